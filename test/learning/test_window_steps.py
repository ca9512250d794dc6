# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Steps of variational methods in torch, by which windows of motions are simulated."""

from types import SimpleNamespace

from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork
from hnn_vi_ros.learning.families.structure import Structure
from hnn_vi_ros.learning.machine_config import MachineConfig
from hnn_vi_ros.learning.machine_losses import samples_of, window_loss, Windows
from hnn_vi_ros.learning.machine_train import describe
from hnn_vi_ros.learning.machine_training import scales_of
from hnn_vi_ros.learning.motions import Motion, smoothed
from hnn_vi_ros.learning.window_steps import first_node, Solutions, STEPS
from hnn_vi_ros.models.checkpoint import save_checkpoint
from hnn_vi_ros.models.mechanical import MechanicalHamiltonian
from hnn_vi_ros.simulation import Simulation
import numpy as np
import pytest
import torch

H = 0.01
STRUCTURES = {
    'arm': Structure(['continuous', 'continuous'], [[1.0, 0.0], [1.0, 1.0]], [[0.0, 1.0]],
                     stribeck=1),
    'prior': Structure(['continuous', 'revolute'], [[1.0, 0.0], [0.0, 1.0]], [[0.0, 1.0]],
                       prior='double_pendulum', friction_features=[[1.0, 0.0]]),
    'three': Structure(['prismatic', 'revolute', 'continuous'], [[1.0, -0.5, 0.0]],
                       [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
}


def motion_of(d: int) -> Motion:
    rates = np.random.default_rng(0).uniform(1.0, 5.0, (2, d))
    t = H * np.arange(60)[:, None]
    return smoothed('random', t[:, 0], np.sin(rates[0] * t), rates[0] * np.cos(rates[0] * t),
                    np.sin(rates[1] * t), 40.0)


def random_network(structure: Structure) -> MechanicalNetwork:
    network = MechanicalNetwork(
        structure, [6, 5], scales_of([motion_of(len(structure.kinds))]), 3)
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(0.3 * torch.randn(parameter.shape, dtype=torch.float64,
                                             generator=generator))
    return network


@pytest.mark.parametrize('structure', STRUCTURES)
@pytest.mark.parametrize('method', [*STEPS])
def test_steps_in_torch_are_those_of_the_compiled_methods(tmp_path, method, structure):
    network = random_network(STRUCTURES[structure])
    d, model = network.d, str(tmp_path / 'm.safetensors')
    config = MachineConfig.model_validate({
        'coordinates': [{'name': f'x{i}', 'kind': kind}
                        for i, kind in enumerate(network.structure.kinds)],
        'data': {'kind': 'arrays'}, 'family': {'kind': 'mechanical'}})
    checkpoint = describe(network, config, [motion_of(d)], 'none', {}, 'random', '')
    save_checkpoint(model, checkpoint)
    simulation = Simulation(
        MechanicalHamiltonian(checkpoint), INTEGRATORS[method](), H, np.zeros(d), np.zeros(d),
        [EFFECTS['external_force']([f'x{i}' for i in range(d)], timeout=100.0),
         EFFECTS['learned_friction'](model)])
    q, v, *tau = torch.tensor(np.random.default_rng(2).uniform(-1.0, 1.0, (5, 4, d)))
    with torch.no_grad():
        nodes, solutions = [first_node(network, q, v)], Solutions()
        for force in tau:
            nodes.append(STEPS[method](solutions, network, nodes[-1], force, H))
    for i in range(len(q)):
        simulation.restart(q[i].numpy(), nodes[0].p[i].numpy())
        for force, node in zip(tau, nodes[1:], strict=True):
            simulation.set_command(force[i].numpy())
            simulation.advance(1)
            # States are of the order of one, and both solve to some units of rounding.
            assert np.abs(node.q[i].numpy() - simulation.q).max() < 1e-13
            assert np.abs(node.p[i].numpy() - simulation.p).max() < 1e-13
            assert np.abs(node.v[i].numpy() - simulation.dH_dp).max() < 1e-12


@pytest.mark.parametrize('method', [*STEPS])
def test_derivatives_of_windows_are_those_of_their_loss(method):
    network = random_network(STRUCTURES['arm'])
    samples, rows = samples_of([motion_of(2)], H), torch.arange(0, 40, 4)
    windows = Windows(5, method, 0.1)
    parameters = [*network.parameters()]
    generator = torch.Generator().manual_seed(7)
    directions = [torch.randn(part.shape, dtype=torch.float64, generator=generator)
                  for part in parameters]

    def moved(step: float) -> float:
        with torch.no_grad():
            for part, direction in zip(parameters, directions, strict=True):
                part.add_(step * direction)
            found = float(window_loss(network, samples, rows, windows))
            for part, direction in zip(parameters, directions, strict=True):
                part.sub_(step * direction)
        return found
    slopes = torch.autograd.grad(window_loss(network, samples, rows, windows), parameters,
                                 allow_unused=True)
    found = sum(float((slope * direction).sum())
                for slope, direction in zip(slopes, directions, strict=True)
                if slope is not None)
    # A difference of order 4 errs by h^4 / 30 times a fifth derivative, of up to 1e6 here; its
    # rounding is some 1e-15 / h.
    step = 2e-4
    expected = (8.0 * (moved(step) - moved(-step))
                - (moved(2.0 * step) - moved(-2.0 * step))) / (12.0 * step)
    assert found == pytest.approx(expected, rel=1e-8)


def test_solutions_that_are_used_again_give_the_same_derivatives_in_forward_mode():
    network = random_network(STRUCTURES['arm'])
    q, v, tau = torch.tensor(np.random.default_rng(2).uniform(-1.0, 1.0, (3, 4, 2)))
    weight = network.potential.linears[-1].weight

    def end(solutions: Solutions, given: torch.Tensor) -> torch.Tensor:
        return torch.func.functional_call(
            Steps(network, solutions), {'network.potential.linears.2.weight': given}, (q, v, tau))
    solutions = Solutions()
    (slope,) = torch.autograd.grad(end(solutions, weight).sum(), weight)
    columns = torch.func.jacfwd(lambda given: end(solutions.again(), given).sum())(
        weight.detach())
    # Both are linear in the same matrices.
    assert (columns - slope).abs().max() < 1e-12 * slope.abs().max()


class Steps(torch.nn.Module):

    def __init__(self, network: MechanicalNetwork, solutions: Solutions):
        super().__init__()
        self.network, self.solutions = network, solutions

    def forward(self, q: torch.Tensor, v: torch.Tensor, tau: torch.Tensor) -> torch.Tensor:
        node = first_node(self.network, q, v)
        for _ in range(3):
            node = STEPS['implicit_midpoint'](self.solutions, self.network, node, tau, H)
        return node.q + node.p


def block(force: torch.Tensor | float, slope: float = 1e3) -> SimpleNamespace:
    """Return a block of 1 kg with friction that is nearly a jump, at about 1 m/s."""
    return SimpleNamespace(
        scales=SimpleNamespace(v=np.ones(1), inertia=np.ones(1)),
        momenta=lambda q, v: (v, -force * torch.tanh(slope * v)))


def test_friction_that_jumps_is_solved_where_newton_would_go_around():
    c = torch.linspace(-1.0, 1.0, 41, dtype=torch.float64)[:, None]
    zero = torch.zeros_like(c)
    w = Solutions().solve(block(0.5), (0.0, 1.0), zero, c, zero, c)
    assert (w + 0.5 * torch.tanh(1e3 * w) - c).abs().max() < 1e-12


def test_equation_without_a_solution_is_no_number():
    machine = block(0.0)
    machine.momenta = lambda q, v: (v.square() + 1.0, torch.zeros_like(v))
    one = torch.ones(3, 1, dtype=torch.float64)
    c = torch.tensor([[0.0], [5.0], [0.5]], dtype=torch.float64)
    w = Solutions().solve(machine, (0.0, 1.0), one, c, 0.0 * one, one)
    assert w.isnan().flatten().tolist() == [True, False, True]
    assert float(w[1, 0]) == pytest.approx(2.0, rel=1e-14)
