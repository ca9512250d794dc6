# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Events: the times at which a condition on the state becomes true."""

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

# WatchedSimulation has the interface of Simulation: most attributes are delegated.
if TYPE_CHECKING:
    _Simulation = Simulation
else:
    _Simulation = object

_EPS = float(np.finfo(np.float64).eps)
# Maximum number of evaluations of the search for a minimum, and its tolerance, in steps.
_MAX_TRIALS, _TOLERANCE = 40, 1e-9
# A minimum closer to an end of an interval than this share of it counts as at that end.
_END_SHARE = 1e-5
# A value beyond this multiple of its neighbours indicates a pole, not a zero.
_MIN_POLE_RATIO = 10.0


@dataclass(frozen=True)
class EventFunction:
    """
    Event condition, with the direction of its zero crossings.

    Parameters
    ----------
    condition : Condition
        Equation that holds at the event.
    direction : str
        Direction in which left minus right side crosses zero: ``'up'``, ``'down'`` or ``'both'``.
    stops : bool
        End the run at the event.

    """

    condition: Condition
    direction: Literal['up', 'down', 'both'] = 'both'
    stops: bool = False


class WatchedSimulation(_Simulation):
    """
    Simulation with event detection in each step.

    The polynomial of each step is evaluated at nine points (of the path itself if the step meets
    a wall; at nine points of each internal step of a method), and searched for sign changes and
    for extrema close to zero. Candidates are then located to round-off on states as accurate as
    the method (see DenseStep). An event that begins and ends within a step is found as well, if
    the polynomial shows it. The steps are bit-identical to those without event detection; a zero
    at the initial state is not an event.

    Parameters
    ----------
    simulation : Simulation
        Simulation of one trajectory; attributes not listed below are delegated to it.
    functions : sequence of EventFunction
        Functions whose zeros are the events.

    Attributes
    ----------
    events : list of Event
        Events since the initial state, in chronological order.

    """

    def __init__(self, simulation: Simulation, functions: Sequence[EventFunction]):
        self._simulation, self._functions = simulation, list(functions)
        self.events: list[Event] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self._simulation, name)

    def take_events(self) -> list[Event]:
        """Return the events found so far, and clear the list."""
        events, self.events = self.events, []
        return events

    def restart(self, *arguments: Any, **more: Any) -> None:
        """Restart with an empty list of events; see Simulation."""
        self._simulation.restart(*arguments, **more)
        self.events.clear()

    def advance(self, n: int, until: float = math.inf) -> int:
        """Take n steps, or fewer, and return their number; see Simulation, and ``record``."""
        for taken in range(1, n + 1):
            self.dense_step()
            if time.perf_counter() >= until:
                return taken
        return n

    def record(self, samples: int, every: int) -> tuple[np.ndarray, np.ndarray]:
        """
        Take samples times every steps, and return samples; see Simulation.

        Raises
        ------
        StoppedByEvent
            An event ended the run; the state is that before its step.
        StepFailure
            A step did not converge, or its result is not finite.

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
        """Take one step and return it with dense output; raises the errors of ``record``."""
        dense = self._simulation.dense_step()
        places = dense.places
        q, p = dense.outline(places)
        # Replace the ends by the exact states, which decide.
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
        # At the end of a step compute the time as the simulation does, with one rounding.
        steps = dense.step + 1 if theta == 1.0 else dense.step + theta
        t = steps * self._simulation.step_size
        return Event(function.condition.text, 'up' if rises else 'down', function.stops, t, q, p,
                     float(self._simulation.hamiltonian.energy(q, p, t)))

    def _find(self, dense: DenseStep, function: EventFunction, places: np.ndarray,
              q: np.ndarray, p: np.ndarray) -> Iterator[tuple[float, bool]]:
        """Yield the fraction of the step, and whether the value rises, for each event."""
        hamiltonian, condition = self._simulation.hamiltonian, function.condition

        def time(theta: float | np.ndarray) -> float | np.ndarray:
            return (dense.step + theta) * self._simulation.step_size

        def value(theta: float) -> float:
            return float(condition.values(hamiltonian, *dense.state(theta), time(theta)))

        def seen(theta: float | np.ndarray) -> np.ndarray:
            return condition.values(hamiltonian, *dense.outline(theta), time(theta))

        values = condition.values(hamiltonian, q, p, time(places))
        # Skip most steps: all values are farther from zero than the width of their range.
        size = np.abs(values)
        if size.min() > values.max() - values.min():
            return
        for start, end in _brackets(places, values, seen, value):
            rises = end[1] > 0.0 or start[1] < 0.0
            if function.direction != ('down' if rises else 'up'):
                theta = _root(value, start, end)
                # The sign also changes at a pole, such as that of 1 / x.
                if theta == end[0] or abs(value(theta)) <= _MIN_POLE_RATIO * max(
                        abs(start[1]), abs(end[1])):
                    yield theta, rises


def watched(simulation: Simulation, scene: Scene) -> Simulation:
    """
    Return a simulation that detects the events of its scene; itself if there are none.

    Raises
    ------
    SceneError
        A condition contains a name that the system does not have.

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
    """Yield pairs of points, each with its value, between which the value changes its sign."""
    for thetas, part in _stretches(at, values, value):
        if part[0] == 0.0:
            # This zero was found at the end of the previous step, or is the initial state.
            part[0] = _after(part)
        if part[0] == 0.0:
            continue
        places = [(float(thetas[0]), float(part[0]))]
        for k in range(1, len(part)):
            places += _dips(thetas, part, k, seen, value)
            last = k == len(part) - 1
            # Inside the step, the polynomial only approximates the true values.
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
    Yield the points, with their values, of each part of a step in which the value is finite.

    It is not finite, for example, at the square root of a negative number.
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
    """Return the last point with a finite value, from `inside` towards `outside`."""
    while abs(inside[0] - outside) > _TOLERANCE:
        middle = 0.5 * (inside[0] + outside)
        there = value(middle)
        inside, outside = ((middle, there), outside) if np.isfinite(there) else (inside, middle)
    return inside


def _after(values: np.ndarray) -> float:
    """Return a small number with the sign of the next nonzero value; 0 if there is none."""
    others = values[np.isfinite(values) & (values != 0.0)]
    return float(np.copysign(_EPS * np.abs(others).max(), others[0])) if others.size else 0.0


def _dips(thetas: np.ndarray, values: np.ndarray, k: int, seen: Callable,
          value: Callable[[float], float]) -> list[Place]:
    """Return the extremum between points k - 1 and k in a list, empty unless beyond zero."""
    low, high = max(0, k - 2), min(len(values) - 1, k + 1)
    near = values[low:high + 1]
    sign = np.sign(values[k])
    # The overshoot is assumed to be at most the range of the neighbouring values.
    if values[k - 1] * values[k] <= 0.0 or \
            min(sign * values[k - 1], sign * values[k]) > np.ptp(near):
        return []
    # Imported lazily: the import takes half a second, and only scenes with events need it.
    from scipy.optimize import minimize_scalar
    start, end = float(thetas[k - 1]), float(thetas[k])

    def lowest(function: Callable) -> tuple[float, float]:
        found = minimize_scalar(lambda x: sign * float(function(x)), bounds=(start, end),
                                method='bounded',
                                options={'xatol': _TOLERANCE, 'maxiter': _MAX_TRIALS})
        return float(found.x), sign * float(found.fun)

    theta, expected = lowest(seen)
    if min(theta - start, end - theta) <= _END_SHARE * (end - start):
        # There is no extremum inside the interval.
        return []
    actual = value(theta)
    if sign * actual > 0.0 and abs(actual) <= 4.0 * abs(actual - expected):
        # The polynomial is not accurate enough here: search on the true values.
        theta, actual = lowest(value)
    return [(theta, actual)] if sign * actual < 0.0 else []


def _root(value: Callable[[float], float], start: Place, end: Place) -> float:
    """Return the zero of the value between two points, to round-off."""
    if end[1] == 0.0:
        return end[0]
    from scipy.optimize import brentq

    def of_sign(theta: float) -> float:
        # At the ends use the given values, whose signs differ.
        return {start[0]: start[1], end[0]: end[1]}.get(theta, value(theta))
    return float(brentq(of_sign, start[0], end[0], xtol=_EPS, rtol=4.0 * _EPS))
