# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rows 3: time to a path error on the learned pendulum, compared with adaptive methods."""

from collections.abc import Callable, Iterable, Iterator

from benchmarks.choosing import (
    accurate_ways, cheapest, GAUSS, largest_error, loosest, problem_of, reference_path, Way)
from benchmarks.measurement import assert_close, race, Row, Settings
from hnn_vi_ros.models import NeuralHamiltonian
from hnn_vi_ros.simulation import InitialValueProblem
import numpy as np
from studies import peers

SHORT, LONG = 100.0, 1e4
_WANTED = {SHORT: 1e-8, LONG: 1e-6}
_TARGET = {SHORT: 1.0, LONG: 0.5}
# Samples along our path; it must be right at each of them, a peer's only at the end.
_SAMPLES = 10
_STEPS, _REFERENCE_STEP = 0.8 * 2.0 ** -np.arange(0.25, 3.25, 0.25), 0.125
# An error is about proportional to the tolerance.
_TOLERANCES = 10.0 ** -np.arange(8.0, 14.1, 0.25)

# solve(duration, tolerance) returns (q, p) at the end, shape (2 d,).
Solve = Callable[[float, float], np.ndarray]


def rows(settings: Settings) -> Iterator[Row]:
    """Measure one row a horizon."""
    problem = problem_of('pendulum')
    solvers = adaptive_peers(problem)
    settings.say('reference, methods and tolerances at T = 100')
    # Rounding errors alone, some 1e-16 J a second, come to 2e-8 at T = 1e4.
    reference = reference_path(problem, SHORT, _SAMPLES, _REFERENCE_STEP, 0.1 * _WANTED[SHORT])
    # DOP853's own error at its tightest tolerance is some 1e-10 here.
    assert_close('reference by scipy', solvers['scipy DOP853'](SHORT, 0.0), reference[-1],
                 0.1 * _WANTED[SHORT])
    ways = accurate_ways(problem, dict.fromkeys(GAUSS, _STEPS), reference, SHORT, _WANTED[SHORT])
    enough = {name: _loosest(solve, SHORT, _TOLERANCES, reference[-1])
              for name, solve in solvers.items()}
    short = _row(SHORT, ways, solvers, enough, '', settings)
    yield short
    if settings.quick:
        return
    settings.say('reference, methods and tolerances at T = 1e4')
    reference = reference_path(problem, LONG, _SAMPLES, _REFERENCE_STEP, 0.1 * _WANTED[LONG])
    # Errors grow with time: the steps that are enough here are at most those from before.
    longer = {way.method.kind: _STEPS[_STEPS < 1.05 * way.step_size] for way in ways}
    ways = accurate_ways(problem, longer, reference, LONG, _WANTED[LONG])
    best = next(name for name in solvers if short.peer.startswith(name))
    # An error grows as T at the least: as the one that is wanted.
    tighter = _TOLERANCES[_TOLERANCES < 1.05 * enough[best]]
    yield _row(LONG, ways, solvers, {best: _loosest(solvers[best], LONG, tighter, reference[-1])},
               'the other peers, which are slower at T = 100, are not run', settings)


def adaptive_peers(problem: InitialValueProblem) -> dict[str, Solve]:
    """Return the adaptive methods of order 8 that users reach for, by name."""
    hamiltonian, z0 = problem.hamiltonian, np.concatenate([problem.q, problem.p])
    assert isinstance(hamiltonian, NeuralHamiltonian)
    solvers = {
        'diffrax Dopri8': peers.diffrax_solve(hamiltonian, 'Dopri8'),
        'scipy DOP853': peers.scipy_solve(hamiltonian, 'DOP853'),
        'torchdiffeq dopri8': peers.torch_solve(hamiltonian, 'dopri8', adaptive=True),
    }
    return {name: lambda duration, tolerance, solve=solve: solve(z0, duration, tolerance)[0]
            for name, solve in solvers.items()}


def _row(duration: float, ways: list[Way], solvers: dict[str, Solve],
         tolerances: dict[str, float], note: str, settings: Settings) -> Row:
    settings.say(f'timing at T = {duration:g}')
    return race(
        f'time to a path error of {_WANTED[duration]:g} at T = {duration:g}', cheapest(ways),
        {name: lambda name=name, tolerance=tolerance: lambda: solvers[name](duration, tolerance)
         for name, tolerance in tolerances.items()}, settings, target=_TARGET[duration], scale=1.0,
        unit='s', note='; '.join([*(f'{name}: tolerance {tolerance:.2g}'
                                    for name, tolerance in tolerances.items()), note]))


def _loosest(solve: Solve, duration: float, tolerances: Iterable[float], end: np.ndarray) -> float:
    """Return the loosest tolerance that is accurate enough."""
    return loosest(tolerances, lambda tolerance: largest_error(solve(duration, tolerance), end),
                   _WANTED[duration])
