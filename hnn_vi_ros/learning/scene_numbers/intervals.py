# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Statistics of numbers fitted to measured motions: intervals, and what the data do not tell."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import math

from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.learning.scene_numbers.correlation import covariances, Process, processes
from hnn_vi_ros.learning.scene_numbers.fit import (
    Problem, projected, search, Solution, told_directions, units_of)
from hnn_vi_ros.learning.scene_numbers.free_numbers import FreeScene, STATES
from hnn_vi_ros.phase_space import Coordinate, momentum_name
import numpy as np
from scipy.linalg import qr
from scipy.optimize import brentq
from scipy.stats import t as student

CONFIDENCE = 0.95
# What share of a direction in which the data tell nothing names a number.
_SHARE = 1e-2
CORRELATED = 0.9


@dataclass(frozen=True)
class Estimate:
    """
    Estimate of a number.

    Parameters
    ----------
    name, unit : str
        Of the number.
    value : float
        That fits best.
    standard_error, low, high : float or None
        Half the interval of 95 % over the quantile of Student's distribution, and that interval;
        None where the data do not tell the number.

    """

    name: str
    unit: str
    value: float
    standard_error: float | None
    low: float | None
    high: float | None

    @property
    def known(self) -> bool:
        """Return whether the data tell it."""
        return self.standard_error is not None


@dataclass(frozen=True, eq=False)
class Estimates:
    """
    Estimates of all numbers.

    Parameters
    ----------
    estimates : list of Estimate
        N of them: the free numbers, then initial states if they were asked for.
    covariance : np.ndarray, shape (N, N)
        Of their errors, by the standard errors; 0 in rows and columns of those that the data do
        not tell.
    unknown : list of dict of str to float
        Directions in which the data tell nothing: by how much of its value (or of 1, of 0) each
        number may change if the others do, the largest 1.
    coloured : np.ndarray, shape (C,)
        How many samples of each measured quantity count as one, by the sum of the correlations
        of its noise; 1 where that may be white.

    """

    estimates: list[Estimate]
    covariance: np.ndarray
    unknown: list[dict[str, float]]
    coloured: np.ndarray

    @property
    def correlated(self) -> list[tuple[str, str, float]]:
        """Return the pairs of numbers whose errors are correlated by more than 0.9."""
        error = np.sqrt(np.diag(self.covariance))
        found = []
        for i, one in enumerate(self.estimates):
            for j in range(i):
                if error[i] > 0.0 and error[j] > 0.0:
                    r = self.covariance[i, j] / error[i] / error[j]
                    if abs(r) > CORRELATED:
                        found.append((self.estimates[j].name, one.name, float(r)))
        return found


def estimates_of(solution: Solution, problem: Problem, free: FreeScene,
                 coordinates: Sequence[Coordinate], states: bool) -> Estimates:
    """
    Return what a fit tells of its numbers, and of the initial states of its runs if asked.

    An error is a sum over the noise of the samples, by the derivatives of least squares. The
    covariance is that of such sums for each process that the noise may be, see
    identify_correlation, and the intervals are those of the mixture of all these.
    """
    weights = problem.weights(solution.residuals)
    slopes, back = projected(solution, weights)
    n, shape = slopes.shape[3], slopes.shape[:3]
    units = units_of(solution)
    taken, factors, null = _solved(slopes.reshape(-1, n), units)
    starts = [_solved(own.reshape(-1, own.shape[2])) for own in solution.by_starts]
    noise = _processes(solution, weights, np.concatenate([
        taken.reshape(*shape, -1),
        np.stack([own.reshape(*shape[1:], -1) for own, _, _ in starts])], axis=3))
    influences = (taken @ factors).reshape(*shape, n)
    names = [(number.name, number.unit) for number in free.numbers]
    values = [*solution.values]
    if states:
        rows = _first_windows(solution)
        null = np.concatenate([null, *(back[w] @ null for _, w in rows)])
        influences = np.concatenate([influences, *(influences @ back[w].T for _, w in rows)], 3)
        for k, (run, w) in enumerate(rows):
            own, inverse, _ = starts[w]
            at = n + k * own.shape[1]
            influences[w, ..., at:at + own.shape[1]] += (own @ inverse).reshape(*shape[1:], -1)
            names += _state_names(coordinates, run if len(rows) > 1 else '')
            values += [*solution.starts[w]]
    # Of the robust loss psi = w r, whose slope is w^3; the projection took w in place of it.
    bend = float((weights[solution.windows.there]**3).mean())
    found = covariances(influences, noise) / bend**2
    return _told(names, np.array(values), found, null, solution.freedom, np.array([
        np.median([one.samples_as_one for one in own])
        if all(len(one.reflections) for one in own) else 1.0 for own in noise]))


def _solved(slopes: np.ndarray, scale: np.ndarray | None = None
            ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the solution of least squares by slopes, shape (N, n).

    Returns
    -------
    tuple of np.ndarray, shapes (N, n), (n, n) and (n, m)
        Orthonormal columns, 0 in place of what the data do not tell; factors, of which the first
        times these is the transpose of the pseudo-inverse; and directions that are not told.

    """
    if scale is None:
        raw = np.linalg.norm(slopes, axis=0)
        scale = np.where(raw > 0.0, raw, 1.0)
    sizes, rows, told = told_directions(slopes / scale)
    factors = np.where(told[:, None], rows, 0.0) / (
        np.where(told, sizes, 1.0)[:, None] * scale)
    return slopes @ factors.T, factors, rows[~told].T / scale[:, None]


def _processes(solution: Solution, weights: np.ndarray, taken: np.ndarray
               ) -> list[list[Process]]:
    """Return what the noise of each quantity may be, by all that the unknowns take from it."""
    lengths, random = solution.windows.there.sum(axis=1), np.random.default_rng(0)
    left = weights * solution.residuals
    return [processes(left[:, :, c], lengths, taken[:, :, c], random)
            for c in range(left.shape[2])]


def _first_windows(solution: Solution) -> list[tuple[str, int]]:
    """Return the name of each run, and its first window."""
    runs = solution.windows.run
    return [(solution.windows.motions[run].name, int(np.flatnonzero(runs == run)[0]))
            for run in np.unique(runs)]


def _state_names(coordinates: Sequence[Coordinate], run: str) -> list[tuple[str, str]]:
    before = f'{STATES}.{run}.' if run else f'{STATES}.'
    return [*((before + one.name, one.q_unit) for one in coordinates),
            *((before + momentum_name(one.name), one.p_unit) for one in coordinates)]


def _told(names: Sequence[tuple[str, str]], values: np.ndarray, covariances: np.ndarray,
          null: np.ndarray, freedom: int, coloured: np.ndarray) -> Estimates:
    """Return the estimates; those with a share in what the data do not tell have no interval."""
    scale = np.where(values != 0.0, np.abs(values), 1.0)
    shares = np.abs(null / scale[:, None])
    largest = shares.max(axis=0, initial=0.0, keepdims=True)
    shares = shares / np.where(largest > 0.0, largest, 1.0)
    blind = (shares > _SHARE).any(axis=1)
    error, factor = errors_of(covariances, freedom), quantile(freedom)
    mean = covariances.mean(axis=0)
    spread = np.sqrt(np.diag(mean))
    covariance = mean * np.outer(*2 * [np.where(blind | (spread == 0.0), 0.0, error) / np.where(
        spread > 0.0, spread, 1.0)])
    estimates = [
        Estimate(name, unit, float(value), None, None, None) if hidden else
        Estimate(name, unit, float(value), float(own), float(value - factor * own),
                 float(value + factor * own))
        for (name, unit), value, own, hidden in zip(names, values, error, blind, strict=True)]
    unknown = [{name: float(part) for (name, _), part in zip(names, direction, strict=True)
                if abs(part) > _SHARE} for direction in _directions(null / scale[:, None])]
    return Estimates(estimates, covariance, unknown, coloured)


def errors_of(covariances: np.ndarray, freedom: int) -> np.ndarray:
    """
    Return standard errors, of which as many as of one distribution of Student reach as far.

    Of the mixture of those with these covariances, shape (N, u, u), whose tails are longer.
    """
    own = np.sqrt(np.einsum('sii->is', covariances))
    factor = quantile(freedom)
    return np.array([0.0 if not part.any() else brentq(
        lambda end, part=part: student.cdf(end / part, freedom).mean() - (0.5 + 0.5 * CONFIDENCE),
        0.0, 2.0 * factor * part.max()) / factor for part in np.maximum(own, 1e-300)])


def _directions(null: np.ndarray) -> np.ndarray:
    """Return directions of the same space, of few numbers each, the first of them 1, one a row."""
    if not null.size:
        return null.T
    _, _, order = qr(null.T, mode='economic', pivoting=True)
    return np.linalg.solve(null[order[:null.shape[1]]].T, null.T)


def quantile(freedom: int) -> float:
    """Return how many standard errors each side of the interval has."""
    return float(student.ppf(0.5 + 0.5 * CONFIDENCE, freedom))


def profile(solution: Solution, problem: Problem, free: FreeScene, estimate: Estimate
            ) -> Estimate:
    """
    Return a number with the interval in which the other numbers can make up for its error.

    On its ends the cost is higher by as much as chance gives it in one case of twenty, with all
    other numbers and the initial states at their best (D. Bates, D. Watts, Nonlinear Regression
    Analysis and Its Applications, 1988, section 6.1). Chance gives more of it where residuals are
    correlated in time, or their loss is robust. An end is None where there is none within the
    bounds, or within twenty standard errors.
    """
    names = [number.name for number in free.numbers]
    k, error = names.index(estimate.name), estimate.standard_error
    if error is None:
        return estimate
    allowed = quantile(solution.freedom) * error / _error_by_cost(solution, problem, k)
    least = float(problem.cost(solution.residuals).sum())

    def excess(value: float) -> float:
        numbers = tuple(replace(number, start=value if i == k else float(now)) for i, (
            number, now) in enumerate(zip(free.numbers, solution.values, strict=True)))
        own = Problem(replace(free, numbers=numbers).holding(k), solution.windows, problem.noise,
                      solution.starts, problem.robust)
        others = np.delete(solution.values, k)
        try:
            residuals = search(own, others).residuals
        except HnnViRosError:
            return math.inf
        return math.sqrt(max(0.0, float(own.cost(residuals).sum()) - least)) - allowed

    number = free.numbers[k]
    return replace(estimate, low=_end(excess, estimate.value, -error, number.low),
                   high=_end(excess, estimate.value, error, number.high))


def _error_by_cost(solution: Solution, problem: Problem, k: int) -> float:
    """Return how far a number moves until the cost, with all others at their best, is 1 more."""
    weights = problem.weights(solution.residuals)
    slopes, _ = projected(solution, weights)
    _, factors, _ = _solved(slopes.reshape(-1, slopes.shape[3]), units_of(solution))
    # The cost of a residual bends as w^3, 1 for squares.
    bend = (weights[solution.windows.there]**3).mean()
    return float(np.linalg.norm(factors[:, k])) / math.sqrt(bend)


def _end(excess: Callable[[float], float], value: float, error: float, bound: float
         ) -> float | None:
    """Return where the excess is zero, on the side of the error; None if it is nowhere."""
    inner = value
    for times in (2.0, 3.0, 5.0, 10.0, 20.0):
        outer = value + times * error
        beyond = outer <= bound if error < 0.0 else outer >= bound
        outer = value + 0.999 * (bound - value) if beyond else outer
        found = excess(outer)
        if found > 0.0:
            if math.isinf(found):
                return None
            return float(brentq(excess, inner, outer, xtol=1e-3 * abs(error)))
        if beyond:
            return None
        inner = outer
    return None
