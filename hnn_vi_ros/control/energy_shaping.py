# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Swing-up by energy shaping, with a regulator near the goal."""

import math

from hnn_vi_ros.control.balance import Balance
from hnn_vi_ros.control.costs import deviation
from hnn_vi_ros.control.linear import momentum
import numpy as np
from numpy.typing import ArrayLike

# Push along the inputs at rest, where energy shaping has no effect [1/s of the input].
_PUSH = 1e-2


class EnergyShaping:
    """
    Drive the energy to that of the goal along the inputs; regulate near the goal.

    H is passive from commands u to the velocities y = B v of the driven inputs: without friction
    H' = u . y. With springs on the inputs, u = -k (B q - B q*) + w, the same holds for
    H~ = H + k (B q - B q*)^2 / 2 and w. Therefore

        w = -g (H~ - H*) y

    never increases (H~ - H*)^2: its rate is -2 g (H~ - H*)^2 y . y, for any H, learned or not. If
    a rollout under the regulator reaches the goal, the regulator takes over. Use it for swing-ups
    of pendulum-like machines; take Ilqr for other goals.

    Parameters
    ----------
    balance : Balance
        Regulator of the goal, with the limits of commands.
    gain : float
        Gain g > 0 [s] if the commands are torques.
    stiffness : float, optional
        k >= 0 [N/m], [N m/rad].

    Attributes
    ----------
    mode, cost
        ``'energy'`` or ``'lqr'``; at the last call, the distance of H~ from H* [J], or the
        regulator's cost.

    References
    ----------
    K. J. Åström, K. Furuta, Swinging up a pendulum by energy control, Automatica 36 (2000).
    R. Ortega et al., Putting energy back in control, IEEE Control Systems 21 (2001).

    """

    plan = None

    def __init__(self, balance: Balance, gain: float = 1.0, stiffness: float = 0.0):
        self._balance, self._gain, self._stiffness = balance, gain, stiffness
        self._hamiltonian, d = balance.steps.hamiltonian, balance.steps.dimension
        # Input matrix of the commands at the goal.
        self._places = balance.steps.field_derivatives(*balance.at)[1][d:].T
        self._energy = float(self._hamiltonian.energy(*np.split(balance.at[0], 2)))
        self.mode, self.cost = 'energy', math.nan

    def __call__(self, q: ArrayLike, v: ArrayLike, t: float = 0.0) -> np.ndarray:
        """Return the command, shape (c,), for coordinates and velocities, shape (d,) each."""
        balance, q = self._balance, np.asarray(q, dtype=np.float64)
        p = momentum(balance.steps, q, v)
        z = np.concatenate([q, p])
        if balance.catches(z):
            u = balance.act(z)
            self.mode, self.cost = balance.mode, balance.cost
            return u
        away = deviation(self._hamiltonian, z, balance.at[0])
        stretched, y = self._places @ away[:q.size], self._places @ np.asarray(v)
        if np.abs(y).max() < _PUSH:
            y = np.full(y.size, _PUSH)
        excess = float(self._hamiltonian.energy(q, p)) - self._energy \
            + 0.5 * self._stiffness * float(stretched @ stretched)
        self.mode, self.cost = 'energy', abs(excess)
        return np.clip(-self._stiffness * stretched - self._gain * excess * y,
                       -balance.limits, balance.limits)
