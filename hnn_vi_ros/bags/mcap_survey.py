# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Content of an MCAP file and its places, found without opening its chunks."""

from dataclasses import dataclass, field
import os
from typing import BinaryIO, NamedTuple

from hnn_vi_ros.bags.bag_source import Piece
from hnn_vi_ros.bags.mcap_frames import Gap, walk
from hnn_vi_ros.bags.mcap_records import decode, Frame, MAGIC, MESSAGE, PREFIX, read_content
from mcap.opcode import Opcode
from mcap.records import Channel, Footer, Header, McapRecord, Metadata, Schema, Statistics

# Messages outside of chunks are read together up to so many bytes.
_PIECE = 2**18
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

    """

    begins: bool
    end: int
    header: Header | None = None
    statistics: Statistics | None = None
    footer: Footer | None = None
    chunks: list[Indexed] = field(default_factory=list)
    runs: list[Piece] = field(default_factory=list)
    messages: int = 0
    numbers: set[int] = field(default_factory=set)
    attachments: list[Frame] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)
    definitions: list[Schema | Channel] = field(default_factory=list)
    repeated: list[Schema | Channel] = field(default_factory=list)
    gaps: list[Gap] = field(default_factory=list)
    private: int = 0

    @property
    def is_mcap(self) -> bool:
        """Return whether this is an MCAP file, by its magic or by what no other file holds."""
        return bool(self.begins or self.header or self.chunks or self.attachments)

    @property
    def complete(self) -> bool:
        """Return whether all is there that the statistics count, messages in chunks aside."""
        count = self.statistics
        if count is None or (count.chunk_count, count.attachment_count, count.metadata_count) != (
                len(self.chunks), len(self.attachments), len(self.metadata)):
            return False
        return bool(self.chunks) or count.message_count == self.messages

    def forgive(self) -> None:
        """Forget what is damaged where nothing is lost: after the data, or if all is there."""
        self.gaps = [gap for gap in self.gaps if not self.complete and gap.start < self.end]


def survey(stream: BinaryIO) -> Survey:
    """Return what a file holds; its position does not count."""
    size = os.fstat(stream.fileno()).st_size
    stream.seek(0)
    found = Survey(stream.read(len(MAGIC)) == MAGIC, size)
    for frame in walk(stream, size):
        if isinstance(frame, Gap):
            found.gaps.append(frame)
            continue
        if frame.opcode in _DATA:
            # An end of the data that came before was none.
            found.end = size
            found.definitions += found.repeated
            found.repeated.clear()
        _add(found, stream, frame)
    found.forgive()
    return found


def _add(found: Survey, stream: BinaryIO, frame: Frame) -> None:
    opcode = frame.opcode
    if opcode == Opcode.CHUNK:
        found.chunks.append(Indexed(frame, []))
    elif opcode == Opcode.MESSAGE_INDEX:
        if found.chunks:
            found.chunks[-1].indexes.append(frame)
    elif opcode == Opcode.MESSAGE:
        stream.seek(frame.start)
        _add_message(found, frame, *MESSAGE.unpack(stream.read(MESSAGE.size)))
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
    elif isinstance(record, Statistics) and record.message_count == sum(
            record.channel_message_counts.values()):
        found.statistics = record


def _add_message(found: Survey, frame: Frame, channel: int, time: int) -> None:
    """Note a message outside of chunks: together with the one before it, if there is one."""
    found.messages += 1
    found.numbers.add(channel)
    start, length = frame.start - PREFIX.size, frame.length + PREFIX.size
    before = found.runs[-1] if found.runs else None
    if before and before.start + before.length == start and before.length < _PIECE:
        found.runs[-1] = Piece(min(before.first, time), max(before.last, time), before.start,
                               before.length + length)
    else:
        found.runs.append(Piece(time, time, start, length))
