# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The motion by which a step of an Euler-type method is replaced where it has no solution."""

from hnn_vi_ros.compilation import inlined
from hnn_vi_ros.hamiltonians.base import Kernel
from hnn_vi_ros.integrators.arithmetic import largest
from hnn_vi_ros.integrators.base import Integrator, Memory, OK, Point
from hnn_vi_ros.integrators.implicit_midpoint import ImplicitMidpoint
import numpy as np

# Compiled code knows functions, not the classes that hold them.
_midpoint_step = ImplicitMidpoint.step
# Spacing of the difference of gradients that stands for the second derivatives of H~.
_SPACING = float(np.finfo(np.float64).eps) ** (1.0 / 3.0)


class ModifiedMidpoint(Integrator):
    """
    The implicit midpoint rule for H~ = H + c H_q . H_p, which methods of order 1 nearly conserve.

    Its steps are parts of one step of that method, and c is half the length of that, or its
    negative. Symplectic, symmetric, of order 2 for the motion in H~: the more parts, the better
    H~ is kept; the motion in H would change it by O(h) for good. (H_q . H_p)' = H'' (H_p, H_q).

    Parameters
    ----------
    extent : float
        c [s].

    """

    order, explicit, symmetric, symplectic = 2, False, True, True
    takes_forces = False

    def __init__(self, extent: float):
        self._base, self._extent = ImplicitMidpoint(), float(extent)

    def options(self, link: int = 0, dimension: int = 1) -> tuple:
        """Return the options of the midpoint rule, and c."""
        return (self._base.options(link, dimension), self._extent)

    def unknowns(self, n: int) -> tuple[int, ...]:
        """Return the equation of the midpoint rule, and the space of the gradient."""
        return (*self._base.unknowns(n), n)

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: tuple, z: Point, z1: Point,
             memory: tuple[Memory, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        solver, extent = options
        modified = Kernel(kernel.energy, _gradient, _hessian_vector, (kernel, memory[1], extent),
                          kernel.dimension, kernel.gradient_scale, kernel.compiled, 0, 0.0)
        outcome, residual, gradients = _midpoint_step(modified, h, solver, z, z1, memory[0:1])
        if outcome == OK:
            modified.gradient(modified.parameters, z1.q, z1.p, z1.dH_dq, z1.dH_dp)
        # Each evaluation takes a gradient of H and a product with its second derivatives.
        return outcome, residual, 2 * (gradients + 1)


@inlined
def _gradient(parameters: tuple, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
              dH_dp: np.ndarray) -> None:
    """Fill the gradient of H~."""
    kernel, space, extent = parameters
    f_q, f_p, w_q, w_p = space.values[0], space.values[1], space.values[2], space.values[3]
    kernel.gradient(kernel.parameters, q, p, f_q, f_p)
    kernel.hessian_vector(kernel.parameters, q, p, f_p, f_q, w_q, w_p)
    for i in range(q.size):
        dH_dq[i], dH_dp[i] = f_q[i] + extent * w_q[i], f_p[i] + extent * w_p[i]


@inlined
def _hessian_vector(parameters: tuple, q: np.ndarray, p: np.ndarray, v_q: np.ndarray,
                    v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
    """Fill H~'' v from a central difference: good enough for Newton's method to converge."""
    space = parameters[1]
    size = max(largest(v_q), largest(v_p))
    spacing = _SPACING * max(largest(q), largest(p), 1.0) / size if size > 0.0 else 1.0
    at_q, at_p = space.basis[0], space.basis[1]
    back_q, back_p = space.basis[2], space.basis[3]
    for i in range(q.size):
        at_q[i], at_p[i] = q[i] - spacing * v_q[i], p[i] - spacing * v_p[i]
    _gradient(parameters, at_q, at_p, back_q, back_p)
    for i in range(q.size):
        at_q[i], at_p[i] = q[i] + spacing * v_q[i], p[i] + spacing * v_p[i]
    _gradient(parameters, at_q, at_p, product_q, product_p)
    for i in range(q.size):
        product_q[i] = (product_q[i] - back_q[i]) / (2.0 * spacing)
        product_p[i] = (product_p[i] - back_p[i]) / (2.0 * spacing)
