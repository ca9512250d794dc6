# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Statistics of fitted numbers: confidence intervals, and numbers that data do not determine.

The noise of a measured quantity is modelled as autoregressive: e_t + a_1 e_{t-1} + ... + a_p
e_{t-p} is white. A fit makes residuals smaller and less correlated than the noise, mostly in the
directions of the motion itself. Processes are therefore compared by the restricted likelihood,
which excludes these directions. Short logs leave several processes and orders possible: all are
kept, in proportion to their probability.

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

# Maximum order, samples per order, and number of successive useless orders at which to stop.
_ORDERS, _SAMPLES, _IN_VAIN = 12, 8, 4
# Penalty per coefficient of twice the log likelihood, for many samples. Akaike's 2 makes intervals
# of short logs too narrow if the noise has several time scales; 1 makes those of white noise too
# wide.
_PRICE = 1.5
# Models that cost more than the best one by this are dropped: their weight is 2 %.
_BEHIND = 4.0
# Number of processes drawn per order and kept in total; and the degrees of freedom of the proposal
# distribution, whose tails are longer than those of the likelihood.
_DRAWN, _KEPT, _TAILS = 200, 400, 5.0
# Maximum of x in reflection coefficients k = tanh x.
_MOST = 6.0
# Directions that lose less than this share to the unknowns count as unaffected.
_TAKEN = 0.02
# Steps of finite differences of costs, for first (scaled) and for second derivatives.
_SLOPE, _BEND = 1e-4, 3e-3
# Variance of white noise due to rounding, relative to the total variance.
_ROUNDING = 1e-8
# Maximum size of temporary arrays.
_AT_ONCE = 1 << 22


class Process(NamedTuple):
    """
    An autoregressive process.

    Parameters
    ----------
    reflections : np.ndarray, shape (p,)
        Its reflection coefficients (partial autocorrelations), of size < 1.
    variance : float
        Variance of its white noise.

    """

    reflections: np.ndarray
    variance: float

    def autocovariances(self, count: int) -> np.ndarray:
        """Return the autocovariances at lags 0, 1, ..., shape (count,)."""
        found, left = [1.0], 1.0
        for p, k in enumerate(self.reflections):  # Levinson-Durbin recursion
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
        """Return the sum of all correlations: the number of samples worth one independent one."""
        a = _polynomials(self.reflections[None])[0]
        return float(self.variance / a.sum()**2 / self.autocovariances(1)[0])


def _polynomials(reflections: np.ndarray) -> np.ndarray:
    """Return the polynomials 1, a_1, ... a_p, shape (N, p + 1), of reflections, shape (N, p)."""
    a = np.zeros((len(reflections), reflections.shape[1] + 1))
    a[:, 0] = 1.0
    for p, k in enumerate(reflections.T, 2):
        a[:, :p] -= k[:, None] * a[:, p - 1::-1]
    return a


class _Restricted:
    """
    Restricted likelihood of processes, given residuals of one quantity in W windows.

    Parameters
    ----------
    residuals : np.ndarray, shape (W, T)
        Residuals of least squares, 0 for missing samples.
    lengths : np.ndarray of int, shape (W,)
        Number of samples in each window.
    taken : np.ndarray, shape (W, T, k)
        Orthonormal directions removed from the residuals by the unknowns: rows of this quantity.

    """

    def __init__(self, residuals: np.ndarray, lengths: np.ndarray, taken: np.ndarray):
        # Each quantity and window separately: across quantities the noise has other correlations.
        left, sizes, _ = np.linalg.svd(taken, full_matrices=False)
        kept = sizes**2 > _TAKEN
        most = int(kept.sum(axis=1).max(initial=0))
        left, kept = np.where(kept[:, None], left, 0.0)[:, :, :most], kept[:, :most]
        # Padding for windows with fewer directions than others.
        self._blank = np.zeros((len(residuals), most + 1, most + 1))
        self._blank[:, range(most), range(most)] = ~kept
        self.freedom = max(1, int(lengths.sum()) - int(kept.sum()))
        self.highest = max(0, min(_ORDERS, self.freedom // _SAMPLES, int(lengths.min()) // 2 - 1))
        columns = np.concatenate([left, residuals[:, :, None]], axis=2)
        self._windows = len(lengths)
        self._products = _lagged(columns, lengths, self.highest)

    def minus_log(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the negative log likelihood of N processes, and their noise variances, (N,)."""
        if len(x) > 1 and len(x) * self._blank.size > _AT_ONCE:
            one, other = zip(*map(self.minus_log, np.array_split(x, 2)), strict=True)
            return np.concatenate(one), np.concatenate(other)
        reflections = np.tanh(np.clip(x, -_MOST, _MOST))
        a = _polynomials(reflections)
        i, j = _pairs(x.shape[1])
        rest = 1.0 - reflections**2
        matrix = np.tensordot(a[:, i] * a[:, j], self._products[:len(i)], 1) \
            + self._blank + _ROUNDING * np.eye(self._blank.shape[1])
        # The last diagonal entry of the Cholesky factor is the residual after the other columns.
        roots = np.einsum('nwii->nwi', np.linalg.cholesky(matrix))
        variance = (roots[..., -1]**2).sum(axis=1) / self.freedom
        return 0.5 * self.freedom * np.log(variance) + np.log(roots[..., :-1]).sum(axis=(1, 2)) \
            - 0.5 * self._windows * np.log(rest) @ np.arange(1, x.shape[1] + 1), variance

    def costs(self, x: np.ndarray) -> np.ndarray:
        """
        Return the negative log posterior of N processes, (N,).

        The prior of reflection coefficients is uniform: density 1 / cosh^2 x, up to values that
        only thousands of samples could tell from 1.
        """
        beyond = np.maximum(np.abs(x) - _MOST, 0.0)
        return self.minus_log(x)[0] + (
            2.0 * (np.logaddexp(x, -x) - math.log(2.0)) + 1e3 * beyond**2).sum(axis=1)

    def best(self, x: np.ndarray) -> np.ndarray:
        """Return the most probable process of an order, searched from x."""
        # Scaled so that second derivatives are about 1.
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
    Return the lagged products of columns summed over time, as the likelihood needs them.

    Parameters
    ----------
    columns : np.ndarray, shape (W, T, k)
        Columns of windows of various lengths.
    lengths : np.ndarray of int, shape (W,)
        Lengths of the windows.
    highest : int
        Highest order.

    Returns
    -------
    np.ndarray, shape ((highest + 1) (highest + 2) / 2, W, k, k)
        Sums of x_{t+i} x_{t+j} over all t < n - i - j, for the pairs of i and j of _pairs; pairs
        with i != j are symmetrised (summed over both orders).

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
    """Return the index pairs i <= j up to the highest; pairs of lower orders come first."""
    j, i = np.tril_indices(highest + 1)
    return i, j


def processes(residuals: np.ndarray, lengths: np.ndarray, taken: np.ndarray,
              random: np.random.Generator) -> list[Process]:
    """
    Return a sample of noise processes consistent with residuals, equally weighted.

    Parameters
    ----------
    residuals, lengths, taken
        See _Restricted.
    random : np.random.Generator
        Generator of the draws.

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
    # Systematic resampling, then shuffled, so that quantities combine independently.
    at = np.searchsorted(np.cumsum(weights) / weights.sum(), (np.arange(_KEPT) + 0.5) / _KEPT)
    kept = {k: found[k]._replace(variance=size**2 * found[k].variance) for k in np.unique(at)}
    return [kept[k] for k in random.permutation(at)]


def _models(likelihood: _Restricted) -> list[tuple[np.ndarray, float]]:
    """Return the most probable process of each order, and its cost."""
    x = np.zeros(0)
    models = [(x, float(likelihood.costs(x[None])[0]))]
    for order in range(1, likelihood.highest + 1):
        starts = np.array([[*x, last] for last in (-1.0, -0.3, -0.05, 0.05, 0.3, 1.0)])
        x = likelihood.best(starts[np.argmin(likelihood.costs(starts))])
        # Higher in small samples: C. Hurvich, C.-L. Tsai, Biometrika 76 (1989).
        price = _PRICE * likelihood.freedom / (likelihood.freedom - order - 2)
        models.append((x, float(likelihood.costs(x[None])[0]) + 0.5 * price * order))
        if int(np.argmin([cost for _, cost in models])) <= order - _IN_VAIN:
            break
    return models


def _drawn(likelihood: _Restricted, x: np.ndarray, random: np.random.Generator, weight: float
           ) -> tuple[list[Process], np.ndarray]:
    """Return draws around the most probable process of an order, and weights with a given sum."""
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
    Return the covariances of weighted sums of noise, one for each sampled process.

    Parameters
    ----------
    influences : np.ndarray, shape (W, T, C, u)
        Factors of each noise sample in u sums; 0 for missing samples.
    noise : sequence of sequence of Process
        Equally many processes for each of C quantities.

    Returns
    -------
    np.ndarray, shape (N, u, u)

    """
    _, samples, quantities, count = influences.shape
    total = np.zeros((len(noise[0]), count, count))
    for c in range(quantities):
        # Each distinct process only once.
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
    identify_correlation); the intervals are those of the mixture.
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
    # For the robust loss psi = w r has slope w^3; the projection used w instead.
    bend = float((weights[solution.windows.there]**3).mean())
    found = covariances(influences, noise) / bend**2
    coloured = np.array([np.median([one.samples_as_one for one in own])
                         if all(len(one.reflections) for one in own) else 1.0 for own in noise])
    return _told(names, np.array(values), found, null * units[:, None], units, solution.freedom,
                 coloured)


def _solved(slopes: np.ndarray, scale: np.ndarray | None = None
            ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Solve a least-squares problem with derivatives of shape (N, n).

    Returns
    -------
    tuple of np.ndarray, shapes (N, n), (n, n) and (n, m)
        Orthonormal columns, 0 for undetermined directions; factors, such that the columns times
        the factors are the transpose of the pseudo-inverse; and the undetermined directions.

    """
    if scale is None:
        scale = _norms(slopes)
    sizes, rows, told = told_directions(slopes / scale)
    factors = np.where(told[:, None], rows, 0.0) / (
        np.where(told, sizes, 1.0)[:, None] * scale)
    return slopes @ factors.T, factors, rows[~told].T / scale[:, None]


def _norms(slopes: np.ndarray) -> np.ndarray:
    """Return the norms of columns, with 1 for zero columns."""
    raw = np.linalg.norm(slopes, axis=0)
    return np.where(raw > 0.0, raw, 1.0)


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


def _told(names: Sequence[tuple[str, str]], values: np.ndarray, covariances: np.ndarray,
          null: np.ndarray, units: np.ndarray, freedom: int, coloured: np.ndarray) -> Estimates:
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
    _, factors, _ = _solved(slopes.reshape(-1, slopes.shape[3]), units_of(solution))
    # The second derivative of the loss is w^3; 1 for squares.
    bend = (weights[solution.windows.there]**3).mean()
    return float(np.linalg.norm(factors[:, k])) / math.sqrt(bend)


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
