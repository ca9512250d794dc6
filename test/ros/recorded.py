# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Bags as the simulator records them, and as other recorders do, made without one."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from bag_content import content_of
from hnn_vi_ros.phase_space import Coordinate
from hnn_vi_ros.recording import BagReader, BagTopics, RecordedMessage, Sample, serialize, Topic
from hnn_vi_ros.ros.recording import BagOutput, RecordingStart
from hnn_vi_ros.run.replay_check import check_replay
from hnn_vi_ros.ros.settings import Settings
from hnn_vi_ros.ros.topics.inputs import INPUTS
from hnn_vi_ros.ros.topics.messages import describe_topic, Encode, encode_causes
from hnn_vi_ros.ros.topics.outputs import ENERGY_BY_CAUSE, OUTPUTS, SCENE, TICKS
from hnn_vi_ros.run import RunFiles, Sampler, scene_report
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import build
from mcap.writer import Writer
import numpy as np
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray

# Topics of each tick.
TICK_TYPES = {
    '/hnn_simulator/state': JointState, '/hnn_simulator/q': Float64MultiArray,
    '/hnn_simulator/p': Float64MultiArray, '/hnn_simulator/energy': Float64,
    '/joint_states': JointState}
# Topics of each tick that any run has.
SAMPLED = tuple(output for output in OUTPUTS if output.encoder is not None)
# Of samples that nobody may miss: a machine may stall for more than ten messages.
QUEUE = QoSProfile(depth=10_000)
# Wall time at which another recorder began [ns].
EPOCH = 1_700_000_000 * 10**9


def encode_sample(coordinates: Sequence[Coordinate]) -> Encode:
    """Return an encoder that makes one message of a sample for each of SAMPLED."""
    encoders = [output.encoder(coordinates) for output in SAMPLED]
    return lambda sample: [payload for encode in encoders for payload in encode(sample)]


def record_run(bag: Path, scene: Scene, ticks: int, rate: float = 100.0,
               change: Callable[[Sample], Sample] = lambda sample: sample, close: bool = True,
               commands: Mapping[int, Sequence[object]] | None = None, begin: int | None = None,
               qos: QoSProfile = TICKS, limited: bool = True, refuse: bool = False,
               **described: object) -> Path:
    """
    Record a run; `change` returns what is recorded in place of a sample.

    Of each step, `commands` are what is heard before it, numbers or messages. The bag begins with
    the run, or is asked for later: at the step `begin`, once what comes before that was heard.
    Replay offers its samples by `qos`. Without `limited`, commands beyond limits act; with
    `refuse` those are recorded that do not.
    """
    simulation = build(scene)
    simulation.restart(simulation.q.copy(), simulation.p.copy(),
                       step=described.get('first_step', 0))
    sampler = Sampler(simulation, rate)
    encode = encode_sample(simulation.hamiltonian.coordinates)
    report = scene_report(scene, simulation) | described
    sink = BagOutput(
        Settings(record=begin is None, record_path=str(bag), publish_rate=rate),
        BagTopics([_topic(*topic[:2], qos) for topic in SAMPLED], _topic(*SCENE[:3])),
        RunFiles())
    recording = sink.open(RecordingStart(scene, simulation, report, sampler))
    first = simulation.steps
    for step in range(first, first + ticks * sampler.every):
        for heard in (commands or {}).get(step, ()):
            message = Float64MultiArray(data=heard) if isinstance(heard, list) else heard
            # Joint states are commands before they are observations.
            one = next(one for one in INPUTS if isinstance(message, one.message_type))
            try:
                if one.content is not None:
                    simulation.set_command(one.content.read(message, sampler.stamp), limited)
            except ValueError:
                if not refuse:
                    raise
            if recording:
                sink.write_other(_topic(one.topic, one.message_type, qos), sampler.stamp,
                                 serialize(message))
        if begin is not None and step == first + begin:
            sink.start()
            recording = True
        simulation.advance(1)
        if simulation.steps % sampler.every == 0 and recording:
            sample = change(sampler.sample())
            sink.write(sample, encode(sample))
            if sample.causes is not None:
                sink.write_other(_topic(*ENERGY_BY_CAUSE[:2], qos), sample.stamp,
                                 encode_causes(simulation)(sample)[0])
    sink.close() if close else sink.flush()
    return bag


def _topic(name: str, kind: type, qos: QoSProfile) -> Topic:
    full = name.replace('~', '/hnn_simulator') if name[0] == '~' else f'/{name}'
    return describe_topic(full, kind, qos)


def as_received(bag: Path, path: Path, without: Collection[str] = (), jitter: float = 0.004,
                epoch: int = EPOCH) -> Path:
    """Write a bag as `ros2 bag record -a` would: at the times of reception, no attachments."""
    reader, rng = BagReader(bag), np.random.default_rng(1)
    messages, newest = [], {}
    for message in reader.messages():
        time = epoch + message.time + round(rng.uniform(0.0, jitter) * 1e9)
        # Those of one topic come in their order.
        time = newest[message.channel] = max(time, newest.get(message.channel, 0) + 1)
        messages.append((time, message))
    messages.sort(key=lambda item: item[0])
    with writing(path) as writer:
        channels = copy_channels(writer, reader, without=without)
        for time, message in messages:
            if message.channel in channels:
                writer.add_message(channels[message.channel], time, message.data, time)
    return path


def of_several(path: Path, **bags: Path) -> Path:
    """Write one bag of several simulators, each in its namespace, from a bag of each."""
    messages = []
    with writing(path) as writer:
        for namespace, bag in bags.items():
            reader = BagReader(bag)
            channels = copy_channels(writer, reader, f'/{namespace}/hnn_simulator')
            messages += [(channels[message.channel], message.time, message.data)
                         for message in reader.messages()]
        for channel, time, data in sorted(messages, key=lambda item: item[1]):
            writer.add_message(channel, time, data, time)
    return path


def rewritten(reader: BagReader, path: Path,
              keep: Callable[[RecordedMessage], bool] = lambda message: True, own: bool = True,
              change: Callable[[RecordedMessage], RecordedMessage] = lambda message: message,
              files: Mapping[str, bytes] | None = None,
              times: Callable[[RecordedMessage], int] = lambda message: 1) -> Path:
    """Write the messages of a bag that are to be kept, with what the simulator keeps with them."""
    with writing(path) as writer:
        attachments = [found for source in reader._sources for found in source.attachments()]
        for found in attachments if own else ():
            writer.add_attachment(0, 0, found.name, '', (files or {}).get(found.name, found.data))
        writer.add_metadata('hnn_vi_ros', reader.metadata('hnn_vi_ros'))
        channels = copy_channels(writer, reader)
        for message in filter(keep, reader.messages()):
            for _ in range(times(message)):
                writer.add_message(
                    channels[message.channel], message.time, change(message).data, 0)
    return path


@contextmanager
def writing(path: Path, *header: str) -> Iterator[Writer]:
    """Give another recorder's writer of a bag."""
    with path.open('wb') as stream:
        writer = Writer(stream, chunk_size=8192)
        writer.start(*(header or ['ros2']))
        yield writer
        writer.finish()


def copy_channels(writer: Writer, reader: BagReader, node: str = '/hnn_simulator',
                  without: Collection[str] = ()) -> dict[int, int]:
    """Register the channels of a bag, of a node of this name; return the number of each."""
    return {number: writer.register_channel(
        channel.topic.replace('/hnn_simulator', node), 'cdr',
        writer.register_schema(schema.name, 'ros2msg', schema.data), channel.metadata)
        for number, channel in reader.channels.items()
        for schema in [reader.schemas[channel.schema_id]]
        if channel.topic.rpartition('/')[2] not in without}


def assert_agrees(bag: Path, samples: int | None = None) -> None:
    """Assert that a bag agrees bit by bit with its run simulated again, in so many samples."""
    verdict = check_replay(bag)
    assert verdict.good, verdict.text
    assert samples is None or f'{samples} samples are bit-identical' in verdict.text, verdict.text


def recorded_messages(bag: Path) -> dict[str, list[bytes]]:
    """Return the messages of the topics of each tick, in a bag that is not damaged."""
    messages = content_of(bag)
    return {topic: [data for name, _, data in messages if name == topic] for topic in TICK_TYPES}
