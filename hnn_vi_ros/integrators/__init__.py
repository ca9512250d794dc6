# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Integrators: one step of each method, and the solvers of its equations.

``registry`` lists the methods under their names in scenes. Loops over steps, and what happens when
a step fails, are in ``simulation``.
"""

from typing import TYPE_CHECKING

from hnn_vi_ros.exports import lazy_exports

if TYPE_CHECKING:
    from hnn_vi_ros.integrators.arithmetic import copy_array, copy_point, is_finite, largest, plus
    from hnn_vi_ros.integrators.base import (
        BEYOND, IN_DOUBT, Integrator, NO_CONVERGENCE, NO_IMPACT, NO_MASS, NO_SOLUTION, Node,
        NOT_FINITE, NOT_HELD, OK, ON_FAILURE, PartitionedTableau, PhasePoint, PointWork, REASONS,
        REDUNDANT, Requirements, Step, step_failure)
    from hnn_vi_ros.integrators.composition import Composition
    from hnn_vi_ros.integrators.dense_output import (
        bend_at, collocation_output, cubic, DenseOutput, hermite_output, quintic, slope_at,
        value_at, WHOLE)
    from hnn_vi_ros.integrators.dop853 import Dop853, PairWork, path_in_legendre
    from hnn_vi_ros.integrators.equations import LEAST_SCALE, set_scale
    from hnn_vi_ros.integrators.gauss import Gauss, GAUSS_METHODS, gauss_tableau, Tableau
    from hnn_vi_ros.integrators.implicit import ImplicitIntegrator
    from hnn_vi_ros.integrators.implicit_midpoint import ImplicitMidpoint
    from hnn_vi_ros.integrators.lie.equations import LieIntegrator
    from hnn_vi_ros.integrators.lie.lie_gauss import LIE_GAUSS_METHODS
    from hnn_vi_ros.integrators.lie.rotations import cayley, Coefficients
    from hnn_vi_ros.integrators.newton_solver import newton
    from hnn_vi_ros.integrators.registry import (
        check_method, INTEGRATORS, method_name, methods_that)
    from hnn_vi_ros.integrators.solvers import (
        anderson, BACK, COMMON, fixed_point, GO_ON, OWN, QUICK, SolverOptions)
    from hnn_vi_ros.integrators.step_addresses import (
        CALLERS, memory_by_address, steps_by_address, StepsByAddress)
    from hnn_vi_ros.integrators.taylor import Taylor, TaylorWork
    from hnn_vi_ros.integrators.variational_midpoint import VariationalMidpoint
    from hnn_vi_ros.integrators.workspaces import (
        arrays_of, DEPTH, discard_history, FAST_MATRIX, LARGEST_MATRIX, mark_commanded,
        mark_independent, MemoryByAddress, SolverWork)

__getattr__, __dir__ = lazy_exports(__name__)
