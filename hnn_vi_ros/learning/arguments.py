# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Parsers of training, evaluation and import commands; imports none of their implementations."""

from pathlib import Path

from hnn_vi_ros.files import complete_by, Parser

# Layouts of the outputs of an imported network, and orders of its inputs.
LAYOUTS, ORDERS = ('hnn', 'sum_second_half', 'so3', 'se3'), ('qp', 'pq')
# Behaviour of measured forces between samples, as in learning/data/motions.py.
INPUTS = ('held', 'interpolated')
# Same as in hamiltonians/activations.py, whose import requires the compiler.
ACTIVATIONS = ('tanh', 'sine', 'relu', 'softplus')
_IMPORTED = """\
The original HNN code and its forks save the state_dict of a torch module,
differentiable_model.linear1.weight, ..., the last layer without bias, of several outputs F:

    hnn              2 outputs, H = F_2 (F_1 is the conservative part, which has no H)
    sum_second_half  2 d outputs, H = F_(d+1) + ... + F_(2 d)

The Lie-group Hamiltonian code saves several networks of one body, M_net.linear1.weight, ...:

    so3              a body that turns, M_net, V_net, g_net and, with friction, Dw_net
    se3              one that moves as well, M_net1, M_net2, V_net, g_net, and Dv_net, Dw_net

Nothing of the file but its tensors is unpickled. H is that of the source network: its unit, its
zero and its box are what its authors say they are."""

def train() -> Parser:
    """Return the parser of ``train``."""
    parser = Parser('train', 'Train a model of a mechanical system.', [
        'ros2 run hnn_vi_ros train --config pendulum',
        'ros2 run hnn_vi_ros train --config double_pendulum_bag --data BAG '
        '--out models/mine.safetensors'])
    complete_by(parser.add_argument('--config', required=True, metavar='NAME|FILE', help=(
        'a shipped training configuration, or a YAML file')), 'training')
    parser.add_argument('--out', type=Path, metavar='FILE',
                        help='the model file to write (default: models/<name>.safetensors)')
    parser.add_argument('--data', nargs='+', default=[], metavar='FILE',
                        help='a measured log, or bags, instead of data.path')
    parser.add_argument('--seed', type=int, help="instead of the configuration's seed")
    parser.add_argument('--ensemble', type=int, metavar='N', help=(
        'train N members on resampled data, whose mean is the model, and whose spread '
        'measures its uncertainty'))
    parser.add_argument('--device', choices=('cpu', 'cuda'), default='cpu',
                        help='where to train (default: cpu)')
    parser.add_argument('--resume', action='store_true',
                        help='continue a run that was interrupted')
    return parser


def evaluate() -> Parser:
    """Return the parser of ``evaluate``."""
    parser = Parser('evaluate', (
        'Judge a model or a scene by measured motions. It is simulated freely from many '
        'measured states, with the measured forces.'), [
            'ros2 run hnn_vi_ros evaluate models/arm.safetensors --data arm.npz',
            'ros2 run hnn_vi_ros evaluate models/arm.safetensors --data bags/run7 --joints a,b',
            'ros2 run hnn_vi_ros evaluate arm.yaml --data arm.npz:run7,run8 --horizons 0.1 0.5 2 '
            '--baselines arm.npz:run1,run2 --json arm.json --out arm'])
    parser.add_argument('model', metavar='MODEL|SCENE', help=(
        'a .safetensors file, with its friction and a force on each coordinate; or the name or '
        'the YAML file of a scene'))
    parser.add_argument('--data', nargs='+', default=[], metavar='FILE', help=(
        'bags with joint states; or NPZ[:RUN,...], arrays of t [s], q, dq/dt and the forces of '
        'the motors, or RUN/t, ... of several runs; or, with --config, files of its format'))
    complete_by(parser.add_argument('--config', metavar='NAME|FILE', help=(
        'a training configuration of any family, whose data section says how --data is read, and '
        'names files or computes motions where there is no --data')), 'training')
    parser.add_argument('--keys', metavar='T,Q[,V[,TAU]]', help=(
        'names of the arrays; without V, or with nothing in its place, velocities are estimated '
        'from q; without TAU no forces act (default: t,q,dq,tau)'))
    parser.add_argument('--joints', metavar='NAME,...', help=(
        'joints of a bag, one a coordinate (default: the names of the coordinates)'))
    parser.add_argument('--horizons', type=float, nargs='+', default=[0.1, 0.5],
                        metavar='S', help='after which errors are taken [s] (default: 0.1 0.5)')
    parser.add_argument('--every', type=float, default=0.05, metavar='S', help=(
        'from one start to the next [s] (default: 0.05)'))
    parser.add_argument('--longest', type=float, default=2.0, metavar='S', help=(
        'how long predictions last for the valid prediction time [s] (default: 2)'))
    parser.add_argument('--whole', action='store_true', help=(
        'also simulate each run once, from its beginning to its end'))
    parser.add_argument('--from', type=int, default=0, metavar='N', dest='first', help=(
        'with --whole: begin at sample N of each run (default: 0)'))
    parser.add_argument('--held-out', action='store_true', help=(
        'with --config: judge by what a training with it holds out'))
    parser.add_argument('--smoothing', type=float, metavar='HZ', help=(
        'cut-off of the zero-phase filter of the initial states (default: 40)'))
    parser.add_argument('--baselines', nargs='+', metavar='FILE', help=(
        'compare with a linear model, and with a rigid body, that are fitted to these motions'))
    parser.add_argument('--out', type=Path, metavar='DIR', help=(
        'a new folder for a report with this table, a picture of the predictions over what was '
        'measured, and a recording of both for rerun'))
    parser.add_argument('--json', type=Path, metavar='FILE', help='write the numbers here')
    return parser


def import_checkpoint() -> Parser:
    """Return the parser of ``import_checkpoint``."""
    parser = Parser('import_checkpoint', (
        'Convert a network of the original HNN code or its forks.'), [
            'ros2 run hnn_vi_ros import_checkpoint funnel.tar --layout sum_second_half '
            '--activation sine --coordinates q1,q2 --box=-6:6,-4:4,-4:4,-4:4'], _IMPORTED)
    parser.add_argument('file', type=Path, metavar='FILE', help='what torch.save wrote')
    parser.add_argument('--layout', required=True, choices=LAYOUTS, help='which outputs are H')
    parser.add_argument('--activation', required=True, choices=ACTIVATIONS,
                        help='between the layers; the file does not say')
    parser.add_argument('--coordinates', required=True, metavar='NAME,...',
                        help='a name for each coordinate')
    parser.add_argument('--order', default='qp', choices=ORDERS,
                        help='of the inputs: coordinates first (default), or momenta first')
    box = parser.add_mutually_exclusive_group(required=True)
    box.add_argument('--box', metavar='LOW:HIGH,...', help=(
        'bounds of the data that the network was trained on: of each coordinate, then of each '
        'momentum, or one for all; beyond them a simulation raises an alarm'))
    box.add_argument('--box-of', metavar='NAME|FILE', help=(
        'instead: the bounds of the data of this training configuration'))
    parser.add_argument('--epsilon', type=float, metavar='NUMBER', help=(
        "of so3 and se3: that code's epsilon of M_net, whose root is added to the diagonal of the "
        'root of M^-1; 0 for none; the file does not say'))
    parser.add_argument('--floor', type=float, default=0.0, metavar='NUMBER', help=(
        'of so3 and se3: what that code adds to the diagonal of M^-1 itself (default: 0)'))
    parser.add_argument('--out', type=Path, metavar='FILE',
                        help='the model file to write (default: models/<name>.safetensors)')
    return parser
