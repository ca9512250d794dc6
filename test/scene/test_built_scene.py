# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Scenes that Python code builds, beside those that are read from YAML."""

from hnn_vi_ros.errors import SceneError
from hnn_vi_ros.files.resources import shipped_names
from hnn_vi_ros.scene import load_scene, plain_data, Scene
from hnn_vi_ros.simulation.build import build
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


def test_scene_takes_arrays_tuples_and_kinds_by_their_names():
    built = Scene.build(
        hamiltonian='free_particle', integrator='gauss4', step_size=np.float64(0.5),
        initial_state=(np.zeros(1), (1,)), effects=({
            'kind': 'gravity', 'coordinate': 'x', 'mass': 1},))
    assert built.initial_state.p == [1.0] and built.integrator.kind == 'gauss4'
    assert built.known_step_size == 0.5 and built.create_hamiltonian().dimension == 1


@pytest.mark.parametrize('changes, expected', [
    ({'hamiltonian': 'harmonic_oscilator'}, 'Scene.build scene: hamiltonian.kind: unknown kind '
     "'harmonic_oscilator'; did you mean harmonic_oscillator\\?; valid kinds: "),
    ({'step_size': '1 ms'}, "Scene.build scene: step_size: '1 ms' is no number of seconds, e.g. "),
    ({'step_size': None}, r'Scene.build scene: step_size: required: h \[s\]'),
    ({'effects': [{'kind': 'damping', 'rat': 1.0}]},
     'effects.0.rat: unknown key; did you mean rate\\?; valid keys: .*rate'),
    ({'initial_state': ([1.0], ['0'])}, "initial_state.p.0: '0' is no number"),
    ({'initial_state': 3}, 'initial_state: expected keys and values'),
    ({'mechanism': 'pendulm'}, "mechanism: 'pendulm' is unknown; did you mean pendulum.*; valid"),
])
def test_part_that_does_not_fit_is_named_as_in_yaml(changes, expected):
    with pytest.raises(SceneError, match=expected) as caught:
        Scene.build(**PARTS | changes)
    assert '\n' not in str(caught.value)


def test_part_that_cannot_be_made_is_placed_by_its_key():
    scene = Scene.build(**PARTS | {'hamiltonian': {'kind': 'harmonic_oscillator', 'mass': -1.0}})
    with pytest.raises(SceneError, match='^scene: hamiltonian.mass: harmonic_oscillator: mass'):
        build(scene)
