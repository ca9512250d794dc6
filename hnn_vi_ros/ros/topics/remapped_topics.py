# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Remapped topics of the simulator: how the remapping is recorded and read from a bag."""

from collections.abc import Iterable, Iterator
from contextlib import suppress

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files import parse_mapping
from hnn_vi_ros.recording import BagReader
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

# Key of the remapping in ~/scene and in the bag.
KEY = 'remapped'
_STRING = 'std_msgs/msg/String'


def remapped_names(node: Node, topics: Iterable[str]) -> dict[str, str]:
    """
    Return the new names of the remapped topics of a node, by their original full names.

    Parameters
    ----------
    node : Node
        Node, with or without remapping rules.
    topics : iterable of str
        Names in the code of the node, such as ``'~/state'``.

    """
    names = {expand_topic_name(topic, node.get_name(), node.get_namespace()):
             node.resolve_topic_name(topic) for topic in topics}
    return {own: called for own, called in names.items() if own != called}


def own_topics(reader: BagReader) -> dict[str, int]:
    """
    Return the channels of a bag by topic; a remapped one also has its original name as a key.

    Parameters
    ----------
    reader : BagReader
        Reader of a bag of the simulator, or of another recorder that contains ~/scene.

    """
    topics = {channel.topic: number for number, channel in reader.channels.items()}
    found: dict[str, int] = {}
    for text in _scenes(reader, topics):
        try:
            remapped = parse_mapping(text, reader.path, RecordingError)[0].get(KEY)
        except RecordingError:
            # The code that needs the scene reports its faults.
            continue
        for own, called in (remapped if isinstance(remapped, dict) else {}).items():
            if isinstance(called, str) and called in topics:
                found[own] = topics[called]
    return topics | found


def _scenes(reader: BagReader, topics: dict[str, int]) -> Iterator[bytes | str]:
    """Yield possible texts of scenes: that of the bag, or the first message of each such topic."""
    if (kept := reader.attachment('scene.yaml')) is not None:
        yield kept
        return
    for topic, number in topics.items():
        schema = reader.schemas.get(reader.channels[number].schema_id)
        if topic.endswith('/scene') and schema is not None and schema.name == _STRING:
            for message in reader.messages([number]):
                # A message of another type is reported by the code that needs it.
                with suppress(RuntimeError):
                    yield deserialize_message(message.data, String).data
                break
