# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Describe a recording in the format of rosbag2: its topics and its metadata.yaml."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files import dump_yaml, open_regular, parse_mapping, parse_yaml, write_text

METADATA_VERSION = 9
# Start time that rosbag2 gives to a bag without messages: the latest possible time.
NEVER = 2**63 - 1
# Maximum size of a metadata.yaml [bytes].
_MAX_METADATA_SIZE = 2**20


@dataclass(frozen=True)
class Topic:
    """
    Recorded topic with all that a reader needs to decode and republish it.

    Parameters
    ----------
    name : str
        Fully resolved name, such as ``'/hnn_simulator/q'``.
    type : str
        Message type, such as ``'std_msgs/msg/Float64'``.
    definition : str
        Text of the .msg file, followed by the texts of the types it uses.
    type_hash : str
        RIHS01 hash of the type.
    offered_qos_profiles : str
        YAML list of the publishers' QoS profiles in the format of rosbag2.

    """

    name: str
    type: str  # noqa: A003
    definition: str
    type_hash: str
    offered_qos_profiles: str


class BagTopics(NamedTuple):
    """
    Topics of a bag that exist from its start.

    Parameters
    ----------
    tick : sequence of Topic
        Topics of every tick, in the order of its payloads.
    scene : Topic
        Topic of the scene.
    remapped : mapping of str to str
        New names of remapped topics by original name.
    robot : Topic, optional
        Topic of the URDF.

    """

    tick: Sequence[Topic]
    scene: Topic
    remapped: Mapping[str, str] = {}
    robot: Topic | None = None


class FileExtent(NamedTuple):
    """
    Extent of a file of a bag.

    Parameters
    ----------
    name : str
        Name in the bag's folder.
    messages : int
        Number of messages.
    first, last : int
        Earliest and latest log time [ns]; undefined without messages.

    """

    name: str
    messages: int
    first: int
    last: int

    @property
    def fields(self) -> dict[str, Any]:
        """Return the fields as named by rosbag2."""
        start, duration = (self.first, self.last - self.first) if self.messages else (NEVER, 0)
        return {'duration': {'nanoseconds': duration},
                'starting_time': {'nanoseconds_since_epoch': start},
                'message_count': self.messages}


def bag_metadata(files: Sequence[FileExtent], topics: Sequence[Topic], counts: Sequence[int],
                 ros_distro: str) -> dict[str, Any]:
    """
    Return the fields of rosbag2's metadata, version 9, for a bag.

    Parameters
    ----------
    files : sequence of Extent
        Files in order.
    topics : sequence of Topic
        The recorded topics.
    counts : sequence of int
        Number of messages of each topic.
    ros_distro : str
        ROS distribution of the recording.

    """
    nonempty = [file for file in files if file.messages]
    extent = FileExtent('', sum(file.messages for file in files),
                        min((file.first for file in nonempty), default=NEVER),
                        max((file.last for file in nonempty), default=0)).fields
    return {
        'version': METADATA_VERSION, 'storage_identifier': 'mcap', **extent,
        'topics_with_message_count': [
            {'topic_metadata': {
                'name': topic.name, 'type': topic.type, 'serialization_format': 'cdr',
                'offered_qos_profiles': qos_profiles(topic.offered_qos_profiles),
                'type_description_hash': topic.type_hash}, 'message_count': count}
            for topic, count in zip(topics, counts, strict=True)],
        # These two describe compression of the whole file, not that of its chunks.
        'compression_format': '', 'compression_mode': '',
        'relative_file_paths': [file.name for file in files],
        'files': [{'path': file.name, **file.fields} for file in files],
        'custom_data': None, 'ros_distro': ros_distro,
    }


def write_bag_metadata(folder: Path, metadata: Mapping[str, Any]) -> None:
    """Write ``metadata.yaml`` to the folder of a bag atomically."""
    write_text(folder / 'metadata.yaml', dump_yaml({
        'rosbag2_bagfile_information': dict(metadata)}))


def qos_profiles(text: str) -> list[Any]:
    """Return the QoS profiles in a channel's metadata; an empty list if they are damaged."""
    try:
        profiles, _ = parse_yaml(text or '[]', 'offered_qos_profiles', RecordingError)
    except RecordingError:
        return []
    return profiles if isinstance(profiles, list) else []


def read_bag_metadata(folder: Path) -> dict[str, Any]:
    """Return the content of ``metadata.yaml`` in a bag's folder; empty if the file is missing."""
    path = folder / 'metadata.yaml'
    try:
        with open_regular(path) as stream:
            content = read_description(stream.read(_MAX_METADATA_SIZE))
    except OSError:
        return {}
    described = content.get('rosbag2_bagfile_information')
    return described if isinstance(described, dict) else {}


def metadata_message_count(folder: Path, names: Sequence[str]) -> int | None:
    """Return the number of messages that metadata.yaml counts in files; None if unknown."""
    described = read_bag_metadata(folder)
    if described.get('relative_file_paths') == list(names):
        counts: list[Any] = [described.get('message_count')]
    else:
        # Only some of several files.
        listed = described.get('files')
        entries = {str(entry.get('path')): entry for entry in listed
                   if isinstance(entry, dict)} if isinstance(listed, list) else {}
        counts = [entries.get(name, {}).get('message_count') for name in names]
    return sum(counts) if all(type(count) is int for count in counts) else None


def read_description(text: str | bytes) -> dict[str, Any]:
    """Return rosbag2's description of a bag from YAML; empty if it is damaged."""
    try:
        return parse_mapping(text, 'the description of the bag', RecordingError)[0]
    except RecordingError:
        return {}
