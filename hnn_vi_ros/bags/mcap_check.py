# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Check every byte of a finished MCAP file that a checksum or another byte speaks for."""

import os
import struct
from typing import BinaryIO

from hnn_vi_ros.bags.mcap_definitions import Definitions
from hnn_vi_ros.bags.mcap_file import McapFile
from hnn_vi_ros.bags.mcap_frames import Gap, walk
from hnn_vi_ros.bags.mcap_records import (
    chunk_head, crc_of, decode, MAGIC, MESSAGE, PREFIX, read_content, unpack)
from hnn_vi_ros.bags.mcap_survey import Indexed, Survey
from mcap.opcode import Opcode
from mcap.records import DataEnd

_CRC = struct.Struct('<I')


def is_finished(stream: BinaryIO, file: McapFile, messages: int) -> bool:
    """
    Return whether an MCAP file is finished, and undamaged where nothing else would show damage.

    Parameters
    ----------
    stream : BinaryIO
        The file.
    file : McapFile
        The same, opened thoroughly.
    messages : int
        How many messages can be read.

    """
    statistics = file.survey.statistics
    return statistics is not None and statistics.message_count == messages \
        and not file.unread and not file.incomplete \
        and _framed(stream) and _counts(file.survey) and _summarised(file.survey) \
        and not _defined_twice(file) and not contradicted(stream, file.survey)


def contradicted(stream: BinaryIO, survey: Survey) -> int:
    """Return how many chunks have indexes that do not match their messages."""
    return sum(not _agrees(stream, indexed) for indexed in survey.chunks)


def data_crc_holds(stream: BinaryIO, survey: Survey) -> bool:
    """Return whether the data are unchanged, header and metadata too, where known."""
    stream.seek(survey.end)
    data_end = decode(Opcode.DATA_END, stream.read(_CRC.size))
    return isinstance(data_end, DataEnd) and data_end.data_section_crc in (
        0, crc_of(stream, 0, survey.end - PREFIX.size))


def _framed(stream: BinaryIO) -> bool:
    """Return whether records follow one another between two magics, with nothing else."""
    size, end = os.fstat(stream.fileno()).st_size, len(MAGIC)
    for frame in walk(stream, size):
        if isinstance(frame, Gap):
            return False
        stream.seek(frame.start - PREFIX.size)
        if PREFIX.unpack(stream.read(PREFIX.size)) != (frame.opcode, frame.length):
            return False
        end = frame.end
    stream.seek(0)
    begin = stream.read(len(MAGIC))
    stream.seek(end)
    return frame.opcode == Opcode.FOOTER and begin == stream.read() == MAGIC


def _counts(survey: Survey) -> bool:
    """Return whether the statistics count what there is."""
    statistics = survey.statistics
    return (statistics.chunk_count, statistics.attachment_count, statistics.metadata_count) == (
        len(survey.chunks), len(survey.attachments), len(survey.metadata))


def _defined_twice(file: McapFile) -> bool:
    """Return whether a schema or a channel is defined otherwise than it is believed."""
    return Definitions([*file.schemas.values(), *file.channels.values(),
                        *file.survey.definitions, *file.survey.repeated]).contradicted


def _summarised(survey: Survey) -> bool:
    """Return whether there is a footer, and what it says of the summary is so."""
    footer = survey.footer
    return footer is not None and survey.summary is not False and footer.summary_start in (
        0, survey.end + _CRC.size)


def _agrees(stream: BinaryIO, indexed: Indexed) -> bool:
    """Return whether the times and the indexes of a chunk match its messages."""
    content = read_content(stream, indexed.chunk)
    head, messages = chunk_head(content), _messages(unpack(content, True)[0])
    times = [time for some in messages.values() for time, _ in some]
    if times and (head.first, head.last) != (min(times), max(times)):
        return False
    indexes = [decode(frame.opcode, read_content(stream, frame)) for frame in indexed.indexes]
    listed = [(index.channel_id, sorted(index.records)) for index in indexes if index.records]
    return not indexes or sorted(listed) == sorted(messages.items())


def _messages(data: bytes) -> dict[int, list[tuple[int, int]]]:
    """Return time and place of each message among unpacked records, by channel."""
    found: dict[int, list[tuple[int, int]]] = {}
    place = 0
    while place < len(data):
        opcode, length = PREFIX.unpack_from(data, place)
        if opcode == Opcode.MESSAGE:
            channel, time = MESSAGE.unpack_from(data, place + PREFIX.size)
            found.setdefault(channel, []).append((time, place))
        place += PREFIX.size + length
    return {channel: sorted(some) for channel, some in found.items()}
