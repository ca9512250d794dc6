# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Training of each family by each of its losses, small; and losses through steps."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import get_args

from helpers import mostly_long, python_step, random_checkpoint
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.errors import DataError, HnnViRosError
from hnn_vi_ros.hamiltonians import Hamiltonian, HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.learning.data.dataset import Dataset, sample_exact
from hnn_vi_ros.learning.families.base import Scales, Trainable
from hnn_vi_ros.learning.families.choices import DiscreteGradientLoss, DiscreteLagrangian, Steps
from hnn_vi_ros.learning.families.hnn import DGNet, DGNetChoice, HNN, HNNChoice
from hnn_vi_ros.learning.families.lagrangian import VIN, VINChoice
from hnn_vi_ros.learning.fit.config import load_config
from hnn_vi_ros.learning.fit.field import FieldSamples, FittedField, LOSSES, network_of
from hnn_vi_ros.learning.fit.steps import path
from hnn_vi_ros.learning.tasks.field import FIELD, judge_energy
from hnn_vi_ros.learning.train import main
from hnn_vi_ros.models import Checkpoint, load_learned, NeuralHamiltonian, VariationalHamiltonian
from hnn_vi_ros.simulation import Simulation
from messages import refused
import numpy as np
import pytest
import torch
from trainings import trained

SCHEMES = get_args(Steps.model_fields['integrator'].annotation)

DATA = """
coordinates: [{{name: x, q_unit: m, p_unit: kg m/s}}]
data:
  kind: exact
  hamiltonian: {{kind: harmonic_oscillator, mass: 2.0, stiffness: 3.0}}
  box: {{q: [[-1.5, 1.5]], p: [[-3.0, 3.0]]}}
  samples: 80
  {data}
{model}
hidden: [16]
adam_steps: 200
lbfgs_steps: 200
reference: {{q: [0.0], p: [0.0]}}
"""
PATHS = 'trajectory: {duration: 0.2, spacing: 0.1}'
STEPS = 'loss: {{kind: steps, integrator: {}, step_size: 0.1, count: {}}}'
# Of each family: what the data hold, what the configuration says, how large the error of the field
# may be beside the field. A network of 16 units learns a parabola to 1e-3 in so few steps; what is
# trained through a method of order two at h = 0.1 is H less (h omega)^2 / 24 = 6e-4, of order one
# without symmetry, half of h omega, 6e-2. Of a dissipative model, and of a Lagrangian, the field
# alone leaves H open; a preference of weight 1e-3 tells the rest, slowly.
RUNS = {
    'hnn': ('', '', 5e-3),
    'hnn, steps': (PATHS, STEPS.format('implicit_midpoint', 1), 1e-2),
    'hnn, many steps': (PATHS, STEPS.format('generalized_leapfrog', 2), 1e-2),
    'hnn, paper': (PATHS, STEPS.format('variational_euler', 1), 0.15),
    'separable_hnn': ('', 'family: {kind: separable_hnn}', 5e-3),
    'dissipative_hnn': ('damping: 0.3', 'family: {kind: dissipative_hnn}', 0.1),
    'dgnet': (f'{PATHS}\n  damping: 0.3',
              'family: {kind: dgnet}\nloss: {kind: discrete_gradient, step_size: 0.1}', 0.02),
    'vin': (PATHS, 'family: {kind: vin, mass: 2.0}\n'
                   'loss: {kind: discrete_lagrangian, step_size: 0.1}', 0.02),
    'vin, midpoint': (PATHS, 'family: {kind: vin, mass: 2.0}\nloss: '
                             '{kind: discrete_lagrangian, rule: midpoint, step_size: 0.1}', 0.02),
    'lagrangian': ('', 'family: {kind: lagrangian, mass: 2.0}\nloss: {kind: euler_lagrange}',
                   0.05),
    'control_affine': ('commands: {input_map: [[0.5]], largest: 2.0}',
                       'family: {kind: control_affine}', 0.02),
}


def train(folder: Path, data: str, model: str, text: str = DATA) -> Path:
    """Train a model by a small configuration and return its file."""
    config = folder / 'small.yaml'
    config.write_text(text.format(data=data, model=model))
    out = folder / 'small.safetensors'
    main(['--config', str(config), '--out', str(out)])
    return out


def model_of(pytestconfig: pytest.Config, name: str) -> Path:
    """Return the trained model of a row of RUNS."""
    data, model, _ = RUNS[name]
    return trained(pytestconfig, name, DATA.format(data=data, model=model)).model


@pytest.mark.parametrize('name', mostly_long(RUNS, *(name for name in RUNS if ',' not in name)))
def test_each_family_learns_the_oscillator_by_each_of_its_losses(pytestconfig, name: str):
    learned, tolerance = load_learned(model_of(pytestconfig, name)), RUNS[name][-1]
    q, p = np.random.default_rng(1).uniform(-1.0, 1.0, (2, 200, 1)) * [[[1.2]], [[2.5]]]
    exact = np.hstack(HAMILTONIANS['harmonic_oscillator'](2.0, 3.0).gradient(q, p))
    errors = np.hstack(learned.gradient(q, p)) - exact
    assert np.sqrt(np.mean(errors**2) / np.mean(exact**2)) <= tolerance
    card = learned.checkpoint.card
    assert card.family == name.partition(',')[0]
    assert learned.energy(np.zeros(1), np.zeros(1)) == pytest.approx(0.0, abs=1e-12)
    if name == 'dgnet':
        assert card.friction == pytest.approx([0.3], rel=0.05)
    if name == 'vin':
        assert card.mass == [[pytest.approx(2.0)]]
        assert (card.scheme.integrator, card.scheme.step_size) == ('stormer_verlet', 0.1)


def test_input_map_of_a_driven_system_is_learned(pytestconfig):
    card_networks = load_learned(model_of(pytestconfig, 'control_affine')).checkpoint.networks
    a, (weights, biases) = np.array([0.4]), card_networks['input_map']
    for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
        a = np.tanh(weight @ a + bias)
    assert (weights[-1] @ a + biases[-1]).item() == pytest.approx(0.5, abs=0.02)


@pytest.mark.long
def test_mass_matrix_is_learned_from_positions_alone(tmp_path):
    text = DATA.replace('[{{name: x, q_unit: m, p_unit: kg m/s}}]', '[{{name: x}}, {{name: y}}]')
    text = text.replace('{{kind: harmonic_oscillator, mass: 2.0, stiffness: 3.0}}',
                        '{{kind: henon_heiles}}')
    text = text.replace('{{q: [[-1.5, 1.5]], p: [[-3.0, 3.0]]}}',
                        '{{q: [[-0.5, 0.5], [-0.5, 0.5]], p: [[-0.5, 0.5], [-0.5, 0.5]]}}')
    text = text.replace('reference: {{q: [0.0], p: [0.0]}}', '')
    path = train(tmp_path, PATHS, RUNS['vin'][1].replace('mass: 2.0', 'mass: 1.0'), text)
    # Hénon-Heiles has M = 1; its potential couples the coordinates, which tells M.
    assert load_learned(path).checkpoint.card.mass == [
        pytest.approx([1.0, 0.0], abs=0.05), pytest.approx([0.0, 1.0], abs=0.05)]


def test_model_trained_through_steps_is_nearer_to_the_path_than_the_exact_one(tmp_path):
    data = 'trajectory: {duration: 0.5, spacing: 0.5}'
    learned = load_learned(train(
        tmp_path, data, STEPS.format('implicit_midpoint', 1).replace('0.1', '0.5')))
    exact = HAMILTONIANS['harmonic_oscillator'](2.0, 3.0)
    omega, z0, ends = np.sqrt(1.5), np.array([1.0, 0.5]), []
    for hamiltonian in (learned, exact):
        simulation = Simulation(
            hamiltonian, INTEGRATORS['implicit_midpoint'](), 0.5, z0[:1], z0[1:])
        ends.append(np.ravel(simulation.record(1, 1)))
    turn = np.array([[np.cos(0.5 * omega), np.sin(0.5 * omega) / (2.0 * omega)],
                     [-2.0 * omega * np.sin(0.5 * omega), np.cos(0.5 * omega)]])
    errors = [np.abs(end - turn @ z0).max() for end in ends]
    # The exact H errs by (h omega)^3 / 12 times the state: 0.02.
    assert errors[0] < 0.2 * errors[1]


def test_training_refuses_a_lagrangian_that_became_singular(tmp_path):
    path = tmp_path / 'small.yaml'
    path.write_text(DATA.format(data='', model=RUNS['lagrangian'][1]))
    config = load_config(path)
    dataset = sample_exact(config.data, 0)
    module = network_of(config, dataset)
    with torch.no_grad():
        module.network.linears[-1].weight.mul_(1e3)
    fitted = FittedField(module, {}, samples=FieldSamples.of(config, dataset))
    with refused(HnnViRosError):
        judge_energy(FIELD.describe(None, fitted, config, 'small', 'train'), module, config,
                     dataset)


def small_hnn(d: int = 1) -> HNN:
    zero, one = np.zeros(d), np.ones(d)
    return HNN(HNNChoice(kind='hnn'), [7], Scales(*3 * [zero], *5 * [one], zero[:0]), seed=2)


@pytest.mark.parametrize('scheme', SCHEMES)
def test_gradient_through_implicit_steps_agrees_with_finite_differences(scheme: str):
    model, h = small_hnn(2), 0.3
    z0 = torch.tensor(np.random.default_rng(1).normal(size=(4, 4)))
    weights = torch.tensor(np.random.default_rng(2).normal(size=(4, 4)))

    def value() -> torch.Tensor:
        # Two steps: through the first state of the second as well as through the parameters.
        return (weights * path(model.vector_field, scheme, z0, h, 2)[-1]).sum()

    parameter = model.network.linears[0].weight
    (exact,) = torch.autograd.grad(value(), parameter)
    spacing = 1e-5
    for at in ((0, 0), (3, 1), (6, 3)):
        ends = []
        for sign in (1.0, -1.0):
            with torch.no_grad():
                parameter[at] += sign * spacing
            ends.append(value().item())
            with torch.no_grad():
                parameter[at] -= sign * spacing
        # Central differences: truncation spacing^2, round-off 1e-15 / spacing.
        assert exact[at].item() == pytest.approx((ends[0] - ends[1]) / (2.0 * spacing), abs=1e-8)


@pytest.mark.parametrize('scheme', [name for name in SCHEMES if name != 'implicit_midpoint'])
def test_steps_of_a_separable_field_solve_no_equations(monkeypatch, scheme: str):
    def solve(*_):
        raise AssertionError('an equation was solved')
    monkeypatch.setattr('hnn_vi_ros.learning.fit.steps.newton', solve)
    weight = torch.tensor([0.7, 1.3], dtype=torch.float64, requires_grad=True)

    def value(weight: torch.Tensor) -> torch.Tensor:
        def field(z: torch.Tensor) -> torch.Tensor:
            q, p = z.chunk(2, dim=1)
            return torch.cat([(weight[0] * p).sinh(), -(weight[1] * q).sin()], dim=1)
        z0 = torch.tensor([[0.7, -0.4], [-1.1, 0.3]], dtype=torch.float64)
        return (z0 * path(field, scheme, z0, 0.1, 2)[-1]).sum()

    (exact,) = torch.autograd.grad(value(weight), weight)
    for k, unit in enumerate(1e-5 * torch.eye(2, dtype=torch.float64)):
        with torch.no_grad():
            difference = (value(weight + unit) - value(weight - unit)).item() / 2e-5
        # Central differences: truncation 1e-10, round-off 1e-15 / 1e-5.
        assert exact[k].item() == pytest.approx(difference, abs=2e-9)


def test_leapfrog_of_a_separable_field_takes_two_gradients_a_step():
    rows = []

    def field(z: torch.Tensor) -> torch.Tensor:
        rows.append(len(z))
        q, p = z.chunk(2, dim=1)
        return torch.cat([p.sinh(), -q.sin()], dim=1)

    path(field, 'generalized_leapfrog', torch.ones(9, 2, dtype=torch.float64), 0.1, 5)
    # One more at the start; fewer rows look whether the field is separable.
    assert rows.count(9) == 11


@pytest.mark.parametrize('scheme', SCHEMES)
def test_step_of_the_training_is_that_of_the_simulator(scheme: str):
    exact, h = HAMILTONIANS['tao'](), 0.1

    def field(z: torch.Tensor) -> torch.Tensor:
        q, p = z.chunk(2, dim=1)
        return torch.cat([(q * q + 1.0) * p, -q * (p * p + 1.0)], dim=1)

    z0 = np.array([[0.7, -0.4], [-1.1, 0.3]])
    ours = path(field, scheme, torch.tensor(z0), h, 1)[0].numpy()
    theirs = [python_step(INTEGRATORS[scheme](), exact, h, z) for z in z0]
    # Both are solved to round-off.
    assert np.abs(ours - theirs).max() <= 1e-14


def test_step_too_large_for_the_field_gives_data_error():
    with refused(DataError):
        # z = 1 + 9 (((1 + z) / 2)^2 + 1) has no real solution.
        path(lambda z: z.square() + 1.0, 'implicit_midpoint', torch.ones(1, 2).double(), 9.0, 1)


@pytest.mark.parametrize('model', [
    'family: {kind: vin}', 'loss: {kind: discrete_gradient, step_size: 0.1}',
    'loss: {kind: steps, integrator: gauss4, step_size: 0.1}',
    'loss: {kind: steps, integrator: implicit_midpoint}', 'family: {kind: mlp}',
    RUNS['vin'][1] + '\nlinearity: 1.0'], ids=range(6))
def test_choice_that_does_not_fit_is_refused_in_one_line(tmp_path, model: str):
    path = tmp_path / 'bad.yaml'
    path.write_text(DATA.format(data='', model=model))
    with refused(DataError):
        load_config(path)


@pytest.mark.parametrize('model', [
    'family: {kind: control_affine}', STEPS.format('implicit_midpoint', 1)])
def test_data_that_lack_what_a_choice_needs_are_refused(tmp_path, model: str):
    with refused(DataError):
        train(tmp_path, '', model)


D, WIDTHS, STARTS, COUNT = 2, [16, 16], 5, 4
SCALES = Scales(*np.random.default_rng(6).uniform(0.5, 1.5, (8, D)), np.zeros(0))
# Friction begins at a tenth of these rates: at one rate for all, or a coupled system gains energy.
SCALES = replace(SCALES, p_rate=SCALES.p_half)


def random_dgnet(friction: bool) -> tuple[DGNet, Hamiltonian]:
    """Return a network as it is trained, and as it is simulated."""
    family = DGNet(DGNetChoice(kind='dgnet', friction=friction), WIDTHS, SCALES, seed=3)
    card = random_checkpoint([2 * D, *WIDTHS, 1], seed=0).card
    return family, NeuralHamiltonian(Checkpoint(card, family.networks(np.zeros(2 * D), 0.0)))


def random_vin() -> tuple[VIN, Hamiltonian]:
    """Return the same of V(q), with a mass matrix that is not diagonal."""
    family = VIN(VINChoice(kind='vin', mass=1.3), WIDTHS, SCALES, seed=4)
    with torch.no_grad():
        family.factor.add_(0.3 * torch.randn(D, D, generator=torch.Generator().manual_seed(5)))
    card = random_checkpoint([2 * D, *WIDTHS, 1], seed=0).card.model_copy(update={
        'family': 'vin', 'widths': [D, *WIDTHS, 1], **family.constants()})
    return family, VariationalHamiltonian(Checkpoint(card, family.networks(np.zeros(2 * D), 0.0)))


def steps(hamiltonian: Hamiltonian, method: str, h: float, effects: tuple = ()) -> Dataset:
    """Return the states of simulations from random ones: what a user would learn from."""
    q, p = [], []
    for start in np.random.default_rng(7).uniform(-1.0, 1.0, (STARTS, 2, D)):
        simulation = Simulation(hamiltonian, INTEGRATORS[method](), h, *start, effects)
        path_q, path_p = simulation.record(COUNT, 1)
        q += [start[:1], path_q]
        p += [start[1:], path_p]
    q, p = np.concatenate(q), np.concatenate(p)
    block = np.repeat(np.arange(STARTS), COUNT + 1)
    return Dataset(q, p, q, p, block, 'simulated', np.tile(h * np.arange(COUNT + 1), STARTS))


def residuals(choice, family: Trainable, data: Dataset) -> np.ndarray:
    """Return what a loss of this choice squares, in the units of its target."""
    loss = LOSSES[choice.kind]
    batch = loss.batch(choice, data)
    return (loss.predict(choice, family, *batch.inputs) - batch.target).detach().numpy()


def test_loss_of_the_discrete_gradient_vanishes_on_the_simulators_steps():
    (family, hamiltonian), h = random_dgnet(friction=False), 0.1
    choice = DiscreteGradientLoss(kind='discrete_gradient', step_size=h)
    data = steps(hamiltonian, choice.scheme.integrator, h)
    change = [np.linalg.norm(np.diff(np.hstack([data.q, data.p])[data.block == k], axis=0), axis=1)
              for k in range(STARTS)]
    # Both know H, a sum of 16 terms of order 1, to 16 eps = 4e-15, and divide its change by that
    # of the state: h times this enters a step. The step itself is solved and rounded to 1e-15.
    assert np.abs(residuals(choice, family, data)).max() * h <= h * 4e-15 / np.min(change) + 1e-15


@pytest.mark.parametrize('rule', ['trapezoid', 'midpoint'])
def test_loss_of_the_discrete_lagrangian_vanishes_on_the_simulators_steps(rule: str):
    (family, hamiltonian), h = random_vin(), 0.1
    choice = DiscreteLagrangian(kind='discrete_lagrangian', rule=rule, step_size=h)
    data = steps(hamiltonian, choice.scheme.integrator, h)
    # Second differences of coordinates of order 1: four roundings of eps / 2 each, as much again
    # where steps are solved; accelerations, of sums of 16 terms, enter them times h^2.
    assert np.abs(residuals(choice, family, data)).max() * h**2 <= 1e-14


def test_loss_of_the_discrete_gradient_takes_friction_in_the_middle_of_a_step():
    # The two cannot agree to round-off: the loss takes friction at the mean momentum, as its
    # authors do, and the simulator its exact flow before and after the step. Both are of order 2,
    # and symmetric: their difference, as a rate, is h^2 times a constant, and smaller terms h^4.
    family, hamiltonian = random_dgnet(friction=True)
    damping = EFFECTS['damping'](family.constants()['friction'])
    sizes = []
    for h in (0.1, 0.05, 0.025):
        choice = DiscreteGradientLoss(kind='discrete_gradient', step_size=h)
        data = steps(hamiltonian, 'discrete_gradient', h, (damping,))
        # Of the first step of each path: all begin in the same states.
        first = residuals(choice, family, data).reshape(STARTS, COUNT, 2 * D)[:, 0]
        sizes.append(np.abs(first).max())
    for coarse, fine in pairwise(sizes):
        assert coarse / fine == pytest.approx(4.0, rel=0.1)
    # Small beside friction itself, whose rates are some 0.1 / s.
    assert sizes[-1] <= 1e-5
