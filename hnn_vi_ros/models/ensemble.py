# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The mean of several learned Hamiltonians, and single members."""

from typing import Any, NamedTuple, Self

from hnn_vi_ros.kernels import (
    by_address, energy as member_energy, gradient as member_gradient,
    hessian_vector as member_hessian_vector, Kernel, Target)
from hnn_vi_ros.models.checkpoint import Checkpoint
from hnn_vi_ros.models.families import FAMILIES
from hnn_vi_ros.models.learned import LearnedHamiltonian
import numpy as np


class MeanParameters(NamedTuple):
    """
    Parameters of the functions of a mean, their first argument.

    Parameters
    ----------
    first : Target
        Parameters of the first member, by address; they are compiled before the first step.
    others : tuple of Target
        Parameters of the other members, which have the same type and call the same code.
    part_q, part_p : np.ndarray, shape (d,)
        Workspace for the gradient of one member.

    """

    first: Target
    others: tuple[Target, ...]
    part_q: np.ndarray
    part_p: np.ndarray


class EnsembleHamiltonian(LearnedHamiltonian):
    """
    H = (H_1 + ... + H_N) / N of members with the same momenta, trained independently.

    It is a Hamiltonian, so a symplectic method nearly conserves its modified energy. A gradient
    costs N gradients of a member.

    Parameters
    ----------
    checkpoint : Checkpoint
        An ensemble.

    Attributes
    ----------
    members : tuple of LearnedHamiltonian
        The networks, each as a Hamiltonian.

    References
    ----------
    B. Lakshminarayanan, A. Pritzel, C. Blundell, Simple and Scalable Predictive Uncertainty
    Estimation using Deep Ensembles, NeurIPS 2017.

    """

    def __init__(self, checkpoint: Checkpoint):
        super().__init__(checkpoint)
        family = FAMILIES[checkpoint.card.family].hamiltonian
        self.members: tuple[Any, ...] = tuple(family(member) for member in checkpoint.members)
        self.separable = all(member.separable for member in self.members)

    def copy(self) -> Self:
        """Return the same function with its own workspace."""
        other = super().copy()
        other.members = tuple(member.copy() for member in self.members)
        return other

    def _kernel(self) -> Kernel:
        first, *others = (Target(*by_address(member.kernel).parameters) for member in self.members)
        return self._kernel_of(_energy, _gradient, _hessian_vector, MeanParameters(
            first, tuple(others), *np.zeros((2, self.dimension))))


def load_member(checkpoint: Checkpoint, member: int | None) -> LearnedHamiltonian:
    """
    Return the Hamiltonian of a model; of an ensemble the mean, or a member from 1 to N.

    Raises
    ------
    ModelError
        The member does not exist.

    """
    checkpoint = checkpoint.member(member)
    family = FAMILIES[checkpoint.card.family]
    kind = family.mean if checkpoint.members else family.hamiltonian
    return kind(checkpoint)


def _energy(parameters: MeanParameters, q: np.ndarray, p: np.ndarray) -> float:
    total = member_energy(parameters.first, q, p)
    for other in parameters.others:
        total += member_energy(other, q, p)
    return total / (1 + len(parameters.others))


def _gradient(parameters: MeanParameters, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
              dH_dp: np.ndarray) -> None:
    part_q, part_p = parameters.part_q, parameters.part_p
    d, share = part_q.size, 1.0 / (1 + len(parameters.others))
    member_gradient(parameters.first, q, p, dH_dq, dH_dp)
    for other in parameters.others:
        for a in range(0, q.size, d):
            member_gradient(other, q[a:a + d], p[a:a + d], part_q, part_p)
            for i in range(d):
                dH_dq[a + i] += part_q[i]
                dH_dp[a + i] += part_p[i]
    for i in range(q.size):
        dH_dq[i] *= share
        dH_dp[i] *= share


def _hessian_vector(parameters: MeanParameters, q: np.ndarray, p: np.ndarray, v_q: np.ndarray,
                    v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
    part_q, part_p = parameters.part_q, parameters.part_p
    d, share = part_q.size, 1.0 / (1 + len(parameters.others))
    member_hessian_vector(parameters.first, q, p, v_q, v_p, product_q, product_p)
    for other in parameters.others:
        for a in range(0, q.size, d):
            b = a + d
            member_hessian_vector(other, q[a:b], p[a:b], v_q[a:b], v_p[a:b], part_q, part_p)
            for i in range(d):
                product_q[a + i] += part_q[i]
                product_p[a + i] += part_p[i]
    for i in range(q.size):
        product_q[i] *= share
        product_p[i] *= share
