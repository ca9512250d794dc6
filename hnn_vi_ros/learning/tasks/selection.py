# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Choose the model of a machine with held-out motions, including the most extreme ones."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
import math
from typing import NamedTuple

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.arguments import Course, INPUTS
from hnn_vi_ros.learning.data.motions import (
    delayed, EvenMotion, MIN_SAMPLES, NONE, of_positions, part_of, run_of)
from hnn_vi_ros.learning.families.choices import (
    AUTO, MechanicalChoice, RigidBodyChoice, TrajectoryLoss)
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.learning.fit.loop import TrainingProblem
from hnn_vi_ros.learning.fit.machine import Network, runge_kutta, samples_of, slowness
from hnn_vi_ros.learning.fit.rigid_problem import positions_alone, RigidProblem
from hnn_vi_ros.learning.judging.missing import missing_force
from hnn_vi_ros.learning.judging.residuals import (
    is_noise, judged_along, noise_text, ONLY_NOISE, Residuals)
from hnn_vi_ros.models import CandidateCard, chain_angles, Errors, PLANAR_CHAIN, SelectionCard
import numpy as np
from scipy.optimize import minimize_scalar
import torch

# Largest estimated delay in samples; the resolution is a tenth of a sample. Most rounds in which
# the delay and the course of forces are found.
MOST_DELAY, _ROUNDS = 5.0, 4
# Number of pieces into which motions are cut, and their maximum duration [s].
_PIECES, _LONGEST = 40, 2.0
# Share of the time held out as extreme in speed, range and force, each; one in _ORDINARY of the
# other pieces is held out too.
_FURTHEST, _ORDINARY = 0.1, 5
# From this number of runs on, the most extreme runs are held out whole, half of the time at most.
_RUNS = 4
# Shares of training steps and windows per step for candidates; horizons at which they are
# judged, and time between starts [s].
_SHARE, _BATCH, _HORIZONS, _EVERY = 0.5, 0.125, (0.1, 0.5), 0.05
# Candidates may have errors on ordinary and on extreme motions larger than the rigid body's by
# _WORSE on average.
# Networks, or more friction, must reduce the mean error by more than _GAIN: smaller gains on
# held-out motions do not show that a candidate is better beyond the data.
_WORSE, _GAIN = 0.02, 0.08
# Initial friction terms of a rigid body, as in its configuration. A term is dropped if that
# increases the mean error by no more than _NEEDED, and other forces between samples are taken if
# they reduce residuals by more.
_TERMS = {'load': True, 'fade': True, 'stribeck': 1, 'directed': True, 'offset': True}
_NEEDED = 0.02
RIGID, ALONE = 'rigid body', 'networks alone'
OF_VELOCITIES, OF_POSITIONS = 'rigid body of measured velocities', 'rigid body of positions alone'
_CANDIDATES: dict[str, dict[str, dict[str, object]]] = {
    'mechanical': {
        RIGID: {'prior': PLANAR_CHAIN, 'residual': False},
        'rigid body and a network of V': {'prior': PLANAR_CHAIN, 'residual': ['potential']},
        'rigid body and networks': {'prior': PLANAR_CHAIN, 'residual': True},
        ALONE: {'prior': None, 'residual': True, 'angles': None, 'springs': False}},
    'rigid_body': {
        RIGID: {'residual': []},
        'rigid body and a network of V': {'residual': ['potential']},
        'rigid body and networks': {'residual': ['potential', 'friction', 'mass']}}}
# Factory of a problem; the last argument is a previously fitted rigid body.
Make = Callable[[MachineConfig, Sequence[EvenMotion], RigidProblem | None], TrainingProblem]


def selected(config: MachineConfig, motions: Sequence[EvenMotion], make: Make
             ) -> tuple[MachineConfig, SelectionCard | None]:
    """
    Return a configuration with the prior chosen, and the selection record if it was auto.

    Parameters
    ----------
    config : MachineConfig
        Configuration of the training. Its default windows are longer if samples are rare.
    motions : sequence of EvenMotion
        Training motions.
    make : callable
        Factory of the problem of a configuration on motions.

    Raises
    ------
    DataError
        No candidate can be trained on these motions.

    """
    config = _paced(config, motions)
    family, kinds = config.family, [coordinate.kind for coordinate in config.coordinates]
    given = config.data
    rigid_body = isinstance(family, RigidBodyChoice)
    if (family.residual if rigid_body else family.prior) != AUTO:
        return config, None
    if not rigid_body and not (
            chain_angles(kinds) and isinstance(config.loss, TrajectoryLoss | None)):
        return _named(config, ALONE), None
    trials, else_takes = _Trials.cut(make, motions, motions), RIGID if rigid_body else ALONE
    if not trials.enough:
        print(f'{AUTO}: {len(motions)} motions are too short for a selection; using '
              f'{else_takes}', flush=True)
        return _named(config, else_takes), None
    config, found = _candidates(config, trials)
    if all(card.failed for card in found):
        raise DataError(f'{AUTO}: {found[-1].failed}')
    best = best_of([card for card in found if card.name in _CANDIDATES[family.kind]])
    text = trials.text
    if config.family.friction != family.friction:
        terms = ', '.join(term for term in _TERMS if getattr(config.family.friction, term))
        text += f'; friction with {terms}, selected on the same motions'
    if config.data.velocities and not given.velocities:
        text += ('; from positions alone, since a rigid body of the measured velocities predicts '
                 'them worse')
    if (config.data.inputs, config.data.delay) != (given.inputs, given.delay):
        delay = config.data.delay
        forces = _Forces(config.data.inputs or 'linear', 0.0 if isinstance(delay, str) else delay)
        text += f'; forces between samples as {forces}, which fits them better'
    return _named(config, best.name), SelectionCard(
        held_out=text, candidates=found, chosen=best.name, trust=_trust(best, config))


class _Trials(NamedTuple):
    """Training motions of candidates, the pieces that judge them, and what ranks these."""

    make: Make
    ranked: Sequence[EvenMotion]
    motions: Sequence[EvenMotion]
    kept: list[EvenMotion]
    furthest: list[EvenMotion]
    ordinary: list[EvenMotion]

    @classmethod
    def cut(cls, make: Make, ranked: Sequence[EvenMotion], motions: Sequence[EvenMotion]
            ) -> '_Trials':
        """Cut motions into the pieces that others, of the same samples, are ranked by."""
        return cls(make, ranked, motions, *held_out(ranked, motions))

    @property
    def enough(self) -> bool:
        """Return whether pieces of both kinds are long enough for judging."""
        shortest = 1.05 * slowness(self.motions) * min(_HORIZONS)
        return all(any(run.t[-1] - run.t[0] >= shortest for run in part)
                   for part in (self.furthest, self.ordinary))

    @property
    def text(self) -> str:
        """Describe the data that judged the candidates."""
        time, total = (sum(len(run.t) * run.spacing for run in runs)
                       for runs in ((*self.furthest, *self.ordinary), self.motions))
        return (f'{time:.3g} s of {total:.3g} s of the motions, held out from the candidates: '
                'those with the largest speed, range or force, and ordinary ones; trained with '
                'half of the steps')

    def tried(self, name: str, own: MachineConfig, rigid: RigidProblem | None = None
              ) -> tuple[CandidateCard, TrainingProblem | None]:
        """Return a candidate's result and its problem; `rigid` is a rigid body fitted before."""
        try:
            problem = self.make(_short(own, self.motions), self.kept, rigid)
            problem.fit()
            own_trials, residuals = self.following(problem)
            card = CandidateCard(
                name=name, residuals=residuals,
                furthest=errors_of(problem.module, own_trials.furthest),
                ordinary=errors_of(problem.module, own_trials.ordinary))
        except DataError as reason:
            problem, card = None, CandidateCard(name=name, failed=str(reason)[:1000])
        print(f'{name}: ' + (card.failed or (
            f'RMS error {_line(card.ordinary, own)}; furthest motions '
            f'{_line(card.furthest, own)}')), flush=True)
        return card, problem

    def explained(self, config: MachineConfig, rigid: RigidProblem, card: CandidateCard) -> bool:
        """
        Return True if a rigid body leaves nothing but noise in these pieces.

        They are short: friction and initial states may make up for a force that is missing. If one
        shows in the accelerations, the fit to whole motions decides.
        """
        if not is_noise(card.residuals):
            return False
        if not missing_force(rigid.module, [*self.furthest, *self.ordinary], [
                one.name for one in config.coordinates]):
            return True
        try:
            whole = self.make(_short(_named(config, RIGID), self.motions), self.motions, None)
        except DataError:
            return False
        fitted = whole.fitted if isinstance(whole, RigidProblem) else None
        return fitted is not None and fitted.stages[-1][1] <= ONLY_NOISE

    def following(self, problem: TrainingProblem) -> tuple['_Trials', Residuals]:
        """
        Return the trials with initial states that a rigid body gives, and its residuals.

        Another model, and one of measured velocities, is judged from the states that there are.
        """
        if not isinstance(problem, RigidProblem) or problem.noise is None:
            return self, {}
        model, noise = problem.known(), problem.noise
        residuals, pieces = judged_along(model, [*self.furthest, *self.ordinary], noise)
        far = len(self.furthest)
        return self._replace(furthest=pieces[:far], ordinary=pieces[far:]), residuals

    def with_forces(self, forces: '_Forces') -> '_Trials':
        """Return the same pieces with forces of this course and delay."""
        return self.cut(self.make, self.ranked, [
            delayed(replace(motion, inputs=forces.course), forces.delay)
            for motion in self.motions])

    def of_positions(self) -> '_Trials':
        """Return the same pieces as if velocities had not been measured."""
        return self.cut(self.make, self.ranked, of_positions(self.motions))


def _candidates(config: MachineConfig, trials: _Trials
                ) -> tuple[MachineConfig, list[CandidateCard]]:
    """Return a configuration with fitting angles and friction, and all candidates' results."""
    kind = config.family.kind
    config, trials, rigid, found, explained = _rigid_bodies(config, trials)
    if isinstance(rigid, RigidProblem):
        trials, _ = trials.following(rigid)
        first, *others = found
        config = _with_angles(config, rigid)
        if explained:
            print(f'{RIGID}: {noise_text(first.residuals)}; nothing more is tried', flush=True)
            return config, found
        if 'friction' not in config.family.model_fields_set:
            config, rigid, found = _with_friction(config, trials, first, rigid)
            found += others
    else:
        rigid = None
    for name in [*_CANDIDATES[kind]][1:]:
        found.append(CandidateCard(name=name, failed=f'no {RIGID} fits these motions')
                     if rigid is None and name != ALONE else trials.tried(
                         name, _named(config, name), None if name == ALONE else rigid)[0])
    return config, found


class RigidBodyStage(NamedTuple):
    """A configuration, its trials, a rigid body with the cards of all, and if it explains all."""

    config: MachineConfig
    trials: _Trials
    rigid: TrainingProblem | None
    cards: list[CandidateCard]
    explained: bool


def _rigid_bodies(config: MachineConfig, trials: _Trials) -> RigidBodyStage:
    """
    Return the rigid body that predicts held-out motions best, of positions alone or of velocities.

    Filtered velocities are late or too small. Without them, initial states are better, and the
    fit is not biased.
    """
    both = _rigid_body(config, trials, *trials.tried(RIGID, _named(config, RIGID)))
    if not isinstance(config.family, MechanicalChoice) or positions_alone(trials.motions):
        return both
    print('from positions alone:', flush=True)
    config, trials = _with_data(config, velocities=NONE), trials.of_positions()
    alone = _rigid_body(config, trials, *trials.tried(RIGID, _named(config, RIGID)))
    if _total(alone.cards[0]) < (1.0 - _GAIN) * _total(both.cards[0]):
        return alone._replace(cards=[*alone.cards, *(card.model_copy(update={
            'name': card.name.replace(RIGID, OF_VELOCITIES)}) for card in both.cards)])
    return both._replace(cards=[*both.cards, alone.cards[0].model_copy(
        update={'name': OF_POSITIONS})])


def _rigid_body(config: MachineConfig, trials: _Trials, first: CandidateCard,
                rigid: TrainingProblem | None) -> RigidBodyStage:
    """Return a rigid body that was tried, with other inputs and springs if it needs them."""
    if not isinstance(rigid, RigidProblem):
        return RigidBodyStage(config, trials, rigid, [first], False)
    config, trials, first, rigid, others = _with_forces(config, trials, first, rigid)
    before, explained, found = rigid, trials.explained(config, rigid, first), [first]
    if not explained and not getattr(config.family, 'springs', True):
        config, rigid, found = _with_springs(config, trials, first, rigid)
        explained = rigid is not before and trials.explained(config, rigid, found[0])
    return RigidBodyStage(config, trials, rigid, [*found, *others], explained)


class _Forces(NamedTuple):
    """Course of measured forces between samples, and their delay in samples."""

    course: Course
    delay: float

    def like(self, course: Course, free: bool) -> list['_Forces']:
        """Return forces of another course, of the same delay and of the same mean in time."""
        moved = round(self.delay + 0.5 * ((self.course == 'held') - (course == 'held')), 2)
        return [_Forces(course, delay) for delay in {self.delay, moved if free else self.delay}
                if abs(delay) <= MOST_DELAY]

    def __str__(self) -> str:
        return self.course + (f', delayed by {self.delay:g} samples' if self.delay else '')


def _with_forces(config: MachineConfig, trials: _Trials, first: CandidateCard, rigid: RigidProblem
                 ) -> tuple[MachineConfig, _Trials, CandidateCard, RigidProblem,
                            list[CandidateCard]]:
    """
    Change the course and the delay of forces if others fit better, unless they are given.

    Held forces are almost linear ones half a sample later, so both are found together. Without the
    delay a fit has wrong friction, and with that another best delay, so they are found in rounds.
    """
    base, given, cards = trials, config.data, list[CandidateCard]()
    now, free = _Forces(trials.motions[0].inputs, 0.0), 'delay' not in given.model_fields_set
    courses = [now.course] if given.inputs or now.course == 'held' else INPUTS
    while rigid.is_driven(base.kept) and len(cards) < _ROUNDS:
        misfit = cache(partial(_misfit, rigid, base, config))
        near = _best_delay(misfit, now) if free else now
        best = min((one for course in courses for one in near.like(course, free)), key=misfit)
        if free and best.course != near.course:
            best = _refined(misfit, best)
        gain = 1.0 - misfit(best) / misfit(now)
        if not rigid.is_evidence(gain):
            break
        own = _with_data(config, **{'inputs': best.course} | (
            {'delay': best.delay} if free else {}))
        moved = base.with_forces(best)
        if gain < _NEEDED and best.delay == now.delay:
            # Less than what another trial could show.
            return own, moved, first, rigid, cards
        print(f'forces between samples as {best}:', flush=True)
        card, problem = moved.tried(RIGID, _named(own, RIGID))
        if not isinstance(problem, RigidProblem) or _total(card) > _total(first):
            break
        cards.insert(0, first.model_copy(update={'name': f'{RIGID}, forces {now}'}))
        config, trials, first, rigid, now = own, moved, card, problem, best
    return config, trials, first, rigid, cards


def _misfit(rigid: RigidProblem, base: _Trials, config: MachineConfig, forces: _Forces) -> float:
    return rigid.misfit_with(base.with_forces(forces).kept, config.windows)


def _best_delay(misfit: Callable[[_Forces], float], forces: _Forces) -> _Forces:
    """Return forces with the delay that fits best, searched from theirs."""
    for side in (1.0, -1.0):
        while abs(forces.delay + side) <= MOST_DELAY and misfit(
                later := forces._replace(delay=forces.delay + side)) < misfit(forces):
            forces = later
    return _refined(misfit, forces)


def _refined(misfit: Callable[[_Forces], float], forces: _Forces) -> _Forces:
    """Return forces with the best delay within a sample of theirs, unless that is 0."""
    if not forces.delay:
        return forces
    found = minimize_scalar(
        lambda delay: misfit(forces._replace(delay=round(delay, 2))),
        bounds=(max(forces.delay - 1.0, -MOST_DELAY), min(forces.delay + 1.0, MOST_DELAY)),
        method='bounded', options={'xatol': 0.05})
    return min(forces, forces._replace(delay=round(float(found.x), 2)), key=misfit)


def _with_data(config: MachineConfig, **changes: object) -> MachineConfig:
    return config.model_copy(update={'data': config.data.model_copy(update=changes)})


def _with_springs(
        config: MachineConfig, trials: _Trials, plain: CandidateCard, rigid: RigidProblem
        ) -> tuple[MachineConfig, RigidProblem, list[CandidateCard]]:
    """Return a configuration, its rigid body and cards, with springs if they are needed."""
    own = config.model_copy(update={'family': config.family.model_copy(update={'springs': True})})
    card, problem = trials.tried(f'{RIGID} with springs', _named(own, RIGID))
    if not isinstance(problem, RigidProblem) or best_of([plain, card]) is plain:
        return config, rigid, [plain, card]
    return own, problem, [card.model_copy(update={'name': RIGID}), plain.model_copy(
        update={'name': f'{RIGID} without springs'})]


def _with_friction(
        config: MachineConfig, trials: _Trials, plain: CandidateCard, rigid: RigidProblem
        ) -> tuple[MachineConfig, RigidProblem, list[CandidateCard]]:
    """
    Return a configuration with the friction that held-out motions support, its rigid body, cards.

    Backward elimination: start with all terms and drop each one that errors do not need.
    Plain viscous and Coulomb friction is kept unless the result reduces errors by _GAIN.
    """
    driven = any(motion.tau.any() for motion in trials.motions)
    motors = driven and isinstance(config.family, MechanicalChoice)
    # For a sliding joint, and with springs, the rigid body already contains a constant force.
    holds = any(coordinate.kind == 'prismatic' for coordinate in config.coordinates) or (
        getattr(config.family, 'springs', False))
    may_be = {'load': driven, 'directed': True, 'stribeck': True, 'fade': motors,
              'offset': motors and not holds}
    names = [name for name in _TERMS if may_be[name]]
    cards: list[CandidateCard] = []

    def without(terms: Sequence[str]
                ) -> tuple[CandidateCard, TrainingProblem | None, MachineConfig]:
        friction = config.family.friction.model_copy(update={
            name: value for name, value in _TERMS.items() if name in names and name not in terms})
        own = config.model_copy(update={'family': config.family.model_copy(update={
            'friction': friction})})
        left = ', '.join(name for name in names if name not in terms)
        card, problem = trials.tried(f'{RIGID}, friction with {left}', _named(own, RIGID))
        cards.append(card)
        return card, problem, own
    left_out: list[str] = []
    best = without([])
    for name in names:
        if len(left_out) + 1 == len(names):
            break
        other = without([*left_out, name])
        if _total(other[0]) <= (1.0 + _NEEDED) * _total(best[0]):
            left_out.append(name)
            best = other
    card, problem, own = best
    if not isinstance(problem, RigidProblem) or best_of([plain, card]) is plain:
        return config, rigid, [plain, *cards]
    plain = plain.model_copy(update={'name': f'{RIGID}, plain friction'})
    return own, problem, [card.model_copy(update={'name': RIGID}), plain, *(
        one for one in cards if one is not card)]


def _paced(config: MachineConfig, motions: Sequence[EvenMotion]) -> MachineConfig:
    """Return a configuration with longer default windows if samples are rare."""
    loss = config.loss_of(motions)
    if not isinstance(loss, TrajectoryLoss) or 'windows' in loss.model_fields_set:
        return config
    longest = max(motion.t[-1] - motion.t[0] for motion in motions)
    windows = [stage.model_copy(update={'duration': max(stage.duration, min(
        slowness(motions, loss.step_size) * stage.duration, 0.5 * longest))})
        for stage in loss.windows]
    return config.model_copy(update={'loss': loss.model_copy(update={'windows': windows})})


def _with_angles(config: MachineConfig, rigid: RigidProblem) -> MachineConfig:
    """Return a configuration with the link angles of a fitted rigid body."""
    if not isinstance(config.family, MechanicalChoice):
        return config
    names = [coordinate.name for coordinate in config.coordinates]
    return config.model_copy(update={'family': config.family.model_copy(update={'angles': [
        ' + '.join(f'{x:g} * {name}' for x, name in zip(row, names, strict=True) if x)
        for row in rigid.module.structure.angles if any(row)]})})


def held_out(motions: Sequence[EvenMotion], cut: Sequence[EvenMotion] | None = None
             ) -> tuple[list[EvenMotion], list[EvenMotion], list[EvenMotion]]:
    """
    Return training motions, extreme pieces and ordinary pieces.

    Pieces are ranked by their largest speed, distance from the median and force, each relative to
    the maximum over all motions. Runs often share one such maximum and are ranked by norms. The
    pieces are those of ``cut``, of the same samples, if it is given.
    """
    cut = motions if cut is None else cut
    total = sum(len(run.t) for run in motions)
    longest = max(MIN_SAMPLES, min(round(_LONGEST / motions[0].spacing), total // _PIECES))
    pieces = [(run, rows) for run in motions
              for rows in np.array_split(np.arange(len(run.t)), max(1, len(run.t) // longest))]
    far = _furthest(motions, pieces)
    others = [k for k in range(len(pieces)) if k not in far]
    usual = set(others[_ORDINARY // 2::_ORDINARY])
    kept: list[EvenMotion] = []
    begin = 0
    for run, own in zip(motions, cut, strict=True):
        count = sum(one is run for one, _ in pieces)
        mine = [(k, pieces[k][1]) for k in range(begin, begin + count)]
        begin += count
        free = np.concatenate([rows for k, rows in mine if k not in far | usual] or [
            np.zeros(0, int)])
        blocks = np.split(free, np.flatnonzero(np.diff(free) > 1) + 1)
        kept += [part_of(own, rows) for rows in blocks if len(rows) >= MIN_SAMPLES]
    if not kept:
        return [*cut], [], []
    at = {id(run): other for run, other in zip(motions, cut, strict=True)}
    furthest, ordinary = ([part_of(at[id(pieces[k][0])], pieces[k][1]) for k in sorted(chosen)]
                          for chosen in (far, usual))
    return kept, furthest, ordinary


def _furthest(motions: Sequence[EvenMotion], pieces: Sequence[tuple[EvenMotion, np.ndarray]]
              ) -> set[int]:
    """Return the indices of the most extreme pieces; see held_out."""
    names = [run_of(run) for run, _ in pieces]
    whole, total = len(set(names)) >= _RUNS, sum(len(run.t) for run in motions)
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
    return far


def errors_of(network: Network, pieces: Sequence[EvenMotion]) -> Errors:
    """Return prediction errors of a network from many states of pieces; see CandidateCard."""
    samples, slow = samples_of(pieces, None), slowness(pieces)
    found: Errors = {}
    apart = max(1, round(_EVERY / pieces[0].spacing))
    for horizon in (slow * usual for usual in _HORIZONS):
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
        raise DataError('the held-out pieces are too short for an evaluation')
    return found


def best_of(found: Sequence[CandidateCard]) -> CandidateCard:
    """
    Return the candidate with the least mean error if it is better than the rigid body by _GAIN.

    Its mean errors on ordinary and on extreme motions may not exceed the rigid body's by more than
    _WORSE, each. Without a rigid body, the best candidate on average is returned.
    """
    tried = [card for card in found if not card.failed]
    rigid = next((card for card in tried if card.name == RIGID), None)
    if rigid is None:
        return min(tried, key=_total)
    best = min((card for card in tried if card is rigid or all(
        _size(card, part) <= (1.0 + _WORSE) * _size(rigid, part)
        for part in ('ordinary', 'furthest'))), key=_total)
    return best if _total(best) < (1.0 - _GAIN) * _total(rigid) else rigid


def _size(card: CandidateCard, *parts: str) -> float:
    """Return the geometric mean of a candidate's errors, inf if it failed."""
    errors = [x for part in parts for errors in getattr(card, part).values() for x in errors]
    return math.exp(np.mean(np.log([math.inf if x is None else max(x, 1e-12)
                                    for x in errors]))) if errors else math.inf


def _total(card: CandidateCard) -> float:
    return _size(card, 'ordinary', 'furthest')


def _named(config: MachineConfig, name: str) -> MachineConfig:
    """Return the configuration of a candidate."""
    return config.model_copy(update={
        'family': config.family.model_copy(update=_CANDIDATES[config.family.kind][name])})


def _short(config: MachineConfig, motions: Sequence[EvenMotion]) -> MachineConfig:
    """Return a configuration with a share of the steps, each on fewer windows."""
    loss = config.loss_of(motions)

    def less(steps: int) -> int:
        return math.ceil(_SHARE * steps)
    changes: dict[str, object] = {
        'forward_steps': less(loss.forward_steps),
        'forward_lbfgs_steps': less(loss.forward_lbfgs_steps),
        'batch': math.ceil(_BATCH * loss.batch),
        'windows': [stage.model_copy(update={'steps': less(stage.steps)})
                    for stage in loss.windows]} if isinstance(loss, TrajectoryLoss) else {
        'steps': less(loss.steps), 'lbfgs_steps': less(loss.lbfgs_steps)}
    return config.model_copy(update={'loss': loss.model_copy(update=changes)})


def _line(errors: Errors, config: MachineConfig) -> str:
    """Format RMS errors as text."""
    units = [coordinate.q_unit for coordinate in config.coordinates]
    return ', '.join(' '.join(
        f'{math.inf if x is None else x:.3g} {unit}' for x, unit in zip(values, units, strict=True)
    ) + f' after {horizon} s' for horizon, values in errors.items())


def _trust(best: CandidateCard, config: MachineConfig) -> str:
    """Return advice on how far to trust the selected model."""
    beyond = 'elsewhere, also within its training domain, its errors are unbounded' \
        if best.name == ALONE else \
        'outside of its training domain it returns to the rigid body' if best.name != RIGID else \
        'it has no networks that could fail outside of its training domain'
    noise = f' On both {noise_text(best.residuals)}.' if best.residuals else ''
    if is_noise(best.residuals):
        return ('Trust it for motions like those of its data and for those that go further: on '
                f'held-out ones of both kinds {noise_text(best.residuals)}; {beyond}.')
    return ('Trust it for motions like those of its data: RMS error '
            f'{_line(best.ordinary, config)}; for motions that go further: '
            f'{_line(best.furthest, config)}; {beyond}.{noise}')
