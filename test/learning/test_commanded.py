# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Logs of commanded positions: their columns, and the servos that are fitted to them."""

from dataclasses import replace
import json
from pathlib import Path

from hnn_vi_ros.effects import JointCommand, OFF
from hnn_vi_ros.errors import DataError, HnnViRosError
from hnn_vi_ros.identify.check import main as check
from hnn_vi_ros.identify.commanded import commanded_scene, first_scene
from hnn_vi_ros.identify.free_numbers import free_scene
from hnn_vi_ros.identify.identify import main
from hnn_vi_ros.identify.loads import Load, read_loads
from hnn_vi_ros.learning import ArraysData, predicted_by, Prediction, read_motions, source_of
from hnn_vi_ros.learning.data.header import read_header
from hnn_vi_ros.learning.data.motions import smoothed
from hnn_vi_ros.learning.fit.step_forces import constant_commands
from hnn_vi_ros.learning.fit.windows import cut_windows
from hnn_vi_ros.phase_space import Coordinate
from hnn_vi_ros.scene import load_scene, Scene, with_values
from hnn_vi_ros.simulation import build, resolve
from messages import refused
import numpy as np
from pandas import DataFrame, read_parquet
import pytest
import yaml

STEP, SAMPLES, NOISE = 0.001, 10, 1e-3
JOINTS = 'shoulder', 'elbow'


def arm(joints: int, scale: float = 1.0) -> str:
    """Return the URDF of bars that hang from each other, with all masses times a factor."""
    text, parent = '<robot name="made"><link name="base"/>', 'base'
    for name, mass, length in zip(JOINTS[:joints], (0.6, 0.4), (0.25, 0.2), strict=False):
        moment = scale * mass * length**2 / 12.0
        at = 0.0 if parent == 'base' else -0.25
        text += (
            f'<link name="{name}_bar"><inertial><origin xyz="0 0 {-0.5 * length}"/>'
            f'<mass value="{scale * mass}"/><inertia ixx="{moment}" iyy="{moment}" '
            f'izz="{0.05 * moment}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="{name}" type="continuous"><origin xyz="0 0 {at}"/>'
            f'<parent link="{parent}"/><child link="{name}_bar"/><axis xyz="0 1 0"/></joint>')
        parent = f'{name}_bar'
    return text + '</robot>'


def numbers(joints: int, random: np.random.Generator) -> dict[str, float]:
    """Return the numbers of hobby servos by their names in an identification."""
    found = {'servo.delay': float(random.integers(10, 40)) * STEP, 'joint_friction.speed': 0.05}
    for k, name in enumerate(JOINTS[:joints]):
        size = (14.0, 9.0)[k] * random.uniform(0.7, 1.4)
        found |= {f'servo.stiffness.{k}': size,
                  f'servo.damping.{k}': 0.035 * size * random.uniform(0.6, 1.5),
                  f'servo.offset.{k}': random.uniform(-0.03, 0.03),
                  f'joint_friction.friction.{name}': 0.009 * size * random.uniform(0.5, 1.5),
                  f'rotor_inertia.{name}': 0.0015 * size * random.uniform(0.6, 1.5)}
    return found


def commands(joints: int, count: int, random: np.random.Generator) -> np.ndarray:
    """Return steps, ramps and sines, shape (count, joints)."""
    found = np.zeros((count, joints))
    for column in found.T:
        at, last = 0, 0.0
        while at < count:
            part = np.arange(min(random.integers(50, 160), count - at))
            end, kind = random.uniform(-1.2, 1.2), random.integers(3)
            column[at + part] = (
                end + 0.0 * part, last + (end - last) * part / len(part),
                last + 0.4 * np.sin(2.0 * np.pi * random.uniform(0.5, 2.0) * 0.01 * part))[kind]
            at, last = at + len(part), column[at + part[-1]]
    return found


def write_log(folder: Path, joints: int, seed: int, duration: float = 6.0, scale: float = 1.0,
              limit: float | None = None, payload: dict[str, object] | None = None,
              name: str = 'log', gain: float = 1.0, jitter: int = 0, dropped: float = 0.0,
              **servo: float) -> dict[str, float]:
    """
    Write arm.urdf and NAME.csv of an arm with all masses and torques times a factor.

    Samples, and the commands sent with them, are up to `jitter` steps late, and of the rows in
    which the command does not jump a share is lost.
    """
    random, names = np.random.default_rng(seed), list(JOINTS[:joints])
    truth = numbers(joints, random)
    (folder / 'arm.urdf').write_text(arm(joints))
    (folder / 'true.urdf').write_text(arm(joints, scale))

    def of(key: str, factor: float = scale) -> list[float]:
        return [factor * value for name, value in truth.items() if name.startswith(key)]
    (folder / 'true.yaml').write_text(yaml.safe_dump({
        'hamiltonian': {'kind': 'urdf', 'file': str(folder / 'true.urdf'),
                        'rotor_inertia': dict(zip(names, of('rotor'), strict=True)),
                        **({'payload': payload} if payload else {})},
        'integrator': {'kind': 'gauss4'}, 'step_size': STEP,
        'initial_state': {'q': [0.0] * joints, 'p': [0.0] * joints},
        'effects': [
            {'kind': 'servo', 'coordinates': names,
             'stiffness': of('servo.stiffness', scale * gain), 'damping': of('servo.damping'),
             'offset': of('servo.offset', 1.0), 'delay': truth['servo.delay'],
             **({'effort_limit': limit} if limit else {}), **servo},
            {'kind': 'joint_friction', 'speed': truth['joint_friction.speed'],
             'friction': dict(zip(names, of('joint_friction.friction'), strict=True))}]}))
    # Each log has its own commands and noise.
    random = np.random.default_rng([seed, *name.encode()]) if name != 'log' else random
    count, none = round(duration / (SAMPLES * STEP)), np.full(joints, np.nan)
    simulation, r = build(resolve(load_scene(folder / 'true.yaml'))), commands(
        joints, count, random)
    if name != 'log':
        # Before a log, its first command is taken to act.
        r[:10] = 0.0
    q, at = [], SAMPLES * np.arange(count + 1)
    late = np.random.default_rng([seed, 1])
    at[1:] += late.integers(jitter + 1, size=count)
    for row, steps in zip(r, np.diff(at), strict=True):
        q.append(simulation.q.copy())
        simulation.set_command(JointCommand(names, row, none, none))
        simulation.advance(int(steps))
    read = np.array(q) + of('servo.offset', 1.0) + NOISE * random.normal(size=(count, joints))
    kept = (late.uniform(size=count) >= dropped) | (
        np.abs(np.diff(r, axis=0, prepend=r[:1])) > 0.1).any(axis=1)
    np.savetxt(folder / f'{name}.csv', np.column_stack([
        STEP * at[:-1], read, np.degrees(r)])[kept], fmt='%.9g', delimiter=',',
        comments='', header=','.join(['t [s]', *(f'{name} position [rad]' for name in names),
                                      *(f'{name} command [deg]' for name in names)]))
    return truth


def fitted(folder: Path, *options: str) -> dict[str, dict[str, float]]:
    """Identify the arm of a log, and return the content of --json."""
    main(['--robot', str(folder / 'arm.urdf'), '--data', str(folder / 'log.csv'), '--json',
          str(folder / 'found.json'), *options])
    return json.loads((folder / 'found.json').read_text())


def test_effort_limit_of_a_urdf_counts_unless_the_motion_exceeds_it(tmp_path):
    """Steps of 1.2 rad ask for some 15 N m of a joint that has 5, and gravity for 0.74 N m."""
    write_log(tmp_path, 1, 0, limit=5.0)
    limits = {}
    for effort in ('5.0', '0.5'):
        (tmp_path / 'arm.urdf').write_text(arm(1).replace(
            '</joint>', f'<limit effort="{effort}" velocity="9"/></joint>'))
        found = fitted(tmp_path, '--write', str(tmp_path / f'{effort}.yaml'))
        servo, = (effect for effect in yaml.safe_load(
            (tmp_path / f'{effort}.yaml').read_text())['effects'] if effect['kind'] == 'servo')
        limits[effort] = servo.get('effort_limit')
        (tmp_path / 'found.json').unlink()
        if effort == '5.0':
            rotor = found['rotor_inertia.shoulder']
            # Without the limit it would absorb the missing torque.
            truth = numbers(1, np.random.default_rng(0))['rotor_inertia.shoulder']
            width = 3.0 * (rotor['high'] - rotor['low']) / 2.0
            assert rotor['value'] == pytest.approx(truth, abs=width)
    assert limits == {'5.0': [5.0], '0.5': None}


def test_numbers_of_a_servo_are_found_by_the_columns_of_a_log(tmp_path, capsys):
    truth = write_log(tmp_path, 1, 0)
    found = fitted(tmp_path, '--write', str(tmp_path / 'twin.yaml'))
    assert found.keys() == truth.keys()
    for name, one in found.items():
        # Within three half-widths, of which one misses in 1 of 20: once in 3e8.
        width = 3.0 * (one['high'] - one['low']) / 2.0
        assert one['value'] == pytest.approx(truth[name], abs=width), name
    # Within a tenth of a sample.
    assert found['servo.delay']['value'] == pytest.approx(truth['servo.delay'], abs=STEP)
    text = capsys.readouterr().out
    assert 'scale of the masses' in text and 'viscous friction and back EMF' in text
    twin = build(resolve(load_scene(tmp_path / 'twin.yaml')))
    twin.set_command(JointCommand(['shoulder'], np.array([0.4]), *[np.array([np.nan])] * 2))
    twin.advance(1000)
    # The servo sags by gravity and sticks: it holds within m g c + F over k.
    assert twin.q[0] == pytest.approx(0.4, abs=0.2) and twin.q[0] != 0.4


@pytest.mark.parametrize(('jitter', 'dropped'), [
    (3, 0.0), *(pytest.param(*case, marks=pytest.mark.long)
                for case in ((1, 0.0), (5, 0.0), (3, 0.05)))])
def test_delay_is_found_with_time_stamps_that_jitter(jitter, dropped, tmp_path):
    truth = write_log(tmp_path, 1, 0, jitter=jitter, dropped=dropped)
    found = fitted(tmp_path, '--horizon', '0.5')
    # Within a tenth of a sample.
    assert found['servo.delay']['value'] == pytest.approx(truth['servo.delay'], abs=STEP)


def test_guess_of_servos_holds_a_known_delay(tmp_path):
    write_log(tmp_path, 1, 0)
    robot, at = tmp_path / 'arm.urdf', {}
    scene = first_scene(robot, tmp_path)
    source = source_of(str(tmp_path / 'log.csv'), scene.create_hamiltonian().coordinates, None,
                       commanded=True)
    motions, _ = read_motions(tmp_path / 'log.csv', source, ['shoulder'], [], ['rad'], True)
    for delay in (0.0, 0.1):
        found, _ = commanded_scene(robot, tmp_path, [(scene.create_hamiltonian(), 1.0)], motions,
                                   {'servo.delay': delay})
        at[delay] = found.effects[0]
    assert [servo.delay for servo in at.values()] == [0.0, 0.1]
    # Other numbers are the best ones with this delay.
    assert at[0.0].stiffness != at[0.1].stiffness


def test_rate_of_ramps_of_commands_is_found(tmp_path):
    truth = write_log(tmp_path, 1, 0, name='m', rate_limit=3.0) | {'servo.rate_limit': 3.0}
    (tmp_path / 'm.csv').rename(tmp_path / 'log.csv')
    found = fitted(tmp_path)
    assert found.keys() == truth.keys()
    for name, one in found.items():
        # Within three half-widths, of which one misses in 1 of 20: once in 3e8.
        width = 3.0 * (one['high'] - one['low']) / 2.0
        assert one['value'] == pytest.approx(truth[name], abs=width), name
    rate = found['servo.rate_limit']
    assert rate['high'] - rate['low'] < 0.1


@pytest.mark.parametrize('servo', [{'load': 0.3}, {'punch': 0.3}, {'effort_limit': 3.0}])
def test_servos_without_ramps_whose_models_lack_something_get_none(servo, tmp_path):
    write_log(tmp_path, 1, 4, **servo)
    assert 'servo.rate_limit' not in fitted(tmp_path)


def test_without_known_masses_forces_are_relative_to_inertias(tmp_path, capsys):
    truth = write_log(tmp_path, 1, 1, scale=1.7)
    found = fitted(tmp_path, '--masses', 'unknown')
    inertia = 0.6 * 0.25**2 / 3.0 + truth['rotor_inertia.shoulder']
    for name, one in found.items():
        true = truth[name.removesuffix(' / inertia')]
        true /= inertia if name.endswith('inertia') else 1.0
        assert one['value'] == pytest.approx(true, abs=1.5 * (one['high'] - one['low'])), name
    assert sum(name.endswith(' / inertia') for name in found) == 4
    assert 'relative to inertias alone' in capsys.readouterr().out


def write_loads(folder: Path, joints: int, seed: int, duration: float) -> dict[str, float]:
    """Write three logs of an arm that carries 0, .3 and .6 kg, the last unknown, and the table."""
    logs = {}
    for mass, gain in ((0.0, 1.0), (0.3, 2.0), (0.6, 1.0)):
        payload = {'link': f'{JOINTS[joints - 1]}_bar', 'mass': mass, 'centre': [0.0, 0.0, -0.15]}
        truth = write_log(folder, joints, seed, duration, payload=payload, name=f'm{mass}',
                          gain=gain)
        logs[f'm{mass}'] = {'payload': payload, 'gain': gain}
    logs['m0.6'] = {'payload': {**payload, 'mass': 0.0}, 'free': ['mass']}
    (folder / 'loads.yaml').write_text(yaml.safe_dump({'logs': logs}))
    return truth | {'m0.6.payload.mass': 0.6}


def with_loads(folder: Path, *options: str) -> dict[str, dict[str, float]]:
    """Identify an arm from logs with loads, and return the content of --json."""
    main(['--robot', str(folder / 'arm.urdf'), '--data', *map(str, sorted(folder.glob('m*.csv'))),
          '--loads', str(folder / 'loads.yaml'), '--json', str(folder / 'found.json'), *options])
    return json.loads((folder / 'found.json').read_text())


def test_logs_with_several_loads_and_gains_share_the_numbers_of_a_servo(tmp_path):
    truth = write_loads(tmp_path, 1, 3, 3.0)
    found = with_loads(tmp_path, '--write', str(tmp_path / 'twin.yaml'))
    assert found.keys() == truth.keys()
    for name, one in found.items():
        # Within three half-widths, of which one misses in 1 of 20: once in 3e8.
        width = 3.0 * (one['high'] - one['low']) / 2.0
        assert one['value'] == pytest.approx(truth[name], abs=width), name
    mass = found['m0.6.payload.mass']
    assert mass['high'] - mass['low'] < 0.1
    assert not load_scene(tmp_path / 'twin.yaml').hamiltonian.payload


@pytest.mark.parametrize('table', [
    'logs: {m0.0: {}, m0.3: {}}', 'logs: {m*: {}, other: {}}',
    'logs: {m*: {free: [mass]}}', 'logs: {m*: {payload: {link: shoulder_bar}, free: [weight]}}',
    'logs: {m*: {payload: {link: hand}}}', 'logs: {m*: {payload: {link: base, mass: -1}}}',
    'logs: {m*: {gain: 0}}', 'm*: {}', '--masses'])
def test_loads_that_fit_no_logs_are_one_line(table, tmp_path):
    write_loads(tmp_path, 1, 3, 1.0)
    if table != '--masses':
        (tmp_path / 'loads.yaml').write_text(table)
    with refused(HnnViRosError):
        with_loads(tmp_path, *(['--masses', 'unknown'] if table == '--masses' else []))


def test_predictions_of_logs_with_loads_are_those_of_each_scene_with_its_load(tmp_path):
    write_loads(tmp_path, 1, 3, 1.0)
    loads = read_loads(tmp_path / 'loads.yaml')
    scene, t = load_scene(tmp_path / 'true.yaml'), 0.01 * np.arange(31)
    logs = [replace(smoothed(name, t, np.zeros((31, 1)), np.zeros((31, 1)), np.sin(
        9.0 * t)[:, None], 40.0), commanded=True, inputs='held') for name in ('m0.6', 'm0.3')]
    free = free_scene(scene.parts(), ['servo.stiffness.0'], {}, tmp_path, False, loads)
    values, windows = np.array([9.0, 0.45]), cut_windows(logs, 0.1)
    starts = np.tile([0.5, 0.1], (len(windows.run), 1))
    both = predicted_by(free, values, windows)
    mass = both.parameter_jacobian(starts)[..., 1]
    for run, (load, gain) in enumerate(((0.45, 1.0), (0.3, 2.0))):
        own = free_scene(with_values(scene, {
            ('hamiltonian', 'payload', 'mass'): load}).parts(), ['servo.stiffness.0'], {},
            tmp_path, False)
        alone = Prediction(own, gain * values[:1], windows)
        rows = windows.run == run
        for one, other in ((both.by_starts(starts)[1], alone.by_starts(starts)[1]),
                           (both.log.predict(starts), alone.log.predict(starts)),
                           (both.directions(starts).swapaxes(0, 1),
                            alone.directions(starts).swapaxes(0, 1))):
            np.testing.assert_array_equal(one[rows], other[rows])
        assert np.abs(mass[rows]).max() == 0.0 if run else np.abs(mass[rows, 1:]).min() > 0.0


def test_energies_of_logs_with_and_without_a_payload_are_summed(tmp_path):
    write_loads(tmp_path, 1, 3, 1.0)
    write_log(tmp_path, 1, 3, 1.0)
    loads, t = {**read_loads(tmp_path / 'loads.yaml'), 'none': Load()}, 0.01 * np.arange(31)
    logs = [replace(smoothed(name, t, np.zeros((31, 1)), np.zeros((31, 1)), np.sin(
        9.0 * t)[:, None], 40.0), commanded=True, inputs='held') for name in ('m0.3', 'none')]
    free = free_scene(load_scene(tmp_path / 'true.yaml').parts(), [], {}, tmp_path, False, loads)
    windows = [cut_windows(logs[k:end], 0.3) for k, end in ((0, 1), (1, 2), (0, 2))]
    one, other, both = (predicted_by(free, np.array([0.6]), own).log.energies(
        np.zeros((len(own.run), 2))) for own in windows)
    assert both['work/payload'] == 0.0 and 'work/payload' not in other
    for name in other:
        assert both[name] == pytest.approx(one[name] + other[name], rel=1e-12)


@pytest.mark.long
@pytest.mark.parametrize('joints', [1, 2])
def test_intervals_with_several_loads_hold_the_truth(joints, tmp_path, measured):
    held = []
    for seed in range(10):
        folder = tmp_path / str(seed)
        folder.mkdir()
        truth = write_loads(folder, joints, seed, 4.0)
        held += [one['low'] <= truth[name] <= one['high']
                 for name, one in with_loads(folder, '--horizon', '1').items()]
    measured('share of 95 % intervals with several loads that hold the truth', f'{joints} joints',
             np.mean(held), '>= 0.9')
    assert np.mean(held) >= 0.9


@pytest.mark.long
@pytest.mark.parametrize('joints', [1, 2])
def test_intervals_of_servos_hold_the_truth_as_often_as_they_say(joints, tmp_path, measured):
    held: dict[str, list[bool]] = {}
    for seed in range(20):
        folder = tmp_path / str(seed)
        folder.mkdir()
        truth = write_log(folder, joints, seed)
        for name, one in fitted(folder).items():
            held.setdefault(name, []).append(one['low'] <= truth[name] <= one['high'])
    share = np.mean([*held.values()])
    measured('share of 95 % intervals of servos that hold the truth', f'{joints} joints', share,
             '>= 0.9')
    # Of 20 at 95 %, fewer than 15 hold once in 40,000.
    assert share >= 0.9 and min(map(sum, held.values())) >= 15


def servo_scene() -> Scene:
    return Scene.build(
        hamiltonian='double_pendulum', integrator='implicit_midpoint', step_size=0.01,
        initial_state=([0.5, -0.3], [0.0, 0.0]), effects=[
            {'kind': 'joint_friction', 'friction': {'angle2': 0.2}, 'speed': 0.5},
            {'kind': 'servo', 'coordinates': ['angle2'], 'stiffness': [8.0], 'damping': 0.4,
             'back_emf': 0.2, 'offset': [0.1], 'delay': 0.013, 'punch': 0.7, 'load': 0.3,
             'speed': 0.4}])


def test_exact_tangents_of_commanded_windows_are_differences_of_simulations(
        tmp_path, monkeypatch):
    scene, t = servo_scene(), 0.02 * np.arange(31)
    command = np.sin(9.0 * t)[:, None]
    command[8:12] = OFF
    log = replace(smoothed('one', t, np.zeros((31, 2)), np.zeros((31, 2)), command, 40.0),
                  commanded=True, inputs='held')
    names = ('mass2', 'servo.stiffness.0', 'servo.damping', 'servo.back_emf', 'servo.offset.0',
             'servo.delay', 'servo.punch', 'servo.load')
    free = free_scene(scene.parts(), names, {}, tmp_path, False)
    values, windows = np.array([number.start for number in free.numbers]), cut_windows([log], 0.3)
    starts = np.tile([0.5, -0.3, 0.3, -0.2], (len(windows.run), 1))

    def slopes() -> list[np.ndarray]:
        prediction = Prediction(free, values, windows)
        return [*prediction.by_starts(starts), prediction.parameter_jacobian(starts)]
    exact = slopes()
    monkeypatch.setattr(Prediction, '_run', None)
    for one, other in zip(exact, slopes(), strict=True):
        # Differences lose two thirds of the digits, and some more by the motion's growth.
        np.testing.assert_allclose(one, other, atol=1e-7 * np.abs(other).max())
    assert all(np.abs(exact[2][..., k]).max() > 0.0 for k in range(len(names)))
    # The reading of the encoder itself contains the offset.
    np.testing.assert_array_equal(exact[0][:, 0, 1], starts[:, 1] + 0.1)


def test_delayed_commands_act_by_their_mean_in_a_step_and_motors_are_off_at_once():
    scene, t = servo_scene(), 0.02 * np.arange(31)
    command = np.arange(31.0)[:, None]
    command[5] = OFF
    log = replace(smoothed('one', t, np.zeros((31, 2)), np.zeros((31, 2)), command, 40.0),
                  commanded=True, inputs='held')
    free = free_scene(scene.parts(), (), {}, Path(), False)
    forces = Prediction(free, np.zeros(0), cut_windows([log], 1.0)).log.forces[0, :, 0]
    # Steps of 10 ms and a delay of 13: three tenths of the fourth one are old.
    assert forces[:6] == pytest.approx([0.0, 0.0, 0.0, 0.7, 1.0, 1.7], abs=1e-12)
    # The motor is switched off from .10 s to .12 s, without this delay; meanwhile the command is
    # the mean of its neighbours.
    assert np.flatnonzero(forces == OFF).tolist() == [10, 11]
    assert forces[12:14] == pytest.approx([5.0, 5.7], abs=1e-12)


@pytest.mark.parametrize('rate', [1.7, 30.0, 1e9])
def test_commands_limited_in_rate_are_those_of_a_fine_integration(rate):
    t = 0.02 * np.arange(31)
    command = np.stack([np.sign(np.sin(9.0 * t)), np.sin(9.0 * t)], axis=1)
    log = replace(smoothed('one', t, np.zeros((31, 2)), np.zeros((31, 2)), command, 40.0),
                  commanded=True, inputs='held')
    edges, h, delay, parts = 0.01 * np.arange(61), 0.01, 0.013, 1000
    fine, r = [], np.zeros(2)
    for k in range(60 * parts):
        late = (k + 0.5) * h / parts - delay
        if late > 0.0:
            r = r + np.clip(command[int(late / 0.02 + 1e-9)] - r, *(
                sign * rate * h / parts for sign in (-1.0, 1.0)))
        fine.append(r)
    found = constant_commands(log, edges, delay, rate)
    # The fine reference is late by half of its steps.
    assert found == pytest.approx(np.reshape(fine, (60, parts, 2)).mean(axis=1),
                                  abs=min(rate, 200.0) * h / parts)


@pytest.mark.parametrize('names, command, enabled', [
    ('t [s],angle [rad],goal [rad]', ['goal [rad]'], []),
    ('t [s],elbow position [deg],elbow velocity,elbow command,enabled',
     ['elbow command [deg]'], ['enabled']),
    ('t,q1 [rad],q2 [rad],q1_des,q2_des', ['q1_des [rad]', 'q2_des [rad]'], []),
    ('t,q1 [rad],q2 [rad],q1_des,q2_des,q1_dot_des,q2_dot_des',
     ['q1_des [rad]', 'q2_des [rad]'], []),
    ('t,q1 [rad],q2 [rad],q1_des', ['q1_des [rad]'], []),
    ('t,q1 [rad],q2 [rad],q1_des,tau1', [], []), ('t [s],angle [rad],torque command', [], [])])
def test_commanded_positions_are_found_by_their_names(names, command, enabled, tmp_path):
    count, t = len(names.split(',')), 0.01 * np.arange(60)
    rows = np.column_stack([t, *(np.sin(t + k) for k in range(count - 1))])
    if enabled:
        rows[:, -1] = t > 0.3
    np.savetxt(tmp_path / 'log.csv', rows, delimiter=',', header=names, comments='')
    reading = read_header(tmp_path / 'log.csv').commanded
    assert reading.get('command', []) == command and reading.get('enabled', []) == enabled
    assert 'command' not in read_header(tmp_path / 'log.csv').data


@pytest.mark.parametrize('options', [
    ['exact_pendulum', '--robot', '{arm}'], ['exact_pendulum'], [],
    ['exact_pendulum', '--free', 'mass', '--masses', 'unknown'],
    ['--robot', '{arm}', '--known', 'servo.stiffness.0', 'high'],
    ['--robot', '{arm}', '--known', 'servo.gain', '2'], ['--robot', '{arm}', '--measured', 'q']])
def test_what_is_no_log_of_a_servo_is_one_line(options, tmp_path):
    (tmp_path / 'arm.urdf').write_text(arm(1))
    t = 0.01 * np.arange(100)
    np.savez(tmp_path / 'log.npz', t=t, q=np.sin(t)[:, None], goal=np.cos(t)[:, None])
    with refused(HnnViRosError):
        main([*(word.format(arm=tmp_path / 'arm.urdf') for word in options), '--data',
              str(tmp_path / 'log.npz')])


def test_log_without_commands_is_refused_for_a_robot(tmp_path):
    (tmp_path / 'arm.urdf').write_text(arm(1))
    t = 0.01 * np.arange(100)
    np.savez(tmp_path / 'log.npz', t=t, q=np.sin(t)[:, None], tau=np.cos(t)[:, None])
    with refused(HnnViRosError):
        main(['--robot', str(tmp_path / 'arm.urdf'), '--data', str(tmp_path / 'log.npz')])


def write_swings(folder: Path, seed: int, load: float) -> dict[str, float]:
    """Write arm.urdf and log.npz of one joint, whose motor is off in 1 of 3 seconds."""
    random, count = np.random.default_rng(seed), 900
    truth = numbers(1, random) | {
        'servo.load.0': load, 'joint_friction.damping.shoulder': random.uniform(0.01, 0.05)}
    (folder / 'arm.urdf').write_text(arm(1))
    scene = Scene.build(
        hamiltonian={'kind': 'urdf', 'file': str(folder / 'arm.urdf'), 'rotor_inertia': {
            'shoulder': truth['rotor_inertia.shoulder']}},
        integrator='implicit_midpoint', step_size=STEP, initial_state=([0.0], [0.0]), effects=[
            {'kind': 'servo', 'coordinates': ['shoulder'], 'delay': truth['servo.delay'], **{
                key: truth[f'servo.{key}.0'] for key in (
                    'stiffness', 'damping', 'offset', 'load')}, 'speed': 0.05},
            {'kind': 'joint_friction', 'speed': 0.05, **{
                key: {'shoulder': truth[f'joint_friction.{key}.shoulder']}
                for key in ('friction', 'damping')}}])
    t, goal = STEP * SAMPLES * np.arange(count), commands(1, count, random)
    on = np.arange(count) % 300 < 200
    log = replace(smoothed('log', t, 0.0 * goal, 0.0 * goal, np.where(on[:, None], goal, OFF),
                           40.0), commanded=True, inputs='held')
    windows = cut_windows([log], 1e3)
    q = predicted_by(free_scene(scene.parts(), [], {}, folder, False), np.zeros(0),
                     windows).log.predict(np.zeros((1, 2)))[0, :, :1]
    np.savez(folder / 'log.npz', t=t, q=q + NOISE * random.normal(size=q.shape), goal=goal,
             enabled=on)
    return truth


def of_swings(folder: Path) -> dict[str, dict[str, float]]:
    """Identify the arm of a log of arrays, and return the content of --json."""
    main(['--robot', str(folder / 'arm.urdf'), '--data', str(folder / 'log.npz'), '--json',
          str(folder / 'found.json')])
    return json.loads((folder / 'found.json').read_text())


def test_friction_in_the_gear_is_told_from_that_of_swings_without_the_motor(tmp_path):
    truth = write_swings(tmp_path, 0, 0.35)
    found = of_swings(tmp_path)
    assert found.keys() == truth.keys()
    for name, one in found.items():
        # Within three half-widths, of which one misses in 1 of 20: once in 3e8.
        width = 3.0 * (one['high'] - one['low']) / 2.0
        assert one['value'] == pytest.approx(truth[name], abs=width), name
    load = found['servo.load.0']
    assert load['high'] - load['low'] < 0.1


def test_servos_whose_motors_are_never_on_are_refused(tmp_path):
    write_log(tmp_path, 1, 2)
    t, q, r = np.loadtxt(tmp_path / 'log.csv', delimiter=',', skiprows=1).T
    np.savez(tmp_path / 'log.npz', t=t, q=q[:, None], goal=np.radians(r)[:, None],
             enabled=np.zeros(len(t)))
    with refused(DataError):
        main(['--robot', str(tmp_path / 'arm.urdf'), '--data', str(tmp_path / 'log.npz')])


def test_array_of_commands_and_of_motors_that_are_off_is_read(tmp_path):
    (tmp_path / 'arm.urdf').write_text(arm(1))
    write_log(tmp_path, 1, 2)
    t, q, r = np.loadtxt(tmp_path / 'log.csv', delimiter=',', skiprows=1).T
    np.savez(tmp_path / 'log.npz', t=t, q=q[:, None], goal=np.radians(r)[:, None],
             enabled=np.ones(len(t), dtype=bool))
    found = fitted(tmp_path)
    main(['--robot', str(tmp_path / 'arm.urdf'), '--data', str(tmp_path / 'log.npz'), '--json',
          str(tmp_path / 'arrays.json'), '--known', 'servo.delay',
          repr(found['servo.delay']['value'])])
    arrays = json.loads((tmp_path / 'arrays.json').read_text())
    # The text has nine digits.
    for name, one in arrays.items():
        assert one['value'] == pytest.approx(found[name]['value'], rel=1e-3), name
    assert 'servo.delay' not in arrays


def test_commands_are_no_forces_of_a_training(tmp_path):
    t = 0.01 * np.arange(100)
    np.savez(tmp_path / 'log.npz', t=t, q=np.sin(t)[:, None], goal=np.cos(t)[:, None])
    data = ArraysData(path=str(tmp_path / 'log.npz'), v=None, tau=None, command='goal')
    with refused(DataError):
        read_motions(tmp_path, data, ['q'])


def test_samples_of_a_json_file_beside_its_settings_are_a_log(tmp_path):
    """As the repositories Rhoban/bam and kscalelabs/sysid store them."""
    t = 0.01 * np.arange(60)
    (tmp_path / 'log.json').write_text(json.dumps({'mass': 0.5, 'kp': 8, 'entries': [
        {'timestamp': float(x), 'position': np.sin(x), 'goal_position': np.cos(x),
         'input_volts': 7.4, 'torque_enable': bool(x < 0.3)} for x in t]}))
    arm_joint = Coordinate('joint', 'rad', 'N m s')
    data = source_of(str(tmp_path / 'log.json'), [arm_joint], None, True)
    assert (data.command, data.enabled, data.tau) == (['goal_position'], ['torque_enable'], None)
    motions, _ = read_motions(
        tmp_path, data, ['joint'], [str(tmp_path / 'log.json')], ['rad'], True)
    off = np.abs(motions[0].tau[:, 0]) == OFF
    np.testing.assert_array_equal(off, motions[0].t > 0.295)
    np.testing.assert_allclose(motions[0].tau[~off, 0], np.cos(t)[~off], atol=1e-12)


def dataset(folder: Path, names: list[str], size: float) -> Path:
    """Write a dataset of LeRobot, with two episodes of two joints and a gripper."""
    t = np.tile(np.arange(50) / 30.0, 2)
    state = size * np.stack([np.sin(t), np.cos(2.0 * t), 0.0 * t + 0.5], axis=1)
    (folder / 'meta').mkdir()
    (folder / 'data' / 'chunk-000').mkdir(parents=True)
    feature = {'dtype': 'float32', 'shape': [3], 'names': names}
    (folder / 'meta' / 'info.json').write_text(json.dumps({
        'fps': 30, 'features': {'action': feature, 'observation.state': feature}}))
    path = folder / 'data' / 'chunk-000' / 'file-000.parquet'
    DataFrame({'action': [*(state + 1.0)], 'observation.state': [*state], 'timestamp': t,
               'frame_index': np.tile(np.arange(50), 2), 'episode_index': np.repeat([0, 1], 50),
               'index': np.arange(100), 'task_index': 0}).to_parquet(path)
    return path


def test_episodes_of_lerobot_are_motions_in_degrees(tmp_path):
    path = dataset(tmp_path, ['shoulder_pan.pos', 'elbow_flex.pos', 'gripper.pos'], 120.0)
    joints = [Coordinate(name, 'rad', 'N m s') for name in ('elbow_flex', 'shoulder_pan')]
    names = [one.name for one in joints]
    data = source_of(str(path), joints, None, True)
    motions, _ = read_motions(tmp_path, data, names, [str(path)], ['rad', 'rad'], True)
    assert [motion.name for motion in motions] == ['0', '1']
    t = np.arange(50) / 30.0
    # Within the rounding of the resampled times.
    expected = np.radians(120.0) * np.stack([np.cos(2.0 * t), np.sin(t)], axis=1)
    np.testing.assert_allclose(motions[1].q, expected, atol=1e-9)
    np.testing.assert_allclose(motions[1].tau, expected + np.radians(1.0), atol=1e-9)


def test_episode_of_three_rows_is_left_out_and_said(tmp_path):
    path = dataset(tmp_path, ['shoulder_pan.pos', 'elbow_flex.pos', 'gripper.pos'], 120.0)
    read_parquet(path).iloc[:53].to_parquet(path)
    joints = [Coordinate(name, 'rad', 'N m s') for name in ('shoulder_pan', 'elbow_flex')]
    names = [one.name for one in joints]
    motions, said = read_motions(tmp_path, source_of(str(path), joints, None, True), names,
                                 [str(path)], ['rad', 'rad'], True)
    assert [motion.name for motion in motions] == ['0']
    assert 'left out 3 in pieces of fewer than 20 of the samples' in said


@pytest.mark.parametrize('name', ['timestamp', 'episode_index'])
def test_lerobot_table_without_times_or_episodes_is_one_line(name, tmp_path):
    path = dataset(tmp_path, ['shoulder_pan.pos', 'elbow_flex.pos', 'gripper.pos'], 120.0)
    read_parquet(path).drop(columns=[name]).to_parquet(path)
    with refused(DataError):
        source_of(str(path), [], None, True)


def test_robot_without_moving_joints_is_one_line(tmp_path):
    (tmp_path / 'fixed.urdf').write_text('<robot name="fixed"><link name="base"/></robot>')
    for run, options in ((main, ['--data', 'log.csv']), (check, ['--excitation', 'move.csv'])):
        with refused(HnnViRosError):
            run(['--robot', str(tmp_path / 'fixed.urdf'), *options])


def test_per_cent_of_a_range_are_refused_without_calibration(tmp_path):
    path = dataset(tmp_path, ['shoulder_pan.pos', 'elbow_flex.pos', 'gripper.pos'], 90.0)
    with refused(DataError):
        source_of(str(path), [], None, True)
