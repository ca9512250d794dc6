# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The same tanh network for JAX, and random ones to measure."""

from collections.abc import Callable
from itertools import pairwise

from hnn_vi_ros.models.checkpoint import Checkpoint, Layers
from hnn_vi_ros.models.model_card import Box, CoordinateCard, ModelCard
from hnn_vi_ros.models.neural import NeuralHamiltonian
import jax
import numpy as np
from studies.peers import jax_energy

jax.config.update('jax_enable_x64', True)


def random_network(widths: list[int], seed: int) -> Checkpoint:
    """Return a network of these widths with random weights of the usual size."""
    rng = np.random.default_rng(seed)
    d = widths[0] // 2
    pairs = list(pairwise(widths))
    card = ModelCard(
        name='random', widths=widths, dataset='none', seed=seed, losses={}, training_command='',
        package_version='0', box=Box(q=[[-1.0, 1.0]] * d, p=[[-1.0, 1.0]] * d),
        coordinates=[CoordinateCard(name=f'x{i}') for i in range(d)])
    return Checkpoint(card, {'energy': Layers(
        tuple(rng.normal(size=(n_out, n_in)) / np.sqrt(n_in) for n_in, n_out in pairs),
        tuple(0.1 * rng.normal(size=n_out) for _, n_out in pairs))})


def jax_gradient(checkpoint: Checkpoint) -> Callable[[jax.Array], jax.Array]:
    """Return (H_q, H_p), shape (2 d,), as a JAX function of (q, p), shape (2 d,)."""
    return jax.grad(jax_energy(NeuralHamiltonian(checkpoint)))
