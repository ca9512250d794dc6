# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Mistakes of users: each is answered by one line with what, where, and a remedy."""

from pathlib import Path
import re

from hnn_vi_ros.cli import run_module
from hnn_vi_ros.commands.table import module_of
from hnn_vi_ros.errors import offered
from hnn_vi_ros.files.resources import shipped_names
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

# What is mistaken; the command line; the file in which a text is another one; the answer.
MISTAKES = [
    ('key', 'run mine.yaml', ('mine.yaml', 'mass', 'mas'), 'mine.yaml:1: hamiltonian.mas: unknown '
     r'key; did you mean mass\?; valid keys: gravity, kind'),
    ('key', 'scene --check mine.yaml', ('mine.yaml', 'step_size', 'stepsize'),
     r'mine.yaml:3: stepsize: unknown key; did you mean step_size\?'),
    ('key', 'train --config train.yaml', ('train.yaml', 'time', 'tme'),
     r'train.yaml:6: data.tme: unknown key; did you mean time\?'),
    ('missing key', 'run mine.yaml', ('mine.yaml', 'integrator: {kind: gauss4}\n', ''),
     'mine.yaml:1: integrator: required: '),
    ('missing key', 'train --config train.yaml', ('train.yaml', '  time: t\n', ''),
     r'train.yaml:2: data.time: required: column of time \[s\]'),
    ('kind', 'run mine.yaml', ('mine.yaml', 'gauss4', 'gauss5'), 'integrator.kind: unknown kind '
     r"'gauss5'; did you mean gauss8\?; valid kinds: .*gauss4.* more\)"),
    ('kind', 'run mine.yaml', ('mine.yaml', SCENE[13:53], 'pendulum'),
     "hamiltonian: expected {kind: pendulum}, and further keys, not 'pendulum'"),
    ('type', 'run mine.yaml', ('mine.yaml', '[1.0]', '1.0'),
     r'mine.yaml:4: initial_state.q: must be a list, as in \[a, b\], not 1.0'),
    ('type', 'run robot.yaml', ('robot.yaml', 'joints: [j1]', 'gravity: 9.81'),
     r'robot.yaml:1: hamiltonian.gravity: must be a list, as in \[a, b\] \[m/s\^2\], not 9.81'),
    ('type', 'sweep sweep.yaml', ('sweep.yaml', '1.0\n', 'ten\n'),
     "sweep.yaml:2: duration: 'ten' is no number of seconds"),
    ('length', 'run mine.yaml', ('mine.yaml', '[1.0]', '[]'),
     r'initial_state.q: must have 1 or more entries, not \[\]'),
    ('length', 'run mine.yaml', ('mine.yaml', '[1.0]', '[1.0, 2.0]'),
     'initial_state.q: 2 values, expected 1, one for each coordinate: angle'),
    ('unit', 'run mine.yaml', ('mine.yaml', '0.01', '10 ms'),
     "step_size: '10 ms' is no number of seconds, e.g. 0.001"),
    ('unit', 'run mine.yaml', ('mine.yaml', 'mass: 1.0', 'mass: 1 kg'),
     r"hamiltonian.mass: '1 kg' is no number \[kg\]"),
    ('unit', 'run mine.yaml --duration 10s', None, "--duration: '10s' is no number of seconds"),
    ('negative', 'run mine.yaml', ('mine.yaml', 'mass: 1.0', 'mass: -1.0'),
     'mass = -1.0 must be a positive number'),
    ('negative', 'run mine.yaml --step-size -1', None, 'step_size: must be greater than 0'),
    ('negative', 'run mine.yaml --duration -1', None, 'duration = -1.0 must be'),
    ('nan', 'run mine.yaml', ('mine.yaml', '[1.0]', '[.nan]'),
     'initial_state.q.0: must be a finite number, not nan'),
    ('nan', 'train --config train.yaml --out x.safetensors', ('log.csv', '0.3,3', '0.3,nan'),
     r"log.csv:5: column 2 \(x\): expected a finite number, found 'nan'; leave such a row out"),
    ('file', 'run nothing.yaml', None, 'nothing.yaml: no such file; give the path of a scene'),
    ('file', 'run pendulumm', None, r'did you mean pendulum\?; .*`hnn scene --list` lists them'),
    ('file', 'train --config train.yaml --data nothing.csv --out x.safetensors', None,
     'nothing.csv: no such data file; pass the log with --data FILE'),
    ('file', 'evaluate mine.yaml --data nothing.npz', None, 'nothing.npz: cannot be read'),
    ('file', 'run robot.yaml', ('robot.yaml', 'arm.urdf', 'leg.urdf'),
     "hamiltonian.file: no file 'leg.urdf'; give a path from the folder of the scene"),
    ('empty', 'run mine.yaml', ('mine.yaml', SCENE, ''), 'mine.yaml:1: is empty'),
    ('empty', 'train --config train.yaml --out x.safetensors', ('log.csv', LOG, ''),
     'log.csv: 0 rows of data, expected a longer log'),
    ('empty', 'evaluate mine.yaml --data empty.npz', None, 'empty.npz: not an .npz file'),
    ('YAML', 'run mine.yaml', ('mine.yaml', 'step_size', '\tstep_size'),
     'mine.yaml:3: a tab; indent by spaces'),
    ('YAML', 'run mine.yaml', ('mine.yaml', '}\nstep', '\nstep'), 'mine.yaml:3: no YAML: '),
    ('YAML', 'run mine.yaml', ('mine.yaml', SCENE, 'hello'), 'expected a mapping of keys'),
    ('column', 'train --config train.yaml --out x.safetensors', ('train.yaml', '[x]', '[y]'),
     "log.csv:1: no column 'y' in the header: t, x, v; name the columns"),
    ('column', 'train --config train.yaml --out x.safetensors', ('log.csv', '0.3,3,', '0.3,'),
     'log.csv:5: 2 columns, expected 3: t, x, v'),
    ('column', 'train --config train.yaml --out x.safetensors', ('train.yaml', 'comma', 'tab'),
     'in the header: t,x,v; set data.delimiter: comma'),
    ('column', 'evaluate mine.yaml --data sw.npz --keys t,angle', None,
     'sw.npz: no key angle; it has .*; name them by --keys'),
    ('model', 'run model.yaml', None, r"model.yaml:1: hamiltonian.model: no model 'mine', nor "
     'models/mine.safetensors; shipped: '),
    ('model', 'evaluate junk.safetensors --data sw.npz', None,
     'junk.safetensors: not a safetensors file'),
    ('model', 'evaluate log.csv --data sw.npz', None, 'log.csv'),
    ('option', 'run mine.yaml --durration 3', None, r'did you mean --duration\?'),
    ('option', 'run mine.yaml --every 1.5', None, "--every: '1.5' is no whole number"),
    ('option', 'evaluate mine.yaml --data sw.npz --horizons x', None, "'x' is no number"),
    ('option', 'run mine.yaml more', None, "unknown argument 'more'"),
    ('option', 'run mine.yaml --integrator gauss5', None, r'did you mean gauss8\?; valid: '),
    ('robot', 'run arm.urdf', None, 'a robot, which needs a scene; write one with: hnn scene '
     '--new --robot arm.urdf'),
    ('robot', 'scene --new --robot arm.urdf', ('arm.urdf', chain([1.0], [1.0]), '<robot><link'),
     'arm.urdf:1: no XML'),
    ('robot', 'scene --new --robot arm.urdf', ('arm.urdf', chain([1.0], [1.0]), '<sdf/>'),
     'arm.urdf:1: <sdf>, expected <robot>: no URDF'),
    ('joint', 'run robot.yaml', ('robot.yaml', '[j1]', '[elbow]'),
     "joints names 'elbow': no such joint moves; moving joints: j1"),
    ('joint', 'run mine.yaml', ('mine.yaml', 'step_size', 'effects: [{kind: external_force, '
                                'coordinates: [elbow]}]\nstep_size'),
     "effects.0: external_force: no coordinate 'elbow'; valid coordinates: angle"),
    ('formula', 'run formula.yaml', ('formula.yaml', '+ x^2', '+ k*x^2'),
     "H column 15: no name 'k'; there are: x, p_x, m; give others a value in parameters"),
    ('formula', 'run formula.yaml', ('formula.yaml', 'x^2/2', 'foo(x)'),
     "H column 15: no function 'foo'"),
    ('formula', 'scene --new well --formula x^2', None, 'no momentum: write p_x for that of'),
    ('bag', 'recover_bag junk.mcap', None, 'junk.mcap: no MCAP file: it does not begin like one'),
    ('bag', 'evaluate mine.yaml --data folder', None,
     r'folder: expected a folder with one bag \(.mcap or .db3\), found none'),
    ('folder', 'run folder', None, r'folder: is a folder; give the path of a scene \(.yaml\)'),
    ('folder', 'train --config train.yaml --data folder --out x.safetensors', None,
     'folder: is a folder; pass the log'),
    ('permission', 'run mine.yaml --csv /proc/nothing/a.csv', None, "no folder '/proc/nothing'"),
    ('permission', 'sweep sweep.yaml --out mine.yaml', None,
     'mine.yaml: File exists; give another --out'),
    ('sweep', 'sweep sweep.yaml', ('sweep.yaml', 'hamiltonian.mass', 'hamiltonian.mas'),
     r"sweep.yaml:4: vary.0.keys.0: .*'?mas'?.*did you mean mass|hamiltonian.mas"),
    ('sweep', 'sweep sweep.yaml --shard 3/2', None, '--shard 3/2: expected I/N'),
    ('identify', 'identify mine.yaml --data sw.npz --free mas', None,
     r'--free mas: .* no such number; did you mean mass\?; valid: mass, length'),
    ('identify', 'identify mine.yaml --data sw.npz --free mass --bounds mass 2 1', None,
     '--bounds mass 2 1: expected two numbers, the lower one first'),
]


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
    """Return the line with which a command ends."""
    name, *argv = words
    try:
        said = run_module(module_of(name, argv), argv, f'hnn {name}')
    except SystemExit as end:
        said = end.code
    printed = capsys.readouterr().err
    return said if isinstance(said, str) else printed.rstrip('\n')


@pytest.mark.parametrize('line, change, expected', [entry[1:] for entry in MISTAKES], ids=[
    f'{number}-{entry[0]}' for number, entry in enumerate(MISTAKES)])
def test_mistake_is_answered_in_a_line(line, change, expected, folder, capsys, monkeypatch):
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
    assert re.search(expected, said), said
    # Three lines of a wide terminal at most; no words of libraries.
    assert '\n' not in said and len(said) < 400
    for words in ('Traceback', 'Errno', 'Field required', 'should be', 'should have', 'invalid '):
        assert words not in said


def test_of_many_names_the_nearest_are_offered():
    said = offered('gauss5', [f'method{k}' for k in range(40)] + ['gauss4', 'gauss6'])
    assert 'did you mean gauss' in said and 'gauss4' in said and '... (34 more)' in said
    assert offered('b', ['a', 'c']) == '; valid: a, c'
    assert len(offered('x', shipped_names('scene'))) < 240
