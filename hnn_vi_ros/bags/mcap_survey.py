# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Survey of an MCAP file: its content, places and definitions, without opening its chunks."""

from collections.abc import Iterable
from dataclasses import dataclass, field
import os
from typing import Any, BinaryIO, NamedTuple

from hnn_vi_ros.bags.bag_source import Piece
from hnn_vi_ros.bags.mcap_records import (
    crc_of, decode, Frame, Gap, is_another_kind, is_consistent, MAGIC, MESSAGE, PREFIX,
    read_content, walk)
from mcap.opcode import Opcode
from mcap.records import Channel, Footer, Header, McapRecord, Metadata, Schema, Statistics

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
    private : int
        Bytes of records whose kind is not known.
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
    private: int = 0
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
    stream.seek(0)
    found = Survey(stream.read(len(MAGIC)) == MAGIC, size)
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
    stream.seek(max(0, begin - len(MAGIC)))
    if begin > len(MAGIC) and stream.read(len(MAGIC)) == MAGIC and found.is_mcap:
        return begin - len(MAGIC)
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
        found.private += frame.length
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
