# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Read the messages of an MCAP bag in the order of their times, an unfinished one as well."""

from collections.abc import Collection, Iterator
import os
from pathlib import Path
import struct
from typing import BinaryIO, final, NamedTuple

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.sinks.mcap_records import (
    check_magic, data_frames, decode, Frame, MAGIC, PREFIX, read_content, records_in, unpack)
from hnn_vi_ros.sinks.mcap_recovery import bag_file
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, McapRecord, Message, Metadata, Schema

_TIMES = struct.Struct('<QQ')
_CHANNEL = struct.Struct('<H')
# Before the log time of a message.
_MESSAGE_TIME = struct.Struct('<xxxxxxQ')
# Messages outside of chunks are read together up to so many bytes.
_PIECE = 2**18


class Recorded(NamedTuple):
    """
    One message of a bag.

    Parameters
    ----------
    time : int
        Log time [ns].
    channel : int
        Number of its channel.
    data : bytes
        As it was serialised.

    """

    time: int
    channel: int
    data: bytes


class _Piece(NamedTuple):
    """A stretch of the file that holds messages: their times [ns], and where it is."""

    first: int
    last: int
    frame: Frame


@final
class BagReader:
    """
    An MCAP file of a bag, finished or cut off; nothing but its outline is held in memory.

    Parameters
    ----------
    bag : Path
        A folder with one MCAP file, or the file.

    Attributes
    ----------
    path : Path
        The file.
    channels : dict of int to Channel
        Topic, encoding and metadata of each channel.
    schemas : dict of int to Schema
        Name and definition of each type.
    first, last : int
        Earliest and latest log time [ns]; 0 in a bag without messages.

    Raises
    ------
    RecordingError
        It is no MCAP file, or cannot be read.

    """

    def __init__(self, bag: Path):
        self.path = bag_file(bag)
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self._pieces: list[_Piece] = []
        self._attachments: list[Frame] = []
        self._metadata: list[Metadata] = []
        try:
            with self.path.open('rb') as stream:
                check_magic(stream, self.path)
                self._scan(stream)
        except OSError as problem:
            raise RecordingError(f'{self.path}: cannot be read ({problem.strerror or problem}); '
                                 'give the folder of a bag, or its .mcap file') from problem
        self._pieces.sort(key=lambda piece: piece.first)
        self.first = min((piece.first for piece in self._pieces), default=0)
        self.last = max((piece.last for piece in self._pieces), default=0)

    def attachment(self, name: str) -> bytes:
        """Return a file that is kept with the bag, or raise RecordingError."""
        with self.path.open('rb') as stream:
            for frame in self._attachments:
                record = decode(frame.opcode, read_content(stream, frame))
                if isinstance(record, Attachment) and record.name == name:
                    return record.data
        raise RecordingError(f'{self.path}: holds no {name}; was it recorded by the simulator?')

    def metadata(self, name: str) -> dict[str, str]:
        """Return the newest metadata of a name; empty if there is none."""
        found = [record.metadata for record in self._metadata if record.name == name]
        return found[-1] if found else {}

    def messages(self, channels: Collection[int] | None = None, first: int = 0,
                 last: int = 2**64 - 1) -> Iterator[Recorded]:
        """
        Yield messages in the order of their log times, those of one time as they were recorded.

        Parameters
        ----------
        channels : collection of int, optional
            Their channels; without it all.
        first, last : int
            Earliest and latest log time [ns].

        """
        wanted = self.channels.keys() if channels is None else frozenset(channels)
        pieces = [piece for piece in self._pieces if piece.last >= first and piece.first <= last]
        held: list[Recorded] = []
        with self.path.open('rb') as stream:
            for i, piece in enumerate(pieces):
                held += [Recorded(record.log_time, record.channel_id, record.data)
                         for record in self._open(stream, piece.frame)
                         if isinstance(record, Message) and record.channel_id in wanted
                         and first <= record.log_time <= last]
                held.sort(key=lambda message: message.time)
                # What a later piece may come before is kept.
                until = pieces[i + 1].first if i + 1 < len(pieces) else 2**64
                place = 0
                while place < len(held) and held[place].time < until:
                    yield held[place]
                    place += 1
                del held[:place]

    def _open(self, stream: BinaryIO, frame: Frame) -> Iterator[McapRecord]:
        content = read_content(stream, frame)
        if frame.opcode == Opcode.CHUNK:
            content, _ = unpack(content, frame.whole)
        return records_in(content)

    def _scan(self, stream: BinaryIO) -> None:
        """Find what there is; a chunk is opened only for channels that are not known yet."""
        chunk, indexed, unknown = None, False, False
        end = os.fstat(stream.fileno()).st_size
        for frame in data_frames(stream, len(MAGIC), end):
            if frame.opcode == Opcode.MESSAGE_INDEX and frame.whole and chunk is not None:
                number, = _CHANNEL.unpack(stream.read(_CHANNEL.size))
                indexed, unknown = True, unknown or number not in self.channels
                continue
            if chunk is not None:
                self._add_chunk(stream, chunk, unknown or not indexed)
            chunk, indexed, unknown = None, False, False
            if frame.opcode == Opcode.CHUNK:
                chunk = frame
            elif frame.whole:
                self._add(stream, frame)
        if chunk is not None:
            # Of the last one the indexes may be missing.
            self._add_chunk(stream, chunk, True)

    def _add_chunk(self, stream: BinaryIO, frame: Frame, look_inside: bool) -> None:
        if not look_inside:
            stream.seek(frame.start)
            self._pieces.append(_Piece(*_TIMES.unpack(stream.read(_TIMES.size)), frame))
            return
        times = []
        for record in self._open(stream, frame):
            if isinstance(record, Message):
                times.append(record.log_time)
            else:
                self._take(record)
        if times:
            self._pieces.append(_Piece(min(times), max(times), frame))

    def _add(self, stream: BinaryIO, frame: Frame) -> None:
        if frame.opcode == Opcode.MESSAGE:
            stream.seek(frame.start)
            self._add_message(_MESSAGE_TIME.unpack(stream.read(_MESSAGE_TIME.size))[0], frame)
        elif frame.opcode == Opcode.ATTACHMENT:
            self._attachments.append(frame)
        elif frame.opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA):
            self._take(decode(frame.opcode, read_content(stream, frame)))

    def _add_message(self, time: int, frame: Frame) -> None:
        """Note a message outside of chunks: together with the one before it, if there is one."""
        start = frame.start - PREFIX.size
        length = frame.length + PREFIX.size
        if self._pieces:
            before = self._pieces[-1]
            if before.frame.opcode == Opcode.MESSAGE and before.frame.end == start \
                    and before.frame.length < _PIECE:
                start, length = before.frame.start, before.frame.length + length
                self._pieces[-1] = _Piece(min(before.first, time), max(before.last, time),
                                          Frame(Opcode.MESSAGE, start, length, True))
                return
        self._pieces.append(_Piece(time, time, Frame(Opcode.MESSAGE, start, length, True)))

    def _take(self, record: McapRecord | None) -> None:
        if isinstance(record, Schema):
            self.schemas.setdefault(record.id, record)
        elif isinstance(record, Channel):
            self.channels.setdefault(record.id, record)
        elif isinstance(record, Metadata):
            self._metadata.append(record)
