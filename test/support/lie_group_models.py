# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Random models of the family lie_group."""

from itertools import pairwise

from hnn_vi_ros.models import Box, Checkpoint, CoordinateCard, Layers, LieGroupCard, ModelCard
import numpy as np

# Inputs of their networks by name; together they cover every part of the kernel.
CARDS = {
    'rotation': {'kind': 'rotation', 'mass_depends_on': [],
                 'potential_depends_on': ['attitude'], 'dissipation_depends_on': [],
                 'input_map_depends_on': []},
    'pose': {'kind': 'pose', 'mass_depends_on': ['position', 'attitude'],
             'potential_depends_on': ['position', 'attitude'],
             'dissipation_depends_on': ['attitude'], 'input_map_depends_on': ['attitude']},
    'unstructured': {'kind': 'pose', 'mass_depends_on': [],
                     'potential_depends_on': ['position', 'attitude', 'momentum']},
}


def random_lie_group(name: str, inputs: int = 2, seed: int = 0) -> Checkpoint:
    """Return a model with random networks of the usual size, one of CARDS."""
    rng = np.random.default_rng(seed)
    size = 3 if CARDS[name]['kind'] == 'rotation' else 6
    card = LieGroupCard(**CARDS[name], mass_scale=rng.uniform(0.8, 1.2, size).tolist(), floor=0.3)
    networks = {}
    for network, ends in card.networks.items():
        widths = [ends.inputs, 9, 6, ends.outputs(1, inputs * size)]
        networks[network] = Layers(
            tuple(0.7 * rng.normal(size=(b, a)) / np.sqrt(a) for a, b in pairwise(widths)),
            tuple(0.3 * rng.normal(size=b) for b in widths[1:]))
    return Checkpoint(ModelCard(
        name='random', family='lie_group', lie_group=card, dataset='none', seed=seed, losses={},
        networks={key: [layers.weights[0].shape[1], *(bias.size for bias in layers.biases)]
                  for key, layers in networks.items()},
        training_command='', package_version='0', coordinates=[CoordinateCard(name='body')],
        box=Box(q=[[-1.0, 1.0]] * (size + 1), p=[[-1.0, 1.0]] * (size + 1))), networks)


def random_states(size: int, count: int, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Return q and p, shapes (count, size + 1) and (count, size), with unit quaternions."""
    rng = np.random.default_rng(seed)
    q, p = rng.normal(size=(count, size + 1)), rng.uniform(-1.0, 1.0, (count, size))
    q[:, -4:] /= np.linalg.norm(q[:, -4:], axis=1, keepdims=True)
    return q, p
