# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Choose the cheapest method and step size that hold a tolerance, by trying them."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from hashlib import sha256
import json
import math
import os
from pathlib import Path
import platform
import time
from typing import Any

from hnn_vi_ros.accuracy.path_reference import find_reference, PathJudge
from hnn_vi_ros.accuracy.step_search import search, StepSearch
from hnn_vi_ros.accuracy.survey import PathSurvey, survey
from hnn_vi_ros.accuracy.trials import (
    EnergyJudge, InitialValueProblem, Judge, Method, Tolerance, Trial)
from hnn_vi_ros.errors import CalibrationError, UnsupportedSystem
from hnn_vi_ros.files.user_folders import cache_folder
from hnn_vi_ros.version import __version__
import numba
import numpy as np

# In the order in which they are tried. Every one keeps its energy for ever, so that what a run
# of many gradients shows holds for a longer one. All Gauss methods share one compiled kernel.
CANDIDATES = (*(f'gauss{order}' for order in range(16, 2, -2)), 'stormer_verlet',
              'generalized_leapfrog', 'variational_euler', 'time_transformed')
# The last one is tried first where the strongest force is so many times the median one; with
# each of these bases, and forces from which on steps are shortened, in units of the median.
_CLOSE, _BASES, _FORCES = 6.0, ('gauss8', 'gauss6', 'gauss4'), (1.0, 0.25)
# First steps: this share of what resolves the path, times the root of the order.
_FIRST = 0.25
# Where one method has reached round-off without holding the tolerance, others are tried up to so
# many times its cost.
_BEYOND_FLOOR = 10.0
# Wall time in which the cost that is reported is measured [s], and in how many pieces.
_TIMED, _PIECES = 0.05, 9
# Format of remembered choices; another number discards them all.
_FORMAT = 2


@dataclass(frozen=True)
class Choice:
    """
    Result of a calibration.

    Parameters
    ----------
    method : str
        A name of INTEGRATORS.
    step_size : float
        h [s].
    error : float
        The largest error seen, in the tolerance's measure, at the horizon.
    checked : float
        The simulated time over which it was seen [s]; less than the horizon where that is long.
    seconds_per_simulated_second : float
        Cost of a simulated second on this machine [s/s]; for the report, not for the choice.
    gradients_per_simulated_second : float
        Basis of the choice [1/s].
    arguments : mapping
        Of the method.
    energy_scale : float
        To which energy errors are relative [J].
    largest_step : float or None
        The time that the step had to divide and is as long as [s]; None for a shorter step.

    """

    method: str
    step_size: float
    error: float
    checked: float
    seconds_per_simulated_second: float
    gradients_per_simulated_second: float
    arguments: Mapping[str, Any]
    energy_scale: float
    largest_step: float | None = None

    def explain(self, tolerance: Tolerance) -> str:
        """Say what was chosen and why, on one line."""
        extent = '' if self.checked >= 0.999 * tolerance.horizon else (
            f', seen over {self.checked:.3g} s and carried on to {tolerance.horizon:g} s')
        relative = f' of {self.energy_scale:.3g} J' if tolerance.kind == 'energy_error' else ''
        limit = '' if self.largest_step is None else (
            f'; h is no longer than the {self.largest_step:g} s between two samples: a lower '
            'publish rate may allow a cheaper choice')
        return (f'chose {Method(self.method, self.arguments)} with h = {self.step_size:g} s for '
                f'{tolerance.kind} {tolerance.error:g}{relative} up to {tolerance.horizon:g} s: '
                f'the cheapest that holds it, with {self.error:.2g}{extent}, at '
                f'{self.gradients_per_simulated_second:.3g} gradients and '
                f'{1e6 * self.seconds_per_simulated_second:.3g} us per simulated second{limit}')


def calibrate(problem: InitialValueProblem, tolerance: Tolerance, largest_step: float | None = None
              ) -> Choice:
    """
    Try methods and step sizes, and return the cheapest that holds a tolerance.

    Cost is counted in gradients, and so is how long trials run: the same problem gives the same
    choice, however busy the machine is.

    Parameters
    ----------
    problem : InitialValueProblem
        The problem to simulate.
    tolerance : Tolerance
        What must be held.
    largest_step : float, optional
        Steps must divide this time [s], such as that between two samples; without it a tenth of
        the horizon.

    Returns
    -------
    Choice
        The cheapest, its cost in time measured on this machine.

    Raises
    ------
    CalibrationError
        No method holds the tolerance; it names the nearest miss. Or the path cannot be known up
        to the horizon, since it is chaotic or round-off is larger than the error.
    UnsupportedSystem
        No candidate takes the effects.

    """
    base = largest_step or 0.1 * tolerance.horizon
    known = survey(problem, tolerance.horizon, base)
    if tolerance.kind == 'path_error':
        reference = find_reference(problem, tolerance, base, known)
        judge: Judge = PathJudge(problem, tolerance, reference)
    else:
        judge = EnergyJudge(problem, tolerance, known.energy_scale, known.extent)
    searches, best = [], None
    bound = math.inf
    for method in _candidates(known):
        try:
            problem.simulation(method, base)
        except UnsupportedSystem:
            continue
        found = search(problem, method, base, judge, _first_step(method, known), bound)
        searches.append(found)
        parts = found.best(judge)
        if best is None and found.at_floor():
            # No method has errors far below the round-off of another.
            bound = min(bound, _BEYOND_FLOOR * found.least_cost)
        if parts is not None and found.tried[parts].cost < bound:
            best, bound = (found, parts), found.tried[parts].cost
    if best is None:
        raise CalibrationError(_refusal(tolerance, base, searches))
    return _choice(problem, *best, known, largest_step)


def _candidates(known: PathSurvey) -> Iterator[Method]:
    if known.strongest >= _CLOSE * known.force > 0.0:
        for base in _BASES:
            for share in _FORCES:
                yield Method('time_transformed',
                             {'base': base, 'force': float(f'{share * known.force:.3g}')})
    yield from map(Method, CANDIDATES[:-1])


def _first_step(method: Method, known: PathSurvey) -> float:
    """Return the step that is tried first [s]: far from right, it only costs trials."""
    step = _FIRST * method.create().order ** 0.5 * known.step_size
    if method.kind == 'time_transformed':
        # Its steps are shortened where it takes them, by the force to the power of 3/4.
        step *= (known.strongest / method.arguments['force']) ** 0.75
    return step


def _choice(problem: InitialValueProblem, found: StepSearch, parts: int, known: PathSurvey,
            largest_step: float | None) -> Choice:
    trial, h = found.tried[parts], found.base / parts
    return Choice(found.method.kind, h, trial.error, trial.checked,
                  _seconds(problem, found.method, h, trial), trial.cost,
                  dict(found.method.arguments), known.energy_scale,
                  largest_step if parts == 1 else None)


def _seconds(problem: InitialValueProblem, method: Method, h: float, trial: Trial) -> float:
    """Return the wall time of a simulated second [s/s]: the median, others use the machine."""
    simulation = problem.simulation(method, h)
    simulation.advance(1)
    start = time.perf_counter()
    costs: list[float] = []
    steps = max(1, math.ceil(trial.checked / h / 100.0))
    while len(costs) < _PIECES and (not costs or time.perf_counter() - start < _TIMED):
        if simulation.time >= trial.checked:
            simulation.restart(problem.q, problem.p)
        begin = time.perf_counter()
        simulation.advance(steps)
        costs.append((time.perf_counter() - begin) / (steps * h))
    return float(np.median(costs))


def _refusal(tolerance: Tolerance, base: float, searches: list[StepSearch]) -> str:
    """Say that no method holds the tolerance, which comes nearest, and what keeps it from more."""
    wanted = f'no method holds {tolerance.kind} {tolerance.error:g} up to {tolerance.horizon:g} s'
    tried = [(trial.error, found, parts) for found in searches
             for parts, trial in found.tried.items() if trial.complete]
    if not tried:
        return (f'{wanted}: every step that is short enough costs more gradients than are '
                'affordable; allow a larger error or a shorter horizon')
    error, found, parts = min(tried, key=lambda item: item[0])
    reason = ('smaller steps do not help, for round-off' if found.at_floor() else
              'smaller steps cost more gradients than are affordable')
    return (f'{wanted}; the nearest is {found.method} with h = {found.base / parts:g} s, which '
            f'errs by {error:.2g}: {reason}; allow a larger error or a shorter horizon')


def remembered(problem: InitialValueProblem, tolerance: Tolerance, largest_step: float | None,
               name: str) -> Choice:
    """
    Return what ``calibrate`` chooses, from the last time that it did so on this machine.

    Parameters
    ----------
    problem, tolerance, largest_step
        See calibrate.
    name : str
        Distinguishes the problem from others, in addition to the model behind H.

    """
    key = json.dumps([_FORMAT, name, problem.hamiltonian.provenance, largest_step, __version__,
                      numba.__version__, platform.node(), os.cpu_count()])
    file = _cache_folder() / f'{sha256(key.encode()).hexdigest()[:32]}.json'
    try:
        return Choice(**json.loads(file.read_text()))
    except (OSError, ValueError, TypeError):
        # Missing or not readable: choose again.
        choice = calibrate(problem, tolerance, largest_step)
    with suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        part = file.with_suffix(f'.{os.getpid()}')
        part.write_text(json.dumps(asdict(choice)))
        part.replace(file)
    return choice


def _cache_folder() -> Path:
    return cache_folder() / 'hnn_vi_ros' / 'calibration'
