# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Steps that a symmetric controller makes shorter where forces are strong."""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

from hnn_vi_ros.integrators.arithmetic import copy_point, plus
from hnn_vi_ros.integrators.base import ENDLESS, NOT_FINITE, OK, Point
from hnn_vi_ros.integrators.workspaces import forget
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.kernels.marks import inlined
import numpy as np

# Steps of its own in one step of the clock, beyond which it is given up.
_MOST_STEPS = 100_000


class Ahead(NamedTuple):
    """
    State from which the next step of the clock continues.

    Parameters
    ----------
    count : np.ndarray, shape (1,)
        1 if there is such a state, 0 before the first step.
    clock : np.ndarray, shape (3,)
        The density of steps [1], how far the state is ahead of the clock [s], and what was
        rounded off that.
    state : Point
        At a time of its own.

    """

    count: np.ndarray  # type: ignore[assignment]  # not tuple.count
    clock: np.ndarray
    state: Point


class ControlledWork(NamedTuple):
    """
    The workspace of a clock; arrays of shape (n,).

    Parameters
    ----------
    kept : Ahead
        For the next step of the clock.
    own_step : np.ndarray, shape (1,)
        The steps of the base where the density is 1, 0 for the steps of the clock [s].
    at : Point
        The state that a step of the base begins with.
    v_q, v_p, change_q, change_p : np.ndarray
        The velocity, and the product of H'' with it.

    """

    kept: Ahead
    own_step: np.ndarray
    at: Point
    v_q: np.ndarray
    v_p: np.ndarray
    change_q: np.ndarray
    change_p: np.ndarray

    @classmethod
    def empty(cls, n: int, dtype: type = np.float64) -> 'ControlledWork':
        """Return the workspace for n coordinates, before the first step."""
        kept = Ahead(np.zeros(1, dtype=np.int64), np.zeros(3, dtype), Point.empty(n, dtype))
        return cls(kept, np.zeros(1), Point.empty(n, dtype), *np.zeros((4, n), dtype))


@inlined
def own_length(own_step: np.ndarray, h: float) -> float:
    """Return the length of the base's steps: as long as that of the clock, unless it is given."""
    return own_step[0] if own_step[0] > 0.0 else h


@cache
def controlled(base_step: Callable) -> Callable:
    """
    Return the step of a clock that a symmetric method fills with steps of controlled size.

        rho_(n+1/2) = rho_(n-1/2) + h G(z_n),  z_(n+1) = Phi_(h / rho_(n+1/2))(z_n)
        G = d/dt log(1 / g) = a (H_q . dH_q/dt) / (F^2 + abs(H_q)^2)

    is an explicit rule of its own for the density rho of the steps, which follows 1 / g and reads
    the same backwards: with a symmetric base, the map of (z, rho) is symmetric, so that in a
    reversible motion the energy does not drift.

    The memory is that of the base twice, for states at the clock and for its own, then its own.

    References
    ----------
    E. Hairer, G. Söderlind, Explicit, time reversible, adaptive step size control, SIAM J. Sci.
    Comput. 26 (2005).

    """
    @inlined
    def step(kernel: Kernel, h: float, options: tuple, z: Point, z1: Point,
             memory: tuple) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        inner, force, exponent = options
        at_clock, own, work = memory[0:1], memory[1:2], memory[2]
        ahead, at, clock = work.kept.state, work.at, work.kept.clock
        fresh = work.kept.count[0] == 0
        if fresh:
            forget(own)
            copy_point(z, ahead)
            clock[0], clock[1], clock[2] = 0.0, 0.0, 0.0
        copy_point(ahead, at)
        own_step = own_length(work.own_step, h)
        worst, gradients, density, time, carry = 0.0, 0, clock[0], clock[1], clock[2]
        for _ in range(_MOST_STEPS):
            if time >= h:
                break
            kernel.gradient(kernel.parameters, at.q, at.p, at.dH_dq, at.dH_dp)
            rate, square = _rate(kernel, at, force, exponent, work)
            if fresh:
                # 1 / g at the start, and from there half a step back.
                density = (1.0 + square) ** (0.5 * exponent) - 0.5 * own_step * rate
                fresh = False
            density += own_step * rate
            if not density > 0.0:
                return NOT_FINITE, worst, gradients
            outcome, residual, more = base_step(kernel, own_step / density, inner, at, z1, own)
            worst, gradients = max(worst, residual), gradients + 2 + more
            if outcome != OK:
                return outcome, residual, gradients
            time, carry = plus(time, carry, own_step / density)
            copy_point(z1, at)
        if time < h:
            return ENDLESS, worst, gradients
        kernel.gradient(kernel.parameters, at.q, at.p, at.dH_dq, at.dH_dp)
        forget(at_clock)
        outcome, residual, more = base_step(kernel, h - time, inner, at, z1, at_clock)
        worst, gradients = max(worst, residual), gradients + more + 1
        if outcome == OK:
            copy_point(at, ahead)
            clock[0], clock[1], clock[2] = density, time - h, carry
            work.kept.count[0] = 1
        return outcome, worst, gradients
    return step


@inlined
def _rate(kernel: Kernel, at: Point, force: float, exponent: float, work: ControlledWork
          ) -> tuple[float, float]:
    """Return G, and abs(H_q)^2 / F^2, at a state whose gradient is known."""
    v_q, v_p, change_q, change_p = work.v_q, work.v_p, work.change_q, work.change_p
    for i in range(at.q.size):
        v_q[i], v_p[i] = at.dH_dp[i], -at.dH_dq[i]
    # The derivative of H_q in time: H'' times the velocity (H_p, -H_q).
    kernel.hessian_vector(kernel.parameters, at.q, at.p, v_q, v_p, change_q, change_p)
    square, product = 0.0, 0.0
    for i in range(at.q.size):
        square += (at.dH_dq[i] / force) ** 2
        product += at.dH_dq[i] * change_q[i] / force ** 2
    return exponent * product / (1.0 + square), square
