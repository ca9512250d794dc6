# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled H of a tree of bodies: few bodies as code without loops, more as data of recursions."""

from typing import NamedTuple

from hnn_vi_ros.hamiltonians.base import compiled_kernel
from hnn_vi_ros.hamiltonians.rigid_body.small_tree import MOST_STRAIGHT, small_tree_kernel
from hnn_vi_ros.hamiltonians.rigid_body.spatial import power
from hnn_vi_ros.hamiltonians.rigid_body.sweeps import (
    add_rate_changes, Bodies, fill_changes, fill_frames, fill_mass_matrix, fill_velocities,
    Following, force_change_of, force_of, solve_rate_changes, solve_rates, TreeParameters,
    TreeWork)
from hnn_vi_ros.kernels import factorise, inlined, Kernel, solve_cholesky
import numpy as np
from numpy.typing import DTypeLike


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


class FollowingParameters(NamedTuple):
    """
    Parameters of the functions of a tree in which joints follow others, their first argument.

    The joint values q = G y + c have rates q' = G y', so that T = y' . G^T M G y' / 2 is that of
    the coordinates y with momenta p = G^T M q'. With the recursions of ``sweeps`` for all joints,

        M_y = G^T M G,    H_p = M_y^-1 p,    H_y = G^T H_q at the rates G H_p

    where H_q at given rates needs no M. Robots without such joints do not run this code.

    Parameters
    ----------
    bodies, work, following
        The bodies of all d joints, each with a coordinate of its own, their workspace, and G, c.
    joints : np.ndarray, shape (d,)
        Workspace for values or changes of all joints.
    mass : np.ndarray, shape (k, k)
        M_y in its lower triangle, and then its Cholesky factor.
    rates, rates_v : np.ndarray, shape (k,)
        y', and its change along a direction.

    """

    bodies: Bodies
    work: TreeWork
    following: Following
    joints: np.ndarray
    mass: np.ndarray
    rates: np.ndarray
    rates_v: np.ndarray

    @classmethod
    def empty(cls, bodies: Bodies, following: Following, dtype: DTypeLike = np.float64
              ) -> 'FollowingParameters':
        """Return parameters with new workspace."""
        d, k = following.leader.size, following.size
        return cls(bodies, TreeWork.empty(d, dtype), following, np.zeros(d, dtype),
                   np.zeros((k, k), dtype), *np.zeros((2, k), dtype))


def following_kernel(bodies: Bodies, following: Following) -> Kernel:
    """Return the functions of H, with their own workspace."""
    return compiled_kernel((_following_energy, _following_gradient, _following_hessian_vector),
                           FollowingParameters.empty(bodies, following), following.size)


@inlined
def _spread(following: Following, y: np.ndarray, start: int, share: float, joints: np.ndarray
            ) -> None:
    """Fill G y + share c for the coordinates at offset ``start``."""
    for i in range(joints.size):
        joints[i] = (following.multiplier[i] * y[start + following.leader[i]]
                     + share * following.offset[i])


@inlined
def _arrange_following(own: FollowingParameters, q: np.ndarray, p: np.ndarray, start: int) -> None:
    """Fill the workspace for the state at offset ``start``, up to the rates of all joints."""
    following, mass = own.following, own.mass
    _spread(following, q, start, 1.0, own.joints)
    fill_frames(own.bodies, own.work, own.joints, 0)
    fill_mass_matrix(own.bodies, own.work)
    mass[:] = 0.0
    for i in range(own.joints.size):
        for j in range(i + 1):
            a, b = following.leader[i], following.leader[j]
            entry = following.multiplier[i] * following.multiplier[j] * own.work.mass[i, j]
            mass[max(a, b), min(a, b)] += entry
            if a == b and i != j:
                mass[a, a] += entry
    regular = factorise(mass)
    for k in range(own.rates.size):
        own.rates[k] = p[start + k] if regular else np.nan
    solve_cholesky(mass, own.rates)
    _spread(following, own.rates, 0, 0.0, own.work.rates)


def _following_energy(own: FollowingParameters, q: np.ndarray, p: np.ndarray) -> float:
    _arrange_following(own, q, p, 0)
    first, gravity = own.work.composite, own.bodies.gravity
    energy = -(first[0, 1] * gravity[0] + first[0, 2] * gravity[1] + first[0, 3] * gravity[2])
    for k in range(p.size):
        energy += 0.5 * p[k] * own.rates[k]
    return energy


def _following_gradient(own: FollowingParameters, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
                        dH_dp: np.ndarray) -> None:
    following, size = own.following, own.rates.size
    for start in range(0, q.size, size):
        _arrange_following(own, q, p, start)
        fill_velocities(own.bodies, own.work)
        for k in range(size):
            dH_dq[start + k], dH_dp[start + k] = 0.0, own.rates[k]
        for i in range(own.joints.size):
            dH_dq[start + following.leader[i]] += following.multiplier[i] * force_of(
                own.bodies, own.work, i + 1)


def _following_hessian_vector(own: FollowingParameters, q: np.ndarray, p: np.ndarray,
                              v_q: np.ndarray, v_p: np.ndarray, product_q: np.ndarray,
                              product_p: np.ndarray) -> None:
    bodies, work, following, size = own.bodies, own.work, own.following, own.rates.size
    for start in range(0, q.size, size):
        _arrange_following(own, q, p, start)
        fill_velocities(bodies, work)
        _spread(following, v_q, start, 0.0, own.joints)
        fill_changes(bodies, work, own.joints, 0)
        for k in range(size):
            own.rates_v[k] = v_p[start + k]
        for i in range(own.joints.size):
            own.rates_v[following.leader[i]] -= following.multiplier[i] * (
                power(work.axis_v, work.momentum, i + 1)
                + power(work.axis, work.momentum_v, i + 1))
        solve_cholesky(own.mass, own.rates_v)
        _spread(following, own.rates_v, 0, 0.0, work.rates_v)
        add_rate_changes(bodies, work)
        for k in range(size):
            product_q[start + k], product_p[start + k] = 0.0, own.rates_v[k]
        for i in range(own.joints.size):
            product_q[start + following.leader[i]] += following.multiplier[i] * force_change_of(
                bodies, work, i + 1)
