# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Rows 16: exact systems, a small arm and a learned pendulum, over heyoka by itself.

Both sides are the cheapest that keep to a path error at ten instants: ours of methods and step
sizes, heyoka of tolerances, in one call to each instant. Its equations are written as its own
documentation does, or from the same formula where they are long.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
import time
from typing import Any

from benchmarks import by_hand
from benchmarks.measurement import compare, interleave, Row, Settings
import heyoka
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.integrators.taylor import Taylor, TaylorWork
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import Simulation
import numpy as np

_INSTANTS, _BATCH = 10, 8
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
        Of the row.
    hamiltonian : Hamiltonian
        Of both sides.
    start : np.ndarray, shape (2 d,)
        (q, p).
    duration, wanted : float
        T [s], and the largest error of a component.
    system : list of tuple or None
        Equations of heyoka; None: from the formula.
    compact : bool
        Whether heyoka writes loops: of networks it would compile for minutes.

    """

    name: str
    hamiltonian: Hamiltonian
    start: np.ndarray
    duration: float
    wanted: float
    system: Any = None
    compact: bool = False

    def ours(self, method: Any, steps: int, instants: int = _INSTANTS
             ) -> Callable[[], np.ndarray]:
        """Return a run of so many steps between instants; of the path (instants, 2 d)."""
        simulation = Simulation(self.hamiltonian, method, self.duration / (instants * steps),
                                *np.split(self.start, 2), on_failure='stop')
        begin = simulation.snapshot()

        def run() -> np.ndarray:
            simulation.restore(begin)
            return np.hstack(simulation.record(instants, steps))
        return run

    def theirs(self, tolerance: float, lanes: int = 1, instants: int = _INSTANTS
               ) -> Callable[[], np.ndarray]:
        """Return a run of heyoka, of one or several copies; of the path (instants, 2 d)."""
        if self.system is None:
            series = TaylorWork(tolerance).series(self.hamiltonian.kernel, lanes)
        else:
            kind = heyoka.taylor_adaptive_batch if lanes > 1 else heyoka.taylor_adaptive
            shape = (self.start.size, lanes) if lanes > 1 else self.start.size
            series = kind(self.system, np.zeros(shape), tol=tolerance,
                          compact_mode=self.compact)

        def run() -> np.ndarray:
            series.state[:] = self.start[:, None] if lanes > 1 else self.start
            series.set_time(0.0) if lanes > 1 else setattr(series, 'time', 0.0)
            path = np.empty((instants, self.start.size))
            for k in range(instants):
                series.propagate_until((k + 1) * self.duration / instants)
                path[k] = series.state[:, 0] if lanes > 1 else series.state
            return path
        return run


def cases() -> Iterator[Case]:
    """Yield what is measured."""
    (x, y, p_x, p_y), (q, p) = heyoka.make_vars('x', 'y', 'px', 'py'), heyoka.make_vars('q', 'p')
    pull = (x ** 2 + y ** 2) ** -1.5
    kepler = [(x, p_x), (y, p_y), (p_x, -x * pull), (p_y, -y * pull)]
    orbit = np.array([0.4, 0.0, 0.0, 2.0])
    for duration in (100.0, 1000.0):
        yield Case('Kepler', HAMILTONIANS['kepler'](), orbit, duration, 1e-9, kepler)
    yield Case('pendulum', HAMILTONIANS['pendulum'](), np.array([1.5, 0.0]), 1000.0, 1e-9,
               [(q, p), (p, -9.81 * heyoka.sin(q))])
    yield Case('Hénon-Heiles', HAMILTONIANS['henon_heiles'](), np.array([0.0, 0.1, 0.45, 0.0]),
               100.0, 1e-9, [(x, p_x), (y, p_y), (p_x, -x - 2.0 * x * y),
                             (p_y, -y - x ** 2 + y ** 2)])
    yield Case('double pendulum', HAMILTONIANS['double_pendulum'](),
               np.array([1.0, 0.5, 0.0, 0.0]), 10.0, 1e-6)
    arm = load_scene('two_joint_arm')
    yield Case('two-joint arm', arm.create_hamiltonian(),
               np.concatenate([arm.initial_state.q, arm.initial_state.p]), 10.0, 1e-6)
    learned = load_scene('pendulum')
    network = learned.create_hamiltonian()
    yield Case('learned pendulum', network,
               np.concatenate([learned.initial_state.q, learned.initial_state.p]), 100.0, 1e-8,
               _network(network, [q, p]), compact=True)


def _network(hamiltonian: Any, variables: list[Any]) -> Any:
    """Return the equations of a learned H, by heyoka's own networks."""
    weights, biases = hamiltonian.checkpoint.networks['energy']
    numbers = np.concatenate([*(w.ravel() for w in weights), *(b.ravel() for b in biases)])
    (energy,) = heyoka.model.ffnn(
        variables, [len(b) for b in biases[:-1]], 1,
        [heyoka.tanh] * (len(biases) - 1) + [lambda x: x], list(numbers))
    d = len(variables) // 2
    return heyoka.hamiltonian(energy, variables[:d], variables[d:])


def rows(settings: Settings) -> Iterator[Row]:
    """Measure formulas, then each motion, alone and in a batch, and by the integrator taylor."""
    yield from by_hand.rows(settings)
    for case in cases():
        settings.say(f'{case.name}, T = {case.duration:g}')
        true = case.theirs(1e-16)()
        choices = list(_choices(case, true))
        tolerance = next(tolerance for tolerance in _TOLERANCES
                         if np.abs(case.theirs(tolerance)() - true).max() <= case.wanted)
        alone, batch = case.theirs(tolerance), case.theirs(tolerance, _BATCH)
        name = f'{case.name}, T = {case.duration:g} s, path error {case.wanted:g}'
        best = min(choices)[1:] if choices else None
        runs = [alone, batch]
        if best:
            runs.append(case.ours(INTEGRATORS[best[0]](), best[1]))
        through = not Taylor().refusal(case.hamiltonian)
        if through:
            # In one call each, as both are used where the end is wanted, or a dense output.
            runs += [case.theirs(tolerance, 1, 1), case.ours(Taylor(tolerance), 1, 1)]
        times = interleave([lambda run=run: run for run in runs], settings.repetitions)
        times /= case.duration
        if best:
            h = case.duration / (_INSTANTS * best[1])
            for peer, column, share in (('heyoka', 0, 1.0), (f'heyoka, {_BATCH} at once', 1,
                                                             1.0 / _BATCH)):
                yield compare(f'{name}: {peer}', times[:, 2], share * times[:, column],
                              target=None, scale=1e6, unit='us/s', peer_name='heyoka',
                              note=f'ours: {best[0]}, h = {h:.3g}; tolerance {tolerance:.2g}')
        if through:
            yield compare(f'{name}: taylor in a scene', times[:, -1], times[:, -2],
                          target=1.3 if case.duration >= 1000.0 else None, scale=1e6,
                          unit='us/s', peer_name='heyoka', note=f'tolerance {tolerance:.2g}')


def _choices(case: Case, true: np.ndarray) -> Iterator[tuple[float, str, int]]:
    """Yield the time of the longest steps of each method that keep to the error [s]."""
    for method in _METHODS:
        for h in _STEPS:
            steps = max(1, round(case.duration / (_INSTANTS * h)))
            run = case.ours(INTEGRATORS[method](), steps)
            start = time.process_time()
            try:
                error = np.abs(run() - true).max()
            except StepFailure:
                continue
            if error <= case.wanted:
                yield min(_seconds(run) for _ in range(3)), method, steps
                break
            if time.process_time() - start > 0.3:
                break


def _seconds(run: Callable[[], object]) -> float:
    start = time.process_time()
    run()
    return time.process_time() - start
