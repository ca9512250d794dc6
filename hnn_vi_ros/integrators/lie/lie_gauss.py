# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Gauss collocation on a group: variational integrators of any even order for rotations."""

from typing import NamedTuple

from hnn_vi_ros.integrators.arithmetic import plus
from hnn_vi_ros.integrators.base import OK, PhasePoint, PointWork, Requirements, TURNED
from hnn_vi_ros.integrators.equations import set_scale
from hnn_vi_ros.integrators.gauss import Collocation, orders_of, Tableau
from hnn_vi_ros.integrators.lie.equations import (
    add_bend, fill_forces, FURTHEST, FURTHEST_CAYLEY, move, set_turn_scale, turns_beyond)
from hnn_vi_ros.integrators.lie.rotations import cayley, cross, dot
from hnn_vi_ros.integrators.newton_solver import by_differences
from hnn_vi_ros.integrators.workspaces import SolverWork
from hnn_vi_ros.kernels import called, inlined, Kernel
import numpy as np


class GaussSlopes(NamedTuple):
    """
    Slopes used for the initial guess of the next step.

    Parameters
    ----------
    count : np.ndarray, shape (1,)
        1 if slopes of a previous step are stored, else 0.
    slopes : np.ndarray, shape (2 s n,)
        Rates of x at all stages, then rates of P.
    end : np.ndarray, shape (n,)
        x at the end of that step.

    """

    count: np.ndarray  # type: ignore[assignment]  # not tuple.count
    slopes: np.ndarray
    end: np.ndarray


class LieGaussWork(NamedTuple):
    """
    Workspace of the equation for the stages.

    Parameters
    ----------
    kept : GaussSlopes
        Slopes for the next initial guess.
    solver : SolverWork
        Arrays of the solvers.
    stages : np.ndarray, shape (2 s n,)
        x at all stages, then P.
    q, mu, dH_dq, dH_dp : np.ndarray, shape (s n,)
        Coordinates, momenta in body frames, and gradient of H at the stages.
    forces, torque, end, momenta : np.ndarray, shape (n,)
        g^* H_g of one stage; the weighted sum over all stages, for rotations in the frame of the
        start; x and P at the end of the step.
    ahead, behind : np.ndarray, shape (2 s n,)
        Points of finite differences.

    """

    kept: GaussSlopes
    solver: SolverWork
    stages: np.ndarray
    q: np.ndarray
    mu: np.ndarray
    dH_dq: np.ndarray
    dH_dp: np.ndarray
    forces: np.ndarray
    torque: np.ndarray
    end: np.ndarray
    momenta: np.ndarray
    ahead: np.ndarray
    behind: np.ndarray


class _LieStageEquation(NamedTuple):
    """The equation for the stages of a step from z; ``by_differences`` uses the last field."""

    kernel: Kernel
    h: float
    matrix: np.ndarray
    weights: np.ndarray
    z: PhasePoint
    point: PhasePoint
    work: LieGaussWork
    scale: np.ndarray
    ahead: np.ndarray
    behind: np.ndarray


class LieGauss(Collocation):
    """
    Gauss collocation of s stages in the Cayley chart around the attitude of each step, order 2 s.

    In the chart g = g_k cay(x), with the momentum P = dcay_(-x)^* mu conjugate to x and
    K(x, P) = H(g_k cay(x), (dcay^-1_(-x))^* P), the stages are Gauss stages from x = 0 to x_1:

        X_i = h sum_j a_ij K_P(X_j, P_j),  P_i = P_1 + h sum_j (b_j - a_ij) K_x(X_j, P_j)
        (dcay^-1_(x_1))^* P_1 = pi_k - h sum_j b_j cay(X_j) g_j^* H_g(g_j, mu_j)
        g_(k+1) = g_k cay(x_1),  pi_(k+1) = (dcay^-1_(-x_1))^* P_1

    Variational integrator whose discrete action uses polynomials of degree s in the chart for the
    path, and Gauss quadrature. The second line is the derivative of the action by g_k, the origin
    of the chart: the balance of spatial momentum, which is conserved if H is independent of g.
    Symplectic; not symmetric, because the chart is that of the start. For scalar coordinates it is
    Gauss. Use it for accurate rotations. A rotation of 3 rad or more in one step fails.

    References
    ----------
    G. Bogfjellmo, H. Marthinsen, High-order symplectic partitioned Lie group methods, Found.
    Comput. Math. 16 (2016).

    """

    requirements = Requirements(symmetric=False, symplectic=True, coordinates='group')
    keeps_gradient, fallback = True, 'lie_leapfrog'
    kernel_name = 'LieGauss'

    def memory(self, n: int, dtype: type = np.float64) -> tuple:
        """Return the workspace of the equation, and the point of a stage."""
        (size,) = self.unknowns(n)
        kept = GaussSlopes(np.zeros(1, dtype=np.int64), np.zeros(size, dtype), np.zeros(n, dtype))
        return (LieGaussWork(
            kept, SolverWork.empty(size, dtype), np.zeros(size, dtype),
            *np.zeros((4, size // 2), dtype), *np.zeros((4, n), dtype),
            *np.zeros((2, size), dtype)), PointWork(PhasePoint.empty(n, dtype)))

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: Tableau, z: PhasePoint, z1: PhasePoint,
             memory: tuple) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        work, point, n, s = memory[0], memory[1].point, z.q.size, options.weights.size
        x, kept, forces, end = work.stages, work.kept, work.forces, work.end
        scale, own = work.solver.iterates.scale, work.solver.iterates.own_scale
        for i in range(n):
            end[i] = h * z.dH_dp[i]
        if turns_beyond(kernel, end, FURTHEST):
            kept.count[0] = 0
            return TURNED, np.inf, 0
        fill_forces(kernel, z.q, z.dH_dq, forces)
        set_turn_scale(kernel, h, z, end, scale[:n], own[:n])
        set_scale(scale[s * n:(s + 1) * n], own[s * n:(s + 1) * n], z.p, forces, h, kernel, 0)
        for i in range(n, s * n):
            scale[i], own[i] = scale[i - n], own[i - n]
            scale[s * n + i], own[s * n + i] = scale[s * n + i - n], own[s * n + i - n]
        _start(kernel, options, kept, z, h, x)
        problem = _LieStageEquation(kernel, h, options.matrix, options.weights, z, point, work,
                                    work.solver.iterates.scale, work.ahead, work.behind)
        outcome, residual, rounds = options.solver.solve(
            _equation, _tangent, problem, x, work.solver, options.solver.max_iterations)
        kept.count[0] = 0
        if outcome != OK:
            return outcome, residual, rounds * s
        for i in range(n):
            kept.end[i] = end[i]
        if turns_beyond(kernel, end, FURTHEST_CAYLEY):
            return TURNED, residual, rounds * s
        kept.count[0] = 1
        move(kernel, cayley, z, end, z1)
        _fill_momentum_changes(kernel, h, z, work)
        for i in range(n):
            z1.p[i], z1.p_carry[i] = plus(z.p[i], z.p_carry[i], forces[i])
        kernel.gradient(kernel.parameters, z1.q, z1.p, z1.dH_dq, z1.dH_dp)
        return OK, residual, rounds * s + 1


LIE_GAUSS_METHODS = {
    f'lie_gauss{method.order}': method for method in orders_of(LieGauss, ' on a group')}


@inlined
def _start(kernel: Kernel, options: Tableau, kept: GaussSlopes, z: PhasePoint, h: float,
           x: np.ndarray) -> None:
    """Set the initial guess from the last collocation polynomial, or from the state."""
    n, s, slopes, end = z.q.size, options.weights.size, kept.slopes, kept.end
    is_kept = kept.count[0] > 0 and options.solver.extrapolate
    for j in range(s):
        for i in range(n):
            change, momentum = 0.0, 0.0
            if is_kept:
                for k in range(s):
                    change += options.start[j, k] * slopes[k * n + i]
                    momentum += options.start[j, k] * slopes[(s + k) * n + i]
            x[j * n + i], x[(s + j) * n + i] = h * change, z.p[i] + h * momentum
    if is_kept:
        _change_chart(kernel, end, z, x, s)


@called
def _change_chart(kernel: Kernel, end: np.ndarray, z: PhasePoint, x: np.ndarray, s: int) -> None:
    """
    Transform rotations and momenta from the chart of the previous step to the present chart.

    On entry x contains changes since the end of the previous step in its chart; its momenta are P
    in that chart, minus P at the end of that step, plus pi there. The composition of Gibbs
    vectors, b after -a, is (b - a - a cross b) / (1 + a . b).
    """
    n, d = end.size, kernel.dimension
    for start in range(0, n, d):
        for k in range(len(kernel.rotations)):
            at = start + kernel.rotations[k] - k
            a0, a1, a2 = 0.5 * end[at], 0.5 * end[at + 1], 0.5 * end[at + 2]
            # P at the end of the previous step: dcay_(-x)^* of its pi, see _fill_slopes.
            bend = cross(end, z.p, at)
            share = 1.0 / (1.0 + a0 * a0 + a1 * a1 + a2 * a2)
            for j in range(s):
                i, m = j * n + at, (s + j) * n + at
                b0, b1, b2 = a0 + 0.5 * x[i], a1 + 0.5 * x[i + 1], a2 + 0.5 * x[i + 2]
                P0 = x[m] - z.p[at] + share * (z.p[at] + 0.5 * bend[0])
                P1 = x[m + 1] - z.p[at + 1] + share * (z.p[at + 1] + 0.5 * bend[1])
                P2 = x[m + 2] - z.p[at + 2] + share * (z.p[at + 2] + 0.5 * bend[2])
                # mu = (dcay^-1_(-2 b))^* P.
                along = b0 * P0 + b1 * P1 + b2 * P2
                mu0 = P0 - (b1 * P2 - b2 * P1) + along * b0
                mu1 = P1 - (b2 * P0 - b0 * P2) + along * b1
                mu2 = P2 - (b0 * P1 - b1 * P0) + along * b2
                scale = 1.0 / (1.0 + a0 * b0 + a1 * b1 + a2 * b2)
                c0 = scale * (b0 - a0 - (a1 * b2 - a2 * b1))
                c1 = scale * (b1 - a1 - (a2 * b0 - a0 * b2))
                c2 = scale * (b2 - a2 - (a0 * b1 - a1 * b0))
                x[i], x[i + 1], x[i + 2] = 2.0 * c0, 2.0 * c1, 2.0 * c2
                own = 1.0 / (1.0 + c0 * c0 + c1 * c1 + c2 * c2)
                x[m] = own * (mu0 + c1 * mu2 - c2 * mu1)
                x[m + 1] = own * (mu1 + c2 * mu0 - c0 * mu2)
                x[m + 2] = own * (mu2 + c0 * mu1 - c1 * mu0)


@called
def _fill_slopes(problem: _LieStageEquation, x: np.ndarray) -> None:
    """Fill the rates of x and P at the stages: K_P, and -K_x."""
    kernel, z, point, work = problem.kernel, problem.z, problem.point, problem.work
    n, s, slopes = z.q.size, problem.matrix.shape[0], work.kept.slopes
    for j in range(s):
        a, b = j * n, (j + 1) * n
        move(kernel, cayley, z, x[a:b], point)
        for i in range(n):
            work.q[a + i] = point.q[i]
            work.mu[a + i] = x[s * n + a + i]
        add_bend(kernel, cayley, x[a:b], x[s * n + a:s * n + b], -1.0, work.mu[a:b])
    kernel.gradient(kernel.parameters, work.q, work.mu, work.dH_dq, work.dH_dp)
    for i in range(n):
        work.torque[i] = 0.0
    for j in range(s):
        a, b = j * n, (j + 1) * n
        there, P, omega = x[a:b], x[s * n + a:s * n + b], work.dH_dp[a:b]
        fill_forces(kernel, work.q[a:b], work.dH_dq[a:b], work.forces)
        for i in range(n):
            slopes[a + i], slopes[s * n + a + i] = omega[i], -work.forces[i]
            work.torque[i] += problem.weights[j] * work.forces[i]
        add_bend(kernel, cayley, there, omega, 1.0, slopes[a:b])
        for start in range(0, n, kernel.dimension):
            for k in range(len(kernel.rotations)):
                at = start + kernel.rotations[k] - k
                # dcay_(-x)^* of the force, and the derivative of omega . mu by x at constant P.
                own = 1.0 / (1.0 + 0.25 * dot(there, there, at))
                bend, turn = cross(there, work.forces, at), cross(P, omega, at)
                turned = _rotation_change(there, work.forces, at, 1.0)
                x_omega, x_P = dot(there, omega, at), dot(there, P, at)
                for i in range(3):
                    work.torque[at + i] += problem.weights[j] * turned[i]
                    slopes[s * n + a + at + i] = (
                        0.5 * turn[i] - 0.25 * (x_omega * P[at + i] + x_P * omega[at + i])
                        - own * (work.forces[at + i] + 0.5 * bend[i]))


@inlined
def _equation(problem: _LieStageEquation, x: np.ndarray, value: np.ndarray) -> None:
    """Fill value with the stages that follow from their slopes, and x and P at the end."""
    z, work, h, s = problem.z, problem.work, problem.h, problem.matrix.shape[0]
    n, slopes, end = z.q.size, work.kept.slopes, work.end
    _fill_slopes(problem, x)
    for i in range(n):
        end[i] = 0.0
        for k in range(s):
            end[i] += h * problem.weights[k] * slopes[k * n + i]
    _fill_last_momenta(problem.kernel, h, z, work)
    for j in range(s):
        for i in range(n):
            change, momentum = 0.0, 0.0
            for k in range(s):
                change += problem.matrix[j, k] * slopes[k * n + i]
                momentum += (problem.weights[k] - problem.matrix[j, k]) * slopes[(s + k) * n + i]
            value[j * n + i] = h * change
            value[(s + j) * n + i] = work.momenta[i] - h * momentum


@called
def _fill_last_momenta(kernel: Kernel, h: float, z: PhasePoint, work: LieGaussWork) -> None:
    """Fill P_1 = dcay_(x_1)^* (pi_k - h torque)."""
    P, x = work.momenta, work.end
    for i in range(P.size):
        P[i] = z.p[i] + (z.p_carry[i] - h * work.torque[i])
    for start in range(0, P.size, kernel.dimension):
        for k in range(len(kernel.rotations)):
            at = start + kernel.rotations[k] - k
            own, bend = 1.0 / (1.0 + 0.25 * dot(x, x, at)), cross(x, P, at)
            for i in range(3):
                P[at + i] = own * (P[at + i] - 0.5 * bend[i])


@called
def _fill_momentum_changes(kernel: Kernel, h: float, z: PhasePoint, work: LieGaussWork) -> None:
    """Fill ``forces`` with pi_(k+1) - pi_k, where pi_(k+1) = cay(-x_1) (pi_k - h torque)."""
    x, change, m = work.end, work.forces, work.momenta
    for i in range(m.size):
        change[i] = -h * work.torque[i]
        m[i] = z.p[i] + (z.p_carry[i] + change[i])
    for start in range(0, m.size, kernel.dimension):
        for k in range(len(kernel.rotations)):
            at = start + kernel.rotations[k] - k
            turned = _rotation_change(x, m, at, -1.0)
            for i in range(3):
                change[at + i] += turned[i]


@inlined
def _rotation_change(x: np.ndarray, m: np.ndarray, at: int,
                     side: float) -> tuple[float, float, float]:
    """Return cay(side x) m - m for the vectors at one place of both arrays."""
    own = 1.0 / (1.0 + 0.25 * dot(x, x, at))
    a, b, c = cross(x, m, at)
    first = side * a + 0.5 * (x[at + 1] * c - x[at + 2] * b)
    second = side * b + 0.5 * (x[at + 2] * a - x[at] * c)
    return own * first, own * second, own * (side * c + 0.5 * (x[at] * b - x[at + 1] * a))


_tangent = by_differences(_equation)
