# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A controller that flies a quadrotor to a position and holds it there."""

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

# Natural frequencies [rad/s] of position and attitude, and the damping ratio of both.
PLACE_RATE, TURN_RATE, DAMPING = 1.5, 9.0, 0.9
# Distance beyond which the approach gets no faster [m].
REACH = 2.0


class Hover:
    """
    Thrust [N] and three torques [N m] that lead to a position with constant heading.

    For quadrotors only. The desired force carries the weight and acts as a damped spring on the
    position; its direction is the desired third body axis, which a second damped spring tracks.

    Parameters
    ----------
    mass, weight : float
        Mass [kg] and weight [N].
    inertia : array_like, shape (3,)
        Moments of inertia about the axes of the body [kg m^2].
    place : array_like, shape (3,)
        Target position x, y and z [m].

    Attributes
    ----------
    mode, cost, plan
        ``'hover'``; the distance from the target at the last call [m]; None.

    References
    ----------
    T. Lee, M. Leok, N. McClamroch, Geometric tracking control of a quadrotor UAV on SE(3), IEEE
    CDC 2010.

    """

    mode, plan = 'hover', None

    def __init__(self, mass: float, weight: float, inertia: ArrayLike, place: ArrayLike):
        self._mass, self._weight, self.cost = mass, weight, math.nan
        self._inertia, self._place = np.array(inertia), np.array(place)

    def __call__(self, q: ArrayLike, v: ArrayLike, t: float = 0.0) -> np.ndarray:
        """
        Return the commands, shape (4,).

        Parameters
        ----------
        q : array_like, shape (7,)
            Position, and quaternion x, y, z, w.
        v : array_like, shape (6,)
            Velocity in the world frame, and angular velocity in the body frame.
        t : float, optional
            Ignored [s].

        """
        q, v = np.asarray(q), np.asarray(v)
        R, away = Rotation.from_quat(q[3:]).as_matrix(), q[:3] - self._place
        self.cost = float(np.linalg.norm(away))
        away *= REACH / max(self.cost, REACH)
        force = [0.0, 0.0, self._weight] - self._mass * PLACE_RATE * (
            PLACE_RATE * away + 2.0 * DAMPING * v[:3])
        up = force / np.linalg.norm(force)
        left = np.cross(up, [1.0, 0.0, 0.0])
        left /= np.linalg.norm(left)
        wanted = np.column_stack([np.cross(left, up), left, up])
        turned = 0.5 * (wanted.T @ R - R.T @ wanted)
        error = np.array([turned[2, 1], turned[0, 2], turned[1, 0]])
        torques = -self._inertia * TURN_RATE * (TURN_RATE * error + 2.0 * DAMPING * v[3:])
        # Rotors only push.
        return np.array([max(0.0, force @ R[:, 2]), *torques])
