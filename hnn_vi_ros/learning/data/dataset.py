# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Data to learn from: states (q, p) with their rates of change, measured or estimated."""

from dataclasses import dataclass, replace
from typing import Annotated, Literal

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.files.yaml_file import StrictModel
from hnn_vi_ros.models.model_card import Box
import numpy as np
from pydantic import Field
from scipy.interpolate import make_smoothing_spline
from scipy.signal import savgol_filter

MIN_ROWS = 10
# Instants count as evenly spaced if they differ from even ones by less than this share of the
# interval: enough for clocks written with few digits, less than a dropped sample.
UNEVENNESS = 0.1

Names = list[Annotated[str, Field(min_length=1)]]
Mass = (Annotated[list[Annotated[float, Field(gt=0.0)]], Field(min_length=1)]
        | Annotated[list[list[float]], Field(min_length=1)])
Block = Annotated[float | None, Field(gt=0.0, description=(
    'length of the blocks of time that a split keeps together [s]'))]


@dataclass(frozen=True)
class Dataset:
    """
    States and their rates of change.

    Parameters
    ----------
    q, p : np.ndarray, shape (N, d)
        Coordinates and momenta.
    dq_dt, dp_dt : np.ndarray, shape (N, d)
        Their rates of change [1/s].
    block : np.ndarray of int, shape (N,)
        Rows that depend on one another share a block; a split keeps a block together.
    description : str
        Where the data comes from, for the model card.
    t : np.ndarray, shape (N,), optional
        When [s]; it increases within a trajectory. States drawn at random have none.
    trajectory : np.ndarray of int, shape (N,), optional
        Rows of one motion share a number; without it, each block is one motion.
    accelerations : np.ndarray, shape (N, d), optional
        d2q/dt2 [1/s2], where known.
    commands : np.ndarray, shape (N, m), optional
        The commands.
    energies : np.ndarray, shape (N,), optional
        The true H [J], where known.

    """

    q: np.ndarray
    p: np.ndarray
    dq_dt: np.ndarray
    dp_dt: np.ndarray
    block: np.ndarray
    description: str
    t: np.ndarray | None = None
    trajectory: np.ndarray | None = None
    accelerations: np.ndarray | None = None
    commands: np.ndarray | None = None
    energies: np.ndarray | None = None

    def checked(self) -> 'Dataset':
        """
        Return this data if something can be learned from it.

        Raises
        ------
        DataError
            Too few rows, or a coordinate, momentum or rate that never changes.

        """
        if len(self.q) < MIN_ROWS or len(np.unique(self.block)) < 2:
            raise DataError(f'{self.description}: {len(self.q)} usable rows are too few; '
                            'give a longer log or a shorter derivatives.window')
        for name in ('q', 'p', 'dq_dt', 'dp_dt'):
            values = getattr(self, name)
            if not (np.isfinite(values).all() and (np.ptp(values, axis=0) > 0.0).all()):
                raise DataError(f'{self.description}: {name} never changes or overflows; '
                                'learn from data in which every coordinate moves')
        return self

    @property
    def motion(self) -> np.ndarray:
        """Return the number of the motion that each row is of, shape (N,)."""
        return self.block if self.trajectory is None else self.trajectory

    @property
    def box(self) -> Box:
        """Bounds of all states."""
        return Box.of(self.q, self.p)

    def split(self, fraction: float, seed: int) -> tuple['Dataset', 'Dataset']:
        """Split off about this fraction of the blocks, at least one, at random by the seed."""
        blocks = np.random.default_rng(seed).permutation(np.unique(self.block))
        held_out = np.isin(self.block, blocks[:max(1, round(fraction * len(blocks)))])
        return self.rows(~held_out), self.rows(held_out)

    def rows(self, chosen: np.ndarray) -> 'Dataset':
        """Return the rows that a mask of shape (N,) chooses."""
        parts = {name: part[chosen] for name, part in vars(self).items()
                 if isinstance(part, np.ndarray)}
        return replace(self, **parts)

    def windows(self, step_size: float, count: int) -> np.ndarray:
        """
        Return which rows follow one another at even times.

        Parameters
        ----------
        step_size : float
            Time from one to the next [s].
        count : int
            How many each.

        Returns
        -------
        np.ndarray of int, shape (M, count)
            Every such sequence; all rows of one are of one trajectory.

        Raises
        ------
        DataError
            There are none.

        """
        found = []
        if self.t is not None:
            for number in np.unique(self.motion):
                rows = np.flatnonzero(self.motion == number)
                first = self.t[rows]
                near = UNEVENNESS * np.median(np.diff(first)) if len(rows) > 1 else 0.0
                times = first[:, None] + step_size * np.arange(count)
                at = np.searchsorted(first, times - near)
                inside = at[:, -1] < len(rows)
                at, times = at[inside], times[inside]
                found.append(rows[at[(np.abs(first[at] - times) <= near).all(axis=1)]])
        windows = np.concatenate(found) if found else np.empty((0, count), dtype=int)
        if not len(windows):
            raise DataError(f'{self.description}: no {count} rows follow one another every '
                            f'{step_size:g} s, as the loss needs; give data sampled at times of '
                            'which step_size is a multiple, such as exact data with a trajectory')
        return windows


def mass_matrix(mass: Mass | None, d: int) -> np.ndarray:
    """
    Return the matrix M of p = M dq/dt, shape (d, d).

    Parameters
    ----------
    mass : list of float, list of list of float, or None
        The masses, or the whole matrix by rows; None is 1 for each coordinate.
    d : int
        Number of coordinates.

    Raises
    ------
    ValueError
        It has another size, or is not symmetric and positive definite.

    """
    if mass is None:
        return np.eye(d)
    if len(mass) != d or any(isinstance(row, list) and len(row) != d for row in mass):
        raise ValueError(f'mass has {len(mass)} entries, expected {d}, one for each coordinate, '
                         f'or {d} rows of {d} numbers')
    matrix = np.array(mass) if isinstance(mass[0], list) else np.diag(mass)
    if not (np.array_equal(matrix, matrix.T) and np.linalg.eigvalsh(matrix)[0] > 0.0):
        raise ValueError('mass must be a symmetric matrix with positive eigenvalues')
    return matrix


def time_blocks(t: np.ndarray, length: float) -> np.ndarray:
    """Return the number, from 0 on, of the block of time that each row is in."""
    return np.floor((t - t[0]) / length).astype(int)


class SavitzkyGolay(StrictModel):
    """Derivatives of a polynomial fitted in a sliding window; needs even sampling."""

    kind: Literal['savitzky_golay'] = 'savitzky_golay'
    window: float = Field(gt=0.0, description='length of the window [s]')
    degree: int = Field(3, ge=1, le=9, description='of the polynomial')

    def rows(self, spacing: float) -> int:
        """Return the window in rows of this spacing [s], an odd number."""
        return 2 * round(0.5 * (min(self.window / spacing, 1e9) - 1.0)) + 1


class SmoothingSpline(StrictModel):
    """Derivatives of a smoothing cubic spline; takes uneven sampling."""

    kind: Literal['smoothing_spline']
    smoothing: float | None = Field(None, ge=0.0, description=(
        'weight of the squared second derivative; without it, generalised cross-validation'))


Derivatives = SavitzkyGolay | SmoothingSpline


def differentiate(t: np.ndarray, values: np.ndarray, method: Derivatives, window: int
                  ) -> tuple[np.ndarray, np.ndarray]:
    """
    Smooth measured values and estimate their derivative.

    Parameters
    ----------
    t : np.ndarray, shape (N,)
        Increasing instants [s]; evenly spaced for a SavitzkyGolay method.
    values : np.ndarray, shape (N, d)
        The measured values.
    method : SavitzkyGolay or SmoothingSpline
        How to smooth.
    window : int
        Rows in the window of a SavitzkyGolay method.

    Returns
    -------
    tuple of np.ndarray, shape (N, d)
        The smoothed values and their derivatives [1/s].

    References
    ----------
    A. Savitzky, M. Golay, Analytical Chemistry 36 (1964), doi:10.1021/ac60214a047.

    """
    if isinstance(method, SavitzkyGolay):
        spacing = (t[-1] - t[0]) / (len(t) - 1)
        smooth, rate = (savgol_filter(values, window, method.degree, deriv=order, delta=spacing,
                                      axis=0) for order in (0, 1))
        return smooth, rate
    splines = [make_smoothing_spline(t, column, lam=method.smoothing) for column in values.T]
    return (np.stack([spline(t) for spline in splines], axis=-1),
            np.stack([spline.derivative()(t) for spline in splines], axis=-1))
