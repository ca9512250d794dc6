# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Short runs that measure the error and the cost of a method at one step size."""

from collections.abc import Callable
from dataclasses import dataclass
import math
import time

from hnn_vi_ros.effects.base import Effect
from hnn_vi_ros.errors import CalibrationError
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.simulation import Simulation
import numpy as np

# Wall time of the reference's run [s]; samples of a trial, instants of a path.
_REFERENCE, _SAMPLES, INSTANTS = 1.0, 1000, 10
# Times in which the state changes by its size, that a trial must see.
_LEAST = 20.0
# From each to the next by a tenth to a third: a step divides its base into such a number of parts.
_PARTS = sorted({round(k * 2.0 ** e) for e in range(40) for k in (4, 5, 6, 7)} | {1, 2, 3})


@dataclass(frozen=True)
class Budget:
    """
    The error that a simulation may make.

    Parameters
    ----------
    kind : str
        ``'energy_error'``, abs(H - H0 - W) over abs(H0), or [J] where H0 is zero; or
        ``'path_error'``, the largest deviation of a coordinate or momentum from the exact path.
    error : float
        The largest that is allowed.
    horizon : float
        Until when it must hold [s].

    """

    kind: str
    error: float
    horizon: float


@dataclass(frozen=True)
class Problem:
    """
    What is simulated: H, effects, and the initial state of shape (d,).

    Parameters
    ----------
    hamiltonian : Hamiltonian
        H.
    effects : tuple of Effect
        What acts beside it.
    q, p : np.ndarray, shape (d,)
        The initial state.

    """

    hamiltonian: Hamiltonian
    effects: tuple[Effect, ...]
    q: np.ndarray
    p: np.ndarray

    def simulation(self, method: str, h: float) -> Simulation:
        """Return a simulation of it."""
        return Simulation(self.hamiltonian, INTEGRATORS[method](), h, self.q, self.p, self.effects)


@dataclass(frozen=True)
class Trial:
    """One method at one step: its error at the horizon, over what time seen, at what cost."""

    error: float
    checked: float
    cost: float


UNAFFORDABLE = Trial(math.inf, 0.0, math.inf)
Judge = Callable[[Simulation, float], Trial]


def parts_for(wish: float) -> int:
    """Return the number of parts that a base is divided into, at least as many as wished for."""
    return next((k for k in _PARTS if k >= wish), _PARTS[-1])


def time_scale(problem: Problem) -> float:
    """Return a time in which the state changes by about its size [s]."""
    q, p = problem.q, problem.p
    dH_dq, dH_dp = problem.hamiltonian.gradient(q, p)
    size = max(np.abs(q).max(), np.abs(p).max())
    speed = max(np.abs(dH_dq).max(), np.abs(dH_dp).max())
    return float(size / speed) if size > 0.0 and speed > 0.0 else 1.0


def energy_judge(problem: Problem, budget: Budget) -> Judge:
    """Return what measures abs(H - H0 - W) relative to abs(H0), over a thousand samples."""
    def judge(simulation: Simulation, wall: float) -> Trial:
        steps = _affordable(problem, simulation, budget.horizon, wall)
        if steps * simulation.step_size < min(budget.horizon, _LEAST * time_scale(problem)):
            return UNAFFORDABLE
        size = abs(simulation.energy) or 1.0
        every, error, costs = math.ceil(steps / _SAMPLES), 0.0, []
        for _ in range(math.ceil(steps / every)):
            start = time.perf_counter()
            simulation.advance(every)
            costs.append(time.perf_counter() - start)
            error = max(error, abs(simulation.budget) / size)
        # The median: whatever else the machine does hits some of the batches.
        each = float(np.median(costs)) / every
        return Trial(error, simulation.time, each / simulation.step_size)
    return judge


def path_judge(problem: Problem, budget: Budget, base: float) -> Judge:
    """Return what measures the distance from a reference, which is computed first."""
    times, reference = _reference(problem, budget, base)

    def judge(simulation: Simulation, wall: float) -> Trial:
        affordable = _affordable(problem, simulation, times[-1] * base, wall)
        parts, errors, costs = round(base / simulation.step_size), [], []
        count = int(np.searchsorted(times * parts, affordable, 'right'))
        if count < 2:
            # Too slow to be the cheapest, and too little to tell how the error grows.
            return UNAFFORDABLE
        for k in range(count):
            start, steps = time.perf_counter(), int(times[k] - (times[k - 1] if k else 0)) * parts
            simulation.advance(steps)
            costs.append((time.perf_counter() - start) / (steps * simulation.step_size))
            z = np.concatenate([simulation.q, simulation.p])
            errors.append(float(np.abs(z - reference[k]).max()))
        carried = _carried(errors, simulation.time, budget.horizon)
        return Trial(carried, simulation.time, float(np.median(costs)))
    return judge


def _carried(errors: list[float], t: float, horizon: float) -> float:
    """Return the largest of errors that grew until t, carried on to the horizon."""
    worst, early = max(errors), max(errors[:(len(errors) + 1) // 2])
    if horizon <= t or worst == 0.0:
        return worst
    growth = worst / max(early, 1e-300)
    if growth > 4.0:
        # Faster than quadratically in time: exponentially, as where the motion is chaotic.
        return worst * math.exp(min(math.log(growth) * (horizon - t) / (0.5 * t), 500.0))
    return worst * (horizon / t) ** max(math.log2(growth), 1.0)


def _reference(problem: Problem, budget: Budget, base: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Return ten times in units of the base, and the states there, shape (10, 2 d).

    Raises
    ------
    CalibrationError
        Halving the steps of the reference moves it by too much: the path is chaotic.

    """
    bases = max(round(budget.horizon / base), INSTANTS)
    parts = parts_for(base / (0.3 * time_scale(problem)))
    simulation = problem.simulation('gauss16', base / parts)
    affordable = _affordable(problem, simulation, bases * base, _REFERENCE) // parts
    bases = min(bases, max(affordable, INSTANTS))
    times = np.round(np.arange(1, INSTANTS + 1) * bases / INSTANTS).astype(int)
    previous, distance, last = None, math.inf, math.inf
    # As long as smaller steps bring two of them nearer.
    while previous is None or last is math.inf or distance < 0.5 * last:
        simulation = problem.simulation('gauss16', base / parts)
        states = []
        for gap in np.diff(times, prepend=0):
            simulation.advance(int(gap) * parts)
            states.append(np.concatenate([simulation.q, simulation.p]))
        if previous is not None:
            last, distance = distance, float(np.abs(np.array(states) - previous).max())
            if distance <= 0.05 * budget.error:
                return times, np.array(states)
        previous, parts = np.array(states), parts_for(1.6 * parts)
    raise CalibrationError(
        f'path_error {budget.error:g} up to {times[-1] * base:g} s: two references differ by '
        f'{distance:.2g} there, so the path cannot be known that well; the motion is chaotic or '
        'the error below round-off; take energy_error, a shorter horizon or a larger error')


def _affordable(problem: Problem, simulation: Simulation, horizon: float, wall: float) -> int:
    """Return how many steps up to the horizon fit into a wall time [s]; compiles the kernel."""
    simulation.compile()
    simulation.advance(1)
    start, probe = time.perf_counter(), 0
    while time.perf_counter() - start < 0.1 * wall:
        simulation.advance(8)
        probe += 8
    each = (time.perf_counter() - start) / probe
    simulation.restart(problem.q, problem.p)
    return max(1, min(round(horizon / simulation.step_size), int(wall / each)))
