# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The folder of a study: its rows as CSV, and as JSON what they were measured on and against."""

import csv
from dataclasses import astuple, fields
import json
import math
import os
from pathlib import Path
import platform
import subprocess
from typing import Any, TextIO

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.models.energy_error import EnergyError
import numpy as np
from studies.measuring import StudyRow
from studies.references import ModelDiscrepancy, Reference

COLUMNS = tuple(field.name for field in fields(StudyRow))
CSV, CARD = 'work_precision.csv', 'work_precision.json'
_DIGITS = {'method': str, 'status': str, 'step_size': repr, 'horizon': repr}


class Results:
    """
    The rows that are finished, kept one by one so that an interruption loses none.

    Its ``commits`` are those of the checkouts that measured them.

    Parameters
    ----------
    folder : Path
        Made if it is not there.
    identity : dict of str to str, optional
        What must be the same for rows to stand in one table: scene, version, machine, runs. That
        of the folder if it is not given.

    Raises
    ------
    ParameterError
        The folder cannot be written, or holds the results of something else.

    """

    def __init__(self, folder: Path, identity: dict[str, str] | None = None):
        self.folder, self.identity = folder, identity or {}
        self.commits: list[str] = []
        self._commit = commit()
        self.references: dict[float, Reference] = {}
        self.model_errors: dict[float, ModelDiscrepancy] = {}
        self._rows: dict[tuple, StudyRow] = {}
        try:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / CSV).touch()
            if (folder / CARD).is_file():
                self._load(check=identity is not None)
            else:
                self._start()
        except OSError as problem:
            raise ParameterError(f'--out {folder}: cannot be written ({problem.strerror}); '
                                 'give a folder that can be written') from problem

    @property
    def rows(self) -> list[StudyRow]:
        """Return what was measured, in the order of the first measurement."""
        return list(self._rows.values())

    def find(self, key: tuple) -> StudyRow | None:
        """Return the row of a key, None if there is none yet."""
        return self._rows.get(key)

    def add(self, row: StudyRow) -> None:
        """Keep a row, on disk as well; one of the same key is replaced."""
        if self._commit not in self.commits:
            self.commits.append(self._commit)
            self._write_card()
        self._rows[row.key] = row
        with (self.folder / CSV).open('a', newline='', encoding='utf-8') as file:
            _writer(file).writerow(row_texts(row))

    def keep_reference(self, horizon: float, reference: Reference, model: ModelDiscrepancy | None
                       ) -> None:
        """Keep what the rows of a horizon are measured against."""
        self.references[horizon] = reference
        if model is not None:
            self.model_errors[horizon] = model
        self._write_card()

    def tidy(self) -> None:
        """Write the CSV anew, without the rows that others have replaced."""
        temporary = self.folder / f'{CSV}.new'
        with temporary.open('w', newline='', encoding='utf-8') as file:
            _writer(file).writerows([COLUMNS, *map(row_texts, self._rows.values())])
        temporary.replace(self.folder / CSV)

    def _start(self) -> None:
        if (self.folder / CSV).stat().st_size > 0:
            raise ParameterError(f'{self.folder / CSV}: there is no {CARD} beside it to tell what '
                                 'it was measured on; remove it or give another --out')
        self.tidy()
        self._write_card()

    def _load(self, check: bool) -> None:
        path = self.folder / CARD
        try:
            card = json.loads(path.read_text(encoding='utf-8'))
            different = [key for key in {**card['identity'], **self.identity}
                         if card['identity'].get(key) != self.identity.get(key)]
            references, models, commits = (
                card[key] for key in ('references', 'model_errors', 'commits'))
        except (ValueError, KeyError, AttributeError) as problem:
            raise ParameterError(f'{path}: is damaged; remove the folder or give another --out'
                                 ) from problem
        if check and different:
            raise ParameterError(
                f'{self.folder}: holds results of another {" and ".join(sorted(different))}; '
                'give another --out, or remove the folder to measure anew')
        self.identity = card['identity']
        self.commits = commits
        for horizon, entry in references.items():
            path = np.array(entry['path'], dtype=np.float64)
            self.references[float(horizon)] = Reference(
                path, _number(entry['accuracy'], math.inf), entry['how'], path[:0])
        for horizon, entry in models.items():
            self.model_errors[float(horizon)] = ModelDiscrepancy(
                _number(entry['path'], math.nan), _number(entry['energy'], math.nan),
                EnergyError(**entry['box']) if entry.get('box') else None)
        self._rows = {row.key: row for row in read_rows(self.folder / CSV)}
        # A row that was cut off by a crash is measured again.
        self.tidy()

    def _write_card(self) -> None:
        card = {
            'identity': self.identity,
            'commits': self.commits,
            'references': {repr(horizon): {
                'how': reference.how, 'accuracy': _or_none(reference.accuracy),
                'path': reference.path.tolist()}
                for horizon, reference in self.references.items()},
            'model_errors': {repr(horizon): {
                'path': _or_none(model.path), 'energy': _or_none(model.energy),
                'box': model.box and model.box.model_dump()}
                for horizon, model in self.model_errors.items()},
        }
        temporary = self.folder / f'{CARD}.new'
        temporary.write_text(json.dumps(card, indent=1) + '\n', encoding='utf-8')
        temporary.replace(self.folder / CARD)


def read_rows(path: Path) -> list[StudyRow]:
    """
    Read a table of rows; lines that are not whole are left out.

    Raises
    ------
    ParameterError
        The file has other columns.

    """
    # What follows the last end of a line was cut off.
    text = path.read_text(encoding='utf-8').rpartition('\n')[0]
    lines = list(csv.reader(text.splitlines()))
    if not lines or tuple(lines[0]) != COLUMNS:
        raise ParameterError(f'{path}: its columns are not {", ".join(COLUMNS)}; remove it or '
                             'give another --out')
    rows = []
    for line in lines[1:]:
        if len(line) == len(COLUMNS):
            numbers = [float(text) if text else math.nan for text in line[1:-1]]
            rows.append(StudyRow(line[0], *numbers, line[-1]))
    return rows


def machine() -> str:
    """Return what this machine is called by those who compare its times."""
    information, processor = Path('/proc/cpuinfo'), platform.processor() or platform.machine()
    if information.is_file():
        for line in information.read_text(encoding='utf-8').splitlines():
            if line.startswith('model name'):
                processor = line.partition(':')[2].strip()
                break
    return f'{processor}, {os.cpu_count()} cores, {platform.system()}'


def commit() -> str:
    """Return the commit of this checkout, and whether files differ from it."""
    def git(*arguments: str) -> str:
        return subprocess.run(['git', *arguments], check=True, capture_output=True, text=True,
                              cwd=Path(__file__).parent).stdout.strip()
    try:
        changed = ' with uncommitted changes' if git(
            'status', '--porcelain', '--', ':/hnn_vi_ros', ':/resource', ':/config',
            ':/docs/studies') else ''
        return git('rev-parse', '--short', 'HEAD') + changed
    except (OSError, subprocess.CalledProcessError):
        return 'unknown: not a git checkout'


def _writer(file: TextIO) -> Any:
    return csv.writer(file, lineterminator='\n')


def row_texts(row: StudyRow) -> list[str]:
    """Return a row as the fields of a line of its table."""
    texts = []
    for name, value in zip(COLUMNS, astuple(row), strict=True):
        if isinstance(value, float) and math.isnan(value):
            texts.append('')
        else:
            texts.append(_DIGITS.get(name, '{:.6g}'.format)(value))
    return texts


def _or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _number(value: float | None, default: float) -> float:
    return default if value is None else float(value)
