# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Graphs of the families whose model files hold networks without a graph."""

from collections.abc import Callable

from hnn_vi_ros.models.checkpoint import Checkpoint
from hnn_vi_ros.models.graphs.graph import Builder, GraphNetwork
import numpy as np


def family_graph(checkpoint: Checkpoint) -> tuple[Builder, int]:
    """Return H of a model as a graph, and its output."""
    if checkpoint.graph is not None:
        return checkpoint.graph
    b, d = Builder(), len(checkpoint.card.coordinates)
    x = b.input(2 * d)
    output = _GRAPHS[checkpoint.card.family](
        b, checkpoint, b.take(x, np.arange(d)), b.take(x, np.arange(d, 2 * d)))
    return b, b.reshape(output, ())


def _control_affine(b: Builder, checkpoint: Checkpoint, q: int, p: int) -> int:
    """Return |A(q)^T p|^2 / 2 + V(q), with the entries of a lower triangular A by rows."""
    (d,) = b.shape(p)
    entries = _network(b, checkpoint, 'mass_inverse', q)
    root = b.put(entries, np.ravel_multi_index(np.tril_indices(d), (d, d)), (d, d))
    w = b.matmul(b.reshape(p, (1, d)), root)
    kinetic = b.sum(b.mul(b.mul(w, w), b.full(w, 0.5)), (0,))
    return b.add(b.reshape(b.sum(kinetic, (0,)), (1,)), _network(b, checkpoint, 'potential', q))


def _network(b: Builder, checkpoint: Checkpoint, name: str, x: int) -> int:
    b.networks.append(GraphNetwork(checkpoint.networks[name], checkpoint.card.activation))
    return b.perceptron(len(b.networks) - 1, x)


_GRAPHS: dict[str, Callable[[Builder, Checkpoint, int, int], int]] = {
    'control_affine': _control_affine}
