# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The largest step of a method that holds a tolerance, found by trials."""

from dataclasses import dataclass
import math

from hnn_vi_ros.accuracy.trials import (
    FAILED, InitialValueProblem, Judge, Method, parts_between, parts_for, Trial)
from hnn_vi_ros.errors import StepFailure

# Measured errors must stay this far below the tolerance: if seen all the way up to the horizon,
# and if extrapolated from a shorter time.
_SEEN, _CARRIED = 0.95, 0.5
# The most trials of a method.
_TRIALS = 24
# Slopes of the error over the step, as shares of the order: of steps that resolve the path, and
# of round-off; and errors that only steps have that do.
_RESOLVED, _FLAT, _SMALL = 0.5, 0.25, 1e-7


@dataclass
class StepSearch:
    """
    Findings of the trials of a method.

    Parameters
    ----------
    method : Method
        The method to try.
    order : int
        Its order.
    base : float
        A time that the steps divide [s].
    tried : dict of int to Trial
        By the number of parts that a step is of the base.

    """

    method: Method
    order: int
    base: float
    tried: dict[int, Trial]

    def allowed(self, trial: Trial, judge: Judge) -> float:
        """Return the error that a trial may have."""
        seen = trial.checked >= judge.tolerance.horizon * (1.0 - 1e-9)
        return (_SEEN if seen else _CARRIED) * judge.tolerance.error - judge.known

    def holds(self, trial: Trial, judge: Judge) -> bool:
        """Return whether a trial held the tolerance."""
        return trial.complete and trial.error <= self.allowed(trial, judge)

    def dear(self, parts: int, judge: Judge, bound: float) -> bool:
        """
        Return whether a trial, and all with smaller steps, cost more than another method does.

        Where steps are so long that their equations are hard to solve, smaller ones cost less.
        """
        trial = self.tried[parts]
        if not (trial.dear or (trial.complete and trial.cost >= bound)):
            return False
        coarser = [other.cost for k, other in self.tried.items() if k < parts]
        return trial.error <= self.allowed(trial, judge) or (
            min(coarser, default=math.inf) <= trial.cost)

    def best(self, judge: Judge) -> int | None:
        """Return the parts of the cheapest trial that held the tolerance."""
        good = [k for k, trial in self.tried.items() if self.holds(trial, judge)]
        return min(good, key=lambda k: (self.tried[k].cost, k), default=None)

    def at_floor(self) -> bool:
        """
        Return whether smaller steps no longer help: round-off is what is left.

        That is shown by two steps in a row, each at most two thirds as long as the one before,
        over which the error falls by less than a quarter of the method's order; the error must
        be small, too, or have fallen by that order before, a sign that steps resolve the path.
        """
        rows = sorted((k, trial.error) for k, trial in self.tried.items()
                      if trial.complete and math.isfinite(trial.error))
        if not rows:
            return False
        flat, resolved, (last, before) = 0, False, rows[0]
        for k, error in rows[1:]:
            slope = math.log(max(before, 1e-300) / max(error, 1e-300)) / math.log(k / last)
            resolved = resolved or slope >= _RESOLVED * self.order or error <= _SMALL
            if 2 * k >= 3 * last:
                flat = flat + 1 if slope < _FLAT * self.order else 0
                last, before = k, error
        return resolved and flat >= 2

    @property
    def least_cost(self) -> float:
        """Return the least cost of the trials that were seen to their end [1/s]."""
        return min((trial.cost for trial in self.tried.values() if trial.complete),
                   default=math.inf)


def search(problem: InitialValueProblem, method: Method, base: float, judge: Judge, guess: float,
           bound: float) -> StepSearch:
    """
    Try steps until the largest that holds a tolerance is found, or it is shown that none does.

    None does where the round-off floor is shown, see ``StepSearch.at_floor``, or where steps small
    enough would cost more than is affordable, or than is known to do.

    Parameters
    ----------
    problem : InitialValueProblem
        The problem to simulate.
    method : Method
        The method to try.
    base : float
        A time that the steps divide [s].
    judge : Judge
        Measures a trial.
    guess : float
        The first step [s].
    bound : float
        Cost of the best that is known [1/s]; more is not looked at.

    """
    found = StepSearch(method, method.create().order, base, {})
    parts = parts_for(base / min(guess, base))
    while len(found.tried) < _TRIALS and parts not in found.tried:
        found.tried[parts] = now = _try(problem, method, base / parts, judge, bound)
        wish = _wish(found, parts, now, judge, bound)
        if wish is None or found.at_floor():
            break
        parts = wish
    return found


def _wish(found: StepSearch, parts: int, now: Trial, judge: Judge, bound: float) -> int | None:
    """Return the parts to try next; None if no other can be better."""
    # Smaller steps than these hold the tolerance, or cost too much; larger ones than those do not.
    enough = [k for k, trial in found.tried.items()
              if found.holds(trial, judge) or found.dear(k, judge, bound)]
    bad = [k for k, trial in found.tried.items() if trial.error > found.allowed(trial, judge)]
    low, high = max(bad, default=0), min(enough, default=math.inf)
    factor = 2.5
    if 0.0 < now.error < math.inf:
        allowed = max(found.allowed(now, judge), 1e-300)
        # The order gives the factor; a tenth more keeps a near miss from missing again.
        factor = 1.1 * (now.error / allowed) ** (1.0 / found.order)
    elif now.error == 0.0:
        factor = 0.25
    if found.dear(parts, judge, bound):
        # As many gradients for each step, with longer steps.
        factor = min(factor, max(1.2 * bound / now.cost, 0.5))
    wish = parts * min(max(factor, 0.15), 8.0)
    if math.isfinite(high):
        between = parts_between(low, high)
        if not between:
            return None
        return min(between, key=lambda k: abs(math.log(k / wish)))
    return max(parts_for(wish), parts_for(low + 0.5))


def _try(problem: InitialValueProblem, method: Method, h: float, judge: Judge, bound: float
         ) -> Trial:
    try:
        return judge(problem.simulation(method, h), bound)
    except StepFailure:
        return FAILED
