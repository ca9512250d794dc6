# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The command line of ``sweep``; imports none of the modules that do the work."""

from pathlib import Path

from hnn_vi_ros.files import complete_by, Parser

_DETAILS = """\
A shard is a file that is made as a whole: part-00000.parquet and so on, with the same bytes
whichever process or machine makes it, and in whatever order. Shards that are in the folder already
are not made again, so the same command continues an interrupted sweep. Exit status: 0 if all
shards are there, 130 if Ctrl-C stopped it."""


def sweep() -> Parser:
    """Return the parser of ``sweep``."""
    parser = Parser('sweep', (
        'Simulate many parameters and initial states. The result is a Parquet dataset.'), [
            'ros2 run hnn_vi_ros sweep pendulum_energies',
            'ros2 run hnn_vi_ros sweep my_sweep.yaml --out results --jobs 8',
            'ros2 run hnn_vi_ros sweep my_sweep.yaml --out results --ray local',
            'ros2 run hnn_vi_ros sweep my_sweep.yaml --episodes mcap --select 0:1000:50'],
        _DETAILS)
    what = parser.add_mutually_exclusive_group(required=True)
    complete_by(what.add_argument('sweep', nargs='?', metavar='SWEEP', help=(
        'what varies: the name of a shipped sweep, or a YAML file')), 'sweep')
    what.add_argument('--schema', action='store_true', help=(
        'print the JSON schema by which editors complete and check sweeps'))
    parser.add_argument('--out', type=Path, metavar='DIR', help=(
        'folder of the results (default: sweeps/NAME; of episodes episodes/NAME)'))
    where = parser.add_mutually_exclusive_group()
    where.add_argument('--jobs', type=int, metavar='N', help=(
        'processes of this machine (default: one for each processor)'))
    where.add_argument('--ray', metavar='ADDRESS', help=(
        'spread the shards over a Ray cluster: its address, auto for the one that this machine '
        'belongs to, or local for one of this machine alone'))
    parser.add_argument('--device', metavar='DEVICE', help=(
        'take the steps in torch, thousands of trajectories together: on cuda, cuda:N or cpu; '
        'for models that are networks, without effects (default: compiled loops on the '
        'processor)'))
    parser.add_argument('--episodes', choices=('mcap',), help=(
        'write trajectories one by one in place of shards: bags like those of the simulator'))
    parser.add_argument('--select', metavar='INDICES', help=(
        'with --episodes: which, as N, FIRST:END or FIRST:END:STEP, with commas between several '
        '(default: all)'))
    return parser
