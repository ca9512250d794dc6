# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Training of bodies that turn: from arrays to a model that runs, and what is refused."""

import json
import math
from pathlib import Path

from hnn_vi_ros import load_scene
from hnn_vi_ros.errors import DataError, HnnViRosError, ParameterError
from hnn_vi_ros.hamiltonians.heavy_top import HeavyTop
from hnn_vi_ros.integrators.lie.lie_leapfrog import LieLeapfrog
from hnn_vi_ros.learning.data.arrays import read_bodies
from hnn_vi_ros.learning.evaluate import main as evaluate
from hnn_vi_ros.learning.families.lie_group import BodyStage, LieGroupNetwork
from hnn_vi_ros.learning.fit import body, loop
from hnn_vi_ros.learning.fit.body import fit_body, joined, network_of, stages_of
from hnn_vi_ros.learning.fit.config import BodyConfig, load_config
from hnn_vi_ros.learning.fit.loop import TrainingProblem
from hnn_vi_ros.learning.tasks.body import published_loss
from hnn_vi_ros.models import load_checkpoint, turn_matrices
from hnn_vi_ros.simulation import build, Simulation
from messages import refused
import numpy as np
import pytest
import torch
from trainings import trained, Training

STEP, EVERY, SAMPLES = 0.005, 4, 12
CONFIG = """
coordinates: [{name: attitude, p_unit: kg m2/s, kind: rotation}]
data: {kind: arrays, tau: null, test_runs: [r3]}
family: {kind: lie_group}
hidden: [8]
batch: 16
learning_rate: 0.005
windows: [{intervals: 1, adam_steps: 40}]
"""
SCENE = """
hamiltonian: {{kind: learned, model: {model}}}
integrator: {{kind: lie_leapfrog, retraction: exponential}}
step_size: 0.02
initial_state: {{q: [0.0, 0.0, 0.0, 1.0], p: [0.1, 0.2, 0.3]}}
"""


def top_motions() -> dict[str, np.ndarray]:
    """Return motions of a top that hangs, four runs of quaternions and velocities."""
    top, arrays = HeavyTop([1.0, 1.4, 0.8], 1.0, -0.5), {}
    rng = np.random.default_rng(0)
    for run in range(4):
        q, p = rng.normal(size=4), rng.normal(size=3)
        motion, rows = Simulation(top, LieLeapfrog(), STEP, q / np.linalg.norm(q), p), []
        for _ in range(SAMPLES):
            rows.append([*motion.q, *(motion.p / top.inertia)])
            motion.advance(EVERY)
        arrays |= {f'r{run}/t': EVERY * STEP * np.arange(SAMPLES),
                   f'r{run}/q': np.array(rows)[:, :4], f'r{run}/dq': np.array(rows)[:, 4:]}
    return arrays


@pytest.fixture(scope='module')
def made(pytestconfig) -> Training:
    """Return a body that is hardly trained, and its motions."""
    return trained(pytestconfig, 'top', CONFIG, top_motions)


@pytest.fixture
def settings(made) -> BodyConfig:
    return load_config(Path(made.config))


@pytest.fixture
def learned(made, settings) -> list:
    return read_bodies(Path(made.data), settings.data, 'rotation')[0]


def config(folder: Path, text: str = CONFIG) -> BodyConfig:
    path = folder / 'top.yaml'
    path.write_text(text)
    return load_config(path)


def test_body_is_trained_judged_and_run(made, settings, learned, tmp_path, capsys):
    card = load_checkpoint(made.model).card
    assert card.scheme.integrator == 'lie_leapfrog' and card.scheme.step_size == 0.02
    evaluate([str(made.model), '--data', made.data, '--config', made.config,
              '--json', str(tmp_path / 'found.json')])
    found = json.loads((tmp_path / 'found.json').read_text())
    network = LieGroupNetwork.of(load_checkpoint(made.model))
    _, judged, _ = read_bodies(Path(made.data), settings.data, 'rotation')
    assert 0.0 < found['published_loss'] == published_loss(
        network, settings, joined([motion.windows(4) for motion in judged]))
    assert f'loss as published: {found["published_loss"]:.3g}' in capsys.readouterr().out
    # Of what was learned from; forty steps are no more than a beginning.
    windows = joined([motion.windows(1) for motion in learned])
    assert published_loss(network, settings, windows) < 0.8 * published_loss(
        network_of(settings, learned), settings, windows)
    scene = tmp_path / 'scene.yaml'
    scene.write_text(SCENE.format(model=made.model))
    run = build(load_scene(scene))
    start = float(run.energy)
    run.advance(200)
    # The leapfrog errs by (h omega)^2 / 24 of energies of the order of ten.
    assert float(run.energy) == pytest.approx(start, abs=0.05)
    assert np.linalg.norm(run.q) == pytest.approx(1.0, abs=1e-12)


def test_windows_of_one_array_are_the_motions_of_its_runs(made, learned, tmp_path):
    with np.load(made.data) as archive:
        rows = [np.hstack([turn_matrices(archive[f'r{run}/q']).reshape(-1, 9),
                           archive[f'r{run}/dq']]) for run in range(4)]
    path = tmp_path / 'windows.npz'
    np.savez(path, train=np.stack(rows[:3], axis=1)[None], test=np.stack(rows[3:], axis=1)[None])
    text = CONFIG.replace('{kind: arrays, tau: null, test_runs: [r3]}',
                          '{kind: windows, interval: 0.02}')
    (found,), (judged,), _ = read_bodies(path, config(tmp_path, text).data, 'rotation')
    assert found.R.shape == (SAMPLES, 3, 3, 3) and judged.R.shape == (SAMPLES, 1, 3, 3)
    assert found.windows(4).R.shape == (5, 3 * (SAMPLES - 4), 3, 3)
    # R is a sum of four products of numbers below one.
    assert (found.R[:, 1] - learned[1].R[:, 0]).abs().max() <= 1e-15
    assert (found.v[:, 1] == learned[1].v[:, 0]).all()


def test_what_never_changes_in_the_data_is_not_learned(tmp_path):
    angle = np.linspace(0.0, 3.0, 40)
    q = np.stack([0 * angle, 0 * angle, np.sin(angle / 2), np.cos(angle / 2)], axis=1)
    speed = np.stack([0 * angle, 0 * angle, 1.0 + 0.1 * np.sin(angle)], axis=1)
    path = tmp_path / 'planar.npz'
    np.savez(path, t=0.1 * np.arange(40), q=q, dq=speed)
    settings = config(tmp_path, CONFIG.replace(', test_runs: [r3]', ''))
    learned, _, _ = read_bodies(path, settings.data, 'rotation')
    first = network_of(settings, learned).potential.linears[0].weight
    # Of a turn about z the entries R13, R23, R31, R32 and R33.
    assert (first[:, [2, 5, 6, 7, 8]] == 0.0).all() and (first[:, [0, 1, 3, 4]] != 0.0).all()


@pytest.mark.parametrize('arrays', [
    {'t': np.arange(9.0), 'q': np.ones((9, 4)), 'dq': np.ones((9, 3))},
    {'t': np.arange(9.0), 'q': np.ones((9, 5)), 'dq': np.ones((9, 3))},
    {'t': np.arange(9.0)**2, 'q': np.ones((9, 4)), 'dq': np.ones((9, 3))},
    {'t': np.arange(9.0), 'q': np.ones((9, 4))},
    {'t': np.arange(9.0), 'q': np.full((9, 4), np.nan), 'dq': np.ones((9, 3))}])
def test_arrays_that_are_no_motions_are_refused(tmp_path, arrays: dict):
    path = tmp_path / 'bad.npz'
    np.savez(path, **arrays)
    settings = config(tmp_path, CONFIG.replace(', test_runs: [r3]', ''))
    with refused(DataError):
        read_bodies(path, settings.data, 'rotation')


@pytest.mark.parametrize('change', [
    ('kind: lie_group', 'kind: lie_group, potential_depends_on: [position]'),
    ('kind: lie_group', 'kind: lie_group, structured: false, mass_depends_on: [attitude]')])
def test_configuration_that_contradicts_itself_is_refused(tmp_path, change: tuple):
    with refused(HnnViRosError):
        config(tmp_path, CONFIG.replace(*change))


def test_body_is_judged_by_the_configuration_that_reads_its_motions(made):
    with refused(ParameterError):
        evaluate(['resource/models/turning_pendulum.safetensors', '--data', made.data])


def test_lbfgs_of_a_body_shortens_a_step_after_which_the_loss_is_no_number(
        settings, learned, monkeypatch):
    network = network_of(settings, learned)
    weight = network.potential.linears[0].weight
    with torch.no_grad():
        weight[0, 0] = 0.5
    # The first step would be of length 1, to where there is no logarithm; the minimum is at 0.01.

    def loss(network: LieGroupNetwork, *_: object) -> torch.Tensor:
        x = network.potential.linears[0].weight[0, 0]
        return x - 0.01 * x.log()
    monkeypatch.setattr(body, 'body_loss', loss)
    stages = settings.model_copy(update={'windows': [BodyStage(intervals=1, lbfgs_steps=40)]})
    fitted = loop.trained(TrainingProblem(network, stages_of(stages, learned)))
    assert fitted.losses['lbfgs_1'] == pytest.approx(0.01 * (1.0 - math.log(0.01)), rel=1e-9)
    assert all(parameter.isfinite().all() for parameter in fitted.module.parameters())


def test_lbfgs_of_a_body_takes_as_many_steps_as_it_is_given(settings, learned, monkeypatch):
    found = {}

    def valley(network: torch.nn.Module, *_: object) -> torch.Tensor:
        """Return Rosenbrock's function, from which 20 steps are far from its end."""
        x = network.potential.linears[0].weight.flatten()[:10]
        return (100.0 * (x[1:] - x[:-1].square()).square() + (1.0 - x[:-1]).square()).sum()
    monkeypatch.setattr(body, 'body_loss', valley)
    for steps in (20, 400):
        stages = settings.model_copy(update={
            'windows': [BodyStage(intervals=1, lbfgs_steps=steps)]})
        found[steps] = fit_body(stages, learned).losses['lbfgs_1']
    assert found[400] < 1e-3 * found[20]


def test_lbfgs_of_a_body_refuses_to_begin_where_no_step_has_a_solution(settings, learned):
    network = network_of(settings, learned)
    with torch.no_grad():
        network.potential.linears[-1].weight.mul_(1e9)
    stages = settings.model_copy(update={'windows': [BodyStage(intervals=1, lbfgs_steps=40)]})
    with refused(DataError):
        loop.trained(TrainingProblem(network, stages_of(stages, learned)))
