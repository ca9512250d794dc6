# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""SQLite bags whose rows are not what they should be: none is omitted in silence, none is code."""

from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
import os
from pathlib import Path
import sqlite3

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.recording import BagReader
from messages import refused
import pytest
import zstandard

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


ENDLESS = 'WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i'
MESSAGES = 'CREATE TABLE messages (id, topic_id, timestamp, data'


@pytest.mark.parametrize('statements', [
    [f'CREATE VIEW messages AS {ENDLESS} AS id, 1 AS topic_id, i AS timestamp, 0 AS data FROM n'],
    [f'{MESSAGES})', f'CREATE VIEW message_definitions AS {ENDLESS} AS topic_type, 0 AS '
     'encoded_message_definition FROM n'],
    [f'{MESSAGES} AS (instr(zeroblob(1 << 28), zeroblob(1 << 27))))'],
    ['CREATE VIRTUAL TABLE messages USING fts5(id, topic_id, timestamp, data)'],
], ids=['view', 'view of definitions', 'generated', 'virtual'])
def test_table_whose_rows_are_computed_is_refused(tmp_path, statements):
    with database_of(tmp_path / 'a.db3') as database:
        for statement in statements:
            database.execute(statement)
    with refused(RecordingError):
        BagReader(tmp_path / 'a.db3')


@pytest.mark.parametrize('time', [-1, 'noon', b'', 1.5])
def test_time_that_is_no_time_is_refused(tmp_path, time):
    with refused(RecordingError):
        list(write(tmp_path / 'a.db3', [(1, 1, 5, b'a'), (2, 1, time, b'b'), (3, 1, 6, b'c')],
                   [A], '').messages())


def test_rows_that_hold_more_than_the_file_are_refused(tmp_path):
    # Rows from before a column was added share its default.
    with database_of(tmp_path / 'a.db3') as database:
        database.execute('CREATE TABLE messages (id, topic_id, timestamp)')
        database.executemany('INSERT INTO messages VALUES (?, 1, ?)', [(i, i) for i in range(999)])
        database.execute(f"ALTER TABLE messages ADD data DEFAULT x'{bytes(2**18).hex()}'")
    with refused(RecordingError):
        list(BagReader(tmp_path / 'a.db3').messages())


@pytest.mark.parametrize('kind', ['fifo', 'endless', 'large'])
def test_description_that_is_no_small_file_is_not_waited_for(tmp_path, kind):
    write(tmp_path / 'a.db3', [(1, 1, 5, b'a')], [A], '')
    path = tmp_path / 'metadata.yaml'
    if kind == 'fifo':
        os.mkfifo(path)
    elif kind == 'endless':
        path.symlink_to('/dev/zero')
    else:
        path.write_bytes(b' ' * 2**24)
    assert [message.data for message in BagReader(tmp_path).messages()] == [b'a']


def test_packed_message_of_a_sqlite_bag_is_not_unpacked_beyond_the_limit(tmp_path):
    packer = zstandard.ZstdCompressor(level=1).compressobj()
    block = bytes(2**20)
    packed = b''.join([*(packer.compress(block) for _ in range(300)), packer.flush()])
    reader = write(tmp_path / 'a.db3', [(1, 1, 5, packed), (2, 1, 6, zstandard.compress(b'a'))],
                   [A], '')
    with refused(RecordingError):
        list(reader.messages())
