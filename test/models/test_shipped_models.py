# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Shipped models: each has the field of the system that its training configuration names."""

from hnn_vi_ros.files import shipped_file, shipped_names
from hnn_vi_ros.learning.data.dataset import Dataset, sample_exact
from hnn_vi_ros.learning.fit.config import find_config, load_config
from hnn_vi_ros.models import load_checkpoint, NeuralHamiltonian
from hnn_vi_ros.scene import load_scene
import numpy as np
import pytest
from scipy.integrate import solve_ivp

# Of real machines there is no exact system; see test_shipped_machines.
CARDS = {name: card for name in shipped_names('model') if (
    card := load_checkpoint(shipped_file('model', name)).card).family not in (
        'mechanical', 'lie_group')}
# Those that have learned the field of the exact system; of the others see test_shipped_families.
MODELS = [name for name, card in CARDS.items() if card.family == 'hnn' and card.scheme is None]


def independent_sample(name: str) -> Dataset:
    """Draw states evenly from the box that the model was trained in, but not those it saw."""
    config = load_config(find_config(name))
    data = config.data.model_copy(update={'samples': 50_000, 'edge_share': 0.0})
    return sample_exact(data, config.seed + 1)


@pytest.mark.parametrize('name', MODELS)
def test_shipped_model_has_the_exact_field_within_one_in_a_thousand(name: str):
    learned = NeuralHamiltonian(load_checkpoint(shipped_file('model', name)))
    sample = independent_sample(name)
    dH_dq, dH_dp = learned.gradient(sample.q, sample.p)
    exact = np.hstack([sample.dq_dt, sample.dp_dt])
    errors = np.hstack([dH_dp, -dH_dq]) - exact
    assert np.sqrt(np.mean(errors**2)) <= 1e-3 * np.sqrt(np.mean(exact**2))
    # No worse in any one rate than three times that: none is drowned by a larger one.
    by_rate = np.sqrt(np.mean(errors**2, axis=0) / np.mean(exact**2, axis=0))
    assert by_rate.max() <= 3e-3


@pytest.mark.parametrize('name', MODELS)
def test_shipped_model_has_the_exact_energy_up_to_its_field_error(name: str):
    config = load_config(find_config(name))
    learned = NeuralHamiltonian(load_checkpoint(shipped_file('model', name)))
    exact = config.data.hamiltonian.create()
    sample = independent_sample(name)
    energy = exact.energy(sample.q, sample.p)
    errors = learned.energy(sample.q, sample.p) - energy
    # The gradient's relative error of one in a thousand, along the way from the zero of energy,
    # which is that of the configuration's reference or of the middle of the data.
    states, slopes = np.hstack([sample.q, sample.p]), np.hstack([sample.dp_dt, sample.dq_dt])
    way = np.sqrt(((states - states.mean(axis=0)) ** 2).sum(axis=1).mean())
    assert np.abs(errors).max() <= 1e-3 * way * np.sqrt((slopes ** 2).sum(axis=1).mean())


@pytest.mark.parametrize('name', CARDS)
def test_shipped_model_is_small_and_says_how_it_was_made(name: str):
    path = shipped_file('model', name)
    card, config = load_checkpoint(path).card, load_config(find_config(name))
    assert path.stat().st_size < 300_000
    assert card.training_command == f'ros2 run hnn_vi_ros train --config {name}'
    assert (card.name, card.seed) == (name, config.seed)
    assert card.family == config.family.kind and card.scheme == config.loss.scheme
    assert all(widths[1:-1] == config.hidden for widths in card.layout.values())
    assert card.coordinates == config.coordinates
    exact = config.data.hamiltonian.create()
    for own, other in zip(card.coordinates, exact.coordinates, strict=True):
        momentum = f'{own.q_unit}/s' if config.data.velocities else other.p_unit
        assert (own.name, own.q_unit, own.p_unit) == (other.name, other.q_unit, momentum)
    if name not in MODELS:
        return  # drawn along motions that leave the box they begin in, or with other momenta
    drawn = np.array([*config.data.box.q, *config.data.box.p])
    learned = np.array([*card.box.q, *card.box.p])
    assert (drawn[:, 0] <= learned[:, 0]).all() and (learned[:, 1] <= drawn[:, 1]).all()


def test_double_pendulum_box_holds_every_state_up_to_its_energy():
    """Up to 12.6 J, as its configuration says: no motion below that leaves the box."""
    config = load_config(find_config('double_pendulum'))
    exact = config.data.hamiltonian.create()
    box = np.array([*config.data.box.q, *config.data.box.p])
    rng = np.random.default_rng(0)
    z = box.mean(axis=1) + 0.6 * np.ptp(box, axis=1) * rng.uniform(-1.0, 1.0, (1_000_000, 4))
    low = z[exact.energy(z[:, :2], z[:, 2:]) <= 12.6]
    assert ((box[:, 0] < low) & (low < box[:, 1])).all()
    # And it is not much larger: they come close to each side.
    assert (np.abs(low).max(axis=0) > 0.9 * box[:, 1]).all()


@pytest.mark.parametrize('name', CARDS)
def test_shipped_scene_stays_in_the_box_of_its_model(name: str):
    # Where the plain name is that of the exact scene, the learned one says so.
    scene = load_scene(f'learned_{name}' if f'learned_{name}' in shipped_names('scene') else name)
    learned = scene.create_hamiltonian()
    d = learned.dimension

    def field(t: float, z: np.ndarray) -> np.ndarray:
        dH_dq, dH_dp = learned.gradient(z[:d], z[d:])
        return np.concatenate([dH_dp, -dH_dq])

    start = [*scene.initial_state.q, *scene.initial_state.p]
    run = solve_ivp(field, (0.0, 60.0), start, method='DOP853', rtol=1e-8, atol=1e-8)
    assert run.success
    low, high = np.vstack(learned.box).T
    assert (low <= run.y.T).all() and (run.y.T <= high).all()
