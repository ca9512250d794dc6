# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The adaptive methods of order 8 that users reach for, each as a function of its tolerance."""

from collections.abc import Callable
from functools import partial

from hnn_vi_ros.models.neural import NeuralHamiltonian
import numpy as np
from studies import peers

# solve(duration, tolerance) returns (q, p) at the end, shape (2 d,).
Solve = Callable[[float, float], np.ndarray]


def adaptive_peers(hamiltonian: NeuralHamiltonian, z0: np.ndarray) -> dict[str, Solve]:
    """Return each peer's solver from z0 = (q, p) on; the tolerance is relative and absolute."""
    solvers = {
        'diffrax Dopri8': peers.diffrax_solve(hamiltonian, 'Dopri8'),
        'scipy DOP853': peers.scipy_solve(hamiltonian, 'DOP853'),
        'torchdiffeq dopri8': peers.torch_solve(hamiltonian, 'dopri8', adaptive=True),
    }
    return {name: partial(_end, solve, z0) for name, solve in solvers.items()}


def scipy_solution(hamiltonian: NeuralHamiltonian, z0: np.ndarray, duration: float
                   ) -> np.ndarray:
    """Return DOP853's (q, p) at the tightest tolerance that it takes."""
    return peers.scipy_solve(hamiltonian, 'DOP853')(z0, duration, 0.0)[0]


def _end(solve: Callable, z0: np.ndarray, duration: float, tolerance: float) -> np.ndarray:
    return solve(z0, duration, tolerance)[0]
