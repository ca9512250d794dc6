# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Steps of eq. (6) where it has no solution, taken in the staggered pair."""

from hnn_vi_ros.hamiltonians.base import Kernel
from hnn_vi_ros.integrators.base import Memory, NO_SOLUTION, OK, Point
from hnn_vi_ros.integrators.modified_midpoint import ModifiedMidpoint
from hnn_vi_ros.integrators.staggered import StaggeredMomentum
from hnn_vi_ros.loops import advance, assemble, take_substeps
import numpy as np

# Of a step, for the motion in H~: it is kept to the square of their length.
_PARTS = 16
# The chain's link that follows the solution from h = 0.
_FOLLOW = 1


class StaggeredRescue:
    """
    A o Psi_sub o A^-1 in place of a step A o Psi o A^-1 of eq. (6).

    In the staggered pair (q, P), with P = p + h H_q(q, p), the map Psi is the symplectic Euler
    method, which nearly conserves H~ = H - (h / 2) H_q . H_p; Psi_sub is the motion in that H~. It
    goes on where A has no solution, as where it folds over: det(I + h H_qp) changes its sign. P is
    then kept, as the momentum that the next step goes on from, and the state holds the momentum
    up to which A can be followed from h = 0.

    Parameters
    ----------
    kernel : Kernel
        The Hamiltonian, without channels.

    """

    def __init__(self, kernel: Kernel):
        self._kernel, self._half = kernel, StaggeredMomentum()

    def take_step(self, h: float, z: Point, z1: Point, memory: Memory) -> tuple[bool, int]:
        """
        Take a step from z, which is changed; return whether it was taken, and its gradients.

        Parameters
        ----------
        h : float
            Step size [s].
        z, z1 : Point
            The state, and working space.
        memory : Memory
            Of the method's equation; holds P while that is kept.

        """
        kernel, at, n = self._kernel, Point.empty(z.q.size), z.q.size
        at.q[:], at.q_carry[:] = z.q, z.q_carry
        at.p[:] = memory.candidate if memory.count[1] == 3 else z.p + h * z.dH_dq
        method = ModifiedMidpoint(-0.5 * h)
        loop, step, options = assemble(take_substeps, kernel, method)
        ok, gradients = loop(step, kernel, h, options, _PARTS, at, z1, method.memory(n))
        if not ok:
            return False, gradients
        loop, step, options = assemble(advance, kernel, self._half, _FOLLOW)
        q, p = np.empty((2, 1, n))
        staggered = at.p.copy()
        outcome, _, more, _, _ = loop(
            step, kernel, h, options, 0, 1, at, z1, self._half.memory(n), q, p)
        if outcome not in (OK, NO_SOLUTION) or not np.isfinite(z1.p).all():
            return False, gradients + more
        z.q[:], z.q_carry[:], z.p[:], z.p_carry[:] = at.q, at.q_carry, z1.p, 0.0
        kernel.gradient(kernel.parameters, z.q, z.p, z.dH_dq, z.dH_dp)
        memory.candidate[:] = staggered
        memory.count[0], memory.count[1] = 0, 0 if outcome == OK else 3
        return True, gradients + more + 1
