# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Reading bags: the order of the messages, windows of time, and files that break off."""

from pathlib import Path
import random

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.recording import BagReader, McapSink
from hnn_vi_ros.recording.bags import mcap_reader
from mcap.writer import CompressionType, Writer
from messages import refused
import pytest
from test_mcap_sink import ATTACHMENTS, payloads, PERIOD, TOPICS

LAYOUTS = {
    'chunks of zstd': {'compression': CompressionType.ZSTD},
    'chunks of lz4': {'compression': CompressionType.LZ4},
    'plain chunks': {'compression': CompressionType.NONE},
    'no chunks': {'use_chunking': False},
}


def write_foreign(path: Path, times: list[int], **options: object) -> None:
    """Write messages in this order, by the mcap package's writer, in small chunks."""
    with path.open('wb') as stream:
        writer = Writer(stream, chunk_size=300, **options)
        writer.start('ros2')
        schema = writer.register_schema('std_msgs/msg/String', 'ros2msg', b'string data')
        channels = [writer.register_channel(f'/topic{i}', 'cdr', schema) for i in range(2)]
        for i, time in enumerate(times):
            writer.add_message(channels[i % 2], time, b'%d' % i, time)
        writer.finish()


@pytest.mark.parametrize('layout', LAYOUTS)
def test_reader_yields_messages_in_the_order_of_their_times_from_any_layout(tmp_path, layout):
    times = list(range(1000, 1200)) + [1100] * 5
    random.Random(3).shuffle(times)
    write_foreign(tmp_path / 'a.mcap', times, **LAYOUTS[layout])
    reader = BagReader(tmp_path / 'a.mcap')
    assert (reader.first, reader.last) == (1000, 1199)
    expected = sorted(enumerate(times), key=lambda item: item[1])
    found = [(int(m.data), m.time) for m in reader.messages()]
    assert [time for _, time in found] == [time for _, time in expected]
    assert sorted(found) == sorted(expected)
    window = [m.time for m in reader.messages(first=1050, last=1060)]
    assert window == list(range(1050, 1061))
    one, = (number for number, c in reader.channels.items() if c.topic == '/topic0')
    assert [int(m.data) % 2 for m in reader.messages([one])] == [0] * 103


def test_reader_keeps_the_order_of_messages_of_one_time_across_chunks(tmp_path):
    write_foreign(tmp_path / 'a.mcap', [i // 4 for i in range(400)])
    found = [int(m.data) for m in BagReader(tmp_path / 'a.mcap').messages()]
    assert found == list(range(400))


def test_reader_knows_a_topic_that_comes_late_and_attachments_and_metadata(tmp_path):
    sink = McapSink(tmp_path / 'bag', TOPICS[:2], ATTACHMENTS)
    for tick in range(3000):
        sink.write(tick * PERIOD, payloads(tick)[:2])
    sink.write_other(TOPICS[2], 3000 * PERIOD, payloads(0)[2])
    sink.close()
    reader = BagReader(tmp_path / 'bag')
    assert {c.topic for c in reader.channels.values()} == {topic.name for topic in TOPICS}
    assert reader.attachment('scene.yaml') == ATTACHMENTS['scene.yaml']
    assert 'message_count: 6001' in reader.metadata('rosbag2')['serialized_metadata']
    assert reader.metadata('nothing') == {}
    assert reader.attachment('other.yaml') is None


def test_reader_refuses_what_is_no_bag_in_one_line(tmp_path):
    (tmp_path / 'notes.mcap').write_text('notes')
    for path in (tmp_path / 'notes.mcap', tmp_path / 'nothing', tmp_path / 'notes.mcap' / 'x'):
        with refused(RecordingError):
            BagReader(path)


def test_folder_of_a_run_is_refused_with_that_of_its_bag(tmp_path):
    (tmp_path / 'bag').mkdir()
    (tmp_path / 'bag' / 'bag_0.mcap').touch()
    with refused(RecordingError):
        BagReader(tmp_path)


def test_messages_that_cannot_be_sorted_in_little_memory_are_refused(tmp_path, monkeypatch):
    path = tmp_path / 'a.mcap'
    # Each chunk begins at time 1 and ends at 9, so that all of them wait for the last.
    write_foreign(path, [1, 9] * 50)
    assert len(list(BagReader(path).messages())) == 100
    monkeypatch.setattr(mcap_reader, '_MAX_BUFFERED', 10)
    with refused(RecordingError):
        list(BagReader(path).messages())
