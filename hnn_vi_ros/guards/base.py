# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Base of guards: the state that they look at, and their alarms."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
import math
from typing import ClassVar, NamedTuple, TypeVar

from hnn_vi_ros.simulation import Sample
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
One = TypeVar('One', Sample, Look)


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

    @classmethod
    def of(cls, samples: Sequence[Sample] | Sequence[Look]) -> 'Block':
        """Return samples as a block."""
        q, p, dH_dq, dH_dp = (np.array([getattr(one, name) for one in samples])
                              for name in ('q', 'p', 'dH_dq', 'dH_dp'))
        energy, modified, work = np.array([
            [one.energy for one in samples], [one.modified_energy for one in samples],
            [one.work for one in samples]])
        return cls(np.array([one.step for one in samples]), q, p, dH_dq, dH_dp, energy,
                   np.where(np.isnan(modified), energy, modified) - work, work)


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


def accounted_energy(sample: Observed) -> float:
    """Return H~, or H for want of it, less the work done on the system [J]."""
    modified = sample.modified_energy
    return (sample.energy if math.isnan(modified) else modified) - sample.work


# Returns the energy scale at each sample of a block [J].
Scale = Callable[[Block], np.ndarray]


def judge(guards: Iterable[BlockGuard], samples: Sequence[One]
          ) -> list[tuple[Alarm, One]]:
    """Let guards look at the next samples; return what they find, and in which sample."""
    if not samples:
        return []
    block = Block.of(samples)
    # A guard judges what is not finite; it says so itself.
    with np.errstate(invalid='ignore', over='ignore'):
        found = [(alarm, samples[int((block.step == alarm.step).argmax())])
                 for guard in guards for alarm in guard.take(block)]
    return sorted(found, key=lambda one: one[1].step)
