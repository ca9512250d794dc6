# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Read a bag in SQLite, in the tables of rosbag2 since its first version.

Only plain tables are read: a view, a virtual table or a generated column is a program, which may
not end.
"""

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import re
import sqlite3
from typing import final
from urllib.parse import quote

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files import open_regular
from hnn_vi_ros.recording.bags.mcap_file import MAX_RECORD_SIZE, MessagePart, UnpackLimit
from mcap.records import Channel, Message, Schema

# Number of messages of a piece.
_PIECE_LENGTH = 4096
_PLAIN = re.compile('CREATE (TABLE|INDEX|UNIQUE INDEX) ')
_COUNTS = """
SELECT count(*), total(typeof(timestamp) = 'integer' AND topic_id IN (SELECT id FROM topics)),
min(timestamp), max(timestamp) FROM messages"""
_MESSAGES = """
SELECT topic_id, timestamp, data FROM messages WHERE timestamp BETWEEN ? AND ?
AND topic_id IN (SELECT id FROM topics)"""


@final
class SqliteBag:
    """
    A bag in SQLite.

    It has the attributes of McapFile, but neither attachments nor metadata.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    RecordingError
        The file is not a bag in SQLite, or contains more than plain tables.
    OSError
        The file cannot be read.

    """

    def __init__(self, path: Path):
        self.path = path
        self.unread: dict[int, int] = {}
        self.altered = False  # it has no checksums
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.pieces: list[MessagePart] = []
        self._numbers: dict[object, int] = {}
        with open_regular(path) as stream:
            self._allowance = UnpackLimit(path, os.fstat(stream.fileno()).st_size)
        with self._plain_errors():
            # Read by another thread than the opening one; without a journal of others.
            self._database = sqlite3.connect(
                f'file:{quote(str(path.absolute()))}?mode=ro&immutable=1', uri=True,
                check_same_thread=False)
            self._database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_RECORD_SIZE)
            columns = {name: self._columns(name, sql) for name, sql in self._database.execute(
                'SELECT name, sql FROM sqlite_schema WHERE sql IS NOT NULL')}
            self._read_topics(columns)
            self.counted, count, first, last = self._database.execute(_COUNTS).fetchone()
            self.message_count = int(count)
            if not self.message_count:
                return
            if not (type(first) is type(last) is int and first >= 0):
                raise ValueError('a time of a message is not a number of nanoseconds')
            # Without an index each piece would be searched in the whole table.
            indexed = self._database.execute('PRAGMA index_list(messages)').fetchone()
            length = -(-(last + 1 - first) * _PIECE_LENGTH // max(
                self.message_count, _PIECE_LENGTH)) if indexed else last + 1 - first
            self.pieces = [MessagePart(begin, min(begin + length - 1, last), begin, length)
                           for begin in range(first, last + 1, length)]

    def _columns(self, name: str, sql: str) -> set[str]:
        """Return the columns of a table; raise ValueError if it is not plain."""
        if _PLAIN.match(sql):
            found = self._database.execute(
                'SELECT name, hidden FROM pragma_table_xinfo(?)', [name]).fetchall()
            if not any(hidden for _, hidden in found):
                return {column for column, _ in found}
        raise ValueError(f'{name[:80]!r} is not a table of stored values')

    def _read_topics(self, columns: dict[str, set[str]]) -> None:
        definitions = {}
        if 'message_definitions' in columns:
            definitions = dict(self._database.execute(
                'SELECT topic_type, encoded_message_definition FROM message_definitions'))
        more = [name if name in columns.get('topics', ()) else "''"
                for name in ('offered_qos_profiles', 'type_description_hash')]
        for number, (key, *texts) in enumerate(self._database.execute(
                f'SELECT id, name, type, serialization_format, {", ".join(more)} FROM topics '
                'ORDER BY id'), 1):
            if not all(isinstance(text, str) for text in texts) or not (texts[0] and texts[1]):
                raise ValueError('a topic has no name or no type')
            topic, kind, encoding, profiles, digest = texts
            self._numbers[key] = number
            self.schemas[number] = Schema(
                id=number, data=str(definitions.get(kind) or '').encode(), encoding='ros2msg',
                name=kind)
            self.channels[number] = Channel(
                id=number, topic=topic, message_encoding=encoding, schema_id=number, metadata={
                    'offered_qos_profiles': profiles, 'topic_type_hash': digest})

    def read(self, piece: MessagePart) -> Iterator[Message]:
        """Yield the messages of a piece."""
        size = 0
        with self._plain_errors():
            for topic, time, data in self._database.execute(_MESSAGES, (piece.first, piece.last)):
                # Rows may share the pages of their data.
                size += len(data or b'')
                self._allowance.spend(piece.first, size)
                if type(time) is not int or not isinstance(data, bytes | None):
                    raise ValueError('a message has no data, or no time')
                yield Message(channel_id=self._numbers[topic], log_time=time, data=data or b'',
                              publish_time=time, sequence=0)

    @contextmanager
    def _plain_errors(self) -> Iterator[None]:
        try:
            yield
        except (sqlite3.Error, ValueError, TypeError, OverflowError) as problem:
            reason = ' '.join(str(problem).split()) or type(problem).__name__
            raise RecordingError(f'{self.path}: cannot be read ({reason}); convert it to MCAP '
                                 'with `ros2 bag convert`, or give another bag') from problem

    def attachment(self, name: str) -> bytes | None:
        """Return None: there are no attachments."""
        return None

    def metadata(self, name: str) -> dict[str, str]:
        """Return an empty dict: there is no metadata."""
        return {}
