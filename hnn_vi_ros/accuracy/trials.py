# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Runs that measure the error and the cost of a method at one step size, counted in gradients."""

from collections.abc import Mapping
from dataclasses import dataclass, field
import math
from typing import Any, Protocol

from hnn_vi_ros.effects.base import Effect
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.integrators.base import Integrator
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.simulation import Simulation
import numpy as np

# Gradients that a run may take, of an H whose kernel holds few numbers; of one whose gradient is
# plain Python. A network's gradient takes time in proportion to its weights.
_GRADIENTS, _WEIGHTS, _PLAIN = 3_000_000, 2000, 20_000
# States of a run that are looked at, and those looked at together.
_SAMPLES, _CHUNK = 20_000, 250
# The same where effects do work, whose sum must be asked for at each of them.
_SAMPLES_OF_WORK = 2000
# An error that is this many times what is allowed need not be known better.
ENOUGH = 1e3
# From each to the next by a quarter: a step divides its base into such a number of parts.
_PARTS = sorted({k * 2 ** e for e in range(40) for k in (4, 5, 6)} | {1, 2, 3})


@dataclass(frozen=True)
class Tolerance:
    """
    The error that a simulation may make.

    Parameters
    ----------
    kind : str
        ``'energy_error'``, abs(H - H0 - W) over the energy scale of the path; or
        ``'path_error'``, the largest deviation of a coordinate or momentum from the exact path.
    error : float
        The largest that is allowed.
    horizon : float
        Until when it must hold [s].
    energy_scale : float or None
        That of the path, to which energy errors are relative [J]; None before it was surveyed.

    """

    kind: str
    error: float
    horizon: float
    energy_scale: float | None = None


@dataclass(frozen=True)
class Method:
    """
    A method with its arguments, as a scene names it.

    Parameters
    ----------
    kind : str
        A name of INTEGRATORS.
    arguments : mapping
        Those of its constructor.

    """

    kind: str
    arguments: Mapping[str, Any] = field(default_factory=dict)

    def create(self) -> Integrator:
        """Return the integrator."""
        return INTEGRATORS[self.kind](**self.arguments)

    def __str__(self) -> str:
        inside = ', '.join(f'{key} {value:.3g}' if isinstance(value, float) else f'{key} {value}'
                           for key, value in self.arguments.items())
        return f'{self.kind} ({inside})' if inside else self.kind


@dataclass(frozen=True)
class InitialValueProblem:
    """
    Problem to simulate: H, effects, and the initial state of shape (d,).

    Parameters
    ----------
    hamiltonian : Hamiltonian
        H.
    effects : tuple of Effect
        Effects in addition to H.
    q, p : np.ndarray, shape (d,)
        The initial state.

    """

    hamiltonian: Hamiltonian
    effects: tuple[Effect, ...]
    q: np.ndarray
    p: np.ndarray

    def simulation(self, method: str | Method, h: float) -> Simulation:
        """Return a simulation of it that stops at the first step that fails."""
        if isinstance(method, str):
            method = Method(method)
        return Simulation(self.hamiltonian, method.create(), h, self.q, self.p, self.effects,
                          'stop')

    @property
    def gradients(self) -> int:
        """Return how many gradients a run may take: the same on every machine, at any time."""
        kernel = self.hamiltonian.kernel
        if not kernel.compiled:
            return _PLAIN
        return round(_GRADIENTS / (1.0 + _numbers(kernel) / _WEIGHTS))


def _numbers(kernel: Kernel) -> int:
    """Return how many numbers the arrays of a kernel hold."""
    found, rest = 0, list(kernel.parameters)
    while rest:
        part = rest.pop()
        if isinstance(part, tuple):
            rest.extend(part)
        found += part.size if isinstance(part, np.ndarray) else 0
    return found


@dataclass(frozen=True)
class Trial:
    """
    One method at one step.

    Parameters
    ----------
    error : float
        In the measure of the tolerance, at the horizon; infinity where a step failed.
    checked : float
        Simulated time that was seen [s].
    cost : float
        Gradients for each simulated second [1/s].
    complete : bool
        Whether it was seen as long as it must be.
    dear : bool
        Whether it was not since it cost too much; or it failed, or erred too far.

    """

    error: float
    checked: float
    cost: float
    complete: bool = True
    dear: bool = False


FAILED = Trial(math.inf, 0.0, math.inf, False)


class Judge(Protocol):
    """
    Judge of a simulation: takes it up to a horizon and returns the size of its error.

    Attributes
    ----------
    tolerance : Tolerance
        What must be held.
    known : float
        What of its error is the reference's.

    """

    tolerance: Tolerance
    known: float

    def __call__(self, simulation: Simulation, bound: float, /) -> Trial:
        """Return what a simulation shows; it is given up where it costs more than the bound."""


def parts_for(wish: float) -> int:
    """Return the number of parts that a base is divided into, at least as many as wished for."""
    return next((k for k in _PARTS if k >= wish), _PARTS[-1])


def parts_between(low: int, high: float) -> list[int]:
    """Return the numbers of parts that are larger than one and smaller than another."""
    return [k for k in _PARTS if low < k < high]


def time_scale(problem: InitialValueProblem) -> float:
    """Return a time in which the initial state changes by about its size [s]."""
    q, p = problem.q, problem.p
    dH_dq, dH_dp = problem.hamiltonian.gradient(q, p)
    size = max(np.abs(q).max(), np.abs(p).max())
    speed = max(np.abs(dH_dq).max(), np.abs(dH_dp).max())
    return float(size / speed) if size > 0.0 and speed > 0.0 else 1.0


class EnergyJudge:
    """
    Measure abs(H - H0 - W) over an energy scale.

    Parameters
    ----------
    problem : InitialValueProblem
        The problem to simulate.
    tolerance : Tolerance
        What must be held.
    scale : float
        The energy scale of the path [J].
    extent : float
        Simulated time that must be seen, at most the horizon [s].

    """

    def __init__(self, problem: InitialValueProblem, tolerance: Tolerance, scale: float,
                 extent: float):
        self._limit, self._scale, self._extent = problem.gradients, scale, extent
        self.tolerance, self.known = tolerance, 0.0
        self._conservative = all(effect.conservative for effect in problem.effects)

    def __call__(self, simulation: Simulation, bound: float) -> Trial:
        """Run up to the horizon, as far as gradients allow; see Trial."""
        h = simulation.step_size
        steps = math.ceil(self.tolerance.horizon / h * (1.0 - 1e-12))
        every = math.ceil(steps / (_SAMPLES if self._conservative else _SAMPLES_OF_WORK))
        count = math.ceil(steps / every)
        most = min(4.0 * self._limit, bound * self._extent)
        start = simulation.energy
        errors: list[float] = []
        while simulation.steps < every * count:
            try:
                errors.append(self._next(simulation, every, count, start))
            except StepFailure:
                return FAILED
            cost = simulation.gradients / simulation.time
            dear = simulation.gradients > most and simulation.time < self._extent
            if dear or max(errors) > ENOUGH * self.tolerance.error:
                return Trial(max(errors), simulation.time, cost, False, dear)
            if simulation.gradients > self._limit and simulation.time >= self._extent:
                break
        return Trial(carried(errors, simulation.time, self.tolerance.horizon, 0.0),
                     simulation.time, cost)

    def _next(self, simulation: Simulation, every: int, count: int, start: float) -> float:
        """Return the largest error of the next samples."""
        if not self._conservative:
            simulation.advance(every)
            return abs(simulation.energy_balance) / self._scale
        more = min(_CHUNK, count - simulation.steps // every)
        energy = simulation.hamiltonian.energy(*simulation.record(more, every))
        return float(np.abs(energy - start).max()) / self._scale


def carried(errors: list[float], t: float, horizon: float, least: float) -> float:
    """
    Return the largest of errors that grew until t, carried on to the horizon as they grew.

    Parameters
    ----------
    errors : list of float
        In the order of time.
    t, horizon : float
        Until when they were seen, and are wanted [s].
    least : float
        The least exponent: 0 where errors are bounded, 1 where phases part.

    """
    worst, early = max(errors), max(errors[:(len(errors) + 1) // 2])
    if horizon <= t * (1.0 + 1e-9) or worst == 0.0:
        return worst
    growth = worst / max(early, 1e-300)
    if growth > 4.0:
        # Faster than quadratically in time: exponentially, as where the motion is chaotic.
        return worst * math.exp(min(math.log(growth) * (horizon - t) / (0.5 * t), 500.0))
    return worst * (horizon / t) ** max(math.log2(growth), least)
