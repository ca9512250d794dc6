# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Recording of samples: of one trajectory, or of many in blocks on several threads."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

from hnn_vi_ros.effects import Command
from hnn_vi_ros.errors import StoppedByEvent
from hnn_vi_ros.simulation.checks import check_numbers
from hnn_vi_ros.simulation.dense_step import record_at, whole_steps
from hnn_vi_ros.simulation.guards.base import Alarm
from hnn_vi_ros.simulation.guards.watch import (
    look, look_at_block, look_at_rows, SHOWN, Watch, watch_of_block)
from hnn_vi_ros.simulation.processors import in_threads, usable_processors
from hnn_vi_ros.simulation.simulation import Simulation
import numpy as np

# Number of trajectories that step together, for which a network's weights are read only once.
# Larger blocks are no faster, because each waits for its slowest trajectory.
BLOCK = 32
# Maximum number of coordinates in all samples of a run; with their momenta 4 GiB.
MOST_NUMBERS = 2**28
# Largest step counter of compiled code.
_MAX_STEPS = 2**63 - 1

# Commands over time: a function of time [s], or one row per sample.
Commands = Callable[[float], Command] | Sequence[Sequence[float]] | np.ndarray
# Samples of q and p, shape (n, d) or (n, m, d).
Samples = tuple[np.ndarray, np.ndarray]


class Schedule(NamedTuple):
    """
    Schedule of the samples after the initial state: first at whole steps, then at any times.

    Parameters
    ----------
    samples, every : int
        Number of samples at whole steps, and number of steps between them.
    rest : np.ndarray, shape (k,)
        Times of the other samples, in increasing order [s].

    """

    samples: int
    every: int
    rest: np.ndarray

    @classmethod
    def until(cls, duration: float, every: int, step_size: float, width: int) -> 'Schedule':
        """Return equidistant samples, the last one at the end; ValueError if they are too many."""
        every = min(every, _MAX_STEPS)
        check_memory(duration, step_size * every, width)
        steps, part = whole_steps(duration, step_size)
        every = min(every, steps + 1)
        samples, left = divmod(steps, every)
        return cls(samples, every, np.full(int(left > 0 or part > 0.0), duration))

    @classmethod
    def at(cls, times: Sequence[float] | np.ndarray, duration: float) -> 'Schedule':
        """Return samples at given times [s], or raise ValueError."""
        t = check_numbers('times', times)
        if t.ndim != 1 or t.size == 0:
            raise ValueError(
                f'times has shape {t.shape}, expected (N,): a list of at least one time')
        if not (np.isfinite(t).all() and (np.diff(t) >= 0.0).all() and t[0] >= 0.0
                and t[-1] <= duration * (1.0 + 1e-12)):
            raise ValueError('times must increase, and lie between 0 s and the duration, '
                             f'{duration:g} s')
        return cls(0, 1, t)

    def times(self, step_size: float) -> np.ndarray:
        """Return the times of the initial state and of all samples, shape (n + 1,) [s]."""
        return np.append(np.arange(self.samples + 1) * self.every * step_size, self.rest)


def check_memory(duration: float, interval: float, dimension: int) -> None:
    """
    Raise ValueError if the samples of a run do not fit into memory.

    Parameters
    ----------
    duration, interval : float
        Duration of the run, and time between samples [s].
    dimension : int
        Coordinates per sample, summed over all trajectories.

    """
    samples = duration / interval
    if samples * dimension > MOST_NUMBERS:
        raise ValueError(f'duration = {duration:g} s gives {samples:.2g} samples, one every '
                         f'{interval:g} s: more than fit into memory; use a larger every')


def record(simulation: Simulation, schedule: Schedule, watch: Watch,
           commands: Commands | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Record samples of one trajectory, or of several that step together.

    Parameters
    ----------
    simulation : Simulation
        Simulation in its initial state, of shape (d,) or (m, d).
    schedule : Schedule
        Schedule of the samples.
    watch : Watch
        Guards, updated during the run if there are commands or effects that do work.
    commands : callable or np.ndarray, shape (N, c), optional
        See ``simulate``.

    Returns
    -------
    tuple of np.ndarray, shape (n,), (n, ...), (n, ...)
        Times [s], q and p, starting with the initial state; if an event ends the run, its state
        is the last sample.

    Raises
    ------
    StepFailure
        A step did not converge, or its result is not finite.

    """
    t = schedule.times(simulation.step_size)
    parts = [(simulation.q[None].copy(), simulation.p[None].copy())]
    try:
        for part in _parts(simulation, schedule, watch, commands):
            parts.append(part)  # noqa: PERF402  keeps the samples taken before a stop
    except StoppedByEvent as stop:
        parts += [(stop.q, stop.p), (stop.event.q[None], stop.event.p[None])]
        t = np.append(t[:sum(len(q) for q, _ in parts) - 1], stop.event.t)
    q, p = (np.concatenate(halves) for halves in zip(*parts, strict=True))
    return t, q, p


def _parts(simulation: Simulation, schedule: Schedule, watch: Watch, commands: Commands | None
           ) -> Iterator[Samples]:
    """Yield samples in batches; update the guards between them if work or commands require it."""
    (samples, every, rest), looks = schedule, commands is not None or not simulation.conservative

    def show() -> None:
        if looks:
            watch.update(look(simulation))

    show()
    most = 1 if commands is not None else max(1, samples // SHOWN if looks else samples)
    for first in range(0, samples, most):
        if commands is None:
            yield simulation.record(min(most, samples - first), every)
        else:
            _advance(simulation, every, commands, first)
            yield simulation.q[None].copy(), simulation.p[None].copy()
        show()
    if commands is not None and rest.size:
        _advance(simulation, whole_steps(rest[0], simulation.step_size)[0] - simulation.steps,
                 commands, samples)
        simulation.set_command(_command(commands, simulation.time, samples))
    yield record_at(simulation, rest, show)


def check_commands(commands: Commands, schedule: Schedule) -> Commands:
    """Return commands, with rows as an array; ValueError if there are too few rows."""
    if callable(commands):
        return commands
    rows, samples = check_numbers('commands', commands), schedule.samples + schedule.rest.size
    if rows.ndim != 2 or len(rows) < samples:
        raise ValueError(f'commands has shape {rows.shape}, expected ({samples}, c), a row '
                         'for each sample but the last; or give a function of the time')
    return rows


def _advance(simulation: Simulation, steps: int, commands: Commands, sample: int) -> None:
    """Take steps after a sample, setting the command before each, so that none times out."""
    for _ in range(steps):
        simulation.set_command(_command(commands, simulation.time, sample))
        simulation.advance(1)


def _command(commands: Commands, time: float, sample: int) -> Command:
    """Return the command at a time after the sample with this index."""
    return commands(time) if callable(commands) else commands[sample]


def record_block(simulation: Simulation, q: np.ndarray, p: np.ndarray, stream: int,
                 schedule: Schedule) -> tuple[np.ndarray, np.ndarray, list[Alarm]]:
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

    Returns
    -------
    tuple of (np.ndarray, np.ndarray, list of Alarm)
        q and p, shape (n, m, d), and the alarms about steps of the block; if no work is done,
        ``show_many`` provides the alarms about energies.

    Raises
    ------
    StepFailure, ValueError
        See ``simulate``.

    """
    simulation.restart(q, p, stream=stream)
    watch = watch_of_block(simulation)
    _, q_all, p_all = record(simulation, schedule, watch)
    watch.update(look_at_block(simulation))
    return q_all, p_all, watch.alarms


def record_rows(simulation: Simulation, q: np.ndarray, p: np.ndarray, stream: int,
                commands: Iterable[np.ndarray]) -> tuple[np.ndarray, np.ndarray, list[Alarm]]:
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
    tuple of (np.ndarray, np.ndarray, list of Alarm)
        q and p, shape (n, m, d), and the alarms about steps of all trajectories.

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
    watch = watch_of_block(simulation, rows)
    states, width = [np.array(first)], q.shape[1]
    watch.update(look_at_rows(simulation, rows, states[0][:, :width], states[0][:, width:]))
    for held in commands:
        states.append(simulation.follow_on(rows, held)[:, -1, :width + p.shape[1]])
        watch.update(look_at_rows(simulation, rows, states[-1][:, :width], states[-1][:, width:]))
    path = np.array(states)
    return path[..., :width], path[..., width:], watch.alarms


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
