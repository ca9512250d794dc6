# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rows 3: time to a path error on the learned pendulum, over the best adaptive method."""

from collections.abc import Callable, Iterator, Mapping
import time

from benchmarks.choosing import accurate_ways, cheapest, GAUSS, path_run, problem_of, Way
from benchmarks.measurement import assert_close, race, Row, Settings
from hnn_vi_ros.accuracy.trials import InitialValueProblem
from hnn_vi_ros.models.neural import NeuralHamiltonian
import numpy as np
from studies import peers

SHORT, LONG = 100.0, 1e4
_WANTED = {SHORT: 1e-8, LONG: 1e-6}
_TARGET = {SHORT: 1.0, LONG: 0.5}
# Samples along our path; it must be right at each of them, a peer's only at the end.
_SAMPLES = 10
_STEPS, _REFERENCE_STEP = 0.8 * 2.0 ** -np.arange(0.25, 3.25, 0.25), 0.125
# Times the least time of a peer, beyond which another is not timed in turns.
_HOPELESS = 3.0

# solve(duration, tolerance) returns (q, p) at the end, shape (2 d,); how loose a tolerance is
# enough, and how long that takes [s].
Solve = Callable[[float, float], np.ndarray]
Loosest = tuple[float, float]


def rows(settings: Settings) -> Iterator[Row]:
    """Measure one row a horizon."""
    problem = problem_of('pendulum')
    solvers = adaptive_peers(problem)
    settings.say('reference, methods and tolerances at T = 100')
    reference = _reference(problem, SHORT)
    # DOP853's own error at its tightest tolerance is some 1e-10 here.
    assert_close('reference by scipy', solvers['scipy DOP853'](SHORT, 0.0), reference[-1],
                 0.1 * _WANTED[SHORT])
    ways = accurate_ways(problem, dict.fromkeys(GAUSS, _STEPS), reference, SHORT, _WANTED[SHORT])
    found = {name: _loosest(solve, SHORT, 1e-10, reference[-1])
             for name, solve in solvers.items()}
    yield _row(SHORT, ways, solvers, found, [], settings)
    if settings.quick:
        return
    settings.say('reference, methods and tolerances at T = 1e4')
    reference = _reference(problem, LONG)
    # An error grows with time: the steps that are enough here are at most those from before.
    longer = {way.method.kind: _STEPS[_STEPS < 1.05 * way.step_size] for way in ways}
    ways = accurate_ways(problem, longer, reference, LONG, _WANTED[LONG])
    long, left_out = _long_tolerances(solvers, found, reference[-1])
    yield _row(LONG, ways, solvers, long, left_out, settings)


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


def _reference(problem: InitialValueProblem, duration: float) -> np.ndarray:
    """Return the path by gauss16, checked by halving its step."""
    counts = (round(duration / (_SAMPLES * h)) for h in (_REFERENCE_STEP, 0.5 * _REFERENCE_STEP))
    coarse, fine = (path_run(problem, problem.simulation(
        'gauss16', duration / (_SAMPLES * count)), _SAMPLES, count)()() for count in counts)
    # Rounding errors alone, some 1e-16 J a second, come to 2e-8 at T = 1e4.
    assert_close(f'reference at T = {duration:g}', coarse, fine, 0.1 * _WANTED[duration])
    return fine


def _row(duration: float, ways: list[Way], solvers: Mapping[str, Solve],
         found: Mapping[str, Loosest], left_out: list[str], settings: Settings) -> Row:
    settings.say(f'timing at T = {duration:g}')
    fastest = min(seconds for _, seconds in found.values())
    timed = {name: lambda name=name, tolerance=tolerance: lambda: solvers[name](
        duration, tolerance) for name, (tolerance, seconds) in found.items()
        if seconds <= _HOPELESS * fastest}
    return race(
        f'time to a path error of {_WANTED[duration]:g} at T = {duration:g}', cheapest(ways),
        timed, settings, target=_TARGET[duration], scale=1.0, unit='s', note='; '.join([
            *[f'{name}: tolerance {tolerance:.2g}, {seconds:.3g} s when chosen'
              for name, (tolerance, seconds) in found.items()], *left_out]))


def _long_tolerances(solvers: Mapping[str, Solve], found: Mapping[str, Loosest], end: np.ndarray
                     ) -> tuple[dict[str, Loosest], list[str]]:
    """Return the tolerances of the peers that may be the fastest, and why others are left out."""
    long: dict[str, Loosest] = {}
    left_out = []
    for name in sorted(solvers, key=lambda name: found[name][1]):
        tolerance, seconds = found[name]
        # Its error grows faster than T, so it would need a tighter tolerance and more time.
        at_least = seconds * LONG / SHORT
        if long and at_least > _HOPELESS * min(seconds for _, seconds in long.values()):
            left_out.append(f'{name} not run: at least {at_least:.3g} s, from its time a second '
                            'at T = 100 with the tolerance that is enough there')
            continue
        long[name] = _loosest(solvers[name], LONG, tolerance * SHORT / LONG, end)
    return long, left_out


def _loosest(solve: Solve, duration: float, tolerance: float, end: np.ndarray) -> Loosest:
    """Return about the loosest tolerance that is accurate enough, and the time it takes [s]."""
    wanted, best = _WANTED[duration], None
    for _ in range(8):
        start = time.perf_counter()
        error = float(np.max(np.abs(solve(duration, tolerance) - end)))
        if error <= wanted and (best is None or tolerance > best):
            best = tolerance
        if 0.4 * wanted <= error <= wanted or (time.perf_counter() - start > 30.0 and best):
            break
        # The error is about proportional to the tolerance.
        tolerance *= float(np.clip(0.7 * wanted / max(error, 1e-300), 1e-2, 1e2))
    if best is None:
        raise RuntimeError(f'no tolerance gives an error of {wanted:g} at T = {duration:g}')
    # Again: the first run of some is compiled.
    start = time.perf_counter()
    solve(duration, best)
    return best, time.perf_counter() - start
