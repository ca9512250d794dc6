# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Gates G1 to G5 that a run of a hard case must pass, and how a limit is derived."""

from dataclasses import dataclass, field
import math

from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.simulation import Alarm
import numpy as np

LARGEST = 1e10
DRIFT_SHARE, GROWTH = 0.1, 1.5
REVERSAL, SYMPLECTIC = 2e-8, 1e-9
_EPS = float(np.finfo(np.float64).eps)
_MANTISSAS = (1, 2, 4, 5, 8, 10)


@dataclass
class Measured:
    """
    Measurements of one run; a figure that there is none for is NaN.

    Parameters
    ----------
    largest : float
        Largest abs of all entries of all states that were looked at.
    residual, residual_limit : float
        Largest relative residual of an implicit step, and max(8, n) eps of its n unknowns.
    band : float
        Largest abs(H - H0 - W) [J].
    slope : float
        Energy drift over the run: least-squares slope of the maxima of 100 blocks, as a share of
        the band.
    growth : float
        Range of H in the last tenth of the run, over that in the first.
    modified_band : float
        Largest abs(H~ - H~0) [J].
    rounding : float
        Largest energy change from rounding [J]; see ``diagnostics.rounding_walk``.
    reversal, symplectic : float
        Largest defects of single steps at states of the run; NaN where the method claims none.
    measures : dict of str to float
        Other measures of the case, by name.
    broken : list of str
        Claims of the case that the run violates.
    alarms : list of Alarm
        The first of each guard, in order of time.
    failure : StepFailure or None
        Failure that ended the run.
    t, error, other : np.ndarray
        For the picture: times [s] and the largest error since the time before, of a motion
        abs(H - H0 - W) [J]; a second curve where the case has one.

    """

    largest: float = 0.0
    residual: float = 0.0
    residual_limit: float = math.nan
    band: float = math.nan
    slope: float = math.nan
    growth: float = math.nan
    modified_band: float = math.nan
    rounding: float = 0.0
    reversal: float = math.nan
    symplectic: float = math.nan
    measures: dict[str, float] = field(default_factory=dict)
    broken: list[str] = field(default_factory=list)
    alarms: list[Alarm] = field(default_factory=list)
    failure: StepFailure | None = None
    t: np.ndarray = field(default_factory=lambda: np.empty(0))
    error: np.ndarray = field(default_factory=lambda: np.empty(0))
    other: np.ndarray = field(default_factory=lambda: np.empty(0))

    @property
    def first_word(self) -> float:
        """Return the step at which the run said that something is wrong; infinity for never."""
        steps = [alarm.step for alarm in self.alarms]
        if self.failure is not None:
            steps.append(round(self.failure.t / self.failure.h))
        return min(steps, default=math.inf)


def g1_finite(measured: Measured) -> bool:
    """Ask for finite states with entries below 1e10."""
    return measured.largest < LARGEST


def g2_solved(measured: Measured) -> bool:
    """Ask for implicit steps that are solved to max(8, n) eps of their scale."""
    return not measured.residual > measured.residual_limit


def g3_no_drift(measured: Measured) -> bool:
    """
    Ask for a drift of at most 10 % of the band, and a range that does not grow by half.

    A band of rounding errors alone is a random walk, which has a slope now and then.
    """
    if measured.band <= measured.rounding:
        return True
    return abs(measured.slope) <= DRIFT_SHARE and measured.growth <= GROWTH


def g4_reversible(measured: Measured) -> bool:
    """Ask a symmetric method for a step forward and one back that end within 2e-8 of a state."""
    return not measured.reversal > REVERSAL


def g5_symplectic(measured: Measured) -> bool:
    """Ask for a symplectic defect of at most 1e-9 in the 2-form that a method claims to keep."""
    return not measured.symplectic > SYMPLECTIC


GATES = {'G1': g1_finite, 'G2': g2_solved, 'G3': g3_no_drift, 'G4': g4_reversible,
         'G5': g5_symplectic}


def failed_gates(measured: Measured, names: list[str]) -> list[str]:
    """
    Return the gates and the claims of the case that a run violates.

    Parameters
    ----------
    measured : Measured
        Measures of the run.
    names : list of str
        The gates of the case; of a run that ended early, drift has no meaning.

    """
    chosen = [name for name in names if not (name == 'G3' and measured.failure is not None)]
    return [name for name in chosen if not GATES[name](measured)] + measured.broken


def verdict(measured: Measured, failed: list[str]) -> str:
    """
    Return in one word how a run ended.

    'stopped' is a typed failure, 'alarm' a run that a guard warned of, 'unstable' one that fails
    without a warning, 'stable' one that passes everything.
    """
    if measured.failure is not None:
        return 'stopped'
    if measured.alarms:
        return 'alarm'
    return 'unstable' if failed else 'stable'


def limit_of(value: float) -> float:
    """
    Return the limit that a measured value sets.

    It is the smallest of {1, 2, 4, 5, 8} x 10^k that is at least twice the value; 0 for 0.
    """
    if value == 0.0 or not math.isfinite(value):
        return value
    twice = 2.0 * abs(value)
    k = math.floor(math.log10(twice))
    # Written as text, so that it is the double that a reader of the file gets.
    limits = [float(f'{mantissa}e{power}') for power in (k - 1, k) for mantissa in _MANTISSAS]
    return min(limit for limit in limits if limit >= twice)
