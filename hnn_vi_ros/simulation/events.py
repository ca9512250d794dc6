# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Events: the instants at which a condition on the state comes true."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
import math
import time
from typing import Any, Literal, TYPE_CHECKING

from hnn_vi_ros.errors import StoppedByEvent
from hnn_vi_ros.phase_space import Event
from hnn_vi_ros.scene import Condition, Scene
from hnn_vi_ros.simulation.dense_step import DenseStep
from hnn_vi_ros.simulation.simulation import Simulation
import numpy as np

# A simulation to those who use it: all but a few of its methods are passed on.
if TYPE_CHECKING:
    _Simulation = Simulation
else:
    _Simulation = object

_EPS = float(np.finfo(np.float64).eps)
# Trials within which a minimum is found, and the share of a step to which it is.
_TRIALS, _NARROW = 40, 1e-9
# Nearer to an end of an interval than this share of it, a minimum is at that end.
_END = 1e-5
# A value this many times those around it is none that comes to zero.
_POLE = 10.0


@dataclass(frozen=True)
class EventFunction:
    """
    A condition; an event is the instant at which it comes true.

    Parameters
    ----------
    condition : Condition
        The equation.
    direction : str
        Which changes of its left less its right side count: ``'up'``, ``'down'`` or ``'both'``.
    stops : bool
        Whether the run ends there.

    """

    condition: Condition
    direction: Literal['up', 'down', 'both'] = 'both'
    stops: bool = False


class WatchedSimulation(_Simulation):
    """
    A simulation whose steps are searched for events.

    Each step is looked at through its polynomial at nine places (through the path itself in
    steps that meet a wall; at nine places of each step of its own that a method takes within one
    of the clock), for changes of sign and for extrema that come close to zero; what is found
    there is found again, to round-off, on states that are as accurate as the method (see
    DenseStep). So an event that comes and goes within a step is found as well, as long as the
    polynomial shows it. The steps equal the simulation's, bit by bit; an event at the
    initial state is none.

    Parameters
    ----------
    simulation : Simulation
        Of one trajectory; all that is not listed below is its own.
    functions : sequence of EventFunction
        Functions whose zeros are the events.

    Attributes
    ----------
    events : list of Event
        What has been found since the initial state, in the order of time.

    """

    def __init__(self, simulation: Simulation, functions: Sequence[EventFunction]):
        self._simulation, self._functions = simulation, list(functions)
        self.events: list[Event] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self._simulation, name)

    def take_events(self) -> list[Event]:
        """Return the events that have been found, and forget them."""
        events, self.events = self.events, []
        return events

    def restart(self, *arguments: Any, **more: Any) -> None:
        """Restart, without events; see Simulation."""
        self._simulation.restart(*arguments, **more)
        self.events.clear()

    def advance(self, n: int, until: float = math.inf) -> int:
        """Take n steps, or fewer, and return how many; see Simulation, and ``record``."""
        for taken in range(1, n + 1):
            self.dense_step()
            if time.perf_counter() >= until:
                return taken
        return n

    def record(self, samples: int, every: int) -> tuple[np.ndarray, np.ndarray]:
        """
        Take samples times every steps; see Simulation.

        Raises
        ------
        StoppedByEvent
            One that ends the run came in a step; the state is that before the step.
        StepFailure
            A step did not converge or is not finite.

        """
        q, p = (np.empty((samples, part.size))
                for part in (self._simulation.q, self._simulation.p))
        for sample in range(samples):
            for _ in range(every):
                try:
                    self.dense_step()
                except StoppedByEvent as stop:
                    raise stop.after(q[:sample], p[:sample]) from None
            q[sample], p[sample] = self._simulation.q, self._simulation.p
        return q, p

    def dense_step(self) -> DenseStep:
        """Take one step, or raise as ``record``; return it with the states inside of it."""
        dense = self._simulation.dense_step()
        places = dense.places
        q, p = dense.outline(places)
        # The ends are known, and what is known of them decides.
        (q[0], p[0]), (q[-1], p[-1]) = dense.state(0.0), dense.state(1.0)
        found = sorted(((theta, rises, function) for function in self._functions
                        for theta, rises in self._find(dense, function, places, q, p)),
                       key=lambda one: one[0])
        for theta, rises, function in found:
            event = self._event(dense, theta, rises, function)
            self.events.append(event)
            if event.stops:
                dense.undo()
                raise StoppedByEvent(event, q[:0], p[:0], dense.state)
        return dense

    def _event(self, dense: DenseStep, theta: float, rises: bool, function: EventFunction
               ) -> Event:
        q, p = dense.state(theta)
        # One product and one rounding at the end of a step, as the simulation has it.
        steps = dense.step + 1 if theta == 1.0 else dense.step + theta
        return Event(function.condition.text, 'up' if rises else 'down', function.stops,
                     steps * self._simulation.step_size, q, p,
                     float(self._simulation.hamiltonian.energy(q, p)))

    def _find(self, dense: DenseStep, function: EventFunction, places: np.ndarray,
              q: np.ndarray, p: np.ndarray) -> Iterator[tuple[float, bool]]:
        """Yield the share of the step and whether the value rises, for each event of a kind."""
        hamiltonian, condition = self._simulation.hamiltonian, function.condition

        def value(theta: float) -> float:
            return float(condition.values(hamiltonian, *dense.state(theta)))

        def seen(theta: float | np.ndarray) -> np.ndarray:
            return condition.values(hamiltonian, *dense.outline(theta))

        values = condition.values(hamiltonian, q, p)
        # Most steps are far from it: nearer to zero than they vary no values come within one.
        size = np.abs(values)
        if size.min() > values.max() - values.min():
            return
        for start, end in _brackets(places, values, seen, value):
            rises = end[1] > 0.0 or start[1] < 0.0
            if function.direction != ('down' if rises else 'up'):
                theta = _root(value, start, end)
                # At a pole, as of 1 / x, the sign changes as well.
                if theta == end[0] or abs(value(theta)) <= _POLE * max(
                        abs(start[1]), abs(end[1])):
                    yield theta, rises


def watched(simulation: Simulation, scene: Scene) -> Simulation:
    """
    Return a simulation that watches for the events of its scene; itself if it has none.

    Raises
    ------
    SceneError
        A condition names what the system does not have.

    """
    if not scene.events:
        return simulation
    functions = []
    for i, choice in enumerate(scene.events):
        function = EventFunction(Condition(choice.when), choice.direction, choice.then == 'stop')
        with scene.placed('events', i):
            function.condition.check(simulation.hamiltonian)
        functions.append(function)
    return WatchedSimulation(simulation, functions)


Place = tuple[float, float]


def _brackets(at: np.ndarray, values: np.ndarray, seen: Callable,
              value: Callable[[float], float]) -> Iterator[tuple[Place, Place]]:
    """Yield pairs of places, each with its value, between which the value changes its sign."""
    for thetas, part in _stretches(at, values, value):
        if part[0] == 0.0:
            # The event was at the end of the step before, or is none at the initial state.
            part[0] = _after(part)
        if part[0] == 0.0:
            continue
        places = [(float(thetas[0]), float(part[0]))]
        for k in range(1, len(part)):
            places += _dips(thetas, part, k, seen, value)
            last = k == len(part) - 1
            # Inside the step, the polynomial is only near to the true values.
            crosses = part[k - 1] * part[k] <= 0.0
            if last or crosses or part[k] * places[-1][1] <= 0.0:
                theta = float(thetas[k])
                places.append((theta, float(part[k]) if last else value(theta)))
        for start, end in pairwise(places):
            if start[1] * end[1] < 0.0 or (end[1] == 0.0 and start[1] != 0.0):
                yield start, end


def _stretches(at: np.ndarray, values: np.ndarray, value: Callable[[float], float]
               ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """
    Yield the places, with their values, of each part of a step in which the value is a number.

    It is none where, such as, a root of a negative number is taken.
    """
    finite = np.isfinite(values)
    ends = np.flatnonzero(np.diff(np.concatenate([[False], finite, [False]])))
    for first, behind in ends.reshape(-1, 2):
        places = [(float(at[k]), float(values[k])) for k in range(first, behind)]
        if first > 0:
            places.insert(0, _edge(value, places[0], float(at[first - 1])))
        if behind < len(values):
            places.append(_edge(value, places[-1], float(at[behind])))
        thetas, part = np.transpose(places)
        yield thetas, part


def _edge(value: Callable[[float], float], inside: Place, outside: float) -> Place:
    """Return the last place, from one where the value is a number to one where it is none."""
    while abs(inside[0] - outside) > _NARROW:
        middle = 0.5 * (inside[0] + outside)
        there = value(middle)
        inside, outside = ((middle, there), outside) if np.isfinite(there) else (inside, middle)
    return inside


def _after(values: np.ndarray) -> float:
    """Return a number of the sign that the values take after the first one."""
    others = values[np.isfinite(values) & (values != 0.0)]
    return float(np.copysign(_EPS * np.abs(others).max(), others[0])) if others.size else 0.0


def _dips(thetas: np.ndarray, values: np.ndarray, k: int, seen: Callable,
          value: Callable[[float], float]) -> list[Place]:
    """Return the place between k - 1 and k, if any, at which a value turns near zero."""
    low, high = max(0, k - 2), min(len(values) - 1, k + 1)
    near = values[low:high + 1]
    sign = np.sign(values[k])
    # It could turn by no more than the values around it differ.
    if values[k - 1] * values[k] <= 0.0 or \
            min(sign * values[k - 1], sign * values[k]) > np.ptp(near):
        return []
    # Imported here: only scenes with events wait the half second that this takes.
    from scipy.optimize import minimize_scalar
    start, end = float(thetas[k - 1]), float(thetas[k])

    def lowest(function: Callable) -> tuple[float, float]:
        found = minimize_scalar(lambda x: sign * float(function(x)), bounds=(start, end),
                                method='bounded', options={'xatol': _NARROW, 'maxiter': _TRIALS})
        return float(found.x), sign * float(found.fun)

    theta, expected = lowest(seen)
    if min(theta - start, end - theta) <= _END * (end - start):
        # It does not turn here.
        return []
    actual = value(theta)
    if sign * actual > 0.0 and abs(actual) <= 4.0 * abs(actual - expected):
        # Too close for the polynomial to tell.
        theta, actual = lowest(value)
    return [(theta, actual)] if sign * actual < 0.0 else []


def _root(value: Callable[[float], float], start: Place, end: Place) -> float:
    """Return where the value is zero between two places, to round-off."""
    if end[1] == 0.0:
        return end[0]
    from scipy.optimize import brentq

    def of_sign(theta: float) -> float:
        # At an end the value is what it was taken for there.
        return {start[0]: start[1], end[0]: end[1]}.get(theta, value(theta))
    return float(brentq(of_sign, start[0], end[0], xtol=_EPS, rtol=4.0 * _EPS))
