# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Simulation of a model along measured motions, from initial states of windows."""

from copy import copy
from functools import cached_property
import math

from hnn_vi_ros.effects import ExternalForce, PeriodicDrive, Place, Servo
from hnn_vi_ros.errors import StateError
from hnn_vi_ros.hamiltonians import Hamiltonian, momentum
from hnn_vi_ros.learning.data.sampling import steps_between
from hnn_vi_ros.learning.fit.step_forces import command_names, constant_commands, constant_forces
from hnn_vi_ros.learning.fit.windows import FOREVER, ModelParts, Windows
from hnn_vi_ros.simulation import Simulation, System
import numpy as np

# Tolerance in steps: a step is split only if forces jump further from its ends than this.
_ALIGNED = 1e-9
# Share of a step by which rounding may move the start of a force, in a million of them.
_ROUNDED = 1e-6
# Number of steps that are followed in one call.
_FOLLOWED = 1 << 16


class LogSimulation:
    """
    Simulation of a model along a log, with its measured forces.

    Parameters
    ----------
    parts : ModelParts
        Parts of the model.
    windows : Windows
        W windows of T samples.

    Attributes
    ----------
    hamiltonian, integrator, effects
        See ModelParts; measured forces have their names, and loops are closed at the start.
    step_size : float
        Length of a step [s]; there are ``per_sample`` between samples.
    driven : bool
        True if measured forces act.
    first : np.ndarray of int, shape (W,)
        Step of the run's clock at which each window starts.

    """

    def __init__(self, parts: ModelParts, windows: Windows):
        self.windows = windows
        self.hamiltonian, self.integrator, self.effects = (
            parts.hamiltonian, parts.integrator, [*parts.effects])
        loops = self.hamiltonian.loops
        if loops is not None:
            # The search leaves the loops; each initial state is moved onto them.
            self.hamiltonian = copy(self.hamiltonian)
            self.hamiltonian.loops = loops._replace(assemble=True)
        self._delay, self._rate_limit = parts.delay, math.inf
        self._on_failure = parts.on_failure
        self.per_sample = steps_between(windows.spacing, parts.step_size)
        self.step_size = windows.spacing / self.per_sample
        self._samples = windows.measured.shape[1] - 1
        self.driven = self._take_force()
        self._parts = self._parts_of_samples()
        # Time and measured forces differ between windows.
        self._timed = self.driven or self.hamiltonian.time is not None or any(
            isinstance(effect, PeriodicDrive) for effect in self.effects)
        # Step of the run's clock at which each window starts.
        self.first = np.rint(windows.times / self.step_size).astype(int) if self._timed else \
            np.zeros(len(windows.run), dtype=int)

    def _take_force(self) -> bool:
        """
        Name the measured forces in the ExternalForce effect; return False if there is none.

        Positions commanded to a servo are its numbers, with its delay.
        """
        self._commanded = self.windows.motions[0].commanded
        for i, effect in enumerate(self.effects):
            if isinstance(effect, Servo) and self._commanded:
                self._delay += effect.delay
                self._rate_limit = effect.rate_limit
                self.effects[i] = effect.on_numbers()
                return True
            if isinstance(effect, ExternalForce):
                if effect.timeout == FOREVER:
                    return True
                self.effects[i] = effect.on(command_names(
                    effect, self.hamiltonian.coordinates, self.windows.motions), FOREVER)
                return True
        return False

    @property
    def even(self) -> bool:
        """Return True if all steps have the same size."""
        return len(self._parts) == 1

    def _parts_of_samples(self) -> list[tuple[float, int]]:
        """Return sizes [s] and counts of steps between samples, split where a held force jumps."""
        whole = [(self.step_size, self.per_sample)]
        # Commands of servos act by their mean in a step.
        if not self.driven or self._commanded or not any(
                motion.held for motion in self.windows.motions):
            return whole
        before, share = divmod(self._delay / self.step_size % self.per_sample, 1.0)
        if min(share, 1.0 - share) < _ALIGNED:
            return whole
        h = self.step_size
        return [part for part in (
            (h, int(before)), (share * h, 1), ((1.0 - share) * h, 1),
            (h, self.per_sample - int(before) - 1)) if part[1]]

    @cached_property
    def simulation(self) -> Simulation:
        """Return the simulation, whose state is that of any window."""
        q, _ = self.windows.start[0]
        with np.errstate(all='ignore'):
            return Simulation(self.hamiltonian, self.integrator, self.step_size, q,
                              np.zeros_like(q), self.effects, self._on_failure)

    def measured_at(self, states: np.ndarray) -> np.ndarray:
        """Return the measured part of states (..., 2 d): q, and H_p if velocities are given."""
        q, columns = states[..., :states.shape[-1] // 2], self.windows.columns
        q = q[..., columns] + self.offset
        return q if not self.windows.rates else np.concatenate(
            [q, self.velocities(states)[..., columns]], -1)

    @cached_property
    def offset(self) -> np.ndarray:
        """Return the offsets of the encoders of servos at measured coordinates, (k,)."""
        names = [one.name for one in self.hamiltonian.coordinates]
        found = np.zeros(len(names))
        for effect in self.effects:
            if isinstance(effect, Servo):
                found[[names.index(one) for one in effect.names]] = effect.values['offset']
        return found[self.windows.columns]

    def velocities(self, states: np.ndarray) -> np.ndarray:
        """Return the velocities H_p at states (..., 2 d), shape (..., d)."""
        q, p = np.split(states, 2, axis=-1)
        flat = [np.ascontiguousarray(part.reshape(-1, part.shape[-1])) for part in (q, p)]
        with np.errstate(all='ignore'):
            found: np.ndarray = self.joined.gradient(*flat)[1].reshape(q.shape)
        return found

    @cached_property
    def joined(self) -> Hamiltonian:
        """Return H including effects that change velocities, such as a magnetic field."""
        if all(effect.place(self.integrator) is not Place.ENERGY for effect in self.effects):
            return self.hamiltonian
        return System(self.hamiltonian, self.effects, self.integrator).hamiltonian

    def starts(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the states (q, p), shape (..., 2 d), with velocities v at coordinates q."""
        return np.concatenate([q, momentum(self.joined, q, v, np.zeros_like(q))], axis=-1)

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
        simulation, at = self.simulation, 0
        simulation.step_size = self.step_size
        flat, usable = self.closed(flat)
        found[own, :, 0] = flat.reshape(len(own), copies, -1)
        rows = simulation.rows(flat, step=np.repeat(self.first[own], copies))
        rows[~usable] = np.nan
        forces = np.repeat(self.forces[own], copies, axis=0)
        # Each call takes longer than many steps.
        most = max(1, _FOLLOWED // (len(flat) * self.per_sample)) if self.even else 1
        for first in range(0, self._samples, most):
            count = min(most, self._samples - first)
            for h, steps in self._parts:
                simulation.step_size = h
                path = simulation.follow_on(rows, np.ascontiguousarray(
                    forces[:, at:at + count * steps]), strict=False)
                at += count * steps
            found[own, :, first + 1:first + 1 + count] = path[:, steps::steps].reshape(
                len(own), copies, count, -1)
        self._ends = rows
        return found

    def closed(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return states with loops closed, and a mask of those at which a run can start, (n,)."""
        try:
            return self.simulation.system.closed(states), np.ones(len(states), bool)
        except StateError:
            if len(states) == 1:
                return states, np.zeros(1, bool)
        (first, usable), (second, others) = map(self.closed, np.array_split(states, 2))
        return np.concatenate([first, second]), np.concatenate([usable, others])

    @cached_property
    def forces(self) -> np.ndarray:
        """Return the measured forces at the steps of each window, shape (W, S, m)."""
        sizes = np.concatenate([np.full(steps, h) for h, steps in self._parts])
        # Sums over thousands of steps would round to the force before.
        since = np.add.outer(self.windows.spacing * np.arange(self._samples),
                             np.cumsum(sizes) - sizes).ravel()
        forces = np.zeros((len(self.first), len(since), 0))
        if not self.driven:
            return forces
        tables, found = dict[int, np.ndarray](), []
        for run, first in zip(self.windows.run.tolist(), self.first, strict=True):
            motion = self.windows.motions[run]
            t = since + (first - round(float(motion.t[0]) / self.step_size)) * self.step_size
            if motion.held and not motion.commanded:
                table, t, duration = motion.tau, t - self._delay, motion.spacing
            else:
                if run not in tables:
                    edges = self.step_size * np.arange(len(motion.tau) * self.per_sample + 1)
                    tables[run] = constant_commands(
                        motion, edges, self._delay, self._rate_limit) if motion.commanded else \
                        constant_forces(motion, edges - self._delay, self.step_size,
                                        self.windows.rates)
                table, duration = tables[run], self.step_size
            # Steps start at a force's start or well after it; the margin allows for rounding.
            row = np.floor(t / duration + _ROUNDED).astype(int)
            acts = (row >= 0) | motion.commanded | (not (motion.held and motion.idle))
            found.append(np.where(acts[:, None], table[np.clip(row, 0, len(table) - 1)], 0.0))
        return np.array(found)

    def energies(self, starts: np.ndarray) -> dict[str, float]:
        """
        Return the works and heats of effects from initial states, (W, 2 d), to the windows' ends.

        They are summed over the windows [J]; see Ledger.
        """
        q, p = np.split(starts[0], 2)
        simulation = self.simulation = Simulation(
            self.hamiltonian, self.integrator, self.step_size, q, p, self.effects,
            self._on_failure, energy_by_cause=True)
        assert simulation.ledger is not None, 'requested'
        names, total = simulation.ledger.names, np.zeros(len(simulation.ledger.names))
        self.states(starts[:, None])
        for row in self._ends[np.isfinite(self._ends[:, 2])]:
            simulation.put(row)
            total += np.array(simulation.causes)
        return {name: float(value) for name, value in zip(names, total, strict=True)
                if name.startswith(('work/', 'heat/'))}

    def predict(self, starts: np.ndarray) -> np.ndarray:
        """Return the prediction from initial states, (W, 2 d), without derivatives, (W, T, C)."""
        return self.measured_at(self.states(starts[:, None])[:, 0])
