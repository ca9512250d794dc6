# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The command line of identification; imports none of the modules that do the work."""

from pathlib import Path

from hnn_vi_ros.files import complete_by, Parser
from hnn_vi_ros.learning import INPUTS

_IDENTIFIED = """\
Names of numbers:

    mass                  of the Hamiltonian, as in its YAML
    damping.rate          of the effect of that kind
    damping.1.rate        of the second one, where there are several: they count from 0
    forearm.mass          of a link of a URDF: mass, centre_x to centre_z, ixx to izz
    elbow.damping         of a joint of a URDF, where joint_friction takes it from there; friction
    input_delay           how late measured forces act [s]
    initial_state         the initial states of the runs, which are always found, are told too"""


def identify() -> Parser:
    """Return the parser of ``identify``."""
    parser = Parser('identify', (
        'Fit parameters of a scene to measured motions. Each gets a confidence interval.'), [
            'ros2 run hnn_vi_ros identify exact_pendulum --data swing.npz --free length '
            'initial_state',
            'ros2 run hnn_vi_ros identify arm.yaml --data bags/run7 --free forearm.mass '
            'joint_friction.damping.elbow --bounds forearm.mass 0.5 3 --write fitted.yaml',
            'ros2 run hnn_vi_ros identify arm.yaml --data arm.npz:run1,run2 --free input_delay '
            '--robust --horizon 0.5 --json numbers.json --out report'], _IDENTIFIED)
    complete_by(parser.add_argument('scene', metavar='SCENE', help=(
        'the name of a shipped scene, see scene --list, or a YAML file')), 'scene')
    parser.add_argument('--data', required=True, nargs='+', metavar='FILE', help=(
        'bags with joint states; or NPZ[:RUN,...], arrays t [s], q, and where there are dq (or v) '
        'and tau, or RUN/t, ... of several runs; or, with --config, a log'))
    parser.add_argument('--config', type=Path, metavar='FILE', help=(
        'a training configuration of a machine, whose data section says how --data is read'))
    parser.add_argument('--inputs', choices=INPUTS, help=(
        'what measured forces do between samples: each is held until the next, or goes over into '
        'it; default: as --config says, or held for topics of commands, else interpolated; the '
        'report says which fits better'))
    parser.add_argument('--free', required=True, nargs='+', metavar='NAME', help=(
        'the numbers to find, see below; the search begins at their values in the scene'))
    parser.add_argument('--bounds', nargs=3, action='append', default=[],
                        metavar=('NAME', 'LOW', 'HIGH'), help='of a number; may be repeated')
    parser.add_argument('--robust', action='store_true', help=(
        'let outliers count less, by the loss soft_l1 beyond two standard deviations'))
    parser.add_argument('--horizon', type=float, metavar='S', help=(
        'length of the windows, each with an initial state of its own [s]; default: they grow up '
        'to whole runs, as long as the scene follows'))
    parser.add_argument('--profile', nargs='+', default=[], metavar='NAME', help=(
        'profile intervals of these numbers, which need not be symmetric'))
    parser.add_argument('--json', type=Path, metavar='FILE', help=(
        'write {name: {value, low, high}} here; low and high are null where the data '
        'do not determine them'))
    parser.add_argument('--posterior', type=Path, metavar='FILE', help=(
        'write the numbers with their covariance here, from which sweeps draw'))
    parser.add_argument('--out', type=Path, metavar='DIR', help=(
        'a new folder for a report with pictures of fit, residuals and correlations'))
    parser.add_argument('--write', type=Path, metavar='SCENE.yaml', help=(
        'write the scene with the fitted numbers to this new file'))
    return parser
