# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The linear regulator of a state at rest as a controller, with its region of attraction."""

import math

from hnn_vi_ros.control.batch_step import BatchStep
from hnn_vi_ros.control.costs import deviation
from hnn_vi_ros.control.linear import lqr, momentum
import numpy as np
from numpy.typing import ArrayLike

# Duration of a rollout in time constants of the slowest mode, and the share of the cost allowed at
# its end; the linear model predicts exp(-10).
_ROLLOUT_CONSTANTS, _MAX_FINAL_COST_SHARE = 5.0, 1e-2
_MAX_ROLLOUT_STEPS = 5000
# Maximum unclipped command for which a rollout is tried, relative to the limits; and the growth of
# the cost since the regulator took over that ends its turn.
_MAX_COMMAND_RATIO, _MAX_COST_GROWTH = 3.0, 2.0


class Balance:
    """
    The discrete LQR of a goal at rest, within limits: u = clip(u* - K (z - z*)).

    Parameters
    ----------
    steps : BatchStep
        Steps of the model, each as long as a command is held.
    goal : tuple of np.ndarray, shape (2 d,) and (c,)
        z* and u*; see ``find_equilibrium``.
    limits : array_like, shape (c,)
        Maximum sizes of commands [N], [N m]; the weight of a command is one over its square.
    position, velocity : array_like, shape (d,), optional
        Weights of deviations of q and of v.

    Attributes
    ----------
    mode, cost, plan
        ``'lqr'``; the cost-to-go x^T P x of the deviation x at the last call; None.
    at : tuple of np.ndarray
        z* and u*.
    gain, value : np.ndarray, shape (c, 2 d) and (2 d, 2 d)
        K and P.

    Raises
    ------
    ValueError
        Commands cannot stabilise the goal.

    References
    ----------
    B. Anderson, J. Moore, Optimal Control: Linear Quadratic Methods, 1990, chapter 3.

    """

    mode, plan = 'lqr', None

    def __init__(self, steps: BatchStep, goal: tuple[np.ndarray, np.ndarray], limits: ArrayLike,
                 position: ArrayLike = 1.0, velocity: ArrayLike = 0.1):
        self.steps, self.at, self.cost = steps, goal, math.nan
        self.limits = np.asarray(limits, dtype=np.float64)
        _, a, b = steps.derivatives(*goal)
        weights = weights_of(steps, goal, position, velocity)
        self.gain, self.value = lqr(a, b, steps.duration * weights,
                                    steps.duration * np.diag(self.limits**-2.0), discrete=True)
        slowest = np.abs(np.linalg.eigvals(a - b @ self.gain)).max()
        self._count = min(_MAX_ROLLOUT_STEPS, math.ceil(-_ROLLOUT_CONSTANTS / math.log(slowest)))
        self._max_cost = 0.0

    def __call__(self, q: ArrayLike, v: ArrayLike, t: float = 0.0) -> np.ndarray:
        """Return the command, shape (c,), for coordinates and velocities, shape (d,) each."""
        return self.act(np.concatenate([q, momentum(self.steps, q, v)]))

    def act(self, z: np.ndarray) -> np.ndarray:
        """Return the command at a state, shape (2 d,)."""
        away = deviation(self.steps.hamiltonian, z, self.at[0])
        self.cost = float(away @ self.value @ away)
        return np.clip(self.at[1] - self.gain @ away, -self.limits, self.limits)

    def catches(self, z: np.ndarray) -> bool:
        """Return whether the law with its limits brings a state to the goal."""
        away = deviation(self.steps.hamiltonian, z, self.at[0])
        cost = float(away @ self.value @ away)
        if not cost <= self._max_cost:
            self._max_cost = _MAX_COST_GROWTH * cost if self._holds(away, cost) else 0.0
        return self._max_cost > 0.0

    def _holds(self, away: np.ndarray, cost: float) -> bool:
        """Return whether a rollout of the model under the law approaches the goal."""
        if (np.abs(self.gain @ away) > _MAX_COMMAND_RATIO * self.limits).any():
            return False
        z, u = self.at
        states, _ = self.steps.rollout(
            z + away, np.broadcast_to(u, (1, self._count, u.size)), -self.gain, z,
            (-self.limits, self.limits))
        left = states[0, -1] - z
        return bool(left @ self.value @ left <= _MAX_FINAL_COST_SHARE * cost)


def weights_of(steps: BatchStep, goal: tuple[np.ndarray, np.ndarray], position: ArrayLike,
               velocity: ArrayLike) -> np.ndarray:
    """
    Convert weights of deviations of q and v = H_p to weights of (q, p), shape (2 d, 2 d).

    Parameters
    ----------
    steps : BatchStep
        Steps of the model.
    goal : tuple of np.ndarray
        State and command at which v is linearised.
    position, velocity : array_like, shape (d,)
        Weights of q and of v.

    """
    d = steps.dimension
    to_v = np.vstack([np.eye(d, 2 * d), steps.field_derivatives(*goal)[0][:d]])
    each = np.r_[np.broadcast_to(position, d), np.broadcast_to(velocity, d)]
    return (to_v.T * each) @ to_v
