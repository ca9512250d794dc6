# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The Hamiltonian neural network: a perceptron H(q, p), its gradient written out."""

from functools import cached_property

from hnn_vi_ros.hamiltonians import perceptron
from hnn_vi_ros.hamiltonians.activations import ACTIVATIONS
from hnn_vi_ros.hamiltonians.base import Hamiltonian, Kernel
from hnn_vi_ros.hamiltonians.checkpoint import Checkpoint
from hnn_vi_ros.hamiltonians.perceptron_memory import pack
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

# States of the box at which rounding is measured.
_SAMPLES = 64
_EPS = float(np.finfo(np.float64).eps)


class NeuralHamiltonian(Hamiltonian):
    """
    A trained multilayer perceptron with an activation f between its layers, H = w . a_K + b.

    With a_0 = (q, p), z_l = W_l a_(l-1) + b_l, a_l = f(z_l), the gradient is propagated back by
    g_K = w, g_(l-1) = W_l^T (f'(z_l) g_l), so (H_q, H_p) = g_0: two passes through the weights,
    no automatic differentiation. f is tanh, the sine, softplus or relu, as the model card says.
    With relu, H_q and H_p jump: it is not ``smooth``.

    Parameters
    ----------
    checkpoint : Checkpoint
        Weights W_l of shape (n_l, n_(l-1)), biases of shape (n_l,), and the model card.

    References
    ----------
    S. Greydanus, M. Dzamba, J. Yosinski, Hamiltonian Neural Networks, NeurIPS 2019.

    """

    def __init__(self, checkpoint: Checkpoint):
        self.checkpoint = checkpoint
        self.coordinates = tuple(
            Coordinate(c.name, c.q_unit, c.p_unit) for c in checkpoint.card.coordinates)

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the bounds of q and of p, each (d, 2), of the data that H was learned from."""
        box = self.checkpoint.card.box
        return np.array(box.q), np.array(box.p)

    @property
    def smooth(self) -> bool:
        """Tell whether the gradient of H is continuous."""
        return ACTIVATIONS[self.checkpoint.card.activation].smooth

    @property
    def provenance(self) -> dict[str, str]:
        """Return the digest of the model file."""
        return {'model_sha256': self.checkpoint.sha256}

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions that simulations compile."""
        parameters = pack(self.checkpoint.weights, self.checkpoint.biases,
                          self.checkpoint.card.activation)
        return Kernel(perceptron.energy, perceptron.gradient, perceptron.hessian_vector,
                      parameters, self.dimension, self._gradient_scale(parameters), compiled=True)

    def _gradient_scale(self, parameters: tuple) -> tuple[float, float]:
        """
        Return the rounding error of H_q and of H_p, in units of the unit round-off.

        It is measured against extended precision at random states of the box; a bound from the
        weights alone would grow exponentially with the depth.
        """
        d = self.dimension
        low, high = np.concatenate(self.box).T
        z = np.random.default_rng(0).uniform(low, high, (_SAMPLES, 2 * d))
        q, p = z[:, :d].ravel(), z[:, d:].ravel()
        dH_dq, dH_dp = np.empty_like(q), np.empty_like(p)
        perceptron.gradient(parameters, q, p, dH_dq, dH_dp)
        exact = self._extended_gradient(z)
        q_error = np.abs(dH_dq - exact[:, :d].ravel()).max()
        p_error = np.abs(dH_dp - exact[:, d:].ravel()).max()
        return 4.0 * float(q_error) / _EPS, 4.0 * float(p_error) / _EPS

    def _extended_gradient(self, z: np.ndarray) -> np.ndarray:
        """Return (H_q, H_p) at states of shape (m, 2 d), in extended precision."""
        value, slope, _ = ACTIVATIONS[self.checkpoint.card.activation]
        a, slopes = z.astype(np.longdouble), []
        weights, biases = self.checkpoint.weights, self.checkpoint.biases
        for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
            z = a @ weight.T.astype(np.longdouble) + bias
            a = value(z)
            slopes.append(slope(z))
        gradient = np.tile(weights[-1][0].astype(np.longdouble), (len(z), 1))
        for weight, slope_l in zip(weights[-2::-1], slopes[::-1], strict=True):
            gradient = (gradient * slope_l) @ weight
        return gradient
