# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Find the records of an MCAP file, behind damage as well.

A record is taken for one only if what it says of its own lengths agrees: the prefix, the fields
inside, and what comes next. Where nothing does, the search continues byte by byte. No opcode
ends it.
"""

from collections.abc import Iterator
import re
from typing import BinaryIO, NamedTuple

from hnn_vi_ros.bags.mcap_records import (
    chunk_head, decode, Frame, LARGEST, MAGIC, MESSAGE_HEAD, PREFIX, read_content, unpack)
from mcap.opcode import Opcode

# What tells of a chunk before its data fits in so many bytes.
_HEAD = 64
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
        head = self._read(place, _HEAD)
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
        return self._search(place + 1, within_chunk=_is_chunk(self._read(place, _HEAD)))

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
        for length in {own, frame.length if frame.opcode == Opcode.CHUNK else None} - {None}:
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
