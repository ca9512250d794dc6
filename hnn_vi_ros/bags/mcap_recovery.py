# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Check an MCAP bag and make it whole if it was interrupted or damaged."""

from array import array
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
import fcntl
import os
from pathlib import Path
import shutil
import struct
import tempfile
from typing import BinaryIO, NamedTuple

from hnn_vi_ros.bags.bag_files import bag_files
from hnn_vi_ros.bags.bag_metadata import (
    bag_metadata, counted_messages, Extent, NEVER, read_description, Topic, write_bag_metadata)
from hnn_vi_ros.bags.mcap_file import Definitions, Indexed, McapFile, Survey
from hnn_vi_ros.bags.mcap_records import (
    chunk_head, crc_of, decode, frames_in, Gap, MAGIC, MESSAGE, PREFIX, read_at, read_content,
    unpack, walk)
from hnn_vi_ros.errors import listed, RecordingError
from hnn_vi_ros.files.regular_file import numbered, open_file
from hnn_vi_ros.files.yaml_text import dump_yaml
from mcap.opcode import Opcode
from mcap.records import DataEnd, MessageIndex
from mcap.writer import CompressionType, Writer
import numpy as np

# Stamps are rounded to nanoseconds, and so are their differences.
_ROUNDING = 2
# Fewer differences, or fewer of them alike, are no grid.
_LEAST, _SHARE = 3, 0.5


class Missing(NamedTuple):
    """
    A gap in an even grid.

    Parameters
    ----------
    after, before : int
        The stamps around it [ns].
    count : int
        How many stamps are missing in between.

    """

    after: int
    before: int
    count: int  # type: ignore[assignment]  # not tuple.count


def missing_stamps(stamps: Sequence[int] | np.ndarray, spacing: int | None = None
                   ) -> list[Missing]:
    """
    Return the gaps in a grid, whose spacing is the most frequent difference if none is given.

    Stamps in between, as of single steps in a pause, are not asked for and no harm. Stamps of
    which less than half are evenly spaced have no gaps.

    Parameters
    ----------
    stamps : sequence of int
        In any order [ns].
    spacing : int, optional
        What lies between two of them at most [ns].

    """
    t = np.unique(np.asarray(stamps, dtype=np.uint64))
    differences = np.diff(t).astype(np.float64)
    usual = spacing or _frequent(differences)
    if usual is None:
        return []
    return [Missing(int(t[i]), int(t[i + 1]), round(differences[i] / usual) - 1)
            for i in np.flatnonzero(differences > 1.5 * usual)]


def _frequent(differences: np.ndarray) -> float | None:
    """Return the most frequent difference; None where less than half are that."""
    if len(differences) < _LEAST:
        return None
    values, counts = np.unique(differences, return_counts=True)
    spacing = float(values[np.argmax(counts)])
    even = np.abs(differences - spacing) <= _ROUNDING
    return spacing if even.sum() >= max(_LEAST, _SHARE * len(differences)) else None


def missing_in_all(topics: Sequence[Sequence[int]]) -> list[Missing]:
    """
    Return the gaps in the grid of a recording.

    Only topics that come about as often as the most frequent one count, and a gap is one only if
    none of them tells anything in it: commands, alarms and diagnostics come when they like.

    Parameters
    ----------
    topics : sequence of sequence of int
        The stamps of each topic [ns].

    """
    most = max(map(len, topics), default=0)
    frequent = [np.asarray(stamps, dtype=np.uint64) for stamps in topics
                if 2 * len(stamps) >= most]
    found = max(map(missing_stamps, frequent), default=[],
                key=lambda gaps: sum(gap.count for gap in gaps))
    if not found:
        return []
    every = np.unique(np.concatenate(frequent))
    return [gap for gap in found
            if np.searchsorted(every, gap.after, 'right') == np.searchsorted(every, gap.before)]


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
        and _framed(stream) and file.survey.counted and _summarised(file.survey) \
        and not _defined_twice(file) and not contradicted(stream, file.survey)


def contradicted(stream: BinaryIO, survey: Survey) -> int:
    """Return how many chunks have indexes that do not match their messages."""
    return sum(not _agrees(stream, indexed) for indexed in survey.chunks)


def data_crc_holds(stream: BinaryIO, survey: Survey) -> bool:
    """Return whether the data are unchanged, header and metadata too, where known."""
    data_end = decode(Opcode.DATA_END, read_at(stream, survey.end, _CRC.size))
    return isinstance(data_end, DataEnd) and data_end.data_section_crc in (
        0, crc_of(stream, 0, survey.end - PREFIX.size))


def _framed(stream: BinaryIO) -> bool:
    """Return whether records follow one another between two magics, with nothing else."""
    size, end, last = os.fstat(stream.fileno()).st_size, len(MAGIC), None
    for frame in walk(stream, size):
        if isinstance(frame, Gap):
            return False
        prefix = read_at(stream, frame.start - PREFIX.size, PREFIX.size)
        if PREFIX.unpack(prefix) != (frame.opcode, frame.length):
            return False
        end, last = frame.end, frame.opcode
    return last == Opcode.FOOTER and read_at(stream, 0, len(MAGIC)) == MAGIC == read_at(
        stream, end)


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
    if head is None or (times and (head.first, head.last) != (min(times), max(times))):
        return False
    indexes = [decode(frame.opcode, read_content(stream, frame)) for frame in indexed.indexes]
    listed = [(index.channel_id, sorted(index.records)) for index in indexes
              if isinstance(index, MessageIndex) and index.records]
    return not indexes or sorted(listed) == sorted(messages.items())


def _messages(data: bytes) -> dict[int, list[tuple[int, int]]]:
    """Return time and place of each message among unpacked records, by channel."""
    found = defaultdict[int, list[tuple[int, int]]](list)
    for opcode, start, _ in frames_in(data, len(data)):
        if opcode == Opcode.MESSAGE:
            channel, time = MESSAGE.unpack_from(data, start)
            found[channel].append((time, start - PREFIX.size))
    return {channel: sorted(some) for channel, some in found.items()}


_CHUNK_SIZE = 256 * 1024


Stamps = dict[int, 'array[int]']


def stamps_of(file: McapFile) -> Stamps:
    """Return the log times [ns] of the messages of each channel, in the order of the file."""
    stamps = {number: array('Q') for number in file.channels}
    for message in file.messages():
        stamps[message.channel_id].append(message.log_time)
    return stamps


def _extent(file: McapFile, stamps: Stamps) -> Extent:
    every = [*filter(None, stamps.values())]
    return Extent(file.name.name, sum(map(len, every)), min(map(min, every), default=NEVER),
                  max(map(max, every), default=0))


def copy_messages(file: McapFile, stamps: Stamps, target: BinaryIO) -> None:
    """
    Write a whole file with all channels, messages, attachments and metadata of another.

    Parameters
    ----------
    file : McapFile
        May break off, or be damaged.
    stamps : dict of int to array
        See ``stamps_of``.
    target : BinaryIO
        Empty.

    """
    writer = Writer(target, chunk_size=_CHUNK_SIZE, compression=CompressionType.ZSTD,
                    enable_data_crcs=True)
    header = file.survey.header
    writer.start(header.profile if header else 'ros2', header.library if header else '')
    for record in file.survey.metadata:
        writer.add_metadata(record.name, record.metadata)
    for attachment in file.attachments():
        writer.add_attachment(attachment.create_time, attachment.log_time, attachment.name,
                              attachment.media_type, attachment.data)
    channels = _register(writer, file)
    for message in file.messages():
        writer.add_message(channels[message.channel_id], message.log_time, message.data,
                           message.publish_time, message.sequence)
    # At the end, what the bag holds, as its recorder would have done.
    described = bag_metadata([_extent(file, stamps)], [*_topics(file).values()],
                             [*map(len, stamps.values())], ros_distro(file))
    writer.add_metadata('rosbag2', {'serialized_metadata': dump_yaml(described)})
    writer.finish()


def _register(writer: Writer, file: McapFile) -> dict[int, int]:
    """Describe the channels, in the order of their numbers; return the new ones."""
    # Schema 0 means no schema.
    schemas = {0: 0}
    for number, schema in file.schemas.items():
        schemas[number] = writer.register_schema(schema.name, schema.encoding, schema.data)
    return {number: writer.register_channel(channel.topic, channel.message_encoding,
                                            schemas.get(channel.schema_id, 0), channel.metadata)
            for number, channel in file.channels.items()}


def _topics(file: McapFile) -> dict[int, Topic]:
    """Return the description of each channel by rosbag2."""
    found = {}
    for number, channel in file.channels.items():
        schema, about = file.schemas.get(channel.schema_id), channel.metadata
        found[number] = Topic(
            channel.topic, schema.name if schema else '',
            schema.data.decode(errors='replace') if schema else '',
            about.get('topic_type_hash', ''), about.get('offered_qos_profiles') or '[]')
    return found


def ros_distro(file: McapFile) -> str:
    """Return the ROS distribution that a file names as its origin."""
    named = read_description(file.metadata('rosbag2').get('serialized_metadata', ''))
    return str(named.get('ros_distro') or 'jazzy')


@dataclass
class Recovery:
    """
    Content of a file once it is whole, and what is lost.

    Parameters
    ----------
    path : Path
        The MCAP file.
    messages : int
        Those that are kept.
    first, last : int
        Earliest and latest log time [ns].
    changed : bool
        Whether the file was rewritten.
    described : bool
        Whether metadata.yaml was written.
    original : Path or None
        Where the original file is kept.
    incomplete : int
        Bytes with which a recording breaks off: no damage, its last second or less.
    damaged : int
        Parts that cannot be read.
    unread : int
        Their bytes.
    altered : bool
        Whether the header or metadata, which nothing else confirms, differ from the recording.
    another : int or None
        Where a second file begins behind the first, which alone is kept.
    fewer : int
        Messages that there were, by the counts in the file or metadata.yaml's, and are not kept.
    more : int
        Messages that are kept and were not counted.
    files : int
        Attachments and metadata that there were, by the file's own count, and are not kept.
    contradicted : int
        Chunks whose indexes do not match their messages: these are made again.
    gaps : list of Missing
        Where stamps are missing that otherwise come evenly.

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
    another: int | None = None
    fewer: int = 0
    more: int = 0
    files: int = 0
    contradicted: int = 0
    gaps: list[Missing] = field(default_factory=list)

    @property
    def lost(self) -> bool:
        """Return whether something that was recorded is not kept, or not known to be."""
        return bool(self.damaged or self.altered or self.fewer or self.more or self.files
                    or self.gaps)

    @property
    def seconds(self) -> float:
        """Return the time from the first message to the last [s]."""
        return (self.last - self.first) * 1e-9 if self.messages else 0.0


def recover(bag: Path, replace: bool = False) -> Recovery:
    """
    Make a bag whole: indexes, summary and footer of its file, and its metadata.yaml.

    A whole bag stays unchanged. Otherwise all that can be read goes into a new file next to it,
    which is read back and then takes its place in one stroke; a failure before changes nothing.

    Parameters
    ----------
    bag : Path
        A folder with one MCAP file, or the file.
    replace : bool
        Whether the original goes; else it is kept as ``<file>.orig``.

    Raises
    ------
    RecordingError
        Nothing can be recovered, it is being recorded, or its folder cannot be written.

    """
    files = bag_files(bag)
    path = files[0]
    if len(files) > 1 or path.name.endswith(('.db3', '.zstd')):
        raise RecordingError(f'{bag}: expected one .mcap file, found '
                             f'{listed(file.name for file in files)}; give one, unpacked')
    try:
        with open_file(path, path) as stream, _not_being_recorded(stream, path):
            file = McapFile(path, path, thorough=True)
            stamps = stamps_of(file)
            recovery = _survey(file, stamps, stream)
            if recovery.changed:
                _refuse_if_nothing(file, recovery)
                _write_anew(file, stamps, recovery, replace)
            if (bag.is_dir() or _is_bag(path)) and (
                    recovery.changed or not (path.parent / 'metadata.yaml').exists()):
                describe(path.parent, [path])
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


def _survey(file: McapFile, stamps: Stamps, stream: BinaryIO) -> Recovery:
    """Return what can be read of a file, and what is lost; it is to be changed if not whole."""
    recovery = Recovery(file.path, *_extent(file, stamps)[1:])
    finished = is_finished(stream, file, recovery.messages)
    recovery.contradicted = 0 if finished else contradicted(stream, file.survey)
    recovery.altered = finished and not data_crc_holds(stream, file.survey)
    recovery.changed = not finished or recovery.altered
    recovery.incomplete = file.incomplete
    recovery.damaged, recovery.unread = len(file.unread), sum(file.unread.values())
    recovery.another = file.survey.another and file.survey.another.start
    recovery.files = file.survey.missing
    total = max(file.counted or 0, counted_messages(file.path.parent, [file.path.name]) or 0)
    recovery.fewer = max(0, max(total, _described(file)) - recovery.messages)
    if file.counted is not None:
        recovery.more = max(0, recovery.messages - file.counted)
    # A total of fewer was counted before the recording ended, and tells nothing.
    if recovery.changed and (total < recovery.messages or not total):
        recovery.gaps = missing_in_all(list(stamps.values()))
    return recovery


def _described(file: McapFile) -> int:
    """Return how many messages there were when the file was described the last time."""
    text = file.metadata('rosbag2').get('serialized_metadata', '')
    count = read_description(text).get('message_count')
    return count if type(count) is int else 0


def _refuse_if_nothing(file: McapFile, recovery: Recovery) -> None:
    described = file.survey.attachments or file.survey.metadata
    if not recovery.messages and (recovery.lost or not described):
        begin = recovery.another
        where = f'{file.path.stat().st_size} bytes' if begin is None else \
            f'the {begin} bytes before a second file, to cut out by `tail -c +{begin + 1}`,'
        raise RecordingError(f'{file.name}: nothing can be recovered: no message in {where} '
                             'can be read; it is left as it is')


def _write_anew(file: McapFile, stamps: Stamps, recovery: Recovery, replace: bool) -> None:
    """Write what can be read of a file into another, which then takes its place."""
    path = file.path.resolve()
    handle, name = tempfile.mkstemp(prefix=f'.{path.name}.', suffix='.tmp', dir=path.parent)
    temporary = Path(name)
    try:
        with os.fdopen(handle, 'wb') as target:
            copy_messages(file, stamps, target)
            target.flush()
            os.fsync(target.fileno())
        _read_back(temporary, recovery.messages)
        shutil.copymode(path, temporary)
        if not replace:
            recovery.original = _keep(path)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _read_back(path: Path, messages: int) -> None:
    """Read all of a file that was written; RecordingError unless every message is in it."""
    copy = McapFile(path, path, thorough=True)
    found = sum(map(len, stamps_of(copy).values()))
    with open_file(path, path) as stream:
        if found != messages or not is_finished(stream, copy, messages) \
                or not data_crc_holds(stream, copy.survey):
            raise RecordingError(f'{path}: what was written reads back with {found} of {messages} '
                                 'messages; the bag is left as it is; look at the disk')


def _keep(path: Path) -> Path:
    """Give a file a second name, that none has yet, and return that."""
    for original in numbered(path.with_name(f'{path.name}.orig')):
        try:
            os.link(path, original)
        except FileExistsError:
            continue
        except PermissionError:
            # A file system without second names.
            if original.exists():
                continue
            path.rename(original)
        break
    return original


def _is_bag(path: Path) -> bool:
    """Return whether a file is a bag by itself: not one of many, nor one that lies anywhere."""
    folder = path.parent
    try:
        return path.name == f'{folder.absolute().name}_0.mcap' and bag_files(folder) == [path]
    except RecordingError:
        # It lies among others that are no one bag.
        return False


def describe(folder: Path, paths: Sequence[Path]) -> int:
    """
    Write the metadata.yaml of a bag, and return how many messages are in it.

    Parameters
    ----------
    folder : Path
        Of the bag.
    paths : sequence of Path
        Its MCAP files, in their order; whole.

    Raises
    ------
    RecordingError
        A file is none.
    OSError
        A file cannot be read, or metadata.yaml not be written.

    """
    # The same topic in several files is one.
    counts: dict[Topic, int] = {}
    extents = []
    for path in paths:
        file = McapFile(path, path)
        stamps = stamps_of(file)
        for number, topic in _topics(file).items():
            counts[topic] = counts.get(topic, 0) + len(stamps[number])
        extents.append(_extent(file, stamps))
    write_bag_metadata(folder, bag_metadata(
        extents, list(counts), list(counts.values()), ros_distro(file)))
    return sum(extent.messages for extent in extents)
