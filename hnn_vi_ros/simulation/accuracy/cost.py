# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Cost of accuracy: the errors of methods and step sizes, against the time that they take."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
import math
import time
from typing import NamedTuple
import warnings

from hnn_vi_ros.errors import StepFailure, UnsupportedSystem
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators import (
    Composition, GAUSS_METHODS, INTEGRATORS, LIE_GAUSS_METHODS, method_name)
from hnn_vi_ros.simulation.accuracy.path_reference import best_reference, PathReference, PATIENCE
from hnn_vi_ros.simulation.accuracy.trials import (
    carried, EVERY_SURVEYOR, InitialValueProblem, Method, parts_between, parts_for, PathSurvey,
    survey, Tolerance, work)
from hnn_vi_ros.simulation.simulation import Simulation
import numpy as np

# Measured first, in case that time does not suffice for all: what others are compared with; after
# the scene's own, explicit ones, and all Gauss methods, which are compiled once.
_YARDSTICKS = ('gauss8', 'lie_gauss8')
_NEXT = ('stormer_verlet', 'generalized_leapfrog', 'lie_stormer_verlet', 'lie_leapfrog',
         *GAUSS_METHODS, *LIE_GAUSS_METHODS, 'kahan_li8', 'rk4', 'variational_euler')
# Compositions are made of the first of these that fits: explicit ones cost less.
_BASES = ('stormer_verlet', 'lie_stormer_verlet', 'generalized_leapfrog', 'lie_leapfrog',
          'implicit_midpoint')
# Shortens its steps where forces are strong: of use where the strongest is so many times the
# median one. It is measured last, since it takes the longest to compile.
_CLOSE_ENCOUNTERS, _CLOSE = 'time_transformed', 6.0
# States at which energies are compared, about, and times at which a run may end for its error;
# where a tolerance is to be held, and where effects do work, whose sum is asked for at each look.
_ENERGIES, _LOOKS, _HELD_ENERGIES, _HELD_LOOKS, _LOOKS_OF_WORK = 1000, 20, 20_000, 100, 2000
# The first step over what resolves the path, at least: the order is taken where that is more, for
# a run that is lost at once costs nothing. Each further step is shorter by some numbers of parts
# in the list of trials, the fewer, the higher the order is: the error falls faster.
_LONGEST, _STRIDES = 2.0, ((4, 3), (8, 2), (math.inf, 1))
# A method that takes so many times what another one does for the same error is followed no more.
_HOPELESS = 100.0
# As many steps are measured of each method, also where they take more than its share of the time.
_LEAST = 3
# An error of this share of the path's size, or of the energy scale, says that a run is lost; and
# so many times a tolerance need not be known better.
_LOST, _ENOUGH = 0.1, 1e3
# Shorter steps, one after another, that show the round-off floor: slopes of the error over the
# step as shares of the order, there and where steps resolve the path; errors that only such have.
_STUCK, _FLAT, _RESOLVED, _SMALL = 2, 0.25, 0.5, 1e-7
# How long a run is repeated to be timed [s], and at most how often.
_TIMED, _REPEATS = 0.02, 7
# Why a run is given up whose work is more than it may be.
TOO_MUCH = 'costs too much'
# No method is begun in this last share of the time: it may have to be compiled.
_BEGUN = 0.05
# Between the instants of a comparison errors may be larger: what is recommended keeps this share,
# and the other one if its error is carried on from a shorter time.
_SEEN, _CARRIED = 0.95, 0.5


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
        Gradients and Hessian-vector products that it took.

    """

    path: float
    energy: float
    gradients: int


@dataclass(frozen=True)
class Cost:
    """
    Cost of a method at one step size; a figure that there is none for is NaN.

    Parameters
    ----------
    method : Method
        With its arguments.
    step_size : float
        h [s].
    path_error : float
        Largest deviation from the reference, not below what is known of that.
    energy_error : float
        Largest abs(H - H0 - W), over the energy scale of the path [1].
    seconds : float
        Processor time of a simulated second [s/s].
    gradients : float
        How many a simulated second takes [1/s].
    failure : str
        Why the run did not come to its end; empty where it did.
    work : float
        Gradients of a simulated second, and all else that steps take in gradients [1/s].
    checked : float
        Simulated time over which its error was seen; it is carried on from there [s].

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


@dataclass
class CostStudy:
    """
    Costs of the methods that fit a problem.

    Parameters
    ----------
    problem : InitialValueProblem
        The motion.
    known : PathSurvey
        Of its path.
    reference : PathReference
        What paths are compared with, and for how long.
    no_path : str
        Why they cannot be, so that energies are; empty where they can.
    costs : list of Cost
        Method by method, the longest steps first.
    left_out : dict of str to list of str
        Methods that do not fit, by the reason.
    unreached : list of str
        Methods that there was no time for.
    tolerance : Tolerance or None
        What is to be held: work is what counts then, which is the same on every machine. Without
        one it is the time.
    at_floor : list of Method
        Those of which shorter steps do not help, for round-off.

    """

    problem: InitialValueProblem
    known: PathSurvey
    reference: PathReference
    no_path: str
    costs: list[Cost] = field(default_factory=list)
    left_out: dict[str, list[str]] = field(default_factory=dict)
    unreached: list[str] = field(default_factory=list)
    tolerance: Tolerance | None = None
    at_floor: list[Method] = field(default_factory=list)

    @property
    def floor(self) -> float:
        """Return the error below which nothing is known."""
        return 0.0 if self.no_path else self.reference.accuracy

    @property
    def lost(self) -> float:
        """Return the error from which on a run says nothing."""
        if self.tolerance is not None:
            return _ENOUGH * self.tolerance.error
        return _LOST if self.no_path else _LOST * float(np.abs(self.reference.states).max())

    def error(self, cost: Cost) -> float:
        """Return the error of the path, or that of the energy where no path is known."""
        if cost.failure:
            return math.inf
        return cost.energy_error if self.no_path else cost.path_error

    def price(self, cost: Cost) -> float:
        """Return what is to be small: the time, or the work."""
        return cost.seconds if self.tolerance is None else cost.work

    def cheapest(self, error: float, method: str | None = None) -> Cost | None:
        """Return what costs least and errs by no more, of all methods or of one."""
        good = [cost for cost in self.costs
                if method in (None, str(cost.method)) and self.error(cost) <= error]
        return min(good, key=self.price, default=None)

    def holds(self, cost: Cost, error: float) -> bool:
        """Return whether a row holds an error, with a margin for unknown errors."""
        seen = self.tolerance is None or cost.checked >= self.tolerance.horizon * (1.0 - 1e-9)
        return self.error(cost) <= (_SEEN if seen else _CARRIED) * error - self.floor

    def recommended(self, error: float, method: str | None = None) -> Cost | None:
        """Return the cheapest that holds an error, of all methods or of one."""
        good = [cost for cost in self.costs
                if method in (None, str(cost.method)) and self.holds(cost, error)]
        return min(good, key=self.price, default=None)


def measure_costs(problem: InitialValueProblem, horizon: float, seconds: float,
                  own: Method | None = None, error: float | None = None,
                  show: Callable[[float, str], None] = lambda share, what: None) -> CostStudy:
    """
    Run the methods that fit a problem, with ever smaller steps.

    Parameters
    ----------
    problem : InitialValueProblem
        The motion.
    horizon : float
        For how long [s]; what cannot be followed for so long is measured for less.
    seconds : float
        Processor time that may be taken, compilation included, about [s].
    own : Method, optional
        That of the scene: it comes first, with its arguments.
    error : float, optional
        Near which more steps are tried.
    show : callable, optional
        Takes the share that is done, and what is.

    Raises
    ------
    CalibrationError
        No step is short enough to follow the path.
    UnsupportedSystem
        No method fits.

    """
    end = time.process_time() + seconds
    with warnings.catch_warnings():
        # Each simulation of an H in plain Python warns of that.
        warnings.simplefilter('ignore')
        show(0.0, 'the reference')
        known = survey(problem, horizon, horizon, EVERY_SURVEYOR)
        reference = best_reference(problem, horizon, known, PATIENCE * problem.gradients)
        why = _why_no_path(problem, reference, known.method)
        study = CostStudy(problem, known, reference, why)
        methods = list(_fitting(study, own))
        for k, method in enumerate(methods):
            left = end - time.process_time()
            if left < _BEGUN * seconds and k > 0:
                study.unreached = [other.kind for other in methods[k:]]
                break
            show((1 + k) / (2 + len(methods)), str(method))
            # However little time there is, one method has results: others may be compiled then.
            last = end if k > 0 else math.inf
            _measure_for(study, method, left / (len(methods) - k), last)
        if error is not None:
            show(1.0, f'more steps near {error:g}')
            try_between(study, error)
    return study


def run_errors(simulation: Simulation, reference: PathReference, enough: float = math.inf,
               hamiltonian: Hamiltonian | None = None) -> RunErrors:
    """
    Run a simulation from its initial state on, as far as a reference goes.

    Parameters
    ----------
    simulation : Simulation
        Whose step divides the time between two instants, or the base of all.
    reference : PathReference
        What its path is compared with; one that is not verified is none.
    enough : float, optional
        A path error that need not be known better: the run ends there.
    hamiltonian : Hamiltonian, optional
        By which energies are judged where no effect works; by default that of the simulation.

    Raises
    ------
    StepFailure
        A step fails, or a state or an energy is not finite.

    """
    path = reference.states if reference.verified else None
    worst = np.array([math.nan if path is None else 0.0, 0.0])
    for errors in _errors_along(simulation, reference, path, _ENERGIES, _LOOKS, hamiltonian):
        worst = np.maximum(worst, errors)
        if worst[0] > enough:
            break
    return RunErrors(float(worst[0]), float(worst[1]), simulation.gradients)


def _errors_along(simulation: Simulation, reference: PathReference, path: np.ndarray | None,
                  energies: int, looks: int, hamiltonian: Hamiltonian | None = None
                  ) -> Iterator[tuple[float, float]]:
    """Yield the largest path error, and energy error [J], between one look and the next."""
    hamiltonian = hamiltonian or simulation.hamiltonian
    instants = reference.instants
    every, apart = instants.met(round(instants.base / simulation.step_size))
    path = None if path is None else path[apart - 1::apart]
    rows = instants.count // apart if path is None else len(path)
    # Energies are looked at between instants as well, where steps end there.
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
    """Return why paths cannot be compared with a reference; nothing where they can."""
    for effect in problem.effects:
        if effect.random:
            return f'{type(effect).__name__} draws other numbers at each step size'
    if reference.verified:
        return ''
    if not len(reference.states):
        return f'no two runs of {method} came to their end'
    return (f'two references differ by {reference.accuracy:.2g} at best, as they do in chaos; a '
            'shorter --duration may have one')


def _fitting(study: CostStudy, own: Method | None) -> Iterator[Method]:
    """Yield the methods that fit, and note why the others do not."""
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
            reasons.append('is for close encounters, of which this path has none')
            study.left_out.setdefault(reasons[0], []).append(kind)


def refusal(study: CostStudy, method: Method) -> str:
    """Return why a method does not fit a problem; nothing where it does."""
    try:
        study.problem.simulation(method, study.reference.instants.base)
    except UnsupportedSystem as problem:
        # What follows the name of the method, without those that can.
        name = method_name(method.create())
        return str(problem).removeprefix(name).strip().partition(';')[0]
    except (TypeError, ValueError) as problem:
        return f'needs an argument of the scene: {problem}'.partition(';')[0]
    except StepFailure:
        return 'fails at the initial state'
    return ''


def _variants(kind: str, known: PathSurvey) -> list[Method]:
    """Return a method with the arguments that are tried, the first that fits to be taken."""
    if kind == _CLOSE_ENCOUNTERS:
        close = known.strongest >= _CLOSE * known.force > 0.0
        return [Method(kind, {'base': 'gauss8', 'force': float(f'{known.force:.3g}')})] * close
    if issubclass(INTEGRATORS[kind], Composition):
        return [Method(kind, {'base': base}) for base in _BASES]
    return [Method(kind)]


def ladder(study: CostStudy, method: Method, bound: float,
           enough: Callable[[list[Cost]], bool]) -> list[Cost]:
    """
    Return the costs of ever shorter steps, until they do not help or are enough.

    Parameters
    ----------
    study : CostStudy
        What is known so far.
    method : Method
        Whose steps.
    bound : float
        Work of a simulated second beyond which a run is given up [1/s].
    enough : callable
        Takes the costs so far.

    """
    order = method.create().order
    stride = next(stride for below, stride in _STRIDES if order < below)
    longest = max(_LONGEST, order) * study.known.step_size
    if study.tolerance is not None:
        # Runs up to a far horizon take long: fewer of them, around what holds an error as a rule.
        stride, longest = max(stride, 2), order ** 0.5 * study.known.step_size
    if method.kind == _CLOSE_ENCOUNTERS:
        longest *= (study.known.strongest / method.arguments.get('force', 1.0)) ** 0.75
    base, costs, flat, resolved = study.reference.instants.base, list[Cost](), 0, False
    shorter = parts_between(parts_for(base / min(longest, base)) - 1,
                            PATIENCE * study.problem.gradients)[::stride]
    last = None
    for parts in shorter:
        costs.append(measure(study, method, parts, bound))
        error = study.error(costs[-1])
        if error <= study.lost:
            if last is not None:
                slope = math.log(max(last[1], 1e-300) / max(error, 1e-300)) / math.log(
                    parts / last[0])
                flat = flat + 1 if slope < _FLAT * order else 0
                resolved = resolved or slope >= _RESOLVED * order
            last, resolved = (parts, error), resolved or error <= _SMALL
        if resolved and flat >= _STUCK:
            study.at_floor.append(method)
            break
        if enough(costs):
            break
    return costs


def _measure_for(study: CostStudy, method: Method, seconds: float, last: float) -> None:
    """Add the costs of a method, for its time [s]; the first few until the last of all time."""
    _warm_up(study, method)
    end = time.process_time() + seconds
    before = [time.process_time()]

    def enough(costs: list[Cost]) -> bool:
        good = [cost for cost in costs if study.error(cost) <= study.lost]
        if costs[-1] in good:
            error = study.error(costs[-1])
            other = study.cheapest(error)
            if error <= study.floor or (
                    other is not None and costs[-1].seconds > _HOPELESS * other.seconds):
                return True
        before.append(time.process_time())
        # The next one takes longer; the first few are measured as long as there is time at all.
        longer = before[-1] - before[-2]
        return before[-1] + 2.0 * longer > (end if len(good) >= _LEAST else last)

    costs = ladder(study, method, math.inf, enough)
    lost = [k for k, cost in enumerate(costs) if study.error(cost) > study.lost]
    # Of those that are lost the last one shows where that ends.
    study.costs += [cost for k, cost in enumerate(costs) if k not in lost[:-1]]


def _warm_up(study: CostStudy, method: Method) -> None:
    """Compile a method, and whatever else its first step takes."""
    with suppress(StepFailure), np.errstate(over='ignore', invalid='ignore'):
        simulation = study.problem.simulation(method, study.known.step_size)
        simulation.advance(1)
        simulation.energy_balance  # noqa: B018  it is compiled as well


def measure(study: CostStudy, method: Method, parts: int, bound: float = math.inf) -> Cost:
    """
    Run a method with so many steps of the base, up to the horizon.

    Parameters
    ----------
    study : CostStudy
        What errors are measured against.
    method : Method
        Whose steps.
    parts : int
        Steps in the base of all.
    bound : float, optional
        Work of a simulated second beyond which the run is given up [1/s].

    """
    h = study.reference.instants.base / parts
    try:
        with np.errstate(over='ignore', invalid='ignore'):
            simulation = study.problem.simulation(method, h)
            # A first step may compile: the series of a formula, say.
            simulation.advance(1)
            simulation.restart(study.problem.q, study.problem.p)
            if study.tolerance is None:
                return _timed(study, method, simulation)
            return _judged(study, study.tolerance, method, simulation, bound)
    except StepFailure as failure:
        return Cost(method, h, failure=f'{failure.reason} at t = {failure.t:.4g} s')


def _timed(study: CostStudy, method: Method, simulation: Simulation) -> Cost:
    """Return the errors of a run and the time that it takes."""
    start = time.process_time()
    errors = run_errors(simulation, study.reference, study.lost)
    first, extent = time.process_time() - start, simulation.time
    lost = 'the path is lost' if errors.path > study.lost else ''
    seconds = first if lost else fastest(study.problem, simulation, simulation.steps, first)
    return Cost(method, simulation.step_size, max(errors.path, study.floor),
                errors.energy / study.known.energy_scale, seconds / extent,
                errors.gradients / extent, lost)


def fastest(problem: InitialValueProblem, simulation: Simulation, steps: int, *times: float
            ) -> float:
    """Return the least processor time of steps from the start [s], with what is known of it."""
    found = [*times]
    while not found or (sum(found) < _TIMED and len(found) < _REPEATS):
        simulation.restart(problem.q, problem.p)
        start = time.process_time()
        simulation.advance(steps)
        found.append(time.process_time() - start)
    return min(found)


def _judged(study: CostStudy, tolerance: Tolerance, method: Method, simulation: Simulation,
            bound: float) -> Cost:
    """Return the error of a run, carried on to the horizon, and its work."""
    by_path, limit = not study.no_path, study.problem.gradients
    extent = study.reference.horizon if by_path else study.known.extent
    most = 4.0 * limit * (PATIENCE if by_path else 1)
    looks = _HELD_LOOKS if simulation.conservative or by_path else _LOOKS_OF_WORK
    seen, failure = list[float](), ''
    for errors in _errors_along(simulation, study.reference, study.reference.states if by_path
                                else None, _HELD_ENERGIES if not by_path else 1, looks):
        seen.append(errors[0] if by_path else errors[1] / study.known.energy_scale)
        # Rounding of the time does not count: it is over at the last instant.
        t, spent = simulation.time, work(simulation)
        over = t >= extent * (1.0 - 1e-12)
        if seen[-1] > study.lost:
            failure = 'the error is far too large'
        elif not over and (simulation.gradients > most or spent > bound * extent):
            failure = TOO_MUCH
        if failure or (over and not by_path and simulation.gradients > limit):
            break
    error = carried(seen, t, tolerance.horizon, 1.0 if by_path else 0.0)
    return Cost(method, simulation.step_size, error if by_path else math.nan,
                math.nan if by_path else error, math.nan, simulation.gradients / t, failure,
                spent / t, t)


def try_between(study: CostStudy, error: float) -> None:
    """Measure more steps near an error, where they may be cheaper than what is known."""
    base = study.reference.instants.base
    order = list(dict.fromkeys(str(cost.method) for cost in study.costs))
    for name in order:
        good, best = study.recommended(error, name), study.recommended(error)
        if good is None or best is None:
            continue
        parts = round(base / good.step_size)
        longer = max((other for cost in study.costs if str(cost.method) == name
                      and (other := round(base / cost.step_size)) < parts), default=parts)
        study.costs += [measure(study, good.method, other)
                        for other in parts_between(longer, parts)
                        if study.price(good) * other / parts < study.price(best)]
    study.costs.sort(key=lambda cost: (order.index(str(cost.method)), -cost.step_size))
