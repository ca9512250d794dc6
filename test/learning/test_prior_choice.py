# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Models of machines that are chosen by what goes furthest, and what they have seen."""

from dataclasses import replace
from functools import cache
import re

from helpers import alarm_of
from hnn_vi_ros.learning.data.motions import EvenMotion, smoothed
from hnn_vi_ros.learning.families.choices import AUTO, Structure
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.learning.fit.fitted_rigid_body import FittedRigidBody
from hnn_vi_ros.learning.fit.loop import Fitted
from hnn_vi_ros.learning.fit.machine import Fading
from hnn_vi_ros.learning.fit.machine_fit import fit_machine
from hnn_vi_ros.learning.judging.residuals import errors_text, is_noise, is_off
from hnn_vi_ros.learning.tasks.selection import (
    _is_explained, _Trials, best_of, Candidate, held_out, OF_VELOCITIES, RIGID, selected,
    trust_text)
from hnn_vi_ros.models.domain import CandidateCard, Domain, DomainCard, SelectionCard
from hnn_vi_ros.models.planar_chain import chain_angles, chain_terms
from hnn_vi_ros.simulation.guards.bounds import BoxGuard
from hnn_vi_ros.simulation.guards.samples import GuardState
from machines import carriage, double_well, kinked_spring, machine_config, sliding
import numpy as np
import pytest
from scipy.integrate import solve_ivp
import torch

CART, POLE, LENGTH, GRAVITY, VISCOUS = 1.3, 0.4, 0.6, 9.81, 0.2


@cache
def cart_and_pole(seed: int) -> EvenMotion:
    """Return a cart with a pole that is driven, by (x, angle from hanging), every 10 ms."""
    t = 0.01 * np.arange(600)
    force = np.interp(np.arange(600), np.arange(0, 600, 20),
                      np.random.default_rng(seed).normal(size=30) * 4.0)

    def rates(time: float, z: np.ndarray) -> list[float]:
        (_, angle), v = np.split(z, 2)
        mixed = POLE * LENGTH * np.cos(angle)
        mass = np.array([[CART + POLE, mixed], [mixed, POLE * LENGTH**2]])
        forces = np.array([np.interp(time, t, force) - VISCOUS * v[0]
                           + POLE * LENGTH * np.sin(angle) * v[1]**2,
                           -POLE * GRAVITY * LENGTH * np.sin(angle)])
        return [*v, *np.linalg.solve(mass, forces)]
    z = solve_ivp(rates, (0.0, t[-1]), np.zeros(4), t_eval=t, rtol=1e-9, atol=1e-9).y.T
    return smoothed(f'run{seed}', t, z[:, :2], z[:, 2:], np.stack([force, 0.0 * t], axis=1), 40.0)


def test_chain_has_the_mass_matrix_of_its_links():
    """A cart, and two links by the angles of their joints: M of their points, J^T J."""
    (_, angles) = chain_angles(['prismatic', 'revolute', 'continuous'])
    lengths, masses, cart = np.array([0.5, 0.3]), np.array([0.7, 0.2]), 1.1
    moments = lengths * np.array([masses.sum(), masses[1]])
    terms = chain_terms(angles, {
        'inertia1': cart + masses.sum(), 'inertia2': lengths[0] * moments[0],
        'inertia3': lengths[1] * moments[1], 'coupling12': moments[0], 'coupling13': moments[1],
        'coupling23': lengths[0] * moments[1], 'gravity1': 0.3, 'gravity2': 1.0, 'gravity3': 2.0})
    q = np.array([0.4, 0.9, -1.7])
    mass = (np.cos(terms.mass_rows @ q)[:, None, None] * terms.matrices).sum(axis=0)
    expected = cart * np.outer(*2 * [np.array([1.0, 0.0, 0.0])])
    phi = np.array([q[1], q[1] + q[2]])
    J = np.zeros((2, 3))
    J[0, 0] = 1.0
    for link in (0, 1):
        # Angles of both joints turn the second link.
        J[:, 1:2 + link] += lengths[link] * np.array([[np.cos(phi[link])], [np.sin(phi[link])]])
        expected += masses[link] * J.T @ J
    assert mass == pytest.approx(expected, rel=1e-14)
    assert (terms.pull @ q, terms.weights[1:].tolist()) == (pytest.approx(0.12), [1.0, 2.0])


def test_what_goes_furthest_is_held_out():
    motions = [cart_and_pole(seed) for seed in (1, 2, 3)]
    kept, furthest, ordinary = held_out(motions)
    speed = [max(np.abs(run.v_smooth[:, 1]).max() for run in runs) for runs in (kept, furthest)]
    assert speed[1] > 1.05 * speed[0]
    total = sum(len(run.t) for run in motions)
    assert [sum(len(run.t) for run in runs) / total > 0.08 for runs in (furthest, ordinary)] == [
        True, True]
    assert sum(len(run.t) for run in (*kept, *furthest, *ordinary)) == total


def test_of_several_runs_whole_ones_are_held_out():
    motions = [cart_and_pole(seed) for seed in (1, 2, 3, 4)]
    kept, furthest, ordinary = held_out(motions)
    far, others = {run.name for run in furthest}, {run.name for run in (*kept, *ordinary)}
    assert 1 <= len(far) <= 2 and not far & others
    assert far | others == {run.name for run in motions}
    speeds = {run.name: float(np.abs(run.v_smooth).max()) for run in motions}
    assert max(speeds, key=speeds.__getitem__) in far


@pytest.mark.parametrize(('ordinary', 'furthest', 'chosen'), [
    (0.98, 0.9, RIGID), (0.8, 0.98, 'other'), (0.7, 1.01, 'other'), (0.5, 1.03, RIGID),
    (1.01, 0.7, 'other'), (1.03, 0.5, RIGID)])
def test_networks_must_gain_and_be_no_worse_near_and_far_away(
        ordinary: float, furthest: float, chosen: str):
    config = machine_config()
    rigid, other = (Candidate(config, None, Fitted(None, {}), CandidateCard(
        name=name, ordinary={'0.1': [0.01 * near]}, furthest={'0.1': [0.02 * far]}))
        for name, near, far in ((RIGID, 1.0, 1.0), ('other', ordinary, furthest)))
    assert best_of(rigid, [other]).card.name == chosen
    assert best_of(rigid._replace(fitted=None), [other]) is other


def test_networks_do_not_fade_at_the_few_samples_of_fast_motions():
    """A turn within 30 of 30000 samples is seen in all its angles."""
    t = 0.01 * np.arange(30000)
    angle = np.interp(t, [250.0, 250.3], [0.1, 4.0])[:, None] + 0.1 * np.sin(t)[:, None]
    run = smoothed('turn', t, angle, np.gradient(angle, t, axis=0), 0.0 * angle, 40.0)
    structure = Structure(['continuous'], [[1.0]], [[1.0]], prior='planar_chain', angles=[[1.0]])
    fading = Fading(structure, [run], 0.0, 1.0)
    weights = fading.weights(torch.tensor([[0.0], [1.0], [2.0], [3.0], [-1.1]]))
    assert (weights[:4] < 0.1).all() and weights[4] > 0.7


def test_auto_takes_the_rigid_body_of_a_machine_that_is_one():
    config = MachineConfig.model_validate({
        'coordinates': [{'name': 'x', 'kind': 'prismatic'},
                        {'name': 'angle', 'kind': 'continuous'}],
        'data': {'kind': 'arrays'}, 'hidden': [8], 'loss': {
            'kind': 'trajectory', 'forward_steps': 40, 'forward_lbfgs_steps': 0, 'batch': 64,
            'windows': [{'duration': 0.1, 'steps': 40}]},
        'family': {'kind': 'mechanical', 'friction': {'coulomb': 0}}})
    chosen, card = selected(config, [cart_and_pole(seed) for seed in (1, 2)])
    first, *_, alone = card.candidates
    assert first.name == RIGID and chosen.family.prior is not None
    assert all(own < other for horizon, errors in first.furthest.items()
               for own, other in zip(errors, alone.furthest[horizon], strict=True))
    assert f'**{card.chosen}**' in card.text
    assert 'Trust it for motions like' in trust_text(
        card, chosen, {}, [cart_and_pole(1)], False)
    prior = fit_machine(chosen, [cart_and_pole(1)]).module.card().prior
    # The midpoint rule at 10 ms is off by (0.01 omega)^2 / 12, the filter by less than 1 %.
    assert [prior.values[name] for name in ('inertia1', 'inertia2', 'coupling12', 'gravity2')] == (
        pytest.approx([CART + POLE, POLE * LENGTH**2, POLE * LENGTH, POLE * GRAVITY * LENGTH],
                      rel=0.02))


@pytest.mark.long
@pytest.mark.parametrize(('back', 'directed'), [(2.5, True), (1.0, False)])
def test_friction_has_the_terms_that_held_out_motions_need(back: float, directed: bool):
    motions = [carriage(seed, back) for seed in (1, 2, 3)]
    chosen, card = selected(sliding(), motions)
    assert chosen.family.friction.directed is directed
    assert ('friction with' in card.held_out) is directed
    assert card.candidates[0].name == RIGID
    assert any('plain' in one.name for one in card.candidates) is directed


def test_springs_are_added_where_held_out_motions_need_them():
    motions = [carriage(seed, 1.0, 60.0, 0.1) for seed in (1, 2, 3)]
    chosen, card = selected(sliding(friction={'coulomb': 1}), motions)
    assert chosen.family.springs
    assert any('without springs' in one.name for one in card.candidates)
    prior = fit_machine(chosen, motions).module.card().prior
    # Noise of 0.2 mm, smoothed at 40 Hz, is 0.2 % of the motion.
    assert [prior.values[name] for name in ('inertia1', 'stiffness1', 'gravity1')] == (
        pytest.approx([2.0, 60.0, -6.0], rel=0.02))
    chosen, card = selected(sliding(friction={'coulomb': 1}), [
        carriage(seed, 1.0) for seed in (1, 2, 3)])
    assert not chosen.family.springs


@pytest.mark.parametrize('off', [0.0, 0.05])
def test_sensor_is_off_by_a_number_where_gravity_shows_it(off: float):
    t = 0.02 * np.arange(700)

    def rates(time: float, z: np.ndarray) -> list[float]:
        return [z[1], np.sin(1.7 * time) - 9.0 * np.sin(z[0]) - 0.05 * z[1]]
    q = solve_ivp(rates, (0.0, t[-1]), [1.0, 0.0], t_eval=t, rtol=1e-8, atol=1e-8).y[0][:, None]
    q += off + 2e-3 * np.random.default_rng(4).normal(size=q.shape)
    motion = smoothed('run', t, q, None, np.sin(1.7 * t)[:, None], 10.0)
    config = machine_config('a', 'revolute', {'hidden': [4], 'loss': {
        'kind': 'trajectory', 'forward_steps': 2, 'forward_lbfgs_steps': 0, 'batch': 16,
        'windows': [{'duration': 0.3, 'steps': 2}]}}, prior=AUTO, friction={'coulomb': 1})
    chosen, _ = selected(config, [motion])
    assert chosen.family.sensor_offsets is (off != 0.0) and not chosen.family.springs
    fitted = fit_machine(chosen, [replace(motion, inputs=chosen.data.inputs or 'linear')])
    assert isinstance(fitted, FittedRigidBody)
    numbers = fitted.estimates(chosen.coordinates, None)
    assert ('sensor_offset1' in numbers) is (off != 0.0)
    # Three standard deviations.
    for name, truth in {'gravity1': 9.0, 'inertia1': 1.0, 'sensor_offset1': off}.items():
        if name in numbers:
            low, high = numbers[name].interval
            assert abs(numbers[name].value - truth) < 1.5 * 0.5 * (high - low)
            assert high - low < 0.02 * (truth if truth > 1.0 else 1.0)


@pytest.mark.long
def test_spring_with_a_kink_is_a_spline_of_its_force():
    """Powers up to the fifth leave residuals of many times the noise."""
    chosen, card = selected(sliding(), [kinked_spring(0.3), kinked_spring(-0.25)])
    assert card.chosen == RIGID and chosen.family.springs == 1 and chosen.family.spring_knots
    assert is_noise(card.candidates[0].residuals)


@pytest.mark.long
def test_double_well_is_chosen_as_a_rigid_body_with_a_spring_and_no_delay():
    """Late forces of another course fitted better than without a spring."""
    chosen, card = selected(sliding(), [double_well()])
    assert card.chosen == RIGID and not chosen.data.delay and chosen.family.springs == 5
    # What is missing goes with the position, so springs are tried before other forces.
    assert f'{RIGID} without springs' in [one.name for one in card.candidates]


@pytest.mark.parametrize('magnet', [0.0, 12.0])
def test_rigid_body_is_enough_unless_accelerations_show_a_force(magnet: float, capsys):
    """In short pieces, friction and initial states make up for the force of a magnet."""
    t = 0.01 * np.arange(2400)

    def rates(time: float, z: np.ndarray) -> list[float]:
        bump = magnet * np.exp(-(z[0] / 0.3)**2)
        return [z[1], (bump - 9.0) * np.sin(z[0]) - 0.05 * z[1]]
    q = solve_ivp(rates, (0.0, t[-1]), [1.4, 0.0], t_eval=t, rtol=1e-8, atol=1e-8).y[0][:, None]
    q += 3e-3 * np.random.default_rng(1).normal(size=q.shape)
    config = machine_config('a', 'revolute', {'hidden': [4], 'loss': {
        'kind': 'trajectory', 'forward_steps': 2, 'forward_lbfgs_steps': 0, 'batch': 16,
        'windows': [{'duration': 0.3, 'steps': 2}]}}, prior=AUTO, friction={'coulomb': 1})
    selected(config, [smoothed('run', t, q, None, 0.0 * q, 5.0)])
    said = capsys.readouterr().out
    # The force of the magnet depends on the position alone, and a spline fits it.
    assert 'nothing more is tried' in said
    assert ('with a spring of straight pieces' in said) is (magnet != 0.0)


def test_runs_of_two_machines_are_named_and_end_the_search(capsys):
    t = 0.01 * np.arange(1200)

    def run(name: str, gravity: float) -> EvenMotion:
        q = solve_ivp(lambda _, z: [z[1], -gravity * np.sin(z[0]) - 0.05 * z[1]], (0.0, t[-1]),
                      [1.2, 0.0], t_eval=t, rtol=1e-8, atol=1e-8).y[0][:, None]
        q += 2e-3 * np.random.default_rng(1).normal(size=q.shape)
        return smoothed(name, t, q, None, 0.0 * q, 5.0)
    config = machine_config('a', 'revolute', prior=AUTO)
    _, card = selected(config, [run('long', 12.0), run('short', 20.0)])
    said = capsys.readouterr().out
    (found,) = re.findall(r'explains each run alone, but not together: gravity1 is (.*) in long '
                          'and (.*) in short;', said)
    # Within a percent, which is many times their intervals.
    assert [*map(float, found)] == pytest.approx([12.0, 20.0], rel=0.01)
    assert found[0] in card.held_out and 'nothing more is tried' in said and 'network' not in said


def test_velocities_that_a_filter_delays_are_left_out():
    """A filter of first order, as in a motor driver."""
    t = 0.02 * np.arange(1000)

    def rates(time: float, z: np.ndarray) -> list[float]:
        return [z[1], np.sin(1.7 * time) - 9.0 * np.sin(z[0]) - 0.05 * z[1]]
    q, v = solve_ivp(rates, (0.0, t[-1]), [1.4, 0.0], t_eval=t, rtol=1e-8, atol=1e-8).y[..., None]
    for k in range(1, len(v)):
        v[k] = v[k - 1] + 0.02 / (0.02 + 0.15) * (v[k] - v[k - 1])
    noise = np.random.default_rng(1).normal(size=(2, *q.shape))
    motion = smoothed('run', t, q + 0.02 * noise[0], v + 2e-3 * noise[1],
                      np.sin(1.7 * t)[:, None], 40.0)
    config = machine_config('a', 'revolute', {'hidden': [4], 'loss': {
        'kind': 'trajectory', 'forward_steps': 2, 'forward_lbfgs_steps': 0, 'batch': 16,
        'windows': [{'duration': 0.3, 'steps': 2}]}}, prior=AUTO, friction={'coulomb': 1})
    chosen, card = selected(config, [motion])
    assert chosen.data.velocities == 'none' and 'from positions alone' in card.held_out
    right, wrong, *_ = card.candidates
    # The noise of the positions is a part of the errors.
    assert right.furthest['0.2'][0] < 1.2 * 0.02 and wrong.furthest['0.2'][0] > 5.0 * 0.02
    assert (right.name, wrong.name) == (RIGID, OF_VELOCITIES)


@pytest.mark.long
def test_friction_that_is_named_is_left_as_it_is():
    motions = [carriage(seed, 2.5) for seed in (1, 2, 3)]
    chosen, card = selected(sliding(friction={'coulomb': 1}), motions)
    assert not chosen.family.friction.directed
    assert not any('friction' in one.name for one in card.candidates)


def test_motions_too_short_to_choose_by_train_networks_alone(capsys):
    whole = carriage(1, 1.0)
    short = smoothed(
        'short', whole.t[:60], whole.q[:60], whole.v_smooth[:60], whole.tau[:60], 40.0)
    chosen, card = selected(sliding(), [short])
    assert card is None and chosen.family.prior is None
    assert '1 motions are too short for a selection' in capsys.readouterr().out


def test_windows_last_as_many_steps_however_rare_samples_are():
    rare = carriage(1, 1.0)
    rare = smoothed('rare', rare.t[::5], rare.q[::5], rare.v_smooth[::5], rare.tau[::5], 10.0)
    config = sliding(prior='none', friction={})
    free = config.model_copy(update={'loss': None})
    for given, durations in ((free, [0.5, 1.25]), (config, [0.3])):
        chosen, _ = selected(given, [rare])
        assert [stage.duration for stage in chosen.windows.windows] == pytest.approx(durations)


def test_domain_says_what_goes_beyond():
    q, v = np.array([[-0.5, 0.0], [0.5, 1.0]]), np.array([[-2.0, -15.0], [2.0, 15.0]])
    domain = Domain(DomainCard.of(q, v, np.array([[-1.0], [1.0]])), ['continuous', 'revolute'], [
        ('shoulder', 'rad', 'N m s'), ('elbow', 'rad', 'N m s')])
    inside = np.array([[2.0 * np.pi + 0.4, 0.5]]), np.array([[0.0, 3.0]])
    assert not domain.excess(*inside, np.array([[0.5]])).any()
    beyond = domain.beyond(inside[0], np.array([[0.0, 30.0]]), np.array([[1.5]]))
    assert beyond == ['elbow = 30 rad/s, trained to 15', 'force 1 = 1.5 N m, trained to 1']
    slide = Domain(DomainCard.of(q[:, :1], v[:, :1], np.array([[-1.0], [1.0]])), ['prismatic'], [
        ('slide', 'm', 'kg m/s')])
    assert slide.beyond(q[:1, :1], v[:1, :1], np.array([[3.0]])) == ['force 1 = 3 N, trained to 1']
    guard = BoxGuard((q.T, v.T), None, domain)

    def look(step: int, velocity: float) -> GuardState:
        return GuardState(step, inside[0][0], np.zeros(2), np.zeros(2), np.array([0.0, velocity]),
                          0.0, 0.0)
    # Within the error of velocities.
    assert alarm_of(guard, look(0, 15.1)) is None
    alarm = alarm_of(guard, look(1, 30.0))
    assert '(largest: elbow = 30 rad/s, trained to 15), in 50 % of the samples' in alarm.message
    assert alarm_of(guard, look(2, 31.0)) is None and guard.share == pytest.approx(2 / 3)


def test_trust_follows_from_residuals_along_whole_motions():
    config, noise, motions = machine_config(), {'0.3': [0.95]}, [carriage(1, 1.0)]
    card = SelectionCard(held_out='', chosen=RIGID, candidates=[CandidateCard(
        name=RIGID, residuals=noise, furthest={'0.1': [2e-4]}, ordinary={'0.1': [1e-4]})])
    assert 'its own error is below the noise' in trust_text(card, config, noise, motions, False)
    # Pieces of motions may be shorter than what shows an error.
    for whole in ({'0.3': [0.95], '3': [1.6]}, {'0.3': [13.0]}):
        text = trust_text(card, config, whole, motions, False)
        assert 'below the noise' not in text and 'go further: 0.0002' in text
        assert f'{max(max(row) for row in whole.values()):.2g} times the noise' in text


@pytest.mark.parametrize('near, far, final', [
    (9.43e19, 9.43e19, False), (None, 1e-4, False), (1e-4, 1e-4, True), (1e-4, None, False)])
def test_model_whose_simulations_leave_the_motions_is_not_trusted(near, far, final: bool):
    """Fits of initial states come through with stiff friction that explodes in other steps."""
    config, noise, motions = machine_config(), {'0.3': [0.95], '2': [1.02]}, [carriage(1, 1.0)]
    card = SelectionCard(held_out='', chosen=RIGID, candidates=[CandidateCard(
        name=RIGID, residuals=noise, furthest={'0.1': [far]}, ordinary={'0.1': [near]})])
    for error in (near, far):
        assert is_off([[1e-4], [error]], motions) is (error != 1e-4)
    text = trust_text(card, config, noise, motions, final)
    assert 'below the noise' not in text and 'and for those that go further' not in text
    assert text.startswith('Do not trust it') is (near != 1e-4 or final)
    said = errors_text(noise, np.array([1e-3]), config.coordinates, True)
    assert 'leave the motions' in said and 'below the noise' not in said


def test_rigid_body_whose_simulations_leave_the_motions_explains_nothing():
    run, config = carriage(1, 1.0), sliding(prior='planar_chain', residual=False)
    fitted = fit_machine(config, [run])
    assert isinstance(fitted, FittedRigidBody)
    trials = _Trials.cut([run], [run])._replace(furthest=[run], ordinary=[run])
    for error, explained in ((1e-4, True), (1e19, False)):
        card = CandidateCard(name=RIGID, residuals={'2': [1.0]}, furthest={'0.1': [1e-4]},
                             ordinary={'0.1': [error]})
        assert _is_explained(Candidate(config, trials, fitted, card)) is explained
