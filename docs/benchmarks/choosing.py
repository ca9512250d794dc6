# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Choose sufficiently accurate methods and steps by counted work.

A time on a machine with other work may be several times too long, and then picks a method that is
several times slower than the best. Gradients are counted; what is left is timed in turns.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TypeVar

from benchmarks.measurement import assert_close, Contestant
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import InitialValueProblem, Method, Simulation
from hnn_vi_ros.simulation.accuracy.trials import work
import numpy as np

GAUSS = tuple(f'gauss{order}' for order in range(8, 18, 2))
# Ways that are timed.
_FEW = 3

T = TypeVar('T')


@dataclass(frozen=True)
class Way:
    """
    A method of ours at a step size.

    Parameters
    ----------
    method : Method
        The method.
    step_size : float
        h [s].
    work : float
        Work of a simulated second, in gradients [1/s].
    prepare : callable
        Returns a run from the start, to be timed.

    """

    method: Method
    step_size: float
    work: float
    prepare: Contestant

    @property
    def name(self) -> str:
        """Return its name in tables."""
        return f'{self.method}, h = {self.step_size:.3g}'


def problem_of(scene: str) -> InitialValueProblem:
    """Return the motion of a shipped scene, without its effects."""
    read = load_scene(scene)
    return InitialValueProblem(read.create_hamiltonian(), (), np.array(read.initial_state.q),
                               np.array(read.initial_state.p))


def cheapest(ways: Iterable[Way], count: int = _FEW) -> dict[str, Contestant]:
    """Return the ways of the least work, to be timed in turns."""
    return {way.name: way.prepare for way in sorted(ways, key=lambda way: way.work)[:count]}


def first_good(settings: Iterable[T], error: Callable[[T], float], wanted: float) -> T | None:
    """Return the first setting whose error is small enough; one that fails has no small error."""
    for setting in settings:
        try:
            if error(setting) <= wanted:
                return setting
        except StepFailure:
            continue
    return None


def loosest(settings: Iterable[T], error: Callable[[T], float], wanted: float) -> T:
    """Return the first setting whose error is small enough, which there must be."""
    found = first_good(settings, error, wanted)
    if found is None:
        raise RuntimeError(f'no setting has an error of {wanted:g}')
    return found


def largest_error(path: np.ndarray, reference: np.ndarray) -> float:
    """Return the largest deviation of a component; infinity for a path that ended early."""
    return float(np.abs(path - reference).max()) if path.shape == reference.shape else np.inf


def path_of(simulation: Simulation, instants: int, every: int) -> np.ndarray:
    """Return (q, p) after every `every` steps, shape (instants, 2 d)."""
    return np.hstack(simulation.record(instants, every))


def path_run(problem: InitialValueProblem, simulation: Simulation, instants: int, every: int
             ) -> Contestant:
    """Return a function that prepares runs from the start; each returns its path."""
    def prepare() -> Callable[[], np.ndarray]:
        simulation.restart(problem.q, problem.p)
        return lambda: path_of(simulation, instants, every)
    return prepare


def reference_path(problem: InitialValueProblem, duration: float, instants: int, step_size: float,
                   tolerance: float) -> np.ndarray:
    """Return the path by gauss16, shape (instants, 2 d), of half the step that checks it."""
    counts = (round(duration / (instants * h)) for h in (step_size, 0.5 * step_size))
    coarse, fine = (path_run(problem, problem.simulation(
        'gauss16', duration / (instants * count)), instants, count)()() for count in counts)
    assert_close(f'reference at T = {duration:g}', coarse, fine, tolerance)
    return fine


def accurate_ways(problem: InitialValueProblem, steps: Mapping[str, Iterable[float]],
                  reference: np.ndarray, duration: float, wanted: float) -> list[Way]:
    """
    Return each method with the first of its steps that keeps to a path error.

    Parameters
    ----------
    problem : InitialValueProblem
        The problem that is simulated.
    steps : mapping
        Step sizes of each method [s], the longest first; each is taken to divide the time between
        two instants.
    reference : np.ndarray, shape (instants, k)
        The first components of (q, p) at equidistant instants, the last at the end.
    duration, wanted : float
        T [s], and the largest error of a component.

    """
    instants, ways = len(reference), []
    for name, step_sizes in steps.items():
        counts = dict.fromkeys(max(1, round(duration / (instants * h))) for h in step_sizes)
        simulations = ((count, problem.simulation(name, duration / (instants * count)))
                       for count in counts)
        found = first_good(simulations, lambda one: largest_error(
            path_of(one[1], instants, one[0])[:, :reference.shape[1]], reference), wanted)
        if found is not None:
            every, simulation = found
            ways.append(Way(Method(name), simulation.step_size, work(simulation) / duration,
                            path_run(problem, simulation, instants, every)))
    return ways
