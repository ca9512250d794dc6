# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Steps of variational methods in torch, and the losses of windows and of whole motions."""

from dataclasses import replace
from itertools import product
from types import SimpleNamespace

from helpers import long
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.learning.data.motions import EvenMotion, smoothed
from hnn_vi_ros.learning.families.choices import FrictionChoice, Structure
from hnn_vi_ros.learning.families.mechanical import Linearised, MechanicalNetwork
from hnn_vi_ros.learning.fit import steps as window_steps
from hnn_vi_ros.learning.fit.loop import trained, TrainingProblem
from hnn_vi_ros.learning.fit.machine import (
    Samples, samples_of, scales_of, window_loss, WindowSettings)
from hnn_vi_ros.learning.fit.machine_fit import fit_machine, Records
from hnn_vi_ros.learning.fit.steps import METHODS, simulated, Solutions
from hnn_vi_ros.simulation import Simulation
from machines import compiled, machine_config, shaken, slopes_along
import numpy as np
import pytest
from scipy.integrate import solve_ivp
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


def motion_of(d: int) -> EvenMotion:
    rates = np.random.default_rng(0).uniform(1.0, 5.0, (2, d))
    t = H * np.arange(60)[:, None]
    return smoothed('random', t[:, 0], np.sin(rates[0] * t), rates[0] * np.cos(rates[0] * t),
                    np.sin(rates[1] * t), 40.0)


def random_network(structure: Structure) -> MechanicalNetwork:
    return shaken(MechanicalNetwork(
        structure, [6, 5], scales_of([motion_of(len(structure.kinds))]), 3))


STAY = [*((method, 'arm') for method in METHODS), ('implicit_midpoint', 'three')]


@pytest.mark.parametrize('method, structure', [
    *STAY, *(long(*pair) for pair in product(METHODS, STRUCTURES) if pair not in STAY)])
def test_steps_in_torch_are_those_of_the_compiled_methods(tmp_path, method, structure):
    network = random_network(STRUCTURES[structure])
    d = network.d
    hamiltonian, model = compiled(network, [motion_of(d)], tmp_path)
    simulation = Simulation(
        hamiltonian, INTEGRATORS[method](), H, np.zeros(d), np.zeros(d),
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


@pytest.mark.parametrize('method', [*METHODS])
def test_windows_are_the_same_however_many_nodes_are_solved_at_once(method, monkeypatch):
    network, windows = random_network(STRUCTURES['arm']), WindowSettings(20, method)
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
                    windows: WindowSettings) -> tuple[float, torch.Tensor]:
    parameters = [*network.parameters()]
    value = window_loss(network, samples, rows, windows)
    slopes = torch.autograd.grad(value, parameters, materialize_grads=True)
    return value.item(), torch.cat([slope.flatten() for slope in slopes])


@pytest.mark.parametrize('method, structure', [
    *((method, 'arm') for method in METHODS), *(('implicit_midpoint', name) for name in STRUCTURES
                                                if name != 'arm')])
def test_derivatives_of_windows_are_those_of_their_loss(method, structure):
    network = random_network(STRUCTURES[structure])
    samples, rows = samples_of([motion_of(network.d)], H), torch.arange(0, 40, 4)
    windows = WindowSettings(5, method)
    found, expected = slopes_along(lambda: window_loss(network, samples, rows, windows),
                                   [*filter(lambda one: one.requires_grad, network.parameters())],
                                   2e-4)
    # A difference of order 6, whose rounding is some 1e-15 over its step.
    assert found == pytest.approx(expected, rel=1e-8)


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


T = 0.02 * np.arange(301)
CONFIG = machine_config(more={'hidden': [8], 'loss': {
    'kind': 'trajectory', 'forward_steps': 100, 'forward_lbfgs_steps': 100, 'step_size': 0.04,
    'batch': 32, 'windows': [{'duration': 0.2, 'steps': 20}]}},
    mass='constant', friction={'coulomb': 1, 'network': True})


def pendulum(seed: int) -> EvenMotion:
    """Return 6 s of a driven pendulum with friction, every 20 ms."""
    rates, phases = np.random.default_rng(seed).uniform(0.5, 4.0, (2, 3))
    tau = np.sin(T[:, None] * rates + phases).sum(axis=1)

    def rate(t: float, z: np.ndarray) -> list[float]:
        return [z[1], np.interp(t, T, tau) - 4.0 * np.sin(z[0]) - 0.4 * z[1]]
    z = solve_ivp(rate, (0.0, T[-1]), [0.5, 0.0], t_eval=T, rtol=1e-9, atol=1e-9).y.T
    return smoothed(f'run{seed}', T, *np.hsplit(z, 2), tau[:, None], 20.0)


@pytest.fixture(scope='module')
def records() -> tuple[MechanicalNetwork, Records]:
    motions = [pendulum(1), pendulum(2)]
    return fit_machine(CONFIG, motions).module, Records(CONFIG, motions)


@pytest.mark.parametrize('steps', [40, long(1000)])
def test_gradient_of_motions_is_that_of_differences(records, steps: int):
    network, loss = records
    parts = [part for name, part in network.named_parameters() if 'linears' in name]
    found, expected = slopes_along(lambda: loss.loss(network, steps), parts, 1e-3)
    # What order 6 cuts off is below 1e-11 here; second derivatives of forces are differences.
    assert found == pytest.approx(expected, rel=1e-8)


@pytest.mark.long
def test_whole_motions_improve_and_end_no_worse(records):
    network, loss = records
    fitted = trained(TrainingProblem(network, loss.stages()))
    assert [*fitted.losses] == ['records_0.25', 'records_0.5', 'records_1']
    # Windows of 0.2 s leave small errors of forces, which 6 s add up: 1.0e-5, then 9e-8.
    assert loss.whole(fitted.module) < 0.1 * loss.whole(network)
    # A stage that finds nothing better leaves the weights as they were.
    away = replace(loss.stages()[0], begin=lambda network, _: lambda: sum(
        part.square().sum() for part in network.tensors().values()))
    after = trained(TrainingProblem(fitted.module, [away])).module.state_dict()
    assert all(torch.equal(part, after[name])
               for name, part in fitted.module.state_dict().items())
