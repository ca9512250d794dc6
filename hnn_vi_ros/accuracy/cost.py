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

from hnn_vi_ros.accuracy.path_reference import best_reference, PathReference, PATIENCE
from hnn_vi_ros.accuracy.trials import (
    EVERY_SURVEYOR, InitialValueProblem, Method, parts_between, parts_for, PathSurvey, survey)
from hnn_vi_ros.errors import StepFailure, UnsupportedSystem
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.integrators import INTEGRATORS, method_name
from hnn_vi_ros.integrators.composition import Composition
from hnn_vi_ros.integrators.gauss import GAUSS_METHODS
from hnn_vi_ros.integrators.lie.lie_gauss import LIE_GAUSS_METHODS
from hnn_vi_ros.simulation import Simulation
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
# States at which energies are compared, about; and times at which a run may end for its error.
_ENERGIES, _LOOKS = 1000, 20
# The first step over what resolves the path, at least: the order is taken where that is more, for
# a run that is lost at once costs nothing. Each further step is shorter by some numbers of parts
# in the list of trials, the fewer, the higher the order is: the error falls faster.
_LONGEST, _STRIDES = 2.0, ((4, 3), (8, 2), (math.inf, 1))
# A method that takes so many times what another one does for the same error is followed no more.
_HOPELESS = 100.0
# As many steps are measured of each method, also where they take more than its share of the time.
_LEAST = 3
# An error of this share of the path's size, or of the energy scale, says that a run is lost.
_LOST = 0.1
# Steps that are shorter and no better, after which a method has come to its floor.
_STUCK, _BETTER = 2, 0.7
# How long a run is repeated to be timed [s], and at most how often.
_TIMED, _REPEATS = 0.02, 7
# No method is begun in this last share of the time: it may have to be compiled.
_BEGUN = 0.05
# Between the instants of a comparison errors may be larger: what is recommended keeps this share.
_SEEN = 0.95


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

    """

    method: Method
    step_size: float
    path_error: float = math.nan
    energy_error: float = math.nan
    seconds: float = math.nan
    gradients: float = math.nan
    failure: str = ''


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

    """

    problem: InitialValueProblem
    known: PathSurvey
    reference: PathReference
    no_path: str
    costs: list[Cost] = field(default_factory=list)
    left_out: dict[str, list[str]] = field(default_factory=dict)
    unreached: list[str] = field(default_factory=list)

    @property
    def floor(self) -> float:
        """Return the error below which nothing is known."""
        return 0.0 if self.no_path else self.reference.accuracy

    @property
    def lost(self) -> float:
        """Return the error from which on a run says nothing."""
        return _LOST if self.no_path else _LOST * float(np.abs(self.reference.states).max())

    def error(self, cost: Cost) -> float:
        """Return the error of the path, or that of the energy where no path is known."""
        if cost.failure:
            return math.inf
        return cost.energy_error if self.no_path else cost.path_error

    def cheapest(self, error: float, kind: str | None = None) -> Cost | None:
        """Return what takes the least time and errs by no more, of all methods or of one."""
        good = [cost for cost in self.costs
                if kind in (None, cost.method.kind) and self.error(cost) <= error]
        return min(good, key=lambda cost: cost.seconds, default=None)

    def recommended(self, error: float) -> Cost | None:
        """Return the cheapest that holds an error, with a margin for unknown errors."""
        return self.cheapest(_SEEN * error - self.floor)


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
            study.costs += _ladder(study, method, left / (len(methods) - k), last)
        if error is not None:
            show(1.0, f'more steps near {error:g}')
            _try_between(study, error)
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
    hamiltonian = hamiltonian or simulation.hamiltonian
    instants = reference.instants
    every, apart = instants.met(round(instants.base / simulation.step_size))
    path = reference.states[apart - 1::apart] if reference.verified else None
    rows = instants.count // apart if path is None else len(path)
    # Energies are looked at between instants as well, where steps end there.
    parts = max(k for k in range(1, max(1, _ENERGIES // rows) + 1) if every % k == 0)
    start = hamiltonian.energy(simulation.q, simulation.p)
    worst, energy_error, done = math.nan if path is None else 0.0, 0.0, 0
    while done < rows and not worst > enough:
        more = min(math.ceil(rows / _LOOKS), rows - done)
        q, p = simulation.record(more * parts, every // parts)
        energy = hamiltonian.energy(q, p) - start if simulation.conservative \
            else np.array([simulation.energy_balance])
        if path is not None:
            found = np.hstack([q, p])[parts - 1::parts]
            worst = max(worst, float(np.abs(found - path[done:done + more]).max()))
        energy_error, done = max(energy_error, float(np.abs(energy).max())), done + more
        if not np.isfinite([*q[-1], *p[-1], *energy]).all():
            raise StepFailure('not finite', simulation.time, simulation.step_size, math.nan,
                              simulation.gradients)
    return RunErrors(worst, energy_error, simulation.gradients)


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
        refusal = ''
        for method in [own] if own and own.kind == kind else _variants(kind, study.known):
            try:
                study.problem.simulation(method, study.reference.instants.base)
            except UnsupportedSystem as problem:
                # What follows the name of the method, without those that can.
                name = method_name(method.create())
                refusal = refusal or str(problem).removeprefix(name).strip().partition(';')[0]
            except (TypeError, ValueError) as problem:
                refusal = f'needs an argument of the scene: {problem}'.partition(';')[0]
            except StepFailure:
                refusal = 'fails at the initial state'
            else:
                yield method
                break
        else:
            study.left_out.setdefault(
                refusal or 'is for close encounters, of which this path has none', []).append(kind)


def _variants(kind: str, known: PathSurvey) -> list[Method]:
    """Return a method with the arguments that are tried, the first that fits to be taken."""
    if kind == _CLOSE_ENCOUNTERS:
        close = known.strongest >= _CLOSE * known.force > 0.0
        return [Method(kind, {'base': 'gauss8', 'force': float(f'{known.force:.3g}')})] * close
    if issubclass(INTEGRATORS[kind], Composition):
        return [Method(kind, {'base': base}) for base in _BASES]
    return [Method(kind)]


def _ladder(study: CostStudy, method: Method, seconds: float, last: float) -> list[Cost]:
    """Return the costs of ever smaller steps, until they do not help or its time is over [s]."""
    order = method.create().order
    stride = next(stride for below, stride in _STRIDES if order < below)
    longest = max(_LONGEST, order) * study.known.step_size
    if method.kind == _CLOSE_ENCOUNTERS:
        longest *= (study.known.strongest / method.arguments.get('force', 1.0)) ** 0.75
    base, costs = study.reference.instants.base, list[Cost]()
    parts, stuck, best = parts_for(base / min(longest, base)), 0, math.inf
    _warm_up(study, method, base / parts)
    end, good = time.process_time() + seconds, 0
    while stuck < _STUCK:
        start = time.process_time()
        cost = _measure(study, method, parts)
        if costs and study.error(costs[-1]) > study.lost:
            costs.pop()
        costs.append(cost)
        error = study.error(cost)
        if error <= study.lost:
            stuck = 0 if error < _BETTER * best else stuck + 1
            best, other, good = min(best, error), study.cheapest(error), good + 1
            if error <= study.floor or (
                    other is not None and cost.seconds > _HOPELESS * other.seconds):
                break
        # No run takes more gradients than the reference may.
        shorter = parts_between(parts, PATIENCE * study.problem.gradients)
        if len(shorter) < stride:
            break
        before, parts = parts, shorter[stride - 1]
        now = time.process_time()
        # The first few are measured as long as there is time at all.
        if now + parts / before * (now - start) > (end if good >= _LEAST else last):
            break
    return costs


def _warm_up(study: CostStudy, method: Method, h: float) -> None:
    """Compile a method, and whatever else its first step takes."""
    with suppress(StepFailure), np.errstate(over='ignore', invalid='ignore'):
        simulation = study.problem.simulation(method, h)
        simulation.advance(1)
        simulation.energy_balance  # noqa: B018  it is compiled as well


def _measure(study: CostStudy, method: Method, parts: int) -> Cost:
    """Run a method with so many steps up to the horizon."""
    problem, reference = study.problem, study.reference
    h = reference.instants.base / parts
    try:
        with np.errstate(over='ignore', invalid='ignore'):
            simulation = problem.simulation(method, h)
            # A first step may compile: the series of a formula, say.
            simulation.advance(1)
            simulation.restart(problem.q, problem.p)
            start = time.process_time()
            errors = run_errors(simulation, reference, study.lost)
            times = [time.process_time() - start]
        extent, steps = simulation.time, simulation.steps
        while sum(times) < _TIMED and len(times) < _REPEATS and not errors.path > study.lost:
            simulation.restart(problem.q, problem.p)
            start = time.process_time()
            simulation.advance(steps)
            times.append(time.process_time() - start)
    except StepFailure as failure:
        return Cost(method, h, failure=f'{failure.reason} at t = {failure.t:.4g} s')
    return Cost(method, h, max(errors.path, study.floor),
                errors.energy / study.known.energy_scale, min(times) / extent,
                errors.gradients / extent,
                'the path is lost' if errors.path > study.lost else '')


def _try_between(study: CostStudy, error: float) -> None:
    """Measure more steps near an error, where they may be cheaper than what is known."""
    base = study.reference.instants.base
    order = list(dict.fromkeys(cost.method.kind for cost in study.costs))
    for kind in order:
        good, best = study.cheapest(_SEEN * error - study.floor, kind), study.recommended(error)
        if good is None or best is None:
            continue
        parts = round(base / good.step_size)
        longer = max((other for cost in study.costs if cost.method.kind == kind
                      and (other := round(base / cost.step_size)) < parts), default=parts)
        study.costs += [_measure(study, good.method, other)
                        for other in parts_between(longer, parts)
                        if good.seconds * other / parts < best.seconds]
    study.costs.sort(key=lambda cost: (order.index(cost.method.kind), -cost.step_size))
