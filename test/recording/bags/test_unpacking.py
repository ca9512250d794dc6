# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Packed content that lies about its size: no more is unpacked than is declared, or allowed."""

from pathlib import Path
import struct

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.recording import BagReader
from hnn_vi_ros.recording.bags import mcap_reader
from hnn_vi_ros.recording.bags.mcap_file import _unpack, MAX_RECORD_SIZE, UnpackLimit
from hnn_vi_ros.recording.bags.mcap_recovery import recover
import lz4.frame
from mcap.data_stream import RecordBuilder
from mcap.records import (
    Attachment, Channel, Chunk, Header, Message, Metadata, Schema)
from mcap.writer import MCAP0_MAGIC
from messages import refused
import pytest
from python_process import run_code
import zstandard

PACKERS = {'zstd': zstandard.compress, 'lz4': lz4.frame.compress, '': bytes}


def records(count: int = 50) -> bytes:
    builder = RecordBuilder()
    Schema(id=1, name='std_msgs/msg/String', encoding='ros2msg', data=b'').write(builder)
    Channel(id=1, topic='/a', message_encoding='cdr', schema_id=1, metadata={}).write(builder)
    for i in range(count):
        data = b'%d' % i
        Message(channel_id=1, log_time=i, publish_time=i, sequence=i, data=data).write(builder)
    return builder.end()


def begun() -> RecordBuilder:
    builder = RecordBuilder()
    builder.write(MCAP0_MAGIC)
    Header('ros2', '').write(builder)
    return builder


def write_chunk(path: Path, compression: str, data: bytes, size: int) -> Path:
    """Write a file with a chunk that declares this size, and with a good one behind it."""
    builder = begun()
    Chunk(compression=compression, data=data, message_start_time=0, message_end_time=49,
          uncompressed_crc=0, uncompressed_size=size).write(builder)
    good = records()
    Chunk(compression='', data=good, message_start_time=0, message_end_time=49,
          uncompressed_crc=0, uncompressed_size=len(good)).write(builder)
    path.write_bytes(builder.end())
    return path


def zeros(size: int) -> bytes:
    """Return a zstd frame, some kilobytes, of so many zeros; its header tells no size."""
    packer = zstandard.ZstdCompressor(level=1).compressobj()
    block, packed = bytes(2**20), b''
    for _ in range(size // len(block)):
        packed += packer.compress(block)
    return packed + packer.flush()


@pytest.mark.parametrize('compression', PACKERS)
@pytest.mark.parametrize('difference', [-1, 1, -1000, 10**6])
def test_chunk_that_lies_about_its_size_is_damaged_and_the_next_is_read(
        tmp_path, compression, difference):
    data = records()
    path = write_chunk(tmp_path / 'a.mcap', compression, PACKERS[compression](data),
                       len(data) + difference)
    reader = BagReader(path)
    assert [int(message.data) for message in reader.messages()] == list(range(50))
    assert '1 damaged parts' in reader.damage
    assert recover(path).damaged == 1


@pytest.mark.parametrize('compression', PACKERS)
def test_no_more_is_unpacked_than_a_chunk_declares_or_256_mebibytes(monkeypatch, compression):
    unpacked = []
    monkeypatch.setattr('hnn_vi_ros.recording.bags.mcap_file.unpack_zstd',
                        lambda data, most: unpacked.append(most) or b'')
    data = records()
    assert MAX_RECORD_SIZE == 256 * 2**20
    for size in (10, MAX_RECORD_SIZE, MAX_RECORD_SIZE + 1, 2**60):
        content = struct.pack('<QQQII', 0, 9, size, 0, len(compression)) + compression.encode() \
            + struct.pack('<Q', len(data)) + PACKERS[compression](data)
        assert _unpack(content, lambda size: None) is None
    assert unpacked == ([11, MAX_RECORD_SIZE + 1] if compression == 'zstd' else [])


BOMB = """
import resource, sys
from pathlib import Path
from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.recording.bags.mcap_reader import BagReader
from hnn_vi_ros.recording.bags.mcap_recovery import recover
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for use in (lambda path: list(BagReader(path).messages()), recover):
    try:
        use(Path(sys.argv[1]))
    except RecordingError as problem:
        print(problem)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


def memory_of(path: Path) -> float:
    """Return by how much a process grows that reads a bag, and recovers it [MiB]."""
    return int(run_code(BOMB, path, check=True).stdout.splitlines()[-1]) / 2**10


@pytest.mark.parametrize('declared', [100, pytest.param(2**62, marks=pytest.mark.long)])
def test_chunk_of_two_gibibytes_of_zeros_costs_no_memory(tmp_path, declared):
    path = write_chunk(tmp_path / 'a.mcap', 'zstd', zeros(2**31), declared)
    assert path.stat().st_size < 2**20
    assert memory_of(path) < 50


def write_bomb(path: Path, of_messages: bool) -> Path:
    """Write an intact file of some kilobytes, of which each record unpacks to 50 MiB."""
    builder = begun()
    builder.write(records(0))
    for i in range(2):
        if of_messages:
            Message(channel_id=1, log_time=i, publish_time=i, sequence=i,
                    data=zeros(50 * 2**20)).write(builder)
        else:
            one = struct.pack('<BQHIQQ', 0x05, 22, 1, 0, i, i)
            data = one * (50 * 2**20 // len(one))
            Chunk(compression='zstd', data=zstandard.compress(data), message_start_time=i,
                  message_end_time=i, uncompressed_crc=0, uncompressed_size=len(data)
                  ).write(builder)
    path.write_bytes(builder.end())
    return path


@pytest.mark.parametrize('of_messages', [False, True])
def test_file_that_unpacks_to_more_than_its_allowance_is_refused(tmp_path, of_messages):
    path = write_bomb(tmp_path / 'a.mcap', of_messages)
    # The allowance is 64 MiB and 128 times the size, of which two records of 50 MiB have more.
    assert 128 * path.stat().st_size < 36 * 2**20
    with refused(RecordingError):
        list(BagReader(path).messages())


def test_parts_that_are_read_again_are_not_counted_again(tmp_path):
    allowance = UnpackLimit(tmp_path / 'a.mcap', 0)
    for _ in range(9):
        allowance.spend(0, 2**25)
        allowance.spend(1, 2**25)
    with refused(RecordingError):
        allowance.spend(2, 1)


def test_packed_bag_is_decompressed_only_up_to_its_allowance(tmp_path, monkeypatch):
    folder = tmp_path / 'unpacked'
    folder.mkdir()
    monkeypatch.setattr('tempfile.tempdir', str(folder))
    most, spend = [], UnpackLimit.spend
    monkeypatch.setattr(UnpackLimit, 'spend',
                        lambda *words: most.append(words[-1]) or spend(*words))
    path = tmp_path / 'a.mcap.zstd'
    path.write_bytes(zeros(2**27))
    with refused(RecordingError):
        BagReader(path)
    # It is read in blocks of 1 MiB; its own size is some kilobytes.
    assert 2**26 < max(most) <= 2**26 + 128 * path.stat().st_size + 2**20
    assert not list(folder.iterdir())


@pytest.mark.parametrize('kind', ['metadata', 'attachments'])
def test_file_of_very_many_metadata_records_or_attachments_is_refused(tmp_path, kind):
    builder = begun()
    one = Metadata('', {}) if kind == 'metadata' else Attachment(
        create_time=0, log_time=0, name='', media_type='', data=b'')
    for _ in range(2**14 + 1):
        one.write(builder)
    path = tmp_path / 'a.mcap'
    path.write_bytes(builder.end())
    with refused(RecordingError):
        BagReader(path)


@pytest.mark.parametrize('length', range(6))
def test_message_index_that_is_too_short_is_damage(tmp_path, length):
    builder = begun()
    builder.write(records(3) + struct.pack('<BQ', 0x07, length) + bytes(length))
    path = tmp_path / 'a.mcap'
    path.write_bytes(builder.end())
    reader = BagReader(path)
    assert len(list(reader.messages())) == 3
    assert '1 damaged parts' in reader.damage


def test_packed_messages_are_unpacked_only_until_they_are_too_large_together(
        tmp_path, monkeypatch):
    data = records(0) + b''.join(
        struct.pack('<BQHIQQ', 0x05, 22 + len(packed), 1, 0, i, i) + packed
        for packed in [zstandard.compress(bytes(2**20))] for i in range(100))
    path = write_chunk(tmp_path / 'a.mcap', 'zstd', zstandard.compress(data), len(data))
    monkeypatch.setattr(mcap_reader, '_MAX_BUFFERED', 2**22)
    unpack_message, unpacked = mcap_reader._unpack_message, []
    monkeypatch.setattr(mcap_reader, '_unpack_message',
                        lambda data: unpacked.append(data) or unpack_message(data))
    with refused(RecordingError):
        list(BagReader(path).messages())
    assert len(unpacked) == 4


@pytest.mark.parametrize('packed', [
    zeros(2**24), zstandard.compress(bytes(2**24)), zstandard.compress(b'some data')[:-3],
    b'\x28\xb5\x2f\xfd' + bytes(20),
    # A frame that claims 2^60 bytes.
    b'\x28\xb5\x2f\xfd\xe0' + struct.pack('<Q', 2**60) + zstandard.compress(b'x' * 99)[6:],
], ids=['too large, untold', 'too large, told', 'cut off', 'noise', 'claims an exbibyte'])
def test_packed_message_that_cannot_be_unpacked_is_told(tmp_path, monkeypatch, packed):
    monkeypatch.setattr(mcap_reader, 'MAX_RECORD_SIZE', 2**20)
    builder = begun()
    builder.write(records(0))
    for i, data in enumerate((zstandard.compress(b'one'), packed, zstandard.compress(b'two'))):
        Message(channel_id=1, log_time=i, publish_time=i, sequence=i, data=data).write(builder)
    path = tmp_path / 'a.mcap'
    path.write_bytes(builder.end())
    reader = BagReader(path)
    assert [message.data for message in reader.messages()] == [b'one', b'two']
    assert '1 damaged parts' in reader.damage
