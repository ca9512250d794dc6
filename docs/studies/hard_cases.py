# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Run the 21 hard cases: each run must be stable or raise an alarm."""

from collections.abc import Iterator, Sequence
from concurrent.futures import as_completed
from itertools import groupby
import math
from pathlib import Path
import time

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.files import Parser
from hnn_vi_ros.simulation import ignore_sigint_in_children, usable_processors, worker_processes
from hnn_vi_ros.version import __version__
from studies.hard_cases_checks import run_job
from studies.hard_cases_plan import Job, load_plan, make_jobs
from studies.hard_cases_results import (
    CaseRow, differences, expectations_file, Folder, FULL, judge, load_expectations, make_row,
    QUICK, write_expectations)
from studies.results import machine
from tqdm import tqdm

# Rows that a process hands over at once.
_TOGETHER = 4


def main(argv: list[str]) -> int:
    """Run the missing rows, write tables and pictures, and compare with the expectations."""
    arguments = parser().parse_args(argv)
    run = QUICK if arguments.quick else FULL
    plan = load_plan()
    jobs = make_jobs(plan, arguments.quick, arguments.case)
    if not 1 <= arguments.jobs <= 1000:
        raise ParameterError(f'--jobs {arguments.jobs}: expected a number from 1 to 1000')
    folder = Folder(arguments.out, {'run': run, 'version': __version__, 'machine': machine()})
    try:
        run_jobs(jobs, folder, arguments.jobs)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f'stopped: {len(folder.rows)} rows are kept in {folder.path}; the '
                                'same command goes on from there') from None
    found = {row.key: row for row in folder.rows}
    rows = [found[job.key] for job in jobs]
    if arguments.commit:
        write_expectations(expectations_file(), run, rows)
    expected = load_expectations(expectations_file(), run)
    rows = [judge(row, expected.get(row.key)) for row in rows]
    # Imported late: matplotlib takes a second, and errors should appear at once.
    from studies.hard_cases_report import write_page, write_report
    cases = [case for case in plan.cases if case.number in {row.case for row in rows}]
    written = write_report(folder, cases, rows, expected)
    if arguments.docs is not None:
        written += write_page(arguments.docs, folder, cases)
    if arguments.case:
        print_rows(rows)
    for path in written:
        print(path)
    different = differences(rows, expected)
    for line in different:
        print(f'not as expected: {line}')
    print(f'{len(rows)} rows, {len(different)} not as expected')
    return 1 if different else 0


def print_rows(rows: Sequence[CaseRow]) -> None:
    """Print a line for each run: how it ended, its energy band, its alarms and broken gates."""
    names = [f'case {row.case} {row.hamiltonian} H, {row.set_up}'.removesuffix(', ')
             for row in rows]
    widths = max(map(len, names)), max(len(row.method) for row in rows)
    for name, row in zip(names, rows, strict=True):
        band = f'band {row.band:.2g} J' if math.isfinite(row.band) else ''
        why = '; '.join(filter(None, (row.alarm, row.failed and f'fails {row.failed}')))
        print(f'{name:{widths[0]}}  {row.method:{widths[1]}}  {row.verdict:8}  {band:16}  {why}'
              .rstrip())


def run_jobs(jobs: Sequence[Job], folder: Folder, processes: int) -> None:
    """Run the jobs that have no up-to-date row, and show how many are left."""
    there = {row.key: row.digest for row in folder.rows}
    todo = sorted((job for job in jobs if there.get(job.key) != job.digest),
                  key=lambda job: job.kernel)
    with tqdm(total=len(todo), unit='row', disable=None) as bar:
        for row in _rows(todo, processes):
            folder.add(row)
            bar.update()
            bar.set_postfix_str(f'case {row.case}, {row.method}')


def run_one(job: Job) -> CaseRow:
    """Run one job."""
    start = time.perf_counter()
    measured = run_job(job)
    return make_row(job, measured, time.perf_counter() - start)


def _rows(jobs: Sequence[Job], processes: int) -> Iterator[CaseRow]:
    """Yield the rows of jobs, which are sorted by the code that they compile."""
    if processes == 1:
        yield from map(run_one, jobs)
        return
    # A few of one kernel go to one process, so that two seldom compile the same code.
    parts = []
    for _, group in groupby(jobs, key=lambda job: job.kernel):
        same = list(group)
        parts += [same[i:i + _TOGETHER] for i in range(0, len(same), _TOGETHER)]
    with worker_processes(processes) as pool:
        with ignore_sigint_in_children():
            futures = [pool.submit(_run_some, part) for part in parts]
        for future in as_completed(futures):
            yield from future.result()


def _run_some(jobs: Sequence[Job]) -> list[CaseRow]:
    return [run_one(job) for job in jobs]


def parser() -> Parser:
    """Return the parser of the command line."""
    found = Parser('hard_cases', __doc__, [
        'make study NAME=hard_cases ARGS="--quick --out try"',
        'make study NAME=hard_cases ARGS="--case 3 7"'])
    found.add_argument('--quick', action='store_true', help='run few methods for a short time')
    found.add_argument('--case', nargs='+', type=int, metavar='N', help='run only these cases')
    found.add_argument('--out', type=Path, metavar='DIR', default=Path('hard_cases'), help=(
        'folder of the results; an interrupted run continues there (default: hard_cases)'))
    found.add_argument('--jobs', type=int, default=usable_processors(), metavar='N',
                       help='number of processes (default: one per processor)')
    found.add_argument('--docs', type=Path, metavar='DIR',
                       help='also write the page hard-cases.md to this folder')
    found.add_argument('--commit', action='store_true', help=(
        'save the results as the new expectations'))
    return found
