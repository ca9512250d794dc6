# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Measure our models as published ones were measured, and write docs/evidence/learning.md."""

import argparse
from collections.abc import Iterator
from pathlib import Path

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.files import Parser, read_yaml
from studies.published_page import (
    FOLDER, MACHINES, PAGE, read_results, Result, write_page, write_results)
from studies.published_pendulum import FILE
from studies.published_runs import Plan, run_table
from studies.results import commit, machine
from tqdm import tqdm

# Seeds of each machine, from 0 on.
_SEEDS = 5


def main(argv: list[str]) -> int:
    """Train and measure every model of the tables, then write the page and its data."""
    arguments = parser().parse_args(argv)
    try:
        if arguments.machines:
            print(measure_on_machines(arguments))
        page = arguments.page or arguments.machines
        results = read_results(arguments.out) if page else measure(arguments)
        print(write_page(arguments.out, results, arguments.quick))
    except OSError as problem:
        raise ParameterError(f'--out {arguments.out}: cannot be written ({problem.strerror}); '
                             'give a folder that can be written') from problem
    return 0


def measure_on_machines(arguments: argparse.Namespace) -> Path:
    """Train and measure the models of machines, and write down every value; return the file."""
    # Imported late: torch takes seconds, and errors should appear at once.
    from studies.machine_tables import measure_machines
    import torch
    torch.set_num_threads(1)
    out: Path = arguments.out / FOLDER / MACHINES
    out.parent.mkdir(parents=True, exist_ok=True)
    return measure_machines(arguments.data, out, range(1 if arguments.quick else _SEEDS),
                            arguments.quick)


def measure(arguments: argparse.Namespace) -> list[Result]:
    """Train and measure the selected models, and write every value."""
    plan = read_yaml(Path(__file__).with_name('published_tables.yaml'), Plan, ParameterError)[0]
    if arguments.quick:
        plan = plan.quick()
    log = arguments.data / FILE
    if not log.is_file():
        print(f'{log}: not there, so nothing is measured on the real pendulum; see --data')
        plan = plan.without_real_pendulum()
    # Found out now, not after the training.
    (arguments.out / FOLDER).mkdir(parents=True, exist_ok=True)
    (arguments.out / PAGE).touch()
    results = list(run(plan, log))
    print(write_results(arguments.out, results))
    return results


def run(plan: Plan, log: Path) -> Iterator[Result]:
    """Train and measure every model of a plan."""
    # Imported late: torch takes seconds, and errors should appear at once.
    import torch
    # Small networks do not benefit from more threads, and one thread makes sums reproducible.
    torch.set_num_threads(1)
    origin = commit(), machine()
    jobs = [(table, system, seed) for table, systems in plan for system in systems
            for seed in systems[system].seeds]
    for table, system, seed in tqdm(jobs, unit='model', disable=None):
        measures = run_table(table, system, getattr(plan, table)[system], seed, log)
        yield from (Result(table, system, seed, measure, value, *origin)
                    for measure, value in measures)


def parser() -> Parser:
    """Return the parser of the command line."""
    found = Parser('published_tables', __doc__, [
        'make study NAME=published_tables ARGS="--quick --out tables"'])
    found.add_argument('--out', type=Path, default=Path('docs/evidence'), metavar='DIR',
                       help='folder to write to (default: docs/evidence)')
    found.add_argument('--data', type=Path, default=Path(), metavar='DIR',
                       help='folder of real_pend_h_1.txt, the log of the real pendulum from the '
                            'supplement of Schmidt and Lipson, Science 324 (2009) (default: '
                            'here)')
    found.add_argument('--quick', action='store_true',
                       help='test run with a few steps of one seed; the results are meaningless')
    what = found.add_mutually_exclusive_group()
    what.add_argument('--page', action='store_true',
                      help='write the page again from the values in DIR, without measuring')
    what.add_argument('--machines', action='store_true',
                      help='measure only the models of machines and of a simulated arm; the data '
                           'sets are in folders of --data: lutter_peters_2021, '
                           'dfki_double_pendulum, multiarm_pendulum; other values are read from '
                           'DIR')
    return found
