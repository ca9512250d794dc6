# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The command lines of this package; imports none of the libraries that the work needs."""

from collections.abc import Mapping
from pathlib import Path

from hnn_vi_ros.files import complete_by, Parser, seconds

LISTED = ('scenes', 'integrators', 'effects', 'hamiltonians', 'families', 'models', 'tasks')


def _add_run(parser: Parser) -> None:
    complete_by(parser.add_argument('scene', metavar='SCENE', help=(
        'name of a shipped scene (see hnn list scenes), or a YAML file')), 'scene')
    parser.add_argument('--duration', type=seconds, metavar='SECONDS',
                        help="simulated time [s] (default: the scene's, 10 if it has none)")
    parser.add_argument('--force', action='store_true', help='overwrite existing files')


def _add_files(parser: Parser, written: Mapping[str, str]) -> None:
    for option, text in written.items():
        parser.add_argument(option, type=Path, metavar='FILE', help=text)


def run() -> Parser:
    """Return the parser of ``run``."""
    parser = Parser('run', (
        'Simulate a scene without ROS. Plot, show or save its trajectory.'), [
            'hnn run pendulum',
            'hnn run kepler --duration 100 --integrator gauss8 --step-size 0.02 --csv kepler.csv',
            'hnn run double_pendulum --plot motion.png --rerun motion.rrd'])
    _add_run(parser)
    parser.add_argument('--step-size', type=seconds, metavar='SECONDS',
                        help="step size h [s]; overrides the scene's")
    complete_by(parser.add_argument('--integrator', metavar='NAME', help=(
        "integrator; overrides the scene's")), 'integrator')
    parser.add_argument('--every', type=int, default=1, metavar='N',
                        help='number of steps between samples (default: 1)')
    parser.add_argument('--strict', action='store_true', help=(
        'exit with status 3 if an alarm says that the run may be qualitatively wrong'))
    _add_files(parser, {
        '--plot': 'plot coordinates, momenta and energy against time: .png, .svg or .pdf',
        '--portrait': 'plot the phase portraits: .png, .svg or .pdf',
        '--plot-energy': 'plot the energy that each cause stored, took and gave: .png, .svg or '
                         '.pdf',
        '--rerun': 'write a recording for the rerun viewer: .rrd',
        '--csv': 'write the samples as CSV: a column each for t, coordinates, momenta and H; - '
                 'is standard output'})
    return parser


def names() -> Parser:
    """Return the parser of ``list``."""
    parser = Parser('list', 'List names with descriptions.', [
        'hnn list scenes', 'hnn list effects damping'])
    parser.add_argument('what', choices=LISTED, metavar='WHAT', help=', '.join(LISTED))
    parser.add_argument('name', nargs='?', metavar='NAME', help=(
        'an integrator, effect, hamiltonian or family: print its keys with units and defaults, '
        'and an example'))
    return parser


def scene() -> Parser:
    """Return the parser of ``scene``."""
    parser = Parser('scene', (
        'Write, check, explain and compile scenes. The first option is the action.'), [
            'hnn scene --explain double_pendulum',
            'hnn scene --new mine.yaml --like double_pendulum',
            'hnn scene --new --robot my_robot.urdf',
            "hnn scene --new my_well --formula 'p_x^2/(2*m) + k*x^4/4'",
            'hnn scene --check pendulum mine.yaml'], (
                'The new scene of a robot contains its joints with their limits and friction. '
                'Other new scenes\nname the schema with which editors complete and check them.'))
    # argparse would put a group of exclusive options on one line, however long.
    parser.usage = (f'{parser.prog} --explain NAME | --check NAME ... | --compile '
                    '[NAME ...] [--no-rescue] |\n       --schema | --new [FILE] [--like SCENE | '
                    '--formula H | --robot URDF] [--force]')
    task = parser.add_mutually_exclusive_group()
    complete_by(task.add_argument('--explain', metavar='NAME', help=(
        'describe a scene, and measure the time that each effect adds to a step')),
        'scene')
    complete_by(task.add_argument('--check', nargs='+', metavar='NAME', help=(
        'report whether each scene, a shipped name or a file, is valid')), 'scene')
    complete_by(task.add_argument('--compile', nargs='*', metavar='NAME', help=(
        'compile scenes now, on all cores (default: all shipped scenes), so that their first '
        'start is fast')), 'scene')
    parser.add_argument('--no-rescue', action='store_true', help=(
        'with --compile: omit the code for failed steps, which takes half of the time; a run '
        'compiles it in the background'))
    task.add_argument('--schema', action='store_true', help=(
        'print the JSON schema with which editors complete and check scenes'))
    task.add_argument('--new', action='store_true', help=(
        'write a new scene: a copy of another, of a formula, or of a robot'))
    parser.add_argument('file', type=Path, nargs='?', metavar='FILE', help=(
        'with --new: file to write; .yaml is added if it has no suffix (default for a robot: '
        'ROBOT.yaml)'))
    source = parser.add_mutually_exclusive_group()
    complete_by(source.add_argument('--like', metavar='SCENE', help=(
        'with --new: scene to copy, a shipped name, a file, or a bag of the simulator (default: '
        'exact_pendulum)')),
        'scene')
    source.add_argument('--formula', metavar='H', help=(
        'with --new: H [J] as a function of coordinates c and momenta p_c; other names become '
        'parameters'))
    source.add_argument('--robot', metavar='URDF', help=(
        'with --new: URDF of the robot, a path or package://PACKAGE/PATH'))
    parser.add_argument('--force', action='store_true', help=(
        'with --new: overwrite FILE if it exists'))
    return parser


def cost() -> Parser:
    """Return the parser of ``cost``."""
    parser = Parser('cost', (
        'Measure the cost of accuracy in a scene. The table and the figure show the error and the '
        'run time of methods and step sizes.'), [
            'hnn cost pendulum', 'hnn cost kepler --error 1e-6 --plot kepler.png',
            'hnn cost my_scene.yaml --duration 60 --rate 100 --csv costs.csv'], (
        'The error is the largest deviation of a coordinate or momentum from a reference, in SI '
        'units. If no\nreference is known for so long, as in chaos, it is the energy error '
        'relative to the energy scale.\nTimes are processor times. The recommendation is the '
        'choice of `integrator: auto`, which counts gradients\nand steps instead, so that it is '
        'reproducible. Exit status: 0; 1 if no method reaches --error.'))
    _add_run(parser)
    parser.add_argument('--error', type=float, metavar='E', help=(
        'recommend a method and step size for this error'))
    parser.add_argument('--rate', type=float, metavar='HZ', help=(
        'compare only step sizes that divide the interval of samples at this rate, as a '
        'publish_rate of the simulator requires'))
    parser.add_argument('--seconds', type=seconds, default=60.0, metavar='SECONDS', help=(
        'approximate limit of the processor time for measuring [s]; methods are started while '
        'compiling and measuring together take no longer (default: 60)'))
    _add_files(parser, {
        '--plot': 'plot error against time: .png, .svg or .pdf',
        '--csv': 'write every method and step size as a row of CSV'})
    return parser


def doctor() -> Parser:
    """Return the parser of ``doctor``."""
    return Parser('doctor', (
        'Report what is installed and what does not work.'), ['hnn doctor'], (
            'Exit status: 0 if simulations work, 1 if not; optional packages may be absent.'))
