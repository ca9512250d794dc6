# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Read an MCAP file: finished, cut off, or with damaged parts, which are left out and told.

Chunks and attachments are covered by checksums; records are found by their lengths, and behind a
length that cannot be right, from the next chunk on.
"""

from array import array
from collections.abc import Iterable, Iterator
from io import BytesIO
import os
from pathlib import Path
import re
import struct
from typing import Any, BinaryIO, final, NamedTuple
import zlib

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files import open_file, refuse_pointer
import lz4.frame
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import (
    Attachment, Channel, DataEnd, Footer, Header, McapRecord, Message, Metadata, Schema,
    Statistics)
from mcap.writer import MCAP0_MAGIC as MAGIC
import zstandard

# Opcode and length come before each record's content.
PREFIX = struct.Struct('<BQ')
# A chunk begins with: times of its first and last message, unpacked size, CRC, length of a name.
_CHUNK, _SIZE = struct.Struct('<QQQII'), struct.Struct('<Q')
_HEAD = _CHUNK.size + 8 + _SIZE.size
# Channel, sequence, log time and publish time come before a message's data.
_MESSAGE = struct.Struct('<HIQQ')
# An index of messages begins with its channel and the size of its entries, each of two numbers.
_INDEX, _ENTRY = struct.Struct('<HI'), 16
_READERS: dict[int, type[Any]] = {
    opcode: getattr(records, opcode.name.title().replace('_', '')) for opcode in Opcode
    if opcode not in (Opcode.CHUNK, Opcode.MESSAGE, Opcode.MESSAGE_INDEX)}
# No record with more bytes, and nothing that unpacks to more, is opened.
LARGEST = 2**28
# Messages outside of chunks are read together up to so many bytes.
_PIECE = 2**18
_WINDOW = 2**20
_COMPRESSIONS = ('', 'zstd', 'lz4')


class Piece(NamedTuple):
    """
    A stretch of a file that holds messages.

    Parameters
    ----------
    first, last : int
        Times of its earliest and latest message [ns].
    start, length : int
        Where it is in the file: in bytes, or as its reader counts.
    packed : bool
        Whether it is the content of a chunk.

    """

    first: int
    last: int
    start: int
    length: int
    packed: bool = False


class _ChunkHead(NamedTuple):
    first: int  # time of the earliest message [ns]
    last: int  # and of the latest
    unpacked: int  # size of the records [bytes]
    crc: int  # of the unpacked records; 0 for none
    compression: str
    start: int  # where the packed records begin in the content


class _ReadAll(ReadDataStream):
    """Give all bytes that are asked for, or raise EndOfFile."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise EndOfFile
        return data


def _decode(opcode: int, content: bytes) -> McapRecord | None:
    """Return a record; None where the content is not exactly one, or its CRC does not match."""
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


def _read_at(stream: BinaryIO, start: int, length: int) -> bytes:
    """Return bytes of a stream, as far as they are there; none of more than LARGEST."""
    stream.seek(start)
    return stream.read(length) if length <= LARGEST else b''


def crc_of(stream: BinaryIO, start: int, end: int) -> int:
    """Return the CRC of bytes of a stream."""
    stream.seek(start)
    found, left = 0, end - start
    while left > 0 and (block := stream.read(min(left, _WINDOW))):
        found, left = zlib.crc32(block, found), left - len(block)
    return found


def _chunk_head(content: bytes) -> _ChunkHead | None:
    """Return what a chunk says of itself before its data; None if it cannot be one."""
    if len(content) < _CHUNK.size:
        return None
    first, last, unpacked, crc, letters = _CHUNK.unpack_from(content)
    name = content[_CHUNK.size:_CHUNK.size + letters].decode('ascii', errors='replace')
    if first > last or name not in _COMPRESSIONS:
        return None
    return _ChunkHead(first, last, unpacked, crc, name, _CHUNK.size + letters + _SIZE.size)


def unpack_zstd(data: bytes, most: int) -> bytes:
    """Return the first bytes of what zstd frames hold, as many as are there; or ZstdError."""
    with zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True) as stream:
        return stream.read(most)


def _unpack(content: bytes) -> bytes | None:
    """Return the records of a chunk, never more than it declares; None if it is damaged."""
    head = _chunk_head(content)
    if head is None or head.unpacked > LARGEST:
        return None
    data, most = content[head.start:], head.unpacked + 1
    try:
        if head.compression == 'zstd':
            data = unpack_zstd(data, most)
        elif head.compression == 'lz4':
            data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=most)
    except (zstandard.ZstdError, RuntimeError):
        return None
    return data if len(data) == head.unpacked and head.crc in (0, zlib.crc32(data)) else None


def _records_in(data: bytes) -> Iterator[McapRecord | None]:
    """Yield schemas, channels and messages among records; None, at the end, for what is none."""
    end = 0
    while end + PREFIX.size <= len(data):
        opcode, length = PREFIX.unpack_from(data, end)
        start = end + PREFIX.size
        end = start + length
        if opcode == Opcode.MESSAGE and _MESSAGE.size <= length <= len(data) - start:
            channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(data, start)
            yield Message(channel_id=channel, sequence=sequence, log_time=log_time,
                          publish_time=publish_time, data=data[start + _MESSAGE.size:end])
        elif isinstance(record := _decode(opcode, data[start:end]), Schema | Channel):
            yield record
        else:
            break
    if end != len(data):
        yield None


@final
class McapFile:
    """
    An MCAP file; nothing but its outline is held in memory.

    Parameters
    ----------
    path, name : Path
        The file, and how the user calls it.
    thorough : bool
        Whether every chunk is opened now, as in a file that was not finished.

    Attributes
    ----------
    channels : dict of int to Channel
        Topic, encoding and metadata of each channel.
    schemas : dict of int to Schema
        Name and definition of each type.
    pieces : list of Piece
        In the order of the file.
    unread : dict of int to int
        Lengths of the parts that cannot be read, by their place [bytes]; those in chunks are
        known once these are opened.
    incomplete : int
        Bytes of a record with which the file breaks off.
    held : int
        How many messages there are, by all that tells it before they are read.
    counted : int or None
        How many the recorder has counted; None where it has not.
    finished : bool
        Whether the recorder has completed the file, and its summary counts what is there.
    header : Header or None
        Profile and library.

    Raises
    ------
    RecordingError
        It is no MCAP file, or holds a second one.
    OSError
        It cannot be read.

    """

    def __init__(self, path: Path, name: Path, thorough: bool = False):
        self.path, self.name = path, name
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.pieces: list[Piece] = []
        self.unread: dict[int, int] = {}
        self.incomplete, self.held, self._listed = 0, 0, 0
        self.counted: int | None = None
        self.header: Header | None = None
        self.data_end: tuple[int, int] | None = None  # where the data end, and their CRC
        self._metadata: list[Metadata] = []
        self._attachments: list[tuple[int, int]] = []  # start, length
        self._chunks: set[tuple[_ChunkHead, int]] = set()
        # Behind the data: definitions, counts and the footer, which only its CRC confirms.
        self._summary: list[McapRecord] = []
        with open_file(path, name) as stream:
            size = os.fstat(stream.fileno()).st_size
            if (begin := _read_at(stream, 0, len(MAGIC))) != MAGIC:
                refuse_pointer(_read_at(stream, 0, 32), name, RecordingError)
                reason = 'it does not begin like one' if begin else 'it is empty'
                raise RecordingError(f'{name}: no MCAP file: {reason}; give a bag or its file')
            end = self._scan(stream, size)
            if self.unread or self.incomplete:
                self._refuse_second(stream, size)
            self._finish(stream, end, size, thorough)

    def _scan(self, stream: BinaryIO, size: int) -> int:
        """Note the records up to the end; return where the footer ends."""
        place = len(MAGIC)
        while place < size and not (self._summary and isinstance(self._summary[-1], Footer)):
            opcode, length = PREFIX.unpack(_read_at(stream, place, PREFIX.size).ljust(9, b'\0'))
            start = place + PREFIX.size
            if start + length <= size and self._add(stream, opcode, start, length):
                place = start + length
                continue
            if self.data_end is not None:
                # What is behind the data can be made again.
                return size
            found = _next_chunk(stream, place + 1, size)
            if found == size and start + length > size and 0 < opcode <= Opcode.DATA_END:
                self.incomplete = size - place
            else:
                self.unread[place] = found - place
            place = found
        if place + len(MAGIC) < size:
            self.unread[place + len(MAGIC)] = size - place - len(MAGIC)
        return place

    def _add(self, stream: BinaryIO, opcode: int, start: int, length: int) -> bool:
        """Note a record; return False if there is none."""
        if opcode == Opcode.CHUNK:
            head = _chunk_head(_read_at(stream, start, min(length, _HEAD)))
            if head is None or head.start > length:
                return False
            if head.crc and (head, length) in self._chunks:
                # A copy of one before it.
                return False
            self._chunks.add((head, length))
            self.pieces.append(Piece(head.first, head.last, start, length, True))
            return True
        if opcode == Opcode.MESSAGE:
            return length >= _MESSAGE.size and self._add_message(stream, start, length)
        if opcode == Opcode.MESSAGE_INDEX:
            _, entries = _INDEX.unpack(_read_at(stream, start, _INDEX.size))
            self._listed += entries // _ENTRY
            return entries == length - _INDEX.size and entries % _ENTRY == 0
        record = _decode(opcode, _read_at(stream, start, length))
        if record is None or (isinstance(record, Header) and self.header is not None):
            return False
        if isinstance(record, Attachment):
            self._attachments.append((start, length))
        elif isinstance(record, Metadata):
            self._metadata.append(record)
        elif isinstance(record, Header):
            self.header = record
        elif isinstance(record, DataEnd):
            self.data_end = start - PREFIX.size, record.data_section_crc
        elif self.data_end is not None:
            self._summary.append(record)
        elif isinstance(record, Schema | Channel):
            self._define(record)
        return True

    def _add_message(self, stream: BinaryIO, start: int, length: int) -> bool:
        """Note a message outside of chunks, together with the one before it if there is one."""
        _, _, time, _ = _MESSAGE.unpack(_read_at(stream, start, _MESSAGE.size))
        begin, before = start - PREFIX.size, self.pieces[-1] if self.pieces else None
        self.held += 1
        if before and before.start + before.length == begin and before.length < _PIECE \
                and not before.packed:
            self.pieces[-1] = Piece(min(before.first, time), max(before.last, time), before.start,
                                    start + length - before.start)
        else:
            self.pieces.append(Piece(time, time, begin, start + length - begin))
        return True

    def _refuse_second(self, stream: BinaryIO, size: int) -> None:
        """Refuse a file that goes on with another one, whose channels have the same numbers."""
        begin = MAGIC + bytes([Opcode.HEADER])
        for place in _found(stream, re.compile(re.escape(begin)), 1, size, len(begin)):
            if not any(start <= place < start + length for start, length in self._attachments):
                raise RecordingError(
                    f'{self.name}: a second file begins within it: cut it out with '
                    f'`tail -c +{place + 1} {self.name}`, and the first with `head -c {place}`')

    def _finish(self, stream: BinaryIO, end: int, size: int, thorough: bool) -> None:
        """Take the summary if it is whole; else open all chunks for what they define."""
        counts = [record for record in self._summary if isinstance(record, Statistics)
                  and record.message_count == sum(record.channel_message_counts.values())]
        self.counted = counts[-1].message_count if counts else None
        self.finished = len(counts) == 1 and self._is_finished(stream, counts[0], end, size)
        for record in self._summary if self.finished else ():
            if isinstance(record, Schema | Channel):
                self._define(record)
        known = self.finished and len(self.channels) == counts[0].channel_count
        if self._chunks and self.held:
            # Where chunks are, messages outside of them are damaged records.
            loose = [piece for piece in self.pieces if not piece.packed]
            self.unread |= {piece.start: piece.length for piece in loose}
            self.pieces = [piece for piece in self.pieces if piece.packed]
            self.held = 0
        if self._chunks:
            self.held = self._listed
        if self._chunks and (thorough or not known):
            self.held = self._open_all(stream)
            self.pieces = [piece for piece in self.pieces if piece.start not in self.unread]
            if self._listed > self.held and self.counted is None:
                self.counted = self._listed

    def _is_finished(self, stream: BinaryIO, count: Statistics, end: int, size: int) -> bool:
        footer = self._summary[-1]
        if not isinstance(footer, Footer) or self.data_end is None:
            return False
        counted = count.chunk_count, count.attachment_count, count.metadata_count
        there = len(self._chunks), len(self._attachments), len(self._metadata)
        summary = self.data_end[0] + PREFIX.size + 4
        return counted == there and _read_at(stream, end, size - end) == MAGIC \
            and footer.summary_start in (0, summary) and footer.summary_crc in (
                0, crc_of(stream, summary, end - 4))

    def _open_all(self, stream: BinaryIO) -> int:
        """Take what chunks define and the times of their messages; return how many these are."""
        held, contradicted = 0, False
        for number, piece in enumerate(self.pieces):
            times, sound = array('Q'), not contradicted
            for record in self._records(stream, piece) if sound else ():
                if isinstance(record, Message):
                    times.append(record.log_time)
                elif record is None:
                    sound = False
                elif not self._define(record):
                    # From here on the channels are those of another recording.
                    sound, contradicted = False, True
                    break
            if not sound:
                self.unread[piece.start] = piece.length
            elif times:
                self.pieces[number] = piece._replace(first=min(times), last=max(times))
                held += len(times)
        return held

    def _records(self, stream: BinaryIO, piece: Piece) -> Iterable[McapRecord | None]:
        content = _read_at(stream, piece.start, piece.length)
        data = _unpack(content) if piece.packed else content
        return [None] if data is None else _records_in(data)

    def _define(self, record: McapRecord) -> bool:
        """Take a schema or a channel; return False if it contradicts one of its number."""
        known: dict[int, Any] = self.schemas if isinstance(record, Schema) else self.channels
        assert isinstance(record, Schema | Channel)
        return known.setdefault(record.id, record) == record

    def read(self, piece: Piece) -> Iterator[Message]:
        """Yield the messages of a piece that can be read, all of known channels."""
        with open_file(self.path, self.name) as stream:
            found = self._records(stream, piece)
        for record in found:
            if isinstance(record, Message) and record.channel_id in self.channels:
                yield record
            elif isinstance(record, Message) or record is None or not self._define(record):
                self.unread[piece.start] = piece.length

    def messages(self) -> Iterator[Message]:
        """Yield all messages in the order of the file."""
        for piece in self.pieces:
            yield from self.read(piece)

    def attachments(self) -> Iterator[Attachment]:
        """Yield the files that are kept with the messages."""
        with open_file(self.path, self.name) as stream:
            for start, length in self._attachments:
                record = _decode(Opcode.ATTACHMENT, _read_at(stream, start, length))
                if isinstance(record, Attachment):
                    yield record

    def attachment(self, name: str) -> bytes | None:
        """Return a file that is kept with the messages; None if there is none of this name."""
        return next((found.data for found in self.attachments() if found.name == name), None)

    @property
    def all_metadata(self) -> list[Metadata]:
        """Return all metadata, in the order of the file."""
        return self._metadata

    def metadata(self, name: str) -> dict[str, str]:
        """Return the newest metadata of a name; empty if there is none."""
        found = [record.metadata for record in self._metadata if record.name == name]
        return found[-1] if found else {}


# The opcode of a chunk, a length below 4 GiB, and the name of a compression where it has to be.
_CHUNK_START = re.compile(
    rb'\x06.{4}\x00{4}.{28}(?:\x00{4}|\x04\x00{3}zstd|\x03\x00{3}lz4)', re.DOTALL)


def _next_chunk(stream: BinaryIO, place: int, size: int) -> int:
    """Return where the next chunk with a checksum seems to begin; the size if none does."""
    for start in _found(stream, _CHUNK_START, place, size, PREFIX.size + _HEAD):
        _, length = PREFIX.unpack(_read_at(stream, start, PREFIX.size))
        head = _chunk_head(_read_at(stream, start + PREFIX.size, _HEAD))
        if head is not None and head.crc and start + PREFIX.size + length <= size:
            return start
    return size


def _found(stream: BinaryIO, pattern: re.Pattern[bytes], place: int, size: int, longest: int
           ) -> Iterator[int]:
    """Yield where a pattern is found, of so many bytes at most."""
    for begin in range(place, size, _WINDOW):
        window = _read_at(stream, begin, min(_WINDOW + longest - 1, size - begin))
        yield from (begin + match.start() for match in pattern.finditer(window))
