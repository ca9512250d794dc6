# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Least-squares fit of a model's numbers: multiple shooting with eliminated initial states.

The windows' initial states are unknowns as well, but each affects only its own window. For given
numbers they are therefore solved for window by window, and the part of the numbers' derivatives
that initial states cannot reproduce drives the search (variable projection).

G. Golub, V. Pereyra, Separable nonlinear least squares: the variable projection method and its
applications, Inverse Problems 19 (2003). H. G. Bock, Recent advances in parameter identification
techniques for O.D.E., 1983, on multiple shooting.
"""

from dataclasses import dataclass, replace
import math

from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.learning.fit.prediction import predicted_by, Prediction, PredictionByLoad
from hnn_vi_ros.learning.fit.windows import CannotFollow, ParametricModel, Windows
import numpy as np
from scipy.optimize import least_squares

# Residual at which the robust loss changes from quadratic to linear, in standard deviations.
_SOFT = 2.0
# Maximum of steps for the initial states, and gain in cost at which they stop, relative to the
# tolerance of the numbers.
_INNER, _GAIN = 30, 1e-2
# Residual assigned to a window that cannot be simulated, in standard deviations.
FAILED = 1e6
# Tolerance of the search at the end, and maximum number of evaluations.
TOLERANCE, _EVALUATIONS = 1e-8, 60
# Relative step that ends a search, in units of its tolerance: it is relative to the largest
# number, and others may be much smaller.
_STILL = 0.1
# Singular values of normalised columns below this are errors of rounding and differences.
_RANK = 1e-6


@dataclass(frozen=True, eq=False)
class Solution:
    """
    Best-fitting numbers and initial states of the windows.

    Parameters
    ----------
    values : np.ndarray, shape (n,)
        Values of the numbers.
    starts : np.ndarray, shape (W, 2 d)
        Initial states of the windows.
    residuals : np.ndarray, shape (W, T, C)
        Prediction minus measurement, in standard deviations; 0 for missing samples.
    by_starts, parameter_jacobian : np.ndarray, shapes (W, T, C, k) and (W, T, C, n)
        Derivatives of the residuals along ``Prediction.directions`` of the initial states, all
        2 d unless loops join coordinates, and with respect to the numbers.
    noise : np.ndarray, shape (C,)
        Standard deviations of the noise.
    windows : Windows
        The fitted windows.

    """

    values: np.ndarray
    starts: np.ndarray
    residuals: np.ndarray
    by_starts: np.ndarray
    parameter_jacobian: np.ndarray
    noise: np.ndarray
    windows: Windows

    @property
    def freedom(self) -> int:
        """Return the number of measured values minus the number of unknowns."""
        measured = int(self.windows.there.sum()) * self.residuals.shape[2]
        return measured - len(self.starts) * self.by_starts.shape[3] - self.values.size

    @property
    def misfit(self) -> float:
        """Return the square root of the sum of squared residuals per degree of freedom."""
        return math.sqrt(float((self.residuals**2).sum()) / self.freedom)


@dataclass(frozen=True, eq=False)
class FitProblem:
    """
    Fit of a model to windows.

    Parameters
    ----------
    model : ParametricModel
        Model with n free numbers.
    windows : Windows
        W windows.
    noise : np.ndarray, shape (C,)
        Standard deviation of each measured quantity.
    starts : np.ndarray, shape (W, 2 d)
        Initial guess of the initial states.
    robust : bool
        True to reduce the weight of outliers, with the loss soft_l1.
    tolerance : float
        Relative tolerance of the search.

    """

    model: ParametricModel
    windows: Windows
    noise: np.ndarray
    starts: np.ndarray
    robust: bool
    tolerance: float = TOLERANCE

    def weights(self, residuals: np.ndarray) -> np.ndarray:
        """Return the weight of each residual, 1 without outliers."""
        return 1.0 / np.sqrt(1.0 + (residuals / _SOFT)**2) if self.robust else \
            np.ones_like(residuals)

    def cost(self, residuals: np.ndarray) -> np.ndarray:
        """Return twice the cost of each window, shape (W,)."""
        squares = residuals**2
        if self.robust:
            squares = 2.0 * _SOFT**2 * (np.sqrt(1.0 + squares / _SOFT**2) - 1.0)
        return squares.sum(axis=(1, 2))

    def bend(self, solution: Solution) -> float:
        """Return the mean second derivative of the loss at a solution, w^3; 1 for squares."""
        return float((self.weights(solution.residuals)[solution.windows.there]**3).mean())

    def misfit(self, solution: Solution) -> float:
        """Return the misfit of a solution of these windows, in which outliers count less."""
        return math.sqrt(float(self.cost(solution.residuals).sum()) / solution.freedom)

    def scaled(self, values: np.ndarray) -> np.ndarray:
        """Return the scaled derivatives in standard deviations, 0 for missing samples."""
        shape = (1, 1, -1) + (1,) * (values.ndim - 3)
        there = self.windows.there.reshape(self.windows.there.shape + (1,) * (values.ndim - 2))
        return np.where(there, values / self.noise.reshape(shape), 0.0)

    def _evaluate(self, prediction: Prediction | PredictionByLoad, starts: np.ndarray,
                  only: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        predicted, slopes = prediction.by_starts(starts, only)
        return self.scaled(predicted - self.windows.measured), self.scaled(slopes)

    def descend(self, prediction: Prediction | PredictionByLoad, starts: np.ndarray
                ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Minimise over the initial states of all windows with Levenberg-Marquardt steps."""
        residuals, slopes = self._evaluate(prediction, starts)
        cost, damping = self.cost(residuals), np.full(len(starts), 1e-9)
        for _ in range(_INNER):
            weights = self.weights(residuals)[..., None]
            matrix = np.einsum('wtci,wtcj->wij', weights * slopes, slopes)
            downhill = -np.einsum('wtci,wtc->wi', weights * slopes, residuals)
            scale = np.sqrt(np.einsum('wii->wi', matrix)) + 1e-300
            with np.errstate(invalid='ignore'):  # windows may be far from all data
                unit = matrix / scale[:, :, None] / scale[:, None, :]
            unit += damping[:, None, None] * np.eye(slopes.shape[3])
            good = np.isfinite(unit).all(axis=(1, 2)) & np.isfinite(downhill).all(axis=1)
            change = np.zeros_like(downhill)
            change[good] = np.linalg.solve(
                unit[good], (downhill / scale)[good, :, None])[..., 0] / scale[good]
            gain = (change * downhill).sum(axis=1)
            open_ = good & (gain > _GAIN * self.tolerance * np.maximum(cost, 1e-12))
            if not open_.any():
                break
            tried = starts + np.einsum('kwi,wk->wi', prediction.directions(starts), np.where(
                open_[:, None], change, 0.0))
            # Most windows converge after a few steps: simulate only the remaining ones.
            new_residuals, new_slopes = self._evaluate(prediction, tried, open_)
            new_cost = self.cost(new_residuals)
            better = open_ & (new_cost < cost)
            damping = np.where(better, 0.1 * damping, np.where(open_, 100.0 * damping, damping))
            damping = np.clip(damping, 1e-12, 1e12)
            starts = np.where(better[:, None], tried, starts)
            residuals = np.where(better[:, None, None], new_residuals, residuals)
            slopes = np.where(better[:, None, None, None], new_slopes, slopes)
            cost = np.where(better, new_cost, cost)
        return starts, residuals, slopes


class _Residuals:
    """Residuals of a problem as a function of the free numbers only; the last ones are kept."""

    def __init__(self, problem: FitProblem):
        self._problem = problem
        self._starts, self._at = problem.starts, np.full(len(problem.model.numbers), np.nan)
        self._slope = np.zeros((*problem.starts.shape, len(problem.model.numbers)))
        self._solved: Solution | None = None
        self._key: bytes | None = None

    def residuals(self, values: np.ndarray) -> np.ndarray:
        """Return the residuals at the best initial states, flat, and n zeros; see ``slopes``."""
        own = np.nan_to_num(self._at_best(values)[1], nan=FAILED).ravel()
        return np.concatenate([own, np.zeros(len(values))])

    def slopes(self, values: np.ndarray) -> np.ndarray:
        """
        Return the derivatives of ``residuals`` with respect to the numbers, shape (N + n, n).

        The n zeros get artificial derivatives along directions that the data do not determine.
        Rounding errors along these would lead the search astray, so it does not move there.
        """
        solution = self.solve(values)
        back = projected(solution, self._problem.weights(solution.residuals))
        self._starts, self._at = solution.starts, solution.values
        self._slope = np.einsum(
            'kwi,wkn->win', self._prediction.directions(solution.starts), back[1])
        own = back[0].reshape(-1, len(values))
        units = units_of(solution)
        sizes, rows, told = identifiable_directions(own / units)
        held = np.where(told[:, None], 0.0, rows) * sizes.max(initial=1e-300)
        return np.concatenate([own / units @ rows[told].T @ rows[told], held]) * units

    def solve(self, values: np.ndarray) -> Solution:
        """Return the solution at given values of the numbers."""
        starts, residuals, by_starts = self._at_best(values)
        if self._solved is None or not np.array_equal(self._solved.values, values):
            jacobian = np.nan_to_num(self._problem.scaled(
                self._prediction.parameter_jacobian(starts)))
            self._solved = Solution(np.array(values), starts, residuals, by_starts, jacobian,
                                    self._problem.noise, self._problem.windows)
        return self._solved

    def _at_best(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the best initial states, the residuals, and their derivatives by the states."""
        key = np.asarray(values, dtype=float).tobytes()
        if key != self._key:
            starts = self._starts
            if np.isfinite(self._at).all():
                starts = starts + self._slope @ (values - self._at)
            try:
                self._prediction = predicted_by(self._problem.model, values, self._problem.windows)
                *best, slopes = self._problem.descend(self._prediction, starts)
                self._best = *best, np.nan_to_num(slopes)
            except HnnViRosError:
                # The values are invalid for the model, for example a negative mass.
                shape = self._problem.windows.measured.shape
                self._best = (self._starts, np.full(shape, np.nan),
                              np.zeros((*shape, self._starts.shape[1])))
            self._key = key
        return self._best


def projected(solution: Solution, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the part of the numbers' derivatives that initial states cannot reproduce.

    Returns
    -------
    np.ndarray, shape (W, T, C, n), and np.ndarray, shape (W, 2 d, n)
        Derivatives of the residuals at the best initial states, and of those states.

    """
    slopes, numbers = solution.by_starts, solution.parameter_jacobian
    # Orthogonal factors keep the precision; normal equations would lose half of the digits.
    w, t, c, n = slopes.shape
    root = np.sqrt(weights).reshape(w, t * c, 1)
    left, right = root * slopes.reshape(w, t * c, n), root * numbers.reshape(w, t * c, -1)
    scale = np.linalg.norm(left, axis=1, keepdims=True) + 1e-300
    back = -np.linalg.pinv(left / scale, rcond=1e-10) @ right / scale.swapaxes(1, 2)
    rest = numbers.reshape(w, t * c, -1) + slopes.reshape(w, t * c, n) @ back
    return rest.reshape(w, t, c, -1), back


def made_up(solution: Solution, weights: np.ndarray, change: np.ndarray
            ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the change of numbers that compensates a change of residuals, to first order.

    Returns
    -------
    np.ndarray, shape (n,), and np.ndarray, shape (W, T, C)
        Minus the change of the numbers, and the part of the residuals' change that is left.

    """
    units, root = units_of(solution), np.sqrt(weights)
    both = replace(solution, parameter_jacobian=np.concatenate(
        [solution.parameter_jacobian / units, change[..., None]], axis=-1))
    rows = (root[..., None] * projected(both, weights)[0]).reshape(-1, 1 + len(units))
    moved = np.linalg.lstsq(rows[:, :-1], rows[:, -1], rcond=_RANK)[0]
    return moved / units, (rows[:, -1] - rows[:, :-1] @ moved).reshape(change.shape) / root


def undetermined(solution: Solution, weights: np.ndarray) -> np.ndarray:
    """Return the directions, in units of ``units_of``, that the data do not determine, (n, m)."""
    units = units_of(solution)
    slopes = projected(solution, weights)[0].reshape(-1, len(units))
    return least_squares_factors(slopes, units)[2] * units[:, None]


def units_of(solution: Solution) -> np.ndarray:
    """Return the effect of each number on the residuals, the norm of its derivatives, (n,)."""
    return column_norms(solution.parameter_jacobian[solution.windows.there].reshape(
        -1, len(solution.values)))


def identifiable_directions(slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the directions of the numbers that the data determine.

    Parameters
    ----------
    slopes : np.ndarray, shape (N, n)
        Scaled derivatives of the residuals, projected as in ``projected``.

    Returns
    -------
    tuple of np.ndarray, shapes (n,), (n, n) and (n,)
        Singular values; directions, one per row; and a mask of those above rounding.

    """
    _, sizes, rows = np.linalg.svd(slopes, full_matrices=False)
    return sizes, rows, sizes > _RANK * max(1.0, sizes.max(initial=0.0))


def least_squares_factors(slopes: np.ndarray, scale: np.ndarray | None = None
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
        scale = column_norms(slopes)
    sizes, rows, told = identifiable_directions(slopes / scale)
    factors = np.where(told[:, None], rows, 0.0) / (np.where(told, sizes, 1.0)[:, None] * scale)
    return slopes @ factors.T, factors, rows[~told].T / scale[:, None]


def column_norms(slopes: np.ndarray) -> np.ndarray:
    """Return the norms of columns, with 1 for zero columns."""
    raw = np.linalg.norm(slopes, axis=0)
    return np.where(raw > 0.0, raw, 1.0)


def search(problem: FitProblem, values: np.ndarray, tolerance: float = TOLERANCE,
           evaluations: int = _EVALUATIONS) -> Solution:
    """Return the best values of the numbers, searched from an initial guess."""
    problem = replace(problem, tolerance=tolerance)
    found = _Residuals(problem)
    first = found.residuals(values)
    if not values.size:
        return found.solve(values)
    if (first == FAILED).any():
        raise CannotFollow(
            f'{problem.model.name} cannot be simulated over all windows with its current values; '
            'change them in the scene, or shorten --horizon')
    low, high = np.array([[number.low, number.high] for number in problem.model.numbers]).T
    # Not from the projected derivatives: they would scale up directions of pure rounding.
    units = 1.0 / units_of(found.solve(values))
    # Interior points crawl along a bound, where many numbers of bodies end.
    closed = all(number.closed for number in problem.model.numbers)
    best = least_squares(
        found.residuals, values, found.slopes, bounds=(low, high), x_scale=units,
        method='dogbox' if closed else 'trf', loss='soft_l1' if problem.robust else 'linear',
        f_scale=_SOFT, ftol=tolerance, xtol=_STILL * tolerance, gtol=tolerance,
        max_nfev=evaluations)
    return found.solve(best.x)
