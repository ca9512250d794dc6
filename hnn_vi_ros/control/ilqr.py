# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Controllers that plan: iLQR with limits of commands, and a regulator where that holds."""

from collections.abc import Callable
import time
from typing import NamedTuple

from hnn_vi_ros.control.batch_step import BatchStep
from hnn_vi_ros.control.costs import Cost, deviation
from hnn_vi_ros.control.linear import momentum
from hnn_vi_ros.control.planning import Plan, Planner
from hnn_vi_ros.control.riccati import sweep
import numpy as np
from numpy.typing import ArrayLike

# Lengths of a change of all commands: that which is tried first, and those that are together.
_LENGTHS = np.array([1.0]), np.array([0.6, 0.3, 0.1, 0.03])
# Which share of the predicted gain is enough, and of the cost is too little to go on.
_ENOUGH, _LITTLE = 0.01, 1e-6
# Of damping.
_LEAST, _MOST = 1e-6, 1e3
# How much worse than planned a plan may become before others are tried.
_WORSE, _NOTHING = 1.1, 1e-9


class Regulator(NamedTuple):
    """
    A linear law u = u* - K x about an equilibrium, and where it is trusted.

    Parameters
    ----------
    at : tuple of np.ndarray, shape (2 d,) and (c,)
        z* and u*; see ``find_equilibrium``.
    gain : np.ndarray, shape (c, 2 d)
        K of the map of the steps; see ``lqr``.
    below : float
        It takes over where the running cost stays below this in a rollout with its limits.
    duration : float
        Of that rollout [s].

    """

    at: tuple[np.ndarray, np.ndarray]
    gain: np.ndarray
    below: float
    duration: float = 2.0


class Ilqr(Planner):
    """
    Commands from a plan over a horizon that is made anew in each call: u = controller(q, v, t).

    Each call goes on from the last plan, shifted by the time since then, with iterations of iLQR
    until the budget is spent or nothing improves. Where the state is not the one that was planned,
    so that the plan has become worse, plans also begin from random commands, and the best of them
    are refined. Where a rollout shows that a regulator holds, it commands.

    Parameters
    ----------
    steps : BatchStep
        The model; each command of a plan lasts ``steps.duration``.
    running, final : Cost
        Of each state and command, and of the last state, with commands of zero.
    horizon : int
        Commands of a plan.
    limits : tuple of array_like, shape (c,)
        Least and largest commands.
    regulator : Regulator, optional
        None if it always plans.
    budget : float, optional
        Time for a call [s]; a call ends with the iteration in which it is over.
    iterations : int, optional
        Most iterations of a plan in a call.
    restarts, refined : int, optional
        Random plans after a disturbance, and how many of them are refined.
    seed : int, optional
        Of these.
    clock : callable, optional
        Returns the time of the budget [s].

    Attributes
    ----------
    mode : str
        ``'plan'``, ``'restart'`` or ``'regulate'``.
    cost : float
        Of the plan.
    plan : np.ndarray, shape (N + 1, 2 d), or None
        Its states.

    References
    ----------
    Y. Tassa, N. Mansard, E. Todorov, Control-limited differential dynamic programming, ICRA 2014.

    """

    def __init__(self, steps: BatchStep, running: Cost, final: Cost, horizon: int,
                 limits: tuple[ArrayLike, ArrayLike], regulator: Regulator | None = None,
                 budget: float = np.inf, iterations: int = 12, restarts: int = 24,
                 refined: int = 4, seed: int = 0,
                 clock: Callable[[], float] = time.perf_counter):
        super().__init__(steps, running, final, horizon, limits, seed)
        self._regulator, self._budget, self._clock = regulator, budget, clock
        self._iterations, self._restarts, self._refined = iterations, restarts, refined

    def __call__(self, q: ArrayLike, v: ArrayLike, t: float) -> np.ndarray:
        """Return the command from t on, shape (c,); see Planner."""
        end = self._clock() + self._budget
        q = np.asarray(q, dtype=np.float64)
        z = np.append(q, momentum(self._steps, q, v))
        candidates = self._candidates(z, t)
        self.mode = 'plan' if len(candidates) == 1 else 'restart'
        regulated = self._regulated(z, t)
        if regulated is not None:
            self.mode, best = 'regulate', regulated
        else:
            for _ in range(self._iterations):
                for one in candidates:
                    if not one.done and self._clock() < end:
                        self._improve(one, t)
            best = min(candidates, key=lambda one: one.cost)
        return self._take(best, t)

    def _candidates(self, z: np.ndarray, t: float) -> list[Plan]:
        """Return the plans to go on from: the last one, or the best of several."""
        last, shifted = self._last, self._shifted(t)
        if last is not None and 0 < self._steps_since(t) < len(last.states):
            planned = last.states[self._steps_since(t)]
            wanted, found = self._rolled(np.stack([planned, z]), np.stack([shifted, shifted]), t)
            if found.cost <= _WORSE * wanted.cost + _NOTHING:
                return [found]
        return self._fresh(z, t, shifted)

    def _fresh(self, z: np.ndarray, t: float, shifted: np.ndarray) -> list[Plan]:
        """Return the best of plans with random commands that last a part of the horizon each."""
        count, size = self._restarts, (self._horizon, self._steps.commands)
        pieces = self._rng.uniform(self._low, self._high, (count, 6, size[1]))
        guesses = np.repeat(pieces, -(-self._horizon // 6), axis=1)[:, :self._horizon]
        plans = self._rolled(z, np.concatenate([shifted[None], guesses]), t)
        return sorted(plans, key=lambda one: one.cost)[:self._refined]

    def _regulated(self, z: np.ndarray, t: float) -> Plan | None:
        """Return the plan of the regulator where it is trusted."""
        own = self._regulator
        if own is None:
            return None
        # The same state, with the angles next to the equilibrium's.
        near = own.at[0] + deviation(self._steps.hamiltonian, z, own.at[0])
        count = max(self._horizon, round(own.duration / self._steps.duration))
        states, commands = self._steps.rollout(
            near, np.broadcast_to(own.at[1], (1, count, own.at[1].size)), -own.gain, own.at[0],
            (self._low, self._high), t)
        worst = self._running.value(states[:, :-1], commands).max()
        if not worst <= own.below:
            return None
        states = states[:, :self._horizon + 1] + (z - near)
        commands = commands[:, :self._horizon]
        return Plan(commands[0], states[0], float(self._costs(states, commands)[0]))

    def _improve(self, plan: Plan, t: float) -> None:
        """Change a plan by an iteration of iLQR; it is done where that gains nothing."""
        steps, count = self._steps, self._horizon
        times = t + steps.duration * np.arange(count)
        _, f_z, f_u = steps.derivatives(plan.states[:-1], plan.commands, times)
        cost = self._running.expand(plan.states[:-1], plan.commands)
        end = self._final.expand(plan.states[-1:], np.zeros((1, steps.commands)))
        changes, gains = np.empty_like(plan.commands), np.empty((*plan.commands.shape,
                                                                plan.states.shape[1]))
        convex, linear, quadratic = sweep(
            np.ascontiguousarray(f_z), np.ascontiguousarray(f_u),
            np.concatenate([cost.by_z, end.by_z]), cost.by_u,
            np.concatenate([cost.by_zz, end.by_zz]), np.ascontiguousarray(cost.by_uu),
            self._low - plan.commands, self._high - plan.commands, plan.damping, changes, gains)
        if not convex or not np.isfinite(gains).all():
            self._damp(plan)
            return
        for lengths in _LENGTHS:
            tried = plan.commands + lengths[:, None, None] * changes
            states, commands = steps.rollout(plan.states[0], tried, gains, plan.states[:-1],
                                             (self._low, self._high), t)
            costs = self._costs(states, commands)
            best = int(costs.argmin())
            gained, length = plan.cost - costs[best], lengths[best]
            if gained > -_ENOUGH * (length * linear + length**2 * quadratic) and gained > 0.0:
                plan.done = gained < _LITTLE * abs(plan.cost)
                plan.commands, plan.states, plan.cost = commands[best], states[best], costs[best]
                plan.damping = 0.0 if plan.damping <= _LEAST else 0.1 * plan.damping
                return
        self._damp(plan)

    def _damp(self, plan: Plan) -> None:
        """Let the next iteration of a plan change it less, or give it up."""
        plan.damping = max(_LEAST, 10.0 * plan.damping)
        plan.done = plan.damping > _MOST
