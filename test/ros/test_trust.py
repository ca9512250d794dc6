# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Bags and topics run no code, unless it is trusted, and choose neither folders nor models."""

import ast
from collections.abc import Callable, Iterator
import json
from pathlib import Path
import shutil
import sys

from hnn_vi_ros import load_scene
from hnn_vi_ros.errors import ModelError, RecordingError, SceneError
from hnn_vi_ros.files import dump_yaml, share_folder, shipped_file, yaml_text
from hnn_vi_ros.files.named_code import trust_context
from hnn_vi_ros.run.recorded_run import RecordedRun, resume
from hnn_vi_ros.run.replay_check import check_replay
from hnn_vi_ros.ros.replay.command import main as replay
from hnn_vi_ros.ros.replay.replay_node import find_type
from hnn_vi_ros.ros.worlds import open_world, WorldError
from hnn_vi_ros.run import scene_report
from hnn_vi_ros.scene import described_scene, Scene
from hnn_vi_ros.simulation import build
from messages import refused
from peer import CLEANUP, CONFIGURE, DEACTIVATE, peer
from processes import (
    finish, simulator_words, standard_error, start, start_executable)
from pydantic import ValidationError
import pytest
from recorded import record_run
from scene_files import write_scene
from std_msgs.msg import String

PYTHON = {'hamiltonian': {'kind': 'python', 'factory': 'marker:make'}}
LAGRANGIAN = {'integrator': {'kind': 'discrete_euler_lagrange',
                             'discrete_lagrangian': 'marker:make'}}
NAMED = [PYTHON, LAGRANGIAN]
# The definition in the schema of each key that names code, and a part of a scene that has it.
CODE_KEYS = {
    ('PythonChoice', 'factory'): PYTHON,
    ('DiscreteEulerLagrange', 'discrete_lagrangian'): LAGRANGIAN,
    ('InvariantChoice', 'function'): {'invariants': [{'name': 'i', 'function': 'marker:make'}]},
    ('HolonomicConstraint', 'factory'): {'effects': [
        {'kind': 'holonomic_constraint', 'form': 'python', 'factory': 'marker:make'}]}}
MARKER = """\
from pathlib import Path
from hnn_vi_ros.hamiltonians.pendulum import Pendulum
Path({path!r}).touch()
def make(*arguments):
    return Pendulum()
"""


@pytest.fixture
def marker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Return the file that importing the module marker makes; nothing finds the module yet."""
    (tmp_path / 'code').mkdir()
    (tmp_path / 'code' / 'marker.py').write_text(MARKER.format(path=str(tmp_path / 'run')))
    monkeypatch.setattr(sys, 'path', sys.path[:])
    yield tmp_path / 'run'
    sys.modules.pop('marker', None)


@pytest.fixture
def on_path(marker: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put the module marker on Python's path, where a user has it."""
    monkeypatch.syspath_prepend(str(marker.parent / 'code'))


def record(folder: Path, **described: object) -> Path:
    return record_run(folder / 'bag', load_scene('exact_pendulum'), 5, **described)


def described(**changes: object) -> str:
    scene = load_scene('exact_pendulum')
    return dump_yaml(scene_report(scene, build(scene)) | changes)


READERS: dict[str, Callable] = {
    'RecordedRun': RecordedRun, 'check_replay': check_replay, 'resume': resume,
    'replay --verify': lambda bag: replay([str(bag), '--verify'])}


@pytest.mark.parametrize('way', READERS)
@pytest.mark.parametrize('named', NAMED, ids=['factory', 'discrete_lagrangian'])
def test_code_that_a_bag_names_is_refused_and_not_run(tmp_path, marker, on_path, way, named):
    bag = record(tmp_path, **named)
    with refused(RecordingError):
        READERS[way](bag)
    assert not marker.exists() and 'marker' not in sys.modules


def test_keys_that_name_code_are_those_of_the_schema():
    schema = json.loads((share_folder() / 'config/scene.schema.json').read_text())
    assert {(name, key) for name, one in schema['$defs'].items()
            for key, value in one.get('properties', {}).items()
            if 'module:function' in value.get('description', '')} == CODE_KEYS.keys()


@pytest.mark.parametrize('named', CODE_KEYS.values(), ids=map('.'.join, CODE_KEYS))
def test_code_in_a_scene_of_others_is_refused_by_files_topics_and_services(
        tmp_path, marker, on_path, named):
    path = tmp_path / 'scene.yaml'
    path.write_text(dump_yaml(load_scene('exact_pendulum').model_dump() | named))
    with refused(SceneError):
        load_scene(path, trust_code=False)
    with refused(RecordingError):
        described_scene(described(**named), '~/scene')
    with refused(WorldError) as problem:
        open_world(str(path))
    assert problem.value.code == 'UNSUPPORTED_ELEMENTS'
    # The scene of the start may be quoted.
    with refused(WorldError):
        open_world(str(path), str(path))
    assert not marker.exists() and 'marker' not in sys.modules
    assert load_scene(path) and not marker.exists()


def test_scene_set_while_the_node_runs_names_no_code_and_that_of_the_start_may(tmp_path, marker):
    (tmp_path / 'code' / 'mine.py').write_text(MARKER.format(path=str(tmp_path / 'ran')))
    for name in ('mine', 'marker'):
        (tmp_path / 'code' / f'{name}.yaml').write_text(dump_yaml(
            load_scene('exact_pendulum').model_dump()
            | {'hamiltonian': {'kind': 'python', 'factory': f'{name}:make'}}))
    given, other = (str(tmp_path / 'code' / f'{name}.yaml') for name in ('mine', 'marker'))
    process = start(tmp_path, scene=given)
    with peer() as peers:
        peers.wait_for_state('active')
        assert (tmp_path / 'ran').exists()
        (tmp_path / 'ran').unlink()
        assert peers.change_state(DEACTIVATE) and peers.change_state(CLEANUP)
        assert not peers.set_parameters(trust_code=True).successful
        assert peers.set_parameters(scene=other).successful
        assert not peers.change_state(CONFIGURE)
        assert peers.state == 'unconfigured' and not marker.exists()
        assert peers.set_parameters(scene=given).successful
        assert peers.change_state(CONFIGURE)
    process.kill()
    process.wait()
    assert 'names what is code' in standard_error(process)


@pytest.mark.parametrize('named', NAMED, ids=['factory', 'discrete_lagrangian'])
def test_code_is_refused_wherever_nobody_says_that_it_is_trusted(named):
    scene = load_scene('exact_pendulum').model_dump() | named
    for context in (None, {}, trust_context(False)):
        with pytest.raises(ValidationError, match='is code'):
            Scene.model_validate(scene, context=context)
    assert Scene.model_validate(scene, context=trust_context(True))


def test_trusted_code_is_run_from_the_path_of_python(tmp_path, marker, on_path):
    # The pendulum of exact_pendulum, so that the samples agree.
    verdict = check_replay(record(tmp_path, **PYTHON), trust_code=True)
    assert verdict.good and marker.exists()


def test_trust_is_given_on_the_command_line(tmp_path, marker, on_path, capsys):
    bag = record(tmp_path, **PYTHON)
    assert replay([str(bag), '--verify', '--trust-code']) == 0, capsys.readouterr().out
    assert marker.exists()
    with pytest.raises(SystemExit):
        replay([str(bag), '--trust-code'])


@pytest.mark.parametrize('name, words', [
    ('replay', ['BAG', '--trust-code', '--rerun', 'a.rrd']),
    ('simulator', simulator_words(scene='harmonic_oscillator', resume='BAG', trust_code='true',
                                  duration=0.1, real_time_factor=0.0)),
], ids=['option', 'resume'])
def test_executable_that_trusts_a_bag_runs_its_code(tmp_path, marker, on_path, name, words):
    bag = record(tmp_path, **PYTHON)
    process = start_executable(name, *[word.replace('BAG', str(bag)) for word in words],
                               folder=tmp_path)
    status, _, error = finish(process, 120.0)
    assert status == 0, error
    assert marker.exists()


def test_folder_of_code_is_not_taken_from_a_bag(tmp_path, marker):
    bag = record(tmp_path, **PYTHON, source=str(marker.parent / 'code' / 'scene.yaml'))
    with refused(SceneError):
        check_replay(bag, trust_code=True)
    assert not marker.exists() and str(marker.parent / 'code') not in sys.path


def test_code_beside_a_scene_file_that_the_user_names_is_found(marker):
    file = marker.parent / 'code' / 'scene.yaml'
    file.write_text(dump_yaml(load_scene('exact_pendulum').model_dump() | PYTHON))
    assert load_scene(file).with_overrides(step_size=0.01).create_hamiltonian().dimension == 1
    assert marker.exists()


def test_type_that_a_bag_names_is_imported_only_from_a_package_of_messages(marker, on_path):
    for name in ('marker/msg/String', 'antigravity/msg/String', 'os/msg/path'):
        with refused(RecordingError):
            find_type(name)
    assert not marker.exists() and 'antigravity' not in sys.modules
    assert find_type('std_msgs/msg/String') is String


def test_names_are_imported_in_one_place():
    # Which modules a name may choose: ours, those of packages of messages, and named_code.
    allowed = {'named_code.py', 'cli.py', 'table.py', 'exports.py', 'families.py',
               'replay_node.py', 'services.py'}
    for path in Path(yaml_text.__file__).parents[1].rglob('*.py'):
        for call in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(call, ast.Call) and ast.unparse(call.func).endswith('import_module'):
                assert path.name in allowed or isinstance(call.args[0], ast.Constant), path


@pytest.fixture
def with_model(tmp_path: Path) -> Path:
    """Return the bag of a scene whose model is a file beside it."""
    shutil.copy(shipped_file('model', 'harmonic_oscillator'), tmp_path / 'm.safetensors')
    scene = write_scene(
        tmp_path / 'scene.yaml', 'hnn, model: m.safetensors', '', 'variational_euler')
    return record_run(tmp_path / 'bag', load_scene(scene), 5)


def test_model_beside_a_recorded_scene_is_found_if_it_is_the_one_recorded(tmp_path, with_model):
    assert RecordedRun(with_model).scene.create_hamiltonian().dimension == 1
    assert resume(with_model).scene.create_hamiltonian().dimension == 1
    shutil.copy(shipped_file('model', 'pendulum'), tmp_path / 'm.safetensors')
    with refused(ModelError):
        RecordedRun(with_model).scene.create_hamiltonian()


@pytest.mark.parametrize('model', ['/etc/hostname', '/dev/zero', '../secret.txt', '/proc/self'])
def test_file_that_a_recording_names_as_its_model_is_not_opened(monkeypatch, model):
    scene, _ = described_scene(described(
        hamiltonian={'kind': 'hnn', 'model': model}), 'here')
    with refused(ModelError), monkeypatch.context() as patch:
        patch.setattr(Path, 'open', None)
        patch.setattr(Path, 'read_bytes', None)
        scene.create_hamiltonian()


def test_models_of_effects_are_recorded_with_their_digests(tmp_path):
    shutil.copy(shipped_file('model', 'pendulum'), tmp_path / 'm.safetensors')
    path = tmp_path / 'scene.yaml'
    path.write_text(dump_yaml(load_scene('exact_pendulum').model_dump() | {
        'effects': [{'kind': 'learned_dissipation', 'model': 'm.safetensors'}]}))
    scene = load_scene(path)
    told = scene_report(scene, build(scene))
    assert told['model_files'] == scene.model_digests
    again, _ = described_scene(dump_yaml(told), 'here')
    assert len(again.create_effects()) == 1
    told['model_files'] = {}
    again, _ = described_scene(dump_yaml(told), 'here')
    with refused(ModelError):
        again.create_effects()
