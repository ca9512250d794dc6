# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The command lines of what only ``hnn`` has; import nothing of what it works with."""

from pathlib import Path

from hnn_vi_ros.command_line import complete_by, named, Parser, seconds

SHELLS = ('bash', 'zsh', 'tcsh')


def run() -> Parser:
    """Return the parser of ``run``."""
    parser = Parser('run', (
        'Simulate a scene without ROS, and draw, show or save its trajectory.'), [
            'hnn run pendulum',
            'hnn run kepler --duration 100 --integrator gauss8 --step-size 0.02 --csv kepler.csv',
            'hnn run double_pendulum --plot motion.png --animate motion.gif --rerun motion.rrd'])
    complete_by(parser.add_argument('scene', metavar='SCENE', help=(
        'the name of a shipped scene, see hnn scene --list, or a YAML file')), named('scene'))
    parser.add_argument('--duration', type=seconds, default=10.0, metavar='SECONDS',
                        help='simulated time [s] (default: 10)')
    parser.add_argument('--step-size', type=seconds, metavar='SECONDS',
                        help="h [s], in place of the scene's")
    complete_by(parser.add_argument('--integrator', metavar='NAME', help=(
        "in place of the scene's")), named('integrator'))
    parser.add_argument('--every', type=int, default=1, metavar='N',
                        help='steps from one sample to the next (default: 1)')
    parser.add_argument('--plot', type=Path, metavar='FILE', help=(
        'draw coordinates, momenta and energy over time: .png, .svg or .pdf'))
    parser.add_argument('--portrait', type=Path, metavar='FILE', help=(
        'draw the phase portraits: .png, .svg or .pdf'))
    parser.add_argument('--animate', type=Path, metavar='FILE', help=(
        'draw the mechanism in motion, in real time: .gif'))
    parser.add_argument('--rerun', type=Path, metavar='FILE', help=(
        'write a recording for the rerun viewer: .rrd'))
    parser.add_argument('--csv', type=Path, metavar='FILE', help=(
        'write the samples as text: a column each for t, coordinates, momenta and H'))
    return parser


def new_scene() -> Parser:
    """Return the parser of ``new_scene``."""
    parser = Parser('new_scene', (
        'Write a new scene file: a copy of a shipped scene, with the schema for editors.'), [
            'hnn new_scene my_arm', 'hnn new_scene mine.yaml --like double_pendulum'])
    parser.add_argument('file', type=Path, metavar='FILE', help=(
        'what to write; .yaml is added where it has no suffix'))
    complete_by(parser.add_argument('--like', default='exact_pendulum', metavar='SCENE', help=(
        'the scene to copy: a shipped name, or a file (default: exact_pendulum)')), named('scene'))
    return parser


def doctor() -> Parser:
    """Return the parser of ``doctor``."""
    return Parser('doctor', (
        'Report what is installed, what does not work, and why.'), ['hnn doctor'], (
            'Exit status: 0 if simulating works, 1 if not; what is optional may be absent.'))


def completion() -> Parser:
    """Return the parser of ``completion``."""
    parser = Parser('completion', (
        'Print the script by which a shell completes commands, options and names of hnn.'), [
            'hnn completion bash > ~/.local/share/bash-completion/completions/hnn',
            'hnn completion zsh > ~/.zfunc/_hnn'])
    parser.add_argument('shell', choices=SHELLS, help='for which shell')
    return parser
