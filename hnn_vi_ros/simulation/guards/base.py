# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Base classes of guards, the samples that they check, and their alarms."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
import math
from struct import Struct
from typing import ClassVar, NamedTuple

from hnn_vi_ros.recording import Sample
import numpy as np


class GuardState(NamedTuple):
    """State and energies of a run after `step` steps; see Sample."""

    step: int
    q: np.ndarray
    p: np.ndarray
    dH_dq: np.ndarray
    dH_dp: np.ndarray
    energy: float
    modified_energy: float
    work: float = 0.0


# A state that guards check.
Observed = Sample | GuardState


def accounted_energy(sample: Observed) -> float:
    """Return H~, or H if there is none, minus the work done on the system [J]."""
    modified = sample.modified_energy
    # Only NaN compares unequal to itself.
    return (modified if modified == modified else sample.energy) - sample.work


class SampleBlock(NamedTuple):
    """
    Batch of k consecutive samples.

    Parameters
    ----------
    step : np.ndarray, shape (k,)
        Steps since the start of the run.
    q, p, dH_dq, dH_dp : np.ndarray, shape (k, d), or (k, m, d) for m trajectories
        States, and derivatives of H at them.
    energy, accounted, work : np.ndarray, shape (k,)
        H, accounted energy, and work so far [J].

    """

    step: np.ndarray
    q: np.ndarray
    p: np.ndarray
    dH_dq: np.ndarray
    dH_dp: np.ndarray
    energy: np.ndarray
    accounted: np.ndarray
    work: np.ndarray


# Step, H, accounted energy and work of a sample.
_REST = Struct('4d')


class SampleBuffer:
    """
    Buffer of samples to be checked together as a block.

    Samples are copied on arrival, which is cheaper than keeping the objects.

    Parameters
    ----------
    most : int
        Capacity in coordinates q; at least one sample fits.

    Attributes
    ----------
    full : bool
        True if the capacity is reached.

    """

    def __init__(self, most: int):
        # Capacity in bytes.
        self._most = 8 * most
        self.full = False
        self._shapes: list[tuple[int, ...]] = []
        self._q, self._p = bytearray(), bytearray()
        self._dH_dq, self._dH_dp, self._rest = bytearray(), bytearray(), bytearray()

    def __len__(self) -> int:
        """Return the number of samples in the buffer."""
        return len(self._rest) // _REST.size

    def add(self, sample: Observed) -> float:
        """Append a sample; return its accounted energy [J]."""
        accounted = accounted_energy(sample)
        self._q += sample.q.tobytes()
        self._p += sample.p.tobytes()
        self._dH_dq += sample.dH_dq.tobytes()
        self._dH_dp += sample.dH_dp.tobytes()
        self._rest += _REST.pack(sample.step, sample.energy, accounted, sample.work)
        self.full = len(self._q) >= self._most
        if not self._shapes:
            self._shapes = [one.shape for one in (sample.q, sample.p, sample.dH_dq, sample.dH_dp)]
        return accounted

    def block(self, first: int = 0) -> SampleBlock | None:
        """Return the buffered samples from index `first` on as a block; None if there are none."""
        n = len(self)
        if first >= n:
            return None
        states = (np.frombuffer(part).reshape(n, *shape)[first:].copy() for part, shape in zip(
            (self._q, self._p, self._dH_dq, self._dH_dp), self._shapes, strict=True))
        step, *energies = np.frombuffer(self._rest).reshape(n, _REST.size // 8)[first:].T.copy()
        return SampleBlock(step.astype(np.int64), *states, *energies)


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
    unit: str = 'J'


class Guard(ABC):
    """
    A condition checked at every sample; violating it raises an alarm.

    Attributes
    ----------
    kind : str
        Name of its alarms.
    remedy : str
        Remedy against its alarms; the page on troubleshooting lists them all.

    """

    kind: str
    remedy: ClassVar[str]

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

    @property
    def calm(self) -> tuple[float, float]:
        """Return the range of accounted energies in which a check can be deferred [J]."""
        return -math.inf, math.inf

    @abstractmethod
    def take(self, block: SampleBlock) -> list[Alarm]:
        """Check the next samples; return an alarm for each beginning of a violation."""


# Returns the energy scale at each sample of a block [J].
Scale = Callable[[SampleBlock], np.ndarray]


def judge(guards: Iterable[BlockGuard], block: SampleBlock | None) -> list[Alarm]:
    """Check the next samples with all guards; return the alarms in the order of steps."""
    if block is None:
        return []
    # Guards raise alarms for non-finite values themselves.
    with np.errstate(invalid='ignore', over='ignore'):
        found = [alarm for guard in guards for alarm in guard.take(block)]
    return sorted(found, key=lambda alarm: alarm.step)
