# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""How well a simulation follows the machine that it is the twin of, while both run."""

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple
import warnings

from hnn_vi_ros.effects.commands import Command, JointPath, Observation
from hnn_vi_ros.effects.observations import select
from hnn_vi_ros.errors import ModelError, StepFailure
from hnn_vi_ros.hamiltonians.momenta import momentum
from hnn_vi_ros.phase_space import columns
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.build import build
import numpy as np

# A prediction is valid until sum_i (error of q_i)^2 / var_i reaches this (M. Lutter, J. Peters,
# 2021).
VALID = 0.01
# A prediction that is still valid after this time ends all the same [s], and predictions of
# which the median is taken.
_LONGEST, _KEPT = 2.0, 1000


class Report(NamedTuple):
    """
    What an observation tells.

    Parameters
    ----------
    delay : float
        From now to when it was made [s].
    error : np.ndarray, shape (n,)
        Observed less simulated coordinates.
    prediction_error : np.ndarray, shape (n,)
        Observed less predicted ones; NaN while nothing is predicted.
    normalised : float
        sum_i (error of the prediction of q_i)^2 / var_i [1].
    running : float
        For how long the present prediction has been valid [s].

    """

    delay: float
    error: np.ndarray
    prediction_error: np.ndarray
    normalised: float
    running: float


class Twin:
    """
    Compare a simulation, and predictions beside it, with what is observed; see Companion.

    A prediction is a second simulation of the scene without its observer, under the same
    commands. It begins at an observation, and ends where its error is no longer valid, or after
    two seconds; then the next one begins at the observation that ended it.

    Parameters
    ----------
    scene : Scene
        Resolved, with an observer.
    simulation : Simulation
        Of it.

    Attributes
    ----------
    names : list of str
        What is observed.
    newest : Report or None
        Of the last observation.
    failed : int
        Predictions that could not begin or go on.

    """

    def __init__(self, scene: Scene, simulation: Simulation):
        (observer,) = (choice for choice in scene.effects if choice.kind == 'observer')
        self.names, self._deviations = list(observer.coordinates), observer.deviations
        names = columns(simulation.hamiltonian.coordinates)[0]
        self._places = [names.index(name) for name in self.names]
        free = [choice.model_dump() for choice in scene.effects if choice.kind != 'observer']
        with warnings.catch_warnings():
            # What is to be said of the scene is said of the simulation.
            warnings.simplefilter('ignore')
            self._shadow = build(scene.changed({'effects': free, 'events': []}))
            self._shadow.compile()
        self.newest: Report | None = None
        self.failed = 0
        self._simulation, self._command = simulation, None
        self._ended: deque[float] = deque(maxlen=_KEPT)
        self._forget()

    def _forget(self) -> None:
        """Know nothing of the machine."""
        self.newest, self.failed = None, 0
        self._command = self._before = None
        self._began: float | None = None
        self._ended.clear()
        self._count, self._mean, self._square = 0, np.zeros(len(self.names)), np.zeros(
            len(self.names))

    def begin(self, simulation: Simulation) -> None:
        """See Companion."""
        self._simulation = simulation
        self._forget()

    def advance(self, n: int) -> None:
        """See Companion."""
        if self._began is not None:
            try:
                self._shadow.advance(n)
            except StepFailure:
                self._fail()

    def set_command(self, command: Command) -> None:
        """See Companion; an observation is compared."""
        if isinstance(command, Observation):
            self._observe(command)
            return
        self._command = command, self._now
        if self._began is not None:
            self._shadow.set_command(command)

    @property
    def times(self) -> list[float]:
        """Return the valid prediction times of the last thousand predictions that ended [s]."""
        return list(self._ended)

    @property
    def valid_prediction_time(self) -> float:
        """Return the median of these; NaN before one has ended."""
        return self.median(self._ended)

    @staticmethod
    def median(times: Sequence[float]) -> float:
        """
        Return the median of prediction times [s], each of which counts by its length.

        So often would predictions that begin at even times, as those of ``evaluate``, have begun
        while it lasted.
        """
        if not times:
            return np.nan
        ordered = np.sort(times)
        shares = np.cumsum(ordered)
        return float(ordered[np.searchsorted(shares, 0.5 * shares[-1])])

    @property
    def ended(self) -> int:
        """Return how many predictions the median is of."""
        return len(self._ended)

    @property
    def _now(self) -> float:
        return float(self._simulation.steps * self._simulation.step_size)

    def _observe(self, seen: Observation) -> None:
        position, velocity = select(seen, self.names)
        velocity = self._velocity(position, velocity, seen.delay)
        simulated = self._at(self._simulation, seen.delay)
        self._count += 1
        change = position - self._mean
        self._mean = self._mean + change / self._count
        self._square = self._square + change * (position - self._mean)
        error, normalised, running = np.full(len(self.names), np.nan), np.nan, 0.0
        if self._began is not None:
            error = position - self._at(self._shadow, seen.delay)
            running = max(0.0, self._now + seen.delay - self._began)
            with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
                parts = error**2 / self._variance
            normalised = float(np.where(error == 0.0, 0.0, parts).sum())
            if not normalised < VALID or running >= _LONGEST:
                self._ended.append(running)
                self._began = None
        if self._began is None:
            self._predict(position, velocity, seen.delay)
        self.newest = Report(seen.delay, position - simulated, error, normalised, running)

    @property
    def _variance(self) -> np.ndarray:
        if self._deviations is not None:
            return np.square(self._deviations)
        return self._square / self._count

    def _velocity(self, position: np.ndarray, velocity: np.ndarray, delay: float) -> np.ndarray:
        """Return velocities, by the observation before where none were observed."""
        now, before = self._now + delay, self._before
        self._before = now, position
        if before is None or now <= before[0]:
            return np.nan_to_num(velocity)
        return np.where(np.isnan(velocity), (position - before[1]) / (now - before[0]), velocity)

    def _at(self, simulation: Simulation, delay: float) -> np.ndarray:
        """Return the observed coordinates of a simulation at a time near now."""
        q, v = simulation.q[self._places], simulation.dH_dp[self._places]
        return q + delay * v

    def _predict(self, position: np.ndarray, velocity: np.ndarray, delay: float) -> None:
        """Begin a prediction at an observation; what is not observed is as it is simulated."""
        own, shadow = self._simulation, self._shadow
        q, v = own.q.copy(), own.dH_dp.copy()
        q[self._places], v[self._places] = position - delay * velocity, velocity
        try:
            p = momentum(shadow.hamiltonian, q, v, own.p.copy())
            shadow.restart(q, p, step=own.steps)
            if self._command is not None:
                shadow.set_command(self._aged(*self._command))
        except (ModelError, StepFailure, ValueError):
            self._fail()
            return
        self._began = self._now + delay

    def _aged(self, command: Command, since: float) -> Command:
        """Return a command as it stands now."""
        if isinstance(command, JointPath):
            return command._replace(delay=command.delay - (self._now - since))
        return command

    def _fail(self) -> None:
        self._began, self.failed = None, self.failed + 1
