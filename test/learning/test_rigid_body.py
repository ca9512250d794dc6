# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rigid bodies that are fitted to motions, alone and with networks beside them."""

from dataclasses import replace
from types import SimpleNamespace

from helpers import long
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.learning import EvenMotion
from hnn_vi_ros.learning.data.motions import cutoff_of, Motion, smoothed
from hnn_vi_ros.learning.families.choices import TrajectoryLoss
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.learning.fit import growing
from hnn_vi_ros.learning.fit.growing import fits_by_length
from hnn_vi_ros.learning.fit.machine_fit import fit_machine
from hnn_vi_ros.learning.fit.rigid_body import best_rigid_body
from hnn_vi_ros.learning.fit.shooting import FitProblem
from hnn_vi_ros.learning.fit.windows import KnownModel, ModelParts
from hnn_vi_ros.learning.judging.energy import momentum
from hnn_vi_ros.learning.judging.missing import missing_force
from hnn_vi_ros.learning.judging.residuals import followed, is_noise, judged_along, noise_text
from hnn_vi_ros.learning.tasks.machine import learn
from hnn_vi_ros.models import CoordinateCard
from hnn_vi_ros.simulation import Simulation
from machines import driven, machine_config
from messages import misfit
import numpy as np
import pytest
from scipy.integrate import solve_ivp
import torch

SIZES = {'mass1': 1.2, 'mass2': 0.8, 'length1': 0.5, 'length2': 0.7}
G = 9.81
# Of the double pendulum of these sizes, by its M and V.
EXPECTED = {'inertia1': 2.0 * 0.5**2, 'inertia2': 0.8 * 0.7**2, 'coupling12': 0.8 * 0.5 * 0.7,
            'gravity1': 2.0 * G * 0.5, 'gravity2': 0.8 * G * 0.7}
# Of a pendulum whose inertia is one [1/s].
FRICTION = 0.05
# Motions are smoothed by a filter at 40 Hz, and their first states with them; the scales of all
# of these are found better than that from windows.
SHARE = 0.02


def motions(*, forced: bool = True, noise: float = 0.0) -> list[EvenMotion]:
    """Return motions of a double pendulum with friction, every 10 ms, from three states."""
    effects = [EFFECTS['external_force'](['angle1', 'angle2'], timeout=100.0),
               *(EFFECTS['dry_friction'](name, 0.2, 0.05) for name in ('angle1', 'angle2'))]
    hamiltonian = HAMILTONIANS['double_pendulum'](**SIZES)
    simulation = Simulation(hamiltonian, INTEGRATORS['implicit_midpoint'](), 0.0025, [0.0, 0.0],
                            [0.0, 0.0], effects)
    rng, found, t = np.random.default_rng(0), [], 0.01 * np.arange(400)
    for start in ([1.0, -0.5], [-1.5, 1.0], [0.3, 2.0]):
        simulation.restart(start, momentum(hamiltonian, np.array(start), np.zeros(2),
                                           np.zeros(2)))
        tau = 3.0 * forced * np.sin(rng.uniform(1.0, 6.0, 2) * t[:, None])
        q, v = driven(simulation, tau, 4)
        found.append(smoothed('run', t, q + noise * rng.normal(size=q.shape),
                              v + 20.0 * noise * rng.normal(size=q.shape), tau, 40.0))
    return found


def parameters(network: MechanicalNetwork) -> dict[str, float]:
    assert network.prior is not None
    return dict(zip(network.prior.names, network.prior.values().tolist(), strict=True))


def states(network: MechanicalNetwork) -> torch.Tensor:
    return network.random_states(200, torch.Generator().manual_seed(0))


def config(names: str = 'ab', **family) -> MachineConfig:
    return machine_config(names, more={'hidden': [8], 'loss': {
        'kind': 'trajectory', 'batch': 64, 'windows': [{'duration': 0.1, 'steps': 20}]}},
        **{'prior': 'double_pendulum', 'mass_depends_on': ['a - b'],
           'friction': {'coulomb': 1}} | family)


@pytest.mark.parametrize('noise', [long(0.0), 1e-3])
def test_parameters_of_a_double_pendulum_are_found(noise):
    fitted = learn(config(residual=False), motions(noise=noise))
    network, losses = fitted.module, fitted.losses
    assert losses.keys() == {'rigid_body_forward', 'rigid_body_0.1'}
    assert parameters(network) == pytest.approx(EXPECTED, rel=SHARE)
    v = torch.tensor([[2.0, -2.0]], dtype=torch.float64)
    quick = network.friction(torch.zeros_like(v), v).detach()
    assert quick.numpy() == pytest.approx(np.array([[0.2, -0.2]]), rel=0.1)
    # Nothing of the networks is left but rounding.
    assert float(network.residual_sizes(states(network)).mean().detach()) < 1e-30


@pytest.mark.long
def test_free_motions_tell_all_but_one_common_factor():
    network = learn(config(residual=False), motions(forced=False)).module
    found = parameters(network)
    ratio = {name: value / found['inertia1'] for name, value in found.items()}
    expected = {name: value / EXPECTED['inertia1'] for name, value in EXPECTED.items()}
    assert ratio == pytest.approx(expected, rel=SHARE)


@pytest.mark.long
def test_networks_beside_a_prior_that_is_right_stay_small():
    fitted = learn(config(), motions())
    network, losses = fitted.module, fitted.losses
    assert losses.keys() == {'rigid_body_forward', 'rigid_body_0.1', 'forward', 'windows_0.1'}
    assert parameters(network) == pytest.approx(EXPECTED, rel=2 * SHARE)
    # In units of a twentieth of the inertias, and of the forces that they make.
    assert float(network.residual_sizes(states(network)).mean().detach()) < 1.0
    prior = network.card().prior
    assert prior is not None and prior.parameters['gravity1'].unit == 'N m'


def test_friction_that_accelerations_do_not_show_is_found_by_windows():
    t = 0.01 * np.arange(400)
    solution = solve_ivp(lambda _, z: [z[1], -np.sin(z[0]) - FRICTION * z[1]], (0.0, t[-1]),
                         [2.0, 0.0], t_eval=t, rtol=1e-10, atol=1e-10)
    q, v = solution.y[:, :, None]
    motion = smoothed('run', t, q, v, np.zeros_like(q), 40.0)
    # Accelerations that tell of a friction below zero: where it begins, it could be held for good.
    noisy = replace(motion, a_smooth=FRICTION * v - np.sin(q))
    network = learn(config('a', prior='pendulum', mass_depends_on=None, residual=False,
                           friction={'coulomb': 0}), [noisy]).module
    viscous = float(network.friction.coefficients()[0].detach())
    assert viscous / parameters(network)['inertia1'] == pytest.approx(FRICTION, rel=SHARE)


def swing(deg: float) -> EvenMotion:
    """Return 12 s of a pendulum with friction, positions alone, with white noise."""
    t = 0.02 * np.arange(600)
    z = solve_ivp(lambda _, z: [z[1], -9.0 * np.sin(z[0]) - 0.1 * z[1]], (0.0, t[-1]),
                  [1.8, 0.0], t_eval=t, rtol=1e-10, atol=1e-10, method='DOP853').y
    q = z[0][:, None] + np.deg2rad(deg) * np.random.default_rng(0).normal(size=(600, 1))
    run = Motion('run', 'run', t, q)
    return smoothed('run', t, q, None, 0.0 * q, cutoff_of([run], 0.02))


PENDULUM = {'prior': 'pendulum', 'mass_depends_on': None, 'residual': False}


@pytest.mark.long
def test_noise_of_positions_biases_neither_gravity_nor_friction():
    motion, setting = swing(0.5), config('a', **PENDULUM, friction={'coulomb': 2})
    problem = fit_machine(setting, [motion])
    found, inertia = parameters(problem.module), parameters(problem.module)['inertia1']
    # Of 600 samples; derivatives of noise would make ten times the friction.
    assert found['gravity1'] / inertia == pytest.approx(9.0, rel=0.005)
    viscous, coulomb, *_ = (part.detach() for part in problem.module.friction.coefficients())
    assert float(viscous) / inertia == pytest.approx(0.1, rel=0.05)
    # Dry friction that there is not is left out.
    assert float(coulomb.abs().max()) < 1e-4 * found['gravity1']
    assert problem.noise == pytest.approx(np.deg2rad([0.5]), rel=0.1)
    residuals, _, _ = judged_along(problem.known(), [motion], problem.noise)
    assert is_noise(residuals) and followed(residuals) == pytest.approx(motion.t[-1], rel=0.01)
    assert 'times the noise of the sensors in windows of up to 12 s' in noise_text(residuals)


def test_input_map_is_given_with_the_norm_that_the_model_has():
    t = 0.02 * np.arange(600)
    q = solve_ivp(lambda t, z: [z[1], np.sin(2.0 * t) - 9.0 * np.sin(z[0])], (0.0, t[-1]),
                  [0.5, 0.0], t_eval=t, rtol=1e-9, atol=1e-9).y[:1].T
    q += 1e-3 * np.random.default_rng(0).normal(size=q.shape)
    motion = smoothed('run', t, q, None, np.sin(2.0 * t)[:, None], 5.0)
    problem = fit_machine(config('a', **PENDULUM, friction={'coulomb': 0}, input_map='learned'),
                          [motion])
    # The model is the same with any multiple of its raw map.
    problem.numbers.solution.values[-1] = 784.0
    found = problem.estimates([CoordinateCard(name='a', q_unit='rad', p_unit='N m s')], None)
    one = found['input map of a']
    assert [one.value, *one.interval] == pytest.approx([1.0, 1.0, 1.0])


def test_intervals_of_a_fit_to_positions_are_those_of_the_noise():
    motion = swing(0.5)
    problem = fit_machine(config('a', **PENDULUM, friction={'coulomb': 0}), [motion])
    coordinates = [CoordinateCard(name='a', q_unit='rad', p_unit='N m s')]
    found = problem.estimates(coordinates, motion.q_smooth)
    assert [(name, one.unit) for name, one in found.items()] == [
        ('inertia1', 'kg m2'), ('gravity1', 'N m'),
        ('viscous friction of a', 'N m / (rad/s)')]
    inertia, gravity, viscous = found.values()
    # No force tells the inertia, which is 1.
    assert np.ptp(inertia.interval) < 1e-9 and inertia.value == pytest.approx(1.0, rel=1e-12)

    def path(x: np.ndarray) -> np.ndarray:
        return solve_ivp(lambda _, z: [z[1], -x[0] * np.sin(z[0]) - x[1] * z[1]],
                         (0.0, motion.t[-1]), x[2:], t_eval=motion.t, rtol=1e-11, atol=1e-11,
                         method='DOP853').y[0]
    true, steps = np.array([9.0, 0.1, 1.8, 0.0]), 1e-5 * np.eye(4)
    slopes = np.stack([(path(true + e) - path(true - e)) / 2e-5 for e in steps], axis=1)
    bound = np.deg2rad(0.5) * np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)))
    for one, expected, least in zip((gravity, viscous), true, bound, strict=False):
        half = 0.5 * np.ptp(one.interval)
        # The robust loss loses 5 % of the information, and 600 samples tell the noise to 3 %.
        assert half / 1.96 == pytest.approx(least, rel=0.2)
        # Four standard deviations.
        assert abs(one.value - expected) < 2.0 * half


def test_what_a_rigid_body_misses_is_not_taken_for_noise():
    # On a spring, of which a slide knows nothing: 1 px of 100, seen 30 times a second.
    t = np.arange(600) / 30.0
    x = 100.0 * np.cos(2.5 * t) + np.random.default_rng(0).normal(size=len(t))
    motion = smoothed('track', t, x[:, None], None, np.zeros((len(t), 1)), 4.0)
    slide = MachineConfig.model_validate({
        'coordinates': [{'name': 'x', 'q_unit': 'm', 'kind': 'prismatic'}],
        'data': {'kind': 'arrays'}, 'hidden': [8],
        'family': {'kind': 'mechanical', 'prior': 'planar_chain', 'residual': False,
                   'friction': {'coulomb': 0}}})
    problem = fit_machine(slide, [motion])
    # Residuals of the shortest windows are 34 px; polynomials leave a few of their motion.
    assert 0.9 < problem.noise.item() < 3.0
    assert not is_noise(judged_along(problem.known(), [motion], problem.noise)[0])


def test_states_of_a_chaotic_motion_are_those_of_windows_that_grew():
    """Fitted at once to windows of 6 s, states were wrong by as much as the elbow moves."""
    h, noise, pendulum = 0.01, 5e-3, HAMILTONIANS['double_pendulum']()
    method = INTEGRATORS['implicit_midpoint']()
    run = Simulation(pendulum, method, h, [2.0, 0.9], [0.0, 4.0])
    truth = np.array([run.q.copy() for _ in range(601) if run.advance(1)])
    q = truth + noise * np.random.default_rng(0).normal(size=truth.shape)
    motion = smoothed('chaos', h * np.arange(len(q)), q, None, 0.0 * q, 8.0)
    residuals, (found,), _ = judged_along(
        KnownModel('the model', ModelParts(pendulum, method, [], h)), [motion],
        np.full(2, noise))
    assert followed(residuals) == pytest.approx(6.0)
    # Four unknowns of 1202 samples; sixteen times (the chaos stretches their errors) as large.
    assert np.sqrt(np.mean((found.q_smooth - truth)**2)) < 16.0 * noise * np.sqrt(4 / 1202)


def test_residuals_of_a_known_model_are_right_to_a_percent(monkeypatch):
    """Of a pendulum whose gravity is a tenth too large, in a few steps of the search."""
    motion, model = swing(0.5), HAMILTONIANS['pendulum'](mass=1.0, length=1.0, gravity=9.9)
    evaluate, calls, found = FitProblem._evaluate, [], []
    monkeypatch.setattr(FitProblem, '_evaluate', lambda *given: (
        calls.append(1), evaluate(*given))[1])
    for tolerance in (growing._JUDGED, 1e-8):
        calls.clear()
        monkeypatch.setattr(growing, '_JUDGED', tolerance)
        fits = fits_by_length(KnownModel('the model', ModelParts(
            model, INTEGRATORS['implicit_midpoint'](), [], 0.01)), [motion], np.deg2rad([0.5]))
        found.append((len(calls), [ratios.item() for _, _, ratios in fits]))
    (few, rough), (many, exact) = found
    # Half a percent of a residual is a percent of its square, which the next step would gain.
    assert exact[0] > 1.25 and rough == pytest.approx(exact, rel=0.01) and few < many


@pytest.mark.long
def test_force_that_is_missing_is_named_with_what_it_goes_with():
    motion = swing(0.02)
    network = learn(config('a', **PENDULUM, friction={'viscous': False, 'coulomb': 0}),
                    [motion]).module
    said = missing_force(network, [motion], ['angle'])
    assert said.startswith('On angle a force of ') and 'goes with velocity' in said


def test_wrong_accelerations_of_few_samples_are_no_missing_force():
    """Of a motion that never returns to where it begins."""
    t = np.linspace(0.0, 10.0, 1001)
    q = np.exp(-t)[:, None]
    motion = SimpleNamespace(t=t, q_smooth=q, v_smooth=-q, a_smooth=q, tau=0.0 * q, cutoff=5.0,
                             spacing=0.01)

    def said(force):
        noise = 1e-3 * np.random.default_rng(0).normal(size=q.shape)
        network = SimpleNamespace(joint_forces=lambda tau: tau + torch.tensor(noise + force),
                                  forces=lambda q, v, a, tau: tau)
        return missing_force(network, [motion], ['x'])
    begin = np.zeros_like(q)
    begin[:2] = 0.3
    assert said(begin) == ''
    # Of the same size along a tenth of the motion, it is a force.
    begin[:100] = 0.3
    assert 'goes with position' in said(begin)


def test_filter_ends_where_the_motion_sinks_into_its_noise():
    # The swing has 0.4 Hz and harmonics: the more noise, the fewer are seen.
    cutoffs = [swing(deg).cutoff for deg in (0.01, 0.1, 1.0)]
    assert 12.0 > cutoffs[0] > cutoffs[1] > cutoffs[2] > 0.8


@pytest.mark.long
def test_best_rigid_body_takes_the_angles_that_fit():
    loss = TrajectoryLoss.model_validate({
        'kind': 'trajectory', 'windows': [{'duration': 0.05, 'steps': 1}]})
    network = best_rigid_body(loss, motions()).module
    assert network.structure.angles == [[1.0, 0.0], [0.0, 1.0]]
    assert parameters(network) == pytest.approx(EXPECTED, rel=SHARE)
    # The same pendulum by the angle of the second link from the first.
    relative = [smoothed('run', motion.t, *(
        part @ np.array([[1.0, -1.0], [0.0, 1.0]]) for part in (motion.q, motion.v)),
        motion.tau @ np.array([[1.0, 0.0], [1.0, 1.0]]), 40.0) for motion in motions()]
    network = best_rigid_body(loss, relative).module
    assert network.structure.angles == [[1.0, 0.0], [1.0, 1.0]]
    found = parameters(network)
    assert found.pop('motor_inertia2') < SHARE * EXPECTED['inertia2']
    assert found == pytest.approx(EXPECTED, rel=2 * SHARE)


def test_losses_that_fit_no_rigid_body_are_refused_beside_a_prior():
    with misfit():
        MachineConfig.model_validate(config().model_dump() | {'loss': {'kind': 'inverse'}})
