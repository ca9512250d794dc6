# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""M and V of priors of the family mechanical, added to its networks; their kernels by address."""

from collections.abc import Sequence
from typing import NamedTuple

from hnn_vi_ros.hamiltonians import tree_kernel
from hnn_vi_ros.kernels import (
    address_of, block, by_address, energy, factorise, flat, gradient, hessian_vector, Kernel, load,
    part, solve_cholesky, Target, type_of)
from hnn_vi_ros.models.exact_prior import create
from hnn_vi_ros.models.mechanical_card import MechanicalCard, PriorCard
from hnn_vi_ros.models.planar_chain import chain_kernel, CHAINS
import numpy as np


class Prior(NamedTuple):
    """
    A system by address, and workspace for one state.

    Parameters
    ----------
    target : Target
        Its functions and parameters.
    inverse, mass : np.ndarray, shape (d, d)
        M^-1, overwritten by its Cholesky factor; and M at the last coordinates.
    momentum, turned : np.ndarray, shape (d,)
        pi = M v, and M' v.
    unit, zero, at_q, at_p : np.ndarray, shape (d,)
        Arguments and results of its functions.

    """

    target: Target
    inverse: np.ndarray
    mass: np.ndarray
    momentum: np.ndarray
    turned: np.ndarray
    unit: np.ndarray
    zero: np.ndarray
    at_q: np.ndarray
    at_p: np.ndarray


def _prior(target: Target, d: int) -> Prior:
    return Prior(target, *np.zeros((2, d, d)), *np.zeros((6, d)))


_EXAMPLE = _prior(Target(np.zeros(1, dtype=np.int64)), 1)
# The type of a prior, and its size in memory in bytes.
_PRIOR, _BYTES = type_of(_EXAMPLE), 8 * len(flat(_EXAMPLE))


class Priors(NamedTuple):
    """
    The priors of a model, or of the members of an ensemble; the functions here add their means.

    Parameters
    ----------
    words : np.ndarray of int64
        Their number, then each Prior as words in numba's layout.

    """

    words: np.ndarray


def priors_of(cards: Sequence[MechanicalCard]) -> Priors:
    """Return the priors of cards; either each card has one, or none has."""
    found = []
    for card in cards:
        if card.prior is not None:
            target = by_address(prior_kernel(card.prior, card.angles)).parameters
            assert isinstance(target, Target)
            found.append(_prior(target, len(card.kinds)))
    return Priors(block(tuple(found), len(found)))


def prior_kernel(prior: PriorCard, angles: Sequence[Sequence[float]]) -> Kernel:
    """Return the functions of a prior alone."""
    if prior.tree is not None:
        return tree_kernel(prior.bodies)
    return chain_kernel(angles, prior.values) if prior.kind in CHAINS else \
        create(prior.kind, prior.values).kernel


@part(forceinline=True)
def _load(priors: Priors, k: int) -> Prior:
    return load(address_of(priors.words) + 8 + k * _BYTES, _PRIOR)


@part(error_model='numpy')
def add_mass(priors: Priors, q: np.ndarray, total: np.ndarray) -> None:
    """Add the lower triangle of M, which is stored for the other functions."""
    for k in range(priors.words[0]):
        prior = _load(priors, k)
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
                total[i, j] += mass[i, j] / priors.words[0]


@part(error_model='numpy')
def prior_potential(priors: Priors, q: np.ndarray) -> float:
    """Return V."""
    total = 0.0
    for k in range(priors.words[0]):
        prior = _load(priors, k)
        total += energy(prior.target, q, prior.zero) / priors.words[0]
    return total


@part(error_model='numpy')
def add_prior_slope(priors: Priors, q: np.ndarray, v: np.ndarray, covector: np.ndarray) -> None:
    """Add V_q - (v . M v)_q / 2 at constant v; call add_mass first."""
    for k in range(priors.words[0]):
        prior = _load(priors, k)
        momentum = prior.momentum
        for i in range(q.size):
            momentum[i] = 0.0
            for j in range(q.size):
                momentum[i] += prior.mass[i, j] * v[j]
        gradient(prior.target, q, momentum, prior.at_q, prior.at_p)
        for i in range(q.size):
            covector[i] += prior.at_q[i] / priors.words[0]


@part(error_model='numpy')
def subtract_turned_mass(priors: Priors, q: np.ndarray, v_q: np.ndarray, v: np.ndarray,
                         right: np.ndarray) -> None:
    """Subtract M' v, where M' is the change of M along v_q; call add_mass first."""
    for k in range(priors.words[0]):
        prior = _load(priors, k)
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
            right[i] -= turned[i] / priors.words[0]


@part(error_model='numpy')
def add_prior_slope_change(priors: Priors, q: np.ndarray, v: np.ndarray, v_q: np.ndarray,
                           v_change: np.ndarray, covector: np.ndarray) -> None:
    """Add the change of H_q(q, M v) with q and v; call subtract_turned_mass first."""
    for k in range(priors.words[0]):
        prior = _load(priors, k)
        unit, turned = prior.unit, prior.turned
        for i in range(q.size):
            prior.zero[i] = v_q[i]
            unit[i] = turned[i]
            for j in range(q.size):
                unit[i] += prior.mass[i, j] * v_change[j]
        hessian_vector(prior.target, q, prior.momentum, prior.zero, unit, prior.at_q, prior.at_p)
        prior.zero[:] = 0.0
        for i in range(q.size):
            covector[i] += prior.at_q[i] / priors.words[0]
