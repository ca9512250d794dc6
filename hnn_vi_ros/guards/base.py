# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Base of guards: the state that they look at, and their alarms."""

from abc import ABC, abstractmethod
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

    """

    kind: str
    remedy: ClassVar[str]

    def allow(self, band: float, change: float) -> None:  # noqa: B027
        """Change the shares of a scale that are allowed, as far as there are such."""

    @abstractmethod
    def update(self, sample: Observed) -> Alarm | None:
        """Look at the next sample; return an alarm when it stops to hold, not while it lasts."""

    @abstractmethod
    def renew(self, sample: Observed) -> Alarm | None:
        """Return the raised alarm updated to a sample, None if nothing in it changes."""


def accounted_energy(sample: Observed) -> float:
    """Return H~, or H for want of it, less the work done on the system [J]."""
    modified = sample.modified_energy
    return (sample.energy if math.isnan(modified) else modified) - sample.work
