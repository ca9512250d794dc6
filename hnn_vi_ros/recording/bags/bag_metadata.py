# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Describe a recording in the form of rosbag2: its topics and its metadata.yaml."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import os
from pathlib import Path
from typing import Any, NamedTuple

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files import dump_yaml, open_file, parse_mapping, parse_yaml

METADATA_VERSION = 9
# rosbag2 gives a bag without messages the latest time there is as its start.
NEVER = 2**63 - 1
# No metadata.yaml is larger [bytes].
_LARGEST = 2**20


@dataclass(frozen=True)
class Topic:
    """
    Recorded topic, as a reader must know it to decode it and to publish it again.

    Parameters
    ----------
    name : str
        Fully resolved name, ``'/hnn_simulator/q'``.
    type : str
        Message type, ``'std_msgs/msg/Float64'``.
    definition : str
        Text of the .msg file, then the texts of the types that it uses.
    type_hash : str
        RIHS01 hash of the type.
    offered_qos_profiles : str
        YAML list of the publishers' QoS profiles, in the form of rosbag2.

    """

    name: str
    type: str  # noqa: A003
    definition: str
    type_hash: str
    offered_qos_profiles: str


class BagTopics(NamedTuple):
    """
    Topics that a bag holds from its start on.

    Parameters
    ----------
    tick : sequence of Topic
        Those of every tick, in the order of its payloads.
    scene : Topic
        That of the scene.
    remapped : mapping of str to str
        What topics are called, by their own names, where these are others.

    """

    tick: Sequence[Topic]
    scene: Topic
    remapped: Mapping[str, str] = {}


class Extent(NamedTuple):
    """
    Extent of a file of a bag.

    Parameters
    ----------
    name : str
        In the bag's folder.
    messages : int
        How many.
    first, last : int
        Earliest and latest log time [ns]; meaningless without messages.

    """

    name: str
    messages: int
    first: int
    last: int

    @property
    def fields(self) -> dict[str, Any]:
        """Return what rosbag2 calls it."""
        start, duration = (self.first, self.last - self.first) if self.messages else (NEVER, 0)
        return {'duration': {'nanoseconds': duration},
                'starting_time': {'nanoseconds_since_epoch': start},
                'message_count': self.messages}


def bag_metadata(files: Sequence[Extent], topics: Sequence[Topic], counts: Sequence[int],
                 ros_distro: str) -> dict[str, Any]:
    """
    Describe a bag in the fields of rosbag2's metadata, version 9.

    Parameters
    ----------
    files : sequence of Extent
        In their order.
    topics : sequence of Topic
        The recorded topics.
    counts : sequence of int
        Messages of each topic.
    ros_distro : str
        ROS distribution of the recording.

    """
    held = [file for file in files if file.messages]
    extent = Extent('', sum(file.messages for file in files),
                    min((file.first for file in held), default=NEVER),
                    max((file.last for file in held), default=0)).fields
    return {
        'version': METADATA_VERSION, 'storage_identifier': 'mcap', **extent,
        'topics_with_message_count': [
            {'topic_metadata': {
                'name': topic.name, 'type': topic.type, 'serialization_format': 'cdr',
                'offered_qos_profiles': qos_profiles(topic.offered_qos_profiles),
                'type_description_hash': topic.type_hash}, 'message_count': count}
            for topic, count in zip(topics, counts, strict=True)],
        # These two speak of compression around the file; the chunks' own is the file's affair.
        'compression_format': '', 'compression_mode': '',
        'relative_file_paths': [file.name for file in files],
        'files': [{'path': file.name, **file.fields} for file in files],
        'custom_data': None, 'ros_distro': ros_distro,
    }


def write_bag_metadata(folder: Path, metadata: Mapping[str, Any]) -> None:
    """Write ``metadata.yaml`` into the folder of a bag, whole or not at all."""
    temporary = folder / 'metadata.yaml.tmp'
    text = dump_yaml({'rosbag2_bagfile_information': dict(metadata)})
    temporary.write_text(text, encoding='utf-8')
    os.replace(temporary, folder / 'metadata.yaml')


def qos_profiles(text: str) -> list[Any]:
    """Return the QoS profiles that a channel's metadata lists; none where they are damaged."""
    try:
        profiles, _ = parse_yaml(text or '[]', 'offered_qos_profiles', RecordingError)
    except RecordingError:
        return []
    return profiles if isinstance(profiles, list) else []


def read_bag_metadata(folder: Path) -> dict[str, Any]:
    """Return the content of ``metadata.yaml`` of a bag's folder; empty if that is not there."""
    path = folder / 'metadata.yaml'
    try:
        with open_file(path, path) as stream:
            content = read_description(stream.read(_LARGEST))
    except OSError:
        return {}
    described = content.get('rosbag2_bagfile_information')
    return described if isinstance(described, dict) else {}


def counted_messages(folder: Path, names: Sequence[str]) -> int | None:
    """Return how many messages metadata.yaml counts in files of a bag; None if it does not."""
    described = read_bag_metadata(folder)
    if described.get('relative_file_paths') == list(names):
        counts: list[Any] = [described.get('message_count')]
    else:
        # Some files of several.
        listed = described.get('files')
        entries = {str(entry.get('path')): entry for entry in listed
                   if isinstance(entry, dict)} if isinstance(listed, list) else {}
        counts = [entries.get(name, {}).get('message_count') for name in names]
    return sum(counts) if all(type(count) is int for count in counts) else None


def read_description(text: str | bytes) -> dict[str, Any]:
    """Return rosbag2's description of a bag from its YAML; empty if that is damaged."""
    try:
        return parse_mapping(text, 'the description of the bag', RecordingError)[0]
    except RecordingError:
        return {}
