# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Parsers of training, evaluation and import commands; imports none of their implementations."""

from argparse import Action, ArgumentTypeError
from math import inf
from pathlib import Path
from typing import get_args, Literal

from hnn_vi_ros.files import complete_by, Parser

# Course of measured forces between samples.
Course = Literal['held', 'linear', 'spline']
INPUTS: tuple[Course, ...] = get_args(Course)
# Same as in models/networks/activations.py, whose import requires the compiler.
ACTIVATIONS = ('tanh', 'sine', 'relu', 'softplus')
_IMPORTED = """\
A file alone must contain the weights and biases of a multilayer perceptron with one output, as of
torch.nn.Sequential. Any other module comes from a function without arguments that returns it.

Only the tensors of a file are unpickled. H is that of the module, with the unit, zero and box that
its authors chose."""


def add_config(parser: Parser, text: str, metavar: str = 'NAME|FILE') -> Action:
    """Add ``--config`` with this help, or ``--counts`` to read logs without one."""
    either = parser.add_mutually_exclusive_group()
    either.add_argument('--counts', type=_positive_number, metavar='N', help=(
        'coordinates of a log that are in counts have N per turn (default: as in the lines above '
        'its names)'))
    return either.add_argument('--config', metavar=metavar, help=text)


def _positive_number(text: str) -> float:
    if not 0.0 < (number := float(text)) < inf:
        raise ArgumentTypeError(f'{text!r} is not positive')
    return number


def train() -> Parser:
    """Return the parser of ``train``."""
    parser = Parser('train', 'Train a model of a mechanical system.', [
        'hnn train --data swing.csv',
        'hnn train --config pendulum',
        'hnn train --config double_pendulum_bag --data BAG '
        '--out models/mine.safetensors',
        'hnn train --module net.py:make --data swing.csv'])
    complete_by(add_config(parser, (
        'a YAML file, or the name of a shipped training configuration; default: the names of the '
        'columns in --data give coordinates and forces, and the configuration is printed'
        )), 'training')
    parser.add_argument('--module', metavar='FILE.py:FUNCTION', help=(
        'train the torch module H(q, p) that this function returns, in place of the family of '
        'the configuration; its code is run'))
    parser.add_argument('--loss', metavar='FILE.py:FUNCTION', help=(
        'with --module: minimise loss(module, states, predicted, target), one number; the rates '
        'are in units of their root mean squares'))
    parser.add_argument('--out', type=Path, metavar='FILE',
                        help='write the model to this file (default: models/<name>.safetensors)')
    parser.add_argument('--data', nargs='+', action='extend', default=[], metavar='FILE',
                        help=(
                            'read these logs (.csv, .parquet, ...), bags or arrays (.npz), each '
                            'a run; overrides the data of the configuration'))
    parser.add_argument('--seed', type=int, help='override the seed of the configuration')
    parser.add_argument('--ensemble', type=int, metavar='N', help=(
        'train N members on resampled data; their mean is the model, and their spread measures '
        'its uncertainty'))
    parser.add_argument('--folds', type=int, metavar='N', help=(
        'first train N models, each without a share of the runs, and print their errors there '
        '(cross-validation)'))
    parser.add_argument('--device', choices=('cpu', 'cuda'), default='cpu',
                        help='train on this device (default: cpu)')
    parser.add_argument('--resume', action='store_true', help='resume an interrupted training')
    return parser


def evaluate() -> Parser:
    """Return the parser of ``evaluate``."""
    parser = Parser('evaluate', (
        'Evaluate a model or a scene on measured motions. It is simulated from many measured '
        'states, with the measured forces.'), [
            'hnn evaluate models/arm.safetensors --data arm.npz',
            'hnn evaluate models/arm.safetensors --data bags/run7 --joints a,b',
            'hnn evaluate arm.yaml --data arm.npz:run7,run8 --horizons 0.1 0.5 2 '
            '--baselines arm.npz:run1,run2 --json arm.json --out arm'])
    parser.add_argument('model', metavar='MODEL|SCENE', help=(
        'a .safetensors file, simulated with its friction and a force on each coordinate; or the '
        'name or YAML file of a scene'))
    parser.add_argument('--data', nargs='+', action='extend', default=[], metavar='FILE', help=(
        'read bags with joint states; or NPZ[:RUN,...] with arrays t [s], q, dq/dt and motor '
        'forces, or RUN/t, ... for several runs; or logs with named columns; '
        'or, with --config, files of its format'))
    complete_by(add_config(parser, (
        'read --data as the data section of this training configuration (of any family) '
        'describes; without --data, use the data that it names or computes')), 'training')
    parser.add_argument('--keys', metavar='T,Q[,V[,TAU]]', help=(
        'set the names of the arrays; without V, or with V empty, velocities are estimated from '
        'q; without TAU no forces act (default: t,q,dq,tau)'))
    parser.add_argument('--joints', metavar='NAME,...', help=(
        'read these joints of a bag, one per coordinate (default: the names of the coordinates)'))
    parser.add_argument('--horizons', type=float, nargs='+', metavar='S', help=(
        'report errors after these times [s] (default: 0.1 0.5; more if samples are rare)'))
    parser.add_argument('--every', type=float, metavar='S', help=(
        'start a prediction at this interval [s] (default: 0.05; more if samples are rare)'))
    parser.add_argument('--longest', type=float, metavar='S', help=(
        'predict for at most this time to find the valid prediction time [s] (default: 2; more '
        'if samples are rare)'))
    parser.add_argument('--whole', action='store_true', help=(
        'also simulate each run once, from start to end'))
    parser.add_argument('--from', type=int, default=0, metavar='N', dest='first', help=(
        'with --whole: start at sample N of each run (default: 0)'))
    parser.add_argument('--held-out', action='store_true', help=(
        'with --config: evaluate only on the runs that a training with it holds out'))
    parser.add_argument('--smoothing', type=float, metavar='HZ', help=(
        'set the cut-off frequency of the zero-phase filter for the initial states (default: 40)'))
    parser.add_argument('--baselines', nargs='+', metavar='FILE', help=(
        'compare with a linear model and a rigid body that are fitted to these motions'))
    parser.add_argument('--out', type=Path, metavar='DIR', help=(
        'write a report to this new folder: this table, a plot of predictions and measurements, '
        'and a recording of both for rerun'))
    parser.add_argument('--json', type=Path, metavar='FILE', help='write the numbers to this file')
    return parser


def import_model() -> Parser:
    """Return the parser of ``import``."""
    parser = Parser('import', 'Convert a trained torch module H(q, p) to a model.', [
        'hnn import my_module.py:make --weights weights.pt --coordinates theta '
        '--box=-3:3,-2:2', 'hnn import sequential.pt --activation tanh '
        '--coordinates x,y --box=-1:1'], _IMPORTED)
    parser.add_argument('source', metavar='FILE.py:FUNCTION|FILE', help=(
        'a function that returns the module, whose code is run once, or a state_dict written by '
        'torch.save'))
    parser.add_argument('--weights', metavar='FILE', help=(
        'load this state_dict, written by torch.save, into the module'))
    parser.add_argument('--entry', metavar='NAME', help=(
        'take this state_dict of a checkpoint that holds several'))
    parser.add_argument('--activation', choices=ACTIVATIONS, help=(
        'set the activation between the layers of a file without code, which does not contain it'))
    parser.add_argument('--coordinates', required=True, metavar='NAME,...',
                        help='name the coordinates')
    parser.add_argument('--box', required=True, metavar='LOW:HIGH,...', help=(
        'set the bounds of the training data: one interval for each coordinate, then for each '
        'momentum, or one for all; outside of them a simulation raises an alarm'))
    parser.add_argument('--out', type=Path, metavar='FILE',
                        help='write the model to this file (default: models/<name>.safetensors)')
    return parser
