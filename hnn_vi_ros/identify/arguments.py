# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The command line of identification; imports none of the modules that do the work."""

from pathlib import Path

from hnn_vi_ros.files import complete_by, Parser
from hnn_vi_ros.learning import add_config, INPUTS

_IDENTIFIED = """\
Names of numbers:

    mass                  of the Hamiltonian, as in its YAML
    damping.rate          of the effect of that kind
    damping.1.rate        of the second of several such effects (zero-based index)
    forearm.mass          of a link of a URDF: mass, centre_x to centre_z, ixx to izz
    elbow.damping         of a joint of a URDF, if joint_friction reads it from there; or friction
    input_delay           delay of measured forces [s]
    initial_state         report the initial states of the runs too; they are always fitted"""


def identify() -> Parser:
    """Return the parser of ``identify``."""
    parser = Parser('identify', (
        'Fit parameters of a scene to measured motions. Each gets a confidence interval.'), [
            'hnn identify exact_pendulum --data swing.npz --free length '
            'initial_state',
            'hnn identify arm.yaml --data bags/run7 --free forearm.mass '
            'joint_friction.damping.elbow --bounds forearm.mass 0.5 3 --write fitted.yaml',
            'hnn identify arm.yaml --data arm.npz:run1,run2 --free input_delay '
            '--robust --horizon 0.5 --json numbers.json --out report',
            'hnn identify --robot arm.urdf --data log.csv --write twin.yaml'], _IDENTIFIED)
    complete_by(parser.add_argument('scene', metavar='SCENE', nargs='?', help=(
        'a YAML file, or the name of a shipped scene (see hnn list scenes)')), 'scene')
    parser.add_argument('--robot', type=Path, metavar='URDF', help=(
        'fit servos to a robot whose log has commanded and measured positions: stiffness, '
        'damping, delay, offsets of encoders, friction and rotor inertias, in place of SCENE'))
    parser.add_argument('--known', nargs=2, action='append', default=[], metavar=('NAME', 'VALUE'),
                        help='with --robot, a number that is known, such as servo.stiffness.0')
    parser.add_argument('--masses', choices=['known', 'unknown'], default='known', help=(
        'with --robot, unknown: print forces relative to the inertias of the joints, which is all '
        'that such a log tells without known masses'))
    parser.add_argument('--loads', type=Path, metavar='YAML', help=(
        'read what the robot carried in each log from this file: logs: {NAME: {payload: {link: '
        'hand, mass: 0.3, centre: [0, 0, 0.1]}}}; free: [mass] fits the mass, gain: 2 is a '
        'factor on the stiffness of servos, and NAME may be a pattern such as half_*'))
    parser.add_argument('--data', required=True, nargs='+', action='extend', default=[],
                        metavar='FILE', help=(
        'read bags with joint states; or NPZ[:RUN,...] with arrays t [s], q and optionally dq (or '
        'v) and tau, or RUN/t, ... for several runs; or logs with named '
        'columns'))
    add_config(parser, (
        'read --data as the data section of this training configuration of a machine describes'
        ), 'FILE').type = Path
    parser.add_argument('--measured', nargs='+', default=[], metavar='NAME', help=(
        'read only these coordinates from --data, in this order; the others are not measured '
        '(default: as in --config, or all)'))
    parser.add_argument('--inputs', choices=INPUTS, help=(
        'course of measured forces between samples: each held until the next, linear, or a cubic '
        'spline (default: as in --config, or held for topics of commands, else linear); the '
        'report compares all three'))
    parser.add_argument('--free', default=[], nargs='+', metavar='NAME', help=(
        'fit these numbers (see below), starting from their values in the scene'))
    parser.add_argument('--bounds', nargs=3, action='append', default=[],
                        metavar=('NAME', 'LOW', 'HIGH'),
                        help='restrict a number to [LOW, HIGH]; repeatable')
    parser.add_argument('--robust', action='store_true', help=(
        'reduce the weight of outliers with the soft_l1 loss beyond two standard deviations'))
    parser.add_argument('--horizon', type=float, metavar='S', help=(
        'fit windows of this length [s], each with its own initial state (default: lengthen the '
        'windows up to whole runs while the scene follows the data)'))
    parser.add_argument('--profile', nargs='+', default=[], metavar='NAME', help=(
        'compute profile-likelihood intervals of these numbers; they need not be symmetric'))
    parser.add_argument('--json', type=Path, metavar='FILE', help=(
        'write {name: {value, low, high}} to this file; low and high are null if the data do not '
        'determine them'))
    parser.add_argument('--posterior', type=Path, metavar='FILE', help=(
        'write the numbers with their covariance to this file, from which sweeps can sample'))
    parser.add_argument('--out', type=Path, metavar='DIR', help=(
        'write a report with plots of fit, residuals and correlations to this new folder'))
    parser.add_argument('--write', type=Path, metavar='SCENE.yaml', help=(
        'write the scene with the fitted numbers to this new file'))
    return parser


def check() -> Parser:
    """Return the parser of ``check``."""
    parser = Parser('check', (
        'Check a log before a fit: how it is read, its faults, what it can tell and how well.'), [
            'hnn check log.csv', 'hnn check log.csv --robot arm.urdf --plot log.png',
            'hnn check --robot arm.urdf --excitation move.csv'], (
                'Exit status: 0; 1 if the log is useless. `train` and `identify` print the same '
                'warnings.'))
    parser.add_argument('log', nargs='*', metavar='LOG', help=(
        'bags with joint states, .npz files of arrays, or logs with named columns, of one '
        'machine; none: write only the excitation'))
    parser.add_argument('--robot', type=Path, metavar='URDF', help=(
        'estimate the numbers of motors and friction that the log tells, with the masses of '
        'this robot'))
    parser.add_argument('--plot', type=Path, metavar='FILE', help=(
        'plot positions, commands and intervals: .png, .svg or .pdf'))
    parser.add_argument('--excitation', type=Path, metavar='FILE.csv', help=(
        'with --robot: write positions to command, joint by joint, that tell these numbers'))
    return parser
