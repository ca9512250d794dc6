# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled H of a tree of bodies: few bodies as code without loops, more as data of recursions."""

from hnn_vi_ros.hamiltonians.base import compiled_kernel
from hnn_vi_ros.hamiltonians.rigid_body.following import following_kernel
from hnn_vi_ros.hamiltonians.rigid_body.small_tree import MOST_STRAIGHT, small_tree_kernel
from hnn_vi_ros.hamiltonians.rigid_body.sweeps import (
    add_rate_changes, Bodies, fill_changes, fill_frames, fill_mass_matrix, fill_velocities,
    Following, force_change_of, force_of, solve_rate_changes, solve_rates, TreeParameters,
    TreeWork)
from hnn_vi_ros.kernels import inlined, Kernel
import numpy as np


def tree_kernel(bodies: Bodies, following: Following | None = None, fixed: bool = True) -> Kernel:
    """Return the functions of H of some bodies, which may change unless they are fixed."""
    d = len(bodies.parent) - 1
    # A bound of the moments of the weights: their sum times the largest possible distance.
    reach = np.zeros(d + 1)
    for i in range(1, d + 1):
        reach[i] = reach[bodies.parent[i]] + np.linalg.norm(bodies.placement[i, 9:])
    weights = (bodies.inertia[1:, 0] * reach[1:] + np.linalg.norm(bodies.inertia[1:, 1:4], axis=1))
    scale = float(np.linalg.norm(bodies.gravity) * weights.sum())
    if fixed and d <= MOST_STRAIGHT:
        kernel = small_tree_kernel(bodies, following)
    elif following is not None:
        kernel = following_kernel(bodies, following)
    else:
        kernel = compiled_kernel(
            (_energy, _gradient, _hessian_vector), TreeParameters(bodies, TreeWork.empty(d)), d)
    gain = 1.0 if following is None else float(np.abs(following.matrix()).sum(axis=0).max())
    return kernel._replace(gradient_scale=(gain * scale, 0.0), energy_scale=scale)


@inlined
def _arrange(parameters: TreeParameters, q: np.ndarray, p: np.ndarray, start: int) -> None:
    """Fill the workspace for the state at offset ``start``, up to the rates of the joints."""
    bodies, work = parameters.bodies, parameters.work
    fill_frames(bodies, work, q, start)
    fill_mass_matrix(bodies, work)
    solve_rates(bodies, work, p, start)


def _energy(parameters: TreeParameters, q: np.ndarray, p: np.ndarray) -> float:
    bodies, work = parameters.bodies, parameters.work
    _arrange(parameters, q, p, 0)
    first, gravity = work.composite, bodies.gravity
    energy = -(first[0, 1] * gravity[0] + first[0, 2] * gravity[1] + first[0, 3] * gravity[2])
    for i in range(p.size):
        at = bodies.coordinate[i + 1]
        energy += 0.5 * p[at] * work.rates[i] + bodies.load[i + 1] * q[at]
    return energy


def _gradient(parameters: TreeParameters, q: np.ndarray, p: np.ndarray,
              dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    bodies, work = parameters.bodies, parameters.work
    for start in range(0, q.size, work.rates.size):
        _arrange(parameters, q, p, start)
        fill_velocities(bodies, work)
        for i in range(1, bodies.parent.size):
            at = start + bodies.coordinate[i]
            dH_dq[at], dH_dp[at] = force_of(bodies, work, i), work.rates[i - 1]


def _hessian_vector(parameters: TreeParameters, q: np.ndarray, p: np.ndarray, v_q: np.ndarray,
                    v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
    bodies, work = parameters.bodies, parameters.work
    for start in range(0, q.size, work.rates.size):
        _arrange(parameters, q, p, start)
        fill_velocities(bodies, work)
        fill_changes(bodies, work, v_q, start)
        solve_rate_changes(bodies, work, v_p, start)
        add_rate_changes(bodies, work)
        for i in range(1, bodies.parent.size):
            at = start + bodies.coordinate[i]
            product_q[at] = force_change_of(bodies, work, i)
            product_p[at] = work.rates_v[i - 1]
