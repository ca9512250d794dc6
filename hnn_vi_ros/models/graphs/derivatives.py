# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Derivatives of graphs as graphs: gradients by reverse mode, products with J by forward mode.

A. Griewank, A. Walther, Evaluating Derivatives, 2nd edition, SIAM 2008.
"""

from collections.abc import Sequence
from itertools import accumulate
import math

from hnn_vi_ros.models.graphs.graph import Builder, count_products, needed, Shape
from hnn_vi_ros.models.graphs.operations import BINARY, UNARY
import numpy as np


# Maximum of pairs of a value, or a product, and an input whose dependence is computed.
_MAX_PAIRS = 1 << 26


def gradient(b: Builder, output: int, x: int, weights: int | None = None) -> int:
    """
    Add the gradient of a number, or of a weighted sum at constant weights, with respect to a node.

    Parameters
    ----------
    b : Builder
        The graph; nodes are added to it.
    output, x : int
        A node of one value, or that of the values that are weighted; and the input vector.
    weights : int, optional
        The weights, of the shape of the output.

    Returns
    -------
    int
        The gradient, of the shape of x.

    """
    own = _between(b, [output], x)
    found = {output: b.full(output, 1.0) if weights is None else weights}
    for k in sorted(own, reverse=True):
        if k in found and k != x:
            for source, part in _back(b, k, found[k], own):
                found[source] = b.add(found[source], part) if source in found else part
    return found[x] if x in found else b.full(x, 0.0)


def tangent(b: Builder, output: int, x: int, v: int) -> int:
    """Add the derivative of a node along the change v of the node x; see ``gradient``."""
    own = _between(b, [output], x)
    found = {x: v}
    for k in sorted(own - {x}):
        found[k] = _forth(b, k, found)
    return found[output] if output in found else b.full(output, 0.0)


def dependence(b: Builder, output: int, x: int) -> np.ndarray:
    """
    Return the dependence of values of a node on values of x, from the structure alone.

    For large graphs the answer is that all may.

    Returns
    -------
    np.ndarray of bool, shape (values of the node, values of x)

    """
    count, own = math.prod(b.shape(x)), needed(b.nodes, [output])
    products = sum(count_products(b.shape(node.inputs[0]), b.shape(node.inputs[1]), *node.options)
                   for node in map(b.nodes.__getitem__, own) if node.op == 'matmul')
    if count * (products + sum(math.prod(b.shape(k)) for k in own)) > _MAX_PAIRS:
        return np.ones((math.prod(b.shape(output)), count), dtype=bool)
    found: dict[int, np.ndarray] = {x: np.eye(count, dtype=bool)}
    for k in own:
        if k != x:
            found[k] = _reached(b, k, found, count)
    return found[output]


def _between(b: Builder, outputs: Sequence[int], x: int) -> set[int]:
    """Return the nodes that depend on x and that outputs depend on."""
    own = {x}
    for k in needed(b.nodes, outputs):
        if own.intersection(b.nodes[k].inputs):
            own.add(k)
    return own


def spread_index(shape: Shape, axes: Sequence[int]) -> np.ndarray:
    """Return the index that takes each value of a sum over axes to all that it sums."""
    left = tuple(1 if k in axes else n for k, n in enumerate(shape))
    return np.broadcast_to(np.arange(math.prod(left)).reshape(left), shape)


def _back(b: Builder, k: int, g: int, own: set[int]) -> list[tuple[int, int]]:
    """Return the inputs of a node that depend on x, with their parts of the gradient."""
    node = b.nodes[k]
    x, shapes = node.inputs[0], [b.shape(i) for i in node.inputs]
    parts: list[int | None]
    match node.op:
        case op if op in UNARY:
            parts = [b.mul(g, UNARY[op].slope(b, x, k))]
        case op if op in BINARY:
            parts = [None if slope is None else b.mul(g, slope)
                     for slope in BINARY[op].slopes(b, x, node.inputs[1], k)]
        case 'where':
            zero = b.full(k, 0.0)
            parts = [None, b.where(x, g, zero), b.where(x, zero, g)]
        case 'matmul':
            y, (t_x, t_y) = node.inputs[1], map(bool, node.options)
            parts = [
                (b.matmul(y, g, t_y, True) if t_x else b.matmul(g, y, False, not t_y))
                if x in own else None,
                (b.matmul(g, x, True, t_x) if t_y else b.matmul(x, g, not t_x, False))
                if y in own else None]
        case 'sum':
            parts = [b.take(g, spread_index(shapes[0], node.options))]
        case 'amax':
            mask, share = _largest(b, x, k)
            parts = [b.mul(mask, b.take(b.mul(g, share), spread_index(shapes[0], node.options)))]
        case 'reshape':
            parts = [b.reshape(g, shapes[0])]
        case 'take':
            parts = [b.put(g, b.tensors[node.tensor], shapes[0])]
        case 'put':
            parts = [b.take(g, b.tensors[node.tensor].reshape(shapes[0]))]
        case 'perceptron':
            parts = [b.pullback(node.tensor, x, g)]
        case _:
            ends = [0, *accumulate(map(math.prod, shapes))]
            parts = [b.take(g, np.arange(first, last).reshape(shape)) for first, last, shape
                     in zip(ends, ends[1:], shapes, strict=False)]
    return [(i, part) for i, part in zip(node.inputs, parts, strict=True)
            if i in own and part is not None]


def _largest(b: Builder, x: int, k: int) -> tuple[int, int]:
    """Return the mask of x where it has its maxima k over axes, and 1 / their counts, as k."""
    axes = b.nodes[k].options
    mask = b.binary('eq', x, b.take(k, spread_index(b.shape(x), axes)))
    return mask, b.unary('reciprocal', b.sum(mask, axes))


def _forth(b: Builder, k: int, found: dict[int, int]) -> int:
    """Return the tangent of a node, given the tangents of its inputs that depend on x."""
    node = b.nodes[k]
    own = [found[i] if i in found else b.full(i, 0.0) for i in node.inputs]
    x, t = node.inputs[0], own[0]
    match node.op:
        case op if op in UNARY:
            return b.mul(t, UNARY[op].slope(b, x, k))
        case op if op in BINARY:
            first, second = (
                b.full(k, 0.0) if slope is None or i not in found else b.mul(change, slope)
                for i, slope, change in zip(
                    node.inputs, BINARY[op].slopes(b, x, node.inputs[1], k), own, strict=True))
            return b.add(first, second)
        case 'where':
            return b.where(x, own[1], own[2])
        case 'matmul':
            y, (t_x, t_y) = node.inputs[1], map(bool, node.options)
            return b.add(b.matmul(t, y, t_x, t_y), b.matmul(x, own[1], t_x, t_y))
        case 'sum':
            return b.sum(t, node.options)
        case 'amax':
            mask, share = _largest(b, x, k)
            return b.mul(share, b.sum(b.mul(mask, t), node.options))
        case 'reshape':
            return b.reshape(t, node.options)
        case 'take':
            return b.take(t, b.tensors[node.tensor])
        case 'put':
            return b.put(t, b.tensors[node.tensor], node.options)
        case 'perceptron':
            return b.pushforward(node.tensor, x, t)
        case 'pullback':
            return b.add(b.pullback(node.tensor, x, own[1]),
                         b.pullback_tangent(node.tensor, x, node.inputs[1], t))
    return b.concatenate(own)


def _reached(b: Builder, k: int, found: dict[int, np.ndarray], count: int) -> np.ndarray:
    """Return the dependence of a node, given its inputs' dependences."""
    node = b.nodes[k]
    size, own = math.prod(node.shape), [found[i] for i in node.inputs]
    match node.op:
        case 'constant' | 'input':
            return np.broadcast_to(np.False_, (size, count))
        case 'matmul':
            left, right = ([
                np.swapaxes(part, -2, -3) if turned else part] for part, turned in zip(
                    (dep.reshape(*b.shape(i), count) for i, dep in zip(
                        node.inputs, own, strict=True)), node.options, strict=True))
            # A zero constant stops what it is multiplied by.
            masks = [(np.ones(b.shape(i)) if (value := b.value(i)) is None else value) != 0.0
                     for i in node.inputs]
            masks = [np.swapaxes(mask, -1, -2) if turned else mask
                     for mask, turned in zip(masks, node.options, strict=True)]
            through = (np.einsum('...mkc,...kn->...mnc', left[0].astype(float), masks[1])
                       + np.einsum('...mk,...knc->...mnc', masks[0], right[0].astype(float)))
            return (through > 0.0).reshape(size, count)
        case 'sum' | 'amax':
            whole = own[0].reshape(*b.shape(node.inputs[0]), count)
            return whole.any(axis=node.options).reshape(size, count)
        case 'take':
            return own[0][b.tensors[node.tensor].ravel()]
        case 'put':
            total = np.zeros((size, count), dtype=bool)
            np.logical_or.at(total, b.tensors[node.tensor].ravel(), own[0])
            return total
        case 'concatenate':
            return np.concatenate(own)
        case 'perceptron' | 'pullback':
            return np.broadcast_to(np.logical_or.reduce([part.any(axis=0) for part in own]),
                                   (size, count))
    return np.logical_or.reduce(own) if len(own) > 1 else own[0]
