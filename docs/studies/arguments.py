# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The command lines of the studies; import nothing of what they work with."""

from pathlib import Path

from hnn_vi_ros.command_line import Parser, seconds
from hnn_vi_ros.processors import usable_processors

# The longest step over the scene's own: 0.2 s where that is 0.01 s. Each further one is half.
LONGEST, HALVINGS = 20.0, 8
# Of the page on accuracy and cost: learned ones, then those that a formula gives.
SCENES = ('harmonic_oscillator', 'pendulum', 'double_pendulum', 'learned_kepler',
          'learned_henon_heiles', 'exact_harmonic_oscillator', 'exact_pendulum',
          'exact_double_pendulum', 'kepler', 'henon_heiles')
_BAG_TO_MODEL = """\
From a bag to a model: record the double pendulum, train on the bag, simulate what was learned.

Recording and training are the commands that a user would type. The learned model then starts from
states of the bag, and from its last one on into what no bag holds, and is compared with the exact
system. What is there already in the folder of the run is not made again."""


def bag_to_model() -> Parser:
    """Return the parser of ``bag_to_model``."""
    parser = Parser('bag_to_model', _BAG_TO_MODEL, [
        'ros2 run hnn_vi_ros bag_to_model', 'ros2 run hnn_vi_ros bag_to_model --out try --docs .'])
    parser.add_argument('--out', type=Path, default=Path('bag_to_model'), metavar='DIR',
                        help='folder of the bag and the model (default: bag_to_model)')
    parser.add_argument('--docs', type=Path, metavar='DIR',
                        help='write the page bag-to-model.md and its picture there as well')
    return parser


def paper_figures() -> Parser:
    """Return the parser of ``paper_figures``."""
    parser = Parser('paper_figures', (
        'Regenerate figures 1 and 2 of the paper from the shipped model, as PNG and CSV.'), [
            'ros2 run hnn_vi_ros paper_figures --out figures'])
    parser.add_argument('--out', type=Path, default=Path('docs'), metavar='DIR',
                        help='folder to write to (default: docs)')
    return parser


def published_tables() -> Parser:
    """Return the parser of ``published_tables``."""
    parser = Parser('published_tables', (
        'Measure our models where published ones were measured, and write docs/learning.md.'), [
            'ros2 run hnn_vi_ros published_tables --quick --out tables'])
    parser.add_argument('--out', type=Path, default=Path('docs'), metavar='DIR',
                        help='folder to write to (default: docs)')
    parser.add_argument('--data', type=Path, default=Path(), metavar='DIR',
                        help='folder of real_pend_h_1.txt, the log of the real pendulum from the '
                             'supplement of Schmidt and Lipson, Science 324 (2009) (default: '
                             'here)')
    parser.add_argument('--quick', action='store_true',
                        help='a few steps of one seed: whether everything runs, no results')
    what = parser.add_mutually_exclusive_group()
    what.add_argument('--page', action='store_true',
                      help='measure nothing: write the page anew from the values in DIR')
    what.add_argument('--machines', action='store_true',
                      help='measure the models of machines alone, whose data sets are in folders '
                           'of --data: lutter_peters_2021, dfki_double_pendulum, '
                           'multiarm_pendulum, and of an arm that is simulated; the other values '
                           'are those in DIR')
    return parser


def work_precision() -> Parser:
    """Return the parser of ``work_precision``."""
    parser = Parser('work_precision', (
        'Measure what accuracy costs: methods, step sizes and horizons against error and time.'), [
            'ros2 run hnn_vi_ros work_precision --scene pendulum --horizons 10 --runs 3',
            'ros2 run hnn_vi_ros work_precision --scene kepler --methods gauss8 yoshida4 --peers'])
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument('--scene', metavar='NAME', help='shipped name or file')
    what.add_argument('--all', action='store_true', help=(
        f'measure {", ".join(SCENES)}, and write the page on accuracy and cost'))
    what.add_argument('--draw', action='store_true', help=(
        'measure nothing: draw the pictures of that page, and the page to explore, of the rows '
        'that are in the folder of --docs'))
    parser.add_argument('--methods', nargs='+', metavar='METHOD', help=(
        'integrators; METHOD@1e-4 or METHOD@3 does not solve its equations further than a '
        'residual or some iterations, METHOD@float32 takes gradients in single precision'))
    parser.add_argument('--horizons', nargs='+', type=seconds, metavar='SECONDS', help=(
        'simulated times after which errors are measured'))
    parser.add_argument('--steps', nargs='+', type=seconds, metavar='SECONDS', help=(
        f'step sizes (default: {LONGEST:g} times that of the scene, and {HALVINGS} halvings)'))
    parser.add_argument('--out', type=Path, metavar='DIR', help=(
        'folder of the results (default: work_precision/SCENE; with --all work_precision, with a '
        'folder for each scene in it)'))
    parser.add_argument('--docs', type=Path, metavar='DIR', default=Path('docs'),
                        help='folder of the page that --all writes (default: docs)')
    parser.add_argument('--peers', action='store_true',
                        help='measure scipy, torchdiffeq and diffrax as well')
    parser.add_argument('--runs', type=int, help='timed runs at the shortest horizon')
    parser.add_argument('--limit', type=seconds, metavar='SECONDS',
                        help='a single run that would take longer is not begun')
    return parser


def hard_cases() -> Parser:
    """Return the parser of ``hard_cases``."""
    parser = Parser('hard_cases', (
        'Run the fourteen hard cases: each must stay stable, or raise an alarm.'), [
            'ros2 run hnn_vi_ros hard_cases --quick --out try',
            'ros2 run hnn_vi_ros hard_cases --case 3 7'])
    parser.add_argument('--quick', action='store_true', help='short runs of few methods')
    parser.add_argument('--case', nargs='+', type=int, metavar='N', help='only these cases')
    parser.add_argument('--out', type=Path, metavar='DIR', default=Path('hard_cases'), help=(
        'folder of the results, from which an interrupted run goes on (default: hard_cases)'))
    parser.add_argument('--jobs', type=int, default=usable_processors(), metavar='N',
                        help='processes (default: one for each processor)')
    parser.add_argument('--docs', type=Path, metavar='DIR',
                        help='folder to write the page hard-cases.md into as well')
    parser.add_argument('--commit', action='store_true', help=(
        'take what comes out for what is expected from now on'))
    return parser
