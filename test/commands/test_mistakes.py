# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Mistakes of users: each is answered by one line with what, where, and a remedy."""

from pathlib import Path

from hnn_vi_ros.cli import run_module
from hnn_vi_ros.commands import module_of
from hnn_vi_ros.errors import offered
from hnn_vi_ros.files import shipped_names
from messages import assert_message
import numpy as np
import pytest
from urdf_robots import chain

SCENE = """\
hamiltonian: {kind: pendulum, mass: 1.0, length: 1.0}
integrator: {kind: gauss4}
step_size: 0.01
initial_state: {q: [1.0], p: [0.0]}
"""
FORMULA = SCENE.replace('{kind: pendulum, mass: 1.0, length: 1.0}', (
    "{kind: formula, coordinates: [x], parameters: {m: 1.0}, H: 'p_x^2/(2*m) + x^2/2'}"))
ROBOT = SCENE.replace('{kind: pendulum, mass: 1.0, length: 1.0}',
                      '{kind: urdf, file: arm.urdf, joints: [j1]}')
TRAINING = """\
coordinates: [{name: x, q_unit: m, p_unit: kg m/s}]
data:
  kind: measured
  path: log.csv
  delimiter: comma
  time: t
  q: [x]
  p: [v]
  derivatives: {kind: savitzky_golay, window: 0.3}
"""
LOG = 't,x,v\n' + ''.join(f'{0.1 * k:.1f},{k % 7},{k % 5}\n' for k in range(30))
SWEEP = """\
scene: exact_pendulum
duration: 1.0
every: 10
vary: [{kind: grid, keys: [hamiltonian.mass], low: [1.0], high: [2.0], counts: [2]}]
statistics: [energy_band]
"""
NAMES = {'mine.yaml': SCENE, 'formula.yaml': FORMULA, 'robot.yaml': ROBOT, 'train.yaml': TRAINING,
         'log.csv': LOG, 'sweep.yaml': SWEEP, 'arm.urdf': chain([1.0], [1.0])}

TRAIN = 'train --config train.yaml --out x.safetensors'
# Command lines with the file in which a text is another one, and lines that are mistaken.
CHANGES = {
    ('run mine.yaml', 'mine.yaml'): [
        ('mass', 'mas'), ('integrator: {kind: gauss4}\n', ''), ('gauss4', 'gauss5'),
        (SCENE[13:53], 'Pendulum'), ('[1.0]', '1.0'), ('[1.0]', '[]'), ('[1.0]', '[1.0, 2.0]'),
        ('[1.0]', '[.nan]'), ('0.01', '10 ms'), ('mass: 1.0', 'mass: 1 kg'),
        ('mass: 1.0', 'mass: -1.0'), (SCENE, ''), (SCENE, 'hello'),
        ('step_size', '\tstep_size'), ('}\nstep', '\nstep'), ('step_size', (
            'effects: [{kind: external_force, coordinates: [elbow]}]\nstep_size'))],
    ('run formula.yaml', 'formula.yaml'): [('+ x^2', '+ k*x^2'), ('x^2/2', 'foo(x)')],
    ('run robot.yaml', 'robot.yaml'): [
        ('joints: [j1]', 'gravity: 9.81'), ('arm.urdf', 'leg.urdf'), ('[j1]', '[elbow]')],
    ('scene --check mine.yaml', 'mine.yaml'): [('step_size', 'stepsize')],
    ('scene --new --robot arm.urdf', 'arm.urdf'): [
        (chain([1.0], [1.0]), '<robot><link'), (chain([1.0], [1.0]), '<sdf/>')],
    (TRAIN, 'train.yaml'): [('time', 'tme'), ('  time: t\n', ''), ('[x]', '[y]'),
                            ('comma', 'tab')],
    (TRAIN, 'log.csv'): [('0.3,3', '0.3,nan'), (LOG, ''), ('0.3,3,', '0.3,')],
    ('sweep sweep.yaml', 'sweep.yaml'): [
        ('1.0\n', 'ten\n'), ('hamiltonian.mass', 'hamiltonian.mas')],
}
LINES = """\
run nothing.yaml
run pendulumm
run model.yaml
run arm.urdf
run folder
run kepler --csv folder
run kepler --csv log.csv
run kepler --duration 1e9 --plot motion
run mine.yaml more
run mine.yaml --csv /proc/nothing/a.csv
run mine.yaml --duration -1
run mine.yaml --duration 10s
run mine.yaml --durration 3
run mine.yaml --every 1.5
run mine.yaml --integrator gauss5
run mine.yaml --step-size -1
scene --explain nothing
scene --new well --formula x^2
scene --new well --formula p^2+q*cos(2*t)
train --config nothing
train --config train.yaml --data folder --out x.safetensors
train --config train.yaml --data nothing.csv --out x.safetensors
evaluate log.csv --data sw.npz
evaluate mine.yaml --data empty.npz
evaluate mine.yaml --data folder
evaluate mine.yaml --data nothing.npz
evaluate mine.yaml --data sw.npz --horizons x
evaluate mine.yaml --data sw.npz --keys t,angle
evaluate junk.safetensors --data sw.npz
identify mine.yaml --data sw.npz --free mas
identify mine.yaml --data sw.npz --free mass --bounds mass 2 1
recover_bag junk.mcap
sweep nothing
sweep sweep.yaml --out mine.yaml
"""
MISTAKES = {f'{line}: {new}': (line, (file, old, new)) for (line, file), changes in CHANGES.items()
            for old, new in changes} | {line: (line, None) for line in LINES.splitlines()}


@pytest.fixture(scope='module')
def folder(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp('mistakes')
    for name, text in NAMES.items():
        (path / name).write_text(text)
    t = np.arange(0.0, 1.0, 0.01)
    np.savez(path / 'sw.npz', t=t, q=np.cos(t)[:, None], dq=-np.sin(t)[:, None])
    (path / 'model.yaml').write_text(SCENE.replace(
        '{kind: pendulum, mass: 1.0, length: 1.0}', '{kind: hnn, model: mine}'))
    (path / 'empty.npz').touch()
    for name in ('junk.safetensors', 'junk.mcap'):
        (path / name).write_bytes(bytes(range(200)))
    (path / 'folder').mkdir()
    return path


def answer(words: list[str], capsys: pytest.CaptureFixture) -> str:
    """Return the line with which a command ends that `hnn` runs."""
    name, *argv = words
    try:
        said = run_module(module_of(name), argv, f'hnn {name}')
    except SystemExit as end:
        said = end.code
    printed = capsys.readouterr().err
    return said if isinstance(said, str) else printed.rstrip('\n')


@pytest.mark.parametrize('line, change', MISTAKES.values(), ids=MISTAKES)
def test_mistake_is_answered_in_a_line(line, change, folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    if change is not None:
        name, old, new = change
        assert old in NAMES[name]
        (folder / name).write_text(NAMES[name].replace(old, new, 1))
    try:
        said = answer(line.split(), capsys)
    finally:
        for name, text in NAMES.items():
            (folder / name).write_text(text)
    assert_message(said)
    # Three lines of a wide terminal at most; no words of libraries.
    assert len(said) < 400
    for words in ('Traceback', 'Errno', 'Field required', 'should be', 'should have', 'invalid '):
        assert words not in said


def test_model_that_must_be_trained_is_told_with_its_data_and_a_command_that_is_there(capsys):
    said = answer(['run', 'air_track'], capsys)
    assert 'train it with: hnn train --config air_track --data FILE, which is real_linear_h_1' \
        in said and '\n' not in said


def test_of_many_names_the_nearest_are_offered():
    said = offered('gauss5', [f'method{k}' for k in range(40)] + ['gauss4', 'gauss6'])
    assert 'did you mean gauss' in said and 'gauss4' in said and '... (34 more)' in said
    assert offered('b', ['a', 'c']) == '; valid: a, c'
    assert len(offered('x', shipped_names('scene'))) < 240
