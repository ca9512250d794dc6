# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A Hamiltonian given as an arbitrary torch module, differentiated by autograd."""

from collections.abc import Sequence
from copy import deepcopy
from functools import cached_property
from typing import TYPE_CHECKING

from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.kernels.kernel import Kernel, Parameters
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

if TYPE_CHECKING:
    import torch


class TorchHamiltonian(Hamiltonian):
    """
    H(q, p) as any torch module of one input vector (q, p), with autograd for its gradient.

    This is the slow, general way: it calls autograd in every step, from Python. A
    multilayer perceptron runs many times faster as a NeuralHamiltonian.

    Parameters
    ----------
    module : torch.nn.Module
        A copy of it in float64 is used. It maps a tensor of shape (1, 2 d), ordered (q, p), to
        one number, H [J].
    coordinates : sequence of Coordinate
        One for each of the d degrees of freedom.

    """

    def __init__(self, module: 'torch.nn.Module', coordinates: Sequence[Coordinate]):
        # In float32 the steps' equations could not be solved to the state's precision.
        self.module = deepcopy(module).double()
        self.coordinates = tuple(coordinates)

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions that simulations call, in plain Python."""
        return Kernel(self._energy, self._gradient, self._hessian_vector, (), self.dimension,
                      (0.0, 0.0), compiled=False)

    def _input(self, q: np.ndarray, p: np.ndarray) -> 'torch.Tensor':
        import torch
        first = next(self.module.parameters(), None)
        dtype = torch.float64 if first is None else first.dtype
        device = None if first is None else first.device
        rows = np.hstack([part.reshape(-1, self.dimension) for part in (q, p)])
        return torch.tensor(rows, dtype=dtype, device=device)

    def _split(self, rows: 'torch.Tensor', q_out: np.ndarray, p_out: np.ndarray) -> None:
        both = rows.detach().double().cpu().numpy()
        q_out[:] = both[:, :self.dimension].ravel()
        p_out[:] = both[:, self.dimension:].ravel()

    def _energy(self, parameters: Parameters, q: np.ndarray, p: np.ndarray) -> float:
        import torch
        with torch.no_grad():
            return float(self.module(self._input(q, p)).reshape(()))

    def _gradient(self, parameters: Parameters, q: np.ndarray, p: np.ndarray,
                  dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
        import torch
        x = self._input(q, p).requires_grad_(True)
        (gradient,) = torch.autograd.grad(self.module(x).sum(), x)
        self._split(gradient, dH_dq, dH_dp)

    def _hessian_vector(self, parameters: Parameters, q: np.ndarray, p: np.ndarray,
                        v_q: np.ndarray, v_p: np.ndarray, product_q: np.ndarray,
                        product_p: np.ndarray) -> None:
        import torch
        x = self._input(q, p).requires_grad_(True)
        (gradient,) = torch.autograd.grad(self.module(x).sum(), x, create_graph=True)
        (product,) = torch.autograd.grad((gradient * self._input(v_q, v_p)).sum(), x)
        self._split(product, product_q, product_p)
