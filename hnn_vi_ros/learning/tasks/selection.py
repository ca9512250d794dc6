# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Choose the model of a machine by motions that are held out, also those that go furthest."""

from collections.abc import Callable, Sequence
import math

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.runs import MIN_SAMPLES, part_of, Run, run_of
from hnn_vi_ros.learning.families.choices import AUTO, MechanicalChoice, Trajectory
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.learning.fit.loop import Problem
from hnn_vi_ros.learning.fit.machine import Network, runge_kutta, samples_of
from hnn_vi_ros.models.planar_chain import chain_angles, PLANAR_CHAIN
from hnn_vi_ros.models.seen import CandidateCard, Errors, SelectionCard
import numpy as np
import torch

# Motions are cut into about so many pieces, of no more than this [s].
_PIECES, _LONGEST = 40, 2.0
# Share of the time that is held out for what goes furthest in speed, in range and in force, each;
# one in so many of the other pieces is held out as well.
_FURTHEST, _ORDINARY = 0.1, 5
# Of so many runs or more, whole ones are held out that go furthest, half of the time at most.
_RUNS = 4
# Candidates are trained for this share of the steps, on this share of the windows in each, and
# judged at these horizons, from a state so often [s].
_SHARE, _BATCH, _HORIZONS, _EVERY = 0.5, 0.125, (0.1, 0.5), 0.05
# On what goes furthest errors may be larger than those of the rigid body by _WORSE on the mean;
# and networks must gain more than _GAIN on the mean: what gains less is no better beyond the data,
# as far as a part of these can tell.
_WORSE, _GAIN = 0.02, 0.08
RIGID, ALONE = 'rigid body', 'networks alone'
_CANDIDATES: dict[str, dict[str, object]] = {
    RIGID: {'prior': PLANAR_CHAIN, 'residual': False},
    'rigid body and a network of V': {'prior': PLANAR_CHAIN, 'residual': ['potential']},
    'rigid body and networks': {'prior': PLANAR_CHAIN, 'residual': True},
    ALONE: {'prior': None, 'residual': True, 'angles': None}}
# Returns a problem, of a rigid body that was fitted before.
Make = Callable[[MachineConfig, Sequence[Run], Problem | None], Problem]


def selected(config: MachineConfig, motions: Sequence[Run], make: Make
             ) -> tuple[MachineConfig, SelectionCard | None]:
    """
    Return a configuration that names its prior, and how that was chosen if it says auto.

    Parameters
    ----------
    config : MachineConfig
        How to train.
    motions : sequence of Run
        What to learn from.
    make : callable
        Makes the problem of a configuration on motions.

    Raises
    ------
    DataError
        No candidate can be trained on these motions.

    """
    family = config.family
    if not isinstance(family, MechanicalChoice) or family.prior != AUTO:
        return config, None
    kinds = [coordinate.kind for coordinate in config.coordinates]
    if not chain_angles(kinds) or not (config.loss is None or isinstance(config.loss, Trajectory)):
        return _named(config, ALONE), None
    kept, furthest, ordinary = held_out(motions)
    if not furthest or not ordinary:
        print(f'prior: auto: {len(motions)} short motions leave nothing to choose by; '
              f'{ALONE}', flush=True)
        return _named(config, ALONE), None
    rigid: Problem | None = None
    found: list[CandidateCard] = []
    for name in _CANDIDATES:
        try:
            own = _short(_named(config, name), motions)
            if name not in (RIGID, ALONE) and rigid is None:
                raise DataError(f'no {RIGID} follows these motions')
            problem = make(own, kept, rigid)
            problem.fit()
            rigid = problem if name == RIGID else rigid
            card = CandidateCard(name=name, furthest=errors_of(problem.module, furthest),
                                 ordinary=errors_of(problem.module, ordinary))
        except DataError as problem:
            card = CandidateCard(name=name, failed=str(problem)[:1000])
        found.append(card)
        print(f'{name}: ' + (card.failed or (
            f'ordinary {_line(card.ordinary)}; furthest {_line(card.furthest)}')), flush=True)
    if all(card.failed for card in found):
        raise DataError(f'prior: auto: {found[-1].failed}')
    best = best_of(found)
    time, total = (sum(len(run.t) * run.spacing for run in runs)
                   for runs in ((*furthest, *ordinary), motions))
    text = (f'{time:.3g} s of {total:.3g} s of the motions, which the candidates had not seen: '
            'those that go furthest, in speed, range or force, and ordinary ones; trained for '
            'half of the steps')
    chosen = _named(config, best.name)
    if rigid is not None and best.name != ALONE:
        # All that follow, such as the members of an ensemble, have links of the same angles.
        names = [coordinate.name for coordinate in config.coordinates]
        chosen = chosen.model_copy(update={'family': chosen.family.model_copy(update={'angles': [
            ' + '.join(f'{x:g} * {name}' for x, name in zip(row, names, strict=True) if x)
            for row in rigid.module.structure.angles if any(row)]})})
    return chosen, SelectionCard(
        held_out=text, candidates=found, chosen=best.name, trust=_trust(best))


def held_out(motions: Sequence[Run]) -> tuple[list[Run], list[Run], list[Run]]:
    """
    Return motions to learn from, and pieces to judge by: the furthest, and ordinary ones.

    Pieces go far by the largest speed, distance from the middle or force in them, each in units
    of the largest of all; runs, of which many are largest in one coordinate, by the norm of all.
    """
    total = sum(len(run.t) for run in motions)
    longest = max(MIN_SAMPLES, min(round(_LONGEST / motions[0].spacing), total // _PIECES))
    pieces = [(run, rows) for run in motions
              for rows in np.array_split(np.arange(len(run.t)), max(1, len(run.t) // longest))]
    names = [run_of(run) for run, _ in pieces]
    whole = len(set(names)) >= _RUNS
    groups = [[k for k, one in enumerate(names) if one == name]
              for name in dict.fromkeys(names)] if whole else [[k] for k in range(len(pieces))]
    lengths = [sum(len(pieces[k][1]) for k in group) for group in groups]
    far: set[int] = set()
    for key in ('v_smooth', 'q_smooth', 'tau'):
        everything = np.concatenate([getattr(run, key) for run in motions])
        middle = np.median(everything, axis=0)
        size = np.abs(everything - middle).max(axis=0)
        moves = size > 0.0
        if not moves.any():
            continue
        reach = [max(float(np.linalg.norm((getattr(run, key)[rows] - middle)[:, moves]
                                          / size[moves], 2 if whole else np.inf, axis=1).max())
                     for run, rows in (pieces[k] for k in group)) for group in groups]
        taken = 0
        for j in np.argsort(-np.array(reach), kind='stable'):
            if whole and len(far | {*groups[j]}) > len(pieces) // 2:
                break
            far |= {*groups[j]}
            taken += lengths[j]
            if taken >= _FURTHEST * total:
                break
    others = [k for k in range(len(pieces)) if k not in far]
    usual = set(others[_ORDINARY // 2::_ORDINARY])
    kept: list[Run] = []
    begin = 0
    for run in motions:
        count = sum(one is run for one, _ in pieces)
        mine = [(k, pieces[k][1]) for k in range(begin, begin + count)]
        begin += count
        free = np.concatenate([rows for k, rows in mine if k not in far | usual] or [
            np.zeros(0, int)])
        blocks = np.split(free, np.flatnonzero(np.diff(free) > 1) + 1)
        kept += [part_of(run, rows) for rows in blocks if len(rows) >= MIN_SAMPLES]
    if not kept:
        return [*motions], [], []
    furthest, ordinary = ([part_of(*pieces[k]) for k in sorted(chosen)] for chosen in (far, usual))
    return kept, furthest, ordinary


def errors_of(network: Network, pieces: Sequence[Run]) -> Errors:
    """Return the errors of a network, simulated from many states of pieces; see CandidateCard."""
    samples = samples_of(pieces, None)
    found: Errors = {}
    apart = max(1, round(_EVERY / pieces[0].spacing))
    for horizon in _HORIZONS:
        steps = max(1, round(horizon / samples.step_size))
        starts = torch.nonzero(samples.left >= steps * samples.every)[:, 0]
        if not len(starts):
            continue
        at = starts[::apart]
        q, v = samples.q[at], samples.v[at]
        with torch.no_grad():
            for _ in range(steps):
                q, v = runge_kutta(network.accelerations, q, v, samples.mean_tau[at],
                                   samples.step_size)
                at = at + samples.every
        rms = (q - samples.measured[at]).square().mean(dim=0).sqrt().tolist()
        found[f'{horizon:g}'] = [x if math.isfinite(x) else None for x in rms]
    if not found:
        raise DataError('the pieces that are held out are too short to judge by')
    return found


def best_of(found: Sequence[CandidateCard]) -> CandidateCard:
    """
    Return the rigid body, or what has smaller errors on the mean by more than _GAIN.

    On what goes furthest their mean may not be larger by more than _WORSE. Without a rigid body
    it is the best on the mean.
    """
    tried = [card for card in found if not card.failed]
    rigid = next((card for card in tried if card.name == RIGID), None)

    def size(card: CandidateCard, *parts: str) -> float:
        errors = [x for part in parts for errors in getattr(card, part).values() for x in errors]
        return math.exp(np.mean(np.log([math.inf if x is None else max(x, 1e-12)
                                        for x in errors])))

    def total(card: CandidateCard) -> float:
        return size(card, 'ordinary', 'furthest')
    if rigid is None:
        return min(tried, key=total)
    best = min((card for card in tried if card is rigid or size(card, 'furthest')
                <= (1.0 + _WORSE) * size(rigid, 'furthest')), key=total)
    return best if total(best) < (1.0 - _GAIN) * total(rigid) else rigid


def _named(config: MachineConfig, name: str) -> MachineConfig:
    """Return a configuration of a candidate."""
    return config.model_copy(update={
        'family': config.family.model_copy(update=_CANDIDATES[name])})


def _short(config: MachineConfig, motions: Sequence[Run]) -> MachineConfig:
    """Return a configuration with a share of the steps, each on fewer windows."""
    loss = config.loss_of(all(motion.accelerations for motion in motions))

    def less(steps: int) -> int:
        return math.ceil(_SHARE * steps)
    changes: dict[str, object] = {
        'forward_steps': less(loss.forward_steps),
        'forward_lbfgs_steps': less(loss.forward_lbfgs_steps),
        'batch': math.ceil(_BATCH * loss.batch),
        'windows': [stage.model_copy(update={'steps': less(stage.steps)})
                    for stage in loss.windows]} if isinstance(loss, Trajectory) else {
        'steps': less(loss.steps), 'lbfgs_steps': less(loss.lbfgs_steps)}
    return config.model_copy(update={'loss': loss.model_copy(update=changes)})


def _line(errors: Errors) -> str:
    """Return errors as text."""
    return ', '.join(f'{" ".join("inf" if x is None else f"{x:.3g}" for x in values)} after '
                     f'{horizon} s' for horizon, values in errors.items())


def _trust(best: CandidateCard) -> str:
    """Return a sentence."""
    beyond = 'nothing holds it there' if best.name == ALONE else \
        'outside of what was seen it goes back to the rigid body' if best.name != RIGID else \
        'it has no networks that could fail outside of what was seen'
    return (f'Trust it for motions like those of its data, to {_line(best.ordinary)}; for motions '
            f'that go further, to {_line(best.furthest)}; {beyond}.')
