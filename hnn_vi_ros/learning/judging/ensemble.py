# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Ensembles: resampled data, members in one model, and what their spread tells of errors."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple
import warnings

from hnn_vi_ros.errors import AlarmWarning, DataError, HnnViRosError, ParameterError
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.learning.data.dataset import Dataset
from hnn_vi_ros.learning.data.exact_data import ExactData, sample_exact
from hnn_vi_ros.learning.fit.config import TrainingConfig
from hnn_vi_ros.models.checkpoint import Checkpoint, save_checkpoint
from hnn_vi_ros.models.families import FAMILIES
from hnn_vi_ros.models.mechanical_card import MOST_MEMBERS
from hnn_vi_ros.models.model_card import averaged_families, EnsembleCard
from hnn_vi_ros.run.ensemble import simulate_many
from hnn_vi_ros.run.spread import deviation, member_scenes
from hnn_vi_ros.scene import Scene
import numpy as np
from scipy.interpolate import CubicHermiteSpline

# Motions by which the factor is found, and as many by which it is checked.
_MOTIONS = 500
# Samples after the first one of each, and steps from one to the next.
_SAMPLES, _STEPS = 20, 2
# Steps of the exact motions from one sample to the next, and how far out of the training domain
# they are followed, in its half-widths: some systems have no bound.
_FINE, _OUTMOST = 50, 1.5
# Fewer motions than this tell nothing of 90 %.
_FEWEST = 20
# Of measured data, the share that no member is trained on.
_HELD_OUT = 0.2


class Held(NamedTuple):
    """
    Motions that training has not seen.

    Parameters
    ----------
    t : np.ndarray, shape (K + 1,)
        Times from 0 on [s].
    q, p : np.ndarray, shape (K + 1, M, d)
        What they are.
    inside : np.ndarray of bool, shape (K + 1, M)
        Up to where each stays in the training domain.

    """

    t: np.ndarray
    q: np.ndarray
    p: np.ndarray
    inside: np.ndarray


def check_count(count: int) -> None:
    """Raise ParameterError if an ensemble cannot have so many members."""
    if not 2 <= count <= MOST_MEMBERS:
        raise ParameterError(f'--ensemble {count}: expected 2 to {MOST_MEMBERS} members')


def check_ensemble(config: TrainingConfig, count: int) -> None:
    """Raise ParameterError if no ensemble of so many can be trained by a configuration."""
    check_count(count)
    if not FAMILIES[config.family.kind].averaged:
        raise ParameterError(
            f'--ensemble: models of the family {config.family.kind} have momenta or forces of '
            f'their own, whose mean means nothing; families: {", ".join(averaged_families())}')


def resampled(dataset: Dataset, seed: int) -> Dataset:
    """
    Return a block bootstrap of data: as many blocks, drawn with replacement.

    Copies of a block stay one block, which a split keeps together, and are motions of their own.
    """
    blocks = np.unique(dataset.block)
    drawn = np.random.default_rng([seed, 1]).choice(blocks, len(blocks))
    order = np.argsort(dataset.block, kind='stable')
    first = np.searchsorted(dataset.block[order], drawn)
    behind = np.searchsorted(dataset.block[order], drawn, side='right')
    rows = [order[a:b] for a, b in zip(first, behind, strict=True)]
    chosen = np.concatenate(rows)
    copy = np.repeat(np.arange(len(rows)), [len(part) for part in rows])
    motions = dataset.block if dataset.trajectory is None else dataset.trajectory
    _, trajectory = np.unique(np.column_stack([copy, motions[chosen]]), axis=0,
                              return_inverse=True)
    return replace(dataset.rows(chosen), trajectory=trajectory.ravel()).checked()


def combined(members: Sequence[Checkpoint], dataset: Dataset, name: str) -> Checkpoint:
    """Return members as one model, whose box is that of all data; its losses are their means."""
    cards = [member.card for member in members]
    losses = {key: float(np.mean([card.losses[key] for card in cards])) for key in cards[0].losses}
    card = cards[0].model_copy(update={
        'name': name, 'box': dataset.box, 'losses': losses, 'energy_error': None,
        'ensemble': EnsembleCard(members=cards)})
    return Checkpoint(card, {}, members=tuple(members))


def held_out(config: TrainingConfig, dataset: Dataset) -> tuple[Dataset, Dataset | None]:
    """Return what to train on, and what not to, by which the spread is calibrated."""
    if isinstance(config.data, ExactData) or dataset.t is None:
        return dataset, None
    return dataset.split(_HELD_OUT, config.seed)


def calibrated(checkpoint: Checkpoint, config: TrainingConfig, test: Dataset | None) -> Checkpoint:
    """
    Return an ensemble whose card tells by what its spread is multiplied (split conformal).

    With the score s = abs(x - mean) / deviation of a coordinate or momentum at each instant of
    held-out motions, its factor is the least of them that the share ``level`` does not exceed.
    They are found on one half of the motions; on the other the share is counted that the bands
    cover. Where that cannot be done there are no factors, and the card says why.

    Parameters
    ----------
    checkpoint : Checkpoint
        The ensemble.
    config : TrainingConfig
        How it was trained.
    test : Dataset or None
        Measured data that training has not seen; exact data are drawn anew.

    References
    ----------
    J. Lei, M. G'Sell, A. Rinaldo, R. Tibshirani, L. Wasserman, Distribution-Free Predictive
    Inference for Regression, JASA 2018.

    """
    return with_calibration(checkpoint, lambda: _calibration(checkpoint, config, test))


def with_calibration(checkpoint: Checkpoint, find: Callable[[], dict[str, object]]) -> Checkpoint:
    """Return an ensemble with what is found of its spread on its card, or why nothing is."""
    try:
        found = find()
    except HnnViRosError as problem:
        # What was trained is a model all the same, and says so.
        found = {'calibration': f'none: {problem}'[:1000]}
    assert checkpoint.card.ensemble is not None, 'an ensemble has its card'
    ensemble = checkpoint.card.ensemble.model_copy(update=found)
    return replace(checkpoint, card=checkpoint.card.model_copy(update={'ensemble': ensemble}))


def _calibration(checkpoint: Checkpoint, config: TrainingConfig, test: Dataset | None
                 ) -> dict[str, object]:
    if isinstance(config.data, ExactData):
        held = held_exact(checkpoint, config, 2 * _MOTIONS, config.seed + 2)
    else:
        held = None if test is None else _held_measured(checkpoint, test)
    count = 0 if held is None else held.q.shape[1]
    if held is None or count < _FEWEST:
        raise DataError(f'{count} held-out motions of H alone, expected at least {_FEWEST}')
    scores = scores_of(checkpoint, held)
    level = checkpoint.card.ensemble.level
    order = np.random.default_rng(config.seed).permutation(count)
    first, second = np.split(order, [count // 2])
    factors = conformal_factors(scores[:, first][held.inside[1:, first]], level)
    covered = float((scores[:, second][held.inside[1:, second]] <= factors).mean())
    return {'factors': factors, 'coverage': covered, 'calibration': (
        f'{len(first)} motions of {held.t[-1]:.3g} s in the training domain, and coverage on '
        f'{len(second)} others')}


def conformal_factors(scores: np.ndarray, level: float) -> list[float]:
    """
    Return the ceil((n + 1) level)-th smallest of n scores, shape (n, 2 d), of each column.

    Raises
    ------
    DataError
        There are too few, or a member comes apart from all others so often that none is finite.

    """
    ordered = np.sort(scores, axis=0)
    rank = int(np.ceil((len(ordered) + 1) * level))
    if rank > len(ordered) or not (
            (0.0 < ordered[rank - 1]) & (ordered[rank - 1] < np.inf)).all():
        raise DataError('the spread of the ensemble cannot be calibrated: too few held-out '
                        'motions in the training domain, or members that do not differ')
    found: list[float] = ordered[rank - 1].tolist()
    return found


def band_text(ensemble: EnsembleCard) -> str:
    """Say by what the spread of a calibrated ensemble is multiplied, and what that covers."""
    assert ensemble.factors is not None, 'it was calibrated'
    assert ensemble.coverage is not None, 'with the factors'
    factors = ', '.join(f'{factor:.3g}' for factor in ensemble.factors)
    return (f'bands of {100.0 * ensemble.level:g} %: {factors} times the spread of q and p, which '
            f'covers {100.0 * ensemble.coverage:.1f} % ({ensemble.calibration})')


def scores_of(checkpoint: Checkpoint, held: Held) -> np.ndarray:
    """Return abs(x - mean) / deviation, shape (K, M, 2 d), behind the first instant."""
    mean, *members = simulate_held(checkpoint, held)
    with np.errstate(divide='ignore', invalid='ignore'):
        scores = np.abs(np.concatenate([held.q, held.p], axis=-1) - mean) / deviation(members)
    return np.where(np.isnan(scores), np.inf, scores)[1:]


def simulate_held(checkpoint: Checkpoint, held: Held) -> list[np.ndarray]:
    """Return what the mean and each member do from the same states on, (K + 1, M, 2 d) each."""
    names = [len(checkpoint.members), held.t[-1]]
    with TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter('ignore', AlarmWarning)
        draft = Path(folder) / 'draft.safetensors'
        save_checkpoint(draft, checkpoint)
        scene = Scene.build(
            hamiltonian={'kind': 'learned', 'model': str(draft), 'confine': False},
            integrator='gauss8', step_size=held.t[1] / _STEPS,
            initial_state=(held.q[0, 0], held.p[0, 0]), name=checkpoint.card.name)
        found = [simulate_many(one, held.q[0], held.p[0], float(names[1]), samples=len(held.t) - 1)
                 for one in (scene, *member_scenes(scene, names[0]))]
    return [np.concatenate([one.q, one.p], axis=-1) for one in found]


def horizon(dataset: Dataset) -> float:
    """Return a time in which a motion goes about once around the box of data [s]."""
    half = 0.5 * np.ptp(np.hstack([dataset.q, dataset.p]), axis=0)
    rates = np.sqrt(np.mean(np.hstack([dataset.dq_dt, dataset.dp_dt])**2, axis=0))
    return float(2.0 * np.pi * (half / rates).max())


def held_exact(checkpoint: Checkpoint, config: TrainingConfig, count: int, seed: int
               ) -> Held | None:
    """Return motions of an exact system from new states of the box; None if they are driven."""
    data = config.data
    if data.commands is not None or data.damping or data.velocities:
        return None  # no motion of H alone
    drawn = data.model_copy(update={
        'samples': count, 'edge_share': 0.0, 'noise': 0.0, 'trajectory': None})
    start, t = sample_exact(drawn, seed), np.linspace(
        0.0, horizon(sample_exact(drawn, config.seed)), _SAMPLES + 1)
    z = _follow(data.hamiltonian.create(), np.hstack([start.q, start.p]), t, checkpoint)
    return _within(checkpoint, t, *np.split(z, 2, axis=-1))


def _follow(hamiltonian: Hamiltonian, z: np.ndarray, t: np.ndarray, checkpoint: Checkpoint
            ) -> np.ndarray:
    """Return the exact motions at even times, (K + 1, M, 2 d), held where they are far outside."""
    box, d = checkpoint.card.box, z.shape[1] // 2
    low, high = np.concatenate([box.q, box.p]).T
    h, found = t[1] / _FINE, [z]

    def rates(z: np.ndarray) -> np.ndarray:
        dH_dq, dH_dp = hamiltonian.gradient(z[:, :d], z[:, d:])
        outside = np.abs(z - 0.5 * (low + high)) > 0.5 * _OUTMOST * (high - low)
        return np.where(outside.any(axis=1)[:, None], 0.0, np.hstack([dH_dp, -dH_dq]))

    for _ in t[1:]:
        for _ in range(_FINE):  # the method of Runge and Kutta, of order 4
            a = rates(z)
            b = rates(z + 0.5 * h * a)
            c = rates(z + 0.5 * h * b)
            z = z + h / 6.0 * (a + 2.0 * b + 2.0 * c + rates(z + h * c))
        found.append(z)
    return np.stack(found)


def _held_measured(checkpoint: Checkpoint, test: Dataset) -> Held | None:
    """Return what was measured from the first state of each held-out block on."""
    blocks = [test.rows(test.block == block) for block in np.unique(test.block)]
    blocks = [rows for rows in blocks if len(rows.q) > 1 and (np.diff(rows.t) > 0.0).all()]
    if not blocks:
        return None
    lengths = np.array([rows.t[-1] - rows.t[0] for rows in blocks])
    T = min(horizon(test), float(np.median(lengths)))
    t = np.linspace(0.0, T, _SAMPLES + 1)
    q, p = (np.stack([
        CubicHermiteSpline(rows.t - rows.t[0], getattr(rows, name), getattr(rows, rate))(t)
        for rows, length in zip(blocks, lengths, strict=True) if length >= T], axis=1)
        for name, rate in (('q', 'dq_dt'), ('p', 'dp_dt')))
    return _within(checkpoint, t, q, p)


def _within(checkpoint: Checkpoint, t: np.ndarray, q: np.ndarray, p: np.ndarray) -> Held:
    box = checkpoint.card.box
    low, high = np.concatenate([box.q, box.p]).T
    z = np.concatenate([q, p], axis=-1)
    inside = ((low <= z) & (z <= high)).all(axis=-1)
    return Held(t, q, p, np.logical_and.accumulate(inside, axis=0))
