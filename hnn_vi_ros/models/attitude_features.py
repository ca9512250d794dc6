# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Features of a rotating body: (x, R row by row, pi), with pi = (R^T p, L).

x and p belong to the position of the body, if it has one; R is its attitude, quadratic in its
quaternion (x, y, z, w); L is its angular momentum in its own frame.
"""

from hnn_vi_ros.kernels import called
from hnn_vi_ros.models.checkpoint import Checkpoint
from hnn_vi_ros.models.lie_group_card import LieGroupCard
from hnn_vi_ros.models.networks.layers import Layers
import numpy as np


def group_of(model: Checkpoint) -> LieGroupCard:
    """Return the ``lie_group`` entry of a model's card."""
    card = model.card.lie_group
    assert card is not None, 'checked with the card: the family has one'
    return card


def widened(model: Checkpoint, network: str) -> Layers:
    """Return a network extended to all inputs (x, R row by row, pi), ignoring additional ones."""
    card = group_of(model)
    return model.networks[network].widened(
        2 * card.size + 6, card.columns(getattr(card, f'{network}_depends_on')))


def turn_matrices(q: np.ndarray) -> np.ndarray:
    """Return rotation matrices R, shape (m, 3, 3), of quaternions, shape (m, 4)."""
    R = np.empty((len(q), 9))
    for one, row in zip(q, R, strict=True):
        fill_turn_change(one, 0.5 * one, 0, row, 0)
    return R.reshape(-1, 3, 3)


@called
def see_attitude(q: np.ndarray, p: np.ndarray, z: np.ndarray) -> None:
    """Fill (x, R row by row, pi) of one state, in the layout of a kernel."""
    places = q.size - 4
    for i in range(places):
        z[i] = q[i]
    fill_turn_change(q, q, places, z, places)
    for i in range(9):
        z[places + i] *= 0.5
    for j in range(q.size - 1):
        z[places + 9 + j] = p[j]
    if places > 0:
        for j in range(3):
            z[12 + j] = z[3 + j] * p[0] + z[6 + j] * p[1] + z[9 + j] * p[2]


@called
def see_change(q: np.ndarray, p: np.ndarray, v_q: np.ndarray, v_p: np.ndarray, z: np.ndarray,
               z_v: np.ndarray) -> None:
    """Fill the change of (x, R, pi) along (v_q, v_p); call ``see_attitude`` first."""
    places = q.size - 4
    for i in range(places):
        z_v[i] = v_q[i]
    fill_turn_change(q, v_q, places, z_v, places)
    for j in range(q.size - 1):
        z_v[places + 9 + j] = v_p[j]
    if places > 0:
        for j in range(3):
            z_v[12 + j] = 0.0
            for i in range(3):
                z_v[12 + j] += z_v[3 + 3 * i + j] * p[i] + z[3 + 3 * i + j] * v_p[i]


@called
def fill_turn_change(q: np.ndarray, v: np.ndarray, at: int, R: np.ndarray, to: int) -> None:
    """Fill R'(q) v, row by row, of the quaternion at an offset; it is 2 R for v = q."""
    x, y, z, w = q[at], q[at + 1], q[at + 2], q[at + 3]
    a, b, c, d = v[at], v[at + 1], v[at + 2], v[at + 3]
    R[to] = 2.0 * (w * d + x * a - y * b - z * c)
    R[to + 1] = 2.0 * (x * b + y * a - w * c - z * d)
    R[to + 2] = 2.0 * (x * c + z * a + w * b + y * d)
    R[to + 3] = 2.0 * (x * b + y * a + w * c + z * d)
    R[to + 4] = 2.0 * (w * d - x * a + y * b - z * c)
    R[to + 5] = 2.0 * (y * c + z * b - w * a - x * d)
    R[to + 6] = 2.0 * (x * c + z * a - w * b - y * d)
    R[to + 7] = 2.0 * (y * c + z * b + w * a + x * d)
    R[to + 8] = 2.0 * (w * d - x * a - y * b + z * c)


@called
def add_turn_slope(q: np.ndarray, at: int, c: np.ndarray, of: int, target: np.ndarray) -> None:
    """Add the derivative of the sum of c_ij R_ij(q) by the quaternion at an offset."""
    x, y, z, w = q[at], q[at + 1], q[at + 2], q[at + 3]
    xx, yy, zz = c[of], c[of + 4], c[of + 8]
    xy, xz, yz = c[of + 1] + c[of + 3], c[of + 2] + c[of + 6], c[of + 5] + c[of + 7]
    xw, yw, zw = c[of + 7] - c[of + 5], c[of + 2] - c[of + 6], c[of + 3] - c[of + 1]
    target[at] += 2.0 * (x * (xx - yy - zz) + y * xy + z * xz + w * xw)
    target[at + 1] += 2.0 * (y * (yy - xx - zz) + x * xy + z * yz + w * yw)
    target[at + 2] += 2.0 * (z * (zz - xx - yy) + x * xz + y * yz + w * zw)
    target[at + 3] += 2.0 * (w * (xx + yy + zz) + x * xw + y * yw + z * zw)
