# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Results of studies: rows as CSV, and machine, commits and references as JSON."""

from collections.abc import Iterable, Mapping
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
import numpy as np
from studies.measuring import StudyRow
from studies.references import Floor

COLUMNS = tuple(field.name for field in fields(StudyRow))
CSV, CARD = 'work_precision.csv', 'work_precision.json'
_DIGITS = {'method': str, 'status': str, 'step_size': repr, 'horizon': repr}


class Results:
    """
    Rows of a scene.

    Parameters
    ----------
    identity : mapping of str to str
        Must be equal for rows of one table: scene, version, machine, runs.
    commits : iterable of str
        Commits of the measurements.
    floors : mapping of float to Floor
        Reference of the rows of each horizon [s].
    rows : iterable of StudyRow
        In the order of the first measurement.

    """

    def __init__(self, identity: Mapping[str, str], commits: Iterable[str] = (),
                 floors: Mapping[float, Floor] | None = None, rows: Iterable[StudyRow] = ()):
        self.identity, self.commits = dict(identity), list(commits)
        self.floors = dict(floors or {})
        self._rows = {row.key: row for row in rows}

    @property
    def rows(self) -> list[StudyRow]:
        """Return the measured rows, in the order of the first measurement."""
        return list(self._rows.values())

    def find(self, key: tuple) -> StudyRow | None:
        """Return the row of a key, None if there is none yet."""
        return self._rows.get(key)

    @property
    def horizons(self) -> list[float]:
        """Return the horizons that there are rows of, the shortest first."""
        return sorted({row.horizon for row in self.rows})

    @property
    def shown(self) -> list[float]:
        """Return the horizons that at least half of our rows were run to: less shows nothing."""
        return [horizon for horizon in self.horizons if np.mean([
            row.was_run for row in self.of(horizon) if row.is_ours]) >= 0.5]

    def of(self, horizon: float) -> list[StudyRow]:
        """Return the rows of one horizon."""
        return [row for row in self.rows if row.horizon == horizon]

    @property
    def card(self) -> dict[str, Any]:
        """Return the card that ``read`` expects with the rows."""
        return {'identity': self.identity, 'commits': self.commits,
                'floors': {repr(horizon): floor.as_json()
                           for horizon, floor in self.floors.items()}}

    @classmethod
    def read(cls, card: Mapping[str, Any], rows: Iterable[StudyRow]) -> 'Results':
        """Return the results of a card and rows, or raise KeyError, TypeError or ValueError."""
        return Results(card['identity'], card['commits'], {
            float(horizon): Floor.of_json(entry) for horizon, entry in card['floors'].items()},
            rows)


class ResultsFolder(Results):
    """
    The rows that are finished, kept one by one so that an interruption loses none.

    Parameters
    ----------
    folder : Path
        Made if it is not there.
    identity : dict of str to str, optional
        See Results. That of the folder if it is not given.

    Raises
    ------
    ParameterError
        The folder cannot be written, or holds the results of something else.

    """

    def __init__(self, folder: Path, identity: dict[str, str] | None = None):
        super().__init__(identity or {})
        self.folder, self._commit = folder, commit()
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

    def add(self, row: StudyRow) -> None:
        """Keep a row, on disk as well; one of the same key is replaced."""
        if self._commit not in self.commits:
            self.commits.append(self._commit)
            self._write_card()
        self._rows[row.key] = row
        with (self.folder / CSV).open('a', newline='', encoding='utf-8') as file:
            _writer(file).writerow(row_texts(row))

    def keep_floor(self, horizon: float, floor: Floor) -> None:
        """Keep the reference of the rows of a horizon."""
        self.floors[horizon] = floor
        self._write_card()

    def tidy(self) -> None:
        """Rewrite the CSV without the rows that were replaced."""
        temporary = self.folder / f'{CSV}.new'
        write_rows(temporary, self.rows)
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
            found = Results.read(
                json.loads(path.read_text(encoding='utf-8')), read_rows(self.folder / CSV))
        except (ValueError, KeyError, TypeError, AttributeError) as problem:
            raise ParameterError(f'{path}: is damaged; remove the folder or give another --out'
                                 ) from problem
        different = [key for key in {**found.identity, **self.identity}
                     if found.identity.get(key) != self.identity.get(key)]
        if check and different:
            raise ParameterError(
                f'{self.folder}: holds results of another {" and ".join(sorted(different))}; '
                'give another --out, or remove the folder to measure anew')
        self.__dict__ |= vars(found)
        # A row that was cut off by a crash is measured again.
        self.tidy()

    def _write_card(self) -> None:
        temporary = self.folder / f'{CARD}.new'
        temporary.write_text(json.dumps(self.card, indent=1) + '\n', encoding='utf-8')
        temporary.replace(self.folder / CARD)


def read_rows(path: Path) -> list[StudyRow]:
    """
    Read a table of rows; lines that are not whole are left out.

    Raises
    ------
    ParameterError
        The file has other columns.

    """
    # An incomplete last line is dropped.
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


def write_rows(path: Path, rows: Iterable[StudyRow]) -> Path:
    """Write a table of rows; return the file."""
    with path.open('w', newline='', encoding='utf-8') as file:
        _writer(file).writerows([COLUMNS, *map(row_texts, rows)])
    return path


def machine() -> str:
    """Return a name of this machine for comparisons of times."""
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


def row_texts(row: StudyRow) -> list[str]:
    """Return a row as the fields of a line of its table."""
    texts = []
    for name, value in zip(COLUMNS, astuple(row), strict=True):
        if isinstance(value, float) and math.isnan(value):
            texts.append('')
        else:
            texts.append(_DIGITS.get(name, '{:.6g}'.format)(value))
    return texts


def _writer(file: TextIO) -> Any:
    return csv.writer(file, lineterminator='\n')
