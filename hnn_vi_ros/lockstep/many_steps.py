# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Launches of the kernel in Triton that takes many steps.

On the processor it runs in Triton's interpreter alone, which is for tests.
"""

from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.integrators import method_name
from hnn_vi_ros.integrators.implicit import ImplicitIntegrator
from hnn_vi_ros.integrators.solvers import secant, SolverOptions
from hnn_vi_ros.lockstep import triton_kernels
from hnn_vi_ros.lockstep.fused import on_device, power, warps_of
from hnn_vi_ros.lockstep.steps import Progress, State
from hnn_vi_ros.models.neural import NeuralHamiltonian
import numpy as np
import torch

# The widest network of which one program has all the weights at hand, and its trajectories: a
# program of width 64 spills 28 numbers of a thread, of the leapfrog 47; of 16 trajectories 105.
WIDEST, _TRAJECTORIES = 64, 8
_METHODS = ('variational_euler', 'generalized_leapfrog')


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
        m, width = state.z.shape[1], power(16, self._width)
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
                CONNECTED=self._options.connected,
                WIDTH=width, COLUMNS=_TRAJECTORIES, numwarps_of=warps_of(width))
        return State(z, carry, slope, counts, tuple(earlier)), outcome


def _fits(hamiltonian: NeuralHamiltonian) -> bool:
    """Return whether one program can hold the network."""
    checkpoint = hamiltonian.checkpoint
    weights = checkpoint.networks['energy'].weights
    return (checkpoint.card.activation == 'tanh' and hamiltonian.dimension == 1
            and len(weights) == 3 and len(weights[0]) == len(weights[1]) <= WIDEST)
