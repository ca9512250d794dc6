# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Methods of order 4 and 8 composed of steps of a symmetric method of order 2."""

from collections.abc import Callable
from functools import cache
from typing import ClassVar

from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators.base import (
    in_sequence, Integrator, OK, PartitionedTableau, PhasePoint, PointWork, Requirements)
from hnn_vi_ros.integrators.generalized_leapfrog import GeneralizedLeapfrog
from hnn_vi_ros.integrators.implicit_midpoint import ImplicitMidpoint
from hnn_vi_ros.integrators.lie.lie_leapfrog import LieLeapfrog
from hnn_vi_ros.integrators.lie.lie_stormer_verlet import LieStormerVerlet
from hnn_vi_ros.integrators.stormer_verlet import StormerVerlet
from hnn_vi_ros.integrators.workspaces import discard_history
from hnn_vi_ros.kernels import inlined, Kernel
import numpy as np

BASES = {
    'generalized_leapfrog': GeneralizedLeapfrog,
    'implicit_midpoint': ImplicitMidpoint,
    'lie_leapfrog': LieLeapfrog,
    'lie_stormer_verlet': LieStormerVerlet,
    'stormer_verlet': StormerVerlet,
}


class Composition(Integrator):
    """
    Composition of steps of a symmetric base method of order 2 whose leading errors cancel.

    Symplectic and symmetric if the base is. For scalar coordinates prefer `gauss8`.

    Parameters
    ----------
    base : str
        ``'stormer_verlet'``, ``'generalized_leapfrog'``, ``'implicit_midpoint'``, or for rotations
        ``'lie_leapfrog'`` or ``'lie_stormer_verlet'``.

    Raises
    ------
    ValueError
        An unknown base.

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section II.4.

    """

    order: int = 4
    explicit = False
    requirements = Requirements(symmetric=True, symplectic=True)
    fractions: ClassVar[tuple[float, ...]]

    def __init__(self, base: str = 'generalized_leapfrog'):
        if base not in BASES:
            raise ValueError(f'base = {base!r}; valid: {", ".join(BASES)}')
        self.base = BASES[base]()
        self.step = _compose(self.base.step, self.fractions)
        self.requirements, self.explicit = self.base.requirements, self.base.explicit
        self.equations = self.base.equations

    def refusal(self, hamiltonian: Hamiltonian) -> str:
        """Return the reason for which the base cannot integrate `hamiltonian`."""
        return self.base.refusal(hamiltonian)

    @property
    def kernel_name(self) -> str:
        """Return the name of the method and of its base."""
        return f'{type(self).__name__}({self.base.kernel_name})'

    def attempts(self, n: int) -> tuple[int, ...]:
        """Return the attempts of the base."""
        return self.base.attempts(n)

    @property
    def usual_gradients(self) -> int:
        """Return the usual number of gradients of the base's steps."""
        return len(self.fractions) * self.base.usual_gradients

    def options(self, attempt: int = 0, dimension: int = 1) -> tuple:
        """Return the options of the base."""
        return self.base.options(attempt, dimension)

    @property
    def partitioned(self) -> PartitionedTableau | None:
        """Return the stages of the base's steps in sequence."""
        base = self.base.partitioned
        return None if base is None else in_sequence(base, self.fractions)

    def memory(self, n: int, dtype: type = np.float64) -> tuple:
        """Return the workspaces of the base, and an intermediate point."""
        return (*self.base.memory(n, dtype), PointWork(PhasePoint.empty(n, dtype)))


class Yoshida4(Composition):
    """
    Three steps of lengths w1, w0, w1, with w1 = 1 / (2 - 2^(1/3)), w0 = 1 - 2 w1, order 4.

    With base Störmer-Verlet it is stable only for h omega < 1.573. See Composition.

    References
    ----------
    H. Yoshida, Construction of higher order symplectic integrators, Phys. Lett. A 150 (1990).

    """

    _w = 1.0 / (2.0 - 2.0 ** (1.0 / 3.0))
    fractions = (_w, 1.0 - 2.0 * _w, _w)


class Suzuki4(Composition):
    """
    Five steps of lengths s, s, 1 - 4 s, s, s, with s = 1 / (4 - 4^(1/3)). See Composition.

    References
    ----------
    M. Suzuki, Fractal decomposition of exponential operators, Phys. Lett. A 146 (1990).

    """

    _s = 1.0 / (4.0 - 4.0 ** (1.0 / 3.0))
    fractions = (_s, _s, 1.0 - 4.0 * _s, _s, _s)


class KahanLi8(Composition):
    """
    Seventeen steps of symmetric lengths, order 8. See Composition.

    References
    ----------
    W. Kahan, R.-C. Li, Composition constants for raising the orders of unconventional schemes
    for ordinary differential equations, Math. Comp. 66 (1997), scheme s17odr8a.

    """

    order = 8
    _w = (0.13020248308889008, 0.5611629817751084, -0.3894749626448473, 0.1588419065551556,
          -0.39590389413323757, 0.1845396409783157, 0.25837438768632205, 0.2950117236093103,
          -0.60550853383003452)
    fractions = (*_w, *_w[-2::-1])


@cache
def _compose(base_step: Callable, fractions: tuple[float, ...]) -> Callable:
    @inlined
    def step(kernel: Kernel, h: float, options: tuple, z: PhasePoint, z1: PhasePoint,
             memory: tuple) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        between, inner = memory[-1].point, memory[:-1]
        worst, gradients = 0.0, 0
        for j in range(len(fractions)):
            # A step of another length is a poor initial guess for the next one.
            discard_history(inner)
            source = z if j == 0 else (between if j % 2 == 0 else z1)
            target = z1 if j % 2 == 0 else between
            outcome, residual, more = base_step(
                kernel, fractions[j] * h, options, source, target, inner)
            worst, gradients = max(worst, residual), gradients + more
            if outcome != OK:
                return outcome, residual, gradients
        return OK, worst, gradients
    return step
