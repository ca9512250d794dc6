# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Many trajectories at once against each of them alone."""

from helpers import EPS
from hnn_vi_ros.ensemble import BLOCK, simulate_many
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import Simulation
import numpy as np
import pytest

SCENE = """\
hamiltonian: {{kind: {kind}}}
integrator: {{kind: {integrator}}}
step_size: 0.05
initial_state: {{q: {q}, p: {q}}}
"""


@pytest.mark.parametrize('kind, integrator, d', [
    ('tao', 'variational_euler', 1), ('tao', 'gauss6', 1), ('tao', 'generalized_leapfrog', 1),
    ('tao', 'discrete_gradient', 1), ('double_pendulum', 'variational_euler', 2)])
@pytest.mark.parametrize('threads', [1, 2])
def test_many_trajectories_are_those_of_each_alone(tmp_path, kind, integrator, d, threads):
    path = tmp_path / 'scene.yaml'
    path.write_text(SCENE.format(kind=kind, integrator=integrator, q=[0.0] * d))
    scene = load_scene(path)
    m, samples, every = 2 * BLOCK + 3, 4, 10
    q, p = np.random.default_rng(0).uniform(-0.8, 0.8, (2, m, d))
    many = simulate_many(scene, q, p, samples * every * 0.05, samples=samples, threads=threads)
    assert many.q.shape == (samples + 1, m, d)
    assert many.energy.shape == (samples + 1, m)
    assert many.t[-1] == pytest.approx(2.0)
    for i in (0, BLOCK - 1, BLOCK, m - 1):
        alone = Simulation(scene.create_hamiltonian(), scene.create_integrator(), 0.05, q[i], p[i])
        q_alone, p_alone = alone.record(samples, every)
        # Both are solved to 8 eps a step, and the flow stretches that less than 100 times.
        tolerance = 100 * 8 * EPS * samples * every
        assert np.abs(many.q[1:, i] - q_alone).max() <= tolerance
        assert np.abs(many.p[1:, i] - p_alone).max() <= tolerance


def test_many_trajectories_report_the_failure_of_one(tmp_path):
    path = tmp_path / 'scene.yaml'
    path.write_text(SCENE.format(kind='tao', integrator='variational_euler, solver: fixed_point',
                                 q=[0.0]))
    q = np.zeros((20, 1))
    q[17] = 1e3
    with pytest.raises(StepFailure):
        simulate_many(load_scene(path), q, q, 1.0)


def test_many_trajectories_refuse_bad_arguments():
    scene = load_scene('harmonic_oscillator')
    with pytest.raises(ValueError, match='expected'):
        simulate_many(scene, [[1.0, 2.0]], [[0.0, 0.0]], 1.0)
    with pytest.raises(ValueError, match='finite'):
        simulate_many(scene, [[np.nan]], [[0.0]], 1.0)
    with pytest.raises(ValueError, match='duration = 0 s'):
        simulate_many(scene, [[1.0]], [[0.0]], 0.0)
    with pytest.raises(ValueError, match=r'shape \(0, 1\): no trajectory'):
        simulate_many(scene, np.empty((0, 1)), np.empty((0, 1)), 1.0)
    with pytest.raises(ValueError, match='threads = -1 must be at least 1'):
        simulate_many(scene, [[1.0]], [[0.0]], 1.0, threads=-1)
    with pytest.raises(TypeError, match='samples = 1.5 must be a whole number'):
        simulate_many(scene, [[1.0]], [[0.0]], 1.0, samples=1.5)
    with pytest.raises(ValueError, match='more than memory holds'):
        simulate_many(scene, [[1.0]], [[0.0]], 1.0, samples=10 ** 12)
