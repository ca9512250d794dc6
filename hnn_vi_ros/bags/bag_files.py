# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Files of a bag, MCAP or SQLite, and how each is opened."""

from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from itertools import pairwise
import os
from pathlib import Path
import re
import shutil
import sqlite3
import tempfile
from typing import final
import weakref

from hnn_vi_ros.bags.bag_metadata import read_bag_metadata
from hnn_vi_ros.bags.bag_source import Piece, Source
from hnn_vi_ros.bags.mcap_file import McapFile
from hnn_vi_ros.bags.mcap_records import LARGEST
from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files.regular_file import open_file
from mcap.records import Channel, Message, Schema
import zstandard

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
            rows = self._taken(database.execute(
                'SELECT topic_id, timestamp, CAST(data AS BLOB) FROM messages '
                f'WHERE rowid BETWEEN ? AND ? AND {_STAMPED} ORDER BY rowid',
                (piece.start, piece.start + piece.length - 1)))
        messages = [Message(topic, time, data or b'', time, 0) for topic, time, data in rows
                    if topic in self.channels]
        if len(messages) < len(rows):
            self.unread[piece.start] = sum(
                len(data or b'') for topic, _, data in rows if topic not in self.channels)
        return messages

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


_SUFFIXES = ('.mcap', '.db3', '.mcap.zstd', '.db3.zstd')
_PACKED = '.zstd'
_BLOCK = 2**18
# rosbag2 numbers the files of a bag, since Lyrical before the name, which the time of each ends.
_NUMBERED = re.compile(
    r'(?P<first>\d+)_(?P<name>.*)_\d{4}_\d\d_\d\d-\d\d_\d\d_\d\d\.|(?P<prefix>.*)_(?P<last>\d+)\.')


def bag_files(bag: Path) -> list[Path]:
    """
    Return the files of a bag, in their order: those that metadata.yaml names, or the folder's.

    Parameters
    ----------
    bag : Path
        A folder, or a file, which is then the only one.

    Raises
    ------
    RecordingError
        A folder without a bag, with several, or with a part of one.

    """
    # Opening the path reports why it cannot be a bag.
    if not os.path.isdir(bag):
        return [bag]
    files = sorted(path for path in bag.iterdir() if path.name.endswith(_SUFFIXES))
    named = read_bag_metadata(bag).get('relative_file_paths')
    # No path of it leads out of the folder.
    names = list(dict.fromkeys(Path(str(name)).name for name in named)) \
        if isinstance(named, list) else []
    absent = [name for name in names if bag / name not in files]
    if names and not absent:
        return [bag / name for name in names]
    if len(files) == 1 and len(names) < 2:
        return files
    if names:
        raise RecordingError(f'{bag}: its metadata.yaml names {absent[0]!r}, which is no file of '
                             'a bag there; put it back, or give a file')
    return _numbered(bag, files)


def _numbered(bag: Path, files: list[Path]) -> list[Path]:
    """Return the files of one bag in the order of their numbers."""
    found = {path: match for path in files if (match := _NUMBERED.match(path.name))}
    numbers = {path: int(match['first'] or match['last']) for path, match in found.items()}
    if not files or len(found) < len(files) or len(set(numbers.values())) < len(files) \
            or len({match.group('name', 'prefix') for match in found.values()}) > 1:
        what = f'{len(files)} files; give one of them' if files else f'none{_nearest(bag)}'
        raise RecordingError(f'{bag}: expected a folder with one bag (.mcap or .db3), found '
                             f'{what}')
    files.sort(key=numbers.__getitem__)
    # The first ones may have been deleted, as recorders do that keep the newest.
    for before, after in pairwise(files):
        if numbers[after] != numbers[before] + 1:
            raise RecordingError(f'{bag}: none of its files is number {numbers[before] + 1}, '
                                 f'between {before.name} and {after.name}; put it back, or give '
                                 'a file')
    return files


def _nearest(folder: Path) -> str:
    """Return which folder in this one may have been meant: a run has its bags in folders."""
    bags = sorted(path.parent for suffix in _SUFFIXES for path in folder.glob(f'*/*{suffix}'))
    return f'; did you mean {bags[0]}?' if bags else ''


def open_source(path: Path) -> Source:
    """
    Return a file of a bag; a packed one stays unpacked while in use.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    RecordingError
        It is no file of a bag, or too large when unpacked.
    OSError
        It cannot be read.

    """
    if not path.name.endswith(_PACKED):
        return _source(path, path)
    scratch = Path(tempfile.mkdtemp(prefix='hnn_vi_ros-'))
    try:
        source = _source(_unpacked(path, scratch), path)
    except BaseException:
        shutil.rmtree(scratch)
        raise
    weakref.finalize(source, shutil.rmtree, scratch, ignore_errors=True)
    return source


def _source(path: Path, name: Path) -> Source:
    return (SqliteFile if path.suffix == '.db3' else McapFile)(path, name)


def _unpacked(path: Path, scratch: Path) -> Path:
    """Unpack a file, never more of it than a chunk may hold."""
    target = scratch / path.name.removesuffix(_PACKED)
    left = LARGEST
    try:
        with open_file(path, path) as stream, target.open('wb') as unpacked:
            reader = zstandard.ZstdDecompressor().stream_reader(stream, read_across_frames=True)
            while left >= 0 and (block := reader.read(_BLOCK)):
                unpacked.write(block)
                left -= len(block)
    except zstandard.ZstdError as problem:
        raise RecordingError(f'{path}: cannot be unpacked ({problem}); give another bag') \
            from problem
    if left < 0:
        raise RecordingError(f'{path}: unpacks to more than {LARGEST >> 20} MiB; unpack it with '
                             f'`zstd -d {path}`, and give what comes out')
    return target
