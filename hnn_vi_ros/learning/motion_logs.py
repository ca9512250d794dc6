# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Measured motions from logs: text files with a row of numbers for each instant."""

from pathlib import Path
from typing import Literal

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.dataset import Names
from hnn_vi_ros.learning.measured_log import read_log
from hnn_vi_ros.learning.motions import as_motions, MeasuredRun, Motion, MotionData
import numpy as np
from pydantic import Field, model_validator


class LogMotions(MotionData):
    """Columns of a text file, of one run or of several that a column numbers."""

    path: str = Field('', description='the log; or given by --data')
    delimiter: Literal['whitespace', 'comma', 'semicolon', 'tab'] = 'whitespace'
    comment: str = Field('#', min_length=1, description='prefix of lines to skip')
    columns: Names = Field(min_length=2, description='names of all columns, in order')
    trial: str | None = Field(None, description='column that numbers separate runs')
    time: str = Field(description='column of time [s]')
    q: Names = Field(min_length=1, description='columns of the coordinates')
    v: Names | None = Field(None, description=(
        'columns of dq/dt; none: they are estimated from q'))
    a: Names | None = Field(None, description=(
        'columns of the accelerations; none: they are estimated'))
    tau: Names | None = Field(None, description='columns of the forces of the motors; none: none')

    @model_validator(mode='after')
    def _check(self) -> 'LogMotions':
        for key in ('v', 'a', 'tau'):
            group = getattr(self, key)
            # There may be fewer motors than joints.
            if group is not None and (len(group) > len(self.q) or (
                    key != 'tau' and len(group) < len(self.q))):
                raise ValueError(f'{key} has {len(group)} columns, q has {len(self.q)}')
        used = [self.time, *self.q, *(self.v or []), *(self.a or []), *(self.tau or [])]
        used += [] if self.trial is None else [self.trial]
        for name in used:
            if self.columns.count(name) != 1 or used.count(name) != 1:
                raise ValueError(f'column {name} must stand once in columns and be used once')
        return self


def read_log_motions(path: Path, data: LogMotions) -> tuple[list[Motion], str]:
    """
    Read runs from a log, and put each on even times.

    Parameters
    ----------
    path : Path
        A text file of at most 256 MiB; a field that is empty or ``nan`` is a number that lacks.
    data : LogMotions
        Its columns.

    Returns
    -------
    list of Motion and str
        The runs, and what they are and lack, for the model card.

    Raises
    ------
    DataError
        The file cannot be read, or a row cannot; names file and line.

    """
    table, lines, digest = read_log(path, data, lacking=True)
    column = dict(zip(data.columns, table.T, strict=True))

    def stacked(names: Names | None, rows: np.ndarray) -> np.ndarray | None:
        return None if names is None else np.stack([column[name][rows] for name in names], -1)

    trials = column[data.trial] if data.trial else np.zeros(len(table))
    unnumbered = np.flatnonzero(~np.isfinite(trials))
    if unnumbered.size:
        raise DataError(f'{path}:{lines[unnumbered[0]]}: column {data.trial}: no number, which '
                        'tells the run; give one, or leave the row out')
    runs = []
    for trial in dict.fromkeys(trials.tolist()):
        rows = np.flatnonzero(trials == trial)
        name = f'{trial:.15g}' if data.trial else path.stem
        runs.append(MeasuredRun(name, f'{path}: {name}', column[data.time][rows],
                                stacked(data.q, rows), stacked(data.v, rows),
                                stacked(data.tau, rows), a=stacked(data.a, rows)))
    return as_motions(runs, data, path.name, digest[:16])
