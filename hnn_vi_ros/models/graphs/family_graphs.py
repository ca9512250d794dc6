# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Graphs of the families whose model files hold networks without a graph."""

from collections.abc import Callable, Sequence
from functools import reduce

from hnn_vi_ros.models.checkpoint import Checkpoint
from hnn_vi_ros.models.graphs.graph import Builder, GraphNetwork
from hnn_vi_ros.models.mechanical_card import is_periodic
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


def mass_and_potential(b: Builder, checkpoint: Checkpoint, q: int) -> tuple[int, int]:
    """
    Return M(q), shape (d, d), and V(q), shape (1,), of the networks of a mechanism.

    Of an ensemble they are means. Networks beside a prior that stands alone add nothing.
    """
    members = checkpoint.members or (checkpoint,)
    masses, potentials = zip(*(
        _mass_and_potential(b, member, q) for member in members), strict=True)
    return _mean(b, masses), _mean(b, potentials)


def _mean(b: Builder, parts: Sequence[int]) -> int:
    total = reduce(b.add, parts)
    return b.mul(total, b.full(total, 1.0 / len(parts)))


def _mass_and_potential(b: Builder, checkpoint: Checkpoint, q: int) -> tuple[int, int]:
    """Return M(q) = S (L L^T + floor) S and V(q)."""
    card = checkpoint.card.mechanical
    assert card is not None, 'checked with the card: the family has one'
    (d,) = b.shape(q)
    if card.prior is not None and card.prior.alone:
        return b.constant(np.zeros((d, d))), b.constant(np.zeros(1))
    entries = _of_features(b, checkpoint, 'mass', q, card.mass_features)
    rows, columns = np.array(card.entries).T
    diagonal, below = np.flatnonzero(rows == columns), np.flatnonzero(rows != columns)
    parts = [b.unary('softplus', b.take(entries, diagonal))]
    if below.size:
        parts.append(b.take(entries, below))
    root = b.put(b.concatenate(parts), (rows * d + columns)[[*diagonal, *below]], (d, d))
    scale = np.array(card.mass_scale)
    mass = b.add(b.mul(b.matmul(root, root, False, True), b.constant(np.outer(scale, scale))),
                 b.constant(np.diag(card.floor * scale**2)))
    return mass, _of_features(b, checkpoint, 'potential', q, card.features)


def _of_features(b: Builder, checkpoint: Checkpoint, name: str, q: int,
                 rows: Sequence[Sequence[float]]) -> int:
    """Return a network of y = F q, given the rows of F, with sine and cosine of periodic ones."""
    card = checkpoint.card.mechanical
    assert card is not None, 'checked with the card: the family has one'
    if not rows:
        return _network(b, checkpoint, name, b.constant(np.zeros(1)))
    y = b.reshape(b.matmul(b.constant(np.array(rows)), b.reshape(q, (len(card.kinds), 1))),
                  (len(rows),))
    periodic = np.array([is_periodic(card.kinds, row) for row in rows])
    plain, waves = np.flatnonzero(~periodic), np.flatnonzero(periodic)
    parts = [b.take(y, plain)] if plain.size else []
    if waves.size:
        parts += [b.unary(op, b.take(y, waves)) for op in ('sin', 'cos')]
    # In the file inputs are in the order of rows, each cosine next to its sine.
    first = np.cumsum(1 + periodic) - 1 - periodic
    order = np.concatenate([first[plain], first[waves], first[waves] + 1])
    return _network(b, checkpoint, name, b.concatenate(parts), np.argsort(order).tolist())


def _control_affine(b: Builder, checkpoint: Checkpoint, q: int, p: int) -> int:
    """Return |A(q)^T p|^2 / 2 + V(q), with the entries of a lower triangular A by rows."""
    (d,) = b.shape(p)
    entries = _network(b, checkpoint, 'mass_inverse', q)
    root = b.put(entries, np.ravel_multi_index(np.tril_indices(d), (d, d)), (d, d))
    w = b.matmul(b.reshape(p, (1, d)), root)
    kinetic = b.sum(b.mul(b.mul(w, w), b.full(w, 0.5)), (0,))
    return b.add(b.reshape(b.sum(kinetic, (0,)), (1,)), _network(b, checkpoint, 'potential', q))


def _network(b: Builder, checkpoint: Checkpoint, name: str, x: int,
             places: Sequence[int] = ()) -> int:
    """Return a network of x, or of the values of x at places, one for each input."""
    layers = checkpoint.networks[name]
    if len(places):
        layers = layers.widened(len(places), places)
    b.networks.append(GraphNetwork(layers, checkpoint.card.activation))
    return b.perceptron(len(b.networks) - 1, x)


_GRAPHS: dict[str, Callable[[Builder, Checkpoint, int, int], int]] = {
    'control_affine': _control_affine}
