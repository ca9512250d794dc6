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
from hnn_vi_ros.learning.fit.fitted_rigid_body import downsampled, FittedRigidBody, positions_alone
from hnn_vi_ros.learning.fit.loop import Fitted
from hnn_vi_ros.learning.fit.machine import Network, slowness
from hnn_vi_ros.learning.fit.machine_fit import fit_machine, MOST_DELAY
from hnn_vi_ros.learning.judging.evaluation import finite, samples_in, score
from hnn_vi_ros.learning.judging.missing import missing_force, missing_forces
from hnn_vi_ros.learning.judging.predictors import predicted_by
from hnn_vi_ros.learning.judging.residuals import (
    is_noise, is_off, judged_along, noise_text, ONLY_NOISE, Residuals)
from hnn_vi_ros.models import (
    CandidateCard, chain_angles, Errors, FittedNumber, HIGHEST_POWER, PLANAR_CHAIN, SelectionCard)
import numpy as np
from scipy.optimize import minimize_scalar

# A delay closer than this to the end of its search [samples] is not found by it.
_EDGE = 0.1
# Change of the delay whose first-order effect shows whether another one is searched [samples].
_BESIDE = 0.25
# Most rounds in which the delay and the course of forces are found.
_ROUNDS = 4
# Number of pieces into which motions are cut, and their maximum duration [s].
_PIECES, _LONGEST = 40, 2.0
# Share of the time held out as extreme in speed, range and force, each; one in _ORDINARY of the
# other pieces is held out too.
_FURTHEST, _ORDINARY = 0.1, 5
# From this number of runs on, the most extreme runs are held out whole, half of the time at most.
_RUNS = 4
# Number of knots of a spring whose force consists of straight lines, and name of linear ones.
_KNOTS, _LINEAR = 32, 'linear springs'
# Shares of training steps and windows per step for candidates; horizons at which they are
# judged, and time between starts [s].
_SHARE, _BATCH, _HORIZONS, _EVERY = 0.5, 0.125, (0.1, 0.5), 0.05
# Evidence for a candidate with more terms or networks; see Candidate.is_better_than. Smaller gains
# on held-out motions do not show that it is better beyond the data.
_WORSE, _GAIN = 0.02, 0.08
# Initial friction terms of a rigid body, as in its configuration. A term is dropped if that
# increases the mean error by no more than _NEEDED, and other forces between samples are taken if
# they reduce residuals by more.
_TERMS = {'load': True, 'fade': True, 'stribeck': 1, 'directed': True, 'offset': True}
_NEEDED = 0.02
# Number of runs that are fitted one by one.
_MOST_RUNS = 4
# Difference of two numbers relative to the sum of the half-widths of their intervals that shows
# two machines. A larger ratio than 1, since models err beyond the noise.
_APART = 3.0
RIGID, ALONE = 'rigid body', 'networks alone'
OF_VELOCITIES, OF_POSITIONS = 'rigid body of measured velocities', 'rigid body of positions alone'
_CANDIDATES: dict[str, dict[str, dict[str, object]]] = {
    'mechanical': {
        RIGID: {'prior': PLANAR_CHAIN, 'residual': False},
        'rigid body and a network of V': {'prior': PLANAR_CHAIN, 'residual': ['potential']},
        'rigid body and networks': {'prior': PLANAR_CHAIN, 'residual': True},
        ALONE: {'prior': None, 'residual': True, 'angles': None, 'springs': False,
                'spring_knots': []}},
    'rigid_body': {
        RIGID: {'residual': []},
        'rigid body and a network of V': {'residual': ['potential']},
        'rigid body and networks': {'residual': ['potential', 'friction', 'mass']}}}


def selected(config: MachineConfig, motions: Sequence[EvenMotion]
             ) -> tuple[MachineConfig, SelectionCard | None]:
    """
    Return a configuration with the prior chosen, and the selection record if it was auto.

    Parameters
    ----------
    config : MachineConfig
        Configuration of the training. Its default windows are longer if samples are rare.
    motions : sequence of EvenMotion
        Training motions.

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
    trials, else_takes = _Trials.cut(motions, motions), RIGID if rigid_body else ALONE
    if not trials.enough:
        print(f'{AUTO}: {len(motions)} motions are too short for a selection; using '
              f'{else_takes}', flush=True)
        return _named(config, else_takes), None
    best, tried = _candidates(config, trials)
    if best.fitted is None:
        raise DataError(f'{AUTO}: {tried[-1].card.failed}')
    config, text = best.config, '; '.join(filter(None, (trials.text, best.remark)))
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
    return config, SelectionCard(
        held_out=text, candidates=[one.card for one in tried], chosen=best.card.name)


class Candidate(NamedTuple):
    """
    A model that was fitted to a part of the motions, and judged on the others.

    Parameters
    ----------
    config : MachineConfig
        Its configuration.
    trials : _Trials
        The motions.
    fitted : Fitted or None
        The fitted model; None if the fit failed.
    card : CandidateCard
        Its errors, or the reason of the failure.
    explained : bool
        True if it leaves nothing but noise.
    remark : str
        See ``_differing_runs``: if it is given, no model of (q, p) is of all runs.

    """

    config: MachineConfig
    trials: '_Trials'
    fitted: Fitted | None
    card: CandidateCard
    explained: bool = False
    remark: str = ''

    @property
    def error(self) -> float:
        """Return the mean error on ordinary and extreme motions."""
        return _size(self.card, 'ordinary', 'furthest')

    @property
    def rigid(self) -> FittedRigidBody | None:
        """Return the rigid body, None for other models."""
        return self.fitted if isinstance(self.fitted, FittedRigidBody) else None

    def named(self, name: str) -> 'Candidate':
        """Return the candidate with another name on its card."""
        return self._replace(card=self.card.model_copy(update={'name': name}))

    def is_better_than(self, other: 'Candidate') -> bool:
        """
        Return True if held-out motions show that this model is better than a simpler one.

        Its mean error must be smaller by more than _GAIN, and those on ordinary and on extreme
        motions not larger by more than _WORSE, each.
        """
        return self.fitted is not None and (
            other.fitted is None or (
                self.error < (1.0 - _GAIN) * other.error and all(
                    _size(self.card, part) <= (1.0 + _WORSE) * _size(other.card, part)
                    for part in ('ordinary', 'furthest'))))


class _Trials(NamedTuple):
    """Training motions of candidates, the pieces that judge them, and what ranks these."""

    ranked: Sequence[EvenMotion]
    motions: Sequence[EvenMotion]
    kept: list[EvenMotion]
    furthest: list[EvenMotion]
    ordinary: list[EvenMotion]

    @classmethod
    def cut(cls, ranked: Sequence[EvenMotion], motions: Sequence[EvenMotion]) -> '_Trials':
        """Cut motions into the pieces that others, of the same samples, are ranked by."""
        return cls(ranked, motions, *held_out(ranked, motions))

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

    def candidate(self, name: str, config: MachineConfig, rigid: FittedRigidBody | None = None
                  ) -> Candidate:
        """Fit a model with half of the steps and judge it; `rigid` was fitted before."""
        try:
            fitted = fit_machine(_short(config, self.motions), self.kept, rigid)
            judged, residuals = self.following(fitted)
            card = CandidateCard(
                name=name, residuals=residuals,
                furthest=errors_of(fitted.module, judged.furthest),
                ordinary=errors_of(fitted.module, judged.ordinary))
        except DataError as reason:
            fitted, card = None, CandidateCard(name=name, failed=str(reason)[:1000])
        print(f'{name}: ' + (card.failed or (
            f'RMS error {_line(card.ordinary, config)}; furthest motions '
            f'{_line(card.furthest, config)}')), flush=True)
        return Candidate(config, self, fitted, card)

    def following(self, fitted: Fitted) -> tuple['_Trials', Residuals]:
        """
        Return the trials with initial states that a rigid body gives, and its residuals.

        Another model, and one of measured velocities, is judged from the states that there are.
        """
        if not isinstance(fitted, FittedRigidBody) or fitted.noise is None:
            return self, {}
        residuals, pieces, _ = judged_along(
            fitted.known(), [*self.furthest, *self.ordinary], fitted.noise)
        far = len(self.furthest)
        return self._replace(furthest=pieces[:far], ordinary=pieces[far:]), residuals

    def with_forces(self, forces: '_Forces') -> '_Trials':
        """Return the same pieces with forces of this course and delay."""
        return self.cut(self.ranked, [
            delayed(replace(motion, inputs=forces.course), forces.delay)
            for motion in self.motions])

    def of_positions(self) -> '_Trials':
        """Return the same pieces as if velocities had not been measured."""
        return self.cut(self.ranked, of_positions(self.motions))


def _candidates(config: MachineConfig, trials: _Trials) -> tuple[Candidate, list[Candidate]]:
    """Return the best candidate, and all in the order in which the card lists them."""
    rigid, *tried = _rigid_bodies(config, trials)
    if rigid.rigid is not None:
        rigid = rigid._replace(config=_with_angles(rigid.config, rigid.rigid),
                               trials=rigid.trials.following(rigid.rigid)[0])
        if rigid.explained:
            print(f'{RIGID}: {noise_text(rigid.card.residuals)}; nothing more is tried',
                  flush=True)
            return rigid, [rigid, *tried]
        if rigid.remark:
            print(f'warning: {rigid.remark}; nothing more is tried', flush=True)
            return rigid, [rigid, *tried]
        if 'friction' not in config.family.model_fields_set:
            rigid, *more = _with_friction(rigid)
            tried = [*more, *tried]
    networks = [_with_networks(rigid, name) for name in [*_CANDIDATES[config.family.kind]][1:]]
    return best_of(rigid, networks), [rigid, *tried, *networks]


def best_of(rigid: Candidate, others: Sequence[Candidate]) -> Candidate:
    """Return the best of some candidates that are better than the rigid body, or that one."""
    return min((one for one in others if one.is_better_than(rigid)), key=lambda one: one.error,
               default=rigid)


def _with_networks(rigid: Candidate, name: str) -> Candidate:
    """Return a candidate with networks on top of a rigid body, or alone."""
    config = _named(rigid.config, name)
    if rigid.rigid is None and name != ALONE:
        return Candidate(config, rigid.trials, None, CandidateCard(
            name=name, failed=f'no {RIGID} fits these motions'))
    return rigid.trials.candidate(name, config, None if name == ALONE else rigid.rigid)


def _rigid_bodies(config: MachineConfig, trials: _Trials) -> list[Candidate]:
    """
    Return rigid bodies, the best one first: of positions alone, or of velocities too.

    Filtered velocities are late or too small. Without them, initial states are better, and the
    fit is not biased.
    """
    both = _rigid_body(trials.candidate(RIGID, _named(config, RIGID)))
    if not isinstance(config.family, MechanicalChoice) or positions_alone(trials.motions):
        return both
    print('from positions alone:', flush=True)
    config = _named(_with_data(config, velocities=NONE), RIGID)
    alone = _rigid_body(trials.of_positions().candidate(RIGID, config))
    if alone[0].is_better_than(both[0]):
        return [*alone, *(one.named(one.card.name.replace(RIGID, OF_VELOCITIES)) for one in both)]
    return [*both, alone[0].named(OF_POSITIONS)]


def _rigid_body(first: Candidate) -> list[Candidate]:
    """Return a rigid body with other forces and springs if it needs them, then those before."""
    if first.rigid is None:
        return [first]
    may_have_springs = not getattr(first.config.family, 'springs', True)
    # A delay of the forces would mimic a spring in vain.
    springs_first = may_have_springs and _lacks_springs(first)
    found = [first] if springs_first else _with_forces(first)
    best = found[0] = found[0]._replace(explained=_is_explained(found[0]))
    if not best.explained:
        motions = best.trials.motions
        best = found[0] = best._replace(
            remark=_differing_runs(_short(best.config, motions), motions))
    if best.explained or best.remark or not may_have_springs:
        return found
    alone = positions_alone(first.trials.motions)
    kinds = [coordinate.kind for coordinate in first.config.coordinates]
    single = alone and len(kinds) == 1
    # As many samples between all, so that no piece is known by a few.
    knots = np.quantile(np.concatenate([motion.q for motion in first.trials.kept]),
                        np.linspace(0.0, 1.0, _KNOTS + 2)[1:-1])
    terms: list[tuple[bool, str, dict[str, object]]] = [
        (alone and {*kinds} != {'prismatic'}, 'offsets of sensors', {'sensor_offsets': True}),
        (single, _LINEAR, {'springs': 1}),
        (True, 'springs', {'springs': HIGHEST_POWER if single else 1}),
        (single, 'a spring of straight pieces', {
            'springs': 1, 'spring_knots': [float(f'{knot:.4g}') for knot in knots]})]
    for may_help, name, changes in terms:
        if not may_help or found[0].explained:
            continue
        best, *others = _with_terms(found[0], first, name, changes)
        # Powers and gravity make up for each other: linear springs are kept if they explain all.
        if name == _LINEAR and not best.explained:
            tried = others[0] if best is found[0] else best.named(f'{RIGID} with {name}')
            found.append(tried)
        else:
            found[:1] = [best, *others]
    if springs_first and found[0].rigid is first.rigid:
        found[:1] = _with_forces(found[0])
    return found


def _differing_runs(config: MachineConfig, motions: Sequence[EvenMotion]) -> str:
    """
    Return a sentence if the first runs are of different machines, loads or units, else ''.

    They are if a rigid body leaves nothing but noise in each run alone, with numbers that differ
    by several times their 95 % intervals. Use it for a rigid body that does not explain all runs.

    Parameters
    ----------
    config : MachineConfig
        Configuration of a rigid body.
    motions : sequence of EvenMotion
        Motions, with positions alone.

    """
    runs: dict[str, list[EvenMotion]] = {}
    for motion in motions:
        runs.setdefault(run_of(motion), []).append(motion)
    free = not any(motion.tau.any() for motion in motions)
    q = np.concatenate([motion.q_smooth for motion in motions]) if free else None
    found = dict[str, dict[str, FittedNumber]]()
    for name in [*runs][:_MOST_RUNS if len(runs) > 1 else 0]:
        try:
            fitted = fit_machine(config, runs[name])
        except DataError:
            return ''
        if not (isinstance(fitted, FittedRigidBody) and fitted.numbers is not None
                and fitted.numbers.stages[-1][1] <= ONLY_NOISE):
            return ''
        found[name] = fitted.estimates(config.coordinates, q)
    apart = {}
    for key in set.intersection(*map(set, found.values())) if found else ():
        low, *_, high = sorted(found, key=lambda name: found[name][key].value)
        first, last = found[low][key], found[high][key]
        if first.interval is None or last.interval is None:
            continue
        # The interval of an inertia that is set to 1 is a point.
        halves = max(first.interval[1] - first.value + last.interval[1] - last.value,
                     1e-6 * abs(last.value))
        apart[(last.value - first.value) / (halves or 1.0)] = key, low, high
    most = max(apart, default=0.0)
    if most < _APART:
        return ''
    key, *ends = apart[most]
    values = ' and '.join(f'{found[name][key].value:.4g} in {name}' for name in ends)
    # Without forces, numbers are relative to the inertia.
    unit = '' if free else f' [{found[ends[0]][key].unit}]'
    return (f'a rigid body explains each run alone, but not together: {key} is {values}{unit}; '
            'train on runs of one machine, load and unit')


def _lacks_springs(candidate: Candidate) -> bool:
    """Return True if most of a force that a rigid body lacks goes with the position."""
    assert candidate.rigid is not None, 'it is a rigid body'
    return any(force.causes.get('position', 0.0) > 0.5 for force in missing_forces(
        candidate.rigid.module, candidate.trials.kept))


def _is_explained(candidate: Candidate) -> bool:
    """
    Return True if a rigid body leaves nothing but noise in the pieces that judge it.

    They are short: friction and initial states may make up for a force that is missing. If one
    shows in the accelerations, the fit to whole motions decides.
    """
    trials, config, rigid = candidate.trials, candidate.config, candidate.rigid
    card, pieces = candidate.card, [*trials.furthest, *trials.ordinary]
    if rigid is None or not is_noise(card.residuals) or is_off(
            [*card.ordinary.values(), *card.furthest.values()], pieces):
        return False
    if not missing_force(rigid.module, pieces, [one.name for one in config.coordinates]):
        return True
    try:
        whole = fit_machine(_short(config, trials.motions), trials.motions)
    except DataError:
        return False
    numbers = whole.numbers if isinstance(whole, FittedRigidBody) else None
    return numbers is not None and numbers.stages[-1][1] <= ONLY_NOISE


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


def _with_forces(first: Candidate) -> list[Candidate]:
    """
    Return a rigid body with another course and delay of forces if they fit better, and all before.

    Held forces are almost linear ones half a sample later, so both are found together. Without the
    delay a fit has wrong friction, and with that another best delay, so they are found in rounds.
    """
    base, given, found = first.trials, first.config.data, [first]
    now, free = _Forces(base.motions[0].inputs, 0.0), 'delay' not in given.model_fields_set
    courses = [now.course] if given.inputs or now.course == 'held' else INPUTS
    while len(found) <= _ROUNDS:
        last, config = found[0], found[0].config
        rigid = last.rigid
        if rigid is None or not rigid.is_driven(base.kept):
            break
        beside = [now._replace(delay=now.delay + side) for side in (_BESIDE, -_BESIDE) if free]
        if not any(rigid.is_hint(base.with_forces(one).kept, config.windows) for one in [
                *beside, *(one for course in courses if course != now.course
                           for one in now.like(course, free))]):
            break
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
            found[0] = last._replace(config=own, trials=moved)
            break
        print(f'forces between samples as {best}:', flush=True)
        other = moved.candidate(RIGID, own)
        if other.rigid is None or other.error > last.error:
            break
        found[:1] = [other, last.named(f'{RIGID}, forces {now}')]
        now = best
    return found


def _misfit(rigid: FittedRigidBody, base: _Trials, config: MachineConfig, forces: _Forces
            ) -> float:
    return rigid.misfit_with(base.with_forces(forces).kept, config.windows)


def _best_delay(misfit: Callable[[_Forces], float], forces: _Forces) -> _Forces:
    """
    Return forces with the delay that fits best, searched from theirs.

    One at the end of the search is no evidence: it makes up for something that the model lacks.
    """
    begun = forces
    for side in (1.0, -1.0):
        while abs(forces.delay + side) <= MOST_DELAY and misfit(
                later := forces._replace(delay=forces.delay + side)) < misfit(forces):
            forces = later
    found = _refined(misfit, forces)
    return begun if abs(found.delay) > MOST_DELAY - _EDGE else found


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


def _with_terms(plain: Candidate, first: Candidate, name: str, changes: dict[str, object]
                ) -> list[Candidate]:
    """
    Return a rigid body with more terms if they are needed, and the other one.

    Other forces between samples are found again: those of a body that lacks terms mimic them.
    """
    config = first.config.model_copy(update={
        'family': first.config.family.model_copy(update=changes)})
    more = first.trials.candidate(f'{RIGID} with {name}', config)
    if more.rigid is None or not more.is_better_than(plain):
        return [plain, more]
    best, *others = _with_forces(more.named(RIGID))
    return [best._replace(explained=_is_explained(best)), *others,
            plain.named(f'{RIGID} without {name}')]


def _with_friction(plain: Candidate) -> list[Candidate]:
    """
    Return a rigid body with the friction that held-out motions support, and all others.

    Backward elimination: start with all terms and drop each one that errors do not need.
    Plain viscous and Coulomb friction is kept unless the result is better.
    """
    config = plain.config
    driven = any(motion.tau.any() for motion in plain.trials.motions)
    motors = driven and isinstance(config.family, MechanicalChoice)
    # For a sliding joint, and with springs, the rigid body already contains a constant force.
    holds = any(coordinate.kind == 'prismatic' for coordinate in config.coordinates) or (
        getattr(config.family, 'springs', False))
    may_be = {'load': driven, 'directed': True, 'stribeck': True, 'fade': motors,
              'offset': motors and not holds}
    names = [name for name in _TERMS if may_be[name]]

    def with_terms(terms: Sequence[str]) -> Candidate:
        friction = config.family.friction.model_copy(update={name: _TERMS[name] for name in terms})
        return plain.trials.candidate(
            f'{RIGID}, friction with {", ".join(terms)}', config.model_copy(update={
                'family': config.family.model_copy(update={'friction': friction})}))
    kept, tried = names, [with_terms(names)]
    best = tried[0]
    for name in names:
        if len(kept) == 1:
            break
        fewer = [one for one in kept if one != name]
        tried.append(with_terms(fewer))
        if tried[-1].error <= (1.0 + _NEEDED) * best.error:
            kept, best = fewer, tried[-1]
    if best.rigid is None or not best.is_better_than(plain):
        return [plain, *tried]
    return [best.named(RIGID), plain.named(f'{RIGID}, plain friction'), *(
        one for one in tried if one is not best)]


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


def _with_angles(config: MachineConfig, rigid: FittedRigidBody) -> MachineConfig:
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
    slow, (pieces, _) = slowness(pieces), downsampled(pieces, None)
    horizons = [horizon for horizon in (slow * usual for usual in _HORIZONS)
                if any(samples_in(horizon, run) < len(run.t) for run in pieces)]
    if not horizons:
        raise DataError('the held-out pieces are too short for an evaluation')
    found = score(predicted_by(network), pieces, horizons, _EVERY, max(horizons))
    return {f'{horizon:g}': finite(rms) for horizon, rms in found.horizons.items()}


def _size(card: CandidateCard, *parts: str) -> float:
    """Return the geometric mean of a candidate's errors, inf if it failed."""
    errors = [x for part in parts for errors in getattr(card, part).values() for x in errors]
    return math.exp(np.mean(np.log([math.inf if x is None else max(x, 1e-12)
                                    for x in errors]))) if errors else math.inf


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


def trust_text(selection: SelectionCard, config: MachineConfig, whole: Residuals,
               motions: Sequence[EvenMotion], off: bool) -> str:
    """
    Return advice on how far to trust the selected model.

    Parameters
    ----------
    selection : SelectionCard
        The candidates; their pieces are short, and some go further than the data of the fits.
    config : MachineConfig
        Configuration of the model.
    whole : dict of str to list of float
        Residuals of the model along whole held-out motions; empty if velocities were measured.
    motions : sequence of EvenMotion
        All motions, with which errors are compared.
    off : bool
        True if simulations of the final model leave the held-out motions.

    """
    chosen = next(one for one in selection.candidates if one.name == selection.chosen)
    beyond = 'elsewhere, also within its training domain, its errors are unbounded' \
        if chosen.name == ALONE else \
        'outside of its training domain it returns to the rigid body' if chosen.name != RIGID \
        else 'it has no networks that could fail outside of its training domain'
    off = off or is_off(chosen.ordinary.values(), motions)
    anywhere = off or is_off(chosen.furthest.values(), motions)
    if is_noise(chosen.residuals) and is_noise(whole) and not anywhere:
        return ('Trust it for motions like those of its data and for those that go further: '
                f'along whole motions {noise_text(whole)}; {beyond}.')
    along = f' Along whole motions {noise_text(whole, anywhere)}.' if whole else ''
    errors = (f'RMS error {_line(chosen.ordinary, config)}; for motions that go further: '
              f'{_line(chosen.furthest, config)}; {beyond}.{along}')
    return ('Do not trust it: its simulations leave the measured motions. ' if off else
            'Trust it for motions like those of its data: ') + errors
