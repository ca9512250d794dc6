# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Integrators by name in scenes, and searches for methods with a property."""

from collections.abc import Callable

from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators.base import Integrator
from hnn_vi_ros.integrators.composition import Composition, KahanLi8, Suzuki4, Yoshida4
from hnn_vi_ros.integrators.discrete_euler_lagrange import DiscreteEulerLagrange
from hnn_vi_ros.integrators.discrete_gradient import DiscreteGradient
from hnn_vi_ros.integrators.dop853 import Dop853
from hnn_vi_ros.integrators.gauss import GAUSS_METHODS
from hnn_vi_ros.integrators.generalized_leapfrog import GeneralizedLeapfrog
from hnn_vi_ros.integrators.implicit_midpoint import ImplicitMidpoint
from hnn_vi_ros.integrators.lie.lie_gauss import LIE_GAUSS_METHODS
from hnn_vi_ros.integrators.lie.lie_leapfrog import (
    LieLeapfrog, LieSymplecticEuler, LieSymplecticEulerAdjoint, LieVariationalEuler)
from hnn_vi_ros.integrators.lie.lie_stormer_verlet import LieStormerVerlet
from hnn_vi_ros.integrators.runge_kutta import ExplicitEuler, RK4
from hnn_vi_ros.integrators.stormer_verlet import StormerVerlet
from hnn_vi_ros.integrators.symplectic_euler import SymplecticEuler, SymplecticEulerAdjoint
from hnn_vi_ros.integrators.taylor import Taylor
from hnn_vi_ros.integrators.time_transformed import TimeTransformed
from hnn_vi_ros.integrators.variational_euler import VariationalEuler
from hnn_vi_ros.integrators.variational_midpoint import VariationalMidpoint

INTEGRATORS: dict[str, type[Integrator]] = {
    'variational_euler': VariationalEuler,
    'symplectic_euler': SymplecticEuler,
    'symplectic_euler_adjoint': SymplecticEulerAdjoint,
    'generalized_leapfrog': GeneralizedLeapfrog,
    'stormer_verlet': StormerVerlet,
    'implicit_midpoint': ImplicitMidpoint,
    **GAUSS_METHODS,
    'yoshida4': Yoshida4,
    'suzuki4': Suzuki4,
    'kahan_li8': KahanLi8,
    'time_transformed': TimeTransformed,
    'discrete_euler_lagrange': DiscreteEulerLagrange,
    'discrete_gradient': DiscreteGradient,
    'variational_midpoint': VariationalMidpoint,
    'lie_variational_euler': LieVariationalEuler,
    'lie_symplectic_euler': LieSymplecticEuler,
    'lie_symplectic_euler_adjoint': LieSymplecticEulerAdjoint,
    'lie_leapfrog': LieLeapfrog,
    'lie_stormer_verlet': LieStormerVerlet,
    **LIE_GAUSS_METHODS,
    'explicit_euler': ExplicitEuler,
    'rk4': RK4,
    'dop853': Dop853,
    'taylor': Taylor,
}


def method_name(integrator: Integrator) -> str:
    """Return the name of a method in a scene, with its base if it has several."""
    name = next((key for key, method in INTEGRATORS.items() if type(integrator) is method),
                type(integrator).__name__)
    return f'{name} over {integrator.base.kernel_name}' \
        if isinstance(integrator, Composition) else name


def methods_that(can: Callable[[Integrator], bool], hamiltonian: Hamiltonian) -> str:
    """Return the names of the methods that support H and satisfy a condition, with commas."""
    methods = ((name, kind()) for name, kind in INTEGRATORS.items()
               if kind.requirements.hamiltonian)
    return ', '.join(name for name, method in methods
                     if not method.refusal(hamiltonian) and can(method)) or 'none for this H'


def check_method(integrator: Integrator, hamiltonian: Hamiltonian) -> None:
    """
    Check that a method can integrate a Hamiltonian.

    Raises
    ------
    UnsupportedSystem
        The method does not apply; the message names the methods that do.

    """
    problem = integrator.refusal(hamiltonian)
    if problem:
        able = methods_that(lambda method: True, hamiltonian)
        raise UnsupportedSystem(f'{method_name(integrator)} {problem}; valid methods: {able}')
