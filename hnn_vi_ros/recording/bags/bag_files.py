# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Files of a bag: MCAP files are read here, SQLite and compressed ones by rosbags."""

from collections.abc import Iterable, Iterator
import os
from pathlib import Path
from typing import Any, final

from hnn_vi_ros.errors import optional, RecordingError
from hnn_vi_ros.files import dump_yaml, regular
from hnn_vi_ros.recording.bags.bag_metadata import read_bag_metadata
from hnn_vi_ros.recording.bags.mcap_file import McapFile, Piece
from mcap.records import Channel, Message, Schema

_SUFFIXES = ('.mcap', '.db3', '.mcap.zstd', '.db3.zstd')
# Number of messages requested from rosbags at once.
_REQUESTED_MESSAGES = 4096


@final
class ForeignBag:
    """
    A bag in another format than MCAP, or with compressed files, read by rosbags.

    It has the attributes of McapFile, but neither attachments nor metadata.

    Parameters
    ----------
    bag : Path
        Folder with metadata.yaml, or a file.
    files : list of Path
        Files of the bag.

    Raises
    ------
    RecordingError
        The bag cannot be read.
    MissingPackage
        The package rosbags is not installed.

    """

    def __init__(self, bag: Path, files: list[Path]):
        with optional('rosbags', f'{bag}: a bag in SQLite or with compressed files'):
            from rosbags.rosbag2 import Reader
        self.path = files[0] if len(files) == 1 else bag
        self.unread: dict[int, int] = {}
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        for path in files:
            regular(path)
        try:
            # Closed at exit: until then, compressed files lie decompressed in a temporary folder.
            described = (bag / 'metadata.yaml').exists()
            self._reader = Reader(bag if described else files[0])
            self._reader.open()
            self._connections = list(self._reader.connections)
            for number, one in enumerate(self._connections, 1):
                about: Any = one.ext
                if not (one.topic and one.msgtype):
                    raise ValueError('a topic has no name or no type')
                self.schemas[number] = Schema(
                    id=number, data=one.msgdef.data.encode(), encoding='ros2msg', name=one.msgtype)
                self.channels[number] = Channel(
                    id=number, topic=one.topic, message_encoding=about.serialization_format,
                    schema_id=number, metadata={
                        'offered_qos_profiles': _profiles(about.offered_qos_profiles),
                        'topic_type_hash': one.digest or ''})
            first, last = self._reader.start_time, self._reader.end_time - 1
            self.message_count = sum(one.msgcount for one in self._connections)
            self.counted = self._reader.message_count
        except Exception as problem:
            # The parsers of rosbags may raise any exception.
            raise _unreadable(self.path, problem) from problem
        parts = -(-self.message_count // _REQUESTED_MESSAGES)
        length = -(-(last + 1 - first) // parts) if parts else 0
        self.pieces = [Piece(begin, min(begin + length - 1, last), begin, length)
                       for begin in range(first, last + 1, length)] if parts else []

    def read(self, piece: Piece) -> Iterator[Message]:
        """Yield the messages of a piece."""
        numbers = {(one.topic, one.msgtype): number
                   for number, one in enumerate(self._connections, 1)}
        try:
            for one, time, data in self._reader.messages(
                    self._connections, piece.first, piece.last + 1):
                yield Message(channel_id=numbers[one.topic, one.msgtype], log_time=time,
                              data=bytes(data or b''), publish_time=time, sequence=0)
        except Exception as problem:
            raise _unreadable(self.path, problem) from problem

    def attachment(self, name: str) -> bytes | None:
        """Return None: there are no attachments."""
        return None

    def metadata(self, name: str) -> dict[str, str]:
        """Return an empty dict: there is no metadata."""
        return {}


def _unreadable(bag: Path, problem: Exception) -> RecordingError:
    reason = ' '.join(str(problem).split()) or type(problem).__name__
    return RecordingError(f'{bag}: cannot be read ({reason}); convert it to MCAP with '
                          '`ros2 bag convert`, or give another bag')


def _profiles(profiles: Iterable[Any]) -> str:
    """Return QoS profiles in the form of the metadata, with the parts that replay uses."""
    return dump_yaml([{'history': one.history.name.lower(), 'depth': one.depth,
                       'reliability': one.reliability.name.lower(),
                       'durability': one.durability.name.lower()} for one in profiles])


def bag_files(bag: Path) -> list[Path]:
    """
    Return the files of a bag in order.

    Parameters
    ----------
    bag : Path
        Folder of the bag, or one file.

    Raises
    ------
    RecordingError
        The folder contains no bag, or several files that no metadata.yaml joins to one bag.

    """
    # Opening the path reports the reason.
    if not os.path.isdir(bag):
        return [bag]
    files = sorted(path for path in bag.iterdir() if path.name.endswith(_SUFFIXES))
    named = read_bag_metadata(bag).get('relative_file_paths')
    # Only the file names are used, so no path leads out of the folder.
    names = list(dict.fromkeys(Path(str(name)).name for name in named)) \
        if isinstance(named, list) else []
    absent = [name for name in names if bag / name not in files]
    if names and not absent:
        return [bag / name for name in names]
    if len(files) == 1 and len(names) < 2:
        return files
    if names:
        raise RecordingError(f'{bag}: its metadata.yaml names {absent[0]!r}, which is not a bag '
                             'file there; restore it, or give a file')
    what = f'{len(files)} files without a metadata.yaml; give one of them, or write it with ' \
        '`ros2 bag reindex`' if files else f'none{_nearest(bag)}'
    raise RecordingError(f'{bag}: expected a folder with one bag (.mcap or .db3), found {what}')


def _nearest(folder: Path) -> str:
    """Suggest the subfolder that may have been meant: a run has its bags in subfolders."""
    bags = sorted(path.parent for suffix in _SUFFIXES for path in folder.glob(f'*/*{suffix}'))
    return f'; did you mean {bags[0]}?' if bags else ''


def open_sources(bag: Path, files: list[Path]) -> list[McapFile | ForeignBag]:
    """
    Return readers of the files of a bag.

    Raises
    ------
    RecordingError
        A file does not belong to a bag, or is too large when decompressed.
    OSError
        A file cannot be read.

    """
    if all(path.suffix == '.mcap' for path in files) or not any(
            path.name.endswith(_SUFFIXES) for path in files):
        return [McapFile(path) for path in files]
    return [ForeignBag(bag, files)]
