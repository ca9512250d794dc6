# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A learned Hamiltonian of a rotating body, with mass and potential on SO(3) or SE(3)."""

from typing import NamedTuple

from hnn_vi_ros.kernels import Kernel, part
from hnn_vi_ros.models.attitude_features import (
    add_turn_slope, group_of, see_attitude, see_change)
from hnn_vi_ros.models.checkpoint import Checkpoint
from hnn_vi_ros.models.graphs.derivatives import gradient as add_gradient, tangent
from hnn_vi_ros.models.graphs.family_graphs import body
from hnn_vi_ros.models.graphs.graph import Builder
from hnn_vi_ros.models.graphs.machine import assembled, fill, GraphParameters, run
from hnn_vi_ros.models.graphs.tape import program
from hnn_vi_ros.models.learned import LearnedHamiltonian, SAMPLES
from hnn_vi_ros.models.lie_group_card import LieGroupCard
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class BodyParameters(NamedTuple):
    """
    Parameters of the functions of a rotating body, their first argument.

    Parameters
    ----------
    graph : GraphParameters
        Tapes of H, its derivative, and the change of that, for z = (x, R row by row, pi); their
        inputs are z and its change.
    c, c_v : np.ndarray, shape (n,)
        The derivative of H by z, and its change.
    v, v_v : np.ndarray, shape (k,)
        Their last entries: the velocity in the frame of the body, and its change.

    """

    graph: GraphParameters
    c: np.ndarray
    c_v: np.ndarray
    v: np.ndarray
    v_v: np.ndarray


class LieGroupHamiltonian(LearnedHamiltonian):
    """
    H = pi . M(g)^-1 pi / 2 + V(g), or V(g, pi), with M^-1 = S (L L^T + floor) S.

    pi = (R^T p, L): linear and angular momentum in the frame of the body. The network ``mass``
    gives the entries y of the lower triangular L, one 3 x 3 block for each, with log(1 + exp(y))
    or y on its diagonal; ``potential`` gives V. Their inputs are the nine entries of R, and the
    position, as defined in the card. The derivative of H by pi is v, the velocity in the frame of
    the body: H_p is R v for the position and v for the rotation. H_g at constant p is that at
    constant pi, plus the derivative of p . R v at constant v. Its friction is the effect
    learned_friction, its input map that of external_force.

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
        b, k = Builder(), self._group.size
        z, change = (b.input(2 * k + 6, number) for number in range(2))
        output = body(b, self.checkpoint, z)
        slope = add_gradient(b, output, z)
        graph = assembled(*program(
            b, [z, change], [output], [slope, tangent(b, slope, z, change)]), k)
        c, c_v = np.zeros((2, 2 * k + 6))
        return self._kernel_of(_energy, _gradient, _hessian_vector, BodyParameters(
            graph, c, c_v, c[k + 6:], c_v[k + 6:]))

    def _samples(self, count: int = SAMPLES) -> np.ndarray:
        """Return random states of the box with any attitude; the last column is zero."""
        rng = np.random.default_rng(0)
        q, p = (rng.uniform(part[:, 0], part[:, 1], (count, len(part))) for part in self.box)
        attitudes = rng.normal(size=(count, 4))
        q[:, -4:] = attitudes / np.linalg.norm(attitudes, axis=1, keepdims=True)
        return np.hstack([q, p, np.zeros((count, 1))])


def _energy(parameters: BodyParameters, q: np.ndarray, p: np.ndarray) -> float:
    graph = parameters.graph
    see_attitude(q, p, graph.memory)
    run(graph, 0)
    return float(graph.memory[graph.places[0]])


def _gradient(parameters: BodyParameters, q: np.ndarray, p: np.ndarray,
              dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    z, c, v = parameters.graph.memory, parameters.c, parameters.v
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


def _hessian_vector(parameters: BodyParameters, q: np.ndarray, p: np.ndarray,
                    v_q: np.ndarray, v_p: np.ndarray, product_q: np.ndarray,
                    product_p: np.ndarray) -> None:
    """Differentiate the lines of _gradient along (v_q, v_p)."""
    graph, c, c_v, v, v_v = parameters
    z, z_v = graph.memory, graph.memory[c.size:]
    d = v.size + 1
    for a in range(0, q.size, d):
        b = a + d
        _first_order(parameters, q[a:b], p[a:b])
        see_change(q[a:b], p[a:b], v_q[a:b], v_p[a:b], z, z_v)
        fill(graph, 2, c_v)
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
def _first_order(parameters: BodyParameters, q: np.ndarray, p: np.ndarray) -> None:
    """Fill the derivative c of H by (x, R) at constant p, and the velocities v."""
    graph, c, v = parameters.graph, parameters.c, parameters.v
    see_attitude(q, p, graph.memory)
    fill(graph, 1, c)
    if v.size > 3:
        for i in range(3):
            for j in range(3):
                c[3 + 3 * i + j] += p[i] * v[j]
