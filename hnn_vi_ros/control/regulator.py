# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The linear regulator around a state at rest, within limits, and where it holds."""

import math

from hnn_vi_ros.control.batch_step import BatchStep
from hnn_vi_ros.control.linear import lqr, momentum
import numpy as np
from numpy.typing import ArrayLike

# Time constants of the slowest mode that a rollout lasts, and what of the cost may be left then:
# by the linear model exp(-10).
_CONSTANTS, _LEFT = 5.0, 1e-2
_LONGEST_ROLLOUT = 2000
# Farther out no rollout is tried [limits]; a rollout whose cost grows so much is lost, and so much
# more than where it began ends the regulation.
_FARTHEST, _LOST, _GROWTH = 3.0, 10.0, 2.0


class Regulator:
    """
    The discrete LQR of a goal at rest, u = clip(u* - K (z - z*)), called as a controller.

    Parameters
    ----------
    steps : BatchStep
        Steps of the model, each as long as a command is held.
    goal : tuple of np.ndarray, shape (2 d,) and (c,)
        z* and u*; see ``find_equilibrium``.
    limits : array_like, shape (c,)
        Largest sizes of commands [N], [N m]; the weight of a command is one over its square.
    position, velocity : array_like, shape (d,), optional
        Weights of deviations of q and of v.

    Attributes
    ----------
    mode, cost
        ``'lqr'``, and z . P z at the last call.

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
        self.steps, (self.goal, self.hold) = steps, goal
        self.limits, self.cost = np.asarray(limits, dtype=np.float64), math.nan
        d = steps.dimension
        _, a, b = steps.derivatives(*goal)
        # Users weigh velocities; states have momenta, whose deviations make those of H_p.
        to_v = np.vstack([np.eye(d, 2 * d), steps.field_derivatives(*goal)[0][:d]])
        weights = np.r_[np.broadcast_to(position, d), np.broadcast_to(velocity, d)]
        self.gain, self._cost = lqr(a, b, steps.duration * to_v.T * weights @ to_v,
                                    steps.duration * np.diag(self.limits**-2.0), discrete=True)
        slowest = np.abs(np.linalg.eigvals(a - b @ self.gain)).max()
        self._rollout = min(_LONGEST_ROLLOUT, math.ceil(-_CONSTANTS / math.log(slowest)))
        self._turns = turns(steps, self.goal[:d])
        self._most = 0.0

    def __call__(self, q: ArrayLike, v: ArrayLike, t: float = 0.0) -> np.ndarray:
        """Return the command, shape (c,), at coordinates and velocities, shape (d,) each."""
        return self.act(np.concatenate([q, momentum(self.steps, q, v)]))

    def act(self, z: np.ndarray) -> np.ndarray:
        """Return the command at a state, shape (2 d,)."""
        away = self.deviation(z)
        self.cost = float(away @ self._cost @ away)
        return self._law(away)

    def deviation(self, z: np.ndarray) -> np.ndarray:
        """Return z - z*, of coordinates that turn to the nearest of its images."""
        away = z - self.goal
        turned = away[:self._turns.size][self._turns]
        away[:self._turns.size][self._turns] = turned - 2.0 * np.pi * np.round(
            turned / (2.0 * np.pi))
        return away

    def catches(self, z: np.ndarray) -> bool:
        """Return whether the law, within its limits, leads from a state to the goal."""
        away = self.deviation(z)
        cost = float(away @ self._cost @ away)
        if not cost <= self._most:
            self._most = _GROWTH * cost if self._holds(z, cost) else 0.0
        return self._most > 0.0

    def _law(self, away: np.ndarray) -> np.ndarray:
        return np.clip(self.hold - self.gain @ away, -self.limits, self.limits)

    def _holds(self, z: np.ndarray, cost: float) -> bool:
        """Simulate the model under the law."""
        if (np.abs(self.gain @ self.deviation(z)) > _FARTHEST * self.limits).any():
            return False
        for _ in range(self._rollout):
            away = self.deviation(z)
            left = away @ self._cost @ away
            if not _LEFT * cost < left < _LOST * cost:
                return bool(left <= _LEFT * cost)
            z = self.steps(z, self._law(away))
        return False


def turns(steps: BatchStep, q: np.ndarray) -> np.ndarray:
    """Return which coordinates are angles that H does not tell from one turn more, shape (d,)."""
    hamiltonian, d = steps.hamiltonian, steps.dimension
    # Some states near the goal tell; fixed ones, so that the same scene gives the same controller.
    states = np.random.default_rng(0).normal(size=(8, 2 * d)) + np.append(q, np.zeros(d))
    slopes = np.hstack(hamiltonian.gradient(*np.hsplit(states, 2)))
    found = []
    for coordinate, unit in zip(hamiltonian.coordinates, np.eye(d), strict=True):
        turned = np.hstack(hamiltonian.gradient(states[:, :d] + 2.0 * np.pi * unit, states[:, d:]))
        found.append(coordinate.q_unit == 'rad'
                     and bool(np.abs(turned - slopes).max() <= 1e-9 * np.abs(slopes).max()))
    return np.array(found)
