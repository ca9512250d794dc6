# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Dependences of runs on parameters: derivatives of H', by finite differences of H'."""

from collections.abc import Callable, Sequence
import operator
from typing import NamedTuple, Protocol

from hnn_vi_ros.errors import SceneError
from hnn_vi_ros.kernels import Kernel
import numpy as np

# Finite differences, central and one-sided: weights of order 6 and of order 4, by offset in
# spacings. With _SPACING times the number as the spacing, the truncation error is about 1e-15 for
# powers of the number, and the rounding error 1e-13, or ten times that if one-sided.
_SPACING = 2e-3
MIDDLE = {sign * (k + 1): (sign * weight, sign * lower) for k, (weight, lower) in enumerate((
    (3.0 / 4.0, 2.0 / 3.0), (-3.0 / 20.0, -1.0 / 12.0), (1.0 / 60.0, 0.0))) for sign in (1, -1)}
_ABOVE = dict(enumerate((
    (-49.0 / 20.0, -25.0 / 12.0), (6.0, 4.0), (-15.0 / 2.0, -3.0), (20.0 / 3.0, 4.0 / 3.0),
    (-15.0 / 4.0, -1.0 / 4.0), (6.0 / 5.0, 0.0), (-1.0 / 6.0, 0.0))))
_BELOW = {-offset: (-weight, -lower) for offset, (weight, lower) in _ABOVE.items()}
# If both orders agree to this share, the truncation error of order 6 is at most 1e-13 for a sine.
# They disagree for derivatives with respect to a frequency after many turns.
_MAX_DISAGREEMENT = 1e-9
_SPACING_RATIO, _MAX_TRIALS = 1.0 / 8.0, 7
# Rounding error of the difference of both orders, relative to H' over the spacing.
_DIFFERENCE_ROUNDING = 1e-14


class StateSequence(NamedTuple):
    """
    Concatenated states of consecutive steps, at which H' is evaluated.

    Parameters
    ----------
    q, p : np.ndarray, shape (N,)
        Coordinates and momenta of all states.
    gradient : callable
        Returns (H_q, H_p) of a kernel at the states, under the command of each step, (2, N).

    """

    q: np.ndarray
    p: np.ndarray
    gradient: Callable[[Kernel], np.ndarray]

    @classmethod
    def at(cls, q: np.ndarray, p: np.ndarray) -> 'StateSequence':
        """Return states for kernels that do not depend on commands."""
        return cls(q, p, lambda kernel: kernel.slopes(q, p))


class Dependence(Protocol):
    """Dependence of H' on a parameter, a number or an array."""

    def contracted(self, at: StateSequence, weights: np.ndarray) -> np.ndarray:
        """Return the gradient of the sum of weights, shape (2, N), times (H_q, H_p)."""

    def changed(self, at: StateSequence, change: np.ndarray) -> np.ndarray:
        """Return the change of (H_q, H_p), shape (2, N), for a change of the parameter."""


class OnNumber:
    """
    Dependence on a number, given by the derivatives of (H_q, H_p) and of damping rates.

    Parameters
    ----------
    slope : callable
        Returns the derivative of (H_q, H_p) at States, shape (2, N).
    rates : np.ndarray, shape (d,), optional
        Derivatives of the damping rates applied around steps.

    """

    def __init__(self, slope: Callable[[StateSequence], np.ndarray],
                 rates: np.ndarray | None = None):
        self._slope, self.rates = slope, rates

    def contracted(self, at: StateSequence, weights: np.ndarray) -> np.ndarray:
        """Return a number, shape (); see Dependence."""
        return np.array((weights * self._slope(at)).sum())

    def changed(self, at: StateSequence, change: np.ndarray) -> np.ndarray:
        """Return the change; see Dependence."""
        return change * self._slope(at)


class OnDifferences(OnNumber):
    """
    Dependence on a number of H, by finite differences of H' of order 6.

    They are one-sided if the number is at an end of its range, such as a rate of zero, and their
    spacing is reduced if differences of order 4 disagree, as for a frequency at late times.

    Parameters
    ----------
    changed : callable
        Function of another value of the number, and of its offset in spacings. Returns the kernel
        of H with this value, and the damping rates applied around steps, or None if they do not
        depend on the number (see ``flow_rates``).
    value : float
        Value of the number.

    Raises
    ------
    SceneError
        The range of the number leaves no room for differences on either side.

    """

    def __init__(self, changed: Callable[[float, int], tuple[Kernel, np.ndarray | None]],
                 value: float):
        self._changed, self._value, self._rounding = changed, value, _DIFFERENCE_ROUNDING
        rates = self._take(_SPACING * (abs(value) or 1.0))
        super().__init__(self._derivative, sum(rates, np.zeros(())) if rates else None)

    def _take(self, spacing: float) -> list[np.ndarray]:
        """Set the spacing, and return the summands of the derivative of damping rates."""
        problem: SceneError | None = None
        for stencil in (MIDDLE, _ABOVE, _BELOW):
            try:
                found = [(weight / spacing, lower / spacing,
                          *self._changed(self._value + offset * spacing, offset))
                         for offset, (weight, lower) in stencil.items()]
            except SceneError as raised:
                problem = problem or raised
                continue
            self._spacing = spacing
            self._kernels = [((weight, lower), kernel) for weight, lower, kernel, _ in found]
            return [weight * own for weight, _, _, own in found if own is not None]
        assert problem is not None
        raise problem

    def _derivative(self, at: StateSequence) -> np.ndarray:
        """Return the derivative of (H_q, H_p) at concatenated states, shape (2, N)."""
        slope, apart, rounding = self._differences(at)
        if apart <= max(_MAX_DISAGREEMENT, rounding):
            return slope
        tried, first = [(apart, self._spacing)], self._spacing
        for k in range(1, _MAX_TRIALS):
            self._take(first * _SPACING_RATIO**k)
            slope, apart, rounding = self._differences(at)
            if apart <= max(_MAX_DISAGREEMENT, rounding):
                return slope
            tried.append((apart, self._spacing))
        # The orders differ by rounding, which is larger than estimated: raise the estimate.
        apart, spacing = min(tried)
        self._take(spacing)
        self._rounding *= 10.0 * apart / self._differences(at)[2]
        return self._differences(at)[0]

    def _differences(self, at: StateSequence) -> tuple[np.ndarray, float, float]:
        """Return the derivative of order 6, its relative difference to order 4, and rounding."""
        slope, other, size = np.zeros((2, at.q.size)), np.zeros((2, at.q.size)), 0.0
        for (weight, lower), kernel in self._kernels:
            both = at.gradient(kernel)
            slope += weight * both
            other += lower * both
            size = max(size, float(np.abs(both).max(initial=0.0)))
        largest = float(np.abs(slope).max(initial=0.0)) or 1e-300
        return (slope, float(np.abs(slope - other).max(initial=0.0)) / largest,
                self._rounding * size / self._spacing / largest)


def derivative(function: Callable[[float], np.ndarray], size: float) -> np.ndarray:
    """Return the derivative of a function at 0, by differences narrower than `size`."""
    found = []
    for k in range(_MAX_TRIALS):
        spacing = _SPACING * size * _SPACING_RATIO**k
        values = [(weights, function(offset * spacing)) for offset, weights in MIDDLE.items()]
        high, low = (np.sum([weights[i] * value for weights, value in values], axis=0) / spacing
                     for i in (0, 1))
        found.append((np.abs(high - low).max(initial=0.0), high))
        if found[-1][0] <= _MAX_DISAGREEMENT * np.abs(high).max(initial=0.0):
            break
    return min(found, key=operator.itemgetter(0))[1]


def sum_of(kernels: Sequence[tuple[float, Kernel]], at: StateSequence) -> np.ndarray:
    """Return the weighted sum of (H_q, H_p) of kernels, shape (2, N)."""
    total = np.zeros((2, at.q.size))
    for weight, kernel in kernels:
        total += weight * at.gradient(kernel)
    return total


def difference(value: float, spacing: float, low: float, high: float) -> list[tuple[float, float]]:
    """
    Return values of a number and their weights for a difference of order 2 within its range.

    It is central if a spacing fits on both sides, otherwise one-sided on the side with more room.
    """
    below, above = value - low, high - value
    if min(below, above) >= spacing:
        return [(value - spacing, -0.5 / spacing), (value + spacing, 0.5 / spacing)]
    step = min(spacing, 0.5 * max(below, above)) * (1.0 if above >= below else -1.0)
    return [(value, -1.5 / step), (value + step, 2.0 / step), (value + 2.0 * step, -0.5 / step)]
