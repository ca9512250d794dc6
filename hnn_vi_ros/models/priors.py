# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""M and V of a prior of the family mechanical, added to its networks; its kernel by address."""

from collections.abc import Sequence
from typing import NamedTuple

from hnn_vi_ros.hamiltonians import tree_kernel
from hnn_vi_ros.kernels import (
    by_address, energy, factorise, gradient, hessian_vector, Kernel, part, solve_cholesky, Target)
from hnn_vi_ros.models.exact_prior import create
from hnn_vi_ros.models.mechanical_card import MechanicalCard, PriorCard
from hnn_vi_ros.models.planar_chain import chain_kernel, CHAINS
import numpy as np


class Prior(NamedTuple):
    """
    A system by address, and workspace for one state.

    Parameters
    ----------
    present : bool
        False if there is no prior; then none of the functions here may be called.
    target : Target
        Its functions and parameters.
    inverse, mass : np.ndarray, shape (d, d)
        M^-1, overwritten by its Cholesky factor; and M at the last coordinates.
    momentum, turned : np.ndarray, shape (d,)
        pi = M v, and M' v.
    unit, zero, at_q, at_p : np.ndarray, shape (d,)
        Arguments and results of its functions.

    """

    present: bool
    target: Target
    inverse: np.ndarray
    mass: np.ndarray
    momentum: np.ndarray
    turned: np.ndarray
    unit: np.ndarray
    zero: np.ndarray
    at_q: np.ndarray
    at_p: np.ndarray


def prior_of(card: MechanicalCard) -> Prior:
    """Return the prior of a card."""
    d = len(card.kinds)
    # Without a prior, a kernel whose functions are neither called nor, hence, compiled.
    kernel = create('free_particle', {'mass': 1.0}).kernel if card.prior is None else \
        prior_kernel(card.prior, card.angles)
    target = by_address(kernel).parameters
    assert isinstance(target, Target)
    return Prior(card.prior is not None, target, *np.zeros((2, d, d)), *np.zeros((6, d)))


def prior_kernel(prior: PriorCard, angles: Sequence[Sequence[float]]) -> Kernel:
    """Return the functions of a prior alone."""
    if prior.tree is not None:
        return tree_kernel(prior.bodies)
    return chain_kernel(angles, prior.values) if prior.kind in CHAINS else \
        create(prior.kind, prior.values).kernel


@part(error_model='numpy')
def add_mass(prior: Prior, q: np.ndarray, share: float, total: np.ndarray) -> None:
    """Add a share of the lower triangle of M, which is stored for the other functions."""
    inverse, mass, unit, d = prior.inverse, prior.mass, prior.unit, q.size
    for j in range(d):
        unit[:] = 0.0
        unit[j] = 1.0
        hessian_vector(prior.target, q, prior.zero, prior.zero, unit, prior.at_q, prior.at_p)
        for i in range(d):
            inverse[i, j] = prior.at_p[i]
    if not factorise(inverse):
        inverse[:] = np.nan
    for j in range(d):
        unit[:] = 0.0
        unit[j] = 1.0
        solve_cholesky(inverse, unit)
        for i in range(d):
            mass[i, j] = unit[i]
    for i in range(d):
        for j in range(i + 1):
            total[i, j] += share * mass[i, j]


@part(error_model='numpy')
def prior_potential(prior: Prior, q: np.ndarray) -> float:
    """Return V."""
    return energy(prior.target, q, prior.zero)


@part(error_model='numpy')
def add_prior_slope(prior: Prior, q: np.ndarray, v: np.ndarray, share: float,
                    covector: np.ndarray) -> None:
    """Add a share of V_q - (v . M v)_q / 2 at constant v; call add_mass first."""
    momentum = prior.momentum
    for i in range(q.size):
        momentum[i] = 0.0
        for j in range(q.size):
            momentum[i] += prior.mass[i, j] * v[j]
    gradient(prior.target, q, momentum, prior.at_q, prior.at_p)
    for i in range(q.size):
        covector[i] += share * prior.at_q[i]


@part(error_model='numpy')
def subtract_turned_mass(prior: Prior, q: np.ndarray, v_q: np.ndarray, v: np.ndarray,
                         share: float, right: np.ndarray) -> None:
    """Subtract a share of M' v, for the change M' of M along v_q; call add_mass first."""
    momentum, turned, unit = prior.momentum, prior.turned, prior.unit
    for i in range(q.size):
        unit[i] = v_q[i]
        momentum[i] = 0.0
        for j in range(q.size):
            momentum[i] += prior.mass[i, j] * v[j]
    hessian_vector(prior.target, q, momentum, unit, prior.zero, prior.at_q, prior.at_p)
    for i in range(q.size):
        turned[i] = 0.0
        for j in range(q.size):
            turned[i] -= prior.mass[i, j] * prior.at_p[j]
        right[i] -= share * turned[i]


@part(error_model='numpy')
def add_prior_slope_change(prior: Prior, q: np.ndarray, v: np.ndarray, v_q: np.ndarray,
                           v_change: np.ndarray, share: float, covector: np.ndarray) -> None:
    """Add a share of the change of H_q(q, M v); call subtract_turned_mass first."""
    unit, turned = prior.unit, prior.turned
    for i in range(q.size):
        prior.zero[i] = v_q[i]
        unit[i] = turned[i]
        for j in range(q.size):
            unit[i] += prior.mass[i, j] * v_change[j]
    hessian_vector(prior.target, q, prior.momentum, prior.zero, unit, prior.at_q, prior.at_p)
    prior.zero[:] = 0.0
    for i in range(q.size):
        covector[i] += share * prior.at_q[i]
