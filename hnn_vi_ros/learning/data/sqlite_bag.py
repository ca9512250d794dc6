# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Bags in SQLite as data, read with the package rosbags."""

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import final

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files import open_regular
from hnn_vi_ros.recording import digest_of, RecordedMessage
from mcap.records import Channel, Schema


@final
class SqliteBag:
    """
    A bag in SQLite with the attributes of BagReader that signals need.

    Parameters
    ----------
    bag : Path
        Folder of the bag, or its file.
    files : sequence of Path
        Files of the bag.

    Raises
    ------
    RecordingError
        The bag cannot be read, or rosbags is not installed.

    """

    damage = ''

    def __init__(self, bag: Path, files: list[Path]):
        # Imported lazily: an optional package.
        try:
            from rosbags.rosbag2 import Reader
        except ImportError:
            raise RecordingError(
                f'{files[0]}: bags in SQLite need the package rosbags, which is not installed: '
                'pip install rosbags; or convert the bag with `ros2 bag convert`') from None
        self.path, self._files = files[0] if len(files) == 1 else bag, files
        try:
            for file in files:
                open_regular(file).close()
            described = bag.is_dir() and (bag / 'metadata.yaml').exists()
            self._reader = Reader(bag if described else files[0])
            self._reader.open()
        # Each version of rosbags and of its SQLite has errors of its own.
        except Exception as problem:
            raise self._unreadable(problem) from problem
        self.channels, self.schemas = {}, {}
        for one in self._reader.connections:
            self.schemas[one.id] = Schema(
                id=one.id, data=b'', encoding='ros2msg', name=one.msgtype)
            self.channels[one.id] = Channel(
                id=one.id, topic=one.topic, message_encoding='cdr', schema_id=one.id, metadata={})

    def messages(self, channels: Collection[int] | None = None) -> Iterator[RecordedMessage]:
        """Yield the messages of some channels, or of all, in the order of their log times."""
        wanted = [one for one in self._reader.connections
                  if channels is None or one.id in channels]
        try:
            for connection, time, data in self._reader.messages(wanted):
                yield RecordedMessage(time, connection.id, bytes(data))
        except Exception as problem:
            raise self._unreadable(problem) from problem

    def digest(self) -> str:
        """Return the SHA-256 of the files."""
        return digest_of(self._files)

    def attachment(self, name: str) -> None:
        """Return None: there are no attachments."""

    def _unreadable(self, problem: Exception) -> RecordingError:
        reason = ' '.join(str(problem).split()) or type(problem).__name__
        return RecordingError(f'{self.path}: cannot be read ({reason}); convert it to MCAP with '
                              '`ros2 bag convert`, or give another bag')
