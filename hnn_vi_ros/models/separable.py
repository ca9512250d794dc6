# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A learned Hamiltonian with separate networks for kinetic and potential energy."""

from typing import NamedTuple

from hnn_vi_ros.kernels import Kernel
from hnn_vi_ros.models.learned import LearnedHamiltonian
from hnn_vi_ros.models.networks import perceptron
from hnn_vi_ros.models.networks.perceptron_memory import MAX_STATES, PackedPerceptron
import numpy as np


class SeparableParameters(NamedTuple):
    """The networks of T and of V, and an array of zeros, shape (m d,)."""

    kinetic: PackedPerceptron
    potential: PackedPerceptron
    zero: np.ndarray


class SeparableHamiltonian(LearnedHamiltonian):
    """
    H(q, p) = T(p) + V(q), with the networks ``kinetic`` and ``potential``.

    Parameters
    ----------
    checkpoint : Checkpoint
        A model of the family separable_hnn.

    References
    ----------
    Z. Chen, J. Zhang, M. Arjovsky, L. Bottou, Symplectic Recurrent Neural Networks, ICLR 2020.

    """

    separable = True

    def _kernel(self) -> Kernel:
        parameters = SeparableParameters(
            self._packed('kinetic', 'p'), self._packed('potential', 'q'),
            np.zeros(MAX_STATES * self.dimension))
        return self._kernel_of(_energy, _gradient, _hessian_vector, parameters)


def _energy(parameters: SeparableParameters, q: np.ndarray, p: np.ndarray) -> float:
    return (perceptron.energy(parameters.kinetic, q, p)
            + perceptron.energy(parameters.potential, q, p))


def _gradient(parameters: SeparableParameters, q: np.ndarray, p: np.ndarray,
              dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    kinetic, potential, space = parameters.kinetic, parameters.potential, parameters.zero
    for a in range(0, q.size, space.size):
        b = min(a + space.size, q.size)
        zero = space[:b - a]
        perceptron.part_gradient(kinetic, q[a:b], p[a:b], zero, dH_dp[a:b])
        perceptron.part_gradient(potential, q[a:b], p[a:b], dH_dq[a:b], zero)


def _hessian_vector(parameters: SeparableParameters, q: np.ndarray, p: np.ndarray, v_q: np.ndarray,
                    v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
    kinetic, potential, space = parameters.kinetic, parameters.potential, parameters.zero
    for a in range(0, q.size, space.size):
        b = min(a + space.size, q.size)
        zero = space[:b - a]
        perceptron.hessian_vector(kinetic, q[a:b], p[a:b], v_q[a:b], v_p[a:b], zero,
                                  product_p[a:b])
        perceptron.hessian_vector(potential, q[a:b], p[a:b], v_q[a:b], v_p[a:b], product_q[a:b],
                                  zero)
