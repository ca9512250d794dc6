# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A sine and its cosine that compilers vectorise, which libm's scalar ones prevent."""

from typing import Any

from hnn_vi_ros.kernels.compilation import kept
import numpy as np

_TWO_OVER_PI = 0.6366197723675814
# pi / 2 in three parts: k times each of the first two is exact for abs(k) < 2^20.
_HALF_PI_HIGH = 1.5707963267341256
_HALF_PI_MIDDLE = 6.077100506303966e-11
_HALF_PI_LOW = 2.0222662487959506e-21
# Adding this rounds a small double to an integer and leaves the integer in its low bits.
_ROUNDING = 6755399441055744.0
# What no remainder reaches; of numbers too large to be reduced, something small is left.
_LARGEST = 0.8
# (sin(r) / r - 1) / r^2 and (cos(r) - 1 + r^2 / 2) / r^4 as polynomials of r^2, lowest power
# first: interpolation in six Chebyshev nodes of 0 <= r^2 <= (1.0001 pi / 4)^2, which
# test_vector_functions.py repeats; error 2.0e-17, of the sine relative.
_S = (
    -0.16666666666666666, 0.008333333333330946, -0.0001984126983675497, 2.755731610068303e-06,
    -2.5051131455427946e-08, 1.591810123027412e-10)
_C = (
    0.041666666666666664, -0.0013888888888887395, 2.4801587298763433e-05,
    -2.7557317270560326e-07, 2.0876146024689747e-09, -1.1382614868556325e-11)


# Only contraction to fused multiply-add is allowed: reassociation would cancel _ROUNDING.
@kept(fastmath={'contract'}, error_model='numpy', forceinline=True)
def sine_and_cosine(x: float) -> tuple[float, float]:
    """
    Return the sine and the cosine of x; NaN stays NaN, and infinity becomes NaN.

    Write x = k pi / 2 + r, abs(r) <= pi / 4: the polynomials give sin r and cos r, and k mod 4
    decides which of them is which and its sign. The error is 1.5 units of round-off for
    abs(x) < 1e6; beyond, x's own last digit. There is no branch and no call, as in vector_tanh.

    """
    rounded: Any = np.float64(x * _TWO_OVER_PI + _ROUNDING)
    k = rounded - _ROUNDING
    r = ((x - k * _HALF_PI_HIGH) - k * _HALF_PI_MIDDLE) - k * _HALF_PI_LOW
    r = _LARGEST if r > _LARGEST else r
    r = -_LARGEST if r < -_LARGEST else r
    r2 = r * r
    r4 = r2 * r2
    s = (_S[0] + _S[1] * r2) + ((_S[2] + _S[3] * r2) + (_S[4] + _S[5] * r2) * r4) * r4
    c = (_C[0] + _C[1] * r2) + ((_C[2] + _C[3] * r2) + (_C[4] + _C[5] * r2) * r4) * r4
    sine, cosine = r + r * r2 * s, (1.0 - 0.5 * r2) + r4 * c
    quadrant = rounded.view(np.int64)
    swapped = (quadrant & 1) != 0
    first, second = cosine if swapped else sine, sine if swapped else cosine
    # The second bit is the sign of the sine; that of the cosine is one quadrant ahead.
    sign, ahead = (quadrant & 2) << 62, ((quadrant + 1) & 2) << 62
    return (np.int64(np.float64(first).view(np.int64) ^ sign).view(np.float64),
            np.int64(np.float64(second).view(np.int64) ^ ahead).view(np.float64))
