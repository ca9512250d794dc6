# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Small untrained ensembles for tests."""

from collections.abc import Sequence
from dataclasses import replace

from helpers import random_checkpoint
from hnn_vi_ros.models import Checkpoint, EnsembleCard, FrictionCard, Layers, mean_card
from mechanical_models import random_mechanical
import numpy as np

# Training configuration with a few states; the size of a network is appended.
OSCILLATOR = """\
coordinates: [{name: x}]
data:
  kind: exact
  hamiltonian: {kind: harmonic_oscillator}
  box: {q: [[-1.0, 1.0]], p: [[-1.0, 1.0]]}
  samples: 60
"""


def ensemble(count: int, factor: float | None = 2.0, change: float = 0.05) -> Checkpoint:
    """Return members that are perturbations of one random network of one coordinate."""
    base = random_checkpoint([2, 6, 1], 3)
    members = []
    for k in range(count):
        rng = np.random.default_rng([7, k])
        weights, biases = base.networks['energy']
        members.append(replace(base, networks={'energy': Layers(tuple(
            weight * (1.0 + change * rng.normal(size=weight.shape)) for weight in weights),
            biases)}))
    card = base.card.model_copy(update={'ensemble': EnsembleCard(
        members=[member.card for member in members],
        factors=None if factor is None else [factor] * 2)})
    return Checkpoint(card, {}, members=tuple(members))


def mechanisms(shape: str, count: int, factor: float | None = 2.0, change: float = 0.05,
               **changes) -> Checkpoint:
    """Return members that are perturbations of one random mechanism in all its numbers."""
    base = random_mechanical(shape, **changes)
    return together([scaled(replace(base, networks={
        name: Layers(tuple(weight * (1.0 + change * rng.normal(size=weight.shape))
                           for weight in layers.weights), layers.biases)
        for name, layers in base.networks.items()}), 1.0 + change * rng.uniform(-1.0, 1.0))
        for rng in map(np.random.default_rng, range(count))], factor)


def together(members: Sequence[Checkpoint], factor: float | None = 2.0) -> Checkpoint:
    """Return mechanisms as one ensemble model."""
    cards = [member.card for member in members]
    card = cards[0].model_copy(update={
        'ensemble': EnsembleCard(members=cards, factors=None if factor is None else [
            factor] * (2 * len(cards[0].coordinates))),
        'mechanical': mean_card([card.mechanical for card in cards])})
    return Checkpoint(card, {}, members=tuple(members))


def scaled(model: Checkpoint, s: float) -> Checkpoint:
    """Return a mechanism whose M, V, friction and input map are scaled by s."""
    card, root = model.card.mechanical, float(np.sqrt(s))

    def forces(terms: list) -> list:
        return [term.model_copy(update={'force': [s * force for force in term.force]})
                for term in terms]
    friction = FrictionCard(viscous=[s * b for b in card.friction.viscous],
                            coulomb=forces(card.friction.coulomb),
                            stribeck=forces(card.friction.stribeck))
    mechanical = card.model_copy(update={
        'friction': friction, 'mass_scale': [root * scale for scale in card.mass_scale],
        'input_map': card.input_map and [[s * x for x in row] for row in card.input_map]})
    # M is scaled with its scale, D = B B^T with that of B.
    networks = dict(model.networks)
    for name, share in (('potential', s), ('friction', root)):
        if name in networks:
            weights, biases = networks[name]
            networks[name] = Layers((*weights[:-1], share * weights[-1]),
                                    (*biases[:-1], share * biases[-1]))
    return Checkpoint(model.card.model_copy(update={'mechanical': mechanical}), networks)
