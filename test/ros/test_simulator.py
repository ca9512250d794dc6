# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The simulator as a process: its files, its messages, its end, and its answers to mistakes."""

from pathlib import Path
import signal

from hnn_vi_ros import load_scene, simulate
from hnn_vi_ros.ros.topics.outputs import LATCHED
from messages import assert_message
import numpy as np
from peer import Listener, peer, stamp, TICK_TYPES
from processes import (
    finish, read_bag, recorded_until, refusal, simulator_words, start, wait_until)
import pytest
from recorded import assert_agrees, recorded_messages
from rerun_reader import assert_verified
from scene_files import write_scene
from std_msgs.msg import Float64MultiArray, String
import yaml


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a working directory with a scene in it."""
    write_scene(tmp_path / 'commanded.yaml', 'free_particle, mass: 2.0, names: [x]',
                '{kind: external_force, coordinates: [x]}', q=[0.0])
    return tmp_path


def test_simulator_run_leaves_a_bag_of_its_samples_and_a_recording(folder):
    status, out, _ = finish(start(folder, duration=5, real_time_factor=0, record='true',
                                  rerun_sink='file'))
    assert status == 0
    (run,) = (folder / 'runs').iterdir()
    assert run.name.startswith('exact_harmonic_oscillator-')
    topics = read_bag(run / 'bag')
    assert {name: type(messages[0][1]).__name__ for name, messages in topics.items()} == {
        '/hnn_simulator/q': 'std_msgs__msg__Float64MultiArray',
        '/hnn_simulator/p': 'std_msgs__msg__Float64MultiArray',
        '/hnn_simulator/energy': 'std_msgs__msg__Float64',
        '/joint_states': 'sensor_msgs__msg__JointState',
        '/hnn_simulator/state': 'sensor_msgs__msg__JointState',
        '/hnn_simulator/scene': 'std_msgs__msg__String'}
    # The scene, once, with the state that the bag begins at.
    assert [when for when, _ in topics.pop('/hnn_simulator/scene')] == [0]
    stamps = [[when for when, _ in messages] for messages in topics.values()]
    # One message a topic and tick, 10 ms apart from the first, and one time for all of them.
    assert stamps == [[10_000_000 * tick for tick in range(1, 501)]] * 5
    assert [stamp(message) for _, message in topics['/joint_states']] == stamps[0]
    assert_verified(run / 'recording.rrd')
    assert str(run.relative_to(folder) / 'bag') in out
    assert 'rerun runs/' in out
    trajectory = simulate(load_scene('exact_harmonic_oscillator'), 5.0)
    q = np.array([message.data for _, message in topics['/hnn_simulator/q']])
    energy = np.array([message.data for _, message in topics['/hnn_simulator/energy']])
    joints = [message for _, message in topics['/joint_states']]
    assert np.array_equal(q, trajectory.q[1:])
    assert np.array_equal(energy, trajectory.energy[1:])
    assert np.array_equal([joint.velocity[0] for joint in joints], trajectory.p[1:, 0])
    # The effort of a spring that is no motor.
    assert not np.any([joint.effort for joint in joints])
    assert joints[0].name == ['x']


@pytest.mark.parametrize('seconds, rate', [
    (3, 100), pytest.param(25, 1000, marks=pytest.mark.long)])
def test_subscriber_in_a_second_process_receives_every_sample_of_the_bag(
        folder, seconds, rate):
    # Queues that hold all messages: a busy machine may stall anybody.
    count = seconds * rate
    queues = {f'qos_overrides.{topic}.publisher.depth': count for topic in TICK_TYPES}
    for factor in (1.0, 0.5):
        bag = folder / f'bag_{factor}'
        with peer(lambda: Listener(count)) as listener:
            process = start(folder, duration=seconds, publish_rate=rate, step_size=1.0 / rate,
                            real_time_factor=factor, record_path=bag, discovery_time=10, **queues)
            listener.spin_until(lambda process=process: process.poll() is not None)
            heard = -1
            while heard < (heard := sum(map(len, listener.heard.values()))):
                # The rest of the queues.
                listener.spin(0.5)
        status, _, log = finish(process)
        assert status == 0
        # The node reports a machine that is too busy for the pace.
        if 'too slow to receive' not in log:
            break
    assert listener.received == recorded_messages(bag)
    # A busy machine may have added alarms of overruns.
    stamps = {topic: [when for when, _ in messages] for topic, messages in read_bag(bag).items()
              if topic != '/diagnostics'}
    assert len(stamps.pop('/hnn_simulator/scene')) == 1
    assert stamps.keys() == TICK_TYPES.keys()
    assert all(found == [10**9 // rate * tick for tick in range(1, count + 1)]
               for found in stamps.values())


def test_simulator_obeys_commands_and_accounts_for_their_work(folder):
    with peer() as other:
        commands = other.publisher(Float64MultiArray, '~/commands')
        scenes = other.hear(String, '~/scene', LATCHED)
        process = start(folder, scene='commanded.yaml', duration=3, record_path='bag',
                        publish_accuracy='true', discovery_time=2)
        while process.poll() is None:
            # One that is not valid comes between those that are, and does no harm.
            for command in ([3.0], [3.0, 3.0]):
                commands.publish(Float64MultiArray(data=command))
                other.spin(0.05)
    status, _, error = finish(process)
    assert status == 0
    assert '~/commands: message ignored' in error
    scene = yaml.safe_load(scenes[0].data)
    assert [effect['kind'] for effect in scene['effects']] == ['external_force']
    assert scene['conservative'] is False
    assert_agrees(folder / 'bag')
    topics = read_bag(folder / 'bag')
    ((_, recorded),) = topics['/hnn_simulator/scene']
    assert recorded.data == scenes[0].data
    p = np.array([message.data[0] for _, message in topics['/hnn_simulator/p']])
    force = np.diff(p) / 0.01
    # Differences of momenta up to 9 kg m/s, over 0.01 s: 4e-13.
    assert np.isclose(force, 3.0, atol=1e-12).any()
    assert (np.isclose(force, 3.0, atol=1e-12) | (force == 0.0)).all()
    accuracy = np.array([message.data for _, message in topics['/hnn_simulator/accuracy']])
    energy, _, error, work, balance = accuracy.T[:5]
    assert work[-1] > 0.0
    # Exact for a constant force; 300 steps of rounding of energies up to 20 J, and H0 is zero.
    assert np.abs(energy - work).max() < 1e-10
    assert np.array_equal(error, balance)


@pytest.mark.parametrize(
    'number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP], ids=lambda s: s.name)
def test_simulator_signal_closes_the_files_and_exits_0(folder, number):
    process = start(folder, record_path='bag', rerun_path='picture.rrd')
    wait_until(lambda: recorded_until(folder / 'bag' / 'bag_0.mcap') > 0.6e9)
    process.send_signal(number)
    status, _, error = finish(process)
    assert status == 0
    assert f'stopped by {number.name}' in error
    assert len(read_bag(folder / 'bag')['/hnn_simulator/q']) > 50
    assert_verified(folder / 'picture.rrd')


def test_simulator_rounds_the_publish_rate_to_whole_steps_and_says_so(folder):
    status, _, error = finish(start(folder, duration=3, publish_rate=30, real_time_factor=0,
                                    record_path='bag'))
    assert status == 0
    assert 'every 3 steps' in error
    stamps = [stamp for stamp, _ in read_bag(folder / 'bag')['/hnn_simulator/q']]
    assert stamps == [30_000_000 * tick for tick in range(1, 101)]


MISTAKES = [
    {'scene': 'nothing'}, {'scene': './nothing.yaml'}, {'publish_rate': -1},
    {'publish_rate': 'fast'}, {'publish_rate': 1e9}, {'record': 3}, {'duration': '.nan'},
    {'real_time_factor': -0.5}, {'rerun_sink': 'screen'}, {'scene': 5},
    {'real_time_factor': '1.0e-300'}, {'step_size': '1.0e-25'},
    {'scene': 'commanded.yaml', 'integrator': 'discrete_euler_lagrange'},
    {'integrator': 'rk5'}, {'duration': 0.001}, {'record_path': 'taken'},
    {'rerun_path': 'taken'}, {'record_path': '/dev/null/bag'}, {'rerun_path': '/dev/null/a'}]


def test_simulator_mistake_is_one_line(folder, monkeypatch):
    monkeypatch.chdir(folder)
    (folder / 'taken').mkdir()
    for parameters in MISTAKES:
        assert_message(refusal('simulator', *simulator_words(**parameters)))
    assert not list((folder / 'taken').iterdir())


def test_simulator_mistake_is_one_line_on_stderr_and_status_1(folder):
    status, out, error = finish(start(folder, publish_rate='fast'))
    assert (status, out) == (1, '')
    (line,) = [line for line in error.splitlines() if '[INFO]' not in line]
    assert line.startswith('hnn simulator: ')
