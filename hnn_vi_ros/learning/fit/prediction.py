# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Prediction of a parametric model in windows of measured motions, with its derivatives."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cached_property, partial
from typing import Any

from hnn_vi_ros.errors import HnnViRosError, UnsupportedSystem
from hnn_vi_ros.integrators import Integrator
from hnn_vi_ros.learning.fit.following import LogSimulation
from hnn_vi_ros.learning.fit.windows import (
    CannotFollow, delays, ParametricModel, Windows, windows_in)
from hnn_vi_ros.simulation import (
    Change, Dependence, difference, DifferentiableRun, flow_rates, OnNumber, sum_of)
import numpy as np

# Step of central differences: its truncation and rounding errors are of equal size.
_SPACING = float(np.cbrt(np.finfo(np.float64).eps))
# Number of windows differentiated together.
_TOGETHER = 128


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
        self._model, self._values = model, np.array(values, dtype=float)
        self.log = LogSimulation(model.parts_at(values), windows)

    def directions(self, starts: np.ndarray) -> np.ndarray:
        """Return the independent directions of initial states, (W, 2 d), shape (k, W, 2 d)."""
        n = starts.shape[1]
        if self.log.hamiltonian.loops is None or self._run is None:
            return np.broadcast_to(np.eye(n)[:, None], (n, *starts.shape))
        closed, usable = self.log.closed(starts)
        loops = self.log.simulation.system.constraints
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
        found = self.log.measured_at(self.log.states(starts[:, None] + offsets, only))
        slopes = (found[:, 1:n + 1] - found[:, n + 1:]) / (2.0 * spacing)[:, None, None]
        return found[:, 0], np.moveaxis(slopes, 1, -1)

    def parameter_jacobian(self, starts: np.ndarray) -> np.ndarray:
        """Return the derivatives of the prediction by the numbers, shape (W, T, C, n)."""
        # A delay changes the forces themselves, and points of loops their equations, not the
        # dependence of H' on the state.
        exact = [k for k, number in enumerate(self._model.numbers) if self._run is not None
                 and not delays(number.place)
                 and not number.place.startswith('hamiltonian.loops.')]
        slopes = np.empty((*self.log.windows.measured.shape, len(self._values)))
        if exact and self._run is not None:
            slopes[..., exact] = self._exact(self._run, starts, [
                Change(np.zeros_like(starts), [(
                    _OnNumber(self._beside(k), self.log.integrator, self._run), np.array(1.0))])
                for k in exact])[1]
        for k in range(len(self._values)):
            if k not in exact:
                slopes[..., k] = self._difference(starts, k)
        return slopes

    def by_forces(self, starts: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """
        Return the derivatives of weighted sums of the prediction by the force of each sample.

        Parameters
        ----------
        starts : np.ndarray, shape (W, 2 d)
            Initial states of the windows.
        weights : np.ndarray, shape (W, T, C, n)
            Weights of n sums over all coordinates; velocities have none.

        Returns
        -------
        np.ndarray, shape (W, T - 1, m, n)
            For m forces; 0 where no exact derivatives are available.

        """
        forces, every = self.log.forces, self.log.per_sample
        found = np.zeros((*weights.shape[:1], forces.shape[1] // every, forces.shape[2],
                          weights.shape[3]))
        if self._run is None:
            return found
        for first in range(0, len(starts), _TOGETHER):
            rows = slice(first, first + _TOGETHER)
            own = np.ascontiguousarray(forces[rows].swapaxes(0, 1))
            self._run.record(np.ascontiguousarray(starts[rows]), len(own), 1, own,
                             self.log.first[rows])
            for k in range(weights.shape[3]):
                cotangents = np.zeros((len(own) + 1, own.shape[1], starts.shape[1]))
                cotangents[::every, :, self.log.windows.columns] = weights[rows, ..., k].swapaxes(
                    0, 1)
                slopes = np.zeros_like(own)
                self._run.pull_back(cotangents, by_commands=slopes)
                found[rows, ..., k] = slopes.reshape(
                    -1, every, *own.shape[1:]).sum(axis=1).swapaxes(0, 1)
        return found

    def _difference(self, starts: np.ndarray, k: int) -> np.ndarray:
        """Return the finite difference with respect to one number, within its bounds."""
        total = np.zeros(self.log.windows.measured.shape)
        for weight, other in self._beside(k):
            total += weight * other.log.predict(starts)
        return total

    @cached_property
    def _run(self) -> DifferentiableRun | None:
        """Return the run with exact derivatives, None if they are not available."""
        # For initial states alone, differences cost less than compiling derivatives.
        if not self.log.even or not self._model.numbers:
            return None
        try:
            return DifferentiableRun(self.log.hamiltonian, self.log.integrator,
                                     self.log.step_size, self.log.effects)
        except UnsupportedSystem:
            return None

    def _exact(self, run: DifferentiableRun, starts: np.ndarray, changes: Sequence[Change],
               only: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return the prediction, and its derivatives with respect to the starts or to numbers."""
        shape = self.log.windows.measured.shape
        found, slopes = np.full(shape, np.nan), np.full((*shape, len(changes)), np.nan)
        wanted = np.arange(len(starts)) if only is None else np.flatnonzero(only)
        for first in range(0, len(wanted), _TOGETHER):
            self._follow(run, starts, changes, wanted[first:first + _TOGETHER], found, slopes)
        return found, slopes

    def _follow(self, run: DifferentiableRun, starts: np.ndarray, changes: Sequence[Change],
                rows: np.ndarray, found: np.ndarray, slopes: np.ndarray) -> None:
        """Fill the prediction of some windows; simulate them one by one if the batch fails."""
        try:
            forces = np.ascontiguousarray(self.log.forces[rows].swapaxes(0, 1))
            every = slice(None, None, self.log.per_sample)
            states = run.record(
                np.ascontiguousarray(starts[rows]), len(forces), 1,
                forces if self.log.driven else None, self.log.first[rows])[every].swapaxes(0, 1)
            moved = run.push_forward([change._replace(
                tangents=change.tangents[rows]) for change in changes])[:, every]
        except HnnViRosError:
            if len(rows) > 1:
                for half in np.array_split(rows, 2):
                    self._follow(run, starts, changes, half, found, slopes)
            return
        found[rows] = self.log.measured_at(states)
        for k, (change, own) in enumerate(zip(changes, moved.swapaxes(1, 2), strict=True)):
            number = change.others[0][0] if change.others else None
            slopes[rows, :, :, k] = self._measured_change(states, own, number)

    def _measured_change(self, states: np.ndarray, moved: np.ndarray,
                         number: Dependence | None) -> np.ndarray:
        d, columns = self.log.windows.start.shape[2], self.log.windows.columns
        q = moved[..., columns]
        if isinstance(number, _OnNumber):
            q = q + number.offset
        if not self.log.windows.rates:
            return q
        flat = [np.ascontiguousarray(part.reshape(-1, d)) for part in (
            *np.split(states, 2, axis=-1), *np.split(moved, 2, axis=-1))]
        v = self.log.joined.hessian_vector(*flat)[1]
        if isinstance(number, _OnNumber):
            v = v + number.velocity(*flat[:2])
        return np.concatenate([q, v.reshape(*moved.shape[:-1], d)[..., columns]], axis=-1)

    def _beside(self, k: int) -> list[tuple[float, 'Prediction']]:
        """Return the weights of a difference in one number, and the predictions at its points."""
        number, value = self._model.numbers[k], float(self._values[k])
        # A step relative to a value close to zero would be lost in rounding.
        usual = self.log.windows.spacing if number.place.endswith('delay') else \
            number.size or abs(number.start) or 1.0
        sides = (number.low, number.high), (value, number.high), (number.low, value)
        for low, high in sides:
            # Neighboring values may be invalid on one side, as for a singular mass.
            with suppress(HnnViRosError):
                return [(weight, Prediction(self._model, np.where(
                    np.arange(len(self._values)) == k, other, self._values), self.log.windows))
                    for other, weight in difference(
                        value, _SPACING * max(abs(value), usual), low, high)]
        raise CannotFollow(f'{self._model.name} is invalid on both sides of {number.name} = '
                           f'{value:g}')


class PredictionByLoad:
    """
    Prediction of logs with different loads, each by its own model; see Prediction.

    It is its own simulation, `log`.

    Parameters
    ----------
    parts : sequence of (np.ndarray of int, Prediction)
        Windows of each load, and their prediction.

    """

    def __init__(self, parts: Sequence[tuple[np.ndarray, Prediction]]):
        self._parts, self.log = parts, self
        self._order = np.argsort(np.concatenate([rows for rows, _ in parts]))

    def directions(self, starts: np.ndarray) -> np.ndarray:
        """Return the independent directions of initial states, shape (k, W, 2 d)."""
        return self._joined(lambda one, rows: one.directions(starts[rows]).swapaxes(0, 1)
                            ).swapaxes(0, 1)

    def by_starts(self, starts: np.ndarray, only: np.ndarray | None = None
                  ) -> tuple[np.ndarray, np.ndarray]:
        """Return the prediction, and its derivative along ``directions``."""
        found = [one.by_starts(starts[rows], None if only is None else only[rows])
                 for rows, one in self._parts]
        predicted, slopes = (np.concatenate(part)[self._order]
                             for part in zip(*found, strict=True))
        return predicted, slopes

    def parameter_jacobian(self, starts: np.ndarray) -> np.ndarray:
        """Return the derivatives of the prediction by the numbers, shape (W, T, C, n)."""
        return self._joined(lambda one, rows: one.parameter_jacobian(starts[rows]))

    def starts(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the states (q, p), shape (W, 2 d), with velocities v at coordinates q."""
        return self._joined(lambda one, rows: one.log.starts(q[rows], v[rows]))

    def states(self, starts: np.ndarray) -> np.ndarray:
        """Return the states at the samples, shape (W, K, T, 2 d)."""
        return self._joined(lambda one, rows: one.log.states(starts[rows]))

    def predict(self, starts: np.ndarray) -> np.ndarray:
        """Return the prediction from initial states, without derivatives, (W, T, C)."""
        return self._joined(lambda one, rows: one.log.predict(starts[rows]))

    def energies(self, starts: np.ndarray) -> dict[str, float]:
        """Return the works and heats of effects [J]."""
        found = [one.log.energies(starts[rows]) for rows, one in self._parts]
        # Logs without a payload have no work of one.
        return {name: sum(own.get(name, 0.0) for own in found)
                for name in dict.fromkeys(name for own in found for name in own)}

    def _joined(self, of: Callable[[Prediction, np.ndarray], np.ndarray]) -> np.ndarray:
        return np.concatenate([of(one, rows) for rows, one in self._parts])[self._order]


def predicted_by(model: ParametricModel, values: np.ndarray, windows: Windows
                 ) -> Prediction | PredictionByLoad:
    """Return the prediction of a model, whose scene may carry other loads in other logs."""
    scene: Any = model
    if not getattr(model, 'loads', None):
        return Prediction(model, values, windows)
    loads = np.array([scene.load_of(windows.motions[run].name) for run in windows.run])
    return PredictionByLoad([(rows, Prediction(
        scene.carrying(load), values, windows_in(windows, rows)))
        for load in np.unique(loads).tolist() for rows in [np.flatnonzero(loads == load)]])


class _OnNumber(OnNumber):
    """Derivatives of H', damping rates and velocities with respect to a number, by differences."""

    def __init__(self, others: Sequence[tuple[float, Prediction]], integrator: Integrator,
                 run: DifferentiableRun):
        kernels = [(weight, run.beside(other.log.hamiltonian, other.log.effects).kernel)
                   for weight, other in others]
        super().__init__(partial(sum_of, kernels), sum(
            (weight * flow_rates(other.log.hamiltonian, integrator, other.log.effects)
             for weight, other in others), np.zeros(())))
        self.offset = sum((weight * other.log.offset for weight, other in others), np.zeros(()))
        self._joined = [(weight, other.log.joined) for weight, other in others]

    def velocity(self, q: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return the derivative of the velocities, shape (N, d)."""
        return sum((weight * joined.gradient(q, p)[1] for weight, joined in self._joined),
                   np.zeros(()))
