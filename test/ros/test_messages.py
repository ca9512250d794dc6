# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The messages of a tick, and what the log says of their topics."""

from dataclasses import replace
import sys

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.phase_space import Coordinate, Follower
from hnn_vi_ros.recording import Sample
from hnn_vi_ros.ros.topics import messages
from hnn_vi_ros.ros.topics.inputs import places_of
from messages import refused
import numpy as np
from peer import nodes_of
import pytest
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from recorded import encode_sample, SAMPLED
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64
import yaml

TICK_TYPES = tuple(output.message_type for output in SAMPLED)
PUBLISHED_TYPES = tuple(dict.fromkeys(TICK_TYPES))
QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
# Doubles that survive only an exact copy of their bits.
HARD = np.array([-0.0, 5e-324, np.nextafter(1.0, 2.0), -np.finfo(float).max, np.inf])


def sample_of(dimension: int, step: int) -> Sample:
    """Return a sample whose arrays all differ."""
    rng = np.random.default_rng(step)
    q, p, dH_dq, dH_dp, motors = rng.normal(size=(5, dimension))
    return Sample(step, step * 10_000_000, q, p, dH_dq, dH_dp, rng.normal(), 0.0, 0.0,
                  rng.normal(), motors)


def encoder_of(names: list[str]) -> messages.Encode:
    return encode_sample([*map(Coordinate, names)])


def decode(encoded: tuple[bytes, ...]) -> list:
    return [deserialize_message(data, kind)
            for data, kind in zip(encoded, TICK_TYPES, strict=True)]


@pytest.mark.parametrize('samples', [
    [sample_of(1, step) for step in range(100)], [sample_of(3, step) for step in range(100)],
    [Sample(0, 0, HARD, -HARD, HARD, -HARD, -0.0, 0.0, 0.0, motors=-HARD)]],
    ids=['one coordinate', 'three', 'hard values'])
def test_messages_equal_the_sample_bit_for_bit(samples):
    names = [*'abcde'][:samples[0].q.size]
    encode = encoder_of(names)
    # All are encoded before the first is looked at: a message must not change with the next.
    encoded = [encode(sample) for sample in samples]
    for sample, data in zip(samples, encoded, strict=True):
        state, q, p, energy, joints = decode(data)
        everything = np.concatenate([
            sample.q, sample.p, -sample.dH_dq, [sample.energy, sample.work]])
        assert state.header == joints.header
        assert state.name == [*names, *(f'p_{name}' for name in names),
                              *(f'dp_dt_{name}' for name in names), 'H', 'work']
        for field, values in ((state.position, everything), (q.data, sample.q), (p.data, sample.p),
                              (joints.position, sample.q), (joints.velocity, sample.dH_dp),
                              (joints.effort, sample.motors)):
            assert field.tobytes() == values.tobytes()
        assert np.float64(energy.data).tobytes() == np.float64(sample.energy).tobytes()
        assert joints.name == names
        for message in (q, p):
            dimension, = message.layout.dim
            assert (dimension.label, dimension.size, dimension.stride) == (
                ','.join(names), len(names), len(names))
            assert message.layout.data_offset == 0


def test_joint_states_have_all_joints_and_efforts_are_those_of_the_leaders():
    thumb = Coordinate('thumb', followers=(Follower('tip', -0.5, 0.25), Follower('pad', 2.0, 0.0)))
    encode = encode_sample([Coordinate('wrist'), thumb])
    sample = Sample(0, 0, np.array([1.0, 3.0]), *np.zeros((2, 2)), np.array([5.0, 7.0]), 0.0, 0.0,
                    0.0, motors=np.array([8.0, 9.0]))
    joints = decode(encode(sample))[-1]
    assert joints.name == ['wrist', 'thumb', 'tip', 'pad']
    assert list(joints.position) == [1.0, 3.0, -1.25, 6.0]
    assert list(joints.velocity) == [5.0, 7.0, -3.5, 14.0]
    assert list(joints.effort) == [8.0, 9.0, 0.0, 0.0]
    assert list(decode(encode(replace(sample, motors=None)))[-1].effort) == [0.0] * 4


def test_initial_state_may_name_joints_that_follow_others():
    joint = Coordinate('wrist'), Coordinate('thumb', followers=(Follower('tip', -0.5, 0.25),))
    assert places_of(joint, ['tip', 'thumb', 'wrist'], 'name') == [2, 1]
    with refused(ValueError):
        places_of(joint, ['tip', 'wrist'], 'name')


@pytest.mark.parametrize('stamp', [0, 999_999_999, 1_000_000_000, 123_456_789_012_345_678])
def test_stamp_is_the_samples_time_in_nanoseconds(stamp):
    one = np.ones(1)
    sample = Sample(0, stamp, one, one, one, one, 0.0, 0.0, 0.0)
    decoded = decode(encoder_of(['x'])(sample))
    for header in (decoded[0].header, decoded[-1].header):
        assert header.stamp.sec * 10**9 + header.stamp.nanosec == stamp
        assert 0 <= header.stamp.nanosec < 10**9


@pytest.mark.parametrize('message_type', [*PUBLISHED_TYPES, Imu])
def test_definition_and_hash_agree_with_rosbags(message_type):
    name = messages.message_type_name(message_type)
    definition, type_hash = messages.message_definition(name), messages.type_hash(name)
    assert type_hash == get_typestore(Stores.ROS2_JAZZY).hash_rihs01(name)
    # A reader that knows no type finds all it needs in the definition.
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition, name))
    assert store.hash_rihs01(name) == type_hash


def test_definition_lists_each_dependency_once_in_the_form_of_rosbag2():
    parts = messages.message_definition('sensor_msgs/msg/Imu').split(f'\n{"=" * 80}\nMSG: ')
    assert [part.splitlines()[0] for part in parts[1:]] == [
        'geometry_msgs/Quaternion', 'geometry_msgs/Vector3', 'std_msgs/Header',
        'builtin_interfaces/Time']


def test_hash_and_qos_agree_with_what_discovery_reports():
    with nodes_of('messages_test') as ((node,), _):
        for i, (message_type, qos) in enumerate([
                (Float64, QOS), (JointState, QOS),
                (Float64, QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=3,
                                     reliability=ReliabilityPolicy.BEST_EFFORT,
                                     durability=DurabilityPolicy.TRANSIENT_LOCAL,
                                     lifespan=Duration(seconds=2, nanoseconds=5)))]):
            publisher = node.create_publisher(message_type, f'topic{i}', qos)
            found, = node.get_publishers_info_by_topic(f'/topic{i}')
            topic = messages.describe_topic(
                publisher.topic_name, message_type, publisher.qos_profile)
            assert (topic.name, topic.type) == (f'/topic{i}', found.topic_type)
            value = bytes(found.topic_type_hash.value).hex()
            assert topic.type_hash == f'RIHS{found.topic_type_hash.version:02}_{value}'
            described, = yaml.safe_load(topic.offered_qos_profiles)
            reported, = yaml.safe_load(messages.qos_yaml(found.qos_profile))
            # Discovery need not tell the history; the publisher knows it.
            assert (described.pop('history'), described.pop('depth')) == ('keep_last', qos.depth)
            del reported['history'], reported['depth']
            assert described == reported


def test_qos_is_written_as_rosbag2_writes_it():
    forever = 'sec: 9223372036\n    nsec: 854775807'
    assert messages.qos_yaml(QOS) == f"""\
- history: keep_last
  depth: 10
  reliability: reliable
  durability: volatile
  deadline:
    {forever}
  lifespan:
    {forever}
  liveliness: automatic
  liveliness_lease_duration:
    {forever}
  avoid_ros_namespace_conventions: false"""


def install(prefix, name: str, description: str) -> None:
    folder = prefix / 'share' / 'some_msgs' / 'msg'
    folder.mkdir(parents=True)
    (folder / f'{name}.msg').write_text('float64 data\n')
    (folder / f'{name}.json').write_text(description)


def test_definition_is_found_beside_the_interpreter_without_a_prefix_path(tmp_path, monkeypatch):
    install(tmp_path, 'Some', '{"type_hashes": [{"type_name": "some_msgs/msg/Some", '
                              '"hash_string": "RIHS01_0"}]}')
    monkeypatch.delenv('AMENT_PREFIX_PATH', raising=False)
    monkeypatch.setattr(sys, 'prefix', str(tmp_path))
    assert messages.message_definition('some_msgs/msg/Some') == 'float64 data\n'
    assert messages.type_hash('some_msgs/msg/Some') == 'RIHS01_0'


def test_definition_that_is_not_installed_is_an_error_with_a_remedy(tmp_path, monkeypatch):
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    monkeypatch.setattr(sys, 'prefix', str(tmp_path / 'venv'))
    for read in (messages.message_definition, messages.type_hash):
        with refused(RecordingError):
            read('std_msgs/msg/Float64')


@pytest.mark.parametrize('description', ['{', '{}', '[]', '{"type_hashes": []}',
                                         '{"type_hashes": [1]}'])
def test_description_without_a_hash_is_an_error_with_a_remedy(
        tmp_path, monkeypatch, description):
    install(tmp_path, 'Some', description)
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    with refused(RecordingError):
        messages.type_hash('some_msgs/msg/Some')
