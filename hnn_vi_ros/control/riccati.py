# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Sweep of iLQR from the end of a horizon to its start, with commands in boxes."""

from hnn_vi_ros.kernels.compilation import kept
from hnn_vi_ros.kernels.marks import inlined
import numpy as np

_MOST = 20


@kept(error_model='numpy')
def sweep(f_z: np.ndarray, f_u: np.ndarray, l_z: np.ndarray, l_u: np.ndarray, l_zz: np.ndarray,
          l_uu: np.ndarray, low: np.ndarray, high: np.ndarray, damping: float,
          changes: np.ndarray, gains: np.ndarray) -> tuple[bool, float, float]:
    """
    Fill the best changes of N commands, and gains on deviations from the states.

    Of the change k of a command it minimises Q_u . k + k . Q_uu k / 2 within the limits, by
    projected Newton steps; commands at a limit have no gains.

    Parameters
    ----------
    f_z, f_u : np.ndarray, shape (N, n, n) and (N, n, c)
        Derivatives of the steps.
    l_z, l_zz : np.ndarray, shape (N + 1, n) and (N + 1, n, n)
        Gradient and Hessian of the cost at the states, that at the end included.
    l_u, l_uu : np.ndarray, shape (N, c) and (N, c, c)
        Likewise by the commands.
    low, high : np.ndarray, shape (N, c)
        Least and largest changes of the commands, <= 0 and >= 0.
    damping : float
        Weight of a change of the state that a command makes, which shortens the changes.
    changes, gains : np.ndarray, shape (N, c) and (N, c, n)
        Filled.

    Returns
    -------
    tuple of (bool, float, float)
        Whether Q_uu was positive definite throughout, and the linear and the quadratic term of
        the predicted change of the cost.

    References
    ----------
    Y. Tassa, N. Mansard, E. Todorov, Control-limited differential dynamic programming, ICRA 2014.

    """
    count, n, c = f_u.shape
    v_z, v_zz = l_z[count].copy(), l_zz[count].copy()
    linear, quadratic = 0.0, 0.0
    k, k_z, own = np.zeros(c), np.zeros((c, n)), np.zeros((c, c))
    for i in range(count - 1, -1, -1):
        a, b = f_z[i], f_u[i]
        q_z, q_u = l_z[i] + v_z @ a, l_u[i] + v_z @ b
        along = v_zz @ a
        q_zz, q_uz = l_zz[i] + a.T @ along, b.T @ along
        q_uu = l_uu[i] + b.T @ (v_zz @ b)
        damped = q_uu + damping * (b.T @ b)
        if not _box(damped, q_u, low[i], high[i], k):
            return False, 0.0, 0.0
        k_z[:] = 0.0
        if not _free(damped, q_u, low[i], high[i], k, own):
            return False, 0.0, 0.0
        for j in range(n):
            k_z[:, j] = _solved(own, -q_uz[:, j])
        for m in range(c):
            if _held(damped, q_u, low[i], high[i], k, m):
                k_z[m] = 0.0
        linear += k @ q_u
        quadratic += 0.5 * (k @ (q_uu @ k))
        v_z = q_z + (q_uu @ k + q_u) @ k_z + k @ q_uz
        v_zz = q_zz + k_z.T @ (q_uu @ k_z) + k_z.T @ q_uz + q_uz.T @ k_z
        v_zz = 0.5 * (v_zz + v_zz.T)
        changes[i], gains[i] = k, k_z
    return True, linear, quadratic


@inlined
def _held(q_uu: np.ndarray, q_u: np.ndarray, low: np.ndarray, high: np.ndarray, k: np.ndarray,
          m: int) -> bool:
    """Return whether a limit holds a command: the cost falls beyond it."""
    slope = q_u[m]
    for j in range(k.size):
        slope += q_uu[m, j] * k[j]
    return (k[m] <= low[m] and slope > 0.0) or (k[m] >= high[m] and slope < 0.0)


@inlined
def _free(q_uu: np.ndarray, q_u: np.ndarray, low: np.ndarray, high: np.ndarray, k: np.ndarray,
          own: np.ndarray) -> bool:
    """Fill the Cholesky factor of Q_uu, with unit rows for commands that limits hold."""
    c = k.size
    for m in range(c):
        held = _held(q_uu, q_u, low, high, k, m)
        for j in range(m + 1):
            if held or _held(q_uu, q_u, low, high, k, j):
                total = 1.0 if m == j else 0.0
            else:
                total = q_uu[m, j]
            for i in range(j):
                total -= own[m, i] * own[j, i]
            if m == j:
                if not total > 0.0:
                    return False
                own[m, m] = np.sqrt(total)
            else:
                own[m, j] = total / own[j, j]
    return True


@inlined
def _solved(own: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the solution of equations whose matrix has this Cholesky factor."""
    x = right.copy()
    for m in range(x.size):
        for j in range(m):
            x[m] -= own[m, j] * x[j]
        x[m] /= own[m, m]
    for m in range(x.size - 1, -1, -1):
        for j in range(m + 1, x.size):
            x[m] -= own[j, m] * x[j]
        x[m] /= own[m, m]
    return x


@inlined
def _box(q_uu: np.ndarray, q_u: np.ndarray, low: np.ndarray, high: np.ndarray, k: np.ndarray
         ) -> bool:
    """Fill the change that minimises a quadratic function in a box; False if it is not convex."""
    c, own = k.size, np.zeros((k.size, k.size))
    for m in range(c):
        k[m] = min(max(0.0, low[m]), high[m])
    for _ in range(_MOST):
        if not _free(q_uu, q_u, low, high, k, own):
            return False
        slope = q_u + q_uu @ k
        right, size = np.zeros(c), 0.0
        for m in range(c):
            if not _held(q_uu, q_u, low, high, k, m):
                right[m] = -slope[m]
        step = _solved(own, right)
        for m in range(c):
            if right[m] == 0.0:
                step[m] = 0.0
        value, length, moved = k @ q_u + 0.5 * (k @ (q_uu @ k)), 1.0, k.copy()
        for _ in range(_MOST):
            for m in range(c):
                moved[m] = min(max(k[m] + length * step[m], low[m]), high[m])
            if moved @ q_u + 0.5 * (moved @ (q_uu @ moved)) <= value:
                break
            length *= 0.5
        for m in range(c):
            size = max(size, abs(moved[m] - k[m]) / (1e-12 + abs(k[m]) + abs(moved[m])))
            k[m] = moved[m]
        if size < 1e-10:
            break
    return True
