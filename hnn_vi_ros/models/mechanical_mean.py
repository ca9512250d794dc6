# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The mean of several learned mechanisms, with the mean of their masses and potentials."""

from typing import NamedTuple

from hnn_vi_ros.kernels import (
    by_address, energy as member_energy, factorise, gradient as member_slope,
    hessian_vector as member_change, Kernel, part, solve_cholesky, Target)
from hnn_vi_ros.models.ensemble import MeanHamiltonian
from hnn_vi_ros.models.mechanical import inertia, slope, slope_change
import numpy as np


class MeanMechanismParameters(NamedTuple):
    """
    Parameters of the functions of a mean, their first argument.

    Parameters
    ----------
    first : Target
        Parameters of the first member, by address; they are compiled before the first step.
    members : tuple of Target
        ``inertia``, ``slope`` and ``slope_change`` of mechanical.py for each member, by address.
    wholes : tuple of Target
        The Hamiltonian of each member, whose energy at rest is V.
    factor : np.ndarray, shape (d, d)
        The Cholesky factor of M.
    v, v_change, part, turned, zero : np.ndarray, shape (d,)
        The velocity, its change, the result of one member, M' v, and zeros.
    wide_q, wide_mass : np.ndarray, shape (d d,)
        q, padded, and M of one member.

    """

    first: Target
    members: tuple[Target, ...]
    wholes: tuple[Target, ...]
    factor: np.ndarray
    v: np.ndarray
    v_change: np.ndarray
    part: np.ndarray
    turned: np.ndarray
    zero: np.ndarray
    wide_q: np.ndarray
    wide_mass: np.ndarray


class MeanMechanism(MeanHamiltonian):
    """
    H(q, p) = p . M(q)^-1 p / 2 + V(q), with M = (M_1 + ... + M_N) / N, and V in the same way.

    This is the mean of the members' Lagrangians, which are functions of the measured q and q'.
    With the mean of friction and input maps, the force that the mean needs for a motion is the
    mean of the members' forces: a motion of all members is also one of the mean, even if they
    differ by a common factor of M, V and friction, which motions with small forces hardly
    determine. M is positive definite because each M_k is. With v = M^-1 p and p_k = M_k v

        H_p = v,    H_q = (sum_k V_k' - (v . M_k v)_q / 2) / N,

    where each term is H_k,q(q, p_k). A gradient costs N gradients of a member.

    Parameters
    ----------
    checkpoint : Checkpoint
        An ensemble of the family mechanical.

    """

    def _kernel(self) -> Kernel:
        d = self.dimension
        members, wholes = [], []
        for member in self.members:
            terms = self._kernel_of(inertia, slope, slope_change, member.parameters())
            members.append(Target(*by_address(terms).parameters))
            wholes.append(Target(*by_address(member._kernel()).parameters))
        parameters = MeanMechanismParameters(
            members[0], tuple(members), tuple(wholes), np.zeros((d, d)), *np.zeros((5, d)),
            *np.zeros((2, d * d)))
        return self._kernel_of(energy, gradient, hessian_vector, parameters)


def energy(parameters: MeanMechanismParameters, q: np.ndarray, p: np.ndarray) -> float:
    """Return H; see Kernel."""
    _solve(parameters, q, p)
    total = 0.0
    for whole in parameters.wholes:
        total += member_energy(whole, q, parameters.zero)
    total /= len(parameters.wholes)
    for i in range(p.size):
        total += 0.5 * p[i] * parameters.v[i]
    return total


def gradient(parameters: MeanMechanismParameters, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
             dH_dp: np.ndarray) -> None:
    """Fill the gradient; see Kernel."""
    v, own, d = parameters.v, parameters.part, parameters.v.size
    share = 1.0 / len(parameters.members)
    for a in range(0, q.size, d):
        b = a + d
        _solve(parameters, q[a:b], p[a:b])
        dH_dq[a:b] = 0.0
        for member in parameters.members:
            member_slope(member, q[a:b], v, own, parameters.turned)
            for i in range(d):
                dH_dq[a + i] += share * own[i]
        for i in range(d):
            dH_dp[a + i] = v[i]


def hessian_vector(parameters: MeanMechanismParameters, q: np.ndarray, p: np.ndarray,
                   v_q: np.ndarray, v_p: np.ndarray, product_q: np.ndarray,
                   product_p: np.ndarray) -> None:
    """Fill the change of the gradient along (v_q, v_p), using M v' = p' - M' v."""
    v, v_change, own = parameters.v, parameters.v_change, parameters.part
    turned, d = parameters.turned, parameters.v.size
    share = 1.0 / len(parameters.members)
    for a in range(0, q.size, d):
        b = a + d
        _solve(parameters, q[a:b], p[a:b])
        for i in range(d):
            v_change[i] = v_p[a + i]
        for member in parameters.members:
            member_change(member, q[a:b], v, v_q[a:b], parameters.zero, own, turned)
            for i in range(d):
                v_change[i] -= share * turned[i]
        solve_cholesky(parameters.factor, v_change)
        product_q[a:b] = 0.0
        for member in parameters.members:
            member_change(member, q[a:b], v, v_q[a:b], v_change, own, turned)
            for i in range(d):
                product_q[a + i] += share * own[i]
        for i in range(d):
            product_p[a + i] = v_change[i]


@part(error_model='numpy')
def _solve(parameters: MeanMechanismParameters, q: np.ndarray, p: np.ndarray) -> None:
    """Fill the factor of M, and v; v is NaN if no factor exists."""
    factor, v, mass = parameters.factor, parameters.v, parameters.wide_mass
    d, share = v.size, 1.0 / len(parameters.members)
    for i in range(d):
        parameters.wide_q[i], v[i] = q[i], p[i]
        for j in range(i + 1):
            factor[i, j] = 0.0
    for member in parameters.members:
        member_energy(member, parameters.wide_q, mass)
        for i in range(d):
            for j in range(i + 1):
                factor[i, j] += share * mass[i * d + j]
    if not factorise(factor):
        v[:] = np.nan
    solve_cholesky(factor, v)
