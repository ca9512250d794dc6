# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Steps that are cut where a coordinate meets a wall."""

from collections.abc import Callable

from hnn_vi_ros.compilation import called, inlined
from hnn_vi_ros.effects.wrapped import energy_of, scratch
from hnn_vi_ros.hamiltonians.base import Kernel
from hnn_vi_ros.integrators.arithmetic import copy_point
from hnn_vi_ros.integrators.base import Memory, NO_CONVERGENCE, OK, Point
import numpy as np

_EPS = float(np.finfo(np.float64).eps)
# Impacts in one step before a body is taken to rest, or the step for too long.
_IMPACTS = 8
_NEWTON_ITERATIONS = 50


def bounce(step: Callable) -> Callable:
    """Return a step for one trajectory that turns a velocity at a wall; see Impact."""
    @inlined
    def bouncing(kernel: Kernel, h: float, options: tuple, z: Point, z1: Point,
                 memory: tuple[Memory, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        inner, (c, position, sign, restitution, pending), live, effect = options
        start, resting = scratch(memory), memory[len(memory) - 1].count
        copy_point(z, start)
        pending[:] = live.pending
        draws, impacts, total = live.draws[1], 0, 0
        # A part of the step that ends in front of the wall, and one that does not.
        rest, low, high = h, 0.0, np.inf
        part = rest
        while True:
            outcome, residual, gradients = step(kernel, part, inner, start, z1, memory[:-1])
            total += gradients
            if outcome != OK:
                return outcome, residual, total
            free = sign * (z1.q[c] - position) >= 0.0
            if part == rest and free:
                resting[0] = 0
                return OK, residual, total
            if impacts == _IMPACTS and restitution == 1.0:
                return NO_CONVERGENCE, residual, total
            if resting[0] == 1 or impacts == _IMPACTS:
                # Here the part is all that is left of the step.
                resting[0] = 1
                work = _turn(kernel, z1, c, position, 0.0)
                live.pending[effect] += work
                return NO_CONVERGENCE if np.isnan(work) else OK, residual, total
            if high - low <= _EPS * h:
                # As near to the wall as time resolves.
                work = _turn(kernel, z1, c, position, restitution)
                if np.isnan(work):
                    return NO_CONVERGENCE, residual, total
                live.pending[effect] += work
                copy_point(z1, start)
                pending[:] = live.pending
                draws, impacts = live.draws[1], impacts + 1
                rest, low, high = rest - part, 0.0, np.inf
                part = rest
                if rest <= 0.0:
                    return OK, residual, total
            else:
                low, high = (part, high) if free else (low, part)
                part = 0.5 * (low + high)
            live.pending[:] = pending
            live.draws[1] = draws
            for k in range(len(memory) - 1):
                # Steps of other lengths are no guide to the next start.
                memory[k].count[0] = 0
    return bouncing


@called
def _turn(kernel: Kernel, z: Point, c: int, position: float, restitution: float) -> float:
    """
    Set q_c on the wall and p_c so that the velocity v_c becomes -e v_c; return the work [J].

    NaN if no such momentum is found.
    """
    before = energy_of(kernel, z)
    z.q[c], z.q_carry[c] = position, 0.0
    kernel.gradient(kernel.parameters, z.q, z.p, z.dH_dq, z.dH_dp)
    speed = z.dH_dp[c]
    target = -restitution * speed
    # Of each Hessian-vector product only H_pp is of interest.
    unit, zero = np.zeros_like(z.p), np.zeros_like(z.p)
    product_q, product_p = np.zeros_like(z.p), np.zeros_like(z.p)
    unit[c] = 1.0
    previous = np.inf
    for _ in range(_NEWTON_ITERATIONS):
        error = abs(z.dH_dp[c] - target)
        if error <= _EPS * abs(speed) or (error >= previous and error <= 64 * _EPS * abs(speed)):
            return energy_of(kernel, z) - before
        previous = error
        kernel.hessian_vector(
            kernel.parameters, z.q, z.p, zero, unit, product_q, product_p)
        if not product_p[c] > 0.0:
            break
        z.p[c] -= (z.dH_dp[c] - target) / product_p[c]
        z.p_carry[c] = 0.0
        kernel.gradient(kernel.parameters, z.q, z.p, z.dH_dq, z.dH_dp)
    return np.nan
