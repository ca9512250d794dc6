# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Variants of methods that the simulator never uses, to show their effect.

``variational_euler@float32`` computes the gradient of the network in single precision.
`Undersolved` stops its implicit equations early.
"""

from collections.abc import Callable
from functools import cache, cached_property
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators import (
    check_method, ImplicitIntegrator, Integrator, INTEGRATORS, OK, Requirements, SolverOptions,
    SolverWork)
from hnn_vi_ros.kernels import inlined, Kernel
from hnn_vi_ros.models import NeuralHamiltonian
import numpy as np

FLOAT32 = 'float32'
# States of the training box at which the rounding of a gradient is measured.
_STATES = 64
_EPS = float(np.finfo(np.float64).eps)


def create(label: str, hamiltonian: Hamiltonian) -> tuple[Hamiltonian, Integrator]:
    """
    Build a method or a variant of one, and the Hamiltonian that it integrates.

    Raises
    ------
    UnsupportedSystem
        The method does not apply to this Hamiltonian.

    """
    kind, _, variant = label.partition('@')
    integrator = INTEGRATORS[kind]()
    check_method(integrator, hamiltonian)
    if variant == FLOAT32:
        if not isinstance(hamiltonian, NeuralHamiltonian):
            raise UnsupportedSystem(f'{label}: {type(hamiltonian).__name__} is a formula; '
                                    'single precision is studied on networks of ours')
        return SinglePrecision(hamiltonian), integrator
    return hamiltonian, integrator


class Undersolved(Integrator):
    """
    An implicit method whose equations are not solved to round-off.

    Parameters
    ----------
    base : ImplicitIntegrator
        The method.
    iterations : int
        Fixed-point iterations, whether they converge or not.

    """

    explicit, requirements = False, Requirements(symmetric=False, symplectic=False)

    def __init__(self, base: ImplicitIntegrator, iterations: int):
        self.base, self.order, self.step = base, base.order, base.step
        self.keeps_gradient = base.keeps_gradient
        self._solver = SolverOptions(_stop_early(), True, iterations)

    @property
    def kernel_name(self) -> str:
        """Return the name of the base, whose step it is."""
        return self.base.kernel_name

    def options(self, attempt: int = 0, dimension: int = 1) -> tuple:
        """Return the options of the base with the solver exchanged."""
        options, worse = self.base.options(attempt, dimension), self._solver
        return worse if isinstance(options, SolverOptions) else options._replace(solver=worse)

    def unknowns(self, n: int) -> tuple[int, ...]:
        """Return the equations of the base."""
        return self.base.unknowns(n)

    def memory(self, n: int, dtype: type = np.float64) -> tuple:
        """Return the workspaces of the base."""
        return self.base.memory(n, dtype)


@cache
def _stop_early() -> Callable:
    @inlined
    def solve(equation: Callable, tangent: Callable, problem: NamedTuple, x: np.ndarray,
              work: SolverWork, max_iterations: int) -> tuple[int, float, int]:
        """Iterate x = G(x) as often as allowed, and tell the residual."""
        value, scale, largest = work.iterates.values[0], work.iterates.scale, 0.0
        for _ in range(max_iterations):
            equation(problem, x, value)
            largest = 0.0
            for i in range(x.size):
                largest = max(largest, abs(value[i] - x[i]) / max(scale[i], 1e-300))
            x[:] = value
        return OK, largest, max_iterations
    # Kernels on disk are found by this name, which is to change with this file.
    solve.__name__ = f'stop_early_{sha256(Path(__file__).read_bytes()).hexdigest()[:16]}'
    return solve


class SinglePrecision(Hamiltonian):
    """
    A network whose gradient is computed in float32; energies stay in float64.

    Parameters
    ----------
    network : NeuralHamiltonian
        Its weights are rounded to float32.

    """

    def __init__(self, network: NeuralHamiltonian):
        self.network, self.coordinates, self.box = network, network.coordinates, network.box

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions that simulations compile, with weights of single precision."""
        exact = self.network.kernel
        network = exact.parameters
        rows, nodes = network.rows.astype(np.float32), network.nodes.astype(np.float32)
        single = exact._replace(parameters=network._replace(
            rows=rows, tiles=rows.reshape(network.tiles.shape),
            nodes=nodes, node_tiles=nodes.reshape(network.node_tiles.shape)))
        return single._replace(gradient_scale=self._gradient_scale(exact, single))

    def _gradient_scale(self, exact: Kernel, single: Kernel) -> tuple[float, float]:
        """Return the rounding error of H_q and of H_p in the box; see Kernel."""
        d = self.dimension
        low, high = np.concatenate(self.box).T
        z = np.random.default_rng(0).uniform(low, high, (_STATES, 2 * d))
        q, p = z[:, :d].ravel(), z[:, d:].ravel()
        gradients = np.empty((2, 2, q.size))
        for kernel, (dH_dq, dH_dp) in zip((exact, single), gradients, strict=True):
            kernel.gradient(kernel.parameters, q, p, dH_dq, dH_dp)
        errors = np.abs(gradients[1] - gradients[0]).max(axis=1)
        return 4.0 * float(errors[0]) / _EPS, 4.0 * float(errors[1]) / _EPS
