# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Results of studies: rows as CSV, and machine, commits and references as JSON."""

from collections.abc import Mapping
import csv
from dataclasses import astuple, dataclass, fields
import json
import math
import os
from pathlib import Path
import platform
import subprocess
from typing import Any

from hnn_vi_ros.errors import ParameterError
import numpy as np
from studies.measuring import StudyRow
from studies.references import Floor

COLUMNS = tuple(field.name for field in fields(StudyRow))
FLOORS = 'floors.json'
_DIGITS = {'method': str, 'status': str, 'step_size': repr, 'horizon': repr}


@dataclass
class Results:
    """
    Rows of a scene.

    Parameters
    ----------
    identity : mapping of str to str
        Conditions that hold for all rows: machine, time or number of runs.
    commits : list of str
        Commits of the measurements.
    floors : mapping of float to Floor
        Reference of the rows of each horizon [s].
    rows : list of StudyRow
        In the order of the measurement.

    """

    identity: Mapping[str, str]
    commits: list[str]
    floors: Mapping[float, Floor]
    rows: list[StudyRow]

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
    def read(cls, card: Mapping[str, Any], rows: list[StudyRow]) -> 'Results':
        """Return the results of a card and rows, or raise KeyError, TypeError or ValueError."""
        return cls(card['identity'], card['commits'], {
            float(horizon): Floor.of_json(entry) for horizon, entry in card['floors'].items()},
            rows)


def read_results(folder: Path) -> dict[str, Results]:
    """
    Return the results of each scene, which ``keep_results`` wrote.

    Raises
    ------
    ParameterError
        A file is absent or damaged.

    """
    path = folder / FLOORS
    found = {}
    try:
        for scene, card in json.loads(path.read_text(encoding='utf-8')).items():
            path = folder / f'{scene}.csv'
            found[scene] = Results.read(card, read_rows(path))
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as problem:
        raise ParameterError(f'{path}: not there or damaged ({problem}); measure with: '
                             'make accuracy') from problem
    return found


def keep_results(folder: Path, results: Mapping[str, Results]) -> None:
    """
    Write the results of scenes; keep the results of other scenes.

    Raises
    ------
    ParameterError
        A file cannot be written, or is damaged.

    """
    path = folder / FLOORS
    before = read_results(folder) if path.is_file() else {}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for scene, entry in results.items():
            with (folder / f'{scene}.csv').open('w', newline='', encoding='utf-8') as file:
                csv.writer(file, lineterminator='\n').writerows(
                    [COLUMNS, *map(row_texts, entry.rows)])
        path.write_text(json.dumps({
            scene: entry.card for scene, entry in {**before, **results}.items()}, indent=1)
                        + '\n', encoding='utf-8')
    except OSError as problem:
        raise unwritable(folder, problem) from problem


def unwritable(folder: Path, problem: OSError) -> ParameterError:
    """Return the error about a folder that cannot be written."""
    return ParameterError(f'--docs: {folder} cannot be written ({problem.strerror}); '
                          'give a folder that can be written')


def read_rows(path: Path) -> list[StudyRow]:
    """Read a table of rows; raise ValueError if it has other columns."""
    with path.open(newline='', encoding='utf-8') as file:
        lines = list(csv.reader(file))
    if not lines or tuple(lines[0]) != COLUMNS:
        raise ValueError(f'its columns are not {", ".join(COLUMNS)}')
    return [StudyRow(line[0], *(float(text or 'nan') for text in line[1:-1]), line[-1])
            for line in lines[1:]]


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
