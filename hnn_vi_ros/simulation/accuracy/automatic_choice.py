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
from typing import Any, NamedTuple

from hnn_vi_ros.errors import CalibrationError
from hnn_vi_ros.files import cache_folder
from hnn_vi_ros.scene import AutoChoice, Scene
from hnn_vi_ros.simulation.accuracy.cost import (
    Cost, CostStudy, fastest, ladder, measure, refusal, TOO_MUCH, try_between)
from hnn_vi_ros.simulation.accuracy.path_reference import find_reference, Instants, PathReference
from hnn_vi_ros.simulation.accuracy.trials import (
    InitialValueProblem, Method, parts_between, PathSurvey, survey, Tolerance)
from hnn_vi_ros.version import __version__
import numba
import numpy as np
from pydantic import ValidationError

# In the order in which they are tried. Every one keeps its energy for ever, so that what a run
# of many gradients shows holds for a longer one. All Gauss methods share one compiled kernel.
CANDIDATES = (*(f'gauss{order}' for order in range(16, 2, -2)), 'stormer_verlet',
              'generalized_leapfrog', 'variational_euler', 'time_transformed')
# The last one is tried first where the strongest force is so many times the median one; with
# each of these bases, and forces from which on steps are shortened, in units of the median.
_CLOSE, _BASES, _FORCES = 6.0, ('gauss8', 'gauss6', 'gauss4'), (1.0, 0.25)
# Where one method has reached round-off without holding the tolerance, others are tried up to so
# many times its cost.
_BEYOND_FLOOR = 10.0
# Share of a run in which the time that is reported is measured.
_TIMED = 0.01
# Format of remembered choices; another number discards them all.
_FORMAT = 4
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
    study = held_costs(problem, tolerance, largest_step or 0.1 * tolerance.horizon)
    best = study.recommended(tolerance.error)
    if best is None:
        raise CalibrationError(_refusal(study, tolerance))
    simulation = problem.simulation(best.method, best.step_size)
    simulation.advance(1)
    steps = math.ceil(_TIMED * best.checked / best.step_size)
    return Choice(best.method.kind, best.step_size, study.error(best), best.checked,
                  fastest(problem, simulation, steps) / (steps * best.step_size), best.work,
                  dict(best.method.arguments), study.known.energy_scale,
                  largest_step if best.step_size == largest_step else None)


def held_costs(problem: InitialValueProblem, tolerance: Tolerance, base: float) -> CostStudy:
    """
    Measure the candidates, each with ever shorter steps until they hold a tolerance.

    Parameters
    ----------
    problem, tolerance
        See ``calibrate``.
    base : float
        A time that steps divide [s].

    """
    known, by_path = survey(problem, tolerance.horizon, base), tolerance.kind == 'path_error'
    reference = find_reference(problem, tolerance, base, known) if by_path else PathReference(
        Instants.of(tolerance.horizon, base), np.empty((0, 0)), math.inf, '')
    study = CostStudy(problem, known, reference, '' if by_path else 'energies are wanted',
                      tolerance=tolerance)
    bound = math.inf

    def enough(costs: list[Cost]) -> bool:
        # Of one that is lost the cost is not known; and where steps are so long that their
        # equations are hard to solve, shorter ones cost less.
        last = [cost for cost in costs[-2:] if cost.failure in ('', TOO_MUCH)]
        return len(last) == 2 and last[0].work <= last[1].work and (
            last[0].failure != '' or last[0].work >= bound
            or study.holds(last[1], tolerance.error))

    for method in _candidates(known):
        if not refusal(study, method):
            costs = ladder(study, method, bound, enough)
            # Where the longest of these steps is not too long, longer ones are tried as well.
            while (costs[0].failure == TOO_MUCH or study.holds(costs[0], tolerance.error)) and (
                    longer := parts_between(0, round(base / costs[0].step_size))):
                costs.insert(0, measure(study, method, longer[-1], bound))
            study.costs += costs
            best = study.recommended(tolerance.error)
            if best is not None:
                bound = best.work
            elif method in study.at_floor:
                # No method has errors far below the round-off of another.
                bound = min([bound, *(_BEYOND_FLOOR * cost.work for cost in costs
                                      if not cost.failure)])
    if by_path:
        _measure_series(study, tolerance.error, bound)
    try_between(study, tolerance.error)
    return study


def _candidates(known: PathSurvey) -> Iterator[Method]:
    if known.strongest >= _CLOSE * known.force > 0.0:
        for base in _BASES:
            for share in _FORCES:
                yield Method('time_transformed',
                             {'base': base, 'force': float(f'{share * known.force:.3g}')})
    yield from map(Method, CANDIDATES[:-1])


def _measure_series(study: CostStudy, error: float, bound: float) -> None:
    """Add Taylor series, the loosest first, until one holds a path error or costs too much."""
    for share in np.clip(_SERIES * error, 1e-16, 1e-3):
        method = Method('taylor', {'tolerance': float(f'{share:.3g}')})
        if refusal(study, method):
            return
        study.costs.append(measure(study, method, 1, bound))
        if study.holds(study.costs[-1], error) or study.costs[-1].work >= bound:
            return


def _refusal(study: CostStudy, tolerance: Tolerance) -> str:
    """Say that no method holds the tolerance, which comes nearest, and what keeps it from more."""
    wanted = f'no method holds {tolerance.kind} {tolerance.error:g} up to {tolerance.horizon:g} s'
    nearest = min(study.costs, key=study.error, default=None)
    if nearest is None or nearest.failure:
        return (f'{wanted}: every step that is short enough costs more gradients than are '
                'affordable; allow a larger error or a shorter horizon')
    reason = ('smaller steps do not help, for round-off' if nearest.method in study.at_floor else
              'smaller steps cost more gradients than are affordable')
    return (f'{wanted}; the nearest is {nearest.method} with h = {nearest.step_size:g} s, which '
            f'errs by {study.error(nearest):.2g}: {reason}; allow a larger error or a shorter '
            'horizon')


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
