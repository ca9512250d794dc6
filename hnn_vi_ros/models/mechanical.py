# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
A learned Hamiltonian of a mechanism: H = p . M(q)^-1 p / 2 + V(q), with networks for M and V.

``inertia``, ``slope`` and ``slope_change`` are used by the mean of several mechanisms.
"""

from typing import NamedTuple

from hnn_vi_ros.kernels import factorise, Kernel, part, solve_cholesky
from hnn_vi_ros.models.features import (
    add_covector, add_covector_change, even_layers, Features, pack_features, see, see_change)
from hnn_vi_ros.models.learned import LearnedHamiltonian
from hnn_vi_ros.models.mechanical_card import MechanicalCard
from hnn_vi_ros.models.networks import perceptron
from hnn_vi_ros.models.networks.perceptron_memory import pack, PackedPerceptron
from hnn_vi_ros.models.outputs import (
    output_tangents, pack_layers, PackedOutputs, part_gradient, weigh)
from hnn_vi_ros.models.priors import (
    add_mass, add_prior_slope, add_prior_slope_change, Prior, prior_kernel, prior_of,
    prior_potential, subtract_turned_mass)
from hnn_vi_ros.models.roots import (
    evaluate_root, transposed_product, turn_root, weigh_entries, weigh_entry_changes)
import numpy as np


class MassNetwork(NamedTuple):
    """
    The network of M with k entries.

    Parameters
    ----------
    outputs : PackedOutputs
        The network of y.
    seen : Features
        Its inputs, features of q.
    places : np.ndarray of int, shape (k, 2)
        Row and column of each entry in L.
    scale : np.ndarray, shape (d,)
        The diagonal of S.
    floor : float
        Constant added to the diagonal of L L^T.

    """

    outputs: PackedOutputs
    seen: Features
    places: np.ndarray
    scale: np.ndarray
    floor: float


class PotentialNetwork(NamedTuple):
    """The network of V, and its features of q."""

    network: PackedPerceptron
    seen: Features


class MechanicalWork(NamedTuple):
    """
    Workspace for one state; names ending in ``_v`` are changes along a direction.

    Parameters
    ----------
    y, y_v, c, c_v : np.ndarray, shape (k,)
        The entries, and u_i w_j L_ij'(y), the derivative of -H by them.
    L, L_v, factor : np.ndarray, shape (d, d)
        L, and the Cholesky factor of S^-1 M S^-1.
    v, u, u_v, w, w_v : np.ndarray, shape (d,)
        The velocity, u = S v and w = L^T u.
    turned : np.ndarray, shape (d,)
        L'^T u for the change L' of L.

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
        """Return workspace for this number of entries and coordinates."""
        return cls(*np.zeros((4, entries)), *np.zeros((3, d, d)), *np.zeros((6, d)))


class MechanicalParameters(NamedTuple):
    """Parameters of the functions of a mechanism: M, V, the prior, and workspace."""

    mass: MassNetwork
    potential: PotentialNetwork
    prior: Prior
    work: MechanicalWork


class MechanicalHamiltonian(LearnedHamiltonian):
    """
    H(q, p) = p . M(q)^-1 p / 2 + V(q), with M = S (L L^T + floor) S.

    The network ``mass`` gives the entries y of the lower triangular L, with log(1 + exp(y)) on its
    diagonal, and ``potential`` gives V; the card defines their inputs from q, S and the floor.
    p = M(q) v is the model's own momentum. With u = S v and w = L^T u,

        H_p = v = M^-1 p,    H_q = V' - sum_ij u_i w_j L_ij',

    since v . M v = |w|^2 + floor |u|^2: one forward and one backward pass through each network.
    Its friction is the effect learned_friction. A prior of the card, rigid links or an exact
    system, adds its M and V with fitted parameters, and the networks give the remainder.

    Parameters
    ----------
    checkpoint : Checkpoint
        A model of the family mechanical.

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
        prior = self._mechanical.prior
        if prior is not None and prior.alone:
            return prior_kernel(prior, self._mechanical.angles)
        return self._kernel_of(energy, gradient, hessian_vector, self.parameters())

    def parameters(self) -> MechanicalParameters:
        """Return the first argument of the compiled functions, with its own workspace."""
        card, mechanical, networks = (
            self.checkpoint.card, self._mechanical, self.checkpoint.networks)
        mass = MassNetwork(
            pack_layers(even_layers(networks['mass']), card.activation),
            pack_features(mechanical, mechanical.mass_features), np.array(mechanical.entries),
            np.array(mechanical.mass_scale), mechanical.floor)
        potential = PotentialNetwork(
            pack(*even_layers(networks['potential']), card.activation),
            pack_features(mechanical, mechanical.features))
        return MechanicalParameters(
            mass, potential, prior_of(mechanical),
            MechanicalWork.empty(len(mechanical.entries), self.dimension))


def energy(parameters: MechanicalParameters, q: np.ndarray, p: np.ndarray) -> float:
    """Return H; see Kernel."""
    potential, prior, v = parameters.potential, parameters.prior, parameters.work.v
    _solve(parameters, q, p)
    see(potential.seen, q)
    x = potential.seen.inputs
    half = x.size // 2
    energy = perceptron.energy(potential.network, x[:half], x[half:])
    if prior.present:
        energy += prior_potential(prior, q)
    for i in range(p.size):
        energy += 0.5 * p[i] * v[i]
    return energy


def gradient(parameters: MechanicalParameters, q: np.ndarray, p: np.ndarray,
             dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    """Fill the gradient; see Kernel."""
    d, v = parameters.mass.scale.size, parameters.work.v
    for a in range(0, q.size, d):
        b = a + d
        _solve(parameters, q[a:b], p[a:b])
        _fill_slope(parameters, q[a:b], dH_dq[a:b])
        for i in range(d):
            dH_dp[a + i] = v[i]


def hessian_vector(parameters: MechanicalParameters, q: np.ndarray, p: np.ndarray,
                   v_q: np.ndarray, v_p: np.ndarray, product_q: np.ndarray,
                   product_p: np.ndarray) -> None:
    """Fill the change of the gradient along (v_q, v_p), from the derivative of each line."""
    scale, u_v, factor = parameters.mass.scale, parameters.work.u_v, parameters.work.factor
    d = scale.size
    for a in range(0, q.size, d):
        b = a + d
        _solve(parameters, q[a:b], p[a:b])
        # A u = S^-1 p with A = L L^T + floor + S^-1 M S^-1 of the prior, so A u' = S^-1 p' - L' w
        # - L (L'^T u) - S^-1 M' v.
        for i in range(d):
            u_v[i] = v_p[a + i] / scale[i]
        _turn_mass(parameters, q[a:b], v_q[a:b], product_q[a:b])
        solve_cholesky(factor, u_v)
        for i in range(d):
            product_p[a + i] = u_v[i] / scale[i]
        _change_slope(parameters, q[a:b], v_q[a:b], product_p[a:b], product_q[a:b])


def inertia(parameters: MechanicalParameters, q: np.ndarray, mass: np.ndarray) -> float:
    """
    Fill the lower triangle of M(q), row by row, shape (d d,); q is padded to that size.

    This function, ``slope`` and ``slope_change`` are called by address, in this order: they have
    the signatures of a kernel's three functions.
    """
    scale, factor = parameters.mass.scale, parameters.work.factor
    d = scale.size
    _fill_mass(parameters, q[:d])
    for i in range(d):
        for j in range(i + 1):
            mass[i * d + j] = scale[i] * factor[i, j] * scale[j]
    return 0.0


def slope(parameters: MechanicalParameters, q: np.ndarray, v: np.ndarray, dH_dq: np.ndarray,
          unused: np.ndarray) -> None:
    """Fill V' - (v . M v)_q / 2 at constant v, which is H_q for p = M v."""
    _set_velocity(parameters, v)
    _fill_slope(parameters, q, dH_dq)


def slope_change(parameters: MechanicalParameters, q: np.ndarray, v: np.ndarray,
                 v_q: np.ndarray, v_change: np.ndarray, change: np.ndarray,
                 turned: np.ndarray) -> None:
    """Fill the change of ``slope`` with q and with v, and M' v for the change M' of M."""
    scale, u_v = parameters.mass.scale, parameters.work.u_v
    _set_velocity(parameters, v)
    u_v[:] = 0.0
    _turn_mass(parameters, q, v_q, change)
    for i in range(scale.size):
        turned[i] = -scale[i] * u_v[i]
        u_v[i] = scale[i] * v_change[i]
    _change_slope(parameters, q, v_q, v_change, change)


@part(error_model='numpy')
def _seen_gradient(network: PackedPerceptron, seen: Features) -> None:
    """Fill the cotangent, the derivative of a network of one output by its inputs."""
    x, c = seen.inputs, seen.cotangent
    half = x.size // 2
    part_gradient(network, x[:half], x[half:], c[:half], c[half:])


@part(error_model='numpy')
def _seen_hessian_vector(network: PackedPerceptron, seen: Features) -> None:
    """Fill the change of the cotangent with the inputs."""
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
def _turn_mass(parameters: MechanicalParameters, q: np.ndarray, v_q: np.ndarray,
               product_q: np.ndarray) -> None:
    """Subtract S^-1 M' v from u_v; fill the change of -sum_ij u_i w_j L_ij' at constant u, w."""
    mass, prior, work = parameters.mass, parameters.prior, parameters.work
    outputs, seen, places, scale = mass.outputs, mass.seen, mass.places, mass.scale
    y, y_v = work.y, work.y_v
    L, L_v, turned = work.L, work.L_v, work.turned
    u, u_v, w = work.u, work.u_v, work.w
    d = scale.size
    product_q[:] = 0.0
    weigh_entries(places, True, work.y, u, work.w, work.c)
    see_change(seen, v_q)
    weigh(outputs, work.c)
    _seen_gradient(outputs.network, seen)
    _seen_hessian_vector(outputs.network, seen)
    add_covector(seen, -1.0, seen.cotangent_change, product_q)
    add_covector_change(seen, -1.0, product_q)
    output_tangents(outputs, y_v)
    turn_root(places, True, y, y_v, L_v)
    transposed_product(L_v, u, turned)
    for i in range(d):
        for j in range(i + 1):
            u_v[i] -= L_v[i, j] * w[j] + L[i, j] * turned[j]
    if prior.present:
        subtract_turned_mass(prior, q, v_q, work.v, scale, u_v)


@part(error_model='numpy')
def _change_slope(parameters: MechanicalParameters, q: np.ndarray, v_q: np.ndarray,
                  v_change: np.ndarray, product_q: np.ndarray) -> None:
    """Add the change of the slope with u, w and V; after _turn_mass, for u_v = S v_change."""
    mass, prior, work = parameters.mass, parameters.prior, parameters.work
    outputs, seen, places = mass.outputs, mass.seen, mass.places
    L, turned = work.L, work.turned
    u, u_v, w, w_v = work.u, work.u_v, work.w, work.w_v
    d = u.size
    for j in range(d):
        w_v[j] = turned[j]
        for i in range(j, d):
            w_v[j] += L[i, j] * u_v[i]
    weigh_entry_changes(places, True, work.y, work.y_v, u, u_v, w, w_v, work.c_v)
    weigh(outputs, work.c_v)
    _seen_gradient(outputs.network, seen)
    add_covector(seen, -1.0, seen.cotangent, product_q)
    _differentiate_potential(parameters.potential, q, v_q, product_q)
    if prior.present:
        add_prior_slope_change(prior, q, work.v, v_q, v_change, product_q)


@part(error_model='numpy')
def _solve(parameters: MechanicalParameters, q: np.ndarray, p: np.ndarray) -> None:
    """Fill y, L, the Cholesky factor of S^-1 M S^-1, and v, u, w; NaN if no factor exists."""
    scale, work = parameters.mass.scale, parameters.work
    factor, v, u = work.factor, work.v, work.u
    _fill_mass(parameters, q)
    for i in range(u.size):
        u[i] = p[i] / scale[i]
    if not factorise(factor):
        u[:] = np.nan
    solve_cholesky(factor, u)
    for i in range(u.size):
        v[i] = u[i] / scale[i]
    transposed_product(work.L, u, work.w)


@part(error_model='numpy')
def _fill_mass(parameters: MechanicalParameters, q: np.ndarray) -> None:
    """Fill y, L, and the lower triangle of S^-1 M S^-1, stored in place of its factor."""
    mass, prior, work = parameters.mass, parameters.prior, parameters.work
    seen, L, factor = mass.seen, work.L, work.factor
    see(seen, q)
    x = seen.inputs
    half = x.size // 2
    evaluate_root(mass.outputs, mass.places, True, x[:half], x[half:], work.y, L)
    for i in range(q.size):
        for j in range(i + 1):
            factor[i, j] = mass.floor if i == j else 0.0
            for k in range(j + 1):
                factor[i, j] += L[i, k] * L[j, k]
    if prior.present:
        add_mass(prior, q, mass.scale, factor)


@part(error_model='numpy')
def _set_velocity(parameters: MechanicalParameters, velocity: np.ndarray) -> None:
    """Fill v, u and w of a velocity; call _fill_mass first."""
    scale, work = parameters.mass.scale, parameters.work
    for i in range(scale.size):
        work.v[i] = velocity[i]
        work.u[i] = scale[i] * velocity[i]
    transposed_product(work.L, work.u, work.w)


@part(error_model='numpy')
def _fill_slope(parameters: MechanicalParameters, q: np.ndarray, dH_dq: np.ndarray) -> None:
    """Fill V' - (v . M v)_q / 2 at constant v; call _solve or _set_velocity first."""
    mass, potential, work = parameters.mass, parameters.potential, parameters.work
    prior = parameters.prior
    weigh_entries(mass.places, True, work.y, work.u, work.w, work.c)
    weigh(mass.outputs, work.c)
    _seen_gradient(mass.outputs.network, mass.seen)
    see(potential.seen, q)
    _seen_gradient(potential.network, potential.seen)
    dH_dq[:] = 0.0
    add_covector(mass.seen, -1.0, mass.seen.cotangent, dH_dq)
    add_covector(potential.seen, 1.0, potential.seen.cotangent, dH_dq)
    if prior.present:
        add_prior_slope(prior, q, work.v, dH_dq)
