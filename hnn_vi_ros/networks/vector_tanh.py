# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A hyperbolic tangent that compilers vectorise, which libm's scalar one prevents."""

from hnn_vi_ros.kernels.compilation import kept
import numpy as np

# tanh is 1 to double precision beyond 2 |x| = 40, and exp stays far from overflow.
_LARGEST = 40.0
_LOG2_E = 1.4426950408889634
# ln 2 in two parts: k * _LN2_HIGH is exact for abs(k) < 2^11.
_LN2_HIGH = 6.93147180369123816490e-01
_LN2_LOW = 1.90821492927058770002e-10
# Adding this rounds a small double to an integer and leaves the integer in its low bits.
_ROUNDING = 6755399441055744.0
# (exp(r) - 1) / r as a polynomial, lowest power first: interpolation in the 11 Chebyshev nodes
# of abs(r) <= 1.0001 ln(2) / 2, which test_vector_tanh.py repeats; relative error 2.4e-17.
_C = (
    1.0, 0.5000000000000006, 0.1666666666666667, 0.041666666666573066, 0.008333333333326136,
    0.001388888893251478, 0.00019841269874820627, 2.480150431378554e-05, 2.7557255400206422e-06,
    2.7626371065696354e-07, 2.5105217004720745e-08)


# Only contraction to fused multiply-add is allowed: reassociation would cancel _ROUNDING.
@kept(fastmath={'contract'}, error_model='numpy', forceinline=True)
def tanh(x: float) -> float:
    """
    Return the tanh of x, to about two units in the last place; NaN stays NaN.

    With m = exp(2 x) - 1, tanh x = m / (m + 2). Write 2 x = k ln 2 + r, abs(r) <= ln(2) / 2;
    then m = 2^k (exp(r) - 1) + (2^k - 1), where exp(r) - 1 is r times a polynomial of degree 10,
    summed by Estrin's scheme, whose chain of dependent operations is shorter than Horner's.
    It is free of branches and calls, and inlined: a loop over it becomes vector instructions.

    """
    doubled = 2.0 * x
    doubled = _LARGEST if doubled > _LARGEST else doubled
    doubled = -_LARGEST if doubled < -_LARGEST else doubled
    rounded = np.float64(doubled * _LOG2_E + _ROUNDING)
    k = rounded - _ROUNDING
    r = (doubled - k * _LN2_HIGH) - k * _LN2_LOW
    power_of_two = np.int64((rounded.view(np.int64) + 1023) << 52).view(np.float64)
    r2 = r * r
    r4 = r2 * r2
    low = (_C[0] + _C[1] * r) + (_C[2] + _C[3] * r) * r2
    middle = (_C[4] + _C[5] * r) + (_C[6] + _C[7] * r) * r2
    high = (_C[8] + _C[9] * r) + _C[10] * r2
    series = low + (middle + high * r4) * r4
    m = power_of_two * (series * r) + (power_of_two - 1.0)
    return m / (m + 2.0)
