# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Content of an MCAP file, finished, cut off or damaged.

``survey`` finds its records, places and definitions without opening its chunks; ``McapFile`` opens
those that it must, and reads the messages.
"""

from array import array
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
import os
from pathlib import Path
import struct
from typing import Any, BinaryIO, final, NamedTuple

from hnn_vi_ros.bags.bag_metadata import DEFINITIONS, described_channels
from hnn_vi_ros.bags.bag_source import Piece, Source
from hnn_vi_ros.bags.mcap_records import (
    chunk_head, ChunkHead, crc_of, decode, files_in, Frame, Gap, HEAD, is_another_kind,
    is_consistent, MAGIC, MESSAGE, PREFIX, read_at, read_content, records_in, unpack, walk)
from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files.regular_file import open_file, refuse_pointer
from mcap.opcode import Opcode
from mcap.records import (
    Attachment, Channel, Footer, Header, McapRecord, Message, Metadata, Schema, Statistics)
import numpy as np

# Messages outside of chunks are read together up to so many bytes.
_PIECE = 2**18
# Larger records that are messages by their opcode are not asked whether they are others.
_OTHERWISE = 2**20
_CRC_SIZE = 4
_OF_CHUNKS = (Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.CHUNK_INDEX)
_DATA = (Opcode.CHUNK, Opcode.MESSAGE, Opcode.ATTACHMENT, Opcode.METADATA)


class Indexed(NamedTuple):
    """A chunk, and the indexes of messages that follow it."""

    chunk: Frame
    indexes: list[Frame]


@dataclass
class Survey:
    """
    The records of a file.

    Parameters
    ----------
    begins : bool
        Whether the file begins with the magic.
    end : int
        Where the data end [bytes].
    header, statistics, footer : McapRecord or None
        If they are there; statistics that contradict themselves are not.
    chunks : list of Indexed
        In the order of the file, as all below.
    stray : list of Frame
        Indexes of messages before any chunk.
    runs : list of Piece
        Messages outside of chunks, those that follow one another together.
    messages : int
        How many these are.
    numbers : set of int
        Their channels.
    attachments : list of Frame
        They are whole: their CRC holds.
    metadata : list of Metadata
        All of them.
    definitions : list of Schema or Channel
        Those outside of chunks, within the data.
    repeated : list of Schema or Channel
        Those behind the data.
    gaps : list of Gap
        What cannot be read and may have held messages, attachments or metadata.
    summary : bool or None
        Whether the records behind the data are unchanged; None without a CRC.
    chunked : bool
        Whether messages are in chunks: then none is believed that is not.
    another : Gap or None
        A second file behind the first one, which is not read.

    """

    begins: bool
    end: int
    header: Header | None = None
    statistics: Statistics | None = None
    footer: Footer | None = None
    chunks: list[Indexed] = field(default_factory=list)
    stray: list[Frame] = field(default_factory=list)
    runs: list[Piece] = field(default_factory=list)
    messages: int = 0
    numbers: set[int] = field(default_factory=set)
    attachments: list[Frame] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)
    definitions: list[Schema | Channel] = field(default_factory=list)
    repeated: list[Schema | Channel] = field(default_factory=list)
    gaps: list[Gap] = field(default_factory=list)
    summary: bool | None = None
    chunked: bool = False
    another: Gap | None = None

    @property
    def is_mcap(self) -> bool:
        """Return whether this is an MCAP file, by its magic or by what no other file holds."""
        return bool(self.begins or self.header or self.chunks or self.attachments)

    @property
    def complete(self) -> bool:
        """Return whether all is there that the statistics count, messages in chunks aside."""
        count = self.statistics
        return count is not None and self.counted and (
            bool(self.chunks) or count.message_count == self.messages)

    @property
    def counted(self) -> bool:
        """Return whether the statistics count as many chunks and files as there are."""
        count = self.statistics
        return count is not None and (
            count.chunk_count, count.attachment_count, count.metadata_count) == (
            len(self.chunks), len(self.attachments), len(self.metadata))

    @property
    def missing(self) -> int:
        """Return how many attachments and metadata are not there that the statistics count."""
        count = self.statistics
        return 0 if count is None else (
            max(0, count.attachment_count - len(self.attachments))
            + max(0, count.metadata_count - len(self.metadata)))

    def forgive(self) -> None:
        """Forget what is damaged where nothing is lost: after the data, or if all is there."""
        self.gaps = [gap for gap in self.gaps if not self.complete and gap.start < self.end]

    def disbelieve(self) -> None:
        """Count messages outside of chunks as damage."""
        self.gaps += [Gap(run.start, run.start + run.length, False) for run in self.runs]
        self.runs, self.messages, self.numbers = [], 0, set()


def survey(stream: BinaryIO, size: int | None = None) -> Survey:
    """
    Return what a file holds; its position does not count.

    Parameters
    ----------
    stream : BinaryIO
        The file.
    size : int, optional
        Where another one begins behind it [bytes].

    """
    whole = os.fstat(stream.fileno()).st_size
    size = whole if size is None else size
    found = Survey(read_at(stream, 0, len(MAGIC)) == MAGIC, size)
    for frame in walk(stream, size):
        if isinstance(frame, Gap):
            found.gaps.append(frame)
            continue
        if frame.opcode == Opcode.HEADER and (begin := _second(found, stream, frame)):
            # What comes before it may break off there.
            return survey(stream, begin)
        if frame.opcode in _DATA and not (frame.opcode == Opcode.MESSAGE and found.chunked):
            # An end of the data that came before was none.
            found.end = size
            found.definitions += found.repeated
            found.repeated.clear()
        _add(found, stream, frame)
    if found.chunked:
        found.disbelieve()
    found.forgive()
    if found.footer is not None and found.footer.summary_crc:
        found.summary = found.footer.summary_crc == crc_of(
            stream, found.end + _CRC_SIZE, size - len(MAGIC) - _CRC_SIZE)
    found.another = Gap(size, whole, False) if size < whole else None
    return found


def _second(found: Survey, stream: BinaryIO, header: Frame) -> int:
    """Return where the file of a header begins behind another one, 0 if that is the first."""
    begin = header.start - PREFIX.size
    before = begin - len(MAGIC)
    if before > 0 and read_at(stream, before, len(MAGIC)) == MAGIC and found.is_mcap:
        return before
    return begin if found.header is not None else 0


def _add(found: Survey, stream: BinaryIO, frame: Frame) -> None:
    opcode = frame.opcode
    found.chunked |= opcode in _OF_CHUNKS
    if opcode == Opcode.CHUNK:
        found.chunks.append(Indexed(frame, []))
    elif opcode == Opcode.MESSAGE_INDEX:
        (found.chunks[-1].indexes if found.chunks else found.stray).append(frame)
    elif opcode == Opcode.MESSAGE:
        _add_message(found, stream, frame)
    elif opcode == Opcode.ATTACHMENT:
        found.attachments.append(frame)
    elif opcode == Opcode.DATA_END:
        found.end = frame.start
    elif opcode > Opcode.DATA_END:
        found.gaps.append(Gap(frame.start - PREFIX.size, frame.end, False))
    else:
        _add_record(found, decode(opcode, read_content(stream, frame)), frame.start)


def _add_record(found: Survey, record: McapRecord | None, start: int) -> None:
    if isinstance(record, Header):
        found.header = found.header or record
    elif isinstance(record, Metadata):
        found.metadata.append(record)
    elif isinstance(record, Schema | Channel):
        (found.definitions if start < found.end else found.repeated).append(record)
    elif isinstance(record, Footer):
        found.footer = record
    elif is_consistent(record):
        found.statistics = record


def _add_message(found: Survey, stream: BinaryIO, frame: Frame) -> None:
    """Note a message outside of chunks: together with the one before it, if there is one."""
    start, length = frame.start - PREFIX.size, frame.length + PREFIX.size
    content = read_content(stream, frame._replace(
        length=frame.length if frame.length <= _OTHERWISE else MESSAGE.size))
    if is_another_kind(content):
        found.gaps.append(Gap(start, frame.end, False))
        return
    channel, time = MESSAGE.unpack_from(content)
    found.messages += 1
    found.numbers.add(channel)
    before = found.runs[-1] if found.runs else None
    if before and before.start + before.length == start and before.length < _PIECE:
        found.runs[-1] = Piece(min(before.first, time), max(before.last, time), before.start,
                               before.length + length)
    else:
        found.runs.append(Piece(time, time, start, length))


class Definitions:
    """
    Schemas and channels, by their numbers.

    Parameters
    ----------
    records : iterable of Schema or Channel
        Taken one by one.

    Attributes
    ----------
    schemas : dict of int to Schema
        Name and definition of each type.
    channels : dict of int to Channel
        Topic, encoding and metadata of each channel.
    contradicted : bool
        Whether one was taken that contradicts an earlier one.

    """

    def __init__(self, records: Iterable[Schema | Channel] = ()):
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.contradicted = False
        for record in records:
            self.take(record)

    def take(self, record: Schema | Channel) -> None:
        """Take one more; an earlier one of the number stays."""
        self.contradicted |= self.contradicts(record)
        self._of(record).setdefault(record.id, record)

    def contradicts(self, record: Schema | Channel) -> bool:
        """Return whether a record of its number is another one."""
        return self._of(record).get(record.id, record) != record

    def add(self, others: 'Definitions') -> None:
        """Add the definitions of others whose numbers are free."""
        self.schemas |= others.schemas | self.schemas
        self.channels |= others.channels | self.channels

    def _of(self, record: Schema | Channel) -> dict[int, Any]:
        return self.schemas if isinstance(record, Schema) else self.channels


def loose_definitions(survey: Survey) -> Definitions:
    """
    Return what is defined outside of chunks, where only the summary may have a checksum.

    Where that holds, the summary is believed; of two that contradict each other, none.
    """
    found: dict[tuple[type, int], Schema | Channel] = {}
    doubtful = set()
    for record in survey.definitions:
        if found.setdefault((type(record), record.id), record) != record:
            doubtful.add((type(record), record.id))
    for record in survey.repeated:
        key = type(record), record.id
        if survey.summary:
            found[key] = record
        elif found.setdefault(key, record) != record and survey.summary is None:
            doubtful.add(key)
    return Definitions(
        record for key, record in found.items() if key not in doubtful
        and not (isinstance(record, Channel) and (Schema, record.schema_id) in doubtful))


_CHANNEL = struct.Struct('<H')
# Where the entries of a message index begin.
_ENTRIES = 6
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
            refuse_pointer(read_at(stream, 0, 32), self.name, RecordingError)
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
            head = chunk_head(read_content(stream, chunk._replace(length=min(chunk.length, HEAD))))
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
