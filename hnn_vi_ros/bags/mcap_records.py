# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Read the records of an MCAP file, none of whose bytes is believed before it is checked."""

from collections.abc import Iterator
from io import BytesIO
import struct
from typing import BinaryIO, NamedTuple, TypeGuard
import zlib

import lz4.frame
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import (
    Attachment, AttachmentIndex, Channel, ChunkIndex, DataEnd, Footer, Header, McapRecord, Message,
    MessageIndex, Metadata, MetadataIndex, Schema, Statistics, SummaryOffset)
from mcap.writer import MCAP0_MAGIC
import zstandard

# At both ends of a file.
MAGIC = MCAP0_MAGIC
# Opcode and length come before each record's content.
PREFIX = struct.Struct('<BQ')
# A chunk begins with: times of its first and last message, unpacked size, CRC, length of a name.
_CHUNK = struct.Struct('<QQQII')
_SIZE = struct.Struct('<Q')
_READERS = {
    Opcode.HEADER: Header, Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel,
    Opcode.MESSAGE_INDEX: MessageIndex, Opcode.ATTACHMENT: Attachment, Opcode.METADATA: Metadata,
    Opcode.CHUNK_INDEX: ChunkIndex, Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.METADATA_INDEX: MetadataIndex, Opcode.STATISTICS: Statistics,
    Opcode.SUMMARY_OFFSET: SummaryOffset, Opcode.DATA_END: DataEnd, Opcode.FOOTER: Footer}
# Where a name begins in records that may be as long as a message, in files without chunks; and the
# counts of statistics, which have none.
_NAMES = {Opcode.HEADER: 0, Opcode.METADATA: 0, Opcode.SCHEMA: 2, Opcode.CHANNEL: 4,
          Opcode.ATTACHMENT: 16, Opcode.METADATA_INDEX: 16, Opcode.ATTACHMENT_INDEX: 40}
_COUNTS = 42
# A message begins with its channel and holds its log time.
MESSAGE = struct.Struct('<HxxxxQ')
# Channel, sequence, log time and publish time come before its data.
_MESSAGE_HEAD = struct.Struct('<HIQQ')
MESSAGE_HEAD = _MESSAGE_HEAD.size
# No record with more bytes, and nothing that unpacks to more, is opened.
LARGEST = 2**28
_BLOCK = 2**20
COMPRESSIONS = ('', 'zstd', 'lz4')


class Frame(NamedTuple):
    """
    A record that is not decoded.

    Parameters
    ----------
    opcode : int
        Its kind.
    start, length : int
        Where its content begins in the stream, and its length [bytes].
    whole : bool
        Whether the stream holds all of it.

    """

    opcode: int
    start: int
    length: int
    whole: bool

    @property
    def end(self) -> int:
        """Return where the next frame begins."""
        return self.start + self.length


class ChunkHead(NamedTuple):
    """
    Head of a chunk: what it says of itself before its data.

    Parameters
    ----------
    first, last : int
        Times of its earliest and latest message [ns].
    unpacked, crc : int
        Size of its records [bytes], and their CRC; 0 for none.
    compression : str
        How they are packed.
    start, length : int
        Where the packed records begin in the content, and how long they are [bytes].

    """

    first: int
    last: int
    unpacked: int
    crc: int
    compression: str
    start: int
    length: int


class _ReadAll(ReadDataStream):
    """Give all bytes that are asked for, or raise EndOfFile."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise EndOfFile
        return data


def decode(opcode: int, content: bytes) -> McapRecord | None:
    """Return a record; None for one of no concern, or whose content does not end as it should."""
    if opcode == Opcode.MESSAGE:
        return _message(content)
    reader = _READERS.get(opcode)
    if reader is None:
        return None
    stream = _ReadAll(BytesIO(content))
    try:
        record = reader.read(stream)
    except (EndOfFile, struct.error, UnicodeDecodeError):
        return None
    if opcode == Opcode.ATTACHMENT and int.from_bytes(content[-4:], 'little') not in (
            0, zlib.crc32(content[:-4])):
        return None
    return record if stream.count == len(content) else None


def is_another_kind(content: bytes) -> bool:
    """Return whether the content of a message is that of another record, to its last byte."""
    return any(_is_named(content, start) and decode(opcode, content) is not None
               for opcode, start in _NAMES.items()) or (
        int.from_bytes(content[_COUNTS:_COUNTS + 4], 'little') == len(content) - _COUNTS - 4
        and is_consistent(decode(Opcode.STATISTICS, content)))


def is_consistent(record: McapRecord | None) -> TypeGuard[Statistics]:
    """Return whether a record is statistics that do not contradict themselves."""
    return isinstance(record, Statistics) and record.message_count == sum(
        record.channel_message_counts.values())


def _is_named(content: bytes, start: int) -> bool:
    """Return whether a printable name is at this place, after its length."""
    begin = start + 4
    end = begin + int.from_bytes(content[start:begin], 'little')
    name = content[begin:end]
    return begin < end <= len(content) and name.isascii() and name.decode().isprintable()


def _message(content: bytes) -> Message | None:
    """Return a message, without the stream that would take the most of the time of a bag."""
    if len(content) < MESSAGE_HEAD:
        return None
    channel, sequence, log_time, publish_time = _MESSAGE_HEAD.unpack_from(content)
    return Message(channel_id=channel, sequence=sequence, log_time=log_time,
                   publish_time=publish_time, data=content[MESSAGE_HEAD:])


def read_content(stream: BinaryIO, frame: Frame) -> bytes:
    """Return the content of a frame, as far as present; nothing of one that is too large."""
    if frame.length > LARGEST:
        return b''
    stream.seek(frame.start)
    return stream.read(frame.length)


def crc_of(stream: BinaryIO, start: int, end: int) -> int:
    """Return the CRC of bytes of a stream."""
    stream.seek(start)
    found, left = 0, end - start
    while left > 0 and (block := stream.read(min(left, _BLOCK))):
        found, left = zlib.crc32(block, found), left - len(block)
    return found


def chunk_head(content: bytes) -> ChunkHead | None:
    """Return the header of a chunk's content; None if it cannot be one."""
    if len(content) < _CHUNK.size:
        return None
    first, last, unpacked, crc, letters = _CHUNK.unpack_from(content)
    start = _CHUNK.size + letters + _SIZE.size
    name = content[_CHUNK.size:_CHUNK.size + letters].decode('ascii', errors='replace')
    if first > last or name not in COMPRESSIONS or len(content) < start:
        return None
    length, = _SIZE.unpack_from(content, start - _SIZE.size)
    return ChunkHead(first, last, unpacked, crc, name, start, length)


def unpack(content: bytes, whole: bool, most: int = LARGEST) -> tuple[bytes, bool]:
    """
    Return the records that a chunk holds, one after the other, and whether they are all there.

    No more is unpacked than the chunk declares, and at most 256 MiB.

    Parameters
    ----------
    content : bytes
        Of the chunk's record.
    whole : bool
        Whether it is all of it. Else what can be unpacked of it is returned.
    most : int
        How many records it may hold at most.

    """
    head = chunk_head(content)
    if head is None or head.unpacked > LARGEST:
        return b'', False
    try:
        data = _unpacked(head.compression, content[head.start:], head.unpacked)
    except (zstandard.ZstdError, RuntimeError):
        return b'', False
    if not whole:
        return data[:head.unpacked], False
    intact = len(data) == head.unpacked and head.crc in (0, zlib.crc32(data)) \
        and _in_order(data, most)
    # Nothing in a damaged chunk is believed.
    return (data, True) if intact else (b'', False)


def _unpacked(compression: str, data: bytes, size: int) -> bytes:
    """Return what data unpack to, and at most one byte more than they should."""
    if compression == 'zstd':
        return unpack_zstd(data, size + 1)
    if compression == 'lz4':
        return lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    return data


def unpack_zstd(data: bytes, most: int) -> bytes:
    """Return the first bytes of what zstd frames hold, as many as are there; or ZstdError."""
    with zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True) as stream:
        return stream.read(most)


def _in_order(data: bytes, most: int) -> bool:
    """Return whether unpacked records follow one another up to the end, and are not too many."""
    place, size = 0, len(data)
    while place + PREFIX.size <= size and most:
        most -= 1
        opcode, length = PREFIX.unpack_from(data, place)
        if opcode == 0 or (opcode == Opcode.MESSAGE and length < MESSAGE_HEAD):
            return False
        place += PREFIX.size + length
    return place == size


def records_in(data: bytes, most: int) -> Iterator[McapRecord]:
    """Yield the complete schemas, channels and messages among so many unpacked records."""
    place, size = 0, len(data)
    while place + PREFIX.size <= size and most:
        most -= 1
        opcode, length = PREFIX.unpack_from(data, place)
        place += PREFIX.size
        if place + length > size or opcode == 0:
            return
        record = decode(opcode, data[place:place + length])
        if isinstance(record, Schema | Channel | Message):
            yield record
        place += length
