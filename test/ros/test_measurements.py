# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What sensors make of joint_states: published, recorded, and verified from the bag."""

from pathlib import Path

from hnn_vi_ros.recording import BagReader, decode_state
from hnn_vi_ros.run.replay_check import check_replay
from hnn_vi_ros.run import JointSensor
import numpy as np
from peer import simulating
from processes import finish, start
from rclpy.serialization import deserialize_message
from recorded import assert_agrees
from scene_files import write_scene
from sensor_msgs.msg import JointState

SENSOR = ('measurements: {joint_states: {noise: 0.01, quantisation: 0.002, velocity: encoder, '
          'delay: 0.03, rate: 50.0, dropout: 0.2, seed: 3}}\n')


def messages_of(bag: Path, topic: str) -> list[bytes]:
    reader = BagReader(bag)
    channel, = (number for number, one in reader.channels.items() if one.topic == topic)
    return [message.data for message in reader.messages([channel])]


def test_readings_replace_joint_states_and_are_verified(tmp_path, monkeypatch):
    write_scene(tmp_path / 'scene.yaml', more=SENSOR)
    status, _, error = finish(start(tmp_path, scene='scene.yaml', record_path='bag', duration=4.0,
                                    real_time_factor=0))
    assert status == 0, error
    states = {state.stamp: state for state in map(decode_state, messages_of(
        tmp_path / 'bag', '/hnn_simulator/state'))}
    readings = [deserialize_message(data, JointState)
                for data in messages_of(tmp_path / 'bag', '/joint_states')]
    # Of 200 readings a fifth is lost.
    assert len(states) == 400 and 120 < len(readings) < 200
    errors = []
    for reading in readings:
        stamp = reading.header.stamp.sec * 10**9 + reading.header.stamp.nanosec
        assert stamp % 20_000_000 == 0
        if stamp >= 40_000_000:
            errors.append(reading.position[0] - states[stamp - 30_000_000].q[0])
    # Noise and rounding, whose deviation is a twelfth of the squared resolution.
    assert abs(np.std(errors) - 0.01) < 0.002 and abs(np.mean(errors)) < 0.003
    assert_agrees(tmp_path / 'bag', 400)
    with monkeypatch.context() as patched:
        patched.setattr('hnn_vi_ros.run.recorded_run.RecordedRun.own', False)
        verdict = check_replay(tmp_path / 'bag')
    assert verdict.good and ('readings of joint_states are not compared: another recorder may '
                             'have lost some') in verdict.text

    class Other(JointSensor):

        def __init__(self, choice, *arguments):
            super().__init__(choice.model_copy(update={'seed': 4}), *arguments)
    monkeypatch.setattr('hnn_vi_ros.run.companions.sensors.JointSensor', Other)
    verdict = check_replay(tmp_path / 'bag')
    assert not verdict.good and 'readings of joint_states differ, the first at t =' in verdict.text


def test_readings_of_a_bag_begun_within_a_run_are_verified(tmp_path):
    write_scene(tmp_path / 'scene.yaml', more=SENSOR)
    with simulating(tmp_path, scene='scene.yaml', record_path='bag') as (other, _):
        heard = other.hear(JointState, 'joint_states')
        other.spin_until(lambda: len(heard) > 20)
        assert other.trigger('stop_recording').success
        assert other.trigger('start_recording').success
        other.spin_until(lambda: len(heard) > 60)
        assert other.trigger('reset').success
        other.spin_until(lambda: len(heard) > 80)
    for name in ('bag', 'bag-2'):
        assert messages_of(tmp_path / name, '/joint_states')
        assert_agrees(tmp_path / name)
