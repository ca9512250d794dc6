# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The run taken a second and a third time with other steps, which shows its path error."""

from collections import deque
from collections.abc import Iterator
import math
import sys
from threading import Event
from typing import cast, NamedTuple

from hnn_vi_ros.effects import Command
from hnn_vi_ros.errors import HnnViRosError, StepFailure
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation.guards.base import Alarm, Guard, StateGuard
from hnn_vi_ros.simulation.guards.facts import RunFacts
from hnn_vi_ros.simulation.guards.samples import Observed
from hnn_vi_ros.simulation.path_error import (
    ACCURATE, ComparedMotion, FEW_STEPS_LIMIT, LIMIT, LOST, OFF, path_errors_of, PathError,
    Repetition, Separation, Turns)
from hnn_vi_ros.simulation.processors import Helper
from hnn_vi_ros.simulation.simulation import RescuePending, Simulation
import numpy as np

KIND = 'path not resolved'
# Number of steps of the first stretch, and maximum number of coordinates stored for it.
_MAX_STEPS, _MAX_NUMBERS = 1_000_000, 2**23
# Steps below which a motion from rest has hardly developed.
_MIN_JUDGED_STEPS = 52
# Steps up to which a run is short: it is repeated with h / 2 and h / 4.
_SHORT = 104
# First steps, with which the amplitude after them is compared.
_FIRST_STEPS = 1040
# Wall time between two looks at a run in real time [s].
_PERIOD = 0.25
# Steps of the first block of the run, coordinates of the largest block, and steps before a thread
# begins to help.
_FIRST_BLOCK, _BLOCK_NUMBERS, _MIN_THREAD_STEPS = 1024, 2**17, 512
# The smallest factor of a step size, or of a tolerance, that is recommended.
_LEAST_FACTOR = 1e-3
# Instants that are compared at a time.
_PART = 1024
# Ratio of successive numbers of steps at which a run in real time is judged.
_JUDGED = 1.25
_HALVES, _TOLERANCES = (0.5, 0.25), (32.0, 1.0 / 32.0)
# Range of exponents of a tolerance in the error.
_TOLERANCE_EXPONENTS = 0.2, 1.2
_LEAST_ORDER = 0.5


def _refusal(simulation: Simulation) -> str:
    """Return the reason that the path error of a run cannot be measured, '' if it can."""
    if any(effect.random for effect in simulation.effects):
        return 'noise draws other numbers at another step size'
    if simulation.hamiltonian.scheme is not None:
        return 'H was learned with its method and step size, and is valid at these alone'
    return ''


def _repetition(simulation: Simulation, steps: float) -> Repetition:
    """Return how a run of this many steps is repeated."""
    method, short = simulation.integrator, steps < _SHORT
    if method.tolerances:
        stride = 1 if short else 8
        return Repetition(_TOLERANCES, (stride, stride), (stride, stride), _TOLERANCE_EXPONENTS,
                          adaptive=True)
    orders = _LEAST_ORDER, float(max(method.order, 1))
    if short or simulation.motors.takes:
        # Commands are held for whole steps.
        return Repetition(_HALVES, (1, 1), (2, 4), orders)
    return Repetition((13.0 / 8.0, 8.0 / 13.0), (13, 8), (8, 13), orders)


class _Block(NamedTuple):
    """Steps `first` + 1 to `last` of a stretch of the run, and q at the common instants."""

    first: int
    last: int
    q: dict[int, np.ndarray]


class _Other:
    """Another run of a stretch, which follows the blocks and commands of the run."""

    def __init__(self, run: Simulation, simulation: Simulation, row: np.ndarray, stride: int,
                 own: int, separation: Separation):
        self._run, self._simulation, self._stride, self._own = run, simulation, stride, own
        self.separation, self.ended, self.failed = separation, False, math.nan
        # Index of the next item; steps and states of the run that are to be compared.
        self._next, self._steps, self._q = 0, np.empty(0, int), np.empty(0)
        simulation.put_from(run, row)

    def follow(self, items: 'list[_Block | Command]', until: float, wait: bool) -> bool:
        """
        Follow the items that are new, until a step of the run.

        Return False if a step needs a rescue that is still being compiled, and `wait` is False:
        the next call goes on there.
        """
        self._simulation.rescue_ready = wait or self._run.rescue_ready
        try:
            while not self.ended and (len(self._steps) or self._next < len(items)):
                if len(self._steps):
                    if self._steps[0] > until:
                        return True
                    self._take(until)
                elif isinstance(item := items[self._next], _Block):
                    self._gather(items)
                else:
                    self._simulation.set_command(item, limited=False)
                    self._next += 1
        except RescuePending:
            return False
        except (HnnViRosError, ValueError):
            # The steps of the run itself succeeded.
            self.ended, self.failed = True, float(self._steps[0]) if len(self._steps) else 0.0
        return True

    def alone(self, step_size: float, row: np.ndarray, samples: int, every: int, wait: bool
              ) -> np.ndarray:
        """Return q of a run of another step size, before this one begins; both from a row."""
        simulation, own = self._simulation, self._simulation.step_size
        simulation.step_size, simulation.rescue_ready = step_size, wait or self._run.rescue_ready
        try:
            return simulation.record(samples, every)[0]
        finally:
            simulation.step_size = own
            simulation.put_from(self._run, row)

    def _gather(self, items: 'list[_Block | Command]') -> None:
        """Take the next blocks, up to a command, as steps and states to be compared."""
        blocks = list[_Block]()
        while self._next < len(items) and isinstance(item := items[self._next], _Block):
            blocks.append(item)
            self._next += 1
        self._q = np.concatenate([block.q[self._stride] for block in blocks])
        self._steps = self._stride * (
            blocks[0].first // self._stride + 1 + np.arange(len(self._q)))

    def _take(self, until: float) -> None:
        """Compare the next instants, in parts: little is then computed behind a lost path."""
        simulation, row = self._simulation, self._simulation.row
        size = min(_PART, int(np.searchsorted(self._steps, until, side='right')))
        while True:
            try:
                other, _ = simulation.record(size, self._own)
                break
            except (StepFailure, RescuePending):
                simulation.put(row)
                if size == 1:
                    raise
                size = max(1, size // 8)
        part, steps = self._q[:size], self._steps[:size]
        self._q, self._steps = self._q[size:], self._steps[size:]
        self.separation.add(steps, part, other.reshape(part.shape))
        self.ended = bool((self.separation.last > LOST).all())


class _Stretch:
    """
    A part of a run that is compared with others from the same state.

    Parameters
    ----------
    simulation : Simulation
        Simulation at the start of the stretch.
    repetition : Repetition
        How it is repeated.
    most : int
        Maximum number of steps.
    until_turned : bool
        End after ten turns.
    live : bool
        Judge it also before its end.
    expected : float
        Number of steps of the whole run; inf if it is not known.
    needed : float, optional
        Time until which the path must be kept [s]; see SecondRun.
    told : set of int
        Trajectories whose alarm was raised.

    Attributes
    ----------
    errors : list of PathError
        Path error of each trajectory, when it was judged last.

    """

    def __init__(self, simulation: Simulation, repetition: Repetition, most: int,
                 until_turned: bool, live: bool, expected: float, needed: float | None,
                 told: set[int]):
        self._simulation, self._repetition, self._until_turned, self._expected, self._needed = (
            simulation, repetition, until_turned, expected, needed)
        self.origin, self.most, self.taken, self.over = simulation.steps, most, 0, False
        # Alarms do not depend on the speed of the machine: the run is judged at these steps.
        self._judged_next, self._judged = _MIN_JUDGED_STEPS if live else sys.maxsize, False
        self._row = simulation.state.without_counts(simulation.row)
        q = simulation.q.reshape(-1, simulation.hamiltonian.dimension)
        self._motion = ComparedMotion(simulation.hamiltonian, simulation.system.turning, q.copy())
        self.turns = Turns(self._motion)
        self._items: list[_Block | Command] = []
        self._turned = deque[tuple[int, np.ndarray]]()
        self.second, self.third = self._other(0), cast(_Other | None, None)
        # Fast motions decay between the first common instants: distances from a run with h / 2,
        # and the first states until they are compared with it.
        self._early = np.zeros_like(self._motion.values(q[None])[0])
        self._first: list[np.ndarray] | None = (
            None if 1 in repetition.strides or repetition.adaptive else [])
        self._told, self.errors = told, list[PathError]()

    def _other(self, k: int) -> _Other:
        run, repetition = self._simulation, self._repetition
        factor, stride = repetition.factors[k], repetition.strides[k]
        simulation = run.sibling(1.0 if repetition.adaptive else factor,
                                 factor if repetition.adaptive else 1.0)
        return _Other(run, simulation, self._row, stride, repetition.own[k],
                      Separation(self._motion, -(-_FIRST_STEPS // stride)))

    def add(self, q: np.ndarray) -> None:
        """Add the states after the next steps, (n, m, d)."""
        first, taken = self.taken, self.taken + len(q)
        self._items.append(_Block(first, taken, {
            stride: q[stride - 1 - first % stride::stride].copy()
            for stride in self._repetition.strides}))
        if self._first is not None and first < _SHORT:
            self._first.append(q[:_SHORT - first].copy())
        if not self.turns.counted:
            self._turned.append((first + 1, q.copy()))
        # Last: a thread then finds all that it counts.
        self.taken = taken
        self.over = self.over or taken >= self.most

    def command(self, command: Command) -> None:
        """Add a command before the next step."""
        self._items.append(command)

    def work(self, end: bool = False) -> list[tuple[int, Alarm]]:
        """Take the other runs as far as the run, `end` if no steps follow; return new alarms."""
        end, taken = end or self.over, self.taken
        turned = [self._turned.popleft() for _ in range(len(self._turned))]
        if turned:
            self.turns.add(turned[0][0], np.concatenate([q for _, q in turned]))
        if self._first is not None:
            if (taken < _SHORT and not end) or not self._compare_first(
                    np.concatenate(self._first), end):
                return []
            self._first = None
        found = list[tuple[int, Alarm]]()
        while not self._judged and self._judged_next <= taken:
            if not self._follow(self._judged_next, end):
                return found
            found += self._judge(self._judged_next)
            other = self.second if self.third is None else self.third
            turned_by = self.turns.ends[1] <= self._judged_next
            self._judged = other.ended or (self._until_turned and bool(turned_by.all()))
            self._judged_next = min(math.ceil(_JUDGED * self._judged_next), max(
                self.most, self._judged_next + 1))
        if not self._judged:
            self._follow(math.inf if end else self._judged_next, end, end)
            if end:
                found += self._judge(taken)
        self._judged = self._judged or end
        self.over = self.over or self._judged
        return found

    def _follow(self, until: float, wait: bool, end: bool = False) -> bool:
        """Follow the run; `end` if no steps follow. Return False as `_Other.follow` does."""
        complete = self.second.follow(self._items, until, wait)
        if end:
            self.second.separation.finish()
        if self.third is None and (
                not math.isnan(self.second.failed)
                or (self._repetition.bound * self.second.separation.last > ACCURATE).any()):
            self.third = self._other(1)
        if self.third is not None:
            complete = self.third.follow(self._items, until, wait) and complete
            if end:
                self.third.separation.finish()
        return complete

    def _compare_first(self, q: np.ndarray, wait: bool) -> bool:
        """Compare the first states with those of a run with h / 2; False as `_Other.follow`."""
        separation = Separation(self._motion, len(q))
        try:
            other = self.second.alone(
                0.5 * self._simulation.step_size, self._row, len(q), 2, wait)
            separation.add(np.arange(len(q)), q, other.reshape(q.shape), end=True)
        except RescuePending:
            return False
        except StepFailure:
            # Where the second run fails too, it is said.
            pass
        self._early = separation.apart
        return True

    def _judge(self, steps: int) -> Iterator[tuple[int, Alarm]]:
        """Judge the trajectories at a number of steps; yield the alarm of each, once."""
        h, second = self._simulation.step_size, self.second.separation
        self.errors = path_errors_of(
            self._repetition, h, self.origin, second.share(self._early), second,
            None if self.third is None else self.third.separation, self.turns, self._needed,
            LIMIT if steps >= _MIN_JUDGED_STEPS else FEW_STEPS_LIMIT)
        for row, error in enumerate(self.errors):
            if row in self._told:
                continue
            if not math.isnan(error.lost):
                self._told.add(row)
                end = steps if math.isinf(self._expected) else self._expected
                yield row, _alarm(error, self._repetition, h, end * h)
            elif self.third is not None and not math.isnan(self.third.failed):
                self._told.add(row)
                yield row, Alarm(KIND, self.origin + int(self.third.failed), math.inf, LIMIT, (
                    'a repetition with smaller steps fails where the run does not: the path is '
                    'wrong; use a smaller step_size'), '1')


def _alarm(error: PathError, repetition: Repetition, h: float, end: float) -> Alarm:
    """Return the alarm of a lost path, with a step size, or tolerance, that resolves it."""
    until = error.t <= error.needed
    size, last = float(error.value[until].max()), float(error.t[until][-1])
    # Errors grow at least in proportion to time, also after the comparison has ended.
    size_at_end = size * max(1.0, min(error.needed, end) / last)
    factor = (error.limit / size_at_end) ** (1.0 / error.exponent)
    what = 'a much smaller step_size'
    if factor >= _LEAST_FACTOR:
        what = (f'tolerances {factor:.1g} times as large' if repetition.adaptive else
                f'step_size {_rounded(h * factor):g}')
    off = f'by {100.0 * size:.2g} % of' if size < LOST else 'by more than'
    return Alarm(KIND, round(error.lost / h), min(size, LOST), error.limit, (
        f'the path is off {off} its amplitude at {last:.3g} s; use {what}, or a method of higher '
        'order'), '1')


def _rounded(value: float) -> float:
    """Return a number rounded down to two digits."""
    digit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f'{math.floor(value / digit * (1.0 + 1e-12)) * digit:.2g}')


class SecondRun:
    """
    Second run of a simulation with other steps, from which its path error is known.

    The run is taken again with 13/8 of its step size, and compared at all common instants. The
    distance bounds the error. Where it exceeds 1 % of the amplitude, a third run with 8/13 of the
    step size shows the order of convergence, and thereby the error itself. Runs with commands,
    which are held for whole steps, and runs of few steps are repeated with a half and a quarter of
    the step size; adaptive methods with other tolerances. The simulation feeds it: it has the
    states after all steps, and the commands.

    The first million steps are compared, or fewer of large systems; then stretches of at least ten
    turns, which start from the state of the run after two million steps, four, and so on. A
    comparison ends where the path is lost. These numbers are fixed: results do not depend on the
    speed of the machine.

    Parameters
    ----------
    simulation : Simulation
        Simulation of one trajectory, or of m that step together. Assigned to its ``second``, the
        second run follows it.
    steps : float, optional
        Number of steps of the run, if known.
    needed : float, optional
        Time until which the path must be kept [s]; by default for ten turns of the slowest
        coordinate that oscillates, one in chaos.
    period : float, optional
        Repeat the run in a thread beside it, if it has many steps, and wait for as long between
        two looks at it [s]; without it the run is repeated at its end.

    Attributes
    ----------
    errors : list of PathError
        Path error of each trajectory in the first stretch, when it was judged last.

    """

    def __init__(self, simulation: Simulation, steps: float = math.inf,
                 needed: float | None = None, period: float | None = None):
        self._simulation, self._repetition = simulation, _repetition(simulation, steps)
        self._steps, self._needed = steps, needed
        self._most = max(_SHORT, min(_MAX_STEPS, _MAX_NUMBERS // max(simulation.q.size, 1)))
        self._chunk = _FIRST_BLOCK
        self._stretches, self._next = list[_Stretch](), simulation.steps
        self._told = set[int]()
        self._first, self._expected = simulation.steps, simulation.steps
        self._rows = simulation.q.size // simulation.hamiltonian.dimension
        self._period = period or 0.0
        self._helper = None if period is None else Helper(self._help)
        self._wake, self._done = Event(), Event()
        self._alarms = list[tuple[int, Alarm]]()
        self.errors: list[PathError] = []

    def span(self) -> tuple[int, bool]:
        """Return the number of steps until the next change, and whether they are recorded."""
        simulation, steps = self._simulation, self._simulation.steps
        now = self._stretches[-1] if self._stretches else None
        if now is not None and not now.over and steps != self._expected:
            self.begin_anew()
        if now is None or now.over:
            if steps < self._next:
                return self._next - steps, False
            self._stretches.append(now := _Stretch(
                simulation, self._repetition, self._most, bool(self._stretches),
                bool(self._period or self._stretches), self._steps, self._needed, self._told))
            self._next = self._first + 2 * max(steps - self._first, self._most)
            self._expected = steps
        return min(now.most - now.taken, self._chunk), True

    def take(self, q: np.ndarray) -> None:
        """Take the states after the next steps, (n, N); none if the first of them failed."""
        if not len(q):
            return
        stretch = self._stretches[-1]
        if len(q) == self._chunk:
            self._chunk = min(2 * len(q), max(1, _BLOCK_NUMBERS // q.shape[1]))
        stretch.add(q.reshape(len(q), self._rows, q.shape[1] // self._rows)[
            ..., :self._simulation.hamiltonian.dimension])
        self._expected = self._simulation.steps
        if self._helper is not None:
            if not self._helper.started and stretch.taken >= _MIN_THREAD_STEPS:
                self._helper.start()
            self._wake.set()

    def begin_anew(self) -> None:
        """Begin another stretch at the next step, whose state is not that of the last one."""
        if self._stretches:
            self._stretches[-1].over = True
        self._next = self._simulation.steps

    def command(self, command: Command) -> None:
        """Take a command that is set before the next step."""
        if self._stretches and not self._stretches[-1].over:
            self._stretches[-1].command(command)

    def _help(self) -> None:
        while not self._done.is_set():
            self._wake.wait()
            self._wake.clear()
            self._follow()
            self._done.wait(self._period)

    def _follow(self, end: bool = False) -> None:
        """Follow the run as far as it is known, and publish what is found."""
        for stretch in self._stretches:
            self._alarms += stretch.work(end)
        if self._stretches:
            self.errors = self._stretches[0].errors

    def alarms(self) -> list[tuple[int, Alarm]]:
        """Return the alarms found since the last call, each with the index of its trajectory."""
        found, self._alarms = self._alarms, []
        return found

    def finish(self) -> list[tuple[int, Alarm]]:
        """Follow the run to its end; return the new alarms."""
        self._done.set()
        self._wake.set()
        if self._helper is not None:
            self._helper.join()
        self._follow(end=True)
        return self.alarms()

    def close(self) -> None:
        """End the thread at once."""
        self._done.set()
        self._wake.set()
        if self._helper is not None:
            self._helper.stop()


class PathReport:
    """
    Path error of a run: its second run, or the reason that there is none.

    Parameters
    ----------
    wanted : bool, optional
        False to take the run once.
    needed : float, optional
        Time until which the path must be kept [s]; see SecondRun.

    Attributes
    ----------
    finished : bool
        The run was followed to its end.

    """

    def __init__(self, wanted: bool = True, needed: float | None = None):
        self._wanted, self._needed, self._reason, self.finished = wanted, needed, OFF, False
        self._second: SecondRun | None = None

    @classmethod
    def of(cls, scene: Scene, wanted: bool = True) -> 'PathReport':
        """Return the path report of a run of a scene, if it is also `wanted` otherwise."""
        return cls(wanted and scene.path_error == 'measured', scene.path_tolerance)

    def follow(self, simulation: Simulation, steps: float = math.inf,
               period: float | None = _PERIOD) -> None:
        """Follow the next steps of a simulation; see SecondRun."""
        self.close()
        self.finished = False
        self._reason = _refusal(simulation) if self._wanted else OFF
        self._second = None if self._reason else SecondRun(
            simulation, steps, self._needed, period)
        simulation.follow_by(self._second)

    def errors(self, rows: int = 1) -> list[PathError]:
        """Return the path errors of the trajectories, as far as they are known."""
        if self._second is None:
            return [PathError.unmeasured(self._reason)] * rows
        return self._second.errors or [PathError.unmeasured('')] * rows

    def finish(self) -> list[tuple[int, Alarm]]:
        """Follow the run to its end; return the new alarms."""
        self.finished = True
        return [] if self._second is None else self._second.finish()

    def close(self) -> None:
        """End the second run at once."""
        if self._second is not None:
            self._second.close()

    def __str__(self) -> str:
        return str(self.errors()[0])


class PathGuard(StateGuard):
    """
    Path error: at most 10 % of the amplitude in ten turns of the slowest oscillating coordinate.

    In chaos, which no path survives for long, in one turn; in a run that does not oscillate, to
    its end. The error is that of SecondRun. Later the phase of a long run may be lost, while its
    energies and its statistics stay right.

    Parameters
    ----------
    second : SecondRun
        The second run.

    """

    kind = KIND
    remedy = ('use a smaller step_size or a method of higher order; the energy may still be '
              'accurate')

    def __init__(self, second: SecondRun):
        self._second, self._found = second, list[Alarm]()

    @classmethod
    def of_run(cls, run: RunFacts) -> Iterator[Guard]:
        if run.simulation.second is not None:
            yield cls(run.simulation.second)

    def update(self, sample: Observed) -> Alarm | None:
        self._found += [alarm for _, alarm in self._second.alarms()]
        return self._found.pop(0) if self._found else None

    def renew(self, sample: Observed) -> Alarm | None:
        return None
