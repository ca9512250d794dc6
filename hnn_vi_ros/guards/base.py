# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Base of guards: the state that they look at, and their alarms."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
import math
from typing import ClassVar, NamedTuple

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


class Block(NamedTuple):
    """
    Samples that follow each other, k of them: together a guard looks at them for less.

    Parameters
    ----------
    first, last : Sample
        Two of them.
    step : np.ndarray, shape (k,)
        Steps since the start of the run.
    q, p, dH_dp : np.ndarray, shape (k, d)
        The states, and their velocities.
    energy, accounted, work : np.ndarray, shape (k,)
        H, the accounted energy, and the work so far [J].

    """

    first: Sample
    last: Sample
    step: np.ndarray
    q: np.ndarray
    p: np.ndarray
    dH_dp: np.ndarray
    energy: np.ndarray
    accounted: np.ndarray
    work: np.ndarray

    @classmethod
    def of(cls, samples: Sequence[Sample]) -> 'Block':
        """Return samples as a block."""
        shape = len(samples), -1
        energy = np.array([sample.energy for sample in samples])
        modified = np.array([sample.modified_energy for sample in samples])
        work = np.array([sample.work for sample in samples])
        return cls(
            samples[0], samples[-1], np.array([sample.step for sample in samples]),
            np.concatenate([sample.q for sample in samples]).reshape(shape),
            np.concatenate([sample.p for sample in samples]).reshape(shape),
            np.concatenate([sample.dH_dp for sample in samples]).reshape(shape),
            energy, np.where(np.isnan(modified), energy, modified) - work, work)


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
    Something that must hold all the time; it costs about as much as ten additions.

    Attributes
    ----------
    kind : str
        Name of its alarms.
    remedy : str
        Remedy against its alarms; the page on troubleshooting lists them all.
    by_sample : bool
        Whether it looks at samples, rather than at the simulation as it is when it is asked.

    """

    kind: str
    remedy: ClassVar[str]
    by_sample: ClassVar[bool] = True

    def allow(self, band: float, change: float) -> None:  # noqa: B027
        """Change the shares of a scale that are allowed, as far as there are such."""

    @abstractmethod
    def update(self, sample: Observed) -> Alarm | None:
        """Look at the next sample; return an alarm when it stops to hold, not while it lasts."""

    @property
    def calm(self) -> tuple[float, float]:
        """Return between which accounted energies a sample can wait for others [J]."""
        return -math.inf, math.inf

    @property
    def ahead(self) -> float:
        """Return how many of the next samples may be in one block."""
        return math.inf

    def quiet(self, block: Block) -> Callable[[], None] | None:
        """
        Return what takes a block of samples, none of which raises an alarm.

        The guard is then as if each had been looked at by ``update``, to the last bit. None if
        one may raise an alarm, or if this is not known: then each is looked at.
        """
        return None

    @abstractmethod
    def renew(self, sample: Observed) -> Alarm | None:
        """Return the raised alarm updated to a sample, None if nothing in it changes."""


def accounted_energy(sample: Observed) -> float:
    """Return H~, or H for want of it, less the work done on the system [J]."""
    modified = sample.modified_energy
    return (sample.energy if math.isnan(modified) else modified) - sample.work


def scales_over(scale: object, block: Block) -> np.ndarray | None:
    """Return the energy scale at each sample of a block [J], if it can be told; see quiet."""
    return scale.over(block) if isinstance(scale, BlockScale) else None


class BlockScale(ABC):
    """An energy scale that can be told for a block of samples."""

    @abstractmethod
    def over(self, block: Block) -> np.ndarray | None:
        """Return the scale at each sample [J], None where each must be taken by itself."""

    @abstractmethod
    def take(self, block: Block) -> None:
        """Take the block that ``over`` was last asked for, once."""
