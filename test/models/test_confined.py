# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A confined network: itself in its box, and a wall around it that no motion leaves."""

from pathlib import Path

from ensembles import OSCILLATOR
from helpers import (
    EPS, exact, jacobian, mostly_long, python_step, random_checkpoint, symplectic_defect,
    Uncompiled)
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.files import shipped_file, shipped_names
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.hamiltonians.tao import Tao
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.learning.train import main as train
from hnn_vi_ros.models import (
    Checkpoint, ConfinedHamiltonian, load_checkpoint, load_learned, save_checkpoint)
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import Simulation
from messages import refused
import numpy as np
import pytest
from scene_files import write_scene

MODELS = [name for name in shipped_names('model')
          if load_checkpoint(shipped_file('model', name)).card.family == 'hnn']
STARTS = np.array([[1.5], [2.0], [3.0]])


class BoxedTao(Uncompiled):
    """A formula in place of a network, so that steps can be taken to 60 digits."""

    box = np.array([[-1.0, 1.0]]), np.array([[-0.5, 1.5]])

    def __init__(self):
        super().__init__(Tao())


def geometry(hamiltonian: Hamiltonian) -> tuple[np.ndarray, np.ndarray]:
    """Return the centre and the half-widths of the box, each (2 d,)."""
    low, high = np.concatenate(hamiltonian.box).T
    return 0.5 * (low + high), 0.5 * (high - low)


def confined(name: str) -> ConfinedHamiltonian:
    return load_learned(shipped_file('model', name), True)


def split(z: np.ndarray) -> list[np.ndarray]:
    """Return q and p of states of shape (..., 2 d)."""
    return np.split(z, 2, axis=-1)


def resolved_step(hamiltonian: ConfinedHamiltonian) -> float:
    """Return a tenth of the shortest time scale of the wall, whose phi'' is 5/4 at most."""
    q_half, p_half = split(geometry(hamiltonian)[1])
    return 0.1 / float((1.25 * hamiltonian.energies / (q_half * p_half)).max())


@pytest.mark.parametrize('name', MODELS)
def test_confined_network_is_bit_identical_in_its_box(name: str):
    held = confined(name)
    centre, half = geometry(held)
    z = centre + half * np.random.default_rng(1).uniform(-1.0, 1.0, (200, centre.size))
    z[0] = np.concatenate(held.box)[:, 0]  # a corner belongs to it
    v = np.ones_like(z)
    assert np.array_equal(held.energy(*split(z)), held.base.energy(*split(z)))
    assert np.array_equal(held.gradient(*split(z)), held.base.gradient(*split(z)))
    assert np.array_equal(held.hessian_vector(*split(z), *split(v)),
                          held.base.hessian_vector(*split(z), *split(v)))
    assert np.array_equal(held.box, held.base.box)


@pytest.mark.parametrize('name', MODELS)
def test_confined_derivatives_are_those_of_its_energy_outside_the_box(name: str):
    held = confined(name)
    centre, half = geometry(held)
    rng = np.random.default_rng(2)
    z = centre + half * rng.uniform(1.0, 3.0, (50, centre.size)) * rng.choice([-1, 1], half.size)
    v = half * rng.uniform(-1.0, 1.0, z.shape)
    t = 1e-4

    def central(function, scale):
        ahead, behind = function(*split(z + t * v)), function(*split(z - t * v))
        return (ahead - behind) / (2.0 * t), scale * np.abs(ahead).max() / t

    gradient = np.concatenate(held.gradient(*split(z)), axis=-1)
    product = np.concatenate(held.hessian_vector(*split(z), *split(v)), axis=-1)
    slope, rounding = central(held.energy, 1e3 * EPS)
    # Truncation: t^2 times a third derivative along v, of the size of the first times a number
    # that the network's weights set.
    assert np.abs((gradient * v).sum(axis=1) - slope).max() <= (
        rounding + 1e3 * t**2 * np.abs(slope).max())
    bend, rounding = central(
        lambda q, p: np.concatenate(held.gradient(q, p), axis=-1) * half, 1e3 * EPS)
    assert np.abs(product * half - bend).max() <= rounding + 1e3 * t**2 * np.abs(bend).max()


@pytest.mark.parametrize('name', MODELS)
def test_confined_energy_is_three_times_continuously_differentiable_at_the_faces(name: str):
    """Behind a face the second derivative sets in as 6 y^2 K / w^2, which vanishes with y."""
    held = confined(name)
    centre, half = geometry(held)
    energies = np.tile(held.energies, 2)
    for i, side in np.ndindex(centre.size, 2):
        found = []
        for y in (0.0, 1e-3, 2e-3):
            z, v = centre.copy(), np.zeros_like(centre)
            z[i] += (2 * side - 1) * half[i] * (1.0 + y)
            v[i] = 1.0
            added = (np.concatenate(held.hessian_vector(*split(z), *split(v)))
                     - np.concatenate(held.base.hessian_vector(*split(z), *split(v))))
            found.append(added[i] * half[i]**2 / energies[i])
            assert np.array_equal(np.delete(added, i), np.zeros(centre.size - 1))
        # The next term of phi'' = 6 y^2 - 15 y^4 + ... is 15 y^2 / 6 of the first; the
        # network's own second derivative leaves rounding of its size in the difference.
        np.testing.assert_allclose(found, [0.0, 6e-6, 24e-6], rtol=1e-4, atol=1e-9)


@pytest.mark.parametrize('name', MODELS)
def test_confined_wall_is_convex_and_grows_without_bound(name: str):
    held = confined(name)
    centre, half = geometry(held)
    energies = np.tile(held.energies, 2)
    y = np.concatenate([[0.0], np.geomspace(1e-3, 1e6, 400)])
    for i in range(centre.size):
        z = np.tile(centre, (y.size, 1))
        z[:, i] += half[i] * (1.0 + y)
        wall = held.energy(*split(z)) - held.base.energy(*split(z))
        slopes = np.diff(wall) / np.diff(y)
        assert (np.diff(slopes) >= -1e-9 * energies[i]).all()
        assert wall[-1] == pytest.approx(0.5e12 * energies[i], rel=1e-9)


@pytest.mark.parametrize('method, steps', [('generalized_leapfrog', 100_000), ('gauss8', 10_000)])
@pytest.mark.parametrize('name', mostly_long(MODELS, 'pendulum'))
def test_confined_motion_from_outside_the_box_comes_back_and_stays(name, method, steps, measured):
    """From 1.5, 2 and 3 half-widths in each coordinate, going outward."""
    held = confined(name)
    centre, half = geometry(held)
    d = half.size // 2
    q0 = centre[:d] + STARTS * half[:d]
    p0 = centre[d:] + np.tile(0.5 * half[d:], (3, 1))
    simulation = Simulation(held, INTEGRATORS[method](), resolved_step(held), q0, p0)
    start = held.energy(q0, p0)
    q, p = (part.reshape(-1, 3, d) for part in simulation.record(steps // 10, 10))
    r = np.abs(np.concatenate([q, p], axis=-1) - centre) / half
    assert np.isfinite(r).all()
    measured('a confined state stays near the box: half-widths from its centre',
             f'{name}, {method}', float(r.max()), 'by the energy')
    # The step resolves the wall: its energy error is O(h^2), at (h omega)^2 = 1/100.
    energy = held.energy(q, p)
    assert np.abs(energy - start).max(axis=0).max() <= 0.5 * np.abs(start).max()
    # K phi(y) <= H - b + B with phi(y) >= (y^2 - 1) / 2; see ConfinedHamiltonian.
    network = held.base.checkpoint.networks['energy']
    reach = energy.max(axis=0) - network.biases[-1][0] + np.abs(network.weights[-1]).sum()
    for i, largest in enumerate(r.max(axis=0).T):
        limit = 1.0 + np.sqrt(1.0 + 2.0 * reach / held.energies[i % d])
        assert (largest <= limit).all()
    # Each coordinate comes back through where it started.
    back = r[:, :, :d].min(axis=0) < STARTS
    assert back.all()


@pytest.mark.parametrize('method', ['symplectic_euler', 'generalized_leapfrog', 'gauss4'])
def test_confined_step_outside_the_box_is_symplectic_to_60_digits(method: str):
    held, h = ConfinedHamiltonian(BoxedTao()), 0.05
    integrator = INTEGRATORS[method]()
    for state in ([1.7, 0.3], [-1.4, 2.1], [0.2, -0.9]):
        derivative = jacobian(lambda z: python_step(integrator, held, h, z), exact(state))
        # The differences are exact to 1e-38; see jacobian.
        assert symplectic_defect(derivative) <= 1e-30


def test_confined_hamiltonian_wants_a_box():
    with refused(ValueError):
        ConfinedHamiltonian(Tao())


def test_confined_state_too_far_for_a_double_ends_in_a_failure():
    with refused(StepFailure):
        Simulation(confined('pendulum'), INTEGRATORS['rk4'](), 0.01, [1e200], [0.0])


@pytest.mark.parametrize('in_card', [False, True])
def test_model_card_says_whether_a_scene_confines_unless_the_scene_does(tmp_path, in_card):
    model, shipped = tmp_path / 'model.safetensors', load_checkpoint(
        shipped_file('model', 'pendulum'))
    card = shipped.card.model_copy(update={'confine': in_card})
    save_checkpoint(model, Checkpoint(card, shipped.networks))
    assert load_checkpoint(model).card.confine == in_card
    for text, expected in (('', in_card), (', confine: true', True), (', confine: false', False)):
        scene = write_scene(tmp_path / 'scene.yaml', f'hnn, model: {model}{text}')
        hamiltonian = load_scene(scene).create_hamiltonian()
        assert isinstance(hamiltonian, ConfinedHamiltonian) == expected


def test_training_configuration_with_confine_makes_a_model_that_confines(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path('config.yaml').write_text(
        f'{OSCILLATOR}hidden: [4]\nadam_steps: 2\nlbfgs_steps: 0\nconfine: true\n')
    train(['--config', 'config.yaml', '--out', 'm.safetensors'])
    assert isinstance(load_learned(Path('m.safetensors')), ConfinedHamiltonian)


def test_file_of_a_model_is_analysed_once_until_it_changes(tmp_path):
    file, state = tmp_path / 'm.safetensors', split(np.array([0.3, 0.2]))
    save_checkpoint(file, random_checkpoint([2, 8, 1], seed=1))
    first, second = load_learned(file), load_learned(file)
    assert second is not first and second.checkpoint is first.checkpoint
    assert second.energy(*state) == first.energy(*state)
    # Simulations do not share workspaces.
    assert second.kernel.parameters is not first.kernel.parameters
    file.unlink()
    save_checkpoint(file, random_checkpoint([2, 8, 1], seed=2))
    assert load_learned(file).energy(*state) != first.energy(*state)
