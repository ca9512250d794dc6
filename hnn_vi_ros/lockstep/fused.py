# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Launches of the kernels in Triton: two for a gradient, or one for many steps.

On the processor they run in Triton's interpreter alone, which is for tests.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.integrators import method_name
from hnn_vi_ros.integrators.implicit import ImplicitIntegrator
from hnn_vi_ros.integrators.solvers import secant, SolverOptions
from hnn_vi_ros.integrators.workspaces import FAST_MATRIX
from hnn_vi_ros.lockstep import triton_kernels
from hnn_vi_ros.lockstep.steps import Progress, State
from hnn_vi_ros.models.checkpoint import Layers
from hnn_vi_ros.models.neural import NeuralHamiltonian
import numpy as np
import torch

# Blocks of products: at most so many rows, and so many columns and terms at once. With all rows of
# a layer in one block, tanh of the other is taken once. Compiled for sm_90, these spill no
# registers in the first kernel, and 31 numbers of a thread in the second; 32 columns spill 74 and
# 163. A block of 16 rows is a warp's.
_MOST_ROWS, COLUMNS, _TERMS, _MOST_WARPS = 256, 16, 16, 8
# The widest network of which one program has all the weights at hand, and its trajectories: a
# program of width 64 spills 28 numbers of a thread, of the leapfrog 47; of 16 trajectories 105.
WIDEST, _TRAJECTORIES = 64, 8
_METHODS = ('variational_euler', 'generalized_leapfrog')


def _power(least: int, n: int) -> int:
    """Return the smallest power of 2 that is neither less than n nor than another."""
    return max(least, 1 << (n - 1).bit_length())


def _warps(rows: int) -> int:
    """Return how many warps share so many rows."""
    return min(rows // 16, _MOST_WARPS)


def on_device(device: torch.device) -> AbstractContextManager[Any]:
    """Return where launches go to a device: by itself Triton takes the current one."""
    return torch.cuda.device(device) if device.type == 'cuda' else nullcontext()


def passes(layers: list[tuple[torch.Tensor, torch.Tensor]], last: torch.Tensor,
           values: list[torch.Tensor], slopes: list[torch.Tensor], inputs: torch.Tensor,
           gradient: torch.Tensor) -> tuple[Callable[[], None], Callable[[], None]]:
    """
    Return the two launches of a gradient: forward through two layers, and back from the second.

    Parameters
    ----------
    layers : list of tuple
        Weights and biases, shapes (n_l, n_(l-1)) and (n_l, 1); at least two.
    last : torch.Tensor, shape (n, 1)
        Weights of the output.
    values, slopes : list of torch.Tensor, each (n_l, m)
        Of the layers: f(Z_l), and f'(Z_l) or, before the launch back, D_l. Those of the first
        are not touched, and where there are two neither is the value of the second.
    inputs, gradient : torch.Tensor, shape (n_0, m)
        What it starts from, and ends in; m is a multiple of 16.

    """
    (w1, b1), (w2, b2) = layers[:2]
    (n1, n), n2, m = w1.shape, len(w2), inputs.shape[1]
    assert m % COLUMNS == 0, 'batches are whole blocks'
    grid, device = (m // COLUMNS,), inputs.device
    rows, rows_back = (min(_power(16, width), _MOST_ROWS) for width in (n2, n1))

    def forward() -> None:
        with on_device(device):
            triton_kernels.forward[grid](
                inputs, w1, b1, w2, b2, last, values[1], slopes[1], m, n1, n2, INPUTS=n,
                LAST=len(layers) == 2, ROWS=rows, COLUMNS=COLUMNS, DEPTH=_TERMS,
                num_warps=_warps(rows))

    def backward() -> None:
        with on_device(device):
            triton_kernels.backward[grid](
                inputs, w1, b1, w2, slopes[1], gradient, m, n1, n2, INPUTS=n,
                PADDED=_power(16, n), ROWS=rows_back, COLUMNS=COLUMNS, DEPTH=_TERMS,
                num_warps=_warps(rows_back))
    return forward, backward


def check_network(layers: Layers, activation: str) -> None:
    """
    Check that a network has fused kernels.

    Raises
    ------
    UnsupportedSystem
        It has none; says which have.

    """
    if activation != 'tanh' or len(layers.weights) < 3:
        raise UnsupportedSystem(
            f'a network with {len(layers.weights) - 1} layers of {activation} has no fused '
            'kernels: they are for tanh and two layers or more, beside the output; leave /fused '
            'out')


class ManySteps:
    """
    Many steps of each trajectory in one launch, by the secant method.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        A network of one coordinate, with two layers of tanh no wider than 64.
    integrator : ImplicitIntegrator
        ``variational_euler`` or ``generalized_leapfrog``.
    h : float
        Step size [s].
    options : SolverOptions
        Of the method.
    device : torch.device
        Where states are.

    Raises
    ------
    UnsupportedSystem
        H, the method or its solver is another one; says which are possible.

    """

    def __init__(self, hamiltonian: Hamiltonian, integrator: ImplicitIntegrator, h: float,
                 options: SolverOptions, device: torch.device):
        name = method_name(integrator)
        if not isinstance(hamiltonian, NeuralHamiltonian) or not _fits(hamiltonian):
            raise UnsupportedSystem(
                f'{type(hamiltonian).__name__}: one launch takes many steps of a network of '
                f'(q, p) of one coordinate, with two layers of tanh no wider than {WIDEST}, and '
                'no box; leave /steps out')
        if name not in _METHODS or options.solve is not secant:
            raise UnsupportedSystem(
                f'{name}: one launch takes many steps of {" or ".join(_METHODS)} by the secant '
                'method, as their solver is by default; leave /steps out')
        layers = hamiltonian.checkpoint.networks['energy']

        def put(array: np.ndarray) -> torch.Tensor:
            return torch.from_numpy(np.ascontiguousarray(array)).to(device)
        (w1, w2, last), (b1, b2, _) = map(put, layers.weights), map(put, layers.biases)
        self._device, self._network, self._width = device, (w1, b1, w2, b2, last), len(w1)
        # As an argument a number would be one of float32.
        self._numbers = put(np.array([h, *hamiltonian.kernel.gradient_scale]))
        self._leapfrog, self._options = name == 'generalized_leapfrog', options

    def take(self, state: State, progress: Progress, end: int) -> tuple[State, torch.Tensor]:
        """
        Take the steps that are to do; see ``LockstepEnsemble``.

        Returns
        -------
        tuple of (State, torch.Tensor)
            The states after them, or before one that is not solved; and its outcome, else OK.

        """
        m, width = state.z.shape[1], _power(16, self._width)
        # Copied: the kernel works in place.
        z, carry, slope, counts, *earlier = (
            part.contiguous().clone() for part in (*state[:4], *state.earlier))
        outcome = torch.empty(m, dtype=torch.int64, device=self._device)
        with on_device(self._device):
            triton_kernels.take_steps[(-(-m // _TRAJECTORIES),)](
                z, carry, slope, counts, earlier[0], earlier[-1], progress.todo, outcome,
                progress.most, progress.at, self._numbers, *self._network, m, self._width, end,
                LEAPFROG=self._leapfrog, EXTRAPOLATE=self._options.extrapolate,
                MOST=self._options.max_iterations,
                CONNECTED=self._options.connected and FAST_MATRIX > 0,
                WIDTH=width, COLUMNS=_TRAJECTORIES, num_warps=_warps(width))
        return State(z, carry, slope, counts, tuple(earlier)), outcome


def _fits(hamiltonian: NeuralHamiltonian) -> bool:
    """Return whether one program can hold the network."""
    checkpoint = hamiltonian.checkpoint
    weights = checkpoint.networks['energy'].weights
    return (checkpoint.card.activation == 'tanh' and hamiltonian.dimension == 1
            and len(weights) == 3 and len(weights[0]) == len(weights[1]) <= WIDEST)
