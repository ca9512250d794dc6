# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What a sweep cannot be is one line that says what, where, and what is valid."""

from hnn_vi_ros.errors import DataError, HnnViRosError
from hnn_vi_ros.files.resources import share_folder, shipped_file, shipped_names
from hnn_vi_ros.sweeps.folder import shards_of
from hnn_vi_ros.sweeps.plan import make_plan
from hnn_vi_ros.sweeps.sweep import main, sweep
import pytest

TEXT = """\
scene: exact_pendulum
duration: 1.0
vary: [{kind: values, key: hamiltonian.length, values: [1.0]}]
"""
BOX = 'vary: [{kind: box, keys: [hamiltonian.length], low: [1.0], high: [2.0], count: 3}]'
VALUES = 'vary: [{kind: values, key: hamiltonian.length, values: [1.0]}]'


@pytest.mark.parametrize('old, new, message', [
    ('duration', 'durations', r'a.yaml:2: durations: unknown key; did you mean duration\?; '),
    ('1.0\n', '.nan\n', r'a.yaml:2: duration: .*finite'),
    ('1.0\n', '-1.0\n', r'a.yaml:2: duration: .*greater than 0'),
    ('1.0\n', '"1"\n', r'a.yaml:2: duration: .*number'),
    ('exact_pendulum', 'nothing', "no scene 'nothing'; shipped: "),
    ('hamiltonian.length', 'hamiltonian.lenght',
     r"a.yaml:3: vary.0: 'hamiltonian.lenght': unknown key 'lenght'; did you mean length\?; "
     'valid keys: kind, mass, '),
    ('hamiltonian.length', 'initial_state.q.angel', 'valid keys: 0, angle'),
    ('hamiltonian.length', 'initial_state.q.1', "unknown key '1'"),
    ('hamiltonian.length', 'effects.0.rate', "unknown key '0'; valid keys: none"),
    ('hamiltonian.length', 'hamiltonian.length.x', 'hamiltonian.length is a value'),
    ('hamiltonian.length', 'description', 'changes no trajectory'),
    ('hamiltonian.length', 'uncertainty', 'changes no trajectory'),
    ('[1.0]', '[]', 'a.yaml:3: vary.0.*values: .*1 or more'),
    ('[1.0]', '[.nan]', 'a.yaml:3: vary.0.*finite'),
    ('[1.0]', '["long"]', 'exact_pendulum as changed: hamiltonian.*length'),
    ('[1.0]', '[-1.0]', 'length'),
    (VALUES, 'vary: []', 'a.yaml:3: vary: .*1 or more'),
    (VALUES, 'vary: [{kind: dice}]', "unknown kind 'dice'; valid kinds: box, file, grid"),
    (VALUES, BOX.replace('3}', '0}'), 'vary.0.*count: .*greater than or equal to 1'),
    (VALUES, BOX.replace('3}', '1000000000000}'), 'count: .*less than or equal to 1073741824'),
    (VALUES, BOX.replace('[1.0]', '[3.0]'), r'low = 3 lies above high = 2'),
    (VALUES, BOX.replace('[1.0]', '[1.0, 1.0]'), r'low has 2 values, expected 1'),
    (VALUES, 'vary: [{kind: grid, keys: [hamiltonian.length, hamiltonian.mass], low: [1, 1], '
     'high: [2, 2], counts: [1000000, 1000000]}]', r'vary.0: 1e\+12 points, more than 1073741824'),
    (VALUES, 'vary: [{kind: repeats, count: 1000000}, {kind: repeats, count: 1000000}]',
     r'makes 1e\+12 trajectories, more than 1073741824; take fewer'),
    (VALUES, VALUES[:-1] + ', {kind: values, key: hamiltonian.length, values: [2.0]}]',
     'hamiltonian.length and hamiltonian.length both set the same value'),
    (VALUES, 'vary: [{kind: values, key: initial_state.q, values: [[1.0]]}, {kind: values, '
     'key: initial_state.q.angle, values: [2.0]}]', 'initial_state.q and initial_state.q.angle'),
    (VALUES, VALUES + '\nkeep: samples', 'every: required by keep: samples'),
    (VALUES, VALUES + '\nkeep: all', "keep: 'all' is unknown; valid: final, samples"),
    (VALUES, VALUES + '\nstatistics: [energy_band]', 'every: required by energy_band'),
    (VALUES, VALUES + '\nstatistics: [mean]', "statistics.*'mean' is unknown; valid: energy_band"),
    (VALUES, VALUES + '\nevery: 1\nstatistics: [out_of_box_time]', 'was not trained in a box'),
    (VALUES, VALUES + '\nstatistics: [event_times]', 'exact_pendulum has no events'),
    ('1.0\n', '1.0e+11\nevery: 1\n', 'take a larger every'),
    (VALUES, VALUES + '\nreduction: {function: "os.system", columns: [a]}', 'reduction.function'),
    (VALUES, VALUES + '\nreduction: {function: "os:nothing", columns: [a]}', 'no attribute'),
    (VALUES, VALUES + '\nreduction: {function: "os:abort", columns: [t]}', 'named t;'),
    (VALUES, 'vary: [{kind: file, path: nothing.csv}]', 'nothing.csv: .*No such file'),
])
def test_sweep_that_cannot_be_is_one_line(tmp_path, old, new, message):
    assert old in TEXT
    (tmp_path / 'a.yaml').write_text(TEXT.replace(old, new, 1))
    with pytest.raises(HnnViRosError, match=message) as problem:
        sweep(tmp_path / 'a.yaml', tmp_path / 'out')
    assert '\n' not in str(problem.value)
    assert not (tmp_path / 'out').exists()


@pytest.mark.parametrize('text, message', [
    ('', 'no row of numbers'), ('hamiltonian.length\n', 'no row of numbers'),
    ('hamiltonian.length\n1,2\n', 'a.csv:2: 2 values, expected 1'),
    ('hamiltonian.length\n1\nnan\n', "a.csv:3: hamiltonian.length: 'nan' is no finite number"),
    ('hamiltonian.length\n1_5\n', "a.csv:2: hamiltonian.length: '1_5' is no finite number"),
    ('hamiltonian.length\nx\n', "a.csv:2: hamiltonian.length: 'x' is no finite number"),
    (f'hamiltonian.length\n1\n1{"," * 10**5}\n', 'a.csv:3: 100001 values, expected 1'),
    ('hamiltonian.width\n1\n', "unknown key 'width'"),
    # A number names no code.
    ('scene\n1\n', "unknown key 'scene'"), ('hamiltonian.kind\n1\n', 'hamiltonian')])
def test_file_that_cannot_be_used_is_one_line(tmp_path, text, message):
    (tmp_path / 'a.csv').write_text(text)
    (tmp_path / 'a.yaml').write_text(
        TEXT.replace(VALUES, 'vary: [{kind: file, path: a.csv}]'))
    with pytest.raises(HnnViRosError, match=message) as problem:
        sweep(tmp_path / 'a.yaml', tmp_path / 'out')
    assert '\n' not in str(problem.value)


def test_arguments_that_cannot_be_used_are_told():
    for share in ('3/3', '-1/3', '1', 'a/b', '0/0', '1/2/3', ''):
        with pytest.raises(ValueError, match='expected I/N, counted from 0'):
            shards_of(share)
    assert shards_of('2/3') == (2, 3)
    with pytest.raises(HnnViRosError, match='--shard 3/3: expected'):
        main(['pendulum_lengths', '--shard', '3/3'])
    with pytest.raises(HnnViRosError, match='jobs = 0 must be at least 1'):
        main(['pendulum_lengths', '--jobs', '0'])
    with pytest.raises(DataError, match="no sweep 'nothing'; shipped: .*pendulum_lengths"):
        main(['nothing'])
    with pytest.raises(TypeError, match='sweep is a int'):
        sweep(3, 'out')
    with pytest.raises(ValueError, match="device = 'tpu' is not known; valid: cpu, cuda"):
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
