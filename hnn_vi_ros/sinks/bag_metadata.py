# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Describe a recording in the form of rosbag2: its topics and its metadata.yaml."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import os
from pathlib import Path
from typing import Any, NamedTuple

import yaml

METADATA_VERSION = 9
# rosbag2 gives a bag without messages the latest time there is as its start.
NEVER = 2**63 - 1


@dataclass(frozen=True)
class Topic:
    """
    What a reader must know of a recorded topic to decode it and to publish it again.

    Parameters
    ----------
    name : str
        Fully resolved name, ``'/hnn_simulator/q'``.
    type : str
        Message type, ``'std_msgs/msg/Float64'``.
    definition : str
        Text of the .msg file, followed by those of the types that it uses.
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
    What a bag holds from its start on.

    Parameters
    ----------
    tick : sequence of Topic
        Those of every tick, in the order of its payloads.
    scene : Topic
        That of the scene.

    """

    tick: Sequence[Topic]
    scene: Topic


def bag_metadata(file_name: str, topics: Sequence[Topic], counts: Sequence[int], first: int,
                 last: int, ros_distro: str) -> dict[str, Any]:
    """
    Describe a bag of one file in the fields of rosbag2's metadata, version 9.

    Parameters
    ----------
    file_name : str
        Name of the MCAP file in the bag's folder.
    topics : sequence of Topic
        The recorded topics.
    counts : sequence of int
        Messages of each topic.
    first, last : int
        Earliest and latest log time [ns]; of no account where there is no message.
    ros_distro : str
        ROS distribution of the recording.

    """
    total = sum(counts)
    start, duration = (first, last - first) if total else (NEVER, 0)
    extent = {'duration': {'nanoseconds': duration},
              'starting_time': {'nanoseconds_since_epoch': start}, 'message_count': total}
    return {
        'version': METADATA_VERSION, 'storage_identifier': 'mcap', **extent,
        'topics_with_message_count': [
            {'topic_metadata': _topic_metadata(topic), 'message_count': count}
            for topic, count in zip(topics, counts, strict=True)],
        # These two speak of compression around the file; the chunks' own is the file's affair.
        'compression_format': '', 'compression_mode': '',
        'relative_file_paths': [file_name], 'files': [{'path': file_name, **extent}],
        'custom_data': None, 'ros_distro': ros_distro,
    }


def write_bag_metadata(folder: Path, metadata: Mapping[str, Any]) -> None:
    """Write ``metadata.yaml`` into the folder of a bag, whole or not at all."""
    temporary = folder / 'metadata.yaml.tmp'
    text = dump_yaml({'rosbag2_bagfile_information': dict(metadata)})
    temporary.write_text(text, encoding='utf-8')
    os.replace(temporary, folder / 'metadata.yaml')


def _topic_metadata(topic: Topic) -> dict[str, Any]:
    return {'name': topic.name, 'type': topic.type, 'serialization_format': 'cdr',
            'offered_qos_profiles': yaml.safe_load(topic.offered_qos_profiles),
            'type_description_hash': topic.type_hash}


class _Dumper(yaml.SafeDumper):
    """Write a value that occurs twice out twice."""

    def ignore_aliases(self, data: object) -> bool:
        return True


def dump_yaml(data: object) -> str:
    """Return plain data as YAML, keys in their order, no line folded."""
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, width=2**31, allow_unicode=True)
