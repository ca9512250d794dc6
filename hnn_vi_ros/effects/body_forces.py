# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Learned forces on a rotating body: forces of inputs, and dissipation."""

from collections.abc import Sequence
from typing import NamedTuple

from hnn_vi_ros.kernels import inlined, kept, name_stably
from hnn_vi_ros.models import (
    Checkpoint, fill_outputs, GraphParameters, group_of, pack_network, see_attitude, widened)
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class BodyNetwork(NamedTuple):
    """
    A network of the pose whose outputs are the entries of a matrix, and its workspace.

    Parameters
    ----------
    graph : GraphParameters
        The network.
    entries : np.ndarray
        Outputs of the network.
    features : np.ndarray
        (x, R, pi), or (x, R, v) with velocities instead of momenta.
    product, force : np.ndarray, shape (k,)
        A product, and the force in the frame of the body.

    """

    graph: GraphParameters
    entries: np.ndarray
    features: np.ndarray
    product: np.ndarray
    force: np.ndarray


def body_network(model: Checkpoint, name: str, coordinates: Sequence[Coordinate]) -> BodyNetwork:
    """Return a network of a model, or raise ValueError if H is of another kind."""
    card = group_of(model)
    if [coordinate.kind for coordinate in coordinates] != [card.kind]:
        raise ValueError(f'the model has one coordinate, a {card.kind}; H has '
                         f'{", ".join(coordinate.kind for coordinate in coordinates)}')
    return BodyNetwork(
        pack_network(widened(model, name), model.card.activation),
        np.zeros(model.card.layout[name][-1]), np.zeros(2 * card.size + 6),
        *np.zeros((2, card.size)))


@kept(error_model='numpy')
def add_body_map(own: BodyNetwork, command: np.ndarray, q: np.ndarray, p: np.ndarray,
                 f_p: np.ndarray) -> None:
    """Add B(g) u in the frame of the body, where u is the first part of the command."""
    _evaluate(own, q, p)
    m = own.entries.size // own.force.size
    for i in range(own.force.size):
        own.force[i] = 0.0
        for k in range(m):
            own.force[i] += own.entries[i * m + k] * command[k]
    _add(own, f_p)


@kept(error_model='numpy')
def add_body_drag(own: BodyNetwork, q: np.ndarray, velocity: np.ndarray, f_p: np.ndarray) -> None:
    """Add -A A^T v in the frame of the body; A has lower triangular blocks, stored row by row."""
    force = own.force
    _evaluate(own, q, velocity)
    force[:] = 0.0
    add_drag(own.entries, 3, own.features[own.features.size - force.size:], own.product, force)
    _add(own, f_p)


@inlined
def add_drag(entries: np.ndarray, block: int, velocity: np.ndarray, product: np.ndarray,
             force: np.ndarray) -> None:
    """Add -A A^T v, where A consists of lower triangular blocks, stored row by row."""
    product[:] = 0.0
    k = 0
    for i in range(velocity.size):
        for j in range(i - i % block, i + 1):
            product[j] += entries[k] * velocity[i]
            k += 1
    k = 0
    for i in range(velocity.size):
        for j in range(i - i % block, i + 1):
            force[i] -= entries[k] * product[j]
            k += 1


@kept(error_model='numpy')
def _evaluate(own: BodyNetwork, q: np.ndarray, p: np.ndarray) -> None:
    see_attitude(q, p, own.features)
    fill_outputs(own.graph, own.features, own.entries)


@kept(error_model='numpy')
def _add(own: BodyNetwork, f_p: np.ndarray) -> None:
    """Add the force, with the part that acts on the position rotated into space."""
    for i in range(own.force.size):
        if i < own.force.size - 3:
            for j in range(3):
                f_p[i] += own.features[3 + 3 * i + j] * own.force[j]
        else:
            f_p[i] += own.force[i]


for _function in (add_body_map, add_body_drag):
    # Functions in the parameters of compiled functions need a name; see identify.
    name_stably(_function)
