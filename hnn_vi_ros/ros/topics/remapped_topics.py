# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Topics of the simulator that were remapped: how that is recorded, and read from a bag."""

from collections.abc import Iterable, Iterator
from contextlib import suppress

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files import parse_mapping
from hnn_vi_ros.recording import BagReader
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

# ~/scene and the bag hold the remapping under this key.
KEY = 'remapped'
_STRING = 'std_msgs/msg/String'


def remapped(node: Node, topics: Iterable[str]) -> dict[str, str]:
    """
    Return what topics of a node are called, by their full names, where these are others.

    Parameters
    ----------
    node : Node
        That was given rules of remapping, or none.
    topics : iterable of str
        Names in its code, such as ``'~/state'``.

    """
    names = {expand_topic_name(topic, node.get_name(), node.get_namespace()):
             node.resolve_topic_name(topic) for topic in topics}
    return {own: called for own, called in names.items() if own != called}


def own_topics(reader: BagReader) -> dict[str, int]:
    """
    Return the channels of a bag by their topics; one that was remapped by its own name as well.

    Parameters
    ----------
    reader : BagReader
        Of a bag of the simulator, or of another recorder that holds ~/scene.

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
    """Yield the texts that may be scenes: that of the bag, else the first of each such topic."""
    if (kept := reader.attachment('scene.yaml')) is not None:
        yield kept
        return
    for topic, number in topics.items():
        schema = reader.schemas.get(reader.channels[number].schema_id)
        if topic.endswith('/scene') and schema is not None and schema.name == _STRING:
            for message in reader.messages([number]):
                # One that is none of this type is reported where it is needed.
                with suppress(RuntimeError):
                    yield deserialize_message(message.data, String).data
                break
