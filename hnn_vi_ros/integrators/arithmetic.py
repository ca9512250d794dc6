# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Elementary arithmetic that every step uses; inlined by the compiler where it is called."""

import math

from hnn_vi_ros.integrators.base import PhasePoint
from hnn_vi_ros.kernels import inlined
import numpy as np


@inlined
def plus(x: float, carry: float, increment: float) -> tuple[float, float]:
    """
    Add an increment to a number stored as a sum x + carry, by compensated summation.

    Returns
    -------
    tuple of (float, float)
        The rounded sum and its rounding error, which is the next carry.

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section VIII.5.

    """
    addend = increment + carry
    total = x + addend
    # The error of a sum of two doubles is a double, whichever of the two is larger (Knuth).
    virtual = total - x
    return total, (x - (total - virtual)) + (addend - virtual)


@inlined
def largest(x: np.ndarray) -> float:
    """Return the largest absolute value in x of shape (n,), NaN if x contains one."""
    result = 0.0
    for i in range(x.size):
        # A comparison with NaN is false, so this form of the test keeps a NaN.
        if not abs(x[i]) <= result:
            result = abs(x[i])
        if math.isnan(result):
            return result
    return result


@inlined
def all_finite(x: np.ndarray) -> bool:
    """Return True if all entries of x of shape (n,) are finite."""
    for i in range(x.size):  # noqa: SIM110  a loop is faster when compiled
        if not math.isfinite(x[i]):
            return False
    return True


@inlined
def is_finite(z: PhasePoint) -> bool:
    """Return True if a state and its gradient are finite."""
    return all_finite(z.q) and all_finite(z.p) and all_finite(z.dH_dq) and all_finite(z.dH_dp)


@inlined
def copy_array(source: np.ndarray, target: np.ndarray) -> None:
    """
    Copy an array of shape (n,) into another.

    For ``target[:] = source`` numba also compiles the error message for mismatched shapes, which
    takes longer than a whole step.
    """
    for i in range(target.size):
        target[i] = source[i]


@inlined
def copy_point(source: PhasePoint, target: PhasePoint) -> None:
    """Copy every array of one point into another point."""
    for i in range(source.q.size):
        target.q[i], target.p[i] = source.q[i], source.p[i]
        target.q_carry[i], target.p_carry[i] = source.q_carry[i], source.p_carry[i]
        target.dH_dq[i], target.dH_dp[i] = source.dH_dq[i], source.dH_dp[i]
