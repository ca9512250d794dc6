# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Perceptrons in graphs: chains of dense layers with one activation, each fused into one node.

Between two activations such a chain has operations that are affine in the values before them:
products with weights, biases, scales, sums and moves. Each segment is computed as one matrix and
one bias, unless its matrix would have more entries than its operations have multiplications.
"""

from collections import Counter
from collections.abc import Mapping
import math
from typing import NamedTuple

from hnn_vi_ros.models.graphs.graph import Builder, count_products, GraphNetwork, GraphNode, needed
from hnn_vi_ros.models.networks.layers import Layers
import numpy as np

ACTIVATIONS = {'tanh': 'tanh', 'sin': 'sine', 'relu': 'relu', 'softplus': 'softplus'}
# Maximum of entries of the matrices of all operations in a segment.
_MAX_ENTRIES = 1 << 25
_ELEMENTWISE = ('add', 'sub', 'mul', 'div', 'neg')


class _Segment(NamedTuple):
    """Affine nodes from a source to a node, in the order of their computation."""

    source: int
    nodes: list[int]


def fused(b: Builder, output: int) -> tuple[Builder, int]:
    """Return a graph with each perceptron in it as one node, and its output."""
    new, found, ends, inner = Builder(), dict[int, int](), dict[int, tuple[int, int]](), set[int]()
    for segments, activation in _chains(b, output):
        own = {k for segment in segments for k in segment.nodes}
        layers = [] if own & inner else [_affine(b, segment) for segment in segments]
        if layers and None not in layers:
            inner |= own
            ends[segments[-1].nodes[-1]] = segments[0].source, len(new.networks)
            weights, biases = zip(*filter(None, layers), strict=True)
            new.networks.append(GraphNetwork(Layers(weights, biases), ACTIVATIONS[activation]))
    for k in needed(b.nodes, [output]):
        node = b.nodes[k]
        if k in ends:
            source, network = ends[k]
            x = new.reshape(found[source], (math.prod(b.shape(source)),))
            found[k] = new.reshape(new.perceptron(network, x), node.shape)
        elif node.op == 'input':
            found[k] = new.input(*node.shape, *node.options)
        elif node.op == 'perceptron':
            new.networks.append(b.networks[node.tensor])
            found[k] = new.perceptron(len(new.networks) - 1, found[node.inputs[0]])
        elif k not in inner and all(i in found for i in node.inputs):
            found[k] = new.operation(
                node.op, [found[i] for i in node.inputs], node.options,
                b.tensors[node.tensor] if node.tensor >= 0 else None)
    return new, found[output]


def whole_perceptron(b: Builder, output: int) -> GraphNetwork | None:
    """Return the network of a graph that is one perceptron of all its inputs, else None."""
    node = _unshaped(b, output)
    return b.networks[node.tensor] if node.op == 'perceptron' and _unshaped(
        b, node.inputs[0]).op == 'input' else None


def _unshaped(b: Builder, k: int) -> GraphNode:
    node = b.nodes[k]
    return b.nodes[node.inputs[0]] if node.op == 'reshape' else node


def _chains(b: Builder, output: int) -> list[tuple[list[_Segment], str]]:
    """Return the segments of each chain, the first from its inputs, and its activation."""
    own = needed(b.nodes, [output])
    uses = Counter(i for k in own for i in b.nodes[k].inputs)
    uses[output] += 1
    chains = dict[int, list[_Segment]]()
    for k in own:
        node = b.nodes[k]
        if node.op not in ACTIVATIONS:
            continue
        before = _segment_before(b, node.inputs[0], uses)
        if before is None:
            continue
        source = before.source
        # A hidden layer that nothing else uses is followed by the next one.
        if b.nodes[source].op == node.op and uses[source] == 1 and source in chains:
            chains[k] = [*chains.pop(source), before]
        else:
            chains[k] = [_shortened(b, before)]
    found = []
    users = {i: k for k in own for i in b.nodes[k].inputs}
    for last, segments in chains.items():
        end = _segment_after(b, last, users, uses)
        segments = [*segments, end] if end is not None else segments
        if len(segments) > 1:
            found.append((segments, b.nodes[last].op))
    return found


def _previous(b: Builder, k: int) -> int | None:
    """Return the input that a node is affine in; None if it is not, or in several."""
    node = b.nodes[k]
    inputs = [i for i in node.inputs if not b.is_constant(i)]
    if len(inputs) != 1 or node.op not in (
            *_ELEMENTWISE, 'matmul', 'sum', 'reshape', 'take', 'put'):
        return None
    return None if node.op == 'div' and b.is_constant(node.inputs[0]) else inputs[0]


def _segment_before(b: Builder, last: int, uses: Mapping[int, int]) -> _Segment | None:
    """Return the segment that ends in a node; None without a dense layer."""
    nodes, k = list[int](), last
    while uses[k] == 1 and (previous := _previous(b, k)) is not None:
        nodes.insert(0, k)
        k = previous
    return _Segment(k, nodes) if any(_is_dense(b, k) for k in nodes) else None


def _shortened(b: Builder, segment: _Segment) -> _Segment:
    """Return a segment without moves before its first dense layer: they make no wider inputs."""
    source, nodes = segment.source, [*segment.nodes]
    first = next(k for k, node in enumerate(nodes) if _is_dense(b, node))
    for k, node in enumerate(nodes[:first]):
        if b.nodes[node].op in ('take', 'put'):
            source, nodes = node, segment.nodes[k + 1:]
    return _Segment(source, nodes)


def _segment_after(b: Builder, source: int, users: Mapping[int, int], uses: Mapping[int, int]
                   ) -> _Segment | None:
    """Return the segment from an activation up to a dense layer and what scales its outputs."""
    nodes, k, dense = list[int](), source, False
    while uses[k] == 1 and k in users and _previous(b, users[k]) == k:
        k = users[k]
        if b.nodes[k].op in ('take', 'put') or (dense and b.nodes[k].op == 'matmul'):
            break
        nodes.append(k)
        dense = dense or _is_dense(b, k)
    return _Segment(source, nodes) if dense else None


def _is_dense(b: Builder, k: int) -> bool:
    return b.nodes[k].op in ('matmul', 'sum')


def _affine(b: Builder, segment: _Segment) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the matrix and the bias of a segment, None if fewer operations compute it."""
    source, nodes = segment
    shape, count = b.shape(source), math.prod(b.shape(source))
    sizes = [math.prod(b.shape(k)) for k in (source, *nodes)]
    work = sum(_work(b, k) for k in nodes)
    if sizes[-1] * count > work or (count + 1) * sum(sizes) > _MAX_ENTRIES:
        return None
    # The first row is the bias, the others are the columns of the matrix.
    rows = np.vstack([np.zeros(count), np.eye(count)]).reshape(count + 1, *shape)
    for k in nodes:
        rows = _applied(b, b.nodes[k], rows)
    rows = rows.reshape(count + 1, -1)
    return np.ascontiguousarray(rows[1:].T), rows[0].copy()


def _work(b: Builder, k: int) -> int:
    node = b.nodes[k]
    shapes = [b.shape(i) for i in node.inputs]
    if node.op == 'matmul':
        return count_products(shapes[0], shapes[1], *node.options)
    return math.prod(shapes[0]) if node.op == 'sum' else 0


def _applied(b: Builder, node: GraphNode, rows: np.ndarray) -> np.ndarray:
    """Return the rows after an affine operation."""
    first = not b.is_constant(node.inputs[0])
    constant = b.value(node.inputs[-1] if first else node.inputs[0])
    match node.op:
        case 'neg':
            return -rows
        case 'add' | 'sub':
            assert constant is not None, 'of two inputs one is constant'
            rows = -rows if node.op == 'sub' and not first else rows.copy()
            rows[0] += -constant if node.op == 'sub' and first else constant
            return rows
        case 'mul':
            return rows * constant
        case 'div':
            return rows / constant
        case 'matmul':
            assert constant is not None, 'of two inputs one is constant'
            t_x, t_y = node.options
            turned, other = (t_x, t_y) if first else (t_y, t_x)
            rows = np.swapaxes(rows, -1, -2) if turned else rows
            constant = np.swapaxes(constant, -1, -2) if other else constant
            return rows @ constant if first else constant @ rows
        case 'sum':
            return rows.sum(axis=tuple(k + 1 for k in node.options))
        case 'reshape':
            return rows.reshape(len(rows), *node.shape)
        case 'take':
            return rows.reshape(len(rows), -1)[:, b.tensors[node.tensor]]
    found = np.zeros((math.prod(node.shape), len(rows)))
    np.add.at(found, b.tensors[node.tensor].ravel(), rows.reshape(len(rows), -1).T)
    return found.T.reshape(len(rows), *node.shape)
