# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Small ensembles, which are not trained, for tests."""

from dataclasses import replace

from helpers import random_checkpoint
from hnn_vi_ros.models.checkpoint import Checkpoint, Layers
from hnn_vi_ros.models.model_card import EnsembleCard
import numpy as np


def ensemble(count: int, factor: float | None = 2.0, change: float = 0.05) -> Checkpoint:
    """Return members that are changes of one random network of one coordinate."""
    base = random_checkpoint([2, 6, 1], 3)
    members = []
    for k in range(count):
        rng = np.random.default_rng([7, k])
        members.append(replace(base, networks={'energy': Layers(tuple(
            weight * (1.0 + change * rng.normal(size=weight.shape)) for weight in base.weights),
            base.biases)}))
    card = base.card.model_copy(update={'ensemble': EnsembleCard(
        members=[member.card for member in members], factor=factor)})
    return Checkpoint(card, {}, members=tuple(members))
