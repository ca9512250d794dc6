# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Scores of predictions from measured states, and their errors outside the training domain."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
import math
from typing import Any, NamedTuple

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.motions import EvenMotion, joined
from hnn_vi_ros.learning.fit.windows import ModelParts
from hnn_vi_ros.learning.judging.energy import balance, energy_mismatch, unaccounted
from hnn_vi_ros.learning.judging.predictors import constant_velocity, Predict, simulated
from hnn_vi_ros.models import Domain
from hnn_vi_ros.phase_space import Coordinate
from hnn_vi_ros.run import VALID
from hnn_vi_ros.simulation import System
import numpy as np

# Errors of the sensors, in units of their noise, that end no valid prediction.
_NOISES = 5.0


class TrajectoryBundle(NamedTuple):
    """
    Predictions of one motion from many of its states.

    Parameters
    ----------
    motion : EvenMotion
        The measured motion.
    starts : np.ndarray of int, shape (n,)
        Indices of the initial samples.
    q : np.ndarray, shape (n, count + 1, d)
        Predicted coordinates at the samples from there on; see Predict.

    """

    motion: EvenMotion
    starts: np.ndarray
    q: np.ndarray


@dataclass(frozen=True)
class Scores:
    """
    Scores of a prediction against measured motions.

    Parameters
    ----------
    horizons : dict of float to np.ndarray, shape (d,)
        RMS error of each coordinate at the end of each horizon [s].
    starts : dict of float to int
        Number of simulations per horizon.
    valid_prediction_time : float
        Median over all starts [s].
    censored : float
        Share of predictions that were still valid at their end or the end of their run.
    failed : int
        Number of failed simulations; their errors are infinite.
    energy_mismatch : dict of float to float, optional
        Energy mismatch of a model over each horizon; see energy_mismatch.

    """

    horizons: dict[float, np.ndarray]
    starts: dict[float, int]
    valid_prediction_time: float
    censored: float
    failed: int
    energy_mismatch: dict[float, float] | None = None


def variance_of(motions: Sequence[EvenMotion], noise: np.ndarray | None = None) -> np.ndarray:
    """
    Return the variance of each coordinate over motions, shape (d,).

    For a constant coordinate it is inf, so that its errors do not count. With the noise of the
    sensors, shape (d,) or longer, it is at least so large that noise alone ends no valid
    prediction.

    Raises
    ------
    DataError
        All coordinates are constant.

    """
    q = np.concatenate([motion.q for motion in motions])
    moves = np.ptp(q, axis=0) > 0.0
    if not moves.any():
        raise DataError(f'{motions[0].name}: no coordinate moves, so no error can be computed; '
                        'use other motions')
    least = 0.0 if noise is None else (_NOISES * noise[:len(moves)])**2 / VALID
    return np.where(moves, np.maximum(q.var(axis=0), least), np.inf)


class Judging(NamedTuple):
    """
    Times at which predictions are judged, each in s.

    Parameters
    ----------
    horizons : tuple of float
        Horizons of errors.
    every : float
        Time between starts.
    longest : float
        Limit of valid prediction times.

    """

    horizons: tuple[float, ...] = (0.1, 0.5)
    every: float = 0.05
    longest: float = 2.0

    def paced(self, motions: Sequence[EvenMotion]) -> 'Judging':
        """Return longer times if samples are further apart than the shortest horizon."""
        slow = max(1.0, motions[0].spacing / min(self.horizons))
        return Judging(tuple(round(slow * horizon, 9) for horizon in self.horizons),
                       max(slow * self.every, motions[0].spacing), slow * self.longest)


def samples_in(time: float, motion: EvenMotion) -> int:
    """Return the number of samples in a time [s], at most all samples of the motion."""
    return round(min(time / motion.spacing, len(motion.t)))


def fans_of(predict: Predict, motions: Sequence[EvenMotion], horizons: Sequence[float],
            every: float, longest: float) -> list[TrajectoryBundle]:
    """Predict from many measured states, for the durations that ``score`` needs."""
    for horizon in horizons:
        if all(samples_in(horizon, motion) >= len(motion.t) for motion in motions):
            raise DataError(f'no motion is as long as the horizon {horizon:g} s; use shorter '
                            '--horizons')
        if any(samples_in(horizon, motion) < 1 for motion in motions):
            raise DataError(f'the horizon {horizon:g} s is shorter than the sampling interval '
                            f'{motions[0].spacing:.4g} s; use longer --horizons')
    fans = []
    for motion in motions:
        n = len(motion.t)
        starts = np.arange(0, n - samples_in(min(horizons), motion),
                           max(1, samples_in(every, motion)))
        if len(starts):
            count = min(samples_in(max(longest, *horizons), motion), n - 1)
            fans.append(TrajectoryBundle(motion, starts, predict(motion, starts, count)))
    return fans


def score(predict: Predict, motions: Sequence[EvenMotion], horizons: Sequence[float], every: float,
          longest: float, noise: np.ndarray | None = None) -> Scores:
    """
    Predict from many measured states, and compare with the measurements.

    Parameters
    ----------
    predict : callable
        Predictor to judge.
    motions : sequence of EvenMotion
        The measured motions.
    horizons : sequence of float
        Times at which errors are evaluated [s].
    every : float
        Time between starts [s].
    longest : float
        Prediction time limit for the valid prediction time, at least the longest horizon [s].
    noise : np.ndarray, optional
        Noise of the coordinates, if known.

    Raises
    ------
    DataError
        No motion is as long as a horizon, or samples are further apart than a horizon.

    """
    fans = fans_of(predict, motions, horizons, every, longest)
    return score_fans(fans, horizons, variance_of(motions, noise))


def score_fans(fans: Sequence[TrajectoryBundle], horizons: Sequence[float], variance: np.ndarray
               ) -> Scores:
    """Score predictions against measured motions of this variance, shape (d,); see score."""
    errors: dict[float, list[np.ndarray]] = {horizon: [] for horizon in horizons}
    times, ended, failed = [], [], 0
    for motion, starts, q in fans:
        n, spacing, count = len(motion.t), motion.spacing, q.shape[1] - 1
        room = n - 1 - starts
        within = np.arange(count + 1) <= room[:, None]
        at = np.minimum(starts[:, None] + np.arange(count + 1), n - 1)
        error = q - motion.q[at]
        failed += int((np.isnan(error).any(axis=2) & within).any(axis=1).sum())
        error = np.where(np.isfinite(error), error, np.inf)
        for horizon in horizons:
            k = samples_in(horizon, motion)
            if k <= count:
                errors[horizon].append(error[room >= k, k])
        with np.errstate(over='ignore', invalid='ignore'):
            # The quotient is NaN for an infinite error of a coordinate with infinite variance.
            beyond = within & ~((error**2 / variance).sum(axis=2) < VALID)
        found = beyond.any(axis=1)
        times.append(np.where(found, beyond.argmax(axis=1), np.minimum(count, room)) * spacing)
        ended.append(~found)
    with np.errstate(over='ignore'):
        rms = {horizon: np.sqrt(np.mean(np.concatenate(parts)**2, axis=0))
               for horizon, parts in errors.items()}
    return Scores(rms, {horizon: sum(map(len, parts)) for horizon, parts in errors.items()},
                  float(np.median(np.concatenate(times))),
                  float(np.mean(np.concatenate(ended))), failed)


def whole_records(predict: Predict, motions: Sequence[EvenMotion], first: int) -> list[np.ndarray]:
    """
    Return the RMS error over each whole run, shape (d,) each.

    Parameters
    ----------
    predict : callable
        Predictor to judge.
    motions : sequence of EvenMotion
        The measured motions.
    first : int
        Sample of each run whose smoothed state starts the only prediction.

    Raises
    ------
    DataError
        A run ends before that sample.

    """
    found = []
    for motion in motions:
        if first >= len(motion.t) - 1:
            raise DataError(f'{motion.name} has only {len(motion.t)} samples; reduce --from')
        q = predict(motion, np.array([first]), len(motion.t) - 1 - first)[0]
        error = np.where(np.isfinite(q), q - motion.q[first:], np.inf)
        found.append(np.sqrt(np.mean(error**2, axis=0)))
    return found


def table(scores: dict[str, Scores], coordinates: Sequence[Coordinate]) -> str:
    """Return the scores of several predictors as a Markdown table, a row for each coordinate."""
    first = next(iter(scores.values()))
    mismatches = [*(first.energy_mismatch or {})]
    head = ['prediction', 'RMS error of', *(f'after {time:g} s' for time in first.horizons),
            'valid for [s]', *(f'energy mismatch [%], {time:g} s' for time in mismatches),
            'failed']
    rows = [head, ['---'] * len(head)]
    for name, found in scores.items():
        least = '>= ' if found.censored >= 0.5 else ''
        others = [f'{least}{found.valid_prediction_time:.3g}', *(
            f'{100.0 * found.energy_mismatch[time]:.3g}' if found.energy_mismatch else '-'
            for time in mismatches), str(found.failed)]
        for k, one in enumerate(coordinates):
            rows.append(['' if k else name, f'{one.name} [{one.q_unit}]',
                         *(f'{rms[k]:.4g}' for rms in found.horizons.values()),
                         *([''] * len(others) if k else others)])
    return '\n'.join(f'| {" | ".join(row)} |' for row in rows)


def verdict(scores: dict[str, Scores]) -> str:
    """Summarise the scores in one sentence."""
    said = [f'{"at least " if found.censored >= 0.5 else ""}{found.valid_prediction_time:.2g} s'
            for found in scores.values()]
    others = ', '.join(f'{name} {text}' for name, text in zip(
        [*scores][1:], said[1:], strict=True))
    return f'The model follows the machine for {said[0]} (median); {others}.'


def as_json(scores: dict[str, Scores]) -> dict[str, Any]:
    """Return the content of ``--json``: scores of the model and of its baselines."""
    model, *others = (numbers(found) for found in scores.values())
    return model | {'baselines': dict(zip([*scores][1:], others, strict=True))}


def finite(values: Iterable[float]) -> list[float | None]:
    """Return numbers for JSON, with None in place of non-finite values."""
    return [float(value) if math.isfinite(value) else None for value in values]


def numbers(scores: Scores) -> dict[str, Any]:
    """Return scores for JSON, with None in place of infinite errors."""
    return {'horizons': {f'{horizon:.15g}': finite(rms)
                         for horizon, rms in scores.horizons.items()},
            'valid_prediction_time': scores.valid_prediction_time,
            'censored': scores.censored, 'failed': scores.failed,
            'energy_mismatch': scores.energy_mismatch and dict(zip(
                (f'{horizon:.15g}' for horizon in scores.energy_mismatch),
                finite([*scores.energy_mismatch.values()]), strict=True))}


class Outside(NamedTuple):
    """
    Motions and predictions outside of a model's training domain, in q, v or forces.

    Parameters
    ----------
    share : float
        Share of the samples that are outside.
    beyond : list of str
        Quantities that exceed the domain, the largest excess first.
    errors : dict of str to dict of float to np.ndarray, shape (d,)
        RMS errors at the end of each horizon, separately for predictions along which the machine
        stayed ``inside`` and for all others, ``outside``; empty groups are omitted.

    """

    share: float
    beyond: list[str]
    errors: dict[str, dict[float, np.ndarray]]

    @property
    def text(self) -> str:
        """Summarise the result in plain sentences."""
        if not self.share:
            return 'All samples are inside the training domain of the model.'
        errors = '; '.join(f'{where} ' + ', '.join(
            f'{" ".join(f"{x:.3g}" for x in rms)} after {horizon:g} s'
            for horizon, rms in found.items()) for where, found in self.errors.items() if found)
        return (f'{100.0 * self.share:.3g} % of the samples are outside the training domain of '
                f'the model: {"; ".join(self.beyond)}. RMS errors {errors}.')

    @property
    def numbers(self) -> dict[str, Any]:
        """Return the result for JSON."""
        return {'share': self.share, 'beyond': self.beyond, 'errors': {
            where: {f'{horizon:.15g}': finite(rms) for horizon, rms in found.items()}
            for where, found in self.errors.items()}}


def outside(domain: Domain, fans: Sequence[TrajectoryBundle], horizons: Sequence[float]
            ) -> Outside:
    """Compare motions, and predictions of them, with a model's training domain."""
    motions = [fan.motion for fan in fans]
    parts = [*joined(motions, 'q_smooth', 'v_smooth', 'tau')]
    errors: dict[str, dict[float, np.ndarray]] = {'inside': {}, 'outside': {}}
    for horizon in horizons:
        found, out = list[np.ndarray](), list[np.ndarray]()
        for motion, starts, q in fans:
            k = samples_in(horizon, motion)
            starts = starts[starts + k < len(motion.t)]
            if k >= q.shape[1] or not len(starts):
                continue
            found.append(q[:len(starts), k] - motion.q[starts + k])
            count = np.cumsum(np.append(0, domain.excess(
                motion.q_smooth, motion.v_smooth, motion.tau).any(axis=1)))
            out.append(count[starts + k + 1] > count[starts])
        error, beyond = np.concatenate(found), np.concatenate(out)
        error = np.where(np.isfinite(error), error, np.inf)
        for where, rows in (('inside', ~beyond), ('outside', beyond)):
            if rows.any():
                errors[where][horizon] = np.sqrt(np.mean(error[rows]**2, axis=0))
    return Outside(float(domain.excess(*parts).any(axis=1).mean()), domain.beyond(*parts), errors)


def judge(parts: ModelParts, motions: Sequence[EvenMotion], horizons: Sequence[float],
          every: float, longest: float, others: Mapping[str, Predict],
          noise: np.ndarray | None = None) -> tuple[dict[str, Scores], list[TrajectoryBundle]]:
    """Return the scores of a model, of constant velocity and of `others`; and the model's fans."""
    fans = fans_of(simulated(parts), motions, horizons, every, longest)
    scores = {'model': score_fans(fans, horizons, variance_of(motions, noise))} | {
        name: score(other, motions, horizons, every, longest, noise)
        for name, other in {'constant velocity': constant_velocity, **others}.items()}
    if not unaccounted(parts.effects):
        hamiltonian = System(parts.hamiltonian, parts.effects, parts.integrator).hamiltonian
        mismatch = energy_mismatch(
            [balance(hamiltonian, parts.effects, motion) for motion in motions],
            motions[0].spacing, horizons)
        scores['model'] = replace(scores['model'], energy_mismatch=mismatch)
    return scores, fans
