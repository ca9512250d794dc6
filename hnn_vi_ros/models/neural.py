# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The Hamiltonian neural network: a perceptron H(q, p) with an explicit gradient."""

from hnn_vi_ros.kernels import Kernel
from hnn_vi_ros.models.checkpoint import Checkpoint
from hnn_vi_ros.models.learned import LearnedHamiltonian
from hnn_vi_ros.models.networks import perceptron


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
