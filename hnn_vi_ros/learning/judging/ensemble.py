# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Ensembles: resampled data, members in one model file, calibration of their spread."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple
import warnings

from hnn_vi_ros.errors import AlarmWarning, DataError, HnnViRosError, ParameterError
from hnn_vi_ros.learning.data.dataset import Dataset, ExactData, sample_exact
from hnn_vi_ros.learning.data.motions import EvenMotion, MIN_SAMPLES, part_of
from hnn_vi_ros.learning.families.choices import TrajectoryLoss
from hnn_vi_ros.learning.fit.config import FieldConfig, MachineConfig
from hnn_vi_ros.learning.fit.following import LogSimulation
from hnn_vi_ros.learning.fit.model_files import drafted, machine_scene
from hnn_vi_ros.learning.fit.windows import ModelParts, windows_at
from hnn_vi_ros.models import Box, Checkpoint, EnsembleCard, mean_card, ModelCard, MOST_MEMBERS
from hnn_vi_ros.run import deviation, member_scenes
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import simulate_many
import numpy as np
from scipy.interpolate import CubicHermiteSpline

# Share of measured data held out from all members for the calibration of the spread.
HELD_OUT = 0.2
# Number of time blocks of machine motions, and minimum number for resampling.
_BLOCKS, _FEWEST_BLOCKS = 20, 5
# Minimum number of simulations for estimating a 90 % quantile.
_FEWEST = 20
# For a field: number of motions to find the factors, and the same to check them; number of samples
# after the first one of each; number of steps between samples.
_MOTIONS, _SAMPLES, _STEPS = 500, 20, 2
# Number of steps of the exact motions between samples.
_FINE = 10
# For a machine: maximum duration of simulations and time between starts [s], number of samples
# per simulation, and maximum number of simulations.
_HORIZON, _EVERY, _INSTANTS, _MOST = 0.5, 0.05, 20, 200


def check_count(count: int) -> None:
    """Raise ParameterError if an ensemble cannot have this number of members."""
    if not 2 <= count <= MOST_MEMBERS:
        raise ParameterError(f'--ensemble {count}: expected 2 to {MOST_MEMBERS} members')


def _drawn(count: int, seed: int) -> np.ndarray:
    """Draw `count` block numbers with replacement, as for a block bootstrap."""
    return np.random.default_rng([seed, 1]).choice(count, count)


def bootstrapped(dataset: Dataset, seed: int) -> Dataset:
    """
    Return a block bootstrap of the data: the same number of blocks, drawn with replacement.

    Copies share one block, which a split keeps whole, but each copy is a separate motion.
    """
    blocks = np.unique(dataset.block)
    order = np.argsort(dataset.block, kind='stable')
    drawn = blocks[_drawn(len(blocks), seed)]
    first, behind = (np.searchsorted(dataset.block[order], drawn, side=side)
                     for side in ('left', 'right'))
    rows = [order[a:b] for a, b in zip(first, behind, strict=True)]
    chosen, copy = np.concatenate(rows), np.repeat(np.arange(len(rows)), [*map(len, rows)])
    _, trajectory = np.unique(np.column_stack([copy, dataset.motion[chosen]]), axis=0,
                              return_inverse=True)
    return replace(dataset.rows(chosen), trajectory=trajectory.ravel()).checked()


def bootstrapped_blocks(blocks: Sequence[EvenMotion], seed: int) -> list[EvenMotion]:
    """Return a block bootstrap of motions, in their original order."""
    return [blocks[k] for k in sorted(_drawn(len(blocks), seed))]


def held_out(config: FieldConfig, dataset: Dataset) -> tuple[Dataset, Dataset | None]:
    """Return training data and calibration data; None if calibration data are drawn later."""
    if isinstance(config.data, ExactData) or dataset.t is None:
        return dataset, None
    return dataset.split(HELD_OUT, config.seed)


def kept_and_held(motions: Sequence[EvenMotion], config: MachineConfig
                  ) -> tuple[list[EvenMotion], list[EvenMotion]]:
    """
    Split motions into training blocks for members and a fifth of the blocks for calibration.

    A block is a motion or a part of one, about a twentieth of the total duration, but not shorter
    than 1 s or twice the longest window of the loss.

    Raises
    ------
    DataError
        There are fewer than five blocks.

    """
    loss = config.loss_of(motions)
    stages = loss.windows if isinstance(loss, TrajectoryLoss) else []
    least = 2.0 * max([_HORIZON, *(stage.duration for stage in stages)])
    lengths = [len(motion.t) * motion.spacing for motion in motions]
    length = max(least, sum(lengths) / _BLOCKS, MIN_SAMPLES * motions[0].spacing)
    blocks = [part_of(motion, slice(rows[0], rows[-1] + 1))
              for motion, time in zip(motions, lengths, strict=True)
              for rows in np.array_split(
                  np.arange(len(motion.t)), max(1, int(time / length * (1.0 + 1e-12))))]
    if len(blocks) < _FEWEST_BLOCKS:
        raise DataError(f'--ensemble: the training motions make {len(blocks)} blocks of '
                        f'{length:.3g} s, expected at least {_FEWEST_BLOCKS}; record for longer, '
                        'or train one model')
    order = np.random.default_rng(config.seed).permutation(len(blocks))
    held = round(HELD_OUT * len(blocks))
    return [blocks[k] for k in sorted(order[held:])], [blocks[k] for k in sorted(order[:held])]


def combined(members: Sequence[Checkpoint], name: str, box: Box | None = None) -> Checkpoint:
    """Combine members into one model with mean losses; its box is `box`, or the mean of theirs."""
    cards = [member.card for member in members]
    losses = {key: float(np.mean([card.losses[key] for card in cards if key in card.losses]))
              for key in cards[0].losses}
    mechanical = [card.mechanical for card in cards if card.mechanical is not None]
    return Checkpoint(cards[0].model_copy(update={
        'name': name, 'losses': losses, 'energy_error': None,
        'mechanical': mean_card(mechanical) if mechanical else None,
        'box': box or Box(q=cards[0].box.q,
                          p=np.mean([card.box.p for card in cards], axis=0).tolist()),
        'ensemble': EnsembleCard(members=cards)}), {}, members=tuple(members))


class Calibration(NamedTuple):
    """
    Scores of an ensemble on motions that no member was trained on.

    A score is abs(x - mean) / deviation of one coordinate or momentum at one time.

    Parameters
    ----------
    scores, others : np.ndarray, shape (n, 2 d)
        Scores that determine the factors, and scores that check them.
    source : str
        Source of the scores, for the model card.

    """

    scores: np.ndarray
    others: np.ndarray
    source: str


def calibrated(checkpoint: Checkpoint, find: Callable[[], Calibration]) -> Checkpoint:
    """
    Add conformal factors of the spread to an ensemble's card (split conformal prediction).

    The factor of a coordinate or momentum is the smallest score that the share ``level`` of its
    scores does not exceed; the other scores give the coverage of the bands. If calibration fails,
    the card holds the reason instead of factors.

    Parameters
    ----------
    checkpoint : Checkpoint
        The ensemble.
    find : callable
        Callable that returns the scores.

    References
    ----------
    J. Lei, M. G'Sell, A. Rinaldo, R. Tibshirani, L. Wasserman, Distribution-Free Predictive
    Inference for Regression, JASA 2018.

    """
    ensemble = checkpoint.card.ensemble
    assert ensemble is not None, 'an ensemble has its card'
    try:
        found = find()
        factors = conformal_factors(found.scores, ensemble.level)
        update = {'factors': factors, 'coverage': float((found.others <= factors).mean()),
                  'calibration': found.source}
    except HnnViRosError as problem:
        # The model is saved nevertheless; its card holds the reason.
        update = {'calibration': f'none: {problem}'[:1000]}
    return replace(checkpoint, card=checkpoint.card.model_copy(update={
        'ensemble': ensemble.model_copy(update=update)}))


def conformal_factors(scores: np.ndarray, level: float) -> list[float]:
    """
    Return the ceil((n + 1) level)-th smallest of n scores, shape (n, 2 d), per column.

    Raises
    ------
    DataError
        There are too few scores, or a member diverges so often that a factor is infinite.

    """
    ordered = np.sort(scores, axis=0)
    rank = int(np.ceil((len(ordered) + 1) * level))
    if rank > len(ordered) or not ((0.0 < ordered[rank - 1]) & (ordered[rank - 1] < np.inf)).all():
        raise DataError('the spread of the ensemble cannot be calibrated: too few held-out '
                        'motions in the training domain, or identical members')
    return ordered[rank - 1].tolist()


def ensemble_text(card: ModelCard) -> str:
    """Describe the spread of an ensemble in one sentence; return '' for a single model."""
    ensemble = card.ensemble
    if ensemble is None:
        return ''
    count = f'Mean of {len(ensemble.members)} members'
    if ensemble.factors is None or ensemble.coverage is None:
        return f'{count}; the spread was not calibrated ({ensemble.calibration})'
    factors = ', '.join(f'{factor:.3g}' for factor in ensemble.factors)
    return (f'{count}; bands of {100.0 * ensemble.level:g} %: {factors} times the spread of q and '
            f'p, with a coverage of {100.0 * ensemble.coverage:.1f} % ({ensemble.calibration})')


def _scores(error: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Return abs(error) / spread, inf where that is not a number."""
    with np.errstate(divide='ignore', invalid='ignore'):
        scores = np.abs(error) / spread
    return np.where(np.isnan(scores) | np.isinf(spread), np.inf, scores)


class Held(NamedTuple):
    """
    Motions of a field that were not used in training.

    Parameters
    ----------
    t : np.ndarray, shape (K + 1,)
        Times [s], starting at 0.
    q, p : np.ndarray, shape (K + 1, M, d)
        States of the motions.
    inside : np.ndarray of bool, shape (K + 1, M)
        True up to the time at which each motion leaves the training domain.

    """

    t: np.ndarray
    q: np.ndarray
    p: np.ndarray
    inside: np.ndarray


def field_calibration(checkpoint: Checkpoint, config: FieldConfig, test: Dataset | None
                      ) -> Calibration:
    """
    Return the scores of held-out motions of H alone; one half calibrates, the other checks.

    Parameters
    ----------
    checkpoint : Checkpoint
        The ensemble.
    config : FieldConfig
        Configuration of the training.
    test : Dataset or None
        Measured data not used in training; ignored if exact data are drawn instead.

    Raises
    ------
    DataError
        There are too few motions.

    """
    if isinstance(config.data, ExactData):
        held = held_exact(checkpoint, config, 2 * _MOTIONS, config.seed + 2)
    else:
        held = None if test is None else _held_measured(checkpoint, test)
    count = 0 if held is None else held.q.shape[1]
    if held is None or count < _FEWEST:
        raise DataError(f'{count} held-out motions without forces, expected at least {_FEWEST}')
    scores = scores_of(checkpoint, held)
    halves = np.split(np.random.default_rng(config.seed).permutation(count), [count // 2])
    first, second = (scores[:, half][held.inside[1:, half]] for half in halves)
    return Calibration(first, second, (
        f'{len(halves[0])} motions of {held.t[-1]:.3g} s in the training domain, coverage on '
        f'{len(halves[1])} others'))


def scores_of(checkpoint: Checkpoint, held: Held) -> np.ndarray:
    """Return abs(x - mean) / deviation, shape (K, M, 2 d), without the initial time."""
    mean, *members = simulate_held(checkpoint, held)
    scores = _scores(np.concatenate([held.q, held.p], axis=-1) - mean, deviation(members))[1:]
    # No band covers a motion at which a simulation fails.
    return np.where(np.isnan(scores), np.inf, scores)


def simulate_held(checkpoint: Checkpoint, held: Held) -> list[np.ndarray]:
    """Simulate the mean and each member from the same states, shape (K + 1, M, 2 d) each."""
    with drafted(checkpoint) as draft:
        scene = Scene.build(
            hamiltonian={'kind': 'learned', 'model': draft, 'confine': False},
            integrator='gauss8', step_size=held.t[1] / _STEPS,
            initial_state=(held.q[0, 0], held.p[0, 0]), name=checkpoint.card.name)
        found = [simulate_many(one, held.q[0], held.p[0], float(held.t[-1]),
                               samples=len(held.t) - 1)
                 for one in (scene, *member_scenes(scene, len(checkpoint.members)))]
    return [np.concatenate([one.q, one.p], axis=-1) for one in found]


def horizon(dataset: Dataset) -> float:
    """Return the time for about one revolution around the box of the data [s]."""
    half = 0.5 * np.ptp(np.hstack([dataset.q, dataset.p]), axis=0)
    rates = np.sqrt(np.mean(np.hstack([dataset.dq_dt, dataset.dp_dt])**2, axis=0))
    return float(2.0 * np.pi * (half / rates).max())


def held_exact(checkpoint: Checkpoint, config: FieldConfig, count: int, seed: int) -> Held | None:
    """Return motions of an exact system from new states of the box; None if it is driven."""
    data = config.data
    assert isinstance(data, ExactData), 'asked of such data alone'
    if data.commands is not None or data.damping or data.velocities:
        return None  # not a motion of H alone
    drawn = data.model_copy(update={
        'samples': count, 'edge_share': 0.0, 'noise': 0.0, 'trajectory': None})
    start, t = sample_exact(drawn, seed), np.linspace(
        0.0, horizon(sample_exact(drawn, config.seed)), _SAMPLES + 1)
    scene = Scene.build(hamiltonian=data.hamiltonian.model_dump(), integrator='gauss8',
                        step_size=t[1] / _FINE, initial_state=(start.q[0], start.p[0]))
    with warnings.catch_warnings():
        # Motions may leave the domain to where the system has no solution.
        warnings.simplefilter('ignore', AlarmWarning)
        found = simulate_many(scene, start.q, start.p, float(t[-1]), samples=_SAMPLES)
    return _within(checkpoint, t, found.q, found.p)


def _held_measured(checkpoint: Checkpoint, test: Dataset) -> Held | None:
    """Return the measured motions from the first state of each held-out block on."""
    blocks = [test.rows(test.block == block) for block in np.unique(test.block)]
    blocks = [rows for rows in blocks
              if rows.t is not None and len(rows.t) > 1 and (np.diff(rows.t) > 0.0).all()]
    if not blocks:
        return None
    times = [rows.t - rows.t[0] for rows in blocks if rows.t is not None]
    T = min(horizon(test), float(np.median([time[-1] for time in times])))
    t = np.linspace(0.0, T, _SAMPLES + 1)
    q, p = (np.stack([
        CubicHermiteSpline(time, getattr(rows, name), getattr(rows, rate))(t)
        for rows, time in zip(blocks, times, strict=True) if time[-1] >= T], axis=1)
        for name, rate in (('q', 'dq_dt'), ('p', 'dp_dt')))
    return _within(checkpoint, t, q, p)


def _within(checkpoint: Checkpoint, t: np.ndarray, q: np.ndarray, p: np.ndarray) -> Held:
    low, high = checkpoint.card.box.bounds
    z = np.concatenate([q, p], axis=-1)
    inside = ((low <= z) & (z <= high)).all(axis=-1)
    return Held(t, q, p, np.logical_and.accumulate(inside, axis=0))


def machine_calibration(checkpoint: Checkpoint, held: Sequence[EvenMotion],
                        test: Sequence[EvenMotion]) -> Calibration:
    """
    Return the scores of simulations of a machine from measured states.

    Only the second half of the samples counts: at first, noise of the states is larger than the
    difference between members. Momenta are M(q) v of the mean.

    Parameters
    ----------
    checkpoint : Checkpoint
        The ensemble.
    held, test : sequence of EvenMotion
        Held-out blocks that no member was trained on, and the test motions.

    Raises
    ------
    DataError
        There are too few simulations in the training domain.

    """
    first, second = ([scores for motion in machine_scores(checkpoint, motions)
                      for scores in motion] for motions in (held, test))
    if min(len(first), len(second)) < _FEWEST:
        raise DataError(
            f'{len(first)} held-out and {len(second)} test simulations in the training domain, '
            f'expected at least {_FEWEST} each')
    return Calibration(np.concatenate(first), np.concatenate(second), (
        f'{len(first)} simulations of {_duration(held):.3g} s from held-out states, coverage on '
        f'{len(second)} simulations of test motions'))


def _duration(motions: Sequence[EvenMotion]) -> float:
    return min(_HORIZON, max(float(motion.t[-1] - motion.t[0]) for motion in motions))


def machine_scores(checkpoint: Checkpoint, motions: Sequence[EvenMotion], most: int | None = _MOST
                   ) -> list[list[np.ndarray]]:
    """
    Return abs(x - mean) / deviation of simulations from measured states, with measured forces.

    Parameters
    ----------
    checkpoint : Checkpoint
        The ensemble.
    motions : sequence of EvenMotion
        The measured motions.
    most : int, optional
        Maximum number of simulations; None for all.

    Returns
    -------
    list of list of np.ndarray, shape (instants, 2 d)
        Scores of each motion, from the second half of each simulation that stays so long in the
        training domain, up to the time at which it leaves the domain.

    """
    spacing = motions[0].spacing
    every = max(1, round(_duration(motions) / (_INSTANTS * spacing)))
    count = max(every, round(_duration(motions) / spacing) // every * every)
    apart = max(1, round(_EVERY / spacing))
    starts = [(k, start) for k, motion in enumerate(motions)
              for start in range(0, len(motion.t) - count, apart)]
    starts = [starts[k] for k in np.unique(
        np.linspace(0, len(starts) - 1, min(most or len(starts), len(starts))).astype(int))]
    if not starts:
        return [[] for _ in motions]
    rows = np.array([start for _, start in starts])[:, None] + np.arange(0, count + 1, every)
    q, v = (np.stack([getattr(motions[k], name)[own] for (k, _), own in zip(
        starts, rows, strict=True)]) for name in ('q_smooth', 'v_smooth'))
    with drafted(checkpoint) as draft:
        driven = any(motion.tau.any() for motion in motions)
        scene = machine_scene(draft, checkpoint.card, spacing, 'implicit_midpoint', driven)
        logs = [LogSimulation(ModelParts(*one.parts()[1:], spacing),
                              windows_at(motions, starts, count))
                for one in (scene, *member_scenes(scene, len(checkpoint.members)))]
        mean, *members = [_predicted(log, logs[0], q[:, 0], v[:, 0], every) for log in logs]
        measured = logs[0].starts(q, v)
    low, high = checkpoint.card.box.bounds
    inside = np.logical_and.accumulate(
        ((low <= measured) & (measured <= high)).all(axis=2), axis=1)
    scores, half = _scores(measured - mean, deviation(members)), max(1, rows.shape[1] // 2)
    found: list[list[np.ndarray]] = [[] for _ in motions]
    for (k, _), own, usable in zip(starts, scores, inside, strict=True):
        if usable[half:].any():
            found[k].append(own[half:][usable[half:]])
    return found


def _predicted(log: LogSimulation, mean: LogSimulation, q: np.ndarray, v: np.ndarray, every: int
               ) -> np.ndarray:
    """Return states of a model at every n-th sample, with momenta of the mean, (W, R, 2 d)."""
    found = log.states(log.starts(q, v)[:, None])[:, 0, ::every]
    usable = np.isfinite(found).all(axis=2)
    states = found[usable]
    found[usable] = mean.starts(states[:, :q.shape[1]], log.velocities(states))
    return found
