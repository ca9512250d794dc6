# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Rows 16: exact systems, a small arm and a learned pendulum, compared with heyoka itself.

Both sides are the cheapest that keep to a path error at ten instants: ours of methods and step
sizes, heyoka of tolerances, in one call to each instant. Its equations are written as its own
documentation does, or from the same formula where they are long.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any

from benchmarks import by_hand
from benchmarks.choosing import (
    accurate_ways, cheapest, first_good, largest_error, path_run, problem_of)
from benchmarks.measurement import Contestant, race, Row, Settings
import heyoka
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import Taylor, TaylorWork
from hnn_vi_ros.simulation import InitialValueProblem, Method, Simulation
import numpy as np

_INSTANTS, _BATCH, _RUNS = 10, 8, 30
_METHODS = ('rk4', 'gauss8', 'gauss16', 'kahan_li8')
_STEPS = 0.8 * 2.0 ** -np.arange(0.0, 9.0, 0.25)
_TOLERANCES = 10.0 ** -np.arange(3.0, 16.0, 0.5)


@dataclass(frozen=True)
class Case:
    """
    A motion, and the error that both sides keep to.

    Parameters
    ----------
    name : str
        Name of the row.
    problem : InitialValueProblem
        Problem of both sides.
    duration, wanted : float
        T [s], and the largest error of a component.
    system : list of tuple or None
        Equations of heyoka; None: from the formula.
    compact : bool
        True if heyoka writes loops; networks would otherwise compile for minutes.

    """

    name: str
    problem: InitialValueProblem
    duration: float
    wanted: float
    system: Any = None
    compact: bool = False

    def theirs(self, tolerance: float, lanes: int = 1, instants: int = _INSTANTS
               ) -> Callable[[], np.ndarray]:
        """Return a run of heyoka, of one or several copies; of the path (instants, 2 d)."""
        start = np.concatenate([self.problem.q, self.problem.p])
        if self.system is None:
            series = TaylorWork(tolerance).series(
                self.problem.hamiltonian.kernel, lanes, np.ones(start.size))
        else:
            kind = heyoka.taylor_adaptive_batch if lanes > 1 else heyoka.taylor_adaptive
            shape = (start.size, lanes) if lanes > 1 else start.size
            series = kind(self.system, np.zeros(shape), tol=tolerance,
                          compact_mode=self.compact)

        def run() -> np.ndarray:
            series.state[:] = start[:, None] if lanes > 1 else start
            series.set_time(0.0) if lanes > 1 else setattr(series, 'time', 0.0)
            path = np.empty((instants, start.size))
            for k in range(instants):
                series.propagate_until((k + 1) * self.duration / instants)
                path[k] = series.state[:, 0] if lanes > 1 else series.state
            return path
        return run

    def in_a_scene(self, tolerance: float, lanes: int = 1) -> Contestant:
        """Return our integrator of the same series, of one or several copies, in one call."""
        problem = self.problem if lanes == 1 else replace(
            self.problem, q=np.tile(self.problem.q, (lanes, 1)),
            p=np.tile(self.problem.p, (lanes, 1)))
        return path_run(problem, Simulation(
            problem.hamiltonian, Taylor(tolerance), self.duration, problem.q, problem.p), 1, 1)

    def ours(self, kind: str, tolerance: float, instants: int = _INSTANTS) -> Contestant:
        """Return a run of a method of ours that chooses its steps."""
        method = Method(kind).within(tolerance)
        return path_run(self.problem, self.problem.simulation(
            method, self.duration / instants), instants, 1)


def cases() -> Iterator[Case]:
    """Yield the measured cases."""
    (x, y, p_x, p_y), (q, p) = heyoka.make_vars('x', 'y', 'px', 'py'), heyoka.make_vars('q', 'p')
    pull = (x ** 2 + y ** 2) ** -1.5
    kepler = [(x, p_x), (y, p_y), (p_x, -x * pull), (p_y, -y * pull)]
    for duration in (100.0, 1000.0):
        yield Case('Kepler', _system('kepler', [0.4, 0.0], [0.0, 2.0]), duration, 1e-9, kepler)
    yield Case('pendulum', _system('pendulum', [1.5], [0.0]), 1000.0, 1e-9,
               [(q, p), (p, -9.81 * heyoka.sin(q))])
    yield Case('Hénon-Heiles', _system('henon_heiles', [0.0, 0.1], [0.45, 0.0]),
               100.0, 1e-9, [(x, p_x), (y, p_y), (p_x, -x - 2.0 * x * y),
                             (p_y, -y - x ** 2 + y ** 2)])
    yield Case('double pendulum', _system('double_pendulum', [1.0, 0.5], [0.0, 0.0]), 10.0, 1e-6)
    yield Case('two-joint arm', problem_of('two_joint_arm'), 10.0, 1e-6)
    learned = problem_of('pendulum')
    yield Case('learned pendulum', learned, 100.0, 1e-8, _network(learned.hamiltonian, [q, p]),
               compact=True)


def _system(name: str, q: list[float], p: list[float]) -> InitialValueProblem:
    return InitialValueProblem(HAMILTONIANS[name](), (), np.array(q), np.array(p))


def _network(hamiltonian: Any, variables: list[Any]) -> Any:
    """Return the equations of a learned H, by heyoka's own networks."""
    weights, biases = hamiltonian.checkpoint.networks['energy']
    numbers = np.concatenate([*(w.ravel() for w in weights), *(b.ravel() for b in biases)])
    (energy,) = heyoka.model.ffnn(
        variables, [len(b) for b in biases[:-1]], 1,
        [heyoka.tanh] * (len(biases) - 1) + [lambda x: x], list(numbers))
    d = len(variables) // 2
    return heyoka.hamiltonian(energy, variables[:d], variables[d:])


def own_steps(case: Case, settings: Settings) -> Iterator[Row]:
    """
    Yield the rows of a formula by our methods that choose their steps, over short times.

    Errors are those at the instants, times those of one call to the end.
    """
    for duration, wanted in product((10.0, 100.0), (1e-6, 1e-9)):
        yield from _own_steps_of(replace(case, duration=duration, wanted=wanted), settings)


def _own_steps_of(case: Case, settings: Settings) -> Iterator[Row]:
    true = case.theirs(1e-16)()

    def good(path: Callable[[float], np.ndarray]) -> float | None:
        return first_good(_TOLERANCES, lambda one: largest_error(path(one), true), case.wanted)

    def ours(kind: str, tolerance: float) -> np.ndarray:
        return case.ours(kind, tolerance)()()

    theirs = good(lambda one: case.theirs(one)())
    loose = case.wanted > 1e-7
    for kind, target in (
            ('dop853', (0.6 if case.name == 'double pendulum' else 3.0) if loose else None),
            ('taylor', 1.5 if loose else 1.3)):
        tolerance = good(partial(ours, kind))
        if theirs is not None and tolerance is not None:
            native = case.theirs(theirs, 1, 1)
            yield race(
                f'{case.name}, T = {case.duration:g} s, path error {case.wanted:g}: {kind}', {
                    f'{kind}, tolerance {tolerance:.2g}': _several([
                        case.ours(kind, tolerance, 1) for _ in range(_RUNS)])}, {
                    f'heyoka, tolerance {theirs:.2g}': _several(
                        _RUNS * [partial(_given, native)])}, settings, target=target,
                scale=1e6 / (case.duration * _RUNS), unit='us per simulated second',
                of_processor=True)


def _given(run: Callable[[], np.ndarray]) -> Callable[[], np.ndarray]:
    return run


def _several(contestants: list[Contestant]) -> Contestant:
    """Return the contestant of several runs, because one is too short to time."""
    def prepare() -> Callable[[], object]:
        runs = [contestant() for contestant in contestants]
        return lambda: [run() for run in runs]
    return prepare


def rows(settings: Settings) -> Iterator[Row]:
    """Measure formulas, then each motion, alone and in a batch, and by the integrator taylor."""
    yield from by_hand.rows(settings)
    for case in {case.name: case for case in cases() if not case.compact}.values():
        settings.say(f'{case.name}, with chosen steps')
        yield from own_steps(case, settings)
    for case in cases():
        settings.say(f'{case.name}, T = {case.duration:g}')
        true = case.theirs(1e-16)()
        ways = cheapest(accurate_ways(case.problem, dict.fromkeys(_METHODS, _STEPS), true,
                                      case.duration, case.wanted))
        tolerance = first_good(
            _TOLERANCES, lambda one, case=case, true=true: largest_error(
                case.theirs(one)(), true), case.wanted)
        assert tolerance is not None, 'as the truth, at a tolerance that is looser'
        alone, batch, to_the_end, batch_to_the_end = (
            case.theirs(tolerance, *how) for how in ((), (_BATCH,), (1, 1), (_BATCH, 1)))
        name = f'{case.name}, T = {case.duration:g} s, path error {case.wanted:g}'
        how = {'target': None, 'scale': 1e6 / case.duration, 'unit': 'us per simulated second',
               'note': f'tolerance {tolerance:.2g}'}
        if ways:
            yield race(f'{name}: heyoka', ways, {'heyoka': lambda run=alone: run}, settings, **how)
            yield race(f'{name}: heyoka, {_BATCH} at once', ways, {
                'heyoka': lambda run=batch: run}, settings, copies=_BATCH, **how)
        if not Taylor().refusal(case.problem.hamiltonian):
            # In one call each, as both are used where the end is wanted, or a dense output.
            yield race(f'{name}: taylor in a scene', {'taylor': case.in_a_scene(tolerance)}, {
                'heyoka': lambda run=to_the_end: run}, settings, **how | {
                'target': 1.3 if case.duration >= 1000.0 else None})
            yield race(f'{name}: taylor in a scene, {_BATCH} at once', {
                'taylor': case.in_a_scene(tolerance, _BATCH)}, {
                    'heyoka': lambda run=batch_to_the_end: run}, settings, **how)
