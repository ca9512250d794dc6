# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Record serialised messages as a rosbag2 folder with one MCAP file."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
import fcntl
import math
import os
from pathlib import Path
import shlex
from threading import Event, RLock, Thread
import time
from types import MappingProxyType
from typing import Any, BinaryIO, cast, final

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files import dump_yaml, make_folder
from hnn_vi_ros.kernels import identity
from hnn_vi_ros.recording.bags.bag_metadata import (
    bag_metadata, FileExtent, NEVER, Topic, write_bag_metadata)
from mcap.data_stream import RecordBuilder
from mcap.records import ChunkIndex
from mcap.writer import CompressionType, LIBRARY_IDENTIFIER, Writer


class _Record(bytes):
    """A record in serialised form."""

    __slots__ = ()

    def write(self, builder: RecordBuilder) -> None:
        """Append the record to the summary."""
        builder.write(self)


class _Records(list[Any]):
    """List of a writer's chunk indexes in serialised form."""

    def append(self, index: ChunkIndex) -> None:
        """Append the index of a chunk."""
        builder = RecordBuilder()
        index.write(builder)
        super().append(_Record(builder.end()))


def compact_index(writer: Writer) -> None:
    """
    Make a new writer keep its chunk indices as bytes, before its first chunk.

    There are two chunks per second of wall time; by default each keeps an object with a dictionary
    until the file is closed, which takes 6 MB an hour.
    """
    parts: Any = writer
    parts._Writer__chunk_indices = _Records()


CHUNK_SIZE = 256 * 1024
# Interval of flushes [s]: a quarter of the second that an interruption may cost.
FLUSH_INTERVAL = 0.25
# Maximum size of the data that wait for a slow disk; beyond it a run waits as well [bytes].
_MAX_PENDING = 2**26


class _BufferedStream:
    """Stream of a writer, whose data wait in memory until a thread writes them to the disk."""

    def __init__(self) -> None:
        self._parts, self._place, self.size = list[bytes](), 0, 0

    def write(self, data: bytes) -> None:
        """Append data."""
        self._parts.append(data)
        self._place += len(data)
        self.size += len(data)

    def tell(self) -> int:
        """Return the position in the file."""
        return self._place

    def flush(self) -> None:
        """Do nothing; ``take`` returns the data."""

    def take(self) -> bytes:
        """Remove and return the data."""
        data = b''.join(self._parts)
        self._parts.clear()
        self.size = 0
        return data


@final
class McapSink:
    """
    Write the messages of each tick, and others, to ``<folder>/<folder name>_0.mcap``.

    Once open, the attachments and all messages older than a second are with the operating system
    and survive a killed process: a thread flushes every FLUSH_INTERVAL, even if no other messages
    follow. A slow disk delays only that thread: ``write`` does not wait for it, except for the
    first tick and if 64 MiB wait already. Nothing here calls ROS, so a recording can be closed
    after the shutdown of ROS.

    Parameters
    ----------
    folder : Path
        Folder of the bag. It must not exist; its parents are created.
    topics : sequence of Topic
        Topics recorded at each tick, in the order of its payloads.
    attachments : mapping of str to bytes
        Files that document the recording, by name: the scene, the parameters.
    ros_distro : str
        ROS distribution named in the log.

    Raises
    ------
    RecordingError
        The folder exists or cannot be written.

    """

    def __init__(self, folder: Path, topics: Sequence[Topic], attachments: Mapping[str, bytes],
                 ros_distro: str = 'jazzy'):
        self._topics, self._ros_distro = tuple(topics), ros_distro
        self._ticks, self._counts = 0, Counter[Topic]()
        # Topics without a message at each tick: channel, and number of messages.
        self._others: dict[Topic, list[int]] = {}
        self._schemas: dict[str, int] = {}
        self._first, self._last = NEVER, 0
        # To write to the disk takes `_disk`, and then `_lock` to take the data, never inversely.
        self._lock, self._disk, self._pending = RLock(), RLock(), _BufferedStream()
        self._closed, self._unflushed = Event(), False
        # Start of the write in progress, and duration of the one before [s].
        self._begun, self._took = math.inf, 0.0
        self._problem: RecordingError | None = None
        self._path = Path(folder) / f'{Path(folder).name}_0.mcap'
        origin = identity()
        hidden = self._path.with_name(f'.{self._path.name}.tmp')
        self._stream: BinaryIO | None = _create(hidden)
        with self._abandoning():
            self._writer = Writer(
                cast(BinaryIO, self._pending), chunk_size=CHUNK_SIZE,
                compression=CompressionType.ZSTD, enable_data_crcs=True)
            compact_index(self._writer)
            self._writer.start('ros2', f'hnn_vi_ros {LIBRARY_IDENTIFIER}')
            self._add_metadata()
            self._attach(attachments)
            # This records whether the run can be reproduced bit by bit.
            self._writer.add_metadata('hnn_vi_ros', origin)
            self._channels = [self._register(topic) for topic in self._topics]
            self._writer.flush()
            _write_all(self._stream, self._pending.take())
            # A file with the final name is readable at any time, even if the process is killed.
            os.rename(hidden, self._path)
        Thread(target=self._flush_by_the_clock, daemon=True).start()

    @property
    def delay(self) -> float:
        """Return the duration of the last write to disk, or of the present one so far [s]."""
        return max(self._took, time.monotonic() - self._begun)

    def write(self, stamp_ns: int, payloads: Sequence[bytes | None]) -> None:
        """
        Record the messages of one tick.

        Parameters
        ----------
        stamp_ns : int
            Common time of the messages [ns], not negative.
        payloads : sequence of bytes or None
            Serialised message of each topic, in order; None if it has none at this tick.

        Raises
        ------
        RecordingError
            The file cannot be written any more; the recording is closed.

        """
        # The format has 32 bits for the sequence number.
        sequence = self._ticks & 0xFFFFFFFF
        with self._abandoning():
            for topic, channel, payload in zip(
                    self._topics, self._channels, payloads, strict=True):
                if payload is not None:
                    self._writer.add_message(channel, stamp_ns, payload, stamp_ns, sequence)
                    self._counts[topic] += 1
            self._ticks += 1
            self._extend_to(stamp_ns)
            # The first is flushed immediately, so that a started run has a sample.
            waits = self._ticks == 1 or self._pending.size > _MAX_PENDING
        if waits:
            self._flush()

    def write_other(self, topic: Topic, stamp_ns: int, payload: bytes) -> None:
        """
        Record a message that does not belong to each tick.

        Parameters
        ----------
        topic : Topic
            Topic of the message; the bag lists it only if it has messages.
        stamp_ns : int
            Time of the message [ns], not negative.
        payload : bytes
            The serialised message.

        Raises
        ------
        RecordingError
            The file cannot be written any more; the recording is closed.

        """
        with self._abandoning():
            if topic not in self._others:
                self._others[topic] = [self._register(topic), 0]
            channel, count = self._others[topic]
            self._writer.add_message(channel, stamp_ns, payload, stamp_ns, count & 0xFFFFFFFF)
            self._others[topic][1] += 1
            self._extend_to(stamp_ns)

    def flush(self) -> None:
        """
        Pass all data to the operating system immediately instead of within FLUSH_INTERVAL.

        Raises
        ------
        RecordingError
            The file cannot be written any more; the recording is closed.

        """
        if not self._is_closed():
            self._flush()

    def close(self, attachments: Mapping[str, bytes] = MappingProxyType({})) -> None:
        """
        Complete the file and write metadata.yaml; a second call has no effect.

        Parameters
        ----------
        attachments : mapping of str to bytes, optional
            Files that document the end of the recording, by name.

        Raises
        ------
        RecordingError
            The end of the recording cannot be written.

        """
        with self._disk:
            if not self._is_closed():
                self._flush()
                self._finish(attachments)

    def _finish(self, attachments: Mapping[str, bytes]) -> None:
        with self._abandoning():
            self._attach(attachments)
            self._add_metadata()
            self._writer.finish()
            _write_all(self._stream, self._pending.take())
            self._end()
            write_bag_metadata(self._path.parent, self._metadata())

    def _attach(self, attachments: Mapping[str, bytes]) -> None:
        for name, data in attachments.items():
            media = 'application/yaml' if name.endswith('.yaml') else 'application/octet-stream'
            self._writer.add_attachment(time.time_ns(), 0, name, media, data)

    def _register(self, topic: Topic) -> int:
        """Register a topic, and its type if it is new; return its channel."""
        if topic.type not in self._schemas:
            self._schemas[topic.type] = self._writer.register_schema(
                topic.type, 'ros2msg', topic.definition.encode())
        return self._writer.register_channel(
            topic.name, 'cdr', self._schemas[topic.type],
            {'offered_qos_profiles': topic.offered_qos_profiles,
             'topic_type_hash': topic.type_hash})

    def _extend_to(self, stamp_ns: int) -> None:
        self._first = min(self._first, stamp_ns)
        self._last = max(self._last, stamp_ns)
        self._unflushed = True

    def _metadata(self) -> dict[str, Any]:
        counts = [self._counts[topic] for topic in self._topics] + [
            count for _, count in self._others.values()]
        file = FileExtent(self._path.name, sum(counts), self._first, self._last)
        return bag_metadata([file], [*self._topics, *self._others], counts, self._ros_distro)

    def _add_metadata(self) -> None:
        # As in rosbag2: once at the start for a truncated file, once at the end.
        self._writer.add_metadata('rosbag2', {'serialized_metadata': dump_yaml(self._metadata())})

    def _flush(self, by_the_clock: bool = False) -> None:
        with self._disk:
            if by_the_clock and self._stream is None:
                return
            with self._abandoning():
                self._writer.flush()
                self._unflushed = False
                data, stream = self._pending.take(), self._stream
            self._begun = time.monotonic()
            try:
                _write_all(stream, data)
                # Detect a removed file: data written to it would be lost.
                self._path.stat()
            except OSError as problem:
                with self._lock:
                    error = self._abandoned(problem)
                    if not by_the_clock:
                        raise error from problem
                    # The next call raises the error.
                    self._problem = error
            self._took, self._begun = time.monotonic() - self._begun, math.inf

    def _flush_by_the_clock(self) -> None:
        while not self._closed.wait(FLUSH_INTERVAL):
            if self._unflushed:
                self._flush(by_the_clock=True)

    def _is_closed(self) -> bool:
        """Return True if the file is closed; raise the error of a flush by the clock."""
        with self._lock:
            if self._stream is None:
                self._raise_problem()
            return self._stream is None

    def _raise_problem(self) -> None:
        problem, self._problem = self._problem, None
        if problem is not None:
            raise problem

    def _end(self) -> None:
        stream, self._stream = self._stream, None
        self._closed.set()
        if stream is not None:
            stream.close()

    @contextmanager
    def _abandoning(self) -> Iterator[None]:
        """Close the file as it is if it cannot be written any more."""
        with self._lock:
            self._raise_problem()
            if self._stream is None:
                raise RecordingError(f'{self._path}: the recording is closed; start a new one')
            try:
                yield
            except OSError as problem:
                raise self._abandoned(problem) from problem

    def _abandoned(self, problem: OSError) -> RecordingError:
        # Closing retries the failed write; only the first failure is reported.
        with suppress(OSError):
            self._end()
        kept = 'the file was removed'
        if self._path.exists():
            kept = ('earlier messages are kept: free some space, then repair the bag with: '
                    f'hnn recover_bag {shlex.quote(str(self._path.parent))}')
        return RecordingError(f'{self._path}: the recording stopped ({_reason(problem)}); {kept}')


def _write_all(stream: BinaryIO | None, data: bytes) -> None:
    """Write data to an open file without a buffer, which may write less at once."""
    assert stream is not None
    left = memoryview(data)
    while left:
        left = left[stream.write(left):]


def _create(path: Path) -> BinaryIO:
    """Create the file in a new folder; leave nothing behind on failure."""
    folder = path.parent
    try:
        make_folder(folder, new=True)
    except FileExistsError as problem:
        raise RecordingError(f'{problem.filename}: exists already and is not overwritten; record '
                             'to a new folder') from problem
    except OSError as problem:
        raise RecordingError(f'{folder}: cannot be created ({_reason(problem)}); record to a '
                             'writable folder') from problem
    try:
        stream = path.open('xb', buffering=0)
        # Lock the file until it is closed or the process ends: it must not be recovered meanwhile.
        with suppress(OSError):
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return stream
    except OSError as problem:
        folder.rmdir()
        raise RecordingError(f'{path}: cannot be created ({_reason(problem)}); record to a '
                             'writable folder') from problem


def _reason(problem: OSError) -> str:
    return problem.strerror or str(problem)
