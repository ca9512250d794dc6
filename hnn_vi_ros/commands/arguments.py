# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The command lines of this package; imports none of the libraries that the work needs."""

from collections.abc import Mapping
from pathlib import Path

from hnn_vi_ros.files import complete_by, Parser, seconds

SHELLS = ('bash', 'zsh')


def _add_run(parser: Parser) -> None:
    complete_by(parser.add_argument('scene', metavar='SCENE', help=(
        'the name of a shipped scene, see hnn scene --list, or a YAML file')), 'scene')
    parser.add_argument('--duration', type=seconds, default=10.0, metavar='SECONDS',
                        help='simulated time [s] (default: 10)')
    parser.add_argument('--force', action='store_true', help='overwrite files that exist')


def _add_files(parser: Parser, written: Mapping[str, str]) -> None:
    for option, text in written.items():
        parser.add_argument(option, type=Path, metavar='FILE', help=text)


def run() -> Parser:
    """Return the parser of ``run``."""
    parser = Parser('run', (
        'Simulate a scene. Draw, show or save its trajectory, without ROS.'), [
            'hnn run pendulum',
            'hnn run kepler --duration 100 --integrator gauss8 --step-size 0.02 --csv kepler.csv',
            'hnn run double_pendulum --plot motion.png --animate motion.gif --rerun motion.rrd'])
    _add_run(parser)
    parser.add_argument('--step-size', type=seconds, metavar='SECONDS',
                        help="h [s], in place of the scene's")
    complete_by(parser.add_argument('--integrator', metavar='NAME', help=(
        "in place of the scene's")), 'integrator')
    parser.add_argument('--every', type=int, default=1, metavar='N',
                        help='steps from one sample to the next (default: 1)')
    parser.add_argument('--strict', action='store_true', help=(
        'end with status 3 if an alarm says that the run may be qualitatively wrong'))
    _add_files(parser, {
        '--plot': 'draw coordinates, momenta and energy over time: .png, .svg or .pdf',
        '--portrait': 'draw the phase portraits: .png, .svg or .pdf',
        '--animate': 'draw the mechanism in motion, in real time: .gif',
        '--rerun': 'write a recording for the rerun viewer: .rrd',
        '--csv': 'write the samples as text: a column each for t, coordinates, momenta and H'})
    return parser


def scene() -> Parser:
    """Return the parser of ``scene``."""
    parser = Parser('scene', (
        'Write, check, list, explain and compile scenes. One of the first options says which.'), [
            'ros2 run hnn_vi_ros scene --list',
            'ros2 run hnn_vi_ros scene --explain double_pendulum',
            'ros2 run hnn_vi_ros scene --new mine.yaml --like double_pendulum',
            'ros2 run hnn_vi_ros scene --new --robot my_robot.urdf',
            "ros2 run hnn_vi_ros scene --new my_well --formula 'p_x^2/(2*m) + k*x^4/4'",
            'ros2 run hnn_vi_ros scene --check pendulum mine.yaml'], (
                'The new scene of a robot has its joints, their limits and friction. A line in '
                'the others\nnames the schema by which editors complete and check them.'))
    # argparse would put a group of exclusive options on one line, however long.
    parser.usage = (f'{parser.prog} --list | --explain NAME | --check NAME ... | --compile '
                    '[NAME ...] [--no-rescue] |\n       --schema | --new [FILE] [--like SCENE | '
                    '--formula H | --robot URDF] [--force]')
    task = parser.add_mutually_exclusive_group()
    task.add_argument('--list', action='store_true', help='name the shipped scenes')
    complete_by(task.add_argument('--explain', metavar='NAME', help=(
        'print what a scene simulates, and measure what each of its effects adds to a step')),
        'scene')
    complete_by(task.add_argument('--check', nargs='+', metavar='NAME', help=(
        'say of each scene, a shipped name or a file, whether it is valid')), 'scene')
    complete_by(task.add_argument('--compile', nargs='*', metavar='NAME', help=(
        'compile now, on all cores, what scenes run (default: all shipped ones), so that their '
        'first start need not')), 'scene')
    parser.add_argument('--no-rescue', action='store_true', help=(
        'with --compile: leave out what takes steps that fail, half of the time; a run compiles '
        'that beside itself'))
    task.add_argument('--schema', action='store_true', help=(
        'print the JSON schema by which editors complete and check scenes'))
    task.add_argument('--new', action='store_true', help=(
        'write a scene to begin from: like another, of a formula, or of a robot'))
    parser.add_argument('file', type=Path, nargs='?', metavar='FILE', help=(
        'with --new: what to write; .yaml is added where it has no suffix (of a robot: '
        'ROBOT.yaml)'))
    source = parser.add_mutually_exclusive_group()
    complete_by(source.add_argument('--like', metavar='SCENE', help=(
        'with --new: the scene to copy, a shipped name or a file (default: exact_pendulum)')),
        'scene')
    source.add_argument('--formula', metavar='H', help=(
        'with --new: H [J] of coordinates c and their momenta p_c; other names become parameters'))
    source.add_argument('--robot', metavar='URDF', help=(
        'with --new: the robot, a path or package://PACKAGE/PATH'))
    parser.add_argument('--force', action='store_true', help=(
        'with --new: overwrite FILE if it exists'))
    return parser


def cost() -> Parser:
    """Return the parser of ``cost``."""
    parser = Parser('cost', (
        'Measure what accuracy costs in a scene. The table and the picture show the error of '
        'methods and step sizes, and the time they take.'), [
            'hnn cost pendulum', 'hnn cost kepler --error 1e-6 --plot kepler.png',
            'hnn cost my_scene.yaml --duration 60 --seconds 300 --csv costs.csv'], (
        'The error is the largest deviation of a coordinate or momentum from a reference, in SI '
        'units. Where no\npath is known so long, as in chaos, it is that of the energy, over the '
        'size of the energies in play.\nTimes are those of the processor. Exit status: 0; 1 if '
        'no method holds --error.'))
    _add_run(parser)
    parser.add_argument('--error', type=float, metavar='E', help=(
        'say what to take for an error of this size'))
    parser.add_argument('--seconds', type=seconds, default=60.0, metavar='SECONDS', help=(
        'processor time that may be taken, about, compilation included [s] (default: 60)'))
    _add_files(parser, {
        '--plot': 'draw error against time: .png, .svg or .pdf',
        '--csv': 'write every method and step size as a line of text'})
    return parser


def doctor() -> Parser:
    """Return the parser of ``doctor``."""
    return Parser('doctor', (
        'Report what is installed, and what does not work.'), ['hnn doctor'], (
            'Exit status: 0 if simulating works, 1 if not; what is optional may be absent.'))


def completion() -> Parser:
    """Return the parser of ``completion``."""
    parser = Parser('completion', (
        'Print the script by which a shell completes hnn.'), [
            'hnn completion bash > ~/.local/share/bash-completion/completions/hnn',
            'hnn completion zsh > ~/.zfunc/_hnn'])
    parser.add_argument('shell', choices=SHELLS, help='for which shell')
    return parser
