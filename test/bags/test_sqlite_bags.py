# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""SQLite bags whose rows are not what they should be: nothing is left out in silence."""

from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
import sqlite3

from hnn_vi_ros.bags import bag_files
from hnn_vi_ros.bags.mcap_reader import BagReader
from hnn_vi_ros.errors import RecordingError
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
    ('INTEGER PRIMARY KEY', [-40, -1, 0, 1, 2**63 - 1]), ('', [None, 1.5, 'x', b'', 7]),
    ('', [1.25 * i for i in range(60)])])
def test_rows_are_read_once_whatever_their_numbers_are(tmp_path, number, ids):
    rows = [(i, 1, time, b'%d' % time) for time, i in enumerate(ids)]
    reader = write(tmp_path / 'a.db3', rows, [A], number)
    assert [(m.time, m.data) for m in reader.messages()] == [
        (time, b'%d' % time) for time in range(len(ids))]
    assert not reader.damage


@pytest.mark.parametrize('row', [
    (2, 1, -5, b'no'), (2, 1, 'noon', b'no'), (2, 1, None, None), (2, 2, 6, b'no'),
    (2, 3, 6, b'no'), (2, None, 6, b'no')])
def test_row_that_cannot_be_read_is_told(tmp_path, row):
    topics = [A, (2, None, 'std_msgs/msg/String', 'cdr'), (None, '/b', None, 'cdr')]
    reader = write(tmp_path / 'a.db3', [(1, 1, 5, b'yes'), row], topics, 'INTEGER PRIMARY KEY')
    assert [message.data for message in reader.messages()] == [b'yes']
    assert '1 damaged parts' in reader.damage


def test_view_in_the_place_of_a_table_is_refused(tmp_path):
    with database_of(tmp_path / 'a.db3') as database:
        database.execute('CREATE VIEW messages AS WITH RECURSIVE c(id) AS (SELECT 1 UNION ALL '
                         'SELECT id + 1 FROM c) SELECT id, 1 AS topic_id, id AS timestamp, '
                         'zeroblob(1000000) AS data FROM c')
    with refused(RecordingError):
        BagReader(tmp_path / 'a.db3')


def test_large_rows_that_a_small_file_computes_are_refused(tmp_path, monkeypatch):
    path = tmp_path / 'a.db3'
    with database_of(path) as database:
        database.execute('CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id, timestamp, '
                         'data AS (zeroblob(1000000)))')
        database.executemany('INSERT INTO messages (id, topic_id, timestamp) VALUES (?, 1, ?)',
                             [(i, i) for i in range(8)])
    assert len(list(BagReader(path).messages())) == 8
    monkeypatch.setattr(bag_files, '_MOST', 7 * 10**6)
    with refused(RecordingError):
        list(BagReader(path).messages())
