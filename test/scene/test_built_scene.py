# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Scenes that Python code builds, beside those that are read from YAML."""

from hnn_vi_ros.errors import SceneError
from hnn_vi_ros.files import shipped_names
from hnn_vi_ros.scene import load_scene, plain_data, Scene
from hnn_vi_ros.simulation import build
from messages import refused
import numpy as np
import pytest

PARTS = {'hamiltonian': {'kind': 'harmonic_oscillator', 'mass': 2.0},
         'integrator': 'variational_euler', 'initial_state': ([1.0], [0.0]), 'step_size': 0.01}


@pytest.mark.parametrize('name', shipped_names('scene'))
def test_scene_of_the_parts_of_another_is_the_same(name):
    loaded = load_scene(name)
    built = Scene.build(name=name, **dict(loaded))
    # A list does for a tuple.
    assert plain_data(built) == plain_data(loaded) and built.name == name


def test_kind_alone_is_a_choice_in_yaml(tmp_path):
    file = tmp_path / 'short.yaml'
    file.write_text('hamiltonian: pendulum\nintegrator: rk4\nstep_size: 0.1\n'
                    'initial_state: {q: [1.0], p: [0.0]}\n')
    scene = load_scene(file)
    assert scene.integrator.kind == 'rk4' and scene.hamiltonian.kind == 'pendulum'
    assert load_scene(file).to_yaml() == scene.to_yaml()


def test_scene_takes_arrays_tuples_and_kinds_by_their_names():
    built = Scene.build(
        hamiltonian='free_particle', integrator='gauss4', step_size=np.float64(0.5),
        initial_state=(np.zeros(1), (1,)), effects=({
            'kind': 'gravity', 'coordinate': 'x', 'mass': 1},))
    assert built.initial_state.p == [1.0] and built.integrator.kind == 'gauss4'
    assert built.known_step_size == 0.5 and built.create_hamiltonian().dimension == 1


@pytest.mark.parametrize('changes', [
    {'hamiltonian': 'harmonic_oscilator'}, {'step_size': '1 ms'}, {'step_size': None},
    {'effects': [{'kind': 'damping', 'rat': 1.0}]}, {'initial_state': ([1.0], ['0'])},
    {'initial_state': 3}, {'mechanism': 'pendulm'}], ids=str)
def test_part_that_does_not_fit_is_named_as_in_yaml(changes):
    with refused(SceneError):
        Scene.build(**PARTS | changes)


def test_part_that_cannot_be_made_is_placed_by_its_key():
    scene = Scene.build(**PARTS | {'hamiltonian': {'kind': 'harmonic_oscillator', 'mass': -1.0}})
    with refused(SceneError):
        build(scene)
