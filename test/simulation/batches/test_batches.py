# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Ensembles in torch against the compiled loops: states, failures, fallbacks, the last bits."""

from pathlib import Path

from batch_scenes import random_network
from helpers import EPS
from hnn_vi_ros.errors import ParameterError, StepFailure, UnsupportedSystem
from hnn_vi_ros.models import Checkpoint, ConfinedHamiltonian, load_checkpoint, NeuralHamiltonian
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import BatchSimulation, open_device, simulate_many, Simulation
from hnn_vi_ros.simulation.batches.gradient import captured, make_gradient
from messages import refused
import numpy as np
import pytest

torch = pytest.importorskip('torch', reason='torch is not installed')
CPU = torch.device('cpu')
METHODS = ['variational_euler', 'generalized_leapfrog', 'implicit_midpoint', 'gauss4', 'gauss6',
           'gauss8']


def ensemble_of(scene: Scene) -> BatchSimulation:
    return BatchSimulation(scene.create_hamiltonian(), scene.create_integrator(),
                           scene.known_step_size, [], scene.on_failure, 'cpu')


def states_of(scene: Scene, m: int, share: float = 0.6) -> np.ndarray:
    """Return q and p, shape (2, m, d), from the middle of the training box."""
    low, high = share * np.array(scene.create_hamiltonian().box).reshape(2, -1, 2).transpose(
        2, 0, 1)
    shape = (m, *low.shape)
    return np.random.default_rng(0).uniform(low, high, shape).transpose(1, 0, 2)


@pytest.mark.parametrize('activation', ['tanh', 'sine', 'softplus', 'relu'])
def test_gradient_is_that_of_the_compiled_loops(activation):
    """Each of the sums of a layer is of at most 64 terms."""
    checkpoint = load_checkpoint(Path('resource/models/double_pendulum.safetensors'))
    card = checkpoint.card.model_copy(update={'activation': activation})
    compiled = NeuralHamiltonian(Checkpoint(card, checkpoint.networks))
    z = np.random.default_rng(1).uniform(-3.0, 3.0, (4, 1500))
    found = make_gradient(compiled, CPU)(torch.from_numpy(z)).numpy()
    expected = np.hstack(compiled.gradient(*np.hsplit(z.T, 2))).T
    # Rounding of 64 terms in each of 6 products, of numbers of the size of the largest, twice.
    assert np.abs(found - expected).max() <= 2 * 6 * 64 * EPS * np.abs(expected).max()
    not_numbers = torch.full((4, 2), torch.nan, dtype=torch.float64)
    assert make_gradient(compiled, CPU)(not_numbers).isnan().all()


def test_gradient_with_walls_and_of_networks_of_q_and_p_is_that_of_the_compiled_loops():
    walled = ConfinedHamiltonian(load_scene('double_pendulum').create_hamiltonian())
    others = [load_scene(f'{name}_pendulum').create_hamiltonian()
              for name in ('separable', 'variational')]
    for hamiltonian in (walled, *others):
        d = hamiltonian.dimension
        bounds = np.concatenate(hamiltonian.box)
        z = np.random.default_rng(1).uniform(1.5 * bounds[:, :1], 1.5 * bounds[:, 1:], (2 * d, 99))
        found = make_gradient(hamiltonian, CPU)(torch.from_numpy(z)).numpy()
        expected = np.hstack(hamiltonian.gradient(z[:d].T, z[d:].T)).T
        assert np.abs(found - expected).max() <= 6 * 64 * EPS * np.abs(expected).max()


@pytest.mark.parametrize('columns', [1, 8, 191, 500, 1100])
def test_gradient_of_a_state_does_not_depend_on_the_others(columns):
    gradient = make_gradient(load_scene('pendulum').create_hamiltonian(), CPU)
    z = torch.from_numpy(np.random.default_rng(2).uniform(-2.0, 2.0, (2, 2000)))
    assert torch.equal(gradient(z)[:, columns:], gradient(z[:, columns:]))


@pytest.mark.parametrize('name, h, method', [
    *(('pendulum', 0.02, method) for method in METHODS), ('double_pendulum', 0.01, 'gauss4'),
    ('double_pendulum', 0.01, 'variational_euler')])
def test_steps_are_those_of_the_compiled_loops(name, h, method):
    """Both solve to 16 s eps of the scale, of numbers up to 8, and carry what is rounded off."""
    scene = load_scene(name).with_overrides(h, method)
    q, p = states_of(scene, 40)
    found = ensemble_of(scene).record(q, p, [1, 10])
    assert not found.failures and not found.counts.rescued.any()
    d = scene.create_hamiltonian().dimension
    for i in (0, 7, 39):
        alone = Simulation(scene.create_hamiltonian(), scene.create_integrator(), h, q[i], p[i])
        for steps, q_found, p_found in zip((1, 10), found.q, found.p, strict=True):
            alone.advance(steps - alone.steps)
            tolerance = 1e-13 * steps
            assert max(8, 8 * d) * EPS * 8.0 <= 1e-13
            assert np.abs(alone.q - q_found[i]).max() <= tolerance
            assert np.abs(alone.p - p_found[i]).max() <= tolerance


@pytest.mark.parametrize('method', ['variational_euler', 'gauss6'])
def test_trajectories_are_the_same_bits_in_any_order_and_company(method):
    scene = load_scene('pendulum').with_overrides(0.1, method)
    q, p = states_of(scene, 700)
    ensemble = ensemble_of(scene)
    whole = ensemble.record(q, p, [5])
    order = np.random.default_rng(3).permutation(700)
    for chosen in (order, order[:1], order[:193], np.arange(690, 700)):
        part = ensemble.record(q[chosen], p[chosen], [5])
        assert np.array_equal(part.q[0], whole.q[0, chosen])
        assert np.array_equal(part.p[0], whole.p[0, chosen])
        assert np.array_equal(part.counts.costliest, whole.counts.costliest[chosen])


@pytest.mark.filterwarnings('ignore')
@pytest.mark.parametrize('on_failure', ['substep', 'stop'])
def test_steps_that_are_hard_are_taken_and_fail_as_in_the_compiled_loops(tmp_path, on_failure):
    """Newton's method, continuation and sub-steps take them; where none does, both fail."""
    scene = random_network(tmp_path, 4.0).changed({'on_failure': on_failure})
    q, p = np.random.default_rng(5).uniform(-1.0, 1.0, (2, 60, 1))
    found = ensemble_of(scene).record(q, p, [0, 1, 2])
    assert np.array_equal(found.q[0], q)
    failed, (rescued, several) = {}, np.zeros((2, 60), dtype=int)
    for i in range(60):
        try:
            alone = Simulation(scene.create_hamiltonian(), scene.create_integrator(), 0.1, q[i],
                               p[i], on_failure=scene.on_failure)
            alone.advance(2)
        except StepFailure as failure:
            failed[i] = failure
            continue
        rescued[i], several[i] = alone.rescued, alone.several_solutions
        # Two steps of up to 1e-13, which such a network stretches.
        assert np.abs(alone.q - found.q[2, i]).max() <= 1e-10
        assert np.abs(alone.p - found.p[2, i]).max() <= 1e-10
    assert {i: (one.reason, one.t) for i, one in failed.items()} == {
        i: (one.reason, one.t) for i, one in found.failures.items()}
    assert np.isnan(found.q[-1, list(failed)]).all()
    # Those of steps before the one that failed are counted as well.
    taken = [i for i in range(60) if i not in failed]
    assert found.counts.several_solutions[taken].tolist() == several[taken].tolist()
    assert found.counts.rescued[taken].tolist() == rescued[taken].tolist()
    # The costliest step has a number, also where the compiled loops took it.
    assert set(found.counts.at.tolist()) == {1, 2}
    assert several.any() and (rescued.any() if on_failure == 'substep' else len(failed) > 5)


def test_simulate_many_takes_its_steps_on_a_device():
    scene = load_scene('pendulum')
    q, p = states_of(scene, 50)
    plain = simulate_many(scene, q, p, 0.2, samples=2)
    found = simulate_many(scene, q, p, 0.2, samples=2, threads=2, device='cpu')
    assert found.q.shape == (3, 50, 1) and np.array_equal(found.t, plain.t)
    assert np.abs(found.q - plain.q).max() <= 20 * 1e-13
    assert np.abs(found.energy - plain.energy).max() <= 20 * 1e-12


@pytest.mark.filterwarnings('ignore')
def test_what_the_guards_say_of_steps_is_said_of_each_trajectory(tmp_path):
    scene = random_network(tmp_path, 4.0)
    q, p = np.random.default_rng(5).uniform(-1.0, 1.0, (2, 60, 1))
    _, _, failures, counts = ensemble_of(scene).record(q, p, [2])
    good = [i for i in range(60) if i not in failures]
    many = simulate_many(scene, q[good], p[good], 0.2, device='cpu')
    told = [any(alarm.kind == 'several solutions' for alarm in own) for own in many.alarms]
    assert told == (counts.several_solutions[good] > 0).tolist() and any(told)


def test_what_no_device_takes_is_refused_with_what_is_possible():
    state = [[0.1]], [[0.1]]
    with refused(UnsupportedSystem):
        simulate_many('exact_pendulum', *state, 0.2, device='cpu')
    with refused(UnsupportedSystem):
        simulate_many('damped_driven_pendulum', *state, 0.2, device='cpu')
    with refused(UnsupportedSystem):
        simulate_many(load_scene('pendulum').with_overrides(integrator='rk4'), *state, 0.2,
                      device='cpu')
    with refused(ValueError):
        simulate_many('pendulum', *state, 0.2, samples=3, device='cpu')
    for name in ('tpu', 'cuda:', 'cuda:x', 'cpu:0', ''):
        with refused(ValueError):
            open_device(name)


def test_gpu_that_is_not_there_is_one_line(monkeypatch):
    monkeypatch.setattr(torch.cuda, 'is_available', lambda: False)
    with refused(ParameterError) as problem:
        open_device('cuda')
    assert '\n' not in str(problem.value)


def test_graphs_are_for_a_gpu_alone(monkeypatch):
    monkeypatch.setattr(torch, 'cuda', None)
    ran = []
    captured(lambda: ran.append(1), CPU)()
    assert ran == [1]
