# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A learned Hamiltonian with a constant mass matrix and a potential network."""

from typing import NamedTuple

from hnn_vi_ros.kernels import Kernel, part
from hnn_vi_ros.models.learned import LearnedHamiltonian
from hnn_vi_ros.models.networks import perceptron
from hnn_vi_ros.models.networks.perceptron_memory import PackedPerceptron
import numpy as np


class VariationalParameters(NamedTuple):
    """M^-1, shape (d, d), and the network of V."""

    mass_inverse: np.ndarray
    potential: PackedPerceptron


class VariationalHamiltonian(LearnedHamiltonian):
    """
    H(q, p) = p . M^-1 p / 2 + V(q), of a variational integrator network.

    M is the mass matrix of the model card, V the network ``potential``.

    Parameters
    ----------
    checkpoint : Checkpoint
        A model of the family vin.

    References
    ----------
    S. Saemundsson, A. Terenin, K. Hofmann, M. P. Deisenroth, Variational Integrator Networks for
    Physically Structured Embeddings, AISTATS 2020.

    """

    separable = True

    @property
    def mass_inverse(self) -> np.ndarray:
        """Return M^-1, shape (d, d)."""
        inverse = np.linalg.inv(np.array(self.checkpoint.card.mass))
        return 0.5 * (inverse + inverse.T)

    def _kernel(self) -> Kernel:
        parameters = VariationalParameters(self.mass_inverse, self._packed('potential', 'q'))
        return self._kernel_of(_energy, _gradient, _hessian_vector, parameters)


def _energy(parameters: VariationalParameters, q: np.ndarray, p: np.ndarray) -> float:
    inverse, potential = parameters.mass_inverse, parameters.potential
    energy = perceptron.energy(potential, q, p)
    for i in range(p.size):
        for j in range(p.size):
            energy += 0.5 * p[i] * inverse[i, j] * p[j]
    return energy


def _gradient(parameters: VariationalParameters, q: np.ndarray, p: np.ndarray,
              dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    inverse, potential = parameters.mass_inverse, parameters.potential
    # Fills dH_dp with zeros.
    perceptron.part_gradient(potential, q, p, dH_dq, dH_dp)
    _add_velocity(inverse, p, dH_dp)


def _hessian_vector(parameters: VariationalParameters, q: np.ndarray, p: np.ndarray,
                    v_q: np.ndarray, v_p: np.ndarray, product_q: np.ndarray,
                    product_p: np.ndarray) -> None:
    inverse, potential = parameters.mass_inverse, parameters.potential
    perceptron.hessian_vector(potential, q, p, v_q, v_p, product_q, product_p)
    _add_velocity(inverse, v_p, product_p)


@part(error_model='numpy', forceinline=True)
def _add_velocity(inverse: np.ndarray, p: np.ndarray, velocity: np.ndarray) -> None:
    d = inverse.shape[0]
    for a in range(0, p.size, d):
        for i in range(d):
            for j in range(d):
                velocity[a + i] += inverse[i, j] * p[a + j]
