# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Ensembles of models of machines: resampled motions, the mean, and what its spread tells."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
import warnings

from hnn_vi_ros.errors import AlarmWarning, DataError, ParameterError, StepFailure
from hnn_vi_ros.hamiltonians.momenta import momentum
from hnn_vi_ros.learning.data.motions import MIN_SAMPLES, Motion
from hnn_vi_ros.learning.fit.machine_config import MachineConfig, Trajectory
from hnn_vi_ros.learning.fit.machine_training import part_of
from hnn_vi_ros.learning.judging.ensemble import (
    band_text, check_count, conformal_factors, with_calibration)
from hnn_vi_ros.models.checkpoint import Checkpoint, save_checkpoint
from hnn_vi_ros.models.mechanical_card import mean_card
from hnn_vi_ros.models.model_card import Box, EnsembleCard, ModelCard
from hnn_vi_ros.models.rigid_body_card import RIGID_BODY
from hnn_vi_ros.run.companions import Accompanied
from hnn_vi_ros.run.members import Members
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation.build import build
import numpy as np

# Blocks of time that motions are cut into, how many of them at least there must be, and the share
# that no member is trained on.
_BLOCKS, _FEWEST_BLOCKS, _HELD_OUT = 20, 5, 0.2
# Simulations by which the spread is calibrated: how long they last at most and how far apart they
# begin [s], instants of each, and how many there are at least and at most.
_HORIZON, _EVERY, _INSTANTS, _FEWEST, _MOST = 0.5, 0.05, 20, 20, 200
# Commands hold to the end of the simulation [s].
_FOREVER = 1e9


def check_machines(config: MachineConfig, count: int) -> None:
    """Raise ParameterError if no ensemble of so many can be trained by a configuration."""
    check_count(count)
    if config.family.kind == RIGID_BODY:
        raise ParameterError('--ensemble: a rigid_body has the uncertainty of each parameter by '
                             'its standard errors; leave --ensemble out, or take the family '
                             'mechanical')


def kept_and_held(motions: Sequence[Motion], config: MachineConfig
                  ) -> tuple[list[Motion], list[Motion]]:
    """
    Return blocks of motions to train members on, and a fifth of the blocks, for calibration.

    A block is a motion, or a part of one that lasts about a twentieth of all of them, but not
    less than 1 s or twice the longest window of the loss.

    Raises
    ------
    DataError
        There are not even five blocks.

    """
    loss = config.loss_of(all(motion.accelerations for motion in motions))
    stages = loss.windows if isinstance(loss, Trajectory) else []
    least = 2.0 * max([_HORIZON, *(stage.duration for stage in stages)])
    lengths = [len(motion.t) * motion.spacing for motion in motions]
    length = max(least, sum(lengths) / _BLOCKS, MIN_SAMPLES * motions[0].spacing)
    blocks = [part_of(motion, slice(rows[0], rows[-1] + 1))
              for motion, time in zip(motions, lengths, strict=True)
              for rows in np.array_split(
                  np.arange(len(motion.t)), max(1, int(time / length * (1.0 + 1e-12))))]
    if len(blocks) < _FEWEST_BLOCKS:
        raise DataError(f'--ensemble: the motions to learn from make {len(blocks)} blocks of '
                        f'{length:.3g} s, expected at least {_FEWEST_BLOCKS}; record for longer, '
                        'or train one model')
    order = np.random.default_rng(config.seed).permutation(len(blocks))
    held = round(_HELD_OUT * len(blocks))
    return [blocks[k] for k in sorted(order[held:])], [blocks[k] for k in sorted(order[:held])]


def resampled_blocks(blocks: Sequence[Motion], seed: int) -> list[Motion]:
    """Return a block bootstrap: as many blocks, drawn with replacement, in their order."""
    drawn = np.random.default_rng([seed, 1]).choice(len(blocks), len(blocks))
    return [blocks[k] for k in sorted(drawn)]


def combined_machines(members: Sequence[Checkpoint], name: str) -> Checkpoint:
    """Return members as one model; its losses, and the box of momenta, are their means."""
    cards = [member.card for member in members]
    mechanical = [card.mechanical for card in cards if card.mechanical is not None]
    losses = {key: float(np.mean([card.losses[key] for card in cards if key in card.losses]))
              for key in cards[0].losses}
    box = Box(q=cards[0].box.q, p=np.mean([card.box.p for card in cards], axis=0).tolist())
    return Checkpoint(cards[0].model_copy(update={
        'name': name, 'box': box, 'losses': losses, 'mechanical': mean_card(mechanical),
        'ensemble': EnsembleCard(members=cards)}), {}, members=tuple(members))


def calibrated_machine(checkpoint: Checkpoint, held: Sequence[Motion], test: Sequence[Motion]
                       ) -> Checkpoint:
    """
    Return an ensemble whose card tells by what its spread is multiplied (split conformal).

    With the score s = abs(x - mean) / deviation of a coordinate or momentum at 11 instants of
    the second half of simulations from measured states, whose noise outweighs what members
    make of it at first, its factor is the least of them that the share ``level``
    does not exceed, on blocks that no member has seen. On the motions that the model is judged
    by the share is counted that the bands cover. Momenta are M(q) v of the mean.

    Parameters
    ----------
    checkpoint : Checkpoint
        The ensemble.
    held, test : sequence of Motion
        What the factors are found on, and what they are checked on.

    References
    ----------
    J. Lei, M. G'Sell, A. Rinaldo, R. Tibshirani, L. Wasserman, Distribution-Free Predictive
    Inference for Regression, JASA 2018.

    """
    ensemble = checkpoint.card.ensemble
    assert ensemble is not None, 'an ensemble has its card'
    level = ensemble.level
    return with_calibration(checkpoint, lambda: _calibration(checkpoint, level, held, test))


def _calibration(checkpoint: Checkpoint, level: float, held: Sequence[Motion],
                 test: Sequence[Motion]) -> dict[str, object]:
    first, second = ([scores for motion in machine_scores(checkpoint, motions)
                      for scores in motion] for motions in (held, test))
    if min(len(first), len(second)) < _FEWEST:
        raise DataError(
            f'{len(first)} and {len(second)} simulations in the training domain, of what was '
            f'held out and of the test, expected at least {_FEWEST}')
    factors = conformal_factors(np.concatenate(first), level)
    return {'factors': factors, 'coverage': float((np.concatenate(second) <= factors).mean()),
            'calibration': (
                f'{len(first)} simulations of {_horizon(held):.3g} s from states of what was '
                f'held out, and coverage on {len(second)} of the test motions')}


def _horizon(motions: Sequence[Motion]) -> float:
    return min(_HORIZON, max(float(motion.t[-1] - motion.t[0]) for motion in motions))


def machine_scores(checkpoint: Checkpoint, motions: Sequence[Motion], most: int | None = _MOST
                   ) -> list[list[np.ndarray]]:
    """
    Return abs(x - mean) / deviation of simulations from measured states, with measured forces.

    Parameters
    ----------
    checkpoint : Checkpoint
        The ensemble.
    motions : sequence of Motion
        What was measured.
    most : int, optional
        How many simulations at most; None: all.

    Returns
    -------
    list of list of np.ndarray, shape (instants, 2 d)
        For each motion, of the second half of each simulation that stays in the training domain
        until then, up to where it leaves that.

    """
    spacing = motions[0].spacing
    every = max(1, round(_horizon(motions) / (_INSTANTS * spacing)))
    count = max(every, round(_horizon(motions) / spacing) // every * every)
    apart = max(1, round(_EVERY / spacing))
    starts = [(k, start) for k, motion in enumerate(motions)
              for start in range(0, len(motion.t) - count, apart)]
    starts = [starts[k] for k in np.unique(
        np.linspace(0, len(starts) - 1, min(most or len(starts), len(starts))).astype(int))]
    found: list[list[np.ndarray]] = [[] for _ in motions]
    with TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter('ignore', AlarmWarning)
        draft = Path(folder) / 'draft.safetensors'
        card = checkpoint.card.model_copy(update={'ensemble': EnsembleCard(
            members=checkpoint.card.ensemble.members)})  # without factors
        save_checkpoint(draft, replace(checkpoint, card=card))
        driven = any(motion.tau.any() for motion in motions)
        scene = _scene(str(draft), checkpoint.card, spacing, driven)
        members = Members(scene)
        simulation = Accompanied(build(scene), [members])
        for k, start in starts:
            scores = _scores(simulation, members, card.box, motions[k], start, count, every)
            if len(scores):
                found[k].append(scores)
    return found


def _scene(model: str, card: ModelCard, spacing: float, driven: bool) -> Scene:
    effects = [{'kind': 'learned_friction', 'model': model}]
    if driven:
        assert card.mechanical is not None, 'the family has one'
        where = {'coordinates': [coordinate.name for coordinate in card.coordinates]} \
            if card.mechanical.input_map is None else {'model': model}
        effects.append({'kind': 'external_force', 'timeout': _FOREVER, **where})
    zero = [0.0] * len(card.coordinates)
    return Scene.build(
        hamiltonian={'kind': 'learned', 'model': model, 'confine': False}, effects=effects,
        integrator='implicit_midpoint', step_size=spacing,
        initial_state=(np.mean(card.box.q, axis=1).tolist(), zero), name=card.name)


def _scores(simulation: Accompanied, members: Members, box: Box, motion: Motion, start: int,
            count: int, every: int) -> np.ndarray:
    """Return the scores of one simulation at every so many samples, shape (instants, 2 d)."""
    rows = start + np.arange(0, count + 1, every)
    q, v = motion.q_smooth[rows], motion.v_smooth[rows]
    hamiltonian, tau = simulation.hamiltonian, motion.forces
    measured = np.hstack([q, momentum(hamiltonian, q, v, np.zeros_like(v))])
    low, high = np.concatenate([box.q, box.p]).T
    inside = np.logical_and.accumulate(((low <= measured) & (measured <= high)).all(axis=1))
    found = []
    try:
        simulation.restart(measured[0, :q.shape[1]], measured[0, q.shape[1]:])
        for at in range(1, int(inside.sum())):
            for k in range(rows[at - 1], rows[at]):
                if simulation.takes_commands:
                    simulation.set_command(tau[k])
                simulation.advance(1)
            spread = members.spread
            with np.errstate(divide='ignore', invalid='ignore'):
                scores = np.abs(measured[at] - np.concatenate([simulation.q, simulation.p])) \
                    / spread
            found.append(np.where(np.isnan(scores) | np.isinf(spread), np.inf, scores))
    except StepFailure:
        # Of the mean: no band covers what it does not predict.
        found += [np.full(measured.shape[1], np.inf)] * (int(inside.sum()) - 1 - len(found))
    return np.array(found)[max(0, (len(rows) - 1) // 2 - 1):]


def ensemble_text(card: ModelCard) -> str:
    """Return one sentence on what the spread of an ensemble tells; '' of one model."""
    ensemble = card.ensemble
    if ensemble is None:
        return ''
    count = f'{len(ensemble.members)} members, whose mean is judged'
    if ensemble.factors is None or ensemble.coverage is None:
        return f'{count}; their spread was not calibrated ({ensemble.calibration})'
    return f'{count}; {band_text(ensemble)}'
