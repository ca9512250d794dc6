# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Steps of many states with held commands, by the method and the effects of a scene."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from hnn_vi_ros.accuracy.automatic_choice import resolve
from hnn_vi_ros.effects.commands import NUMBERS
from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.gradients.acting_effects import ActingEffects, check_effects
from hnn_vi_ros.gradients.derivatives import check_unknowns, differentiable_tableau
from hnn_vi_ros.gradients.stages import Acting, entry_of, push_each, StageWork
from hnn_vi_ros.integrators.arithmetic import copy_point, is_finite
from hnn_vi_ros.integrators.base import NOT_FINITE, OK, Point, Step
from hnn_vi_ros.integrators.workspaces import forget
from hnn_vi_ros.kernels.blocks import bare
from hnn_vi_ros.kernels.kernel import Kernel, Parameters
from hnn_vi_ros.kernels.marks import inlined
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation.assembly import Loop
from hnn_vi_ros.simulation.checks import check_count
from hnn_vi_ros.simulation.system import System
import numpy as np
from numpy.typing import ArrayLike


class Law(NamedTuple):
    """
    Feedback that is added to N commands, which limits then bound.

    Parameters
    ----------
    gains : np.ndarray, shape (m, N, c, 2 d)
        Of what a state deviates, of each of m trajectories; empty for none.
    about : np.ndarray, shape (m, N, 2 d)
        From where.
    low, high : np.ndarray, shape (c,)
        Least and largest commands.

    """

    gains: np.ndarray
    about: np.ndarray
    low: np.ndarray
    high: np.ndarray


def follow_each(step: Step, kernel: Kernel, h: float, options: Parameters, hold: int, count: int,
                z: Point, z1: Point, memory: Parameters, times: np.ndarray, clock: np.ndarray,
                command: np.ndarray, places: np.ndarray, law: Law, wanted: np.ndarray,
                states: np.ndarray) -> int:
    """Hold commands one after another from each first state; NaN from a step that fails on."""
    kernel, options, z, z1, memory, times, clock, command, places, law, wanted, states = bare(
        (kernel, options, z, z1, memory, times, clock, command, places, law, wanted, states))
    dimension, failed = states.shape[2] // 2, 0
    for m in range(states.shape[0]):
        clock[0], clock[1] = times[m], 0.0
        for k in range(z.q.size):
            z.q[k] = states[m, 0, k] if k < dimension else 0.0
            z.p[k] = states[m, 0, dimension + k] if k < dimension else 0.0
            z.q_carry[k], z.p_carry[k] = 0.0, 0.0
        # Results must not depend on what stepped before.
        forget(memory)
        for n in range(count):
            _put(law, m, n, states[m, n], places, wanted[m, n], command)
            # A command changes H' of the point, which methods keep.
            kernel.gradient(kernel.parameters, z.q, z.p, z.dH_dq, z.dH_dp)
            outcome = OK
            for _ in range(hold):
                outcome, _, _ = step(kernel, h, options, z, z1, memory)
                if outcome != OK or not is_finite(z1):
                    outcome = NOT_FINITE
                    break
                copy_point(z1, z)
            if outcome != OK:
                states[m, n + 1:] = np.nan
                failed += 1
                break
            for k in range(dimension):
                states[m, n + 1, k], states[m, n + 1, dimension + k] = z.q[k], z.p[k]
    return failed


@inlined
def _put(law: Law, m: int, n: int, state: np.ndarray, places: np.ndarray, wanted: np.ndarray,
         command: np.ndarray) -> None:
    """Add feedback to wanted commands within limits, and write them as forces find them."""
    command[:] = 0.0
    # They do not expire.
    command[command.size - 1] = np.inf
    for i in range(wanted.size):
        for k in range(state.size if law.gains.size else 0):
            wanted[i] += law.gains[m, n, i, k] * (state[k] - law.about[m, n, k])
        wanted[i] = min(max(wanted[i], law.low[i]), law.high[i])
        for k in range(places.shape[1]):
            command[k] += wanted[i] * places[i, k]


class BatchStep:
    """
    Steps of many states of a scene, each with a command that is held: (z, u) -> z.

    Steps are those of the scene's own method with its effects, compiled once; a step that fails
    gives NaN, without fallbacks. What comes out of one state depends on no other. For one thread
    at a time.

    Parameters
    ----------
    scene : Scene, str or Path
        See ``hnn_vi_ros.simulate``. Of effects it may have those that join H, forces that depend
        on time and state, damping, and external_force on coordinates, whose time-out is ignored.
    hold : int, optional
        Steps that each command lasts.

    Attributes
    ----------
    dimension, commands : int
        Coordinates d, and numbers c of a command, 0 without an external_force.
    inputs : list of str
        What each of these is for, where that has a name.
    hold : int
        Steps that each command lasts.
    duration : float
        Time that a command is held [s].

    Raises
    ------
    UnsupportedSystem
        An effect depends on more than time and state, or coordinates turn.
    HnnViRosError, ValueError
        The scene cannot be built, or an argument is not usable.

    """

    def __init__(self, scene: Scene | str | Path, hold: int = 1):
        check_count('hold', hold)
        self.scene, _ = resolve(scene if isinstance(scene, Scene) else load_scene(scene))
        parts = self.scene.parts().copy()
        check_effects(parts.effects, parts.integrator)
        if parts.hamiltonian.rotations:
            raise UnsupportedSystem(f'{self.scene.name} has coordinates that turn, whose steps '
                                    'under commands have no derivatives yet')
        self._h, self.hold = self.scene.known_step_size, int(hold)
        self._system = System(parts.hamiltonian, parts.effects, parts.integrator)
        self._acting = ActingEffects(self._system, parts.hamiltonian, parts.effects, self._h)
        self.hamiltonian, self.dimension = self._system.hamiltonian, parts.hamiltonian.dimension
        self.duration = self.hold * self._h
        takes = NUMBERS in self._system.motors.takes
        self.commands = self._system.motors.size if takes else 0
        self.inputs = list(self._system.motors.names) if takes else []
        self._places = self._acting.places if takes else np.zeros((0, self.dimension))
        n, method = self._system.kernel.dimension, self._system.integrator
        self._loop = Loop(follow_each, self._system.kernel, method)
        self._points = Point.empty(n), Point.empty(n)
        limit, empty = np.full(self.commands, np.inf), np.zeros((0, 0))
        self._free = Law(empty[None, None], empty[None], -limit, limit)
        self._memory = method.memory(n)
        self._derivative: tuple[Any, ...] | None = None
        self._push: Callable[..., int] | None = None

    @property
    def places(self) -> np.ndarray:
        """Return how each number of a command acts on each coordinate, shape (c, d)."""
        return self._places.copy()

    def __call__(self, z: ArrayLike, u: ArrayLike = (), time: float = 0.0) -> np.ndarray:
        """
        Return states after the steps, NaN where a step failed.

        Parameters
        ----------
        z : array_like, shape (..., 2 d)
            States (q, p).
        u : array_like, shape (..., c) or (c,)
            Commands.
        time : float, optional
            At which the steps begin, for forces that depend on it [s].

        """
        states, commands = self._checked(z, u)
        return self._advanced(states, commands, time, 1, self.hold)[:, 1].reshape(np.shape(z))

    def rollout(self, z: ArrayLike, u: ArrayLike, gains: ArrayLike | None = None,
                about: ArrayLike | None = None, limits: tuple[ArrayLike, ArrayLike] | None = None,
                time: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the states under N commands one after another, and these commands.

        Parameters
        ----------
        z : array_like, shape (2 d,) or (m, 2 d)
            First states.
        u : array_like, shape (m, N, c)
            Commands, each held as by a call.
        gains, about : array_like, shape (m, N, c, 2 d) and (m, N, 2 d), optional
            Feedback K (z - about) that is added to the commands; what broadcasts to that.
        limits : tuple of array_like, optional
            Least and largest commands, shape (c,) each.
        time : float, optional
            At the start [s].

        Returns
        -------
        tuple of np.ndarray, shape (m, N + 1, 2 d) and (m, N, c)
            States are NaN from a step that fails on.

        """
        commands = np.array(u, dtype=np.float64, ndmin=3)
        rows, count, _ = commands.shape
        states, _ = self._checked(np.broadcast_to(z, (rows, 2 * self.dimension)), commands[:, 0])
        law = self._free
        if gains is not None and about is not None:
            law = law._replace(gains=_filled(gains, (*commands.shape, 2 * self.dimension)),
                               about=_filled(about, (rows, count, 2 * self.dimension)))
        if limits is not None:
            law = law._replace(low=_filled(limits[0], (self.commands,)),
                               high=_filled(limits[1], (self.commands,)))
        path = np.empty((rows, count + 1, 2 * self.dimension))
        path[:, 0] = states
        self._follow(path, commands, time, self.hold, law)
        return path, commands

    def derivatives(self, z: ArrayLike, u: ArrayLike = (), time: ArrayLike = 0.0
                    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Return states after the steps, and their exact derivatives by z and by u.

        Parameters
        ----------
        z, u
            As of a call.
        time : float or array_like, shape (m,), optional
            At which the steps begin, of each of m states [s].

        Returns
        -------
        tuple of np.ndarray, shape (..., 2 d), (..., 2 d, 2 d) and (..., 2 d, c)
            NaN where a step failed or has no derivative.

        Raises
        ------
        UnsupportedSystem
            The method is not differentiable yet; names those that are.

        """
        states, commands = self._checked(z, u)
        path = self._advanced(states, commands, time, self.hold, 1)
        tableau, work, sources, flow, x, first, unpadded = self._prepared()
        tangents = np.repeat(first[None], len(states), axis=0)
        state = self._system.effect_state
        times = np.broadcast_to(time, len(states))[:, None] + np.arange(self.hold) * self._h
        acting = Acting(state.clock, state.command, times, self._rows(commands), flow)
        arguments = (self._h, tableau, acting, self._acting.padded(path), sources, tangents, x,
                     work)
        if self._push is None:
            self._push = entry_of(push_each, self._system.kernel, *arguments)
        self._push(self._system.kernel, *arguments)
        by = tangents[:, :, unpadded].swapaxes(1, 2)
        shape, n = np.shape(z), 2 * self.dimension
        return (path[:, -1].reshape(shape), by[..., :n].reshape(*shape, n),
                by[..., n:].reshape(*shape, self.commands))

    def field(self, z: ArrayLike, u: ArrayLike = (), time: float = 0.0) -> np.ndarray:
        """Return z' of one state, shape (2 d,), under a command, shape (c,)."""
        q, p, d = *self._enter(z, u, time), self.dimension
        dH_dq, dH_dp = np.empty((2, q.size))
        self._system.kernel.gradient(self._system.kernel.parameters, q, p, dH_dq, dH_dp)
        return np.concatenate([dH_dp[:d], -dH_dq[:d] - self._acting.rates * p[:d]])

    def field_derivatives(self, z: ArrayLike, u: ArrayLike = (), time: float = 0.0
                          ) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives of z' by z, (2 d, 2 d), and by u, (2 d, c)."""
        q, p, d = *self._enter(z, u, time), self.dimension
        by_z, kernel = np.empty((2 * d, 2 * d)), self._system.kernel
        for column, unit in enumerate(np.eye(2 * d)):
            v_q, v_p = (np.append(half, np.zeros(q.size - d)) for half in np.split(unit, 2))
            along_q, along_p = np.empty((2, q.size))
            kernel.hessian_vector(kernel.parameters, q, p, v_q, v_p, along_q, along_p)
            by_z[:, column] = np.concatenate(
                [along_p[:d], -along_q[:d] - self._acting.rates * unit[d:]])
        return by_z, np.vstack([np.zeros((d, self.commands)), self._places.T])

    def _enter(self, z: ArrayLike, u: ArrayLike, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Make a command act from a time on; return q and p with the channels of forces."""
        states, commands = self._checked(z, u)
        state = self._system.effect_state
        state.clock[:] = time, 0.0
        state.command[:] = self._rows(commands)[0]
        q, p = np.split(self._acting.padded(states[0]), 2)
        return q, p

    def _checked(self, z: ArrayLike, u: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Return states, (m, 2 d), and commands, (m, c), or raise ValueError."""
        states, commands = np.asarray(z, dtype=np.float64), np.asarray(u, dtype=np.float64)
        if states.shape[-1:] != (2 * self.dimension,):
            raise ValueError(f'z has shape {states.shape}, expected (..., {2 * self.dimension})')
        expected = (*states.shape[:-1], self.commands)
        if commands.shape not in (expected, expected[-1:]):
            raise ValueError(f'u has shape {commands.shape}, expected {expected} or '
                             f'{expected[-1:]}')
        rows = np.ascontiguousarray(states).reshape(-1, 2 * self.dimension)
        return rows, np.broadcast_to(commands, expected).reshape(len(rows), self.commands)

    def _rows(self, commands: np.ndarray) -> np.ndarray:
        """Return commands as forces find them, which do not expire."""
        rows = np.empty((len(commands), self._system.effect_state.command.size))
        rows[:, :-1], rows[:, -1] = commands @ self._places, np.inf
        return rows

    def _advanced(self, states: np.ndarray, commands: np.ndarray, time: ArrayLike, count: int,
                  hold: int) -> np.ndarray:
        """Return the states around so many holds of a command, shape (m, count + 1, 2 d)."""
        path = np.empty((len(states), count + 1, states.shape[1]))
        path[:, 0] = states
        self._follow(path, np.repeat(commands[:, None], count, axis=1), time, hold, self._free)
        return path

    def _follow(self, path: np.ndarray, commands: np.ndarray, time: ArrayLike, hold: int,
                law: Law) -> None:
        """Fill the states after the first ones, and what the law makes of commands."""
        state, times = self._system.effect_state, np.empty(len(path))
        times[:] = time
        self._loop(self._h, hold, commands.shape[1], *self._points, self._memory, times,
                   state.clock, state.command, self._places, law, commands, path)

    def _prepared(self) -> tuple[Any, ...]:
        """Return what derivatives need besides states and commands; made once."""
        if self._derivative is None:
            tableau = differentiable_tableau(self.hamiltonian, self._system.method)
            n, d, c = self._system.kernel.dimension, self.dimension, self.commands
            check_unknowns(self._system.method, tableau, n)
            s, identity = tableau.stages, self._acting.padded(np.eye(2 * d))
            sources = np.zeros((2 * d + c, 2, s, n))
            # A force lessens H_q.
            sources[2 * d:, 0, :, :d] = -self._places[:, None]
            flow = self._acting.acting(slice(0, 1), 0, np.zeros(1), 1).flow
            self._derivative = (
                tableau, StageWork.empty(s, n), sources.reshape(2 * d + c, -1), flow,
                np.zeros(2 * s * n), np.vstack([identity, np.zeros((c, 2 * n))]),
                np.r_[:d, n:n + d])
        return self._derivative


def _filled(values: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    """Return an array of its own of this shape, filled with values that broadcast to it."""
    array = np.empty(shape)
    array[:] = values
    return array
