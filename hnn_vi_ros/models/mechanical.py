# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
A learned Hamiltonian of a mechanism: H = p . M(q)^-1 p / 2 + V(q), with networks for M and V.

M and V of the networks are a graph, with tapes for their values, changes, and H_q.
"""

from typing import NamedTuple

from hnn_vi_ros.kernels import factorise, Kernel, part, solve_cholesky
from hnn_vi_ros.models.graphs.derivatives import gradient as add_gradient, tangent
from hnn_vi_ros.models.graphs.family_graphs import mass_and_potential
from hnn_vi_ros.models.graphs.graph import Builder
from hnn_vi_ros.models.graphs.machine import assembled, GraphParameters, run
from hnn_vi_ros.models.graphs.tape import Assembler
from hnn_vi_ros.models.learned import LearnedHamiltonian
from hnn_vi_ros.models.networks.perceptron_memory import pack_mapping
from hnn_vi_ros.models.priors import (
    add_mass, add_prior_slope, add_prior_slope_change, Prior, prior_kernel, prior_of,
    prior_potential, subtract_turned_mass)
import numpy as np


class MechanicalParameters(NamedTuple):
    """
    Parameters of the functions of a mechanism, their first argument.

    Parameters
    ----------
    graph : GraphParameters
        Tapes of M and V, both row by row; of M; of H_q, after M; of M and its change M' along
        v_q; and of the change of H_q, after them. Their inputs are q and G, and the changes of
        both, where H_q is the derivative of V + sum_ij G_ij M_ij at constant G = -v v^T / 2.
    priors : tuple of Prior
        The prior of each member of a mean, or of the model.
    factor : np.ndarray, shape (d, d)
        The Cholesky factor of M.
    v, v_v : np.ndarray, shape (d,)
        The velocity, and its change.

    """

    graph: GraphParameters
    priors: tuple[Prior, ...]
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

    Of an ensemble, M and V are the means of the members': the mean of their Lagrangians, which
    are functions of the measured q and q'. With the mean of friction and input maps, the force
    that the mean needs for a motion is the mean of the members' forces: a motion of all members
    is also one of the mean, even if they differ by a common factor of M, V and friction, which
    motions with small forces hardly determine.

    Parameters
    ----------
    checkpoint : Checkpoint
        A model of the family mechanical, or an ensemble of such models.

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
        x, change = (b.input(d + d * d, number) for number in range(2))
        q, G = b.take(x, np.arange(d)), b.take(x, np.arange(d, d + d * d).reshape(d, d))
        mass, potential = mass_and_potential(b, self.checkpoint, q)
        turned = tangent(b, mass, x, change)
        weighted = b.reshape(b.sum(b.mul(G, mass), (0, 1)), (1,))
        slope = add_gradient(b, b.add(weighted, potential), q)
        assembler = Assembler(b, [x, change])
        tapes = [tape for outputs in (
            [b.concatenate([mass, potential])], [mass, slope],
            [b.concatenate([mass, turned]), tangent(b, slope, x, change)])
            for tape in assembler.tapes(outputs)]
        graph = assembled(
            assembler.memory(), assembler.index(), tapes,
            [pack_mapping(*layers, activation) for layers, activation in b.networks], d)
        cards = [one.card.mechanical for one in self.checkpoint.members or (self.checkpoint,)]
        priors = tuple(prior_of(card) for card in cards if card is not None)
        return self._kernel_of(energy, gradient, hessian_vector, MechanicalParameters(
            graph, priors, np.zeros((d, d)), *np.zeros((2, d))))


def energy(parameters: MechanicalParameters, q: np.ndarray, p: np.ndarray) -> float:
    """Return H; see Kernel."""
    graph, v, priors = parameters.graph, parameters.v, parameters.priors
    _solve(parameters, q, p, 0)
    energy = graph.memory[graph.places[0] + q.size * q.size]
    for prior in priors:
        if prior.present:
            energy += prior_potential(prior, q) / len(priors)
    for i in range(q.size):
        energy += 0.5 * p[i] * v[i]
    return float(energy)


def gradient(parameters: MechanicalParameters, q: np.ndarray, p: np.ndarray,
             dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    """Fill the gradient; see Kernel."""
    graph, v, priors = parameters.graph, parameters.v, parameters.priors
    d, place, share = v.size, graph.places[2], 1.0 / len(priors)
    for a in range(0, q.size, d):
        b = a + d
        _solve(parameters, q[a:b], p[a:b], 1)
        run(graph, 2)
        for i in range(d):
            dH_dq[a + i], dH_dp[a + i] = graph.memory[place + i], v[i]
        for prior in priors:
            if prior.present:
                add_prior_slope(prior, q[a:b], v, share, dH_dq[a:b])


def hessian_vector(parameters: MechanicalParameters, q: np.ndarray, p: np.ndarray,
                   v_q: np.ndarray, v_p: np.ndarray, product_q: np.ndarray,
                   product_p: np.ndarray) -> None:
    """Fill the change of the gradient along (v_q, v_p), using M v' = p' - M' v."""
    graph, priors, v, v_v = parameters.graph, parameters.priors, parameters.v, parameters.v_v
    memory, d, share = graph.memory, v.size, 1.0 / len(priors)
    turned, place, second = graph.places[3] + d * d, graph.places[4], d + d * d
    for a in range(0, q.size, d):
        b = a + d
        for i in range(d):
            memory[second + i] = v_q[a + i]
        _solve(parameters, q[a:b], p[a:b], 3)
        for i in range(d):
            v_v[i] = v_p[a + i]
            for j in range(d):
                v_v[i] -= memory[turned + i * d + j] * v[j]
        for prior in priors:
            if prior.present:
                subtract_turned_mass(prior, q[a:b], v_q[a:b], v, share, v_v)
        solve_cholesky(parameters.factor, v_v)
        for i in range(d):
            for j in range(d):
                memory[second + d + i * d + j] = -0.5 * (v_v[i] * v[j] + v[i] * v_v[j])
        run(graph, 4)
        for i in range(d):
            product_q[a + i], product_p[a + i] = memory[place + i], v_v[i]
        for prior in priors:
            if prior.present:
                add_prior_slope_change(
                    prior, q[a:b], v, v_q[a:b], v_v, share, product_q[a:b])


@part(error_model='numpy')
def _solve(parameters: MechanicalParameters, q: np.ndarray, p: np.ndarray, tape: int) -> None:
    """Fill the factor of M by a tape, v, and G; v is NaN if no factor exists."""
    graph, priors, factor, v = (
        parameters.graph, parameters.priors, parameters.factor, parameters.v)
    memory, place, d, share = graph.memory, graph.places[tape], v.size, 1.0 / len(priors)
    for i in range(d):
        memory[i] = q[i]
    run(graph, tape)
    for i in range(d):
        v[i] = p[i]
        for j in range(i + 1):
            factor[i, j] = memory[place + i * d + j]
    for prior in priors:
        if prior.present:
            add_mass(prior, q, share, factor)
    if not factorise(factor):
        v[:] = np.nan
    solve_cholesky(factor, v)
    for i in range(d):
        for j in range(d):
            memory[d + i * d + j] = -0.5 * v[i] * v[j]
