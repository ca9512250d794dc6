# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Simulate trajectories of a sweep in blocks, with statistics; a failure becomes a row."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
import math
from typing import Any, NamedTuple, TYPE_CHECKING
import warnings

from hnn_vi_ros.errors import HnnViRosError, listed, StepFailure
from hnn_vi_ros.files import one_line
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.scene import load_code, Parts, with_values
from hnn_vi_ros.simulation import (
    Alarm, build_at, drawn, judge_many, MAX_MEASURED_STEPS, measure_alone, PathReport,
    record_block, record_one, Schedule, System, time_between_motions, Trajectory, watched,
    whole_steps)
from hnn_vi_ros.sweeps.definition import Reduction
from hnn_vi_ros.sweeps.plan import SweepPlan
import numpy as np

if TYPE_CHECKING:
    from hnn_vi_ros.simulation import BatchSimulation


def measure(statistics: Sequence[str], trajectory: Trajectory, parts: Parts,
            joined: Hamiltonian, duration: float) -> dict[str, Any]:
    """
    Return statistics of a trajectory by column.

    Parameters
    ----------
    statistics : sequence of str
        Names of the statistics.
    trajectory : Trajectory
        Trajectory including the initial state.
    parts : Parts
        Parts of its scene.
    joined : Hamiltonian
        H including the potentials and fields among the effects.
    duration : float
        Time over which the chaos statistic is evaluated [s].

    Raises
    ------
    HnnViRosError, ValueError
        A statistic cannot be computed from this trajectory.

    """
    found: dict[str, Any] = {}
    for name in statistics:
        match name:
            case 'energy_band':
                found[name] = float(np.ptp(trajectory.energy))
            case 'out_of_box_time':
                # An interval counts if the sample at its end is outside.
                outside = joined.outside(trajectory.q, trajectory.p)[1:]
                found[name] = float(np.diff(trajectory.t)[outside].sum())
            case 'event_times':
                found[name] = [event.t for event in trajectory.events]
                found['events'] = [event.when for event in trajectory.events]
            case 'path_error':
                error = trajectory.path_error
                found[name] = math.nan if error is None else error.largest
            case 'lyapunov_time':
                h = parts.scene.known_step_size
                found[name] = time_between_motions(
                    parts.hamiltonian, parts.effects, parts.integrator, h, trajectory.q[0],
                    trajectory.p[0], max(1024, duration / h), parts.scene.on_failure)
    return found


def reduce(reduction: Reduction, function: Callable[[Trajectory], Any], trajectory: Trajectory
           ) -> dict[str, float]:
    """
    Return the results of the user's reduction of a trajectory, by column.

    Parameters
    ----------
    reduction : Reduction
        Name and columns of the reduction.
    function : callable
        User's function; it gets read-only arrays.
    trajectory : Trajectory
        Trajectory including the initial state.

    Raises
    ------
    HnnViRosError
        The function fails, or its result has the wrong form.

    """
    name, views = reduction.function, {
        key: getattr(trajectory, key).view() for key in ('t', 'q', 'p', 'energy')}
    for view in views.values():
        view.flags.writeable = False
    try:
        found = function(replace(trajectory, **views))
        numbers = {column: float(found[column]) for column in reduction.columns}
        more = set(found) - set(numbers)
    except (Exception, SystemExit) as problem:  # noqa: B902  the user's code may raise any
        raise HnnViRosError(f'{name}: {type(problem).__name__}: {one_line(problem)}') from problem
    if more:
        raise HnnViRosError(f'{name}: returned {listed(sorted(more))} in addition to its columns; '
                            'add them to columns')
    return numbers


# Errors that make a trajectory fail; any other is a bug in this package and ends the sweep.
FAILURES = HnnViRosError, ValueError, ArithmeticError
# Number of scenes cached; the least recently used one is dropped first.
_MAX_CACHED_SCENES = 4
_State = tuple[np.ndarray, np.ndarray]


class Rows(NamedTuple):
    """
    Rows of several trajectories.

    Parameters
    ----------
    indices : list of int
        Indices of the trajectories.
    values : list of tuple
        Values of the varied keys for each trajectory.
    length : int
        Number of samples kept of each trajectory.
    t, q, p, energy : np.ndarray, shape (n,), (n, d), (n, d), (n,)
        Samples of one trajectory after another; NaN for a failed one.
    alarms : list of list of str
        Alarms of the guards for each trajectory.
    measured : dict
        Statistics and results of the reduction by column; only for a single trajectory.
    failure : str or None
        Reason for which there is no result.

    """

    indices: list[int]
    values: list[tuple[Any, ...]]
    length: int
    t: np.ndarray
    q: np.ndarray
    p: np.ndarray
    energy: np.ndarray
    alarms: list[list[str]]
    measured: dict[str, Any] = {}
    failure: str | None = None


class Runner:
    """
    Simulation of the trajectories of a sweep.

    The result of a trajectory depends on its block, because the equations of a block are iterated
    until all of its trajectories have converged. Blocks are therefore cut by index, and share no
    state.

    Parameters
    ----------
    plan : SweepPlan
        Plan of the sweep.

    Raises
    ------
    SceneError
        The reduction cannot be imported.

    """

    def __init__(self, plan: SweepPlan):
        self._plan, self._made = plan, dict[str, CachedScene]()
        sweep = plan.sweep
        self._of_scene = [k for k, part in enumerate(plan.parts) if part[0] != 'initial_state']
        self._kept = slice(None) if sweep.keep == 'samples' else slice(-1, None)
        self._measures = bool(sweep.statistics or sweep.reduction)
        self._function: Any = sweep.reduction and load_code(
            sweep.reduction.function, 'reduction', str(plan.folder.resolve()))

    def check(self) -> None:
        """
        Make the scenes of the first and the last trajectory, and raise the error if both fail.

        Raises
        ------
        HnnViRosError, ValueError
            Neither can be made; for example a value has the wrong type for its key.

        """
        problems = []
        for index in (0, self._plan.count - 1):
            columns = self._plan.values(range(index, index + 1))
            row = tuple(column[0] for column in columns)
            try:
                CachedScene(self._plan, row).states([row])
                return
            except FAILURES as problem:
                problems.append(problem)
        raise problems[0]

    def shard(self, shard: int) -> Iterator[list[Rows]]:
        """Yield the blocks of a shard."""
        indices = self._plan.indices(shard)
        columns = self._plan.values(indices)
        for first in range(0, len(indices), self._plan.block):
            part = slice(first, first + self._plan.block)
            rows = list(zip(*(column[part] for column in columns), strict=True)) if columns else \
                [()] * len(indices[part])
            with warnings.catch_warnings():
                # The warnings about the scene were already raised when the sweep started.
                warnings.simplefilter('ignore')
                yield self._block(indices[part], rows)

    def _block(self, indices: range, rows: Sequence[tuple[Any, ...]]) -> list[Rows]:
        """Return the rows of a block; trajectories that share a scene step together."""
        groups: dict[str, list[int]] = {}
        for k, row in enumerate(rows):
            # The cache key of a scene contains all values outside the initial state.
            groups.setdefault(repr([row[part] for part in self._of_scene]), []).append(k)
        return [found for key, members in groups.items() for found in self._group(
            key, [indices[k] for k in members], [rows[k] for k in members])]

    def _group(self, key: str, indices: list[int], rows: list[tuple[Any, ...]]) -> list[Rows]:
        try:
            made = self._made.pop(key, None) or CachedScene(self._plan, rows[0])
            self._made[key] = made
            while len(self._made) > _MAX_CACHED_SCENES:
                del self._made[next(iter(self._made))]
            if self._plan.device is not None:
                return self._on_device(made, indices, rows)
        except FAILURES as problem:
            return [self._failed(index, row, problem)
                    for index, row in zip(indices, rows, strict=True)]
        if made.batched and len(rows) > 1:
            try:
                return self._kept_rows(made, indices, rows, made.together(indices, rows))
            except FAILURES:
                # Any of them may have failed: simulate each one alone.
                made.forget()
        return [self._try(made, index, row, partial(made.alone, index, row))
                for index, row in zip(indices, rows, strict=True)]

    def _on_device(self, made: 'CachedScene', indices: list[int], rows: list[tuple[Any, ...]]
                   ) -> list[Rows]:
        """Return the rows of trajectories simulated on a device; failures are per trajectory."""
        found, failures = made.on_device(rows)
        left = [k for k in range(len(rows)) if k not in failures]
        taken = [] if not left else self._kept_rows(
            made, [indices[k] for k in left], [rows[k] for k in left], replace(
                found, q=found.q[:, left], p=found.p[:, left], energy=found.energy[:, left],
                alarms=tuple(found.alarms[k] for k in left)))
        return taken + [self._failed(indices[k], rows[k], problem)
                        for k, problem in failures.items()]

    def _kept_rows(self, made: 'CachedScene', indices: list[int], rows: list[tuple[Any, ...]],
                   found: Trajectory) -> list[Rows]:
        """Return the rows of trajectories simulated together, measured one by one if requested."""
        if self._measures:
            return [self._try(made, index, row, partial(found.select, k))
                    for k, (index, row) in enumerate(zip(indices, rows, strict=True))]
        kept = self._kept
        q, p = (half[kept].swapaxes(0, 1).reshape(-1, half.shape[-1])
                for half in (found.q, found.p))
        t = found.t[kept]
        return [Rows(indices, rows, len(t), np.tile(t, len(rows)), q, p,
                     found.energy[kept].T.ravel(), [_kinds(own) for own in found.alarms])]

    def _try(self, made: 'CachedScene', index: int, row: tuple[Any, ...],
             find: Callable[[], Trajectory]) -> Rows:
        """Return the row of one trajectory with its statistics, or with the reason it failed."""
        sweep, kept = self._plan.sweep, self._kept
        try:
            found = find()
            measured = measure(sweep.statistics, found, made.parts, made.joined, sweep.duration)
            if sweep.reduction is not None:
                measured |= reduce(sweep.reduction, self._function, found)
        except FAILURES as problem:
            made.forget()
            return self._failed(index, row, problem)
        return Rows([index], [row], len(found.t[kept]), found.t[kept], found.q[kept],
                    found.p[kept], found.energy[kept], [_kinds(found.alarms)], measured)

    def _failed(self, index: int, row: tuple[Any, ...], problem: Exception) -> Rows:
        q, p = (np.full((1, len(names)), np.nan) for names in self._plan.names.values())
        t = np.array([getattr(problem, 't', np.nan)])
        return Rows([index], [row], 1, t, q, p, np.full(1, np.nan), [[]],
                    failure=one_line(problem) or type(problem).__name__)


class CachedScene:
    """A scene with the values of the axes, and its simulations."""

    def __init__(self, plan: SweepPlan, row: tuple[Any, ...]):
        self._plan = plan
        values = dict(zip(plan.parts, row, strict=True))
        scene = with_values(plan.scene, {
            part: value for part, value in values.items() if part[0] != 'initial_state'})
        self.parts = plan.made if scene is plan.scene else scene.parts()
        _, hamiltonian, integrator, effects = self.parts
        if scene.energy_by_cause:
            raise HnnViRosError(f'{scene.place("energy_by_cause")}: a sweep does not account for '
                                'the energy by cause; remove it, or use simulate_many')
        with scene.placed('initial_state'):
            system = System(hamiltonian, effects, integrator)
        self.joined = system.hamiltonian
        self.batched = system.batched and not scene.events
        self._state = {half: np.array(values) for half, values in (
            ('q', scene.initial_state.q), ('p', scene.initial_state.p))}
        steps, _ = whole_steps(plan.sweep.duration, scene.known_step_size)
        self._every = plan.sweep.every or max(steps, 1)
        if steps // self._every + 2 > 2 * plan.samples:
            raise HnnViRosError(f'step_size = {scene.known_step_size:g} s gives more than twice '
                                'the samples of the unchanged scene, for which memory is reserved')
        self._simulations: dict[str, Any] = {}
        if plan.device is not None:
            self._batch = self._make_batch(plan.device)

    def states(self, rows: list[tuple[Any, ...]]) -> _State:
        """Return q and p, shape (m, d) each, from rows."""
        state = {half: np.tile(values, (len(rows), 1)) for half, values in self._state.items()}
        for k, part in enumerate(self._plan.parts):
            if part[0] == 'initial_state':
                where: Any = np.s_[:, part[2]] if len(part) == 3 else np.s_[:]
                state[str(part[1])][where] = np.array([row[k] for row in rows], dtype=np.float64)
        return state['q'], state['p']

    def forget(self) -> None:
        """Drop the simulations after one of them failed."""
        self._simulations.clear()

    def together(self, indices: list[int], rows: list[tuple[Any, ...]]) -> Trajectory:
        """Return trajectories stepped together: q and p of shape (n, m, d)."""
        q, p = self.states(rows)
        simulation = self._simulation('block', q, p)
        schedule = Schedule.until(self._plan.sweep.duration, self._every, simulation)
        found = record_block(simulation, q, p, indices[0], schedule,
                             PathReport.of(self.parts.scene, self._all_measured))
        for k, index in enumerate(indices):
            if self._is_measured(index) and not self._all_measured:
                found.errors[k], alarms = measure_alone(self.parts, q[k], p[k], schedule)
                found.alarms[k] += alarms
        return replace(self._several(
            schedule.times(simulation.step_size), found.q, found.p, found.alarms),
            path_error=tuple(found.errors))

    def _several(self, t: np.ndarray, q: np.ndarray, p: np.ndarray,
                 alarms: list[list[Alarm]]) -> Trajectory:
        # A simulation of a single trajectory evaluates the energy of all of them.
        one = self._simulation('first', q[0, :1], p[0, :1])
        energy = judge_many(one, t, q, p, alarms)
        return Trajectory(t, q, p, energy, self.parts.hamiltonian.coordinates,
                          tuple(map(tuple, alarms)), scene=self.parts.scene)

    def _make_batch(self, device: str) -> 'BatchSimulation':
        """Return the batch that steps on a device."""
        from hnn_vi_ros.simulation import batch_on
        scene = self.parts.scene
        if scene.events:
            raise HnnViRosError('events are not supported on a device; remove the events of '
                                f'{scene.name}, or run without --device')
        if whole_steps(self._plan.sweep.duration, scene.known_step_size)[1]:
            raise HnnViRosError(
                f'duration = {self._plan.sweep.duration:g} s is not a whole number of steps of '
                f'{scene.known_step_size:g} s, which a device needs; change it')
        return batch_on(device, self.parts)

    def on_device(self, rows: list[tuple[Any, ...]]) -> tuple[Trajectory, dict[int, StepFailure]]:
        """Return trajectories computed on a device, and the failures by trajectory number."""
        from hnn_vi_ros.simulation import one_thread_each, record_on
        q, p = self.states(rows)
        device, h = self._plan.device, self.parts.scene.known_step_size
        assert device is not None, 'a device is requested'
        steps, _ = whole_steps(self._plan.sweep.duration, h)
        samples = sorted({*range(0, steps + 1, self._every), steps})
        with one_thread_each(device):
            found, alarms_of = record_on(
                self._batch, self._simulation('first', q[:1], p[:1]), q, p, samples)
        return (self._several(np.array(samples) * h, found.q, found.p,
                              [alarms_of.get(k, []) for k in range(len(rows))]), found.failures)

    def alone(self, index: int, row: tuple[Any, ...]) -> Trajectory:
        """Return one trajectory with its own noise and events."""
        q, p = self.states([row])
        simulation = self._simulation('alone', q[0], p[0])
        # Each index has its own noise stream.
        simulation.restart(q[0], p[0], stream=index)
        schedule = Schedule.until(self._plan.sweep.duration, self._every, simulation)
        return replace(record_one(simulation, schedule, report=PathReport.of(
            self.parts.scene, self._is_measured(index))), scene=self.parts.scene)

    @property
    def _all_measured(self) -> bool:
        """Return whether the path error of all trajectories of the sweep is measured."""
        return (self.parts.scene.path_error == 'measured'
                and self._plan.count * self._plan.steps <= MAX_MEASURED_STEPS)

    def _is_measured(self, index: int) -> bool:
        """Return whether the path error of a trajectory is measured; see ``simulate_many``."""
        return self._all_measured or (self.parts.scene.path_error == 'measured'
                                      and index in drawn(self._plan.count))

    def _simulation(self, name: str, q: np.ndarray, p: np.ndarray) -> Any:
        """Return a cached simulation, created at the first use from this state."""
        if name not in self._simulations:
            self._simulations[name] = watched(build_at(self.parts, q, p), self.parts.scene)
        return self._simulations[name]


def _kinds(alarms: Iterable[Alarm]) -> list[str]:
    return [alarm.kind for alarm in alarms]
