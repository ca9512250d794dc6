# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Read an MCAP file: finished, truncated, or with damaged parts, which are skipped and reported.

Checksums cover chunks and attachments. Records are found by their lengths; after an invalid
length, reading continues at the next chunk.
"""

from array import array
from collections.abc import Callable, Iterable, Iterator
from functools import cached_property, partial
from io import BytesIO
import os
from pathlib import Path
import re
import struct
from typing import Any, BinaryIO, final, NamedTuple
import zlib

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files import in_bytes, open_regular, refuse_pointer
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

# Header of each record: opcode and length.
PREFIX = struct.Struct('<BQ')
# Start of a chunk: times of first and last message, unpacked size, CRC, length of a name.
_CHUNK, _SIZE = struct.Struct('<QQQII'), struct.Struct('<Q')
_HEAD = _CHUNK.size + 8 + _SIZE.size
# Header of a message: channel, sequence, log time and publish time.
_MESSAGE = struct.Struct('<HIQQ')
# Start of a message index: channel and size of the entries, each of two numbers.
_INDEX, _ENTRY = struct.Struct('<HI'), 16
_READERS: dict[int, type[Any]] = {
    opcode: getattr(records, opcode.name.title().replace('_', '')) for opcode in Opcode
    if opcode not in (Opcode.CHUNK, Opcode.MESSAGE, Opcode.MESSAGE_INDEX)}
# Maximum size of a record and of its unpacked content [bytes].
MAX_RECORD_SIZE = 2**28
# Unpacked size of any file [bytes], and in units of its size: recordings shrink to a tenth.
_UNPACKED_SIZE, _UNPACKED_RATIO = 2**26, 128
# Maximum number of metadata records and attachments; recorders write a few.
_MAX_EXTRAS = 2**14
# Maximum size of a group of messages outside of chunks that is read together [bytes].
_MAX_GROUP_SIZE = 2**18
_READ_SIZE = 2**20
_COMPRESSIONS = ('', 'zstd', 'lz4')


class UnpackLimit:
    """
    Limit of the unpacked content of a file: 64 MiB and 128 times its size.

    Parameters
    ----------
    path : Path
        The file.
    size : int
        Its size [bytes].

    """

    def __init__(self, path: Path, size: int):
        self._path, self._most = path, _UNPACKED_SIZE + _UNPACKED_RATIO * size
        self._parts, self._total = dict[int, int](), 0

    def spend(self, part: int, size: int) -> None:
        """
        Count the unpacked size of a part [bytes], which may be read several times.

        Raises
        ------
        RecordingError
            All parts together are too large.

        """
        more = size - self._parts.get(part, 0)
        if more > 0:
            self._parts[part] = size
            self._total += more
        if self._total > self._most:
            raise RecordingError(
                f'{self._path}: unpacks to more than {in_bytes(self._most)} '
                f'({in_bytes(_UNPACKED_SIZE)} and {_UNPACKED_RATIO} times its size); if you trust '
                'it, unpack it with `mcap decompress` or `zstd -d`')


class MessagePart(NamedTuple):
    """
    Part of a file that contains messages.

    Parameters
    ----------
    first, last : int
        Times of its earliest and latest message [ns].
    start, length : int
        Position in the file: in bytes, or in units of its reader.
    packed : bool
        True for the content of a chunk.

    """

    first: int
    last: int
    start: int
    length: int
    packed: bool = False


class _ChunkHead(NamedTuple):
    first: int  # time of the earliest message [ns]
    last: int  # time of the latest message [ns]
    unpacked: int  # size of the records [bytes]
    crc: int  # CRC of the unpacked records; 0 for none
    compression: str
    start: int  # start of the packed records in the content


class _ReadAll(ReadDataStream):
    """Stream that returns all requested bytes, or raises EndOfFile."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise EndOfFile
        return data


def _decode(opcode: int, content: bytes) -> McapRecord | None:
    """Return a record; None if the content is not exactly one record, or its CRC is wrong."""
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
    """Return the existing bytes of a stream; none if more than MAX_RECORD_SIZE are requested."""
    stream.seek(start)
    return stream.read(length) if length <= MAX_RECORD_SIZE else b''


def _crc_of(stream: BinaryIO, start: int, end: int) -> int:
    """Return the CRC of a range of a stream."""
    stream.seek(start)
    found, left = 0, end - start
    while left > 0 and (block := stream.read(min(left, _READ_SIZE))):
        found, left = zlib.crc32(block, found), left - len(block)
    return found


def _chunk_head(content: bytes) -> _ChunkHead | None:
    """Return the header of a chunk; None if it is invalid."""
    if len(content) < _CHUNK.size:
        return None
    first, last, unpacked, crc, letters = _CHUNK.unpack_from(content)
    name = content[_CHUNK.size:_CHUNK.size + letters].decode('ascii', errors='replace')
    if first > last or name not in _COMPRESSIONS:
        return None
    return _ChunkHead(first, last, unpacked, crc, name, _CHUNK.size + letters + _SIZE.size)


def unpack_zstd(data: bytes, most: int) -> bytes:
    """Decompress zstd frames up to a number of bytes; raise ZstdError if they are invalid."""
    with zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True) as stream:
        return stream.read(most)


def _unpack(content: bytes, spend: Callable[[int], None]) -> bytes | None:
    """Return the records of a chunk, at most the declared size; None if it is damaged."""
    head = _chunk_head(content)
    if head is None or head.unpacked > MAX_RECORD_SIZE:
        return None
    data, most = content[head.start:], head.unpacked + 1
    try:
        if head.compression == 'zstd':
            data = unpack_zstd(data, most)
        elif head.compression == 'lz4':
            data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=most)
    except (zstandard.ZstdError, RuntimeError):
        return None
    spend(len(data))
    return data if len(data) == head.unpacked and head.crc in (0, zlib.crc32(data)) else None


def _records_in(data: bytes) -> Iterator[McapRecord | None]:
    """Yield schemas, channels and messages; yield None at invalid data, and stop."""
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
    An MCAP file; only its outline is held in memory.

    Parameters
    ----------
    path : Path
        The file.
    thorough : bool
        True to open every chunk now, as for an unfinished file.

    Attributes
    ----------
    channels : dict of int to Channel
        Topic, encoding and metadata of each channel.
    schemas : dict of int to Schema
        Name and definition of each type.
    pieces : list of Piece
        Pieces in the order of the file.
    unread : dict of int to int
        Lengths of unreadable parts by position [bytes]; those in chunks are known once the chunks
        have been opened.
    incomplete : int
        Size of the truncated record at the end of the file [bytes].
    message_count : int
        Number of messages, as far as known before they are read.
    counted : int or None
        Number of messages counted by the recorder; None if unknown.
    finished : bool
        True if the recorder has completed the file, and its summary matches the content.
    header : Header or None
        Profile and library.

    Raises
    ------
    RecordingError
        It is not an MCAP file, or contains a second one.
    OSError
        The file cannot be read.

    """

    def __init__(self, path: Path, thorough: bool = False):
        self.path = path
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.pieces: list[MessagePart] = []
        self.unread: dict[int, int] = {}
        self.incomplete, self.message_count, self._listed = 0, 0, 0
        self.counted: int | None = None
        self.header: Header | None = None
        self.data_end: tuple[int, int] | None = None  # end of the data section, and its CRC
        self.all_metadata: list[Metadata] = []
        self._attachments: list[tuple[int, int]] = []  # start, length
        self._chunks: set[tuple[_ChunkHead, int]] = set()
        # After the data: definitions, counts and the footer, confirmed only by its CRC.
        self._summary: list[McapRecord] = []
        with open_regular(path) as stream:
            size = os.fstat(stream.fileno()).st_size
            self._allowance = UnpackLimit(path, size)
            if (begin := _read_at(stream, 0, len(MAGIC))) != MAGIC:
                refuse_pointer(_read_at(stream, 0, 32), path, RecordingError)
                reason = 'its first bytes are wrong' if begin else 'it is empty'
                raise RecordingError(f'{path}: is not an MCAP file: {reason}; give a bag or its '
                                     'file')
            end = self._scan(stream, size)
            if self.unread or self.incomplete:
                self._refuse_second(stream, size)
            self._finish(stream, end, size, thorough)

    def _scan(self, stream: BinaryIO, size: int) -> int:
        """Index the records up to the end; return the end of the footer."""
        place = len(MAGIC)
        while place < size and not (self._summary and isinstance(self._summary[-1], Footer)):
            opcode, length = PREFIX.unpack(_read_at(stream, place, PREFIX.size).ljust(9, b'\0'))
            start = place + PREFIX.size
            if start + length <= size and self._add(stream, opcode, start, length):
                place = start + length
                continue
            if self.data_end is not None:
                # Everything after the data section can be reconstructed.
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
        """Index a record; return False if it is invalid."""
        if opcode == Opcode.CHUNK:
            head = _chunk_head(_read_at(stream, start, min(length, _HEAD)))
            if head is None or head.start > length:
                return False
            if head.crc and (head, length) in self._chunks:
                # A copy of an earlier one.
                return False
            self._chunks.add((head, length))
            self.pieces.append(MessagePart(head.first, head.last, start, length, True))
            return True
        if opcode == Opcode.MESSAGE:
            return length >= _MESSAGE.size and self._add_message(stream, start, length)
        if opcode == Opcode.MESSAGE_INDEX:
            if length < _INDEX.size:
                return False
            _, entries = _INDEX.unpack(_read_at(stream, start, _INDEX.size))
            self._listed += entries // _ENTRY
            return entries == length - _INDEX.size and entries % _ENTRY == 0
        record = _decode(opcode, _read_at(stream, start, length))
        if record is None or (isinstance(record, Header) and self.header is not None):
            return False
        if isinstance(record, Attachment | Metadata) and \
                len(self._attachments) + len(self.all_metadata) == _MAX_EXTRAS:
            raise RecordingError(f'{self.path}: more than {_MAX_EXTRAS} metadata records and '
                                 'attachments; give a bag with fewer')
        if isinstance(record, Attachment):
            self._attachments.append((start, length))
        elif isinstance(record, Metadata):
            self.all_metadata.append(record)
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
        """Index a message outside of chunks; join it to the piece before it if possible."""
        _, _, time, _ = _MESSAGE.unpack(_read_at(stream, start, _MESSAGE.size))
        begin, before = start - PREFIX.size, self.pieces[-1] if self.pieces else None
        self.message_count += 1
        if before and before.start + before.length == begin and before.length < _MAX_GROUP_SIZE \
                and not before.packed:
            self.pieces[-1] = MessagePart(min(before.first, time), max(before.last, time),
                                          before.start, start + length - before.start)
        else:
            self.pieces.append(MessagePart(time, time, begin, start + length - begin))
        return True

    def _refuse_second(self, stream: BinaryIO, size: int) -> None:
        """Raise an error if a second file is appended; its channels have the same numbers."""
        begin = MAGIC + bytes([Opcode.HEADER])
        for place in _find_pattern(stream, re.compile(re.escape(begin)), 1, size, len(begin)):
            if not any(start <= place < start + length for start, length in self._attachments):
                raise RecordingError(
                    f'{self.path}: a second file begins inside it: extract it with `tail -c '
                    f'+{place + 1} {self.path}`, and the first with `head -c {place}`')

    def _finish(self, stream: BinaryIO, end: int, size: int, thorough: bool) -> None:
        """Use the summary if it is intact; otherwise open all chunks for their definitions."""
        counts = [record for record in self._summary if isinstance(record, Statistics)
                  and record.message_count == sum(record.channel_message_counts.values())]
        self.counted = counts[-1].message_count if counts else None
        self.finished = len(counts) == 1 and self._is_finished(stream, counts[0], end, size)
        for record in self._summary if self.finished else ():
            if isinstance(record, Schema | Channel):
                self._define(record)
        known = self.finished and len(self.channels) == counts[0].channel_count
        if self._chunks and self.message_count:
            # In a file with chunks, messages outside of them are damaged records.
            loose = [piece for piece in self.pieces if not piece.packed]
            self.unread |= {piece.start: piece.length for piece in loose}
            self.pieces = [piece for piece in self.pieces if piece.packed]
            self.message_count = 0
        if self._chunks:
            self.message_count = self._listed
        if self._chunks and (thorough or not known):
            self.message_count = self._open_all(stream)
            self.pieces = [piece for piece in self.pieces if piece.start not in self.unread]
            if self._listed > self.message_count and self.counted is None:
                self.counted = self._listed

    def _is_finished(self, stream: BinaryIO, count: Statistics, end: int, size: int) -> bool:
        footer = self._summary[-1]
        if not isinstance(footer, Footer) or self.data_end is None:
            return False
        counted = count.chunk_count, count.attachment_count, count.metadata_count
        there = len(self._chunks), len(self._attachments), len(self.all_metadata)
        summary = self.data_end[0] + PREFIX.size + 4
        return counted == there and _read_at(stream, end, size - end) == MAGIC \
            and footer.summary_start in (0, summary) and footer.summary_crc in (
                0, _crc_of(stream, summary, end - 4))

    def _open_all(self, stream: BinaryIO) -> int:
        """Read definitions and message times from all chunks; return the number of messages."""
        count, contradicted = 0, False
        for number, piece in enumerate(self.pieces):
            times, sound = array('Q'), not contradicted
            for record in self._records(stream, piece) if sound else ():
                if isinstance(record, Message):
                    times.append(record.log_time)
                elif record is None:
                    sound = False
                elif not self._define(record):
                    # From here on, channels belong to another recording.
                    sound, contradicted = False, True
                    break
            if not sound:
                self.unread[piece.start] = piece.length
            elif times:
                self.pieces[number] = piece._replace(first=min(times), last=max(times))
                count += len(times)
        return count

    def _records(self, stream: BinaryIO, piece: MessagePart) -> Iterable[McapRecord | None]:
        content = _read_at(stream, piece.start, piece.length)
        data = _unpack(content, partial(self._allowance.spend, piece.start)) \
            if piece.packed else content
        return [None] if data is None else _records_in(data)

    def _define(self, record: McapRecord) -> bool:
        """Add a schema or a channel; return False if its number is already used for another."""
        known: dict[int, Any] = self.schemas if isinstance(record, Schema) else self.channels
        assert isinstance(record, Schema | Channel)
        return known.setdefault(record.id, record) == record

    def read(self, piece: MessagePart) -> Iterator[Message]:
        """Yield the readable messages of a piece that belong to known channels."""
        with open_regular(self.path) as stream:
            found = self._records(stream, piece)
        for record in found:
            if isinstance(record, Message) and record.channel_id in self.channels:
                yield record
            elif isinstance(record, Message) or record is None or not self._define(record):
                self.unread[piece.start] = piece.length

    @cached_property
    def altered(self) -> bool:
        """Return whether a finished file fails the CRC that covers also header and metadata."""
        if not self.finished or self.data_end is None or not self.data_end[1]:
            return False
        with open_regular(self.path) as stream:
            return _crc_of(stream, 0, self.data_end[0]) != self.data_end[1]

    def messages(self) -> Iterator[Message]:
        """Yield all messages in the order of the file."""
        for piece in self.pieces:
            yield from self.read(piece)

    def attachments(self) -> Iterator[Attachment]:
        """Yield the attachments."""
        with open_regular(self.path) as stream:
            for start, length in self._attachments:
                record = _decode(Opcode.ATTACHMENT, _read_at(stream, start, length))
                if isinstance(record, Attachment):
                    yield record

    def attachment(self, name: str) -> bytes | None:
        """Return an attachment by name; None if it does not exist."""
        return next((found.data for found in self.attachments() if found.name == name), None)

    def metadata(self, name: str) -> dict[str, str]:
        """Return the newest metadata with a name; empty if it does not exist."""
        found = [record.metadata for record in self.all_metadata if record.name == name]
        return found[-1] if found else {}


# Opcode of a chunk, a length below 4 GiB, and the name of a compression at its position.
_CHUNK_START = re.compile(
    rb'\x06.{4}\x00{4}.{28}(?:\x00{4}|\x04\x00{3}zstd|\x03\x00{3}lz4)', re.DOTALL)


def _next_chunk(stream: BinaryIO, place: int, size: int) -> int:
    """Return the start of the next plausible chunk with a checksum, or the file size."""
    for start in _find_pattern(stream, _CHUNK_START, place, size, PREFIX.size + _HEAD):
        _, length = PREFIX.unpack(_read_at(stream, start, PREFIX.size))
        head = _chunk_head(_read_at(stream, start + PREFIX.size, _HEAD))
        if head is not None and head.crc and start + PREFIX.size + length <= size:
            return start
    return size


def _find_pattern(stream: BinaryIO, pattern: re.Pattern[bytes], place: int, size: int, longest: int
                  ) -> Iterator[int]:
    """Yield the positions of a pattern whose matches have at most `longest` bytes."""
    for begin in range(place, size, _READ_SIZE):
        window = _read_at(stream, begin, min(_READ_SIZE + longest - 1, size - begin))
        yield from (begin + match.start() for match in pattern.finditer(window))
