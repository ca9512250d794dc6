# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Work-precision study: errors of methods and step sizes versus computing time."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
import math
import time
from typing import NamedTuple
import warnings

from hnn_vi_ros.errors import StepFailure, UnsupportedSystem
from hnn_vi_ros.integrators import (
    Composition, GAUSS_METHODS, INTEGRATORS, LIE_GAUSS_METHODS, method_name)
from hnn_vi_ros.simulation.accuracy.path_reference import best_reference, PathReference, PATIENCE
from hnn_vi_ros.simulation.accuracy.trials import (
    BASE_SHARE, carried, InitialValueProblem, Method, parts_between, parts_for, PathSurvey,
    survey, Tolerance, work)
from hnn_vi_ros.simulation.dense_step import record_at
from hnn_vi_ros.simulation.simulation import Simulation
import numpy as np

# Order of measurement, in case the time does not suffice for all: the baselines, the scene's own
# method, then explicit methods and all Gauss methods, which are compiled once.
_YARDSTICKS = ('gauss8', 'lie_gauss8')
_NEXT = ('dop853', 'stormer_verlet', 'generalized_leapfrog', 'lie_stormer_verlet', 'lie_leapfrog',
         *GAUSS_METHODS, *LIE_GAUSS_METHODS, 'kahan_li8', 'rk4', 'variational_euler')
# Compositions use the first of these that the problem supports: explicit ones cost less.
_BASES = ('stormer_verlet', 'lie_stormer_verlet', 'generalized_leapfrog', 'lie_leapfrog',
          'implicit_midpoint')
# The method that shortens its steps where forces are strong: useful if the strongest force is at
# least _MIN_FORCE_RATIO times the median. It is measured last, since compiling it takes longest.
_CLOSE_ENCOUNTERS, _MIN_FORCE_RATIO = 'time_transformed', 6.0
# Approximate number of states at which energies are compared, and number of checks at which a
# run may end early; the same with a tolerance; number of checks if effects do work, since their
# sum is evaluated only at checks.
_SAMPLES, _CHECKS, _JUDGED_SAMPLES, _JUDGED_CHECKS, _WORK_CHECKS = 1000, 20, 20_000, 100, 2000
# Number of instants between steps at which the path of a method that meets a tolerance is checked.
_CHECKS_BETWEEN = 200
# Ratio of the first step size to the one that resolves the path: the larger of this and the
# order, since a run that diverges at once is cheap. Strides through the list of subdivisions,
# by upper bound of the order: smaller for higher orders, whose error falls faster.
_FIRST_STEP_RATIO, _STRIDES = 2.0, ((4, 3), (8, 2), (math.inf, 1))
# Ratio of successive tolerances of adaptive methods, ratios tried near an error, and exponent with
# which their cost falls as the tolerance grows.
_TOLERANCE_RATIO, _RATIOS_BETWEEN, _COST_EXPONENT = 0.1, 10.0 ** np.array([0.25, 0.5, 0.75]), 0.125
# A method this many times as expensive as another one at the same error is abandoned.
_MAX_COST_RATIO = 100.0
# Minimum number of step sizes measured per method, even beyond its share of the time.
_MIN_STEP_SIZES = 3
# A run counts as diverged beyond this share of the path's size or of the energy scale; with a
# tolerance, beyond this multiple of it.
_LOST_SHARE, _LOST_MULTIPLE = 0.1, 1e3
# Detection of the round-off floor: number of consecutive flat step sizes; slopes of log error
# over log step size, as shares of the order, that count as flat and as resolving the path;
# error below which the path is resolved in any case.
_MIN_FLAT_STEP_SIZES, _MAX_FLAT_SLOPE, _MIN_RESOLVED_SLOPE, _RESOLVED_ERROR = 2, 0.25, 0.5, 1e-7
# Minimum total time of timed repetitions [s], and their maximum number.
_MIN_TIMED_SECONDS, _MAX_REPEATS = 0.02, 7
# A run that takes so much longer per step than this part of it is timed again.
_COMPILED_RATIO, _PROBED = 2.0, 10
# Failure reason of a run that exceeds its limit of work.
TOO_EXPENSIVE = 'too expensive'
# No method is started in this last share of the time, since it may need compiling.
_LAST_START_SHARE = 0.05
# Safety factors of recommendations, since errors may be larger between instants of comparison:
# for errors measured up to the horizon, and for errors extrapolated to it.
_SAFETY, _EXTRAPOLATION_SAFETY = 0.95, 0.5


class RunErrors(NamedTuple):
    """
    Errors of a run.

    Parameters
    ----------
    path : float
        Largest deviation of a coordinate or momentum from the reference; NaN without a reference.
    energy : float
        Largest abs(H - H0 - W) [J].
    gradients : int
        Number of gradients and Hessian-vector products evaluated.

    """

    path: float
    energy: float
    gradients: int


@dataclass(frozen=True)
class MethodCost:
    """
    Cost of a method at one step size; unknown figures are NaN.

    Parameters
    ----------
    method : Method
        The method and its arguments.
    step_size : float
        Step size h [s].
    path_error : float
        Largest deviation from the reference, at least the accuracy of the reference.
    energy_error : float
        Largest abs(H - H0 - W), over the energy scale of the path [1].
    seconds : float
        Processor time per simulated second [s/s].
    gradients : float
        Gradients per simulated second [1/s].
    failure : str
        Reason why the run ended early; empty if it completed.
    work : float
        Gradients plus step overhead in units of gradients, per simulated second [1/s].
    checked : float
        Simulated time over which the error was measured; beyond it, it is extrapolated [s].

    """

    method: Method
    step_size: float
    path_error: float = math.nan
    energy_error: float = math.nan
    seconds: float = math.nan
    gradients: float = math.nan
    failure: str = ''
    work: float = math.inf
    checked: float = 0.0

    @property
    def coarseness(self) -> float:
        """Return the tolerance of an adaptive method, the step size [s] of others."""
        return self.method.tolerance or self.step_size


@dataclass
class CostStudy:
    """
    Costs of the methods that support a problem.

    Parameters
    ----------
    problem : InitialValueProblem
        The problem to simulate.
    known : PathSurvey
        Survey of the path.
    reference : PathReference
        Reference that paths are compared with, up to its own horizon.
    no_path : str
        Reason why energies are compared instead of paths; empty if paths are.
    costs : list of Cost
        Costs grouped by method, the longest steps first.
    left_out : dict of str to list of str
        Unsupported methods by reason.
    unreached : list of str
        Methods skipped for lack of time.
    tolerance : Tolerance or None
        Tolerance to meet: methods are then ranked by work, which is machine-independent. None:
        by time.
    at_floor : list of Method
        Methods at their round-off floor: shorter steps do not reduce their error.

    """

    problem: InitialValueProblem
    known: PathSurvey
    reference: PathReference
    no_path: str
    costs: list[MethodCost] = field(default_factory=list)
    left_out: dict[str, list[str]] = field(default_factory=dict)
    unreached: list[str] = field(default_factory=list)
    tolerance: Tolerance | None = None
    at_floor: list[Method] = field(default_factory=list)

    @property
    def floor(self) -> float:
        """Return the smallest error that can be measured."""
        return 0.0 if self.no_path else self.reference.accuracy

    @property
    def lost(self) -> float:
        """Return the error beyond which a run counts as diverged."""
        if self.tolerance is not None:
            return _LOST_MULTIPLE * self.tolerance.error
        return _LOST_SHARE * (1.0 if self.no_path else float(np.abs(self.reference.states).max()))

    def error(self, cost: MethodCost) -> float:
        """Return the path error, or the energy error if there is no reference path."""
        if cost.failure:
            return math.inf
        return cost.energy_error if self.no_path else cost.path_error

    def price(self, cost: MethodCost) -> float:
        """Return the quantity to minimise: the time, or the work if there is a tolerance."""
        return cost.seconds if self.tolerance is None else cost.work

    def cheapest(self, error: float, family: str | None = None) -> MethodCost | None:
        """Return the cheapest cost with at most this error, of all methods or of one family."""
        good = [cost for cost in self.costs
                if family in (None, cost.method.family) and self.error(cost) <= error]
        return min(good, key=self.price, default=None)

    def holds(self, cost: MethodCost, error: float) -> bool:
        """Return whether a cost meets an error, with a safety margin."""
        seen = self.tolerance is None or cost.checked >= self.tolerance.horizon * (1.0 - 1e-9)
        safety = _SAFETY if seen else _EXTRAPOLATION_SAFETY
        return self.error(cost) <= safety * error - self.floor

    def recommended(self, error: float, family: str | None = None) -> MethodCost | None:
        """Return the cheapest cost that meets an error with margin, of all methods or a family."""
        good = [cost for cost in self.costs
                if family in (None, cost.method.family) and self.holds(cost, error)]
        return min(good, key=self.price, default=None)


def measure_costs(problem: InitialValueProblem, horizon: float, seconds: float,
                  own: Method | None = None, base: float | None = None,
                  show: Callable[[float, str], None] = lambda share, what: None) -> CostStudy:
    """
    Run the methods that support a problem, with decreasing step sizes or tolerances.

    Parameters
    ----------
    problem : InitialValueProblem
        The problem to simulate.
    horizon : float
        Simulated time [s]; shorter if the path cannot be determined that far.
    seconds : float
        Approximate budget of processor time for measuring [s]; methods are started while compiling
        and measuring together take no longer.
    own : Method, optional
        Method of the scene, with its arguments; measured right after the baselines.
    base : float, optional
        Time that step sizes divide [s], such as a sampling interval; by default a tenth of the
        horizon. Adaptive methods take steps of this size.
    show : callable, optional
        Progress callback; takes the share done and a description of the current task.

    Raises
    ------
    CalibrationError
        No step is short enough to resolve the path.
    UnsupportedSystem
        No method supports the problem.

    """
    with warnings.catch_warnings():
        # Each simulation of an H in plain Python emits a warning.
        warnings.simplefilter('ignore')
        show(0.0, 'the reference')
        base = base or BASE_SHARE * horizon
        known = survey(problem, horizon, base)
        end = time.process_time() + seconds  # the survey has compiled the method of the reference
        reference = best_reference(problem, horizon, base, known, PATIENCE * problem.gradients)
        why = _why_no_path(problem, reference, known.method)
        study = CostStudy(problem, known, reference, why)
        methods, compiling = list(_fitting(study, own)), 0.0
        for k, method in enumerate(methods):
            left = end - time.process_time()
            if left < _LAST_START_SHARE * seconds and k > 0:
                study.unreached = [other.kind for other in methods[k:]]
                break
            show((1 + k) / (2 + len(methods)), str(method))
            begun = time.process_time()
            _warm_up(study, method)
            compiling += time.process_time() - begun
            # The first method gets results whatever the budget.
            last = end + compiling if k > 0 else math.inf
            _measure_for(study, method, (left + compiling) / (len(methods) - k), last)
    return study


def run_errors(simulation: Simulation, reference: PathReference, enough: float = math.inf
               ) -> RunErrors:
    """
    Run a simulation from its initial state to the end of a reference and return its errors.

    Parameters
    ----------
    simulation : Simulation
        Simulation whose step size divides the time between two instants, or their base.
    reference : PathReference
        Reference path; ignored for path errors if it is not verified.
    enough : float, optional
        Path error at which the run ends early.

    Raises
    ------
    StepFailure
        A step fails, or a state or an energy is not finite.

    """
    path = reference.states if reference.verified else None
    worst = np.array([math.nan if path is None else 0.0, 0.0])
    for errors in _errors_along(simulation, reference, path, _SAMPLES, _CHECKS):
        worst = np.maximum(worst, errors)
        if worst[0] > enough:
            break
    return RunErrors(float(worst[0]), float(worst[1]), simulation.gradients)


def _errors_along(simulation: Simulation, reference: PathReference, path: np.ndarray | None,
                  energies: int, looks: int) -> Iterator[tuple[float, float]]:
    """Yield the largest path error and energy error [J] of each interval between checks."""
    hamiltonian = simulation.hamiltonian
    instants = reference.instants
    every, apart = instants.met(round(instants.base / simulation.step_size))
    path = None if path is None else path[apart - 1::apart]
    rows = instants.count // apart if path is None else len(path)
    # Energies are also compared between instants, at multiples of the step size.
    parts = max(k for k in range(1, max(1, energies // rows) + 1) if every % k == 0)
    start = hamiltonian.energy(simulation.q, simulation.p)
    for done in range(0, rows, more := math.ceil(rows / looks)):
        q, p = simulation.record(min(more, rows - done) * parts, every // parts)
        energy = hamiltonian.energy(q, p) - start if simulation.conservative \
            else np.array([simulation.energy_balance])
        if not np.isfinite([*q[-1], *p[-1], *energy]).all():
            raise StepFailure('not finite', simulation.time, simulation.step_size, math.nan,
                              simulation.gradients)
        found = np.hstack([q, p])[parts - 1::parts]
        yield (math.nan if path is None else
               float(np.abs(found - path[done:done + more]).max())), float(np.abs(energy).max())


def _why_no_path(problem: InitialValueProblem, reference: PathReference, method: str) -> str:
    """Return the reason why paths cannot be compared with a reference; '' if they can."""
    for effect in problem.effects:
        if effect.random:
            return f'{type(effect).__name__} draws different random numbers at each step size'
    if reference.verified:
        return ''
    if not len(reference.states):
        return f'no two runs of {method} finished'
    return (f'two reference runs differ by at least {reference.accuracy:.2g}, as in chaotic '
            'motions; try a shorter --duration')


def _fitting(study: CostStudy, own: Method | None) -> Iterator[Method]:
    """Yield the supported methods, and record the reason for each unsupported one."""
    order = [*_YARDSTICKS, *([own.kind] if own else ()), *_NEXT, *INTEGRATORS]
    kinds = sorted(INTEGRATORS, key=lambda kind: (kind == _CLOSE_ENCOUNTERS, order.index(kind)))
    for kind in kinds:
        reasons = []
        for method in [own] if own and own.kind == kind else _variants(kind, study.known):
            reasons.append(refusal(study, method))
            if not reasons[-1]:
                yield method
                break
        else:
            reasons.append('is for close encounters, but this path has none')
            study.left_out.setdefault(reasons[0], []).append(kind)


def refusal(study: CostStudy, method: Method) -> str:
    """Return the reason why a method does not support a problem; '' if it does."""
    try:
        study.problem.simulation(method, study.reference.instants.base)
    except UnsupportedSystem as problem:
        # The reason follows the method's name; the list of alternatives is dropped.
        name = method_name(method.create())
        return str(problem).removeprefix(name).strip().partition(';')[0]
    except (TypeError, ValueError) as problem:
        return f'needs an argument of the scene: {problem}'.partition(';')[0]
    except StepFailure:
        return 'fails at the initial state'
    return ''


def _variants(kind: str, known: PathSurvey) -> list[Method]:
    """Return the variants of a method, by arguments; the first supported one is used."""
    if kind == _CLOSE_ENCOUNTERS:
        close = known.strongest >= _MIN_FORCE_RATIO * known.force > 0.0
        return [Method(kind, {'base': 'gauss8', 'force': float(f'{known.force:.3g}')})] * close
    if issubclass(INTEGRATORS[kind], Composition):
        return [Method(kind, {'base': base}) for base in _BASES]
    return [Method(kind)]


def ladder(study: CostStudy, method: Method, bound: float,
           enough: Callable[[list[MethodCost]], bool]) -> list[MethodCost]:
    """
    Return the costs at decreasing step sizes or tolerances, until round-off or a criterion.

    Parameters
    ----------
    study : CostStudy
        Results so far.
    method : Method
        Method to run.
    bound : float
        Work per simulated second at which a run is abandoned [1/s].
    enough : callable
        Stopping criterion; takes the costs so far.

    """
    costs, flat, resolved, last = list[MethodCost](), 0, False, None
    # The error of an adaptive method is proportional to its tolerance.
    order = 1 if method.useful_tolerances[1] else method.create().order
    for finer, parts in _settings(study, method):
        costs.append(measure(study, finer, parts, bound))
        coarseness, error = costs[-1].coarseness, study.error(costs[-1])
        if error <= study.lost:
            if last is not None:
                slope = math.log(max(last[1], 1e-300) / max(error, 1e-300)) / math.log(
                    last[0] / coarseness)
                flat = flat + 1 if slope < _MAX_FLAT_SLOPE * order else 0
                resolved = resolved or slope >= _MIN_RESOLVED_SLOPE * order
            last, resolved = (coarseness, error), resolved or error <= _RESOLVED_ERROR
        if resolved and flat >= _MIN_FLAT_STEP_SIZES:
            study.at_floor.append(method)
            break
        if enough(costs):
            break
    return costs


def _settings(study: CostStudy, method: Method) -> Iterator[tuple[Method, int]]:
    """Yield finer and finer settings of a method: itself, and its number of steps per base."""
    least, loosest = method.useful_tolerances
    if loosest:
        tolerance = min(loosest, study.tolerance.error if study.tolerance else loosest)
        while tolerance >= least:
            yield method.within(float(f'{tolerance:.3g}')), 1
            tolerance *= _TOLERANCE_RATIO
        return
    order, base = method.create().order, study.reference.instants.base
    stride = next(stride for below, stride in _STRIDES if order < below)
    longest = max(_FIRST_STEP_RATIO, order) * study.known.step_size
    if study.tolerance is not None:
        # Runs up to a long horizon are expensive: use fewer, around the usual step size.
        stride, longest = max(stride, 2), order ** 0.5 * study.known.step_size
    if method.kind == _CLOSE_ENCOUNTERS:
        longest *= (study.known.strongest / method.arguments.get('force', 1.0)) ** 0.75
    for parts in parts_between(parts_for(base / min(longest, base)) - 1,
                               PATIENCE * study.problem.gradients)[::stride]:
        yield method, parts


def coarser(study: CostStudy, cost: MethodCost) -> tuple[Method, int] | None:
    """Return the next coarser setting than that of a cost; None if there is none."""
    tolerance = cost.method.tolerance
    if tolerance is not None:
        longer = min(tolerance / _TOLERANCE_RATIO, cost.method.useful_tolerances[1])
        return (cost.method.within(float(f'{longer:.3g}')), 1) if longer > tolerance else None
    parts = parts_between(0, round(study.reference.instants.base / cost.step_size))
    return (cost.method, parts[-1]) if parts else None


def _measure_for(study: CostStudy, method: Method, seconds: float, last: float) -> None:
    """Add the costs of a method within its time [s]; the first few may use all the time left."""
    end = time.process_time() + seconds
    before = [time.process_time()]

    def enough(costs: list[MethodCost]) -> bool:
        good = [cost for cost in costs if study.error(cost) <= study.lost]
        if costs[-1] in good:
            error = study.error(costs[-1])
            other = study.cheapest(error)
            if error <= study.floor or (
                    other is not None and costs[-1].seconds > _MAX_COST_RATIO * other.seconds):
                return True
        before.append(time.process_time())
        # The next run takes about twice as long; the first few may use all the remaining time.
        longer = before[-1] - before[-2]
        return before[-1] + 2.0 * longer > (end if len(good) >= _MIN_STEP_SIZES else last)

    costs = ladder(study, method, math.inf, enough)
    lost = [k for k, cost in enumerate(costs) if study.error(cost) > study.lost]
    # Keep only the diverged run with the shortest step, which shows the stability limit.
    study.costs += [cost for k, cost in enumerate(costs) if k not in lost[:-1]]


def _warm_up(study: CostStudy, method: Method) -> None:
    """Compile a method and everything else that its first step needs."""
    with suppress(StepFailure), np.errstate(over='ignore', invalid='ignore'):
        simulation = study.problem.simulation(method, study.known.step_size)
        simulation.advance(1)
        simulation.energy_balance  # noqa: B018  compiles it


def measure(study: CostStudy, method: Method, parts: int, bound: float = math.inf) -> MethodCost:
    """
    Run a method with the base divided into `parts` steps, up to the horizon.

    Parameters
    ----------
    study : CostStudy
        Study with the reference and the survey.
    method : Method
        Method to run.
    parts : int
        Number of steps per base.
    bound : float, optional
        Work per simulated second at which the run is abandoned [1/s].

    """
    h = study.reference.instants.base / parts
    try:
        with np.errstate(over='ignore', invalid='ignore'):
            simulation = study.problem.simulation(method, h)
            # The first step may compile code, for example the Taylor series of a formula.
            simulation.advance(1)
            simulation.restart(study.problem.q, study.problem.p)
            if study.tolerance is None:
                return _timed(study, method, simulation)
            return _judged(study, study.tolerance, method, simulation, bound)
    except StepFailure as failure:
        return MethodCost(method, h, failure=f'{failure.reason} at t = {failure.t:.4g} s')


def _timed(study: CostStudy, method: Method, simulation: Simulation) -> MethodCost:
    """Return the errors and the computing time of a run."""
    start = time.process_time()
    errors = run_errors(simulation, study.reference, study.lost)
    first, extent, path = time.process_time() - start, simulation.time, errors.path
    lost = 'the path error is too large' if path > study.lost else ''
    seconds = first if lost else fastest(study.problem, simulation, simulation.steps, first)
    if method.tolerance and not lost and not study.no_path:
        # A step of the clock is long.
        path = max(path, error_between(study, simulation))
    return MethodCost(method, simulation.step_size, max(path, study.floor),
                      errors.energy / study.known.energy_scale, seconds / extent,
                      errors.gradients / extent, lost)


def fastest(problem: InitialValueProblem, simulation: Simulation, steps: int, *times: float
            ) -> float:
    """Return the minimum processor time of `steps` from the start [s], given earlier `times`."""
    def again(steps: int) -> float:
        simulation.restart(problem.q, problem.p)
        start = time.process_time()
        simulation.advance(steps)
        return time.process_time() - start

    found = [*times]
    if found and sum(found) >= _MIN_TIMED_SECONDS and min(found) > _COMPILED_RATIO * (
            _PROBED * again(max(1, steps // _PROBED))):
        # It compiled code as well, such as that for failed steps.
        found.clear()
    while not found or (sum(found) < _MIN_TIMED_SECONDS and len(found) < _MAX_REPEATS):
        found.append(again(steps))
    return min(found)


def _judged(study: CostStudy, tolerance: Tolerance, method: Method, simulation: Simulation,
            bound: float) -> MethodCost:
    """Return the error of a run, extrapolated to the horizon, and its work."""
    by_path, limit = not study.no_path, study.problem.gradients
    extent = study.reference.horizon if by_path else study.known.extent
    most = 4.0 * limit * (PATIENCE if by_path else 1)
    looks = _JUDGED_CHECKS if simulation.conservative or by_path else _WORK_CHECKS
    seen, failure = list[float](), ''
    for errors in _errors_along(simulation, study.reference, study.reference.states if by_path
                                else None, _JUDGED_SAMPLES if not by_path else 1, looks):
        seen.append(errors[0] if by_path else errors[1] / study.known.energy_scale)
        # Tolerate rounding of the time: the run is complete at the last instant.
        t, spent = simulation.time, work(simulation)
        over = t >= extent * (1.0 - 1e-12)
        if seen[-1] > study.lost:
            failure = 'the error is too large'
        elif not over and (simulation.gradients > most or spent > bound * extent):
            failure = TOO_EXPENSIVE
        if failure or (over and not by_path and simulation.gradients > limit):
            break
    error = carried(seen, t, tolerance.horizon, 1.0 if by_path else 0.0)
    gradients = simulation.gradients
    if by_path and not failure and error <= tolerance.error and spent / t < bound:
        error = max(error, error_between(study, simulation) * max(1.0, error / max(*seen, 1e-300)))
    return MethodCost(method, simulation.step_size, error if by_path else math.nan,
                      math.nan if by_path else error, math.nan, gradients / t, failure,
                      spent / t, t)


def error_between(study: CostStudy, simulation: Simulation) -> float:
    """
    Return the largest path error of dense output, where the path is fastest in equal parts of it.

    Errors of phase are largest there, and steps of several orbits may end elsewhere.
    """
    states = study.reference.states
    moves = np.abs(np.diff(states, axis=0)).max(axis=1)
    ends = np.linspace(0, len(moves), 1 + min(_CHECKS_BETWEEN, len(moves))).astype(int)
    places = np.array([low + int(moves[low:high].argmax()) for low, high in pairwise(ends)])
    simulation.restart(study.problem.q, study.problem.p)
    found = np.hstack(record_at(simulation, study.reference.instants.gap * (1 + places)))
    return float(np.abs(found - states[places]).max())


def try_between(study: CostStudy, error: float) -> None:
    """Measure additional settings near an error if they may beat the cheapest known cost."""
    order = list(dict.fromkeys(cost.method.family for cost in study.costs))
    for family in order:
        rows = [cost for cost in study.costs if cost.method.family == family]
        best, fine = study.recommended(error), study.recommended(error, family) or max(
            (cost for cost in rows if cost.failure == TOO_EXPENSIVE),
            key=lambda cost: cost.coarseness, default=None)
        coarse = min((cost for cost in rows if fine and cost.coarseness > fine.coarseness),
                     key=lambda cost: cost.coarseness, default=None)
        if best is None or fine is None or coarse is None:
            continue
        # The price of a run that was abandoned is not known.
        price = study.price(fine) if not fine.failure else (
            study.price(coarse) * coarse.coarseness / fine.coarseness)
        study.costs += [measure(study, method, parts)
                        for method, parts, share in _between(study, fine, coarse.coarseness)
                        if price * share < study.price(best)]
    study.costs.sort(key=lambda cost: (order.index(cost.method.family), -cost.coarseness))


def _between(study: CostStudy, cost: MethodCost, coarser: float
             ) -> Iterator[tuple[Method, int, float]]:
    """Yield coarser settings than that of a cost, and their approximate share of its price."""
    base, tolerance = study.reference.instants.base, cost.method.tolerance
    if tolerance is None:
        parts = round(base / cost.step_size)
        for other in parts_between(round(base / coarser), parts):
            yield cost.method, other, other / parts
        return
    for ratio in _RATIOS_BETWEEN:
        if ratio * tolerance < coarser:
            yield (cost.method.within(float(f'{ratio * tolerance:.3g}')), 1,
                   ratio ** -_COST_EXPONENT)
