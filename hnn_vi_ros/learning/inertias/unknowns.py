# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Unknowns of a robot that is identified: numbers, of which any are those of some robot."""

from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork
from hnn_vi_ros.learning.families.rigid_tree import RigidTree
from hnn_vi_ros.learning.inertias.rigid_body import inverse_softplus, LEAST
from hnn_vi_ros.models.rigid_body_card import INERTIAL
import numpy as np
import torch


class Unknowns:
    """
    Unknowns x = (log-Cholesky, rotors, offsets, viscous, Coulomb), of which some rest.

    Parameters
    ----------
    network : MechanicalNetwork
        With a RigidTree, and without networks.
    rotors, offsets : bool
        Whether those are identified as well.

    """

    def __init__(self, network: MechanicalNetwork, rotors: bool, offsets: bool):
        tree, structure, d = network.prior, network.structure, network.d
        assert isinstance(tree, RigidTree)
        self.network, self.tree, friction = network, tree, network.friction
        terms = structure.coulomb + structure.stribeck
        self.sizes = [INERTIAL * d, d, d, structure.viscous * d, terms * d]
        order = [body.coordinate for body in tree.tree.bodies]
        force = friction.force_unit.numpy()
        inertia = network.scales.inertia
        self.scale = np.concatenate([
            np.ones(self.sizes[0]), inertia[order], force[order],
            friction.viscous_unit.numpy()[:self.sizes[3]], np.tile(force, terms)])
        moves = np.repeat([True, rotors, offsets, True, True], self.sizes)
        self.free = np.flatnonzero(moves)
        self.least = np.concatenate([
            np.full(self.sizes[0], -np.inf), np.zeros(d), np.full(d, -np.inf),
            np.full(sum(self.sizes[3:]), LEAST)])
        self.start = np.concatenate([np.zeros(self.sizes[0]), tree.rotor.detach().numpy()
                                     / self.scale[self.sizes[0]:][:d], np.zeros(d),
                                     np.full(sum(self.sizes[3:]), 10.0 * LEAST)])

    def linear(self, x: torch.Tensor) -> torch.Tensor:
        """Return all that the forces are linear in, shape (k,), of x in units of ``scale``."""
        log, rotors, offsets, friction = self._parts(x)
        values = torch.cat([self.tree.inertial(log), rotors[:, None], offsets[:, None]], dim=1)
        return torch.cat([values.flatten(), friction])

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Return the derivatives of ``linear`` by x."""
        found: np.ndarray = torch.func.jacfwd(self.linear)(torch.tensor(x)).numpy()
        return found

    def _parts(self, x: torch.Tensor) -> tuple[torch.Tensor, ...]:
        log, rotors, offsets, *friction = (x * torch.tensor(self.scale)).split(self.sizes)
        return log.reshape(-1, INERTIAL), rotors, offsets, torch.cat(friction)

    def raw(self, x: torch.Tensor) -> dict[str, torch.Tensor]:
        """Return the parameters of the network, of x."""
        log, rotors, offsets, forces = self._parts(x)
        friction, d = self.network.friction, self.network.d
        viscous, coulomb = forces.split(self.sizes[3:])
        found = {'prior.raw': log, 'prior.rotor': rotors, 'prior.offset': offsets}
        if len(viscous):
            found['friction.raw_viscous'] = inverse_softplus(viscous / friction.viscous_unit)
        if len(coulomb):
            found['friction.raw_force'] = inverse_softplus(
                coulomb.reshape(-1, d) / friction.force_unit)
        return found

    def give(self, x: np.ndarray) -> None:
        """Give the network these."""
        with torch.no_grad():
            for name, parameter in self.raw(torch.tensor(x)).items():
                self.network.get_parameter(name).copy_(parameter)
