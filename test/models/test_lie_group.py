# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Learned Hamiltonians of bodies that turn: their kernel, their steps in torch, their effects."""

from pathlib import Path

from helpers import assert_derivatives_of_energy, long
from hnn_vi_ros.effects import EffectError, EFFECTS
from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.learning.families.lie_group import HeldBody, LieGroupNetwork
from hnn_vi_ros.learning.fit.body import BodyState, LieSteps
from hnn_vi_ros.models import LieGroupCard, load_learned, save_checkpoint, turn_matrices
from hnn_vi_ros.models.lie_group import LieGroupHamiltonian
from hnn_vi_ros.simulation import Simulation
from lie_group_models import CARDS, random_lie_group, random_states
from messages import misfit, refused
import numpy as np
import pytest
import torch

# Sums of some hundred terms of order one.
ROUND_OFF = 1e-13
# Central differences over 1e-5: truncation 1e-10 times a third derivative, round-off 1e-11.
DIFFERENCES = 1e-8


def nodes(name: str, count: int = 3) -> tuple[LieGroupHamiltonian, np.ndarray, np.ndarray]:
    hamiltonian = LieGroupHamiltonian(random_lie_group(name))
    return hamiltonian, *random_states(hamiltonian.dimension - 1, count)


@pytest.mark.parametrize('name', CARDS)
def test_gradient_and_hessian_of_a_learned_body_are_the_derivatives_of_its_energy(name: str):
    # Off the unit sphere as well, where steps never are but differences of quaternions go.
    assert_derivatives_of_energy(*nodes(name), DIFFERENCES)


@pytest.mark.parametrize('method, retraction', [
    long('lie_leapfrog', 'cayley'), ('lie_variational_euler', 'exponential')])
@pytest.mark.parametrize('name', CARDS)
def test_torch_step_on_a_group_is_the_compiled_step_to_round_off(tmp_path, name: str, method: str,
                                                                 retraction: str):
    model = random_lie_group(name)
    path, h, places = str(tmp_path / 'm.safetensors'), 0.1, len(model.card.box.q) - 4
    save_checkpoint(path, model)
    driven = 'input_map' in model.networks
    effects = [EFFECTS['learned_friction'](path), EFFECTS['external_force'](
        model=path, timeout=10.0)] if driven else []
    u = torch.tensor(np.array([[0.4, -0.7]] if driven else [[]]))
    q, p = random_states(places + 3, 1)
    simulation = Simulation(LieGroupHamiltonian(model), INTEGRATORS[method](retraction), h,
                            q[0], p[0], effects)
    if driven:
        simulation.set_command(u[0].numpy())
    simulation.advance(3)
    step = LieSteps(LieGroupNetwork.of(model), method, retraction, h)
    node = BodyState(torch.tensor(q[:, :places]), torch.tensor(turn_matrices(q[:, -4:])),
                     torch.tensor(p))
    for _ in range(3):
        node = step(node, u)
    R = turn_matrices(simulation.q[None, -4:])
    for ours, theirs in ((node.x[0], simulation.q[:places]), (node.R[0], R[0]),
                         (node.p[0], simulation.p)):
        assert np.abs(ours.detach().numpy() - theirs).max(initial=0.0) <= ROUND_OFF


def test_torch_step_has_the_derivatives_of_its_solution():
    network, (q, p) = LieGroupNetwork.of(random_lie_group('pose')), random_states(6, 2)
    R, u = torch.tensor(turn_matrices(q[:, -4:])), torch.tensor(np.array([[0.4, -0.7]] * 2))
    x, p = torch.tensor(q[:, :3]), torch.tensor(p)

    def end(change: float) -> torch.Tensor:
        with torch.no_grad():
            bias.add_(change)
        node = LieSteps(network, 'lie_leapfrog', 'exponential', 0.2)(BodyState(x, R, p), u)
        with torch.no_grad():
            bias.sub_(change)
        return node.p.sum() + node.x.sum() + node.R.sum()

    for name in ('mass', 'potential', 'dissipation', 'input_map'):
        bias = getattr(network, name).linears[0].bias
        (slope,) = torch.autograd.grad(end(0.0), bias)
        found = (end(1e-5) - end(-1e-5)).item() / 2e-5
        assert slope.sum().item() == pytest.approx(found, abs=DIFFERENCES)


@pytest.mark.parametrize('name', CARDS)
def test_momenta_of_velocities_have_these_velocities(name: str):
    network, (q, v) = LieGroupNetwork.of(random_lie_group(name)), random_states(
        len(random_lie_group(name).card.box.q) - 1, 3)
    x, R, v = (torch.tensor(part) for part in (q[:, :-4], turn_matrices(q[:, -4:]), v))
    p = network.momenta(x, R, v)
    found = HeldBody(network, x, R, v[:, :0]).of_body(p)
    assert (found - v).abs().max() <= 10.0 * ROUND_OFF


def test_dissipation_of_a_learned_body_only_takes_energy(tmp_path):
    path = str(tmp_path / 'm.safetensors')
    save_checkpoint(path, random_lie_group('pose'))
    hamiltonian, q, p = nodes('pose', 1)
    run = Simulation(hamiltonian, INTEGRATORS['lie_leapfrog'](), 0.02, q[0], p[0],
                     [EFFECTS['learned_friction'](path)])
    before, taken = float(run.energy), 0.0
    for _ in range(20):
        run.advance(5)
        assert run.work <= taken
        taken = float(run.work)
    # The leapfrog errs by h^2 times derivatives of order one.
    assert taken < -0.1
    assert float(run.energy) - before == pytest.approx(taken, abs=5e-3)


def test_learned_body_refuses_what_it_cannot_be_used_for(tmp_path):
    paths = {name: str(tmp_path / f'{name}.safetensors') for name in CARDS}
    for name, path in paths.items():
        save_checkpoint(path, random_lie_group(name))
    with refused(ModelError):
        EFFECTS['learned_friction'](paths['unstructured'])
    with refused(ModelError):
        load_learned(Path(paths['pose']), confine=True)
    quadrotor = HAMILTONIANS['quadrotor']()
    for kind in ('learned_friction', 'external_force'):
        with refused(EffectError):
            Simulation(quadrotor, INTEGRATORS['lie_leapfrog'](), 0.1,
                       [0.0] * 6 + [1.0], [0.0] * 6, [EFFECTS[kind](model=paths['rotation'])])


@pytest.mark.parametrize('changes', [
    {'mass_depends_on': ['position']}, {'potential_depends_on': ['attitude', 'attitude']},
    {'mass_scale': [1.0]}], ids=range(3))
def test_card_of_a_body_that_contradicts_itself_is_refused(changes: dict):
    with misfit():
        LieGroupCard(**{**CARDS['rotation'], 'mass_scale': [1.0] * 3, 'floor': 0.1, **changes})
