# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Bags as the simulator records them, and as other recorders do, made without one."""

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path

from hnn_vi_ros.bags.bag_metadata import BagTopics, Topic
from hnn_vi_ros.bags.cdr import serialize
from hnn_vi_ros.bags.mcap_reader import BagReader
from hnn_vi_ros.ros.recording import BagOutput, Beginning
from hnn_vi_ros.ros.settings import Settings
from hnn_vi_ros.ros.topics.inputs import INPUTS
from hnn_vi_ros.ros.topics.messages import describe_topic
from hnn_vi_ros.ros.topics.outputs import encode_sample, SAMPLED, SCENE, TICKS
from hnn_vi_ros.run.run_folder import RunFiles
from hnn_vi_ros.run.sampling import Sampler
from hnn_vi_ros.run.scene_report import scene_report
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import Sample
from hnn_vi_ros.simulation.build import build
from mcap.writer import Writer
import numpy as np
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64MultiArray

# Of samples that nobody may miss: a machine may stall for more than ten messages.
QUEUE = QoSProfile(depth=10_000)
# Wall time at which another recorder began [ns].
EPOCH = 1_700_000_000 * 10**9


def record_run(bag: Path, scene: Scene, ticks: int, rate: float = 100.0,
               change: Callable[[Sample], Sample] = lambda sample: sample, close: bool = True,
               commands: Mapping[int, Sequence[object]] | None = None, begin: int | None = None,
               state: bool = True, qos: QoSProfile = TICKS, limited: bool = True,
               refuse: bool = False, **described: object) -> Path:
    """
    Record a run; `change` returns what is recorded in place of a sample.

    Of each step, `commands` are what is heard before it, numbers or messages. The bag begins with
    the run, or is asked for later: at the step `begin`, once what comes before that was heard. It
    is one of before ~/state without `state`. Replay offers its samples by `qos`. Without
    `limited`, commands beyond limits act; with `refuse` those are recorded that do not.
    """
    simulation = build(scene)
    simulation.restart(simulation.q.copy(), simulation.p.copy(),
                       step=described.get('first_step', 0))
    sampler = Sampler(simulation, rate)
    encode = encode_sample(simulation.hamiltonian.coordinates)
    report = scene_report(scene, simulation) | described
    topics = SAMPLED if state else SAMPLED[1:]
    sink = BagOutput(
        Settings(record=begin is None, record_path=str(bag), publish_rate=rate),
        BagTopics([_topic(*topic[:2], qos) for topic in topics], _topic(*SCENE[:3])),
        RunFiles())
    recording, first = sink.open(Beginning(scene, simulation, report, sampler)), simulation.steps
    for step in range(first, first + ticks * sampler.every):
        for heard in (commands or {}).get(step, ()):
            message = Float64MultiArray(data=heard) if isinstance(heard, list) else heard
            # Joint states are commands before they are observations.
            one = next(one for one in INPUTS if isinstance(message, one.message_type))
            try:
                if one.read is not None:
                    simulation.set_command(one.read(message, sampler.stamp), limited)
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
            sink.write(sample, encode(sample)[0 if state else 1:])
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
    with path.open('wb') as stream:
        writer = Writer(stream, chunk_size=8192)
        writer.start('ros2')
        channels = {}
        for number, channel in reader.channels.items():
            if channel.topic.rpartition('/')[2] not in without:
                schema = reader.schemas[channel.schema_id]
                channels[number] = writer.register_channel(
                    channel.topic, 'cdr', writer.register_schema(
                        schema.name, 'ros2msg', schema.data), channel.metadata)
        for time, message in messages:
            if message.channel in channels:
                writer.add_message(channels[message.channel], time, message.data, time)
        writer.finish()
    return path


def of_several(path: Path, **bags: Path) -> Path:
    """Write one bag of several simulators, each in its namespace, from a bag of each."""
    messages = []
    with path.open('wb') as stream:
        writer = Writer(stream)
        writer.start('ros2')
        for namespace, bag in bags.items():
            reader = BagReader(bag)
            channels = {}
            for number, channel in reader.channels.items():
                schema = reader.schemas[channel.schema_id]
                name = channel.topic.replace('/hnn_simulator', f'/{namespace}/hnn_simulator')
                channels[number] = writer.register_channel(
                    name, 'cdr', writer.register_schema(schema.name, 'ros2msg', schema.data),
                    channel.metadata)
            messages += [(channels[message.channel], message.time, message.data)
                         for message in reader.messages()]
        for channel, time, data in sorted(messages, key=lambda item: item[1]):
            writer.add_message(channel, time, data, time)
        writer.finish()
    return path
