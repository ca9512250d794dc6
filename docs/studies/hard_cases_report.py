# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Report on the hard cases: Markdown, CSV and pictures, and the pages of the docs."""

from collections import Counter
from collections.abc import Mapping, Sequence
import json
import math
from pathlib import Path
import shutil
from types import MappingProxyType
from typing import Any

from hnn_vi_ros.errors import listed, ParameterError
from hnn_vi_ros.integrators import INTEGRATORS
from studies.coarse_steps import committed, read_runs, table
from studies.hard_cases_figure import draw_bands, draw_case, draw_verdicts
from studies.hard_cases_plan import Case, load_plan
from studies.hard_cases_results import (
    CaseRow, CSV, differences, Expectation, expectations_file, Folder, FULL, Key,
    load_expectations, read_csv, write_csv)
from studies.pages import render

MARKDOWN = 'hard_cases.md'
PAGE, PICTURES, CARD = 'hard-cases.md', 'hard_cases', 'hard_cases.json'
GRID, BANDS, VERDICTS = 'grid.html', 'bands.png', 'verdicts.png'
# Methods for comparison, in the last columns.
BASELINES = ('explicit_euler', 'rk4')
# Cases whose claim is an alarm or a stop in some of their set-ups.
MEANT = frozenset({6, 10, 11, 17, 18, 19, 21})


def write_report(folder: Folder, cases: Sequence[Case], rows: Sequence[CaseRow],
                 expected: Mapping[Key, Expectation]) -> list[Path]:
    """
    Write tables and pictures into the folder of a run; return the files.

    Raises
    ------
    ParameterError
        A file cannot be written.

    """
    try:
        pictures = [draw_case(folder.path / _picture(case), case, _of(case, rows))
                    for case in cases]
        page = folder.path / MARKDOWN
        page.write_text(render(MARKDOWN, cases=_parts(cases, rows, expected)), encoding='utf-8')
        return [page, write_csv(folder.path / CSV, rows), *pictures]
    except OSError as problem:
        raise ParameterError(f'--out {folder.path}: cannot be written ({problem.strerror}); '
                             'give a folder that can be written') from problem


def write_page(docs: Path, source: Folder, cases: Sequence[Case]) -> list[Path]:
    """
    Write the page of the docs, its table of all runs, and the pictures.

    Other cases that the page already has stay on it.

    Parameters
    ----------
    docs : Path
        Folder of the page.
    source : Folder
        The one that ``write_report`` wrote to.
    cases : sequence of Case
        The cases of the run.

    Raises
    ------
    ParameterError
        A file cannot be written.

    """
    folder = docs / PICTURES
    try:
        folder.mkdir(parents=True, exist_ok=True)
        copies = [Path(shutil.copyfile(source.path / name, folder / name))
                  for name in map(_picture, cases)]
        there, card, identity = folder / CSV, folder / CARD, source.identity
        rows, numbers = read_csv(source.path / CSV), [case.number for case in cases]
        others = [row for row in read_csv(there) if row.case not in numbers] \
            if there.is_file() else []
        if others:
            before, own = json.loads(card.read_text(encoding='utf-8')), identity['machine']
            if own not in before['machine']:
                before['machine'] += f'; case {listed(numbers)} from {own}'
            identity = before
        copies.append(write_csv(there, sorted(rows + others, key=lambda row: row.case)))
        card.write_text(json.dumps(identity, indent=1) + '\n', encoding='utf-8')
        page, grid = docs / PAGE, folder / GRID
        page.write_text(page_of(docs), encoding='utf-8')
        grid.write_text(grid_of(docs), encoding='utf-8')
        pictures = draw_summaries(docs)
    except OSError as problem:
        raise ParameterError(f'--docs {docs}: cannot be written ({problem.strerror}); give a '
                             'folder that can be written') from problem
    return [page, grid, *pictures, *copies, card]


def page_of(docs: Path) -> str:
    """Return the page, from the table that the docs hold."""
    card = json.loads((docs / PICTURES / CARD).read_text(encoding='utf-8'))
    cases, rows = _read(docs)
    expected = load_expectations(expectations_file(), card.get('run', FULL))
    silent = sorted({row.method for row in rows if row.verdict == 'unstable'})
    coarse = read_runs(committed())
    ends = Counter(f'{run.judgement} {"told" if run.alarms else "silent"}' for run in coarse)
    return render(PAGE, cases=_parts(cases, rows, expected, card.get('notes', {})),
                  machine=card['machine'], runs=len(rows), silent=silent, baselines=BASELINES,
                  silent_runs=sum(row.method in silent for row in rows),
                  coarse=len(coarse), ends=ends, table=table(coarse),
                  meant=[case for case in cases if case.number in MEANT],
                  meant_runs=sum(_shown(row) == 'meant' for row in rows),
                  compared=sum(row.method in BASELINES for row in rows),
                  verdicts=Counter(row.verdict for row in rows))


def _shown(row: CaseRow) -> str:
    """Return the verdict of a run, or 'meant' for an alarm or a stop that its case claims."""
    return 'meant' if row.case in MEANT and row.verdict in ('alarm', 'stopped') else row.verdict


def draw_summaries(docs: Path) -> list[Path]:
    """Draw the verdicts by method and all energy bands, from the table that the docs hold."""
    cases, rows = _read(docs)
    counts: dict[str, Counter[str]] = {name: Counter() for name in _columns(rows)}
    for row in rows:
        counts[row.method.partition('@')[0]][_shown(row)] += 1
    folder = docs / PICTURES
    return [draw_verdicts(folder / VERDICTS, counts), draw_bands(folder / BANDS, cases, rows)]


def grid_of(docs: Path) -> str:
    """Return the table of all runs as HTML, from the table that the docs hold."""
    cases, rows = _read(docs)
    methods = _columns(rows)
    parts = []
    for case in cases:
        lines: dict[tuple[str, str, str], dict[str, CaseRow]] = {}
        for row in _of(case, rows):
            method, _, variant = row.method.partition('@')
            lines.setdefault((row.hamiltonian, row.set_up, variant), {})[method] = row
        parts.append((case, [(', '.join(filter(None, name)), [
            line.get(method) for method in methods]) for name, line in lines.items()]))
    return render(GRID, cases=parts, methods=methods)


def _read(docs: Path) -> tuple[list[Case], list[CaseRow]]:
    """Return the rows that the docs hold, and their cases."""
    rows = read_csv(docs / PICTURES / CSV)
    return [case for case in load_plan().cases if _of(case, rows)], rows


def _columns(rows: Sequence[CaseRow]) -> list[str]:
    """Return the methods in the order of the registry, the baselines last."""
    met = {row.method.partition('@')[0] for row in rows}
    return sorted(met, key=lambda name: (name in BASELINES, list(INTEGRATORS).index(name)))


def _picture(case: Case) -> str:
    """Return the file name of a case's picture."""
    return f'case_{case.number:02d}.png'


def _of(case: Case, rows: Sequence[CaseRow]) -> list[CaseRow]:
    return [row for row in rows if row.case == case.number]


def _parts(cases: Sequence[Case], rows: Sequence[CaseRow], expected: Mapping[Key, Expectation],
           notes: Mapping[str, str] = MappingProxyType({})) -> list[dict[str, Any]]:
    """Return the template values of each case; notes are keyed by case number."""
    parts = []
    for case in cases:
        own = _of(case, rows)
        counts = Counter(row.verdict for row in own)
        parts.append({
            'case': case, 'picture': _picture(case),
            'counts': [len(own), *(counts[word] for word in (
                'stable', 'alarm', 'stopped', 'unstable'))],
            'note': notes.get(str(case.number)), 'wrong': len(differences(own, dict(expected))),
            'rows': [_cells(row, expected.get(row.key)) for row in own]})
    return parts


def _cells(row: CaseRow, expectation: Expectation | None) -> list[str]:
    limits = expectation.limits if expectation is not None else {}

    def limited(name: str, value: float) -> str:
        if math.isnan(value):
            return ''
        return f'{value:.2g} ({limits[name]:g})' if name in limits else f'{value:.2g}'

    other = '; '.join(f'{name} {limited(name, value)}' for name, value in row.measures.items())
    verdict = row.verdict
    if expectation is None or expectation.verdict != verdict:
        verdict += f', expected {expectation.verdict if expectation else "nothing"}'
    return [row.set_up, row.hamiltonian, row.method, f'{row.steps:.0e}'.replace('e+0', 'e'),
            limited('band', row.band), _number(row.slope),
            limited('modified band', row.modified_band), _number(row.residual), other, row.alarm,
            row.failed, verdict]


def _number(value: float) -> str:
    return '' if math.isnan(value) else f'{value:.1g}'
