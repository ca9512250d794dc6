# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Training: the network, reproducibility, the shipped model, and a model of a real log."""

import os
from pathlib import Path
import time

from hnn_vi_ros import load_scene, simulate
from hnn_vi_ros.errors import DataError, HnnViRosError, ParameterError
from hnn_vi_ros.files.resources import shipped_file, shipped_names
from hnn_vi_ros.learning.families.base import Perceptron, Scales
from hnn_vi_ros.learning.families.choices import HNNChoice
from hnn_vi_ros.learning.families.hnn import HNN
from hnn_vi_ros.learning.fit.config import find_config, load_config
from hnn_vi_ros.learning.tasks.field import mean_square, nonlinearity
from hnn_vi_ros.learning.train import main
from hnn_vi_ros.models.checkpoint import load_checkpoint
from hnn_vi_ros.models.neural import NeuralHamiltonian
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
import torch

ROOT = Path(__file__).resolve().parents[2]
AIR_TRACK_LOG = Path(os.environ.get('HNN_VI_ROS_AIR_TRACK_LOG') or (
    ROOT.parent / 'shared' / 'data' / 'schmidt_lipson_2009' / 'real_linear_h_1.txt'))

TINY = """
coordinates: [{name: x, q_unit: m, p_unit: kg m/s}]
data:
  kind: exact
  hamiltonian: {kind: harmonic_oscillator}
  box: {q: [[-1.0, 3.0]], p: [[-2.0, 2.0]]}
  samples: 60
hidden: [8, 5]
adam_steps: 40
lbfgs_steps: 40
linearity: 0.01
"""


def unscaled_hnn(d: int) -> HNN:
    """Return a network of d coordinates and five hidden units whose data are of order one."""
    zero, one = np.zeros(d), np.ones(d)
    return HNN(HNNChoice(kind='hnn'), [5], Scales(*3 * [zero], *5 * [one], zero), seed=3)


def tiny_config(folder: Path, more: str = '') -> str:
    path = folder / 'tiny.yaml'
    path.write_text(TINY + more)
    return str(path)


def grid(box, points: int = 61) -> tuple[np.ndarray, np.ndarray]:
    """Return q and p, shape (points^2, 1), of an even grid over the box of one coordinate."""
    axes = [np.linspace(*bounds[0], points) for bounds in box]
    q, p = np.meshgrid(*axes)
    return q.reshape(-1, 1), p.reshape(-1, 1)


def assert_is_the_oscillator(path: Path) -> None:
    hamiltonian = NeuralHamiltonian(load_checkpoint(path))
    q, p = grid(hamiltonian.box)
    assert np.abs(np.abs(hamiltonian.box) - 2.0).max() < 0.02  # 1000 uniform samples of [-2, 2]
    dH_dq, dH_dp = hamiltonian.gradient(q, p)
    errors = np.hstack([dH_dp - p, -dH_dq + q])
    assert np.sqrt(np.mean(errors**2)) < 1e-4  # the promise is 1e-3
    # H is zero in the centre of the box, at most 0.02 from the origin, where it is below 4e-4;
    # elsewhere it errs by at most the path, 2 sqrt(2), times the largest field error, below 1e-3.
    assert np.abs(errors).max() < 1e-3
    energy_errors = hamiltonian.energy(q, p) - 0.5 * (q[:, 0]**2 + p[:, 0]**2)
    assert np.abs(energy_errors).max() < 4e-4 + 2.0 * np.sqrt(2.0) * 1e-3


def test_shipped_harmonic_oscillator_has_the_field_of_the_exact_one():
    assert_is_the_oscillator(shipped_file('model', 'harmonic_oscillator'))


def test_shipped_model_card_says_how_it_was_made():
    card = load_checkpoint(shipped_file('model', 'harmonic_oscillator')).card
    config = load_config(find_config('harmonic_oscillator'))
    assert card.training_command == 'ros2 run hnn_vi_ros train --config harmonic_oscillator'
    assert (card.name, card.seed) == ('harmonic_oscillator', config.seed)
    assert card.widths == [2, *config.hidden, 1]
    assert card.coordinates == config.coordinates
    assert card.losses['field_rms'] < 1e-4


@pytest.mark.timeout(300)
def test_harmonic_oscillator_trains_anew_in_two_minutes_of_cpu_time(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    # Of this process alone; others may keep the machine busy.
    start = time.process_time()
    main(['--config', 'harmonic_oscillator'])
    assert time.process_time() - start < 120.0
    printed = capsys.readouterr().out
    assert 'models/harmonic_oscillator.safetensors' in printed
    assert 'trained in' in printed
    curve = tmp_path / 'models' / 'harmonic_oscillator.loss.png'
    assert curve.read_bytes().startswith(b'\x89PNG')
    assert_is_the_oscillator(tmp_path / 'models' / 'harmonic_oscillator.safetensors')


def test_training_is_bit_reproducible_by_seed(tmp_path):
    config = tiny_config(tmp_path)
    weights = []
    for i, seed in enumerate(('4', '4', '5')):
        out = tmp_path / f'{i}.safetensors'
        main(['--config', config, '--seed', seed, '--out', str(out)])
        checkpoint = load_checkpoint(out)
        assert checkpoint.card.seed == int(seed)
        weights.append(b''.join(
            part.tobytes() for parts in checkpoint.networks['energy'] for part in parts))
    assert weights[0] == weights[1]
    assert weights[0] != weights[2]


def test_longer_history_brings_lbfgs_further_in_as_many_steps(tmp_path):
    losses = []
    for history in (2, 100):
        folder = tmp_path / str(history)
        folder.mkdir()
        config = tiny_config(folder, f'lbfgs_history: {history}\n')
        text = Path(config).read_text().replace('lbfgs_steps: 40', 'lbfgs_steps: 400')
        Path(config).write_text(text.replace('linearity: 0.01\n', ''))
        main(['--config', config, '--out', str(folder / 'm.safetensors')])
        losses.append(load_checkpoint(folder / 'm.safetensors').card.losses['train_loss'])
    assert losses[1] < 0.5 * losses[0]  # a fifth, with this seed


def test_exported_layers_are_the_network_with_its_energy_set(tmp_path):
    network = Perceptron([7, 6], np.array([50.0, 3.0, -2.0, 0.0]),
                         np.array([9.0, 0.1, 4.0, 1.0]), np.array([250.0]), seed=1)
    z0, energy0 = np.array([45.0, 3.1, 0.0, 0.5]), -3.0
    weights, biases = network.layers(z0, energy0)
    z = network.centre.numpy() + network.scale.numpy() * np.random.default_rng(2).uniform(
        -1.0, 1.0, (20, 4))
    a = np.vstack([z, z0])
    for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
        a = np.tanh(a @ weight.T + bias)
    energies = (a @ weights[-1].T + biases[-1])[:, 0]
    exact = network(torch.tensor(np.vstack([z, z0]))).detach().numpy()[:, 0]
    # Round-off of terms of size energy_scale, and of inputs that lie 500 scales from zero.
    assert np.allclose(energies - energies[-1], exact - exact[-1], rtol=0.0, atol=250.0 * 1e-12)
    assert energies[-1] == pytest.approx(energy0, abs=250.0 * 1e-15)


def test_vector_field_is_the_symplectic_gradient_of_the_energy():
    network = unscaled_hnn(2)
    z = torch.tensor(np.random.default_rng(4).normal(size=(6, 4)))
    field = network.vector_field(z).detach()
    step = 1e-5
    for i, (row, sign) in enumerate(((2, -1), (3, -1), (0, 1), (1, 1))):
        shift = step * torch.eye(4, dtype=torch.float64)[i]
        slope = (network.energy(z + shift) - network.energy(z - shift)).detach() / (2.0 * step)
        # Central differences: truncation step^2, round-off 1e-16 / step.
        assert torch.allclose(field[:, row], sign * slope, rtol=0.0, atol=1e-9)


def test_losses_vanish_exactly_where_they_should():
    network = unscaled_hnn(1)
    z = torch.tensor(np.random.default_rng(4).normal(size=(6, 2)))
    unit = torch.ones(2, dtype=torch.float64)
    field = network.vector_field(z).detach()
    assert mean_square(network.vector_field(z) - field, unit).item() == 0.0
    errors = network.vector_field(z) - (field + 2.0)
    assert mean_square(errors, 2.0 * unit).item() == pytest.approx(1.0)
    assert nonlinearity(network, z, z, unit).item() == 0.0
    assert nonlinearity(network, z, z.flip(0), unit).item() > 0.0


def test_reference_sets_the_zero_of_the_energy_and_the_box_is_that_of_the_data(tmp_path):
    config = tiny_config(tmp_path, 'reference: {q: [1.0], p: [0.5], energy: 0.625}\n')
    out = tmp_path / 'm.safetensors'
    main(['--config', config, '--out', str(out)])
    hamiltonian = NeuralHamiltonian(load_checkpoint(out))
    assert hamiltonian.energy(np.array([1.0]), np.array([0.5])) == pytest.approx(0.625, abs=1e-12)
    bounds = np.vstack(hamiltonian.box)
    # The bounds of 60 uniform samples: inside the box, and close to it.
    assert np.abs(bounds - [[-1.0, 3.0], [-2.0, 2.0]]).max() < 0.5
    assert (np.abs(bounds - [[1.0], [0.0]]) <= 2.0).all()


def test_existing_files_are_never_overwritten(tmp_path):
    config = tiny_config(tmp_path)
    for name in ('m.safetensors', 'm.loss.png', 'm.loss.rrd', 'm.field.png', 'm.report.md'):
        existing = tmp_path / name
        existing.write_text('precious')
        with pytest.raises(ParameterError, match=f'--out .*/{name}: exists already'):
            main(['--config', config, '--out', str(tmp_path / 'm.safetensors')])
        assert existing.read_text() == 'precious'
        existing.unlink()


@pytest.mark.parametrize('argv, words', [
    (['--config', 'none'], '; shipped: '),
    (['--config', 'none.yaml'], 'none.yaml: no such file; give the path of a training '
     'configuration, or the name of a shipped one: air_track, '),
    (['--config', 'air_track'], 'data.path is empty; pass the file with --data FILE, which is '
     'real_linear_h_1.txt of the supplement of Schmidt and Lipson'),
    (['--config', 'air_track', '--data', 'none.txt'], 'none.txt: no such data file'),
    (['--config', 'harmonic_oscillator', '--data', 'log.txt'], 'its data is exact'),
    (['--config', 'harmonic_oscillator', '--seed', '-1'], '--seed -1: expected'),
    (['--config', 'harmonic_oscillator', '--out', 'model.pt'], 'must end in .safetensors'),
    (['--config', 'harmonic_oscillator', '--out', 'file/m.safetensors'], 'cannot be written'),
])
def test_unusable_argument_gives_one_line_that_says_what_to_do(
        tmp_path, monkeypatch, argv, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'file').write_text('')
    with pytest.raises(HnnViRosError) as caught:
        main(argv)
    assert words in str(caught.value)
    assert '\n' not in str(caught.value)


def test_diverging_training_gives_data_error(tmp_path):
    config = tiny_config(tmp_path)
    text = TINY.replace('[[-1.0, 3.0]]', '[[-1.0e160, 1.0e160]]')
    Path(config).write_text(text)
    with pytest.raises(DataError, match='the loss is'):
        main(['--config', config, '--out', str(tmp_path / 'm.safetensors')])
    assert not (tmp_path / 'm.safetensors').exists()


@pytest.mark.parametrize('name', shipped_names('training'))
def test_shipped_training_configuration_is_valid(name):
    path = find_config(name)
    assert load_config(path).family.kind


@given(start=st.integers(0, len(TINY)), length=st.integers(0, 20),
       replacement=st.text(max_size=10))
@settings(max_examples=100)
def test_mutated_configuration_gives_data_error_or_a_configuration(
        tmp_path_factory, start, length, replacement):
    path = tmp_path_factory.getbasetemp() / 'mutated.yaml'
    path.write_bytes((TINY[:start] + replacement + TINY[start + length:]).encode(
        errors='surrogatepass'))
    try:
        load_config(path)
    except DataError as problem:
        assert '\n' not in str(problem)


def test_model_of_a_log_named_by_its_configuration_has_its_period(tmp_path, monkeypatch):
    folder = tmp_path / 'config'
    folder.mkdir()
    omega, t = 2.0, 0.05 * np.arange(300)
    swings = [np.stack([np.full_like(t, i), t, a * np.sin(omega * t),
                        a * omega * np.cos(omega * t)],
                       axis=-1) for i, a in enumerate((0.5, 1.0))]
    np.savetxt(folder / 'log.csv', np.vstack(swings), delimiter=',', header='two swings')
    (folder / 'swings.yaml').write_text("""
coordinates: [{name: angle, q_unit: rad, p_unit: kg m2 rad/s}]
data:
  kind: measured
  path: log.csv
  delimiter: comma
  columns: [run, t, angle, rate]
  trial: run
  time: t
  q: [angle]
  p: [rate]
  mass: [3.0]
  derivatives: {kind: savitzky_golay, window: 0.45}
hidden: [16]
adam_steps: 300
lbfgs_steps: 300
""")
    monkeypatch.chdir(tmp_path)
    main(['--config', 'config/swings.yaml'])
    hamiltonian = NeuralHamiltonian(load_checkpoint('models/swings.safetensors'))
    assert hamiltonian.coordinates[0].p_unit == 'kg m2 rad/s'
    assert 'log.csv (600 rows' in hamiltonian.checkpoint.card.dataset
    # H = p^2 / (2 m) + m omega^2 q^2 / 2, within the loss and what the cubic flattens: a window
    # of 9 rows spans 0.8 rad, whose derivative errs by 1e-3 of itself at most.
    q, p = np.array([0.6]), np.array([-2.0])
    dH_dq, dH_dp = hamiltonian.gradient(q, p)
    tolerance = 1e-3 + 3.0 * np.sqrt(hamiltonian.checkpoint.card.losses['validation_loss'])
    assert dH_dp == pytest.approx(p / 3.0, abs=tolerance * omega)
    assert dH_dq == pytest.approx(3.0 * omega**2 * q, abs=tolerance * 3.0 * omega**2)


def upward_crossings(t: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the instants at which x - mean(x) changes from negative to positive."""
    y = x - x.mean()
    before = np.flatnonzero((y[:-1] < 0.0) & (y[1:] >= 0.0))
    return t[before] - y[before] * (t[before + 1] - t[before]) / (y[before + 1] - y[before])


@pytest.fixture(scope='module')
def air_track(tmp_path_factory):
    """Train the model of the air track and return the folder that its scene runs in."""
    if not AIR_TRACK_LOG.is_file():
        pytest.skip(f'the air-track log is not shipped and not at {AIR_TRACK_LOG}; set '
                    'HNN_VI_ROS_AIR_TRACK_LOG to real_linear_h_1.txt of Schmidt and Lipson (2009)')
    folder = tmp_path_factory.mktemp('air_track')
    main(['--config', 'air_track', '--data', str(AIR_TRACK_LOG),
          '--out', str(folder / 'models' / 'air_track.safetensors')])
    return folder


@pytest.mark.timeout(300)
def test_air_track_model_oscillates_with_the_measured_period(air_track, monkeypatch):
    monkeypatch.chdir(air_track)
    # Independent of how the model learns: the mean time between upward crossings of the mean
    # position, in the raw log; the 11 periods agree with one another within 0.1 %.
    _, t, x, _ = np.loadtxt(AIR_TRACK_LOG, comments='%').T
    periods = np.diff(upward_crossings(t, x))
    assert len(periods) == 11
    measured = periods.mean()
    run = simulate(load_scene('air_track'), 26.0)
    simulated = np.diff(upward_crossings(run.t, run.q[:, 0])).mean()
    # The promise is 1 %. Ten seeds gave 0.14 % at most.
    assert simulated == pytest.approx(measured, rel=3e-3)


@pytest.mark.timeout(300)
def test_air_track_energy_surface_is_one_bowl_of_closed_orbits(air_track, monkeypatch):
    monkeypatch.chdir(air_track)
    hamiltonian = NeuralHamiltonian(load_checkpoint('models/air_track.safetensors'))
    n = 101
    energy = hamiltonian.energy(*grid(hamiltonian.box, n)).reshape(n, n)
    inner = energy[1:-1, 1:-1]
    neighbours = [energy[1 + i:n - 1 + i, 1 + j:n - 1 + j]
                  for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
    assert np.all([inner < neighbour for neighbour in neighbours], axis=0).sum() == 1
    # Closed through the box: the lowest energy on its edge is above that of a state almost there.
    edge = np.concatenate([energy[0], energy[-1], energy[:, 0], energy[:, -1]])
    q_high = hamiltonian.box[0][0, 1]
    assert edge.min() > hamiltonian.energy(np.array([0.95 * q_high]), np.zeros(1)) > inner.min()
    for amplitude in (20.0, 60.0, 95.0):
        scene = load_scene('air_track')
        state = scene.initial_state.model_copy(update={'q': [-amplitude]})
        run = simulate(scene.model_copy(update={'initial_state': state}), 10.0)
        # The orbit comes back on the other side, within the few pixels that the rest position
        # may lie off zero.
        assert run.q.max() == pytest.approx(amplitude, abs=4.0)
