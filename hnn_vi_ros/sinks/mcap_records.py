# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Read the records of an MCAP file that may break off anywhere."""

from collections.abc import Iterator
from io import BytesIO
import struct
from typing import BinaryIO, NamedTuple
import zlib

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.lfs_pointer import refuse_pointer
import lz4.frame
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import (
    Attachment, Channel, Chunk, Header, McapRecord, Message, MessageIndex, Metadata, Schema)
from mcap.writer import MCAP0_MAGIC as MAGIC
import zstandard

# Opcode and length come before each record's content.
PREFIX = struct.Struct('<BQ')
_READERS = {
    Opcode.HEADER: Header, Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel, Opcode.CHUNK: Chunk,
    Opcode.MESSAGE_INDEX: MessageIndex, Opcode.ATTACHMENT: Attachment, Opcode.METADATA: Metadata}
# What comes after the data.
_ENDS = (Opcode.DATA_END, Opcode.FOOTER)
# Any other frame is none: a tail of zeros, or of something else.
_OPCODES = frozenset(range(0x01, 0x10)) | frozenset(range(0x80, 0x100))
# No content that unpacks to more is opened [bytes].
_LARGEST_CHUNK = 2**30


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


def check_magic(stream: BinaryIO, name: object) -> None:
    """Read the magic bytes, or raise RecordingError: it is no MCAP file."""
    found = stream.read(len(MAGIC))
    if found != MAGIC:
        refuse_pointer(found + stream.read(24), name, RecordingError)
        reason = 'it does not begin like one' if found else 'it is empty'
        raise RecordingError(f'{name}: no MCAP file: {reason}; give a bag or its .mcap file')


def data_frames(stream: BinaryIO, first: int, end: int) -> Iterator[Frame]:
    """
    Yield the frames from a place on, up to the end of the data or of the stream.

    Parameters
    ----------
    stream : BinaryIO
        May be read elsewhere between two frames.
    first, end : int
        Where the first frame begins, and the size of the stream.

    """
    place = first
    while place + PREFIX.size <= end:
        stream.seek(place)
        opcode, length = PREFIX.unpack(stream.read(PREFIX.size))
        start = place + PREFIX.size
        if opcode in _ENDS or opcode not in _OPCODES:
            return
        if start + length > end:
            yield Frame(opcode, start, end - start, False)
            return
        yield Frame(opcode, start, length, True)
        place = start + length


def decode(opcode: int, content: bytes) -> McapRecord | None:
    """Return a whole record; None for one of no concern, or whose content is damaged."""
    stream = ReadDataStream(BytesIO(content))
    try:
        if opcode == Opcode.MESSAGE:
            return Message.read(stream, len(content))
        reader = _READERS.get(opcode)
        return None if reader is None else reader.read(stream)
    except (EndOfFile, struct.error, UnicodeDecodeError):
        return None


def read_content(stream: BinaryIO, frame: Frame) -> bytes:
    """Return the content of a frame, as far as it is there."""
    stream.seek(frame.start)
    return stream.read(frame.length)


def unpack(content: bytes, whole: bool) -> tuple[bytes, bool]:
    """
    Return the records that a chunk holds, one after the other, and whether they are all there.

    Parameters
    ----------
    content : bytes
        Of the chunk's record.
    whole : bool
        Whether it is all of it. Else what can be unpacked of it is returned.

    """
    chunk = decode(Opcode.CHUNK, content)
    if chunk is None or chunk.uncompressed_size > _LARGEST_CHUNK:
        return b'', False
    try:
        if chunk.compression == 'zstd':
            data = zstandard.ZstdDecompressor().decompressobj().decompress(chunk.data)
        elif chunk.compression == 'lz4':
            data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data)
        else:
            data = chunk.data if not chunk.compression else b''
    except (zstandard.ZstdError, RuntimeError):
        return b'', False
    if not whole:
        return data, False
    intact = len(data) == chunk.uncompressed_size and chunk.uncompressed_crc in (
        0, zlib.crc32(data))
    # Of a damaged chunk nothing is believed.
    return (data, True) if intact else (b'', False)


def records_in(data: bytes) -> Iterator[McapRecord]:
    """Yield the complete schemas, channels and messages among unpacked records."""
    place, size = 0, len(data)
    while place + PREFIX.size <= size:
        opcode, length = PREFIX.unpack_from(data, place)
        place += PREFIX.size
        if place + length > size:
            return
        record = decode(opcode, data[place:place + length])
        if record is not None:
            yield record
        place += length
