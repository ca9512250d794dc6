# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Read the messages of a bag in the order of their times, even if it is unfinished or damaged."""

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import final, NamedTuple

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files import in_bytes
from hnn_vi_ros.recording.bags.bag_files import bag_files, digest_of, open_sources
from hnn_vi_ros.recording.bags.bag_metadata import metadata_message_count
from hnn_vi_ros.recording.bags.mcap_file import (
    MAX_RECORD_SIZE, McapFile, MessagePart, UnpackLimit)
from mcap.records import Channel, Schema
import zstandard

_ZSTD = b'\x28\xb5\x2f\xfd'
# Maximum size of messages buffered for sorting, equal to a few of the largest chunks; and overhead
# per message [bytes].
_MAX_BUFFERED, _MESSAGE_OVERHEAD = 2**30, 160


class RecordedMessage(NamedTuple):
    """
    One message of a bag.

    Parameters
    ----------
    time : int
        Log time [ns].
    channel : int
        Number of its channel.
    data : bytes
        Serialised message.

    """

    time: int
    channel: int
    data: bytes


class _Part(NamedTuple):
    """A piece of a file, with the map from its channel numbers to the reader's."""

    piece: MessagePart
    source: McapFile
    numbers: dict[int, int]


@final
class BagReader:
    """
    A bag: finished, truncated or damaged; only its outline is held in memory.

    It is one file in MCAP, or several split by rosbag2, possibly compressed as files or
    message by message. Channels of one topic in several files are merged.

    Parameters
    ----------
    bag : Path
        Folder with the files of one bag, or one file.

    Attributes
    ----------
    path : Path
        Path of the file, or of the folder if there are several.
    channels : dict of int to Channel
        Topic, encoding and metadata of each channel.
    schemas : dict of int to Schema
        Name and definition of each type.
    first, last : int
        Earliest and latest log time [ns]; 0 in a bag without messages.

    Raises
    ------
    RecordingError
        It is not a bag, or cannot be read.

    """

    def __init__(self, bag: Path):
        files = bag_files(bag)
        self.path = files[0] if len(files) == 1 else bag
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self._files, self._parts = files, list[_Part]()
        try:
            self._sources, self._copies = open_sources(files)
            self._allowance = UnpackLimit(self.path, sum(path.stat().st_size for path in files))
        except OSError as problem:
            raise RecordingError(f'{self.path}: cannot be read ({problem.strerror or problem}); '
                                 'give the folder of a bag, or its file') from problem
        for source in self._sources:
            numbers = self._join(source)
            self._parts += [_Part(piece, source, numbers) for piece in source.pieces]
        self._parts.sort(key=lambda part: part.piece.first)
        self.first = min((part.piece.first for part in self._parts), default=0)
        self.last = max((part.piece.last for part in self._parts), default=0)

    @property
    def damage(self) -> str:
        """Describe the parts that could not be read; '' if there are none."""
        found = []
        if places := [(source, start) for source in self._sources
                      for start in sorted(source.unread)]:
            size = sum(source.unread[start] for source, start in places)
            source, start = places[0]
            found.append(f'{source.path}: {len(places)} damaged parts, {size} bytes, cannot be '
                         f'read, the first at byte {start}: their content is missing')
        found += [f'{source.path}: contains {source.message_count} messages, but its summary or '
                  f'indexes count {source.counted}' for source in self._sources
                  if source.counted not in (None, source.message_count)]
        found += [f'{source.path}: its header or metadata differ from the recorded ones '
                  '(wrong checksum)' for source in self._sources
                  if source.altered and not source.unread]
        message_count = sum(source.message_count for source in self._sources)
        counted = metadata_message_count(self._files[0].parent,
                                         [path.name for path in self._files])
        # Recorders write the counts only at the end.
        if counted and counted != message_count and not found:
            found.append(f'{self.path}: contains {message_count} messages, but its metadata.yaml '
                         f'counts {counted}')
        return '; '.join(found)

    def digest(self) -> str:
        """Return the SHA-256 of the files."""
        return digest_of(self._files)

    def attachment(self, name: str) -> bytes | None:
        """Return an attachment of the bag by name; None if it does not exist."""
        found = (source.attachment(name) for source in self._sources)
        return next((data for data in found if data is not None), None)

    def metadata(self, name: str) -> dict[str, str]:
        """Return the newest metadata with a name; empty if it does not exist."""
        found = [source.metadata(name) for source in self._sources]
        return next(filter(None, reversed(found)), {})

    def messages(self, channels: Collection[int] | None = None, first: int = 0,
                 last: int = 2**64 - 1) -> Iterator[RecordedMessage]:
        """
        Yield messages in the order of their log times; equal times in the order of recording.

        Parameters
        ----------
        channels : collection of int, optional
            Channels to read; all by default.
        first, last : int
            Minimum and maximum log time [ns].

        """
        wanted = self.channels.keys() if channels is None else frozenset(channels)
        parts = [part for part in self._parts
                 if part.piece.last >= first and part.piece.first <= last]
        buffered: list[RecordedMessage] = []
        size = 0
        for i, part in enumerate(parts):
            for message in self._read(part, wanted):
                if first <= message.time <= last:
                    buffered.append(message)
                    size += len(message.data) + _MESSAGE_OVERHEAD
                if size > _MAX_BUFFERED:
                    raise RecordingError(
                        f'{self.path}: its messages are too far out of order: sorting them '
                        f'needs more than {in_bytes(_MAX_BUFFERED)} of memory; run `mcap sort` '
                        'on it')
            buffered.sort(key=lambda message: message.time)
            # Hold messages back that a later piece may precede.
            until = parts[i + 1].piece.first if i + 1 < len(parts) else 2**64
            place = 0
            while place < len(buffered) and buffered[place].time < until:
                size -= len(buffered[place].data) + _MESSAGE_OVERHEAD
                yield buffered[place]
                place += 1
            del buffered[:place]

    def _read(self, part: _Part, wanted: Collection[int]) -> Iterator[RecordedMessage]:
        """Yield the decompressed messages of a piece."""
        unpacked = 0
        for message in part.source.read(part.piece):
            number = part.numbers[message.channel_id]
            if number not in wanted:
                continue
            data: bytes | None = message.data
            # An uncompressed message starts with its encoding, 00 .. in CDR.
            if message.data.startswith(_ZSTD) and self.channels[number].message_encoding == 'cdr':
                data, size = _unpack_message(message.data)
                unpacked += size
                self._allowance.spend(id(part), unpacked)
            if data is None:
                part.source.unread[part.piece.start] = len(message.data)
            else:
                yield RecordedMessage(message.log_time, number, data)

    def _join(self, source: McapFile) -> dict[int, int]:
        """Add the channels of a file; return their numbers in this reader."""
        known = {self._key(channel, self.schemas): number
                 for number, channel in self.channels.items()}
        numbers = {}
        for number, channel in source.channels.items():
            key = self._key(channel, source.schemas)
            if key not in known:
                known[key] = len(self.channels) + 1
                schema = source.schemas.get(channel.schema_id)
                if schema is not None:
                    self.schemas[known[key]] = schema
                self.channels[known[key]] = Channel(
                    id=known[key], topic=channel.topic, schema_id=known[key],
                    message_encoding=channel.message_encoding, metadata=channel.metadata)
            numbers[number] = known[key]
        return numbers

    @staticmethod
    def _key(channel: Channel, schemas: dict[int, Schema]) -> tuple[str, str, str]:
        schema = schemas.get(channel.schema_id)
        return channel.topic, channel.message_encoding, schema.name if schema else ''


def _unpack_message(data: bytes) -> tuple[bytes | None, int]:
    """Decompress a message, None if it is damaged or too large; return it and the bytes made."""
    size = 0
    try:
        size = zstandard.get_frame_parameters(data).content_size
        if size > MAX_RECORD_SIZE and size != zstandard.CONTENTSIZE_UNKNOWN:
            return None, 0
        found = zstandard.ZstdDecompressor().decompress(data, max_output_size=MAX_RECORD_SIZE)
        return found, len(found)
    except zstandard.ZstdError:
        return None, min(size, MAX_RECORD_SIZE)
