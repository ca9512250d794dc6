# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Choose the cheapest method and step size that hold a budget of error, by trying them."""

from contextlib import suppress
from dataclasses import asdict, dataclass
from hashlib import sha256
import json
import math
import os
from pathlib import Path
import platform

from hnn_vi_ros.errors import CalibrationError, StepFailure, UnsupportedSystem
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.trials import (
    Budget, energy_judge, INSTANTS, Judge, parts_for, path_judge, Problem, time_scale,
    UNAFFORDABLE)
from hnn_vi_ros.version import __version__
import numba
import numpy as np

# In the order in which they are tried. Every one keeps its energy for ever, so that what a short
# run shows holds for a long one. All Gauss methods share one compiled kernel.
CANDIDATES = ('stormer_verlet', 'generalized_leapfrog', 'variational_euler',
              *(f'gauss{order}' for order in range(4, 18, 2)))
# What is measured must stay this far below the budget.
SAFETY = 2.0
# Wall time of a trial [s], and the most trials of a method.
_TRIAL, _TRIALS = 0.06, 8
_CHAOS = ' (if the motion is chaotic, so does every method)'
# A method that promises to cost this many times the best is not tried further.
_HOPELESS = 3.0


@dataclass(frozen=True)
class Choice:
    """
    What a calibration found.

    Parameters
    ----------
    method : str
        A name of INTEGRATORS.
    step_size : float
        h [s].
    error : float
        The largest error seen, in the budget's measure, at the horizon.
    checked : float
        The simulated time over which it was seen [s]; less than the horizon where that is long.
    seconds_per_simulated_second : float
        What a simulated second costs on this machine [s/s].

    """

    method: str
    step_size: float
    error: float
    checked: float
    seconds_per_simulated_second: float

    def explain(self, budget: Budget) -> str:
        """Say what was chosen and why, on one line."""
        extent = '' if self.checked >= 0.999 * budget.horizon else (
            f', seen over {self.checked:.3g} s and carried on to {budget.horizon:g} s')
        return (f'chose {self.method} with h = {self.step_size:g} s for {budget.kind} '
                f'{budget.error:g} up to {budget.horizon:g} s: the cheapest that holds it, with '
                f'{self.error:.2g}{extent}, at {1e6 * self.seconds_per_simulated_second:.3g} us '
                'per simulated second')


def calibrate(problem: Problem, budget: Budget, largest_step: float | None = None) -> Choice:
    """
    Try methods and step sizes, and return the cheapest that holds a budget.

    Parameters
    ----------
    problem : Problem
        What is simulated.
    budget : Budget
        What must be held.
    largest_step : float, optional
        Steps must divide this time [s], such as that between two samples; without it a tenth of
        the horizon.

    Returns
    -------
    Choice
        Measured on this machine, now.

    Raises
    ------
    CalibrationError
        No method holds the budget; says how near the best comes. Or the path is chaotic and
        cannot be known up to the horizon.
    UnsupportedSystem
        No candidate takes the effects.

    """
    base = largest_step or budget.horizon / INSTANTS
    judge = energy_judge(problem, budget)
    if budget.kind == 'path_error':
        judge = path_judge(problem, budget, base)
    best, nearest, refusal = None, None, None
    for method in CANDIDATES:
        try:
            problem.simulation(method, base)
        except UnsupportedSystem as problem_of_method:
            refusal = problem_of_method
            continue
        except StepFailure as failure:
            raise CalibrationError(str(failure)) from failure
        bound = math.inf if best is None else best.seconds_per_simulated_second
        found, least = _search(problem, method, budget, base, judge, bound)
        nearest = min(filter(None, (nearest, least)), key=lambda choice: choice.error)
        if found and found.seconds_per_simulated_second < bound:
            best = found
    if nearest is None:
        raise refusal or CalibrationError('no candidate can be tried')
    if best is None:
        raise CalibrationError(
            f'no method holds {budget.kind} {budget.error:g} up to {budget.horizon:g} s with '
            f'{SAFETY:g}-fold safety; the nearest is {nearest.method} with h = '
            f'{nearest.step_size:g} s, which errs by {nearest.error:.2g}'
            f'{_CHAOS if budget.kind == "path_error" else ""}; allow a larger error or a shorter '
            'horizon')
    return best


def remembered(problem: Problem, budget: Budget, largest_step: float | None, name: str) -> Choice:
    """
    Return what ``calibrate`` chooses, from the last time that it did so on this machine.

    Parameters
    ----------
    problem, budget, largest_step
        See calibrate.
    name : str
        What tells the problem from others, beside the model behind H.

    """
    key = json.dumps([name, problem.hamiltonian.provenance, largest_step, __version__,
                      numba.__version__, platform.node(), os.cpu_count()])
    file = _cache_folder() / f'{sha256(key.encode()).hexdigest()[:32]}.json'
    try:
        return Choice(**json.loads(file.read_text()))
    except (OSError, ValueError, TypeError):
        # Not yet, or not readable: it is made anew.
        choice = calibrate(problem, budget, largest_step)
    with suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        part = file.with_suffix(f'.{os.getpid()}')
        part.write_text(json.dumps(asdict(choice)))
        part.replace(file)
    return choice


def _cache_folder() -> Path:
    home = os.environ.get('XDG_CACHE_HOME') or Path('~').expanduser() / '.cache'
    return Path(home) / 'hnn_vi_ros' / 'calibration'


def _search(problem: Problem, method: str, budget: Budget, base: float, judge: Judge,
            bound: float) -> tuple[Choice | None, Choice]:
    """Return the largest step that holds the budget, if any does, and that of the least error."""
    order, target = INTEGRATORS[method]().order, budget.error / SAFETY
    tried: dict[int, Choice] = {}
    parts = parts_for(base / (0.25 * order ** 0.5 * time_scale(problem)))
    while len(tried) < _TRIALS and parts not in tried:
        tried[parts] = _try(problem, method, base / parts, judge)
        now = tried[parts]
        good = [k for k, choice in tried.items() if choice.error <= target]
        bad = [k for k, choice in tried.items() if not choice.error <= target]
        # By its order, where that tells; a step that failed says nothing about its error.
        factor = 0.4 if not np.isfinite(now.error) else (
            (target / max(now.error, 1e-300)) ** (1.0 / order))
        wish = parts / min(max(0.9 * factor, 0.1), 6.0)
        if good and bad:
            wish = min(max(wish, max(bad) + 0.5), min(good) - 0.5)
        if now.error <= target and now.seconds_per_simulated_second > _HOPELESS * bound * max(
                factor, 1.0):
            break
        parts = parts_for(wish)
    good = [choice for choice in tried.values() if choice.error <= target]
    least = min(tried.values(), key=lambda choice: choice.error)
    if not good:
        return None, least
    return min(good, key=lambda choice: choice.seconds_per_simulated_second), least


def _try(problem: Problem, method: str, h: float, judge: Judge) -> Choice:
    try:
        trial = judge(problem.simulation(method, h), _TRIAL)
    except StepFailure:
        trial = UNAFFORDABLE
    return Choice(method, h, trial.error, trial.checked, trial.cost)
