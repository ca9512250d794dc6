# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The leapfrog on a group: the symmetric method of order 2 for rotations."""

from hnn_vi_ros.integrators.base import OK, Point, PointWork
from hnn_vi_ros.integrators.lie.base import LieIntegrator
from hnn_vi_ros.integrators.lie.equations import GroupWork, LieOptions
from hnn_vi_ros.integrators.lie.lie_symplectic_euler import LieSymplecticEuler
from hnn_vi_ros.integrators.lie.lie_symplectic_euler_adjoint import LieSymplecticEulerAdjoint
from hnn_vi_ros.integrators.requirements import Requirements
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.kernels.marks import inlined
import numpy as np

# Compiled code knows functions, not the classes that hold them.
_first_step, _second_step = LieSymplecticEuler.step, LieSymplecticEulerAdjoint.step


class LieLeapfrog(LieIntegrator):
    """
    Half a step of LieSymplecticEuler, then half a step of its adjoint.

    Symplectic, symmetric, order 2; for scalar coordinates it is GeneralizedLeapfrog. Where H does
    not depend on g it keeps the spatial momentum.
    """

    order = 2
    requirements = Requirements(symmetric=True, symplectic=True, coordinates='group')

    def unknowns(self, n: int) -> tuple[int, ...]:
        """Return the sizes of the equations for the momenta and for the turns."""
        return (n, n)

    def memory(self, n: int, dtype: type = np.float64) -> tuple:
        """Return the workspaces of the two equations, and the point between them."""
        return (GroupWork.empty(n, dtype), GroupWork.empty(n, dtype),
                PointWork(Point.empty(n, dtype)))

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: LieOptions, z: Point, z1: Point,
             memory: tuple) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        middle = memory[2].point
        outcome, residual, gradients = _first_step(
            kernel, 0.5 * h, options, z, middle, memory[:1])
        if outcome != OK:
            return outcome, residual, gradients
        outcome, residual_turn, more = _second_step(
            kernel, 0.5 * h, options, middle, z1, memory[1:])
        return outcome, max(residual, residual_turn), gradients + more
