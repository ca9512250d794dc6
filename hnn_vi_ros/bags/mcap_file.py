# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The messages of an MCAP file, finished, cut off or damaged."""

from array import array
from collections.abc import Iterable, Iterator
from enum import IntEnum
from pathlib import Path
import struct
from typing import BinaryIO, final

from hnn_vi_ros.bags.bag_metadata import DEFINITIONS, described_channels
from hnn_vi_ros.bags.bag_source import Piece, Source
from hnn_vi_ros.bags.mcap_records import (
    chunk_head, decode, Frame, read_content, records_in, unpack)
from hnn_vi_ros.bags.mcap_survey import Indexed, Survey, survey
from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files.lfs_pointer import refuse_pointer
from hnn_vi_ros.files.regular_file import open_file
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, McapRecord, Message, Schema
import numpy as np

_CHANNEL = struct.Struct('<H')
# Where the entries of a message index begin.
_ENTRIES = 6
# Records in chunks, over the size of the file and beside so many: of messages without content
# whose stamps are even, zstd packs 1.4 into a byte; of those that are equal in all, 350.
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
        What the file holds.

    Raises
    ------
    RecordingError
        It is no MCAP file.
    OSError
        It cannot be read.

    """

    def __init__(self, path: Path, name: Path, thorough: bool = False):
        super().__init__(path, name)
        self._left = _PER_BYTE * path.stat().st_size + _AT_LEAST
        # How many records each chunk that was opened might hold then.
        self._most: dict[int, int] = {}
        with open_file(path, name) as stream:
            self.survey: Survey = survey(stream)
            if not self.survey.is_mcap:
                stream.seek(0)
                refuse_pointer(stream.read(32), name, RecordingError)
                reason = 'it does not begin like one' if path.stat().st_size else 'it is empty'
                raise RecordingError(f'{name}: no MCAP file: {reason}; give a bag or its file')
            for gap in self.survey.gaps:
                if gap.incomplete:
                    self.incomplete += gap.end - gap.start
                else:
                    self.unread[gap.start] = gap.end - gap.start
            self._numbers = set(self.survey.numbers)
            if not thorough:
                self._take(self.survey.definitions)
            for indexed in self.survey.chunks:
                self._add_chunk(stream, indexed, thorough)
        # What has no checksum comes last.
        self._take(self.survey.definitions + self.survey.repeated)
        if not self._numbers <= self.channels.keys() and self.metadata(DEFINITIONS):
            for record in reversed(self.survey.metadata):
                if record.name == 'rosbag2':
                    self._take(described_channels(record.metadata, self.metadata(DEFINITIONS)))
        # Of unknown channels, beside chunks that are all there, they are damaged indexes.
        believed = not self.survey.complete or self.survey.numbers <= self.channels.keys()
        self.pieces = sorted(self.pieces + self.survey.runs * believed,
                             key=lambda piece: piece.start)

    def read(self, piece: Piece) -> Iterator[Message]:
        """See Source."""
        with open_file(self.path, self.name) as stream:
            records, sound = self._open(stream, piece)
        for record in records:
            if isinstance(record, Message):
                if record.channel_id in self.channels:
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

    def _add_chunk(self, stream: BinaryIO, indexed: Indexed, thorough: bool) -> None:
        chunk = indexed.chunk
        kind = _Kind.CHUNK if chunk.whole else _Kind.BROKEN_CHUNK
        self.incomplete += 0 if chunk.whole else chunk.length
        times = None if thorough or not chunk.whole else self._trusted(stream, indexed)
        if times is None:
            piece = Piece(0, 0, chunk.start, chunk.length, kind)
            records, sound = self._open(stream, piece)
            if not sound:
                self.unread[chunk.start] = chunk.length
            found = array('Q')
            for record in records:
                if isinstance(record, Message):
                    self._numbers.add(record.channel_id)
                    found.append(record.log_time)
                else:
                    self._take([record])
            if not found:
                return
            times = min(found), max(found)
        self.pieces.append(Piece(*times, chunk.start, chunk.length, kind))

    def _trusted(self, stream: BinaryIO, indexed: Indexed) -> tuple[int, int] | None:
        """Return the times of a chunk, if it and its indexes agree and know all channels."""
        times, numbers = [], set()
        for frame in indexed.indexes:
            content = read_content(stream, frame)
            numbers.add(_CHANNEL.unpack_from(content)[0])
            times.append(np.frombuffer(content, '<u8', offset=_ENTRIES)[::2])
        head = chunk_head(read_content(stream, indexed.chunk._replace(
            length=min(indexed.chunk.length, 64))))
        if head is None or not any(len(some) for some in times) \
                or not numbers <= self.channels.keys():
            return None
        found = np.concatenate(times)
        agreed = (head.first, head.last) == (int(found.min()), int(found.max()))
        return (head.first, head.last) if agreed else None

    def _take(self, records: Iterable[McapRecord]) -> None:
        for record in records:
            if isinstance(record, Schema):
                self.schemas.setdefault(record.id, record)
            elif isinstance(record, Channel):
                self.channels.setdefault(record.id, record)

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
