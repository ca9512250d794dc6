# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Functions between the layers of a network: their value, slope and curvature.

Each class of PackedPerceptron has one activation, by which the compiler chooses among the loops
below, so that a network of one activation holds nothing of the others. tanh needs no memory of
its own: its slope is 1 - a^2. The others keep their slope in a fifth group of rows of
``nodes``, and in a sixth its derivative along a_0' = v.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from hnn_vi_ros.kernels.linking import LINK_ONLY, part
from hnn_vi_ros.networks.perceptron_memory import (
    PackedPerceptron, Relu, Sine, Softplus, Tanh, TILE)
from hnn_vi_ros.networks.vector_functions import sine_and_cosine, softplus_and_slope, tanh
from numba.extending import overload
import numpy as np

# Sums may be reordered to vectorise; NaN and infinity keep their meaning, or the checks for
# non-finite states would be optimised away.
FASTMATH = {'contract', 'reassoc', 'nsz', 'arcp'}
_OPTIONS: dict[str, Any] = {'fastmath': FASTMATH, 'error_model': 'numpy', 'forceinline': True}
_inlined = part(**_OPTIONS)


class NumpyActivation(NamedTuple):
    """An activation in numpy, for any precision: value and slope of z."""

    value: Callable[[np.ndarray], np.ndarray]
    slope: Callable[[np.ndarray], np.ndarray]
    smooth: bool = True


ACTIVATIONS = {
    'tanh': NumpyActivation(np.tanh, lambda z: 1.0 - np.tanh(z) ** 2),
    'sine': NumpyActivation(np.sin, np.cos),
    'relu': NumpyActivation(lambda z: np.maximum(z, 0.0),
                            lambda z: np.where(z > 0.0, 1.0, 0.0 * z), smooth=False),
    'softplus': NumpyActivation(lambda z: np.logaddexp(z, 0.0),
                                lambda z: 1.0 / (1.0 + np.exp(-z))),
}


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


def activate(network: PackedPerceptron, s: int, layer: int, first: int, last: int) -> None:
    """Replace z by the activation of z + b_l, in the tiles first to last."""
    raise NotImplementedError('compiled code only')


def scale(network: PackedPerceptron, s: int, layer: int, row: int, first: int, last: int) -> None:
    """Multiply row + layer by the slope at z_l, in the tiles first to last."""
    raise NotImplementedError('compiled code only')


def scale_forth(network: PackedPerceptron, s: int, layer: int, first: int, last: int) -> None:
    """Replace z_l' by a_l', and keep the derivative of the slope, in the tiles first to last."""
    raise NotImplementedError('compiled code only')


def scale_tangent(network: PackedPerceptron, s: int, layer: int, first: int, last: int) -> None:
    """Replace g_l' by delta_l' = slope g_l' + slope' g_l, in the tiles first to last."""
    raise NotImplementedError('compiled code only')


# In the loops below, an index without a sign cannot count from the end of an array, the check of
# which would keep them from vectorising.
@overload(activate, jit_options={**_OPTIONS, **LINK_ONLY})
def _activate(network: Any, s: int, layer: int, first: int, last: int) -> Any:
    def of_tanh(network: Any, s: int, layer: int, first: int, last: int) -> None:
        sizes, rows, nodes = network.sizes, network.rows, network.nodes
        bias = sizes[0] + layer - 1
        for i in range(np.uint64(TILE * first), np.uint64(TILE * last)):
            nodes[s, layer, i] = tanh(nodes[s, layer, i] + rows[bias, i])

    def of_others(network: Any, s: int, layer: int, first: int, last: int) -> None:
        sizes, rows, nodes = network.sizes, network.rows, network.nodes
        bias, slope = sizes[0] + layer - 1, 4 * sizes.size + layer
        for i in range(np.uint64(TILE * first), np.uint64(TILE * last)):
            value, derivative = value_and_slope(nodes[s, layer, i] + rows[bias, i])
            nodes[s, layer, i] = value
            nodes[s, slope, i] = derivative

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

    return of_tanh if network.instance_class is Tanh else of_others
