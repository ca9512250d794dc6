# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The trajectories of a sweep: a block of neighbours at a time, each failure a row."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any
import warnings

from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.files.yaml_text import one_line
from hnn_vi_ros.guards.base import Alarm
from hnn_vi_ros.guards.cost import CostGuard
from hnn_vi_ros.guards.energy import EnergyGuard
from hnn_vi_ros.guards.rescue import RescueGuard
from hnn_vi_ros.guards.watch import show_many, Watch
from hnn_vi_ros.phase_space import Trajectory
from hnn_vi_ros.run.ensemble import record_one
from hnn_vi_ros.run.recorders import recorders
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.dense_step import whole_steps
from hnn_vi_ros.simulation.events import watched
from hnn_vi_ros.simulation.system import System
from hnn_vi_ros.sweeps.measures import measure, Parts, Reducer
from hnn_vi_ros.sweeps.plan import Plan
import numpy as np

# What a trajectory may fail by; anything else is a fault of this package, and ends the sweep.
_FAILURES = HnnViRosError, ValueError, ArithmeticError
# Scenes that are kept made: those of the last parameters.
_KEPT = 4
_State = tuple[np.ndarray, np.ndarray]


@dataclass
class Outcome:
    """
    What became of one trajectory.

    Parameters
    ----------
    index : int
        Its number.
    values : list
        Of the keys that vary.
    t, q, p, energy : np.ndarray, shape (n,), (n, d), (n, d), (n,)
        The samples that are kept; NaN of one that failed.
    alarms : list of str
        What guards found.
    failure : str or None
        Why there is no result.
    measured : dict
        Statistics, and what the reduction returned, by column.

    """

    index: int
    values: list[Any]
    t: np.ndarray
    q: np.ndarray
    p: np.ndarray
    energy: np.ndarray
    alarms: list[str] = field(default_factory=list)
    failure: str | None = None
    measured: dict[str, Any] = field(default_factory=dict)


class Runner:
    """
    Makes the trajectories of a sweep.

    What becomes of a trajectory depends on the block that it is in, since the equations of a
    block are solved until each of its trajectories has converged. So blocks are cut by index,
    and nothing of one is known to another.

    Parameters
    ----------
    plan : Plan
        Of the sweep.

    Raises
    ------
    SceneError
        Its reduction cannot be imported.

    """

    def __init__(self, plan: Plan):
        self._plan, self._made = plan, dict[str, _Made]()
        sweep = plan.sweep
        self._reducer = None if sweep.reduction is None else Reducer(
            sweep.reduction, str(plan.folder.resolve()))

    def check(self) -> None:
        """
        Raise what the first trajectory, and the last, fail by where their scene is made.

        Raises
        ------
        HnnViRosError, ValueError
            Neither can be made: a value that is none for its key, such as of another type.

        """
        problems = []
        for index in (0, self._plan.count - 1):
            columns = self._plan.values(range(index, index + 1))
            row = tuple(column[0] for column in columns)
            try:
                _Made(self._plan, row).state(row)
                return
            except _FAILURES as problem:
                problems.append(problem)
        raise problems[0]

    def shard(self, shard: int) -> Iterator[list[Outcome]]:
        """Yield the blocks of a shard."""
        indices = self._plan.indices(shard)
        columns = self._plan.values(indices)
        for first in range(0, len(indices), self._plan.block):
            part = slice(first, first + self._plan.block)
            rows = list(zip(*(column[part] for column in columns), strict=True)) if columns else \
                [()] * len(indices[part])
            with warnings.catch_warnings():
                # What is to be said of the scene was said when the sweep began.
                warnings.simplefilter('ignore')
                yield self._block(indices[part], rows)

    def _block(self, indices: range, rows: Sequence[tuple[Any, ...]]) -> list[Outcome]:
        """Return what becomes of neighbours: those of one scene step together."""
        groups: dict[str, list[int]] = {}
        for k, row in enumerate(rows):
            groups.setdefault(self._scene_key(row), []).append(k)
        found: dict[int, Outcome] = {}
        for key, members in groups.items():
            found.update(zip(members, self._group(
                key, [indices[k] for k in members], [rows[k] for k in members]), strict=True))
        return [found[k] for k in range(len(rows))]

    def _scene_key(self, row: tuple[Any, ...]) -> str:
        """Return what tells scenes apart: all values but those of the initial state."""
        return repr([value for part, value in zip(self._plan.parts, row, strict=True)
                     if part[0] != 'initial_state'])

    def _group(self, key: str, indices: list[int], rows: list[tuple[Any, ...]]) -> list[Outcome]:
        try:
            made = self._made.pop(key, None) or _Made(self._plan, rows[0])
        except _FAILURES as problem:
            return [self._failed(index, row, problem)
                    for index, row in zip(indices, rows, strict=True)]
        self._made[key] = made
        while len(self._made) > _KEPT:
            del self._made[next(iter(self._made))]
        if made.lockstep and len(rows) > 1:
            try:
                states = [made.state(row) for row in rows]
                found = made.together(indices, states)
                return [self._told(made, *one) for one in zip(indices, rows, found, strict=True)]
            except _FAILURES:
                # Of whichever of them: each by itself.
                made.forget()
        outcomes = []
        for index, row in zip(indices, rows, strict=True):
            try:
                outcomes.append(self._told(made, index, row, made.alone(index, made.state(row))))
            except _FAILURES as problem:
                made.forget()
                outcomes.append(self._failed(index, row, problem))
        return outcomes

    def _told(self, made: '_Made', index: int, row: tuple[Any, ...], found: Trajectory
              ) -> Outcome:
        sweep = self._plan.sweep
        measured = measure(sweep.statistics, found, made.parts, sweep.duration)
        if self._reducer is not None:
            measured |= self._reducer(found)
        kept = slice(None) if sweep.keep == 'samples' else slice(-1, None)
        return Outcome(
            index, list(row), found.t[kept], found.q[kept], found.p[kept], found.energy[kept],
            [alarm.kind for alarm in found.alarms], None, measured)

    def _failed(self, index: int, row: tuple[Any, ...], problem: Exception) -> Outcome:
        nothing = np.full((1, self._plan.hamiltonian.dimension), np.nan)
        t = np.array([getattr(problem, 't', np.nan)])
        return Outcome(index, list(row), t, nothing, nothing, np.full(1, np.nan),
                       failure=one_line(problem) or type(problem).__name__)


class _Made:
    """A scene with its values, and simulations of it."""

    def __init__(self, plan: Plan, row: tuple[Any, ...]):
        self._plan = plan
        values = dict(zip(plan.parts, row, strict=True))
        scene = plan.scene_of(
            {part: value for part, value in values.items() if part[0] != 'initial_state'})
        hamiltonian, integrator = scene.create_hamiltonian(), scene.create_integrator()
        effects = scene.create_effects()
        system = System(hamiltonian, effects, integrator)
        self.parts = Parts(scene, hamiltonian, system.hamiltonian, integrator, effects)
        self.lockstep = system.lockstep and not scene.events
        self._state = (np.array(scene.initial_state.q), np.array(scene.initial_state.p))
        steps, _ = whole_steps(plan.sweep.duration, scene.known_step_size)
        self._every = plan.sweep.every or max(steps, 1)
        if steps // self._every + 2 > 2 * plan.samples:
            raise HnnViRosError(f'step_size = {scene.known_step_size:g} s makes more than twice '
                                'the samples of the scene as it is, for which memory is')
        self._simulations: dict[int, Any] = {}

    def state(self, row: tuple[Any, ...]) -> _State:
        """Return q and p, shape (d,) each, as a row has them."""
        state = {'q': self._state[0].copy(), 'p': self._state[1].copy()}
        for part, value in zip(self._plan.parts, row, strict=True):
            if part[0] != 'initial_state':
                continue
            half = str(part[1])
            if len(part) == 3:
                state[half][part[2]] = value
            else:
                state[half] = np.array(value, dtype=np.float64)
        return state['q'], state['p']

    def forget(self) -> None:
        """Drop simulations, of which one broke off."""
        self._simulations.clear()

    def together(self, indices: list[int], states: list[_State]) -> list[Trajectory]:
        """Return the trajectories of a block, in lockstep."""
        q, p = (np.array(half) for half in zip(*states, strict=True))
        simulation = self._begin(q, p, indices[0])
        watch = Watch(simulation, None, kinds=(EnergyGuard, CostGuard, RescueGuard))
        parts = [(q[None], p[None])]
        t, takers = recorders(
            simulation, self._plan.sweep.duration, self._every, None, None, watch)
        parts += [take() for take in takers]
        q_all, p_all = (np.vstack(halves) for halves in zip(*parts, strict=True))
        alarms: list[list[Alarm]] = [list(watch.alarms) for _ in indices]
        energy = show_many(simulation, t / simulation.step_size, q_all, p_all, alarms)
        return [Trajectory(t, q_all[:, k], p_all[:, k], energy[:, k], tuple(own))
                for k, own in enumerate(alarms)]

    def alone(self, index: int, state: _State) -> Trajectory:
        """Return one trajectory, with noise and events of its own."""
        return record_one(self._begin(*state, index), self._plan.sweep.duration, self._every)

    def _begin(self, q: np.ndarray, p: np.ndarray, stream: int) -> Any:
        """Return a simulation in an initial state; a stream of noise for each index."""
        simulation = self._simulations.get(q.ndim)
        if simulation is None:
            scene, hamiltonian, _, integrator, effects = self.parts
            simulation = watched(Simulation(
                hamiltonian.copy(), integrator, scene.known_step_size, q, p, effects,
                scene.on_failure), scene)
            self._simulations[q.ndim] = simulation
        simulation.restart(q, p, stream=stream)
        return simulation
