# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""`integrator: auto`: the cheapest method and largest step size that meet a tolerance."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from importlib.util import find_spec
import json
import math
import os
import platform
from typing import Any, NamedTuple

from hnn_vi_ros.errors import CalibrationError
from hnn_vi_ros.files import own_cache, parse_json, read_limited, write_text
from hnn_vi_ros.phase_space import energy_unit
from hnn_vi_ros.scene import AutoChoice, Scene
from hnn_vi_ros.simulation.accuracy.cost import (
    coarser, CostStudy, fastest, ladder, measure, MethodCost, refusal, TOO_EXPENSIVE, try_between)
from hnn_vi_ros.simulation.accuracy.path_reference import find_reference, Instants, PathReference
from hnn_vi_ros.simulation.accuracy.trials import (
    CalibrationTask, InitialValueProblem, Method, PathSurvey, survey, Tolerance)
from hnn_vi_ros.version import __version__
import numba
import numpy as np
from pydantic import ValidationError

# Candidates in the order in which they are tried. All have a bounded energy error, so results
# of a limited run extrapolate to a longer one. All Gauss methods share one compiled kernel. The
# last but one conserves the energy of coordinates that are not canonical.
CANDIDATES = (*(f'gauss{order}' for order in range(16, 2, -2)), 'stormer_verlet',
              'generalized_leapfrog', 'variational_euler', 'lie_stormer_verlet', 'lie_leapfrog',
              *(f'lie_gauss{order}' for order in range(16, 2, -2)), 'variational_midpoint',
              'time_transformed')
# Candidates for path errors, whose energy drifts.
PATH_CANDIDATES = 'dop853', 'taylor', 'rk4'
# time_transformed is tried first if the ratio of strongest to median force is at least this, with
# each of these bases and thresholds of its argument `force`, in units of the median force.
_MIN_FORCE_RATIO, _BASES, _FORCES = 6.0, ('gauss8', 'gauss6', 'gauss4'), (1.0, 0.25)
# Once a method has reached its round-off floor above the tolerance, others are tried up to this
# multiple of its cost.
_MAX_COST_BEYOND_FLOOR = 10.0
# Errors, relative to the largest coordinate, that round-off may explain.
_ROUNDING = 1e-9
# Share of a run used to measure the reported computing time, and its minimum number of steps.
_TIMED_SHARE, _MIN_TIMED_STEPS = 0.01, 10
# Format version of cached choices; changing it invalidates the cache.
_FORMAT = 7


@dataclass(frozen=True)
class Choice:
    """
    Result of a calibration.

    Parameters
    ----------
    method : str
        A key of INTEGRATORS.
    step_size : float
        Step size h [s].
    error : float
        Maximum error, of the kind of the tolerance, extrapolated to the horizon.
    checked : float
        Simulated time over which the error was measured [s]; less than a long horizon.
    seconds_per_simulated_second : float
        Computing time per simulated second on this machine [s/s]; reported, not used to choose.
    work_per_simulated_second : float
        Criterion of the choice: gradients plus step overhead in units of gradients [1/s].
    arguments : mapping
        Arguments of the method.
    energy_scale : float
        Energy that energy errors are relative to.
    largest_step : float or None
        Upper limit of the step size [s] if the step size equals it; None for a shorter step.
    energy_unit : str
        Unit of the energy scale.

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
    energy_unit: str = 'J'

    def explain(self, tolerance: Tolerance) -> str:
        """Return the choice and its reason on one line."""
        extent = '' if self.checked >= 0.999 * tolerance.horizon else (
            f', measured over {self.checked:.3g} s and extrapolated to {tolerance.horizon:g} s')
        relative = (f' of {self.energy_scale:.3g} {self.energy_unit}'
                    if tolerance.kind == 'energy_error' else '')
        limit = '' if self.largest_step is None else (
            f'; h is at most the sampling interval of {self.largest_step:g} s: a lower publish '
            'rate may allow a cheaper choice')
        return (f'chose {Method(self.method, self.arguments)} with h = {self.step_size:g} s for '
                f'{tolerance.kind} {tolerance.error:g}{relative} up to {tolerance.horizon:g} s: '
                f'the cheapest within the tolerance, with error {self.error:.2g}{extent}, '
                f'{self.work_per_simulated_second:.3g} gradients and '
                f'{1e6 * self.seconds_per_simulated_second:.3g} us per simulated second{limit}')


def calibrate(task: CalibrationTask) -> Choice:
    """
    Try methods and step sizes, and return the cheapest that meets a tolerance.

    Costs and the length of trials are counted in gradients and steps, not in time, so the choice
    is reproducible whatever the load of the machine.

    Parameters
    ----------
    task : CalibrationTask
        The problem, the tolerance to meet, and the time that the step size must divide.

    Returns
    -------
    Choice
        The cheapest choice, with its computing time measured on this machine.

    Raises
    ------
    CalibrationError
        No method meets the tolerance (the message names the nearest miss), or the path cannot be
        determined up to the horizon, because of chaos or round-off larger than the error.
    UnsupportedSystem
        No candidate supports the effects.

    """
    problem, study = task.problem, held_costs(task)
    best = study.recommended(task.tolerance.error)
    if best is None:
        raise CalibrationError(_refusal(study, task.tolerance))
    simulation = problem.simulation(best.method, best.step_size)
    simulation.advance(1)
    steps = max(_MIN_TIMED_STEPS, math.ceil(_TIMED_SHARE * best.checked / best.step_size))
    return Choice(best.method.kind, best.step_size, study.error(best), best.checked,
                  fastest(problem, simulation, steps) / (steps * best.step_size), best.work,
                  dict(best.method.arguments), study.known.energy_scale,
                  task.largest_step if best.step_size == task.largest_step else None,
                  energy_unit(problem.hamiltonian.coordinates))


def held_costs(task: CalibrationTask) -> CostStudy:
    """Measure the candidates, each with finer settings until it meets the tolerance."""
    problem, tolerance, base = task.problem, task.tolerance, task.base
    known, by_path = survey(problem, tolerance.horizon, base), tolerance.kind == 'path_error'
    reference = find_reference(task, known) if by_path else PathReference(
        Instants.of(tolerance.horizon, base), np.empty((0, 0)), math.inf, '')
    study = CostStudy(problem, known, reference, '' if by_path else 'the tolerance is on energies',
                      tolerance=tolerance)
    bound = math.inf

    def enough(costs: list[MethodCost]) -> bool:
        # The cost of a diverged run is unknown; and shorter steps can cost less than steps so
        # long that their equations are hard to solve.
        last = [cost for cost in costs[-2:] if cost.failure in ('', TOO_EXPENSIVE)]
        return len(last) == 2 and last[0].work <= last[1].work and (
            last[0].failure != '' or last[0].work >= bound
            or study.holds(last[1], tolerance.error))

    for method in _candidates(known, by_path):
        if not refusal(study, method):
            costs = ladder(study, method, bound, enough)
            # Longer steps are tried as well if the longest of the ladder is not too long.
            while (costs[0].failure == TOO_EXPENSIVE
                   or study.holds(costs[0], tolerance.error)) and (
                    longer := coarser(study, costs[0])) is not None:
                costs.insert(0, measure(study, *longer, bound))
            study.costs += costs
            best = study.recommended(tolerance.error)
            if best is not None:
                bound = best.work
            elif method in study.at_floor:
                # The round-off floors of different methods are similar.
                bound = min([bound, *(_MAX_COST_BEYOND_FLOOR * cost.work for cost in costs
                                      if not cost.failure)])
    try_between(study, tolerance.error)
    return study


def _candidates(known: PathSurvey, by_path: bool) -> Iterator[Method]:
    if known.strongest >= _MIN_FORCE_RATIO * known.force > 0.0:
        for base in _BASES:
            for share in _FORCES:
                yield Method('time_transformed',
                             {'base': base, 'force': float(f'{share * known.force:.3g}')})
    yield from map(Method, CANDIDATES[:-1])
    yield from map(Method, PATH_CANDIDATES if by_path else ())


def _refusal(study: CostStudy, tolerance: Tolerance) -> str:
    """Return a message: no method meets the tolerance, the nearest miss and its limitation."""
    wanted = f'no method meets {tolerance.kind} {tolerance.error:g} up to {tolerance.horizon:g} s'
    nearest = min(study.costs, key=study.error, default=None)
    if nearest is None or nearest.failure:
        return (f'{wanted}: every small enough step_size exceeds the limit of gradients; '
                'allow a larger error or a shorter horizon')
    reason = 'smaller steps exceed the limit of gradients'
    if nearest.method in study.at_floor:
        rounding = _ROUNDING * np.abs(study.reference.states).max(initial=1.0)
        reason = 'smaller steps do not help because of round-off' if study.error(
            nearest) <= rounding else (
                'smaller steps hardly help, as where a force has limits or kinks')
    return (f'{wanted}; the best is {nearest.method} with h = {nearest.step_size:g} s and error '
            f'{study.error(nearest):.2g}: {reason}; allow a larger error or a shorter horizon')


def remembered(task: CalibrationTask, name: str) -> Choice:
    """
    Return the result of `calibrate`, cached on this machine.

    Parameters
    ----------
    task : CalibrationTask
        See calibrate.
    name : str
        Key of the problem in the cache, in addition to the provenance of H.

    """
    key = json.dumps([_FORMAT, name, task.problem.hamiltonian.provenance, task.largest_step,
                      __version__, numba.__version__, platform.node(), os.cpu_count(),
                      find_spec('heyoka') is not None])
    name = f'{sha256(key.encode()).hexdigest()[:32]}.json'
    try:
        return Choice(**parse_json(read_limited(own_cache('calibration') / name, 1 << 16)))
    except (OSError, ValueError, TypeError):
        # Missing or unreadable: calibrate again.
        choice = calibrate(task)
    with suppress(OSError):
        write_text(own_cache('calibration') / name, json.dumps(asdict(choice)))
    return choice


class Chosen(NamedTuple):
    """Tolerance requested of `integrator: auto`, with its energy scale, and the choice made."""

    tolerance: Tolerance
    choice: Choice


def tolerance_of(choice: AutoChoice) -> Tolerance:
    """Return the tolerance requested of `integrator: auto`."""
    if choice.energy_error is not None:
        return Tolerance('energy_error', choice.energy_error, choice.horizon)
    assert choice.path_error is not None, 'the schema requires one of them'
    return Tolerance('path_error', choice.path_error, choice.horizon)


def problem_of(scene: Scene) -> InitialValueProblem:
    """Return the initial value problem of a scene, without its method, or raise HnnViRosError."""
    state = scene.initial_state
    return InitialValueProblem(scene.create_hamiltonian(), tuple(scene.create_effects()),
                               np.array(state.q), np.array(state.p))


def choose(scene: Scene, largest_step: float | None = None) -> tuple[Scene, Chosen | None]:
    """
    Return a scene with `integrator: auto`, if it has that, replaced by a method and a step size.

    Parameters
    ----------
    scene : Scene
        A scene with the integrator auto or any other.
    largest_step : float, optional
        Time that the step size must divide if the scene has no step_size, such as the sampling
        interval [s].

    Returns
    -------
    scene : Scene
        The resolved scene; unchanged if it has another integrator.
    chosen : Chosen or None
        The choice; None if the scene has another integrator.

    Raises
    ------
    HnnViRosError
        No method meets the tolerance, or the scene cannot be built.

    """
    if not isinstance(scene.integrator, AutoChoice):
        return scene, None
    tolerance = tolerance_of(scene.integrator)
    task = CalibrationTask(problem_of(scene), tolerance, scene.step_size or largest_step)
    with scene.placed('integrator'):
        if _names_code(scene):
            # The code and its imports may change between runs, so the choice is not cached.
            choice = calibrate(task)
        else:
            choice = remembered(task, json.dumps([scene.model_dump_json(), scene.model_digests]))
    resolved = scene.changed({'step_size': choice.step_size,
                              'integrator': {'kind': choice.method, **choice.arguments}})
    return resolved, Chosen(replace(tolerance, energy_scale=choice.energy_scale), choice)


def _names_code(scene: Scene) -> bool:
    """Return whether the motion depends on Python code of the user."""
    try:
        # Validated as a scene from a bag, which runs no code of the user.
        Scene.model_validate(scene.model_dump(exclude={'invariants'}))
    except ValidationError:
        return True
    return False
