# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The family mechanical in torch: what it is, how it is trained, and from which data."""

from dataclasses import replace
from functools import cache
from pathlib import Path

from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.errors import DataError
from hnn_vi_ros.hamiltonians import HAMILTONIANS, momentum
from hnn_vi_ros.identify.identify import _arrays
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.learning import ArraysData, EvenMotion, split_runs
from hnn_vi_ros.learning.data.motions import smoothed, train_and_test
from hnn_vi_ros.learning.families.choices import combination, FrictionChoice, Structure
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork, PlainNetwork
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.learning.fit.loop import Fitted
from hnn_vi_ros.learning.fit.machine import (
    acceleration_loss, balanced_step, discrete_loss, fit_network, mean_forces, runge_kutta,
    samples_of, scales_of)
from hnn_vi_ros.learning.judging.evaluation import score
from hnn_vi_ros.learning.judging.predictors import constant_velocity, predicted_by
from hnn_vi_ros.learning.tasks.machine import start_of, with_scale
from hnn_vi_ros.simulation import Simulation
from machines import compiled, driven, from_file, machine_config, shaken
from messages import misfit, refused
import numpy as np
import pytest
from scipy.integrate import solve_ivp
import torch

CONFIG = {
    'coordinates': [{'name': 'a', 'kind': 'continuous'}, {'name': 'b', 'kind': 'continuous'}],
    'data': {'kind': 'arrays'}, 'hidden': [8],
    'family': {'kind': 'mechanical', 'prior': 'none', 'features': ['a', 'a + b'],
               'mass_depends_on': ['b'],
               'friction': {'stribeck': 1}},
}


def random_motions(d: int, seed: int = 0) -> list[EvenMotion]:
    rng = np.random.default_rng(seed)
    t = 0.01 * np.arange(60)
    rates = rng.uniform(1.0, 5.0, (3, d))
    return [smoothed('random', t, np.sin(rates[0] * t[:, None]),
                     rates[0] * np.cos(rates[0] * t[:, None]), np.sin(rates[1] * t[:, None]),
                     40.0)]


LONG = pytest.mark.long
KINDS = ['prismatic', 'revolute', 'continuous']


# Networks alone, links with networks, another system, and links alone; then what else there is.
@pytest.mark.parametrize('structure', [
    Structure(['continuous', 'continuous'], [[1.0, 0.0], [1.0, 1.0]], [[-1.0, 1.0]],
              friction=FrictionChoice(stribeck=1)),
    Structure(KINDS, np.eye(3).tolist(), [[0.0, 1.0, 0.0]], prior='planar_chain',
              angles=[[0.0] * 3, [0.0, 1.0, 0.0], [0.0, 1.0, 1.0]],
              friction_features=[[0.0, 1.0, 0.0]]),
    Structure(['prismatic', 'prismatic'], [[1.0, 0.0], [1.0, -1.0]], [[0.0, 1.0]],
              prior='kepler'),
    Structure(['continuous', 'continuous'], [[1.0, 0.0], [1.0, 1.0]], [[0.0, 1.0]],
              prior='planar_chain', angles=[[1.0, 0.0], [1.0, 1.0]], residual=False),
    *(pytest.param(structure, marks=LONG) for structure in (
        Structure(KINDS, [[1.0, -0.5, 0.0], [0.0, 0.0, 2.0]], [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
                  diagonal_mass=True),
        Structure(['revolute'], [[1.0]], [], friction=FrictionChoice(coulomb=0)),
        Structure(['continuous', 'revolute'], [[1.0, 0.0], [0.0, 1.0]], [[0.0, 1.0]],
                  prior='planar_chain', angles=[[1.0, 0.0], [0.0, 1.0]]),
        Structure(['revolute'], [[1.0]], [[1.0]], prior='tao', residual=False),
        Structure(KINDS, [[1.0, 0.0, 0.0]], [],
                  friction=FrictionChoice(viscous=False, coulomb=0),
                  friction_features=[[1.0, -1.0, 0.0], [0.0, 0.0, 1.0]]),
        Structure(['revolute', 'revolute'], [[1.0, 0.0]], [], friction_features=[])))])
def test_accelerations_in_torch_are_those_of_the_kernel_and_its_friction(structure, tmp_path):
    motions = random_motions(len(structure.kinds))
    network = shaken(MechanicalNetwork(structure, [6, 5], scales_of(motions), 3))
    d = network.d
    hamiltonian, model = compiled(network, motions, tmp_path)
    effect = EFFECTS['learned_friction'](model)
    parameters = effect.resolve(hamiltonian.coordinates, None)
    rng = np.random.default_rng(2)
    q, v, tau = rng.uniform(-1.0, 1.0, (3, 4, d))
    p = momentum(hamiltonian, q, v, np.zeros_like(q))
    with torch.no_grad():
        at, moving, driven = map(torch.tensor, (q, v, tau))
        found = network.accelerations(at, moving, driven).numpy()
        inverse = network.forces(at, moving, torch.tensor(found)).numpy()
        momenta, rates = (part.numpy() for part in network.momenta(at, moving))
        assert np.abs(network.velocities(at, torch.tensor(p)).numpy() - v).max() < 1e-12
    assert np.abs(inverse - tau).max() < 1e-12 and np.abs(momenta - p).max() < 1e-12
    for i in range(len(q)):
        dH_dq, dH_dp = hamiltonian.gradient(q[i], p[i])
        force = tau[i].copy()
        effect.add_force(parameters, 0.0, q[i], p[i], dH_dp, np.zeros(d), force)
        expected = hamiltonian.hessian_vector(q[i], p[i], dH_dp, force - dH_dq)[1]
        assert np.abs(dH_dp - v[i]).max() < 1e-12
        assert np.abs(rates[i] - (force - tau[i] - dH_dq)).max() < 1e-12
        assert np.abs(found[i] - expected).max() < 1e-11 * max(1.0, np.abs(expected).max())


def test_scale_of_energy_is_fixed_by_a_norm_and_changes_no_motion():
    motions = random_motions(2)
    config = MachineConfig.model_validate(CONFIG)
    network = MechanicalNetwork(config.structure(), [6], scales_of(motions), 0)
    q, v = (torch.tensor(getattr(motions[0], name)) for name in ('q_smooth', 'v_smooth'))
    with torch.no_grad():
        before = network.accelerations(q, v, torch.zeros_like(q))
        network = with_scale(Fitted(network, {}), motions).module
        after = network.accelerations(q, v, torch.zeros_like(q))
    assert float(network.masses(q).detach()[:, 0, 0].mean()) == pytest.approx(1.0, rel=1e-12)
    assert torch.allclose(before, after, rtol=1e-11, atol=1e-11)


def test_runge_kutta_converges_with_order_4():
    def accelerations(q: torch.Tensor, v: torch.Tensor, tau: torch.Tensor) -> torch.Tensor:
        return -torch.sin(q) - 0.1 * v + tau

    def end(steps: int) -> float:
        q, v, tau = torch.tensor([1.0, 0.0, 0.3], dtype=torch.float64)[:, None]
        for _ in range(steps):
            q, v = runge_kutta(accelerations, q, v, tau, 1.0 / steps)
        return float(q)
    errors = [abs(end(steps) - end(256)) for steps in (8, 16)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.2)


@cache
def driven_pendulum(seed: int, seconds: float = 12.0) -> EvenMotion:
    """Return a pendulum with Coulomb friction under random forces, every 10 ms."""
    simulation = Simulation(
        HAMILTONIANS['pendulum'](), INTEGRATORS['implicit_midpoint'](), 0.01, [0.5], [0.0],
        [EFFECTS['external_force'](['angle'], timeout=100.0),
         EFFECTS['dry_friction']('angle', 0.3, 0.1)])
    rng = np.random.default_rng(seed)
    amplitude, phase = rng.uniform(-1.5, 1.5, 3), rng.uniform(0.0, 6.0, 3)
    t = 0.01 * np.arange(round(seconds / 0.01))
    tau = (amplitude * np.sin(np.array([1.0, 2.3, 4.1]) * t[:, None] + phase)).sum(
        axis=1, keepdims=True)
    return smoothed(f'run{seed}', t, *driven(simulation, tau), tau, 40.0)


def fitted(motions: list[EvenMotion], hidden: int, loss: dict, **family: object
           ) -> tuple[MechanicalNetwork, dict[str, float]]:
    """Return networks of a pendulum that were trained, and their losses."""
    config = machine_config(more={'hidden': [hidden], 'loss': loss},
                            **{'mass': 'constant', **family})
    network = MechanicalNetwork(config.structure(), [hidden], scales_of(motions), 0)
    found = fit_network(network, config, motions)
    return found.module, found.losses


@pytest.mark.parametrize('loss', [
    {'kind': 'forward', 'steps': 200, 'lbfgs_steps': 200},
    pytest.param({'kind': 'trajectory', 'forward_steps': 300, 'forward_lbfgs_steps': 0,
                  'step_size': 0.02, 'batch': 64, 'windows': [{'duration': 0.2, 'steps': 100}]},
                 marks=LONG),
    pytest.param({'kind': 'inverse', 'steps': 200, 'lbfgs_steps': 200}, marks=LONG),
    pytest.param({'kind': 'discrete', 'steps': 200, 'lbfgs_steps': 200}, marks=LONG),
], ids=lambda loss: loss['kind'])
def test_driven_pendulum_with_friction_is_learned_by_each_loss(loss):
    train, test = [driven_pendulum(1), driven_pendulum(2)], [driven_pendulum(3)]
    network, losses = fitted(train, 12, loss, friction={'coulomb': 1})
    assert losses.keys() == ({'forward', 'windows_0.2'} if loss['kind'] == 'trajectory' else
                             {loss['kind'], f'{loss["kind"]}_lbfgs'})
    learned = score(predicted_by(network), test, [0.5], 0.25, 1.0)
    still = score(constant_velocity, test, [0.5], 0.25, 1.0)
    # Starts at the ends of a run, whose states the filter knows less of, are among them.
    assert learned.horizons[0.5] < 0.1 * still.horizons[0.5]
    # The pendulum of 1 kg and 1 m, and its friction of 0.3 N m, in their own units.
    assert float(network.masses(torch.zeros(1, 1, dtype=torch.float64)).detach()[0, 0, 0]
                 ) == pytest.approx(1.0, abs=0.05)
    v = torch.tensor([[1.0]], dtype=torch.float64)
    friction = network.friction(torch.zeros_like(v), v)
    assert float(friction.detach()) == pytest.approx(0.3, abs=0.05)


# Beyond Adam, as far as L-BFGS comes in so many steps, whether or not a terminal shows them.
@pytest.mark.parametrize('kind, option, at_end', [
    ('forward', 'lbfgs_steps', {}),
    pytest.param('trajectory', 'forward_lbfgs_steps', {
        'batch': 1, 'windows': [{'duration': 0.01, 'steps': 1, 'learning_rate': 1e-12}]},
        marks=LONG)])
def test_lbfgs_on_accelerations_takes_as_many_steps_as_it_is_given(kind, option, at_end):
    motions, found = [driven_pendulum(1, 4.0)], {}
    for steps in (0, 20, 100):
        network, losses = fitted(motions, 8, {
            'kind': kind, 'steps' if kind == 'forward' else 'forward_steps': 50, option: steps,
            **at_end})
        assert ('forward_lbfgs' in losses) == (steps > 0)
        samples = samples_of(motions, None)
        with torch.no_grad():
            found[steps] = float(acceleration_loss(network, samples, torch.arange(400)))
    # The midpoint rule at 0.01 s and the filter leave some of it, which they all have.
    assert found[100] < 0.9 * found[20] < 0.9 * 0.5 * found[0]


def test_what_lbfgs_is_judged_by_is_held_back_from_adam():
    """The tenth, of blocks; and where there are hardly any samples there is one of them."""
    (motion,), seen = [driven_pendulum(1, 1.0)], []
    for part in (slice(None), slice(20)):
        motions = [replace(motion, **{name: values[part] for name, values in vars(motion).items()
                                      if isinstance(values, np.ndarray)})]
        config = machine_config(kind='revolute', more={'hidden': [4], 'loss': {
            'kind': 'trajectory', 'forward_steps': 20, 'forward_lbfgs_steps': 20, 'batch': 2,
            'windows': [{'duration': 0.02, 'steps': 1}]}})
        network = MechanicalNetwork(config.structure(), [4], scales_of(motions), 0)
        asked, whole = [], network.accelerations
        network.accelerations = lambda q, *others: (asked.append(q.detach()), whole(q, *others))[1]
        losses = fit_network(network, config, motions).losses
        assert 'forward_lbfgs' in losses and np.isfinite([*losses.values()]).all()
        q = torch.tensor(motions[0].q_smooth)
        by_adam = torch.unique(torch.cat(asked[:20]))
        seen.append(len(q) - sum(bool((by_adam == x).any()) for x in q))
    assert seen == [10, 2]


# How much a bearing rubs that does not sit in the middle.
def eccentric(q: np.ndarray) -> np.ndarray:
    return 0.3 + 0.2 * np.cos(q)


def motion_of_an_eccentric_pendulum(seed: int) -> EvenMotion:
    rng = np.random.default_rng(seed)
    h, n = 0.01, 800
    amplitude, phase = rng.uniform(-2.0, 2.0, 3), rng.uniform(0.0, 6.0, 3)

    def torque(t: float) -> float:
        return float((amplitude * np.sin(np.array([1.0, 2.3, 4.1]) * t + phase)).sum())

    def rate(t: float, z: np.ndarray) -> np.ndarray:
        q, v = z
        return np.array([v, torque(t) - 9.81 * np.sin(q) - eccentric(q) * v])
    t = h * np.arange(n)
    found = solve_ivp(rate, (0.0, t[-1]), [0.5, 0.0], t_eval=t, rtol=1e-9, atol=1e-9).y.T
    tau = np.array([[torque(time)] for time in t])
    a = np.array([rate(time, z)[1:] for time, z in zip(t, found, strict=True)])
    return smoothed(f'run{seed}', t, found[:, :1], found[:, 1:], tau, 40.0, a)


@LONG
def test_friction_that_depends_on_the_angle_is_learned():
    network, _ = fitted(
        [motion_of_an_eccentric_pendulum(seed) for seed in (1, 2)], 8,
        {'kind': 'forward', 'steps': 200, 'lbfgs_steps': 1000}, friction={
            'viscous': False, 'coulomb': 0, 'network': True, 'network_depends_on': ['a']})
    q = torch.linspace(-2.0, 2.0, 9, dtype=torch.float64)[:, None]
    with torch.no_grad():
        friction = network.friction(q, torch.ones_like(q)).numpy()
    # Each is off by less than a tenth of what it varies by.
    assert np.abs(friction - eccentric(q.numpy())).max() < 0.02


def test_discrete_loss_is_zero_on_a_motion_of_the_midpoint_rule(tmp_path):
    motions = random_motions(2)
    config = MachineConfig.model_validate(CONFIG)
    network = MechanicalNetwork(config.structure(), [6], scales_of(motions), 3)
    hamiltonian, model = compiled(network, motions, tmp_path)
    h, n = 0.01, 60
    simulation = Simulation(
        hamiltonian, INTEGRATORS['implicit_midpoint'](), h, [0.3, -0.2], [0.1, 0.2],
        [EFFECTS['external_force'](['x0', 'x1'], timeout=100.0),
         EFFECTS['learned_friction'](model)])
    tau = 0.3 * np.random.default_rng(0).normal(size=(n, 2))
    q = np.empty((n, 2))
    for k in range(n):
        q[k] = simulation.q
        simulation.set_command(tau[k])
        simulation.advance(1)
    motion = replace(motions[0], t=h * np.arange(n), q=q, tau=tau, inputs='held')
    samples, rows = samples_of([motion], h), torch.arange(n - 2)
    with torch.no_grad():
        found = [float(discrete_loss(network, samples, rows)),
                 float(discrete_loss(network, samples._replace(mean_tau=0.99 * samples.mean_tau),
                                     rows))]
    # Equations are solved to 8 eps, which a second difference makes 8 eps / h^2, squared.
    assert found[0] < (8 * 2.2e-16 / h**2 / scales_of(motions).a.min())**2 < 1e-10 * found[1]


def test_step_of_the_discrete_loss_balances_noise_and_the_rule():
    t = 0.001 * np.arange(25000)
    rng = np.random.default_rng(0)
    quiet, noisy = ([smoothed('run', t, np.sin(3.0 * t)[:, None] + part, None, 0.0 * t[:, None],
                              10.0)] for part in (0.0, 1e-4 * rng.normal(size=(25000, 1))))
    # (12 sqrt(6) sigma / rms(81 sin))^(1/4), of white noise that the filter takes away.
    assert balanced_step(noisy) == pytest.approx((12 * 6**0.5 * 1e-4 / 57.3)**0.25, rel=0.15)
    # Without noise, 4e-6 is what the filter takes away of the motion.
    assert balanced_step(quiet) < 0.6 * balanced_step(noisy)


@pytest.mark.parametrize('text, row', [
    ('a', [1.0, 0.0]), ('a + b', [1.0, 1.0]), ('-2*a+0.5 * b', [-2.0, 0.5]), ('a - b', [1.0, -1.0])
])
def test_linear_combinations_are_read(text, row):
    assert combination(text, ['a', 'b'], 'features') == row


@pytest.mark.parametrize('text', ['', 'c', 'a b', 'a * b', 'a +', '2'])
def test_what_is_no_linear_combination_is_refused(text):
    if not text:
        assert combination(text, ['a', 'b'], 'features') == [0.0, 0.0]  # which the card refuses
        return
    with refused(ValueError):
        combination(text, ['a', 'b'], 'features')


@pytest.mark.parametrize('changes', [
    {'features': ['c']}, {'features': ['a', '0.5 * b']}, {'mass_depends_on': ['a - a']},
    {'mass_depends_on': ['c']}, {'mass': 'constant'},
    {'features': ['a', 'b', 'a + b'], 'prior': 'double_pendulum'},
    {'features': ['a', '2 * a'], 'prior': 'double_pendulum'}, {'prior': 'pendulum'},
    {'residual': False}, {'friction': {'network_depends_on': ['a']}},
    {'friction': {'network': True, 'network_depends_on': ['c']}},
    {'friction': {'network': True}, 'prior': 'double_pendulum', 'residual': False},
    {'prior': 'planar_chain', 'springs': True, 'spring_knots': [0.1]}])
def test_configuration_refuses_what_makes_no_sense(changes):
    with misfit():
        MachineConfig.model_validate(CONFIG | {'family': CONFIG['family'] | changes})


def write(path: Path, **changes) -> Path:
    t = 0.01 * np.arange(40)
    arrays = {'t': t, 'q': np.sin(t)[:, None], 'dq': np.cos(t)[:, None],
              'tau': np.zeros((40, 1))} | changes
    np.savez(path, **{f'one/{key}': value for key, value in arrays.items() if value is not None})
    return path


@pytest.mark.parametrize('changes', [
    {'t': np.zeros(40)}, {'t': 0.01 * np.arange(40) + np.arange(40) // 15}, {'tau': None},
    {'q': np.zeros((40, 2))}, {'tau': np.full((40, 1), np.nan)}, {'q': np.array([['x']] * 40)}])
def test_arrays_that_cannot_be_used_are_refused_in_one_line(tmp_path, changes):
    path = write(tmp_path / 'arm.npz', **changes)
    with refused(DataError):
        from_file(path, ArraysData(), 1)


def test_runs_that_are_not_there_and_files_that_are_none_are_named(tmp_path):
    path = write(tmp_path / 'arm.npz')
    with refused(DataError):
        from_file(f'{path}:two', ArraysData(), 1)
    (tmp_path / 'folder.npz').mkdir()
    whole = path.read_bytes()
    for name, content in (('text.npz', b'hello'), ('empty.npz', b''), ('cut.npz', whole[:-40]),
                          ('damaged.npz', whole[:300] + bytes(40) + whole[340:])):
        (tmp_path / name).write_bytes(content)
        with refused(DataError) as no:
            from_file(tmp_path / name, ArraysData(), 1)
        assert 'pickle' not in str(no.value)
        # What keys there are is asked before, when nothing is said of them.
        assert _arrays(tmp_path / name, ArraysData(), False) == ArraysData()
    for name in ('nothing.npz', 'folder.npz'):
        with refused(DataError):
            from_file(tmp_path / name, ArraysData(), 1)
    assert split_runs(f'{path}:a,b') == (path, ['a', 'b'])
    assert split_runs(str(path)) == (path, [])
    names = [f'run{k}' for k in range(100)]  # longer than any name of a file
    assert split_runs(f'{path}:{",".join(names)}') == (path, names)


def test_accelerations_that_were_measured_are_taken_and_choose_the_loss(tmp_path):
    config = MachineConfig.model_validate(CONFIG)
    t = 0.01 * np.arange(40)[:, None]
    path = write(tmp_path / 'arm.npz', q=t**2, dq=2.0 * t, ddq=np.full((40, 1), 2.0))
    (estimated,), _ = from_file(path, ArraysData(), 1)
    (measured,), _ = from_file(path, ArraysData(a='ddq', smoothing=10.0), 1)
    assert np.abs(measured.a_smooth - 2.0).max() < 1e-12
    assert config.loss_of([estimated]).kind == 'trajectory'
    assert config.loss_of([measured]).kind == 'forward'
    with refused(DataError):
        from_file(write(tmp_path / 'arm2.npz'), ArraysData(a='ddq'), 1)


def test_runs_without_times_come_at_an_interval(tmp_path):
    path = write(tmp_path / 'arm.npz', t=None)
    with refused(DataError):
        from_file(path, ArraysData(), 1)
    (motion,), _ = from_file(path, ArraysData(interval=0.01), 1)
    assert motion.name == 'one' and motion.spacing == pytest.approx(0.01, rel=1e-12)
    assert np.abs(motion.q[:, 0] - np.sin(0.01 * np.arange(40))).max() < 1e-12


def test_samples_that_come_too_seldom_for_the_filter_are_taken_as_they_are(tmp_path):
    t = 0.04 * np.arange(40)
    path = write(tmp_path / 'arm.npz', t=t, q=np.sin(t)[:, None], dq=np.cos(t)[:, None])
    (motion,), _ = from_file(path, ArraysData(), 1)
    assert np.array_equal(motion.q_smooth, motion.q)
    assert np.abs(motion.v_smooth[:, 0] - np.cos(motion.t)).max() < 1e-12
    # A spline's slope inside, of samples h apart: h^4 / 180 at most, more at the ends.
    assert np.abs(motion.a_smooth[8:-8, 0] + np.sin(motion.t[8:-8])).max() < 0.04**4 / 180


def test_late_samples_are_put_on_even_times(tmp_path):
    t = 0.01 * np.arange(400)
    late = t + 0.004 * (np.arange(400) % 7 == 3)
    path = write(tmp_path / 'arm.npz', t=late, q=np.sin(late)[:, None], dq=np.cos(late)[:, None],
                 tau=np.zeros((400, 1)))
    (motion,), _ = from_file(path, ArraysData(), 1)
    assert np.ptp(np.diff(motion.t)) < 1e-9
    # A cubic between samples 14 ms apart at most: (0.014)^4 / 384.
    assert np.abs(motion.q[:, 0] - np.sin(motion.t)).max() < 1e-9
    # v is linear between them, off by 0.014^2 / 8, which 0.01 s later it is not.
    assert np.abs(motion.a_smooth[50:-50, 0] + np.sin(motion.t[50:-50])).max() < 2.5e-3


def test_last_fifth_of_each_run_is_held_out_unless_runs_are_named():
    motions = random_motions(1) + random_motions(1, 1)
    train, test = train_and_test(motions, [])
    assert [len(motion.t) for motion in (*train, *test)] == [48, 48, 12, 12]
    assert test[0].t[0] == motions[0].t[48]


@pytest.mark.parametrize('inputs, means', [
    ('linear', [1.0, 2.0, 3.0, 3.5, 4.0]), ('held', [0.5, 1.5, 2.5, 3.0, 4.0]),
    ('spline', [1.0, 2.0, 3.0, 3.5, 4.0])])
def test_forces_are_averaged_as_they_act_between_samples(inputs, means):
    motion = replace(random_motions(1)[0], t=np.arange(5.0), tau=np.arange(5.0)[:, None],
                     inputs=inputs)
    assert mean_forces(motion, 2)[:, 0] == pytest.approx(means, abs=1e-14)


def test_spline_between_samples_has_the_mean_of_a_smooth_force_in_each_interval():
    t = 0.1 * np.arange(41)
    motion = replace(random_motions(1)[0], t=t, tau=np.sin(3.0 * t)[:, None], inputs='spline')
    # A cubic spline is off by 5 / 384 (3 h)^4, without end conditions by a few times that there.
    assert motion.forces[:, 0] == pytest.approx(np.diff(-np.cos(3.0 * t)) / 0.3, abs=5e-4)


@LONG
def test_plain_network_learns_what_it_is_compared_by():
    """Of the same motions, and angles that have turned over are the same ones to it."""
    config = machine_config(more={'loss': {
        'kind': 'trajectory', 'forward_steps': 300, 'forward_lbfgs_steps': 0,
        'step_size': 0.02, 'batch': 64, 'windows': [{'duration': 0.2, 'steps': 100}]}})
    train, test = [driven_pendulum(1), driven_pendulum(2)], [driven_pendulum(3)]
    network = PlainNetwork(['continuous'], [12], scales_of(train), 0)
    q, v, tau = torch.rand(3, 5, 1, dtype=torch.float64)
    before = network.accelerations(q, v, tau)
    # To rounding.
    assert (network.accelerations(q + 2.0 * np.pi, v, tau) - before).abs().max() < 1e-12
    network = fit_network(network, config, train).module
    found, still = (score(what, test, [0.5], 0.25, 1.0).horizons[0.5]
                    for what in (predicted_by(network), constant_velocity))
    assert found < 0.2 * still


def test_stage_may_have_a_rate_of_its_own():
    motions, moved = random_motions(2), []
    for rate in (None, 1e-9):
        config = MachineConfig.model_validate(CONFIG | {'loss': {
            'kind': 'trajectory', 'forward_steps': 1, 'forward_lbfgs_steps': 0, 'batch': 4,
            'method': 'rk4',
            'windows': [{'duration': 0.02, 'steps': 2, 'learning_rate': rate}]}})
        network = MechanicalNetwork(config.structure(), [8], scales_of(motions), 0)
        first = torch.nn.utils.parameters_to_vector(network.parameters()).detach().clone()
        found = fit_network(network, config, motions).module
        after = torch.nn.utils.parameters_to_vector(found.parameters()).detach()
        moved.append(float((after - first).abs().max()))
    # Adam moves no number by more than about its rate in a step: first one of 0.01, then two of
    # a fifth of that, or of the stage's own.
    assert moved[1] <= 0.0101 < moved[0] <= 0.0101 + 2 * 0.00205


def test_scene_of_a_model_starts_in_motion():
    t = 0.01 * np.arange(400)
    large, small = (smoothed('run', t, size * np.cos(3.0 * t)[:, None], None, 0.0 * t[:, None],
                             5.0) for size in (1.0, 0.02))
    assert start_of([large], [large]) == (large, 0)
    motion, k = start_of([small], [large])
    # The filter has no sample from before the first one.
    assert motion is large and t[k] == pytest.approx(1.0 / 5.0)
