# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A learned Hamiltonian of a rotating body, with mass and potential on SO(3) or SE(3)."""

from hnn_vi_ros.kernels import Kernel, part
from hnn_vi_ros.models.attitude_features import (
    add_turn_slope, group_of, see_attitude, see_change, widened)
from hnn_vi_ros.models.checkpoint import Checkpoint
from hnn_vi_ros.models.learned import LearnedHamiltonian, SAMPLES
from hnn_vi_ros.models.lie_group_card import LieGroupCard
from hnn_vi_ros.models.networks.perceptron_memory import pack
from hnn_vi_ros.models.outputs import pack_layers
from hnn_vi_ros.models.roots import energy, first_order, RootParameters, RootWork, second_order
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class LieGroupHamiltonian(LearnedHamiltonian):
    """
    H = pi . M(g)^-1 pi / 2 + V(g), or V(g, pi), with M^-1 = S (L L^T + floor) S.

    pi = (R^T p, L): linear and angular momentum in the frame of the body. The network ``mass``
    gives the entries y of the lower triangular L, one 3 x 3 block for each, with log(1 + exp(y))
    or y on its diagonal; ``potential`` gives V. Their inputs are the nine entries of R, and the
    position, as defined in the card. With u = S pi and w = L^T u,

        v = S (L w + floor u) + V_pi,    H_g = V_g + sum_ij u_i w_j (L_ij)_g + p . (R v)_g,

    where v are the velocities in the frame of the body: H_p is R v for the position and v for the
    rotation. Its friction is the effect learned_friction, its input map that of external_force.

    Parameters
    ----------
    checkpoint : Checkpoint
        A model of the family lie_group.

    References
    ----------
    T. Duong, A. Altawaitan, J. Stanley, N. Atanasov, Port-Hamiltonian Neural ODE Networks on Lie
    Groups for Robot Dynamics Learning and Control, IEEE Trans. Robot. 40 (2024).

    """

    def __init__(self, checkpoint: Checkpoint):
        super().__init__(checkpoint)
        (own,) = self.coordinates
        self.coordinates = (Coordinate(own.name, own.q_unit, own.p_unit, self._group.kind),)
        q, p = self.box
        self.box = q, p[:-1]

    @property
    def _group(self) -> LieGroupCard:
        return group_of(self.checkpoint)

    def _kernel(self) -> Kernel:
        card = self._group
        parameters = RootParameters(
            pack_layers(widened(self.checkpoint, 'mass'), self.checkpoint.card.activation),
            pack(*widened(self.checkpoint, 'potential'), self.checkpoint.card.activation),
            np.array(card.entries), np.array(card.mass_scale), card.floor,
            card.diagonal == 'softplus',
            RootWork.empty(2 * card.size + 6, len(card.entries), card.size))
        return self._kernel_of(_energy, _gradient, _hessian_vector, parameters)

    def _samples(self, count: int = SAMPLES) -> np.ndarray:
        """Return random states of the box with any attitude; the last column is zero."""
        rng = np.random.default_rng(0)
        q, p = (rng.uniform(part[:, 0], part[:, 1], (count, len(part))) for part in self.box)
        attitudes = rng.normal(size=(count, 4))
        q[:, -4:] = attitudes / np.linalg.norm(attitudes, axis=1, keepdims=True)
        return np.hstack([q, p, np.zeros((count, 1))])


def _energy(parameters: RootParameters, q: np.ndarray, p: np.ndarray) -> float:
    see_attitude(q, p, parameters.work.z)
    return energy(parameters)


def _gradient(parameters: RootParameters, q: np.ndarray, p: np.ndarray,
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


def _hessian_vector(parameters: RootParameters, q: np.ndarray, p: np.ndarray,
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
        second_order(parameters)
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
                    product_p[a + i] += z_v[3 + 3 * i + j] * v[j] + z[3 + 3 * i + j] * v_v[j]


@part(error_model='numpy')
def _first_order(parameters: RootParameters, q: np.ndarray, p: np.ndarray) -> None:
    """Fill the derivative c of H by (x, R) at constant p, and the velocities v."""
    c, v = parameters.work.c, parameters.work.v
    see_attitude(q, p, parameters.work.z)
    first_order(parameters)
    if v.size > 3:
        for i in range(3):
            for j in range(3):
                c[3 + 3 * i + j] += p[i] * v[j]
