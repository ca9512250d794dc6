# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Interrupted recordings: what recover_bag gives back, and what it never touches."""

from io import BytesIO
import mmap
import os
from pathlib import Path
import random
from subprocess import Popen
import sys
import tempfile
import time

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.recording import BagReader, McapSink
from hnn_vi_ros.recording.bags.mcap_recovery import recover
from hypothesis import example, given, settings, strategies
from mcap.reader import make_reader
from mcap.records import Message
from messages import refused
import numpy as np
import pytest
from python_process import run_code
from rosbags.highlevel import AnyReader
from test_mcap_sink import (
    ATTACHMENTS, mcap_of, PATH, payloads, PERIOD, record, TOPICS)
import yaml

KILLS = int(os.environ.get('HNN_VI_ROS_KILLS', '5'))
TICKS = 400


def messages_of(content: bytes) -> list[Message]:
    """Return the messages of a whole file, by the mcap package's reader."""
    reader = make_reader(BytesIO(content), validate_crcs=True)
    return [message for _, _, message in reader.iter_messages(log_time_order=False)]


@pytest.fixture(scope='module')
def recorded(tmp_path_factory) -> bytes:
    """Return a file of several chunks of noise, which fill more than one block each."""
    noise = np.random.default_rng(1)
    sink = McapSink(tmp_path_factory.mktemp('recorded') / 'bag', TOPICS, ATTACHMENTS)
    for tick in range(TICKS):
        sink.write(tick * PERIOD, [*payloads(tick)[:2], noise.bytes(2000)])
    sink.close()
    return sink._path.read_bytes()


def cut(folder: Path, content: bytes) -> Path:
    """Leave a bag as an interrupted recording does: no metadata.yaml."""
    folder.mkdir()
    (folder / f'{folder.name}_0.mcap').write_bytes(content)
    return folder


def test_interrupted_bag_reads_in_rosbags_with_all_that_was_written(tmp_path):
    sink = McapSink(tmp_path / 'live', TOPICS, ATTACHMENTS, 'jazzy')
    for tick in range(50):
        sink.write(tick * PERIOD, payloads(tick))
    sink.flush()
    bag = cut(tmp_path / 'bag', sink._path.read_bytes())
    sink.close()
    recovery = recover(bag)
    assert (recovery.messages, recovery.seconds) == (150, pytest.approx(0.49))
    assert recovery.changed and recovery.described and not recovery.damaged
    with AnyReader([bag]) as reader:
        assert {c.topic: (c.msgtype, c.msgcount, c.digest) for c in reader.connections} == {
            topic.name: (topic.type, 50, topic.type_hash) for topic in TOPICS}
        assert reader.end_time == 49 * PERIOD + 1
    reader = mcap_of(bag / 'bag_0.mcap')
    assert {a.name: a.data for a in reader.iter_attachments()} == ATTACHMENTS
    summary = reader.get_summary()
    assert reader.get_header().library.startswith('hnn_vi_ros')
    assert summary.statistics.message_count == 150 and len(summary.chunk_indexes) == 1
    assert {c.topic: c.metadata for c in summary.channels.values()} == {
        topic.name: {'offered_qos_profiles': topic.offered_qos_profiles,
                     'topic_type_hash': topic.type_hash} for topic in TOPICS}


def test_metadata_of_a_recovered_bag_is_what_its_recorder_would_have_written(tmp_path):
    path = record(tmp_path / 'bag', 25)
    written = (tmp_path / 'bag' / 'metadata.yaml').read_text()
    # The footer is gone, all messages are there.
    path.write_bytes(path.read_bytes()[:-20])
    (tmp_path / 'bag' / 'metadata.yaml').unlink()
    recover(tmp_path / 'bag')
    assert (tmp_path / 'bag' / 'metadata.yaml').read_text() == written


def test_whole_bag_stays_as_it_is_to_the_byte(tmp_path):
    path = record(tmp_path / 'bag', 25)
    before = path.read_bytes(), path.stat().st_ino
    assert not recover(tmp_path / 'bag').changed
    (tmp_path / 'bag' / 'metadata.yaml').unlink()
    assert recover(path).described
    path.write_bytes(before[0][:-1])
    assert recover(path).changed
    once = path.read_bytes()
    assert not recover(path).changed
    assert path.read_bytes() == once


@pytest.mark.long
@settings(max_examples=60)
@given(share=strategies.floats(0.0, 1.0))
@example(share=0.0)
@example(share=1.0)
@example(share=0.0025)
def test_file_cut_off_at_any_byte_is_read_as_and_recovers_a_prefix_of_its_messages(
        recorded, share):
    place = round(share * len(recorded))
    with tempfile.TemporaryDirectory() as folder:
        bag = cut(Path(folder) / 'bag', recorded[:place])
        whole = messages_of(recorded)
        if place >= 8:
            reader = BagReader(bag)
            there = [(m.time, m.data) for m in reader.messages()]
            assert there == [(m.log_time, m.data) for m in whole[:len(there)]]
            assert not there or (there[0][0], there[-1][0]) == (reader.first, reader.last)
        try:
            recovery = recover(bag)
        except RecordingError as problem:
            # Not even its description is whole.
            description = make_reader(BytesIO(recorded)).get_summary().metadata_indexes[0]
            assert place < description.offset + description.length and '\n' not in str(problem)
            assert [path.name for path in bag.iterdir()] == ['bag_0.mcap']
            return
        found = messages_of((bag / 'bag_0.mcap').read_bytes())
        assert recovery.messages == len(found)
        assert found == whole[:len(found)]
        kept = ['bag_0.mcap.orig'] if recovery.changed else []
        assert sorted(path.name for path in bag.iterdir()) == [
            'bag_0.mcap', *kept, 'metadata.yaml']
        assert not recovery.lost


def test_damaged_chunk_is_left_out_and_told(tmp_path, recorded):
    chunk = make_reader(BytesIO(recorded)).get_summary().chunk_indexes[1]
    damaged = bytearray(recorded[:-8])
    damaged[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 1
    bag = cut(tmp_path / 'bag', damaged)
    recovery = recover(bag)
    lost = [m for m in messages_of(recorded)
            if chunk.message_start_time <= m.log_time <= chunk.message_end_time]
    assert recovery.damaged == 1
    assert recovery.messages >= 3 * TICKS - len(lost) - 6


@pytest.mark.parametrize('content', [b'', b'no bag at all', b'\x89MCAP0\r'])
def test_what_is_no_mcap_is_refused_in_one_line_and_left_alone(tmp_path, content):
    path = tmp_path / 'notes.mcap'
    path.write_bytes(content)
    (tmp_path / 'empty').mkdir()
    for wrong in (path, tmp_path / 'nothing', tmp_path / 'nothing.mcap', tmp_path / 'empty'):
        with refused(RecordingError):
            recover(wrong)
    assert path.read_bytes() == content


def test_bag_that_is_still_being_recorded_is_refused(tmp_path):
    sink = McapSink(tmp_path / 'bag', TOPICS, {})
    sink.write(0, payloads(0))
    sink.flush()
    before = sink._path.read_bytes()
    with refused(RecordingError):
        recover(tmp_path / 'bag')
    assert sink._path.read_bytes() == before
    sink.close()
    assert not recover(tmp_path / 'bag').changed


FULL = """
import resource, sys
from pathlib import Path
from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.recording.bags.recover_bag import main
from hnn_vi_ros.recording.bags.mcap_recovery import recover
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), resource.RLIM_INFINITY))
try:
    recover(Path(sys.argv[1]))
except RecordingError as problem:
    print(problem)
"""


@pytest.mark.parametrize('limit', [100, pytest.param(300_000, marks=pytest.mark.long)])
def test_full_disk_leaves_the_original_and_no_other_file(tmp_path, recorded, limit):
    bag = cut(tmp_path / 'bag', recorded[:-20])
    child = run_code(FULL, bag, limit)
    assert (child.returncode, child.stderr, child.stdout.count('\n')) == (0, '', 1)
    assert 'File too large' in child.stdout
    assert (bag / 'bag_0.mcap').read_bytes() == recorded[:-20]
    assert len(list(bag.iterdir())) == 1


@pytest.mark.skipif(os.geteuid() == 0, reason='root may write into a read-only folder')
def test_read_only_folder_leaves_the_original_in_one_line(tmp_path, recorded):
    bag = cut(tmp_path / 'bag', recorded[:-20])
    bag.chmod(0o555)
    try:
        with pytest.raises(RecordingError, match='Permission denied'):
            recover(bag)
    finally:
        bag.chmod(0o755)
    assert (bag / 'bag_0.mcap').read_bytes() == recorded[:-20]


def test_executable_tells_messages_and_seconds_or_one_line(tmp_path):
    path = record(tmp_path / 'bag', 101)
    path.write_bytes(path.read_bytes()[:-5])
    code = 'from hnn_vi_ros.cli import recover_bag; recover_bag()'
    for bag, status, told in ((path.parent, 0, 'recovered: 303 messages, 1.00 s'),
                              (path, 0, 'already complete: 303 messages, 1.00 s'),
                              (tmp_path / 'nothing', 1, 'hnn recover_bag: ')):
        result = run_code(code, bag)
        assert result.returncode == status
        assert told in result.stdout + result.stderr
        assert (result.stdout + result.stderr).count('\n') == 1


ENDLESS = """
import mmap, os, struct, sys, time
from pathlib import Path
from hnn_vi_ros.recording.bags.mcap_sink import McapSink
from test_mcap_sink import payloads, TOPICS
sink = McapSink(Path(sys.argv[1]), TOPICS, {})
with open(sys.argv[2], 'r+b') as stream:
    shared = mmap.mmap(stream.fileno(), 16)
tick, messages = 0, payloads(0)
while True:
    stamp = time.monotonic_ns()
    sink.write(stamp, messages)
    tick += 1
    shared[:] = struct.pack('<QQ', tick, stamp)
    time.sleep(0.002)
"""


def wait_for_ticks(progress: Path, ticks: int) -> None:
    with progress.open('rb') as stream, \
            mmap.mmap(stream.fileno(), 16, access=mmap.ACCESS_READ) as shared:
        deadline = time.monotonic() + 30.0
        while int.from_bytes(shared[:8], 'little') < ticks:
            assert time.monotonic() < deadline, 'the recording process does not record'
            time.sleep(0.01)


@pytest.mark.timeout(60 + 5 * KILLS)
@pytest.mark.parametrize('kills', [3, pytest.param(KILLS, marks=pytest.mark.long)])
def test_killed_recording_loses_at_most_its_last_second_and_is_recovered(tmp_path, kills):
    """At random moments, HNN_VI_ROS_KILLS of them in `make test-long`."""
    moments = random.Random(5)
    for kill in range(kills):
        folder = tmp_path / f'bag{kill}'
        progress = folder.with_suffix('.progress')
        progress.write_bytes(bytes(16))
        child = Popen([sys.executable, '-c', ENDLESS, folder, progress], env=PATH)
        try:
            wait_for_ticks(progress, 1)
            time.sleep(moments.uniform(0.0, 3.0))
        finally:
            child.kill()
            child.wait()
        ticks, last = (int(word) for word in np.frombuffer(progress.read_bytes(), np.uint64))
        assert not (folder / 'metadata.yaml').exists()
        recovery = recover(folder)
        # The stamps are the steady clock's: what is lost is a stretch of wall time.
        found = messages_of((folder / f'{folder.name}_0.mcap').read_bytes())
        assert [m.sequence for m in found] == [i // 3 for i in range(recovery.messages)]
        assert recovery.messages <= 3 * ticks + 3
        first = found[0].log_time if found else last - 2_000_000 * ticks
        newest = found[-1].log_time if found else first
        assert last - newest <= 1_000_000_000
        metadata = yaml.safe_load((folder / 'metadata.yaml').read_text())
        counted = metadata['rosbag2_bagfile_information']['message_count']
        assert counted == recovery.messages
