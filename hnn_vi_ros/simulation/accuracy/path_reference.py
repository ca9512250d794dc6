# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The path that trials are measured against, and how far it can be known."""

from dataclasses import dataclass, replace
import math

from hnn_vi_ros.errors import CalibrationError, HnnViRosError, StepFailure
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.simulation.accuracy.lyapunov import time_between_motions
from hnn_vi_ros.simulation.accuracy.trials import InitialValueProblem, PathSurvey, Tolerance
import numpy as np

# Instants at which paths are compared: at least and at most; the least of an H that is slow.
_LEAST, _MOST, _FEW = 320, 2000, 40
_SLOW = 1_000_000
# References may take this many times the gradients of a trial.
PATIENCE = 6
# A reference is good enough when it is known to this share of the tolerance, and usable up to
# half.
_KNOWN, _USABLE = 0.02, 0.5
# Refinements without progress after which round-off is what is left, or chaos.
_STUCK = 3
# A path that is known less well than this share of its size is none.
_VERIFIED = 1e-4
_EPS = float(np.finfo(np.float64).eps)
# Each refinement's number of steps over that of the one before.
_RATIO = 1.5
_CHUNK = 20
# Steps up to which chaos is looked for at least.
_CHAOS_STEPS = 2 ** 14


@dataclass(frozen=True)
class Instants:
    """
    Times at which paths are compared: each so many bases, or so many times a base.

    Parameters
    ----------
    base : float
        What steps divide [s].
    stride, density : int
        One instant each ``stride`` bases, or ``density`` in each base; one of them is 1.
    count : int
        How many up to the horizon.

    """

    base: float
    stride: int
    density: int
    count: int

    @classmethod
    def of(cls, horizon: float, base: float, least: int = _LEAST) -> 'Instants':
        """Return instants that steps meet, of base / 4, / 5, / 6, / 8, ...: see parts_for."""
        bases = max(1, round(horizon / base))
        if bases >= least:
            stride = math.ceil(bases / _MOST)
            return cls(base, stride, 1, bases // stride)
        doublings = math.ceil(math.log2(least / bases))
        density = 15 * 2 ** doublings
        return cls(base, 1, density, bases * density)

    @property
    def gap(self) -> float:
        """Return the time between two instants [s]."""
        return self.base * self.stride / self.density

    def met(self, parts: int) -> tuple[int, int]:
        """Return steps of base / parts between instants that they meet, and their distance."""
        if self.density == 1:
            return self.stride * parts, 1
        common = math.gcd(parts, self.density)
        return parts // common, self.density // common


@dataclass(frozen=True)
class PathReference:
    """
    A path, known as well as possible.

    Parameters
    ----------
    instants : Instants
        Up to the horizon.
    states : np.ndarray, shape (n, 2 d)
        (q, p) at the first n instants; of a rotation 2 d less one.
    accuracy : float
        The largest error: of a formula a bound, else the largest difference from the path that
        was found before it.
    how : str
        How it was computed.

    """

    instants: Instants
    states: np.ndarray
    accuracy: float
    how: str

    @property
    def horizon(self) -> float:
        """Return how far it goes, or as far as was wanted where it goes nowhere [s]."""
        instants, count = self.instants, len(self.states) or self.instants.count
        return instants.base * instants.stride * count / instants.density

    @property
    def verified(self) -> bool:
        """Return whether errors can be measured against the path: in chaos they soon cannot."""
        return self.accuracy <= _VERIFIED * np.abs(self.states).max(initial=1e-300)


def find_reference(problem: InitialValueProblem, tolerance: Tolerance, base: float,
                   known: PathSurvey) -> PathReference:
    """
    Return the path, refined until two of them agree.

    Parameters
    ----------
    problem : InitialValueProblem
        The problem to simulate.
    tolerance : Tolerance
        How well it must be known, and until when.
    base : float
        A time that the steps of trials divide [s].
    known : PathSurvey
        Of the path.

    Raises
    ------
    CalibrationError
        Round-off or chaos, which is measured, keeps it from being known so well.

    """
    limit = PATIENCE * problem.gradients
    instants = Instants.of(tolerance.horizon, base, _LEAST if limit >= _SLOW else _FEW)
    best = refined_path(problem, instants, known, limit, _KNOWN * tolerance.error)
    if best is None or best.accuracy > _USABLE * tolerance.error:
        raise CalibrationError(_refusal(problem, tolerance, known, best))
    return best


def best_reference(problem: InitialValueProblem, horizon: float, known: PathSurvey,
                   limit: float) -> PathReference:
    """
    Return the path as well as it can be known: by a formula, or refined until that is no better.

    Parameters
    ----------
    problem : InitialValueProblem
        The problem to simulate.
    horizon : float
        Until when [s].
    known : PathSurvey
        Of the path.
    limit : float
        Gradients that a run may take; the path may end sooner for that.

    Returns
    -------
    PathReference
        One without states where no path is known at all.

    """
    instants = Instants.of(horizon, horizon, _FEW)
    found = None
    # Random numbers are others at each step size.
    if not any(effect.random for effect in problem.effects):
        found = exact_path(problem, instants) or refined_path(
            problem, instants, known, limit, shorten=False)
    if found is None:
        return PathReference(
            instants, np.empty((0, problem.q.size + problem.p.size)), math.inf, '')
    # Two paths may agree by chance to the last digit, which is rounded.
    return replace(found, accuracy=max(found.accuracy, _EPS * np.abs(found.states).max()))


def exact_path(problem: InitialValueProblem, instants: Instants) -> PathReference | None:
    """Return the path that a formula gives; None where none is known, or an effect acts."""
    hamiltonian = problem.hamiltonian
    t = instants.gap * np.arange(1, instants.count + 1)
    motion = None if problem.effects else hamiltonian.exact_motion(problem.q, problem.p, t)
    if motion is None:
        return None
    # A phase is known to about two eps, and a value to one.
    speed = np.abs(hamiltonian.gradient(*np.split(motion.path, 2, axis=1))).max()
    rounding = _EPS * (np.abs(motion.path).max() + 2.0 * motion.condition * speed * t[-1])
    return PathReference(instants, motion.path, float(rounding), f'exact: {motion.formula}')


def refined_path(problem: InitialValueProblem, instants: Instants, known: PathSurvey,
                 limit: float, wanted: float = 0.0, shorten: bool = True
                 ) -> PathReference | None:
    """
    Return the path by ever smaller steps, up to where they no longer bring it nearer.

    Parameters
    ----------
    problem : InitialValueProblem
        The problem to simulate.
    instants : Instants
        Where it is wanted; it may end sooner.
    known : PathSurvey
        Of the path: the method, and the first step.
    limit : float
        Gradients that a run may take.
    wanted : float, optional
        Accuracy that is enough; by default, all that can be had.
    shorten : bool, optional
        Whether it may end sooner to be known better: smaller steps do not come so far by as many
        gradients.

    Returns
    -------
    PathReference or None
        The two paths that agree best; None where no two are known.

    """
    steps = max(1, math.ceil(instants.gap / known.step_size))
    before, best, last, stuck = None, None, math.inf, 0
    while stuck < _STUCK:
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
                    f'{known.method}, h = {instants.gap / steps:.3g} s, checked by refining'))
            if distance <= wanted or n < min(instants.count, _FEW):
                break
        before, steps = states, math.ceil(_RATIO * steps)
    return best


def _path(problem: InitialValueProblem, method: str, instants: Instants, steps: int, limit: float
          ) -> np.ndarray | None:
    """Return the states at the instants, as many as gradients allow; None if a step fails."""
    simulation = problem.simulation(method, instants.gap / steps)
    rows: list[np.ndarray] = []
    count = 0
    try:
        while count < instants.count and simulation.gradients < limit:
            rows.append(np.hstack(simulation.record(min(_CHUNK, instants.count - count), steps)))
            count += len(rows[-1])
    except StepFailure:
        return None
    return np.concatenate(rows)


def _refusal(problem: InitialValueProblem, tolerance: Tolerance, known: PathSurvey,
             best: PathReference | None) -> str:
    """Say why the path cannot be known so well."""
    wanted = f'path_error {tolerance.error:g} up to {tolerance.horizon:g} s: '
    if best is None:
        return f'{wanted}no path can be computed; take a shorter horizon'
    near = (f'two references differ by {best.accuracy:.2g} at best up to '
            f'{len(best.states) * best.instants.gap:.3g} s')
    try:
        time = time_between_motions(
            problem.hamiltonian, problem.effects, INTEGRATORS[known.method](), known.step_size,
            problem.q, problem.p, max(_CHAOS_STEPS, 2.0 * tolerance.horizon / known.step_size))
    except (HnnViRosError, ValueError) as problem_of_measure:
        return f'{wanted}{near} (Lyapunov time not measured: {problem_of_measure}); take ' \
               'energy_error, a shorter horizon or a larger error'
    if math.isinf(time):
        return (f'{wanted}{near}, which is round-off: the motion is regular, but in double '
                'precision its path is not known better; take a larger error or a shorter '
                'horizon')
    size = float(np.abs(best.states).max())
    reach = time * math.log(max(tolerance.error / (np.finfo(float).eps * size), 1.0))
    return (f'{wanted}{near}: the motion is chaotic, with a Lyapunov time of {time:.3g} s, so '
            f'that round-off alone reaches this error after some {reach:.2g} s; take '
            'energy_error, a shorter horizon or a larger error')
