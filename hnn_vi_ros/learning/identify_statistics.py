# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Statistics of numbers fitted to measured motions: intervals, and what the data do not tell."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import math

from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.learning.identify_fit import (
    Problem, projected, search, Solution, told_directions, units_of)
from hnn_vi_ros.learning.identify_numbers import FreeScene, STATES
from hnn_vi_ros.phase_space import Coordinate, momentum_name
import numpy as np
from scipy.linalg import qr
from scipy.optimize import brentq
from scipy.stats import t as student

CONFIDENCE = 0.95
# What share of a direction in which the data tell nothing names a number.
_SHARE = 1e-2
# Standard errors of a correlation beyond which residuals are no white noise.
_COLOURED = 3.0
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
        And the interval of 95 %; None where the data do not tell the number.

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
        Of their errors; 0 in rows and columns of those that the data do not tell.
    unknown : list of dict of str to float
        Directions in which the data tell nothing: by how much of its value (or of 1, of 0) each
        number may change if the others do, the largest 1.
    coloured : np.ndarray, shape (C,)
        By which factor the sum of its correlations makes the noise of each measured quantity
        count; 1 for white noise.

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

    The covariance is that of least squares, (J^T J)^-1 of the derivatives in standard deviations
    with the initial states eliminated. Where residuals are correlated in time, as those of data
    that are sampled faster than their noise changes, it is (J^T J)^-1 J^T R J (J^T J)^-1 with
    their correlations R.
    """
    slopes, back = projected(solution, problem.weights(solution.residuals))
    scale = units_of(solution)
    sizes, rows, told = told_directions(slopes.reshape(-1, slopes.shape[3]) / scale)
    inverse = _inverse(scale, sizes[told], rows[told])
    null = rows[~told].T / scale[:, None]
    correlations = [correlations_of(solution.residuals[:, :, c], solution.windows.there)
                    for c in range(slopes.shape[2])]
    coloured = np.array([1.0 + 2.0 * float(np.sum(own)) for own in correlations])
    meat = _correlated(slopes, correlations)
    covariance = inverse @ meat @ inverse * _robust_factor(problem, solution)
    names = [(number.name, number.unit) for number in free.numbers]
    values = [*solution.values]
    if states:
        rows = _first_windows(solution)
        own = [_own_covariance(solution, problem, w, correlations) for _, w in rows]
        gain = np.concatenate([np.eye(len(values)), *(back[w] for _, w in rows)])
        covariance = gain @ covariance @ gain.T
        null = gain @ null
        at = len(values)
        for (run, w), part in zip(rows, own, strict=True):
            n = len(part)
            covariance[at:at + n, at:at + n] += part
            names += _state_names(coordinates, run if len(rows) > 1 else '')
            values += [*solution.starts[w]]
            at += n
    return _told(names, np.array(values), covariance, null, solution.freedom, coloured)


def _inverse(scale: np.ndarray, sizes: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return (J^T J)^-1 in some directions, of the singular values of J by units."""
    kept = rows / sizes[:, None]
    found: np.ndarray = kept.T @ kept / np.outer(scale, scale)
    return found


def _correlated(slopes: np.ndarray, correlations: Sequence[Sequence[float]]) -> np.ndarray:
    """Return J^T R J of derivatives, shape (W, T, C, n), by correlations of each quantity."""
    n = slopes.shape[3]
    meat = np.zeros((n, n))
    for c, found in enumerate(correlations):
        own = slopes[:, :, c]
        added = np.zeros((n, n))
        for k, r in enumerate(found, 1):
            lagged = np.einsum('wti,wtj->ij', own[:, :-k], own[:, k:])
            added += r * (lagged + lagged.T)
        # What correlations seem to take away is kept: the data are never better than white.
        sizes, rows = np.linalg.eigh(added)
        meat += np.einsum('wti,wtj->ij', own, own) + (rows * np.maximum(sizes, 0.0)) @ rows.T
    return meat


def correlations_of(residuals: np.ndarray, there: np.ndarray) -> list[float]:
    """
    Return the correlations of residuals, shape (W, T), with those 1, 2, ... samples later.

    None where the first of them is no more than chance. They end where the sum of two in a row
    is no longer positive (C. Geyer, Practical Markov chain Monte Carlo, Statistical Science 7
    (1992)).
    """
    size = float((residuals[there]**2).mean())
    if size == 0.0:
        return []
    found: list[float] = []
    for k in range(1, residuals.shape[1] // 2):
        pairs = there[:, :-k] & there[:, k:]
        found.append(float((residuals[:, :-k] * residuals[:, k:])[pairs].mean()) / size)
        if k == 1 and found[0] < _COLOURED / math.sqrt(pairs.sum()):
            return []
        if k % 2 == 0 and found[-1] + found[-2] <= 0.0:
            return found[:-2]
    return found


def _robust_factor(problem: Problem, solution: Solution) -> float:
    """Return what the variance of a fit with the robust loss is of one with squares (Huber)."""
    if not problem.robust:
        return 1.0
    own = solution.residuals[solution.windows.there]
    weights = problem.weights(own)
    # Of psi = w r, whose slope is w^3; the projection took w in place of it.
    return float(((weights * own)**2).mean() / (weights**3).mean()**2)


def _own_covariance(solution: Solution, problem: Problem, w: int,
                    correlations: Sequence[Sequence[float]]) -> np.ndarray:
    """Return the covariance of the initial state of a window if all numbers were known."""
    n = solution.starts.shape[1]
    slopes = solution.by_starts[w].reshape(-1, n)
    raw = np.linalg.norm(slopes, axis=0)
    scale = np.where(raw > 0.0, raw, 1.0)
    sizes, rows, told = told_directions(slopes / scale)
    inverse = _inverse(scale, sizes[told], rows[told])
    meat = _correlated(solution.by_starts[w:w + 1], correlations)
    found: np.ndarray = inverse @ meat @ inverse * _robust_factor(problem, solution)
    return found


def _first_windows(solution: Solution) -> list[tuple[str, int]]:
    """Return the name of each run, and its first window."""
    runs = solution.windows.run
    return [(solution.windows.motions[run].name, int(np.flatnonzero(runs == run)[0]))
            for run in np.unique(runs)]


def _state_names(coordinates: Sequence[Coordinate], run: str) -> list[tuple[str, str]]:
    before = f'{STATES}.{run}.' if run else f'{STATES}.'
    return [*((before + one.name, one.q_unit) for one in coordinates),
            *((before + momentum_name(one.name), one.p_unit) for one in coordinates)]


def _told(names: Sequence[tuple[str, str]], values: np.ndarray, covariance: np.ndarray,
          null: np.ndarray, freedom: int, coloured: np.ndarray) -> Estimates:
    """Return the estimates; those with a share in what the data do not tell have no interval."""
    scale = np.where(values != 0.0, np.abs(values), 1.0)
    shares = np.abs(null / scale[:, None])
    largest = shares.max(axis=0, initial=0.0, keepdims=True)
    shares = shares / np.where(largest > 0.0, largest, 1.0)
    blind = (shares > _SHARE).any(axis=1)
    covariance = np.where(blind[:, None] | blind[None, :], 0.0, covariance)
    error, factor = np.sqrt(np.diag(covariance)), quantile(freedom)
    estimates = [
        Estimate(name, unit, float(value), None, None, None) if hidden else
        Estimate(name, unit, float(value), float(own), float(value - factor * own),
                 float(value + factor * own))
        for (name, unit), value, own, hidden in zip(names, values, error, blind, strict=True)]
    unknown = [{name: float(part) for (name, _), part in zip(names, direction, strict=True)
                if abs(part) > _SHARE} for direction in _directions(null / scale[:, None])]
    return Estimates(estimates, covariance, unknown, coloured)


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
    slopes, _ = projected(solution, problem.weights(solution.residuals))
    scale = units_of(solution)
    sizes, rows, told = told_directions(slopes.reshape(-1, slopes.shape[3]) / scale)
    # The cost of a residual bends as w^3, 1 for squares.
    bend = (problem.weights(solution.residuals)[solution.windows.there]**3).mean()
    return math.sqrt(float(_inverse(scale, sizes[told], rows[told])[k, k] / bend))


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
