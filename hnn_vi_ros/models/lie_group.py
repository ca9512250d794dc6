# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A learned Hamiltonian of a body that turns: its mass and its potential on SO(3) or SE(3)."""

from typing import NamedTuple

from hnn_vi_ros.kernels.compilation import kept
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.kernels.linking import part
from hnn_vi_ros.models.attitude_features import (
    add_turn_slope, group_of, see, see_change, turn_matrices, widened)
from hnn_vi_ros.models.checkpoint import Checkpoint
from hnn_vi_ros.models.learned import LearnedHamiltonian
from hnn_vi_ros.models.lie_group_card import LieGroupCard
from hnn_vi_ros.models.outputs import (
    evaluate_outputs, output_tangents, pack_layers, PackedOutputs, part_gradient, root_of, weigh)
from hnn_vi_ros.networks import perceptron
from hnn_vi_ros.networks.perceptron_memory import pack, PackedPerceptron
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

# States at which rounding is measured.
_SAMPLES = 64


class LieGroupWork(NamedTuple):
    """
    Space for one state; what ends in ``_v`` is a change along a direction.

    Parameters
    ----------
    z, z_v, c, c_v, m, m_v : np.ndarray, shape (n,)
        (x, R row by row, pi), what the networks see; the derivative of H by it; and that of the
        network of M alone.
    y, y_v, a, a_v : np.ndarray, shape (e,)
        The entries of L, as outputs of the network, and the derivative of H by them.
    L, L_v : np.ndarray, shape (k, k)
        L.
    u, u_v, w, w_v, v, v_v : np.ndarray, shape (k,)
        u = S pi, w = L^T u, and the velocity in the frame of the body.

    """

    z: np.ndarray
    z_v: np.ndarray
    c: np.ndarray
    c_v: np.ndarray
    m: np.ndarray
    m_v: np.ndarray
    y: np.ndarray
    y_v: np.ndarray
    a: np.ndarray
    a_v: np.ndarray
    L: np.ndarray
    L_v: np.ndarray
    u: np.ndarray
    u_v: np.ndarray
    w: np.ndarray
    w_v: np.ndarray
    v: np.ndarray
    v_v: np.ndarray


class LieGroupParameters(NamedTuple):
    """
    Parameters of the functions of such a body, their first argument.

    Parameters
    ----------
    mass : PackedOutputs
        The network of y.
    potential : PackedPerceptron
        That of V, or of all of H.
    places : np.ndarray of int, shape (e, 2)
        Row and column of each entry in L.
    scale : np.ndarray, shape (k,)
        The diagonal of S.
    floor : float
        Constant added to the diagonal of L L^T.
    positive : bool
        Whether the diagonal of L is log(1 + exp(y)), not y.
    work : LieGroupWork
        Space.

    """

    mass: PackedOutputs
    potential: PackedPerceptron
    places: np.ndarray
    scale: np.ndarray
    floor: float
    positive: bool
    work: LieGroupWork


class LieGroupHamiltonian(LearnedHamiltonian):
    """
    H = pi . M(g)^-1 pi / 2 + V(g), or V(g, pi), with M^-1 = S (L L^T + floor) S.

    pi = (R^T p, L): the momentum of the position and that of turning, both in the frame of the
    body. The network ``mass`` gives the entries y of the lower triangular L, a block of 3 x 3 for
    each, with log(1 + exp(y)) or y on its diagonal; ``potential`` gives V. They see the nine
    entries of R, and the position, as the card says. With u = S pi and w = L^T u,

        v = S (L w + floor u) + V_pi,    H_g = V_g + sum_ij u_i w_j (L_ij)_g + p . (R v)_g,

    where v are the velocities in the frame of the body: H_p is R v of the position, v of turning.
    Its friction is the effect learned_friction, its input map that of external_force.

    Parameters
    ----------
    checkpoint : Checkpoint
        Of the family lie_group.

    References
    ----------
    T. Duong, A. Altawaitan, J. Stanley, N. Atanasov, Port-Hamiltonian Neural ODE Networks on Lie
    Groups for Robot Dynamics Learning and Control, IEEE Trans. Robot. 40 (2024).

    """

    def __init__(self, checkpoint: Checkpoint):
        super().__init__(checkpoint)
        (own,) = self.coordinates
        self.coordinates = (Coordinate(own.name, own.q_unit, own.p_unit, self._group.kind),)

    @property
    def _group(self) -> LieGroupCard:
        return group_of(self.checkpoint)

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the bounds of the columns of q and of p, of the data that H was learned from."""
        q, p = super().box
        return q, p[:-1]

    def _kernel(self) -> Kernel:
        card = self._group
        n, e, k = 2 * card.size + 6, len(card.entries), card.size
        work = LieGroupWork(*np.zeros((6, n)), *np.zeros((4, e)), *np.zeros((2, k, k)),
                            *np.zeros((6, k)))
        parameters = LieGroupParameters(
            pack_layers(widened(self.checkpoint, 'mass'), self.checkpoint.card.activation),
            pack(*widened(self.checkpoint, 'potential'), self.checkpoint.card.activation),
            np.array(card.entries), np.array(card.mass_scale), card.floor,
            card.diagonal == 'softplus', work)
        return self._kernel_of(_energy, _gradient, _hessian_vector, parameters)

    def _samples(self) -> np.ndarray:
        """Return states of the box, shape (m, 2 d), with any attitude; the last column is zero."""
        rng = np.random.default_rng(0)
        q, p = (rng.uniform(part[:, 0], part[:, 1], (_SAMPLES, len(part))) for part in self.box)
        attitudes = rng.normal(size=(_SAMPLES, 4))
        q[:, -4:] = attitudes / np.linalg.norm(attitudes, axis=1, keepdims=True)
        return np.hstack([q, p, np.zeros((_SAMPLES, 1))])

    def _extended_gradient(self, z: np.ndarray) -> np.ndarray:
        card, places, k = self._group, self._group.size - 3, self._group.size
        q, p = np.split(z.astype(np.longdouble), 2, axis=1)
        p = p[:, :k]
        R, R_q = turn_matrices(q[:, -4:])
        pi = p.copy()
        if places:
            pi[:, :3] = (R * p[:, :3, None]).sum(axis=1)
        seen = np.hstack([q[:, :places], R.reshape(-1, 9), pi])
        L, L_z = self._roots(seen)
        S = np.array(card.mass_scale)
        u = S * pi
        w = (L * u[:, :, None]).sum(axis=1)
        c = np.zeros_like(seen)
        at = card.columns(card.potential_depends_on)
        c[:, at] = self._evaluated('potential', seen[:, at])[1][:, 0]
        v = S * ((L * w[:, None, :]).sum(axis=2) + card.floor * u) + c[:, places + 9:]
        c[:, :places + 9] += (L_z * (u[:, :, None] * w[:, None, :])[..., None]).sum(
            axis=(1, 2))[:, :places + 9]
        slopes, rates = c[:, places:places + 9].reshape(-1, 3, 3), v.copy()
        if places:
            slopes = slopes + p[:, :3, None] * v[:, None, :3]
            rates[:, :3] = (R * v[:, None, :3]).sum(axis=2)
        H_q = (R_q * slopes[..., None]).sum(axis=(1, 2))
        return np.hstack([c[:, :places], H_q, rates, np.zeros((len(z), 1))])

    def _roots(self, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return L, shape (m, k, k), and its derivatives by what can be seen."""
        card = self._group
        at = card.columns(card.mass_depends_on)
        y, y_x = self._evaluated('mass', seen[:, at] if at else np.zeros((len(seen), 1)))
        y_z = np.zeros((*y.shape, seen.shape[1]), y.dtype)
        if at:
            y_z[:, :, at] = y_x
        return root_of(y, y_z, card.entries, card.diagonal == 'softplus')


@kept(error_model='numpy')
def _energy(parameters: LieGroupParameters, q: np.ndarray, p: np.ndarray) -> float:
    work = parameters.work
    see(q, p, work.z)
    _roots(parameters)
    half = work.z.size // 2
    energy = perceptron.energy(parameters.potential, work.z[:half], work.z[half:])
    for i in range(work.u.size):
        energy += 0.5 * (work.w[i] * work.w[i] + parameters.floor * work.u[i] * work.u[i])
    return energy


@kept(error_model='numpy')
def _gradient(parameters: LieGroupParameters, q: np.ndarray, p: np.ndarray,
              dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    z, c, v = parameters.work.z, parameters.work.c, parameters.work.v
    d = v.size + 1
    for a in range(0, q.size, d):
        _first_order(parameters, q[a:a + d], p[a:a + d])
        for i in range(d):
            dH_dq[a + i] = c[i] if i < d - 4 else 0.0
        add_turn_slope(q, a + d - 4, c, d - 4, dH_dq)
        for i in range(v.size):
            dH_dp[a + i] = v[i]
        dH_dp[a + d - 1] = 0.0
        if d > 4:
            for i in range(3):
                dH_dp[a + i] = 0.0
                for j in range(3):
                    dH_dp[a + i] += z[3 + 3 * i + j] * v[j]


@kept(error_model='numpy')
def _hessian_vector(parameters: LieGroupParameters, q: np.ndarray, p: np.ndarray,
                    v_q: np.ndarray, v_p: np.ndarray, product_q: np.ndarray,
                    product_p: np.ndarray) -> None:
    """Differentiate the lines of _gradient along (v_q, v_p)."""
    work = parameters.work
    z, z_v, c, c_v, v, v_v = work.z, work.z_v, work.c, work.c_v, work.v, work.v_v
    d = v.size + 1
    for a in range(0, q.size, d):
        b = a + d
        _first_order(parameters, q[a:b], p[a:b])
        see_change(q[a:b], p[a:b], v_q[a:b], v_p[a:b], z, z_v)
        _second_order(parameters)
        if d > 4:
            for i in range(3):
                for j in range(3):
                    c_v[3 + 3 * i + j] += v_p[a + i] * v[j] + p[a + i] * v_v[j]
        for i in range(d):
            product_q[a + i] = c_v[i] if i < d - 4 else 0.0
        add_turn_slope(q, b - 4, c_v, d - 4, product_q)
        add_turn_slope(v_q, b - 4, c, d - 4, product_q)
        for i in range(v.size):
            product_p[a + i] = v_v[i]
        product_p[b - 1] = 0.0
        if d > 4:
            for i in range(3):
                product_p[a + i] = 0.0
                for j in range(3):
                    product_p[a + i] += (z_v[3 + 3 * i + j] * v[j]
                                         + z[3 + 3 * i + j] * v_v[j])


@part(error_model='numpy')
def _first_order(parameters: LieGroupParameters, q: np.ndarray, p: np.ndarray) -> None:
    """Fill the derivative c of H by (x, R) at held p, and the velocities v."""
    work, places, scale = parameters.work, parameters.places, parameters.scale
    z, c, m, y, a, L = work.z, work.c, work.m, work.y, work.a, work.L
    u, w, v = work.u, work.w, work.v
    half, first = z.size // 2, z.size - v.size
    see(q, p, z)
    _roots(parameters)
    for k in range(y.size):
        i, j = places[k]
        a[k] = u[i] * w[j]
        if i == j and parameters.positive:
            a[k] *= _slope(y[k])
    weigh(parameters.mass, a)
    part_gradient(parameters.mass.network, z[:half], z[half:], m[:half], m[half:])
    part_gradient(parameters.potential, z[:half], z[half:], c[:half], c[half:])
    for i in range(first):
        c[i] += m[i]
    for i in range(v.size):
        v[i] = parameters.floor * u[i]
        for j in range(i + 1):
            v[i] += L[i, j] * w[j]
        v[i] = scale[i] * v[i] + c[first + i]
    if v.size > 3:
        for i in range(3):
            for j in range(3):
                c[3 + 3 * i + j] += p[i] * v[j]


@part(error_model='numpy')
def _second_order(parameters: LieGroupParameters) -> None:
    """Fill the changes of c and of v along z_v, but for that of p . R v; after _first_order."""
    work, places, scale = parameters.work, parameters.places, parameters.scale
    z, z_v, c_v, m, m_v = work.z, work.z_v, work.c_v, work.m, work.m_v
    y, y_v, a_v, L, L_v = work.y, work.y_v, work.a_v, work.L, work.L_v
    u, u_v, w, w_v, v_v = work.u, work.u_v, work.w, work.w_v, work.v_v
    half, first = z.size // 2, z.size - v_v.size
    perceptron.hessian_vector(parameters.mass.network, z[:half], z[half:], z_v[:half],
                              z_v[half:], m_v[:half], m_v[half:])
    output_tangents(parameters.mass, y_v)
    for k in range(y.size):
        i, j = places[k]
        L_v[i, j] = y_v[k] * _slope(y[k]) if i == j and parameters.positive else y_v[k]
    for i in range(u.size):
        u_v[i] = scale[i] * z_v[first + i]
    for j in range(u.size):
        w_v[j] = 0.0
        for i in range(j, u.size):
            w_v[j] += L_v[i, j] * u[i] + L[i, j] * u_v[i]
    for k in range(y.size):
        i, j = places[k]
        a_v[k] = u_v[i] * w[j] + u[i] * w_v[j]
        if i == j and parameters.positive:
            slope = _slope(y[k])
            a_v[k] = a_v[k] * slope + u[i] * w[j] * slope * (1.0 - slope) * y_v[k]
    weigh(parameters.mass, a_v)
    part_gradient(parameters.mass.network, z[:half], z[half:], m[:half], m[half:])
    perceptron.hessian_vector(parameters.potential, z[:half], z[half:], z_v[:half], z_v[half:],
                              c_v[:half], c_v[half:])
    for i in range(first):
        c_v[i] += m[i] + m_v[i]
    for i in range(v_v.size):
        v_v[i] = parameters.floor * u_v[i]
        for j in range(i + 1):
            v_v[i] += L_v[i, j] * w[j] + L[i, j] * w_v[j]
        v_v[i] = scale[i] * v_v[i] + c_v[first + i]


@part(error_model='numpy')
def _roots(parameters: LieGroupParameters) -> None:
    """Fill y and L at z, and u and w."""
    work, places = parameters.work, parameters.places
    z, y, L, u, w = work.z, work.y, work.L, work.u, work.w
    half, first = z.size // 2, z.size - u.size
    evaluate_outputs(parameters.mass, z[:half], z[half:], y)
    for k in range(y.size):
        i, j = places[k]
        L[i, j] = y[k]
        if i == j and parameters.positive:
            # log(1 + exp(y)) without overflow.
            L[i, j] = max(y[k], 0.0) + np.log1p(np.exp(-abs(y[k])))
    for i in range(u.size):
        u[i] = parameters.scale[i] * z[first + i]
    for j in range(u.size):
        w[j] = 0.0
        for i in range(j, u.size):
            w[j] += L[i, j] * u[i]


@part(error_model='numpy')
def _slope(y: float) -> float:
    """Return the derivative of log(1 + exp(y))."""
    return 1.0 / (1.0 + np.exp(-y))
