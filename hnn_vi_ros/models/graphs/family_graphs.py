# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Graphs of the families whose model files hold networks without a graph."""

from collections.abc import Callable, Mapping, Sequence

from hnn_vi_ros.models.checkpoint import Checkpoint
from hnn_vi_ros.models.graphs.graph import Builder, GraphNetwork
from hnn_vi_ros.models.mechanical_card import is_periodic, MechanicalCard
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


def mechanism(b: Builder, checkpoint: Checkpoint, q: int) -> tuple[int, int, int]:
    """
    Return R, M and V of the networks of a mechanism, of shapes (n, d), (d, d) and (1,).

    M(q) = S (L L^T + floor) S is R^T R, with R = L^T S, and a constant. Of an ensemble, M and V
    are means, and R has the rows of all members. Where a prior stands alone, networks add nothing.
    """
    (d,), members = b.shape(q), checkpoint.members or (checkpoint,)
    x, places = _features(b, checkpoint, q)
    entries, potentials, scales, floors = [], [], list[np.ndarray](), np.zeros((d, d))
    for member in members:
        card = _card(member)
        if card.prior is None or not card.prior.alone:
            entries.append(_of_features(b, member, 'mass', card.mass_features, x, places))
            potentials.append(_of_features(b, member, 'potential', card.features, x, places))
            scales.append(np.tile(card.mass_scale, (d, 1)))
            floors += np.diag(card.floor * np.square(card.mass_scale)) / len(members)
    if not entries:
        zero = b.constant(np.zeros((d, d)))
        return zero, zero, b.constant(np.zeros(1))
    rows, columns = np.array(_card(checkpoint).entries).T
    index = np.add.outer(d * d * np.arange(len(entries)), columns * d + rows).ravel()
    y = b.put(b.concatenate(entries), index, (len(entries), d, d))
    scale = np.array(scales) / np.sqrt(len(members))
    # Cheaper than to separate the diagonal, whose entries are positive, from the others.
    root = b.reshape(b.add(
        b.mul(y, b.constant(np.triu(scale, 1))),
        b.mul(b.unary('softplus', y), b.constant(scale * np.eye(d)))), (len(entries) * d, d))
    total = b.reshape(b.sum(b.concatenate(potentials), (0,)), (1,))
    return (root, b.add(b.matmul(root, root, True), b.constant(floors)),
            b.mul(total, b.full(total, 1.0 / len(members))))


def _card(checkpoint: Checkpoint) -> MechanicalCard:
    card = checkpoint.card.mechanical
    assert card is not None, 'checked with the card: the family has one'
    return card


def _features(b: Builder, checkpoint: Checkpoint, q: int
              ) -> tuple[int, dict[tuple[float, ...], list[int]]]:
    """Return the features y = F q of M and V, or their sines and cosines, and their places."""
    card = _card(checkpoint)
    rows = [*dict.fromkeys(map(tuple, card.features + card.mass_features))]
    y = b.reshape(b.matmul(b.constant(np.array(rows)), b.reshape(q, (len(card.kinds), 1))),
                  (len(rows),))
    periodic = np.array([is_periodic(card.kinds, row) for row in rows])
    plain, waves = np.flatnonzero(~periodic), np.flatnonzero(periodic)
    values = b.take(y, waves)
    places = {rows[k]: [place] for place, k in enumerate(plain)} | {
        rows[k]: [place, place + len(waves)] for place, k in enumerate(waves, len(plain))}
    return b.concatenate([
        b.take(y, plain), b.unary('sin', values), b.unary('cos', values)]), places


def _of_features(b: Builder, checkpoint: Checkpoint, name: str, rows: Sequence[Sequence[float]],
                 x: int, places: Mapping[tuple[float, ...], Sequence[int]]) -> int:
    """Return a network of the features of these rows; without rows, of 0."""
    return _network(b, checkpoint, name, x, [
        place for row in rows for place in places[tuple(row)]]) if rows else \
        _network(b, checkpoint, name, b.constant(np.zeros(1)))


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
    """Return a network of x, or of the values of x at places."""
    layers = checkpoint.networks[name]
    if len(places):
        layers = layers.widened(b.shape(x)[0], places)
    b.networks.append(GraphNetwork(layers, checkpoint.card.activation))
    return b.perceptron(len(b.networks) - 1, x)


_GRAPHS: dict[str, Callable[[Builder, Checkpoint, int, int], int]] = {
    'control_affine': _control_affine}
