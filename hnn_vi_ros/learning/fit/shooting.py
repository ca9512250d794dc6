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

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
from typing import NamedTuple

from hnn_vi_ros.errors import DataError, HnnViRosError
from hnn_vi_ros.hamiltonians import momentum
from hnn_vi_ros.learning.data.motions import EvenMotion
from hnn_vi_ros.learning.fit.noise import covariances, likeliest, Process
from hnn_vi_ros.learning.fit.windows import (
    CannotFollow, cut_windows, ParametricModel, Prediction, refined, Seen, Windows)
import numpy as np
from scipy.optimize import least_squares

# Minimum noise relative to the measured range: the size of rounding errors.
_LEAST_NOISE = 1e-9
_LEAST_SAMPLES = 10


def first_noise(motions: Sequence[EvenMotion]) -> np.ndarray:
    """Return a noise estimate from third differences, which are small for smooth motion."""
    thirds = np.concatenate([np.diff(motion.measured, 3, axis=0) for motion in motions])
    least = least_noise(np.concatenate([motion.measured for motion in motions]))
    return np.maximum(np.sqrt((thirds**2).mean(axis=0) / 20.0), least)


def least_noise(measured: np.ndarray) -> np.ndarray:
    """Return the noise caused by rounding, shape (C,)."""
    return _LEAST_NOISE * (np.ptp(measured, axis=0) + 1e-300)


def first_length(motions: Sequence[EvenMotion]) -> float:
    """Return an initial window length [s]: four time scales of the motion."""
    q, v = (np.concatenate([getattr(motion, name) for motion in motions])
            for name in ('q_smooth', 'v_smooth'))
    speed = np.sqrt((v**2).mean(axis=0))
    if not speed.any():
        raise DataError(f'{motions[0].name}: no coordinate moves, so no parameter can be '
                        'identified')
    pace = float((q.std(axis=0)[speed > 0.0] / speed[speed > 0.0]).min())
    least = 2 * _LEAST_SAMPLES if motions[0].v is None else _LEAST_SAMPLES
    return max(4.0 * pace, (least - 1) * motions[0].spacing)


# Residual at which the robust loss changes from quadratic to linear, in standard deviations.
_SOFT = 2.0
# Maximum of steps for the initial states, and gain in cost at which they stop, relative to the
# tolerance of the numbers.
_INNER, _GAIN = 30, 1e-2
# Size of normal residuals after the weights of the robust loss, (E[x^2 / (1 + (x / 2)^2)])^(1/2).
_WEIGHTED = 0.793
# Residual assigned to a window that cannot be simulated, in standard deviations.
_FAILED = 1e6
# Tolerances of the search at the end and before, and maximum number of evaluations.
_TOLERANCE, _ROUGH, _EVALUATIONS = 1e-8, 1e-4, 60
# Maximum number of windows that show the noise of the sensors, and degree of polynomials that
# follow 0.6 of a period of any motion to 0.3 %.
_ENOUGH, _DEGREE = 200, 5
# Residuals smaller than this share of the noise show that it was estimated in a poor fit.
_SMALLER = 0.8
# Residuals of the first windows, relative to differences of neighbours, that show a false
# minimum: shorter windows have none.
_FALSE = 10.0
# Number of places from which the search of unmeasured initial states begins.
_PLACES = 12
# Growth factor of the windows, and the growth of residuals at which they stop growing.
_LONGER, _GROWTH = 3.0, 1.5
# Residual in units of the noise beyond which longer windows tell nothing more.
_POOR = 5.0
# Ratios of misfits up to which fits are the same, and up to which one may still win.
_SAME, _AS_GOOD = 1.001, 1.05
# Singular values of normalised columns below this are errors of rounding and differences.
_RANK = 1e-6
# Relative change of the noise that requires no further search; and maximum of searches.
_SETTLED, _ROUNDS = 0.1, 6


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
    by_starts, by_numbers : np.ndarray, shapes (W, T, C, k) and (W, T, C, n)
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
    by_numbers: np.ndarray
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


class FitProblem:
    """
    Residuals of windows as a function of the free numbers only.

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

    """

    def __init__(self, model: ParametricModel, windows: Windows, noise: np.ndarray,
                 starts: np.ndarray, robust: bool):
        self.model, self.windows, self.noise, self.robust = model, windows, noise, robust
        self.tolerance = _TOLERANCE
        self._starts, self._at = starts, np.full(len(model.numbers), np.nan)
        self._slope = np.zeros((*starts.shape, len(model.numbers)))
        self._solved: Solution | None = None
        self._key: bytes | None = None

    def residuals(self, values: np.ndarray) -> np.ndarray:
        """Return the residuals at the best initial states, flat, and n zeros; see ``slopes``."""
        own = np.nan_to_num(self._at_best(values)[1], nan=_FAILED).ravel()
        return np.concatenate([own, np.zeros(len(values))])

    def slopes(self, values: np.ndarray) -> np.ndarray:
        """
        Return the derivatives of ``residuals`` with respect to the numbers, shape (N + n, n).

        The n zeros get artificial derivatives along directions that the data do not determine.
        Rounding errors along these would lead the search astray, so it does not move there.
        """
        solution = self.solve(values)
        back = projected(solution, self.weights(solution.residuals))
        self._starts, self._at = solution.starts, solution.values
        self._slope = np.einsum(
            'kwi,wkn->win', self._prediction.directions(solution.starts), back[1])
        own = back[0].reshape(-1, len(values))
        units = units_of(solution)
        sizes, rows, told = told_directions(own / units)
        held = np.where(told[:, None], 0.0, rows) * sizes.max(initial=1e-300)
        return np.concatenate([own / units @ rows[told].T @ rows[told], held]) * units

    def solve(self, values: np.ndarray) -> Solution:
        """Return the solution at given values of the numbers."""
        starts, residuals, by_starts = self._at_best(values)
        if self._solved is None or not np.array_equal(self._solved.values, values):
            by_numbers = np.nan_to_num(self._scaled(self._prediction.by_numbers(starts)))
            self._solved = Solution(np.array(values), starts, residuals, by_starts, by_numbers,
                                    self.noise, self.windows)
        return self._solved

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

    def _scaled(self, values: np.ndarray) -> np.ndarray:
        """Return the scaled derivatives in standard deviations, 0 for missing samples."""
        shape = (1, 1, -1) + (1,) * (values.ndim - 3)
        there = self.windows.there.reshape(self.windows.there.shape + (1,) * (values.ndim - 2))
        return np.where(there, values / self.noise.reshape(shape), 0.0)

    def _at_best(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the best initial states, the residuals, and their derivatives by the states."""
        key = np.asarray(values, dtype=float).tobytes()
        if key != self._key:
            starts = self._starts
            if np.isfinite(self._at).all():
                starts = starts + self._slope @ (values - self._at)
            try:
                self._prediction = Prediction(self.model, values, self.windows)
                *best, slopes = self.descend(self._prediction, starts)
                self._best = *best, np.nan_to_num(slopes)
            except HnnViRosError:
                # The values are invalid for the model, for example a negative mass.
                shape = self.windows.measured.shape
                self._best = (self._starts, np.full(shape, np.nan),
                              np.zeros((*shape, self._starts.shape[1])))
            self._key = key
        return self._best

    def _evaluate(self, prediction: Prediction, starts: np.ndarray,
                  only: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        predicted, slopes = prediction.by_starts(starts, only)
        return self._scaled(predicted - self.windows.measured), self._scaled(slopes)

    def descend(self, prediction: Prediction, starts: np.ndarray
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
            open_ = good & (gain > _GAIN * self.tolerance * np.maximum(
                cost, 1e-12))
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


def projected(solution: Solution, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the part of the numbers' derivatives that initial states cannot reproduce.

    Returns
    -------
    np.ndarray, shape (W, T, C, n), and np.ndarray, shape (W, 2 d, n)
        Derivatives of the residuals at the best initial states, and of those states.

    """
    slopes, numbers = solution.by_starts, solution.by_numbers
    # Orthogonal factors keep the precision; normal equations would lose half of the digits.
    w, t, c, n = slopes.shape
    root = np.sqrt(weights).reshape(w, t * c, 1)
    left, right = root * slopes.reshape(w, t * c, n), root * numbers.reshape(w, t * c, -1)
    scale = np.linalg.norm(left, axis=1, keepdims=True) + 1e-300
    back = -np.linalg.pinv(left / scale, rcond=1e-10) @ right / scale.swapaxes(1, 2)
    rest = numbers.reshape(w, t * c, -1) + slopes.reshape(w, t * c, n) @ back
    return rest.reshape(w, t, c, -1), back


def units_of(solution: Solution) -> np.ndarray:
    """Return the effect of each number on the residuals, the norm of its derivatives, (n,)."""
    raw = np.linalg.norm(solution.by_numbers[solution.windows.there].reshape(
        -1, len(solution.values)), axis=0)
    return np.where(raw > 0.0, raw, 1.0)


def told_directions(slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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


class Fitted(NamedTuple):
    """
    Fit of a model.

    Parameters
    ----------
    fits : list of (float, Solution, FitProblem)
        Length of the windows [s], solution and problem of each stage.
    stages : list of (float, float)
        Length [s] and residuals of each stage, relative to those expected of the noise.
    sensor : list of Process
        Noise of each measured quantity, from the shortest windows.

    """

    fits: list[tuple[float, Solution, FitProblem]]
    stages: list[tuple[float, float]]
    sensor: list[Process]

    @property
    def solution(self) -> Solution:
        """Return the solution in the longest windows."""
        return self.fits[-1][1]

    @property
    def problem(self) -> FitProblem:
        """Return the problem in the longest windows."""
        return self.fits[-1][2]

    @property
    def noise(self) -> np.ndarray:
        """
        Return the noise of the sensors, shape (C,).

        The smaller of two upper bounds: errors of the model add to the residuals of the shortest
        windows, and smooth ones look like a process of large variance.
        """
        shortest = self.fits[0][1]
        sizes = np.sqrt([one.autocovariances(1)[0] for one in self.sensor]) / (
            _WEIGHTED if self.problem.robust else 1.0)
        least = least_noise(shortest.windows.measured[shortest.windows.there])
        return np.maximum(np.minimum(sizes, shortest.noise), least)

    @property
    def size(self) -> float:
        """Return the size of the residuals in the longest windows, to compare with others."""
        return self.solution.misfit * float(np.exp(np.log(self.solution.noise).mean()))


def fit_numbers(models: Sequence[ParametricModel], motions: Sequence[EvenMotion],
                horizon: float | None, robust: bool, seen: Seen | None = None,
                tolerance: float = _TOLERANCE) -> Fitted:
    """
    Fit the free numbers in growing windows: short ones first, because they have no false minima.

    Parameters
    ----------
    models : sequence of ParametricModel
        Models with free numbers. If there are several, those that fit as well as the best one go
        on from each length of the windows to the next.
    motions : sequence of EvenMotion
        Measured motions; either all or none have velocities.
    horizon : float, optional
        Final length of the windows [s]; by default they grow up to whole runs, as long as
        residuals do not grow by more than a half.
    robust : bool
        See FitProblem.
    seen : Seen, optional
        The measured coordinates; by default all.
    tolerance : float, optional
        Relative tolerance of the last search.

    Raises
    ------
    DataError
        The data are too few, or no initial guess can be simulated over them.

    """
    longest = max(motion.t[-1] - motion.t[0] for motion in motions)
    wanted = longest if horizon is None else min(horizon, longest)
    share = 1.0 if seen is None else _hidden(seen)
    # Internal variables of effects are zero at the start of a run, and unknown within it.
    whole = any(effect.internal for model in models for effect in model.parts_at(
        np.array([number.start for number in model.numbers])).effects)
    if whole and wanted < longest:
        raise DataError(f'--horizon {wanted:g}: the scene has effects with internal variables, '
                        'which are known at the start of a run only; leave out --horizon')
    length = longest if whole else min(first_length(motions) * share, wanted)
    least = (2 * _LEAST_SAMPLES - 1) * motions[0].spacing * share
    noise = first_noise(motions)
    alive: list[tuple[ParametricModel, Fitted | None]] = [(model, None) for model in models]
    while True:
        found: list[tuple[Fitted, Fitted | None]] = []
        for model, before in alive:
            try:
                found.append((longer(
                    model, motions, length, noise, robust,
                    tolerance if length >= wanted else _ROUGH, before, seen), before))
            except CannotFollow:
                if not found and model is alive[-1][0] and (
                        before is None or horizon is not None):
                    raise
        if not found and (before := alive[0][1]) is not None:
            return refitted(before, before.problem.model, before.solution.values, tolerance)
        best, before = min(found, key=lambda pair: pair[0].size)
        shorter = length / _LONGER
        if not whole and before is None and shorter >= least and \
                best.size > _FALSE * float(np.exp(np.log(noise).mean())):
            length = shorter
            continue
        best = _judged(best)
        if horizon is None and before is not None and \
                best.stages[-1][1] > _GROWTH * best.stages[-2][1]:
            return refitted(before, before.problem.model, before.solution.values, tolerance
                            )._replace(stages=best.stages)
        if length >= wanted:
            return best
        # Starts that lead to the same optimum have the same misfit.
        alive = [(best.problem.model, best), *(
            (one.problem.model, _judged(one)) for one, _ in found
            if _SAME < one.size / best.size < _AS_GOOD)]
        length = min(_LONGER * length, wanted)


def _hidden(seen: Seen) -> float:
    """Return the number of coordinates per measured one."""
    return len(seen.spread) / len(seen.columns)


def _searched(model: ParametricModel, windows: Windows, noise: np.ndarray, starts: np.ndarray,
              values: np.ndarray, seen: Seen, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Return values and initial states, of which unmeasured ones are tried from several places."""
    random, d = np.random.default_rng(0), len(seen.spread)
    hidden = ~np.isin(np.arange(d), seen.columns)
    for _ in range(2):
        problem, prediction = FitProblem(model, windows, noise, starts, False), Prediction(
            model, values, windows)
        found, best = starts, np.full(len(starts), np.inf)
        for k in range(_PLACES + 1):
            q, v = windows.start.swapaxes(0, 1) + hidden * seen.spread * random.normal(
                size=(2, len(starts), d)) * np.array([1.0, 4.0 / length])[:, None, None]
            tried = starts if not k else np.hstack([
                q, momentum(prediction.hamiltonian, q, v, np.zeros_like(q))])
            ended, residuals, _ = problem.descend(prediction, tried)
            cost = problem.cost(residuals)
            better = cost < best
            best = np.where(better, cost, best)
            found = np.where(better[:, None], ended, found)
        solution = search(FitProblem(model, windows, noise, found, False), values, _ROUGH)
        values, starts = solution.values, solution.starts
    return values, starts


def fits_by_length(model: ParametricModel, motions: Sequence[EvenMotion], noise: np.ndarray
                   ) -> list[tuple[float, Solution, np.ndarray]]:
    """
    Fit the initial states of a model without free numbers in windows of several lengths.

    They grow up to whole runs, until all residuals are _POOR of the noise, or until a simulation
    fails.

    Parameters
    ----------
    model : ParametricModel
        Model without free numbers.
    motions : sequence of EvenMotion
        Measured motions.
    noise : np.ndarray, shape (C,)
        Standard deviation of the noise of each measured quantity.

    Returns
    -------
    list of (float, Solution, np.ndarray of shape (C,))
        Length [s], fit, and root mean square of the residuals in units of the noise, each.

    """
    longest = max(motion.t[-1] - motion.t[0] for motion in motions)
    length, before = min(first_length(motions), longest), None
    found = list[tuple[float, Solution, np.ndarray]]()
    while True:
        before = longer(model, motions, length, noise, True, _ROUGH, before)
        ratios = noise_of(before.solution, False) / noise
        if not np.isfinite(ratios).all():
            return found
        found.append((length, before.solution, ratios))
        if length >= longest or (ratios > _POOR).all():
            return found
        length = min(_LONGER * length, longest)


def with_states_of(model: ParametricModel, motions: Sequence[EvenMotion], fitted: Solution
                   ) -> list[EvenMotion]:
    """Return motions whose smoothed states are those of a model, fitted to every n-th sample."""
    none, windows = np.zeros(0), refined(fitted.windows, motions)
    # From other states, long windows of a chaotic motion would end in a false minimum.
    solution, _ = _settled(model, windows, fitted.noise, fitted.starts, none, True, _ROUGH, False)
    prediction = Prediction(model, none, windows)
    states = prediction.states(solution.starts[:, None])[:, 0]
    q, v = states[..., :states.shape[-1] // 2], prediction.velocities(states)
    found = []
    for run, motion in enumerate(motions):
        own = solution.windows.run == run
        there = solution.windows.there[own]
        found.append(replace(motion, q_smooth=q[own][there], v_smooth=v[own][there]))
    return found


def refitted(fitted: Fitted, model: ParametricModel, values: np.ndarray, tolerance: float
             ) -> Fitted:
    """Return the fit of another model in the same windows, searched from given values."""
    (length, last, problem), shorter = fitted.fits[-1], fitted.fits[:-1]
    solution, problem = _settled(model, last.windows, last.noise, last.starts, values,
                                 problem.robust, tolerance, False)
    return fitted._replace(fits=[*shorter, (length, solution, problem)])


def cost_at_start(model: ParametricModel, motions: Sequence[EvenMotion]) -> float:
    """Return the cost of a model's initial guess in the shortest windows, inf if it fails."""
    windows = cut_windows(motions, min(first_length(motions), max(
        motion.t[-1] - motion.t[0] for motion in motions)))
    values = np.array([number.start for number in model.numbers])
    problem = FitProblem(model, windows, first_noise(motions),
                         _starts(model, values, windows, None), False)
    problem.tolerance = 1.0
    cost = float(problem.cost(problem.residuals(values)[:-len(values)].reshape(
        windows.measured.shape)).sum())
    return cost if math.isfinite(cost) else math.inf


def longer(model: ParametricModel, motions: Sequence[EvenMotion], length: float,
           noise: np.ndarray, robust: bool, tolerance: float, before: Fitted | None,
           seen: Seen | None = None) -> Fitted:
    """Return the fit in windows of this length [s], from that in shorter ones."""
    values = np.array([number.start for number in model.numbers]) if before is None else \
        before.solution.values
    windows = cut_windows(motions, length, seen)
    starts = _starts(model, values, windows, before)
    if before is None and seen is not None and np.delete(
            seen.spread, seen.columns).any():
        values, starts = _searched(model, windows, noise, starts, values, seen, length)
    solution, problem = _settled(
        model, windows, noise if before is None else before.solution.noise, starts, values,
        robust, tolerance, before is None)
    fits, sensor = ([], []) if before is None else (before.fits, before.sensor)
    return Fitted([*fits, (length, solution, problem)], [], sensor)


def _judged(fitted: Fitted) -> Fitted:
    """Return a fit with the noise of its sensors, and its stages."""
    sensor = fitted.sensor
    if not sensor or excess_of(fitted.solution, fitted.problem, sensor) < _SMALLER:
        sensor = sensor_noise(fitted.solution, fitted.problem)
    return fitted._replace(sensor=sensor, stages=[
        (length, excess_of(solution, problem, sensor))
        for length, solution, problem in fitted.fits])


def _settled(model: ParametricModel, windows: Windows, noise: np.ndarray, starts: np.ndarray,
             values: np.ndarray, robust: bool, tolerance: float, guessed: bool
             ) -> tuple[Solution, FitProblem]:
    """Return the fit whose noise agrees with its own residuals, iterated from a first noise."""
    if windows.there.sum() * len(noise) <= starts.size + len(values):
        raise DataError(f'{int(windows.there.sum())} samples of {len(noise)} quantities in '
                        f'{len(starts)} windows are too few for {len(values)} numbers and '
                        f'{starts.size} initial values; record more, or lengthen --horizon')
    for k in range(_ROUNDS):
        # A guess from the data alone is far too small for an incomplete scene, and would make all
        # residuals outliers. The first round therefore uses squares to estimate the noise.
        squares = robust and guessed and k == 0
        problem = FitProblem(model, windows, noise, starts, robust and not squares)
        solution = search(problem, values, _ROUGH if squares else tolerance)
        told = noise_of(solution, robust)
        values, starts = solution.values, solution.starts
        ratio = told / noise
        noise = told
        # A common factor affects only the robust loss.
        if not squares and np.ptp(np.log(ratio)) < _SETTLED and not (
                robust and abs(np.log(ratio)).max() > _SETTLED):
            break
    problem.noise = noise
    return replace(
        solution, residuals=solution.residuals / ratio, noise=noise,
        by_starts=solution.by_starts / ratio[:, None],
        by_numbers=solution.by_numbers / ratio[:, None]), problem


def search(problem: FitProblem, values: np.ndarray, tolerance: float = _TOLERANCE,
           evaluations: int = _EVALUATIONS) -> Solution:
    """Return the best values of the numbers, searched from an initial guess."""
    problem.tolerance = tolerance
    first = problem.residuals(values)
    if not values.size:
        return problem.solve(values)
    if (first == _FAILED).any():
        raise CannotFollow(
            f'{problem.model.name} cannot be simulated over all windows with its current values; '
            'change them in the scene, or shorten --horizon')
    low, high = np.array([[number.low, number.high] for number in problem.model.numbers]).T
    # Not from the projected derivatives: they would scale up directions of pure rounding.
    units = 1.0 / units_of(problem.solve(values))
    found = least_squares(
        problem.residuals, values, problem.slopes, bounds=(low, high), x_scale=units,
        loss='soft_l1' if problem.robust else 'linear', f_scale=_SOFT, ftol=tolerance,
        xtol=tolerance, gtol=tolerance, max_nfev=evaluations)
    return problem.solve(found.x)


def noise_of(solution: Solution, robust: bool) -> np.ndarray:
    """Return the noise of each quantity estimated from residuals, shape (C,)."""
    there = solution.windows.there
    own = solution.residuals[there]
    measured = own.size
    share = math.sqrt(measured / solution.freedom)
    spread = 1.4826 * np.median(np.abs(own), axis=0) if robust else \
        np.sqrt((own**2).mean(axis=0))
    least = least_noise(solution.windows.measured[there])
    return np.maximum(share * spread * solution.noise, least)


def sensor_noise(solution: Solution, problem: FitProblem) -> list[Process]:
    """
    Return the noise of each quantity, from the residuals of short windows.

    The motion that a model lacks is smooth there. Polynomials are therefore removed from the
    residuals as well as initial states.
    """
    lengths = solution.windows.there.sum(axis=1)
    rows = np.unique(np.linspace(0, len(lengths) - 1, _ENOUGH).astype(int))
    lengths, residuals = lengths[rows], (
        problem.weights(solution.residuals) * solution.residuals)[rows]
    states = solution.by_starts[rows]
    states = states / (np.linalg.norm(states, axis=(1, 2), keepdims=True) + 1e-300)
    smooth = np.zeros((*residuals.shape[:2], _DEGREE + 1))
    for n in np.unique(lengths):
        smooth[lengths == n, :n] = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, n), min(
            _DEGREE + 1, n // 3)))[0] @ np.eye(min(_DEGREE + 1, n // 3), _DEGREE + 1)
    found = [likeliest(residuals[:, :, c], lengths, np.concatenate([states[:, :, c], smooth], 2))
             for c in range(residuals.shape[2])]
    return [one._replace(variance=one.variance * scale**2)
            for one, scale in zip(found, solution.noise, strict=True)]


def excess_of(solution: Solution, problem: FitProblem, sensor: Sequence[Process]) -> float:
    """Return the size of the residuals relative to that expected of the sensors' noise."""
    noise = [[one._replace(variance=one.variance / scale**2)]
             for one, scale in zip(sensor, solution.noise, strict=True)]
    w, t, c, k = solution.by_starts.shape
    # Initial states reproduce a part of the noise: more of it if it is correlated.
    taken = np.linalg.qr(solution.by_starts.reshape(w, t * c, k))[0].reshape(w, t, c, -1)
    expected = solution.windows.there.sum() * sum(
        float(one.autocovariances(1)[0]) for one, in noise) - np.trace(
            covariances(taken, noise)[0])
    expected *= solution.freedom / (solution.freedom + len(solution.values))
    left = problem.weights(solution.residuals) * solution.residuals
    return math.sqrt(float((left**2).sum()) / max(float(expected), 1e-300))


def _starts(model: ParametricModel, values: np.ndarray, windows: Windows,
            before: Fitted | None) -> np.ndarray:
    """Return initial guesses: the starts of shorter windows, or smoothed measurements."""
    q, v = windows.start.swapaxes(0, 1)
    if before is None:
        prediction = Prediction(model, values, windows)
        return np.hstack([q, momentum(prediction.hamiltonian, q, v, np.zeros_like(q))])
    solution = before.solution
    states = Prediction(model, values, solution.windows).states(solution.starts[:, None])[:, 0]
    found = np.empty((len(q), 2 * q.shape[1]))
    for w in range(len(q)):
        own = np.flatnonzero((solution.windows.run == windows.run[w])
                             & (solution.windows.first <= windows.first[w]))[-1]
        found[w] = states[own, windows.first[w] - solution.windows.first[own]]
    return found
