# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What a sweep cannot be is one line that says what, where, and what is valid."""

from hnn_vi_ros import load_scene
from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.files.resources import share_folder, shipped_file, shipped_names
from hnn_vi_ros.sweeps.plan import make_plan
from hnn_vi_ros.sweeps.running import main, sweep
from messages import refused
import pytest

TEXT = """\
scene: exact_pendulum
duration: 1.0
vary: [{kind: values, key: hamiltonian.length, values: [1.0]}]
"""
BOX = 'vary: [{kind: box, keys: [hamiltonian.length], low: [1.0], high: [2.0], count: 3}]'
VALUES = 'vary: [{kind: values, key: hamiltonian.length, values: [1.0]}]'


@pytest.mark.parametrize('old, new', [
    ('duration', 'durations'), ('1.0\n', '.nan\n'), ('1.0\n', '-1.0\n'), ('1.0\n', '"1"\n'),
    ('exact_pendulum', 'nothing'), ('hamiltonian.length', 'hamiltonian.lenght'),
    ('hamiltonian.length', 'initial_state.q.angel'), ('hamiltonian.length', 'initial_state.q.1'),
    ('hamiltonian.length', 'effects.0.rate'), ('hamiltonian.length', 'hamiltonian.length.x'),
    ('hamiltonian.length', 'description'), ('hamiltonian.length', 'uncertainty'), ('[1.0]', '[]'),
    ('[1.0]', '[.nan]'), ('[1.0]', '["long"]'), ('[1.0]', '[-1.0]'), (VALUES, 'vary: []'),
    (VALUES, 'vary: [{kind: dice}]'), (VALUES, BOX.replace('3}', '0}')),
    (VALUES, BOX.replace('3}', '1000000000000}')), (VALUES, BOX.replace('[1.0]', '[3.0]')),
    (VALUES, BOX.replace('[1.0]', '[1.0, 1.0]')),
    (VALUES, 'vary: [{kind: grid, keys: [hamiltonian.length, hamiltonian.mass], low: [1, 1], '
     'high: [2, 2], counts: [1000000, 1000000]}]'),
    (VALUES, 'vary: [{kind: repeats, count: 1000000}, {kind: repeats, count: 1000000}]'),
    (VALUES, VALUES[:-1] + ', {kind: values, key: hamiltonian.length, values: [2.0]}]'),
    (VALUES, 'vary: [{kind: values, key: initial_state.q, values: [[1.0]]}, {kind: values, '
     'key: initial_state.q.angle, values: [2.0]}]'),
    (VALUES, VALUES + '\nkeep: samples'), (VALUES, VALUES + '\nkeep: all'),
    (VALUES, VALUES + '\nstatistics: [energy_band]'), (VALUES, VALUES + '\nstatistics: [mean]'),
    (VALUES, VALUES + '\nevery: 1\nstatistics: [out_of_box_time]'),
    (VALUES, VALUES + '\nstatistics: [event_times]'), ('1.0\n', '1.0e+11\nevery: 1\n'),
    (VALUES, VALUES + '\nreduction: {function: "os.system", columns: [a]}'),
    (VALUES, VALUES + '\nreduction: {function: "os:nothing", columns: [a]}'),
    (VALUES, VALUES + '\nreduction: {function: "os:abort", columns: [t]}'),
    (VALUES, 'vary: [{kind: file, path: nothing.csv}]')])
def test_sweep_that_cannot_be_is_one_line(tmp_path, old, new):
    assert old in TEXT
    (tmp_path / 'a.yaml').write_text(TEXT.replace(old, new, 1))
    with refused(HnnViRosError):
        sweep(tmp_path / 'a.yaml', tmp_path / 'out')
    assert not (tmp_path / 'out').exists()


def test_sweep_of_a_scene_with_energy_by_cause_is_refused(tmp_path):
    scene = load_scene('exact_pendulum').changed({'energy_by_cause': True})
    (tmp_path / 'scene.yaml').write_text(scene.to_yaml())
    (tmp_path / 'a.yaml').write_text(TEXT.replace('exact_pendulum', 'scene.yaml'))
    with refused(HnnViRosError):
        sweep(tmp_path / 'a.yaml', tmp_path / 'out')


@pytest.mark.parametrize('text', [
    '', 'hamiltonian.length\n', 'hamiltonian.length\n1,2\n', 'hamiltonian.length\n1\nnan\n',
    'hamiltonian.length\n1_5\n', 'hamiltonian.length\nx\n',
    f'hamiltonian.length\n1\n1{"," * 10**5}\n', 'hamiltonian.width\n1\n', 'scene\n1\n',
    'hamiltonian.kind\n1\n'])
def test_file_that_cannot_be_used_is_one_line(tmp_path, text):
    (tmp_path / 'a.csv').write_text(text)
    (tmp_path / 'a.yaml').write_text(
        TEXT.replace(VALUES, 'vary: [{kind: file, path: a.csv}]'))
    with refused(HnnViRosError):
        sweep(tmp_path / 'a.yaml', tmp_path / 'out')


def test_arguments_that_cannot_be_used_are_told():
    for words in (['pendulum_lengths', '--jobs', '0'], ['nothing']):
        with refused(HnnViRosError):
            main(words)
    with refused(TypeError):
        sweep(3, 'out')
    with refused(ValueError):
        sweep({}, 'out', device='tpu')


@pytest.mark.parametrize('name', shipped_names('sweep'))
def test_shipped_sweeps_can_be_run(name):
    text = shipped_file('sweep', name).read_text(encoding='utf-8')
    assert text.startswith('# yaml-language-server: $schema=../sweep.schema.json\n')
    plan = make_plan(name)
    assert plan.shards >= 1 and plan.sweep.description
    assert len(plan.values(plan.indices(0))) == len(plan.keys)


def test_schema_that_is_shipped_is_that_of_the_code(capsys):
    assert main(['--schema']) == 0
    shipped = share_folder() / 'config' / 'sweep.schema.json'
    assert shipped.read_text(encoding='utf-8') == capsys.readouterr().out
