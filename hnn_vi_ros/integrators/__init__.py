# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Integrators, by the name that a scene's YAML gives them."""

from hnn_vi_ros.integrators.composition import Suzuki4, Yoshida4
from hnn_vi_ros.integrators.discrete_euler_lagrange import DiscreteEulerLagrange
from hnn_vi_ros.integrators.discrete_gradient import DiscreteGradient
from hnn_vi_ros.integrators.dop853 import DOP853
from hnn_vi_ros.integrators.explicit_euler import ExplicitEuler
from hnn_vi_ros.integrators.gauss import GAUSS_METHODS
from hnn_vi_ros.integrators.generalized_leapfrog import GeneralizedLeapfrog
from hnn_vi_ros.integrators.implicit_midpoint import ImplicitMidpoint
from hnn_vi_ros.integrators.rk4 import RK4
from hnn_vi_ros.integrators.stormer_verlet import StormerVerlet
from hnn_vi_ros.integrators.symplectic_euler import SymplecticEuler
from hnn_vi_ros.integrators.symplectic_euler_adjoint import SymplecticEulerAdjoint
from hnn_vi_ros.integrators.time_transformed import TimeTransformed
from hnn_vi_ros.integrators.variational_euler import VariationalEuler
from hnn_vi_ros.integrators.variational_midpoint import VariationalMidpoint

INTEGRATORS = {
    'variational_euler': VariationalEuler,
    'symplectic_euler': SymplecticEuler,
    'symplectic_euler_adjoint': SymplecticEulerAdjoint,
    'generalized_leapfrog': GeneralizedLeapfrog,
    'stormer_verlet': StormerVerlet,
    'implicit_midpoint': ImplicitMidpoint,
    **GAUSS_METHODS,
    'yoshida4': Yoshida4,
    'suzuki4': Suzuki4,
    'time_transformed': TimeTransformed,
    'discrete_euler_lagrange': DiscreteEulerLagrange,
    'discrete_gradient': DiscreteGradient,
    'variational_midpoint': VariationalMidpoint,
    'explicit_euler': ExplicitEuler,
    'rk4': RK4,
    'dop853': DOP853,
}
