# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Check an MCAP bag, and recover it if it was interrupted or damaged."""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
import fcntl
import os
from pathlib import Path
from typing import BinaryIO

from hnn_vi_ros.errors import listed, RecordingError
from hnn_vi_ros.files import dump_yaml, numbered_paths, open_regular, written
from hnn_vi_ros.recording.bags.bag_files import bag_files, is_sqlite
from hnn_vi_ros.recording.bags.bag_metadata import (
    bag_metadata, FileExtent, metadata_message_count, NEVER, read_description, Topic,
    write_bag_metadata)
from hnn_vi_ros.recording.bags.mcap_file import McapFile
from mcap.writer import CompressionType, Writer

_CHUNK_SIZE = 256 * 1024


@dataclass
class Recovery:
    """
    Content of a recovered file, and its losses.

    Parameters
    ----------
    path : Path
        Path of the MCAP file.
    messages : int
        Number of messages kept.
    first, last : int
        Earliest and latest log time [ns].
    changed : bool
        True if the file was rewritten.
    described : bool
        True if metadata.yaml was written.
    original : Path or None
        Path of the original file, if kept.
    incomplete : int
        Size of the truncated end of a recording [bytes]: its last second or less, not damage.
    damaged : int
        Number of unreadable parts.
    unread : int
        Size of the unreadable parts [bytes].
    altered : bool
        True if the header or metadata, which have no checksum, differ from the recording.
    fewer : int
        Number of lost messages, according to the counts in the file or in metadata.yaml.

    """

    path: Path
    messages: int = 0
    first: int = NEVER
    last: int = 0
    changed: bool = False
    described: bool = False
    original: Path | None = None
    incomplete: int = 0
    damaged: int = 0
    unread: int = 0
    altered: bool = False
    fewer: int = 0

    @property
    def lost(self) -> bool:
        """Return whether recorded data are lost, or possibly lost."""
        return bool(self.damaged or self.altered or self.fewer)

    @property
    def seconds(self) -> float:
        """Return the time between the first and the last message [s]."""
        return (self.last - self.first) * 1e-9 if self.messages else 0.0


def recover(bag: Path, replace: bool = False) -> Recovery:
    """
    Recover a bag: indexes, summary and footer of its file, and its metadata.yaml.

    An intact bag is not changed. Otherwise all readable data are written to a new file next to it,
    which is read back and then replaces the bag atomically; an earlier failure changes nothing.
    Chunks with a wrong checksum are skipped.

    Parameters
    ----------
    bag : Path
        Folder with one MCAP file, or the file.
    replace : bool
        True to delete the original; otherwise it is kept as ``<file>.orig``.

    Raises
    ------
    RecordingError
        Nothing can be recovered, the bag is being recorded, or its folder cannot be written.

    """
    files = bag_files(bag)
    path = files[0]
    if len(files) > 1 or is_sqlite(path) or path.suffix == '.zstd':
        raise RecordingError(f'{bag}: expected one .mcap file, found '
                             f'{listed(file.name for file in files)}; give one, unpacked')
    try:
        with open_regular(path) as stream, _lock_recording(stream, path):
            file = McapFile(path, thorough=True)
            content = _Content(file)
            recovery = _compare_with_counts(file, content)
            if recovery.changed:
                _write_anew(file, content, recovery, replace)
            if (bag.is_dir() or _is_bag(path)) and (
                    recovery.changed or not (path.parent / 'metadata.yaml').exists()):
                write_bag_metadata(path.parent, content.described)
                recovery.described = True
            return recovery
    except OSError as problem:
        raise RecordingError(
            f'{path}: cannot be repaired ({problem.strerror or problem}); it is unchanged; give '
            'an existing file, in a writable folder with space for a second one') from problem


class _Content:
    """Counts of the messages of a file by channel, and their extent; it reads all messages."""

    def __init__(self, file: McapFile):
        self.counts = Counter[int]()
        first, last = NEVER, 0
        for message in file.messages():
            self.counts[message.channel_id] += 1
            first, last = min(first, message.log_time), max(last, message.log_time)
        self.extent = FileExtent(file.path.name, self.counts.total(), first, last)
        topics = []
        for channel in file.channels.values():
            schema, about = file.schemas.get(channel.schema_id), channel.metadata
            topics.append(Topic(
                channel.topic, schema.name if schema else '',
                schema.data.decode(errors='replace') if schema else '',
                about.get('topic_type_hash', ''), about.get('offered_qos_profiles') or '[]'))
        named = _description(file)
        self.described = bag_metadata(
            [self.extent], topics, [self.counts[number] for number in file.channels],
            str(named.get('ros_distro') or 'jazzy'))


def _description(file: McapFile) -> dict[str, object]:
    """Return the newest description by rosbag2 in a file."""
    return read_description(file.metadata('rosbag2').get('serialized_metadata', ''))


@contextmanager
def _lock_recording(stream: BinaryIO, path: Path) -> Iterator[None]:
    """Lock the file against a second recovery; raise an error if a recorder has locked it."""
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as problem:
        raise RecordingError(f'{path}: is still being recorded; stop the recorder '
                             'first') from problem
    except OSError:
        # The file system has no locks, so a recorder has none either.
        pass
    yield


def _compare_with_counts(file: McapFile, content: _Content) -> Recovery:
    """Compare the readable messages with the counts; raise an error if there are none."""
    messages = content.extent.messages
    recovery = Recovery(file.path, *content.extent[1:])
    recovery.altered = file.altered
    recovery.incomplete = file.incomplete
    recovery.damaged, recovery.unread = len(file.unread), sum(file.unread.values())
    described = _description(file).get('message_count')
    counts = [file.counted, metadata_message_count(file.path.parent, [file.path.name]),
              described if type(described) is int else 0]
    recovery.fewer = max(0, *(count - messages for count in counts if count is not None))
    recovery.changed = not file.finished or file.counted != messages or recovery.lost
    if not messages and (recovery.lost or not file.all_metadata):
        raise RecordingError(
            f'{file.path}: nothing can be recovered: no message in {file.path.stat().st_size} '
            'bytes can be read; it is unchanged')
    return recovery


def _write_anew(file: McapFile, content: _Content, recovery: Recovery, replace: bool) -> None:
    """Write the readable content of a file to a new one, which then replaces it."""
    path = file.path.resolve()
    with written(path) as target:
        copy_messages(file, content, target)
        target.flush()
        _read_back(Path(target.name), recovery.messages)
        if not replace:
            recovery.original = _link_original(path)


def copy_messages(file: McapFile, content: _Content, target: BinaryIO) -> None:
    """Write a complete file with the channels, messages, attachments and metadata of another."""
    writer = Writer(target, chunk_size=_CHUNK_SIZE, compression=CompressionType.ZSTD,
                    enable_data_crcs=True)
    header = file.header
    writer.start(header.profile if header else 'ros2', header.library if header else '')
    for record in file.all_metadata:
        writer.add_metadata(record.name, record.metadata)
    for attachment in file.attachments():
        writer.add_attachment(attachment.create_time, attachment.log_time, attachment.name,
                              attachment.media_type, attachment.data)
    # Schema 0 means that there is no schema.
    schemas = {0: 0} | {
        number: writer.register_schema(schema.name, schema.encoding, schema.data)
        for number, schema in file.schemas.items()}
    channels = {number: writer.register_channel(
        channel.topic, channel.message_encoding, schemas.get(channel.schema_id, 0),
        channel.metadata) for number, channel in file.channels.items()}
    for message in file.messages():
        writer.add_message(channels[message.channel_id], message.log_time, message.data,
                           message.publish_time, message.sequence)
    # Final description of the bag, as its recorder would have written it.
    writer.add_metadata('rosbag2', {'serialized_metadata': dump_yaml(content.described)})
    writer.finish()


def _read_back(path: Path, messages: int) -> None:
    """Read a written file back; raise RecordingError unless all messages are in it."""
    copy = McapFile(path, thorough=True)
    found = _compare_with_counts(copy, _Content(copy))
    if found.messages != messages or found.changed:
        raise RecordingError(f'{path}: the repaired file reads back with {found.messages} of '
                             f'{messages} messages; the bag is unchanged; check the disk')


def _link_original(path: Path) -> Path:
    """Hard-link a file to an unused name, and return that name."""
    for original in numbered_paths(path.with_name(f'{path.name}.orig')):
        try:
            os.link(path, original)
        except FileExistsError:
            continue
        except PermissionError:
            # The file system has no hard links.
            if original.exists():
                continue
            path.rename(original)
        break
    return original


def _is_bag(path: Path) -> bool:
    """Return whether a file is a complete bag in its own folder, not one of several files."""
    folder = path.parent
    try:
        return path.name == f'{folder.absolute().name}_0.mcap' and bag_files(folder) == [path]
    except RecordingError:
        # It is next to files that do not form one bag.
        return False
