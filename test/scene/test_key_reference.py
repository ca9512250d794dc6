# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The reference of keys: each kind has valid examples, units and defaults."""

from hnn_vi_ros.commands import names
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.scene import definitions, describe, example, keys_of, Scene
from messages import refused
import pytest
import yaml

SCENE = {'hamiltonian': {'kind': 'harmonic_oscillator'}, 'step_size': 0.01,
         'integrator': {'kind': 'gauss4'}, 'initial_state': {'q': [1.0], 'p': [0.0]}}
PLURALS = ('effects', 'integrators', 'hamiltonians')


def test_every_kind_has_an_entry():
    assert {*definitions('effects')} == {*EFFECTS}
    assert {*definitions('integrators')} == {*INTEGRATORS, 'auto'}
    assert {*HAMILTONIANS} <= {*definitions('hamiltonians')}


@pytest.mark.parametrize('part, name', [
    (part, name) for part in PLURALS for name in definitions(part)
    # These name the user's code.
    if name not in ('python', 'discrete_euler_lagrange')])
def test_example_is_valid_in_a_scene(part, name):
    Scene.model_validate(SCENE | yaml.safe_load(example(part, name)))


def test_example_of_a_family_has_its_required_keys():
    for name, one in names.schemas('families').items():
        given = yaml.safe_load(example('families', name))['family']
        assert {*one.get('required', ())} <= {*given} <= {*one['properties']}


def test_keys_have_units_and_defaults():
    (gamma, _) = keys_of(definitions('effects')['damping'])
    assert gamma.name == 'rate' and not gamma.required
    keys = {key.name: key for key in keys_of(definitions('effects')['servo'])}
    assert (keys['damping'].unit, keys['damping'].default) == ('[N s/m], [N m s/rad]', '0.0')
    assert keys['stiffness'].required and '[' not in keys['stiffness'].meaning


def test_list_prints_the_keys_of_a_name(capsys):
    assert names.main(['effects', 'servo']) == 0
    text = describe('effects', 'servo', definitions('effects'))
    assert capsys.readouterr().out == text + '\n'
    assert 'back_emf' in text and 'Example: effects: [{kind: servo, ' in text


def test_unknown_name_and_list_without_keys_are_refused():
    with refused(ParameterError):
        describe('effects', 'dampin', {'damping': {}, 'gravity': {}})
    with refused(ParameterError):
        names.main(['scenes', 'pendulum'])
