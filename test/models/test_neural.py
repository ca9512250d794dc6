# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The written-out gradient of the network against automatic differentiation by torch."""

from dataclasses import replace

from helpers import EPS, random_checkpoint
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.models import NeuralHamiltonian, TorchHamiltonian
from hnn_vi_ros.models.learned import rounding
from hnn_vi_ros.models.networks.perceptron_memory import MAX_STATES
from hnn_vi_ros.simulation import Simulation
from messages import refused
import numba
import numpy as np
import pytest
import torch

WIDTHS = [[2, 1, 1], [2, 200, 200, 1], [4, 33, 7, 1], [6, 64, 64, 64, 1], [2, 5, 1],
          [20, 5, 1, 9, 1], [2, 16, 300, 20, 1], [2, 600, 600, 1]]


class Sine(torch.nn.Module):
    """The sine of every number."""

    def forward(self, z: torch.Tensor) -> torch.Tensor:
        """Return sin z."""
        return torch.sin(z)


MODULES = {'tanh': torch.nn.Tanh, 'sine': Sine, 'relu': torch.nn.ReLU,
           # torch takes z itself for softplus(z) from a threshold on, at 20 unless told.
           'softplus': lambda: torch.nn.Softplus(threshold=40.0)}
CASES = [('tanh', widths) for widths in WIDTHS] + [
    (activation, widths) for activation in MODULES if activation != 'tanh'
    for widths in ([2, 1, 1], [4, 33, 7, 1], [6, 64, 64, 64, 1], [2, 16, 300, 20, 1])]


def random_hamiltonian(activation: str, widths: list[int], seed: int) -> NeuralHamiltonian:
    checkpoint = random_checkpoint(widths, seed)
    card = checkpoint.card.model_copy(update={'activation': activation})
    return NeuralHamiltonian(replace(checkpoint, card=card))


def as_torch(hamiltonian: NeuralHamiltonian) -> torch.nn.Sequential:
    """Return the same network as a torch module."""
    layers: list[torch.nn.Module] = []
    checkpoint = hamiltonian.checkpoint
    for weight, bias in zip(*checkpoint.networks['energy'], strict=True):
        layer = torch.nn.Linear(weight.shape[1], weight.shape[0], dtype=torch.float64)
        layer.weight.data = torch.from_numpy(weight)
        layer.bias.data = torch.from_numpy(bias)
        layers += [layer, MODULES[checkpoint.card.activation]()]
    return torch.nn.Sequential(*layers[:-1])


@pytest.mark.parametrize('activation, widths', CASES, ids=str)
def test_neural_gradient_and_hessian_vector_agree_with_torch_autograd(
        activation: str, widths: list[int]):
    hamiltonian = random_hamiltonian(activation, widths, seed=sum(widths))
    d, module = hamiltonian.dimension, as_torch(hamiltonian)
    z, v = np.random.default_rng(7).normal(size=(2, 50, 2 * d))
    x = torch.from_numpy(z).requires_grad_(True)
    energy = module(x)
    (slope,) = torch.autograd.grad(energy.sum(), x, create_graph=True)
    (curved,) = torch.autograd.grad(slope, x, torch.from_numpy(v), materialize_grads=True)
    gradient = np.hstack(hamiltonian.gradient(z[:, :d], z[:, d:]))
    assert np.abs(gradient - slope.detach().numpy()).max() <= 1e-12
    difference = hamiltonian.energy(z[:, :d], z[:, d:]) - energy.detach().numpy()[:, 0]
    assert np.abs(difference).max() <= 1e-12
    product = np.hstack(hamiltonian.hessian_vector(z[:, :d], z[:, d:], v[:, :d], v[:, d:]))
    assert np.abs(product - curved.numpy()).max() <= 1e-11


@pytest.mark.parametrize('activation', MODULES)
@pytest.mark.parametrize('n_states', [0, 1, 3, MAX_STATES, 19])
def test_neural_gradient_of_a_batch_is_that_of_its_states(n_states: int, activation: str):
    hamiltonian = random_hamiltonian(activation, [4, 33, 40, 7, 1], seed=9)
    q, p = np.random.default_rng(2).normal(size=(2, n_states, 2))
    batch = np.array(hamiltonian.gradient(q, p))
    for s in range(n_states):
        assert np.abs(batch[:, s] - hamiltonian.gradient(q[s], p[s])).max() <= 1e-14


@pytest.mark.parametrize('activation', MODULES)
def test_neural_gradient_counts_no_references(activation: str):
    hamiltonian = random_hamiltonian(activation, [2, 8, 8, 1], seed=1)

    @numba.njit
    def repeat(gradient, parameters, n, q, p, dH_dq, dH_dp):
        for _ in range(n):
            gradient(parameters, q, p, dH_dq, dH_dp)

    state = [np.zeros(1) for _ in range(4)]
    repeat(hamiltonian.kernel.gradient, hamiltonian.kernel.parameters, 1, *state)
    (code,) = repeat.inspect_llvm().values()
    # A count for every array of every call made a small network take twice as long.
    assert 'NRT_incref' not in code.split('define')[1]


def test_neural_hamiltonian_takes_batches_of_any_shape():
    hamiltonian = NeuralHamiltonian(random_checkpoint([4, 8, 1], seed=3))
    q, p = np.random.default_rng(0).normal(size=(2, 3, 5, 2))
    dH_dq, dH_dp = hamiltonian.gradient(q, p)
    assert dH_dq.shape == dH_dp.shape == (3, 5, 2)
    assert hamiltonian.energy(q, p).shape == (3, 5)
    one = hamiltonian.gradient(q[1, 2], p[1, 2])
    # Many states are columns of matrices, whose sums are in another order.
    assert np.abs(one[0] - dH_dq[1, 2]).max() <= 1e-14
    with refused(ValueError):
        hamiltonian.energy(q[..., :1], p[..., :1])


def test_torch_fallback_says_so_and_gives_the_same_trajectory():
    compiled = NeuralHamiltonian(random_checkpoint([2, 16, 16, 1], seed=5))
    general = TorchHamiltonian(as_torch(compiled), compiled.coordinates)
    runs = []
    for hamiltonian in (compiled, general):
        integrator = INTEGRATORS['variational_euler']()
        if hamiltonian is general:
            with pytest.warns(UserWarning, match='autograd') as caught:
                simulation = Simulation(hamiltonian, integrator, 0.01, [0.3], [0.1])
                runs.append(simulation.record(100, 1))
            assert len(caught) == 1
        else:
            runs.append(Simulation(hamiltonian, integrator, 0.01, [0.3], [0.1]).record(100, 1))
    # Two ways of rounding H_q, h eps apart a step, over 100 steps of a smooth flow.
    assert np.abs(np.array(runs[0]) - np.array(runs[1])).max() <= 100 * 8 * EPS


@pytest.mark.parametrize('activation', MODULES)
def test_neural_gradient_keeps_not_a_number(activation: str):
    hamiltonian = random_hamiltonian(activation, [2, 8, 1], seed=1)
    dH_dq, dH_dp = hamiltonian.gradient(np.array([np.nan]), np.array([0.0]))
    assert np.isnan(dH_dq).all()
    assert np.isnan(dH_dp).all()


@pytest.mark.parametrize('activation', [name for name in MODULES if name != 'relu'])
def test_neural_gradient_scale_bounds_its_rounding_error(activation: str):
    """Of relu, all that is near is rounded in the same way: no two slopes there differ."""
    hamiltonian = random_hamiltonian(activation, [2, 32, 32, 1], seed=6)
    scale = np.array(hamiltonian.kernel.gradient_scale) * EPS
    z = np.random.default_rng(3).uniform(-1.0, 1.0, (200, 2))
    x = torch.from_numpy(z).requires_grad_(True)
    (other,) = torch.autograd.grad(as_torch(hamiltonian)(x).sum(), x)
    difference = np.abs(np.hstack(hamiltonian.gradient(z[:, :1], z[:, 1:])) - other.numpy())
    # Two ways of rounding, each within the scale; it is measured at 64 states, with 4 to spare.
    assert (difference.max(axis=0) <= 2.0 * scale).all()
    assert (scale < 100.0 * EPS).all()


def test_rounding_is_measured_whatever_the_slope_and_the_unit():
    """The sum with 3000 rounds by 2^-42 at most: 1024 unit round-offs."""
    z = np.random.default_rng(4).uniform(-1.0, 1.0, (100, 2)) * [1.0, 1e6]
    (found,) = rounding(lambda z: 7.0 * z[:, :1] + ((z[:, :1] + 3000.0) - 3000.0), z)
    # A second difference has one to four such errors at the worst of 100 states; it is doubled.
    assert 2.0 * 1024.0 <= found <= 8.0 * 1024.0 + 100.0


def test_relu_network_is_not_smooth_and_says_so_once():
    hamiltonian = random_hamiltonian('relu', [2, 8, 1], seed=1)
    with pytest.warns(UserWarning, match='gradient of H is discontinuous') as caught:
        Simulation(hamiltonian, INTEGRATORS['variational_euler'](), 0.01, [0.3], [0.1])
    assert len(caught) == 1
    for activation in ('tanh', 'sine', 'softplus'):
        assert random_hamiltonian(activation, [2, 8, 1], seed=1).smooth


@pytest.mark.parametrize('activation', ['sine', 'softplus'])
def test_networks_of_every_smooth_activation_are_simulated(activation: str):
    hamiltonian = random_hamiltonian(activation, [2, 16, 16, 1], seed=5)
    simulation = Simulation(hamiltonian, INTEGRATORS['gauss4'](), 0.01, [0.3], [0.1])
    before = simulation.energy
    simulation.advance(200)
    # Order 4: (0.01)^4 times derivatives of order one.
    assert abs(simulation.energy - before) < 1e-8


def test_copies_of_a_network_have_the_rounding_that_was_measured_once(monkeypatch):
    hamiltonian = random_hamiltonian('tanh', [2, 8, 1], seed=2)
    assert hamiltonian.kernel.compiled
    other = hamiltonian.copy()
    monkeypatch.delattr('hnn_vi_ros.models.learned.rounding')
    assert other.kernel is not hamiltonian.kernel
    assert (other.kernel.gradient_scale, other.kernel.energy_scale) == (
        hamiltonian.kernel.gradient_scale, hamiltonian.kernel.energy_scale)
