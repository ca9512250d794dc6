# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The log: what independent readers find in it, and what outlives a killed process."""

from collections.abc import Iterator
from io import BytesIO
import os
from pathlib import Path
import shutil
from threading import Event
import time
import tracemalloc

import hnn_vi_ros
from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.kernels import identity
from hnn_vi_ros.recording import BagReader, McapSink
from hnn_vi_ros.recording.bags import mcap_sink
from hnn_vi_ros.recording.bags.mcap_recovery import recover
from hnn_vi_ros.recording.bags.mcap_sink import CHUNK_SIZE, Topic
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader, McapReader
from mcap.records import McapRecord, Message
from mcap.stream_reader import CRCValidationError, StreamReader
from messages import refused
import numpy as np
import pytest
from python_process import run_code
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosHistory, QosReliability
from rosbags.typesys import get_typestore, Stores
import yaml

STORE = get_typestore(Stores.ROS2_JAZZY)
ARRAY, NUMBER = 'std_msgs/msg/Float64MultiArray', 'std_msgs/msg/Float64'
TYPES = (ARRAY, ARRAY, NUMBER)
NAMES = ('/simulator/q', '/simulator/p', '/simulator/energy')
PERIOD = 10_000_000
FOREVER = {'sec': 9223372036, 'nsec': 854775807}
QOS = {
    'history': 'keep_last', 'depth': 10, 'reliability': 'reliable', 'durability': 'volatile',
    'deadline': {**FOREVER}, 'lifespan': {**FOREVER}, 'liveliness': 'automatic',
    'liveliness_lease_duration': {**FOREVER}, 'avoid_ros_namespace_conventions': False}
TOPICS = tuple(
    Topic(name, kind, STORE.generate_msgdef(kind, ros_version=2)[0], STORE.hash_rihs01(kind),
          yaml.safe_dump([QOS]))
    for name, kind in zip(NAMES, TYPES, strict=True))
# Of processes that import this file.
PATH = {**os.environ, 'PYTHONPATH': os.pathsep.join(
    map(str, (Path(hnn_vi_ros.__file__).parents[1], Path(__file__).parent,
              Path(__file__).parents[2] / 'support')))}
ATTACHMENTS = {'scene.yaml': b'step_size: 0.01\n', 'model': bytes(range(256))}


def payloads(tick: int) -> list[bytes]:
    """Return serialised messages whose values depend on the tick."""
    kinds = STORE.types
    layout = kinds['std_msgs/msg/MultiArrayLayout'](
        dim=[kinds['std_msgs/msg/MultiArrayDimension'](label='x', size=1, stride=1)],
        data_offset=0)
    values = (np.array([np.cos(tick)]), np.array([np.sin(tick)]))
    messages = [kinds[ARRAY](layout=layout, data=value) for value in values]
    messages.append(kinds[NUMBER](data=0.5 + tick))
    return [bytes(STORE.serialize_cdr(message, kind)) for message, kind in zip(
        messages, TYPES, strict=True)]


def record(folder: Path, ticks: int, start: int = 0) -> Path:
    """Record ticks from the stamp `start` [ns]; return the MCAP file."""
    sink = McapSink(folder, TOPICS, ATTACHMENTS)
    for tick in range(ticks):
        sink.write(start + tick * PERIOD, payloads(tick))
    sink.close()
    return folder / f'{folder.name}_0.mcap'


def test_index_of_the_chunks_takes_little_memory_while_the_bag_grows(tmp_path):
    sink = McapSink(tmp_path / 'bag', TOPICS, {})
    message, chunks = payloads(0), 500
    tracemalloc.start()
    try:
        for tick in range(2 * chunks):
            if tick == chunks:
                before, _ = tracemalloc.get_traced_memory()
            sink.write(tick * PERIOD, message)
            sink.flush()
        each = (tracemalloc.get_traced_memory()[0] - before) / chunks
    finally:
        tracemalloc.stop()
    sink.close()
    # A record of 9 + 64 bytes and the name of the compression, 10 for each channel, as an object
    # of 33 in a list; the library's own objects take 600.
    assert each < 9 + 64 + 8 + 10 * len(TOPICS) + 33 + 8 + 50
    summary = mcap_of(tmp_path / 'bag' / 'bag_0.mcap').get_summary()
    assert [index.message_start_time for index in summary.chunk_indexes] == [
        tick * PERIOD for tick in range(2 * chunks)]


def mcap_of(path: Path) -> McapReader:
    """Return the mcap package's reader of a whole file."""
    return make_reader(BytesIO(path.read_bytes()), validate_crcs=True)


def readable_records(path: Path) -> Iterator[McapRecord]:
    """Yield the records of a file that may break off."""
    with path.open('rb') as stream:
        try:
            yield from StreamReader(stream, validate_crcs=True).records
        except EndOfFile:
            return


@pytest.mark.parametrize('start', [0, 1_234_567_890_123])
def test_bag_reads_in_rosbags_with_types_qos_counts_stamps_and_values(tmp_path, start):
    record(tmp_path / 'bag', 25, start)
    with AnyReader([tmp_path / 'bag']) as reader:
        assert {c.topic: (c.msgtype, c.msgcount, c.digest) for c in reader.connections} == {
            topic.name: (topic.type, 25, topic.type_hash) for topic in TOPICS}
        for connection in reader.connections:
            qos, = connection.ext.offered_qos_profiles
            assert (qos.history, qos.depth, qos.reliability, qos.durability) == (
                QosHistory.KEEP_LAST, 10, QosReliability.RELIABLE, QosDurability.VOLATILE)
        assert reader.message_count == 75
        assert reader.start_time == start
        # rosbags ends a bag one nanosecond after its last message.
        assert reader.end_time == start + 24 * PERIOD + 1
        seen = {name: [] for name in NAMES}
        for connection, stamp, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            seen[connection.topic].append((stamp, float(np.squeeze(message.data))))
    stamps = [start + tick * PERIOD for tick in range(25)]
    functions = (np.cos, np.sin, lambda tick: 0.5 + tick)
    for name, function in zip(NAMES, functions, strict=True):
        assert seen[name] == [(stamp, function(tick)) for tick, stamp in enumerate(stamps)]


def test_message_that_comes_now_and_then_reads_in_rosbags_at_its_stamp(tmp_path):
    other = Topic('/alarms', NUMBER, TOPICS[2].definition, TOPICS[2].type_hash,
                  TOPICS[2].offered_qos_profiles)
    sink = McapSink(tmp_path / 'bag', TOPICS, {})
    for tick in range(25):
        sink.write(tick * PERIOD, payloads(tick))
        if tick in (7, 19):
            sink.write_other(other, tick * PERIOD, payloads(100 + tick)[2])
    sink.close()
    with refused(RecordingError):
        sink.write_other(other, 0, b'')
    with AnyReader([tmp_path / 'bag']) as reader:
        assert {c.topic: c.msgcount for c in reader.connections} == dict.fromkeys(NAMES, 25) | {
            '/alarms': 2}
        found = [(stamp, reader.deserialize(raw, connection.msgtype).data)
                 for connection, stamp, raw in reader.messages() if connection.topic == '/alarms']
    assert found == [(7 * PERIOD, 107.5), (19 * PERIOD, 119.5)]
    metadata = yaml.safe_load((tmp_path / 'bag' / 'metadata.yaml').read_text())
    counts = {entry['topic_metadata']['name']: entry['message_count'] for entry
              in metadata['rosbag2_bagfile_information']['topics_with_message_count']}
    assert counts == dict.fromkeys(NAMES, 25) | {'/alarms': 2}
    # A type that is known already is not described again.
    assert mcap_of(tmp_path / 'bag' / 'bag_0.mcap').get_summary().statistics.schema_count == 2


def test_recorded_bytes_times_and_sequences_equal_those_written(tmp_path):
    reader = mcap_of(record(tmp_path / 'bag', 300))
    assert reader.get_header().profile == 'ros2'
    found = [(schema.name, schema.encoding, channel.topic, channel.message_encoding,
              message.log_time, message.publish_time, message.sequence, message.data)
             for schema, channel, message in reader.iter_messages(log_time_order=False)]
    assert found == [
        (topic.type, 'ros2msg', topic.name, 'cdr', tick * PERIOD, tick * PERIOD, tick, payload)
        for tick in range(300) for topic, payload in zip(
                TOPICS, payloads(tick), strict=True)]


def test_summary_agrees_with_the_messages_from_stamp_zero(tmp_path):
    summary = mcap_of(record(tmp_path / 'bag', 4000)).get_summary()
    statistics = summary.statistics
    assert statistics.message_count == 12_000
    assert set(statistics.channel_message_counts.values()) == {4000}
    assert (statistics.message_start_time, statistics.message_end_time) == (0, 3999 * PERIOD)
    assert (statistics.schema_count, statistics.channel_count) == (2, 3)
    assert statistics.chunk_count == len(summary.chunk_indexes) > 1
    assert summary.chunk_indexes[0].message_start_time == 0
    assert summary.chunk_indexes[-1].message_end_time == 3999 * PERIOD
    for channel, topic in zip(summary.channels.values(), TOPICS, strict=True):
        assert channel.metadata == {'offered_qos_profiles': topic.offered_qos_profiles,
                                    'topic_type_hash': topic.type_hash}


def test_chunks_are_compressed_indexed_and_limited(tmp_path, monkeypatch):
    # A flush just after a chunk became full in the middle of a tick would end one of a message.
    monkeypatch.setattr('hnn_vi_ros.recording.bags.mcap_sink.FLUSH_INTERVAL', 1e6)
    chunks = mcap_of(record(tmp_path / 'bag', 4000)).get_summary().chunk_indexes
    largest_record = 31 + max(map(len, payloads(0)))
    for chunk in chunks:
        assert chunk.compression == 'zstd'
        assert chunk.uncompressed_size <= CHUNK_SIZE + largest_record
        assert chunk.message_index_length > 0 and set(chunk.message_index_offsets) == {1, 2, 3}


def test_damaged_chunk_fails_its_crc(tmp_path):
    # Random payloads do not compress: the changed byte stays a byte of the chunk's content.
    noise = np.random.default_rng(7).bytes(4096)
    sink = McapSink(tmp_path / 'bag', TOPICS, {})
    sink.write(0, [noise] * 3)
    sink.close()
    path = tmp_path / 'bag' / 'bag_0.mcap'
    damaged = bytearray(path.read_bytes())
    damaged[damaged.index(noise[1000:1100])] ^= 1
    path.write_bytes(damaged)
    with pytest.raises(CRCValidationError):
        list(readable_records(path))


def test_attachments_are_kept(tmp_path):
    attached = list(mcap_of(record(tmp_path / 'bag', 1)).iter_attachments())
    assert {attachment.name: attachment.data for attachment in attached} == ATTACHMENTS
    assert {attachment.media_type for attachment in attached} == {
        'application/yaml', 'application/octet-stream'}


def test_metadata_has_the_fields_of_rosbag2_version_9(tmp_path):
    record(tmp_path / 'bag', 25, 5 * PERIOD)
    extent = {'starting_time': {'nanoseconds_since_epoch': 5 * PERIOD},
              'duration': {'nanoseconds': 24 * PERIOD}, 'message_count': 75}
    metadata = yaml.safe_load((tmp_path / 'bag' / 'metadata.yaml').read_text())
    assert metadata == {'rosbag2_bagfile_information': {
        'version': 9, 'storage_identifier': 'mcap', **extent,
        'topics_with_message_count': [
            {'message_count': 25, 'topic_metadata': {
                'name': topic.name, 'type': topic.type, 'serialization_format': 'cdr',
                'offered_qos_profiles': [QOS], 'type_description_hash': topic.type_hash}}
            for topic in TOPICS],
        'compression_format': '', 'compression_mode': '', 'relative_file_paths': ['bag_0.mcap'],
        'files': [{'path': 'bag_0.mcap', **extent}], 'custom_data': None, 'ros_distro': 'jazzy'}}
    assert sorted(p.name for p in (tmp_path / 'bag').iterdir()) == ['bag_0.mcap', 'metadata.yaml']


def test_file_itself_carries_the_metadata(tmp_path):
    records = list(mcap_of(record(tmp_path / 'bag', 25)).iter_metadata())
    own, = (record for record in records if record.name == 'hnn_vi_ros')
    assert own.metadata == identity()
    assert {'hnn_vi_ros', 'sources', 'numba', 'numpy', 'processor'} <= own.metadata.keys()
    first, last = (yaml.safe_load(record.metadata['serialized_metadata'])
                   for record in records if record.name == 'rosbag2')
    in_folder = yaml.safe_load((tmp_path / 'bag' / 'metadata.yaml').read_text())
    assert last == in_folder['rosbag2_bagfile_information']
    assert first['message_count'] == 0 and first['ros_distro'] == 'jazzy'


def test_recording_without_messages_reads_as_empty(tmp_path):
    path = record(tmp_path / 'bag', 0)
    with AnyReader([tmp_path / 'bag']) as reader:
        assert reader.message_count == 0
        assert {connection.topic for connection in reader.connections} == set(NAMES)
    assert list(mcap_of(path).iter_messages()) == []


def test_existing_folder_is_never_overwritten(tmp_path):
    path = record(tmp_path / 'deep' / 'er' / 'bag', 3)
    before = path.read_bytes()
    (tmp_path / 'empty').mkdir()
    for folder in (path.parent, tmp_path / 'empty', path / 'below_a_file'):
        with refused(RecordingError):
            McapSink(folder, TOPICS, {})
    assert path.read_bytes() == before
    assert list((tmp_path / 'empty').iterdir()) == []


def test_folder_that_cannot_be_made_is_an_error_of_one_line(tmp_path):
    for folder in (Path('/proc/bag'), tmp_path / ('x' * 250)):
        with refused(RecordingError):
            McapSink(folder, TOPICS, {})
    assert list(tmp_path.iterdir()) == []


def test_closing_twice_is_one_closing_and_ends_the_writing(tmp_path):
    sink = McapSink(tmp_path / 'bag', TOPICS, {})
    sink.write(0, payloads(0))
    sink.close()
    before = (tmp_path / 'bag' / 'bag_0.mcap').read_bytes()
    sink.close()
    sink.flush()
    with refused(RecordingError):
        sink.write(PERIOD, payloads(1))
    assert (tmp_path / 'bag' / 'bag_0.mcap').read_bytes() == before


def messages(path: Path) -> list[bytes]:
    return [record.data for record in readable_records(path) if isinstance(record, Message)]


def test_first_message_is_flushed_at_once_and_others_by_a_flush_for_other_readers(tmp_path):
    sink, path = McapSink(tmp_path / 'bag', TOPICS, ATTACHMENTS), tmp_path / 'bag' / 'bag_0.mcap'
    for tick in range(3):
        sink.write(tick * PERIOD, payloads(tick))
        if tick:
            sink.flush()
        assert messages(path) == [
            data for before in range(tick + 1) for data in payloads(before)]
    sink.close()


def test_file_killed_before_its_first_message_is_recovered_with_its_attachments(tmp_path):
    # Left as a kill leaves it: nothing that is still held in memory will ever be written.
    sink = McapSink(tmp_path / 'bag', TOPICS, ATTACHMENTS | {'large': bytes(100_000)})
    killed = tmp_path / 'killed' / 'killed_0.mcap'
    killed.parent.mkdir()
    shutil.copy(tmp_path / 'bag' / 'bag_0.mcap', killed)
    sink.close()
    assert BagReader(killed.parent).metadata('hnn_vi_ros') == identity()
    assert recover(killed.parent).changed
    reader = BagReader(killed.parent)
    for name, data in ATTACHMENTS.items():
        assert reader.attachment(name) == data
    with AnyReader([killed.parent]) as found:
        assert found.message_count == 0


def test_file_gets_its_name_once_it_holds_what_explains_it(tmp_path, monkeypatch):
    """Killed at any moment, there is no file under that name which tells nothing."""
    begun = []

    def rename(source: Path, target: Path) -> None:
        assert not target.exists()
        begun.append(source.read_bytes())
        os.replace(source, target)

    monkeypatch.setattr('hnn_vi_ros.recording.bags.mcap_sink.os.rename', rename)
    sink = McapSink(tmp_path / 'bag', TOPICS, ATTACHMENTS)
    path = tmp_path / 'copy.mcap'
    path.write_bytes(*begun)
    for name, data in ATTACHMENTS.items():
        assert BagReader(path).attachment(name) == data
    sink.close()
    assert sorted(file.name for file in (tmp_path / 'bag').iterdir()) == [
        'bag_0.mcap', 'metadata.yaml']


def test_messages_are_flushed_by_the_clock_though_none_follows(tmp_path):
    sink = McapSink(tmp_path / 'bag', TOPICS, ATTACHMENTS)
    for tick in range(3):
        sink.write(tick * PERIOD, payloads(tick))
    expected = [data for tick in range(3) for data in payloads(tick)]
    while messages(tmp_path / 'bag' / 'bag_0.mcap') != expected:
        time.sleep(0.01)
    sink.close()


@pytest.mark.parametrize('call', ['write', 'flush', 'close'])
def test_failure_of_a_flush_by_the_clock_is_raised_by_the_next_call(tmp_path, call):
    sink = McapSink(tmp_path / 'bag', TOPICS, {})
    sink.write(0, payloads(0))
    sink.write(PERIOD, payloads(1))
    shutil.rmtree(tmp_path / 'bag')
    while sink._stream is not None:
        time.sleep(0.01)
    with pytest.raises(RecordingError, match='the file was removed'):
        getattr(sink, call)(*(2 * PERIOD, payloads(2)) if call == 'write' else ())
    sink.close()


def test_slow_disk_stops_neither_the_ticks_nor_loses_them(tmp_path, monkeypatch):
    sink, path = McapSink(tmp_path / 'bag', TOPICS, {}), tmp_path / 'bag' / 'bag_0.mcap'
    sink.write(0, payloads(0))
    begun, write_all = [Event(), Event()], mcap_sink._write_all

    def write_slowly(*words: object) -> None:
        begun[0].set()
        assert begun[1].wait(60.0)
        write_all(*words)

    monkeypatch.setattr(mcap_sink, '_write_all', write_slowly)
    other = Topic('/alarms', NUMBER, TOPICS[2].definition, TOPICS[2].type_hash,
                  TOPICS[2].offered_qos_profiles)
    sink.write(PERIOD, payloads(1))
    assert begun[0].wait(60.0)
    # The disk is busy from here on; more than one chunk comes.
    for tick in range(2, 2000):
        sink.write(tick * PERIOD, payloads(tick))
        sink.write_other(other, tick * PERIOD, payloads(tick)[2])
    assert messages(path) == payloads(0)
    before = sink.delay
    assert 0.0 < before < sink.delay  # the present write goes on
    begun[1].set()
    sink.close()
    assert len(messages(path)) == 3 * 2000 + 1998


def test_data_that_wait_for_a_disk_are_limited(tmp_path, monkeypatch):
    monkeypatch.setattr(mcap_sink, 'FLUSH_INTERVAL', 1e6)
    monkeypatch.setattr(mcap_sink, '_MAX_PENDING', 10 * CHUNK_SIZE)
    sink, sizes = McapSink(tmp_path / 'bag', TOPICS, {}), []
    noise = np.random.default_rng(7).bytes(2**16)
    for tick in range(300):
        sink.write(tick, [noise[tick:], noise[:-tick or None], noise])
        sizes.append(sink._pending.size)
    # Noise is not compressed: a tick of three messages may complete a chunk, of four of them.
    assert 5 * CHUNK_SIZE < max(sizes) < 12 * CHUNK_SIZE
    sink.close()
    assert len(messages(tmp_path / 'bag' / 'bag_0.mcap')) == 900


FULL = """
import os, resource, sys
from itertools import count
from pathlib import Path
from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.kernels.sources import identity
from hnn_vi_ros.recording.bags.mcap_sink import McapSink
from test_mcap_sink import TOPICS
sink = McapSink(Path(sys.argv[1]), TOPICS, {})
# The system refuses to let a file grow beyond this, with an OSError as for a full disk.
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), resource.RLIM_INFINITY))
for tick in count():
    try:
        sink.write(tick, [os.urandom(2000)] * 3)
    except RecordingError as problem:
        print(problem)
        break
sink.close()
sink.close()
try:
    sink.write(0, [b''] * 3)
except RecordingError as problem:
    print(problem)
"""


@pytest.mark.timeout(60)
@pytest.mark.parametrize('limit', [pytest.param(5_000, marks=pytest.mark.long), 700_000])
def test_full_disk_ends_the_recording_with_its_reason(tmp_path, limit):
    child = run_code(FULL, tmp_path / 'bag', limit, env=PATH)
    assert child.returncode == 0 and child.stderr == ''
    stopped, closed = child.stdout.splitlines()
    assert 'bag_0.mcap: the recording stopped (File too large)' in stopped
    assert 'closed' in closed
    path = tmp_path / 'bag' / 'bag_0.mcap'
    assert path.stat().st_size <= limit
    assert not (tmp_path / 'bag' / 'metadata.yaml').exists()
