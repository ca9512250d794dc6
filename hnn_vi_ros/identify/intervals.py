# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Statistics of fitted numbers: confidence intervals, and numbers that data do not determine."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import math

from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.identify.free_numbers import FreeScene, STATES
from hnn_vi_ros.learning import (
    column_norms, covariances, FitProblem, least_squares_factors, Process, processes, projected,
    search, Solution, units_of)
from hnn_vi_ros.phase_space import Coordinate, momentum_name
import numpy as np
from scipy.linalg import qr
from scipy.optimize import brentq
from scipy.stats import t as student

CONFIDENCE = 0.95
# Minimum share of a number in an undetermined direction for it to be reported, measured by its
# effect on the motion: relative to its value, any change of a number near zero is large.
_SHARE = 1e-3
CORRELATED = 0.9


@dataclass(frozen=True)
class Estimate:
    """
    Estimate of a number.

    Parameters
    ----------
    name, unit : str
        Name and unit of the number.
    value : float
        Best-fitting value.
    standard_error, low, high : float or None
        Half the 95 % interval over the quantile of Student's t-distribution, and that interval;
        None if the data do not determine the number.

    """

    name: str
    unit: str
    value: float
    standard_error: float | None
    low: float | None
    high: float | None

    @property
    def known(self) -> bool:
        """Return whether the data determine the number."""
        return self.standard_error is not None


@dataclass(frozen=True, eq=False)
class Estimates:
    """
    Estimates of all numbers.

    Parameters
    ----------
    estimates : list of Estimate
        N estimates: the free numbers, then initial states if requested.
    covariance : np.ndarray, shape (N, N)
        Covariance of their errors, consistent with the standard errors; rows and columns of
        undetermined numbers are 0.
    unknown : list of dict of str to float
        Directions that the data do not determine: the change of each number relative to its value
        (absolute if that is 0) along the direction; the largest is 1 or -1.
    coloured : np.ndarray, shape (C,)
        Samples of each measured quantity per independent one: the sum of the correlations of its
        noise; 1 if the noise may be white.

    """

    estimates: list[Estimate]
    covariance: np.ndarray
    unknown: list[dict[str, float]]
    coloured: np.ndarray

    @property
    def correlated(self) -> list[tuple[str, str, float]]:
        """Return the pairs of numbers whose errors have a correlation above 0.9."""
        error = np.sqrt(np.diag(self.covariance))
        found = []
        for i, one in enumerate(self.estimates):
            for j in range(i):
                if error[i] > 0.0 and error[j] > 0.0:
                    r = self.covariance[i, j] / error[i] / error[j]
                    if abs(r) > CORRELATED:
                        found.append((self.estimates[j].name, one.name, float(r)))
        return found


def estimates_of(solution: Solution, problem: FitProblem, free: FreeScene,
                 coordinates: Sequence[Coordinate], states: bool) -> Estimates:
    """
    Return the estimates of a fit's numbers, and of its initial states if requested.

    An error is a weighted sum over the noise of the samples, with least-squares weights. The
    covariance of these sums is computed for each process the noise may be (see
    identify_correlation); the intervals describe the mixture.
    """
    weights = problem.weights(solution.residuals)
    slopes, back = projected(solution, weights)
    n, shape = slopes.shape[3], slopes.shape[:3]
    units = units_of(solution)
    taken, factors, null = least_squares_factors(slopes.reshape(-1, n), units)
    starts = [least_squares_factors(own.reshape(-1, own.shape[2])) for own in solution.by_starts]
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
        units = np.concatenate([units, *(column_norms(solution.by_starts[w].reshape(
            -1, back.shape[1])) for _, w in rows)])
        for k, (run, w) in enumerate(rows):
            own, inverse, hidden = starts[w]
            at = n + k * own.shape[1]
            null = np.hstack([null, np.zeros((len(null), hidden.shape[1]))])
            null[at:at + len(hidden), null.shape[1] - hidden.shape[1]:] = hidden
            influences[w, ..., at:at + own.shape[1]] += (own @ inverse).reshape(*shape[1:], -1)
            names += _state_names(coordinates, run if len(rows) > 1 else '')
            values += [*solution.starts[w]]
    found = covariances(influences, noise) / problem.bend(solution)**2
    coloured = np.array([np.median([one.samples_as_one for one in own])
                         if all(len(one.reflections) for one in own) else 1.0 for own in noise])
    return make_estimates(names, np.array(values), found, null * units[:, None], units,
                          solution.freedom, coloured)


def _processes(solution: Solution, weights: np.ndarray, taken: np.ndarray
               ) -> list[list[Process]]:
    """Return sampled noise processes of each quantity, given the directions of all unknowns."""
    lengths, random = solution.windows.there.sum(axis=1), np.random.default_rng(0)
    left = weights * solution.residuals
    return [processes(left[:, :, c], lengths, taken[:, :, c], random)
            for c in range(left.shape[2])]


def _first_windows(solution: Solution) -> list[tuple[str, int]]:
    """Return the name and the first window of each run."""
    runs = solution.windows.run
    return [(solution.windows.motions[run].name, int(np.flatnonzero(runs == run)[0]))
            for run in np.unique(runs)]


def _state_names(coordinates: Sequence[Coordinate], run: str) -> list[tuple[str, str]]:
    before = f'{STATES}.{run}.' if run else f'{STATES}.'
    return [*((before + one.name, one.q_unit) for one in coordinates),
            *((before + momentum_name(one.name), one.p_unit) for one in coordinates)]


def make_estimates(names: Sequence[tuple[str, str]], values: np.ndarray, covariances: np.ndarray,
                   null: np.ndarray, units: np.ndarray, freedom: int, coloured: np.ndarray
                   ) -> Estimates:
    """Return the estimates; numbers in undetermined directions have no interval."""
    blind = np.asarray((_shares(null) > _SHARE).any(axis=1))
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
    scale = units * np.where(values != 0.0, np.abs(values), 1.0)
    unknown = []
    for direction in _directions(null):
        parts = direction / scale * (_shares(direction) > _SHARE)
        unknown.append({name: float(part) for (name, _), part in zip(
            names, parts / np.abs(parts).max(), strict=True) if part})
    return Estimates(estimates, covariance, unknown, coloured)


def _shares(directions: np.ndarray) -> np.ndarray:
    """Return the entries of directions, one per column, relative to the largest of each."""
    largest = np.abs(directions).max(axis=0, initial=0.0)
    return np.asarray(np.abs(directions) / np.where(largest > 0.0, largest, 1.0))


def errors_of(covariances: np.ndarray, freedom: int) -> np.ndarray:
    """
    Return standard errors that give the mixture's intervals with one Student distribution.

    The mixture has the covariances of shape (N, u, u), and longer tails than its components.
    """
    own = np.sqrt(np.einsum('sii->is', covariances))
    factor = quantile(freedom)
    return np.array([0.0 if not part.any() else brentq(
        lambda end, part=part: student.cdf(end / part, freedom).mean() - (0.5 + 0.5 * CONFIDENCE),
        0.0, 2.0 * factor * part.max()) / factor for part in np.maximum(own, 1e-300)])


def _directions(null: np.ndarray) -> np.ndarray:
    """Return a sparse basis of the same space, one direction per row, with leading entry 1."""
    if not null.size:
        return null.T
    _, _, order = qr(null.T, mode='economic', pivoting=True)
    return np.linalg.solve(null[order[:null.shape[1]]].T, null.T)


def quantile(freedom: int) -> float:
    """Return the half-width of the interval in standard errors."""
    return float(student.ppf(0.5 + 0.5 * CONFIDENCE, freedom))


def profile(solution: Solution, problem: FitProblem, free: FreeScene, estimate: Estimate
            ) -> Estimate:
    """
    Return an estimate with its profile-likelihood interval.

    At its ends the cost, minimised over all other numbers and the initial states, exceeds the
    minimum by an amount that chance exceeds in 5 % of cases (D. Bates, D. Watts, Nonlinear
    Regression Analysis and Its Applications, 1988, section 6.1). The amount is larger if residuals
    are correlated in time or the loss is robust. An end is None if it is beyond the bounds or
    beyond twenty standard errors.
    """
    names = [number.name for number in free.numbers]
    k, error = names.index(estimate.name), estimate.standard_error
    if error is None:
        return estimate
    allowed = quantile(solution.freedom) * error / _error_by_cost(solution, problem, k)
    least = float(problem.cost(solution.residuals).sum())

    def excess(value: float) -> float:
        values = solution.values.copy()
        values[k] = value
        own = FitProblem(free.starting_at(values).holding(k), solution.windows, problem.noise,
                         solution.starts, problem.robust)
        try:
            residuals = search(own, np.delete(values, k)).residuals
        except HnnViRosError:
            return math.inf
        return math.sqrt(max(0.0, float(own.cost(residuals).sum()) - least)) - allowed

    number = free.numbers[k]
    return replace(estimate, low=_end(excess, estimate.value, -error, number.low),
                   high=_end(excess, estimate.value, error, number.high))


def _error_by_cost(solution: Solution, problem: FitProblem, k: int) -> float:
    """Return the change of a number that raises the cost, minimised over the others, by 1."""
    weights = problem.weights(solution.residuals)
    slopes, _ = projected(solution, weights)
    _, factors, _ = least_squares_factors(slopes.reshape(-1, slopes.shape[3]), units_of(solution))
    return float(np.linalg.norm(factors[:, k])) / math.sqrt(problem.bend(solution))


def _end(excess: Callable[[float], float], value: float, error: float, bound: float
         ) -> float | None:
    """Return the root of the excess on the side of the error; None if there is none."""
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
