# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Backward pass of iLQR over a horizon, with box limits on the commands."""

from typing import NamedTuple

from hnn_vi_ros.kernels import factorise, inlined, kept, solve_cholesky
import numpy as np

_MAX_ITERATIONS = 20
# Relative change of a command at which the box-constrained search stops.
_COMMAND_TOLERANCE = 1e-10


class Stages(NamedTuple):
    """
    Expansions along m plans of N commands each.

    Parameters
    ----------
    f_z, f_u : np.ndarray, shape (m, N, n, n) and (m, N, n, c)
        Derivatives of the steps.
    l_z, l_zz : np.ndarray, shape (m, N + 1, n) and (m, N + 1, n, n)
        Gradient and Hessian of the cost with respect to the states, including the last state.
    l_u, l_uu : np.ndarray, shape (m, N, c) and (m, N, c, c)
        The same with respect to the commands.
    low, high : np.ndarray, shape (m, N, c)
        Minimum and maximum changes of the commands, <= 0 and >= 0.
    damping : np.ndarray, shape (m,)
        Regularisation: weight of the state change caused by a command, which shortens the steps.

    """

    f_z: np.ndarray
    f_u: np.ndarray
    l_z: np.ndarray
    l_zz: np.ndarray
    l_u: np.ndarray
    l_uu: np.ndarray
    low: np.ndarray
    high: np.ndarray
    damping: np.ndarray


class _Work(NamedTuple):
    """Workspace of a stage: Q and V of dynamic programming, and the box-constrained search."""

    v_z: np.ndarray
    v_zz: np.ndarray
    q_z: np.ndarray
    q_zz: np.ndarray
    along: np.ndarray
    q_u: np.ndarray
    q_uz: np.ndarray
    q_uu: np.ndarray
    damped: np.ndarray
    factor: np.ndarray
    step: np.ndarray
    moved: np.ndarray


@kept(error_model='numpy')
def riccati_sweep(stages: Stages, changes: np.ndarray, gains: np.ndarray, gained: np.ndarray
                  ) -> None:
    """
    Fill the optimal changes of the commands, and the feedback gains on state deviations.

    The change k of a command minimises Q_u . k + k . Q_uu k / 2 within the limits, by projected
    Newton steps; commands at a limit have zero gains.

    Parameters
    ----------
    stages : Stages
        Expansions of m plans.
    changes, gains : np.ndarray, shape (m, N, c) and (m, N, c, n)
        Output arrays.
    gained : np.ndarray, shape (m, 2)
        Output: the linear and the quadratic term of the predicted change of the cost; NaN if Q_uu
        is not positive definite at some stage.

    References
    ----------
    Y. Tassa, N. Mansard, E. Todorov, Control-limited differential dynamic programming, ICRA 2014.

    """
    rows, count, n, c = stages.f_u.shape
    work = _Work(np.zeros(n), np.zeros((n, n)), np.zeros(n), np.zeros((n, n)), np.zeros((n, n)),
                 np.zeros(c), np.zeros((c, n)), np.zeros((c, c)), np.zeros((c, c)),
                 np.zeros((c, c)), np.zeros(c), np.zeros(c))
    for m in range(rows):
        gained[m] = 0.0
        for a in range(n):
            work.v_z[a] = stages.l_z[m, count, a]
            for b in range(n):
                work.v_zz[a, b] = stages.l_zz[m, count, a, b]
        for i in range(count - 1, -1, -1):
            _fill(stages, m, i, work)
            k, k_z = changes[m, i], gains[m, i]
            if not _solve_in_box(stages.low[m, i], stages.high[m, i], k, work):
                gained[m] = np.nan
                break
            _fill_gains(stages.low[m, i], stages.high[m, i], k, k_z, work)
            _fill_cost_to_go(k, k_z, gained[m], work)


@inlined
def _fill(stages: Stages, m: int, i: int, work: _Work) -> None:
    """Fill Q at a stage from V of the next one."""
    f_z, f_u = stages.f_z[m, i], stages.f_u[m, i]
    n, c = f_u.shape
    for a in range(n):
        total = stages.l_z[m, i, a]
        for b in range(n):
            total += work.v_z[b] * f_z[b, a]
            along = 0.0
            for e in range(n):
                along += work.v_zz[a, e] * f_z[e, b]
            work.along[a, b] = along
        work.q_z[a] = total
    for a in range(n):
        for b in range(n):
            total = stages.l_zz[m, i, a, b]
            for e in range(n):
                total += f_z[e, a] * work.along[e, b]
            work.q_zz[a, b] = total
    for a in range(c):
        total = stages.l_u[m, i, a]
        for e in range(n):
            total += work.v_z[e] * f_u[e, a]
        work.q_u[a] = total
        for b in range(n):
            total = 0.0
            for e in range(n):
                total += f_u[e, a] * work.along[e, b]
            work.q_uz[a, b] = total
        for b in range(c):
            total, square = stages.l_uu[m, i, a, b], 0.0
            for e in range(n):
                square += f_u[e, a] * f_u[e, b]
                for g in range(n):
                    total += f_u[e, a] * work.v_zz[e, g] * f_u[g, b]
            work.q_uu[a, b], work.damped[a, b] = total, total + stages.damping[m] * square


@inlined
def _fill_gains(low: np.ndarray, high: np.ndarray, k: np.ndarray, k_z: np.ndarray, work: _Work
                ) -> None:
    """Fill the gains of a stage, given the Cholesky factor for its free commands."""
    c, n = k_z.shape
    for b in range(n):
        for a in range(c):
            work.step[a] = -work.q_uz[a, b]
        solve_cholesky(work.factor, work.step)
        for a in range(c):
            k_z[a, b] = 0.0 if _is_at_limit(low, high, k, a, work) else work.step[a]


@inlined
def _fill_cost_to_go(k: np.ndarray, k_z: np.ndarray, gained: np.ndarray, work: _Work) -> None:
    """Fill V of a stage, and add its share to the predicted change of the cost."""
    c, n = k_z.shape
    for a in range(c):
        slope = 0.0
        for b in range(c):
            slope += work.q_uu[a, b] * k[b]
        gained[0] += k[a] * work.q_u[a]
        gained[1] += 0.5 * k[a] * slope
        # From here on, the gradient after the change.
        work.step[a] = slope + work.q_u[a]
    for b in range(n):
        total = work.q_z[b]
        for a in range(c):
            total += work.step[a] * k_z[a, b] + k[a] * work.q_uz[a, b]
        work.v_z[b] = total
        for e in range(b + 1):
            total = 0.5 * (work.q_zz[b, e] + work.q_zz[e, b])
            for a in range(c):
                total += k_z[a, b] * work.q_uz[a, e] + work.q_uz[a, b] * k_z[a, e]
                for g in range(c):
                    total += k_z[a, b] * work.q_uu[a, g] * k_z[g, e]
            work.v_zz[b, e] = work.v_zz[e, b] = total


@inlined
def _is_at_limit(low: np.ndarray, high: np.ndarray, k: np.ndarray, a: int, work: _Work) -> bool:
    """Return whether a command is at a limit beyond which the cost would fall."""
    slope = work.q_u[a]
    for b in range(k.size):
        slope += work.damped[a, b] * k[b]
    return (k[a] <= low[a] and slope > 0.0) or (k[a] >= high[a] and slope < 0.0)


@inlined
def _factorise(low: np.ndarray, high: np.ndarray, k: np.ndarray, work: _Work) -> bool:
    """Fill the Cholesky factor of Q_uu, with unit rows for commands at their limits."""
    for a in range(k.size):
        held = _is_at_limit(low, high, k, a, work)
        for b in range(a + 1):
            work.factor[a, b] = 1.0 if a == b else 0.0
            if not (held or _is_at_limit(low, high, k, b, work)):
                work.factor[a, b] = work.damped[a, b]
    return factorise(work.factor)


@inlined
def _value(k: np.ndarray, work: _Work) -> float:
    """Return the change of the cost due to a change of the command."""
    total = 0.0
    for a in range(k.size):
        total += k[a] * work.q_u[a]
        for b in range(k.size):
            total += 0.5 * k[a] * work.damped[a, b] * k[b]
    return total


@inlined
def _solve_in_box(low: np.ndarray, high: np.ndarray, k: np.ndarray, work: _Work) -> bool:
    """Fill the optimal change in a box and its factor; return False if Q_uu is not positive."""
    step, moved = work.step, work.moved
    for a in range(k.size):
        k[a] = min(max(0.0, low[a]), high[a])
    for _ in range(_MAX_ITERATIONS):
        if not _factorise(low, high, k, work):
            return False
        for a in range(k.size):
            step[a] = 0.0
            if not _is_at_limit(low, high, k, a, work):
                step[a] = -work.q_u[a]
                for b in range(k.size):
                    step[a] -= work.damped[a, b] * k[b]
        solve_cholesky(work.factor, step)
        value, length, settled = _value(k, work), 1.0, True
        for _ in range(_MAX_ITERATIONS):
            for a in range(k.size):
                moved[a] = min(max(k[a] + length * step[a], low[a]), high[a])
            if _value(moved, work) <= value:
                break
            length *= 0.5
        for a in range(k.size):
            if abs(moved[a] - k[a]) > _COMMAND_TOLERANCE * (abs(k[a]) + abs(moved[a])):
                settled = False
            k[a] = moved[a]
        if settled:
            break
    return _factorise(low, high, k, work)
