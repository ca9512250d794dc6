# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A Hamiltonian given as an arbitrary torch module, differentiated by autograd."""

from collections.abc import Callable, Sequence
from copy import deepcopy
from functools import cached_property
from typing import NoReturn, TYPE_CHECKING

from hnn_vi_ros.errors import ModelError, prefixed
from hnn_vi_ros.hamiltonians import Arguments, Hamiltonian, read_arguments, slopes_differ
from hnn_vi_ros.kernels import Kernel, Parameters
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

if TYPE_CHECKING:
    import torch


def rows_of(module: 'torch.nn.Module', arguments: Arguments
            ) -> 'Callable[[torch.Tensor], torch.Tensor]':
    """Return the module as a function of rows (q, p), shape (n, 2 d), or of rows (q, p, t)."""
    def rows(x: 'torch.Tensor') -> 'torch.Tensor':
        z, t = (x[..., :-1], x[..., -1:]) if arguments.timed else (x, None)
        return arguments.call(module, z.chunk(2, -1) if arguments.order else [z], t)
    return rows


class TorchHamiltonian(Hamiltonian):
    """
    H(q, p) as a torch module of one input vector (q, p), with autograd for its gradient.

    This way is general but slow: it calls autograd in every step, from Python. A multilayer
    perceptron is many times faster as a NeuralHamiltonian.

    Parameters
    ----------
    module : torch.nn.Module
        A module that maps a tensor of shape (n, 2 d), with rows (q, p), or q and p apart, to H of
        each row or to their sum [J]. A copy of it in float64 and in evaluation mode is used.
    coordinates : sequence of Coordinate
        Coordinates of the d degrees of freedom.

    Raises
    ------
    ModelError
        When it is called: the module raises an error, or is not such a function.

    """

    def __init__(self, module: 'torch.nn.Module', coordinates: Sequence[Coordinate]):
        with prefixed(type(module).__name__, ModelError):
            self._arguments = read_arguments(module.forward)
        if self._arguments.timed:
            self.module = module
            self._refuse('takes the time, which only an exported module does: use export')
        # In float32 the equations of steps could not be solved to the precision of the state.
        self.module = deepcopy(module).double().eval()
        self.coordinates = tuple(coordinates)

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions for simulations, in plain Python."""
        return Kernel(self._energy, self._gradient, self._hessian_vector, (), self.dimension,
                      (0.0, 0.0), compiled=False)

    def _input(self, q: np.ndarray, p: np.ndarray) -> 'torch.Tensor':
        import torch
        first = next(self.module.parameters(), None)
        dtype = torch.float64 if first is None else first.dtype
        device = None if first is None else first.device
        rows = np.hstack([part.reshape(-1, self.dimension) for part in (q, p)])
        return torch.tensor(rows, dtype=dtype, device=device)

    def check_state(self, q: np.ndarray, p: np.ndarray) -> None:
        """Raise ModelError unless the module is a function of each row with these slopes."""
        other = 1.25 * q + 0.125
        rows = np.array([[q, p], [other, p], [q, p]])
        one, same, another = (np.array(self._slopes(*row)) for row in rows[[0, 2, 1]])
        both = np.array(self._slopes(rows[:2, 0], rows[:2, 1])).reshape(2, 2, -1)
        if not np.array_equal(one, same, equal_nan=True):
            self._refuse('has a different gradient when it is called again; make it a function of '
                         'its input alone')
        # Matrix products of one row and of two have different rounding errors.
        if not np.allclose(both, np.stack([one, another], axis=1), 1e-6, 1e-9, equal_nan=True):
            self._refuse('mixes the rows of its input, or uses only the first; index columns as '
                         'in x[:, 0], and avoid layers that depend on the batch')
        if slopes_differ(self, q, p):
            self._refuse('has slopes that are not those of its values: it detaches a part of its '
                         'input, or rounds, compares or converts it')

    def _refuse(self, why: str) -> NoReturn:
        raise ModelError(f'{type(self.module).__name__} {why}')

    def _values(self, x: 'torch.Tensor') -> 'torch.Tensor':
        """Return H of rows, shape (n, 2 d), or their sum."""
        import torch
        try:
            values = rows_of(self.module, self._arguments)(x)
        except Exception as problem:  # noqa: B902  the user's code may raise any
            self._refuse(f'raises {type(problem).__name__}: {" ".join(str(problem).split())}; it '
                         f'is called in float64, with a tensor of shape {(*x.shape,)}')
        if not isinstance(values, torch.Tensor) or values.dtype != x.dtype:
            self._refuse(f'returns {getattr(values, "dtype", type(values).__name__)}, expected a '
                         'float64 tensor, as its input is; remove type casts')
        if values.numel() not in (1, len(x)):
            self._refuse(f'returns a tensor of shape {(*values.shape,)} for an input of shape '
                         f'{(*x.shape,)}, expected one number per row; select the column of H')
        return values.sum()

    def _slopes(self, q: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        slopes = np.empty((2, q.size))
        self._gradient((), q, p, *slopes)
        return slopes[0], slopes[1]

    def _derivative(self, value: 'torch.Tensor', x: 'torch.Tensor', more: bool = False
                    ) -> 'torch.Tensor':
        """Return the derivative of a number by rows; with ``more``, it is differentiable again."""
        import torch
        try:
            (slopes,) = torch.autograd.grad(value, x, create_graph=more)
        except RuntimeError as problem:
            self._refuse(f'cannot be differentiated: {" ".join(str(problem).split())}; compute H '
                         'from its input with differentiable operations of torch')
        return slopes

    def _split(self, rows: 'torch.Tensor', q_out: np.ndarray, p_out: np.ndarray) -> None:
        both = rows.detach().double().cpu().numpy()
        q_out[:] = both[:, :self.dimension].ravel()
        p_out[:] = both[:, self.dimension:].ravel()

    def _energy(self, parameters: Parameters, q: np.ndarray, p: np.ndarray) -> float:
        import torch
        with torch.no_grad():
            return float(self._values(self._input(q, p)))

    def _gradient(self, parameters: Parameters, q: np.ndarray, p: np.ndarray,
                  dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
        x = self._input(q, p).requires_grad_(True)
        self._split(self._derivative(self._values(x), x), dH_dq, dH_dp)

    def _hessian_vector(self, parameters: Parameters, q: np.ndarray, p: np.ndarray,
                        v_q: np.ndarray, v_p: np.ndarray, product_q: np.ndarray,
                        product_p: np.ndarray) -> None:
        x = self._input(q, p).requires_grad_(True)
        gradient = self._derivative(self._values(x), x, more=True)
        # For relu, and if H is linear, the gradient does not depend on x: its product is zero.
        gradient = gradient + 0.0 * x
        product = self._derivative((gradient * self._input(v_q, v_p)).sum(), x)
        self._split(product, product_q, product_p)
