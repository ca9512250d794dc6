# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Recorders of the samples of one trajectory: at whole steps, at given times, with commands."""

from collections.abc import Callable, Sequence

from hnn_vi_ros.effects.commands import Command
from hnn_vi_ros.errors import StoppedByEvent
from hnn_vi_ros.guards.watch import look, record_watched, Watch
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.checks import check_numbers
from hnn_vi_ros.simulation.dense_step import record_at, whole_steps
import numpy as np

# Coordinates that the samples of a run may have in all; with as many momenta: 4 GiB.
MOST_NUMBERS = 2**28
# Compiled code counts no further.
_MOST_STEPS = 2**63 - 1

# Commands over time: a function of time [s], or values at each sample.
Commands = Callable[[float], Command] | Sequence[Sequence[float]] | np.ndarray
# What takes samples: q and p, shape (k, d) each.
Recorder = Callable[[], tuple[np.ndarray, np.ndarray]]


def recorders(simulation: Simulation, duration: float, every: int,
              times: Sequence[float] | np.ndarray | None, commands: Commands | None, watch: Watch
              ) -> tuple[np.ndarray, list[Recorder]]:
    """
    Return the times of the initial state and of all samples, and what takes those in turn.

    Parameters
    ----------
    simulation : Simulation
        In its initial state.
    duration, every, times, commands
        See ``simulate``.
    watch : Watch
        The guards, which look on meanwhile where work is done.

    Returns
    -------
    tuple of (np.ndarray, list of callable)
        Times, shape (N + 1,) [s]; each callable returns q and p, shape (k, d), of the next ones.

    Raises
    ------
    ValueError
        Times or commands that cannot be used, or more samples than fit into memory.

    """
    if times is not None:
        if commands is not None:
            raise ValueError('times and commands cannot both be given: use every with commands')
        t = _check_times(times, duration)
        return np.append(0.0, t), [lambda: record_samples(simulation, t.size, t, watch)]
    every = min(every, _MOST_STEPS)
    check_memory(duration, simulation.step_size * every, simulation.q.size)
    steps, part = whole_steps(duration, simulation.step_size)
    every = min(every, steps + 1)
    samples, rest = divmod(steps, every)
    t = np.arange(samples + 1) * every * simulation.step_size
    if commands is None:
        takers = [lambda: record_samples(simulation, samples, every, watch)]
    else:
        commands = _check_commands(commands, samples + bool(rest or part))
        takers = [lambda: _record_commanded(simulation, samples, every, commands, watch)]
    if rest or part:
        t = np.append(t, duration)
        takers.append(lambda: _record_last(
            simulation, samples, rest, duration, commands, watch))
    return t, takers


def record_samples(simulation: Simulation, samples: int, every: int | np.ndarray, watch: Watch
                   ) -> tuple[np.ndarray, np.ndarray]:
    """Take samples, every so many steps or at given times; look on where work is done."""
    if isinstance(every, int):
        return (simulation.record(samples, every) if simulation.conservative
                else record_watched(simulation, samples, every, watch))
    if simulation.conservative:
        return record_at(simulation, every)
    watch.update(look(simulation))
    return record_at(simulation, every, lambda: watch.update(look(simulation)))


def _check_times(times: Sequence[float] | np.ndarray, duration: float) -> np.ndarray:
    """Return times of samples as an array, or raise."""
    t = check_numbers('times', times)
    if t.ndim != 1 or t.size == 0:
        raise ValueError(f'times has shape {t.shape}, expected (N,): a list of at least one time')
    if not (np.isfinite(t).all() and (np.diff(t) >= 0.0).all() and t[0] >= 0.0
            and t[-1] <= duration * (1.0 + 1e-12)):
        raise ValueError(f'times must rise from 0 s at least to the duration, {duration:g} s, at '
                         'most')
    return t


def check_memory(duration: float, interval: float, dimension: int) -> None:
    """
    Raise ValueError if the samples of a run do not fit into memory.

    Parameters
    ----------
    duration, interval : float
        Of the run, and from one sample to the next [s].
    dimension : int
        Coordinates of each, of all trajectories.

    """
    samples = duration / interval
    if samples * dimension > MOST_NUMBERS:
        raise ValueError(f'duration = {duration:g} s would make {samples:.2g} samples, one every '
                         f'{interval:g} s: more than memory holds; take a larger every')


def _check_commands(commands: Commands, samples: int) -> Commands:
    """Return rows of commands as an array, or raise if there are too few."""
    if callable(commands):
        return commands
    rows = check_numbers('commands', commands)
    if rows.ndim != 2 or len(rows) < samples:
        raise ValueError(f'commands has shape {rows.shape}, expected ({samples}, c): a row '
                         'for each sample but the last; or give a function of the time')
    return rows


def _record_commanded(simulation: Simulation, samples: int, every: int, commands: Commands,
                      watch: Watch) -> tuple[np.ndarray, np.ndarray]:
    """Take samples times every steps, with a command before each step."""
    q, p = (np.empty((samples, part.size)) for part in (simulation.q, simulation.p))
    watch.update(look(simulation))
    for sample in range(samples):
        try:
            _advance_commanded(simulation, every, commands, sample)
        except StoppedByEvent as stop:
            raise stop.after(q[:sample], p[:sample]) from None
        q[sample], p[sample] = simulation.q, simulation.p
        watch.update(look(simulation))
    return q, p


def _record_last(simulation: Simulation, sample: int, steps: int, duration: float,
                 commands: Commands | None, watch: Watch) -> tuple[np.ndarray, np.ndarray]:
    """Take the sample at the end of a duration, after another: some steps, and a part of one."""
    if commands is not None:
        _advance_commanded(simulation, steps, commands, sample)
        simulation.set_command(_command(commands, simulation.time, sample))
    return record_samples(simulation, 1, np.array([duration]), watch)


def _advance_commanded(simulation: Simulation, steps: int, commands: Commands, sample: int
                       ) -> None:
    """Take steps after a sample, with a command before each: none ends by the time-out."""
    for _ in range(steps):
        simulation.set_command(_command(commands, simulation.time, sample))
        simulation.advance(1)


def _command(commands: Commands, time: float, sample: int) -> Command:
    """Return the command at a time, which lies after a sample."""
    return commands(time) if callable(commands) else commands[sample]
