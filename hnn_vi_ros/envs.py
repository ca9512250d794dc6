# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Gymnasium environments: a scene whose external forces are the actions."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from hnn_vi_ros.effects import Commanded, EffectError, NUMBERS
from hnn_vi_ros.errors import StateError, StepFailure, StoppedByEvent
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import (
    build_at, changed_parts, check_count, check_numbers, Simulation, usable_processors, watched,
    WatchedSimulation)
import numpy as np
from numpy.typing import ArrayLike

__all__ = ['SceneEnv', 'SceneVectorEnv', 'Transition', 'check_action']


class Transition(NamedTuple):
    """
    Result of one action.

    Parameters
    ----------
    t : float
        Simulated time at the end [s].
    q_before, p_before : np.ndarray, shape (d,)
        State before the action.
    action : np.ndarray, shape (c,)
        External force [N] or [N m].
    q, p : np.ndarray, shape (d,)
        State at the end: if an event ended the run, the state at the event; if a step failed, the
        last valid one.
    ended : str or None
        Event or failure that ended the run, or None.

    """

    t: float
    q_before: np.ndarray
    p_before: np.ndarray
    action: np.ndarray
    q: np.ndarray
    p: np.ndarray
    ended: str | None


_NEEDS_RESET = 'the episode has ended, or none has started: call reset()'
# Information on an action in addition to its transition, by name.
_Info = dict[str, Any]
Step = tuple[np.ndarray, float, bool, bool, _Info]


class SceneEnv(gymnasium.Env):
    """
    A scene as an environment: an action is the external force, an observation is (q, p).

    An action is held over its steps, which equal those in ``Simulation`` bit by bit. An event of
    the scene with ``then: stop`` and a failed step terminate the episode: ``info`` then contains
    ``event`` or ``failure``. Other events of the scene are in ``info['events']``.

    Parameters
    ----------
    scene : Scene, str or Path
        Scene from ``load_scene``, or its argument: name of a shipped scene, or a YAML file.
    reward : callable
        Function that returns the reward of a Transition.
    every : int, optional
        Number of simulation steps per action.
    limits : float or sequence of float, shape (c,), optional
        Maximum size of each component of an action, > 0 [N] or [N m]; no limit by default.
    max_episode_steps : int, optional
        Number of actions after which an episode is truncated.
    initial_state : callable, optional
        Function of the environment's ``np.random.Generator`` that returns q and p; by default each
        episode starts at the scene's initial state.
    effects : sequence of mapping, optional
        Effects that replace the scene's, each as in YAML: ``{'kind': 'external_force',
        'coordinates': ['angle']}``.

    Attributes
    ----------
    over : bool
        True if the episode has ended, or none has been started.

    Raises
    ------
    HnnViRosError
        The scene cannot be built.
    ValueError, TypeError
        An argument is invalid, or the scene has no effect that takes commands.

    References
    ----------
    M. Towers et al., Gymnasium: A Standard Interface for Reinforcement Learning Environments,
    arXiv:2407.17032, 2024.

    """

    metadata: dict[str, Any] = {'render_modes': []}

    def __init__(self, scene: Scene | str | Path, reward: Callable[[Transition], float], *,
                 every: int = 1, limits: ArrayLike = np.inf,
                 max_episode_steps: int | None = None,
                 initial_state: Callable[[np.random.Generator], tuple[ArrayLike, ArrayLike]]
                 | None = None, effects: Sequence[Mapping[str, Any]] | None = None):
        check_count('every', every)
        if max_episode_steps is not None:
            check_count('max_episode_steps', max_episode_steps)
        self._reward, self._every, self._most = reward, int(every), max_episode_steps
        self._initial_state = initial_state
        # A separate copy: vector environments modify it.
        self.metadata = dict(self.metadata)
        self._parts = changed_parts(scene, effects=effects)
        self._scene = self._parts.scene
        self._check_commands()
        self._simulation = self._made()
        # Compile now, not in the first step of an episode.
        self._simulation.compile()
        self.over, self._taken = True, 0
        self._ahead: tuple[Transition, _Info] | None = None
        self.action_space = gymnasium.spaces.Box(*_bounds(
            limits, self._simulation.command_size), dtype=np.float64)
        size = self._simulation.q.size + self._simulation.p.size
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float64)

    def copy(self, *, shared: bool = False) -> 'SceneEnv':
        """
        Return a copy of the environment before its first episode.

        Parameters
        ----------
        shared : bool, optional
            True to share the simulation of this environment, in the same thread.

        """
        other = copy(self)
        if not shared:
            other._simulation = other._made()
        other.over, other._ahead = True, None
        # A separate generator, with a random seed until reset() gets one.
        other.np_random, _ = gymnasium.utils.seeding.np_random()
        return other

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None
              ) -> tuple[np.ndarray, _Info]:
        """
        Start an episode; the seed determines its initial state and its noise.

        Raises
        ------
        StateError
            The initial state is invalid.

        """
        super().reset(seed=seed)
        if options:
            raise ValueError(f'options = {options!r:.80}: no options exist; the argument '
                             'initial_state of the environment sets the initial state')
        state = self._scene.initial_state
        q, p = (state.q, state.p) if self._initial_state is None else \
            self._initial_state(self.np_random)
        simulation = self._simulation
        try:
            simulation.restart(q, p, stream=int(self.np_random.integers(2**63)))
        except (StepFailure, EffectError) as problem:
            # gymnasium reconstructs the error of another process from its message only.
            raise StateError(str(problem)) from problem
        self.over, self._taken, self._ahead, self._row = False, 0, None, simulation.row
        return np.concatenate([simulation.q, simulation.p]), {}

    def step(self, action: ArrayLike) -> Step:
        """Apply an action: advance the simulation by the steps of the action."""
        if self.over:
            raise gymnasium.error.ResetNeeded(_NEEDS_RESET)
        if self._ahead is None:
            self.begin([self], check_action(action, self.action_space)[None])
        assert self._ahead is not None, 'begin() has computed the steps'
        (transition, info), self._ahead = self._ahead, None
        self._taken += 1
        terminated = transition.ended is not None
        truncated = self._most is not None and self._taken >= self._most
        self.over = terminated or truncated
        return (np.concatenate([transition.q, transition.p]), float(self._reward(transition)),
                terminated, truncated, info)

    def begin(self, envs: Sequence['SceneEnv'], actions: np.ndarray) -> None:
        """
        Compute actions ahead of ``step``, for environments that share this simulation.

        Parameters
        ----------
        envs : sequence of SceneEnv
            Environments; those whose episode has ended are skipped.
        actions : np.ndarray, shape (len(envs), c)
            Actions from ``check_action``.

        """
        live = [k for k, env in enumerate(envs) if not env.over]
        if not live:
            return
        simulation, taken = self._simulation, np.zeros(len(live))
        if not isinstance(simulation, WatchedSimulation):
            rows = np.array([envs[k]._row for k in live])
            path, taken = simulation.follow(rows, actions[live, None], self._every)
            q, p = np.split(path[..., :simulation.q.size + simulation.p.size],
                            [simulation.q.size], axis=2)
            times = (rows[:, 1] * simulation.step_size).tolist()
        for i, k in enumerate(live):
            if taken[i] < self._every:
                envs[k]._begin_alone(actions[k])
                continue
            envs[k]._row = rows[i]
            envs[k]._ahead = Transition(
                times[i], q[i, 0], p[i, 0], actions[k], q[i, 1], p[i, 1], None), {}

    def _begin_alone(self, action: np.ndarray) -> None:
        """Compute an action with individual steps, in which events or failures may occur."""
        simulation = self._simulation
        simulation.put(self._row)
        before = simulation.q.copy(), simulation.p.copy()
        info: _Info = {}
        ended: str | None = None
        at_event: tuple[float, np.ndarray, np.ndarray] | None = None
        try:
            simulation.set_command(action.tolist())
            simulation.advance(self._every)
        except StoppedByEvent as stop:
            at_event = stop.event.t, stop.event.q, stop.event.p
            info['event'] = ended = str(stop.event)
        except StepFailure as failure:
            info['failure'] = ended = str(failure)
        if isinstance(simulation, WatchedSimulation) and (events := [
                str(event) for event in simulation.take_events() if not event.stops]):
            info['events'] = events
        t, q, p = at_event or (simulation.time, simulation.q.copy(), simulation.p.copy())
        self._ahead, self._row = (Transition(t, *before, action, q, p, ended), info), \
            simulation.row

    def _made(self) -> Simulation | WatchedSimulation:
        scene, state = self._scene, self._scene.initial_state
        with scene.placed('initial_state'):
            simulation = build_at(self._parts, state.q, state.p)
        return watched(simulation, scene)

    def _check_commands(self) -> None:
        """Raise ValueError if no effect takes commands, or a time-out is too short."""
        holds = [choice.timeout for choice, effect in zip(
            self._scene.effects, self._parts.effects, strict=False)
            if isinstance(effect, Commanded) and NUMBERS in effect.takes]
        if not holds:
            raise ValueError(
                f'{self._scene.name} takes no commands, which are the actions: add an effect, '
                "such as effects=[{'kind': 'external_force', 'coordinates': [...]}]")
        lasts = self._every * self._scene.known_step_size
        if lasts > min(holds):
            raise ValueError(f'an action lasts {lasts:g} s, every = {self._every} steps, but a '
                             f'command of the scene expires after {min(holds):g} s: increase the '
                             'timeout of its external_force')


class SceneVectorEnv(SyncVectorEnv):
    """
    Many environments of one scene, stepped together.

    Results and resets equal gymnasium's ``SyncVectorEnv`` of ``SceneEnv`` bit by bit. The
    environments of a thread step in one compiled loop that releases Python's lock, so threads pay
    off if actions last several steps.

    Parameters
    ----------
    scene, reward
        See SceneEnv.
    num_envs : int
        Number of environments.
    threads : int, optional
        Number of threads, by default that of the processors.
    autoreset_mode : AutoresetMode, optional
        Time of the automatic reset: by default the step after the last one of an episode.
    **settings
        See SceneEnv: every, limits, max_episode_steps, initial_state, effects.

    Raises
    ------
    HnnViRosError, ValueError, TypeError
        See SceneEnv.

    """

    def __init__(self, scene: Scene | str | Path, num_envs: int,
                 reward: Callable[[Transition], float], *, threads: int | None = None,
                 autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP, **settings: Any):
        check_count('num_envs', num_envs)
        if threads is not None:
            check_count('threads', threads)
        first = SceneEnv(scene, reward, **settings)
        self._workers = min(threads or usable_processors(), num_envs)
        shares = np.array_split(np.arange(num_envs), self._workers)
        leaders = [first, *(first.copy() for _ in shares[1:])]
        made = iter([env for leader, share in zip(leaders, shares, strict=True)
                     for env in (leader, *(leader.copy(shared=True) for _ in share[1:]))])
        super().__init__([partial(next, made)] * num_envs, autoreset_mode=autoreset_mode)
        self._shares = [slice(int(share[0]), int(share[-1]) + 1) for share in shares]
        self._pool = ThreadPoolExecutor(self._workers)

    def step(self, actions: ArrayLike) -> tuple[np.ndarray, ...]:
        """Take an action in each environment; see gymnasium's VectorEnv."""
        # Check all actions before any environment moves.
        checked = check_action(actions, self.action_space)
        if self.autoreset_mode is AutoresetMode.DISABLED and any(env.over for env in self.envs):
            raise gymnasium.error.ResetNeeded(_NEEDS_RESET)
        # Consume the iterator, so that a failure in a thread is raised here.
        list(self._pool.map(self._begin, self._shares, [checked[own] for own in self._shares]))
        return super().step(checked)

    def close_extras(self, **options: Any) -> None:
        """Stop the threads."""
        super().close_extras(**options)
        self._pool.shutdown()

    def _begin(self, share: slice, actions: np.ndarray) -> None:
        envs = self.envs[share]
        envs[0].begin(envs, actions)


def check_action(action: ArrayLike, space: Any) -> np.ndarray:
    """
    Return one or several environments' actions as a new float64 array.

    Parameters
    ----------
    action : array_like, shape of the space
        Action given by the caller [N] or [N m].
    space : gymnasium.spaces.Box
        Space of actions.

    Raises
    ------
    ValueError, TypeError
        The shape is wrong, or a number is not finite or beyond the limits.

    """
    array = check_numbers('action', action)
    if array.shape != space.shape:
        raise ValueError(f'action has shape {array.shape}, expected {space.shape}')
    if not (np.isfinite(array) & (array >= space.low) & (array <= space.high)).all():
        text = ' '.join(str(array.tolist()).split())
        raise ValueError(f'action = {text:.80} must be finite, and within the limits '
                         f'{np.ravel(space.high)[:array.shape[-1]].tolist()}; the gymnasium '
                         'wrapper ClipAction clips the actions of a policy')
    return array


def _bounds(limits: ArrayLike, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the minimum and the maximum action, shape (c,); raise an error if invalid."""
    largest = check_numbers('limits', limits)
    if largest.shape not in ((), (size,)) or not (largest > 0.0).all():
        raise ValueError(f'limits = {largest.tolist()} must be a positive number, or a list of '
                         f'{size}, one for each component of an action')
    high = np.broadcast_to(largest, size).copy()
    return -high, high
