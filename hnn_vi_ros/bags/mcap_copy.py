# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Write what can be read of an MCAP file into a whole one."""

from typing import BinaryIO

from hnn_vi_ros.bags.bag_metadata import bag_metadata, Extent, NEVER, read_description, Topic
from hnn_vi_ros.bags.mcap_file import McapFile
from hnn_vi_ros.files.yaml_text import dump_yaml
from mcap.records import Channel, Schema
from mcap.writer import CompressionType, Writer

_CHUNK_SIZE = 256 * 1024


def copy_messages(file: McapFile, target: BinaryIO) -> None:
    """
    Write a whole file with all channels, messages, attachments and metadata of another.

    Parameters
    ----------
    file : McapFile
        May break off, or be damaged.
    target : BinaryIO
        Empty.

    """
    writer = Writer(target, chunk_size=_CHUNK_SIZE, compression=CompressionType.ZSTD,
                    enable_data_crcs=True)
    header = file.survey.header
    writer.start(header.profile if header else 'ros2', header.library if header else '')
    for record in file.survey.metadata:
        writer.add_metadata(record.name, record.metadata)
    for attachment in file.attachments():
        writer.add_attachment(attachment.create_time, attachment.log_time, attachment.name,
                              attachment.media_type, attachment.data)
    channels = _register(writer, file)
    counts, first, last = dict.fromkeys(file.channels, 0), NEVER, 0
    for message in file.messages():
        writer.add_message(channels[message.channel_id], message.log_time, message.data,
                           message.publish_time, message.sequence)
        counts[message.channel_id] += 1
        first, last = min(first, message.log_time), max(last, message.log_time)
    # At the end, what the bag holds, as its recorder would have done.
    topics = [describe_topic(channel, file.schemas.get(channel.schema_id))
              for channel in file.channels.values()]
    extent = Extent(file.name.name, sum(counts.values()), first, last)
    described = bag_metadata([extent], topics, list(counts.values()), ros_distro(file))
    writer.add_metadata('rosbag2', {'serialized_metadata': dump_yaml(described)})
    writer.finish()


def _register(writer: Writer, file: McapFile) -> dict[int, int]:
    """Describe the channels, in the order of their numbers; return the new ones."""
    # Schema 0 means no schema.
    schemas = {0: 0}
    for number, schema in file.schemas.items():
        schemas[number] = writer.register_schema(schema.name, schema.encoding, schema.data)
    return {number: writer.register_channel(channel.topic, channel.message_encoding,
                                            schemas.get(channel.schema_id, 0), channel.metadata)
            for number, channel in file.channels.items()}


def describe_topic(channel: Channel, schema: Schema | None) -> Topic:
    """Return the description of a channel by rosbag2."""
    about = channel.metadata
    return Topic(channel.topic, schema.name if schema else '',
                 schema.data.decode(errors='replace') if schema else '',
                 about.get('topic_type_hash', ''), about.get('offered_qos_profiles') or '[]')


def ros_distro(file: McapFile) -> str:
    """Return the ROS distribution that a file names as its origin."""
    named = read_description(file.metadata('rosbag2').get('serialized_metadata', ''))
    return str(named.get('ros_distro') or 'jazzy')
