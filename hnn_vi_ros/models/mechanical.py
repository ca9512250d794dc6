# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
A learned Hamiltonian of a mechanism: H = p . M(q)^-1 p / 2 + V(q), with networks for M and V.

M and V of the networks are a graph, with tapes for their values, changes, and H_q. M and V of
priors, whose kernels are called by address, are added.
"""

from collections.abc import Sequence
from typing import NamedTuple

from hnn_vi_ros.hamiltonians import tree_kernel
from hnn_vi_ros.kernels import (
    address_of, block, by_address, energy as energy_of, factorise, flat, gradient as gradient_of,
    hessian_vector as hessian_vector_of, Kernel, load, part, solve_cholesky, Target, type_of)
from hnn_vi_ros.models.exact_prior import create
from hnn_vi_ros.models.graphs.derivatives import gradient as add_gradient, tangent
from hnn_vi_ros.models.graphs.family_graphs import mechanism
from hnn_vi_ros.models.graphs.graph import Builder
from hnn_vi_ros.models.graphs.machine import assembled, GraphParameters, run
from hnn_vi_ros.models.graphs.tape import program
from hnn_vi_ros.models.learned import LearnedHamiltonian
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
            hessian_vector_of(
                prior.target, q, prior.zero, prior.zero, unit, prior.at_q, prior.at_p)
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
        total += energy_of(prior.target, q, prior.zero) / priors.words[0]
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
        gradient_of(prior.target, q, momentum, prior.at_q, prior.at_p)
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
        hessian_vector_of(prior.target, q, momentum, unit, prior.zero, prior.at_q, prior.at_p)
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
        hessian_vector_of(
            prior.target, q, prior.momentum, prior.zero, unit, prior.at_q, prior.at_p)
        prior.zero[:] = 0.0
        for i in range(q.size):
            covector[i] += prior.at_q[i] / priors.words[0]


class MechanicalParameters(NamedTuple):
    """
    Parameters of the functions of a mechanism, their first argument.

    Parameters
    ----------
    graph : GraphParameters
        Tapes of M and then V; of M and then H_q; and of M, then M' v, and then the change of H_q.
        Their inputs are q and v, and the changes of both.
    priors : Priors
        The priors of the model, or of the members of a mean.
    factor : np.ndarray, shape (d, d)
        The Cholesky factor of M.
    v, v_v : np.ndarray, shape (d,)
        The velocity, and its change.

    """

    graph: GraphParameters
    priors: Priors
    factor: np.ndarray
    v: np.ndarray
    v_v: np.ndarray


class MechanicalHamiltonian(LearnedHamiltonian):
    """
    H(q, p) = p . M(q)^-1 p / 2 + V(q), with M = S (L L^T + floor) S.

    The network ``mass`` gives the entries of the lower triangular L, with log(1 + exp(y)) on its
    diagonal, and ``potential`` gives V; the card defines their inputs from q, S and the floor.
    p = M(q) v is the model's own momentum, and

        H_p = v = M^-1 p,    H_q = V' - (v . M v)_q / 2 at constant v.

    Its friction is the effect learned_friction. A prior of the card, rigid links or an exact
    system, adds its M and V with fitted parameters, and the networks give the remainder.

    For an ensemble, M and V are the means of the members': the mean of their Lagrangians, which
    are functions of the measured q and q'. With the mean of friction and input maps, the force
    that the mean needs for a motion is the mean of the members' forces: a motion of all members
    is also one of the mean, even if they differ by a common factor of M, V and friction, which
    motions with small forces hardly determine.

    Parameters
    ----------
    checkpoint : Checkpoint
        A model of the family mechanical, or an ensemble of them.

    References
    ----------
    M. Lutter, C. Ritter, J. Peters, Deep Lagrangian Networks: Using Physics as Model Prior for
    Deep Learning, ICLR 2019 (M = L L^T, with a diagonal that is positive).

    """

    def _kernel(self) -> Kernel:
        card = self.checkpoint.card.mechanical
        assert card is not None, 'checked with the card: the family has one'
        if card.prior is not None and card.prior.alone and not self.checkpoint.members:
            return prior_kernel(card.prior, card.angles)
        b, d = Builder(), self.dimension
        x, change = (b.input(2 * d, number) for number in range(2))
        q, row = b.take(x, np.arange(d)), b.take(x, np.arange(d, 2 * d).reshape(1, d))
        root, mass, potential = mechanism(b, self.checkpoint, q)
        w = b.matmul(root, row, False, True)
        # The derivative of -|R v|^2 / 2 by R is -(R v) v^T.
        slope = add_gradient(
            b, b.concatenate([root, potential]), q,
            b.concatenate([b.matmul(b.neg(w), row), b.full(potential, 1.0)]))
        turned = tangent(b, b.matmul(root, w, True), q, b.take(change, np.arange(d)))
        graph = assembled(*program(
            b, [x, change], [mass, potential], [mass, slope],
            [mass, turned, tangent(b, slope, x, change)]), d)
        cards = [one.card.mechanical for one in self.checkpoint.members or (self.checkpoint,)]
        priors = priors_of([card for card in cards if card is not None])
        return self._kernel_of(energy, gradient, hessian_vector, MechanicalParameters(
            graph, priors, np.zeros((d, d)), *np.zeros((2, d))))


def energy(parameters: MechanicalParameters, q: np.ndarray, p: np.ndarray) -> float:
    """Return H; see Kernel."""
    graph, v = parameters.graph, parameters.v
    _solve(parameters, q, p, 0)
    run(graph, 1)
    energy = graph.memory[graph.places[1]] + prior_potential(parameters.priors, q)
    for i in range(q.size):
        energy += 0.5 * p[i] * v[i]
    return float(energy)


def gradient(parameters: MechanicalParameters, q: np.ndarray, p: np.ndarray,
             dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    """Fill the gradient; see Kernel."""
    graph, v = parameters.graph, parameters.v
    d, place = v.size, graph.places[3]
    for a in range(0, q.size, d):
        b = a + d
        _solve(parameters, q[a:b], p[a:b], 2)
        run(graph, 3)
        for i in range(d):
            dH_dq[a + i], dH_dp[a + i] = graph.memory[place + i], v[i]
        add_prior_slope(parameters.priors, q[a:b], v, dH_dq[a:b])


def hessian_vector(parameters: MechanicalParameters, q: np.ndarray, p: np.ndarray,
                   v_q: np.ndarray, v_p: np.ndarray, product_q: np.ndarray,
                   product_p: np.ndarray) -> None:
    """Fill the change of the gradient along (v_q, v_p), using M v' = p' - M' v."""
    graph, priors, v, v_v = parameters.graph, parameters.priors, parameters.v, parameters.v_v
    memory, d, turned, place = graph.memory, v.size, graph.places[5], graph.places[6]
    for a in range(0, q.size, d):
        b = a + d
        for i in range(d):
            memory[2 * d + i] = v_q[a + i]
        _solve(parameters, q[a:b], p[a:b], 4)
        run(graph, 5)
        for i in range(d):
            v_v[i] = v_p[a + i] - memory[turned + i]
        subtract_turned_mass(priors, q[a:b], v_q[a:b], v, v_v)
        solve_cholesky(parameters.factor, v_v)
        for i in range(d):
            memory[3 * d + i] = v_v[i]
        run(graph, 6)
        for i in range(d):
            product_q[a + i], product_p[a + i] = memory[place + i], v_v[i]
        add_prior_slope_change(priors, q[a:b], v, v_q[a:b], v_v, product_q[a:b])


@part(error_model='numpy')
def _solve(parameters: MechanicalParameters, q: np.ndarray, p: np.ndarray, tape: int) -> None:
    """Fill the factor of M by a tape, and v, also as input of tapes; v is NaN without a factor."""
    graph, factor, v = parameters.graph, parameters.factor, parameters.v
    memory, place, d = graph.memory, graph.places[tape], v.size
    for i in range(d):
        memory[i] = q[i]
    run(graph, tape)
    for i in range(d):
        v[i] = p[i]
        for j in range(i + 1):
            factor[i, j] = memory[place + i * d + j]
    add_mass(parameters.priors, q, factor)
    if not factorise(factor):
        v[:] = np.nan
    solve_cholesky(factor, v)
    for i in range(d):
        memory[d + i] = v[i]
