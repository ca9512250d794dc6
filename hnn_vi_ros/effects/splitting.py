# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Strang splitting: half a step of an effect's flow before and after a method's step."""

from collections.abc import Callable
import math
from typing import Any

from hnn_vi_ros.effects.wrapped import energy_of
from hnn_vi_ros.integrators import copy_point, OK, PhasePoint, Step
from hnn_vi_ros.kernels import inlined, Kernel, Parameters


def strang(flow: Callable[..., None], step: Step, keeps_gradient: bool) -> Step:
    """
    Return flow(h/2) o step(h) o flow(h/2), symmetric if the step is, and of order at most 2.

    Parameters
    ----------
    flow : callable
        ``flow(parameters, h, q, p, p_carry)`` changes one state; arrays have shape (d,).
    step : callable
        The step of the method.
    keeps_gradient : bool
        True if the step reads the gradient at its start.

    References
    ----------
    G. Strang, On the construction and comparison of difference schemes, SIAM J. Numer. Anal. 5
    (1968).

    """
    @inlined
    def half_flow(kernel: Kernel, h: float, parameters: Parameters, z: PhasePoint) -> float:
        """Change the state, and return the work."""
        before = energy_of(kernel, z)
        d = kernel.dimension - kernel.channels
        for a in range(0, z.q.size, kernel.dimension):
            b = a + d
            flow(parameters, 0.5 * h, z.q[a:b], z.p[a:b], z.p_carry[a:b])
        return energy_of(kernel, z) - before

    @inlined
    def split(kernel: Kernel, h: float, options: Parameters, z: PhasePoint, z1: PhasePoint,
              memory: tuple[Any, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        inner, parameters, state, effect = options
        start, more = memory[-1].point, 0
        copy_point(z, start)
        state.pending[effect] += half_flow(kernel, h, parameters, start)
        if keeps_gradient:
            kernel.gradient(kernel.parameters, start.q, start.p, start.dH_dq, start.dH_dp)
            more = 1
        outcome, residual, gradients = step(kernel, h, inner, start, z1, memory[:-1])
        if outcome == OK:
            state.pending[effect] += half_flow(kernel, h, parameters, z1)
        return outcome, residual, gradients + more
    return split


def largest_gain(mass: float, damping: float, h: float) -> float:
    """
    Return the largest gain for which the splitting of an observer is stable at a step size.

    Half a flow, the motion of a free mass m, and another half flow map (q - y, p) with the
    determinant exp(-lambda h); both eigenvalues have modulus at most 1 up to k = (2 m lambda / h)
    coth(lambda h / 2), which is 4 m / h^2 without damping.

    Parameters
    ----------
    mass : float
        m [kg], [kg m2].
    damping : float
        lambda [1/s].
    h : float
        Step size [s].

    """
    half = 0.5 * damping * h
    return 4.0 * mass / h**2 * (half / math.tanh(half) if half > 0.0 else 1.0)
