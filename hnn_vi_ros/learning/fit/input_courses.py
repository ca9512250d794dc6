# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Course of measured forces between samples: how well a fit explains the data with each."""

from collections.abc import Callable, Sequence
from dataclasses import replace
import math
from typing import NamedTuple

from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.learning.arguments import Course, INPUTS
from hnn_vi_ros.learning.data.motions import EvenMotion
from hnn_vi_ros.learning.fit.following import LogSimulation
from hnn_vi_ros.learning.fit.shooting import FitProblem, made_up, search, Solution
import numpy as np

# Reduction of the sum of squares that counts as evidence for another fit: three sigma.
EVIDENCE = 9.0
# Number of evaluations of another course, which begin at the solution, and their tolerance.
_TRIED, _TOLERANCE = 10, 1e-5


def evidence_of(freedom: int, ratio: float) -> float:
    """Return by how many variances a fit of this ratio of misfits reduces the sum of squares."""
    return freedom * (1.0 - ratio**2)


class InputCourses(NamedTuple):
    """
    Assumed course of measured forces between samples, and the evidence for the others.

    Parameters
    ----------
    taken : Course
        Assumed course.
    stated : bool
        True if the user or the kind of data determines the course.
    own : float
        Residuals with the assumed course, in standard deviations.
    others : dict of Course to float
        Residuals with each of the others.
    freedom : int
        Number of degrees of freedom of the residuals.

    """

    taken: Course
    stated: bool
    own: float
    others: dict[Course, float]
    freedom: int

    def evidence(self, other: Course) -> float:
        """Return the reduction of the sum of squares by another course, in variances."""
        return evidence_of(self.freedom, self.others[other] / self.own)

    @property
    def better(self) -> Course | None:
        """Return the best course if it is another one."""
        best = min(self.others, key=self.others.__getitem__)
        return best if self.evidence(best) > EVIDENCE else None

    def text(self, remedy: str) -> str:
        """Describe the course, and how well others fit; ``remedy`` precedes the better one."""
        said = []
        for other in sorted(self.others, key=self.others.__getitem__):
            evidence = self.evidence(other)
            said.append(f'as {other} they fit equally well' if abs(evidence) <= EVIDENCE else
                        f'as {other} they fit {"better" if evidence > 0.0 else "worse"} '
                        f'(residuals {self.others[other]:.3g} times the noise, instead of '
                        f'{self.own:.3g})')
        if self.better:
            said[0] += f': check, and use {remedy} {self.better}'
        known = '' if self.stated else ', which the data do not specify'
        return f'Forces between samples are taken as {self.taken}{known}; {"; ".join(said)}'


def input_courses(solution: Solution, problem: FitProblem, taken: Course, stated: bool,
                  motions: Callable[[Course], Sequence[EvenMotion]]) -> InputCourses:
    """
    Repeat a fit with forces of each other course.

    Parameters
    ----------
    solution, problem : Solution, FitProblem
        The fit.
    taken, stated
        See InputCourses.
    motions : callable
        Returns the fitted motions with forces of another course.

    """
    scale = solution.misfit / problem.misfit(solution)
    return InputCourses(taken, stated or taken == 'held', solution.misfit, {
        other: scale * misfit_with(solution, problem, motions(other)) for other in INPUTS
        if other != taken}, solution.freedom)


def misfit_with(solution: Solution, problem: FitProblem, motions: Sequence[EvenMotion]) -> float:
    """Return the misfit of the same windows with other forces; inf if that fit fails."""
    windows = replace(solution.windows, motions=motions)
    other = FitProblem(problem.model, windows, problem.noise, solution.starts, problem.robust)
    try:
        return other.misfit(search(other, solution.values, _TOLERANCE, _TRIED))
    except HnnViRosError:
        return math.inf


def evidence_at(solution: Solution, problem: FitProblem, motions: Sequence[EvenMotion]) -> float:
    """
    Return the evidence that forces change towards others, from one simulation with these.

    It is that of the best share of their change to first order (a score test): a refit with the
    others shows less, unless it is far away.
    """
    log = LogSimulation(problem.model.parts_at(solution.values), replace(
        solution.windows, motions=motions))
    now = problem.scaled(solution.windows.measured) + solution.residuals
    change = np.where(solution.windows.there[..., None],
                      problem.scaled(log.predict(solution.starts)) - now, 0.0)
    if not np.isfinite(change).all():
        return math.inf
    weights = problem.weights(solution.residuals)
    rest = made_up(solution, weights, change)[1]
    slope, size = (float((weights * rest * one).sum()) for one in (solution.residuals, rest))
    return slope**2 / max(size, 1e-300) / problem.misfit(solution)**2 if slope < 0.0 else 0.0
