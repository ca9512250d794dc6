# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Terms of an exact system added to a learned M and V, compiled: its kernel by address."""

from typing import NamedTuple

from hnn_vi_ros.kernels.addresses import (
    by_address, energy, gradient, hessian_vector, Target)
from hnn_vi_ros.kernels.compilation import kept
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.kernels.linear_algebra import factorise, solve_lower, solve_upper
import numpy as np


class ExactTerms(NamedTuple):
    """
    A system by address, and space for one state.

    Parameters
    ----------
    target : Target
        Its functions and parameters.
    inverse, mass : np.ndarray, shape (d, d)
        M^-1, overwritten by its Cholesky factor; and M at the coordinates seen last.
    momentum, turned : np.ndarray, shape (d,)
        pi = M v, and M' v.
    unit, zero, at_q, at_p : np.ndarray, shape (d,)
        What its functions take and fill.

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


def exact_terms(kernel: Kernel) -> ExactTerms:
    """Return the terms of a system."""
    d = kernel.dimension
    target = by_address(kernel).parameters
    assert isinstance(target, Target)
    return ExactTerms(target, *np.zeros((2, d, d)), *np.zeros((6, d)))


@kept(error_model='numpy')
def add_mass(prior: ExactTerms, q: np.ndarray, scale: np.ndarray, gram: np.ndarray) -> None:
    """Add S^-1 M S^-1 on and below the diagonal; M is kept for all others."""
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
        solve_lower(inverse, unit)
        solve_upper(inverse, unit)
        for i in range(d):
            mass[i, j] = unit[i]
    for i in range(d):
        for j in range(i + 1):
            gram[i, j] += mass[i, j] / (scale[i] * scale[j])


@kept(error_model='numpy')
def prior_potential(prior: ExactTerms, q: np.ndarray) -> float:
    """Return V."""
    return energy(prior.target, q, prior.zero)


@kept(error_model='numpy')
def add_prior_slope(prior: ExactTerms, q: np.ndarray, v: np.ndarray, covector: np.ndarray
                    ) -> None:
    """Add V_q - (v . M v)_q / 2 at held v, after add_mass."""
    momentum = prior.momentum
    for i in range(q.size):
        momentum[i] = 0.0
        for j in range(q.size):
            momentum[i] += prior.mass[i, j] * v[j]
    gradient(prior.target, q, momentum, prior.at_q, prior.at_p)
    for i in range(q.size):
        covector[i] += prior.at_q[i]


@kept(error_model='numpy')
def subtract_turned_mass(prior: ExactTerms, q: np.ndarray, v_q: np.ndarray, v: np.ndarray,
                         scale: np.ndarray, right: np.ndarray) -> None:
    """Subtract S^-1 M' v, M' being the change of M along v_q, after add_mass."""
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
        right[i] -= turned[i] / scale[i]


@kept(error_model='numpy')
def add_prior_slope_change(prior: ExactTerms, q: np.ndarray, v: np.ndarray, v_q: np.ndarray,
                           v_change: np.ndarray, covector: np.ndarray) -> None:
    """Add the change of H_q(q, M v) along changes of q and v, after subtract_turned_mass."""
    unit, turned = prior.unit, prior.turned
    for i in range(q.size):
        prior.zero[i] = v_q[i]
        unit[i] = turned[i]
        for j in range(q.size):
            unit[i] += prior.mass[i, j] * v_change[j]
    hessian_vector(prior.target, q, prior.momentum, prior.zero, unit, prior.at_q, prior.at_p)
    prior.zero[:] = 0.0
    for i in range(q.size):
        covector[i] += prior.at_q[i]
