# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Read the records of an MCAP file, none of whose bytes is believed before it is checked."""

from collections.abc import Iterator
from io import BytesIO
import re
import struct
from typing import Any, BinaryIO, NamedTuple, TypeGuard
import zlib

import lz4.frame
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Channel, McapRecord, Message, Schema, Statistics
from mcap.writer import MCAP0_MAGIC
import zstandard

# At both ends of a file.
MAGIC = MCAP0_MAGIC
# Opcode and length come before each record's content.
PREFIX = struct.Struct('<BQ')
# A chunk begins with: times of its first and last message, unpacked size, CRC, length of a name.
_CHUNK = struct.Struct('<QQQII')
_SIZE = struct.Struct('<Q')
# Chunks are not unpacked as records; messages have a faster reader.
_READERS: dict[int, type[Any]] = {
    opcode: getattr(records, opcode.name.title().replace('_', ''))
    for opcode in Opcode if opcode not in (Opcode.CHUNK, Opcode.MESSAGE)}
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


def read_at(stream: BinaryIO, start: int, length: int = -1) -> bytes:
    """Return bytes of a stream from a place on, all by default, as far as they are there."""
    stream.seek(start)
    return stream.read(length)


def read_content(stream: BinaryIO, frame: Frame) -> bytes:
    """Return the content of a frame, as far as present; nothing of one that is too large."""
    if frame.length > LARGEST:
        return b''
    return read_at(stream, frame.start, frame.length)


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
    end = 0
    for opcode, start, end in frames_in(data, most):
        if opcode == 0 or (opcode == Opcode.MESSAGE and end - start < MESSAGE_HEAD):
            return False
    return end == len(data)


def frames_in(data: bytes, most: int) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and end of so many unpacked records, the last one whole or not."""
    end = 0
    while end + PREFIX.size <= len(data) and most:
        most -= 1
        opcode, length = PREFIX.unpack_from(data, end)
        start = end + PREFIX.size
        end = start + length
        yield opcode, start, end


def records_in(data: bytes, most: int) -> Iterator[McapRecord]:
    """Yield the complete schemas, channels and messages among so many unpacked records."""
    for opcode, start, end in frames_in(data, most):
        if end > len(data) or opcode == 0:
            return
        record = decode(opcode, data[start:end])
        if isinstance(record, Schema | Channel | Message):
            yield record


# What tells of a chunk before its data fits in so many bytes.
HEAD = 64
# Records below 4 GiB: an opcode, and the length's upper half, which is zero.
_START = re.compile(rb'(?=[\x01-\x0f].{4}\x00{4})', re.DOTALL)
_WINDOW = 2**20
# Most bytes to read in search of records, as a multiple of the file's size plus a constant: a
# damaged bag takes a few times its size, one made to take long would take its square.
_MOST_READ, _AT_LEAST = 64, 2**28
# Only chunks, attachments, messages and their indexes may be longer [bytes].
_LONGEST = 2**24
_KINDS = frozenset(range(0x01, 0x10))
# Kinds that the format leaves to others.
_PRIVATE = frozenset(range(0x10, 0x100))
# Kinds of records that a chunk may hold.
_INNER = frozenset((Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE))
_INDEX_HEAD = 6


class Gap(NamedTuple):
    """
    Bytes that are not understood.

    Parameters
    ----------
    start, end : int
        Where they are.
    incomplete : bool
        Whether they are the beginning of a record, with which the file breaks off.

    """

    start: int
    end: int
    incomplete: bool


def files_in(stream: BinaryIO, size: int) -> Iterator[int]:
    """Yield where MCAP files seem to begin in the first bytes of a stream, other than at 0."""
    begin = MAGIC + bytes([Opcode.HEADER])
    for start in range(1, size, _WINDOW):
        window = read_at(stream, start, min(_WINDOW + len(begin) - 1, size - start))
        yield from (start + found.start() for found in re.finditer(re.escape(begin), window))


def walk(stream: BinaryIO, size: int) -> Iterator[Frame | Gap]:
    """
    Yield the records of a stream, and the bytes between them that are none.

    Only the last frame may not be whole: a chunk with which the file breaks off. The magic at
    both ends is left out. A record of a kind that is not known is a frame like another.

    Parameters
    ----------
    stream : BinaryIO
        May be read elsewhere between two frames.
    size : int
        Of the stream [bytes].

    """
    finder = _Finder(stream, size)
    place = len(MAGIC)
    while place < size:
        frame = finder.at(place)
        if frame is not None:
            yield frame
            place = frame.end
            continue
        if finder.ends_at(place):
            return
        found = finder.after(place)
        yield Gap(place, found, found == size and finder.breaks_off(place))
        place = found


class _Finder:
    """Return whether a record begins at a place, and where the next one does."""

    def __init__(self, stream: BinaryIO, size: int):
        self._stream, self._size = stream, size
        self._left = _MOST_READ * size + _AT_LEAST

    def at(self, place: int, alone: bool = False, searched: bool = False) -> Frame | None:
        """
        Return the record that begins at a place, None if there is none.

        Parameters
        ----------
        place : int
            Where.
        alone : bool
            Whether it is not asked what follows it.
        searched : bool
            Whether no record is known to end here: then what follows must be one in any case.

        """
        head = self._read(place, HEAD)
        if len(head) < PREFIX.size:
            return None
        opcode, length = PREFIX.unpack_from(head)
        frame, own = Frame(opcode, place + PREFIX.size, length, True), _chunk_length(head)
        if _is_chunk(head):
            return self._chunk(frame, alone or searched)
        if own != length and opcode in _KINDS and self._fits(frame, head):
            weak = searched or opcode == Opcode.MESSAGE
            if alone or not weak or self._follows(frame.end):
                return frame
        if not searched and (chunk := self._mended_chunk(frame, own)) is not None:
            return chunk
        if opcode in _PRIVATE and frame.end <= self._size and self._follows(frame.end):
            return frame
        return None

    def after(self, place: int) -> int:
        """Return where the next record begins, the size of the stream if none does."""
        # In a chunk that is not packed there are records that are not believed by themselves.
        return self._search(place + 1, within_chunk=_is_chunk(self._read(place, HEAD)))

    def _search(self, place: int, within_chunk: bool = False) -> int:
        # Beyond what any damage takes, nothing more is understood.
        while place < self._size and self._left > 0:
            window = self._read(place, _WINDOW + PREFIX.size)
            for match in _START.finditer(window):
                start = place + match.start()
                if within_chunk and window[match.start()] in _INNER:
                    continue
                if self.at(start, searched=True) is not None:
                    return start
                if self._left <= 0:
                    break
            place += _WINDOW
        return self._size

    def breaks_off(self, place: int) -> bool:
        """Return whether the stream may end within a record that begins at a place."""
        head = self._read(place, PREFIX.size)
        if not head or head[0] not in _KINDS:
            return False
        return len(head) < PREFIX.size or self._size < place + PREFIX.size + PREFIX.unpack(
            head)[1] < self._size + LARGEST

    def ends_at(self, place: int) -> bool:
        """Return whether only the closing magic is left, or what there is of it."""
        left = self._read(place, len(MAGIC) + 1)
        return left == MAGIC[:len(left)]

    def _read(self, place: int, length: int) -> bytes:
        self._stream.seek(place)
        return self._spend(self._stream.read(min(length, max(0, self._size - place))))

    def _spend(self, content: bytes) -> bytes:
        self._left -= len(content)
        return content

    def _fits(self, frame: Frame, head: bytes) -> bool:
        """Return whether a record is there, and its fields agree with its length."""
        opcode, length = frame.opcode, frame.length
        if opcode == Opcode.CHUNK or frame.end > self._size:
            return False
        if opcode == Opcode.MESSAGE:
            return length >= MESSAGE_HEAD
        if opcode == Opcode.MESSAGE_INDEX:
            entries, start = length - _INDEX_HEAD, PREFIX.size + 2
            return 0 <= entries < LARGEST and entries % 16 == 0 and entries == int.from_bytes(
                head[start:start + 4], 'little')
        return (opcode == Opcode.ATTACHMENT or length <= _LONGEST) and decode(
            opcode, self._spend(read_content(self._stream, frame))) is not None

    def _chunk(self, frame: Frame, alone: bool) -> Frame | None:
        """Return a chunk whose lengths agree, if what follows does or its CRC holds."""
        if frame.end > self._size:
            if not alone and self._search(frame.start, within_chunk=True) < self._size:
                return None
            return frame._replace(length=self._size - frame.start, whole=False)
        return frame if alone or self._follows(frame.end) or self._sound(frame) else None

    def _mended_chunk(self, frame: Frame, own: int | None) -> Frame | None:
        """Return a chunk whose opcode, length or one of its inner lengths is damaged."""
        for length in filter(None, {own, frame.length if frame.opcode == Opcode.CHUNK else None}):
            chunk = Frame(Opcode.CHUNK, frame.start, length, True)
            if chunk.end <= self._size and self._sound(chunk):
                return chunk
        return None

    def _sound(self, chunk: Frame) -> bool:
        content = self._spend(read_content(self._stream, chunk))
        head = chunk_head(content)
        return head is not None and head.crc != 0 and unpack(content, True)[1]

    def _follows(self, place: int) -> bool:
        """Return whether a place is where a record begins, or the end."""
        return place == self._size or self.ends_at(place) or self.breaks_off(place) \
            or self.at(place, alone=True) is not None


def _chunk_length(head: bytes) -> int | None:
    """Return how long the content of a chunk is by its own fields; None if it is no chunk."""
    fields = chunk_head(head[PREFIX.size:])
    return None if fields is None else fields.start + fields.length


def _is_chunk(head: bytes) -> bool:
    """Return whether a chunk begins here, by its opcode and all its lengths."""
    own = _chunk_length(head)
    return own is not None and PREFIX.unpack_from(head) == (Opcode.CHUNK, own)
