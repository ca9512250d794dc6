# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Make an MCAP bag whole whose recording was interrupted."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
import fcntl
import os
from pathlib import Path
import shutil
import tempfile
from typing import Any, BinaryIO

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.sinks.bag_metadata import bag_metadata, NEVER, Topic, write_bag_metadata
from hnn_vi_ros.sinks.mcap_records import (
    check_magic, data_frames, decode, MAGIC, read_content, records_in, unpack)
from hnn_vi_ros.yaml_text import dump_yaml, parse_mapping
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Header, McapRecord, Message, Metadata, Schema
from mcap.summary import Summary
from mcap.writer import CompressionType, Writer

_CHUNK_SIZE = 256 * 1024


@dataclass
class Recovery:
    """
    What a file holds once it is whole.

    Parameters
    ----------
    path : Path
        The MCAP file.
    messages : int
        Complete messages.
    first, last : int
        Earliest and latest log time [ns].
    changed : bool
        Whether the file was written anew.
    described : bool
        Whether metadata.yaml was written.
    damaged : int
        Chunks that could not be read, or not to their end.

    """

    path: Path
    messages: int = 0
    first: int = NEVER
    last: int = 0
    changed: bool = False
    described: bool = False
    damaged: int = 0

    @property
    def seconds(self) -> float:
        """Return the time from the first message to the last [s]."""
        return (self.last - self.first) * 1e-9 if self.messages else 0.0


def bag_file(bag: Path) -> Path:
    """Return the MCAP file that is a bag, or its only one; RecordingError if there is none."""
    if not bag.is_dir():
        return bag
    files = sorted(bag.glob('*.mcap'))
    if len(files) != 1:
        found = f'{len(files)} of them; give one of them' if files else 'none'
        raise RecordingError(f'{bag}: expected a folder with one .mcap file, found {found}')
    return files[0]


def recover(bag: Path) -> Recovery:
    """
    Make a bag whole: indexes, summary and footer of its file, and its metadata.yaml.

    What is whole already stays as it is. The file is replaced by a whole one in one stroke, once
    that is on the disk; whatever goes wrong before leaves it as it was.

    Parameters
    ----------
    bag : Path
        A folder with one MCAP file, or the file.

    Raises
    ------
    RecordingError
        It is no MCAP file, it is being recorded, or nothing can be written beside it.

    """
    path = bag_file(bag)
    try:
        with path.open('rb') as stream, _not_being_recorded(stream, path):
            check_magic(stream, path)
            recovery = _whole(stream, path)
            if recovery is None:
                recovery = _write_anew(stream, path)
            folder = path.parent
            # A file that is one of many, or lies anywhere, is no bag by itself.
            is_bag = bag.is_dir() or path.name == f'{folder.absolute().name}_0.mcap'
            if is_bag and (recovery.changed or not (folder / 'metadata.yaml').exists()):
                with path.open('rb') as whole:
                    write_bag_metadata(folder, _describe(path, _summary(whole), _origin(whole)))
                recovery.described = True
            return recovery
    except OSError as problem:
        raise RecordingError(
            f'{path}: cannot be made whole ({problem.strerror or problem}); it is left as it is; '
            'give a file that exists, in a folder that can be written, with room for a second '
            'one') from problem


@contextmanager
def _not_being_recorded(stream: BinaryIO, path: Path) -> Iterator[None]:
    """Hold the file against a second recovery; refuse it while a recorder holds it."""
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as problem:
        raise RecordingError(f'{path}: is still being recorded; stop that first') from problem
    except OSError:
        # A file system without locks: the recorder could not hold it either.
        pass
    yield


def _whole(stream: BinaryIO, path: Path) -> Recovery | None:
    """Return what a file holds that is whole; None of one that is not."""
    summary = _summary(stream)
    if summary is None or summary.statistics is None:
        return None
    found = summary.statistics
    return Recovery(path, found.message_count, found.message_start_time, found.message_end_time)


def _summary(stream: BinaryIO) -> Summary | None:
    """Return the summary of a file that ends as it should."""
    try:
        stream.seek(-len(MAGIC), os.SEEK_END)
        if stream.tell() < len(MAGIC) or stream.read() != MAGIC:
            return None
        stream.seek(0)
        return make_reader(stream, validate_crcs=True).get_summary()
    except (McapError, ValueError):
        return None


def _write_anew(stream: BinaryIO, path: Path) -> Recovery:
    """Write what can be read of a file into another, which then takes its place."""
    handle, name = tempfile.mkstemp(prefix=f'.{path.name}.', suffix='.tmp', dir=path.parent)
    temporary = Path(name)
    try:
        with os.fdopen(handle, 'wb') as target:
            recovery = _Copy(target, path).fill(stream)
            target.flush()
            os.fsync(target.fileno())
        shutil.copymode(path, temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    return recovery


class _Copy:
    """A whole file that takes the records of one that breaks off, in their order."""

    def __init__(self, target: BinaryIO, path: Path):
        self._writer = Writer(target, chunk_size=_CHUNK_SIZE, compression=CompressionType.ZSTD)
        self._started = False
        self._schemas: dict[int, tuple[Schema, int]] = {}
        self._channels: dict[int, tuple[Channel, int]] = {}
        self._counts: dict[int, int] = {}
        self._distro = 'jazzy'
        self._recovery = Recovery(path, changed=True)

    def fill(self, stream: BinaryIO) -> Recovery:
        """Take all records of a stream that can be read, and complete the file."""
        end = os.fstat(stream.fileno()).st_size
        for frame in data_frames(stream, len(MAGIC), end):
            content = read_content(stream, frame)
            if frame.opcode == Opcode.CHUNK:
                data, all_there = unpack(content, frame.whole)
                self._recovery.damaged += not all_there
                for record in records_in(data):
                    self._take(record)
            elif frame.whole:
                self._take(decode(frame.opcode, content))
        if not self._started:
            self._take(Header('ros2', ''))
        self._add_bag_metadata()
        self._writer.finish()
        return self._recovery

    def _take(self, record: McapRecord | None) -> None:
        writer = self._writer
        if isinstance(record, Header) and not self._started:
            writer.start(record.profile, record.library)
            self._started = True
        elif isinstance(record, Schema) and record.id not in self._schemas:
            new = writer.register_schema(record.name, record.encoding, record.data)
            self._schemas[record.id] = record, new
        elif isinstance(record, Channel) and record.id not in self._channels:
            self._add_channel(record)
        elif isinstance(record, Message) and record.channel_id in self._channels:
            self._add_message(record)
        elif isinstance(record, Attachment):
            writer.add_attachment(record.create_time, record.log_time, record.name,
                                  record.media_type, record.data)
        elif isinstance(record, Metadata):
            writer.add_metadata(record.name, record.metadata)
            self._distro = _distro(record) or self._distro

    def _add_channel(self, record: Channel) -> None:
        # Of schema 0 there is none.
        _, schema = self._schemas.get(record.schema_id, (None, 0))
        new = self._writer.register_channel(
            record.topic, record.message_encoding, schema, record.metadata)
        self._channels[record.id] = record, new

    def _add_message(self, record: Message) -> None:
        recovery = self._recovery
        self._writer.add_message(self._channels[record.channel_id][1], record.log_time,
                                 record.data, record.publish_time, record.sequence)
        self._counts[record.channel_id] = self._counts.get(record.channel_id, 0) + 1
        recovery.messages += 1
        recovery.first = min(recovery.first, record.log_time)
        recovery.last = max(recovery.last, record.log_time)

    def _add_bag_metadata(self) -> None:
        """Say at the end what the bag holds, as its recorder would have done."""
        topics = [_topic(channel, self._schemas.get(channel.schema_id, (None, 0))[0])
                  for channel, _ in self._channels.values()]
        counts = [self._counts.get(number, 0) for number in self._channels]
        recovery = self._recovery
        metadata = bag_metadata(recovery.path.name, topics, counts, recovery.first,
                                recovery.last, self._distro)
        self._writer.add_metadata('rosbag2', {'serialized_metadata': dump_yaml(metadata)})


def _describe(path: Path, summary: Summary, distro: str) -> dict[str, Any]:
    """Return what metadata.yaml says of a whole file."""
    found = summary.statistics
    channels = summary.channels.values()
    topics = [_topic(channel, summary.schemas.get(channel.schema_id)) for channel in channels]
    counts = [found.channel_message_counts.get(channel.id, 0) for channel in channels]
    return bag_metadata(path.name, topics, counts, found.message_start_time,
                        found.message_end_time, distro)


def _origin(stream: BinaryIO) -> str:
    """Return the ROS distribution that a whole file names."""
    stream.seek(0)
    named = [_distro(record) for record in make_reader(stream).iter_metadata()]
    return next(filter(None, named), 'jazzy')


def _topic(channel: Channel, schema: Schema | None) -> Topic:
    about = channel.metadata
    return Topic(channel.topic, schema.name if schema else '',
                 schema.data.decode(errors='replace') if schema else '',
                 about.get('topic_type_hash', ''), about.get('offered_qos_profiles') or '[]')


def _distro(record: Metadata) -> str:
    """Return the ROS distribution that rosbag2's record names; empty if it is none."""
    if record.name != 'rosbag2':
        return ''
    try:
        described, _ = parse_mapping(record.metadata.get('serialized_metadata', ''),
                                     'serialized_metadata', RecordingError)
    except RecordingError:
        return ''
    return str(described.get('ros_distro', ''))
