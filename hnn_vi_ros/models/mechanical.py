# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A learned Hamiltonian of a mechanism: a mass matrix and a potential that are networks of q."""

from hnn_vi_ros.kernels.compilation import kept
from hnn_vi_ros.kernels.kernel import Kernel, Parameters
from hnn_vi_ros.kernels.linear_algebra import factorise, solve_lower, solve_upper
from hnn_vi_ros.kernels.linking import part
from hnn_vi_ros.models.features import (
    add_covector, add_covector_change, even_layers, inputs_of, pack_features, see, see_change)
from hnn_vi_ros.models.learned import LearnedHamiltonian
from hnn_vi_ros.models.mechanical_card import MechanicalCard
from hnn_vi_ros.models.outputs import (
    evaluate_outputs, output_tangents, pack_layers, part_gradient, weigh)
from hnn_vi_ros.models.prior_terms import (
    add_mass, add_prior_slope, add_prior_slope_change, prior_gradient, prior_potential,
    subtract_turned_mass)
from hnn_vi_ros.networks import perceptron
from hnn_vi_ros.networks.perceptron_memory import pack
import numpy as np


class MechanicalHamiltonian(LearnedHamiltonian):
    """
    H(q, p) = p . M(q)^-1 p / 2 + V(q), with M = S (L L^T + floor) S.

    The network ``mass`` gives the entries y of the lower triangular L, those of its diagonal as
    log(1 + exp(y)), and ``potential`` gives V; what they see of q, S and the floor stand in the
    card. p = M(q) v is the model's own momentum. With u = S v and w = L^T u,

        H_p = v = M^-1 p,    H_q = V' - sum_ij u_i w_j L_ij',

    since v . M v = |w|^2 + floor |u|^2: one forward and one backward pass through each network.
    Its friction is the effect learned_friction. A prior of the card, such as the double pendulum,
    adds its M and V of fitted parameters, and the networks are what it lacks.

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
        card, d = self.checkpoint.card, self.dimension
        mechanical, networks = self._mechanical, self.checkpoint.networks
        mass = (pack_layers(even_layers(networks['mass']), card.activation),
                pack_features(mechanical, mechanical.mass_features),
                np.array(mechanical.entries), np.array(mechanical.mass_scale), mechanical.floor)
        potential = (pack(*even_layers(networks['potential']), card.activation),
                     pack_features(mechanical, mechanical.features))
        parameters = (mass, potential, np.zeros((5, len(mechanical.entries))),
                      np.zeros((3, d, d)), np.zeros((7, d)), tuple(mechanical.terms))
        return Kernel(_energy, _gradient, _hessian_vector, parameters, d, (0.0, 0.0),
                      compiled=True)

    def masses(self, q: np.ndarray) -> np.ndarray:
        """Return M(q), shape (m, d, d), at q of shape (m, d), in extended precision."""
        return self._roots(q)[0] + prior_gradient(self._mechanical.terms, q, np.zeros(q.shape))[0]

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
        return np.hstack([slope - kinetic + prior_gradient(card.terms, q, v)[1], v])


@kept(error_model='numpy')
def _energy(parameters: Parameters, q: np.ndarray, p: np.ndarray) -> float:
    network, seen = parameters[1]
    _solve(parameters, q, p)
    v = parameters[4][0]
    see(seen, q)
    x = seen[2][0]
    half = x.size // 2
    energy = perceptron.energy(network, x[:half], x[half:]) + prior_potential(parameters[5], q)
    for i in range(p.size):
        energy += 0.5 * p[i] * v[i]
    return energy


@kept(error_model='numpy')
def _gradient(parameters: Parameters, q: np.ndarray, p: np.ndarray,
              dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    mass, (network, seen), entries, _, space, prior = parameters
    d = space.shape[1]
    half = seen[2].shape[1] // 2
    mass_half = mass[1][2].shape[1] // 2
    for a in range(0, q.size, d):
        b = a + d
        _solve(parameters, q[a:b], p[a:b])
        _weigh_entries(parameters)
        weigh(mass[0], entries[1])
        x, c = mass[1][2][0], mass[1][2][2]
        part_gradient(mass[0][0], x[:mass_half], x[mass_half:], c[:mass_half], c[mass_half:])
        see(seen, q[a:b])
        x, c = seen[2][0], seen[2][2]
        part_gradient(network, x[:half], x[half:], c[:half], c[half:])
        for i in range(d):
            dH_dq[a + i], dH_dp[a + i] = 0.0, space[0, i]
        add_covector(mass[1], -1.0, 2, dH_dq[a:b])
        add_covector(seen, 1.0, 2, dH_dq[a:b])
        add_prior_slope(prior, q[a:b], space[0], dH_dq[a:b])


@kept(error_model='numpy')
def _hessian_vector(parameters: Parameters, q: np.ndarray, p: np.ndarray, v_q: np.ndarray,
                    v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
    """Differentiate the lines of _gradient along (v_q, v_p)."""
    d = parameters[4].shape[1]
    for a in range(0, q.size, d):
        b = a + d
        product_q[a:b] = 0.0
        _solve(parameters, q[a:b], p[a:b])
        _weigh_entries(parameters)
        _differentiate_mass(parameters, q[a:b], v_q[a:b], v_p[a:b], product_q[a:b],
                            product_p[a:b])
        _differentiate_potential(parameters[1], q[a:b], v_q[a:b], product_q[a:b])
        add_prior_slope_change(parameters[5], q[a:b], parameters[4][0], v_q[a:b], product_p[a:b],
                               product_q[a:b])


@part(error_model='numpy')
def _differentiate_potential(potential: Parameters, q: np.ndarray, v_q: np.ndarray,
                             product_q: np.ndarray) -> None:
    """Add V''(q) v_q."""
    network, seen = potential
    x, x_v, c, c_v = seen[2]
    half = x.size // 2
    see(seen, q)
    see_change(seen, v_q)
    part_gradient(network, x[:half], x[half:], c[:half], c[half:])
    perceptron.hessian_vector(network, x[:half], x[half:], x_v[:half], x_v[half:],
                              c_v[:half], c_v[half:])
    add_covector(seen, 1.0, 3, product_q)
    add_covector_change(seen, 1.0, 2, product_q)


@part(error_model='numpy')
def _differentiate_mass(parameters: Parameters, q: np.ndarray, v_q: np.ndarray,
                        v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
    """Fill the change of v, and add that of -sum_ij u_i w_j L_ij'; after _weigh_entries."""
    (network, seen, places, scale, _), _, entries, matrices, space, prior = parameters
    y, c, y_v, c_v, _ = entries
    L, C, L_v = matrices
    u, w, u_v, w_v = space[1], space[2], space[3], space[4]
    d, x, x_v, g, g_v = scale.size, seen[2][0], seen[2][1], seen[2][2], seen[2][3]
    half = x.size // 2
    see_change(seen, v_q)
    weigh(network, c)
    part_gradient(network[0], x[:half], x[half:], g[:half], g[half:])
    perceptron.hessian_vector(network[0], x[:half], x[half:], x_v[:half], x_v[half:],
                              g_v[:half], g_v[half:])
    add_covector(seen, -1.0, 3, product_q)
    add_covector_change(seen, -1.0, 2, product_q)
    output_tangents(network, y_v)
    for k in range(y.size):
        i, j = places[k]
        L_v[i, j] = y_v[k] * _slope(y[k]) if i == j else y_v[k]
    # A u = S^-1 p with A = L L^T + floor + S^-1 M S^-1 of the prior, so
    # A u' = S^-1 p' - L' w - L (L'^T u) - S^-1 M' v.
    for j in range(d):
        space[5, j] = 0.0
        for i in range(j, d):
            space[5, j] += L_v[i, j] * u[i]
    for i in range(d):
        u_v[i] = v_p[i] / scale[i]
        for j in range(i + 1):
            u_v[i] -= L_v[i, j] * w[j] + L[i, j] * space[5, j]
    subtract_turned_mass(prior, q, v_q, space[0], scale, u_v)
    solve_lower(C, u_v)
    solve_upper(C, u_v)
    for j in range(d):
        product_p[j] = u_v[j] / scale[j]
        w_v[j] = space[5, j]
        for i in range(j, d):
            w_v[j] += L[i, j] * u_v[i]
    for k in range(y.size):
        i, j = places[k]
        c_v[k] = u_v[i] * w[j] + u[i] * w_v[j]
        if i == j:
            slope = _slope(y[k])
            c_v[k] = c_v[k] * slope + u[i] * w[j] * slope * (1.0 - slope) * y_v[k]
    weigh(network, c_v)
    part_gradient(network[0], x[:half], x[half:], g[:half], g[half:])
    add_covector(seen, -1.0, 2, product_q)


@part(error_model='numpy')
def _solve(parameters: Parameters, q: np.ndarray, p: np.ndarray) -> None:
    """Fill y, L, the Cholesky factor of L L^T + floor, and v, u, w; NaN where there is none."""
    (network, seen, places, scale, floor), _, entries, matrices, space, prior = parameters
    L, C = matrices[0], matrices[1]
    y, v, u, w = entries[0], space[0], space[1], space[2]
    d = scale.size
    see(seen, q)
    x = seen[2][0]
    half = x.size // 2
    evaluate_outputs(network, x[:half], x[half:], y)
    for k in range(y.size):
        i, j = places[k]
        L[i, j] = y[k]
        if i == j:
            # log(1 + exp(y)) without overflow.
            L[i, j] = max(y[k], 0.0) + np.log1p(np.exp(-abs(y[k])))
    for i in range(d):
        u[i] = p[i] / scale[i]
        for j in range(i + 1):
            C[i, j] = floor if i == j else 0.0
            for k in range(j + 1):
                C[i, j] += L[i, k] * L[j, k]
    add_mass(prior, q, scale, C)
    if not factorise(C):
        u[:] = np.nan
    solve_lower(C, u)
    solve_upper(C, u)
    for j in range(d):
        v[j], w[j] = u[j] / scale[j], 0.0
        for i in range(j, d):
            w[j] += L[i, j] * u[i]


@part(error_model='numpy')
def _weigh_entries(parameters: Parameters) -> None:
    """Fill the cotangent of y, u_i w_j times the slope of the diagonal's softplus."""
    places, entries, space = parameters[0][2], parameters[2], parameters[4]
    for k in range(places.shape[0]):
        i, j = places[k]
        entries[1, k] = space[1, i] * space[2, j]
        if i == j:
            entries[1, k] *= _slope(entries[0, k])


@part(error_model='numpy')
def _slope(y: float) -> float:
    """Return the derivative of log(1 + exp(y))."""
    return 1.0 / (1.0 + np.exp(-y))
