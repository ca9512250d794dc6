# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The family mechanical as a Hamiltonian, and its friction."""

from pathlib import Path

from helpers import long, random_checkpoint
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.models import (
    FAMILIES, FrictionCard, load_checkpoint, MechanicalCard, ModelCard, parameter_names, PriorCard,
    Quantity, save_checkpoint)
from hnn_vi_ros.models.planar_chain import chain_kernel, chain_terms, sensor_offsets
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import build, Simulation
from mechanical_models import (
    assert_agrees_with_torch, network, PRIOR, random_mechanical, ROUND_OFF, saved, seen, SHAPES)
from messages import misfit, refused
import numpy as np
import pytest
import torch


def states(d: int, n: int = 5) -> np.ndarray:
    return np.random.default_rng(3).uniform(-1.5, 1.5, (n, 2 * d))


@pytest.mark.parametrize('shape', SHAPES)
def test_kernel_agrees_with_torch_autograd(shape: str):
    hamiltonian = FAMILIES['mechanical'].hamiltonian(random_mechanical(shape))
    z = states(hamiltonian.dimension)
    assert_agrees_with_torch(hamiltonian, hamiltonian.checkpoint, z, z[::-1])


_ANGLES = [[1.0]], [[0.0] * 3, [0.0, 1.0, 0.0], [0.0, 1.0, 1.0]], np.tril(np.ones((4, 4))).tolist()


@pytest.mark.parametrize(('angles', 'springs', 'offsets', 'knots'), [
    *((angles, springs, offsets, ()) for angles in _ANGLES
      for springs, offsets in ((0, False), (1, False), (5, False), (5, True))),
    ([[1.0]], 1, True, (-0.9, 0.1, 1e-7)), ([[0.0]], 2, False, (0.2,))])
def test_straight_code_of_a_chain_is_that_of_its_mass_and_potential(
        angles: list, springs: int, offsets: bool, knots: tuple[float, ...]):
    rng, d = np.random.default_rng(2), len(angles)
    names = parameter_names(angles, springs, offsets, knots)
    parameters = {name: float(rng.uniform(1.0, 2.0) * (0.2 if name.startswith('c') else 1.0))
                  for name in names}
    kernel, terms = chain_kernel(angles, parameters), chain_terms(angles, parameters)
    q, p = rng.uniform(-1.5, 1.5, (2, d))
    energy = kernel.energy.py_func(kernel.parameters, q, p)
    q -= sensor_offsets(d, parameters)
    assert offsets == np.any(sensor_offsets(d, parameters))
    mass = np.tensordot(np.cos(terms.mass_rows @ q), terms.matrices, 1)
    expected = (0.5 * p @ np.linalg.solve(mass, p) + terms.pull @ q + 0.5 * q @ terms.stiffness @ q
                + terms.weights @ (1.0 - np.cos(terms.rows @ q))
                + sum(s @ q**n / n for n, s in enumerate(terms.powers, 3))
                + 0.5 * terms.bends @ np.maximum(q[0] - terms.knots, 0.0)**2)
    assert terms.knots.tolist() == [*knots] and (terms.bends >= 1.0).all()
    # Round-off of some 100 operations on numbers of order one.
    assert abs(energy - expected) < 1e-13 * (1.0 + abs(expected))


def test_continuous_coordinate_is_periodic_and_a_revolute_one_is_not():
    for shape, periodic in (('arm', True), ('joint', False)):
        hamiltonian = FAMILIES['mechanical'].hamiltonian(random_mechanical(shape))
        z = states(hamiltonian.dimension)
        q, p = np.split(z, 2, axis=1)
        turned = hamiltonian.energy(q + 2.0 * np.pi, p)
        # sin(q + 2 pi) differs from sin(q) by the rounding of q + 2 pi.
        assert np.allclose(turned, hamiltonian.energy(q, p), rtol=0.0, atol=1e-13) == periodic


def test_model_file_keeps_family_and_friction(tmp_path: Path):
    written = random_mechanical('three')
    read = load_checkpoint(saved(tmp_path, 'three'))
    assert read.card == written.card
    z = states(3)
    before, after = (FAMILIES['mechanical'].hamiltonian(model).energy(*np.split(z, 2, axis=1))
                     for model in (written, read))
    assert (before == after).all()


def changed(**values: float) -> PriorCard:
    return PriorCard(kind=PRIOR.kind, parameters=PRIOR.parameters | {
        name: Quantity(value=value, unit='1') for name, value in values.items()})


@pytest.mark.parametrize('changes', [
    {'kinds': ['continuous', 'prismatic']}, {'features': [[0.5, 0.0]]},
    {'features': [[0.0, 0.0]]}, {'features': [[1.0]]}, {'mass_features': [[1.0]]},
    {'friction_features': [[0.5, 0.0]]}, {'friction_features': [[1.0]]}, {'floor': 0.0},
    {'prior': PRIOR, 'kinds': ['continuous', 'prismatic'], 'features': [[1.0, 0.0], [0.0, 1.0]],
     'mass_features': []}, {'prior': PRIOR, 'features': [[1.0, 0.0], [0.0, 1.0]]},
    {'prior': PRIOR, 'features': [[1.0, 0.0]]}, {'prior': changed(coupling12=1.2)},
    {'friction': 1.0}, {'prior': [1.0]}, {'friction': {'viscous': [0.0, 0.0], 'coulomb': ['x']}}],
    ids=range(15))
def test_card_refuses_features_that_make_no_sense(changes: dict):
    settings = SHAPES['arm'] | {'mass_scale': [1.0, 1.0], 'floor': 0.1,
                                'friction': FrictionCard(viscous=[0.0, 0.0])} | changes
    with misfit():
        MechanicalCard(**settings)


@pytest.mark.parametrize('shape, method, bound', [
    ('arm', 'generalized_leapfrog', 1e-4), long('arm', 'implicit_midpoint', 1e-4),
    long('arm', 'gauss4', 1e-8), ('worn', 'gauss4', 1e-8)])
def test_energy_balance_closes_with_learned_friction_and_commands(tmp_path, shape, method, bound):
    model = saved(tmp_path, shape)
    hamiltonian = FAMILIES['mechanical'].hamiltonian(load_checkpoint(model))
    effects = [EFFECTS['learned_friction'](model),
               EFFECTS['external_force'](['x0', 'x1'], timeout=100.0)]
    simulation = Simulation(hamiltonian, INTEGRATORS[method](), 1e-3, [0.5, -0.8], [1.0, -0.6],
                            effects)
    simulation.set_command([0.3, -0.2])
    initial = simulation.energy
    simulation.advance(1000)
    friction, command = simulation.works.values()
    # All three are far from zero, and what is left is of the method's order in h.
    assert friction < -0.05 and abs(command) > 0.01
    assert abs(simulation.energy - initial - friction - command) < bound


def test_learned_friction_takes_energy_in_every_state(tmp_path):
    model = saved(tmp_path, 'three')
    hamiltonian = FAMILIES['mechanical'].hamiltonian(load_checkpoint(model))
    effect = EFFECTS['learned_friction'](model)
    parameters = effect.resolve(hamiltonian.coordinates, None)
    for v in np.random.default_rng(0).normal(size=(100, 3)) * 3.0:
        force = np.zeros(3)
        effect.add_force(parameters, 0.0, v, v, v, np.zeros(3), force)
        assert (force * v < 0.0).all()


@pytest.mark.parametrize('shape', ['eccentric', 'worn'])
def test_friction_network_takes_energy_in_every_state(tmp_path, shape):
    model = random_mechanical(shape)
    card = model.card.mechanical
    d = len(card.kinds)
    hamiltonian = FAMILIES['mechanical'].hamiltonian(model)
    effect = EFFECTS['learned_friction'](saved(tmp_path, shape))
    parameters = effect.resolve(hamiltonian.coordinates, None)
    rest = parameters._replace(add=lambda own, q, velocity, f_p: None)
    rng = np.random.default_rng(0)
    for q, v in zip(rng.normal(size=(100, d)), 3.0 * rng.normal(size=(100, d)), strict=True):
        force, others, zero = np.zeros((3, d))
        effect.add_force(parameters, 0.0, q, q, v, zero, force)
        effect.add_force(rest, 0.0, q, q, v, zero, others)
        B = np.zeros((d, d))
        B[np.tril_indices(d)] = network(model.networks['friction'], seen(
            card, card.friction_features, torch.tensor(q))).numpy()
        assert np.abs(force - others + B @ B.T @ v).max() < ROUND_OFF * np.abs(v).max()
        # Of the network alone, -|B^T v|^2; what is rounded off is far below it here.
        assert (force - others) @ v <= 0.0
        assert force @ v < 0.0


def test_model_with_a_friction_network_needs_it_in_the_file():
    card = random_mechanical('worn').card.model_dump()
    for networks in ({name: widths for name, widths in card['networks'].items()
                      if name != 'friction'}, card['networks'] | {'friction': [3, 9, 6, 2]}):
        with misfit():
            ModelCard.model_validate(card | {'networks': networks})


def test_scene_of_a_model_with_a_friction_network_comes_to_rest(tmp_path):
    model = saved(tmp_path, 'eccentric')
    simulation = build(Scene.build(
        hamiltonian={'kind': 'learned', 'model': model}, integrator='implicit_midpoint',
        step_size=0.01, initial_state=([0.3], [0.4]),
        effects=[{'kind': 'learned_friction', 'model': model}]))
    energies = []
    for _ in range(50):
        energies.append(simulation.energy)
        simulation.advance(20)
    # The rule keeps the balance of work up to h^2, far below what friction takes in 0.2 s.
    assert max(np.diff(energies)) < 1e-4 and energies[-1] < energies[0] - 0.01


def test_energy_keeps_its_band_without_friction():
    hamiltonian, h = FAMILIES['mechanical'].hamiltonian(random_mechanical('arm')), 0.005
    simulation = Simulation(hamiltonian, INTEGRATORS['implicit_midpoint'](), h,
                            [0.5, -0.8], [1.0, -0.6])
    energies, terms = [], []
    for _ in range(1000):
        dH_dq, dH_dp = hamiltonian.gradient(simulation.q, simulation.p)
        along_q, along_p = hamiltonian.hessian_vector(simulation.q, simulation.p, dH_dp, -dH_dq)
        terms.append(h**2 / 24.0 * (dH_dp @ along_q - dH_dq @ along_p))
        energies.append(simulation.energy)
        simulation.advance(200)
    # Over T = 1000 s of a motion that is chaotic the band of H is that of the first term of the
    # modified energy, H - h^2 / 24 H''(z', z') + O(h^4), which the rule keeps: a hundredth of the
    # band is some ten times more than what is left of it.
    modified = np.array(energies) - terms
    assert np.ptp(modified) < 0.01 * np.ptp(terms)
    assert abs(np.ptp(energies) - np.ptp(terms)) < 0.01 * np.ptp(terms)


def test_learned_friction_names_the_family_that_has_none(tmp_path):
    save_checkpoint(tmp_path / 'hnn.safetensors', random_checkpoint([2, 8, 1], 0))
    with refused(ModelError):
        EFFECTS['learned_friction'](str(tmp_path / 'hnn.safetensors'))
