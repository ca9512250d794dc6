# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Comparison of a simulation with the machine that it models, while both run."""

from collections import deque
from collections.abc import Callable
from typing import NamedTuple
import warnings

from hnn_vi_ros.effects import Command, largest_gain, Observation, select, whole_turns
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.hamiltonians import momentum
from hnn_vi_ros.models import domain_of
from hnn_vi_ros.phase_space import columns
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import build, Simulation
import numpy as np

# Valid prediction time: the error is valid below this value of sum_i (error of q_i)^2 / var_i
# (M. Lutter, J. Peters, 2021).
VALID = 0.01
# Time after which a still valid prediction is ended [s], and number of ended predictions from
# which the median is taken.
_MAX_PREDICTION, _MEDIAN_OF = 2.0, 1000
# Times that differ by at most this are equal [s].
_TIME_TOLERANCE = 1e-9


class Report(NamedTuple):
    """
    Report on an observation.

    Parameters
    ----------
    delay : float
        Time of the observation relative to now [s].
    error : np.ndarray, shape (n,)
        Observed minus simulated coordinates.
    prediction_error : np.ndarray, shape (n,)
        Observed minus predicted coordinates of the oldest prediction; NaN if there is none.
    normalised : float
        sum_i (error of the prediction of q_i)^2 / var_i [1].
    running : float
        Age of that prediction [s].

    """

    delay: float
    error: np.ndarray
    prediction_error: np.ndarray
    normalised: float
    running: float


class TwinPrediction:
    """A simulation without an observer, which starts from an observation."""

    def __init__(self, simulation: Simulation):
        self.simulation = simulation
        # Start time [s]; None while it waits.
        self.began: float | None = None


class Twin:
    """
    Comparison of a simulation, and of predictions, with observations; see Companion.

    A prediction is another simulation of the scene without its observer, with the same commands.
    It starts from an observation, at regular times, and ends when its error is no longer valid or
    after two seconds. Regular start times give an unbiased sample: if each prediction started at
    the end of the one before, hard instants would have too little or too much weight.

    Parameters
    ----------
    scene : Scene
        Resolved scene with an observer.
    simulation : Simulation
        Simulation of the scene.

    Attributes
    ----------
    names : list of str
        Names of the observed coordinates.
    newest : Report or None
        Report on the last observation.
    timeout : float
        Time for which an observation is held [s].
    heard : callable
        Called with each report.
    times : deque of float
        Valid prediction times of the last thousand ended predictions [s].
    failed : int
        Number of predictions that could not start or continue.
    outside : float
        Share of observations outside of the model's training domain; NaN if that is unknown.
    beyond : str
        Quantity that went furthest outside.

    Raises
    ------
    SceneError
        The gain is too large for the step size at the initial state.

    """

    def __init__(self, scene: Scene, simulation: Simulation):
        ((place, observer),) = ((i, choice) for i, choice in enumerate(scene.effects)
                                if choice.kind == 'observer')
        self.names, self._deviations = list(observer.coordinates), observer.deviations
        self.timeout, self._velocity_limit = observer.timeout, observer.velocity_limit
        self._gain, self._damping = observer.gain, observer.damping
        names = columns(simulation.hamiltonian.coordinates)[0]
        self._places = [names.index(name) for name in self.names]
        self._turning = simulation.system.turning[self._places]
        free = [choice.model_dump() for choice in scene.effects if choice.kind != 'observer']
        alone = scene.changed({'effects': free, 'events': [], 'uncertainty': None}).parts()
        with warnings.catch_warnings():
            # The simulation has already raised the warnings about the scene.
            warnings.simplefilter('ignore')
            self._predictions = [TwinPrediction(build(alone.copy()))
                                 for _ in range(observer.predictions)]
            first = self._predictions[0].simulation
        first.compile()
        first.compile_rescue()
        first.hamiltonian.compile()
        self._every = _MAX_PREDICTION / observer.predictions
        self.heard: Callable[[Report], None] = lambda report: None
        self._simulation, self._domain = simulation, domain_of(simulation.hamiltonian)
        with scene.placed('effects', place):
            if problem := self.unstable:
                raise ValueError(f'{problem}; reduce it, or step_size')
        self._forget()

    def _forget(self) -> None:
        """Discard all observations and predictions."""
        self.newest: Report | None = None
        self.failed = 0
        self._before: tuple[float, np.ndarray] | None = None
        self.times: deque[float] = deque(maxlen=_MEDIAN_OF)
        self._due = -np.inf
        self._outside, self._last_outside, self._furthest, self.beyond = 0, -np.inf, 0.0, ''
        self._times: dict[bool, deque[float]] = {
            out: deque(maxlen=_MEDIAN_OF) for out in (False, True)}
        self._count, self._mean, self._square = 0, np.zeros(len(self.names)), np.zeros(
            len(self.names))
        for prediction in self._predictions:
            prediction.began = None

    def begin(self, simulation: Simulation) -> None:
        """See Companion."""
        self._simulation = simulation
        self._forget()

    def advance(self, n: int) -> None:
        """See Companion."""
        for prediction in self._active():
            if prediction.began is not None and (
                    self._now - prediction.began > _MAX_PREDICTION + self.timeout):
                # Without observations, its valid time is unknown.
                prediction.began = None
                continue
            try:
                prediction.simulation.advance(n)
            except StepFailure:
                prediction.began, self.failed = None, self.failed + 1

    def set_command(self, command: Command) -> None:
        """See Companion; observations are compared."""
        if isinstance(command, Observation):
            self._observe(command)
            return
        for prediction in self._active():
            prediction.simulation.set_command(command)

    @property
    def unstable(self) -> str:
        """Return a message if the gain is too large for the state of the simulation, else ''."""
        own, h = self._simulation, self._simulation.step_size
        inverse = own.hamiltonian.inverse_mass(own.q, own.p, own.time)[
            np.ix_(self._places, self._places)]
        if not (self._gain and np.isfinite(inverse).all()):
            return ''
        # The lightest observed motion sets the limit.
        lightest = float(np.linalg.eigvalsh(0.5 * (inverse + inverse.T))[-1])
        most = largest_gain(1.0 / lightest, self._damping, h) if lightest > 0.0 else np.inf
        return '' if self._gain <= most else (
            f'gain = {self._gain:g} is not stable at step_size = {h:g} s: the limit for these '
            f'masses is {most:.3g}')

    @property
    def running(self) -> list[float]:
        """Return the age of each running prediction [s]."""
        return [self._now - began for one in self._active() if (began := one.began) is not None]

    @property
    def valid_prediction_time(self) -> float:
        """Return the median over ended predictions [s]; NaN before one has ended."""
        return float(np.median(self.times)) if self.times else np.nan

    @property
    def outside(self) -> float:
        """Return the share of observations outside of the model's training domain."""
        return self._outside / self._count if self._domain is not None and self._count else np.nan

    def valid_time(self, outside: bool) -> float:
        """Return the median [s] over predictions in which the machine left the domain, or not."""
        return float(np.median(self._times[outside])) if self._times[outside] else np.nan

    def _look(self, position: np.ndarray, velocity: np.ndarray, now: float) -> None:
        """Compare an observation with the training domain of the model."""
        if self._domain is None:
            return
        q, v = self._simulation.q.copy(), self._simulation.dH_dp.copy()
        q[self._places] = position
        v[self._places] = np.where(np.isfinite(velocity), velocity, v[self._places])
        excess = float(self._domain.excess(q[None], v[None]).max())
        if excess > 0.0:
            self._outside, self._last_outside = self._outside + 1, now
        if excess > self._furthest:
            self._furthest, self.beyond = excess, self._domain.beyond(q[None], v[None])[0]

    @property
    def _now(self) -> float:
        return float(self._simulation.steps * self._simulation.step_size)

    def _active(self) -> list[TwinPrediction]:
        """Return the running predictions, the oldest first."""
        return [one for _, one in sorted(
            ((one.began, one) for one in self._predictions if one.began is not None),
            key=lambda pair: pair[0])]

    def _observe(self, seen: Observation) -> None:
        position, velocity = select(seen, self.names)
        if self._before is not None:
            # Unwrap angles relative to the last observation.
            position = position - whole_turns(position - self._before[1], self._turning)
        velocity = self._velocity(position, velocity, seen.delay)
        self._count += 1
        change = position - self._mean
        self._mean = self._mean + change / self._count
        self._square = self._square + change * (position - self._mean)
        self._look(position, velocity, self._now + seen.delay)
        found = [(error, *self._judge(one, error, seen.delay)) for one in self._active()
                 for error in (self._error(position, one.simulation, seen.delay),)]
        error, normalised, age = found[0] if found else (
            np.full(len(self.names), np.nan), np.nan, 0.0)
        now = self._now + seen.delay
        # A prediction needs the velocity.
        if now >= self._due - _TIME_TOLERANCE and np.isfinite(velocity).all():
            self._predict(position, velocity, seen.delay)
            # At regular times, independent of the rate of the observations.
            late = self._due <= now - self._every
            self._due = (now if late else self._due) + self._every
        self.newest = Report(seen.delay, self._error(position, self._simulation, seen.delay),
                             error, normalised, age)
        self.heard(self.newest)

    def _judge(self, prediction: TwinPrediction, error: np.ndarray, delay: float
               ) -> tuple[float, float]:
        """Return normalised error and age of a prediction; end it if it is invalid or old."""
        assert prediction.began is not None, 'the prediction runs'
        age = max(0.0, self._now + delay - prediction.began)
        with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
            normalised = float(np.where(error == 0.0, 0.0, error**2 / self._variance).sum())
        if not normalised < VALID or age >= _MAX_PREDICTION - _TIME_TOLERANCE:
            self.times.append(min(age, _MAX_PREDICTION))
            self._times[self._last_outside >= prediction.began].append(min(age, _MAX_PREDICTION))
            prediction.began = None
        return normalised, age

    @property
    def _variance(self) -> np.ndarray:
        if self._deviations is not None:
            return np.square(self._deviations)
        return self._square / self._count

    def _velocity(self, position: np.ndarray, velocity: np.ndarray, delay: float) -> np.ndarray:
        """Return the velocities; missing ones from the last observation, NaN without one."""
        now, before = self._now + delay, self._before
        self._before = now, position
        if before is None or not 0.0 < now - before[0] <= self.timeout:
            return velocity
        between = (position - before[1]) / (now - before[0])
        # Two observations at almost the same time give only noise.
        between[np.abs(between) > self._velocity_limit] = np.nan
        return np.where(np.isnan(velocity), between, velocity)

    def _error(self, position: np.ndarray, simulation: Simulation, delay: float) -> np.ndarray:
        """Return observed minus simulated coordinates, extrapolated to the observation."""
        q, v = simulation.q[self._places], simulation.dH_dp[self._places]
        error: np.ndarray = position - (q + delay * v)
        return error - whole_turns(error, self._turning)

    def _predict(self, position: np.ndarray, velocity: np.ndarray, delay: float) -> None:
        """Start a prediction from an observation and, for unobserved values, the simulation."""
        waiting = [one for one in self._predictions if one.began is None]
        if not waiting:
            return
        own, simulation = self._simulation, waiting[0].simulation
        q, v = own.q.copy(), own.dH_dp.copy()
        q[self._places], v[self._places] = position - delay * velocity, velocity
        try:
            p = momentum(simulation.hamiltonian, q, v, own.p.copy())
            simulation.restart(q, p, step=own.steps, held=own.snapshot())
        except (StepFailure, ValueError):
            self.failed += 1
            return
        waiting[0].began = self._now + delay
