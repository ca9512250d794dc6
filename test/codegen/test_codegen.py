# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Test exported scenes: C programs that take the same steps as simulations, bit by bit."""

from collections import Counter
import csv
import ctypes
from functools import cache
import math
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import tempfile
from threading import Thread
from xml.etree import ElementTree
from zipfile import ZipFile

from helpers import long
from hnn_vi_ros.codegen import (
    compile_scene, entries, escaped, export, identifier, prefix_of, scene_code, write_fmu,
    write_project)
from hnn_vi_ros.codegen.arguments import COMPILERS, HOST
from hnn_vi_ros.codegen.entries import EVENT, INVALID_COMMAND, INVALID_STATE
from hnn_vi_ros.codegen.project import FUNCTIONS
from hnn_vi_ros.effects import JointCommand
from hnn_vi_ros.errors import HnnViRosError, StepFailure
from hnn_vi_ros.files import one_line, prefixes, share_folder
from hnn_vi_ros.integrators import base, NOT_FINITE, OK, REASONS
from hnn_vi_ros.scene import load_scene, Scene, with_numbers
from hnn_vi_ros.simulation import build, watched
from messages import refused
import numpy as np
import pytest

SERVO = {'kind': 'servo', 'coordinates': ['angle'], 'stiffness': 3.0, 'damping': 0.3,
         'effort_limit': 2.0, 'position': [0.5]}
ARM = {'kind': 'servo', 'coordinates': ['elbow', 'wrist_1'], 'stiffness': 40.0, 'damping': 4.0,
       'position': [0.6, 0.0], 'gravity_compensation': 'model'}
LOAD = {'link': 'flange', 'mass': 0.5, 'centre': [0.02, -0.03, 0.08]}


def attention():
    """Return a scene with an attention network that was exported from torch."""
    import torch
    from hnn_vi_ros.learning import export as export_module
    from torch import nn

    class Attention(nn.Module):

        def __init__(self):
            super().__init__()
            self.embed, self.last = nn.Linear(2, 4), nn.Linear(4, 1)
            self.query, self.key, self.value = (nn.Linear(4, 4) for _ in range(3))

        def forward(self, x):
            h = self.embed(torch.stack(x.chunk(2, -1), -1))
            weights = torch.softmax(self.query(h) @ self.key(h).transpose(1, 2) / 2.0, -1)
            return self.last(torch.tanh(h + weights @ self.value(h))).sum((1, 2)) \
                + 0.5 * (x**2).sum(-1)

    torch.manual_seed(1)
    path = Path(tempfile.mkdtemp(), 'attention.safetensors')
    box = [(-2.0, 2.0)] * 3
    export_module(Attention(), path, ['x', 'y', 'z'], {'q': box, 'p': box})
    return Scene.build(hamiltonian={'kind': 'hnn', 'model': str(path)},
                       integrator={'kind': 'implicit_midpoint'}, step_size=0.05,
                       initial_state={'q': [0.5, -0.2, 0.1], 'p': [0.0, 0.3, 0.0]})


def loaded_arm():
    """Return an arm with a payload, a servo and friction."""
    arm = load_scene('six_joint_arm')
    return arm.changed({
        'hamiltonian': arm.model_dump()['hamiltonian'] | {'payload': LOAD},
        'effects': [ARM, {'kind': 'joint_friction', 'damping': {'elbow': 0.1},
                          'friction': {'elbow': 0.5}, 'speed': 0.01}]})


def changed(name, **changes):
    return lambda: load_scene(name).changed(changes)


FORMULA = {'hamiltonian': {'kind': 'formula', 'coordinates': ['x'],
                           'H': 'p_x**2/(2*m) + k*m**1.5*x**4/4',
                           'parameters': {'m': 1.0, 'k': 1.0}},
           'integrator': {'kind': 'gauss4'}, 'step_size': 0.05,
           'initial_state': {'q': [1.0], 'p': [0.0]}}
SCENES = {
    'pendulum': changed('pendulum'),
    'servo': changed('pendulum', effects=[SERVO]),
    'gauss8': changed('double_pendulum', integrator={'kind': 'gauss8'}, step_size=0.02),
    'arm': loaded_arm,
    'four_bar': changed('four_bar'),
    'gear': changed('gripper'),
    'quadrotor': changed('quadrotor'),
    'body': changed('turning_pendulum'),
    'attention': attention,
    'formula': lambda: Scene.build(**FORMULA),
    'time': changed('driven_duffing'),
    'driven': changed('exact_damped_driven_pendulum'),
    'pair': changed('double_pendulum', integrator={'kind': 'dop853', 'relative_tolerance': 1e-7}),
}
QUICK = 'servo', 'time'


@cache
def exported(name):
    """Return a scene, its code, and the folder and prefix of its files."""
    scene = SCENES[name]()
    code = compile_scene(scene, name)
    folder = Path(tempfile.mkdtemp(), name)
    write_project(folder, name, code)
    return scene, code, folder


class Library:
    """The functions of an exported scene, called by ctypes."""

    def __init__(self, name):
        self.scene, self.code, folder = exported(name)
        library = ctypes.CDLL(str(folder / f'{name}.so'))
        for function in FUNCTIONS:
            setattr(self, function, getattr(library, f'{name}_{function}'))
        self.energy.restype = ctypes.c_double

    def state(self):
        memory = np.zeros(self.code.image.words.size + 8, dtype=np.int64)
        begin = -memory.ctypes.data // 8 % 8
        own = memory[begin:begin + self.code.image.words.size]
        assert self.init(address(own)) == 0
        return own

    def take(self, state, n, command=None):
        numbers = None if command is None else address(np.array(command))
        return self.step(address(state), numbers, ctypes.c_int64(n))

    def values(self, state):
        out = np.full(len(self.code.outputs), np.nan)
        assert self.outputs(address(state), address(out)) == 0
        return dict(zip((one.name for one in self.code.outputs), out.tolist(), strict=True))

    def point(self, state):
        """Return q and p."""
        outputs = self.code.machine.outputs
        return [*self.values(state).values()][:outputs.q_size + outputs.p_size]


def address(array):
    pointer = ctypes.c_void_p(array.ctypes.data)
    pointer.array = array  # keeps the memory
    return pointer


def program(name):
    """Return the example of a scene, compiled as standard C without warnings."""
    _, _, folder = exported(name)
    subprocess.run(['cc', '-std=c11', '-Wall', '-Wextra', '-Wpedantic', '-Werror', 'example.c',
                    f'lib{name}.a', '-lm', '-o', 'example'], cwd=folder, check=True)
    return folder / 'example'


@pytest.mark.parametrize('name', [name if name in QUICK else long(name) for name in SCENES])
def test_c_program_takes_the_steps_of_simulate_bit_by_bit(name):
    steps, every = 100_000, 20_000
    lines = subprocess.run([program(name), str(steps), str(every)], capture_output=True, text=True,
                           check=True).stdout.splitlines()
    rows = np.array(list(csv.reader(lines[1:])), dtype=float)
    simulation = build(SCENES[name]())
    q, p = simulation.record(steps // every, every)
    assert rows.shape[0] == 1 + steps // every
    assert np.array_equal(rows[1:, :q.shape[1]], q)
    assert np.array_equal(rows[1:, q.shape[1]:q.shape[1] + p.shape[1]], p)
    last = dict(zip(lines[0].split(','), rows[-1], strict=True))
    assert last['energy [J]'] == simulation.energy
    assert last['gradients [1]'] == simulation.gradients
    assert {key: last[f'work_{key} [J]'] for key in simulation.works} == simulation.works
    # Nobody has rescued a step: the program cannot.
    assert simulation.rescued == simulation.several_solutions == 0


@pytest.mark.parametrize('name', [name if name in QUICK else long(name) for name in SCENES])
def test_object_needs_the_mathematical_library_only(name):
    _, code, folder = exported(name)
    listed = subprocess.run(['nm', '-u', f'lib{name}.a'], cwd=folder, capture_output=True,
                            text=True, check=True).stdout.split()
    needed = {word for word in listed if word != 'U' and not word.endswith('.o:')}
    assert needed <= {'sin', 'cos', 'sincos', 'tan', 'asin', 'acos', 'atan', 'atan2', 'exp',
                      'exp2', 'expm1', 'log', 'log1p', 'log2', 'pow', 'sqrt', 'tanh', 'sinh',
                      'cosh', 'hypot', 'fmod', 'floor', 'ceil', 'cbrt', 'memcpy', 'memmove',
                      'memset', 'asinh', 'acosh', 'atanh', 'erf', 'erfc', 'log10'}
    # No memory of its own changes.
    sections = subprocess.run(['nm', f'lib{name}.a'], cwd=folder, capture_output=True, text=True,
                              check=True).stdout.split()
    assert not {'B', 'b', 'D', 'C'} & set(sections)
    # Names of Python and of folders do not reach other machines.
    assert not re.search(rb'numba|/site-packages|\.py\b', code.code)
    # All that is linked into a program, without the weights and other numbers of arrays.
    linked = subprocess.run(['size', f'lib{name}.a'], cwd=folder, capture_output=True, text=True,
                            check=True).stdout.split()[9]
    weights = 8 * np.count_nonzero(code.image.words[code.image.changing:])
    assert int(linked) - weights < (400_000 if name == 'body' else 300_000)


@pytest.mark.long
def test_equal_scenes_give_equal_files_in_every_process(tmp_path):
    subprocess.run([sys.executable, '-m', 'hnn_vi_ros', 'export', 'driven_duffing', '--out',
                    str(tmp_path / 'one'), '--fmu', str(tmp_path / 'one.fmu')], check=True)
    code = compile_scene(SCENES['time'](), 'driven_duffing')
    write_project(tmp_path / 'two', 'driven_duffing', code)
    write_fmu(tmp_path / 'two.fmu', 'driven_duffing', code)
    assert (tmp_path / 'one.fmu').read_bytes() == (tmp_path / 'two.fmu').read_bytes()
    for path in (tmp_path / 'one').iterdir():
        assert path.read_bytes() == (tmp_path / 'two' / path.name).read_bytes()


def test_commands_act_as_in_a_simulation():
    library, simulation = Library('servo'), build(SCENES['servo']())
    state, nan = library.state(), np.nan
    for position, velocity in ((1.0, nan), (nan, 2.0), (nan, nan), (-0.5, 0.3)):
        assert library.take(state, 50, [position, velocity]) == 0
        if not np.isnan([position, velocity]).all():
            simulation.set_command(JointCommand(
                ['angle'], np.array([position]), np.array([velocity]), np.array([nan])))
        simulation.advance(50)
        assert library.point(state) == [*simulation.q, *simulation.p]
        values = library.values(state)
        assert values['angle_velocity'] == simulation.dH_dp[0]
        assert values['angle_effort'] == simulation.motors.forces(
            simulation.time, simulation.q, simulation.p, simulation.dH_dp)[0]


@pytest.mark.long
def test_efforts_expire_as_in_a_simulation():
    library, simulation = Library('quadrotor'), build(SCENES['quadrotor']())
    state = library.state()
    for command in ([9.0, 0.01, 0.0, 0.0], [7.0, 0.0, -0.01, 0.001], None):
        assert library.take(state, 70, command) == 0
        if command:
            simulation.set_command(command)
        simulation.advance(70)
        assert library.point(state) == [*simulation.q, *simulation.p]


@pytest.mark.parametrize('number', [np.inf, -np.inf, 1e13])
def test_invalid_command_changes_nothing(number):
    library = Library('servo')
    state = library.state()
    before = state.copy()
    assert library.take(state, 5, [number, np.nan]) == INVALID_COMMAND
    assert np.array_equal(state, before)


def test_saved_state_continues_bit_by_bit_elsewhere():
    library = Library('servo')
    state = library.state()
    saved = np.zeros(1 + state.size - library.code.image.changing, dtype=np.int64)
    library.take(state, 37, [0.7, np.nan])
    assert library.save(address(state), address(saved)) == 0
    library.take(state, 100)
    other = library.state()
    assert library.restore(address(other), address(saved)) == 0
    library.take(other, 100)
    assert library.values(other) == library.values(state)


def test_state_saved_by_an_object_of_other_code_is_refused(monkeypatch):
    for factor in (1, 2):
        SCENES[f'event{factor}'] = lambda factor=factor: Scene.build(**FORMULA | {
            'integrator': {'kind': 'stormer_verlet'},
            'events': [{'when': f'x = {factor}*p_x'}]})
    library = Library('event1')
    monkeypatch.setattr(scene_code, 'image_of', lambda _: library.code.image)
    other = Library('event2')
    state, foreign = library.state(), other.state()
    before = state.copy()
    saved = np.zeros(1 + max(state.size, foreign.size), dtype=np.int64)
    other.save(address(foreign), address(saved))
    assert library.restore(address(state), address(saved)) == INVALID_STATE
    assert np.array_equal(state, before)
    assert other.restore(address(foreign), address(saved)) == OK


def test_start_begins_at_another_state():
    library, simulation = Library('servo'), build(SCENES['servo']())
    state = library.state()
    assert library.start(address(state), address(np.array([0.1])), address(np.array([-1.0]))) == 0
    simulation.restart([0.1], [-1.0])
    library.take(state, 100)
    simulation.advance(100)
    assert library.point(state) == [*simulation.q, *simulation.p]
    assert library.start(address(state), address(np.array([np.nan])),
                         address(np.array([0.0]))) == NOT_FINITE


def test_states_are_independent_in_threads():
    library = Library('servo')
    states = [library.state() for _ in range(4)]
    threads = [Thread(target=library.take, args=(state, 20_000, [0.1 * k, np.nan]))
               for k, state in enumerate(states)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for k, state in enumerate(states):
        alone = library.state()
        library.take(alone, 20_000, [0.1 * k, np.nan])
        assert library.values(alone) == library.values(state)


def test_events_end_calls_after_their_steps():
    scene = Scene.build(**FORMULA).changed({'events': [
        {'when': 'x = 0', 'direction': 'down'}, {'when': 'v_x^2 + H/2 = p_x + 1'}]})
    SCENES['events'] = lambda: scene
    library, simulation = Library('events'), watched(build(scene), scene)
    state, h, found = library.state(), scene.step_size, []
    while (status := library.take(state, 400 - sum(found))) == EVENT:
        found.append(round(library.values(state)['time'] / h) - sum(found))
    assert status == OK
    simulation.advance(400)
    # The times of a simulation are in the steps after which calls end.
    ends = {math.ceil(event.t / h) for event in simulation.events}
    assert np.cumsum(found).tolist() == sorted(ends) and len(found) > 5
    assert library.point(state) == [*simulation.q, *simulation.p]
    values = library.values(state)
    counts = Counter(event.when for event in simulation.events)
    assert [values['event_1'], values['event_2']] == [
        counts[one.when] for one in scene.events]
    state = library.state()
    assert library.take(state, 400) == EVENT
    assert library.values(state)['time'] == found[0] * h


def test_numbers_of_the_scene_can_be_changed():
    library, changes = Library('servo'), {'effects.0.stiffness': 4.0, 'effects.0.damping': 0.5}
    simulation = build(with_numbers(SCENES['servo'](), changes))
    state, tuned = library.state(), [one for one in library.code.parameters if one.powers]
    values = np.array([changes.get(one.name, np.nan) for one in tuned])
    assert np.isfinite(values).sum() == 2
    assert library.tune(address(state), address(values)) == OK
    library.take(state, 200)
    simulation.advance(200)
    assert library.point(state) == [*simulation.q, *simulation.p]
    assert library.values(state)['angle_effort'] == simulation.motors.forces(
        simulation.time, simulation.q, simulation.p, simulation.dH_dp)[0]
    before = state.copy()
    for value in (-1.0, np.inf):
        values[0] = value
        assert library.tune(address(state), address(values)) == INVALID_COMMAND
        assert np.array_equal(state, before)


def test_several_numbers_of_one_word_can_be_changed():
    library, other = Library('formula'), with_numbers(SCENES['formula'](), {
        'hamiltonian.parameters.m': 3.0, 'hamiltonian.parameters.k': 0.7})
    state, simulation = library.state(), build(other)
    assert [one.name for one in library.code.parameters] == [
        'hamiltonian.parameters.m', 'hamiltonian.parameters.k']
    library.tune(address(state), address(np.array([3.0, 0.7])))
    library.take(state, 20)
    simulation.advance(20)
    # Words are products of powers, rounded several times.
    assert library.point(state) == pytest.approx([*simulation.q, *simulation.p], rel=1e-13)


def test_alarms_are_outputs():
    library, simulation = Library('servo'), build(SCENES['servo']())
    state, (low, high) = library.state(), np.concatenate(simulation.hamiltonian.box).T
    library.start(address(state), address(np.array([0.5])), address(np.array([30.0])))
    simulation.restart([0.5], [30.0])
    for _ in range(5):
        library.take(state, 20)
        simulation.advance(20)
        values = library.values(state)
        # Sums of three terms, each rounded.
        assert values['energy_error'] == pytest.approx(
            simulation.energy_balance, abs=4.0 * np.finfo(float).eps * abs(simulation.energy))
        z = np.append(simulation.q, simulation.p)
        assert values['outside_domain'] == pytest.approx(
            (np.maximum(low - z, z - high) / (0.5 * (high - low))).max(), rel=1e-15)
        assert values['outside_domain'] > 0.0


def test_failed_steps_are_rescued_as_in_a_simulation():
    scene = Scene.build(**FORMULA).changed({'step_size': 20.0})
    SCENES['rescued'] = lambda: scene
    library, simulation = Library('rescued'), build(scene)
    state, found = library.state(), []
    for _ in range(4):
        assert library.take(state, 5) == OK
        simulation.advance(5)
        assert library.point(state) == [*simulation.q, *simulation.p]
        values = library.values(state)
        assert values['gradients'] == simulation.gradients
        assert values['residual'] == simulation.residual
        assert values['rescued_steps'] == simulation.rescued
        found.append(simulation.rescued)
    assert 0 < found[-1] < 20


def test_failed_step_returns_its_status_and_leaves_the_state_before_it():
    scene = Scene.build(**FORMULA).changed({
        'step_size': 50.0, 'on_failure': 'stop',
        'integrator': {'kind': 'gauss4', 'solver': 'fixed_point'}})
    SCENES['failing'] = lambda: scene
    library = Library('failing')
    state = library.state()
    before = library.point(state)
    with pytest.raises(StepFailure) as failure:
        build(scene).advance(10)
    assert REASONS[library.take(state, 10)] in str(failure.value)
    assert library.point(state) == before
    assert library.values(state)['time'] == 0.0


def test_any_names_of_joints_are_valid_c(tmp_path):
    _, code, _ = exported('servo')
    names = ['θ', 'φ', 'Time', '*/ "q\\']
    outputs = [one._replace(name=name, text=f'coordinate {name}')
               for name, one in zip(names, code.outputs, strict=False)]
    write_project(tmp_path / 'c', 'int', code._replace(
        outputs=[*outputs, *code.outputs[len(names):]]))
    subprocess.run(['cc', '-std=c11', '-Wall', '-Wextra', '-Wpedantic', '-Werror', '-c',
                    'example.c'], cwd=tmp_path / 'c', check=True)
    header = (tmp_path / 'c' / 'int.h').read_text()
    found = [name for name in re.findall(r'  INT_OUT_(\w+)', header) if 'TIME' in name]
    # The time keeps its name.
    assert found == ['TIME_2', 'TIME']
    assert '"*/ \\"q\\\\ [N m]"' in (tmp_path / 'c' / 'example.c').read_text()


def test_two_scenes_are_linked_into_one_program(tmp_path):
    folders = [exported(name)[2] for name in QUICK]
    (tmp_path / 'both.c').write_text(''.join(f'#include "{name}.h"\n' for name in QUICK) + (
        'int main(void) { static servo_state one; static time_state other; '
        'return servo_init(&one) || time_init(&other) || servo_step(&one, 0, 10) || '
        'time_step(&other, 0, 10); }\n'))
    subprocess.run(['cc', 'both.c', *(f'-I{folder}' for folder in folders),
                    *(str(folder / f'lib{name}.a') for folder, name in zip(
                        folders, QUICK, strict=True)), '-lm', '-o', 'both'],
                   cwd=tmp_path, check=True)
    subprocess.run([tmp_path / 'both'], check=True)


def test_no_steps_and_less_alignment_change_nothing():
    library = Library('servo')
    state = library.state()
    before = state.copy()
    for n in (0, -5):
        assert library.take(state, n) == OK
        assert np.array_equal(state, before)
    memory = np.zeros(state.size + 9, dtype=np.int64)
    # Addresses of doubles, in the middle of a line of the cache.
    begin = -memory.ctypes.data // 8 % 8 + 1
    other = memory[begin:begin + state.size]
    assert library.init(address(other)) == OK
    for own in (state, other):
        assert library.take(own, 100) == OK
    assert library.values(other) == library.values(state)


@pytest.mark.parametrize('name', ['taylor', 'measurements', 'observer', 'delay', 'link_wrench',
                                  'energy_by_cause'])
def test_scene_with_what_is_not_compiled_is_refused(name):
    joints = ['angle1', 'angle2']
    scene = load_scene('gripper' if name == 'link_wrench' else 'exact_double_pendulum').changed({
        'link_wrench': {'effects': [{'kind': 'link_wrench'}]},
        'energy_by_cause': {'energy_by_cause': True},
        'taylor': {'integrator': {'kind': 'taylor'}},
        'delay': {'effects': [{'kind': 'servo', 'coordinates': joints, 'stiffness': 1.0,
                               'delay': 0.01}]},
        'measurements': {'measurements': {'joint_states': {}}},
        'observer': {'effects': [{'kind': 'observer', 'coordinates': joints}]}}[name])
    with refused(HnnViRosError):
        compile_scene(scene, 'refused', begin=lambda: pytest.fail('has begun to compile'))


def test_without_a_compiler_the_archive_alone_is_written(monkeypatch, capsys, tmp_path):
    monkeypatch.setenv('PATH', '/nowhere')
    scene = tmp_path / 'my scene.yaml'
    scene.write_text(Scene.build(**FORMULA).to_yaml())
    assert export.main([str(scene), '--out', str(tmp_path / 'c')]) == 0
    assert 'no C compiler cc: my_scene.so is not written' in capsys.readouterr().out
    assert {path.name for path in (tmp_path / 'c').iterdir()} == {
        'libmy_scene.a', 'my_scene.h', 'example.c', 'CMakeLists.txt', 'README.md'}
    monkeypatch.undo()
    subprocess.run(['cc', 'example.c', 'libmy_scene.a', '-lm', '-o', 'example'],
                   cwd=tmp_path / 'c', check=True)
    with refused(HnnViRosError):
        export.main([str(scene), '--out', str(tmp_path / 'c')])
    with refused(HnnViRosError):
        export.main([str(scene)])
    with refused(HnnViRosError):
        export.main([str(scene), '--fmu', str(tmp_path / 'scene.zip')])
    # Before a minute of compilation.
    for option, path in (('--out', scene / 'c'), ('--out', scene), ('--fmu', tmp_path)):
        with refused(HnnViRosError):
            export.main([str(scene), option, str(path), '--force'])
    other = next(target for target in COMPILERS if target != HOST)
    with refused(HnnViRosError):
        export.main([str(scene), '--target', other, '--cpu', 'x86-64'])


def test_compiler_that_fails_is_an_error_in_a_line(monkeypatch, tmp_path):
    code = exported('formula')[1]
    monkeypatch.setattr(scene_code, 'compile_scene', lambda *_: code)
    (tmp_path / 'cc').write_text('#!/bin/sh\nexit 3\n')
    (tmp_path / 'cc').chmod(0o755)
    monkeypatch.setenv('PATH', str(tmp_path))
    for option in ('--fmu', '--out'):
        path = tmp_path / 'pendulum.fmu'
        with refused(HnnViRosError):
            export.main(['exact_pendulum', option, str(path)])
        assert not path.exists()


@pytest.mark.long
def test_command_exports_for_another_processor(tmp_path):
    # The compiler reads the name of the processor once in each process.
    def run(name):
        folder = tmp_path / name
        subprocess.run([sys.executable, '-m', 'hnn_vi_ros', 'export', 'exact_pendulum', '--out',
                        str(folder), '--cpu', name], check=True)
        return folder
    folder = run('x86-64')
    assert 'for x86-64.' in (folder / 'exact_pendulum.h').read_text()
    shown = subprocess.run(['objdump', '-d', 'libexact_pendulum.a'], cwd=folder,
                           capture_output=True, text=True, check=True).stdout
    # Registers of AVX are not in code for all x86-64.
    assert '%ymm' not in shown and '%xmm' in shown
    subprocess.run(['cmake', '-S', folder, '-B', folder / 'build'], check=True)
    subprocess.run(['cmake', '--build', folder / 'build'], check=True)
    subprocess.run([folder / 'build/exact_pendulum_example', '10', '1'], check=True)


# Reads states of two numbers each, and writes the next ones.
STEPS = """
#include <stdio.h>
#include "scene.h"
int main(void) {
  static scene_state state;
  double z[2 * SCENE_Q_SIZE], out[SCENE_OUTPUTS];
  while (fread(z, sizeof z, 1, stdin)) {
    if (scene_init(&state) || scene_start(&state, z, z + SCENE_Q_SIZE) ||
      scene_step(&state, NULL, 1) || scene_outputs(&state, out)) { return 1; }
    fwrite(out, sizeof z, 1, stdout);
  }
}
"""


@pytest.mark.long
@pytest.mark.skipif(None in map(shutil.which, ('qemu-aarch64', COMPILERS['aarch64-linux'])),
                    reason='no emulator or compiler of aarch64')
@pytest.mark.parametrize('name', ['pendulum', 'double_pendulum', 'exact_double_pendulum'])
def test_steps_on_aarch64_are_those_of_simulate(tmp_path, name):
    scene, file = load_scene(name), tmp_path / 'scene.yaml'
    file.write_text(scene.to_yaml())
    subprocess.run([sys.executable, '-m', 'hnn_vi_ros', 'export', str(file), '--out',
                    str(tmp_path / 'c'), '--target', 'aarch64-linux', '--fmu',
                    str(tmp_path / 'scene.fmu')], check=True, cwd=tmp_path)
    with ZipFile(tmp_path / 'scene.fmu') as unit:
        assert 'binaries/aarch64-linux/scene.so' in unit.namelist()
    (tmp_path / 'c/own.c').write_text(STEPS)
    subprocess.run([COMPILERS['aarch64-linux'], '-static', 'own.c', 'libscene.a', '-lm', '-o',
                    'own'], cwd=tmp_path / 'c', check=True)
    simulation = build(scene)
    states = np.random.default_rng(1).uniform(-1.5, 1.5, (1000, 2 * simulation.q.size))
    found = subprocess.run(['qemu-aarch64', tmp_path / 'c/own'], input=states.tobytes(),
                           capture_output=True, check=True).stdout
    for state, end in zip(states, np.frombuffer(found).reshape(states.shape), strict=True):
        simulation.restart(*np.split(state, 2))
        simulation.advance(1)
        # Functions of the two libm differ in the last bit, and sums in their order.
        assert end == pytest.approx(np.append(simulation.q, simulation.p), rel=1e-13, abs=1e-13)


@pytest.mark.long
@pytest.mark.skipif(shutil.which('valgrind') is None, reason='no valgrind')
@pytest.mark.parametrize('name', SCENES)
def test_valgrind_finds_no_error(tmp_path, name):
    text = SCENES[name]().to_yaml()
    (tmp_path / f'{name}.yaml').write_text(
        text.replace('../robots', str(share_folder() / 'config/robots')))
    # Code for this processor may be unknown to valgrind; any x86-64 is known.
    subprocess.run([sys.executable, '-m', 'hnn_vi_ros', 'export', f'{name}.yaml', '--out', 'c',
                    '--cpu', 'x86-64'], check=True, cwd=tmp_path)
    subprocess.run(['cc', '-g', 'example.c', f'lib{prefix_of(name)}.a', '-lm', '-o', 'example'],
                   cwd=tmp_path / 'c', check=True)
    done = subprocess.run(['valgrind', '-q', '--error-exitcode=9', './example', '100', '10'],
                          cwd=tmp_path / 'c', capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr == ''


@pytest.mark.long
@pytest.mark.parametrize('name', ['servo', 'formula', 'arm'])
def test_memory_does_not_grow_over_a_million_steps(name):
    sizes = []
    for steps in (1_000, 1_000_000):
        with subprocess.Popen([program(name), str(steps), str(steps)],
                              stdout=subprocess.DEVNULL) as process:
            _, status, used = os.wait4(process.pid, 0)
            process.returncode = status
        assert status == 0
        sizes.append(used.ru_maxrss)
    # In kB: the loader's share varies from run to run.
    assert sizes[1] <= sizes[0] + 256


def test_header_has_the_statuses_of_steps():
    _, _, folder = exported('servo')
    found = dict(re.findall(r'  SERVO_(\w+) = (\d+)', (folder / 'servo.h').read_text()))
    known = vars(entries) | vars(base)
    assert {name: int(number) for name, number in found.items()} == {
        name: known[name] for name in found}
    assert {*REASONS, OK} <= {int(number) for number in found.values()}


def test_header_is_standard_c_plus_plus():
    _, _, folder = exported('servo')
    (folder / 'own.cpp').write_text(
        '#include "servo.h"\nint main() { static servo_state s; return servo_init(&s) || '
        'servo_step(&s, nullptr, 10) || SERVO_INPUTS != 2 || SERVO_IN_VELOCITY_ANGLE != 1; }\n')
    subprocess.run(['c++', '-std=c++14', '-Wall', '-Wextra', '-Wpedantic', '-Werror', 'own.cpp',
                    'libservo.a', '-lm', '-o', 'own'], cwd=folder, check=True)
    subprocess.run([folder / 'own'], check=True)


@pytest.mark.long
def test_node_of_the_page_fits_the_header():
    SCENES['gripper'] = changed('gripper')
    _, _, folder = exported('gripper')
    page = (Path(__file__).parents[2] / 'docs/how-to/export-c.md').read_text()
    node = re.search(r'```cpp\n(.*?)```', page, re.DOTALL)[1]
    used = set(re.findall(r'\bGRIPPER_\w+|\bgripper_(?:init|step|outputs|state)\b', node))
    assert len(used) > 8 and used <= set(re.findall(r'\w+', (folder / 'gripper.h').read_text()))
    (folder / 'node.cpp').write_text(node)
    headers = [f'-I{path}' for prefix in prefixes() for path in (prefix / 'include').glob('*')]
    if any(option.endswith('/rclcpp') for option in headers):
        subprocess.run(['c++', '-std=c++17', '-fsyntax-only', *headers, 'node.cpp'], cwd=folder,
                       check=True)


@pytest.mark.parametrize(('text', 'expected'), [
    ('my scene', 'my_scene'), ('2 links', '_2_links'), ('ä-b', '__b'), ('', '_')])
def test_identifier_is_one_of_c(text, expected):
    assert identifier(text) == prefix_of(text) == expected


# Ends of comments and strings, also in trigraphs and joined lines; and what XML has no place for.
HOSTILE = ['*/ int x; /*', '*\\\n/ int x;', '*??/\n/', '**//*', '"); exit(1); ("', '??/" "', '\\',
           '\x01\ufffe\ud800', '<x a="b">&amp;', ']]>', '%s%n', '${x} $x']


@pytest.mark.skipif(shutil.which('cc') is None, reason='needs a C compiler')
@pytest.mark.parametrize('flags', [['-std=c11'], ['-std=gnu99', '-trigraphs']])
def test_text_of_models_is_only_text_in_c(flags, tmp_path):
    comments, strings = ([escaped(text, language) for text in HOSTILE]
                         for language in ('comment', 'string'))
    (tmp_path / 'a.c').write_text('#include <stdio.h>\n' + ''.join(
        f'/* {text} */\n/* {text} [{text}] */\n' for text in comments)
        + 'int main(void) {' + ''.join(f'puts("{text}");' for text in strings) + '}\n')
    subprocess.run(['cc', *flags, '-Wno-trigraphs', 'a.c', '-o', 'a'], cwd=tmp_path, check=True)
    shown = subprocess.run([tmp_path / 'a'], capture_output=True, text=True, check=True).stdout
    assert shown.splitlines() == [one_line(text) for text in HOSTILE]


def test_text_of_models_is_only_text_in_xml_and_in_names():
    for text in HOSTILE:
        quoted = escaped(text, 'xml')
        found = ElementTree.fromstring(f'<a b="{quoted}">{quoted}</a>')
        assert found.get('b') == found.text == one_line(text)
        assert re.fullmatch('[A-Za-z_][A-Za-z0-9_]*', identifier(text))
        assert '<' not in escaped(text, 'markdown').replace(r'\<', '')


def test_files_replace_no_header_or_library_of_c():
    # `#include <stdint.h>` would find the header of the scene, -lm its library, and a program that
    # calls sem_init its function; CMake has a target install.
    assert [prefix_of(name) for name in ('stdint', 'm', 'sem', 'install', 'int')] == [
        'stdint_scene', 'm_scene', 'sem_scene', 'install_scene', 'int']
