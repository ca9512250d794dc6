# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Steps of variational methods in torch, by which windows of motions are simulated."""

from dataclasses import replace
from types import SimpleNamespace

from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.learning.data.runs import Run, smoothed
from hnn_vi_ros.learning.families.choices import FrictionChoice, Structure
from hnn_vi_ros.learning.families.mechanical import Linearised, MechanicalNetwork
from hnn_vi_ros.learning.fit import steps as window_steps
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.learning.fit.machine import Samples, samples_of, scales_of, window_loss, Windows
from hnn_vi_ros.learning.fit.steps import METHODS, simulated, Solutions
from hnn_vi_ros.learning.tasks.machine import describe
from hnn_vi_ros.models.checkpoint import save_checkpoint
from hnn_vi_ros.models.mechanical import MechanicalHamiltonian
from hnn_vi_ros.simulation import Simulation
import numpy as np
import pytest
import torch

H = 0.01
STRUCTURES = {
    'arm': Structure(['continuous', 'continuous'], [[1.0, 0.0], [1.0, 1.0]], [[0.0, 1.0]],
                     friction=FrictionChoice(stribeck=1)),
    'prior': Structure(['continuous', 'revolute'], [[1.0, 0.0], [0.0, 1.0]], [[0.0, 1.0]],
                       prior='planar_chain', angles=[[1.0, 0.0], [0.0, 1.0]],
                       friction_features=[[1.0, 0.0]]),
    'three': Structure(['prismatic', 'revolute', 'continuous'], [[1.0, -0.5, 0.0]],
                       [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
                       friction=FrictionChoice(load=True)),
}


def motion_of(d: int) -> Run:
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
@pytest.mark.parametrize('method', [*METHODS])
def test_steps_in_torch_are_those_of_the_compiled_methods(tmp_path, method, structure):
    network = random_network(STRUCTURES[structure])
    d, model = network.d, str(tmp_path / 'm.safetensors')
    config = MachineConfig.model_validate({
        'coordinates': [{'name': f'x{i}', 'kind': kind}
                        for i, kind in enumerate(network.structure.kinds)],
        'data': {'kind': 'arrays'}, 'family': {'kind': 'mechanical', 'prior': 'none'}})
    checkpoint = describe(network, config, [motion_of(d)], 'none', {}, 'random', '')
    save_checkpoint(model, checkpoint)
    simulation = Simulation(
        MechanicalHamiltonian(checkpoint), INTEGRATORS[method](), H, np.zeros(d), np.zeros(d),
        [EFFECTS['external_force']([f'x{i}' for i in range(d)], timeout=100.0),
         EFFECTS['learned_friction'](model)])
    q, v, *tau = torch.tensor(np.random.default_rng(2).uniform(-1.0, 1.0, (5, 4, d)))
    with torch.no_grad():
        first, motion = network.momenta(q, v)[0], simulated(
            network, method, q, v, torch.stack(tau), H)
    for i in range(len(q)):
        simulation.restart(q[i].numpy(), first[i].numpy())
        for force, found_q, found_v, found_p in zip(tau, *motion, strict=True):
            simulation.set_command(force[i].numpy())
            simulation.advance(1)
            # States are of the order of one, and both solve to some units of rounding.
            assert np.abs(found_q[i].numpy() - simulation.q).max() < 1e-13
            assert np.abs(found_p[i].numpy() - simulation.p).max() < 1e-13
            assert np.abs(found_v[i].numpy() - simulation.dH_dp).max() < 1e-12


@pytest.mark.parametrize('structure', [*STRUCTURES, 'prior alone', 'spring alone'])
def test_derivatives_that_are_written_out_are_those_of_the_momenta(structure):
    # The forces of a spring do not depend on v, nor its mass on q.
    given = STRUCTURES.get(structure.removesuffix(' alone'), Structure(
        ['prismatic'], [[1.0]], [], prior='harmonic_oscillator'))
    network = random_network(given if structure in STRUCTURES else replace(
        given, residual=False, friction_features=None))
    q, v, tau = torch.tensor(np.random.default_rng(2).uniform(-1.0, 1.0, (3, 5, network.d)))
    at = q.clone().requires_grad_(), v.clone().requires_grad_()
    p, rate = network.momenta(*at, tau)
    slopes = [torch.stack(torch.autograd.grad(part[:, i].sum(), at, retain_graph=True,
                                              materialize_grads=True))
              for part in (p, rate) for i in range(network.d)]
    (p_q, p_v), (rate_q, rate_v) = (
        torch.stack(rows, dim=2) for rows in (slopes[:network.d], slopes[network.d:]))
    # Some ten operations on numbers of up to ten.
    for found, expected in zip(
            network.linearised(q, v, tau), (p, rate, p_v, p_q, rate_q, rate_v), strict=True):
        size = max(1.0, expected.detach().abs().max().item())
        assert (found - expected).abs().max() < 1e-13 * size


@pytest.mark.parametrize('method', [*METHODS])
def test_windows_are_the_same_however_many_nodes_are_solved_at_once(method, monkeypatch):
    network, windows = random_network(STRUCTURES['arm']), Windows(20, method, 0.1)
    samples, rows = samples_of([motion_of(2)], H), torch.arange(0, 40, 4)
    found = []
    for at_once in (1, 100, 10**9):
        monkeypatch.setattr(window_steps, '_AT_ONCE', at_once)
        found.append(loss_and_slopes(network, samples, rows, windows))
    (loss, slopes), *others = found
    for other, other_slopes in others:
        # Both solve to some units of rounding; but the matrices that make the derivatives are
        # those where the last step began, up to 1e-6 of the usual velocity away.
        assert other == pytest.approx(loss, rel=1e-13)
        assert (other_slopes - slopes).norm() < 1e-5 * slopes.norm()


@pytest.mark.parametrize('guess', ['far', 'no number'])
def test_first_guess_does_not_change_what_is_found(guess):
    network = random_network(STRUCTURES['arm'])
    q, v, *tau = torch.tensor(np.random.default_rng(2).uniform(-1.0, 1.0, (12, 4, 2)))
    forces, solutions = torch.stack(tau), Solutions()
    about = torch.zeros_like(forces)
    about[:, 1] = 30.0 if guess == 'far' else torch.nan
    with torch.no_grad():
        expected = simulated(network, 'implicit_midpoint', q, v, forces, H)
        found = simulated(network, 'implicit_midpoint', q, v, forces, H, about, solutions)
    others = [0, 2, 3]
    assert (found.q - expected.q)[:, others].abs().max() < 1e-13
    assert solutions.alone == (guess == 'no number')
    if guess == 'far':
        assert (found.q - expected.q).abs().max() < 1e-13


def loss_and_slopes(network: MechanicalNetwork, samples: Samples, rows: torch.Tensor,
                    windows: Windows) -> tuple[float, torch.Tensor]:
    parameters = [*network.parameters()]
    value = window_loss(network, samples, rows, windows)
    slopes = torch.autograd.grad(value, parameters, materialize_grads=True)
    return value.item(), torch.cat([slope.flatten() for slope in slopes])


@pytest.mark.parametrize('method', [*METHODS])
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
        motion = simulated(self.network, 'implicit_midpoint', q, v, tau.expand(3, *tau.shape), H,
                           solutions=self.solutions)
        return motion.q[-1] + motion.p[-1]


def machine_of(momenta, by_v) -> SimpleNamespace:
    """Return a machine of one coordinate, which its momenta do not depend on."""
    def linearised(q: torch.Tensor, v: torch.Tensor, tau: torch.Tensor) -> Linearised:
        p_v, rate_v = (slope[:, :, None] for slope in by_v(v))
        zero = torch.zeros_like(p_v)
        return Linearised(*momenta(q, v), p_v, zero, zero, rate_v)
    return SimpleNamespace(
        scales=SimpleNamespace(v=np.ones(1), inertia=np.ones(1)),
        momenta=lambda q, v, tau=None: momenta(q, v),
        linearised=linearised, velocities=lambda q, p: p)


def test_friction_that_jumps_is_solved_where_newton_would_go_around():
    # A block of 1 kg, with friction of 0.5 N that is nearly a jump, in steps of 1 s.
    machine = machine_of(
        lambda q, v: (v, -0.5 * torch.tanh(1e3 * v)),
        lambda v: (torch.ones_like(v), -500.0 / torch.cosh(1e3 * v).square()))
    v = torch.linspace(-1.0, 1.0, 41, dtype=torch.float64)[:, None]
    zero, solutions = torch.zeros_like(v), Solutions()
    (w,) = simulated(machine, 'variational_euler', zero, v, zero[None], 1.0,
                     solutions=solutions).p
    assert solutions.alone
    assert (w + 0.5 * torch.tanh(1e3 * w) - v).abs().max() < 1e-12


def test_equation_without_a_solution_is_no_number():
    # v^2 + 1 is a momentum that no force can lower below 1.
    machine = machine_of(lambda q, v: (v.square() + 1.0, torch.zeros_like(v)),
                         lambda v: (2.0 * v, torch.zeros_like(v)))
    v = torch.tensor([[1.0], [2.0], [0.5]], dtype=torch.float64)
    force = torch.tensor([[[-2.0], [-3.0], [-1.0]]], dtype=torch.float64)
    solutions = Solutions()
    (p,) = simulated(machine, 'variational_euler', torch.zeros_like(v), v, force, 1.0,
                     solutions=solutions).p
    assert p.isnan().flatten().tolist() == [True, False, True]
    assert float(p[1, 0]) == pytest.approx(2.0, rel=1e-14)
    assert solutions.alone == 2
