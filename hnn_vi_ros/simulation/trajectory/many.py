# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Simulation of many trajectories of a scene without ROS, in blocks on threads."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from hnn_vi_ros.effects import LARGEST
from hnn_vi_ros.errors import optional, StateError, StepFailure
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.phase_space import check_state, energy_unit
from hnn_vi_ros.scene import Parts, Scene
from hnn_vi_ros.simulation.checks import check_count, check_numbers, check_seconds
from hnn_vi_ros.simulation.construction import build_at
from hnn_vi_ros.simulation.dense_step import whole_steps
from hnn_vi_ros.simulation.energy_by_cause import ERROR, WORK
from hnn_vi_ros.simulation.guards.base import Alarm
from hnn_vi_ros.simulation.guards.watch import (
    judge_many, look_at_block, look_at_rows, tell_many, watch_of_block)
from hnn_vi_ros.simulation.path_error import OFF, PathError
from hnn_vi_ros.simulation.processors import in_threads, usable_processors
from hnn_vi_ros.simulation.run_samples import (
    CommandFunction, Commands, MOST_NUMBERS, record, Schedule)
from hnn_vi_ros.simulation.second_run import PathReport
from hnn_vi_ros.simulation.simulation import Simulation
from hnn_vi_ros.simulation.system import System
from hnn_vi_ros.simulation.trajectory.simulate import changed_parts
from hnn_vi_ros.simulation.trajectory.trajectory import EnergyByCause, Trajectory
import numpy as np
from numpy.typing import ArrayLike

# Number of trajectories that step together, for which a network's weights are read only once.
# Larger blocks are no faster, because each waits for its slowest trajectory.
BLOCK = 32
_FIRST = slice(0, 1)
# Commands of m trajectories: rows held from sample to sample, or a function of time [s].
ManyCommands = ArrayLike | Callable[[float], ArrayLike]
# Steps of all trajectories together up to which each of them is taken a second time; beyond, a
# sample is: the extremes of the start, and some that are drawn.
MAX_MEASURED_STEPS, _DRAWN = 1_000_000, 32


class Recorded(NamedTuple):
    """
    Samples of a block of trajectories.

    Parameters
    ----------
    q, p : np.ndarray, shape (n, m, d)
        States.
    alarms : list of list of Alarm
        Alarms about the steps of each trajectory.
    causes : np.ndarray, shape (n, m, C), or None
        Energy by cause, if it was requested.
    errors : list of PathError
        Path error of each trajectory.

    """

    q: np.ndarray
    p: np.ndarray
    alarms: list[list[Alarm]]
    causes: np.ndarray | None
    errors: list[PathError]


def simulate_many(scene: Scene | str | Path, q: ArrayLike, p: ArrayLike, duration: float, *,
                  samples: int = 1, commands: ManyCommands | None = None,
                  threads: int | None = None, device: str | None = None,
                  path_error: str | None = None) -> Trajectory:
    """
    Simulate one scene from many initial states.

    Trajectories are independent: a block of them is one system whose H is the sum of their
    Hamiltonians, stepped by the same code. The implicit equations of a block are solved until
    each of its trajectories has converged. With a thermostat, an impact, a constraint or
    ``energy_by_cause`` each trajectory is stepped separately, with its own noise.

    Parameters
    ----------
    scene : Scene, str or Path
        See ``simulate``; the scene's initial state is not used.
    q, p : sequence, shape (m, d)
        Initial states.
    duration : float
        Simulated time [s].
    samples : int, optional
        Number of equidistant samples after the initial one; see DenseStep for times between steps.
    commands : array or callable, optional
        Commands for external_force as plain numbers: an array of shape (m, samples, c), held from
        sample to sample, or a function of time [s] that returns (m, c) or (c,), called before
        each step. Each trajectory is then stepped separately, with results bit-identical to
        ``simulate``, and the interval between samples must be a whole number of steps.
    threads : int, optional
        Number of threads; by default the number of usable processors. Ignored on a GPU.
    device : str, optional
        torch device, ``'cuda'``, ``'cuda:N'`` or ``'cpu'``: take the steps in torch instead of
        compiled loops, solving each trajectory separately; see docs/how-to/scale.md. Requires an
        H of perceptrons without effects, and supports some of the methods.
    path_error : str, optional
        ``'measured'``, or ``'off'``; overrides the scene's. If all trajectories together take more
        than a million steps, or on a device, or with commands, it is measured of a sample only:
        those whose energy, speed or distance from the origin is largest or smallest at the start,
        and 32 drawn at random.

    Returns
    -------
    Trajectory
        t of shape (samples + 1,), q and p of shape (samples + 1, m, d), energy of shape
        (samples + 1, m). Alarms about steps, and about energies if work is done, are assigned to
        all trajectories of a block. A trajectory that fails has the alarm ``failed``, and NaN
        from then on.

    Warns
    -----
    AlarmWarning
        See ``simulate``.

    Raises
    ------
    HnnViRosError
        The scene cannot be built, or all trajectories fail.
    MissingPackage
        `device` is given, but the extra ``train`` is not installed.
    ValueError
        Invalid argument, or more samples than fit into memory.
    TypeError
        Argument of a wrong type.

    Examples
    --------
    >>> simulate_many('exact_pendulum', [[0.1], [0.2], [0.3]], np.zeros((3, 1)), 1.0).q.shape
    (2, 3, 1)

    """
    check_seconds('duration', duration)
    check_count('samples', samples)
    if threads is not None:
        check_count('threads', threads)
    parts = changed_parts(scene, path_error=path_error)
    if parts.scene.events:
        raise ValueError('simulate_many does not support events: remove `events` from '
                         f'{parts.scene.name}, or simulate one trajectory at a time')
    run = _Many(parts, q, p, duration, samples)
    function = CommandFunction(commands) if callable(commands) else None
    if commands is not None:
        run.follow(function or commands, threads, device)
    elif device is not None:
        run.step_on(device, threads)
    else:
        run.step(threads)
    energies = run.energies()
    run.measure(commands)
    if function is not None:
        function.check_held(run.step_size)
    tell_many(run.alarms, run.step_size)
    causes = run.energy_by_cause
    work = None if causes is None or not causes.of(WORK) else (
        energies - energies[0] - causes.of(ERROR)[''])
    return Trajectory(run.t, run.q, run.p, energies, run.parts.hamiltonian.coordinates,
                      tuple(map(tuple, run.alarms)), scene=parts.scene,
                      work=work, energy_by_cause=causes, path_error=tuple(run.errors))


class _Many:
    """
    Run of many trajectories of one scene.

    Parameters
    ----------
    parts : Parts
        Parts of the scene.
    q, p, duration, samples
        See ``simulate_many``.

    Attributes
    ----------
    t : np.ndarray, shape (samples + 1,)
        Times of the samples [s].
    q, p : np.ndarray, shape (samples + 1, m, d)
        Samples, filled in by step, follow or step_on.
    alarms : list of list of Alarm
        Alarms about the steps of each trajectory.
    failures : dict of int to StepFailure or StateError
        Failures of trajectories.
    errors : list of PathError
        Path errors of the trajectories.
    energy_by_cause : EnergyByCause or None
        Filled in by step and follow, if requested.

    """

    def __init__(self, parts: Parts, q: ArrayLike, p: ArrayLike, duration: float, samples: int):
        q0, p0 = _initial_states(q, p, parts.hamiltonian)
        if q0.size * samples > MOST_NUMBERS:
            raise ValueError(f'{samples} samples of {len(q0)} trajectories do not fit into '
                             'memory; simulate fewer at a time')
        self.parts, self.count = parts, len(q0)
        self.step_size = h = parts.scene.known_step_size
        samples = samples if duration else 0
        self._interval = interval = duration / max(samples, 1)
        self._every, self._share = whole_steps(interval, h)
        self.t = np.arange(samples + 1) * (interval if self._share else self._every * h)
        self.q, self.p = (np.full((samples + 1, *part.shape), np.nan) for part in (q0, p0))
        self.q[0], self.p[0] = q0, p0
        self.alarms: list[list[Alarm]] = [[] for _ in q0]
        self.failures: dict[int, StepFailure | StateError] = {}
        self._measured = parts.scene.path_error == 'measured'
        self.errors = [PathError.unmeasured(OFF)] * self.count
        self.energy_by_cause: EnergyByCause | None = None
        if parts.scene.energy_by_cause:
            ledger = self.simulation().ledger
            assert ledger is not None, 'requested'
            self.energy_by_cause = EnergyByCause(self.t, ledger.names, np.full(
                (samples + 1, self.count, len(ledger.names)), np.nan),
                energy_unit(parts.hamiltonian.coordinates))

    def simulation(self, block: slice = _FIRST) -> Simulation:
        """Return a simulation of a block of trajectories in their initial states."""
        return build_at(self.parts, self.q[0, block], self.p[0, block])

    def step(self, threads: int | None) -> None:
        """Take the steps in compiled loops, of blocks if the system supports batches."""
        _, hamiltonian, integrator, effects = self.parts
        size = BLOCK if System(hamiltonian, effects, integrator, by_joint=(
            self.parts.scene.energy_by_cause)).batched else 1
        together = self._measured and self.count * self._steps <= MAX_MEASURED_STEPS

        def take(simulation: Simulation, block: slice, samples: int) -> Recorded:
            return record_block(
                simulation, self.q[0, block], self.p[0, block], block.start,
                Schedule(0, 1, self.t[1:samples + 1]) if self._share or not self._every else
                Schedule(samples, self._every, np.empty(0)),
                PathReport.of(self.parts.scene, together))
        in_blocks(self.count, size, threads, lambda first: self._kept(take, size))

    def follow(self, commands: ManyCommands, threads: int | None, device: str | None) -> None:
        """Take the steps with individual commands, or raise ValueError."""
        one = self.simulation()
        if not one.takes_commands:
            raise ValueError('no effect of the scene accepts commands; add external_force with '
                             'its coordinates')
        if self._share or device is not None:
            raise ValueError('commands need whole steps between samples, and no device; change '
                             'duration or samples, and remove device')
        if callable(commands):
            # The function may not be thread-safe.
            threads = 1
        else:
            commands = _checked_numbers(
                'commands', commands, [(self.count, self.t.size - 1, one.command_size)])

        def take(simulation: Simulation, block: slice, samples: int) -> Recorded:
            return record_rows(
                simulation, self.q[0, block], self.p[0, block], block.start,
                (part[block] for part in self._held(commands, one.command_size, samples)))
        in_blocks(self.count, BLOCK, threads, lambda first: self._kept(take, 1))

    def _held(self, commands: Any, c: int, samples: int) -> Iterator[np.ndarray]:
        """Yield, for each interval between samples, the commands of its steps, (m, every, c)."""
        for sample in range(samples):
            # Compiled code reads them in C order, which stack does not keep for one row of all.
            yield np.ascontiguousarray(np.stack([
                _numbers(commands, k * self.step_size, sample, (self.count, c))
                for k in range(sample * self._every, (sample + 1) * self._every)], axis=1))

    def step_on(self, device: str, threads: int | None) -> None:
        """Take the steps in torch, or raise ValueError."""
        if self._share:
            raise ValueError(f'device = {device}: samples are {self._interval:g} s apart, '
                             f'{self._interval / self.step_size:g} steps; a device needs whole '
                             'steps between samples; change duration or samples')
        if self.energy_by_cause is not None:
            raise ValueError(f'device = {device}: a device does not account for the energy by '
                             'cause; remove `energy_by_cause`, or device')
        with optional('torch', f'device = {device}'):
            from hnn_vi_ros.simulation.batches.batch_simulation import open_device
            from hnn_vi_ros.simulation.trajectory.devices import (
                batch_on, one_thread_each, record_on, TOGETHER)
        size = TOGETHER if open_device(device).type == 'cpu' else self.count
        samples = [k * self._every for k in range(self.t.size)]

        def start(first: slice) -> Callable[[slice], None]:
            ensemble, one = batch_on(device, self.parts), self.simulation(_FIRST)

            def take(block: slice) -> None:
                found, alarms = record_on(
                    ensemble, one, self.q[0, block], self.p[0, block], samples)
                self.q[:, block], self.p[:, block] = found.q, found.p
                for k, problem in found.failures.items():
                    self._fail(block.start + k, problem)
                for k, told in alarms.items():
                    self.alarms[block.start + k] += told
            return take

        with one_thread_each(device):
            in_blocks(self.count, size, threads, start)

    def _kept(self, take: Callable[[Simulation, slice, int], Recorded], size: int
              ) -> Callable[[slice], None]:
        """Return a function that records a block; if it fails, each trajectory on its own."""
        cached = list[Simulation]()

        def put(block: slice, samples: int) -> None:
            simulation = cached.pop() if cached else self.simulation(
                slice(block.start, min(block.stop, block.start + size)))
            found = take(simulation, block, samples)
            # One that failed is not used again.
            cached.append(simulation)
            self.q[:samples + 1, block], self.p[:samples + 1, block] = found.q, found.p
            if self.energy_by_cause is not None:
                self.energy_by_cause.values[:samples + 1, block] = found.causes
            for own, alarms in zip(self.alarms[block], found.alarms, strict=True):
                own += alarms
            self.errors[block] = found.errors

        def attempt(block: slice) -> None:
            try:
                put(block, self.t.size - 1)
            except (StepFailure, StateError) as problem:
                alone = [slice(k, k + 1) for k in range(self.count)[block]]
                if len(alone) > 1:
                    for own in alone:
                        attempt(own)
                elif samples := self._fail(block.start, problem):
                    put(block, samples)
        return attempt

    def _fail(self, k: int, problem: StepFailure | StateError) -> int:
        """Record the failure of a trajectory; return the number of samples before it."""
        time = getattr(problem, 't', 0.0) + 1e-9 * self.step_size
        samples = int(np.searchsorted(self.t, time, 'right')) - 1
        self.q[samples + 1:, k] = self.p[samples + 1:, k] = np.nan
        self.failures[k] = problem
        self.alarms[k].append(Alarm('failed', round(time / self.step_size), time,
                                    float(self.t[-1]), str(problem), 's'))
        return samples

    def energies(self) -> np.ndarray:
        """Return H, shape (samples + 1, m), and add alarms; if all failed, raise the first."""
        if len(self.failures) == self.count:
            raise self.failures[min(self.failures)]
        kept = [k for k in range(self.count) if k not in self.failures]
        simulation = self.simulation(slice(kept[0], kept[0] + 1))
        found = np.asarray(simulation.hamiltonian.energy(self.q, self.p, self.t[:, None])) \
            if self.failures else np.empty(self.q.shape[:2])
        found[:, kept] = judge_many(simulation, self.t, self.q[:, kept], self.p[:, kept],
                                    [self.alarms[k] for k in kept])
        return found

    @property
    def _steps(self) -> int:
        """Return the number of steps of a trajectory."""
        return (self.t.size - 1) * self._every + int(self.t[-1] / self.step_size) * (
            not self._every)

    def measure(self, commands: ManyCommands | None) -> None:
        """Simulate a sample of the trajectories again, alone, to measure their path errors."""
        if not self._measured or any(error.reason != OFF for error in self.errors):
            return
        rows = self._sample()
        self.errors = [PathError.unmeasured(f'{len(rows)} of {self.count} trajectories were '
                                            'measured, and not this one')] * self.count
        schedule = Schedule(0, 1, self.t[1:]) if self._share or not self._every else Schedule(
            self.t.size - 1, self._every, np.empty(0))
        for k in rows:
            self.errors[k], alarms = measure_alone(
                self.parts, self.q[0, k], self.p[0, k], schedule, _of_one(commands, k))
            self.alarms[k] += alarms

    def _sample(self) -> list[int]:
        """Return the indices of the trajectories whose path error is measured."""
        if self.count * self._steps <= MAX_MEASURED_STEPS:
            return [k for k in range(self.count) if k not in self.failures]
        q, p, hamiltonian = self.q[0], self.p[0], self.parts.hamiltonian
        speed = np.linalg.norm(hamiltonian.gradient(q, p)[1], axis=1)
        measures = hamiltonian.energy(q, p), speed, np.linalg.norm(q, axis=1)
        ends = [int(end) for values in measures for end in (np.argmin(values), np.argmax(values))]
        return sorted({*drawn(self.count), *ends} - set(self.failures))


def measure_alone(parts: Parts, q: np.ndarray, p: np.ndarray, schedule: Schedule,
                  commands: Commands | None = None) -> tuple[PathError, list[Alarm]]:
    """Simulate a trajectory again, alone; return its path error, and the alarm about it."""
    simulation, report = build_at(parts, q, p), PathReport.of(parts.scene)
    report.follow(simulation, schedule.steps(simulation.step_size), period=None)
    # A failure is known already.
    with suppress(StepFailure, StateError):
        record(simulation, schedule, commands)
    alarms = [alarm for _, alarm in report.finish()]
    return report.errors()[0], alarms


@cache
def drawn(count: int) -> frozenset[int]:
    """Return the indices of the trajectories that are drawn of `count` to be measured."""
    generator = np.random.default_rng(0)
    return frozenset(generator.choice(count, min(count, _DRAWN), replace=False).tolist())


def _of_one(commands: ManyCommands | None, k: int) -> Commands | None:
    """Return the commands of one trajectory; see ``simulate``."""
    if commands is None or not callable(commands):
        return None if commands is None else np.asarray(commands)[k]

    def command(time: float) -> np.ndarray:
        found = np.asarray(commands(time))
        return found[k] if found.ndim > 1 else found
    return command


def _initial_states(q: ArrayLike, p: ArrayLike, hamiltonian: Hamiltonian) -> list[np.ndarray]:
    """Return q and p of initial states, shape (m, d), or raise an error if they are invalid."""
    states, d, turning = (
        (check_numbers('q', q), check_numbers('p', p)), hamiltonian.dimension,
        hamiltonian.rotations)
    widths = d, d - len(turning)
    for name, part, width in zip('qp', states, widths, strict=True):
        if part.ndim == 1 and part.size != width:
            raise ValueError(f'{name} has shape {part.shape}, expected (m, {width}): a row for '
                             'each trajectory, a column for each coordinate')
    checked = [part.reshape(-1, width) for part, width in zip(
        check_state(*states, d, turning), widths, strict=True)]
    if checked[0].size == 0:
        raise ValueError(f'q has shape {np.shape(q)}: no trajectory to simulate')
    return checked


def _numbers(commands: Any, time: float, sample: int, shape: tuple[int, int]) -> np.ndarray:
    """Return the commands of all trajectories, (m, c), at a time after sample `sample`."""
    if not callable(commands):
        return np.asarray(commands[:, sample])
    return np.broadcast_to(_checked_numbers(
        f'commands({time:g})', commands(time), [shape, shape[1:]]), shape)


def _checked_numbers(name: str, values: Any, shapes: list[tuple[int, ...]]) -> np.ndarray:
    """Return finite numbers of one of the shapes, or raise ValueError."""
    found = check_numbers(name, values)
    if found.shape not in shapes:
        raise ValueError(f'{name} has shape {found.shape}, expected '
                         f'{" or ".join(map(str, shapes))}')
    if not (np.abs(found) <= LARGEST).all():
        raise ValueError(f'{name} must hold finite numbers, at most {LARGEST:g} in size')
    return found


def record_block(simulation: Simulation, q: np.ndarray, p: np.ndarray, stream: int,
                 schedule: Schedule, report: PathReport) -> Recorded:
    """
    Record samples of trajectories that step together.

    Parameters
    ----------
    simulation : Simulation
        Simulation of m trajectories; it is restarted.
    q, p : np.ndarray, shape (m, d)
        Initial states.
    stream : int
        Number of the noise stream.
    schedule : Schedule
        Schedule of the samples.
    report : PathReport
        Path errors of the trajectories.

    Returns
    -------
    Recorded
        If no work is done, ``judge_many`` provides the alarms about energies.

    Raises
    ------
    StepFailure, ValueError
        See ``simulate``.

    """
    simulation.restart(q, p, stream=stream)
    watch = watch_of_block(simulation)
    report.follow(simulation, schedule.steps(simulation.step_size), period=None)
    found = record(simulation, schedule, observe=watch.observe)
    watch.update(look_at_block(simulation))
    causes = None if found.causes is None else found.causes[:, None]
    alarms = [watch.alarms for _ in range(len(q))]
    for k, alarm in report.finish():
        alarms[k].append(alarm)
    return Recorded(found.q, found.p, alarms, causes, report.errors(len(q)))


def record_rows(simulation: Simulation, q: np.ndarray, p: np.ndarray, stream: int,
                commands: Iterable[np.ndarray]) -> Recorded:
    """
    Record samples of trajectories with individual commands.

    Parameters
    ----------
    simulation : Simulation
        Simulation of one of the trajectories; it is restarted.
    q, p : np.ndarray, shape (m, d)
        Initial states.
    stream : int
        Number of the noise stream of the first trajectory; the others use the following numbers.
    commands : iterable of np.ndarray, shape (m, every, c)
        For each interval between samples, the commands before each step.

    Returns
    -------
    Recorded
        The samples.

    Raises
    ------
    StepFailure, ValueError
        See ``simulate``.

    """
    begun, first = [], []
    for k in range(len(q)):
        simulation.restart(q[k:k + 1], p[k:k + 1], stream=stream + k)
        begun.append(simulation.row)
        # Loops may have moved it.
        first.append(np.append(simulation.q, simulation.p))
    rows = np.array(begun)
    watch = watch_of_block(simulation, in_rows=True)
    states, width = [np.array(first)], q.shape[1]
    watch.update(look_at_rows(simulation, rows, states[0][:, :width], states[0][:, width:]))
    causes = [_causes(simulation, rows)]
    for held in commands:
        states.append(simulation.follow_on(rows, held)[:, -1, :width + p.shape[1]])
        watch.update(look_at_rows(simulation, rows, states[-1][:, :width], states[-1][:, width:]))
        causes.append(_causes(simulation, rows))
    path = np.array(states)
    return Recorded(path[..., :width], path[..., width:], [watch.alarms for _ in rows],
                    None if simulation.ledger is None else np.array(causes),
                    [PathError.unmeasured(OFF)] * len(rows))


def _causes(simulation: Simulation, rows: np.ndarray) -> list[np.ndarray | None]:
    """Return the energy by cause of rows; an empty list if it was not requested."""
    found = []
    for row in rows if simulation.ledger is not None else ():
        simulation.put(row)
        found.append(simulation.causes)
    return found


def in_blocks(count: int, size: int, threads: int | None,
              start: Callable[[slice], Callable[[slice], None]]) -> None:
    """
    Process trajectories in blocks on several threads.

    Parameters
    ----------
    count, size : int
        Number of trajectories, and number per block.
    threads : int or None
        Maximum number of threads; None for the number of usable processors.
    start : callable
        Called in each thread with its first block; returns the function that processes a block.

    """
    workers = min(threads or usable_processors(), -(-count // size))

    def work(worker: int) -> None:
        blocks = [slice(first, first + size)
                  for first in range(worker * size, count, workers * size)]
        take = start(blocks[0])
        for block in blocks:
            take(block)
    in_threads(work, workers)
