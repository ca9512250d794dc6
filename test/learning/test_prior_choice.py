# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Models of machines that are chosen by what goes furthest, and what they have seen."""

from dataclasses import replace
from functools import cache
import math
from pathlib import Path

from helpers import alarm_of
from hnn_vi_ros.learning.data.motions import EvenMotion, of_positions, smoothed
from hnn_vi_ros.learning.families.choices import AUTO, Structure
from hnn_vi_ros.learning.fit import rigid_body
from hnn_vi_ros.learning.fit.config import guess_config, MachineConfig
from hnn_vi_ros.learning.fit.fitted_rigid_body import covariance_of, rounding_of
from hnn_vi_ros.learning.fit.following import LogSimulation
from hnn_vi_ros.learning.fit.loop import Fitted
from hnn_vi_ros.learning.fit.machine import Fading
from hnn_vi_ros.learning.fit.machine_fit import fit_machine
from hnn_vi_ros.learning.fit.prediction import Prediction
from hnn_vi_ros.learning.tasks import selection
from hnn_vi_ros.learning.tasks.machine import as_selected, MACHINE
from hnn_vi_ros.learning.tasks.selection import (
    best_of, Candidate, held_out, OF_VELOCITIES, RIGID, selected, trust_text)
from hnn_vi_ros.models.domain import CandidateCard, Domain, DomainCard, SelectionCard
from hnn_vi_ros.models.planar_chain import chain_angles, chain_terms
from hnn_vi_ros.simulation.guards.bounds import BoxGuard
from hnn_vi_ros.simulation.guards.samples import GuardState
from machines import machine_config
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
    chosen, card = selected(config, [cart_and_pole(seed) for seed in (1, 2, 3)])
    first, *_, alone = card.candidates
    assert first.name == RIGID and chosen.family.prior is not None
    assert all(own < other for horizon, errors in first.furthest.items()
               for own, other in zip(errors, alone.furthest[horizon], strict=True))
    assert f'**{card.chosen}**' in card.text
    assert 'Trust it for motions like' in trust_text(card, chosen, {})
    prior = fit_machine(chosen, [cart_and_pole(1)]).module.card().prior
    # The midpoint rule at 10 ms is off by (0.01 omega)^2 / 12, the filter by less than 1 %.
    assert [prior.values[name] for name in ('inertia1', 'inertia2', 'coupling12', 'gravity2')] == (
        pytest.approx([CART + POLE, POLE * LENGTH**2, POLE * LENGTH, POLE * GRAVITY * LENGTH],
                      rel=0.02))


@cache
def carriage(seed: int, back: float, stiffness: float = 0.0, rest: float = 0.0) -> EvenMotion:
    """Return a carriage of 2 kg, whose friction is 1 N ahead, and another back, every 10 ms."""
    t = 0.01 * np.arange(500)
    rng = np.random.default_rng(seed)
    force = 3.0 * np.sin(t[:, None] * rng.uniform(1.0, 4.0, 3) + rng.uniform(0.0, 6.0, 3)).sum(1)

    def rates(time: float, z: np.ndarray) -> list[float]:
        side = np.tanh(z[1] / 0.05)
        return [z[1], 0.5 * (np.interp(time, t, force) - 0.5 * z[1] - stiffness * (z[0] - rest)
                             - (0.5 * (1.0 + side) + 0.5 * (1.0 - side) * back) * side)]
    z = solve_ivp(rates, (0.0, t[-1]), np.zeros(2), t_eval=t, rtol=1e-8, atol=1e-8).y.T
    noise = rng.normal(size=z.shape) * [2e-4, 2e-3]
    return smoothed(f'run{seed}', t, *np.hsplit(z + noise, 2), force[:, None], 40.0)


def sliding(**family: object) -> MachineConfig:
    return machine_config('x', 'prismatic', {'hidden': [4], 'loss': {
        'kind': 'trajectory', 'forward_steps': 2, 'forward_lbfgs_steps': 0, 'batch': 16,
        'windows': [{'duration': 0.3, 'steps': 2}]}}, **{'prior': AUTO, **family})


@pytest.mark.long
@pytest.mark.parametrize(('back', 'directed'), [(2.5, True), (1.0, False)])
def test_friction_has_the_terms_that_held_out_motions_need(back: float, directed: bool):
    motions = [carriage(seed, back) for seed in (1, 2, 3)]
    chosen, card = selected(sliding(), motions)
    assert chosen.family.friction.directed is directed
    assert ('friction with' in card.held_out) is directed
    assert card.candidates[0].name == RIGID
    assert any('plain' in one.name for one in card.candidates) is directed


def test_more_friction_never_fits_windows_worse_than_less(monkeypatch):
    """Accelerations gave a start at which windows diverged, or ended at a local minimum."""
    first = rigid_body._first

    def diverging(physical, samples):
        numbers, loss = first(physical, samples)
        more = physical.network.friction.choice.directed
        return (np.nan * numbers if more else numbers), loss
    monkeypatch.setattr(rigid_body, '_first', diverging)
    errors = [[*fit_machine(sliding(prior='planar_chain', residual=False, friction=friction),
                            [carriage(1, 2.5)]).losses.values()][-1]
              for friction in ({}, {'directed': True, 'offset': True, 'load': True})]
    # Its friction is 2.5 N back and 1 N ahead.
    assert errors[1] < 0.5 * errors[0]


def test_fit_of_a_weight_and_an_offset_that_are_one_force_is_not_lost_in_rounding():
    """Their columns are the same: what they have in common was 1e13 N, with rounding of 1 mN."""
    problem = fit_machine(sliding(prior='planar_chain', residual=False, friction={
        'offset': True, 'directed': True}), [carriage(1, 1.0)])
    card = problem.module.card()
    assert abs(card.friction.offset[0]) < 1e3
    assert card.prior.values['inertia1'] == pytest.approx(2.0, rel=0.05)


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


@cache
def double_well() -> EvenMotion:
    """Return a driven mass of 0.5 kg, V = -6 q^2 + 225 q^4, by its positions every 10 ms."""
    t = 0.01 * np.arange(1000)
    force = (0.8 * np.sin(t[:, None] * [2.1, 5.3, 8.0] + [0.3, 1.0, 2.0])).sum(1)
    z = solve_ivp(lambda time, z: [z[1], 2.0 * (
        np.interp(time, t, force) - 0.35 * z[1] + 12.0 * z[0] - 900.0 * z[0]**3)], (0.0, t[-1]),
        np.array([0.12, 0.0]), t_eval=t, rtol=1e-9, atol=1e-11).y.T
    q = z[:, :1] + 3e-4 * np.random.default_rng(5).normal(size=(len(t), 1))
    return smoothed('well', t, q, None, force[:, None], 40.0)


def test_delay_at_the_end_of_its_search_is_no_evidence():
    forces = selection._Forces('linear', 0.0)
    for sign in (1.0, -1.0):
        assert selection._best_delay(lambda one: 9.0 - sign * one.delay, forces) == forces
    found = selection._best_delay(lambda one: 1.0 + (one.delay - 3.3)**2, forces)
    assert found.delay == pytest.approx(3.3, abs=0.1)


@pytest.mark.long
def test_double_well_is_chosen_as_a_rigid_body_with_a_spring_and_no_delay():
    """Late forces of another course fitted better than without a spring."""
    chosen, card = selected(sliding(), [double_well()])
    assert card.chosen == RIGID and not chosen.data.delay and chosen.family.springs == 5


def test_double_well_has_a_cubic_spring():
    chosen = sliding(prior='planar_chain', residual=False, springs=5)
    found = fit_machine(chosen, [double_well()]).estimates(sliding().coordinates, None)
    assert {'inertia1', 'stiffness1', 'spring3_1', 'viscous friction of x'} <= {*found}
    assert not [name for name in found if 'dry' in name or name.startswith(('spring2', 'spring5'))]
    for name, truth in (('inertia1', 0.5), ('stiffness1', -12.0), ('spring3_1', 900.0)):
        low, high = found[name].interval
        # Four standard errors.
        assert abs(found[name].value - truth) < 2.0 * (high - low) / 1.96


@pytest.mark.parametrize('stiffness', [0.0, 60.0])
def test_springs_that_positions_do_not_show_are_left_out(stiffness: float):
    motions = of_positions([carriage(seed, 1.0, stiffness) for seed in (1, 2)])
    config = sliding(prior='planar_chain', residual=False, springs=True)
    prior = fit_machine(config, motions).module.card().prior
    assert (prior.values['stiffness1'] == 0.0) is (stiffness == 0.0)


def test_width_of_friction_is_a_number_of_the_fit():
    """Fixed widths gave residuals of 5.8 times the noise, and numbers outside their intervals."""
    motions = of_positions([carriage(seed, 1.0) for seed in (1, 2)])
    rigid = fit_machine(sliding(prior='planar_chain', residual=False), motions)
    found = rigid.estimates(sliding().coordinates, None)
    for name, truth in (('inertia1', 2.0), ('viscous friction of x', 0.5),
                        ('dry friction of x', 1.0), ('width of dry friction of x', 0.05)):
        low, high = found[name].interval
        assert low < truth < high
    assert not [name for name in found if name.startswith('dry friction ') and name[-1] != 'x']


@pytest.fixture(scope='module')
def rounded():
    run = of_positions([carriage(1, 1.0)])[0]
    return fit_machine(sliding(prior='planar_chain', residual=False), [replace(
        run, tau=0.05 * np.rint(run.tau / 0.05))])


def test_prediction_is_differentiated_by_the_force_of_each_sample(rounded):
    solution, model = rounded.numbers.solution, rounded.numbers.problem.model
    weights = np.random.default_rng(0).normal(size=(*solution.residuals.shape, 2))
    found = Prediction(model, solution.values, solution.windows).by_forces(
        solution.starts, weights)[0, :, 0]
    motion, = solution.windows.motions
    for sample in (0, 3, 250, 498):
        sums = []
        for change in (1e-4, -1e-4):
            tau = motion.tau + change * (np.arange(len(motion.tau)) == sample)[:, None]
            log = LogSimulation(model.parts_at(solution.values), replace(
                solution.windows, motions=[replace(motion, tau=tau)]))
            sums.append((weights * log.predict(solution.starts)[..., None]).sum(axis=(0, 1, 2)))
        # Differences of 2e-4 N have errors of 1e-8 by bends, and of 1e-9 by the solver.
        assert found[sample] == pytest.approx((sums[0] - sums[1]) / 2e-4, rel=1e-4, abs=1e-7)


def test_intervals_contain_the_rounding_of_forces(rounded):
    numbers, (motion,) = rounded.numbers, rounded.numbers.solution.windows.motions
    # Steps have the means of two forces, whose common step is half of theirs.
    assert rounding_of(motion.tau) == pytest.approx([0.025 / math.sqrt(12.0)])
    exact = replace(motion, tau=motion.tau + 1e-7 * np.random.default_rng(0).normal(
        size=motion.tau.shape))
    alone = covariance_of(numbers._replace(fits=[(length, replace(
        solution, windows=replace(solution.windows, motions=[exact])), problem)
        for length, solution, problem in numbers.fits]))
    assert (np.diag(covariance_of(numbers)) > 1.05 * np.diag(alone)).all()
    for name, truth in (('inertia1', 2.0), ('viscous friction of x', 0.5),
                        ('dry friction of x', 1.0)):
        # Four standard errors.
        value, high = (number := rounded.estimates(sliding().coordinates, None)[name]
                       ).value, number.interval[1]
        assert abs(value - truth) < 4.0 * (high - value) / 1.96


@pytest.mark.parametrize(('column', 'rounding'), [
    (np.round(np.sin(np.arange(500.0)), 3), 1e-3), (np.sin(np.arange(500.0)), 0.0),
    (0.00981 * np.round(1e3 * np.sin(np.arange(500.0))), 0.00981),
    # Levels of a command, which are exact.
    (np.arange(500.0) % 7.0, 0.0), (np.zeros(500), 0.0)])
def test_rounding_of_a_column_is_that_of_its_common_step(column: np.ndarray, rounding: float):
    assert rounding_of(column[:, None]) == pytest.approx([rounding / math.sqrt(12.0)])


def test_weight_that_positions_do_not_show_is_left_out(rounded):
    assert 'gravity1' not in rounded.estimates(sliding().coordinates, None)


def test_intervals_are_wider_where_residuals_exceed_the_noise():
    rigid = fit_machine(sliding(prior='planar_chain', residual=False),
                        of_positions([carriage(1, 1.0)]))
    (length, _), = stages = rigid.numbers.stages[-1:]
    sizes = [np.ptp(replace(rigid, numbers=rigid.numbers._replace(
        stages=[(length, excess)])).estimates(sliding().coordinates, None)['inertia1'].interval)
        for excess in (1.0, 3.0)]
    assert stages and sizes[1] == pytest.approx(3.0 * sizes[0], rel=1e-9)


def test_width_that_a_log_does_not_tell_is_a_usual_one():
    """Dry friction as wide as all speeds made viscous friction four times as uncertain."""
    t = 0.05 * np.arange(480)
    z = solve_ivp(lambda time, z: [z[1], -9.81 * np.sin(z[0]) - 0.05 * z[1] - 0.02 * np.tanh(
        100.0 * z[1])], (0.0, t[-1]), [0.9, 0.0], t_eval=t, rtol=1e-9, atol=1e-9).y.T
    q = z[:, :1] + 5e-3 * np.random.default_rng(0).normal(size=(len(t), 1))
    config = machine_config('a', prior='planar_chain', residual=False)
    rigid = fit_machine(config, [smoothed('swing', t, q, None, 0.0 * q, 8.0)])
    found = rigid.estimates(config.coordinates, q)
    assert not [name for name in found if 'width' in name]
    for name, truth in (('viscous friction of a', 0.05), ('dry friction of a', 0.02)):
        # Four standard errors.
        value, high = found[name].value, found[name].interval[1]
        assert abs(value - truth) < 4.0 * (high - value) / 1.96 < 0.02


def test_steps_are_as_small_as_sharp_friction_needs():
    """A carriage that reverses within a step: the numbers of coarse steps were 9 errors off."""
    t, rng = 0.01 * np.arange(800), np.random.default_rng(4)
    force = (2.5 * np.sin(t[:, None] * [2.1, 3.7, 5.3] + [0.3, 1.0, 2.0])).sum(1)
    z, found = np.zeros(2), []
    for value in force:
        found.append(z[0])
        for _ in range(100):  # 0.1 ms: a tenth of the time in which friction changes its sign
            middle = z + 5e-5 * np.array([z[1], 0.5 * (
                value - 0.5 * z[1] - np.tanh(z[1] / 0.002))])
            z = z + 1e-4 * np.array([middle[1], 0.5 * (
                value - 0.5 * middle[1] - np.tanh(middle[1] / 0.002))])
    q = np.array(found)[:, None] + 1e-4 * rng.normal(size=(len(t), 1))
    run = replace(smoothed('sharp', t, q, None, force[:, None], 40.0), inputs='held')
    rigid = fit_machine(sliding(prior='planar_chain', residual=False), [run])
    assert rigid.numbers.problem.model.step_size < 0.006
    assert rigid.numbers.stages[-1][1] < 1.1
    found = rigid.estimates(sliding().coordinates, None)
    for name, truth in (('inertia1', 2.0), ('viscous friction of x', 0.5),
                        ('dry friction of x', 1.0), ('width of dry friction of x', 0.002)):
        # Four standard errors.
        value, high = found[name].value, found[name].interval[1]
        assert abs(value - truth) < 4.0 * (high - value) / 1.96


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
    assert ('nothing more is tried' in capsys.readouterr().out) is (magnet == 0.0)


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


@pytest.mark.parametrize('delay', [0.0, 2.0])
def test_smooth_forces_at_rare_samples_bias_no_number(delay: float):
    """
    Chords of a force of 2.6 Hz at 20 Hz are too small by (2 pi f h)^2 / 12, 5 %.

    With a wrong delay the fit has wrong friction, and with that another delay fits it best.
    """
    times, noise, truth = 0.05 * np.arange(400), 2e-3, [0.25, 4.0]

    def force(t: np.ndarray | float) -> np.ndarray:
        return sum(size * np.sin(2.0 * np.pi * f * t) for size, f in (
            (1.0, 0.7), (1.5, 1.9), (1.2, 2.6)))

    def rates(t: float, z: np.ndarray) -> list[float]:
        return [z[1], (force(t) - truth[1] * np.sin(z[0]) - 0.08 * z[1]) / truth[0]]
    q = solve_ivp(rates, (0.0, times[-1]), [0.3, 0.0], t_eval=times, rtol=1e-9, atol=1e-9).y[:1].T
    q += noise * np.random.default_rng(1).normal(size=q.shape)
    config = machine_config('a', 'revolute', {'hidden': [4], 'loss': {
        'kind': 'trajectory', 'forward_steps': 2, 'forward_lbfgs_steps': 0, 'batch': 16,
        'windows': [{'duration': 0.3, 'steps': 2}]}}, prior=AUTO, friction={'coulomb': 1})
    motions = [smoothed('run', times, q, None, force(times + 0.05 * delay)[:, None], 8.0)]
    chosen, card = selected(config, motions)
    assert chosen.data.inputs == 'spline' and 'between samples as spline' in card.held_out
    # The noise over the speed, 2e-3 / 0.5 s / sqrt(400), is .004 of a sample; found to 0.01.
    assert chosen.data.delay == pytest.approx(delay, abs=0.02)
    problem = fit_machine(chosen, as_selected(motions, chosen.data, chosen.data.delay))
    for name, number in problem.estimates(chosen.coordinates, None).items():
        if name in ('inertia1', 'gravity1'):
            low, high = number.interval
            true = truth[name == 'gravity1']
            # Three standard errors; that of chords is fifteen.
            assert abs(number.value - true) < 3.0 * (high - low) / (2.0 * 1.96)


@pytest.mark.parametrize('delay', [-3.0, 2.0])
def test_forces_that_act_earlier_or_later_than_logged_are_moved(delay: float):
    """A tenth of a sample, 2 ms, is 0.018 of the faster force; chords add (w h)^2 / 8, 0.004."""
    t = 0.02 * np.arange(800)

    def force(t: np.ndarray | float) -> np.ndarray:
        return np.sin(1.7 * t) + np.sin(9.0 * t)

    def rates(t: float, z: np.ndarray) -> list[float]:
        return [z[1], force(t) - 9.0 * np.sin(z[0]) - 0.3 * z[1]]
    q = solve_ivp(rates, (0.0, t[-1]), [0.4, 0.0], t_eval=t, rtol=1e-8, atol=1e-8).y[:1].T
    q += 3e-3 * np.random.default_rng(1).normal(size=q.shape)
    config = machine_config('a', 'revolute', {'hidden': [4], 'loss': {
        'kind': 'trajectory', 'forward_steps': 2, 'forward_lbfgs_steps': 0, 'batch': 16,
        'windows': [{'duration': 0.3, 'steps': 2}]}}, prior=AUTO, friction={'coulomb': 1})
    motions = [smoothed('run', t, q, None, force(t + 0.02 * delay)[:, None], 5.0)]
    chosen, card = selected(config, motions)
    assert chosen.data.delay == pytest.approx(delay, abs=0.1)
    assert f'delayed by {chosen.data.delay:g} samples' in card.held_out
    (moved,) = as_selected(motions, chosen.data, chosen.data.delay)
    assert np.abs(moved.tau[5:-5, 0] - force(t[5:-5])).max() < 0.05
    stated = config.model_copy(update={'data': config.data.model_validate(
        {'kind': 'arrays', 'delay': 0.0})})
    assert selected(stated, motions)[0].data.delay == 0.0


@pytest.mark.long
def test_chords_that_whole_motions_alone_show_are_found_in_a_chaotic_motion(tmp_path: Path):
    """
    At 100 Hz chords of forces of 0.5 to 1.9 Hz are too small by 0.01 to 0.1 %.

    Short pieces do not show that; whole motions do, but those of 16 s have false minima.
    """
    times = 0.01 * np.arange(2000)
    I1, I2, C, G1, G2 = 0.256, 0.15, 0.12, 1.6 * 0.4 * 9.81, 0.6 * 0.5 * 9.81

    def forces(t: np.ndarray | float) -> np.ndarray:
        return np.array([3.0 * np.sin(np.pi * t) + 2.0 * np.sin(2.4 * np.pi * t),
                         1.5 * np.sin(1.4 * np.pi * t) + np.sin(3.8 * np.pi * t)])

    def rates(t: float, z: np.ndarray) -> list[float]:
        (a, b), v = np.split(z, 2)
        mixed, bend = I2 + C * np.cos(b), C * np.sin(b)
        mass = np.array([[I1 + 2.0 * mixed - I2, mixed], [mixed, I2]])
        pull = G2 * np.sin(a + b)
        return [*v, *np.linalg.solve(mass, forces(t) - [0.05 * v[0], 0.03 * v[1]] + [
            bend * (2.0 * v[0] + v[1]) * v[1] - G1 * np.sin(a) - pull,
            -bend * v[0]**2 - pull])]
    q = solve_ivp(rates, (0.0, times[-1]), [0.5, 0.1, 0.0, 0.0], t_eval=times, rtol=1e-9,
                  atol=1e-10).y[:2].T
    q += 2e-3 * np.random.default_rng(9).normal(size=q.shape)
    log = tmp_path / 'log.csv'
    np.savetxt(log, np.column_stack([times, q, forces(times).T]), delimiter=',', comments='',
               header='t,q1 [rad],q2 [rad],tau1 [N m],tau2 [N m]')
    config, _ = guess_config([str(log)])
    data = MACHINE.select(MACHINE.read(tmp_path / 'x.yaml', config, [str(log)], False))
    fitted = MACHINE.fit(data, config, 'cpu')
    assert MACHINE.describe(
        data, fitted, config, 'x', 'train').card.mechanical.inputs == 'spline'
    # Those of chords were 1.9, 2.1, 1.3, 1.7 and 3.8 half-widths off.
    for truth, number in zip((I1, I2, C, G1, G2), fitted.estimates(
            config.coordinates, None).values(), strict=False):
        low, high = number.interval
        assert abs(number.value - truth) < 1.5 * 0.5 * (high - low)


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
    assert alarm_of(guard, look(0, 3.0)) is None
    alarm = alarm_of(guard, look(1, 30.0))
    assert '(largest: elbow = 30 rad/s, trained to 15), in 50 % of the samples' in alarm.message
    assert alarm_of(guard, look(2, 31.0)) is None and guard.share == pytest.approx(2 / 3)


def test_trust_follows_from_residuals_along_whole_motions():
    config, noise = machine_config(), {'0.3': [0.95]}
    card = SelectionCard(held_out='', chosen=RIGID, candidates=[CandidateCard(
        name=RIGID, residuals=noise, furthest={'0.1': [2e-4]}, ordinary={'0.1': [1e-4]})])
    assert 'its own error is below the noise' in trust_text(card, config, noise)
    # Pieces of motions may be shorter than what shows an error.
    for whole in ({'0.3': [0.95], '3': [1.6]}, {'0.3': [13.0]}):
        text = trust_text(card, config, whole)
        assert 'below the noise' not in text and 'go further: 0.0002' in text
        assert f'{max(max(row) for row in whole.values()):.2g} times the noise' in text
