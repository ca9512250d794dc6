# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Report on the hard cases: Markdown, CSV and pictures, and the pages of the docs."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
import math
from pathlib import Path
import shutil

from hnn_vi_ros.errors import ParameterError
from studies.hard_cases_figure import draw_case
from studies.hard_cases_plan import Case
from studies.hard_cases_results import (
    CaseRow, CSV, differences, Expectation, Folder, Key)

MARKDOWN = 'hard_cases.md'
PAGE, PICTURES = 'hard-cases.md', 'hard_cases'
_PAGE = """\
# Hard cases

Fourteen cases in which integrators are known to fail, with an exact H and with a trained network.
The page is for users who want to know the limits of each method, and whether a failure raises an
alarm.

**Main result.** Only methods that are neither symplectic nor energy-conserving fail without an
alarm.

Each row must have the verdict that is committed in
[hard_cases_expected.csv](studies/hard_cases_expected.csv): *stable*, every gate holds
and no measured value exceeds its limit; *alarm*, a guard reported that the run is not reliable;
*stopped*, a step failed with a typed error and the last good state was kept; or *unstable*, a
gate fails without an alarm, which is accepted only for methods that are neither symplectic nor
energy-conserving.

| gate | holds if |
|---|---|
| G1 | all states are finite and below 1e10 |
| G2 | every implicit step is solved to max(8, n) eps of its scale |
| G3 | over 100 blocks the energy drift is at most 10 % of its band, and its range in the last \
tenth at most 1.5 times that in the first; or the band is at rounding level |
| G4 | a step forward and one back end within 2e-8 of their start, for symmetric methods |
| G5 | the symplectic defect of a step is at most 1e-9 in the method's own 2-form |

A limit is the smallest of {{1, 2, 4, 5, 8}} x 10^k that is at least twice the measured value at
the time of its commit; the table shows both. `make hard-cases` repeats all runs and fails if a
verdict differs. The page is written by `ros2 run hnn_vi_ros hard_cases --docs docs`, from a full
run on {machine}. All rows: [hard_cases.csv](hard_cases/hard_cases.csv).

"""


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
        pictures = [draw_case(folder.path / picture_name(case), case, _of(case, rows))
                    for case in cases]
        page = folder.path / MARKDOWN
        page.write_text('# Hard cases\n\n' + as_markdown(cases, rows, expected),
                        encoding='utf-8')
        return [page, folder.write_csv(rows), *pictures]
    except OSError as problem:
        raise ParameterError(f'--out {folder.path}: cannot be written ({problem.strerror}); '
                             'give a folder that can be written') from problem


def write_page(docs: Path, source: Path, cases: Sequence[Case], rows: Sequence[CaseRow],
               expected: Mapping[Key, Expectation], machine: str) -> list[Path]:
    """
    Write the page of the docs, and beside it a page and a picture of each case, and the table.

    Parameters
    ----------
    docs, source : Path
        Folder of the page, and the one that ``write_report`` wrote to.
    cases, rows, expected
        See write_report.
    machine : str
        On which they were run.

    Raises
    ------
    ParameterError
        A file cannot be written.

    """
    try:
        (docs / PICTURES).mkdir(parents=True, exist_ok=True)
        names = [CSV, *(picture_name(case) for case in cases)]
        copies = [Path(shutil.copyfile(source / name, docs / PICTURES / name)) for name in names]
        pages = {docs / PAGE: main_page(cases, rows, expected, machine)} | {
            docs / f'{page_name(case)}.md': case_page(case, _of(case, rows), expected)
            for case in cases}
        for path, text in pages.items():
            path.write_text(text, encoding='utf-8')
    except OSError as problem:
        raise ParameterError(f'--docs {docs}: cannot be written ({problem.strerror}); give a '
                             'folder that can be written') from problem
    return [*pages, *copies]


def picture_name(case: Case) -> str:
    """Return the file name of a case's picture."""
    return f'case_{case.number:02d}.png'


def page_name(case: Case) -> str:
    """Return the name of a case's page, from that of the docs, without its suffix."""
    return f'{PICTURES}/case_{case.number:02d}'


def main_page(cases: Sequence[Case], rows: Sequence[CaseRow],
              expected: Mapping[Key, Expectation], machine: str) -> str:
    """Return the page that sums up all cases and leads to the page of each."""
    toctree = ['```{toctree}', ':hidden:', '', *(page_name(case) for case in cases), '```', '']
    return _PAGE.format(machine=machine) + '\n'.join([
        *_summary(cases, rows, expected, linked=True), '', *toctree])


def case_page(case: Case, rows: Sequence[CaseRow], expected: Mapping[Key, Expectation]) -> str:
    """Return the page of one case."""
    text = '\n'.join([f'# Case {case.number}: {case.title}\n',
                      'One of the [hard cases](../hard-cases.md), where gates and verdicts are '
                      'defined.\n', *_section(case, rows, expected)])
    return text.rstrip('\n') + '\n'


def as_markdown(cases: Sequence[Case], rows: Sequence[CaseRow],
                expected: Mapping[Key, Expectation]) -> str:
    """Return summary and tables, for the folder where the pictures lie."""
    parts = [*_summary(cases, rows, expected), '']
    for case in cases:
        parts += [f'## Case {case.number}: {case.title}\n',
                  *_section(case, _of(case, rows), expected)]
    return '\n'.join(parts)


def _of(case: Case, rows: Sequence[CaseRow]) -> list[CaseRow]:
    return [row for row in rows if row.case == case.number]


def _summary(cases: Sequence[Case], rows: Sequence[CaseRow],
             expected: Mapping[Key, Expectation], linked: bool = False) -> Iterator[str]:
    yield '| case | | rows | stable | alarm | stopped | unstable | as expected |'
    yield '|---' * 8 + '|'
    for case in cases:
        own = _of(case, rows)
        counts = Counter(row.verdict for row in own)
        wrong = len(differences(own, dict(expected)))
        numbers = ' | '.join(str(counts[word]) for word in (
            'stable', 'alarm', 'stopped', 'unstable'))
        name = f'[{case.title}]({page_name(case)}.md)' if linked else case.title
        yield (f'| {case.number} | {name} | {len(own)} | {numbers} | '
               f'{"yes" if wrong == 0 else f"{wrong} are not"} |')


def _section(case: Case, rows: Sequence[CaseRow], expected: Mapping[Key, Expectation]
             ) -> Iterator[str]:
    yield f'Claim: {case.claim}. {case.without}'.rstrip() + '\n'
    yield f'![case {case.number}]({picture_name(case)})\n'
    yield ('| set-up | H | method | steps | band [J] (limit) | slope / band | H~ band [J] (limit) '
           '| residual | other (limit) | alarm | fails | verdict |')
    yield '|---' * 12 + '|'
    for row in rows:
        yield f'| {" | ".join(_cells(row, expected.get(row.key)))} |'
    yield ''


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
