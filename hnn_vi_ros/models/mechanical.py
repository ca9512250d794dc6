# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A learned Hamiltonian of a mechanism: a mass matrix and a potential that are networks of q."""

from typing import NamedTuple

from hnn_vi_ros.hamiltonians.rigid_body.tree_kernel import tree_kernel
from hnn_vi_ros.kernels.compilation import kept
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.kernels.linear_algebra import factorise, solve_lower, solve_upper
from hnn_vi_ros.kernels.linking import part
from hnn_vi_ros.models.features import (
    add_covector, add_covector_change, even_layers, Features, inputs_of, pack_features, see,
    see_change)
from hnn_vi_ros.models.learned import LearnedHamiltonian
from hnn_vi_ros.models.mechanical_card import MechanicalCard
from hnn_vi_ros.models.outputs import (
    evaluate_outputs, output_tangents, pack_layers, PackedOutputs, part_gradient, weigh)
from hnn_vi_ros.models.priors import added, Prior, prior_of
from hnn_vi_ros.networks import perceptron
from hnn_vi_ros.networks.perceptron_memory import pack, PackedPerceptron
import numpy as np


class MassNetwork(NamedTuple):
    """
    The network of M of k entries.

    Parameters
    ----------
    outputs : PackedOutputs
        The network of y.
    seen : Features
        What it sees of q.
    places : np.ndarray of int, shape (k, 2)
        Row and column of each entry in L.
    scale : np.ndarray, shape (d,)
        The diagonal of S.
    floor : float
        What is added to the diagonal of L L^T.

    """

    outputs: PackedOutputs
    seen: Features
    places: np.ndarray
    scale: np.ndarray
    floor: float


class PotentialNetwork(NamedTuple):
    """The network of V, and what it sees of q."""

    network: PackedPerceptron
    seen: Features


class MechanicalWork(NamedTuple):
    """
    Space for one state; what ends in ``_v`` is a change along a direction.

    Parameters
    ----------
    y, y_v, c, c_v : np.ndarray, shape (k,)
        The entries, and their cotangent u_i w_j L_ij'(y): the derivative of -H by them.
    L, L_v, factor : np.ndarray, shape (d, d)
        L, and the Cholesky factor of S^-1 M S^-1.
    v, u, u_v, w, w_v : np.ndarray, shape (d,)
        The velocity, u = S v and w = L^T u.
    turned : np.ndarray, shape (d,)
        L'^T u of the change L' of L.

    """

    y: np.ndarray
    y_v: np.ndarray
    c: np.ndarray
    c_v: np.ndarray
    L: np.ndarray
    L_v: np.ndarray
    factor: np.ndarray
    v: np.ndarray
    u: np.ndarray
    u_v: np.ndarray
    w: np.ndarray
    w_v: np.ndarray
    turned: np.ndarray

    @classmethod
    def empty(cls, entries: int, d: int) -> 'MechanicalWork':
        """Return space for so many entries and coordinates."""
        return cls(*np.zeros((4, entries)), *np.zeros((3, d, d)), *np.zeros((6, d)))


class MechanicalParameters(NamedTuple):
    """Parameters of the functions of a mechanism: M, V, what a prior adds, and space."""

    mass: MassNetwork
    potential: PotentialNetwork
    prior: Prior
    work: MechanicalWork


class MechanicalHamiltonian(LearnedHamiltonian):
    """
    H(q, p) = p . M(q)^-1 p / 2 + V(q), with M = S (L L^T + floor) S.

    The network ``mass`` gives the entries y of the lower triangular L, those of its diagonal as
    log(1 + exp(y)), and ``potential`` gives V; what they see of q, S and the floor stand in the
    card. p = M(q) v is the model's own momentum. With u = S v and w = L^T u,

        H_p = v = M^-1 p,    H_q = V' - sum_ij u_i w_j L_ij',

    since v . M v = |w|^2 + floor |u|^2: one forward and one backward pass through each network.
    Its friction is the effect learned_friction. A prior of the card, rigid links or an exact
    system, adds its M and V of fitted parameters, and the networks are what it lacks.

    Parameters
    ----------
    checkpoint : Checkpoint
        Of the family mechanical.

    References
    ----------
    M. Lutter, C. Ritter, J. Peters, Deep Lagrangian Networks: Using Physics as Model Prior for
    Deep Learning, ICLR 2019 (M = L L^T, with a diagonal that is positive).

    """

    @property
    def _mechanical(self) -> MechanicalCard:
        card = self.checkpoint.card.mechanical
        assert card is not None, 'checked with the card: the family has one'
        return card

    def _kernel(self) -> Kernel:
        card, d, prior = self.checkpoint.card, self.dimension, self._mechanical.prior
        if prior is not None and prior.alone:
            return tree_kernel(prior.bodies)
        mechanical, networks = self._mechanical, self.checkpoint.networks
        mass = MassNetwork(
            pack_layers(even_layers(networks['mass']), card.activation),
            pack_features(mechanical, mechanical.mass_features), np.array(mechanical.entries),
            np.array(mechanical.mass_scale), mechanical.floor)
        potential = PotentialNetwork(
            pack(*even_layers(networks['potential']), card.activation),
            pack_features(mechanical, mechanical.features))
        parameters = MechanicalParameters(mass, potential, prior_of(mechanical),
                                          MechanicalWork.empty(len(mechanical.entries), d))
        return Kernel(_energy, _gradient, _hessian_vector, parameters, d, (0.0, 0.0),
                      compiled=True)

    def masses(self, q: np.ndarray) -> np.ndarray:
        """Return M(q), shape (m, d, d), at q of shape (m, d), in extended precision."""
        return self._roots(q)[0] + added(self._mechanical, q, np.zeros(q.shape))[0]

    def _roots(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return M without the prior's, L, and the derivatives of L, shape (m, d, d, d)."""
        card, d = self._mechanical, self.dimension
        x, x_q = inputs_of(card, card.mass_features, q)
        y, y_x = self._evaluated('mass', x)
        y_q = y_x @ x_q
        L, L_q = np.zeros((len(q), d, d), y.dtype), np.zeros((len(q), d, d, d), y.dtype)
        for k, (i, j) in enumerate(card.entries):
            L[:, i, j], L_q[:, i, j] = y[:, k], y_q[:, k]
            if i == j:
                L[:, i, j] = np.logaddexp(0.0, y[:, k])
                L_q[:, i, j] /= 1.0 + np.exp(-y[:, k])[:, None]
        S = np.array(card.mass_scale)
        gram = (L[:, :, None, :] * L[:, None, :, :]).sum(axis=3)
        return S[:, None] * (gram + card.floor * np.eye(d)) * S, L, L_q

    def _extended_gradient(self, z: np.ndarray) -> np.ndarray:
        card, (q, p) = self._mechanical, np.split(z, 2, axis=1)
        L, L_q = self._roots(q)[1:]
        masses = self.masses(q)
        v = p.astype(np.longdouble)
        for mass, right in zip(masses, v, strict=True):
            factorise(mass)
            solve_lower(mass, right)
            solve_upper(mass, right)
        u = v * np.array(card.mass_scale)
        w = (L * u[:, :, None]).sum(axis=1)
        x, x_q = inputs_of(card, card.features, q)
        slope = (self._evaluated('potential', x)[1] @ x_q)[:, 0]
        kinetic = (L_q * (u[:, :, None] * w[:, None, :])[..., None]).sum(axis=(1, 2))
        return np.hstack([slope - kinetic + added(card, q, v)[1], v])


@kept(error_model='numpy')
def _energy(parameters: MechanicalParameters, q: np.ndarray, p: np.ndarray) -> float:
    potential, prior, v = parameters.potential, parameters.prior, parameters.work.v
    _solve(parameters, q, p)
    see(potential.seen, q)
    x = potential.seen.inputs
    half = x.size // 2
    energy = (perceptron.energy(potential.network, x[:half], x[half:])
              + prior.potential(prior.own, q))
    for i in range(p.size):
        energy += 0.5 * p[i] * v[i]
    return energy


@kept(error_model='numpy')
def _gradient(parameters: MechanicalParameters, q: np.ndarray, p: np.ndarray,
              dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    mass, potential, work = parameters.mass, parameters.potential, parameters.work
    prior, v = parameters.prior, work.v
    d = mass.scale.size
    for a in range(0, q.size, d):
        b = a + d
        _solve(parameters, q[a:b], p[a:b])
        _weigh_entries(parameters)
        weigh(mass.outputs, work.c)
        _seen_gradient(mass.outputs.network, mass.seen)
        see(potential.seen, q[a:b])
        _seen_gradient(potential.network, potential.seen)
        for i in range(d):
            dH_dq[a + i], dH_dp[a + i] = 0.0, v[i]
        add_covector(mass.seen, -1.0, mass.seen.cotangent, dH_dq[a:b])
        add_covector(potential.seen, 1.0, potential.seen.cotangent, dH_dq[a:b])
        prior.add_slope(prior.own, q[a:b], v, dH_dq[a:b])


@kept(error_model='numpy')
def _hessian_vector(parameters: MechanicalParameters, q: np.ndarray, p: np.ndarray,
                    v_q: np.ndarray, v_p: np.ndarray, product_q: np.ndarray,
                    product_p: np.ndarray) -> None:
    """Differentiate the lines of _gradient along (v_q, v_p)."""
    d, prior = parameters.mass.scale.size, parameters.prior
    for a in range(0, q.size, d):
        b = a + d
        product_q[a:b] = 0.0
        _solve(parameters, q[a:b], p[a:b])
        _weigh_entries(parameters)
        _differentiate_mass(parameters, q[a:b], v_q[a:b], v_p[a:b], product_q[a:b],
                            product_p[a:b])
        _differentiate_potential(parameters.potential, q[a:b], v_q[a:b], product_q[a:b])
        prior.add_slope_change(prior.own, q[a:b], parameters.work.v, v_q[a:b],
                               product_p[a:b], product_q[a:b])


@part(error_model='numpy')
def _seen_gradient(network: PackedPerceptron, seen: Features) -> None:
    """Fill the cotangent: the derivative of a network of one output by its inputs."""
    x, c = seen.inputs, seen.cotangent
    half = x.size // 2
    part_gradient(network, x[:half], x[half:], c[:half], c[half:])


@part(error_model='numpy')
def _seen_hessian_vector(network: PackedPerceptron, seen: Features) -> None:
    """Fill the change of the cotangent with that of the inputs."""
    x, x_v, c_v = seen.inputs, seen.change, seen.cotangent_change
    half = x.size // 2
    perceptron.hessian_vector(network, x[:half], x[half:], x_v[:half], x_v[half:],
                              c_v[:half], c_v[half:])


@part(error_model='numpy')
def _differentiate_potential(potential: PotentialNetwork, q: np.ndarray, v_q: np.ndarray,
                             product_q: np.ndarray) -> None:
    """Add V''(q) v_q."""
    seen = potential.seen
    see(seen, q)
    see_change(seen, v_q)
    _seen_gradient(potential.network, seen)
    _seen_hessian_vector(potential.network, seen)
    add_covector(seen, 1.0, seen.cotangent_change, product_q)
    add_covector_change(seen, 1.0, product_q)


@part(error_model='numpy')
def _differentiate_mass(parameters: MechanicalParameters, q: np.ndarray, v_q: np.ndarray,
                        v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
    """Fill the change of v, and add that of -sum_ij u_i w_j L_ij'; after _weigh_entries."""
    mass, prior, work = parameters.mass, parameters.prior, parameters.work
    outputs, seen, places, scale = mass.outputs, mass.seen, mass.places, mass.scale
    y, y_v, c_v = work.y, work.y_v, work.c_v
    L, L_v, turned = work.L, work.L_v, work.turned
    u, u_v, w, w_v = work.u, work.u_v, work.w, work.w_v
    d = scale.size
    see_change(seen, v_q)
    weigh(outputs, work.c)
    _seen_gradient(outputs.network, seen)
    _seen_hessian_vector(outputs.network, seen)
    add_covector(seen, -1.0, seen.cotangent_change, product_q)
    add_covector_change(seen, -1.0, product_q)
    output_tangents(outputs, y_v)
    for k in range(y.size):
        i, j = places[k]
        L_v[i, j] = y_v[k] * _slope(y[k]) if i == j else y_v[k]
    # A u = S^-1 p with A = L L^T + floor + S^-1 M S^-1 of the prior, so
    # A u' = S^-1 p' - L' w - L (L'^T u) - S^-1 M' v.
    for j in range(d):
        turned[j] = 0.0
        for i in range(j, d):
            turned[j] += L_v[i, j] * u[i]
    for i in range(d):
        u_v[i] = v_p[i] / scale[i]
        for j in range(i + 1):
            u_v[i] -= L_v[i, j] * w[j] + L[i, j] * turned[j]
    prior.subtract_turned_mass(prior.own, q, v_q, work.v, scale, u_v)
    solve_lower(work.factor, u_v)
    solve_upper(work.factor, u_v)
    for j in range(d):
        product_p[j] = u_v[j] / scale[j]
        w_v[j] = turned[j]
        for i in range(j, d):
            w_v[j] += L[i, j] * u_v[i]
    for k in range(y.size):
        i, j = places[k]
        c_v[k] = u_v[i] * w[j] + u[i] * w_v[j]
        if i == j:
            slope = _slope(y[k])
            c_v[k] = c_v[k] * slope + u[i] * w[j] * slope * (1.0 - slope) * y_v[k]
    weigh(outputs, c_v)
    _seen_gradient(outputs.network, seen)
    add_covector(seen, -1.0, seen.cotangent, product_q)


@part(error_model='numpy')
def _solve(parameters: MechanicalParameters, q: np.ndarray, p: np.ndarray) -> None:
    """Fill y, L, the Cholesky factor of L L^T + floor, and v, u, w; NaN where there is none."""
    mass, prior, work = parameters.mass, parameters.prior, parameters.work
    seen, places, scale = mass.seen, mass.places, mass.scale
    L, factor, y, v, u, w = work.L, work.factor, work.y, work.v, work.u, work.w
    d = scale.size
    see(seen, q)
    x = seen.inputs
    half = x.size // 2
    evaluate_outputs(mass.outputs, x[:half], x[half:], y)
    for k in range(y.size):
        i, j = places[k]
        L[i, j] = y[k]
        if i == j:
            # log(1 + exp(y)) without overflow.
            L[i, j] = max(y[k], 0.0) + np.log1p(np.exp(-abs(y[k])))
    for i in range(d):
        u[i] = p[i] / scale[i]
        for j in range(i + 1):
            factor[i, j] = mass.floor if i == j else 0.0
            for k in range(j + 1):
                factor[i, j] += L[i, k] * L[j, k]
    prior.add_mass(prior.own, q, scale, factor)
    if not factorise(factor):
        u[:] = np.nan
    solve_lower(factor, u)
    solve_upper(factor, u)
    for j in range(d):
        v[j], w[j] = u[j] / scale[j], 0.0
        for i in range(j, d):
            w[j] += L[i, j] * u[i]


@part(error_model='numpy')
def _weigh_entries(parameters: MechanicalParameters) -> None:
    """Fill the cotangent of y, u_i w_j times the slope of the diagonal's softplus."""
    places, y, c = parameters.mass.places, parameters.work.y, parameters.work.c
    u, w = parameters.work.u, parameters.work.w
    for k in range(places.shape[0]):
        i, j = places[k]
        c[k] = u[i] * w[j]
        if i == j:
            c[k] *= _slope(y[k])


@part(error_model='numpy')
def _slope(y: float) -> float:
    """Return the derivative of log(1 + exp(y))."""
    return 1.0 / (1.0 + np.exp(-y))
