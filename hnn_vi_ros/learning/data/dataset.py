# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""States (q, p) with their rates of change, from measured motions or an exact Hamiltonian."""

from abc import abstractmethod
from dataclasses import dataclass, replace
from inspect import signature
from typing import Annotated, ClassVar, Literal

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.files import StrictModel
from hnn_vi_ros.hamiltonians import Hamiltonian, HAMILTONIANS
from hnn_vi_ros.learning.data.motions import (
    check_rates, Motion, OnBad, part_of, pieces_of, ReadingReport, Recording, resampled,
    unwrapped_piece)
from hnn_vi_ros.learning.data.sampling import cubic
from hnn_vi_ros.models import Box, Interval
import numpy as np
from pydantic import ConfigDict, Field
from scipy.integrate import solve_ivp
from scipy.interpolate import make_smoothing_spline
from scipy.signal import savgol_filter

MIN_ROWS = 10
# Number of blocks of a motion unless data.block gives their length, or the filter has a window.
BLOCKS = 20
# Largest deviation of evenly spaced times, as a share of the interval: more than the error of
# clocks written with few digits, less than a dropped sample.
UNEVENNESS = 0.1

Names = list[Annotated[str, Field(min_length=1)]]
Mass = (Annotated[list[Annotated[float, Field(gt=0.0)]], Field(min_length=1)]
        | Annotated[list[list[float]], Field(min_length=1)])
Block = Annotated[float | None, Field(gt=0.0, description=(
    'length of the time blocks that a split does not divide [s]'))]


@dataclass(frozen=True)
class Dataset:
    """
    A set of states and their rates of change.

    Parameters
    ----------
    q, p : np.ndarray, shape (N, d)
        Coordinates and momenta.
    dq_dt, dp_dt : np.ndarray, shape (N, d)
        Their rates of change [1/s].
    block : np.ndarray of int, shape (N,)
        Block number of each row. Dependent rows share a block; a split keeps blocks whole.
    description : str
        Source of the data, for the model card.
    t : np.ndarray, shape (N,), optional
        Times [s], increasing within a trajectory; None for states drawn at random.
    trajectory : np.ndarray of int, shape (N,), optional
        Motion number of each row; default: each block is one motion.
    accelerations : np.ndarray, shape (N, d), optional
        Accelerations d2q/dt2 [1/s2], if known.
    commands : np.ndarray, shape (N, m), optional
        Commands u.
    energies : np.ndarray, shape (N,), optional
        True values of H [J], if known.

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
        Return this dataset after checking that a model can be trained on it.

        Raises
        ------
        DataError
            There are too few rows, or a coordinate, momentum or rate is constant.

        """
        if len(self.q) < MIN_ROWS or len(np.unique(self.block)) < 2:
            raise DataError(f'{self.description}: {len(self.q)} usable rows are too few; use a '
                            'longer log or a shorter derivatives.window')
        for name in ('q', 'p', 'dq_dt', 'dp_dt'):
            values = getattr(self, name)
            if not (np.isfinite(values).all() and (np.ptp(values, axis=0) > 0.0).all()):
                raise DataError(f'{self.description}: {name} never changes or overflows; use data '
                                'in which every coordinate moves')
        return self

    @property
    def motion(self) -> np.ndarray:
        """Return the motion number of each row, shape (N,)."""
        return self.block if self.trajectory is None else self.trajectory

    @property
    def box(self) -> Box:
        """Return the bounds of all states."""
        return Box.of(self.q, self.p)

    def split(self, fraction: float, seed: int) -> tuple['Dataset', 'Dataset']:
        """Split off about this fraction of the blocks at random by seed, at least one block."""
        blocks = np.random.default_rng(seed).permutation(np.unique(self.block))
        held_out = np.isin(self.block, blocks[:max(1, round(fraction * len(blocks)))])
        return self.rows(~held_out), self.rows(held_out)

    def rows(self, chosen: np.ndarray) -> 'Dataset':
        """Return the rows selected by a mask of shape (N,)."""
        return part_of(self, chosen)

    def windows(self, step_size: float, count: int) -> np.ndarray:
        """
        Return the indices of consecutive rows at even times.

        Parameters
        ----------
        step_size : float
            Time between consecutive rows [s].
        count : int
            Number of rows in a window.

        Returns
        -------
        np.ndarray of int, shape (M, count)
            All such windows; the rows of one window belong to one trajectory.

        Raises
        ------
        DataError
            There are no windows.

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
            raise DataError(f'{self.description}: no {count} successive rows have the interval '
                            f'{step_size:g} s, as the loss requires; use data whose sampling '
                            'interval divides step_size, such as exact data with a trajectory')
        return windows


def mass_matrix(mass: Mass | None, d: int) -> np.ndarray:
    """
    Return the mass matrix M in p = M dq/dt, shape (d, d).

    Parameters
    ----------
    mass : list of float, list of list of float, or None
        Masses, or the whole matrix by rows; None is the identity.
    d : int
        Number of coordinates.

    Raises
    ------
    ValueError
        The matrix has the wrong size, or is not symmetric positive definite.

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
    """Return the block number of each row, from 0; blocks have equal length in time."""
    return np.floor((t - t[0]) / length).astype(int)


class SavitzkyGolay(StrictModel):
    """Derivatives of a polynomial fitted in a sliding window; requires even sampling."""

    kind: Literal['savitzky_golay'] = 'savitzky_golay'
    window: float = Field(gt=0.0, description='length of the window [s]')
    degree: int = Field(3, ge=1, le=9, description='degree of the polynomial')

    def rows(self, spacing: float, most: int, where: str, of: str) -> int:
        """Return the odd number of rows of the window at `spacing` [s]; DataError if unfit."""
        rows = 2 * round(0.5 * (min(self.window / spacing, 1e9) - 1.0)) + 1
        least = self.degree + 2
        if most < least:
            raise DataError(f'{where}: {of} allow a window of at most {most} rows, but '
                            f'derivatives.degree = {self.degree} requires {least}; record for '
                            'longer')
        if not least <= rows <= most:
            raise DataError(f'{where}: derivatives.window = {self.window:g} s spans {rows} rows; '
                            f'set {least * spacing:.3g} to {most * spacing:.3g} s, for which '
                            f'{of} allow {least} to {most}')
        return rows


class SmoothingSpline(StrictModel):
    """Derivatives of a smoothing cubic spline, for uneven sampling."""

    kind: Literal['smoothing_spline']
    smoothing: float | None = Field(None, ge=0.0, description=(
        'weight of the squared second derivative; default: chosen by generalised '
        'cross-validation'))


Derivatives = SavitzkyGolay | SmoothingSpline


def differentiate(t: np.ndarray, values: np.ndarray, method: Derivatives, window: int,
                  where: str = '') -> tuple[np.ndarray, np.ndarray]:
    """
    Smooth measured values and estimate their derivative.

    Parameters
    ----------
    t : np.ndarray, shape (N,)
        Increasing times [s]; evenly spaced for SavitzkyGolay.
    values : np.ndarray, shape (N, d)
        Measured values.
    method : SavitzkyGolay or SmoothingSpline
        Smoothing method.
    window : int
        Number of rows in the window of SavitzkyGolay.
    where : str, optional
        Source of the values, for error messages.

    Returns
    -------
    tuple of np.ndarray, shape (N, d)
        The smoothed values and their derivatives [1/s].

    Raises
    ------
    DataError
        The derivatives cannot be estimated.

    References
    ----------
    A. Savitzky, M. Golay, Analytical Chemistry 36 (1964), doi:10.1021/ac60214a047.

    """
    try:
        if isinstance(method, SavitzkyGolay):
            spacing = (t[-1] - t[0]) / (len(t) - 1)
            smooth, rate = (savgol_filter(values, window, method.degree, deriv=order,
                                          delta=spacing, axis=0) for order in (0, 1))
            return smooth, rate
        splines = [make_smoothing_spline(t, column, lam=method.smoothing) for column in values.T]
    except (ValueError, np.linalg.LinAlgError) as problem:
        raise DataError(f'{where}: the derivatives cannot be estimated ({problem}); check its '
                        'times and data.derivatives') from problem
    return (np.stack([spline(t) for spline in splines], axis=-1),
            np.stack([spline.derivative()(t) for spline in splines], axis=-1))


class StateOptions(StrictModel):
    """Options of measured states in every format."""

    # Minimum number of rows that are dropped at each end of a motion.
    margin: ClassVar[int] = 0

    mass: Mass | None = Field(None, description=(
        'p = mass * velocities: one mass per coordinate, or the rows of a matrix; default: 1'))
    derivatives: Derivatives | None = Field(
        None, discriminator='kind', description='method that estimates unmeasured derivatives')
    spacing: float | None = Field(None, gt=0.0, description=(
        'resampling interval [s]; default: no resampling if the samples are even or derivatives '
        'accepts uneven ones, else their mean interval'))
    block: Block = None
    on_bad: OnBad = 'drop'

    @property
    @abstractmethod
    def least(self) -> int:
        """Return the minimum number of rows of a motion."""

    @abstractmethod
    def method(self, spacing: float) -> Derivatives | None:
        """Return the differentiation method for this interval [s]; None if rates are measured."""

    @abstractmethod
    def blocks(self, t: np.ndarray, window: int) -> np.ndarray:
        """Return the block of each row, shape (N,); `window` is the filter's in rows, or 0."""


def dataset_of(recording: Recording, data: StateOptions) -> Dataset:
    """
    Concatenate the states and rates of measured motions.

    If a rate is estimated, the values it is estimated from are smoothed too. Rows without a whole
    window, near the ends of their motion, are dropped.

    Raises
    ------
    DataError
        The motions are too short, most samples are bad, or a rate cannot be estimated.

    """
    report, count = ReadingReport(data.least), 0
    parts, blocks = list[Motion](), list[np.ndarray]()
    for motion in recording.motions:
        pieces = pieces_of(motion, data.on_bad, report)
        for rows in pieces.rows:
            piece, window = _differentiated(pieces.motion, rows, data, report)
            inside = slice(margin := max(window // 2, data.margin), len(piece.t) - margin)
            parts.append(part_of(piece, inside))
            blocks.append(count + data.blocks(piece.t, window)[inside])
            count = blocks[-1].max(initial=count - 1) + 1
    column = {channel: np.concatenate([part.channels[channel] for part in parts])
              for channel in parts[0].channels}
    return Dataset(
        column['q'], column['p'], column['v'], column['dp_dt'], np.concatenate(blocks),
        report.described(recording, len(column['t'])), column['t'],
        np.repeat(np.arange(len(parts)), [len(part.t) for part in parts]), column.get('a'),
        column.get('tau')).checked()


def _differentiated(motion: Motion, rows: np.ndarray, data: StateOptions, report: ReadingReport
                    ) -> tuple[Motion, int]:
    """Return a piece of a motion with p and all rates, and the filter window in rows, or 0."""
    t = motion.t[rows]
    mean = (t[-1] - t[0]) / max(len(t) - 1, 1)
    method = data.method(data.spacing or mean)
    if method is None:
        return part_of(motion, rows), 0
    piece, window = unwrapped_piece(motion, rows, report), 0
    check_rates(piece)
    uneven = np.abs(np.diff(t) - mean).max() > UNEVENNESS * mean
    if data.spacing or (uneven and isinstance(method, SavitzkyGolay)):
        report.note(f'resampled every {data.spacing or mean:.4g} s')
        piece = resampled(piece, data.spacing or mean, cubic)
    if isinstance(method, SavitzkyGolay):
        window = method.rows(data.spacing or mean, len(piece.t) - 1, motion.where,
                             f'its {len(piece.t)} rows')
    return differentiated(piece, method, window, data.mass), window


def differentiated(motion: Motion, method: Derivatives, window: int, mass: Mass | None = None
                   ) -> Motion:
    """Return a motion with momenta and all rates; differentiated values are smoothed."""
    q, v, p, dp_dt = motion.q, motion.v, motion.p, motion.dp_dt

    def rate(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return differentiate(motion.t - motion.t[0], values, method, window, motion.where)

    if v is None:
        q, v = rate(q)
    if p is None:
        p = v @ mass_matrix(mass, q.shape[1])
    if dp_dt is None:
        p, dp_dt = rate(p)
    return replace(motion, q=q, v=v, p=p, dp_dt=dp_dt, a=rate(v)[1])


_MOST_DRAWS = 10_000
MAX_STATES = 1_000_000
# Relative and absolute tolerance of the integrated motions.
_TOLERANCES = 1e-10, 1e-12


class ExactHamiltonian(StrictModel):
    """An analytic Hamiltonian by name; further keys are its parameters, as in a scene."""

    model_config = ConfigDict(extra='allow')
    __pydantic_extra__: dict[str, float]

    kind: Literal[tuple(HAMILTONIANS)]  # type: ignore[valid-type]

    def _check(self) -> None:
        valid = list(signature(HAMILTONIANS[self.kind]).parameters)
        unknown = sorted(set(self.__pydantic_extra__) - set(valid))
        if unknown:
            raise ValueError(f'unknown key {unknown[0]}; valid keys: {", ".join(valid) or "none"}')
        if self.create().rotations:
            raise ValueError(f'{self.kind} has rotations, which exact data do not support; use '
                             'another system')

    def create(self) -> Hamiltonian:
        """Return the Hamiltonian."""
        return HAMILTONIANS[self.kind](**self.__pydantic_extra__)


class EvenTimes(StrictModel):
    """Sampling of a motion at even times from 0 to the duration."""

    duration: float = Field(gt=0.0, description='duration of each motion [s]')
    spacing: float = Field(gt=0.0, description='interval between states [s]')

    def _check(self) -> None:
        if not 1.0 <= self.duration / self.spacing < MAX_STATES:
            raise ValueError(f'spacing = {self.spacing:g} must be between duration / {MAX_STATES} '
                             f'and the duration, {self.duration:g}')

    @property
    def times(self) -> np.ndarray:
        """Return the times [s]."""
        return self.spacing * np.arange(int(self.duration / self.spacing * (1.0 + 1e-12)) + 1)


class Commands(StrictModel):
    """Commands u, uniform in [-largest, largest], which add B u to dp/dt."""

    input_map: list[Annotated[list[float], Field(min_length=1)]] = Field(
        min_length=1, description='matrix B with one row per coordinate and one column per '
                                  'command')
    largest: float = Field(gt=0.0, description='bound on the magnitude of every command')

    def _check(self) -> None:
        if len({len(row) for row in self.input_map}) > 1:
            raise ValueError('input_map has rows of different lengths')


class ExactData(StrictModel):
    """States drawn at random from a box, with rates computed from an exact Hamiltonian."""

    kind: Literal['exact']
    hamiltonian: ExactHamiltonian
    box: Box
    samples: int = Field(1000, ge=MIN_ROWS, le=1_000_000)
    edge_share: float = Field(0.0, ge=0.0, lt=1.0, description=(
        'probability that a value lies on a bound; otherwise the corners of many dimensions stay '
        'empty'))
    radius: Interval | None = Field(None, description=(
        'bounds of the norm of q, an annulus in the box, for an H that is singular at q = 0'))
    energy: Interval | None = Field(None, description=(
        'bounds of H, the part of the box with these energies'))
    velocities: bool = Field(False, description=(
        'use dq/dt in place of p, also in the box, as if masses were unknown'))
    trajectory: EvenTimes | None = Field(None, description=(
        'follow the motion from each sample, and learn from all of its states'))
    damping: float = Field(0.0, ge=0.0, description=(
        'damping rate gamma [1/s] in dp/dt = -H_q - gamma p'))
    commands: Commands | None = Field(None, description=(
        'random commands that drive the system, different for each sample'))
    noise: float = Field(0.0, ge=0.0, description=(
        'standard deviation of the noise of each coordinate and momentum; rates are exact'))

    def _check(self) -> None:
        for name in ('radius', 'energy'):
            bounds = getattr(self, name)
            if bounds is not None and not bounds[0] < bounds[1]:
                raise ValueError(f'{name} = {bounds} must be [low, high] with low < high')
        if self.commands is not None and len(self.commands.input_map) != len(self.box.q):
            raise ValueError(f'commands.input_map has {len(self.commands.input_map)} rows, '
                             f'expected {len(self.box.q)}, one for each coordinate')
        if self.trajectory is not None:
            states = self.samples * len(self.trajectory.times)
            if states > MAX_STATES:
                raise ValueError(f'{states} states exceed the limit of {MAX_STATES}; reduce '
                                 'samples or increase trajectory.spacing')


def sample_exact(data: ExactData, seed: int) -> Dataset:
    """
    Draw states from a box and compute their rates, dq/dt = H_p and dp/dt = -H_q.

    With ``trajectory``, each state starts a motion. With ``noise``, the rates belong to the
    noise-free states, as in the data of Greydanus, Dzamba and Yosinski (NeurIPS 2019).

    Parameters
    ----------
    data : ExactData
        Hamiltonian, box and number of samples.
    seed : int
        Seed of the random numbers.

    Raises
    ------
    DataError
        The box and the Hamiltonian differ in dimension, or a motion cannot be
        integrated.

    """
    hamiltonian = data.hamiltonian.create()
    if len(data.box.q) != hamiltonian.dimension:
        raise DataError(f'data.box has {len(data.box.q)} coordinates, but {data.hamiltonian.kind} '
                        f'has {hamiltonian.dimension}; give one interval of q and of p for each')
    rng = np.random.default_rng(seed)
    q, p = _draw_states(data, hamiltonian, rng)
    trajectory, t, commands = np.arange(data.samples), None, None
    if data.commands is not None:
        m = len(data.commands.input_map[0])
        commands = data.commands.largest * rng.uniform(-1.0, 1.0, (data.samples, m))
    if data.trajectory is not None:
        times = data.trajectory.times
        q, p = _follow(data, hamiltonian, q, p, times, commands)
        t, trajectory = np.tile(times, data.samples), np.repeat(trajectory, len(times))
        commands = None if commands is None else commands[trajectory]
    dq_dt, dp_dt = _rates(data, hamiltonian, q, p, commands)
    _, accelerations = hamiltonian.hessian_vector(q, p, dq_dt, dp_dt)
    energies = hamiltonian.energy(q, p)
    if data.velocities:
        p, dq_dt, dp_dt = dq_dt, dq_dt, accelerations
    if data.noise > 0.0:
        q, p = (part + data.noise * rng.normal(size=part.shape) for part in (q, p))
    return Dataset(q, p, dq_dt, dp_dt, trajectory, _describe(data), t, trajectory,
                   accelerations, commands, energies).checked()


def _rates(data: ExactData, hamiltonian: Hamiltonian, q: np.ndarray, p: np.ndarray,
           commands: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Return dq/dt and dp/dt, shaped like q, including damping and commands."""
    dH_dq, dH_dp = hamiltonian.gradient(q, p)
    dp_dt = -dH_dq
    if data.damping:
        dp_dt -= data.damping * p
    if commands is not None and data.commands is not None:
        dp_dt += commands @ np.transpose(data.commands.input_map)
    return dH_dp, dp_dt


def _describe(data: ExactData) -> str:
    parameters = ', '.join(
        f'{key}={value:g}' for key, value in data.hamiltonian.__pydantic_extra__.items())
    system = f'{data.hamiltonian.kind}({parameters})'
    text = f'{data.samples} exact samples of {system}'
    if data.trajectory is not None:
        text = (f'{data.samples} exact motions of {system}, of {data.trajectory.duration:g} s in '
                f'steps of {data.trajectory.spacing:g} s')
    text += f', damped at {data.damping:g} /s' if data.damping else ''
    text += f', with commands up to {data.commands.largest:g}' if data.commands else ''
    text += ', with dq/dt in place of p' if data.velocities else ''
    return text + (f', noise {data.noise:g}' if data.noise > 0.0 else '')


def _follow(data: ExactData, hamiltonian: Hamiltonian, q: np.ndarray, p: np.ndarray,
            times: np.ndarray, commands: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Integrate the motions from states (q, p); return the states, one motion after another."""
    d, motions = hamiltonian.dimension, []
    for i, z in enumerate(np.hstack([q, p])):
        command = None if commands is None else commands[i]

        def rates(_: float, z: np.ndarray) -> np.ndarray:
            return np.concatenate(_rates(data, hamiltonian, z[:d], z[d:], command))  # noqa: B023

        motion = solve_ivp(rates, (0.0, times[-1]), z, 'DOP853', times, rtol=_TOLERANCES[0],
                           atol=_TOLERANCES[1])
        if not motion.success:
            raise DataError(f'data.trajectory: the motion from {z.tolist()} cannot be integrated '
                            f'({motion.message}); use a smaller box or a shorter duration')
        motions.append(motion.y.T)
    z = np.concatenate(motions)
    return z[:, :d], z[:, d:]


def _draw_states(data: ExactData, hamiltonian: Hamiltonian, rng: np.random.Generator
                 ) -> tuple[np.ndarray, np.ndarray]:
    """Draw q and p, shape (samples, d); redraw those out of bounds."""
    q, p = np.empty((2, data.samples, len(data.box.q)))
    again = np.arange(data.samples)
    for _ in range(_MOST_DRAWS):
        q[again] = _draw(data.box.q, data, rng)[again]
        p[again] = _momenta(data, hamiltonian, q[again], _draw(data.box.p, data, rng)[again])
        again = again[~_is_within(data, hamiltonian, q[again], p[again])]
        if not len(again):
            return q, p
    raise DataError(f'data.radius = {data.radius}, data.energy = {data.energy}: too small a part '
                    'of data.box is within these bounds; widen them or use a smaller box')


def _momenta(data: ExactData, hamiltonian: Hamiltonian, q: np.ndarray, drawn: np.ndarray
             ) -> np.ndarray:
    """Return p, shape (N, d), converted from velocities if those were drawn."""
    if not data.velocities:
        return drawn
    zero = np.zeros_like(q)
    columns = [hamiltonian.hessian_vector(q, zero, zero, np.tile(unit, (len(q), 1)))[1]
               for unit in np.eye(q.shape[1])]
    rest = hamiltonian.gradient(q, zero)[1]
    # This is exact because dq/dt is affine in p for all of these Hamiltonians.
    return np.linalg.solve(np.stack(columns, axis=2), (drawn - rest)[:, :, None])[:, :, 0]


def _is_within(data: ExactData, hamiltonian: Hamiltonian, q: np.ndarray, p: np.ndarray
               ) -> np.ndarray:
    """Return the mask of states within the bounds of radius and energy."""
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
    """Draw values of shape (samples, d), uniform between the bounds or on one of them."""
    low, high = np.transpose(bounds)
    values = rng.uniform(low, high, size=(data.samples, len(bounds)))
    if data.edge_share > 0.0:
        edges = np.where(rng.random(values.shape) < 0.5, low, high)
        values = np.where(rng.random(values.shape) < data.edge_share, edges, values)
    return values
