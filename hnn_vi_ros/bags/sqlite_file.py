# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The messages of an SQLite file, as rosbag2 records them without MCAP."""

from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
import sqlite3
from typing import final

from hnn_vi_ros.bags.bag_source import Piece, Source
from hnn_vi_ros.bags.mcap_records import LARGEST
from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files.regular_file import open_file
from mcap.records import Channel, Message, Schema

# Rows that are read together, as a power of two, and how much they may hold [bytes].
_SHIFT = 4
_MOST = 2**30
# Only such rows count as stamped messages.
_STAMPED = "typeof(timestamp) = 'integer' AND timestamp >= 0"


@final
class SqliteFile(Source):
    """
    An SQLite file of a bag; it holds neither attachments nor metadata.

    Raises
    ------
    RecordingError
        It is no such file, or damaged in its structure.
    OSError
        It cannot be read.

    """

    def __init__(self, path: Path, name: Path):
        super().__init__(path, name)
        open_file(path, name).close()
        with self._open() as database:
            tables = {row[0] for row in database.execute(
                "SELECT name FROM sqlite_master WHERE type = 'table'")}
            if not {'topics', 'messages'} <= tables:
                raise RecordingError(f'{name}: no bag: it has no tables topics and messages')
            columns = {row[1] for row in database.execute('PRAGMA table_info(topics)')}
            self._add_topics(database, columns)
            # The query avoids the column id, which a file may declare as anything.
            self.pieces = [
                Piece(first, last, rows << _SHIFT, 1 << _SHIFT)
                for rows, first, last in database.execute(
                    f'SELECT rowid >> {_SHIFT}, min(timestamp), max(timestamp) FROM messages '
                    f'WHERE {_STAMPED} GROUP BY 1 ORDER BY 1')]
            self.unread.update(database.execute(
                'SELECT min(rowid), coalesce(sum(length(CAST(data AS BLOB))), 0) '
                f'FROM messages WHERE NOT ({_STAMPED}) HAVING count(*) > 0'))
            self.held, = database.execute('SELECT count(*) FROM messages').fetchone()

    def read(self, piece: Piece) -> list[Message]:
        """See Source."""
        with self._open() as database:
            rows = database.execute(
                'SELECT topic_id, timestamp, CAST(data AS BLOB) FROM messages '
                f'WHERE rowid BETWEEN ? AND ? AND {_STAMPED} ORDER BY rowid',
                (piece.start, piece.start + piece.length - 1))
            rows = self._taken(rows)
        messages = [Message(topic, time, data or b'', time, 0) for topic, time, data in rows
                    if topic in self.channels]
        if len(messages) < len(rows):
            self.unread[piece.start] = sum(
                len(data or b'') for topic, _, data in rows if topic not in self.channels)
        return messages

    def attachment(self, name: str) -> bytes | None:
        """See Source."""
        return None

    def metadata(self, name: str) -> dict[str, str]:
        """See Source."""
        return {}

    def _taken(self, rows: Iterable[tuple[int, int, bytes]]) -> list[tuple[int, int, bytes]]:
        """Return rows within a limit: a file of any size may hold what computes large ones."""
        taken, size = [], 0
        for row in rows:
            size += len(row[2] or b'')
            if size > _MOST:
                raise RecordingError(f'{self.name}: {1 << _SHIFT} messages hold more than '
                                     f'{_MOST >> 20} MiB; give another bag')
            taken.append(row)
        return taken

    def _add_topics(self, database: sqlite3.Connection, columns: set[str]) -> None:
        # What older versions of rosbag2 do not write.
        qos = 'CAST(offered_qos_profiles AS TEXT)' if 'offered_qos_profiles' in columns else "''"
        digest = 'CAST(type_description_hash AS TEXT)' if 'type_description_hash' in columns \
            else "''"
        for number, topic, kind, encoding, profiles, hashed in database.execute(
                f'SELECT id, CAST(name AS TEXT), CAST(type AS TEXT), '
                f'CAST(serialization_format AS TEXT), {qos}, {digest} FROM topics '
                "WHERE typeof(id) = 'integer' AND name IS NOT NULL AND type IS NOT NULL"):
            self.schemas[number] = Schema(id=number, data=b'', encoding='ros2msg', name=kind)
            self.channels[number] = Channel(
                id=number, topic=topic, message_encoding=encoding, schema_id=number, metadata={
                    'offered_qos_profiles': profiles or '', 'topic_type_hash': hashed or ''})

    @contextmanager
    def _open(self) -> Iterator[sqlite3.Connection]:
        """Open the file for reading; what is in it may neither grow nor call anything."""
        address = f'{self.path.absolute().as_uri()}?mode=ro'
        try:
            with closing(sqlite3.connect(address, uri=True)) as database:
                database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST)
                database.execute('PRAGMA trusted_schema = OFF')
                yield database
        except sqlite3.Error as problem:
            raise RecordingError(
                f'{self.name}: cannot be read ({problem}); mend it with `sqlite3 .recover`, or '
                'give another bag') from problem
