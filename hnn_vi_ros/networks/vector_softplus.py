# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""log(1 + exp(x)) and its slope, so that compilers vectorise them; see vector_tanh."""

from hnn_vi_ros.kernels.compilation import kept
from hnn_vi_ros.networks.vector_tanh import _C, _LN2_HIGH, _LN2_LOW, _LOG2_E, _ROUNDING
import numpy as np

# Where exp is still far from the smallest numbers, and softplus from what can be told from 0.
_LOWEST = -700.0
# (artanh(t) / t - 1) / t^2 as a polynomial of t^2, lowest power first: interpolation in the ten
# Chebyshev nodes of 0 <= t^2 <= 1.0001 / 9, which test_vector_functions.py repeats; relative
# error 7e-18.
_L = (
    0.3333333333333333, 0.20000000000007298, 0.1428571428355253, 0.11111111358900891,
    0.09090894708663223, 0.07692785296456121, 0.06657067775440581, 0.06000577591428889,
    0.04400158825434387, 0.08082469084735669)


# Only contraction to fused multiply-add is allowed: reassociation would cancel _ROUNDING.
@kept(fastmath={'contract'}, error_model='numpy', forceinline=True)
def softplus_and_slope(x: float) -> tuple[float, float]:
    """
    Return log(1 + exp(x)) and its derivative, 1 / (1 + exp(-x)); NaN stays NaN.

    With u = exp(-abs(x)) and t = u / (2 + u), log(1 + u) = 2 artanh(t), which is added to x
    where x is positive. The relative error of both is about four units of round-off for
    x > -700; below, both are what they are at -700, 1e-304.

    """
    low = x if x < 0.0 else -x
    low = _LOWEST if low < _LOWEST else low
    rounded = np.float64(low * _LOG2_E + _ROUNDING)
    k = rounded - _ROUNDING
    r = (low - k * _LN2_HIGH) - k * _LN2_LOW
    power_of_two = np.int64((rounded.view(np.int64) + 1023) << 52).view(np.float64)
    r2 = r * r
    r4 = r2 * r2
    series = ((_C[0] + _C[1] * r) + (_C[2] + _C[3] * r) * r2) + (
        ((_C[4] + _C[5] * r) + (_C[6] + _C[7] * r) * r2)
        + ((_C[8] + _C[9] * r) + _C[10] * r2) * r4) * r4
    u = power_of_two * (1.0 + series * r)
    t = u / (2.0 + u)
    t2 = t * t
    t4 = t2 * t2
    t8 = t4 * t4
    tail = ((_L[0] + _L[1] * t2) + (_L[2] + _L[3] * t2) * t4) + (
        ((_L[4] + _L[5] * t2) + (_L[6] + _L[7] * t2) * t4) + (_L[8] + _L[9] * t2) * t8) * t8
    positive = 0.0 if x < 0.0 else x
    ratio = 1.0 / (1.0 + u)
    return positive + 2.0 * (t + t * t2 * tail), (u if x < 0.0 else 1.0) * ratio
