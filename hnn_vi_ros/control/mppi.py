# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Model predictive path integral control: a weighted average of random commands."""

from hnn_vi_ros.control.batch_step import BatchStep
from hnn_vi_ros.control.costs import Cost
from hnn_vi_ros.control.linear import momentum
from hnn_vi_ros.control.planning import Planner
import numpy as np
from numpy.typing import ArrayLike


class Mppi(Planner):
    """
    The mean of random plans, weighted by exp(-cost / temperature): u = controller(q, v, t).

    It needs no derivatives and works with all methods and models of BatchStep; if derivatives are
    available, Ilqr usually needs less time.

    Parameters
    ----------
    steps, running, final, horizon, limits, seed
        See Ilqr.
    spread : array_like, shape (c,)
        Standard deviation of the noise added to the commands of the last plan.
    temperature : float
        Temperature in units of the cost.
    samples : int, optional
        Number of random plans per call.
    knots : int, optional
        Number of independent noise values per command; between them it is interpolated.

    Attributes
    ----------
    mode, cost, plan
        See Ilqr; the mode is always ``'plan'``.

    References
    ----------
    G. Williams, P. Drews, B. Goldfain, J. Rehg, E. Theodorou, Information-theoretic model
    predictive control, IEEE Transactions on Robotics 34 (2018).

    """

    def __init__(self, steps: BatchStep, running: Cost, final: Cost, horizon: int,
                 limits: tuple[ArrayLike, ArrayLike], spread: ArrayLike, temperature: float,
                 samples: int = 256, knots: int = 8, seed: int = 0):
        super().__init__(steps, running, final, horizon, limits, seed)
        self._spread = np.broadcast_to(np.asarray(spread, dtype=np.float64), self._low.shape)
        if not (self._spread > 0.0).all() or not temperature > 0.0:
            raise ValueError(f'spread = {self._spread.tolist()} and temperature = {temperature} '
                             'must be positive')
        self._temperature, self._samples = float(temperature), int(samples)
        # Linear interpolation from knots to commands.
        at = np.linspace(0.0, knots - 1.0, horizon)
        self._knots = np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(knots)))

    def __call__(self, q: ArrayLike, v: ArrayLike, t: float) -> np.ndarray:
        """Return the command from t on, shape (c,)."""
        z = np.append(np.asarray(q, dtype=np.float64), momentum(self._steps, q, v))
        mean = self._shifted(self._last, t)
        noise = self._knots @ self._rng.normal(
            scale=self._spread, size=(self._samples, self._knots.shape[1], self._spread.size))
        # Include the last plan without noise.
        noise[0] = 0.0
        plans = self._rolled(z, mean + noise, t)
        costs = np.array([one.cost for one in plans])
        weights = np.exp((costs.min() - costs) / self._temperature)
        weights /= weights.sum()
        commands = np.tensordot(weights, np.array([one.commands for one in plans]), 1)
        return self._take(self._rolled(z, commands[None], t)[0], t)
