# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The integrator auto: the cheapest method and largest step size that hold a tolerance."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from importlib.util import find_spec
import json
import math
import os
from pathlib import Path
import platform
import time
from typing import Any, NamedTuple

from hnn_vi_ros.accuracy.path_reference import find_reference, PathJudge
from hnn_vi_ros.accuracy.trials import (
    EnergyJudge, FAILED, InitialValueProblem, Judge, Method, parts_between, parts_for, PathSurvey,
    survey, Tolerance, Trial)
from hnn_vi_ros.errors import CalibrationError, StepFailure, UnsupportedSystem
from hnn_vi_ros.files.resources import cache_folder
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.scene.choices import AutoChoice
from hnn_vi_ros.version import __version__
import numba
import numpy as np
from pydantic import ValidationError

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
_FORMAT = 3
# What the integrator taylor is given, as shares of a path error.
_SERIES = 10.0 ** -np.arange(0.0, 8.0)


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
    work_per_simulated_second : float
        Basis of the choice: gradients, and the rest of the steps in gradients [1/s].
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
    work_per_simulated_second: float
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
                f'the work of {self.work_per_simulated_second:.3g} gradients and '
                f'{1e6 * self.seconds_per_simulated_second:.3g} us per simulated second{limit}')


def calibrate(problem: InitialValueProblem, tolerance: Tolerance, largest_step: float | None = None
              ) -> Choice:
    """
    Try methods and step sizes, and return the cheapest that holds a tolerance.

    Cost is counted, in gradients and steps, and so is how long trials run: the same problem gives
    the same choice, however busy the machine is.

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
            bound = min([bound, *(_BEYOND_FLOOR * trial.cost
                                  for trial in found.tried.values() if trial.complete)])
        if parts is not None and found.tried[parts].cost < bound:
            best, bound = (found, parts), found.tried[parts].cost
    if tolerance.kind == 'path_error':
        for found in _series(problem, base, judge, bound):
            best = (found, 1)
    if best is None:
        raise CalibrationError(_refusal(tolerance, base, searches))
    found, parts = best
    trial, h = found.tried[parts], base / parts
    return Choice(found.method.kind, h, trial.error, trial.checked,
                  _seconds(problem, found.method, h, trial), trial.cost,
                  dict(found.method.arguments), known.energy_scale,
                  largest_step if parts == 1 else None)


def _candidates(known: PathSurvey) -> Iterator[Method]:
    if known.strongest >= _CLOSE * known.force > 0.0:
        for base in _BASES:
            for share in _FORCES:
                yield Method('time_transformed',
                             {'base': base, 'force': float(f'{share * known.force:.3g}')})
    yield from map(Method, CANDIDATES[:-1])


def _series(problem: InitialValueProblem, base: float, judge: Judge, bound: float
            ) -> Iterator[StepSearch]:
    """Yield the loosest Taylor series that hold a path error, if they cost less than a bound."""
    for error in np.clip(_SERIES * judge.tolerance.error, 1e-16, 1e-3):
        found = StepSearch(Method('taylor', {'tolerance': float(f'{error:.3g}')}), 1, base, {})
        try:
            found.tried[1] = _try(problem, found.method, base, judge, bound)
        except UnsupportedSystem:
            return
        if found.dear(1, judge, bound):
            return
        if found.holds(found.tried[1], judge):
            yield found
            return


def _first_step(method: Method, known: PathSurvey) -> float:
    """Return the step that is tried first [s]: far from right, it only costs trials."""
    step = _FIRST * method.create().order ** 0.5 * known.step_size
    if method.kind == 'time_transformed':
        # Its steps are shortened where it takes them, by the force to the power of 3/4.
        step *= (known.strongest / method.arguments['force']) ** 0.75
    return step


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
                      numba.__version__, platform.node(), os.cpu_count(),
                      find_spec('heyoka') is not None])
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


class Chosen(NamedTuple):
    """Question put to the integrator auto, its energy scale known now, and the choice it made."""

    tolerance: Tolerance
    choice: Choice


def tolerance_of(choice: AutoChoice) -> Tolerance:
    """Return what the integrator auto is asked for."""
    if choice.energy_error is not None:
        return Tolerance('energy_error', choice.energy_error, choice.horizon)
    assert choice.path_error is not None, 'its schema asks for one of them'
    return Tolerance('path_error', choice.path_error, choice.horizon)


def problem_of(scene: Scene) -> InitialValueProblem:
    """Return what a scene describes, whatever its method, or raise HnnViRosError."""
    state = scene.initial_state
    return InitialValueProblem(scene.create_hamiltonian(), tuple(scene.create_effects()),
                               np.array(state.q), np.array(state.p))


def resolve(scene: Scene, largest_step: float | None = None) -> tuple[Scene, Chosen | None]:
    """
    Return a scene with a method and a step size in place of the integrator auto, if it has that.

    Parameters
    ----------
    scene : Scene
        With the integrator auto or any other.
    largest_step : float, optional
        A time that the step must divide where the scene names none, such as that between two
        samples [s].

    Returns
    -------
    scene : Scene
        The same if it names its method.
    chosen : Chosen or None
        The choice, if the scene asks for one.

    Raises
    ------
    HnnViRosError
        No method holds the tolerance, or the scene cannot be built.

    """
    if not isinstance(scene.integrator, AutoChoice):
        return scene, None
    problem = problem_of(scene)
    tolerance = tolerance_of(scene.integrator)
    with scene.placed('integrator'):
        base = scene.step_size or largest_step
        if _names_code(scene):
            # The code, and its imports, may change from one time to the next.
            choice = calibrate(problem, tolerance, base)
        else:
            name = json.dumps([scene.model_dump_json(), scene.model_digests])
            choice = remembered(problem, tolerance, base, name)
    resolved = scene.changed({'step_size': choice.step_size,
                              'integrator': {'kind': choice.method, **choice.arguments}})
    return resolved, Chosen(replace(tolerance, energy_scale=choice.energy_scale), choice)


def _names_code(scene: Scene) -> bool:
    """Return whether the motion depends on Python code of the user's."""
    try:
        # As of a bag, for which none is run.
        Scene.model_validate(scene.model_dump(exclude={'invariants'}))
    except ValidationError:
        return True
    return False
