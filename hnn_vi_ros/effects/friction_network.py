# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Friction -D(q) v of a network B, with D = B(q) B(q)^T, which dissipates for any B."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from hnn_vi_ros.effects.base import EffectState
from hnn_vi_ros.effects.body_forces import add_body_drag, add_drag, body_network, BodyNetwork
from hnn_vi_ros.effects.input_map import InputMatrix, motors_of
from hnn_vi_ros.kernels import kept, name_stably
from hnn_vi_ros.models import Checkpoint, fill_outputs, GraphParameters, pack_friction
from hnn_vi_ros.phase_space import columns, Coordinate, rotations
import numpy as np


class FrictionNetwork(NamedTuple):
    """The network of B as a graph, and workspace for the entries of B and for B^T v."""

    graph: GraphParameters
    entries: np.ndarray
    product: np.ndarray


class FrictionInputs(NamedTuple):
    """Coefficients k, (d,), the input matrix of motors, and command and clock of EffectState."""

    share: np.ndarray
    motors: InputMatrix
    command: np.ndarray
    clock: np.ndarray


class LearnedFrictionParameters(NamedTuple):
    """
    Parameters of the compiled function of learned friction.

    Parameters
    ----------
    switch, offset : np.ndarray, shape (d,)
        Inverse speed of the transition from v < 0 to v > 0, and a constant force.
    viscous : np.ndarray, shape (2, d)
        b where v > 0 and where v < 0.
    coulomb : np.ndarray, shape (k, 3, d)
        c where v > 0, where v < 0, and 1/w of each term.
    stribeck : np.ndarray, shape (l, 3, d)
        c, 1/w and 1/s of each term.
    load : FrictionInputs
        Inputs of the friction that increases with the force of motors.
    add : callable
        The function that adds the friction of the network; see add_by_network.
    own : FrictionNetwork, BodyNetwork or tuple of int
        Its first argument; an unused number if there is no network.

    """

    switch: np.ndarray
    offset: np.ndarray
    viscous: np.ndarray
    coulomb: np.ndarray
    stribeck: np.ndarray
    load: FrictionInputs
    add: Callable[..., None]
    own: FrictionNetwork | BodyNetwork | tuple[int]


def friction_of(model: Checkpoint, coordinates: Sequence[Coordinate], state: EffectState
                ) -> LearnedFrictionParameters:
    """Return the friction of a model, or raise ValueError if its coordinates do not match."""
    d, card = len(columns(coordinates)[0]), model.card
    none = FrictionInputs(
        np.zeros(d), InputMatrix(np.zeros((d, 0)), np.zeros(0)), np.zeros(1), np.zeros(2))
    if card.mechanical is None:
        nothing = np.zeros((0, 3, d))
        return LearnedFrictionParameters(
            np.zeros(d), np.zeros(d), np.zeros((2, d)), nothing, nothing.copy(), none,
            add_body_drag, body_network(model, 'dissipation', coordinates))
    friction = card.mechanical.friction
    if len(friction.viscous) != d or rotations(coordinates):
        kinds = ' and '.join(sorted({coordinate.kind for coordinate in coordinates}))
        raise ValueError(f'the model has {len(friction.viscous)} scalar coordinates, H has '
                         f'{len(coordinates)} ({kinds})')
    coulomb: list[Any] = [
        (term.force, term.back or term.force, np.reciprocal(term.width))
        for term in friction.coulomb]
    stribeck: list[Any] = [
        (term.force, np.reciprocal(term.width), np.reciprocal(term.speed))
        for term in friction.stribeck]
    return LearnedFrictionParameters(
        np.zeros(d) if friction.switch is None else np.reciprocal(friction.switch),
        np.array(friction.offset or np.zeros(d)),
        np.array([friction.viscous, friction.viscous_back or friction.viscous]),
        np.reshape(coulomb, (-1, 3, d)), np.reshape(stribeck, (-1, 3, d)),
        none if friction.load is None else FrictionInputs(
            np.array(friction.load), motors_of(card.mechanical), state.command, state.clock),
        *network_of(model))


def network_of(model: Checkpoint) -> tuple[Callable[..., None], FrictionNetwork | tuple[int]]:
    """Return ``add`` and ``own`` of LearnedFrictionParameters."""
    card = model.card.mechanical
    assert card is not None, 'the effect has checked the family'
    if card.friction_features is None:
        return add_none, (0,)
    d = len(card.kinds)
    count = max(1, len(model.members)) * d * (d + 1) // 2
    return add_by_network, FrictionNetwork(pack_friction(model), np.zeros(count), np.zeros(d))


@kept(error_model='numpy')
def add_by_network(own: FrictionNetwork, q: np.ndarray, velocity: np.ndarray, f_p: np.ndarray
                   ) -> None:
    """Add -B (B^T v) for each lower triangular B."""
    entries, size = own.entries, q.size * (q.size + 1) // 2
    fill_outputs(own.graph, q, entries)
    for begin in range(0, entries.size, size):
        add_drag(entries[begin:begin + size], q.size, velocity, own.product, f_p)


@kept(error_model='numpy')
def add_none(own: tuple[int], q: np.ndarray, velocity: np.ndarray, f_p: np.ndarray) -> None:
    """Add nothing."""


for _function in (add_by_network, add_none):
    # Functions in the parameters of compiled functions need a name; see identify.
    name_stably(_function)
