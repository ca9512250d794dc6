# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The command line of ``sweep``; imports none of the modules that do the work."""

from pathlib import Path

from hnn_vi_ros.files import complete_by, Parser

_DETAILS = """\
A shard is a file that is written as a whole: part-000000.parquet and so on. Its bytes do not
depend on the process, the machine or the order. Existing shards are not computed again, so the
same command continues an interrupted sweep. Exit status: 0 if all shards exist, 130 if Ctrl-C
stopped it."""


def sweep() -> Parser:
    """Return the parser of ``sweep``."""
    parser = Parser('sweep', (
        'Simulate many parameters and initial states. The result is a Parquet dataset.'), [
            'hnn sweep pendulum_energies',
            'hnn sweep my_sweep.yaml --out results --jobs 8',
            'hnn sweep my_sweep.yaml --out results --ray local'],
        _DETAILS)
    what = parser.add_mutually_exclusive_group(required=True)
    complete_by(what.add_argument('sweep', nargs='?', metavar='SWEEP', help=(
        'name of a shipped sweep, or a YAML file')), 'sweep')
    what.add_argument('--schema', action='store_true', help=(
        'print the JSON schema with which editors complete and check sweeps'))
    parser.add_argument('--out', type=Path, metavar='DIR', help=(
        'folder of the results (default: sweeps/NAME)'))
    where = parser.add_mutually_exclusive_group()
    where.add_argument('--jobs', type=int, metavar='N', help=(
        'number of processes on this machine (default: one per processor)'))
    where.add_argument('--ray', metavar='ADDRESS', help=(
        'distribute the shards over a Ray cluster: its address, auto for the cluster of this '
        'machine, or local for this machine alone'))
    parser.add_argument('--device', metavar='DEVICE', help=(
        'compute the steps with torch on cuda, cuda:N or cpu, thousands of trajectories together; '
        'for models that are networks, without effects (default: compiled loops on the CPU)'))
    return parser
