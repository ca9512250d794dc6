# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The midpoint rule for the action of a one-form and an energy, in any coordinates."""

from typing import Any

from hnn_vi_ros import models
from hnn_vi_ros.integrators.arithmetic import largest
from hnn_vi_ros.integrators.base import PhasePoint, Requirements
from hnn_vi_ros.integrators.discrete_gradient import (
    discrete_factor, EndProblem, EnergyConserving, fill_end, fill_middle, step_to_end)
from hnn_vi_ros.kernels import inlined, Kernel
import numpy as np


@inlined
def _set_scale(scale: np.ndarray, kernel: Kernel, h: float, z: PhasePoint) -> None:
    """
    Set the scale of q and p of each trajectory.

    D contains the rounding of H over abs(u1 - u0), which W^-1 converts to one of u'.
    """
    n, d = z.q.size, kernel.dimension
    form: Any = kernel.parameters
    for a in range(0, n, d):
        slope_q, slope_p = largest(z.dH_dp[a:a + d]), largest(z.dH_dq[a:a + d])
        fastest = max(slope_q, slope_p)
        rounding = form.energy_rounding * form.inverse_norm / fastest if fastest > 0.0 else 0.0
        for i in range(a, a + d):
            scale[i] = max(largest(z.q[a:a + d]), abs(h) * slope_q,
                           abs(h) * kernel.gradient_scale[1], rounding)
            scale[n + i] = max(largest(z.p[a:a + d]), abs(h) * slope_p,
                               abs(h) * kernel.gradient_scale[0], rounding)


@inlined
def _equation(problem: EndProblem, x: np.ndarray, value: np.ndarray) -> None:
    kernel, z, n = problem.kernel, problem.z, problem.z.q.size
    d, middle = kernel.dimension, problem.middle
    fill_middle(problem, x)
    for a in range(0, n, d):
        b = a + d
        # Covector and rates of each trajectory are adjacent until they are sorted below.
        covector = value[2 * a:2 * b]
        # Accessed through its package, which is already loaded, since H comes from it. An import
        # in this file would load the compiler even to read a scene.
        models.symplectic_form.slope(kernel.parameters, middle[a:b], middle[n + a:n + b], covector)
        factor = discrete_factor(problem, x, a, covector[:d], covector[d:])
        for i in range(d):
            covector[i] += factor * (x[a + i] - z.q[a + i])
            covector[d + i] += factor * (x[n + a + i] - z.p[a + i])
        models.symplectic_form.raise_index(
            kernel.parameters, middle[a:b], middle[n + a:n + b], covector)
        for i in range(d):
            problem.rates[a + i], problem.rates[n + a + i] = covector[i], covector[d + i]
    fill_end(problem, value)


class VariationalMidpoint(EnergyConserving):
    """
    Midpoint rule for the action of theta(u) . u' - H(u): W(u~) (u1 - u0) = h D(u0, u1).

    With u~ = (u0 + u1) / 2 the discrete Lagrangian is L_d = theta(u~) . (u1 - u0) - h H(u~). The
    sum and difference of its two equations p0 = -D_1 L_d, p1 = D_2 L_d are

        (p0 + p1) / 2 = theta(u~),  p1 - p0 = theta'(u~)^T (u1 - u0) - h H'(u~).

    L is linear in u', so that p is not free: p = theta(u). The two equations satisfy it only at
    midpoints. Taken literally, they have twice as many solutions as there are motions; the
    spurious ones alternate in sign from step to step, and may grow: with a gradient added to
    theta, which changes no motion, a double pendulum diverges within 2 s. So p = theta(u) replaces
    the first equation, and theta(u1) - theta(u0) = theta'(u~) (u1 - u0), to the order of the
    method, is used in the second one: with W = theta'^T - theta'

        W(u~) (u1 - u0) = h H'(u~),

    a one-step map that does not depend on gradients in theta. W is skew, so
    (u1 - u0) . H'(u~) = 0, and H changes by terms of third order, which need not cancel without
    time reversal. Therefore D is the midpoint discrete gradient of H, which is H'(u~) up to those
    terms; see DiscreteGradient. Then (u1 - u0) . D = H(u1) - H(u0) = 0: the energy is conserved up
    to the rounding of H.

    Symmetric, order 2, not symplectic; for models of the family `symplectic_form`. If W is
    constant, it is DiscreteGradient in canonical coordinates.

    References
    ----------
    Y. Chen, T. Matsubara, T. Yaguchi, Neural Symplectic Form, NeurIPS 2021.
    M. Kraus, Projected variational integrators for degenerate Lagrangian systems, 2017,
    arXiv:1708.07356, on the solutions that grow.
    D. Cohen, E. Hairer, Linear energy-preserving integrators for Poisson systems, BIT 51 (2011).

    """

    requirements = Requirements(symmetric=True, symplectic=False, coordinates='other',
                                forces=False)
    step = staticmethod(step_to_end(_set_scale, _equation))
