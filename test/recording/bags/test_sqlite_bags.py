# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""SQLite bags whose rows are not what they should be: nothing is left out in silence."""

from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
import sqlite3

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.recording import BagReader
from messages import refused
import pytest

A = (1, '/a', 'std_msgs/msg/String', 'cdr')
Row = tuple[object, object, object, object]


@contextmanager
def database_of(path: Path, topics: Sequence[Row] = (A,)) -> Iterator[sqlite3.Connection]:
    with closing(sqlite3.connect(path)) as database, database:
        database.execute('CREATE TABLE topics (id, name, type, serialization_format)')
        database.executemany('INSERT INTO topics VALUES (?, ?, ?, ?)', topics)
        yield database


def write(path: Path, rows: list[Row], topics: list[Row], number: str) -> BagReader:
    with database_of(path, topics) as database:
        database.execute(f'CREATE TABLE messages (id {number}, topic_id, timestamp, data)')
        database.executemany('INSERT INTO messages VALUES (?, ?, ?, ?)', rows)
    return BagReader(path)


@pytest.mark.parametrize('number, ids', [
    ('INTEGER PRIMARY KEY', [-40, -1, 0, 1, 2**63 - 1]), ('', [1.5, 'x', b'', 7]),
    ('', [1.25 * i for i in range(60)])])
def test_rows_are_read_once_whatever_their_numbers_are(tmp_path, number, ids):
    rows = [(i, 1, time, b'%d' % time) for time, i in enumerate(ids)]
    reader = write(tmp_path / 'a.db3', rows, [A], number)
    assert [(m.time, m.data) for m in reader.messages()] == [
        (time, b'%d' % time) for time in range(len(ids))]
    assert not reader.damage


@pytest.mark.parametrize('topic', [3, None])
def test_row_of_no_topic_is_told(tmp_path, topic):
    reader = write(tmp_path / 'a.db3', [(1, 1, 5, b'yes'), (2, topic, 6, b'no')], [A],
                   'INTEGER PRIMARY KEY')
    assert [message.data for message in reader.messages()] == [b'yes']
    assert 'contains 1 messages' in reader.damage


def test_topic_without_a_name_is_refused(tmp_path):
    with refused(RecordingError):
        write(tmp_path / 'a.db3', [(1, 1, 5, b'yes')],
              [A, (2, None, 'std_msgs/msg/String', 'cdr')], 'INTEGER PRIMARY KEY')
