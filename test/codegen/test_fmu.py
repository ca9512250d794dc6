# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Test FMUs of exported scenes: fmpy reads and steps them, with the bits of simulations."""

from contextlib import suppress
import ctypes
from functools import cache
from pathlib import Path
import re
import tempfile
from zipfile import ZipFile

from helpers import long
from hnn_vi_ros.codegen import compile_scene, export, write_fmu
from hnn_vi_ros.effects import JointCommand
from hnn_vi_ros.scene import load_scene, Scene, with_numbers
from hnn_vi_ros.simulation import build
import numpy as np
import pytest

fmpy = pytest.importorskip('fmpy', reason='fmpy is not installed')
H = 0.01
SERVO = {'kind': 'servo', 'coordinates': ['angle'], 'stiffness': 3.0, 'damping': 0.3,
         'effort_limit': 2.0, 'position': [0.5]}
MASS = {'hamiltonian': {'kind': 'formula', 'coordinates': ['x'], 'H': 'p_x**2/(2*m) + c',
                        'parameters': {'m': 1.0, 'c': 0.0}},
        'effects': [{'kind': 'external_force', 'coordinates': ['x'], 'timeout': 10.0}],
        'integrator': {'kind': 'stormer_verlet'}, 'step_size': H,
        'events': [{'when': 'x = 0'}], 'initial_state': {'q': [1.0], 'p': [0.0]}}
SCENES = {'mass': lambda: Scene.build(**MASS),
          'pendulum': lambda: load_scene('pendulum').changed({'effects': [SERVO]})}


@cache
def code_of(name):
    """Return the object code of a scene."""
    return compile_scene(SCENES[name](), name)


@cache
def unit(name):
    """Return the FMU of a scene, its description and its unpacked folder."""
    path = Path(tempfile.mkdtemp(), f'{name}.fmu')
    write_fmu(path, name, code_of(name))
    return path, fmpy.read_model_description(path), fmpy.extract(path)


class Instance(fmpy.fmi3.FMU3Slave):
    """An instance of an FMU, with names instead of value references."""

    def __init__(self, name, initialized=True, early=False):
        _, description, folder = unit(name)
        super().__init__(
            instanceName='one', guid=description.guid, unzipDirectory=folder,
            modelIdentifier=description.coSimulation.modelIdentifier)
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        self.instantiate(loggingOn=False, earlyReturnAllowed=early)
        if initialized:
            self.enterInitializationMode(startTime=0.0)
            self.exitInitializationMode()

    def put(self, **values):
        self.setFloat64([self.references[name] for name in values], [*values.values()])

    def get(self, *names):
        return self.getFloat64([self.references[name] for name in names])


def refused(call, *arguments, **named):
    """Expect an error of FMI."""
    with pytest.raises(Exception, match='(?i)error|status'):
        call(*arguments, **named)


@pytest.mark.parametrize('name', ['mass', long('pendulum')])
def test_fmpy_validates_and_simulates_it_with_the_same_bits(name):
    from fmpy.validation import validate_fmu
    path, _, _ = unit(name)
    assert validate_fmu(str(path)) == []
    with ZipFile(path) as file:
        assert file.read('documentation/trajectory.png').startswith(b'\x89PNG')
        assert 'src="trajectory.png"' in file.read('documentation/index.html').decode()
    scene = SCENES[name]()
    simulation = build(scene)
    label = simulation.hamiltonian.coordinates[0].name
    result = fmpy.simulate_fmu(str(path), stop_time=1.0, step_size=H, output_interval=10 * H,
                               output=[label, f'{label}_momentum', 'energy'])
    q, p = simulation.record(10, 10)
    assert len(result) == 11
    assert np.array_equal(result[label][1:], q[:, 0])
    assert np.array_equal(result[f'{label}_momentum'][1:], p[:, 0])
    assert result['energy'][-1] == simulation.energy


def test_names_of_variables_are_unique(tmp_path):
    code, path = code_of('mass'), tmp_path / 'mass.fmu'
    own, *others = code.outputs
    write_fmu(path, 'mass', code._replace(outputs=[own._replace(name='effort_x'), *others]))
    names = [one.name for one in fmpy.read_model_description(path).modelVariables]
    assert len({*names}) == len(names) and {'effort_x_2', 'effort_x'} <= {*names}


def test_inputs_act_from_the_next_step_on():
    own, simulation = Instance('mass'), build(SCENES['mass']())
    for k, force in enumerate((1.0, 1.0, -2.0)):
        own.put(effort_x=force)
        own.doStep(k * 5 * H, 5 * H)
        simulation.set_command([force])
        simulation.advance(5)
        assert own.get('x', 'x_momentum') == [*simulation.q, *simulation.p]
    own.freeInstance()


@pytest.mark.long
def test_servo_takes_positions():
    own, simulation = Instance('pendulum'), build(SCENES['pendulum']())
    own.put(position_angle=1.0)
    own.doStep(0.0, 50 * H)
    simulation.set_command(JointCommand(
        ['angle'], np.array([1.0]), np.array([np.nan]), np.array([np.nan])))
    simulation.advance(50)
    assert own.get('angle', 'angle_effort')[0] == simulation.q[0]
    own.freeInstance()


def test_initial_state_is_a_parameter():
    own = Instance('mass', initialized=False)
    own.put(initial_x=3.0, initial_x_momentum=2.0)
    own.enterInitializationMode(startTime=5.0)
    assert own.get('x', 'x_velocity', 'energy', 'time') == [3.0, 2.0, 2.0, 5.0]
    own.exitInitializationMode()
    refused(own.setFloat64, [own.references['initial_x']], [0.0])
    own.doStep(5.0, H)
    # x + h v, rounded as the method does.
    assert own.get('x')[0] == pytest.approx(3.0 + 2.0 * H, rel=1e-15)
    own.reset()
    assert own.get('x', 'initial_x', 'time') == [1.0, 1.0, 0.0]
    own.freeInstance()


def test_event_ends_a_communication_step_early_if_this_is_allowed():
    own, other = Instance('mass', early=True), Instance('mass')
    for one in (own, other):
        one.put(effort_x=-1.0)
    # x = 1 - t^2 / 2 is 0 at t = sqrt(2), in the step to 1.42.
    ended = own.doStep(0.0, 300 * H)
    assert ended[:3] == (False, False, True) and ended[3] == pytest.approx(1.42, rel=1e-12)
    assert own.get('event_1', 'time') == [1.0, ended[3]]
    assert own.doStep(ended[3], 158 * H)[2] is False
    assert other.doStep(0.0, 300 * H)[2] is False
    assert own.get(*own.references) == other.get(*other.references)
    own.freeInstance()
    other.freeInstance()


def test_numbers_of_the_scene_are_tunable_parameters():
    scene = SCENES['mass']()
    own, m = Instance('mass'), 'hamiltonian.parameters.m'
    kinds = {v.name: (v.causality, v.variability) for v in unit('mass')[1].modelVariables}
    assert kinds[m] == ('parameter', 'tunable')
    assert kinds['effects.0.timeout'] == ('local', 'constant')
    own.put(effort_x=1.0, **{m: 2.0})
    own.doStep(0.0, 10 * H)
    state, before = own.getFMUState(), own.get(*own.references)
    simulation = build(with_numbers(scene, {m: 2.0}))
    simulation.set_command([1.0])
    simulation.advance(10)
    # 1 / (2 m) is a number of the code, 1/4 without rounding.
    assert own.get('x', 'x_momentum') == [*simulation.q, *simulation.p]
    error = own.get('energy_error')[0]
    own.put(**{m: 8.0})
    # The kinetic energy is a quarter, and its change is no error, up to the rounding of sums.
    assert own.get('energy')[0] == before[own.references['energy']] / 4.0
    assert own.get('energy_error')[0] == pytest.approx(error, abs=1e-16)
    own.setFMUState(state)
    assert own.get(*own.references) == before
    for value in (0.0, np.nan, np.inf):
        refused(own.put, **{m: value})
    refused(own.setFloat64, [own.references['effects.0.timeout']], [1.0])
    assert own.get(*own.references) == before
    own.reset()
    assert own.get(m) == [1.0]
    own.freeInstance()


def test_stored_and_serialized_states_continue_bit_by_bit():
    own, other = Instance('mass'), Instance('mass')
    own.put(effort_x=1.0)
    own.doStep(0.0, 3 * H)
    state = own.getFMUState()
    stored = own.serializeFMUState(state)
    own.doStep(3 * H, 4 * H)
    end = own.get(*own.references)
    own.setFMUState(state)
    own.doStep(3 * H, 4 * H)
    assert own.get(*own.references) == end
    copied = other.deserializeFMUState(stored)
    other.setFMUState(copied)
    other.doStep(3 * H, 4 * H)
    assert other.get(*own.references) == end
    own.freeFMUState(state)
    damaged = bytes([*stored[:-1], stored[-1] ^ 1])
    refused(other.deserializeFMUState, damaged)
    refused(other.deserializeFMUState, stored[:-1])
    own.freeInstance()
    other.freeInstance()


def test_wrong_calls_are_errors_and_change_nothing():
    own = Instance('mass', initialized=False)
    refused(own.doStep, 0.0, H)
    refused(own.exitInitializationMode)
    refused(own.terminate)
    own.enterInitializationMode(startTime=0.0)
    own.exitInitializationMode()
    before = own.get(*own.references)
    refused(own.setFloat64, [own.references['x']], [0.0])
    refused(own.setFloat64, [own.references['effort_x']], [np.inf])
    refused(own.setFloat64, [10_000], [0.0])
    refused(own.getFloat64, [10_000])
    for now, size in ((1.0, H), (0.0, 0.5 * H), (0.0, 0.0), (0.0, -H), (0.0, np.nan), (np.nan, H),
                      (0.0, np.inf)):
        refused(own.doStep, now, size)
    refused(own.getInt32, [0])
    refused(own.enterStepMode)
    # NaN is no value of an input that has none, and differs from itself.
    assert np.array_equal(own.get(*own.references), before, equal_nan=True)
    own.freeInstance()
    other = Instance('mass', initialized=False)
    other.fmi3FreeInstance(other.component)
    other.guid = 'of another one'
    with pytest.raises(Exception, match='instantiate'):
        other.instantiate()


def test_random_orders_of_calls_do_not_crash():
    rng = np.random.default_rng(1)
    for _ in range(200):
        own, states = Instance('mass', initialized=False), []
        calls = [
            lambda: own.enterInitializationMode(startTime=0.0), own.exitInitializationMode,
            own.terminate, own.reset, lambda: own.put(effort_x=rng.normal()),
            lambda: own.put(initial_x=rng.normal()), lambda: own.get(*own.references),
            lambda: own.doStep(own.get('time')[0], H * rng.integers(0, 4)),
            lambda: states.append(own.getFMUState()),
            lambda: states and own.setFMUState(states[-1]),
            lambda: states and own.deserializeFMUState(own.serializeFMUState(states[-1])),
            lambda: own.setFMUState(ctypes.c_void_p()), own.enterEventMode,
            lambda: own.getInt32([0])]
        for k in rng.integers(0, len(calls), 40):
            with suppress(Exception):
                calls[k]()
        # It still answers.
        assert len(own.get(*own.references)) == len(own.references)
        for state in states:
            own.freeFMUState(state)
        own.freeInstance()


@pytest.mark.long
def test_master_of_the_page(tmp_path, monkeypatch, capsys):
    page = (Path(__file__).parents[2] / 'docs/how-to/export-c.md').read_text()
    scene, master = (re.search(f'```{kind}\n(.*?)```', page, re.DOTALL)[1]
                     for kind in ('yaml', 'python'))
    monkeypatch.chdir(tmp_path)
    Path('mass.yaml').write_text(scene)
    assert export.main(['mass.yaml', '--fmu', 'mass.fmu']) == 0
    capsys.readouterr()
    exec(compile(master, 'master.py', 'exec'), {})
    left, right, momentum = map(float, capsys.readouterr().out.split())
    # See the test of two units below.
    assert left == -right and momentum == 0.0
    assert right == pytest.approx(np.cos(np.sqrt(2.0) * 3.0), abs=3.0 * H)


def test_master_steps_two_units_that_exchange_forces():
    # Two masses on a spring of stiffness 1: the master computes the force between them.
    one, two = Instance('mass'), Instance('mass', initialized=False)
    two.put(initial_x=-1.0)
    two.enterInitializationMode(startTime=0.0)
    two.exitInitializationMode()
    for k in range(300):
        force = two.get('x')[0] - one.get('x')[0]
        one.put(effort_x=force)
        two.put(effort_x=-force)
        one.doStep(k * H, H)
        two.doStep(k * H, H)
    # Equal and opposite forces keep the sum of momenta, exactly by symmetry.
    assert one.get('x_momentum')[0] == -two.get('x_momentum')[0]
    # x = cos(sqrt(2) t); a force held for h delays it by h / 2, an error of order h.
    assert one.get('x')[0] == pytest.approx(np.cos(np.sqrt(2.0) * 3.0), abs=3.0 * H)
    one.freeInstance()
    two.freeInstance()
