# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Base class of controllers that plan commands over a horizon."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

from hnn_vi_ros.control.batch_step import BatchStep
from hnn_vi_ros.control.costs import Cost
from hnn_vi_ros.simulation import check_count
import numpy as np
from numpy.typing import ArrayLike


@dataclass
class Plan:
    """
    Commands over a horizon.

    Parameters
    ----------
    commands : np.ndarray, shape (N, c)
        Successive commands.
    states : np.ndarray, shape (N + 1, 2 d)
        States reached by the commands.
    cost : float
        Cost; inf if a step failed.
    gains : np.ndarray, shape (N, c, 2 d), or None
        Feedback gains on deviations from the states.
    damping : float
        Damping; see ``sweep``.
    done : bool
        True if iterations no longer improve the plan.

    """

    commands: np.ndarray
    states: np.ndarray
    cost: float
    gains: np.ndarray | None = None
    damping: float = 0.0
    done: bool = False


class Planner(ABC):
    """
    A controller that plans: u = controller(q, v, t).

    Attributes
    ----------
    mode : str
        Origin of the last command.
    cost : float
        Cost of the last plan.
    plan : np.ndarray, shape (N + 1, 2 d), or None
        States of the last plan; None before the first one.
    interval : float
        Time between two of these states [s].

    """

    def __init__(self, steps: BatchStep, running: Cost, final: Cost, horizon: int,
                 limits: tuple[ArrayLike, ArrayLike], seed: int):
        check_count('horizon', horizon)
        self._steps, self._running, self._final = steps, running, final
        self._low, self._high = (np.broadcast_to(np.asarray(limit, dtype=np.float64),
                                                 (steps.commands,)) for limit in limits)
        if not (self._low < self._high).all() or not steps.commands:
            raise ValueError(f'limits {self._low.tolist()} and {self._high.tolist()} must allow a '
                             'range of commands, and the scene must accept commands with an '
                             'external_force')
        self._horizon, self._seed, self.interval = int(horizon), seed, steps.duration
        self.reset()

    def reset(self) -> None:
        """Discard all plans, so that the next call does as the first one."""
        self._rng = np.random.default_rng(self._seed)
        self.mode, self.cost, self._time = 'plan', np.inf, 0.0
        self.plan: np.ndarray | None = None
        self._last: Plan | None = None
        # Other plans of the last call that iterations still improve.
        self._others: list[Plan] = []

    @abstractmethod
    def __call__(self, q: ArrayLike, v: ArrayLike, t: float) -> np.ndarray:
        """
        Return the command from t on, shape (c,).

        Parameters
        ----------
        q, v : array_like, shape (d,)
            Coordinates and velocities.
        t : float
            Time [s].

        """

    def _take(self, plan: Plan, t: float) -> np.ndarray:
        """Store a plan as the last one; return its first command."""
        self._last, self._time, self.cost, self.plan = plan, t, plan.cost, plan.states
        return plan.commands[0].copy()

    def _steps_since(self, t: float) -> int:
        """Return the number of commands of the last plan that have passed."""
        return max(0, round((t - self._time) / self._steps.duration))

    def _shifted(self, plan: Plan | None, t: float) -> np.ndarray:
        """Return a plan's commands from now on, shape (N, c), padded with zero commands."""
        commands = np.clip(np.zeros((self._horizon, self._steps.commands)), self._low, self._high)
        if plan is not None:
            rest = plan.commands[self._steps_since(t):]
            commands[:len(rest)] = rest
        return commands

    def _costs(self, states: np.ndarray, commands: np.ndarray) -> np.ndarray:
        """Return the costs of m plans, inf if a step fails."""
        running = self._running.value(states[:, :-1], commands).sum(axis=-1)
        total = running + self._final.value(states[:, -1], np.zeros_like(commands[:, 0]))
        return np.where(np.isfinite(total), total, np.inf)

    def _rolled(self, z: np.ndarray, commands: np.ndarray, t: float,
                gains: np.ndarray | None = None, about: np.ndarray | None = None) -> list[Plan]:
        """Return plans from m rows of commands with feedback, from one state or one per row."""
        states, commands = self._steps.rollout(
            z, commands, gains, about, (self._low, self._high), t)
        return [Plan(*parts) for parts in zip(
            commands, states, self._costs(states, commands).tolist(),
            len(commands) * [None] if gains is None else gains, strict=True)]
