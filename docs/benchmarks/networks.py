# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The same tanh network for JAX."""

from collections.abc import Callable

from hnn_vi_ros.models.checkpoint import Checkpoint
from hnn_vi_ros.models.neural import NeuralHamiltonian
import jax
from studies.peers import jax_energy

jax.config.update('jax_enable_x64', True)


def jax_gradient(checkpoint: Checkpoint) -> Callable[[jax.Array], jax.Array]:
    """Return (H_q, H_p), shape (2 d,), as a JAX function of (q, p), shape (2 d,)."""
    return jax.grad(jax_energy(NeuralHamiltonian(checkpoint)))
