# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Learned Hamiltonians made of perceptrons: H(q, p), T(p) + V(q), or V(q) with a constant M."""

from typing import NamedTuple

from hnn_vi_ros.kernels import Kernel, part
from hnn_vi_ros.models.checkpoint import Checkpoint
from hnn_vi_ros.models.learned import LearnedHamiltonian
from hnn_vi_ros.models.networks import perceptron
from hnn_vi_ros.models.networks.perceptron_memory import MAX_STATES, PackedPerceptron
import numpy as np


class NeuralHamiltonian(LearnedHamiltonian):
    """
    A trained multilayer perceptron with activation f between its layers, H = w . a_K + b.

    With a_0 = (q, p), z_l = W_l a_(l-1) + b_l, a_l = f(z_l), the gradient is propagated back by
    g_K = w, g_(l-1) = W_l^T (f'(z_l) g_l), so (H_q, H_p) = g_0: two passes through the weights,
    without automatic differentiation. f is tanh, sine, softplus or relu, see the model card. With
    relu, H_q and H_p are discontinuous: it is not ``smooth``.

    Parameters
    ----------
    checkpoint : Checkpoint
        Weights W_l of shape (n_l, n_(l-1)), biases of shape (n_l,), and the model card.
    network : str
        Name of the network if there are several: that of H, or another one of (q, p).

    References
    ----------
    S. Greydanus, M. Dzamba, J. Yosinski, Hamiltonian Neural Networks, NeurIPS 2019.

    """

    def __init__(self, checkpoint: Checkpoint, network: str = 'energy'):
        super().__init__(checkpoint)
        self._network = network

    def _kernel(self) -> Kernel:
        return self._kernel_of(perceptron.energy, perceptron.gradient, perceptron.hessian_vector,
                               self._packed(self._network))


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
        return self._kernel_of(
            _separable_energy, _separable_gradient, _separable_hessian_vector, parameters)


def _separable_energy(parameters: SeparableParameters, q: np.ndarray, p: np.ndarray) -> float:
    return (perceptron.energy(parameters.kinetic, q, p)
            + perceptron.energy(parameters.potential, q, p))


def _separable_gradient(parameters: SeparableParameters, q: np.ndarray, p: np.ndarray,
                        dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    kinetic, potential, space = parameters.kinetic, parameters.potential, parameters.zero
    for a in range(0, q.size, space.size):
        b = min(a + space.size, q.size)
        zero = space[:b - a]
        perceptron.part_gradient(kinetic, q[a:b], p[a:b], zero, dH_dp[a:b])
        perceptron.part_gradient(potential, q[a:b], p[a:b], dH_dq[a:b], zero)


def _separable_hessian_vector(parameters: SeparableParameters, q: np.ndarray, p: np.ndarray,
                              v_q: np.ndarray, v_p: np.ndarray, product_q: np.ndarray,
                              product_p: np.ndarray) -> None:
    kinetic, potential, space = parameters.kinetic, parameters.potential, parameters.zero
    for a in range(0, q.size, space.size):
        b = min(a + space.size, q.size)
        zero = space[:b - a]
        perceptron.hessian_vector(kinetic, q[a:b], p[a:b], v_q[a:b], v_p[a:b], zero,
                                  product_p[a:b])
        perceptron.hessian_vector(potential, q[a:b], p[a:b], v_q[a:b], v_p[a:b], product_q[a:b],
                                  zero)


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
        return self._kernel_of(
            _variational_energy, _variational_gradient, _variational_hessian_vector, parameters)


def _variational_energy(parameters: VariationalParameters, q: np.ndarray, p: np.ndarray) -> float:
    inverse, potential = parameters.mass_inverse, parameters.potential
    energy = perceptron.energy(potential, q, p)
    for i in range(p.size):
        for j in range(p.size):
            energy += 0.5 * p[i] * inverse[i, j] * p[j]
    return energy


def _variational_gradient(parameters: VariationalParameters, q: np.ndarray, p: np.ndarray,
                          dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    inverse, potential = parameters.mass_inverse, parameters.potential
    # Fills dH_dp with zeros.
    perceptron.part_gradient(potential, q, p, dH_dq, dH_dp)
    _add_velocity(inverse, p, dH_dp)


def _variational_hessian_vector(parameters: VariationalParameters, q: np.ndarray, p: np.ndarray,
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
