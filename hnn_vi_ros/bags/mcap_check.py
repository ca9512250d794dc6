# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Check every byte of a finished MCAP file that a checksum or another byte speaks for."""

import os
import struct
from typing import BinaryIO
import zlib

from hnn_vi_ros.bags.mcap_file import McapFile
from hnn_vi_ros.bags.mcap_frames import Gap, walk
from hnn_vi_ros.bags.mcap_records import (
    chunk_head, decode, MAGIC, MESSAGE, PREFIX, read_content, unpack)
from hnn_vi_ros.bags.mcap_survey import Indexed, Survey
from mcap.opcode import Opcode
from mcap.records import DataEnd, Footer

_BLOCK = 2**20
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
        and _framed(stream) and _counts(file.survey) and _summary_crc(stream, file.survey) \
        and all(_agrees(stream, indexed) for indexed in file.survey.chunks)


def data_crc_holds(stream: BinaryIO, survey: Survey) -> bool:
    """Return whether the data are as they were written, header and metadata too, where known."""
    stream.seek(survey.end)
    data_end = decode(Opcode.DATA_END, stream.read(_CRC.size))
    return isinstance(data_end, DataEnd) and data_end.data_section_crc in (
        0, _crc(stream, 0, survey.end - PREFIX.size))


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


def _summary_crc(stream: BinaryIO, survey: Survey) -> bool:
    footer = survey.footer
    end = os.fstat(stream.fileno()).st_size - len(MAGIC) - _CRC.size
    begin = footer.summary_start if footer else 0
    data_end = survey.end + _CRC.size
    return isinstance(footer, Footer) and begin in (0, data_end) and footer.summary_crc in (
        0, _crc(stream, data_end, end))


def _crc(stream: BinaryIO, start: int, end: int) -> int:
    stream.seek(start)
    found, left = 0, end - start
    while left > 0 and (block := stream.read(min(left, _BLOCK))):
        found, left = zlib.crc32(block, found), left - len(block)
    return found


def _agrees(stream: BinaryIO, indexed: Indexed) -> bool:
    """Return whether the times and the indexes of a chunk are those of its messages."""
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
