# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
The operations of graphs: names, semantics and derivatives.

A graph computes with arrays of float64 of fixed shapes, in row-major order; truth values are 1.0
and 0.0. Elementwise operations take arrays of one shape, without broadcasting. The structural ones
are

    input                 the argument of the graph, one vector
    constant T            tensor T of the file
    matmul a b [t_a t_b]  a b, of (m, k) and (k, n) or of stacks of these; t: transpose first
    sum a [axes]          sum over axes
    amax a [axes]         largest value over axes
    reshape a [shape]     the same values in another shape
    take a T              a.ravel()[T], in the shape of the index tensor T
    put a T [shape]       zeros of this shape, where ravel()[T] += a
    concatenate a b ...   the values of all, joined to one vector

Slices, transposes, broadcasts and indexing by constants are ``take``; their transposes are
``put``. ``fixed`` is the identity with the derivative 0, for what cancels, as the largest value
that a softmax subtracts. ``root`` is the square root with the derivative 0 at 0, as norms have it;
like sqrt and reciprocal, which have a singular point as well, it counts as smooth. Version 1 of
the list is the keys of UNARY, BINARY and STRUCTURAL, and ``where``.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.special import erf, expit

VERSION = 1
STRUCTURAL = ('input', 'constant', 'matmul', 'sum', 'amax', 'reshape', 'take', 'put',
              'concatenate')
Array = np.ndarray


class Unary(NamedTuple):
    """An elementwise function of one array: its values, and its derivative as a graph."""

    values: Callable[[Array], Array]
    # slope(b, x, y) adds nodes to the builder b: f'(x), where y = f(x).
    slope: Callable[[Any, Any, Any], Any]


class Binary(NamedTuple):
    """An elementwise function of two arrays: its values, and both derivatives as graphs."""

    values: Callable[[Array, Array], Array]
    # slopes(b, x, y, z) adds nodes: the derivatives of z = f(x, y); None for zero.
    slopes: Callable[[Any, Any, Any, Any], tuple[Any, Any]]


def _softplus(x: Array) -> Array:
    return np.logaddexp(x, 0.0)


def _zero(b: Any, x: Any, y: Any) -> Any:
    return b.full(x, 0.0)


UNARY: dict[str, Unary] = {
    'neg': Unary(np.negative, lambda b, x, y: b.full(x, -1.0)),
    'abs': Unary(np.abs, lambda b, x, y: b.unary('sign', x)),
    'sign': Unary(np.sign, _zero),
    'floor': Unary(np.floor, _zero),
    'ceil': Unary(np.ceil, _zero),
    'rint': Unary(np.rint, _zero),
    'not': Unary(lambda x: (x == 0.0).astype(float), _zero),
    'relu': Unary(lambda x: np.where(x <= 0.0, 0.0, x),
                  lambda b, x, y: b.binary('gt', x, b.full(x, 0.0))),
    'reciprocal': Unary(np.reciprocal, lambda b, x, y: b.neg(b.mul(y, y))),
    'sqrt': Unary(np.sqrt, lambda b, x, y: b.div(b.full(x, 0.5), y)),
    'exp': Unary(np.exp, lambda b, x, y: y),
    'expm1': Unary(np.expm1, lambda b, x, y: b.add(y, b.full(x, 1.0))),
    'log': Unary(np.log, lambda b, x, y: b.unary('reciprocal', x)),
    'log1p': Unary(np.log1p,
                   lambda b, x, y: b.unary('reciprocal', b.add(x, b.full(x, 1.0)))),
    'sin': Unary(np.sin, lambda b, x, y: b.unary('cos', x)),
    'cos': Unary(np.cos, lambda b, x, y: b.neg(b.unary('sin', x))),
    'tan': Unary(np.tan, lambda b, x, y: b.add(b.mul(y, y), b.full(x, 1.0))),
    'asin': Unary(np.arcsin, lambda b, x, y: b.unary('reciprocal', b.unary('sqrt', b.sub(
        b.full(x, 1.0), b.mul(x, x))))),
    'acos': Unary(np.arccos, lambda b, x, y: b.neg(b.unary('reciprocal', b.unary('sqrt', b.sub(
        b.full(x, 1.0), b.mul(x, x)))))),
    'atan': Unary(np.arctan, lambda b, x, y: b.unary('reciprocal', b.add(
        b.mul(x, x), b.full(x, 1.0)))),
    'sinh': Unary(np.sinh, lambda b, x, y: b.unary('cosh', x)),
    'cosh': Unary(np.cosh, lambda b, x, y: b.unary('sinh', x)),
    'tanh': Unary(np.tanh, lambda b, x, y: b.sub(b.full(x, 1.0), b.mul(y, y))),
    'asinh': Unary(np.arcsinh, lambda b, x, y: b.unary('reciprocal', b.unary('sqrt', b.add(
        b.mul(x, x), b.full(x, 1.0))))),
    'sigmoid': Unary(expit, lambda b, x, y: b.mul(y, b.sub(b.full(x, 1.0), y))),
    'softplus': Unary(_softplus, lambda b, x, y: b.unary('sigmoid', x)),
    'fixed': Unary(lambda x: x, _zero),
    'erf': Unary(erf, lambda b, x, y: b.mul(b.full(x, 2.0 / np.sqrt(np.pi)), b.unary(
        'exp', b.neg(b.mul(x, x))))),
    'root': Unary(np.sqrt, lambda b, x, y: b.div(b.full(x, 0.5), b.where(
        b.binary('eq', y, b.full(x, 0.0)), b.full(x, np.inf), y))),
}


def _compared(values: Callable[[Array, Array], Array]) -> Binary:
    return Binary(lambda x, y: values(x, y).astype(float), lambda b, x, y, z: (None, None))


def _power_slopes(b: Any, x: Any, y: Any, z: Any) -> tuple[Any, Any]:
    # The slope of x^0 is 0, at x = 0 as well.
    zero = b.full(x, 0.0)
    less = b.where(b.binary('eq', y, zero), zero, b.sub(y, b.full(y, 1.0)))
    by_base = b.mul(y, b.binary('pow', x, less))
    # x^y log x is 0 at x = 0, as its limit for y > 0.
    safe = b.where(b.binary('eq', x, zero), b.full(x, 1.0), x)
    return by_base, None if b.is_constant(y) else b.mul(z, b.unary('log', safe))


def _larger_slopes(b: Any, x: Any, y: Any, z: Any) -> tuple[Any, Any]:
    # Half each where both are equal, as torch does.
    own = b.mul(b.full(x, 0.5), b.add(b.binary('ge', x, y), b.binary('gt', x, y)))
    return own, b.sub(b.full(x, 1.0), own)


def _angle_slopes(b: Any, y: Any, x: Any, z: Any) -> tuple[Any, Any]:
    square = b.add(b.mul(x, x), b.mul(y, y))
    return b.div(x, square), b.neg(b.div(y, square))


BINARY: dict[str, Binary] = {
    'add': Binary(np.add, lambda b, x, y, z: (b.full(x, 1.0), b.full(x, 1.0))),
    'sub': Binary(np.subtract, lambda b, x, y, z: (b.full(x, 1.0), b.full(x, -1.0))),
    'mul': Binary(np.multiply, lambda b, x, y, z: (y, x)),
    'div': Binary(np.divide, lambda b, x, y, z: (
        b.unary('reciprocal', y), b.neg(b.div(z, y)))),
    'pow': Binary(np.power, _power_slopes),
    'maximum': Binary(np.maximum, _larger_slopes),
    'minimum': Binary(np.minimum, lambda b, x, y, z: _larger_slopes(b, y, x, z)),
    'atan2': Binary(np.arctan2, _angle_slopes),
    'lt': _compared(np.less), 'le': _compared(np.less_equal),
    'gt': _compared(np.greater), 'ge': _compared(np.greater_equal),
    'eq': _compared(np.equal), 'ne': _compared(np.not_equal),
}


def _neighbours(b: Any, node: Any) -> Any:
    shape = b.shape(node.inputs[0])
    numbers = np.arange(int(np.prod(shape))).reshape(shape)
    return b.sub(node.inputs[0], b.take(node.inputs[0], np.roll(numbers, 1, node.options)))


# Functions with kinks or jumps: nodes that change their signs there.
SWITCHES: dict[str, Callable[[Any, Any], Any]] = {
    **dict.fromkeys(('abs', 'atan2', 'sign', 'relu'), lambda b, node: node.inputs[0]),
    **dict.fromkeys(('maximum', 'minimum', 'lt', 'le', 'gt', 'ge', 'eq', 'ne'),
                    lambda b, node: b.sub(*node.inputs)),
    **dict.fromkeys(('floor', 'ceil', 'rint'), lambda b, node: b.unary('sin', b.mul(
        node.inputs[0], b.full(node.inputs[0], 2.0 * np.pi)))), 'amax': _neighbours}
