# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Fits in windows that grow, the noise that their residuals show, and the states along them."""

from collections.abc import Callable, Sequence
from dataclasses import replace
import math
from typing import NamedTuple

from hnn_vi_ros.errors import DataError, HnnViRosError
from hnn_vi_ros.learning.data.motions import EvenMotion, joined
from hnn_vi_ros.learning.fit.following import LogSimulation
from hnn_vi_ros.learning.fit.noise import covariances, likeliest, Process
from hnn_vi_ros.learning.fit.prediction import predicted_by
from hnn_vi_ros.learning.fit.shooting import FAILED, FitProblem, search, Solution, TOLERANCE
from hnn_vi_ros.learning.fit.windows import (
    CannotFollow, cut_windows, MeasuredColumns, ParametricModel, refined, Windows)
import numpy as np

# Tolerance of all searches but the last.
_ROUGH = 1e-4
# Tolerance of initial states that only tell the size of residuals, which is then right to 1 %.
_JUDGED = 1.0
# Minimum noise relative to the measured range: the size of rounding errors.
_LEAST_NOISE = 1e-9
_LEAST_SAMPLES = 10
# Size of normal residuals after the weights of the robust loss, (E[x^2 / (1 + (x / 2)^2)])^(1/2).
_WEIGHTED = 0.793
# Maximum number of windows that show the noise of the sensors, and degree of polynomials that
# follow 0.6 of a period of any motion to 0.3 %.
_ENOUGH, _DEGREE = 200, 5
# Residuals smaller than this share of the noise show that it was estimated in a poor fit.
_SMALLER = 0.8
# Residuals of the first windows, relative to differences of neighbours, that show a false
# minimum: shorter windows have none.
_FALSE = 10.0
# Longest time scale of a coordinate, in units of that of its speed: of one frequency both are 1.
_TURNING = 3.0
# Number of places from which the search of unmeasured initial states begins.
_PLACES = 12
# Growth factor of the windows, and the growth of residuals at which they stop growing.
_LONGER, _GROWTH = 3.0, 1.5
# Residuals that are noise alone, and their growth in standard deviations that is no chance.
_NOISE_ALONE, _CERTAIN = 1.05, 5.0
# Residual in units of the noise beyond which longer windows tell nothing more.
_POOR = 5.0
# Ratios of misfits up to which fits are the same, and up to which one may still win.
_SAME, _AS_GOOD = 1.001, 1.05
# Relative change of the noise that requires no further search; and maximum of searches.
_SETTLED, _ROUNDS = 0.1, 6


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
    speed, pace = _speeds_and_paces(motions)
    if not speed.any():
        raise DataError(f'{motions[0].name}: no coordinate moves, so no parameter can be '
                        'identified')
    least = 2 * _LEAST_SAMPLES if motions[0].v is None else _LEAST_SAMPLES
    return max(4.0 * float(pace[speed > 0.0].min()), (least - 1) * motions[0].spacing)


def _speeds_and_paces(motions: Sequence[EvenMotion]) -> tuple[np.ndarray, np.ndarray]:
    """Return the usual speed and the time scale [s] of each coordinate, (d,)."""
    q, v, a = joined(motions, 'q_smooth', 'v_smooth', 'a_smooth')
    speed, rate = (np.sqrt((part**2).mean(axis=0)) for part in (v, a))
    # The range of a joint that turns over and over tells nothing of its time scale.
    return speed, np.minimum(q.std(axis=0) / (speed + 1e-300), _TURNING * speed / (rate + 1e-300))


class FittedNumbers(NamedTuple):
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
                horizon: float | None, robust: bool, seen: MeasuredColumns | None = None,
                tolerance: float = TOLERANCE,
                finer: Callable[[FittedNumbers], FittedNumbers] | None = None) -> FittedNumbers:
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
        residuals do not grow by more than a half, and stay noise if they were.
    robust : bool
        See FitProblem.
    seen : MeasuredColumns, optional
        The measured coordinates; by default all.
    tolerance : float, optional
        Relative tolerance of the last search.
    finer : callable, optional
        Returns a fit with the steps that it needs, before the next length.

    Raises
    ------
    DataError
        The data are too few, or no initial guess can be simulated over them.

    """
    longest = max(motion.t[-1] - motion.t[0] for motion in motions)
    wanted = longest if horizon is None else min(horizon, longest)
    # Coordinates per measured one.
    share = 1.0 if seen is None else len(seen.spread) / len(seen.columns)
    # Internal variables of effects are zero at the start of a run, and unknown within it.
    whole = any(effect.internal for model in models for effect in model.parts_at(
        np.array([number.start for number in model.numbers])).effects)
    if whole and wanted < longest:
        raise DataError(f'--horizon {wanted:g}: the scene has effects with internal variables, '
                        'which are known at the start of a run only; leave out --horizon')
    length = longest if whole else min(first_length(motions) * share, wanted)
    least = (2 * _LEAST_SAMPLES - 1) * motions[0].spacing * share
    noise = first_noise(motions)
    alive: list[tuple[ParametricModel, FittedNumbers | None]] = [(model, None) for model in models]
    while True:
        found: list[tuple[FittedNumbers, FittedNumbers | None]] = []
        for model, before in alive:
            try:
                if before is not None and horizon is None:
                    _check_followed(before, motions, length, seen)
                found.append((fit_longer_windows(
                    model, motions, length, noise, robust,
                    tolerance if length >= wanted else _ROUGH, before, seen,
                    math.inf if before is None or horizon is not None else
                    _GROWTH * before.problem.misfit(before.solution)), before))
            except CannotFollow:
                if not found and model is alive[-1][0] and (before is None or horizon is not None):
                    raise
        if not found and (before := alive[0][1]) is not None:
            return refitted(before, before.problem.model, before.solution.values, tolerance)
        best, before = min(found, key=lambda pair: pair[0].size)
        shorter = length / _LONGER
        if not whole and before is None and shorter >= least and \
                best.size > _FALSE * float(np.exp(np.log(noise).mean())):
            length = shorter
            continue
        best = judged(best)
        if horizon is None and before is not None and _leaves_the_motion(best):
            shorter_fit = refitted(before, before.problem.model, before.solution.values, tolerance)
            return shorter_fit if _is_false(best) else shorter_fit._replace(stages=best.stages)
        if length >= wanted:
            return best
        # Starts that lead to the same optimum have the same misfit.
        kept = [best, *(
            judged(one) for one, _ in found if _SAME < one.size / best.size < _AS_GOOD)]
        alive = [(one.problem.model, one) for one in (kept if finer is None else map(finer, kept))]
        length = min(_LONGER * length, wanted)


def _leaves_the_motion(fitted: FittedNumbers) -> bool:
    """
    Return True if residuals grew too much in the longest windows.

    Residuals that were noise have to stay so: long windows of a chaotic motion have false minima.
    """
    (_, before), (_, now) = fitted.stages[-2:]
    grown = math.sqrt(0.5 * fitted.solution.freedom) * ((now / before)**2 - 1.0)
    return now > _GROWTH * before or (before < _NOISE_ALONE and grown > _CERTAIN)


def _is_false(fitted: FittedNumbers) -> bool:
    """
    Return True if the longest windows ended in a false minimum, which tells nothing of the model.

    The errors of a force that is missing grow with a power of the length, up to the third: from
    less than a third of noise that seems alone to less than _POOR.
    """
    (_, before), (_, now) = fitted.stages[-2:]
    return before < _NOISE_ALONE and now > _POOR


def _searched(model: ParametricModel, windows: Windows, noise: np.ndarray, starts: np.ndarray,
              values: np.ndarray, seen: MeasuredColumns, length: float
              ) -> tuple[np.ndarray, np.ndarray]:
    """Return values and initial states; unmeasured ones are tried from several places."""
    random, d = np.random.default_rng(0), len(seen.spread)
    hidden = ~np.isin(np.arange(d), seen.columns)
    for _ in range(2):
        problem, prediction = FitProblem(model, windows, noise, starts, False), predicted_by(
            model, values, windows)
        found, best = starts, np.full(len(starts), np.inf)
        for k in range(_PLACES + 1):
            q, v = windows.start.swapaxes(0, 1) + hidden * seen.spread * random.normal(
                size=(2, len(starts), d)) * np.array([1.0, 4.0 / length])[:, None, None]
            tried = starts if not k else prediction.log.starts(q, v)
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
        before = fit_longer_windows(model, motions, length, noise, True, _JUDGED, before)
        ratios = noise_of(before.solution, False) / noise
        if not np.isfinite(ratios).all():
            return found
        found.append((length, before.solution, ratios))
        if length >= longest or (ratios > _POOR).all():
            return found
        length = min(_LONGER * length, longest)


def with_states_of(model: ParametricModel, motions: Sequence[EvenMotion], fitted: Solution
                   ) -> list[EvenMotion]:
    """Return motions whose smoothed states are a model's, fitted to every n-th sample."""
    none, windows = np.zeros(0), refined(fitted.windows, motions)
    # From other states, long windows of a chaotic motion would end in a false minimum.
    solution, _ = fit_with_noise(
        model, windows, fitted.noise, fitted.starts, none, True, _ROUGH, False)
    log = LogSimulation(model.parts_at(none), windows)
    states = log.states(solution.starts[:, None])[:, 0]
    q, v = states[..., :states.shape[-1] // 2], log.velocities(states)
    found = []
    for run, motion in enumerate(motions):
        own = solution.windows.run == run
        there = solution.windows.there[own]
        found.append(replace(motion, q_smooth=q[own][there], v_smooth=v[own][there]))
    return found


def refitted(fitted: FittedNumbers, model: ParametricModel, values: np.ndarray,
             tolerance: float = TOLERANCE) -> FittedNumbers:
    """Return the fit of another model in the same windows, searched from given values."""
    (length, last, problem), shorter = fitted.fits[-1], fitted.fits[:-1]
    solution, problem = fit_with_noise(model, last.windows, last.noise, last.starts, values,
                                       problem.robust, tolerance, False)
    return fitted._replace(fits=[*shorter, (length, solution, problem)])


def cost_at_start(model: ParametricModel, motions: Sequence[EvenMotion]) -> float:
    """Return the cost of a model's initial guess in the shortest windows, inf if it fails."""
    windows = cut_windows(motions, min(first_length(motions), max(
        motion.t[-1] - motion.t[0] for motion in motions)))
    values = np.array([number.start for number in model.numbers])
    try:
        prediction = predicted_by(model, values, windows)
        starts = prediction.log.starts(*windows.start.swapaxes(0, 1))
        problem = FitProblem(model, windows, first_noise(motions), starts, False, tolerance=1.0)
        _, residuals, _ = problem.descend(prediction, starts)
    except HnnViRosError:
        return math.inf
    cost = float(problem.cost(np.nan_to_num(residuals, nan=FAILED)).sum())
    return cost if math.isfinite(cost) else math.inf


def fit_longer_windows(model: ParametricModel, motions: Sequence[EvenMotion], length: float,
                       noise: np.ndarray, robust: bool, tolerance: float,
                       before: FittedNumbers | None, seen: MeasuredColumns | None = None,
                       limit: float = math.inf) -> FittedNumbers:
    """Return the fit in windows of this length [s], from that in shorter ones."""
    values = np.array([number.start for number in model.numbers]) if before is None else \
        before.solution.values
    windows = cut_windows(motions, length, seen)
    starts = _starts(model, values, windows, before)
    if before is None and seen is not None and np.delete(seen.spread, seen.columns).any():
        values, starts = _searched(model, windows, noise, starts, values, seen, length)
    solution, problem = fit_with_noise(
        model, windows, noise if before is None else before.solution.noise, starts, values,
        robust, tolerance, before is None, limit)
    fits, sensor = ([], []) if before is None else (before.fits, before.sensor)
    return FittedNumbers([*fits, (length, solution, problem)], [], sensor)


def _check_followed(fitted: FittedNumbers, motions: Sequence[EvenMotion], length: float,
                    seen: MeasuredColumns | None) -> None:
    """Raise CannotFollow if a fit is off by a swing in longer windows, as in a chaotic motion."""
    model, values = fitted.problem.model, fitted.solution.values
    windows = cut_windows(motions, length, seen)
    off = predicted_by(model, values, windows).log.predict(
        _starts(model, values, windows, fitted)) - windows.measured
    swing = np.prod(_speeds_and_paces(motions), axis=0)
    size = np.sqrt(np.mean(off[..., :len(swing)]**2, axis=1, where=windows.there[..., None]))
    # The swing of a coordinate at rest is noise.
    if not (size <= swing + _FALSE * fitted.solution.noise[:len(swing)]).all():
        raise CannotFollow(f'{model.name} cannot follow windows of {length:.3g} s')


def judged(fitted: FittedNumbers) -> FittedNumbers:
    """Return a fit with the noise of its sensors, and its stages."""
    sensor = fitted.sensor
    if not sensor or excess_of(fitted.solution, fitted.problem, sensor) < _SMALLER:
        sensor = sensor_noise(fitted.solution, fitted.problem)
    return fitted._replace(sensor=sensor, stages=[
        (length, excess_of(solution, problem, sensor))
        for length, solution, problem in fitted.fits])


def fit_with_noise(model: ParametricModel, windows: Windows, noise: np.ndarray, starts: np.ndarray,
                   values: np.ndarray, robust: bool, tolerance: float, guessed: bool,
                   limit: float = math.inf) -> tuple[Solution, FitProblem]:
    """
    Return the fit whose noise agrees with its own residuals, iterated from a first noise.

    It is not iterated where the misfit exceeds a limit, beyond which the fit is left.
    """
    if windows.there.sum() * len(noise) <= starts.size + len(values):
        raise DataError(f'{int(windows.there.sum())} samples of {len(noise)} quantities in '
                        f'{len(starts)} windows are too few for {len(values)} numbers and '
                        f'{starts.size} initial values; record more, or lengthen --horizon')
    for k in range(_ROUNDS):
        # A guess from the data alone is far too small for an incomplete scene, and would make all
        # residuals outliers. The first round therefore uses squares to estimate the noise.
        squares = robust and guessed and k == 0
        problem = FitProblem(model, windows, noise, starts, robust and not squares)
        solution = search(problem, values, max(_ROUGH, tolerance) if squares else tolerance)
        told = noise_of(solution, robust)
        values, starts = solution.values, solution.starts
        ratio = told / noise
        noise = told
        # A common factor affects only the robust loss.
        settled = np.ptp(np.log(ratio)) < _SETTLED and not (
            robust and abs(np.log(ratio)).max() > _SETTLED)
        if problem.misfit(solution) > limit or (settled and not squares):
            break
    return replace(
        solution, residuals=solution.residuals / ratio, noise=noise,
        by_starts=solution.by_starts / ratio[:, None],
        parameter_jacobian=solution.parameter_jacobian / ratio[:, None]), replace(
            problem, noise=noise)


def noise_of(solution: Solution, robust: bool) -> np.ndarray:
    """Return the noise of each quantity estimated from residuals, shape (C,)."""
    there = solution.windows.there
    own = solution.residuals[there]
    measured = own.size
    share = math.sqrt(measured / solution.freedom)
    spread = 1.4826 * np.median(np.abs(own), axis=0) if robust else np.sqrt((own**2).mean(axis=0))
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
            before: FittedNumbers | None) -> np.ndarray:
    """Return initial guesses: the starts of shorter windows, or smoothed measurements."""
    q, v = windows.start.swapaxes(0, 1)
    if before is None:
        return predicted_by(model, values, windows).log.starts(q, v)
    solution = before.solution
    states = predicted_by(model, values, solution.windows).log.states(
        solution.starts[:, None])[:, 0]
    found = np.empty((len(q), 2 * q.shape[1]))
    for w in range(len(q)):
        own = np.flatnonzero((solution.windows.run == windows.run[w])
                             & (solution.windows.first <= windows.first[w]))[-1]
        found[w] = states[own, windows.first[w] - solution.windows.first[own]]
    return found
