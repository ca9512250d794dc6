# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Reference path of trials, and the time up to which it can be determined."""

from dataclasses import dataclass, replace
import math

from hnn_vi_ros.errors import CalibrationError, HnnViRosError, StepFailure
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.simulation.accuracy.neighbouring_motions import time_between_motions
from hnn_vi_ros.simulation.accuracy.trials import (
    CalibrationTask, InitialValueProblem, PathSurvey)
import numpy as np

# Number of instants at which paths are compared: minimum, maximum, and minimum for a slow H.
_MIN_INSTANTS, _MAX_INSTANTS, _MIN_SLOW_INSTANTS = 320, 2000, 40
_SLOW_LIMIT = 1_000_000
# Limit of the gradients of a reference, as a multiple of that of a trial.
PATIENCE = 6
# Target accuracy of a reference as a share of the tolerance, and the largest usable share.
_REFERENCE_ERROR_SHARE, _MAX_REFERENCE_ERROR_SHARE = 0.02, 0.5
# Number of refinements without progress after which round-off or chaos is assumed.
_MAX_ROUNDS_WITHOUT_PROGRESS = 3
# Largest relative error of a path that counts as verified.
_MAX_VERIFIED_ERROR = 1e-4
_EPS = float(np.finfo(np.float64).eps)
# Ratio of the numbers of steps of successive refinements.
_REFINEMENT_RATIO = 1.5
_CHUNK_SIZE = 20
# Minimum number of steps of the search for chaos.
_MIN_CHAOS_STEPS = 2 ** 14


@dataclass(frozen=True)
class Instants:
    """
    Equidistant times at which paths are compared, at multiples or fractions of a base.

    Parameters
    ----------
    base : float
        Time that step sizes divide [s].
    stride, density : int
        One instant every ``stride`` bases, or ``density`` per base; one of the two is 1.
    count : int
        Number of instants up to the horizon.

    """

    base: float
    stride: int
    density: int
    count: int

    @classmethod
    def of(cls, horizon: float, base: float, least: int = _MIN_INSTANTS) -> 'Instants':
        """Return instants that steps of base / 4, / 5, / 6, / 8, ... meet; see parts_for."""
        bases = max(1, round(horizon / base))
        if bases >= least:
            stride = math.ceil(bases / _MAX_INSTANTS)
            return cls(base, stride, 1, bases // stride)
        doublings = math.ceil(math.log2(least / bases))
        density = 15 * 2 ** doublings
        return cls(base, 1, density, bases * density)

    @property
    def gap(self) -> float:
        """Return the time between two instants [s]."""
        return self.base * self.stride / self.density

    def met(self, parts: int) -> tuple[int, int]:
        """Return steps of base / parts between instants they meet, and the stride of these."""
        if self.density == 1:
            return self.stride * parts, 1
        common = math.gcd(parts, self.density)
        return parts // common, self.density // common


@dataclass(frozen=True)
class PathReference:
    """
    A path determined as accurately as possible.

    Parameters
    ----------
    instants : Instants
        Instants up to the horizon.
    states : np.ndarray, shape (n, 2 d)
        (q, p) at the first n instants; 2 d - 1 columns for a rotation.
    accuracy : float
        Largest error: a bound for an exact formula, otherwise the largest difference from the
        previous refinement.
    how : str
        Description of the computation.

    """

    instants: Instants
    states: np.ndarray
    accuracy: float
    how: str

    @property
    def horizon(self) -> float:
        """Return the time of the last state, or the requested horizon without states [s]."""
        instants, count = self.instants, len(self.states) or self.instants.count
        return instants.base * instants.stride * count / instants.density

    @property
    def verified(self) -> bool:
        """Return whether the path is accurate enough to measure errors against it."""
        return self.accuracy <= _MAX_VERIFIED_ERROR * np.abs(self.states).max(initial=1e-300)


def find_reference(task: CalibrationTask, known: PathSurvey) -> PathReference:
    """
    Return the path, refined until two successive refinements agree.

    Parameters
    ----------
    task : CalibrationTask
        The problem, and the tolerance of the trials.
    known : PathSurvey
        Survey of the path.

    Raises
    ------
    CalibrationError
        Round-off, or chaos (as measured by the Lyapunov time), prevents the accuracy needed.

    """
    problem, tolerance = task.problem, task.tolerance
    limit = PATIENCE * problem.gradients
    # At least two instants, of 15 or more per base, in a step that resolves the path.
    finer = math.ceil(min(2.0 * tolerance.horizon / known.step_size / 15.0, _MAX_INSTANTS))
    instants = Instants.of(tolerance.horizon, task.base, max(_MIN_INSTANTS, finer)
                           if limit >= _SLOW_LIMIT else _MIN_SLOW_INSTANTS)
    best = refined_path(problem, instants, known, limit, _REFERENCE_ERROR_SHARE * tolerance.error)
    if best is None or best.accuracy > _MAX_REFERENCE_ERROR_SHARE * tolerance.error:
        raise CalibrationError(_refusal(task, known, best))
    return best


def best_reference(problem: InitialValueProblem, horizon: float, base: float, known: PathSurvey,
                   limit: float) -> PathReference:
    """
    Return the most accurate path: from an exact formula, or refined until it converges.

    Parameters
    ----------
    problem : InitialValueProblem
        The problem to simulate.
    horizon : float
        End of the path [s].
    base : float
        Time that step sizes divide [s].
    known : PathSurvey
        Survey of the path.
    limit : float
        Maximum number of gradients of a run; it may shorten the path.

    Returns
    -------
    PathReference
        The path; without states if none can be determined.

    """
    # Errors peak between few instants.
    instants = Instants.of(horizon, base, _MIN_INSTANTS if limit >= _SLOW_LIMIT else
                           _MIN_SLOW_INSTANTS)
    found = None
    # Random effects draw different numbers at each step size.
    if not any(effect.random for effect in problem.effects):
        found = exact_path(problem, instants) or refined_path(
            problem, instants, known, limit, shorten=False)
    if found is None:
        return PathReference(
            instants, np.empty((0, problem.q.size + problem.p.size)), math.inf, '')
    # Two refinements may agree by chance to the last, rounded digit.
    return replace(found, accuracy=max(found.accuracy, _EPS * np.abs(found.states).max()))


def exact_path(problem: InitialValueProblem, instants: Instants) -> PathReference | None:
    """Return the path of an exact formula; None if none is known or there are effects."""
    hamiltonian = problem.hamiltonian
    t = instants.gap * np.arange(1, instants.count + 1)
    motion = None if problem.effects else hamiltonian.exact_motion(problem.q, problem.p, t)
    if motion is None:
        return None
    # The phase has a rounding error of about two eps, and a value of one.
    speed = np.abs(hamiltonian.gradient(*np.split(motion.path, 2, axis=1))).max()
    rounding = _EPS * (np.abs(motion.path).max() + 2.0 * motion.condition * speed * t[-1])
    return PathReference(instants, motion.path, float(rounding), f'exact: {motion.formula}')


def refined_path(problem: InitialValueProblem, instants: Instants, known: PathSurvey,
                 limit: float, wanted: float = 0.0, shorten: bool = True
                 ) -> PathReference | None:
    """
    Return the path computed with decreasing step sizes, until it no longer converges.

    Parameters
    ----------
    problem : InitialValueProblem
        The problem to simulate.
    instants : Instants
        Requested instants; the path may end earlier.
    known : PathSurvey
        Survey of the path, which provides the method and the first step size.
    limit : float
        Maximum number of gradients of a run.
    wanted : float, optional
        Sufficient accuracy; by default the best possible.
    shorten : bool, optional
        Accept a shorter path for better accuracy: with smaller steps, the same number of
        gradients covers less time.

    Returns
    -------
    PathReference or None
        The refinement closest to its predecessor; None if fewer than two runs succeeded.

    """
    steps = max(1, math.ceil(instants.gap / known.step_size))
    before, best, last, stuck = None, None, math.inf, 0
    while stuck < _MAX_ROUNDS_WITHOUT_PROGRESS:
        states = _path(problem, known.method, instants, steps, limit)
        if states is None:
            stuck += 1
        elif before is not None:
            n = min(len(states), len(before))
            if best is not None and n < len(best.states) and not shorten:
                break
            distance = float(np.abs(states[:n] - before[:n]).max())
            stuck = 0 if distance < 0.5 * last else stuck + 1
            last = min(last, distance)
            if best is None or distance < best.accuracy:
                best = PathReference(instants, states[:n], distance, (
                    f'{known.method}, h = {instants.gap / steps:.3g} s, verified by refinement'))
            if distance <= wanted or n < min(instants.count, _MIN_SLOW_INSTANTS):
                break
        before, steps = states, math.ceil(_REFINEMENT_RATIO * steps)
    return best


def _path(problem: InitialValueProblem, method: str, instants: Instants, steps: int, limit: float
          ) -> np.ndarray | None:
    """Return the states at the instants, up to the limit of gradients; None if a step fails."""
    simulation = problem.simulation(method, instants.gap / steps)
    rows: list[np.ndarray] = []
    count = 0
    try:
        while count < instants.count and simulation.gradients < limit:
            rows.append(np.hstack(simulation.record(
                min(_CHUNK_SIZE, instants.count - count), steps)))
            count += len(rows[-1])
    except StepFailure:
        return None
    return np.concatenate(rows)


def _refusal(task: CalibrationTask, known: PathSurvey, best: PathReference | None) -> str:
    """Return the reason why the path cannot be determined with the accuracy needed."""
    problem, tolerance = task.problem, task.tolerance
    wanted = f'path_error {tolerance.error:g} up to {tolerance.horizon:g} s: '
    if best is None:
        return f'{wanted}no reference path can be computed; use a shorter horizon'
    near = (f'two reference runs differ by at least {best.accuracy:.2g} up to '
            f'{len(best.states) * best.instants.gap:.3g} s')
    try:
        time = time_between_motions(
            problem.hamiltonian, problem.effects, INTEGRATORS[known.method](), known.step_size,
            problem.q, problem.p, max(_MIN_CHAOS_STEPS, 2.0 * tolerance.horizon / known.step_size))
    except (HnnViRosError, ValueError) as problem_of_measure:
        return f'{wanted}{near} (Lyapunov time not measured: {problem_of_measure}); use ' \
               'energy_error, a shorter horizon or a larger error'
    if math.isinf(time):
        return (f'{wanted}{near}, because of round-off: the motion is regular, but double '
                'precision does not determine its path better; use a larger error or a shorter '
                'horizon')
    size = float(np.abs(best.states).max())
    reach = time * math.log(max(tolerance.error / (np.finfo(float).eps * size), 1.0))
    return (f'{wanted}{near}: the motion is chaotic with a Lyapunov time of {time:.3g} s; '
            f'round-off alone reaches this error after about {reach:.2g} s; use '
            'energy_error, a shorter horizon or a larger error')
