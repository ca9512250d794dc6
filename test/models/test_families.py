# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The model families as Hamiltonians: their kernels, what they refuse, what effects they feed."""

from itertools import pairwise
from pathlib import Path
import warnings

from ensembles import mechanisms
from helpers import assert_derivatives_of_energy, long, Uncompiled
from hnn_vi_ros import load_scene
from hnn_vi_ros.effects import EffectError, EFFECTS
from hnn_vi_ros.errors import HnnViRosError, ModelError, UnsupportedSystem
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import check_method, INTEGRATORS
from hnn_vi_ros.learning.fit.config import FieldFamily
from hnn_vi_ros.models import (
    Box, Checkpoint, ConfinedHamiltonian, CoordinateCard, families, Layers, LearnedHamiltonian,
    load_learned, load_member, ModelCard, save_checkpoint, Scheme)
from hnn_vi_ros.simulation import build, Simulation, System
from mechanical_models import assert_agrees_with_torch, network, random_mechanical
from messages import misfit, refused
import numpy as np
from pydantic import TypeAdapter
import pytest
from scene_files import write_scene
import torch

# Learned one-forms are not canonical; machines, bodies that turn and graphs have own tests.
FAMILIES = sorted(families.FAMILIES.keys() - {
    'symplectic_form', 'mechanical', 'lie_group', 'graph'})
# Hessians of networks as large as these are of the order of ten; see test_neural.
ROUND_OFF = 1e-12


def random_model(family: str, d: int, commands: int = 1, **changes) -> Checkpoint:
    """Return a model of random networks of the usual size."""
    rng = np.random.default_rng(d)
    networks = {}
    for name, ends in families.FAMILIES[family].networks.items():
        widths = [ends.inputs * d, 9, 6, ends.outputs(d, d * commands)]
        networks[name] = Layers(
            tuple(rng.normal(size=(b, a)) / np.sqrt(a) for a, b in pairwise(widths)),
            tuple(0.3 * rng.normal(size=b) for b in widths[1:]))
    layout = {name: [layers.weights[0].shape[1], *(bias.size for bias in layers.biases)]
              for name, layers in networks.items()}
    factor = rng.normal(size=(d, d))
    # Large beside the curvature of a random network: the Lagrangian is regular.
    mass = (factor @ factor.T + 3.0 * np.eye(d)).tolist()
    constants = {'dgnet': {'friction': [0.2] * d}, 'vin': {'mass': mass},
                 'lagrangian': {'mass': mass, 'velocities': [[-1.0, 1.0]] * d}}.get(family, {})
    card = ModelCard(**{
        'name': 'random', 'family': family, 'dataset': 'none', 'seed': d, 'losses': {},
        'training_command': '', 'package_version': '0',
        'box': Box(q=[[-1.0, 1.0]] * d, p=[[-1.0, 1.0]] * d),
        'coordinates': [CoordinateCard(name=f'x{i}') for i in range(d)],
        **({'networks': layout} if len(layout) > 1 else {'widths': next(iter(layout.values()))}),
        **constants, **changes})
    return Checkpoint(card, networks)


@pytest.mark.parametrize('family', sorted(families.FAMILIES.keys() - {'graph'}))
def test_row_of_a_family_names_what_is_compiled_and_what_is_trained(family: str):
    row = families.FAMILIES[family]
    assert issubclass(row.hamiltonian, LearnedHamiltonian)
    assert issubclass(row.trainer, torch.nn.Module)
    assert row.hamiltonian.canonical == row.canonical
    assert row.dissipation in {'', *row.networks}
    assert set(row.constants) <= ModelCard.model_fields.keys()


def test_every_family_that_a_configuration_can_name_has_a_row():
    kinds = TypeAdapter(FieldFamily).json_schema()['discriminator']['mapping']
    assert kinds.keys() <= families.FAMILIES.keys()


def learned(family: str, d: int, **changes) -> LearnedHamiltonian:
    return families.FAMILIES[family].hamiltonian(random_model(family, d, **changes))


def saved(folder: Path, family: str, d: int, **changes) -> str:
    path = folder / f'{family}_{d}.safetensors'
    save_checkpoint(path, random_model(family, d, **changes))
    return str(path)


def torch_lagrangian(model: Checkpoint, q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    mass = torch.tensor(model.card.mass, dtype=torch.float64)
    return 0.5 * v @ mass @ v + network(model.networks['lagrangian'], torch.cat([q, v]))[0]


def torch_energy(model: Checkpoint, z: torch.Tensor) -> torch.Tensor:
    """Return H, written as the families define it."""
    q, p = z.chunk(2)
    nets, family = model.networks, model.card.family
    if family == 'separable_hnn':
        return network(nets['kinetic'], p)[0] + network(nets['potential'], q)[0]
    if family == 'vin':
        mass = torch.tensor(model.card.mass, dtype=torch.float64)
        return 0.5 * p @ torch.linalg.solve(mass, p) + network(nets['potential'], q)[0]
    if family == 'control_affine':
        root = torch.zeros(len(q), len(q), dtype=torch.float64)
        root[np.tril_indices(len(q))] = network(nets['mass_inverse'], q)
        return 0.5 * (root.T @ p).square().sum() + network(nets['potential'], q)[0]
    if family == 'lagrangian':
        v = p.detach().clone()
        for _ in range(20):
            slope = torch.autograd.functional.jacobian(
                lambda v: torch_lagrangian(model, q.detach(), v), v)
            mass = torch.autograd.functional.hessian(
                lambda v: torch_lagrangian(model, q.detach(), v), v)
            v = v + torch.linalg.solve(mass, p.detach() - slope)
        # By the theorem of the implicit function: one step of Newton's method carries dv.
        v = v.detach().requires_grad_(True)
        (slope,) = torch.autograd.grad(torch_lagrangian(model, q, v), v, create_graph=True)
        v = v.detach() + torch.linalg.solve(mass, p - slope)
        return p @ v - torch_lagrangian(model, q, v)
    return network(nets['energy'], z)[0]


def unnamed(value: object) -> bool:
    """Tell whether a tuple without names is in a value."""
    return isinstance(value, tuple) and (
        not hasattr(value, '_fields') or any(unnamed(part) for part in value))


@pytest.mark.parametrize('family', [*FAMILIES, 'mechanical', 'mean of mechanical'])
def test_parameters_of_each_family_have_names(family: str):
    hamiltonian = learned(family, 2) if family in FAMILIES else load_member(
        random_mechanical('double pendulum') if family == 'mechanical' else
        mechanisms('double pendulum', 2), None)
    assert not unnamed(hamiltonian.kernel.parameters)
    assert not unnamed(ConfinedHamiltonian(hamiltonian).kernel.parameters)


def states(d: int, n: int = 5) -> np.ndarray:
    return np.random.default_rng(3).uniform(-1.0, 1.0, (n, 2 * d))


@pytest.mark.parametrize('d', [long(1), 3])
@pytest.mark.parametrize('family', FAMILIES)
def test_kernel_of_each_family_agrees_with_torch_autograd(family: str, d: int):
    hamiltonian, z = learned(family, d), states(d)
    # One step of Newton's method carries no second derivative of v: see the next test.
    curvature = np.inf if family == 'lagrangian' else ROUND_OFF
    assert_agrees_with_torch(hamiltonian, hamiltonian.checkpoint, z, z[::-1], torch_energy,
                             curvature)


@pytest.mark.parametrize('d', [1, 3])
def test_hessian_of_the_legendre_transform_is_the_derivative_of_its_gradient(d: int):
    # Differences of order 6 over 1e-4 are rounded to 1e-14 / 1e-4.
    assert_derivatives_of_energy(learned('lagrangian', d), *np.split(states(d), 2, axis=1), 1e-9)


@pytest.mark.parametrize('family', ['separable_hnn', 'vin'])
def test_separable_family_has_no_mixed_derivative_to_the_last_bit(family: str):
    hamiltonian = learned(family, 2)
    z, moved = states(2), states(2)[::-1]
    one = hamiltonian.gradient(z[:, :2], z[:, 2:])
    other = hamiltonian.gradient(z[:, :2], np.ascontiguousarray(moved[:, 2:]))
    assert np.array_equal(one[0], other[0])


@pytest.mark.parametrize('family', FAMILIES)
def test_stormer_verlet_takes_families_that_separate_and_refuses_the_others(family: str):
    hamiltonian, method = learned(family, 1), INTEGRATORS['stormer_verlet']()
    if family in ('separable_hnn', 'vin'):
        check_method(method, hamiltonian)
    else:
        with refused(UnsupportedSystem):
            check_method(method, hamiltonian)


def test_lagrangian_that_is_singular_in_its_box_is_refused_at_load(tmp_path):
    model = saved(tmp_path, 'lagrangian', 1, mass=[[0.01]])
    with refused(ModelError) as e:
        load_learned(Path(model))
    assert model in str(e.value) and '\n' not in str(e.value)


def test_legendre_transform_without_a_velocity_is_not_a_number():
    # Momenta of a bounded L_v that none reaches: the mass is small beside the network far away.
    hamiltonian = learned('lagrangian', 1)
    assert np.isnan(hamiltonian.energy(np.array([0.0]), np.array([np.nan])))


@pytest.mark.parametrize('family', FAMILIES)
def test_model_file_of_each_family_is_read_back_exactly(tmp_path, family: str):
    written = random_model(family, 2, commands=2 if family == 'control_affine' else 1)
    path = tmp_path / 'm.safetensors'
    save_checkpoint(path, written)
    hamiltonian = load_learned(path)
    assert hamiltonian.checkpoint.card == written.card
    assert type(hamiltonian) is families.FAMILIES[family].hamiltonian
    for name, layers in written.networks.items():
        for ours, theirs in zip(layers, hamiltonian.checkpoint.networks[name], strict=True):
            assert all(np.array_equal(a, b) for a, b in zip(ours, theirs, strict=True))


@pytest.mark.parametrize('family, changes', [
    ('vin', {'mass': None}), ('vin', {'mass': [[-1.0]]}), ('vin', {'widths': [2, 5, 1]}),
    ('hnn', {'friction': [0.1]}), ('hnn', {'networks': {'energy': [2, 5, 1]}}),
    ('separable_hnn', {'networks': {'kinetic': [1, 5, 1]}}), ('dgnet', {'friction': [-0.1]})])
def test_card_that_contradicts_its_family_is_refused(family: str, changes: dict):
    with misfit():
        random_model(family, 1, **changes)


def test_discrete_euler_lagrange_of_a_learned_lagrangian_is_the_midpoint_rule(tmp_path):
    model = saved(tmp_path, 'lagrangian', 2)
    hamiltonian = load_learned(Path(model))
    start, runs = ([0.3, -0.2], [0.4, 0.1]), []
    for method, system in (
            (INTEGRATORS['discrete_euler_lagrange'](model=model), hamiltonian),
            (INTEGRATORS['implicit_midpoint'](), Uncompiled(hamiltonian))):
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')
            runs.append(Simulation(system, method, 0.1, *start).record(20, 1))
    # The position-momentum form of the midpoint rule for the action is the implicit midpoint rule
    # (Marsden, West 2001, section 2.6); 20 steps of round-off.
    assert np.abs(np.array(runs[0]) - np.array(runs[1])).max() <= 20 * ROUND_OFF


def test_discrete_euler_lagrange_refuses_another_family_and_another_model(tmp_path):
    with refused(ModelError):
        INTEGRATORS['discrete_euler_lagrange'](model=saved(tmp_path, 'hnn', 1))
    method = INTEGRATORS['discrete_euler_lagrange'](model=saved(tmp_path, 'lagrangian', 1))
    with refused(UnsupportedSystem):
        check_method(method, learned('hnn', 1))
    with refused(ValueError):
        INTEGRATORS['discrete_euler_lagrange']()


def test_dissipation_is_the_second_network_of_a_dissipative_model(tmp_path):
    effect = EFFECTS['learned_dissipation'](saved(tmp_path, 'dissipative_hnn', 1))
    q, p = np.array([0.3]), np.array([-0.5])
    networks = random_model('dissipative_hnn', 1).networks
    D = network(networks['dissipation'], torch.tensor([0.3, -0.5], dtype=torch.float64))
    assert effect.network.energy(q, p) == pytest.approx(D.item(), abs=ROUND_OFF)
    with refused(ModelError):
        EFFECTS['learned_dissipation'](saved(tmp_path, 'vin', 1))


def test_damping_takes_the_friction_that_a_model_has_learned(tmp_path):
    effect = EFFECTS['damping'](model=saved(tmp_path, 'dgnet', 2))
    assert effect.rate == [0.2, 0.2]
    with refused(ModelError):
        EFFECTS['damping'](model=saved(tmp_path, 'hnn', 1))
    for arguments in ({}, {'rate': 1.0, 'model': 'm'}):
        with refused(ValueError):
            EFFECTS['damping'](**arguments)


@pytest.mark.parametrize('commands', [1, 2])
def test_command_acts_through_the_input_map_of_its_model(tmp_path, commands: int):
    model = saved(tmp_path, 'control_affine', 2, commands=commands)
    hamiltonian = load_learned(Path(model))
    effect = EFFECTS['external_force'](model=model)
    q, p = np.array([0.3, -0.4]), np.array([0.1, 0.2])
    with pytest.warns(UserWarning, match='plain Python'):
        simulation = Simulation(
            Uncompiled(hamiltonian), INTEGRATORS['implicit_midpoint'](), 0.01, q, p, [effect])
    u = np.array([0.7, -1.1])[:commands]
    free = simulation.dH_dq.copy()
    simulation.set_command(u)
    g = network(hamiltonian.checkpoint.networks['input_map'], torch.tensor(q)).numpy()
    assert np.abs(free - simulation.dH_dq - g.reshape(2, commands) @ u).max() <= ROUND_OFF
    simulation.advance(20)
    # The midpoint rule errs by its third derivative times h^2: of the order of 1e-4 here.
    assert simulation.energy_balance == pytest.approx(0.0, abs=1e-3)
    with refused(ValueError):
        simulation.set_command([1.0] * 3)
    with refused(EffectError):
        System(Uncompiled(HAMILTONIANS['quadrotor']()), [effect], INTEGRATORS['lie_leapfrog']())


def test_external_force_refuses_a_model_without_an_input_map(tmp_path):
    with refused(ModelError):
        EFFECTS['external_force'](model=saved(tmp_path, 'hnn', 1))
    with refused(ValueError):
        EFFECTS['external_force']()


@pytest.mark.parametrize('integrator, step_size, said', [
    ('implicit_midpoint', 0.1, False), ('implicit_midpoint', 0.05, True),
    ('generalized_leapfrog', 0.1, True)])
def test_scene_warns_in_one_line_when_the_scheme_is_not_that_of_the_training(
        tmp_path, integrator: str, step_size: float, said: bool):
    model = saved(tmp_path, 'hnn', 1, scheme=Scheme(integrator='implicit_midpoint', step_size=0.1))
    scene = write_scene(
        tmp_path / 'scene.yaml', f'learned, model: {model}', '', integrator, step_size, [0.3])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter('always')
        build(load_scene(scene))
    texts = [str(warning.message) for warning in caught]
    assert len(texts) == said
    for text in texts:
        assert 'trained through implicit_midpoint with step_size 0.1' in text
        assert f'{integrator} and step_size {step_size}' in text and '\n' not in text


def test_scene_of_a_damaged_family_names_file_and_line(tmp_path):
    model = saved(tmp_path, 'lagrangian', 1, mass=[[0.01]])
    scene = write_scene(tmp_path / 'scene.yaml', f'learned, model: {model}')
    with refused(HnnViRosError):
        build(load_scene(scene))
