# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The scene executable: each task, its exit status, and the schema that editors read."""

from dataclasses import replace
import json
import math
import os
from pathlib import Path
import re

from hnn_vi_ros.commands import names
from hnn_vi_ros.commands.scene_tool import _times, energy_moved, explain, lyapunov_line, main
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.files import json_schema, shipped_file, shipped_names
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.run import measure_effects, report
from hnn_vi_ros.run.report import EffectCosts
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import EnergyByCause, simulate, Simulation
from messages import assert_message
import numpy as np
import pytest
from python_process import run_code
from scene_files import write_scene

ROOT = Path(__file__).parents[2]
SCHEMA = json.loads(json_schema(Scene, 'A scene of hnn_vi_ros'))
# Those whose model is shipped.
SCENES = [name for name in shipped_names('scene') if name != 'air_track']
# Says what is announced, and as a last line what numba compiles.
STARTED = """
from numba.core.event import RecordingListener, install_listener
from hnn_vi_ros import simulate
from hnn_vi_ros.kernels.compilation import announced
with announced(print), install_listener('numba:compile', RecordingListener()) as heard:
    simulate({scene!r}, 1.0)
print(*(event.data['dispatcher'] for _, event in heard.buffer))
"""


@pytest.mark.parametrize('names', [
    ['bouncing_mass', 'heavy_top', 'pendulum'], pytest.param(SCENES, marks=pytest.mark.long)],
    ids=len)
def test_check_says_of_a_shipped_scene_what_it_is(names, capsys):
    assert main(['--check', *names]) == 0
    captured = capsys.readouterr()
    assert captured.err == ''
    for name, line in zip(names, captured.out.splitlines(), strict=True):
        assert re.fullmatch(rf'{name}: valid: .+, h = [\d.]+ s, (not )?conservative', line)


def test_check_answers_each_scene_and_fails_if_one_is_wrong(tmp_path, capsys):
    text = shipped_file('scene', 'bouncing_mass').read_text(encoding='utf-8')
    wrong = tmp_path / 'wrong.yaml'
    wrong.write_text(text.replace('coordinate: z', 'coordinate: y', 1))
    assert main(['--check', 'harmonic_oscillator', str(wrong), 'nothing', 'kepler']) == 1
    captured = capsys.readouterr()
    assert [line.partition(':')[0] for line in captured.out.splitlines()] == [
        'harmonic_oscillator', 'kepler']
    first, second = captured.err.splitlines()
    assert 'wrong.yaml' in first and 'effects.0' in first and 'valid coordinates: z' in first
    assert second.startswith("hnn scene: no scene 'nothing'; shipped: ")


def test_check_places_an_effect_that_the_method_cannot_take(tmp_path, capsys):
    text = shipped_file('scene', 'brownian_oscillator').read_text(encoding='utf-8')
    wrong = tmp_path / 'wrong.yaml'
    wrong.write_text(text.replace('generalized_leapfrog', 'rk4'))
    assert main(['--check', str(wrong)]) == 1
    assert_message(capsys.readouterr().err.removesuffix('\n'))


@pytest.mark.parametrize(('sensor', 'said'), [
    ('noise: [0.1, 0.2]', 'noise has 2 values, expected 1'),
    ('noise: 1.0e+308', 'less than or equal to 1000000000'),
    ('bias: [-1.0e+10]', 'equal to -1000000000'),
    ('quantisation: 1.0e-300', 'quantisation = 1e-300: expected 0, or at least 1e-15'),
    ('rate: 33.0', 'rate = 33 Hz: expected the rate of the samples')])
def test_check_refuses_a_sensor_that_no_run_can_have(sensor: str, said: str, tmp_path, capsys):
    text = shipped_file('scene', 'exact_pendulum').read_text(encoding='utf-8')
    wrong = tmp_path / 'wrong.yaml'
    wrong.write_text(f'{text}measurements: {{joint_states: {{{sensor}}}}}\n')
    assert main(['--check', str(wrong)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert 'measurements.joint_states' in line and said in line


@pytest.mark.parametrize('arguments', [
    [], ['--check'], ['--new', '--schema'], ['--new'], ['--schema', '--out', 'a.yaml'],
    ['--explain'], ['--explain', 'a', 'b'], ['kepler'], ['--schema', '--robot', 'a.urdf'],
    ['--schema', '--no-rescue']])
def test_wrong_usage_exits_2_and_says_which_tasks_there_are(arguments: list[str], capsys):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert_message(capsys.readouterr().err.removesuffix('\n'))


def test_list_names_every_scene_and_marks_those_without_their_model(
        tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)  # no models/ of the user's
    assert names.main(['scenes']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == shipped_names('scene')
    assert len({line.index(load_scene(line.split()[0]).description) for line in lines}) == 1
    assert [line.split()[0] for line in lines if 'model absent' in line] == ['air_track']


@pytest.mark.parametrize('what, known', [
    ('integrators', INTEGRATORS), ('effects', EFFECTS), ('models', shipped_names('model')),
    ('tasks', shipped_names('task'))])
def test_list_has_a_line_with_a_description_for_every_name(what, known, capsys):
    assert names.main([what]) == 0
    rows = [line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines()]
    assert [name for name, _ in rows] == [*known]


def test_list_of_something_else_is_one_line(capsys):
    for argv in (['scene'], []):
        with pytest.raises(SystemExit):
            names.main(argv)
        assert_message(capsys.readouterr().err.removesuffix('\n'))


def test_schema_that_is_shipped_is_that_of_the_code(capsys):
    assert main(['--schema']) == 0
    assert (ROOT / 'config' / 'scene.schema.json').read_text(encoding='utf-8') \
        == capsys.readouterr().out
    assert SCHEMA['$schema'] == 'https://json-schema.org/draft/2020-12/schema'
    assert all(part['additionalProperties'] is False
               for part in (SCHEMA, *SCHEMA['$defs'].values()))


def test_shipped_scene_names_the_schema_first():
    for name in shipped_names('scene'):
        path = shipped_file('scene', name)
        modeline = path.read_text(encoding='utf-8').partition('\n')[0]
        assert modeline == '# yaml-language-server: $schema=../scene.schema.json', name
        assert (path.parent / '../scene.schema.json').is_file()


def test_schema_describes_every_key_and_the_unit_of_every_number():
    fields = [(owner, key, field) for owner, part in [('Scene', SCHEMA), *SCHEMA['$defs'].items()]
              for key, field in part['properties'].items()]
    assert [(owner, key) for owner, key, field in fields if not field['description'] or (
        '"number"' in json.dumps(field)
        and not re.search(r'\[.+\]|\bunits?\b', field['description']))] == []


def described(scene: Scene) -> str:
    """Return what is told before anything is measured, which takes a compiler."""
    lines = []
    for line in explain(scene):
        lines.append(line)
        if line.startswith('conservative: '):
            break
    return '\n'.join(lines)


@pytest.fixture
def damped(tmp_path) -> Path:
    return write_scene(
        tmp_path / 'mine.yaml', 'harmonic_oscillator, stiffness: 2',
        '{kind: damping, rate: 0.1}, {kind: damping, rate: [0.2]}', 'symplectic_euler', q=[-1.5])


def assert_told(out: str, *expected: str) -> None:
    for words in expected:
        assert re.search(words, out), words


def test_explain_tells_the_system_and_what_each_effect_is(damped):
    assert_told(
        described(load_scene(damped)),
        r'hamiltonian harmonic_oscillator: A mass on a linear spring, H',
        r'stiffness = 2.0: k > 0 \[N/m\]', r'coordinate x \[m\] from -1.5',
        r'effect damping: Linear damping', r'rate = 0.1: gamma >= 0 \[1/s\]', r'does work',
        r'rate = \[0.2\]: ', r'integrator symplectic_euler: ',
        r'order 1, step_size = 0.01 \[s\]', r'conservative: no')


# Two of a kind: leaving out the one or the other leaves the same kernel, compiled once.
@pytest.mark.long
def test_explain_tells_what_each_effect_adds(damped, capsys):
    assert main(['--explain', str(damped)]) == 0
    assert_told(
        capsys.readouterr().out, r'conservative: no',
        r'Lyapunov time: none found within [\d.e+]+ s: .* regular',
        r'time per step: \d+\.\d+ us', r'integrator alone: \d+\.\d+ us',
        r'damping_0 adds -?\d+\.\d+ us, moves [\d.]+ J in 10 s',
        r'damping_1 adds -?\d+\.\d+ us, moves [\d.]+ J in 10 s')


def test_explain_tells_the_energy_that_each_effect_moved_and_which_one_is_not_called_for():
    names = ('work/motors+lag/a', 'work/motors/b', 'work/drag', 'stored/spring',
             'stored/hamiltonian', 'heat/drag', 'error')
    values = np.outer([0.0, 1.0, 0.5], [2.0, -1.0, -1e-7, 0.3, 5.0, 1e-7, 1e-6])
    run = replace(simulate('exact_pendulum', 0.02), energy_by_cause=EnergyByCause(
        np.arange(3.0), names, values, 'J'))
    labels = ['motors', 'lag', 'drag', 'spring', 'idle']
    moved = energy_moved(run, labels)
    # The range of each column, of all joints; heat is not counted again.
    assert moved == {'': 1e-6, 'motors': 3.0, 'lag': 2.0, 'drag': 1e-7, 'spring': 0.3, 'idle': 0.0}
    costs = EffectCosts(1e-6, 5e-7, dict.fromkeys(labels, 1e-7) | {'spring': -5e-6})
    told = list(_times(costs, load_scene('exact_pendulum'), moved, 'J'))
    assert told[2] == '  motors adds 0.100 us, moves 3 J in 10 s'
    assert told[4].endswith('less than the error of the method, 1e-06 J: not called for')
    assert '-5.000 us (steps of the motion without it take longer)' in told[5]
    # What did nothing, such as a motor without a command, may be called for in another run.
    assert told[6] == '  idle adds 0.100 us, moves 0 J in 10 s'


def test_explain_tells_where_a_body_starts_column_by_column():
    assert_told(
        described(load_scene('heavy_top')),
        r'  rotation attitude: attitude_qx \[1\] from 0.258819, .*_qw \[1\] from 0.96',
        r'  rotation attitude, momenta: attitude_rx \[kg m2/s\] from 0, .*_rz .* from 6\n')


@pytest.mark.parametrize('time, said', [(12.34, 'Lyapunov time: 12.3 s: the motion is chaotic'), (
    math.inf, 'Lyapunov time: none found within 102.4 s: the motion is regular so far')])
def test_explain_tells_the_lyapunov_time(monkeypatch, time, said):
    monkeypatch.setattr('hnn_vi_ros.simulation.lyapunov_time', lambda *arguments: time)
    assert lyapunov_line(load_scene('henon_heiles'), 2048) == said


@pytest.mark.long
def test_explain_tells_what_auto_chose_and_that_a_regular_motion_is_not_chaotic(
        tmp_path, capsys, monkeypatch):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'cache'))
    path = tmp_path / 'mine.yaml'
    path.write_text('hamiltonian: {kind: pendulum}\n'
                    'integrator: {kind: auto, energy_error: 1.0e-5, horizon: 100.0}\n'
                    'initial_state: {q: [2.5], p: [0.0]}\n')
    assert main(['--explain', str(path)]) == 0
    assert_told(
        capsys.readouterr().out, r'integrator (gauss\d+|stormer_verlet): ',
        r'step_size = [\d.e-]+ \[s\]', r'chose .* for energy_error 1e-05 of [\d.]+ J up to 100 s',
        r'Lyapunov time: none found within [\d.e+]+ s', r'time per step: \d+\.\d+ us')


@pytest.mark.long
def test_explain_tells_the_lyapunov_time_of_a_chaotic_motion():
    line = re.fullmatch(r'Lyapunov time: ([\d.]+) s: the motion is chaotic',
                        lyapunov_line(load_scene('henon_heiles'), 2**16))
    # As test_lyapunov has it from the variational equations: some ten to thirty seconds.
    assert line and 5.0 < float(line[1]) < 50.0


def test_explain_says_why_a_lyapunov_time_is_not_measured():
    line = lyapunov_line(load_scene('bouncing_mass'), 2048)
    assert line.startswith('Lyapunov time: not measured: impact: supported for one motion')


def test_measure_effects_of_a_scene_without_effects_is_its_bare_integrator():
    parts = load_scene('exact_harmonic_oscillator').parts()
    costs = measure_effects(parts, batches=3, batch_time=1e-3)
    assert costs.added == {} and costs.total > 0.0 and costs.bare > 0.0


def test_measure_effects_takes_the_loading_of_code_for_no_step(monkeypatch):
    given, taken = [1.0], list[int]()

    def run(simulation: Simulation, scene: Scene, steps: int) -> float:
        taken.append(steps)
        return given.pop() if given else 1e-6 * steps
    monkeypatch.setattr(report, '_run', run)
    costs = measure_effects(load_scene('exact_pendulum').parts(), batches=3, batch_time=1e-3)
    assert costs.total == pytest.approx(1e-6, rel=1e-12) and taken[-1] >= 500


def test_measure_effects_knows_no_time_of_a_scene_that_cannot_do_without_an_effect(tmp_path):
    # In its third step explicit Euler overflows, unless it is damped.
    path = write_scene(tmp_path / 'mine.yaml', 'harmonic_oscillator, stiffness: 1.0e+150',
                       '{kind: damping, rate: 3.0}', 'explicit_euler', 1000.0)
    costs = measure_effects(load_scene(path).parts(), batches=3, batch_time=2e-3)
    assert costs.total > 0.0 and math.isnan(costs.bare) and math.isnan(costs.added['damping'])


def test_scene_that_was_compiled_compiles_nothing_when_it_starts():
    assert main(['--compile', 'exact_pendulum']) == 0
    code = STARTED.format(scene='exact_pendulum')
    assert run_code(code, check=True).stdout == '\n'


def test_check_tells_an_angle_of_many_turns(tmp_path, capsys):
    scene = load_scene('exact_pendulum').changed({'initial_state': {'q': [143.0], 'p': [0.0]}})
    (tmp_path / 'far.yaml').write_text(scene.to_yaml())
    assert main(['--check', str(tmp_path / 'far.yaml')]) == 0
    assert capsys.readouterr().out.endswith('; angle starts at 143 rad, 22.8 turns\n')


@pytest.mark.long
def test_scenes_that_were_compiled_compile_nothing_when_they_start(tmp_path):
    """In later processes: the loop, H, and what guards and samples take of it."""
    shipped = shipped_file('scene', 'exact_pendulum').read_text(encoding='utf-8')
    scene, damped, other = (tmp_path / f'{name}.yaml' for name in ('mine', 'damped', 'other'))
    scene.write_text(shipped.replace('variational_euler', 'stormer_verlet'), encoding='utf-8')
    # The same with an effect; and one that is not compiled.
    damped.write_text(scene.read_text(encoding='utf-8')
                      + 'effects: [{kind: damping, rate: 0.4}]\n', encoding='utf-8')
    other.write_text(shipped.replace('variational_euler', 'symplectic_euler'), encoding='utf-8')
    environment = os.environ | {'NUMBA_CACHE_DIR': str(tmp_path / 'cache')}

    def run(code: str) -> str:
        return run_code(code, check=True, env=environment).stdout

    def start(scene: Path) -> str:
        return run(STARTED.format(scene=str(scene)))

    # One after another: what they share is compiled once.
    for path in damped, scene:
        assert re.fullmatch(r'.+: compiled in [\d.]+ s\n', run(
            'import sys; from hnn_vi_ros.commands.scene_tool import main\n'
            f"sys.exit(main(['--compile', {str(path)!r}]))"))
    assert start(scene) == start(damped) == '\n'
    cold = start(other)
    assert re.search(r'compiling the loop over steps once: about \d+ s\n', cold)
    assert 'advance' in cold.splitlines()[-1]


def test_compile_says_what_is_wrong_with_a_scene_and_compiles_the_others(capsys):
    assert main(['--compile', 'nothing', 'exact_pendulum']) == 1
    captured = capsys.readouterr()
    assert captured.out.startswith('exact_pendulum: compiled in ')
    assert captured.err.startswith("hnn scene: no scene 'nothing'")
