# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Initial states given by velocities."""

from hnn_vi_ros import load_scene, Scene, simulate
from hnn_vi_ros.errors import DataError, SceneError
from hnn_vi_ros.identify.free_numbers import free_scene, write_fitted
from hnn_vi_ros.run.report import scene_report
from hnn_vi_ros.simulation import build
from hnn_vi_ros.sweeps.plan import make_plan
from hnn_vi_ros.sweeps.trajectories import Runner
from messages import refused
import numpy as np
import pytest

# p_x = 3 (v - x) / m of H = m p^2 / 6 + p x; at x = 1, v = 2 and m = 1 that is 3.
FILE = """hamiltonian:
  {kind: formula, coordinates: [x], H: 'm*p_x^2/6 + p_x*x', parameters: {m: 1.0}}
integrator: {kind: gauss4}
step_size: 0.01
initial_state: {q: [1.0], v: [2.0]}
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / 'scene.yaml'
    path.write_text(FILE)
    return path


def test_velocities_become_the_momenta_of_each_change_of_the_scene(file):
    scene = load_scene(file)
    # Newton's method solves a quadratic H in one iteration, to its goal of 1e-12.
    assert scene.initial_state.p == pytest.approx([3.0], rel=1e-11)
    assert 'p:' not in scene.to_yaml() and 'v:' in scene.to_yaml()
    heavy = scene.changed({'hamiltonian': {**scene.hamiltonian.model_dump(),
                                           'parameters': {'m': 2.0}}})
    assert heavy.initial_state.p == pytest.approx([1.5], rel=1e-11)
    at_rest = simulate(scene, 0.1, initial_state={'q': [1.0], 'v': [1.0]})
    assert at_rest.p[0] == pytest.approx([0.0], abs=1e-11)
    report = scene_report(scene, build(scene))
    assert report['initial_state'] == {'q': [1.0], 'p': scene.initial_state.p}
    run = simulate(lambda q, p: p @ p / 6.0, duration=0.1, step_size=0.1,
                   initial_state={'q': [1.0], 'v': [2.0]})
    assert run.p[0] == pytest.approx([6.0], rel=1e-11)


def test_angular_velocity_of_a_body_becomes_its_momentum():
    scene = load_scene('free_rigid_body')
    q, p = map(np.array, (scene.initial_state.q, scene.initial_state.p))
    v = scene.create_hamiltonian().gradient(q, p)[1]
    again = scene.with_overrides(initial_state={'q': q, 'v': v})
    assert again.initial_state.p == pytest.approx(p, rel=1e-11)


def test_sweep_of_a_parameter_keeps_the_velocities(file):
    sweep = {'scene': str(file), 'duration': 0.01, 'keep': 'samples', 'every': 1, 'vary': [
        {'kind': 'values', 'key': 'hamiltonian.parameters.m', 'values': [1.0, 2.0]}]}
    runner = Runner(make_plan(sweep))
    starts = [rows.p[0, 0] for block in runner.shard(0) for rows in block]
    assert starts == pytest.approx([3.0, 1.5], rel=1e-11)
    sweep['vary'] = [{'kind': 'values', 'key': 'initial_state.q.x', 'values': [1.0, 2.0]}]
    with refused(DataError):
        make_plan(sweep)


def test_fitted_scene_has_the_velocities_of_the_fitted_state(file, tmp_path):
    free = free_scene(load_scene(file).parts(), ['parameters.m'], {}, tmp_path, False)
    write_fitted(tmp_path / 'fitted.yaml', free, [2.0], {'q': [1.0], 'p': [6.0]})
    fitted = load_scene(tmp_path / 'fitted.yaml')
    # 2 p / 3 + x.
    assert fitted.initial_state.v == pytest.approx([5.0])
    assert fitted.initial_state.p == pytest.approx([6.0], rel=1e-11)


@pytest.mark.parametrize('state, changes', [
    ({'q': [1.0]}, {}), ({'q': [1.0], 'p': [1.0], 'v': [1.0]}, {}),
    ({'q': [1.0], 'v': [1.0, 2.0]}, {}),
    ({'q': [1.0], 'v': [2.0]}, {'H': 'sqrt(1 + p_x^2)'}),
    ({'q': [1.0, 0.0], 'v': [2.0, 0.0]}, {'coordinates': ['x', 'y'], 'H': 'p_x^2 + p_y^2'})],
    ids=['neither', 'both', 'count', 'light', 'field'])
def test_velocities_without_momenta_are_refused(state, changes):
    field = [{'kind': 'magnetic_field', 'field': 1.0, 'plane': ['x', 'y']}] * (
        'coordinates' in changes)
    with refused(SceneError):
        Scene.build(hamiltonian={'kind': 'formula', 'coordinates': ['x'], 'H': 'p_x^2'} | changes,
                    integrator='gauss4', step_size=0.1, initial_state=state, effects=field)
