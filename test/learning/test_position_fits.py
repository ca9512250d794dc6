# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rigid bodies that are fitted to positions: friction, springs, steps and intervals."""

from dataclasses import replace
import math
from pathlib import Path

from hnn_vi_ros.errors import SceneError
from hnn_vi_ros.learning.data.motions import of_positions, smoothed
from hnn_vi_ros.learning.families.choices import FrictionChoice, Structure
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork
from hnn_vi_ros.learning.fit import growing, rigid_body
from hnn_vi_ros.learning.fit.fitted_rigid_body import covariance_of, rounding_of
from hnn_vi_ros.learning.fit.following import LogSimulation
from hnn_vi_ros.learning.fit.growing import first_length
from hnn_vi_ros.learning.fit.machine import scales_of
from hnn_vi_ros.learning.fit.machine_fit import fit_machine
from hnn_vi_ros.learning.fit.prediction import Prediction
from hnn_vi_ros.learning.fit.rigid_model import PriorUnknowns, RigidModel
from hnn_vi_ros.learning.fit.shooting import search
from hnn_vi_ros.learning.fit.windows import ModelParts, refusals
from hnn_vi_ros.learning.tasks.machine import MACHINE, MachineData
from hnn_vi_ros.models import CoordinateCard, equation_text
from machines import carriage, compiled, double_well, kinked_spring, machine_config, sliding
import numpy as np
import pytest
from scipy.integrate import solve_ivp


class Refusing:
    """A rigid body of at most 1.9 kg, a condition that is no bound of a number."""

    def __init__(self, model: RigidModel):
        self.name, self.numbers, self._model = model.name, model.numbers, model

    def parts_at(self, values: np.ndarray) -> ModelParts:
        """Return the parts, or raise SceneError."""
        if values[0] > 1.9:
            raise SceneError('the carriage is too heavy')
        return self._model.parts_at(values)


def test_trial_that_a_model_refuses_is_rejected_and_the_condition_is_named():
    """Derivatives beside such a value ended the fit."""
    fitted = fit_machine(sliding(prior='planar_chain', residual=False), of_positions([
        carriage(1, 1.0)])).numbers
    model, values = Refusing(fitted.problem.model), fitted.solution.values.copy()
    values[0] = 1.8
    found = search(replace(fitted.problem, model=model), values, 1e-5).values
    # It is 2 kg without the condition.
    assert 1.89 < found[0] <= 1.9
    assert refusals(model, found, 0.01 * found) == {0: 'the carriage is too heavy'}


def test_forces_that_are_the_same_leave_one_of_them():
    """The criterion charged each of them for what the other one could make up for."""
    found = fit_machine(sliding(prior='planar_chain', residual=False, springs=1, friction={
        'coulomb': 1, 'offset': True}), of_positions([
            carriage(1, 1.0, 60.0, 0.1)])).estimates(sliding().coordinates, None)
    low, high = found['gravity1'].interval
    assert 'offset of x' not in found
    # Four standard errors.
    assert abs(found['gravity1'].value + 6.0) < 2.0 * (high - low) / 1.96


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


def test_double_well_has_a_cubic_spring():
    chosen = sliding(prior='planar_chain', residual=False, springs=5)
    found = fit_machine(chosen, [double_well()]).estimates(sliding().coordinates, None)
    assert {'inertia1', 'stiffness1', 'spring3_1', 'viscous friction of x'} <= {*found}
    assert not [name for name in found if 'dry' in name or name.startswith(('spring2', 'spring5'))]
    for name, truth in (('inertia1', 0.5), ('stiffness1', -12.0), ('spring3_1', 900.0)):
        low, high = found[name].interval
        # Four standard errors.
        assert abs(found[name].value - truth) < 2.0 * (high - low) / 1.96


def test_stiffness_of_a_spring_changes_at_a_knot(tmp_path: Path):
    chosen = sliding(prior='planar_chain', residual=False, springs=1,
                     spring_knots=[-0.1, 0.07, 0.15], friction={'coulomb': 1})
    motions = [kinked_spring(0.3), kinked_spring(-0.25)]
    rigid = fit_machine(chosen, motions)
    found = rigid.estimates([CoordinateCard(name='x', q_unit='m', p_unit='N s')], None)
    assert found['stiffness_above_0.07_1'].unit == 'N/m'
    assert not {'stiffness_above_-0.1_1', 'stiffness_above_0.15_1'} & {*found}
    for name, truth in (('inertia1', 0.5), ('stiffness1', 20.0), ('stiffness_above_0.07_1', 40.0)):
        low, high = found[name].interval
        # Four standard errors.
        assert abs(found[name].value - truth) < 2.0 * (high - low) / 1.96
    hamiltonian, _ = compiled(rigid.module, motions, tmp_path)
    values = hamiltonian.checkpoint.card.mechanical.prior.values
    stiffness, above, weight = (values[name] for name in (
        'stiffness1', 'stiffness_above_0.07_1', 'gravity1'))
    q = np.array([-0.2, 0.05, 0.12, 0.3])
    energy = hamiltonian.energy(q[:, None], np.zeros((4, 1)))
    # Round-off of the terms of V.
    assert energy == pytest.approx(0.5 * stiffness * q**2 + weight * q + 0.5 * above * np.maximum(
        q - 0.07, 0.0)**2, rel=1e-12)
    assert f'{above:.4g} max(x0 - 0.07, 0)^2 / 2' in equation_text(hamiltonian.checkpoint.card)


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
    t, rng, z, found = 0.01 * np.arange(500), np.random.default_rng(3), np.zeros(2), []
    force = 3.0 * np.sin(t[:, None] * [1.3, 2.1, 3.7] + [0.3, 1.0, 2.0]).sum(1)
    for value in force:
        found.append(z[0])
        for _ in range(20):
            middle = z + 2.5e-4 * np.array([z[1], 0.5 * (
                value - 0.5 * z[1] - np.tanh(z[1] / 0.05))])
            z = z + 5e-4 * np.array([middle[1], 0.5 * (
                value - 0.5 * middle[1] - np.tanh(middle[1] / 0.05))])
    q = np.array(found)[:, None] + 2e-4 * rng.normal(size=(len(t), 1))
    return fit_machine(sliding(prior='planar_chain', residual=False), [replace(smoothed(
        'rounded', t, q, None, 0.05 * np.rint(force[:, None] / 0.05), 40.0), inputs='held')])


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
    assert rounding_of(motion.tau) == pytest.approx([0.05 / math.sqrt(12.0)])
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


def test_fit_that_explains_nothing_has_no_intervals(rounded):
    (length, _), *others = rounded.numbers.stages[::-1]
    found = replace(rounded, numbers=rounded.numbers._replace(
        stages=[*others, (length, 7.0)])).estimates(sliding().coordinates, None)
    assert found and all(one.interval is None for one in found.values())


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
    config = sliding(prior='planar_chain', residual=False)
    rigid = fit_machine(config, [run])
    assert rigid.numbers.problem.model.step_size < 0.006
    assert rigid.numbers.stages[-1][1] < 1.1
    found = rigid.estimates(sliding().coordinates, None)
    for name, truth in (('inertia1', 2.0), ('viscous friction of x', 0.5),
                        ('dry friction of x', 1.0), ('width of dry friction of x', 0.002)):
        # Four standard errors.
        value, high = found[name].value, found[name].interval[1]
        assert abs(value - truth) < 4.0 * (high - value) / 1.96
    # Those with which it is judged as well: of its own motion only noise is left.
    data = MachineData(config, ([run], [run]), '', False, [run], [run])
    card = MACHINE.judge(data, MACHINE.describe(data, rigid, config, 'x', ''), rigid
                         ).checkpoint.card
    assert max(*card.prediction_error.residuals.values()) < [1.1]


def test_first_windows_of_a_joint_that_turns_over_are_as_short_as_those_of_one_that_swings():
    """Those of its range had false minima: they lasted many turns of a chaotic motion."""
    t, lengths = 0.005 * np.arange(2000), []
    for speed in (0.0, 20.0):
        q = (speed * t + 0.3 * np.sin(20.0 * t))[:, None]
        lengths.append(first_length([smoothed('turns', t, q, None, 0.0 * q, 40.0)]))
    # Four of its 0.05 s, and at most three times the speed over the acceleration, 21 / 85 s.
    assert lengths == pytest.approx([0.2, 4.0 * 3.0 * 20.5 / 84.9], rel=0.05)


def test_stages_of_windows_that_were_left_stay_beside_those_of_the_fit(rounded, monkeypatch):
    """Residuals of the shorter windows were stored as those of the longer ones."""
    left = rounded.numbers._replace(stages=[*rounded.numbers.stages, (99.0, 3.0)])
    half = left.problem.model.at_step(0.5 * left.problem.model.step_size)
    monkeypatch.setattr(rigid_body, '_finer_model', lambda _: half)
    found = rigid_body._with_finer_steps(left)
    assert found.problem.model is half and found.stages[-1] == (99.0, 3.0)
    assert [one for one, _ in found.stages] == [one for one, _ in left.stages]
    assert found.stages[-2] == (left.stages[-2][0], pytest.approx(left.stages[-2][1], rel=0.02))


@pytest.mark.long
def test_numbers_of_two_links_that_whirl_are_within_their_intervals():
    """Numbers of coarse steps led longer windows to false minima: gravity was 5 errors off."""
    heavy, crossed, light, weights = 0.06, 0.0195, 0.0117, np.array([2.26, 0.65])
    t, rng, inside = 0.01 * np.arange(1000), np.random.default_rng(1), 100
    tau = np.stack([1.0 * np.sin(t[:, None] * [2.1, 4.3, 7.1] + [0.0, 1.0, 2.0]).sum(1), 0.3 *
                    np.sin(t[:, None] * [3.3, 5.7, 7.9] + [1.0, 0.0, 2.0]).sum(1)], axis=1)

    def rates(z: np.ndarray, force: np.ndarray) -> np.ndarray:
        (q, v), c, s = np.split(z, 2), crossed * np.cos(z[1]), crossed * np.sin(z[1])
        pull = weights * np.sin([q[0], q[0] + q[1]])
        felt = force - [0.04, 0.013] * v - [0.106, 0.029] * np.tanh(v / [0.02, 0.03]) - [
            pull.sum() - s * (2.0 * v[0] * v[1] + v[1]**2), pull[1] + s * v[0]**2]
        mass = np.array([[heavy + light + 2.0 * c, light + c], [light + c, light]])
        return np.concatenate([v, np.linalg.solve(mass, felt)])
    states, h = [np.array([0.2, -0.3, 0.0, 0.0])], 0.01 / inside
    for force in tau[:-1]:
        z = states[-1]
        for _ in range(inside):
            z = z + h * rates(z + 0.5 * h * rates(z, force), force)
        states.append(z)
    q = np.array(states)[:, :2]
    assert (np.ptp(q, axis=0) > 2.0 * np.pi).any()
    config = machine_config('ab', prior='planar_chain', residual=False)
    found = fit_machine(config, [replace(smoothed(
        'whirl', t, q + [2e-3, 5e-3] * rng.normal(size=q.shape), None, tau, 40.0), inputs='held'
    )]).estimates(config.coordinates, None)
    for name, truth in (('inertia1', heavy), ('inertia2', light), ('coupling12', crossed),
                        ('gravity1', weights[0]), ('gravity2', weights[1]),
                        ('viscous friction of a', 0.04), ('viscous friction of b', 0.013),
                        ('dry friction of a', 0.106), ('dry friction of b', 0.029)):
        # Four standard errors, which are less than 2 % of the number.
        value, high = found[name].value, found[name].interval[1]
        assert abs(value - truth) < 4.0 * (high - value) / 1.96 < 0.08 * truth


def test_false_minimum_of_whole_motions_is_left_at_once_and_tells_nothing(monkeypatch):
    """Searches went on for minutes, and intervals were hundreds of times wider."""
    motions, searches, search = of_positions([carriage(1, 1.0)]), [], growing.search

    def false(problem, *arguments):
        solution = search(problem, *arguments)
        searches.append(len(solution.starts))
        return replace(solution, residuals=(
            100.0 if len(solution.starts) == 1 else 1.0) * solution.residuals)
    monkeypatch.setattr(growing, 'search', false)
    found = fit_machine(sliding(prior='planar_chain', residual=False), motions).numbers
    assert searches.count(1) == 1 and len(found.solution.starts) > 1
    assert max(excess for _, excess in found.stages) < 1.1


def test_widths_and_offsets_of_sensors_do_not_grow_with_the_scale_of_the_energy():
    """Without forces they were divided by the mean inertia, which is 1 by convention."""
    run = carriage(1, 1.0)
    structure = Structure(
        ['revolute'], [[1.0]], [], prior='planar_chain', angles=[[1.0]], residual=False,
        sensor_offsets=True, friction=FrictionChoice(coulomb=1, stribeck=1))
    unknowns = PriorUnknowns(MechanicalNetwork(structure, [1], scales_of([run]), 0), widths=True)
    labels = unknowns.labels([CoordinateCard(name='a', q_unit='rad', p_unit='N m s')])
    fixed = [name for (name, _), grows in zip(labels, unknowns.scaled, strict=True) if not grows]
    assert fixed == ['sensor_offset1', 'Stribeck speed of a', 'width of dry friction 1',
                     'width of dry friction 2']
