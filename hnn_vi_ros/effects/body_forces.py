# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Forces that a model of a body that turns has learned, of its inputs and of dissipation."""

from collections.abc import Sequence
from typing import NamedTuple

from hnn_vi_ros.kernels.compilation import identify, kept
from hnn_vi_ros.models.attitude_features import group_of, see, widened
from hnn_vi_ros.models.checkpoint import Checkpoint
from hnn_vi_ros.models.outputs import evaluate_outputs, pack_layers, PackedOutputs
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class BodyNetwork(NamedTuple):
    """
    A network that makes a force, and space.

    Parameters
    ----------
    outputs : PackedOutputs
        Of the pose.
    entries : np.ndarray
        Space for its outputs.
    seen : np.ndarray
        Space for (x, R, pi), or with velocities in place of momenta.
    product, force : np.ndarray, shape (k,)
        Space for a product, and for the force in the frame of the body.

    """

    outputs: PackedOutputs
    entries: np.ndarray
    seen: np.ndarray
    product: np.ndarray
    force: np.ndarray


def body_network(model: Checkpoint, name: str, coordinates: Sequence[Coordinate]) -> BodyNetwork:
    """Return a network of a model for the functions here; ValueError for another kind of H."""
    card = group_of(model)
    if [coordinate.kind for coordinate in coordinates] != [card.kind]:
        raise ValueError(f'the model is of one {card.kind}; H has '
                         f'{", ".join(coordinate.kind for coordinate in coordinates)}')
    return BodyNetwork(
        pack_layers(widened(model, name), model.card.activation),
        np.zeros(model.card.layout[name][-1]), np.zeros(2 * card.size + 6),
        *np.zeros((2, card.size)))


@kept(error_model='numpy')
def add_body_map(own: BodyNetwork, command: np.ndarray, q: np.ndarray, p: np.ndarray,
                 f_p: np.ndarray) -> None:
    """Add B(g) u in the frame of the body, with u the first numbers of the command."""
    _evaluate(own, q, p)
    m = own.entries.size // own.force.size
    for i in range(own.force.size):
        own.force[i] = 0.0
        for k in range(m):
            own.force[i] += own.entries[i * m + k] * command[k]
    _add(own, f_p)


@kept(error_model='numpy')
def add_body_drag(own: BodyNetwork, q: np.ndarray, velocity: np.ndarray, f_p: np.ndarray) -> None:
    """Add -A A^T v in the frame of the body, with blocks of the lower triangular A row by row."""
    entries, product, force = own.entries, own.product, own.force
    _evaluate(own, q, velocity)
    first = own.seen.size - force.size
    product[:] = 0.0
    force[:] = 0.0
    k = 0
    for i in range(force.size):
        for j in range(i - i % 3, i + 1):
            product[j] += entries[k] * own.seen[first + i]
            k += 1
    k = 0
    for i in range(force.size):
        for j in range(i - i % 3, i + 1):
            force[i] -= entries[k] * product[j]
            k += 1
    _add(own, f_p)


@kept(error_model='numpy')
def _evaluate(own: BodyNetwork, q: np.ndarray, p: np.ndarray) -> None:
    see(q, p, own.seen)
    half = own.seen.size // 2
    evaluate_outputs(own.outputs, own.seen[:half], own.seen[half:], own.entries)


@kept(error_model='numpy')
def _add(own: BodyNetwork, f_p: np.ndarray) -> None:
    """Add the force, that on the place turned to space."""
    for i in range(own.force.size):
        if i < own.force.size - 3:
            for j in range(3):
                f_p[i] += own.seen[3 + 3 * i + j] * own.force[j]
        else:
            f_p[i] += own.force[i]


for _function in (add_body_map, add_body_drag):
    # They are among the parameters of compiled functions; see identify.
    identify(_function)
