# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Steps of many states with held commands, using the method and the effects of a scene."""

from copy import copy
from functools import cached_property
from pathlib import Path
from threading import RLock

from hnn_vi_ros.effects import EFFECTS, LoopManifold, NUMBERS
from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.scene import load_scene, Parts, Scene
from hnn_vi_ros.simulation import (
    ActingEffects, check_count, check_effects, check_numbers, CommandLaw, derivative,
    DifferentiableRun, in_threads, resolve, Simulation, System, usable_processors)
import numpy as np
from numpy.typing import ArrayLike


# Least number of steps per thread.
_LEAST_STEPS = 500


class BatchStep:
    """
    Batched steps of a scene's states, each with a held command: (z, u) -> z.

    Steps use the scene's method and effects, and are compiled once; a failed step gives NaN,
    without fallbacks. The result for one state is independent of the others and of the number of
    threads. Calls are serialised by a lock: for parallel calls, create a BatchStep for each.

    Parameters
    ----------
    scene : Scene, str or Path
        See ``hnn_vi_ros.simulate``. Supported effects are those that join H, forces that depend on
        time and state, damping, and external_force on coordinates (its time-out is ignored).
    hold : int, optional
        Number of steps per command.
    threads : int, optional
        Maximum number of threads for many states; by default the number of usable processors.

    Attributes
    ----------
    dimension, commands : int
        Number d of coordinates, and number c of commands, 0 without an external_force.
    inputs : list of str
        Names of the commands that have one.
    hold : int
        Number of steps per command.
    duration : float
        Time for which a command is held [s].

    Raises
    ------
    UnsupportedSystem
        An effect depends on more than time and state, or coordinates include rotations.
    HnnViRosError, ValueError
        The scene cannot be built, or an argument is invalid.

    """

    def __init__(self, scene: Scene | str | Path, hold: int = 1, threads: int | None = None):
        check_count('hold', hold)
        if threads is not None:
            check_count('threads', threads)
        parts = resolve(scene if isinstance(scene, Scene) else load_scene(scene)).copy()
        self.scene = parts.scene
        check_effects(parts.effects, parts.integrator)
        if any(type(effect) is EFFECTS['servo'] for effect in parts.effects):
            raise UnsupportedSystem(f'{self.scene.name}: the effect servo follows positions, but '
                                    'controllers command forces; replace it by external_force')
        if parts.hamiltonian.rotations:
            raise UnsupportedSystem(f'{self.scene.name} has rotations, for which steps with '
                                    'commands have no derivatives yet')
        if parts.hamiltonian.time is not None:
            raise UnsupportedSystem(f'{self.scene.name}: its H depends on the time, but '
                                    'controllers assume that it does not')
        self._h, self.hold, self._parts = self.scene.known_step_size, int(hold), parts
        self._simulation, self._threads = self._begin(parts), threads or usable_processors()
        # One for each thread, made when first needed.
        self._simulations: list[Simulation] = []
        self._system = self._simulation.system
        if isinstance(self._system.constraints, LoopManifold):
            raise UnsupportedSystem(f'{self.scene.name} has loops, for which control has no '
                                    'equilibria and feedback yet; use servo or external_force')
        if self._system.kernel.internal:
            raise UnsupportedSystem(
                f'{self.scene.name} has effects with internal variables, which a controller does '
                'not measure; give it a scene with joint_friction, and without lags of motors')
        self._acting = ActingEffects(self._system, parts.hamiltonian, parts.effects, self._h)
        self.hamiltonian, self.dimension = self._system.hamiltonian, parts.hamiltonian.dimension
        self.duration = self.hold * self._h
        takes = NUMBERS in self._system.motors.takes
        self.commands = self._system.motors.size if takes else 0
        self.inputs = list(self._system.motors.names) if takes else []
        self._run: DifferentiableRun | None = None
        # All calls share the state of one simulation, so they are serialised.
        self._lock = RLock()

    def __call__(self, z: ArrayLike, u: ArrayLike = (), time: float = 0.0) -> np.ndarray:
        """
        Return the states after the steps; NaN if a step failed.

        Parameters
        ----------
        z : array_like, shape (..., 2 d)
            States (q, p).
        u : array_like, shape (..., c) or (c,)
            Commands.
        time : float, optional
            Time at the start of the steps, for forces that depend on it [s].

        """
        states, commands = self._checked(z, u)
        return self._advanced(states, commands, time, 1, self.hold)[:, 1].reshape(np.shape(z))

    def rollout(self, z: ArrayLike, u: ArrayLike, gains: ArrayLike | None = None,
                about: ArrayLike | None = None, limits: tuple[ArrayLike, ArrayLike] | None = None,
                time: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """
        Simulate N successive commands; return the states and the commands applied.

        Parameters
        ----------
        z : array_like, shape (2 d,) or (m, 2 d)
            Initial states.
        u : array_like, shape (m, N, c)
            Commands, each held as in a call.
        gains, about : array_like, shape (m, N, c, 2 d) and (m, N, 2 d), optional
            Feedback K (z - about) added to the commands; arrays that broadcast to these shapes.
        limits : tuple of array_like, optional
            Minimum and maximum commands, shape (c,) each.
        time : float, optional
            Time at the start [s].

        Returns
        -------
        tuple of np.ndarray, shape (m, N + 1, 2 d) and (m, N, c)
            States are NaN from the first failed step on.

        """
        commands = check_numbers('u', u)
        if commands.ndim != 3:
            raise ValueError(f'u has shape {commands.shape}, expected (m, N, {self.commands})')
        rows, count, _ = commands.shape
        if not count:
            raise ValueError(f'u has shape {commands.shape}: it must contain commands')
        states, _ = self._checked(
            np.broadcast_to(check_numbers('z', z), (rows, 2 * self.dimension)), commands[:, 0])
        law = CommandLaw.none(self.commands)
        if gains is not None and about is not None:
            law = law._replace(gains=_broadcast_copy(gains, (*commands.shape, 2 * self.dimension)),
                               about=_broadcast_copy(about, (rows, count, 2 * self.dimension)))
        if limits is not None:
            low, high = (_broadcast_copy(limit, (self.commands,)) for limit in limits)
            if not (low <= high).all():
                raise ValueError(f'limits {low.tolist()} and {high.tolist()}: the lower limits '
                                 'must not exceed the upper ones')
            law = law._replace(low=low, high=high)
        return self._follow(states, commands, time, self.hold, law), commands

    def derivatives(self, z: ArrayLike, u: ArrayLike = (), time: ArrayLike = 0.0
                    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Return the states after the steps, and their exact derivatives with respect to z and u.

        Parameters
        ----------
        z, u
            As in a call.
        time : float or array_like, shape (m,), optional
            Time at the start of the steps, optionally for each of m states [s].

        Returns
        -------
        tuple of np.ndarray, shape (..., 2 d), (..., 2 d, 2 d) and (..., 2 d, c)
            NaN if a step failed or has no derivative.

        Raises
        ------
        UnsupportedSystem
            The method is not differentiable; the message names those that are.

        """
        states, commands = self._checked(z, u)
        times = np.broadcast_to(time, len(states)) + np.arange(self.hold)[:, None] * self._h
        with self._lock:
            path = self._advanced(states, commands, time, self.hold, 1)
            if self._run is None:
                self._run = DifferentiableRun(self._parts.hamiltonian, self._parts.integrator,
                                              self._h, self._parts.effects)
            by = self._run.jacobians(np.ascontiguousarray(path.swapaxes(0, 1)), times, commands)
        shape, n = np.shape(z), 2 * self.dimension
        return (path[:, -1].reshape(shape), by[..., :n].reshape(*shape, n),
                by[..., n:].reshape(*shape, self.commands))

    @property
    def places(self) -> np.ndarray:
        """
        Return the input matrix of commands on coordinates, shape (c, d).

        Raises
        ------
        UnsupportedSystem
            It depends on state and command; see ``field_derivatives``.

        """
        if self._acting.feels:
            raise UnsupportedSystem(
                'the effect of commands depends on state and command, because of a motor model or '
                'friction under load; use field_derivatives(z, u)[1] instead of places')
        return self._system.places if self.commands else np.zeros((0, self.dimension))

    def field(self, z: ArrayLike, u: ArrayLike = (), time: float = 0.0) -> np.ndarray:
        """Return z' of one state, shape (2 d,), under a command, shape (c,)."""
        with self._lock:
            q, p, d = *self._enter(z, u, time), self.dimension
            dH_dq, dH_dp = self._system.kernel.slopes(q, p)
        return np.concatenate([dH_dp[:d], -dH_dq[:d] - self._acting.rates * p[:d]])

    def field_derivatives(self, z: ArrayLike, u: ArrayLike = (), time: float = 0.0
                          ) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives of z' with respect to z, (2 d, 2 d), and u, (2 d, c)."""
        with self._lock:
            q, p, d = *self._enter(z, u, time), self.dimension
            by_z = np.empty((2 * d, 2 * d))
            for column, unit in enumerate(np.eye(2 * d)):
                v_q, v_p = (np.append(half, np.zeros(q.size - d)) for half in np.split(unit, 2))
                along_q, along_p = self._system.kernel.products(q, p, v_q, v_p)
                by_z[:, column] = np.concatenate(
                    [along_p[:d], -along_q[:d] - self._acting.rates * unit[d:]])
            if not self._acting.feels:
                return by_z, np.vstack([np.zeros((d, self.commands)), self.places.T])
        command = np.asarray(u, dtype=np.float64)
        sizes = np.where(command, np.abs(command), np.abs(command).max() or 1.0)

        def along(unit: np.ndarray, size: float) -> np.ndarray:
            return derivative(lambda step: self.field(z, command + step * unit, time), size)
        return by_z, np.array([*map(along, np.eye(command.size), sizes)]).T

    @cached_property
    def frictionless(self) -> 'BatchStep':
        """Return these steps with a field without passive effects, whose forces vanish at rest."""
        effects = [effect for effect in self._parts.effects if not effect.passive]
        if len(effects) == len(self._parts.effects):
            return self
        other, hamiltonian = copy(self), self._parts.hamiltonian
        other._system = System(hamiltonian, effects, self._parts.integrator)
        other._acting = ActingEffects(other._system, hamiltonian, effects, self._h)
        return other

    def _enter(self, z: ArrayLike, u: ArrayLike, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Apply a command from a time on; return q and p with the channels of forces."""
        states, commands = self._checked(z, u)
        acting = self._acting.acting(np.array([[time]]), commands[None])
        acting.clock[:], acting.command[:] = (time, 0.0), acting.commands[0, 0]
        q, p = np.split(self._acting.padded(states[0]), 2)
        return q, p

    def _checked(self, z: ArrayLike, u: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Return states, (m, 2 d), and commands, (m, c), or raise ValueError."""
        states, commands = check_numbers('z', z), check_numbers('u', u)
        if states.shape[-1:] != (2 * self.dimension,):
            raise ValueError(f'z has shape {states.shape}, expected (..., {2 * self.dimension})')
        expected = (*states.shape[:-1], self.commands)
        shapes = dict.fromkeys((expected, expected[-1:]))
        if commands.shape not in shapes:
            raise ValueError(f'u has shape {commands.shape}, expected '
                             f'{" or ".join(map(str, shapes))}')
        rows = np.ascontiguousarray(states).reshape(-1, 2 * self.dimension)
        return rows, np.broadcast_to(commands, expected).reshape(len(rows), self.commands)

    def _advanced(self, states: np.ndarray, commands: np.ndarray, time: ArrayLike, count: int,
                  hold: int) -> np.ndarray:
        """Return the initial states and those after each of `count` holds, (m, count + 1, 2 d)."""
        return self._follow(states, np.repeat(commands[:, None], count, axis=1), time, hold,
                            CommandLaw.none(self.commands))

    def _begin(self, parts: Parts) -> Simulation:
        """Return a simulation of parts that no other simulation uses."""
        state = self.scene.initial_state
        with self.scene.placed('initial_state'):
            return Simulation(parts.hamiltonian, parts.integrator, self._h, state.q, state.p,
                              parts.effects, 'stop')

    def _follow(self, states: np.ndarray, commands: np.ndarray, time: ArrayLike, hold: int,
                law: CommandLaw) -> np.ndarray:
        """Return the paths of states under commands; see ``Simulation.follow``."""
        most = len(states) * commands.shape[1] * hold // _LEAST_STEPS
        bounds = np.linspace(0, len(states), 1 + max(1, min(self._threads, most)), dtype=int)
        parts = [*map(slice, bounds, bounds[1:])]
        with self._lock:
            rows = self._simulation.rows(states, time)
            if len(parts) == 1:
                # Few steps take less time than the start of a thread.
                return self._simulation.follow(rows, commands, hold, law)[0]
            while len(self._simulations) < len(parts):
                self._simulations.append(self._begin(self._parts.copy()))
            simulations = self._simulations

            def follow(worker: int) -> np.ndarray:
                part = parts[worker]
                return simulations[worker].follow(rows[part], commands[part], hold,
                                                  law.of(part))[0]
            try:
                return np.concatenate(in_threads(follow, len(parts)))
            except BaseException:
                # After Ctrl-C, threads may still use theirs.
                self._simulations = []
                raise


def _broadcast_copy(values: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    """Return a new array of this shape, filled with values that broadcast to it."""
    array = np.empty(shape)
    array[:] = values
    return array
