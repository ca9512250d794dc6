# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Graphs of the families whose model files hold networks without a graph."""

from collections.abc import Callable, Mapping, Sequence

from hnn_vi_ros.models.attitude_features import group_of, widened
from hnn_vi_ros.models.checkpoint import Checkpoint
from hnn_vi_ros.models.graphs.graph import Builder, GraphNetwork
from hnn_vi_ros.models.mechanical_card import is_periodic, MechanicalCard
from hnn_vi_ros.models.networks.layers import Layers
import numpy as np
from scipy.linalg import block_diag

# Small networks of the same inputs run as one, whose weights between networks are zeros. Measured:
# with more weights than these a network takes longer than the call that is saved.
_STACKED = 1000


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
    (d,), card, members = b.shape(q), _card(checkpoint), checkpoint.members or (checkpoint,)
    own = [one for one in members if (prior := _card(one).prior) is None or not prior.alone]
    if not own:
        zero = b.constant(np.zeros((d, d)))
        return zero, zero, b.constant(np.zeros(1))
    x, places = _features(b, card, q, card.features + card.mass_features)
    scales = np.array([[_card(one).mass_scale] for one in own]) / np.sqrt(len(members))
    root = b.reshape(_scaled_root(b, _of_features(
        b, own, 'mass', card.mass_features, x, places), card.entries, scales), (len(own) * d, d))
    floor = sum(_card(one).floor * scale[0]**2 for one, scale in zip(own, scales, strict=True))
    total = b.reshape(b.sum(_of_features(
        b, own, 'potential', card.features, x, places), (0,)), (1,))
    return (root, b.add(b.matmul(root, root, True), b.constant(np.diag(floor))),
            b.mul(total, b.full(total, 1.0 / len(members))))


def _scaled_root(b: Builder, y: int, entries: Sequence[tuple[int, int]], scales: np.ndarray,
                 positive: bool = True) -> int:
    """Return each L^T S, whose L has the entries y, or log(1 + exp(y)) on its diagonal."""
    (rows, columns), (m, _, d) = np.array(entries).T, scales.shape
    index = np.add.outer(d * d * np.arange(m), columns * d + rows).ravel()
    y = b.put(y, index, (m, d, d))
    if not positive:
        return b.mul(y, b.constant(scales * np.ones((d, d))))
    # Cheaper than to separate the diagonal, whose entries are positive, from the others.
    return b.add(b.mul(y, b.constant(scales * np.triu(np.ones((d, d)), 1))),
                 b.mul(b.unary('softplus', y), b.constant(scales * np.eye(d))))


def body(b: Builder, checkpoint: Checkpoint, z: int) -> int:
    """
    Return pi . M(g)^-1 pi / 2 + V(g), or V(g, pi), of a rotating body with z = (x, R, pi).

    M^-1 = S (L L^T + floor) S, and the network ``mass`` gives the entries of L.
    """
    card = group_of(checkpoint)
    entries, potential = (add_network(b, widened(checkpoint, name), checkpoint.card.activation, z)
                          for name in ('mass', 'potential'))
    scale, k = np.array(card.mass_scale), card.size
    root = b.reshape(_scaled_root(b, entries, card.entries, scale.reshape(1, 1, k),
                                  card.diagonal == 'softplus'), (k, k))
    pi = b.take(z, np.arange(k + 6, 2 * k + 6))
    w = b.reshape(b.matmul(root, b.reshape(pi, (k, 1))), (k,))
    u = b.mul(b.mul(pi, pi), b.constant(0.5 * card.floor * scale**2))
    kinetic = b.sum(b.add(b.mul(b.mul(w, w), b.full(w, 0.5)), u), (0,))
    return b.add(b.reshape(kinetic, (1,)), potential)


def _card(checkpoint: Checkpoint) -> MechanicalCard:
    card = checkpoint.card.mechanical
    assert card is not None, 'checked with the card: the family has one'
    return card


def friction_entries(b: Builder, checkpoint: Checkpoint, q: int) -> int:
    """
    Return the entries of a lower triangular B, with D = B B^T, row by row.

    The outputs of an ensemble's members follow one another, divided by the root of their number.
    """
    card, members = _card(checkpoint), checkpoint.members or (checkpoint,)
    assert card.friction_features is not None, 'checked by the caller'
    x, places = _features(b, card, q, card.friction_features)
    entries = _of_features(b, members, 'friction', card.friction_features, x, places)
    return b.mul(entries, b.full(entries, 1.0 / np.sqrt(len(members))))


def _features(b: Builder, card: MechanicalCard, q: int, found: Sequence[Sequence[float]]
              ) -> tuple[int, dict[tuple[float, ...], list[int]]]:
    """Return the features y = F q, or their sines and cosines, and their places, by rows of F."""
    rows = [*dict.fromkeys(map(tuple, found))]
    if not rows:
        return q, {}
    y = b.reshape(b.matmul(b.constant(np.array(rows)), b.reshape(q, (len(card.kinds), 1))),
                  (len(rows),))
    periodic = np.array([is_periodic(card.kinds, row) for row in rows])
    plain, waves = np.flatnonzero(~periodic), np.flatnonzero(periodic)
    values = b.take(y, waves)
    places = {rows[k]: [place] for place, k in enumerate(plain)} | {
        rows[k]: [place, place + len(waves)] for place, k in enumerate(waves, len(plain))}
    return b.concatenate([
        b.take(y, plain), b.unary('sin', values), b.unary('cos', values)]), places


def _of_features(b: Builder, members: Sequence[Checkpoint], name: str,
                 rows: Sequence[Sequence[float]], x: int,
                 places: Mapping[tuple[float, ...], Sequence[int]]) -> int:
    """Return the outputs of a network of each member, of the features of these rows, or of 0."""
    networks = [one.networks[name] for one in members]
    if len(networks) * sum(weight.size for weight in networks[0].weights[1:]) <= _STACKED:
        first, *others = zip(*(layers.weights for layers in networks), strict=True)
        biases = zip(*(layers.biases for layers in networks), strict=True)
        networks = [Layers((np.vstack(first), *(block_diag(*layer) for layer in others)),
                           tuple(map(np.concatenate, biases)))]
    return b.concatenate([
        add_network(b, layers, members[0].card.activation, x if rows else b.constant(np.zeros(1)),
                 [place for row in rows for place in places[tuple(row)]]) for layers in networks])


def _control_affine(b: Builder, checkpoint: Checkpoint, q: int, p: int) -> int:
    """Return |A(q)^T p|^2 / 2 + V(q), with the entries of a lower triangular A by rows."""
    (d,) = b.shape(p)
    entries, potential = (network(b, checkpoint, name, q)
                          for name in ('mass_inverse', 'potential'))
    root = b.put(entries, np.ravel_multi_index(np.tril_indices(d), (d, d)), (d, d))
    w = b.matmul(b.reshape(p, (1, d)), root)
    kinetic = b.sum(b.mul(b.mul(w, w), b.full(w, 0.5)), (0,))
    return b.add(b.reshape(b.sum(kinetic, (0,)), (1,)), potential)


def network(b: Builder, checkpoint: Checkpoint, name: str, x: int) -> int:
    """Return a network of a model, of the values of x."""
    return add_network(b, checkpoint.networks[name], checkpoint.card.activation, x)


def add_network(b: Builder, layers: Layers, activation: str, x: int, places: Sequence[int] = ()
             ) -> int:
    """Return a network of x, or of the values of x at places."""
    if len(places):
        layers = layers.widened(b.shape(x)[0], places)
    b.networks.append(GraphNetwork(layers, activation))
    return b.perceptron(len(b.networks) - 1, x)


_GRAPHS: dict[str, Callable[[Builder, Checkpoint, int, int], int]] = {
    'control_affine': _control_affine}
