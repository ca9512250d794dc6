# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Recording of samples of one trajectory, or of several that step together."""

from collections.abc import Callable, Iterator, Sequence
import math
from typing import Any, NamedTuple, TYPE_CHECKING
import warnings

from hnn_vi_ros.effects import Command, JointCommand
from hnn_vi_ros.errors import StoppedByEvent
from hnn_vi_ros.simulation.checks import check_numbers
from hnn_vi_ros.simulation.dense_step import DenseStep, record_at, whole_steps
from hnn_vi_ros.simulation.simulation import Simulation
import numpy as np

# CommandedSimulation has the interface of Simulation: most attributes are delegated.
if TYPE_CHECKING:
    _Simulation = Simulation
else:
    _Simulation = object

# Maximum number of coordinates in all samples of a run; with their momenta 4 GiB.
MOST_NUMBERS = 2**28
# Largest step counter of compiled code.
_MAX_STEPS = 2**63 - 1
# Approximate maximum number of samples at which guards check a run, in addition to the extremes of
# a path. Half as many suffice to detect a lasting change; see EnergyGuard.
MAX_OBSERVED = 10_000

# Largest mean change of smooth commands from step to step relative to their range: 0.32 w h for
# A cos(w t), whose held values lag by w h / 2 = 0.1 rad. Least number of changes.
_MAX_HELD_SHARE, _MIN_CHANGES = 0.064, 8

# Commands over time: a function of time [s], or one row per sample.
Commands = Callable[[float], Command] | Sequence[Sequence[float]] | np.ndarray
# Samples of q and p, shape (n, d) or (n, m, d).
Samples = tuple[np.ndarray, np.ndarray]


class Schedule(NamedTuple):
    """
    Schedule of samples: the initial state, then at whole steps, then at any times.

    Parameters
    ----------
    samples, every : int
        Number of samples at whole steps, and number of steps between them.
    rest : np.ndarray, shape (k,)
        Times of the other samples, in increasing order [s].
    from_start : bool
        True if the initial state is the first sample.

    """

    samples: int
    every: int
    rest: np.ndarray
    from_start: bool = True

    @classmethod
    def until(cls, duration: float, every: int, simulation: Simulation) -> 'Schedule':
        """Return equidistant samples, the last one at the end; ValueError if they are too many."""
        every = min(every, _MAX_STEPS)
        check_memory(duration, simulation.step_size * every, simulation.q.size)
        steps, part = whole_steps(duration, simulation.step_size)
        every = min(every, steps + 1)
        samples, left = divmod(steps, every)
        return cls(samples, every, np.full(int(left > 0 or part > 0.0), duration))

    @classmethod
    def at(cls, times: Sequence[float] | np.ndarray, duration: float) -> 'Schedule':
        """Return samples at given times only [s], or raise ValueError."""
        t = check_numbers('times', times)
        if t.ndim != 1 or t.size == 0:
            raise ValueError(
                f'times has shape {t.shape}, expected (N,): a list of at least one time')
        if not (np.isfinite(t).all() and (np.diff(t) >= 0.0).all() and t[0] >= 0.0
                and t[-1] <= duration * (1.0 + 1e-12)):
            raise ValueError('times must increase, and lie between 0 s and the duration, '
                             f'{duration:g} s')
        return cls(0, 1, t, from_start=False)

    def steps(self, step_size: float) -> int:
        """Return the number of steps of a run."""
        return max(self.samples * self.every, math.ceil(
            self.rest[-1] / step_size - 1e-9) if self.rest.size else 0)

    def times(self, step_size: float) -> np.ndarray:
        """Return the times of all samples, shape (n,) [s]."""
        steps = np.arange(0 if self.from_start else 1, self.samples + 1) * self.every
        return np.append(steps * step_size, self.rest)


class RunSamples(NamedTuple):
    """
    Samples of a run.

    Parameters
    ----------
    t : np.ndarray, shape (n,)
        Times [s].
    q, p : np.ndarray, shape (n, d) or (n, m, d)
        States.
    work : np.ndarray, shape (n,), or None
        Work done on the system since the start [J]: NaN between steps, and at some of more than
        MAX_OBSERVED samples without causes. None if no effect does work.
    causes : np.ndarray, shape (n, C), or None
        Energy by cause [J], NaN between steps; None if it was not requested. See Ledger.

    """

    t: np.ndarray
    q: np.ndarray
    p: np.ndarray
    work: np.ndarray | None
    causes: np.ndarray | None = None


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


def record(simulation: Simulation, schedule: Schedule, commands: Commands | None = None,
           observe: Callable[[], None] = lambda: None) -> RunSamples:
    """
    Record samples of one trajectory, or of several that step together.

    Parameters
    ----------
    simulation : Simulation
        Simulation in its initial state, of shape (d,) or (m, d).
    schedule : Schedule
        Schedule of the samples.
    commands : callable or np.ndarray, shape (N, c), optional
        See ``simulate``.
    observe : callable, optional
        Called at the initial state and after samples if effects do work, which samples do not
        show; it must leave the simulation as it is. Other runs are not interrupted.

    Returns
    -------
    RunSamples
        The samples; if an event ends the run, its state is the last one.

    Raises
    ------
    StepFailure
        A step did not converge, or its result is not finite.

    """
    t = schedule.times(simulation.step_size)
    if commands is not None:
        simulation = CommandedSimulation(simulation, commands, schedule)
    # Keys are numbers of steps.
    works, causes = dict[int, float](), dict[int, np.ndarray]()

    def note() -> None:
        if (found := simulation.causes) is not None:
            causes[simulation.steps] = found
        if not simulation.conservative:
            works[simulation.steps] = simulation.work
            observe()

    first = slice(0, int(schedule.from_start))
    parts = [(simulation.q[None][first].copy(), simulation.p[None][first].copy())]
    try:
        for part in _parts(simulation, schedule, note, at_each=commands is not None):
            parts.append(part)  # noqa: PERF402  keeps the samples taken before a stop
    except StoppedByEvent as stop:
        parts += [(stop.q, stop.p), (stop.event.q[None], stop.event.p[None])]
        t = np.append(t[:sum(len(q) for q, _ in parts) - 1], stop.event.t)
    q, p = (np.concatenate(halves) for halves in zip(*parts, strict=True))
    ledger = simulation.ledger
    if simulation.conservative and ledger is None:
        return RunSamples(t, q, p, None)
    steps = [-1 if share else step for step, share in (
        whole_steps(time, simulation.step_size) for time in t.tolist())]
    return RunSamples(
        t, q, p, None if simulation.conservative else np.array(
            [works.get(step, math.nan) for step in steps]),
        None if ledger is None else np.array(
            [causes.get(step, np.full(len(ledger.names), math.nan)) for step in steps]))


def _parts(simulation: Simulation, schedule: Schedule, note: Callable[[], None], at_each: bool
           ) -> Iterator[Samples]:
    """Yield samples in batches, or one by one with `at_each`; call `note` between them."""
    note()
    samples, every, rest, _ = schedule
    most = 1 if at_each or simulation.ledger is not None else max(
        1, samples if simulation.conservative else samples // MAX_OBSERVED)
    for first in range(0, samples, most):
        yield simulation.record(min(most, samples - first), every)
        note()
    yield record_at(simulation, rest, note)


class CommandedSimulation(_Simulation):
    """
    Simulation with a command for each step, which is set before the step, so that none times out.

    Parameters
    ----------
    simulation : Simulation
        Simulation of one trajectory; attributes not listed below are delegated to it.
    commands : callable or array, shape (N, c)
        See ``simulate``.
    schedule : Schedule
        Schedule of the samples, from each of which on a row of commands is held.

    Raises
    ------
    ValueError
        There are too few rows.

    """

    def __init__(self, simulation: Simulation, commands: Commands, schedule: Schedule):
        self._simulation, self._every = simulation, schedule.every
        self._commands = commands
        if not callable(commands):
            samples = schedule.samples + schedule.rest.size
            self._commands = rows = check_numbers('commands', commands)
            if rows.ndim != 2 or len(rows) < samples:
                raise ValueError(f'commands has shape {rows.shape}, expected ({samples}, c), a '
                                 'row for each sample but the last; or give a function of the '
                                 'time')

    def __getattr__(self, name: str) -> Any:
        return getattr(self._simulation, name)

    def advance(self, n: int, until: float = math.inf) -> int:
        """Take n steps; see Simulation."""
        for _ in range(n):
            self._set_command()
            self._simulation.advance(1)
        return n

    def record(self, samples: int, every: int) -> Samples:
        """Take samples times every steps, and return samples; see Simulation."""
        q, p = (np.empty((samples, part.size)) for part in (self.q, self.p))
        for sample in range(samples):
            self.advance(every)
            q[sample], p[sample] = self.q, self.p
        return q, p

    def dense_step(self) -> DenseStep:
        """Take one step and return it with dense output; see Simulation."""
        self._set_command()
        return self._simulation.dense_step()

    def _set_command(self) -> None:
        own, commands = self._simulation, self._commands
        own.set_command(commands(own.time) if callable(commands) else
                        commands[own.steps // self._every])


class CommandFunction:
    """
    Commands as a function of the time, whose values are held for a step each.

    Parameters
    ----------
    function : callable
        See ``simulate``.

    """

    def __init__(self, function: Callable[[float], Any]):
        self._function, self._time = function, -math.inf
        self._last = self._low = self._high = np.empty(0)
        self._change: np.ndarray = np.empty(0)
        self._sums: np.ndarray = np.empty((3, 0))

    def __call__(self, time: float) -> Any:
        """Return the command at a time [s]."""
        command = self._function(time)
        # Each block of trajectories begins at the start.
        if time > self._time:
            self._time = time
            self._add(command)
        return command

    def check_held(self, step_size: float) -> None:
        """Warn of a smooth function that changes much while its values are held for a step [s]."""
        if self._share > _MAX_HELD_SHARE:
            warnings.warn(
                f'commands change by {self._share:.0%} of their range from step to step, but are '
                f'held for a step of {step_size:g} s: the force lags behind the function by half '
                'a step; use a smaller step_size, or write the force as time t in H or as '
                'periodic_drive', stacklevel=3)

    def _add(self, command: Command) -> None:
        """Add the next command; paths and those of other shapes do not continue the last."""
        parts = command[1:] if isinstance(command, JointCommand) else [command]
        try:
            now = np.concatenate([np.ravel(np.asarray(part, dtype=float)) for part in parts])
        except (TypeError, ValueError):
            return  # a path, or what set_command refuses
        if now.shape != self._last.shape:
            self._last = self._low = self._high = now
            self._change, self._sums = np.zeros(now.size), np.zeros((3, now.size))
            return
        change = now - self._last
        self._sums += np.abs(change), np.abs(change - self._change), change != 0.0
        self._last, self._change = now, change
        self._low, self._high = np.fmin(self._low, now), np.fmax(self._high, now)

    @property
    def _share(self) -> float:
        """Return the mean change over the range of numbers that change smoothly, 0 for none."""
        if not self._sums.size:
            return 0.0
        total, bend, count = self._sums
        # Commands that jump, or are random, are meant to be held.
        smooth = (bend < total) & (count >= _MIN_CHANGES)
        shares = total[smooth] / (count * (self._high - self._low))[smooth]
        return float(shares.max(initial=0.0))
