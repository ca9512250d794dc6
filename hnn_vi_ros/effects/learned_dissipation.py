# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Learned dissipation."""

from collections.abc import Sequence
from typing import NamedTuple

from hnn_vi_ros.effects.base import EffectState, Force, Place
from hnn_vi_ros.effects.masses import vector_potential
from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.kernels import inlined, Kernel
from hnn_vi_ros.models import FAMILIES, load_checkpoint
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class Dissipation(NamedTuple):
    """The kernel of D, EffectState.gauge, and workspace for P and D', shape (d,)."""

    network: Kernel
    gauge: np.ndarray
    kinetic: np.ndarray
    dD_dq: np.ndarray
    dD_dp: np.ndarray


class LearnedDissipation(Force):
    """
    Gradient of a network D(q, p), as in the dissipative HNN.

        q' = H_p + D_q,  p' = -H_q + D_p

    D is a model with the coordinates of H, or the second network of a dissipative HNN, whose first
    network is H. In a magnetic field both are functions of P = p - c A(q), because they were
    trained without it. For joints use `learned_friction`. Energy account: the power
    H_q . D_q + H_p . D_p.

    Parameters
    ----------
    model : str
        A shipped model, one trained into models/ of the working directory, or the path of a
        .safetensors file.

    Raises
    ------
    ModelError
        The model does not exist, is damaged, or holds no such network.

    References
    ----------
    A. Sosanya, S. Greydanus, Dissipative Hamiltonian Neural Networks: Learning Dissipative and
    Conservative Dynamics Separately, 2022, arXiv:2201.10085.

    """

    depends_on_momentum = True
    excludes = {Place.MANIFOLD: 'because its forces would do work where the velocity is not H_p'}

    def __init__(self, model: str):
        checkpoint = load_checkpoint(model)
        family = checkpoint.card.family
        networks = {name: row.dissipation for name, row in FAMILIES.items() if row.dissipation}
        if family not in networks:
            raise ModelError(f'{model}: a model of the family {family} has no network D; use '
                             f'one of the family {" or ".join(networks)}')
        # Imported lazily: reading a scene needs no compiler.
        from hnn_vi_ros.models import NeuralHamiltonian
        self.network = NeuralHamiltonian(checkpoint, networks[family])

    @property
    def rounding(self) -> tuple[float, float]:
        """Return the rounding errors of D_q and D_p."""
        return self.network.kernel.gradient_scale

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> Dissipation:
        """Return the network's kernel, the gauge of magnetic fields, and working memory."""
        if len(coordinates) != (d := self.network.dimension):
            raise ValueError(f'the model has {d} coordinates, H has {len(coordinates)}')
        from hnn_vi_ros.kernels import name_stably
        kernel = self.network.copy().kernel
        for function in (kernel.energy, kernel.gradient, kernel.hessian_vector):
            name_stably(function)
        return Dissipation(kernel, state.gauge, *np.zeros((3, d)))

    @staticmethod
    @inlined
    def add_force(parameters: Dissipation, t: float, q: np.ndarray, p: np.ndarray,
                  velocity: np.ndarray, f_q: np.ndarray, f_p: np.ndarray) -> None:
        """Add D_q and D_p."""
        network, gauge, kinetic, dD_dq, dD_dp = parameters
        for i in range(q.size):
            kinetic[i] = p[i] - vector_potential(gauge, q, i)
        network.gradient(network.parameters, q, kinetic, dD_dq, dD_dp)
        for i in range(q.size):
            f_q[i] += dD_dq[i]
            f_p[i] += dD_dp[i]
            # D_q adds to the velocity, and p = P + c A(q) changes with q.
            for j in range(q.size):
                f_p[i] += gauge[j, i] * dD_dq[j]
