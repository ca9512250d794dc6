# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Measured motions in windows, and what a scene with given numbers predicts in each."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
import math

from hnn_vi_ros.effects.base import Effect, Place
from hnn_vi_ros.effects.external_force import ExternalForce
from hnn_vi_ros.effects.periodic_drive import PeriodicDrive
from hnn_vi_ros.errors import DataError, HnnViRosError, StepFailure, UnsupportedSystem
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.learning.identify_numbers import FreeScene
from hnn_vi_ros.learning.measured_force import MeasuredForce
from hnn_vi_ros.learning.motions import Motion
from hnn_vi_ros.run.acting_effects import flow_rates
from hnn_vi_ros.run.derivatives import DifferentiableRun, gradient_of
from hnn_vi_ros.run.ensemble import BLOCK
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.system import System
import numpy as np

# Of a central difference: the error of its truncation is as large as that of rounding.
_SPACING = float(np.cbrt(np.finfo(np.float64).eps))
# Of a step: times of samples that are further from whole steps shift the phase of a drive.
_OFF_GRID = 0.01


@dataclass(frozen=True, eq=False)
class Windows:
    """
    Pieces of measured motions, each of which begins at an unknown state.

    Parameters
    ----------
    motions : sequence of Motion
        The runs, which share one interval.
    run, first : np.ndarray of int, shape (W,)
        The run and the sample with which each window begins.
    measured : np.ndarray, shape (W, T, C)
        Coordinates, then velocities if they were measured, at its samples.
    there : np.ndarray of bool, shape (W, T)
        Whether a sample belongs to it: some windows are shorter than others.
    start : np.ndarray, shape (W, 2, d)
        Smoothed coordinates and velocities at the first samples.

    """

    motions: Sequence[Motion]
    run: np.ndarray
    first: np.ndarray
    measured: np.ndarray
    there: np.ndarray
    start: np.ndarray

    @property
    def spacing(self) -> float:
        """Return the time between samples [s]."""
        return self.motions[0].spacing

    @property
    def dimension(self) -> int:
        """Return d."""
        return self.start.shape[2]

    @property
    def times(self) -> np.ndarray:
        """Return the time at which each begins [s], shape (W,)."""
        return np.array([self.motions[run].t[first]
                         for run, first in zip(self.run, self.first, strict=True)])


def windows_of(motions: Sequence[Motion], horizon: float, velocities: bool) -> Windows:
    """
    Cut runs into windows of one length, as nearly as whole numbers allow.

    Parameters
    ----------
    motions : sequence of Motion
        The runs.
    horizon : float
        The longest window [s]; at least two samples are in each.
    velocities : bool
        Whether they were measured.

    """
    most = max(2, int(horizon / motions[0].spacing * (1.0 + 1e-9)) + 1)
    pieces = [(run, part) for run, motion in enumerate(motions) for part in np.array_split(
        np.arange(len(motion.t)), math.ceil(len(motion.t) / most))]
    longest = max(len(part) for _, part in pieces)
    d = motions[0].q.shape[1]
    measured = np.zeros((len(pieces), longest, 2 * d if velocities else d))
    there = np.zeros((len(pieces), longest), dtype=bool)
    for w, (run, part) in enumerate(pieces):
        both = [motions[run].q[part], motions[run].v[part]]
        measured[w, :len(part)] = np.hstack(both[:1 + velocities])
        there[w, :len(part)] = True
    first = np.array([part[0] for _, part in pieces])
    start = np.array([[motions[run].q_smooth[part[0]], motions[run].v_smooth[part[0]]]
                      for run, part in pieces])
    return Windows(motions, np.array([run for run, _ in pieces]), first, measured, there, start)


class Prediction:
    """
    What a scene with certain values of its free numbers predicts in windows.

    Parameters
    ----------
    free : FreeScene
        The scene.
    values : np.ndarray, shape (n,)
        Of its free numbers.
    windows : Windows
        W of them, of T samples.

    Raises
    ------
    HnnViRosError
        The scene does not take these values.

    """

    def __init__(self, free: FreeScene, values: np.ndarray, windows: Windows):
        self._free, self._values, self._windows = free, np.array(values, dtype=float), windows
        scene, self._delay = free.at(values)
        self.hamiltonian, self._integrator = scene.create_hamiltonian(), scene.create_integrator()
        self._per_sample = steps_per_sample(scene, windows.spacing)
        self._h = windows.spacing / self._per_sample
        self._samples = windows.measured.shape[1] - 1
        self._effects, self._force = self._acting(scene)
        self._on_failure = scene.on_failure
        # Time, and what was measured, are others in each window.
        self._alone = any(isinstance(effect, MeasuredForce | PeriodicDrive)
                          for effect in self._effects)

    def _acting(self, scene: Scene) -> tuple[list[Effect], MeasuredForce | None]:
        """Return the effects, with the measured forces in place of commands."""
        effects, force = scene.create_effects(), None
        for i, effect in enumerate(effects):
            if isinstance(effect, ExternalForce):
                names = command_names(effect, self.hamiltonian.coordinates, self._windows.motions)
                force = MeasuredForce(names, self._samples * self._per_sample)
                force.times[1] = 1.0 / self._h
                effects[i] = force
        return effects, force

    @cached_property
    def _simulation(self) -> Simulation:
        q, _ = self._windows.start[0]
        with np.errstate(all='ignore'):
            return Simulation(self.hamiltonian, self._integrator, self._h, q, np.zeros_like(q),
                              self._effects, self._on_failure)

    def measured_at(self, states: np.ndarray) -> np.ndarray:
        """Return what is measured of states, shape (..., 2 d): q, and H_p if velocities were."""
        q, p = np.split(states, 2, axis=-1)
        if self._windows.measured.shape[2] == q.shape[-1]:
            return q
        flat = [np.ascontiguousarray(part.reshape(-1, part.shape[-1])) for part in (q, p)]
        with np.errstate(all='ignore'):
            return np.concatenate([q, self._joined.gradient(*flat)[1].reshape(q.shape)], -1)

    @cached_property
    def _joined(self) -> Hamiltonian:
        """Return H with what joins it, such as a magnetic field, by which velocities change."""
        if all(effect.place(self._integrator) is not Place.ENERGY for effect in self._effects):
            return self.hamiltonian
        return System(self.hamiltonian, self._effects, self._integrator).hamiltonian

    def states(self, starts: np.ndarray) -> np.ndarray:
        """
        Return the states at the samples, not a number from where a simulation fails.

        Parameters
        ----------
        starts : np.ndarray, shape (W, K, 2 d)
            K states from which each window begins.

        Returns
        -------
        np.ndarray, shape (W, K, T, 2 d)

        """
        found = np.full((*starts.shape[:2], self._samples + 1, starts.shape[2]), np.nan)
        found[:, :, 0] = starts
        if self._alone:
            for w in range(len(starts)):
                self._prepare(w)
                self._record(starts[w], found[w], self._step(w))
        else:
            flat, into = starts.reshape(-1, starts.shape[2]), found.reshape(
                -1, *found.shape[2:])
            for a in range(0, len(flat), BLOCK):
                self._record(flat[a:a + BLOCK], into[a:a + BLOCK], 0)
        return found

    def _record(self, starts: np.ndarray, found: np.ndarray, step: int) -> None:
        """Fill the states from some starts, one by one if they do not all go well together."""
        q, p = np.split(starts, 2, axis=1)
        try:
            self._simulation.restart(q, p, step=step)
            states = np.concatenate(self._simulation.record(self._samples, self._per_sample), 2)
            found[:, 1:] = states.swapaxes(0, 1)
        except (StepFailure, ValueError):
            if len(starts) > 1:
                for k in range(len(starts)):
                    self._record(starts[k:k + 1], found[k:k + 1], step)

    def _step(self, w: int) -> int:
        return round(float(self._windows.times[w]) / self._h)

    def _prepare(self, w: int) -> None:
        """Put the forces that were measured in a window into effect."""
        if self._force is None:
            return
        start = self._step(w) * self._h
        self._force.times[0] = start
        motion = self._windows.motions[self._windows.run[w]]
        edges = self._windows.first[w] * self._windows.spacing + self._h * np.arange(
            len(self._force.table) + 1) - self._delay
        self._force.table[:] = np.diff(impulse(motion, edges), axis=0) / self._h

    def by_starts(self, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return what is predicted, and its derivative by the initial states.

        Parameters
        ----------
        starts : np.ndarray, shape (W, 2 d)
            The states from which the windows begin.

        Returns
        -------
        tuple of np.ndarray, shapes (W, T, C) and (W, T, C, 2 d)

        """
        if self._run is not None:
            return self._exact(self._run, starts, [
                (np.broadcast_to(unit, starts.shape), None) for unit in np.eye(starts.shape[1])])
        n = starts.shape[1]
        spacing = _SPACING * np.maximum(np.abs(starts).max(axis=0), 1e-3)
        offsets = np.concatenate([np.zeros((1, n)), np.diag(spacing), -np.diag(spacing)])
        found = self.measured_at(self.states(starts[:, None] + offsets))
        slopes = (found[:, 1:n + 1] - found[:, n + 1:]) / (2.0 * spacing)[:, None, None]
        return found[:, 0], np.moveaxis(slopes, 1, -1)

    def by_numbers(self, starts: np.ndarray) -> np.ndarray:
        """Return the derivative of what is predicted by the free numbers, shape (W, T, C, n)."""
        wanted = range(len(self._values))
        if not wanted:
            return np.zeros((*self._windows.measured.shape, 0))
        if self._run is not None:
            return self._exact(self._run, starts, [(np.zeros_like(starts), k) for k in wanted])[1]
        return np.stack([self._difference(starts, k) for k in wanted], axis=-1)

    def _difference(self, starts: np.ndarray, k: int) -> np.ndarray:
        """Return a central difference by one number; its spacing keeps within the bounds."""
        sides = []
        for value in self._beside(k):
            values = self._values.copy()
            values[k] = value
            other = Prediction(self._free, values, self._windows)
            sides.append((value, other.measured_at(other.states(starts[:, None])[:, 0])))
        (low, below), (high, above) = sides
        return (above - below) / (high - low)

    @cached_property
    def _run(self) -> DifferentiableRun | None:
        """Return the run whose derivatives are exact, None where there is none."""
        if self._alone:
            return None
        try:
            return DifferentiableRun(self.hamiltonian, self._integrator, self._h, self._effects)
        except UnsupportedSystem:
            return None

    def _exact(self, run: DifferentiableRun, starts: np.ndarray,
               changes: Sequence[tuple[np.ndarray, int | None]]) -> tuple[np.ndarray, np.ndarray]:
        """Return what is predicted, and how it changes with the starts and with a number."""
        try:
            states = run.record(np.ascontiguousarray(starts), self._samples, self._per_sample)
            states = states.swapaxes(0, 1)
            slopes = []
            for tangents, k in changes:
                number = None if k is None else self._on_number(k)
                moved = run.push_forward(
                    np.ascontiguousarray(tangents), [] if number is None else [
                        (number, np.array(1.0))]).swapaxes(0, 1)
                slopes.append(self._measured_change(states, moved, number))
        except HnnViRosError:
            shape = self._windows.measured.shape
            return np.full(shape, np.nan), np.full((*shape, len(changes)), np.nan)
        return self.measured_at(states), np.stack(slopes, axis=-1)

    def _measured_change(self, states: np.ndarray, moved: np.ndarray,
                         number: '_OnNumber | None') -> np.ndarray:
        d = self._windows.dimension
        if self._windows.measured.shape[2] == d:
            return moved[..., :d]
        flat = [np.ascontiguousarray(part.reshape(-1, d)) for part in (
            *np.split(states, 2, axis=-1), *np.split(moved, 2, axis=-1))]
        v = self._joined.hessian_vector(*flat)[1]
        if number is not None:
            v = v + number.velocity(*flat[:2])
        return np.concatenate([moved[..., :d], v.reshape(*moved.shape[:-1], d)], axis=-1)

    def _on_number(self, k: int) -> '_OnNumber':
        """Return the dependence of the steps on one number."""
        systems, rates = [], []
        for value in self._beside(k):
            values = self._values.copy()
            values[k] = value
            scene, _ = self._free.at(values)
            hamiltonian, effects = scene.create_hamiltonian(), scene.create_effects()
            systems.append((value, System(hamiltonian, effects, self._integrator)))
            rates.append(flow_rates(hamiltonian, self._integrator, effects))
        return _OnNumber(systems, rates)

    def _beside(self, k: int) -> tuple[float, float]:
        """Return a value of a number below its own and one above, both within the bounds."""
        number, value = self._free.numbers[k], self._values[k]
        spacing = _SPACING * (abs(value) or abs(number.start) or 1.0)
        spacing = min(spacing, 0.5 * (value - number.low) or spacing,
                      0.5 * (number.high - value) or spacing)
        return max(value - spacing, number.low), min(value + spacing, number.high)


class _OnNumber:
    """The dependence of H' and of rates of damping on a number, by differences; see Dependence."""

    def __init__(self, systems: Sequence[tuple[float, System]], rates: Sequence[np.ndarray]):
        (low, self._below), (high, self._above) = systems
        self._width = high - low
        self.rates = (rates[1] - rates[0]) / self._width

    def changed(self, q: np.ndarray, p: np.ndarray, change: np.ndarray) -> np.ndarray:
        """Return how (H_q, H_p) change, shape (2, N)."""
        below, above = (gradient_of(system.kernel, q, p) for system in (self._below, self._above))
        return change * (above - below) / self._width

    def contracted(self, q: np.ndarray, p: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return the gradient by the number, shape ()."""
        return np.array((weights * self.changed(q, p, np.array(1.0))).sum())

    def velocity(self, q: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return how the velocities of states change, shape (N, d)."""
        below, above = (system.hamiltonian.gradient(q, p)[1]
                        for system in (self._below, self._above))
        return (above - below) / self._width


def impulse(motion: Motion, times: np.ndarray) -> np.ndarray:
    """
    Return the integral of the measured forces up to times from the first sample on [s].

    Each force holds until the next, or goes over into it, as the motion says; the first one acts
    before the first sample, the last one after the last.
    """
    tau, spacing = motion.tau, motion.spacing
    means = tau[:-1] if motion.held else 0.5 * (tau[1:] + tau[:-1])
    whole = np.concatenate([np.zeros((1, tau.shape[1])), np.cumsum(means * spacing, axis=0)])
    row = np.clip(np.floor(times / spacing).astype(int), 0, len(tau) - 1)
    rest = (times - row * spacing)[:, None]
    slope = np.zeros_like(tau)
    if not motion.held:
        slope[:-1] = np.diff(tau, axis=0) / spacing
    return whole[row] + rest * (tau[row] + 0.5 * np.where(rest > 0.0, rest, 0.0) * slope[row])


def steps_per_sample(scene: Scene, spacing: float) -> int:
    """Return how many steps are taken from one sample to the next, none longer than h."""
    return max(1, math.ceil(spacing / scene.known_step_size - 1e-9))


def command_names(effect: ExternalForce, coordinates: Sequence, motions: Sequence[Motion]
                  ) -> Sequence[str]:
    """Return the coordinates on which the measured forces act, or raise DataError."""
    names, m = [coordinate.name for coordinate in coordinates], motions[0].tau.shape[1]
    if not effect.names:
        raise DataError('external_force: its model has an input map, which takes no measured '
                        'forces here; give it coordinates')
    if m in (len(effect.names), len(names)):
        return effect.names if m == len(effect.names) else names
    raise DataError(f'external_force has {len(effect.names)} coordinates, H {len(names)}, and the '
                    f'data hold {m} forces; give as many')


def check_times(effects: Sequence[Effect], motions: Sequence[Motion], h: float) -> None:
    """Raise DataError where a drive would be out of phase: samples at no whole steps."""
    if any(isinstance(effect, PeriodicDrive) for effect in effects):
        for motion in motions:
            off = abs(motion.t[0] / h - round(motion.t[0] / h))
            if off > _OFF_GRID:
                raise DataError(f'{motion.name}: begins at {motion.t[0]:.9g} s, which is no whole '
                                f'number of steps of {h:g} s, by which the drive of the scene '
                                'counts time; shift the times')
