# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Data to learn from: states (q, p) with their rates of change (dq/dt, dp/dt)."""

from dataclasses import dataclass, replace
from inspect import signature
from typing import Annotated, Literal

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.hamiltonians.model_card import Box, Interval
from hnn_vi_ros.yaml_file import StrictModel
import numpy as np
from pydantic import ConfigDict, Field, model_validator

MIN_ROWS = 10
# Instants count as evenly spaced if they differ from even ones by less than this share of the
# interval: enough for clocks written with few digits, less than a dropped sample.
UNEVENNESS = 0.1
_MOST_DRAWS = 10_000

Names = list[Annotated[str, Field(min_length=1)]]


class ExactHamiltonian(StrictModel):
    """An analytic Hamiltonian by name; further keys are its parameters, as in a scene."""

    model_config = ConfigDict(extra='allow')
    __pydantic_extra__: dict[str, float]

    kind: Literal[tuple(HAMILTONIANS)]  # type: ignore[valid-type]

    @model_validator(mode='after')
    def _check(self) -> 'ExactHamiltonian':
        valid = list(signature(HAMILTONIANS[self.kind]).parameters)
        unknown = sorted(set(self.__pydantic_extra__) - set(valid))
        if unknown:
            raise ValueError(f'unknown key {unknown[0]}; valid keys: {", ".join(valid) or "none"}')
        self.create()
        return self

    def create(self) -> Hamiltonian:
        """Build the Hamiltonian."""
        return HAMILTONIANS[self.kind](**self.__pydantic_extra__)


class ExactData(StrictModel):
    """States drawn at random from a box, their rates computed from an exact Hamiltonian."""

    kind: Literal['exact']
    hamiltonian: ExactHamiltonian
    box: Box
    samples: int = Field(1000, ge=MIN_ROWS, le=1_000_000)
    edge_share: float = Field(0.0, ge=0.0, lt=1.0, description=(
        'chance of each value to lie on a bound: corners of many dimensions are else left empty'))
    radius: Interval | None = Field(None, description=(
        'bounds of the length of q: an annulus of the box, for an H that is singular at q = 0'))
    energy: Interval | None = Field(None, description=(
        'bounds of H: the part of the box that motions of these energies visit'))

    @model_validator(mode='after')
    def _check(self) -> 'ExactData':
        for name in ('radius', 'energy'):
            bounds = getattr(self, name)
            if bounds is not None and not bounds[0] < bounds[1]:
                raise ValueError(f'{name} = {bounds} must be [low, high] with low < high')
        return self


class SavitzkyGolay(StrictModel):
    """Derivatives of a polynomial fitted in a sliding window; needs even sampling."""

    kind: Literal['savitzky_golay'] = 'savitzky_golay'
    window: float = Field(gt=0.0, description='length of the window [s]')
    degree: int = Field(3, ge=1, le=9, description='of the polynomial')


class SmoothingSpline(StrictModel):
    """Derivatives of a smoothing cubic spline; takes uneven sampling."""

    kind: Literal['smoothing_spline']
    smoothing: float | None = Field(None, ge=0.0, description=(
        'weight of the squared second derivative; without it, generalised cross-validation'))


class MeasuredData(StrictModel):
    """A measured log: a text file with one row of numbers for each instant."""

    kind: Literal['measured']
    path: str = Field('', max_length=4096, description='the log; --data FILE overrides it')
    delimiter: Literal['whitespace', 'comma', 'semicolon', 'tab'] = 'whitespace'
    comment: str = Field('#', min_length=1, description='prefix of lines to skip')
    columns: Names = Field(min_length=3, description='names of all columns, in order')
    trial: str | None = Field(None, description='column that numbers separate recordings')
    time: str = Field(description='column of time [s]')
    q: Names = Field(min_length=1, description='columns of the coordinates')
    p: Names = Field(min_length=1, description='columns of the momenta, or of the velocities')
    mass: list[Annotated[float, Field(gt=0.0)]] | None = Field(
        None, description='p = mass * column, for each coordinate; default 1')
    dq_dt: Names | None = Field(None, description='columns of dq/dt, if the log has them')
    dp_dt: Names | None = Field(None, description='columns of dp/dt, if the log has them')
    derivatives: SavitzkyGolay | SmoothingSpline | None = Field(
        None, discriminator='kind', description='how missing derivatives are estimated')

    @model_validator(mode='after')
    def _check(self) -> 'MeasuredData':
        groups = {'q': self.q, 'p': self.p, 'dq_dt': self.dq_dt, 'dp_dt': self.dp_dt,
                  'mass': self.mass}
        for key, group in groups.items():
            if group is not None and len(group) != len(self.q):
                raise ValueError(f'{key} has {len(group)} entries, expected {len(self.q)}, '
                                 'one for each coordinate')
        used = [self.time, *self.q, *self.p, *(self.dq_dt or []), *(self.dp_dt or [])]
        used += [] if self.trial is None else [self.trial]
        for name in used:
            if self.columns.count(name) != 1 or used.count(name) != 1:
                raise ValueError(f'column {name} must stand once in columns and be used once')
        if self.derivatives is None and not (self.dq_dt and self.dp_dt):
            raise ValueError('derivatives is missing, since the log lacks dq_dt or dp_dt; '
                             'for example derivatives: {kind: savitzky_golay, window: 0.3}')
        return self


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
        When [s], for rows of a block that follow one another; a row of random states has none.
    accelerations : np.ndarray, shape (N, d), optional
        d2q/dt2 [1/s2], where known.
    commands : np.ndarray, shape (N, m), optional
        What was commanded.

    """

    q: np.ndarray
    p: np.ndarray
    dq_dt: np.ndarray
    dp_dt: np.ndarray
    block: np.ndarray
    description: str
    t: np.ndarray | None = None
    accelerations: np.ndarray | None = None
    commands: np.ndarray | None = None

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
    def box(self) -> Box:
        """Bounds of all states."""
        return Box(q=_bounds(self.q), p=_bounds(self.p))

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
            Every such sequence; all rows of one are in one block.

        Raises
        ------
        DataError
            There are none.

        """
        found = []
        if self.t is not None:
            for block in np.unique(self.block):
                rows = np.flatnonzero(self.block == block)
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


def sample_exact(data: ExactData, seed: int) -> Dataset:
    """
    Draw states from a box and compute their rates, dq/dt = H_p and dp/dt = -H_q.

    Parameters
    ----------
    data : ExactData
        The Hamiltonian, the box and the number of samples.
    seed : int
        Of the random numbers; the same seed gives the same data.

    Raises
    ------
    DataError
        The box has another number of coordinates than the Hamiltonian.

    """
    hamiltonian = data.hamiltonian.create()
    if len(data.box.q) != hamiltonian.dimension:
        raise DataError(f'data.box has {len(data.box.q)} coordinates, but {data.hamiltonian.kind} '
                        f'has {hamiltonian.dimension}; give one interval of q and of p for each')
    rng = np.random.default_rng(seed)
    q, p = _draw_states(data, hamiltonian, rng)
    dH_dq, dH_dp = hamiltonian.gradient(q, p)
    kind, parameters = data.hamiltonian.kind, data.hamiltonian.__pydantic_extra__
    described = ', '.join(f'{key}={value:g}' for key, value in parameters.items())
    return Dataset(q, p, dH_dp, -dH_dq, np.arange(data.samples),
                   f'{data.samples} exact samples of {kind}({described})').checked()


def _draw_states(data: ExactData, hamiltonian: Hamiltonian, rng: np.random.Generator
                 ) -> tuple[np.ndarray, np.ndarray]:
    """Return q and p of shape (samples, d), drawn anew until all are within the bounds."""
    q, p = _draw(data.box.q, data, rng), _draw(data.box.p, data, rng)
    bad = ~_is_within(data, hamiltonian, q, p)
    for _ in range(_MOST_DRAWS):
        if not bad.any():
            return q, p
        again = np.flatnonzero(bad)
        q[again] = _draw(data.box.q, data, rng)[again]
        p[again] = _draw(data.box.p, data, rng)[again]
        bad[again] = ~_is_within(data, hamiltonian, q[again], p[again])
    raise DataError(f'data.radius = {data.radius}, data.energy = {data.energy}: too little of '
                    'data.box is within these bounds; give wider ones or a smaller box')


def _is_within(data: ExactData, hamiltonian: Hamiltonian, q: np.ndarray, p: np.ndarray
               ) -> np.ndarray:
    """Tell which states are within the bounds of radius and energy."""
    within = np.ones(len(q), dtype=bool)
    if data.radius is not None:
        low, high = data.radius
        length = np.linalg.norm(q, axis=1)
        within &= (low <= length) & (length <= high)
    if data.energy is not None:
        low, high = data.energy
        energy = hamiltonian.energy(q, p)
        within &= (low <= energy) & (energy <= high)
    return within


def _draw(bounds: list[list[float]], data: ExactData, rng: np.random.Generator) -> np.ndarray:
    """Return values of shape (samples, d), uniform between the bounds or on one of them."""
    low, high = np.transpose(bounds)
    values = rng.uniform(low, high, size=(data.samples, len(bounds)))
    if data.edge_share > 0.0:
        edges = np.where(rng.random(values.shape) < 0.5, low, high)
        values = np.where(rng.random(values.shape) < data.edge_share, edges, values)
    return values


def _bounds(values: np.ndarray) -> list[list[float]]:
    return np.stack([values.min(axis=0), values.max(axis=0)], axis=-1).tolist()
