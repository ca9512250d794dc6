# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Steps that a symmetric controller makes shorter where forces are strong."""

from collections.abc import Callable
from functools import cache

from hnn_vi_ros.integrators.arithmetic import copy_point, plus
from hnn_vi_ros.integrators.base import Memory, NO_CONVERGENCE, NOT_FINITE, OK, Point
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.kernels.marks import inlined

# Steps of its own in one step of the clock, beyond which it is given up.
_MOST_STEPS = 100_000


@cache
def controlled(base_step: Callable) -> Callable:
    """
    Return the step of a clock that a symmetric method fills with steps of controlled size.

        rho_(n+1/2) = rho_(n-1/2) + h G(z_n),  z_(n+1) = Phi_(h / rho_(n+1/2))(z_n)
        G = d/dt log(1 / g) = a (H_q . dH_q/dt) / (F^2 + abs(H_q)^2)

    is an explicit rule of its own for the density rho of the steps, which follows 1 / g and reads
    the same backwards: with a symmetric base, the map of (z, rho) is symmetric, so that in a
    reversible motion the energy does not drift.

    The memory is that of the base twice, for states at the clock and for its own, and space.

    References
    ----------
    E. Hairer, G. Söderlind, Explicit, time reversible, adaptive step size control, SIAM J. Sci.
    Comput. 26 (2005).

    """
    @inlined
    def step(kernel: Kernel, h: float, options: tuple, z: Point, z1: Point,
             memory: tuple[Memory, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        inner, force, exponent = options
        own, store = memory[1:2], memory[2]
        ahead = Point(store.values[0], store.values[1], store.values[2], store.values[3],
                      store.residuals[0], store.residuals[1])
        at = Point(store.basis[0], store.basis[1], store.basis[2], store.basis[3],
                   store.residuals[2], store.residuals[3])
        # The density, and how far the state is ahead of the clock, with what was rounded off that.
        kept = store.triangle[0]
        fresh = store.count[0] == 0
        if fresh:
            own[0].count[0] = 0
            copy_point(z, ahead)
            kept[0], kept[1], kept[2] = 0.0, 0.0, 0.0
        copy_point(ahead, at)
        worst, gradients, density, time, carry = 0.0, 0, kept[0], kept[1], kept[2]
        for _ in range(_MOST_STEPS):
            if time >= h:
                break
            kernel.gradient(kernel.parameters, at.q, at.p, at.dH_dq, at.dH_dp)
            rate, square = _rate(kernel, at, force, exponent, store)
            if fresh:
                # 1 / g at the start, and from there half a step back.
                density = (1.0 + square) ** (0.5 * exponent) - 0.5 * h * rate
                fresh = False
            density += h * rate
            if not density > 0.0:
                return NOT_FINITE, worst, gradients
            outcome, residual, more = base_step(kernel, h / density, inner, at, z1, own)
            worst, gradients = max(worst, residual), gradients + 2 + more
            if outcome != OK:
                return outcome, residual, gradients
            time, carry = plus(time, carry, h / density)
            copy_point(z1, at)
        if time < h:
            return NO_CONVERGENCE, worst, gradients
        kernel.gradient(kernel.parameters, at.q, at.p, at.dH_dq, at.dH_dp)
        memory[0].count[0] = 0
        outcome, residual, more = base_step(kernel, h - time, inner, at, z1, memory[0:1])
        worst, gradients = max(worst, residual), gradients + more + 1
        if outcome == OK:
            copy_point(at, ahead)
            kept[0], kept[1], kept[2], store.count[0] = density, time - h, carry, 1
        return outcome, worst, gradients
    return step


@inlined
def _rate(kernel: Kernel, at: Point, force: float, exponent: float, store: Memory
          ) -> tuple[float, float]:
    """Return G, and abs(H_q)^2 / F^2, at a state whose gradient is known."""
    v_q, v_p, change_q, change_p = store.unknowns, store.base, store.scale, store.newton
    for i in range(at.q.size):
        v_q[i], v_p[i] = at.dH_dp[i], -at.dH_dq[i]
    # The derivative of H_q in time: H'' times the velocity (H_p, -H_q).
    kernel.hessian_vector(kernel.parameters, at.q, at.p, v_q, v_p, change_q, change_p)
    square, product = 0.0, 0.0
    for i in range(at.q.size):
        square += (at.dH_dq[i] / force) ** 2
        product += at.dH_dq[i] * change_q[i] / force ** 2
    return exponent * product / (1.0 + square), square
