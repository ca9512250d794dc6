# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Noise of measured quantities, correlated in time.

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

from collections.abc import Sequence
from functools import cache
import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.signal import lfilter, lfiltic

# Maximum order, samples per order, and number of successive useless orders at which to stop.
_ORDERS, _SAMPLES, _IN_VAIN = 12, 8, 4
# Penalty per coefficient of twice the log likelihood, for many samples. Akaike's 2 makes intervals
# of short logs too narrow if the noise has several time scales; 1 makes those of white noise too
# wide.
_PRICE = 1.5
# Models that cost more than the best one by this are dropped: their weight is 2 %.
_BEHIND = 4.0
# Number of processes drawn per order and kept in total; and the degrees of freedom of the proposal
# distribution, whose tails are longer than the likelihood's.
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


_SILENT = Process(np.zeros(0), 0.0)


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
        return [_SILENT] * _KEPT
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


def likeliest(residuals: np.ndarray, lengths: np.ndarray, taken: np.ndarray) -> Process:
    """Return the most probable noise process of residuals; see _Restricted."""
    size = float(np.linalg.norm(residuals))
    if size == 0.0:
        return _SILENT
    likelihood = _Restricted(residuals / size, lengths, taken)
    x, _ = min(_models(likelihood), key=lambda model: model[1])
    return Process(np.tanh(np.clip(x, -_MOST, _MOST)),
                   size**2 * float(likelihood.minus_log(x[None])[1][0]))


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
