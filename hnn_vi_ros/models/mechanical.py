# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A learned Hamiltonian of a mechanism: a mass matrix and a potential that are networks of q."""

from hnn_vi_ros.hamiltonians.rigid_body.tree_kernel import tree_kernel
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.models.features import even_layers, pack_features
from hnn_vi_ros.models.learned import LearnedHamiltonian
from hnn_vi_ros.models.mechanical_card import MechanicalCard
from hnn_vi_ros.models.mechanical_kernel import (
    energy, gradient, hessian_vector, MassNetwork, MechanicalParameters, MechanicalWork,
    PotentialNetwork)
from hnn_vi_ros.models.outputs import pack_layers
from hnn_vi_ros.models.priors import prior_of
from hnn_vi_ros.networks.perceptron_memory import pack
import numpy as np


class MechanicalHamiltonian(LearnedHamiltonian):
    """
    H(q, p) = p . M(q)^-1 p / 2 + V(q), with M = S (L L^T + floor) S.

    The network ``mass`` gives the entries y of the lower triangular L, with log(1 + exp(y)) on its
    diagonal, and ``potential`` gives V; the card holds their inputs from q, S and the floor.
    p = M(q) v is the model's own momentum. With u = S v and w = L^T u,

        H_p = v = M^-1 p,    H_q = V' - sum_ij u_i w_j L_ij',

    since v . M v = |w|^2 + floor |u|^2: one forward and one backward pass through each network.
    Its friction is the effect learned_friction. A prior of the card, rigid links or an exact
    system, adds its M and V of fitted parameters, and the networks are what it lacks.

    Parameters
    ----------
    checkpoint : Checkpoint
        Of the family mechanical.

    References
    ----------
    M. Lutter, C. Ritter, J. Peters, Deep Lagrangian Networks: Using Physics as Model Prior for
    Deep Learning, ICLR 2019 (M = L L^T, with a diagonal that is positive).

    """

    @property
    def _mechanical(self) -> MechanicalCard:
        card = self.checkpoint.card.mechanical
        assert card is not None, 'checked with the card: the family has one'
        return card

    def _kernel(self) -> Kernel:
        prior = self._mechanical.prior
        if prior is not None and prior.alone:
            return tree_kernel(prior.bodies)
        return self._kernel_of(energy, gradient, hessian_vector, self.parameters())

    def parameters(self) -> MechanicalParameters:
        """Return what the compiled functions take first, with working memory of its own."""
        card, mechanical, networks = (
            self.checkpoint.card, self._mechanical, self.checkpoint.networks)
        mass = MassNetwork(
            pack_layers(even_layers(networks['mass']), card.activation),
            pack_features(mechanical, mechanical.mass_features), np.array(mechanical.entries),
            np.array(mechanical.mass_scale), mechanical.floor)
        potential = PotentialNetwork(
            pack(*even_layers(networks['potential']), card.activation),
            pack_features(mechanical, mechanical.features))
        return MechanicalParameters(
            mass, potential, prior_of(mechanical),
            MechanicalWork.empty(len(mechanical.entries), self.dimension))
