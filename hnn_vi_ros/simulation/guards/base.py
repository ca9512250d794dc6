# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Base classes of guards, and their alarms."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
import math
from typing import ClassVar, NamedTuple

from hnn_vi_ros.simulation.guards.facts import RunFacts
from hnn_vi_ros.simulation.guards.samples import Observed, SampleBlock
import numpy as np


class Alarm(NamedTuple):
    """
    Alarm of a guard.

    Parameters
    ----------
    kind : str
        Constant name of the alarms of this guard.
    step : int
        Steps since the start of the run.
    value, limit : float
        The value found, and its limit.
    message : str
        One line: the violation, its size, the remedy.
    unit : str
        Unit of value and limit.

    """

    kind: str
    step: int
    value: float
    limit: float
    message: str
    unit: str


class Guard(ABC):
    """
    A condition checked at every sample; violating it raises an alarm.

    Attributes
    ----------
    kind : str
        Name of its alarms.
    remedy : str
        Remedy against its alarms; the page on troubleshooting lists them all.
    smaller : str
        Cause of shorter steps with the method of the run, for messages.
    energy_unit : str
        Unit of H.

    """

    kind: str
    remedy: ClassVar[str]
    smaller: str = 'a smaller step_size'
    energy_unit: str = 'J'

    @classmethod
    def of_run(cls, run: RunFacts) -> Iterator['Guard']:
        """Yield the guards of this class that a run needs; by default none."""
        yield from ()

    def allow(self, band: float, change: float) -> None:  # noqa: B027
        """Change the allowed shares of a scale, in guards that have them."""

    @abstractmethod
    def renew(self, sample: Observed) -> Alarm | None:
        """Return the raised alarm updated to a sample; None if it does not change."""


class StateGuard(Guard):
    """
    A guard that checks the current state of the run.

    Attributes
    ----------
    each : bool
        True if it must be updated at each sample.

    """

    each: ClassVar[bool] = False

    @abstractmethod
    def update(self, sample: Observed) -> Alarm | None:
        """Check the next sample; return an alarm when a violation begins, None otherwise."""


class LimitGuard(StateGuard):
    """
    Base class of guards of a number that must not exceed a limit, reported once.

    Attributes
    ----------
    limit : float
        Limit of the number.
    message : str
        Message of the alarm, with a placeholder for the number.

    """

    limit: float
    message: str
    _raised = False

    def update(self, sample: Observed) -> Alarm | None:
        if self._raised or self.value(sample) <= self.limit:
            return None
        self._raised = True
        return self.renew(sample)

    def renew(self, sample: Observed) -> Alarm:
        value = self.value(sample)
        return Alarm(self.kind, self.step(sample), value, self.limit, self.message.format(value),
                     '1')

    def step(self, sample: Observed) -> int:
        """Return the step of the alarm."""
        return sample.step

    @abstractmethod
    def value(self, sample: Observed) -> float:
        """Return the number."""


class BlockGuard(Guard):
    """A guard that checks samples in blocks of any length, vectorised."""

    # The alarm at a step.
    _alarm: Callable[..., Alarm]

    def renew(self, sample: Observed) -> Alarm | None:
        return self._alarm(sample.step)

    @property
    def calm(self) -> tuple[float, float]:
        """Return the range of accounted energies in which a check can be deferred [J]."""
        return -math.inf, math.inf

    @abstractmethod
    def take(self, block: SampleBlock) -> list[Alarm]:
        """Check the next samples; return an alarm for each beginning of a violation."""


def judge_block(guards: Iterable[BlockGuard], block: SampleBlock | None) -> list[Alarm]:
    """Check the next samples with all guards; return the alarms in the order of steps."""
    if block is None:
        return []
    # Guards raise alarms for non-finite values themselves.
    with np.errstate(invalid='ignore', over='ignore'):
        found = [alarm for guard in guards for alarm in guard.take(block)]
    return sorted(found, key=lambda alarm: alarm.step)
