# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The neural symplectic form: its equation of motion, its method, its training, its refusals."""

from functools import cached_property
from pathlib import Path

from helpers import plain_steps, random_checkpoint
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.errors import DataError, ModelError, UnsupportedSystem
from hnn_vi_ros.files import shipped_file
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.kernels import Kernel
from hnn_vi_ros.learning.data.dataset import ExactData, sample_exact
from hnn_vi_ros.learning.fit.config import find_config, load_config
from hnn_vi_ros.learning.train import main
from hnn_vi_ros.models import (
    Box, Checkpoint, irregularity, Layers, load_checkpoint, load_learned, NeuralHamiltonian,
    save_checkpoint)
from hnn_vi_ros.models.symplectic_form import SymplecticFormHamiltonian
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import build, Simulation
from messages import refused
import numpy as np
import pytest
from scipy.integrate import solve_ivp

CANONICAL = sorted(name for name, method in INTEGRATORS.items()
                   if method.requirements.coordinates == 'canonical')
# A random form of two coordinates: its W varies by a factor of two over the box, in directions
# that no time reversal respects.
STRENGTH = 0.06


def random_form(strength: float = STRENGTH) -> Checkpoint:
    """Return a model of random networks of (q, p) in R^4, theta = (p, 0) + strength N."""
    energy, form = random_checkpoint([4, 12, 1], seed=1), random_checkpoint([4, 10, 1], seed=2)
    rng = np.random.default_rng(3)
    first, last = form.networks['energy'], strength * rng.normal(size=(4, 10))
    networks = {
        'one_form': Layers((first.weights[0], last), (first.biases[0], np.zeros(4))),
        'energy': energy.networks['energy']}
    card = energy.card.model_copy(update={
        'family': 'symplectic_form', 'widths': None, 'mass': np.eye(2).tolist(),
        'networks': {'one_form': [4, 10, 4], 'energy': [4, 12, 1]},
        'box': Box(q=2 * [[-1.0, 1.0]], p=2 * [[-1.0, 1.0]])})
    return Checkpoint(card, networks)


class Uncompiled(SymplecticFormHamiltonian):
    """The same as plain Python around compiled networks: no loop over steps is compiled."""

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions."""
        return super().kernel._replace(compiled=False)


def field(model: SymplecticFormHamiltonian, z: np.ndarray) -> np.ndarray:
    """Return u' at states of shape (..., 2 d)."""
    d = model.dimension
    minus_p, q = model.gradient(z[..., :d], z[..., d:])
    return np.concatenate([q, -minus_p], axis=-1)


def one_form(model: SymplecticFormHamiltonian, z: np.ndarray) -> np.ndarray:
    """Return theta at states of shape (m, 2 d)."""
    d, ((*weights, last), (*biases, end)) = model.dimension, model.checkpoint.networks['one_form']
    theta = z
    for weight, bias in zip(weights, biases, strict=True):
        theta = np.tanh(theta @ weight.T + bias)
    theta = theta @ last.T + end
    theta[:, :d] += z[:, d:] @ np.array(model.checkpoint.card.mass).T
    return theta


def simulation(h: float, name: str = 'variational_midpoint', *arguments: float) -> Simulation:
    return Simulation(Uncompiled(random_form()), INTEGRATORS[name](*arguments), h,
                      [0.4, -0.3], [0.2, 0.5])


def test_canonical_one_form_gives_the_equations_of_hamilton():
    checkpoint = random_form(strength=0.0)
    energy = checkpoint.networks['energy']
    card = checkpoint.card.model_copy(update={
        'family': 'hnn', 'mass': None, 'networks': None, 'widths': [4, 12, 1]})
    plain = NeuralHamiltonian(Checkpoint(card, {'energy': energy}))
    z = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 4))
    of_form = SymplecticFormHamiltonian(checkpoint).gradient(z[:, :2], z[:, 2:])
    # W is of ones and zeros: nothing is rounded but what the loops sum in another order.
    np.testing.assert_allclose(of_form, plain.gradient(z[:, :2], z[:, 2:]), rtol=1e-13, atol=1e-14)


def test_motion_makes_the_action_stationary():
    model, T, n = SymplecticFormHamiltonian(random_form()), 2.0, 60
    motion = solve_ivp(lambda t, z: field(model, z), (0.0, T), [0.4, -0.3, 0.2, 0.5], 'DOP853',
                       rtol=1e-11, atol=1e-12, dense_output=True)
    nodes, weights = np.polynomial.legendre.leggauss(n)
    t, weights = 0.5 * T * (nodes + 1.0), 0.5 * T * weights
    u, slope = motion.sol(t).T, field(model, motion.sol(t).T)
    bump, bump_slope = np.sin(np.pi * t / T)**2, np.pi / T * np.sin(2.0 * np.pi * t / T)

    def action(shift: np.ndarray) -> float:
        z, rate = u + bump[:, None] * shift, slope + bump_slope[:, None] * shift
        lagrangian = (one_form(model, z) * rate).sum(axis=1) - model.energy(z[:, :2], z[:, 2:])
        return float(weights @ lagrangian)

    for direction in np.eye(4):
        first = (action(1e-4 * direction) - action(-1e-4 * direction)) / 2e-4
        second = (action(direction) - 2.0 * action(0.0 * direction) + action(-direction))
        # A central difference errs by 1e-8 times a third derivative of order one.
        assert abs(first) < 1e-7 and abs(second) > 1e-3


def test_variational_midpoint_converges_with_order_2():
    reference = simulation(2.0, 'dop853', 1e-12, 1e-13)
    reference.advance(1)
    errors = []
    for steps in (10, 20, 40, 80):
        run = simulation(2.0 / steps)
        run.advance(steps)
        errors.append(max(np.abs(run.q - reference.q).max(), np.abs(run.p - reference.p).max()))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.abs(orders - 2.0).max() < 0.1  # the next term is h^2 = 0.04 of the first


def test_variational_midpoint_is_symmetric():
    there = simulation(0.1)
    there.advance(1)
    back = plain_steps(there.integrator, there.hamiltonian.kernel, -0.1, there.q, there.p)
    # Each way is solved to about 8 eps of a scale that holds the rounding of W^-1 H'.
    np.testing.assert_allclose([*back.q, *back.p], [0.4, -0.3, 0.2, 0.5], rtol=0.0, atol=1e-13)


def test_variational_midpoint_conserves_the_energy_of_a_form_without_time_reversal():
    run = simulation(0.2)
    energy = run.energy
    run.advance(500)
    # Solved to round-off, H changes by some eps of its terms a step: a random walk of 500.
    assert abs(run.energy - energy) < 1e-12


def test_variational_midpoint_restored_from_a_snapshot_is_bit_identical():
    whole, resumed = simulation(0.05), simulation(0.05)
    whole.advance(20)
    snapshot = whole.snapshot()
    whole.advance(20)
    resumed.restore(snapshot)
    resumed.advance(20)
    assert np.array_equal(resumed.q, whole.q) and np.array_equal(resumed.p, whole.p)


@pytest.mark.parametrize('name', CANONICAL)
def test_canonical_methods_refuse_coordinates_that_are_not(name: str):
    arguments = ('helpers:midpoint_lagrangian',) if name == 'discrete_euler_lagrange' else ()
    refusal = f'{name}.* needs canonical .*variational_midpoint'
    with pytest.raises(UnsupportedSystem, match=refusal):
        Simulation(SymplecticFormHamiltonian(random_form()), INTEGRATORS[name](*arguments), 0.1,
                   [0.0, 0.0], [0.0, 0.0])


def test_variational_midpoint_refuses_canonical_coordinates():
    plain = NeuralHamiltonian(random_checkpoint([4, 12, 1], seed=1))
    with refused(UnsupportedSystem):
        Simulation(plain, INTEGRATORS['variational_midpoint'](), 0.1, [0.0, 0.0], [0.0, 0.0])


def test_effects_and_the_implicit_rescue_refuse_coordinates_that_are_not_canonical():
    model, method = SymplecticFormHamiltonian(random_form()), INTEGRATORS['variational_midpoint']()
    state = [0.0, 0.0], [0.0, 0.0]
    with refused(ValueError):
        Simulation(model, method, 0.1, *state, [EFFECTS['periodic_drive']('x', 1.0, 1.0)])
    with refused(UnsupportedSystem):
        Simulation(model, method, 0.1, *state, on_failure='implicit')


def test_confining_wall_refuses_coordinates_that_are_not_canonical(tmp_path: Path):
    save_checkpoint(tmp_path / 'form.safetensors', random_form())
    with refused(ModelError):
        load_learned(tmp_path / 'form.safetensors', confine=True)


def test_model_whose_form_is_singular_in_its_box_is_refused_when_loaded(tmp_path: Path):
    save_checkpoint(tmp_path / 'form.safetensors', random_form(strength=0.25))
    with pytest.raises(ModelError, match='form.safetensors: the learned 2-form is singular.*set '
                                         'linearity'):
        load_learned(tmp_path / 'form.safetensors')


@pytest.mark.parametrize('d', [1, 2, 3])
def test_irregularity_sees_a_surface_on_which_a_form_is_singular(d: int):
    rng = np.random.default_rng(d)
    mixing = rng.normal(size=(2 * d, 2 * d))
    forms = np.zeros((200, 2 * d, 2 * d))
    forms[:, :d, d:], forms[:, d:, :d] = -np.eye(d), np.eye(d)
    regular = mixing.T @ forms @ mixing
    assert irregularity(regular, np.ones(2 * d)) == ''
    # One block changes its sign with u_1, of which no sample is zero.
    forms[:, 0, d] *= rng.uniform(-1.0, 1.0, 200)
    forms[:, d, 0] = -forms[:, 0, d]
    assert 'singular' in irregularity(mixing.T @ forms @ mixing, np.ones(2 * d))


def test_exact_data_in_velocities_are_the_same_motions():
    data = ExactData.model_validate({
        'kind': 'exact', 'hamiltonian': {'kind': 'double_pendulum'}, 'velocities': True,
        'box': {'q': 2 * [[-1.0, 1.0]], 'p': 2 * [[-3.0, 3.0]]}, 'samples': 200})
    sample = sample_exact(data, seed=0)
    exact = data.hamiltonian.create()
    assert np.abs(sample.p).max() <= 3.0 and np.array_equal(sample.p, sample.dq_dt)
    # The accelerations of Landau's double pendulum: M a = -(gravity) -/+ sin(q1 - q2) v^2.
    (q1, q2), (v1, v2) = sample.q.T, sample.p.T
    c, s = np.cos(q1 - q2), np.sin(q1 - q2)
    mass = np.array([[2.0 + 0.0 * c, c], [c, 1.0 + 0.0 * c]]).transpose(2, 0, 1)
    force = np.stack([-s * v2**2 - 2.0 * 9.81 * np.sin(q1), s * v1**2 - 9.81 * np.sin(q2)], axis=1)
    acceleration = np.linalg.solve(mass, force[:, :, None])[:, :, 0]
    np.testing.assert_allclose(sample.dp_dt, acceleration, rtol=1e-9, atol=1e-9)
    assert exact.dimension == 2 and 'in place of p' in sample.description


TINY = """
coordinates: [{name: angle, q_unit: rad, p_unit: rad/s}]
data:
  kind: exact
  hamiltonian: {kind: pendulum, mass: 2.0, length: 1.5}
  box: {q: [[-1.5, 1.5]], p: [[-3.0, 3.0]]}
  velocities: true
  samples: 200
family: {kind: symplectic_form, mass: 4.5}
hidden: [12]
adam_steps: 150
lbfgs_steps: 200
reference: {q: [0.0], p: [0.0]}
"""


def test_training_learns_the_energy_of_a_pendulum_from_its_angle_and_rate(tmp_path: Path):
    (tmp_path / 'tiny.yaml').write_text(TINY)
    main(['--config', str(tmp_path / 'tiny.yaml'), '--out', str(tmp_path / 'tiny.safetensors')])
    model = load_learned(tmp_path / 'tiny.safetensors')
    z = np.random.default_rng(0).uniform(-1.0, 1.0, (500, 2)) * [1.4, 2.8]
    exact = np.stack([z[:, 1], -9.81 / 1.5 * np.sin(z[:, 0])], axis=1)
    error = np.sqrt(np.mean((field(model, z) - exact)**2) / np.mean(exact**2))
    energy = 0.5 * 4.5 * z[:, 1]**2 + 2.0 * 9.81 * 1.5 * (1.0 - np.cos(z[:, 0]))
    assert error < 0.01
    # Any function of H would do: the one for which W is constant, m l^2, was chosen.
    assert np.abs(model.two_forms(z)[:, 1, 0] / 4.5 - 1.0).max() < 0.05
    # An error of the field changes H along the way from the reference by as large a share, and
    # the mass, which sets the unit, is the mean over the box of data.
    assert np.abs(model.energy(z[:, :1], z[:, 1:]) - energy).max() < 0.03 * energy.max()


def test_training_refuses_to_confine_what_is_not_canonical(tmp_path: Path):
    (tmp_path / 'tiny.yaml').write_text(TINY + 'confine: true\n')
    with refused(DataError):
        load_config(tmp_path / 'tiny.yaml')


def test_shipped_form_has_the_field_of_the_double_pendulum_in_velocities():
    config = load_config(find_config('double_pendulum_velocity'))
    data = config.data.model_copy(update={'samples': 5000, 'edge_share': 0.0})
    sample = sample_exact(data, config.seed + 1)
    model = load_learned(shipped_file('model', 'double_pendulum_velocity'))
    exact = np.hstack([sample.dq_dt, sample.dp_dt])
    errors = field(model, np.hstack([sample.q, sample.p])) - exact
    assert np.sqrt(np.mean(errors**2)) <= 2e-3 * np.sqrt(np.mean(exact**2))
    card = load_checkpoint(shipped_file('model', 'double_pendulum_velocity')).card
    assert card.training_command == 'ros2 run hnn_vi_ros train --config double_pendulum_velocity'


@pytest.mark.timeout(300)
def test_learned_form_of_the_double_pendulum_keeps_its_energy_for_1000_s():
    scene = load_scene('double_pendulum_velocity')
    run = build(scene)
    q, p = run.record(1000, round(1.0 / scene.step_size))
    energy = run.hamiltonian.energy(q, p)
    low, high = np.concatenate(run.hamiltonian.box).T
    assert (low < np.hstack([q, p])).all() and (np.hstack([q, p]) < high).all()
    # 1e5 steps, each solved to 8 eps of some 10 J, and none the same way: no more than 1e-9 J.
    assert np.abs(energy - energy[0]).max() < 1e-9
    assert run.rescued == 0
