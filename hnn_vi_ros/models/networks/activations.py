# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Activation functions of a network: their value, slope and curvature.

Each class of PackedPerceptron has one activation, by which the compiler selects among the loops
below, so that a network contains no code of other activations. tanh needs no further memory: its
slope is 1 - a^2. The others store their slope in a fifth group of rows of ``nodes``, and in a
sixth its derivative along a_0' = v. A Mapping has any of the four: of its loops, only those of
tanh are inlined.
"""

from typing import Any

from hnn_vi_ros.kernels import address_of, array_at, kept, LINK_ONLY, part
from hnn_vi_ros.models.networks.perceptron_memory import (
    Mapping, PackedPerceptron, Relu, Sine, Softplus, Tanh, TILE)
from numba.extending import overload
import numpy as np

# tanh is 1 to double precision beyond 2 |x| = 40, and exp stays far from overflow.
_LARGEST = 40.0
_LOG2_E = 1.4426950408889634
# ln 2 in two parts: k * _LN2_HIGH is exact for abs(k) < 2^11.
_LN2_HIGH = 6.93147180369123816490e-01
_LN2_LOW = 1.90821492927058770002e-10
# Adding this rounds a small double to an integer and leaves the integer in its low bits.
_ROUNDING = 6755399441055744.0
# (exp(r) - 1) / r as a polynomial, lowest power first: interpolation in the 11 Chebyshev nodes of
# abs(r) <= 1.0001 ln(2) / 2, recomputed in test_vector_tanh.py; relative error 2.4e-17.
_EXP = (
    1.0, 0.5000000000000006, 0.1666666666666667, 0.041666666666573066, 0.008333333333326136,
    0.001388888893251478, 0.00019841269874820627, 2.480150431378554e-05, 2.7557255400206422e-06,
    2.7626371065696354e-07, 2.5105217004720745e-08)


# Only contraction to fused multiply-add is allowed: reassociation would cancel _ROUNDING.
_PRECISE: dict[str, Any] = {'fastmath': {'contract'}, 'error_model': 'numpy', 'forceinline': True}


@part(**_PRECISE)
def _exponential(x: float) -> tuple[float, float]:
    """
    Return 2^k and exp(r) - 1, for x = k ln 2 + r with abs(r) <= ln(2) / 2.

    exp(r) - 1 is r times a polynomial of degree 10, evaluated by Estrin's scheme, which has a
    shorter dependency chain than Horner's.
    """
    rounded = np.float64(x * _LOG2_E + _ROUNDING)
    k = rounded - _ROUNDING
    r = (x - k * _LN2_HIGH) - k * _LN2_LOW
    power_of_two = np.int64((rounded.view(np.int64) + 1023) << 52).view(np.float64)
    r2 = r * r
    r4 = r2 * r2
    low = (_EXP[0] + _EXP[1] * r) + (_EXP[2] + _EXP[3] * r) * r2
    middle = (_EXP[4] + _EXP[5] * r) + (_EXP[6] + _EXP[7] * r) * r2
    high = (_EXP[8] + _EXP[9] * r) + _EXP[10] * r2
    return power_of_two, (low + (middle + high * r4) * r4) * r


@kept(**_PRECISE)
def tanh(x: float) -> float:
    """
    Return the tanh of x, to about two units in the last place; NaN stays NaN.

    With m = exp(2 x) - 1 = 2^k (exp(r) - 1) + (2^k - 1), tanh x = m / (m + 2). It has no branches
    or calls and is inlined, so a loop over it is vectorised.

    """
    doubled = 2.0 * x
    doubled = _LARGEST if doubled > _LARGEST else doubled
    doubled = -_LARGEST if doubled < -_LARGEST else doubled
    power_of_two, rest = _exponential(doubled)
    m = power_of_two * rest + (power_of_two - 1.0)
    return m / (m + 2.0)


# Below the first, exp is 0; above the second, it overflows.
_UNDERFLOW, _OVERFLOW = -745.2, 709.8


@kept(**_PRECISE)
def exponential(x: float) -> float:
    """Return exp(x), to about one unit in the last place, without branches, as ``tanh``."""
    low = _UNDERFLOW if x < _UNDERFLOW else x
    low = _OVERFLOW if low > _OVERFLOW else low
    # The power of two in two factors, since one alone may not be a number.
    half, rest = _exponential(0.5 * low)
    whole = half * (1.0 + rest)
    return np.inf if x > _OVERFLOW else whole * whole


_TWO_OVER_PI = 0.6366197723675814
# pi / 2 in three parts: k times each of the first two is exact for abs(k) < 2^20.
_HALF_PI_HIGH = 1.5707963267341256
_HALF_PI_MIDDLE = 6.077100506303966e-11
_HALF_PI_LOW = 2.0222662487959506e-21
# Bound that no remainder reaches; arguments too large to be reduced are clipped to it.
_LARGEST_REST = 0.8
# (sin(r) / r - 1) / r^2 and (cos(r) - 1 + r^2 / 2) / r^4 as polynomials of r^2, lowest power
# first: interpolation in six Chebyshev nodes of 0 <= r^2 <= (1.0001 pi / 4)^2, recomputed in
# test_vector_functions.py; error 2.0e-17, relative for the sine.
_SIN = (
    -0.16666666666666666, 0.008333333333330946, -0.0001984126983675497, 2.755731610068303e-06,
    -2.5051131455427946e-08, 1.591810123027412e-10)
_COS = (
    0.041666666666666664, -0.0013888888888887395, 2.4801587298763433e-05,
    -2.7557317270560326e-07, 2.0876146024689747e-09, -1.1382614868556325e-11)


@kept(**_PRECISE)
def sine_and_cosine(x: float) -> tuple[float, float]:
    """
    Return the sine and the cosine of x; NaN stays NaN, and infinity becomes NaN.

    With x = k pi / 2 + r, abs(r) <= pi / 4, the polynomials give sin r and cos r, and k mod 4
    selects function and sign. The error is 1.5 units of round-off for abs(x) < 1e6; beyond, one
    unit in the last place of x. There are no branches or calls, as in tanh.

    """
    rounded: Any = np.float64(x * _TWO_OVER_PI + _ROUNDING)
    k = rounded - _ROUNDING
    r = ((x - k * _HALF_PI_HIGH) - k * _HALF_PI_MIDDLE) - k * _HALF_PI_LOW
    r = _LARGEST_REST if r > _LARGEST_REST else r
    r = -_LARGEST_REST if r < -_LARGEST_REST else r
    r2 = r * r
    r4 = r2 * r2
    s = (_SIN[0] + _SIN[1] * r2) + ((_SIN[2] + _SIN[3] * r2) + (_SIN[4] + _SIN[5] * r2) * r4) * r4
    c = (_COS[0] + _COS[1] * r2) + ((_COS[2] + _COS[3] * r2) + (_COS[4] + _COS[5] * r2) * r4) * r4
    sine, cosine = r + r * r2 * s, (1.0 - 0.5 * r2) + r4 * c
    quadrant = rounded.view(np.int64)
    swapped = (quadrant & 1) != 0
    first, second = cosine if swapped else sine, sine if swapped else cosine
    # The second bit is the sign of the sine; the sign of the cosine is one quadrant ahead.
    sign, ahead = (quadrant & 2) << 62, ((quadrant + 1) & 2) << 62
    return (np.int64(np.float64(first).view(np.int64) ^ sign).view(np.float64),
            np.int64(np.float64(second).view(np.int64) ^ ahead).view(np.float64))


# Below this, exp is still far from underflow, and softplus is indistinguishable from 0.
_LOWEST = -700.0
# (artanh(t) / t - 1) / t^2 as a polynomial of t^2, lowest power first: interpolation in the ten
# Chebyshev nodes of 0 <= t^2 <= 1.0001 / 9, recomputed in test_vector_functions.py; relative error
# 7e-18.
_LOG = (
    0.3333333333333333, 0.20000000000007298, 0.1428571428355253, 0.11111111358900891,
    0.09090894708663223, 0.07692785296456121, 0.06657067775440581, 0.06000577591428889,
    0.04400158825434387, 0.08082469084735669)


@part(**_PRECISE)
def _artanh(t: float) -> float:
    """Return artanh(t) for abs(t) <= 1/3."""
    t2 = t * t
    t4 = t2 * t2
    t8 = t4 * t4
    tail = ((_LOG[0] + _LOG[1] * t2) + (_LOG[2] + _LOG[3] * t2) * t4) + (
        ((_LOG[4] + _LOG[5] * t2) + (_LOG[6] + _LOG[7] * t2) * t4)
        + (_LOG[8] + _LOG[9] * t2) * t8) * t8
    return t + t * t2 * tail


# The bits of the square root of 1/2, less 1024 powers of two; and 2^52 + 1024 with its bits.
_HALF_ROOT, _MANTISSA = 0x3FE6A09E667F3BCD - (1024 << 52), 0x4330000000000000
_POWER = 4503599627371520.0
# Below this, doubles have fewer bits; multiplied by 2^54 they have all.
_NORMAL, _SCALE = 2.2250738585072014e-308, 18014398509481984.0


@kept(**_PRECISE)
def logarithm(x: float) -> float:
    """
    Return log(x), to about one unit in the last place; NaN for negative x.

    With x = 2^k m and m from 2^(-1/2) to 2^(1/2), log x = k ln 2 + 2 artanh((m - 1) / (m + 1)).
    """
    scaled = x * _SCALE if x < _NORMAL else x
    bits: Any = np.float64(scaled).view(np.int64)
    power = np.int64(np.uint64(bits - _HALF_ROOT) >> np.uint64(52))
    m: Any = np.int64(bits - ((power - 1024) << 52)).view(np.float64)
    k = np.int64(power | _MANTISSA).view(np.float64) - _POWER
    k = k - 54.0 if x < _NORMAL else k
    t = (m - 1.0) / (m + 1.0)
    found = k * _LN2_HIGH + (2.0 * _artanh(t) + k * _LN2_LOW)
    found = found if x < np.inf else x
    return (found if x > 0.0 else np.nan) if x != 0.0 else -np.inf


@kept(**_PRECISE)
def softplus_and_slope(x: float) -> tuple[float, float]:
    """
    Return log(1 + exp(x)) and its derivative, 1 / (1 + exp(-x)); NaN stays NaN.

    With u = exp(-abs(x)) and t = u / (2 + u), log(1 + u) = 2 artanh(t), which is added to x if x
    is positive. The relative error of both is about four units of round-off for x > -700; below,
    both are constant at their values at -700, 1e-304.

    """
    low = x if x < 0.0 else -x
    low = _LOWEST if low < _LOWEST else low
    power_of_two, rest = _exponential(low)
    u = power_of_two * (1.0 + rest)
    t = u / (2.0 + u)
    positive = 0.0 if x < 0.0 else x
    ratio = 1.0 / (1.0 + u)
    return positive + 2.0 * _artanh(t), (u if x < 0.0 else 1.0) * ratio


# Sums may be reordered to vectorise; NaN and infinity keep their meaning, because the checks for
# non-finite states would otherwise be optimised away.
FASTMATH = {'contract', 'reassoc', 'nsz', 'arcp'}
_OPTIONS: dict[str, Any] = {'fastmath': FASTMATH, 'error_model': 'numpy', 'forceinline': True}
_inlined = part(**_OPTIONS)


# True if the slope of an activation is continuous.
SMOOTH = {'tanh': True, 'sine': True, 'relu': False, 'softplus': True}


@_inlined
def _relu(z: float) -> tuple[float, float]:
    # NaN gives NaN.
    return (0.0 if z <= 0.0 else z), (1.0 if z > 0.0 else 0.0 if z <= 0.0 else z)


@_inlined
def _sine_curvature(value: float, slope: float) -> float:
    return -value


@_inlined
def _softplus_curvature(value: float, slope: float) -> float:
    return slope * (1.0 - slope)


@_inlined
def _relu_curvature(value: float, slope: float) -> float:
    return 0.0


_FUNCTIONS: dict[type, tuple[Any, Any]] = {
    Sine: (sine_and_cosine, _sine_curvature),
    Softplus: (softplus_and_slope, _softplus_curvature),
    Relu: (_relu, _relu_curvature)}


def activate(network: PackedPerceptron, s: int, layer: int, bias: int, first: int, last: int
             ) -> None:
    """Replace z by the activation of z + b_l, b_l in row bias, in the tiles first to last."""
    raise NotImplementedError('compiled code only')


def in_columns(network: PackedPerceptron) -> PackedPerceptron:
    """Return the same workspace for one state whose rows are as long as those of all states."""
    raise NotImplementedError('compiled code only')


def scale(network: PackedPerceptron, s: int, layer: int, row: int, first: int, last: int) -> None:
    """Multiply row + layer by the slope at z_l, in the tiles first to last."""
    raise NotImplementedError('compiled code only')


def scale_forth(network: PackedPerceptron, s: int, layer: int, first: int, last: int) -> None:
    """Replace z_l' by a_l', and store the derivative of the slope, in the tiles first to last."""
    raise NotImplementedError('compiled code only')


def scale_tangent(network: PackedPerceptron, s: int, layer: int, first: int, last: int) -> None:
    """Replace g_l' by delta_l' = slope g_l' + slope' g_l, in the tiles first to last."""
    raise NotImplementedError('compiled code only')


def _typed(kind: type) -> Any:
    @_inlined
    def typed(network: Mapping) -> PackedPerceptron:
        return kind(network.sizes, network.rows, network.tiles, network.nodes, network.node_tiles)
    return typed


_as_tanh, _as_sine, _as_relu, _as_softplus = map(_typed, (Tanh, Sine, Relu, Softplus))


@part(fastmath=FASTMATH, error_model='numpy')
def _activate_others(network: Mapping, s: int, layer: int, bias: int, first: int, last: int
                     ) -> None:
    if network.activation == 1:
        activate(_as_sine(network), s, layer, bias, first, last)
    elif network.activation == 2:
        activate(_as_relu(network), s, layer, bias, first, last)
    else:
        activate(_as_softplus(network), s, layer, bias, first, last)


@part(fastmath=FASTMATH, error_model='numpy')
def _scale_forth_others(network: Mapping, s: int, layer: int, first: int, last: int) -> None:
    if network.activation == 1:
        scale_forth(_as_sine(network), s, layer, first, last)
    elif network.activation == 2:
        scale_forth(_as_relu(network), s, layer, first, last)
    else:
        scale_forth(_as_softplus(network), s, layer, first, last)


# In the loops below, an unsigned index cannot be negative; the wrap-around check for negative
# indices would prevent vectorisation.
@overload(in_columns, jit_options={**_OPTIONS, **LINK_ONLY})
def _in_columns(network: Any) -> Any:
    kind = network.instance_class

    def of_all(network: Any) -> Any:
        states, count, width = network.nodes.shape
        # By address: a reshaped array would count references.
        at, n = address_of(network.nodes[0, 0]), states * width
        return kind(network.sizes, array_at(at, (count, n)), network.tiles,
                    array_at(at, (1, count, n)), array_at(at, (1, count, n // TILE, TILE)))
    return of_all


@overload(activate, jit_options={**_OPTIONS, **LINK_ONLY})
def _activate(network: Any, s: int, layer: int, bias: int, first: int, last: int) -> Any:
    def of_tanh(network: Any, s: int, layer: int, bias: int, first: int, last: int) -> None:
        rows, nodes = network.rows, network.nodes
        for i in range(np.uint64(TILE * first), np.uint64(TILE * last)):
            nodes[s, layer, i] = tanh(nodes[s, layer, i] + rows[bias, i])

    def of_others(network: Any, s: int, layer: int, bias: int, first: int, last: int) -> None:
        sizes, rows, nodes = network.sizes, network.rows, network.nodes
        slope = 4 * sizes.size + layer
        for i in range(np.uint64(TILE * first), np.uint64(TILE * last)):
            value, derivative = value_and_slope(nodes[s, layer, i] + rows[bias, i])
            nodes[s, layer, i] = value
            nodes[s, slope, i] = derivative

    def of_any(network: Any, s: int, layer: int, bias: int, first: int, last: int) -> None:
        if network.activation == 0:
            activate(_as_tanh(network), s, layer, bias, first, last)
        else:
            _activate_others(network, s, layer, bias, first, last)

    if network.instance_class is Mapping:
        return of_any
    if network.instance_class is Tanh:
        return of_tanh
    value_and_slope, _ = _FUNCTIONS[network.instance_class]
    return of_others


@overload(scale, jit_options={**_OPTIONS, **LINK_ONLY})
def _scale(network: Any, s: int, layer: int, row: int, first: int, last: int) -> Any:
    def of_tanh(network: Any, s: int, layer: int, row: int, first: int, last: int) -> None:
        nodes = network.nodes
        for i in range(np.uint64(TILE * first), np.uint64(TILE * last)):
            nodes[s, row + layer, i] *= 1.0 - nodes[s, layer, i] * nodes[s, layer, i]

    def of_others(network: Any, s: int, layer: int, row: int, first: int, last: int) -> None:
        nodes, slope = network.nodes, 4 * network.sizes.size + layer
        for i in range(np.uint64(TILE * first), np.uint64(TILE * last)):
            nodes[s, row + layer, i] *= nodes[s, slope, i]

    def of_any(network: Any, s: int, layer: int, row: int, first: int, last: int) -> None:
        if network.activation == 0:
            scale(_as_tanh(network), s, layer, row, first, last)
        else:
            scale(_as_sine(network), s, layer, row, first, last)

    if network.instance_class is Mapping:
        return of_any
    return of_tanh if network.instance_class is Tanh else of_others


@overload(scale_forth, jit_options={**_OPTIONS, **LINK_ONLY})
def _scale_forth(network: Any, s: int, layer: int, first: int, last: int) -> Any:
    def of_tanh(network: Any, s: int, layer: int, first: int, last: int) -> None:
        scale(network, s, layer, 2 * network.sizes.size, first, last)

    def of_others(network: Any, s: int, layer: int, first: int, last: int) -> None:
        nodes, g = network.nodes, network.sizes.size
        for i in range(np.uint64(TILE * first), np.uint64(TILE * last)):
            value, slope = nodes[s, layer, i], nodes[s, 4 * g + layer, i]
            z = nodes[s, 2 * g + layer, i]
            nodes[s, 5 * g + layer, i] = curvature(value, slope) * z
            nodes[s, 2 * g + layer, i] = slope * z

    def of_any(network: Any, s: int, layer: int, first: int, last: int) -> None:
        if network.activation == 0:
            scale_forth(_as_tanh(network), s, layer, first, last)
        else:
            _scale_forth_others(network, s, layer, first, last)

    if network.instance_class is Mapping:
        return of_any
    if network.instance_class is Tanh:
        return of_tanh
    _, curvature = _FUNCTIONS[network.instance_class]
    return of_others


@overload(scale_tangent, jit_options={**_OPTIONS, **LINK_ONLY})
def _scale_tangent(network: Any, s: int, layer: int, first: int, last: int) -> Any:
    def of_tanh(network: Any, s: int, layer: int, first: int, last: int) -> None:
        nodes, g = network.nodes, network.sizes.size
        for i in range(np.uint64(TILE * first), np.uint64(TILE * last)):
            a = nodes[s, layer, i]
            nodes[s, 3 * g + layer, i] = (
                (1.0 - a * a) * nodes[s, 3 * g + layer, i]
                - 2.0 * a * nodes[s, 2 * g + layer, i] * nodes[s, g + layer, i])

    def of_others(network: Any, s: int, layer: int, first: int, last: int) -> None:
        nodes, g = network.nodes, network.sizes.size
        for i in range(np.uint64(TILE * first), np.uint64(TILE * last)):
            nodes[s, 3 * g + layer, i] = (
                nodes[s, 4 * g + layer, i] * nodes[s, 3 * g + layer, i]
                + nodes[s, 5 * g + layer, i] * nodes[s, g + layer, i])

    def of_any(network: Any, s: int, layer: int, first: int, last: int) -> None:
        if network.activation == 0:
            scale_tangent(_as_tanh(network), s, layer, first, last)
        else:
            scale_tangent(_as_sine(network), s, layer, first, last)

    if network.instance_class is Mapping:
        return of_any
    return of_tanh if network.instance_class is Tanh else of_others
