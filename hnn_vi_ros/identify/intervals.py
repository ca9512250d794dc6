# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Statistics of numbers fitted to measured motions: intervals, and what the data do not tell.

The noise of a measured quantity is taken for autoregressive, e_t + a_1 e_{t-1} + ... + a_p e_{t-p}
is white. A fit makes residuals smaller and less correlated than the noise, most of all where the
motion itself is. So processes are judged by the restricted likelihood, which leaves out what the
unknowns could make up for. Short logs leave several of them possible, of various orders: all are
kept, as often as they are likely.

D. Harville, Maximum likelihood approaches to variance component estimation and to related
problems, J. Am. Stat. Assoc. 72 (1977). G. Box, G. Jenkins, Time Series Analysis, 1976, appendix
A7.5, on the exact likelihood. K. Burnham, D. Anderson, Model Selection and Multimodel Inference,
2002, on weights of models.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
import math
from typing import NamedTuple

from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.identify.fit import (
    FitProblem, projected, search, Solution, told_directions, units_of)
from hnn_vi_ros.identify.free_numbers import FreeScene, STATES
from hnn_vi_ros.phase_space import Coordinate, momentum_name
import numpy as np
from scipy.linalg import qr
from scipy.optimize import brentq, minimize
from scipy.signal import lfilter, lfiltic
from scipy.stats import t as student

# Highest order, samples for each, and how many orders in a row have to be in vain to try no more.
_ORDERS, _SAMPLES, _IN_VAIN = 12, 8, 4
# What a coefficient of many samples has to add to twice the log likelihood. By 2, as Akaike has
# it, intervals of short logs with noise of several time scales are too narrow; by 1 those of
# white noise too wide.
_PRICE = 1.5
# Models that cost so much more than the best one are left out: 2 % as likely.
_BEHIND = 4.0
# Processes that are drawn of each order, and kept of all; and the degrees of freedom of the
# distribution they are drawn from, whose tails are longer than those of the likelihood.
_DRAWN, _KEPT, _TAILS = 200, 400, 5.0
# Reflection coefficients are k = tanh x, for x up to this.
_MOST = 6.0
# Directions of which unknowns take less than this share from the residuals count as left.
_TAKEN = 0.02
# Spacings of differences of costs, for first derivatives in units of about 1, and second ones.
_SLOPE, _BEND = 1e-4, 3e-3
# White noise that rounding adds, as a share of the square of all.
_ROUNDING = 1e-8
# Numbers that are worked on at once.
_AT_ONCE = 1 << 22


class Process(NamedTuple):
    """
    An autoregressive process.

    Parameters
    ----------
    reflections : np.ndarray, shape (p,)
        Its reflection coefficients (partial autocorrelations), of size < 1.
    variance : float
        Of its white noise.

    """

    reflections: np.ndarray
    variance: float

    def autocovariances(self, count: int) -> np.ndarray:
        """Return the autocovariances of samples 0, 1, ... apart, shape (count,)."""
        found, left = [1.0], 1.0
        for p, k in enumerate(self.reflections):  # the recursion of Levinson and Durbin
            a = _polynomials(self.reflections[None, :p])[0]
            found.append(k * left - a[1:] @ found[:0:-1])
            left *= 1.0 - k * k
        r = np.array(found)
        if len(r) > 1:
            a = _polynomials(self.reflections[None])[0]
            r = np.append(r, lfilter([1.0], a, np.zeros(max(0, count - len(r))),
                                     zi=lfiltic([1.0], a, r[:0:-1]))[0])
        return self.variance / left * np.append(r, np.zeros(max(0, count - len(r))))[:count]

    @property
    def samples_as_one(self) -> float:
        """Return the sum of all its correlations: so many samples count as one."""
        a = _polynomials(self.reflections[None])[0]
        return float(self.variance / a.sum()**2 / self.autocovariances(1)[0])


def _polynomials(reflections: np.ndarray) -> np.ndarray:
    """Return 1, a_1, ... a_p of N processes, shape (N, p + 1), of their reflections, (N, p)."""
    a = np.zeros((len(reflections), reflections.shape[1] + 1))
    a[:, 0] = 1.0
    for p, k in enumerate(reflections.T, 2):
        a[:, :p] -= k[:, None] * a[:, p - 1::-1]
    return a


class _Restricted:
    """
    The restricted likelihood of processes, by residuals of one quantity in W windows.

    Parameters
    ----------
    residuals : np.ndarray, shape (W, T)
        Residuals of least squares, 0 for missing samples.
    lengths : np.ndarray of int, shape (W,)
        How many there are in each window.
    taken : np.ndarray, shape (W, T, k)
        This quantity's rows of orthonormal directions that the unknowns took from residuals.

    """

    def __init__(self, residuals: np.ndarray, lengths: np.ndarray, taken: np.ndarray):
        # Each quantity in each window by itself: what others tell has a correlation of its own.
        left, sizes, _ = np.linalg.svd(taken, full_matrices=False)
        kept = sizes**2 > _TAKEN
        most = int(kept.sum(axis=1).max(initial=0))
        left, kept = np.where(kept[:, None], left, 0.0)[:, :, :most], kept[:, :most]
        # Where windows have fewer directions than others.
        self._blank = np.zeros((len(residuals), most + 1, most + 1))
        self._blank[:, range(most), range(most)] = ~kept
        self.freedom = max(1, int(lengths.sum()) - int(kept.sum()))
        self.highest = max(0, min(_ORDERS, self.freedom // _SAMPLES, int(lengths.min()) // 2 - 1))
        columns = np.concatenate([left, residuals[:, :, None]], axis=2)
        self._windows = len(lengths)
        self._products = _lagged(columns, lengths, self.highest)

    def minus_log(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return minus its logarithm for N processes, and variances of their white noise, (N,)."""
        if len(x) > 1 and len(x) * self._blank.size > _AT_ONCE:
            one, other = zip(*map(self.minus_log, np.array_split(x, 2)), strict=True)
            return np.concatenate(one), np.concatenate(other)
        reflections = np.tanh(np.clip(x, -_MOST, _MOST))
        a = _polynomials(reflections)
        i, j = _pairs(x.shape[1])
        rest = 1.0 - reflections**2
        matrix = np.tensordot(a[:, i] * a[:, j], self._products[:len(i)], 1) \
            + self._blank + _ROUNDING * np.eye(self._blank.shape[1])
        # The Cholesky factor's last diagonal entry is the residual that the other columns leave.
        roots = np.einsum('nwii->nwi', np.linalg.cholesky(matrix))
        variance = (roots[..., -1]**2).sum(axis=1) / self.freedom
        return 0.5 * self.freedom * np.log(variance) + np.log(roots[..., :-1]).sum(axis=(1, 2)) \
            - 0.5 * self._windows * np.log(rest) @ np.arange(1, x.shape[1] + 1), variance

    def costs(self, x: np.ndarray) -> np.ndarray:
        """
        Return minus the logarithm of the posterior of N processes, (N,).

        All reflection coefficients are as likely beforehand, by density 1 / cosh^2 x, up to those
        that it would take thousands of samples to tell from 1.
        """
        beyond = np.maximum(np.abs(x) - _MOST, 0.0)
        return self.minus_log(x)[0] + (
            2.0 * (np.logaddexp(x, -x) - math.log(2.0)) + 1e3 * beyond**2).sum(axis=1)

    def best(self, x: np.ndarray) -> np.ndarray:
        """Return the likeliest process of an order, from x on."""
        # In units in which the posterior bends by about 1.
        unit = 1.0 / math.sqrt(self.freedom)
        step = _SLOPE * np.eye(len(x))

        def cost(z: np.ndarray) -> tuple[float, np.ndarray]:
            values = self.costs(unit * (z + np.concatenate([0.0 * step[:1], step, -step])))
            ahead, back = np.split(values[1:], 2)
            return float(values[0]), (ahead - back) / (2.0 * _SLOPE)
        return unit * minimize(cost, x / unit, jac=True, method='BFGS',
                               options={'gtol': 1e-2, 'maxiter': 50}).x

    def bend(self, x: np.ndarray) -> np.ndarray:
        """Return the second derivatives of the cost, shape (p, p)."""
        steps = _BEND * np.eye(len(x))
        i, j = _pairs(len(x) - 1)
        value, ahead, back, both, neither = (self.costs(x + part) for part in (
            0.0 * steps[:1], steps, -steps, steps[i] + steps[j], -steps[i] - steps[j]))
        sides = ahead + back - 2.0 * value
        bend = np.zeros(steps.shape)
        bend[i, j] = bend[j, i] = 0.5 * (both + neither - 2.0 * value - sides[i] - sides[j])
        return bend / _BEND**2


def _lagged(columns: np.ndarray, lengths: np.ndarray, highest: int) -> np.ndarray:
    """
    Return the sums over time of columns times columns, of which the likelihood consists.

    Parameters
    ----------
    columns : np.ndarray, shape (W, T, k)
        Of windows of various lengths.
    lengths : np.ndarray of int, shape (W,)
        Those.
    highest : int
        Of the orders.

    Returns
    -------
    np.ndarray, shape ((highest + 1) (highest + 2) / 2, W, k, k)
        Sums of x_{t+i} x_{t+j} over all t < n - i - j, for the pairs of i and j of _pairs; of
        different ones twice, with either first.

    """
    pairs = np.transpose(_pairs(highest))
    w, _, k = columns.shape
    found = np.empty((len(pairs), w, k, k))
    for n in np.unique(lengths):
        rows = np.flatnonzero(lengths == n)
        own = columns[rows, :n]
        for at, (i, j) in enumerate(pairs):
            product = own[:, i:n - j].swapaxes(1, 2) @ own[:, j:n - i]
            found[at, rows] = product if i == j else product + product.swapaxes(1, 2)
    return found


@cache
def _pairs(highest: int) -> tuple[np.ndarray, np.ndarray]:
    """Return pairs of numbers up to the highest, i <= j; those of fewer come first."""
    j, i = np.tril_indices(highest + 1)
    return i, j


def processes(residuals: np.ndarray, lengths: np.ndarray, taken: np.ndarray,
              random: np.random.Generator) -> list[Process]:
    """
    Return processes that can have left residuals, each as likely as the others.

    Parameters
    ----------
    residuals, lengths, taken
        See _Restricted.
    random : np.random.Generator
        Draws them.

    """
    size = float(np.linalg.norm(residuals))
    if size == 0.0:
        return [Process(np.zeros(0), 0.0)] * _KEPT
    likelihood = _Restricted(residuals / size, lengths, taken)
    models = _models(likelihood)
    best = min(cost for _, cost in models)
    found, weights = zip(*(_drawn(likelihood, x, random, math.exp(best - cost))
                           for x, cost in models if cost - best < _BEHIND), strict=True)
    found, weights = [one for part in found for one in part], np.concatenate(weights)
    # One after another by their weights, then mixed: other quantities go with any of them.
    at = np.searchsorted(np.cumsum(weights) / weights.sum(), (np.arange(_KEPT) + 0.5) / _KEPT)
    kept = {k: found[k]._replace(variance=size**2 * found[k].variance) for k in np.unique(at)}
    return [kept[k] for k in random.permutation(at)]


def _models(likelihood: _Restricted) -> list[tuple[np.ndarray, float]]:
    """Return the likeliest process of each order, and what it costs."""
    x = np.zeros(0)
    models = [(x, float(likelihood.costs(x[None])[0]))]
    for order in range(1, likelihood.highest + 1):
        starts = np.array([[*x, last] for last in (-1.0, -0.3, -0.05, 0.05, 0.3, 1.0)])
        x = likelihood.best(starts[np.argmin(likelihood.costs(starts))])
        # More in few samples: C. Hurvich, C.-L. Tsai, Biometrika 76 (1989).
        price = _PRICE * likelihood.freedom / (likelihood.freedom - order - 2)
        models.append((x, float(likelihood.costs(x[None])[0]) + 0.5 * price * order))
        if int(np.argmin([cost for _, cost in models])) <= order - _IN_VAIN:
            break
    return models


def _drawn(likelihood: _Restricted, x: np.ndarray, random: np.random.Generator, weight: float
           ) -> tuple[list[Process], np.ndarray]:
    """Return processes of the order of the likeliest one, and their weights, of a given sum."""
    if not len(x):
        return [Process(x, float(likelihood.minus_log(x[None])[1][0]))], np.array([weight])
    sizes, rows = np.linalg.eigh(likelihood.bend(x))
    normal = random.normal(size=(_DRAWN, len(x)))
    normal /= np.sqrt(random.chisquare(_TAILS, size=(_DRAWN, 1)) / _TAILS)
    tried = x + normal / np.sqrt(np.maximum(sizes, 0.25)) @ rows.T
    weights = 0.5 * (_TAILS + len(x)) * np.log1p((normal**2).sum(axis=1) / _TAILS) \
        - likelihood.costs(tried)
    weights = np.exp(weights - weights.max())
    return [Process(*one) for one in zip(
        np.tanh(np.clip(tried, -_MOST, _MOST)), likelihood.minus_log(tried)[1], strict=True)
            ], weight / weights.sum() * weights


def covariances(influences: np.ndarray, noise: Sequence[Sequence[Process]]) -> np.ndarray:
    """
    Return the covariance of sums over noise, one for each of the processes it can be.

    Parameters
    ----------
    influences : np.ndarray, shape (W, T, C, u)
        Factors of the noise of each sample in u sums; 0 for missing samples.
    noise : sequence of sequence of Process
        Of each of C quantities as many.

    Returns
    -------
    np.ndarray, shape (N, u, u)

    """
    _, samples, quantities, count = influences.shape
    total = np.zeros((len(noise[0]), count, count))
    for c in range(quantities):
        # Each once, however often it was kept.
        known = {id(one): one for one in noise[c]}
        by_lag = np.stack([one.autocovariances(samples) for one in known.values()])
        waves = np.fft.rfft(influences[:, :, c], 2 * samples, axis=1)
        own = np.empty((len(known), count, count))
        for i in range(count):
            lagged = np.fft.irfft(np.einsum('wf,wfj->fj', waves[:, :, i].conj(), waves), axis=0)
            lagged[1:samples] += lagged[:samples:-1]
            own[:, i] = by_lag @ lagged[:samples]
        at = {key: k for k, key in enumerate(known)}
        total += own[[at[id(one)] for one in noise[c]]]
    return total


CONFIDENCE = 0.95
# Which share of a direction that the data do not determine names a number, by what its part of it
# does to the motion: of a number next to zero any change is large relative to its value.
_SHARE = 1e-3
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
        number may change if the others do, the largest 1 or -1.
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


def estimates_of(solution: Solution, problem: FitProblem, free: FreeScene,
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
        units = np.concatenate([units, *(_norms(solution.by_starts[w].reshape(
            -1, back.shape[1])) for _, w in rows)])
        for k, (run, w) in enumerate(rows):
            own, inverse, _ = starts[w]
            at = n + k * own.shape[1]
            influences[w, ..., at:at + own.shape[1]] += (own @ inverse).reshape(*shape[1:], -1)
            names += _state_names(coordinates, run if len(rows) > 1 else '')
            values += [*solution.starts[w]]
    # Of the robust loss psi = w r, whose slope is w^3; the projection took w in place of it.
    bend = float((weights[solution.windows.there]**3).mean())
    found = covariances(influences, noise) / bend**2
    coloured = np.array([np.median([one.samples_as_one for one in own])
                         if all(len(one.reflections) for one in own) else 1.0 for own in noise])
    return _told(names, np.array(values), found, null * units[:, None], units, solution.freedom,
                 coloured)


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
        scale = _norms(slopes)
    sizes, rows, told = told_directions(slopes / scale)
    factors = np.where(told[:, None], rows, 0.0) / (
        np.where(told, sizes, 1.0)[:, None] * scale)
    return slopes @ factors.T, factors, rows[~told].T / scale[:, None]


def _norms(slopes: np.ndarray) -> np.ndarray:
    """Return the norms of columns, 1 for those that are zero."""
    raw = np.linalg.norm(slopes, axis=0)
    return np.where(raw > 0.0, raw, 1.0)


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
          null: np.ndarray, units: np.ndarray, freedom: int, coloured: np.ndarray) -> Estimates:
    """Return the estimates; those with a share in what the data do not tell have no interval."""
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
    """Return parts of directions, one a column, over the largest of each."""
    largest = np.abs(directions).max(axis=0, initial=0.0)
    return np.asarray(np.abs(directions) / np.where(largest > 0.0, largest, 1.0))


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


def profile(solution: Solution, problem: FitProblem, free: FreeScene, estimate: Estimate
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
