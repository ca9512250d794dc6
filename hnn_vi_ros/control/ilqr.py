# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Planning by iLQR with box limits on the commands, and a regulator near its equilibrium."""

from collections.abc import Callable
import time
from typing import NamedTuple

from hnn_vi_ros.control.batch_step import BatchStep
from hnn_vi_ros.control.costs import Cost, deviation
from hnn_vi_ros.control.linear import momentum
from hnn_vi_ros.control.planning import Plan, Planner
from hnn_vi_ros.control.riccati import riccati_sweep, Stages
import numpy as np
from numpy.typing import ArrayLike

# Step lengths of the line search: the one tried first, then those tried together.
_STEP_LENGTHS = np.array([1.0]), np.array([0.6, 0.3, 0.1, 0.03])
# Share of the predicted gain that is accepted, and relative gain at which iterations stop.
_MIN_GAIN_SHARE, _MIN_RELATIVE_GAIN = 0.01, 1e-6
# Bounds of the damping.
_MIN_DAMPING, _MAX_DAMPING = 1e-6, 1e3
# Relative and absolute increase of a plan's cost that triggers a restart from random plans.
_MAX_COST_RATIO, _ABSOLUTE_TOLERANCE = 1.1, 1e-9


class Regulator(NamedTuple):
    """
    A linear law u = u* - K x about an equilibrium, and the region in which it is used.

    Parameters
    ----------
    at : tuple of np.ndarray, shape (2 d,) and (c,)
        z* and u*; see ``find_equilibrium``.
    gain : np.ndarray, shape (c, 2 d)
        Gain K of the discrete map of the steps; see ``lqr``.
    below : float
        Upper bound of the running cost during a rollout under the law, with its limits.
    duration : float
        Duration of that rollout [s].

    """

    at: tuple[np.ndarray, np.ndarray]
    gain: np.ndarray
    below: float
    duration: float = 2.0


class Ilqr(Planner):
    """
    Receding-horizon iLQR that replans in each call: u = controller(q, v, t).

    Each call starts from the last plan, shifted in time, and iterates until the budget is spent or
    nothing improves. If a disturbance has made the plan worse, random plans are tried as well and
    the best of them are refined. If a rollout shows that a regulator succeeds, it takes over. The
    first choice for differentiable models; use Mppi if steps have no derivatives.

    Parameters
    ----------
    steps : BatchStep
        Model; each command of a plan lasts ``steps.duration``.
    running, final : Cost
        Costs of each state and command, and of the last state with zero commands.
    horizon : int
        Number of commands of a plan.
    limits : tuple of array_like, shape (c,)
        Minimum and maximum commands.
    regulator : Regulator, optional
        Regulator; None to always plan.
    budget : float, optional
        Time for a call [s]. An iteration starts only if it can finish in time, judged by the last.
    iterations : int, optional
        Maximum number of iterations per call.
    restarts, refined : int, optional
        Number of random plans after a disturbance, and number of plans refined.
    seed : int, optional
        Seed of the random plans.
    clock : callable, optional
        Function that returns the time for the budget [s].

    Attributes
    ----------
    mode : str
        ``'plan'``, ``'restart'`` or ``'regulate'``.
    cost : float
        Cost of the plan.
    plan : np.ndarray, shape (N + 1, 2 d), or None
        States of the plan.

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
        """Return the command from t on, shape (c,)."""
        end = self._clock() + self._budget
        z = np.append(np.asarray(q, dtype=np.float64), momentum(self._steps, q, v))
        regulated = self._regulated(z, t)
        if regulated is not None:
            self.mode, self._others = 'regulate', []
            return self._take(regulated, t)
        plans = self._candidates(z, t)
        took = 0.0
        for _ in range(self._iterations):
            going, begun = [one for one in plans if not one.done], self._clock()
            if not going or begun + took >= end:
                break
            self._improve(going, t)
            took = self._clock() - begun
        best = min(plans, key=lambda one: one.cost)
        self._others = [one for one in plans if one is not best and not one.done]
        return self._take(best, t)

    def _candidates(self, z: np.ndarray, t: float) -> list[Plan]:
        """Return the initial plans: from the last call, or the best of random ones."""
        last, since = self._last, self._steps_since(t)
        self.mode = 'plan'
        if last is not None and since < self._horizon:
            going = [last, *self._others]
            planned, found, *others = self._continued(
                np.stack([last.states[since], *[z] * len(going)]), [last, *going], t)
            # A disturbance is larger than any step of the plan.
            moves = np.abs(np.diff(last.states, axis=0)).max(axis=0)
            if found.cost <= _MAX_COST_RATIO * planned.cost + _ABSOLUTE_TOLERANCE and (
                    np.abs(z - planned.states[0]) <= moves + _ABSOLUTE_TOLERANCE).all():
                return [found, *others]
        self.mode = 'restart'
        return self._fresh(z, t)

    def _continued(self, z: np.ndarray, plans: list[Plan], t: float) -> list[Plan]:
        """Return the last call's plans shifted to now, each from a given state, with feedback."""
        since, n = self._steps_since(t), z.shape[1]
        commands = np.stack([self._shifted(plan, t) for plan in plans])
        gains, about = np.zeros((*commands.shape, n)), np.zeros((*commands.shape[:2], n))
        for plan, own, states in zip(plans, gains, about, strict=True):
            if plan.gains is not None:
                own[:self._horizon - since] = plan.gains[since:]
                states[:self._horizon - since] = plan.states[since:-1]
        return self._rolled(z, commands, t, gains, about)

    def _fresh(self, z: np.ndarray, t: float) -> list[Plan]:
        """Return the best of random plans, whose commands are piecewise constant."""
        count, size = self._restarts, (self._horizon, self._steps.commands)
        pieces = self._rng.uniform(self._low, self._high, (count, 6, size[1]))
        guesses = np.repeat(pieces, -(-self._horizon // 6), axis=1)[:, :self._horizon]
        last, *plans = self._rolled(z, np.concatenate([[self._shifted(self._last, t)], guesses]),
                                    t)
        return [last, *sorted(plans, key=lambda one: one.cost)[:self._refined - 1]]

    def _regulated(self, z: np.ndarray, t: float) -> Plan | None:
        """Return the plan of the regulator, None outside its region."""
        own = self._regulator
        if own is None:
            return None
        # The same state, with angles wrapped to the equilibrium's.
        near = own.at[0] + deviation(self._steps.hamiltonian, z, own.at[0])
        first = np.clip(own.at[1] - own.gain @ (near - own.at[0]), self._low, self._high)
        if not self._running.value(near, first) <= own.below:
            return None
        count = max(self._horizon, round(own.duration / self._steps.duration))
        states, commands = self._steps.rollout(
            near, np.broadcast_to(own.at[1], (1, count, own.at[1].size)), -own.gain, own.at[0],
            (self._low, self._high), t)
        worst = self._running.value(states[:, :-1], commands).max()
        if not worst <= own.below:
            return None
        states = states[:, :self._horizon + 1] + (z - near)
        commands = commands[:, :self._horizon]
        return Plan(commands[0], states[0], float(self._costs(states, commands)[0]),
                    np.broadcast_to(-own.gain, (self._horizon, *own.gain.shape)))

    def _improve(self, plans: list[Plan], t: float) -> None:
        """Update plans with one iteration of iLQR; mark those done that gain nothing."""
        commands = np.stack([plan.commands for plan in plans])
        states = np.stack([plan.states for plan in plans])
        changes, gains, gained = self._changes(plans, commands, states, t)
        rest = np.flatnonzero(np.isfinite(gained[:, 0]))
        failed = set(range(len(plans))) - set(rest.tolist())
        for lengths in _STEP_LENGTHS:
            rows, much = np.repeat(rest, lengths.size), np.tile(lengths, rest.size)
            tried = commands[rows] + much[:, None, None] * changes[rows]
            moved, taken = self._steps.rollout(
                states[rows, 0], tried, gains[rows], states[rows, :-1], (self._low, self._high), t)
            costs = self._costs(moved, taken).reshape(rest.size, lengths.size)
            best = costs.argmin(axis=1)
            kept = []
            for i, m in enumerate(rest.tolist()):
                plan, length, row = plans[m], lengths[best[i]], i * lengths.size + best[i]
                gain = plan.cost - costs[i, best[i]]
                predicted = -length * gained[m, 0] - length**2 * gained[m, 1]
                if not (gain > _MIN_GAIN_SHARE * predicted and gain > 0.0):
                    kept.append(m)
                    continue
                plan.done = bool(gain < _MIN_RELATIVE_GAIN * abs(plan.cost))
                plan.commands, plan.states, plan.gains = taken[row], moved[row], gains[m]
                plan.cost = float(costs[i, best[i]])
                plan.damping = 0.0 if plan.damping <= _MIN_DAMPING else 0.1 * plan.damping
            rest = np.array(kept, dtype=int)
            if not rest.size:
                break
        for m in (*failed, *rest.tolist()):
            # Damp the next iteration more; give the plan up beyond the maximum.
            plans[m].damping = max(_MIN_DAMPING, 10.0 * plans[m].damping)
            plans[m].done = plans[m].damping > _MAX_DAMPING

    def _changes(self, plans: list[Plan], commands: np.ndarray, states: np.ndarray, t: float
                 ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return command changes, gains and predicted gains of m plans; see ``riccati_sweep``."""
        m, count, c = commands.shape
        n = states.shape[2]
        z, u = states[:, :-1].reshape(-1, n), commands.reshape(-1, c)
        times = np.tile(t + self._steps.duration * np.arange(count), m)
        _, f_z, f_u = self._steps.derivatives(z, u, times)
        along = self._running.expand(z, u)
        end = self._final.expand(states[:, -1], np.zeros((m, c)))
        changes, gains, gained = np.zeros((m, count, c)), np.zeros((m, count, c, n)), \
            np.empty((m, 2))
        riccati_sweep(Stages(
            np.ascontiguousarray(f_z).reshape(m, count, n, n),
            np.ascontiguousarray(f_u).reshape(m, count, n, c),
            np.concatenate([along.by_z.reshape(m, count, n), end.by_z[:, None]], axis=1),
            np.concatenate([along.by_zz.reshape(m, count, n, n), end.by_zz[:, None]], axis=1),
            along.by_u.reshape(m, count, c),
            np.ascontiguousarray(along.by_uu).reshape(m, count, c, c),
            self._low - commands, self._high - commands,
            np.array([plan.damping for plan in plans])), changes, gains, gained)
        return changes, gains, gained
