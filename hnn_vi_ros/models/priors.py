# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Priors of the family mechanical, added to its networks: rigid links, or an exact system."""

from collections.abc import Callable
from typing import NamedTuple

from hnn_vi_ros.hamiltonians.rigid_body.sweeps import Bodies
from hnn_vi_ros.hamiltonians.rigid_body.tree import mass_matrix
from hnn_vi_ros.hamiltonians.rigid_body.tree_kernel import extended_gradient, tree_kernel
from hnn_vi_ros.kernels.compilation import identify
from hnn_vi_ros.models import exact_terms, prior_terms
from hnn_vi_ros.models.exact_prior import create, exact_gradient
from hnn_vi_ros.models.exact_terms import ExactTerms
from hnn_vi_ros.models.mechanical_card import MechanicalCard
from hnn_vi_ros.models.planar_chain import CHAINS, Terms
import numpy as np


class Prior(NamedTuple):
    """
    M and V of a prior, compiled; see prior_terms.py and exact_terms.py.

    Parameters
    ----------
    own : Terms or ExactTerms
        What its functions take first.
    add_mass, potential, add_slope, subtract_turned_mass, add_slope_change : callable
        Functions that are called in this order at each state.

    """

    own: Terms | ExactTerms
    add_mass: Callable[..., None]
    potential: Callable[..., float]
    add_slope: Callable[..., None]
    subtract_turned_mass: Callable[..., None]
    add_slope_change: Callable[..., None]


_LINKS = (prior_terms.add_mass, prior_terms.prior_potential, prior_terms.add_prior_slope,
          prior_terms.subtract_turned_mass, prior_terms.add_prior_slope_change)
_EXACT = (exact_terms.add_mass, exact_terms.prior_potential, exact_terms.add_prior_slope,
          exact_terms.subtract_turned_mass, exact_terms.add_prior_slope_change)
for _function in (*_LINKS, *_EXACT):
    # They are among the parameters of compiled functions; see identify.
    identify(_function)


def prior_of(card: MechanicalCard) -> Prior:
    """Return the prior of a card, of no terms where it has none."""
    if card.prior is None or card.prior.kind in CHAINS:
        return Prior(card.terms, *_LINKS)
    kernel = tree_kernel(card.prior.bodies) if card.prior.tree is not None else \
        create(card.prior.kind, card.prior.values).kernel
    return Prior(exact_terms.exact_terms(kernel), *_EXACT)


def added(card: MechanicalCard, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return M, shape (m, d, d), and V_q - (v . M v)_q / 2 of (m, d), in extended precision."""
    if card.prior is None or card.prior.kind in CHAINS:
        return prior_terms.prior_gradient(card.terms, q, v)
    if card.prior.tree is not None:
        return _tree_gradient(card.prior.bodies, q, v)
    return exact_gradient(create(card.prior.kind, card.prior.values), q, v)


def _tree_gradient(bodies: Bodies, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    masses = np.stack([mass_matrix(bodies, one) for one in q.astype(np.longdouble)])
    momenta = (masses @ v[:, :, None])[:, :, 0]
    return masses, extended_gradient(bodies, q, momenta)[0]
