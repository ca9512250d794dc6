# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Measured motions cut into windows, and the prediction of a parametric model in each window."""

from collections.abc import Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from functools import cached_property, partial
import math
from typing import NamedTuple, Protocol

from hnn_vi_ros.effects import Effect, ExternalForce, PeriodicDrive, Place
from hnn_vi_ros.errors import DataError, HnnViRosError, ModelError, StateError, UnsupportedSystem
from hnn_vi_ros.hamiltonians import Hamiltonian, momentum
from hnn_vi_ros.integrators import Integrator
from hnn_vi_ros.learning.data.motions import EvenMotion
from hnn_vi_ros.learning.data.sampling import steps_between
from hnn_vi_ros.learning.fit.step_forces import command_names, constant_forces
from hnn_vi_ros.simulation import (
    Change, Dependence, difference, DifferentiableRun, flow_rates, OnNumber, Simulation, sum_of,
    System)
import numpy as np


class CannotFollow(DataError):
    """A model that cannot be simulated through the windows from its initial values."""


# Place of the delay of the input [s], which belongs to no part of a model.
DELAY = 'input_delay'


@dataclass(frozen=True)
class Number:
    """
    A number to be identified.

    Parameters
    ----------
    name : str
        Name as given by the user.
    place : str
        Place in the model, such as that in a scene; or DELAY.
    unit : str
        Unit, '' if unknown.
    start, low, high : float
        Initial guess and bounds.
    size : float, optional
        Usual size; default: that of the initial guess.

    """

    name: str
    place: str
    unit: str
    start: float
    low: float = -math.inf
    high: float = math.inf
    size: float | None = None


class ModelParts(NamedTuple):
    """
    Parts that simulate a model.

    Parameters
    ----------
    hamiltonian, integrator, effects, step_size, on_failure
        See Simulation.
    delay : float
        Delay of the measured forces [s].

    """

    hamiltonian: Hamiltonian
    integrator: Integrator
    effects: Sequence[Effect]
    step_size: float
    on_failure: str = 'stop'
    delay: float = 0.0


class ParametricModel(Protocol):
    """A model with free numbers: a scene, or a rigid body of training."""

    @property
    def name(self) -> str:
        """Return the name for messages."""

    @property
    def numbers(self) -> Sequence[Number]:
        """Return the n free numbers."""

    def parts_at(self, values: np.ndarray) -> ModelParts:
        """Return the parts at values of the numbers, (n,), or raise HnnViRosError."""


class KnownModel(NamedTuple):
    """A model without free numbers; see ParametricModel."""

    name: str
    parts: ModelParts
    numbers: Sequence[Number] = ()

    def parts_at(self, values: np.ndarray) -> ModelParts:
        """Return the parts."""
        return self.parts


# Tolerance in steps: sample times further from whole steps would shift the phase of a drive.
_OFF_GRID = 0.01


def check_times(effects: Sequence[Effect], motions: Sequence[EvenMotion], h: float) -> None:
    """Raise DataError if samples do not fall on whole steps, which would shift a drive's phase."""
    if any(isinstance(effect, PeriodicDrive) for effect in effects):
        for motion in motions:
            off = abs(motion.t[0] / h - round(motion.t[0] / h))
            if off > _OFF_GRID:
                raise DataError(f'{motion.name}: begins at {motion.t[0]:.9g} s, which is not a '
                                f'multiple of the step {h:g} s with which the drive of the scene '
                                'counts time; shift the times')


# Step of central differences: its truncation and rounding errors are of equal size.
_SPACING = float(np.cbrt(np.finfo(np.float64).eps))
# Tolerance in steps: a step is split only if forces jump further from its ends than this.
_ALIGNED = 1e-9
# Share of a step by which rounding may move the start of a force, in a million of them.
_ROUNDED = 1e-6
# Time-out of the external force, which gets a value at every step [s]; an effect that has it is
# taken as it is.
FOREVER = 1e9
# Number of windows differentiated together, and of steps that are followed in one call.
_TOGETHER, _FOLLOWED = 128, 1 << 16


class MeasuredColumns(NamedTuple):
    """
    Coordinates that were measured, and what is known of the others.

    Parameters
    ----------
    columns : np.ndarray of int, shape (k,)
        Columns of the measured coordinates.
    rest : np.ndarray, shape (2, d)
        Coordinates and velocities from which the search of the others begins.
    spread : np.ndarray, shape (d,)
        Size of the coordinates' motion; 0 for one that needs no search.
    rotors : sequence of (int, int)
        Columns of rotors that were not measured, and of their joints, where they begin.

    """

    columns: np.ndarray
    rest: np.ndarray
    spread: np.ndarray
    rotors: Sequence[tuple[int, int]] = ()


@dataclass(frozen=True, eq=False)
class Windows:
    """
    Pieces of measured motions, each starting at an unknown state.

    Parameters
    ----------
    motions : sequence of EvenMotion
        Motions, which have the same sampling interval.
    run, first : np.ndarray of int, shape (W,)
        Run and first sample of each window.
    measured : np.ndarray, shape (W, T, C)
        Measured coordinates, then their velocities if they were measured.
    there : np.ndarray of bool, shape (W, T)
        Mask of the samples in each window, since windows differ in length.
    start : np.ndarray, shape (W, 2, d)
        Smoothed coordinates and velocities at the first samples; those of
        ``MeasuredColumns.rest`` if they were not measured.
    columns : np.ndarray of int, shape (k,)
        Columns of the measured coordinates.

    """

    motions: Sequence[EvenMotion]
    run: np.ndarray
    first: np.ndarray
    measured: np.ndarray
    there: np.ndarray
    start: np.ndarray
    columns: np.ndarray

    @property
    def rates(self) -> bool:
        """Return True if velocities were measured."""
        return self.measured.shape[2] > len(self.columns)

    @property
    def spacing(self) -> float:
        """Return the time between samples [s]."""
        return self.motions[0].spacing

    @property
    def times(self) -> np.ndarray:
        """Return the start time of each window [s], shape (W,)."""
        return np.array([self.motions[run].t[first]
                         for run, first in zip(self.run, self.first, strict=True)])


def cut_windows(motions: Sequence[EvenMotion], horizon: float, seen: MeasuredColumns | None = None
                ) -> Windows:
    """
    Cut runs into windows whose lengths are as equal as whole samples allow.

    Parameters
    ----------
    motions : sequence of EvenMotion
        Measured motions.
    horizon : float
        Maximum length of a window [s]; each one has at least two samples.
    seen : MeasuredColumns, optional
        The measured coordinates; by default all.

    """
    most = max(2, int(horizon / motions[0].spacing * (1.0 + 1e-9)) + 1)
    return _windows_of(motions, [
        (run, part) for run, motion in enumerate(motions) for part in np.array_split(
            np.arange(len(motion.t)), math.ceil(len(motion.t) / most))], seen)


def refined(windows: Windows, motions: Sequence[EvenMotion]) -> Windows:
    """Return the same windows of motions with all samples, of which theirs are every n-th."""
    every, pieces = round(windows.spacing / motions[0].spacing), []
    for run, first in enumerate(windows.first[windows.run == run] for run in range(len(motions))):
        pieces += [(run, part) for part in np.split(
            np.arange(len(motions[run].t)), every * first[1:])]
    return _windows_of(motions, pieces, None)


def _windows_of(motions: Sequence[EvenMotion], pieces: Sequence[tuple[int, np.ndarray]],
                seen: MeasuredColumns | None) -> Windows:
    """Return windows of given samples of runs."""
    longest = max(len(part) for _, part in pieces)
    channels = [motion.measured for motion in motions]
    measured = np.zeros((len(pieces), longest, channels[0].shape[1]))
    there = np.zeros((len(pieces), longest), dtype=bool)
    for w, (run, part) in enumerate(pieces):
        measured[w, :len(part)] = channels[run][part]
        there[w, :len(part)] = True
    first = np.array([part[0] for _, part in pieces])
    columns = np.arange(motions[0].q.shape[1]) if seen is None else seen.columns
    start = np.zeros((len(pieces), 2, len(columns))) if seen is None else np.tile(
        seen.rest, (len(pieces), 1, 1))
    start[:, :, columns] = [[motions[run].q_smooth[part[0]], motions[run].v_smooth[part[0]]]
                            for run, part in pieces]
    for rotor, joint in () if seen is None else seen.rotors:
        start[:, :, rotor] = start[:, :, joint]
    return Windows(motions, np.array([run for run, _ in pieces]), first, measured, there, start,
                   columns)


class Prediction:
    """
    Prediction in windows, simulated with given values of a model's numbers.

    Parameters
    ----------
    model : ParametricModel
        Model with n free numbers.
    values : np.ndarray, shape (n,)
        Values of the numbers.
    windows : Windows
        W windows of T samples.

    Raises
    ------
    HnnViRosError
        The model rejects these values.

    """

    def __init__(self, model: ParametricModel, values: np.ndarray, windows: Windows):
        self._model, self._values, self._windows = model, np.array(values, dtype=float), windows
        own = model.parts_at(values)
        self.hamiltonian, self._integrator, self._effects = (
            own.hamiltonian, own.integrator, [*own.effects])
        loops = self.hamiltonian.loops
        if loops is not None:
            # The search leaves the loops; each initial state is moved onto them.
            self.hamiltonian = copy(self.hamiltonian)
            self.hamiltonian.loops = loops._replace(assemble=True)
        self._delay, self._on_failure = own.delay, own.on_failure
        self._per_sample = steps_between(windows.spacing, own.step_size)
        self._h = windows.spacing / self._per_sample
        self._samples = windows.measured.shape[1] - 1
        self._driven = self._take_force()
        self._parts = self._parts_of_samples()
        # Time and measured forces differ between windows.
        self._timed = self._driven or any(
            isinstance(effect, PeriodicDrive) for effect in self._effects)
        # Step of the run's clock at which each window starts.
        self._first = np.rint(windows.times / self._h).astype(int) if self._timed else \
            np.zeros(len(windows.run), dtype=int)

    def _take_force(self) -> bool:
        """Name the measured forces in the ExternalForce effect; return False if there is none."""
        for i, effect in enumerate(self._effects):
            if isinstance(effect, ExternalForce):
                if effect.timeout == FOREVER:
                    return True
                self._effects[i] = effect.on(command_names(
                    effect, self.hamiltonian.coordinates, self._windows.motions), FOREVER)
                return True
        return False

    def _parts_of_samples(self) -> list[tuple[float, int]]:
        """Return sizes [s] and counts of steps between samples, split where a held force jumps."""
        whole = [(self._h, self._per_sample)]
        if not self._driven or not any(motion.held for motion in self._windows.motions):
            return whole
        before, share = divmod(self._delay / self._h % self._per_sample, 1.0)
        if min(share, 1.0 - share) < _ALIGNED:
            return whole
        return [part for part in (
            (self._h, int(before)), (share * self._h, 1), ((1.0 - share) * self._h, 1),
            (self._h, self._per_sample - int(before) - 1)) if part[1]]

    @cached_property
    def _simulation(self) -> Simulation:
        q, _ = self._windows.start[0]
        with np.errstate(all='ignore'):
            return Simulation(self.hamiltonian, self._integrator, self._h, q, np.zeros_like(q),
                              self._effects, self._on_failure)

    def measured_at(self, states: np.ndarray) -> np.ndarray:
        """Return the measured part of states (..., 2 d): q, and H_p if velocities are given."""
        q, columns = states[..., :states.shape[-1] // 2], self._windows.columns
        return q[..., columns] if not self._windows.rates else np.concatenate(
            [q[..., columns], self.velocities(states)[..., columns]], -1)

    def velocities(self, states: np.ndarray) -> np.ndarray:
        """Return the velocities H_p at states (..., 2 d), shape (..., d)."""
        q, p = np.split(states, 2, axis=-1)
        flat = [np.ascontiguousarray(part.reshape(-1, part.shape[-1])) for part in (q, p)]
        with np.errstate(all='ignore'):
            found: np.ndarray = self._joined.gradient(*flat)[1].reshape(q.shape)
        return found

    @cached_property
    def _joined(self) -> Hamiltonian:
        """Return H including effects that change velocities, such as a magnetic field."""
        if all(effect.place(self._integrator) is not Place.ENERGY for effect in self._effects):
            return self.hamiltonian
        return System(self.hamiltonian, self._effects, self._integrator).hamiltonian

    def starts(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the states (q, p), shape (W, 2 d), with velocities v at coordinates q, (W, d)."""
        return np.hstack([q, momentum(self.hamiltonian, q, v, np.zeros_like(q))])

    def states(self, starts: np.ndarray, only: np.ndarray | None = None) -> np.ndarray:
        """
        Return the states at the samples; NaN from the point where a simulation fails.

        Parameters
        ----------
        starts : np.ndarray, shape (W, K, 2 d)
            K initial states of each window.
        only : np.ndarray of bool, shape (W,), optional
            Windows to simulate; the others are NaN.

        Returns
        -------
        np.ndarray, shape (W, K, T, 2 d)

        """
        found = np.full((*starts.shape[:2], self._samples + 1, starts.shape[2]), np.nan)
        found[:, :, 0] = starts
        own = np.arange(len(starts)) if only is None else np.flatnonzero(only)
        flat, copies = starts[own].reshape(-1, starts.shape[2]), starts.shape[1]
        simulation, at = self._simulation, 0
        simulation.step_size = self._h
        flat, usable = self._closed(flat)
        found[own, :, 0] = flat.reshape(len(own), copies, -1)
        rows = simulation.rows(flat, step=np.repeat(self._first[own], copies))
        rows[~usable] = np.nan
        forces = np.repeat(self._forces[own], copies, axis=0)
        # Each call takes longer than many steps.
        most = 1 if len(self._parts) > 1 else max(1, _FOLLOWED // (len(flat) * self._per_sample))
        for first in range(0, self._samples, most):
            count = min(most, self._samples - first)
            for h, steps in self._parts:
                simulation.step_size = h
                path = simulation.follow_on(rows, np.ascontiguousarray(
                    forces[:, at:at + count * steps]), strict=False)
                at += count * steps
            found[own, :, first + 1:first + 1 + count] = path[:, steps::steps].reshape(
                len(own), copies, count, -1)
        return found

    def _closed(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return states with loops closed, and a mask of those at which a run can start, (n,)."""
        try:
            return self._simulation.system.closed(states), np.ones(len(states), bool)
        except StateError:
            if len(states) == 1:
                return states, np.zeros(1, bool)
        (first, usable), (second, others) = map(self._closed, np.array_split(states, 2))
        return np.concatenate([first, second]), np.concatenate([usable, others])

    @cached_property
    def _forces(self) -> np.ndarray:
        """Return the measured forces at the steps of each window, shape (W, S, m)."""
        sizes = np.concatenate([np.full(steps, h) for h, steps in self._parts])
        # Sums over thousands of steps would round to the force before.
        since = np.add.outer(self._windows.spacing * np.arange(self._samples),
                             np.cumsum(sizes) - sizes).ravel()
        forces = np.zeros((len(self._first), len(since), 0))
        if not self._driven:
            return forces
        tables, found = dict[int, np.ndarray](), []
        for run, first in zip(self._windows.run.tolist(), self._first, strict=True):
            motion = self._windows.motions[run]
            t = since + (first - round(float(motion.t[0]) / self._h)) * self._h
            if motion.held:
                table, t, duration = motion.tau, t - self._delay, motion.spacing
            else:
                if run not in tables:
                    edges = self._h * np.arange(len(motion.tau) * self._per_sample + 1)
                    tables[run] = constant_forces(motion, edges - self._delay, self._h,
                                                  self._windows.rates)
                table, duration = tables[run], self._h
            # Steps start at a force's start or well after it; the margin allows for rounding.
            row = np.floor(t / duration + _ROUNDED).astype(int)
            acts = (row >= 0) | (not (motion.held and motion.idle))
            found.append(np.where(acts[:, None], table[np.clip(row, 0, len(table) - 1)], 0.0))
        return np.array(found)

    def predict(self, starts: np.ndarray) -> np.ndarray:
        """Return the prediction from initial states, (W, 2 d), without derivatives, (W, T, C)."""
        return self.measured_at(self.states(starts[:, None])[:, 0])

    def directions(self, starts: np.ndarray) -> np.ndarray:
        """Return the independent directions of initial states, (W, 2 d), shape (k, W, 2 d)."""
        n = starts.shape[1]
        if self.hamiltonian.loops is None or self._run is None:
            return np.broadcast_to(np.eye(n)[:, None], (n, *starts.shape))
        closed, usable = self._closed(starts)
        loops = self._simulation.system.constraints
        assert loops is not None, 'of the robot'
        found = np.zeros((n - 2 * int((~loops.constraints.dropped).sum()), *starts.shape))
        if usable.any():
            found[:, usable] = self._run.closed_directions(closed[usable])[:len(found)]
        return found

    def by_starts(self, starts: np.ndarray, only: np.ndarray | None = None
                  ) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the prediction, and its derivative along ``directions`` of the initial states.

        Parameters
        ----------
        starts : np.ndarray, shape (W, 2 d)
            Initial states of the windows.
        only : np.ndarray of bool, shape (W,), optional
            Windows to simulate; the others are NaN.

        Returns
        -------
        tuple of np.ndarray, shapes (W, T, C) and (W, T, C, k)

        """
        if self._run is not None:
            return self._exact(self._run, starts, [
                Change(own) for own in self.directions(starts)], only)
        n = starts.shape[1]
        spacing = _SPACING * np.maximum(np.abs(starts).max(axis=0), 1e-3)
        offsets = np.concatenate([np.zeros((1, n)), np.diag(spacing), -np.diag(spacing)])
        found = self.measured_at(self.states(starts[:, None] + offsets, only))
        slopes = (found[:, 1:n + 1] - found[:, n + 1:]) / (2.0 * spacing)[:, None, None]
        return found[:, 0], np.moveaxis(slopes, 1, -1)

    def parameter_jacobian(self, starts: np.ndarray) -> np.ndarray:
        """Return the derivatives of the prediction by the numbers, shape (W, T, C, n)."""
        # A delay changes the forces themselves, and points of loops their equations, not the
        # dependence of H' on the state.
        exact = [k for k, number in enumerate(self._model.numbers) if self._run is not None
                 and number.place != DELAY and not number.place.startswith('hamiltonian.loops.')]
        slopes = np.empty((*self._windows.measured.shape, len(self._values)))
        if exact and self._run is not None:
            slopes[..., exact] = self._exact(self._run, starts, [
                Change(np.zeros_like(starts), [(
                    _OnNumber(self._beside(k), self._integrator, self._run), np.array(1.0))])
                for k in exact])[1]
        for k in range(len(self._values)):
            if k not in exact:
                slopes[..., k] = self._difference(starts, k)
        return slopes

    def _difference(self, starts: np.ndarray, k: int) -> np.ndarray:
        """Return the finite difference with respect to one number, within its bounds."""
        total = np.zeros(self._windows.measured.shape)
        for weight, other in self._beside(k):
            total += weight * other.predict(starts)
        return total

    @cached_property
    def _run(self) -> DifferentiableRun | None:
        """Return the run with exact derivatives, None if they are not available."""
        # For initial states alone, differences cost less than compiling derivatives.
        if len(self._parts) > 1 or not self._model.numbers:
            return None
        try:
            return DifferentiableRun(self.hamiltonian, self._integrator, self._h, self._effects)
        except UnsupportedSystem:
            return None

    def _exact(self, run: DifferentiableRun, starts: np.ndarray, changes: Sequence[Change],
               only: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return the prediction, and its derivatives with respect to the starts or to numbers."""
        shape = self._windows.measured.shape
        found, slopes = np.full(shape, np.nan), np.full((*shape, len(changes)), np.nan)
        wanted = np.arange(len(starts)) if only is None else np.flatnonzero(only)
        for first in range(0, len(wanted), _TOGETHER):
            self._follow(run, starts, changes, wanted[first:first + _TOGETHER], found, slopes)
        return found, slopes

    def _follow(self, run: DifferentiableRun, starts: np.ndarray, changes: Sequence[Change],
                rows: np.ndarray, found: np.ndarray, slopes: np.ndarray) -> None:
        """Fill the prediction of some windows; simulate them one by one if the batch fails."""
        try:
            forces = np.ascontiguousarray(self._forces[rows].swapaxes(0, 1))
            every = slice(None, None, self._per_sample)
            states = run.record(
                np.ascontiguousarray(starts[rows]), len(forces), 1,
                forces if self._driven else None, self._first[rows])[every].swapaxes(0, 1)
            moved = run.push_forward([change._replace(
                tangents=change.tangents[rows]) for change in changes])[:, every]
        except HnnViRosError:
            if len(rows) > 1:
                for half in np.array_split(rows, 2):
                    self._follow(run, starts, changes, half, found, slopes)
            return
        found[rows] = self.measured_at(states)
        for k, (change, own) in enumerate(zip(changes, moved.swapaxes(1, 2), strict=True)):
            number = change.others[0][0] if change.others else None
            slopes[rows, :, :, k] = self._measured_change(states, own, number)

    def _measured_change(self, states: np.ndarray, moved: np.ndarray,
                         number: Dependence | None) -> np.ndarray:
        d, columns = self._windows.start.shape[2], self._windows.columns
        if not self._windows.rates:
            return moved[..., columns]
        flat = [np.ascontiguousarray(part.reshape(-1, d)) for part in (
            *np.split(states, 2, axis=-1), *np.split(moved, 2, axis=-1))]
        v = self._joined.hessian_vector(*flat)[1]
        if isinstance(number, _OnNumber):
            v = v + number.velocity(*flat[:2])
        return np.concatenate([moved[..., columns],
                               v.reshape(*moved.shape[:-1], d)[..., columns]], axis=-1)

    def _beside(self, k: int) -> list[tuple[float, 'Prediction']]:
        """Return the weights of a difference in one number, and the predictions at its points."""
        number, value = self._model.numbers[k], float(self._values[k])
        # A step relative to a value close to zero would be lost in rounding.
        usual = self._windows.spacing if number.place == DELAY else \
            number.size or abs(number.start) or 1.0
        sides = (number.low, number.high), (value, number.high), (number.low, value)
        for low, high in sides:
            # The values beside may be invalid on one side, such as those of a singular mass.
            with suppress(ModelError):
                return [(weight, Prediction(self._model, np.where(
                    np.arange(len(self._values)) == k, other, self._values), self._windows))
                    for other, weight in difference(
                        value, _SPACING * max(abs(value), usual), low, high)]
        raise CannotFollow(f'{self._model.name} is invalid on both sides of {number.name} = '
                           f'{value:g}')


class _OnNumber(OnNumber):
    """Derivatives of H', damping rates and velocities with respect to a number, by differences."""

    def __init__(self, others: Sequence[tuple[float, Prediction]], integrator: Integrator,
                 run: DifferentiableRun):
        kernels = [(weight, run.beside(other.hamiltonian, other._effects).kernel)
                   for weight, other in others]
        super().__init__(partial(sum_of, kernels), sum(
            (weight * flow_rates(other.hamiltonian, integrator, other._effects)
             for weight, other in others), np.zeros(())))
        self._joined = [(weight, other._joined) for weight, other in others]

    def velocity(self, q: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return the derivative of the velocities, shape (N, d)."""
        return sum((weight * joined.gradient(q, p)[1] for weight, joined in self._joined),
                   np.zeros(()))
