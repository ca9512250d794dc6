# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The messages of an MCAP file, finished, cut off or damaged."""

from array import array
from collections.abc import Iterable, Iterator, Sequence
from enum import IntEnum
import os
from pathlib import Path
import struct
from typing import BinaryIO, final

from hnn_vi_ros.bags.bag_metadata import DEFINITIONS, described_channels
from hnn_vi_ros.bags.bag_source import Piece, Source
from hnn_vi_ros.bags.mcap_records import (
    chunk_head, ChunkHead, decode, files_in, Frame, PREFIX, read_content, records_in, unpack)
from hnn_vi_ros.bags.mcap_survey import Definitions, loose_definitions, Survey, survey
from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files.regular_file import open_file, refuse_pointer
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, McapRecord, Message, Schema
import numpy as np

_CHANNEL = struct.Struct('<H')
# Where the entries of a message index begin.
_ENTRIES = 6
# The fields of a chunk before its data fit in so many bytes.
_HEAD = 64
# Most records in chunks, per byte of the file plus a constant: zstd packs 1.4 messages without
# content and with even stamps into a byte; of entirely equal ones, 350.
_PER_BYTE, _AT_LEAST = 4, 2**20


class _Kind(IntEnum):
    """Kind of a piece: messages outside of chunks, a chunk, or what there is of one."""

    MESSAGES = 0
    CHUNK = 1
    BROKEN_CHUNK = 2


@final
class McapFile(Source):
    """
    An MCAP file.

    Parameters
    ----------
    path, name : Path
        The file, and how the user calls it.
    thorough : bool
        Whether every chunk is opened now; else only where it takes that to know what is in it.

    Attributes
    ----------
    survey : Survey
        Survey of the file.

    Raises
    ------
    RecordingError
        It is no MCAP file.
    OSError
        It cannot be read.

    """

    def __init__(self, path: Path, name: Path, thorough: bool = False):
        super().__init__(path, name)
        with open_file(path, name) as stream:
            end = self._begin(stream, None, thorough)
            # Another file begins where a chunk defines a channel otherwise than one before it, and
            # where a file begins in what cannot be read: a record that broke off hides it.
            while end is not None:
                end = self._begin(stream, end, thorough)
        self.pieces = sorted(self.pieces + self.survey.runs, key=lambda piece: piece.start)
        self._define()
        self._count()

    def _begin(self, stream: BinaryIO, end: int | None, thorough: bool) -> int | None:
        """Note what is in the file up to a place; return where another one begins before that."""
        self.survey: Survey = survey(stream, end)
        if not self.survey.is_mcap:
            stream.seek(0)
            refuse_pointer(stream.read(32), self.name, RecordingError)
            reason = 'it does not begin like one' if stream.seek(0, 2) else 'it is empty'
            raise RecordingError(f'{self.name}: no MCAP file: {reason}; give a bag or its file')
        self.pieces, self.unread, self.incomplete, self.held = [], {}, 0, self.survey.messages
        for gap in [*self.survey.gaps, *filter(None, [self.survey.another])]:
            if gap.incomplete:
                self.incomplete += gap.end - gap.start
            else:
                self.unread[gap.start] = gap.end - gap.start
        self._left = _PER_BYTE * stream.seek(0, 2) + _AT_LEAST
        # How many records each chunk that was opened might hold then.
        self._most: dict[int, int] = {}
        self._numbers = set(self.survey.numbers)
        # What chunks define, to which their checksums speak, and what stands outside of them.
        self._defined, self._loose = Definitions(), loose_definitions(self.survey)
        self._entries: dict[int, int] = {}
        self._read_indexes(stream, self.survey.stray)
        begin = self._note_chunks(stream, thorough)
        if begin is None and (self.unread or self.incomplete):
            begin = self._hidden_file(stream, end)
        return begin

    def _note_chunks(self, stream: BinaryIO, thorough: bool) -> int | None:
        """Note the chunks up to one that contradicts those before it; return its place."""
        seen = set[tuple[ChunkHead | None, int]]()
        for chunk, indexes in self.survey.chunks:
            head = chunk_head(read_content(stream, chunk._replace(
                length=min(chunk.length, _HEAD))))
            if head is not None and head.crc and (head, chunk.length) in seen:
                # A copy of one before it.
                self.unread[chunk.start] = chunk.length
                continue
            seen.add((head, chunk.length))
            entries = self._read_indexes(stream, indexes)
            if thorough or not chunk.whole or not self._trust(chunk, head, entries):
                self._open_chunk(stream, chunk)
            if self._defined.contradicted:
                return chunk.start - PREFIX.size
        return None

    def _hidden_file(self, stream: BinaryIO, end: int | None) -> int | None:
        """Return where another file begins before a place, other than in what is sound."""
        size = stream.seek(0, os.SEEK_END) if end is None else end
        sound = [chunk for chunk, _ in self.survey.chunks
                 if chunk.whole and chunk.start not in self.unread]
        return next((place for place in files_in(stream, size)
                     if not any(frame.start <= place < frame.end
                                for frame in [*sound, *self.survey.attachments])), None)

    def _define(self) -> None:
        """Define the channels; what has no checksum comes last."""
        self._defined.add(self._loose)
        if not self._numbers <= self._defined.channels.keys() and self.metadata(DEFINITIONS):
            for record in reversed(self.survey.metadata):
                if record.name == 'rosbag2':
                    self._defined.add(Definitions(described_channels(
                        record.metadata, self.metadata(DEFINITIONS))))
        self.schemas, self.channels = self._defined.schemas, self._defined.channels

    def _count(self) -> None:
        """Take the count of the summary; else that of the indexes, where they list more."""
        listed = sum(self._entries.values())
        self._entries.clear()
        if self.survey.statistics is not None:
            self.counted = self.survey.statistics.message_count
        elif listed > self.held:
            self.counted = listed

    def read(self, piece: Piece) -> Iterator[Message]:
        """See Source."""
        with open_file(self.path, self.name) as stream:
            records, sound = self._open(stream, piece)
        for record in records:
            if not isinstance(record, Message):
                if isinstance(record, Schema | Channel) and self._defined.contradicts(record):
                    sound = False
                    break
            elif record.channel_id in self.channels:
                yield record
            else:
                sound = False
        if not sound:
            self.unread[piece.start] = piece.length

    def messages(self) -> Iterable[Message]:
        """Yield all messages in the order of the file."""
        for piece in self.pieces:
            yield from self.read(piece)

    def attachments(self) -> Iterable[Attachment]:
        """Yield the files that are kept with the messages."""
        with open_file(self.path, self.name) as stream:
            for frame in self.survey.attachments:
                record = decode(frame.opcode, read_content(stream, frame))
                if isinstance(record, Attachment):
                    yield record

    def attachment(self, name: str) -> bytes | None:
        """See Source."""
        return next((found.data for found in self.attachments() if found.name == name), None)

    def metadata(self, name: str) -> dict[str, str]:
        """See Source."""
        found = [record.metadata for record in self.survey.metadata if record.name == name]
        return found[-1] if found else {}

    def _open_chunk(self, stream: BinaryIO, chunk: Frame) -> None:
        """Take what a chunk defines, and note its messages."""
        self.incomplete += 0 if chunk.whole else chunk.length
        kind = _Kind.CHUNK if chunk.whole else _Kind.BROKEN_CHUNK
        records, sound = self._open(stream, Piece(0, 0, chunk.start, chunk.length, kind))
        if not sound:
            self.unread[chunk.start] = chunk.length
        times = array('Q')
        for record in records:
            if isinstance(record, Message):
                self._numbers.add(record.channel_id)
                times.append(record.log_time)
            elif isinstance(record, Schema | Channel):
                self._defined.take(record)
        if times:
            self._add_piece(Piece(min(times), max(times), chunk.start, chunk.length, kind),
                            len(times))

    def _read_indexes(self, stream: BinaryIO, frames: Sequence[Frame]
                      ) -> list[tuple[int, np.ndarray]]:
        """Return channel and entries of indexes, and count these; of equal indexes one counts."""
        found = []
        for frame in frames:
            content = read_content(stream, frame)
            entries = np.frombuffer(content, '<u8', offset=_ENTRIES).reshape(-1, 2)
            self._entries[hash(content)] = len(entries)
            found.append((_CHANNEL.unpack_from(content)[0], entries))
        return found

    def _trust(self, chunk: Frame, head: ChunkHead | None,
               indexes: Sequence[tuple[int, np.ndarray]]) -> bool:
        """Note a chunk without opening it, if it and its indexes agree and it defines nothing."""
        numbers = {number for number, _ in indexes}
        times, places = np.concatenate(
            [np.empty((0, 2), '<u8'), *(entries for _, entries in indexes)]).T
        # The definitions in a chunk come before its first message.
        if head is None or not len(times) or places.min() != 0 or len(numbers) < len(indexes) \
                or not numbers <= {*self._defined.channels, *self._loose.channels} \
                or (head.first, head.last) != (int(times.min()), int(times.max())):
            return False
        self._add_piece(
            Piece(head.first, head.last, chunk.start, chunk.length, _Kind.CHUNK), len(times))
        return True

    def _add_piece(self, piece: Piece, messages: int) -> None:
        self.pieces.append(piece)
        self.held += messages

    def _open(self, stream: BinaryIO, piece: Piece) -> tuple[Iterator[McapRecord], bool]:
        """Return the records of a piece, and whether all that is there can be read."""
        whole = piece.kind != _Kind.BROKEN_CHUNK
        content = read_content(stream, Frame(Opcode.CHUNK, piece.start, piece.length, whole))
        if piece.kind == _Kind.MESSAGES:
            return records_in(content, len(content)), True
        known = piece.start in self._most
        most = self._most.setdefault(piece.start, self._left)
        content, sound = unpack(content, whole, most)
        records = records_in(content, most)
        return records if known else self._counted(records), sound or not whole

    def _counted(self, records: Iterator[McapRecord]) -> Iterator[McapRecord]:
        """Yield the records of a chunk, and leave as many less to other chunks."""
        for record in records:
            self._left -= 1
            yield record
