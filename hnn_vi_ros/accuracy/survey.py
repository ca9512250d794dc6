# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Survey of a whole path: how short steps must be, how strong forces and energies are."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
import math

from hnn_vi_ros.accuracy.energy_scale import energy_scale
from hnn_vi_ros.accuracy.trials import InitialValueProblem, parts_for, time_scale
from hnn_vi_ros.errors import CalibrationError, StepFailure, UnsupportedSystem
from hnn_vi_ros.simulation import Simulation
import numpy as np

# What surveys a path: the first of these that takes H and the effects. The calibration takes those
# among which it chooses; the others are for rotations, and for coordinates that are not canonical.
SURVEYORS = ('gauss16', 'gauss4', 'generalized_leapfrog', 'stormer_verlet', 'variational_euler')
EVERY_SURVEYOR = (*SURVEYORS, 'lie_gauss16', 'lie_leapfrog', 'rk4')
# A path is resolved when half the step changes none of its figures by more than this share; and
# where energy is conserved, when its error is below this share of its scale.
_AGREED = 0.1
_HALVINGS, _CHUNK = 24, 512
# States by which energies are weighed.
_SAMPLES = 4000


@dataclass(frozen=True)
class PathSurvey:
    """
    The figures of a path.

    Parameters
    ----------
    method : str
        What surveyed it.
    step_size : float
        The longest of its steps that resolve the path [s].
    extent : float
        How far it went, at most up to the horizon [s].
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


def survey(problem: InitialValueProblem, horizon: float, base: float,
           surveyors: Sequence[str] = SURVEYORS) -> PathSurvey:
    """
    Follow a path with ever shorter steps until its figures are known.

    Parameters
    ----------
    problem : InitialValueProblem
        The problem to simulate.
    horizon : float
        How far, if gradients allow [s].
    base : float
        A time that the steps divide [s].
    surveyors : sequence of str, optional
        Methods; the first that fits is taken.

    Raises
    ------
    CalibrationError
        No step is short enough.
    UnsupportedSystem
        No method takes the effects.

    """
    method = _surveyor(problem, base, surveyors)
    parts = parts_for(base / min(base, time_scale(problem)))
    before, failure = None, None
    for _ in range(_HALVINGS):
        try:
            found, error = _follow(problem, method, base / parts, horizon)
        except StepFailure as problem_of_step:
            found, failure = None, problem_of_step
        if found and before and error <= _AGREED and _agree(found, before):
            return found
        before, parts = found, 2 * parts
    reason = failure or 'its figures change with each shorter step'
    raise CalibrationError(f'no step of {method} down to {2.0 * base / parts:.2g} s resolves the '
                           f'path: {reason}')


def _surveyor(problem: InitialValueProblem, base: float, surveyors: Sequence[str]) -> str:
    refusal = None
    for method in surveyors:
        try:
            problem.simulation(method, base)
        except UnsupportedSystem as problem_of_method:
            refusal = refusal or problem_of_method
        except StepFailure as failure:
            raise CalibrationError(str(failure)) from failure
        else:
            return method
    raise refusal or UnsupportedSystem('no method can follow the path')


def _follow(problem: InitialValueProblem, method: str, h: float, horizon: float
            ) -> tuple[PathSurvey, float]:
    """Return the figures by steps of one size, and the energy's error over its scale."""
    simulation = problem.simulation(method, h)
    states = np.concatenate(list(_states(problem, simulation, horizon)))
    # A rotation has one column less in p than in q.
    q, p = np.split(states, [problem.q.size], axis=1)
    hamiltonian = simulation.hamiltonian
    every = math.ceil(len(q) / _SAMPLES)
    scale = energy_scale(hamiltonian, q[::every], p[::every]) or 1.0
    dH_dq, _ = hamiltonian.gradient(q, p)
    forces = np.linalg.norm(dH_dq, axis=1)
    error = 0.0
    if simulation.conservative:
        energy = hamiltonian.energy(q, p)
        error = float(np.abs(energy - energy[0]).max()) / scale
    return PathSurvey(method, h, simulation.time, scale, float(np.median(forces)),
                      float(forces.max())), error


def _states(problem: InitialValueProblem, simulation: Simulation, horizon: float
            ) -> Iterator[np.ndarray]:
    """Yield the initial state and those after each step, rows of (q, p)."""
    yield np.concatenate([problem.q, problem.p])[None]
    while simulation.time < horizon * (1.0 - 1e-9) and simulation.gradients < problem.gradients:
        left = math.ceil((horizon - simulation.time) / simulation.step_size * (1.0 - 1e-9))
        yield np.hstack(simulation.record(min(_CHUNK, max(left, 1)), 1))


def _agree(one: PathSurvey, other: PathSurvey) -> bool:
    pairs = [(one.energy_scale, other.energy_scale), (one.force, other.force),
             (one.strongest, other.strongest)]
    return all(abs(a - b) <= _AGREED * max(a, b) for a, b in pairs)
