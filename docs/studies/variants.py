# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Methods by their names in the study, and variants that are solved or computed less exactly.

``gauss8`` is a method; ``gauss8@1e-4`` stops its implicit equations at a relative residual of
1e-4, ``gauss8@3`` after three fixed-point iterations, converged or not, and ``gauss8@float32``
takes the gradient from the network in single precision. The simulator does none of these: the
study does, to show what they cost.
"""

from collections.abc import Callable
from functools import cache, cached_property
from hashlib import sha256
import math
from pathlib import Path
from typing import NamedTuple

from hnn_vi_ros.errors import did_you_mean, HnnViRosError, ParameterError, UnsupportedSystem
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.integrators import check_method, INTEGRATORS
from hnn_vi_ros.integrators.base import Integrator, NO_CONVERGENCE, NOT_FINITE, OK, Requirements
from hnn_vi_ros.integrators.implicit import ImplicitIntegrator
from hnn_vi_ros.integrators.solvers import SolverOptions
from hnn_vi_ros.integrators.workspaces import SolverWork
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.kernels.marks import inlined
from hnn_vi_ros.models.neural import NeuralHamiltonian
import numpy as np

FLOAT32 = 'float32'
_MOST_ITERATIONS = 100
# States of the training box at which the rounding of a gradient is measured.
_STATES = 64
_EPS = float(np.finfo(np.float64).eps)


class MethodLabel(NamedTuple):
    """A label as above, taken apart; ``variant`` is empty for the method itself."""

    label: str
    kind: str
    variant: str


def parse_method(label: str) -> MethodLabel:
    """
    Take a label apart.

    Raises
    ------
    ParameterError
        No such method or variant; the message lists the valid ones.

    """
    kind, at, variant = label.partition('@')
    if kind not in INTEGRATORS:
        raise ParameterError(f'--methods: unknown method {kind!r}'
                             f'{did_you_mean(kind, INTEGRATORS)}; valid: {", ".join(INTEGRATORS)}')
    if at and variant != FLOAT32:
        if not issubclass(INTEGRATORS[kind], ImplicitIntegrator):
            raise ParameterError(f'--methods: {label}: {kind} solves no equation of its own; '
                                 'take an implicit method')
        _accuracy(label, variant)
    return MethodLabel(label, kind, variant)


def create(method: MethodLabel, hamiltonian: Hamiltonian) -> tuple[Hamiltonian, Integrator]:
    """
    Build a method, and the Hamiltonian that it integrates.

    Raises
    ------
    UnsupportedSystem
        The method does not apply to this Hamiltonian.

    """
    try:
        integrator = INTEGRATORS[method.kind]()
    except (TypeError, ValueError) as problem:
        raise UnsupportedSystem(f'{method.label}: needs parameters of its own, which the study '
                                'does not give it; leave it out') from problem
    check_method(integrator, hamiltonian)
    if method.variant == FLOAT32:
        if not isinstance(hamiltonian, NeuralHamiltonian):
            raise UnsupportedSystem(f'{method.label}: {type(hamiltonian).__name__} is a formula; '
                                    'single precision is studied on networks of ours')
        return SinglePrecision(hamiltonian), integrator
    if method.variant:
        integrator = Undersolved(integrator, *_accuracy(method.label, method.variant))
    return hamiltonian, integrator


def applicable(method: MethodLabel, hamiltonian: Hamiltonian) -> bool:
    """Return whether a method can be built for a Hamiltonian."""
    try:
        create(method, hamiltonian)
    except HnnViRosError:
        return False
    return True


def _accuracy(label: str, variant: str) -> tuple[float, int]:
    """Return the tolerance, and the iterations after which an iterate is taken unconverged."""
    try:
        number = float(variant)
    except ValueError:
        number = math.nan
    if 0.0 < number < 1.0:
        return number, 0
    if number in range(1, _MOST_ITERATIONS + 1):
        return 0.0, int(number)
    raise ParameterError(f'--methods: {label}: after @ comes {FLOAT32}, a tolerance below 1, or a '
                         f'number of iterations from 1 to {_MOST_ITERATIONS}')


class Undersolved(Integrator):
    """
    An implicit method whose equations are not solved to round-off.

    Parameters
    ----------
    base : ImplicitIntegrator
        The method.
    tolerance : float
        Relative residual at which an iterate is taken [1].
    iterations : int
        Fixed-point iterations after which an iterate is taken in any case; 0 for none.

    """

    explicit, requirements = False, Requirements(symmetric=False, symplectic=False)

    def __init__(self, base: ImplicitIntegrator, tolerance: float, iterations: int):
        self.base, self.order, self.step = base, base.order, base.step
        self.keeps_gradient = base.keeps_gradient
        self._solve = _stop_early(tolerance, iterations)
        self._most = iterations or _MOST_ITERATIONS

    @property
    def kernel_name(self) -> str:
        """Return the name of the base, whose step it is."""
        return self.base.kernel_name

    def options(self, attempt: int = 0, dimension: int = 1) -> tuple:
        """Return the options of the base with the solver exchanged."""
        worse = SolverOptions(self._solve, True, self._most)
        options = self.base.options(attempt, dimension)
        return worse if isinstance(options, SolverOptions) else options._replace(solver=worse)

    def unknowns(self, n: int) -> tuple[int, ...]:
        """Return the equations of the base."""
        return self.base.unknowns(n)

    def memory(self, n: int, dtype: type = np.float64) -> tuple:
        """Return the workspaces of the base."""
        return self.base.memory(n, dtype)


@cache
def _stop_early(tolerance: float, iterations: int) -> Callable:
    @inlined
    def solve(equation: Callable, tangent: Callable, problem: NamedTuple, x: np.ndarray,
              work: SolverWork, max_iterations: int) -> tuple[int, float, int]:
        """Iterate x = G(x) until it is good enough, or was tried often enough."""
        value, scale, largest = work.iterates.values[0], work.iterates.scale, math.inf
        for k in range(1, max_iterations + 1):
            equation(problem, x, value)
            largest = 0.0
            for i in range(x.size):
                defect = abs(value[i] - x[i])
                if not defect <= largest * scale[i]:
                    largest = defect / scale[i] if scale[i] > 0.0 else defect
            if not math.isfinite(largest):
                return NOT_FINITE, largest, k
            if largest <= tolerance or k == iterations:
                return OK, largest, k
            x[:] = value
        return NO_CONVERGENCE, largest, max_iterations
    # Kernels on disk are found by this name, which is to change with this file.
    digest = sha256(Path(__file__).read_bytes()).hexdigest()[:16]
    solve.__name__ = f'stop_early_{tolerance!r}_{iterations}_{digest}'
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
