# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rows 3: time to a path error on the learned pendulum, over the best adaptive method."""

from collections.abc import Callable, Iterator
import time

from benchmarks.adaptive import adaptive_peers, scipy_solution, Solve
from benchmarks.measurement import assert_close, compare, interleave, Row, Settings
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.models.neural import NeuralHamiltonian
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import Simulation
import numpy as np

SHORT, LONG = 100.0, 1e4
_WANTED = {SHORT: 1e-8, LONG: 1e-6}
_TARGET = {SHORT: 1.0, LONG: 0.5}
_METHODS = ('gauss8', 'gauss10', 'gauss12', 'gauss14', 'gauss16')
# Samples along our path; it must be right at each of them, a peer's only at the end.
_SAMPLES = 10
_REFERENCE_STEP = 0.125

Choice = tuple[str, int]


class Problem:
    """
    The pendulum that is integrated, ours at given steps and the reference.

    Parameters
    ----------
    hamiltonian : NeuralHamiltonian
        Of the scene.
    z0 : np.ndarray, shape (2 d,)
        Its initial (q, p).

    """

    def __init__(self, hamiltonian: NeuralHamiltonian, z0: np.ndarray):
        self.hamiltonian, self.z0 = hamiltonian, z0

    def prepare(self, duration: float, choice: Choice) -> Callable[[], np.ndarray]:
        """Return a run that returns (q, p) at the samples, shape (samples, 2 d)."""
        method, steps = choice
        simulation = Simulation(
            self.hamiltonian, INTEGRATORS[method](), duration / steps,
            *np.split(self.z0, 2))
        simulation.compile()
        return lambda: np.hstack(simulation.record(_SAMPLES, steps // _SAMPLES))

    def reference(self, duration: float) -> np.ndarray:
        """Return the path by gauss16, checked by halving its step."""
        coarse, fine = (
            self.prepare(duration, ('gauss16', round(duration / h)))()
            for h in (_REFERENCE_STEP, 0.5 * _REFERENCE_STEP))
        # Rounding errors alone, some 1e-16 J a second, come to 2e-8 at T = 1e4.
        assert_close(f'reference at T = {duration:g}', coarse, fine, 0.1 * _WANTED[duration])
        return fine


def rows(settings: Settings) -> Iterator[Row]:
    """Measure one row a horizon."""
    scene = load_scene('pendulum')
    z0 = np.concatenate([scene.initial_state.q, scene.initial_state.p])
    problem = Problem(scene.create_hamiltonian(), z0)
    peers = adaptive_peers(problem.hamiltonian, z0)
    settings.say('reference at T = 100')
    reference = problem.reference(SHORT)
    # DOP853's own error at its tightest tolerance is some 1e-10 here.
    assert_close('reference by scipy', scipy_solution(problem.hamiltonian, z0, SHORT),
                 reference[-1], 0.1 * _WANTED[SHORT])
    settings.say('choosing methods and tolerances at T = 100')
    choices = _fastest_choices(problem, reference)
    found = {name: _loosest(solve, SHORT, 1e-10, reference[-1]) for name, solve in peers.items()}
    yield _row(problem, SHORT, choices[0], peers, found, [], settings)
    if settings.quick:
        return
    yield _long_row(problem, choices, peers, found, settings)


def _long_row(problem: Problem, choices: list[Choice], peers: dict[str, Solve],
              found: dict[str, tuple[float, float]], settings: Settings) -> Row:
    settings.say('reference, methods and tolerances at T = 1e4')
    reference = problem.reference(LONG)
    ours = _fastest_long_choice(problem, choices, reference)
    long, left_out = {}, []
    for name in sorted(peers, key=lambda name: found[name][1]):
        tolerance, seconds = found[name]
        # Its error grows faster than T, so it would need a tighter tolerance and more time.
        at_least = seconds * LONG / SHORT
        if long and at_least > 1.5 * min(seconds for _, seconds in long.values()):
            left_out.append(f'{name} not run: at least {at_least:.3g} s, from its time a second '
                            'at T = 100 with the tolerance that is enough there')
            continue
        long[name] = _loosest(peers[name], LONG, tolerance * SHORT / LONG, reference[-1])
    return _row(problem, LONG, ours, peers, long, left_out, settings)


def _row(problem: Problem, duration: float, ours: Choice, peers: dict[str, Solve],
         found: dict[str, tuple[float, float]], left_out: list[str], settings: Settings) -> Row:
    settings.say(f'timing at T = {duration:g}: {ours[0]}, h = {duration / ours[1]:.3g}')
    fastest = min(seconds for _, seconds in found.values())
    timed = [name for name, (_, seconds) in found.items() if seconds <= 1.5 * fastest]
    contestants = [lambda: problem.prepare(duration, ours), *(
        lambda name=name: lambda: peers[name](duration, found[name][0]) for name in timed)]
    times = interleave(contestants, settings.repetitions)
    best = timed[int(np.argmin(np.median(times[:, 1:], axis=0)))]
    note = '; '.join([
        f'ours: {ours[0]}, h = {duration / ours[1]:.3g}',
        *[f'{name}: tolerance {tolerance:.2g}, {seconds:.3g} s when chosen'
          for name, (tolerance, seconds) in found.items()], *left_out])
    return compare(
        f'time to a path error of {_WANTED[duration]:g} at T = {duration:g}', times[:, 0],
        times[:, 1:].min(axis=1), target=_TARGET[duration], scale=1.0, unit='s',
        peer_name=best, note=note)


def _fastest_choices(problem: Problem, reference: np.ndarray) -> list[Choice]:
    """Return methods and steps that are accurate enough at T = 100, the fastest first."""
    found = []
    for method in _METHODS:
        for h in 0.1 * 2.0 ** np.arange(0.0, 3.0, 0.25):
            choice = method, _SAMPLES * round(SHORT / h / _SAMPLES)
            try:
                error = np.max(np.abs(problem.prepare(SHORT, choice)() - reference))
            except StepFailure:
                break
            if error > _WANTED[SHORT]:
                break
            found.append((min(_seconds(problem.prepare(SHORT, choice)) for _ in range(3)), choice))
    return [choice for _, choice in sorted(found)]


def _fastest_long_choice(problem: Problem, choices: list[Choice], reference: np.ndarray
                         ) -> Choice:
    """Return the fastest of the first few choices that is accurate enough at T = 1e4."""
    found: list[tuple[float, Choice]] = []
    for method, steps in choices:
        choice = method, round(steps * LONG / SHORT)
        run = problem.prepare(LONG, choice)
        start = time.perf_counter()
        path = run()
        seconds = time.perf_counter() - start
        if np.max(np.abs(path - reference)) <= _WANTED[LONG]:
            found.append((seconds, choice))
        if len(found) == 3:
            break
    return min(found)[1]


def _loosest(solve: Solve, duration: float, tolerance: float, reference: np.ndarray
             ) -> tuple[float, float]:
    """Return about the loosest tolerance that is accurate enough, and the time it takes [s]."""
    wanted, best = _WANTED[duration], None
    for _ in range(8):
        start = time.perf_counter()
        error = float(np.max(np.abs(solve(duration, tolerance) - reference)))
        if error <= wanted and (best is None or tolerance > best):
            best = tolerance
        if 0.4 * wanted <= error <= wanted or (time.perf_counter() - start > 30.0 and best):
            break
        # The error is about proportional to the tolerance.
        tolerance *= float(np.clip(0.7 * wanted / max(error, 1e-300), 1e-2, 1e2))
    if best is None:
        raise RuntimeError(f'no tolerance gives an error of {wanted:g} at T = {duration:g}')
    return best, min(_seconds(lambda: solve(duration, best)) for _ in range(2))


def _seconds(run: Callable[[], object]) -> float:
    start = time.perf_counter()
    run()
    return time.perf_counter() - start
