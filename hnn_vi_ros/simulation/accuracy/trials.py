# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Initial value problem of trials, the work of methods, and the survey of the path."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
import math
from typing import Any

from hnn_vi_ros.effects import Effect
from hnn_vi_ros.errors import CalibrationError, StepFailure, UnsupportedSystem
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators import Integrator, INTEGRATORS
from hnn_vi_ros.kernels import Kernel
from hnn_vi_ros.simulation.accuracy.diagnostics import energy_scale
from hnn_vi_ros.simulation.simulation import Simulation
import numpy as np

# Time that step sizes divide, as a share of the horizon, without a sampling interval.
BASE_SHARE = 0.1
# Allowed numbers of steps per base, with ratios of 5 / 4, 6 / 5 and 4 / 3 from 4 on.
_PARTS = sorted({k * 2 ** e for e in range(40) for k in (4, 5, 6)} | {1, 2, 3})


@dataclass(frozen=True)
class Tolerance:
    """
    The largest allowed error of a simulation.

    Parameters
    ----------
    kind : str
        ``'energy_error'``, abs(H - H0 - W) over the energy scale of the path; or
        ``'path_error'``, the largest deviation of a coordinate or momentum from the exact path.
    error : float
        The largest allowed error.
    horizon : float
        Time up to which it must hold [s].
    energy_scale : float or None
        Energy scale of the path, for relative energy errors [J]; None before the survey.

    """

    kind: str
    error: float
    horizon: float
    energy_scale: float | None = None


@dataclass(frozen=True)
class Method:
    """
    A method with its arguments, as in a scene.

    Parameters
    ----------
    kind : str
        A key of INTEGRATORS.
    arguments : mapping
        Arguments of its constructor.

    """

    kind: str
    arguments: Mapping[str, Any] = field(default_factory=dict)

    def create(self) -> Integrator:
        """Return the integrator."""
        return INTEGRATORS[self.kind](**self.arguments)

    @property
    def tolerance(self) -> float | None:
        """Return the tolerance of an adaptive method; None for others."""
        names = INTEGRATORS[self.kind].tolerances
        return self.arguments.get(names[0]) if names else None

    @property
    def useful_tolerances(self) -> tuple[float, float]:
        """Return the smallest and the largest useful tolerance; zeros if it takes none."""
        return INTEGRATORS[self.kind].useful_tolerances

    def within(self, tolerance: float) -> 'Method':
        """Return the adaptive method with all its tolerances replaced."""
        names = INTEGRATORS[self.kind].tolerances
        return replace(self, arguments={**self.arguments, **dict.fromkeys(names, tolerance)})

    @property
    def family(self) -> str:
        """Return the name with the arguments other than tolerances."""
        names = INTEGRATORS[self.kind].tolerances
        return str(replace(self, arguments={
            key: value for key, value in self.arguments.items() if key not in names}))

    def __str__(self) -> str:
        inside = ', '.join(f'{key} {value:.3g}' if isinstance(value, float) else f'{key} {value}'
                           for key, value in self.arguments.items())
        return f'{self.kind} ({inside})' if inside else self.kind


@dataclass(frozen=True)
class InitialValueProblem:
    """
    Problem to simulate: H, effects, and initial state of shape (d,).

    Parameters
    ----------
    hamiltonian : Hamiltonian
        The Hamiltonian H.
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
        """Return a simulation of the problem that stops at the first failed step."""
        if isinstance(method, str):
            method = Method(method)
        return Simulation(self.hamiltonian, method.create(), h, self.q, self.p, self.effects,
                          'stop')

    @property
    def gradients(self) -> int:
        """Return the maximum number of gradients of a run; machine-independent."""
        kernel = self.hamiltonian.kernel
        if not kernel.compiled:
            return _MAX_PYTHON_GRADIENTS
        return round(_MAX_GRADIENTS / (1.0 + _numbers(kernel) / _HALVING_SIZE))


@dataclass(frozen=True)
class CalibrationTask:
    """
    Problem to simulate within a tolerance.

    Parameters
    ----------
    problem : InitialValueProblem
        The problem to simulate.
    tolerance : Tolerance
        The tolerance to meet.
    largest_step : float or None
        Time that the step size must divide [s], such as the sampling interval.

    """

    problem: InitialValueProblem
    tolerance: Tolerance
    largest_step: float | None = None

    @property
    def base(self) -> float:
        """Return the time that step sizes divide [s]: by default a tenth of the horizon."""
        return self.largest_step or BASE_SHARE * self.tolerance.horizon


def _numbers(kernel: Kernel) -> int:
    """Return the total number of entries in the arrays of a kernel."""
    found, rest = 0, list(kernel.parameters)
    while rest:
        part = rest.pop()
        if isinstance(part, tuple):
            rest.extend(part)
        found += part.size if isinstance(part, np.ndarray) else 0
    return found


def work(simulation: Simulation) -> float:
    """
    Return the work of a run so far, in gradients: evaluated gradients plus step overhead.

    A gradient of nanoseconds is cheaper than the rest of an implicit step.
    """
    kernel = simulation.hamiltonian.kernel
    gradient = _PYTHON_TIME if not kernel.compiled else (
        _GRADIENT_TIME * (1.0 + _numbers(kernel) / _DOUBLING_SIZE))
    fixed, more = simulation.integrator.own_times(kernel)
    return simulation.gradients * (1.0 + more / gradient) + simulation.steps * fixed / gradient


def parts_for(wish: float) -> int:
    """Return the smallest allowed number of steps per base that is at least `wish`."""
    return next((k for k in _PARTS if k >= wish), _PARTS[-1])


def parts_between(low: int, high: float) -> list[int]:
    """Return the allowed numbers of steps per base between two bounds, both excluded."""
    return [k for k in _PARTS if low < k < high]


def time_scale(hamiltonian: Hamiltonian, q: np.ndarray, p: np.ndarray, t: float = 0.0) -> float:
    """Return the time in which a state (q, p) at time t [s] changes by about its size [s]."""
    dH_dq, dH_dp = hamiltonian.gradient(q, p, t)
    size = max(np.abs(q).max(), np.abs(p).max())
    speed = max(np.abs(dH_dq).max(), np.abs(dH_dp).max())
    return float(size / speed) if size > 0.0 and speed > 0.0 else 1.0


def carried(errors: list[float], t: float, horizon: float, least: float) -> float:
    """
    Return the largest error, extrapolated from t to the horizon by its observed growth.

    Parameters
    ----------
    errors : list of float
        Errors in the order of time.
    t, horizon : float
        Times up to which errors were measured and are extrapolated [s].
    least : float
        Minimum exponent of the growth: 0 for bounded errors, 1 for phase errors.

    """
    worst, early = max(errors), max(errors[:(len(errors) + 1) // 2])
    if horizon <= t * (1.0 + 1e-9) or worst == 0.0:
        return worst
    growth = worst / max(early, 1e-300)
    if growth > 4.0:
        # Growth faster than quadratic is taken as exponential, as in chaotic motion.
        return worst * math.exp(min(math.log(growth) * (horizon - t) / (0.5 * t), 500.0))
    return worst * (horizon / t) ** max(math.log2(growth), least)


# Methods that survey a path; the first that supports H and the effects is used. The last three are
# for rotations and for non-canonical coordinates.
SURVEYORS = ('gauss16', 'gauss4', 'generalized_leapfrog', 'stormer_verlet', 'variational_euler',
             'lie_gauss16', 'lie_leapfrog', 'rk4')
# A path is resolved if halving the step changes each figure by at most this share and, for
# conserved energy, if the energy error is at most this share of its scale.
_MAX_DISAGREEMENT = 0.1
_MAX_HALVINGS, _SURVEY_CHUNK = 24, 512
# Approximate number of states used for the energy scale.
_SURVEY_SAMPLES = 4000


@dataclass(frozen=True)
class PathSurvey:
    """
    Characteristic figures of a path.

    Parameters
    ----------
    method : str
        Method used for the survey.
    step_size : float
        The longest of its step sizes that resolve the path [s].
    extent : float
        End of the surveyed path, at most the horizon [s].
    energy_scale : float
        See ``energy_scale`` [J].
    force, strongest : float
        Median over time, and maximum, of abs(H_q) [N, or N m for angles].

    """

    method: str
    step_size: float
    extent: float
    energy_scale: float
    force: float
    strongest: float


def survey(problem: InitialValueProblem, horizon: float, base: float) -> PathSurvey:
    """
    Simulate a path with decreasing step sizes until its characteristic figures converge.

    Parameters
    ----------
    problem : InitialValueProblem
        The problem to simulate.
    horizon : float
        End of the path, if the limit of gradients allows [s].
    base : float
        Time that step sizes divide [s].

    Raises
    ------
    CalibrationError
        No step is short enough.
    UnsupportedSystem
        No method supports the effects.

    """
    method = _surveyor(problem, base)
    scale = time_scale(problem.hamiltonian, problem.q, problem.p)
    parts = parts_for(base / min(base, scale))
    before, failure = None, None
    for _ in range(_MAX_HALVINGS):
        try:
            found, error = _follow(problem, method, base / parts, horizon)
        except StepFailure as problem_of_step:
            found, failure = None, problem_of_step
        if found and before and error <= _MAX_DISAGREEMENT and _agree(found, before):
            return found
        before, parts = found, 2 * parts
    reason = failure or 'the results change with each smaller step_size'
    raise CalibrationError(f'no step_size of {method} down to {2.0 * base / parts:.2g} s resolves '
                           f'the path: {reason}')


def _surveyor(problem: InitialValueProblem, base: float) -> str:
    refusal = None
    for method in SURVEYORS:
        try:
            problem.simulation(method, base)
        except UnsupportedSystem as problem_of_method:
            refusal = refusal or problem_of_method
        except StepFailure as failure:
            raise CalibrationError(str(failure)) from failure
        else:
            return method
    raise refusal or UnsupportedSystem('no method supports this problem')


def _follow(problem: InitialValueProblem, method: str, h: float, horizon: float
            ) -> tuple[PathSurvey, float]:
    """Return the figures at one step size, and the relative energy error."""
    simulation = problem.simulation(method, h)
    states = np.concatenate(list(_states(problem, simulation, horizon)))
    # For a rotation, p has one column less than q.
    q, p = np.split(states, [problem.q.size], axis=1)
    hamiltonian, t = simulation.hamiltonian, h * np.arange(len(q))
    every = math.ceil(len(q) / _SURVEY_SAMPLES)
    scale = energy_scale(hamiltonian, q[::every], p[::every], t[::every]) or 1.0
    dH_dq, _ = hamiltonian.gradient(q, p, t)
    forces = np.linalg.norm(dH_dq, axis=1)
    error = 0.0
    if simulation.conservative:
        energy = hamiltonian.energy(q, p)
        error = float(np.abs(energy - energy[0]).max()) / scale
    return PathSurvey(method, h, simulation.time, scale, float(np.median(forces)),
                      float(forces.max())), error


def _states(problem: InitialValueProblem, simulation: Simulation, horizon: float
            ) -> Iterator[np.ndarray]:
    """Yield the initial state and the states after each step, as rows of (q, p)."""
    yield np.concatenate([problem.q, problem.p])[None]
    while simulation.time < horizon * (1.0 - 1e-9) and simulation.gradients < problem.gradients:
        left = math.ceil((horizon - simulation.time) / simulation.step_size * (1.0 - 1e-9))
        yield np.hstack(simulation.record(min(_SURVEY_CHUNK, max(left, 1)), 1))


def _agree(one: PathSurvey, other: PathSurvey) -> bool:
    pairs = [(one.energy_scale, other.energy_scale), (one.force, other.force),
             (one.strongest, other.strongest)]
    return all(abs(a - b) <= _MAX_DISAGREEMENT * max(a, b) for a, b in pairs)


# Maximum number of gradients of a run for a kernel with few parameters; number of parameters
# that halves it, since a network's gradient time is proportional to its weights; and maximum
# number for gradients in plain Python.
_MAX_GRADIENTS, _HALVING_SIZE, _MAX_PYTHON_GRADIENTS = 3_000_000, 2000, 20_000
# Time of a compiled gradient [s], number of parameters that doubles it, and time in Python [s].
_GRADIENT_TIME, _DOUBLING_SIZE, _PYTHON_TIME = 1e-8, 40, 2e-5
