# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Base of guards: the state that they look at, and their alarms."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
import math
from struct import Struct
from typing import ClassVar, NamedTuple

from hnn_vi_ros.recording import Sample
import numpy as np


class Look(NamedTuple):
    """The state of a run after so many steps, and its energies; see Sample."""

    step: int
    q: np.ndarray
    p: np.ndarray
    dH_dq: np.ndarray
    dH_dp: np.ndarray
    energy: float
    modified_energy: float
    work: float = 0.0


# The state that guards look at.
Observed = Sample | Look


def accounted_energy(sample: Observed) -> float:
    """Return H~, or H for want of it, less the work done on the system [J]."""
    modified = sample.modified_energy
    # Only NaN differs from itself.
    return (modified if modified == modified else sample.energy) - sample.work


class Block(NamedTuple):
    """
    Samples that follow each other, k of them.

    Parameters
    ----------
    step : np.ndarray, shape (k,)
        Steps since the start of the run.
    q, p, dH_dq, dH_dp : np.ndarray, shape (k, d), or (k, m, d) for m trajectories
        The states and the derivatives of H there.
    energy, accounted, work : np.ndarray, shape (k,)
        H, the accounted energy, and the work so far [J].

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


class Waiting:
    """
    Samples that wait for others, to be looked at together.

    They are copied while they are new, which costs less than to keep them.

    Parameters
    ----------
    most : int
        Coordinates of theirs that there is room for, those of one sample at least.

    Attributes
    ----------
    full : bool
        Whether there is no room for another.

    """

    def __init__(self, most: int):
        # In bytes.
        self._most = 8 * most
        self.full = False
        self._shapes: list[tuple[int, ...]] = []
        self._q, self._p = bytearray(), bytearray()
        self._dH_dq, self._dH_dp, self._rest = bytearray(), bytearray(), bytearray()

    def __len__(self) -> int:
        """Return how many wait."""
        return len(self._rest) // _REST.size

    def add(self, sample: Observed) -> float:
        """Let a sample wait; return its accounted energy [J]."""
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

    def block(self, first: int = 0) -> Block | None:
        """Return those that wait, from the first on; None for none."""
        n = len(self)
        if first >= n:
            return None
        states = (np.frombuffer(part).reshape(n, *shape)[first:].copy() for part, shape in zip(
            (self._q, self._p, self._dH_dq, self._dH_dp), self._shapes, strict=True))
        step, *energies = np.frombuffer(self._rest).reshape(n, _REST.size // 8)[first:].T.copy()
        return Block(step.astype(np.int64), *states, *energies)


class Alarm(NamedTuple):
    """
    Finding of a guard.

    Parameters
    ----------
    kind : str
        Which guard: the same words each time.
    step : int
        Steps since the start of the run.
    value, limit : float
        The value found, and the limit for it.
    message : str
        One line: what, by how much, remedy.
    unit : str
        Of value and limit.

    """

    kind: str
    step: int
    value: float
    limit: float
    message: str
    unit: str = 'J'


class Guard(ABC):
    """
    Something that must hold all the time.

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
        """Change the shares of a scale that are allowed, as far as there are such."""

    @abstractmethod
    def renew(self, sample: Observed) -> Alarm | None:
        """Return the raised alarm updated to a sample, None if nothing in it changes."""


class StateGuard(Guard):
    """
    A guard that looks at the run as it is when it is asked.

    Attributes
    ----------
    each : bool
        Whether it must be asked at each sample.

    """

    each: ClassVar[bool] = False

    @abstractmethod
    def update(self, sample: Observed) -> Alarm | None:
        """Look at the next sample; return an alarm when it stops to hold, not while it lasts."""


class BlockGuard(Guard):
    """A guard that looks at samples in blocks, however many make one: many cost little more."""

    @property
    def calm(self) -> tuple[float, float]:
        """Return between which accounted energies a sample can wait for others [J]."""
        return -math.inf, math.inf

    @abstractmethod
    def take(self, block: Block) -> list[Alarm]:
        """Look at the next samples; return an alarm where it stops to hold, not while it lasts."""


# Returns the energy scale at each sample of a block [J].
Scale = Callable[[Block], np.ndarray]


def judge(guards: Iterable[BlockGuard], block: Block | None) -> list[Alarm]:
    """Let guards look at the next samples; return what they find, by steps."""
    if block is None:
        return []
    # A guard judges what is not finite; it says so itself.
    with np.errstate(invalid='ignore', over='ignore'):
        found = [alarm for guard in guards for alarm in guard.take(block)]
    return sorted(found, key=lambda alarm: alarm.step)
