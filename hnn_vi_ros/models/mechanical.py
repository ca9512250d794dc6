# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
A learned Hamiltonian of a mechanism: H = p . M(q)^-1 p / 2 + V(q), with networks for M and V.

M and V of the networks are a graph, with tapes for their values, changes, and H_q.
"""

from typing import NamedTuple

from hnn_vi_ros.kernels import factorise, Kernel, part, solve_cholesky
from hnn_vi_ros.models.graphs.derivatives import gradient as add_gradient, tangent
from hnn_vi_ros.models.graphs.family_graphs import mechanism
from hnn_vi_ros.models.graphs.graph import Builder
from hnn_vi_ros.models.graphs.machine import assembled, GraphParameters, run
from hnn_vi_ros.models.graphs.tape import program
from hnn_vi_ros.models.learned import LearnedHamiltonian
from hnn_vi_ros.models.priors import (
    add_mass, add_prior_slope, add_prior_slope_change, prior_kernel, prior_potential, Priors,
    priors_of, subtract_turned_mass)
import numpy as np


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
