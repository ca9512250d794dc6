# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Bags as `ros2 bag record` leaves them: split, packed, in SQLite; and bags with damage."""

from collections.abc import Callable
from pathlib import Path
import re
import shutil
import sys

from bag_content import content_of
from hnn_vi_ros import load_scene
from hnn_vi_ros.errors import DataError, RecordingError
from hnn_vi_ros.learning.data.bags import BagData
from hnn_vi_ros.learning.data.sources import make_dataset
from hnn_vi_ros.recording import BagReader
from hnn_vi_ros.recording.bags.mcap_file import McapFile
from hnn_vi_ros.ros.replay.picture import write_picture
from hnn_vi_ros.run.recorded_run import RecordedRun, resume
from hnn_vi_ros.run.replay_check import check_replay
from messages import refused
import numpy as np
from processes import finish, start_executable
import pytest
from recorded import as_received, EPOCH, record_run, rewritten
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
import yaml
import zstandard

TICKS = 200
DATA = BagData.model_validate({'kind': 'bag', 'joints': ['angle'], 'p': 'p'})


@pytest.fixture(scope='module')
def run(tmp_path_factory) -> Path:
    """Return a bag of ours, of two seconds."""
    return record_run(tmp_path_factory.mktemp('run') / 'bag', load_scene('exact_pendulum'), TICKS)


def converted(bag: Path, target: Path, plugin: StoragePlugin, mode: CompressionMode,
              first: int = 0, last: int = TICKS) -> Path:
    """Write the messages of some ticks as another recorder does; of attachments there are none."""
    writer = Writer(target, version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with AnyReader([bag]) as reader, writer:
        # From the second file on in another order, and so with other numbers.
        topics = sorted(reader.connections, key=lambda c: c.topic, reverse=bool(first))
        connections = {c.topic: writer.add_connection(
            c.topic, c.msgtype, msgdef=c.msgdef.data, rihs01=c.digest) for c in topics}
        for connection, stamp, data in reader.messages():
            # ~/scene is told of the state that the run begins at.
            if first < stamp // 10**7 <= last or stamp == first == 0:
                writer.write(connections[connection.topic], stamp, data)
    return target


def split(bag: Path, target: Path, plugin: StoragePlugin) -> Path:
    """Write a bag of two files, as it is when the recorder has reached its largest size."""
    parts = [converted(bag, target.with_name(f'{target.name}{i}'), plugin, CompressionMode.NONE,
                       i * TICKS // 2, (i + 1) * TICKS // 2) for i in range(2)]
    target.mkdir()
    names = [f'{target.name}_{i}.{plugin.name.lower()}' for i in (9, 10)]
    names = [name.replace('sqlite3', 'db3') for name in names]
    for part, name in zip(parts, names, strict=True):
        found, = (path for path in part.iterdir() if path.suffix in ('.mcap', '.db3'))
        shutil.move(found, target / name)
    one, two = (yaml.safe_load((part / 'metadata.yaml').read_text())[
        'rosbag2_bagfile_information'] for part in parts)
    counts = {topic['topic_metadata']['name']: topic['message_count']
              for topic in two['topics_with_message_count']}
    for topic in one['topics_with_message_count']:
        topic['message_count'] += counts[topic['topic_metadata']['name']]
    one['message_count'] += two['message_count']
    one['duration']['nanoseconds'] = TICKS * 10**7
    (target / 'metadata.yaml').write_text(yaml.safe_dump(
        {'rosbag2_bagfile_information': {**one, 'relative_file_paths': names}}))
    return target


def forms_of(plugin: StoragePlugin) -> dict[str, Callable[[Path, Path], Path]]:
    """Return writers of bags in the forms of a storage, by name."""
    return {f'{plugin.name}, split': lambda bag, target: split(bag, target, plugin)} | {
        f'{plugin.name} with zstd around each {mode.name}':
        lambda bag, target, mode=mode: converted(bag, target, plugin, mode)
        for mode in (CompressionMode.MESSAGE, CompressionMode.FILE)}


FORMS, SQLITE = forms_of(StoragePlugin.MCAP), forms_of(StoragePlugin.SQLITE3)


@pytest.fixture(scope='module', params=FORMS)
def foreign(request, run, tmp_path_factory) -> Path:
    return FORMS[request.param](run, tmp_path_factory.mktemp('foreign') / 'bag')


def test_foreign_bag_holds_the_same_messages(run, foreign):
    assert sorted(content_of(foreign)) == sorted(content_of(run))
    reader = BagReader(foreign)
    assert (reader.first, reader.last) == (0, TICKS * 10**7)
    assert len(reader.channels) == len(BagReader(run).channels)
    half = [m.time for m in reader.messages(first=10**9, last=10**9 + 10**7)]
    assert half == sorted(half) and set(half) == {10**9, 10**9 + 10**7}


@pytest.mark.parametrize('form', FORMS | SQLITE)
def test_foreign_bag_is_trained_on_like_ours(run, tmp_path, form):
    foreign = (FORMS | SQLITE)[form](run, tmp_path / 'bag')
    theirs, ours = make_dataset(DATA, 0, Path(), [foreign]), make_dataset(DATA, 0, Path(), [run])
    for name in ('q', 'p', 'dq_dt', 'dp_dt', 't'):
        assert np.array_equal(getattr(theirs, name), getattr(ours, name))


def test_bag_in_sqlite_is_read_as_training_data_only(run, tmp_path, monkeypatch):
    bag = converted(run, tmp_path / 'bag', StoragePlugin.SQLITE3, CompressionMode.NONE)
    for use in (BagReader, resume, check_replay):
        with refused(RecordingError):
            use(bag)
    # Alone, without its metadata.
    (bag / 'metadata.yaml').unlink()
    theirs, ours = (make_dataset(DATA, 0, Path(), [one]) for one in (bag, run))
    assert np.array_equal(theirs.q, ours.q)
    monkeypatch.setitem(sys.modules, 'rosbags.rosbag2', None)
    with refused(DataError):
        make_dataset(DATA, 0, Path(), [bag])


@pytest.mark.parametrize('reset', [True, False], ids=['reset', 'started again'])
def test_foreign_bag_of_two_runs_is_one_line_that_says_where_to_cut_it(run, tmp_path, reset):
    # After ~/reset stamps go on, by a new scene; if a simulator is started again they go back.
    second = EPOCH + 100 * 10**9
    again = record_run(tmp_path / 'again', load_scene('exact_pendulum'), 5, origin=10**10) \
        if reset else run
    (tmp_path / 'bag').mkdir()
    bag = as_received(run, tmp_path / 'bag' / 'bag_0.mcap', jitter=0.0).parent
    as_received(again, bag / 'bag_1.mcap', jitter=0.0, epoch=second)
    name_files(bag, ['bag_0.mcap', 'bag_1.mcap'])
    # From the last run of several of one scene a simulator may go on.
    for use in (check_replay, resume, show) if reset else (check_replay, show):
        with refused(RecordingError):
            use(bag)
    data = BagData.model_validate({'kind': 'bag', 'joints': ['angle']})
    if reset:
        with refused(DataError):
            make_dataset(data, 0, Path(), [bag])
    else:
        assert set(make_dataset(data, 0, Path(), [bag]).trajectory) == {0, 1}


def show(bag: Path) -> None:
    """Read all of a bag as its picture does."""
    recorded = RecordedRun(bag)
    list(recorded.in_order(recorded.reader.channels))


@pytest.mark.parametrize('foreign', [
    pytest.param(form, marks=[pytest.mark.long] * (form != 'MCAP, split')) for form in FORMS],
    indirect=True)
def test_foreign_bag_is_replayed(run, foreign):
    status, _, log = finish(start_executable(
        'replay', foreign, '--rate', 100, '--discovery-time', 0))
    assert status == 0 and f'{len(content_of(run))} messages published' in log
    assert 'WARN' not in log


def with_attachments(bag: Path, target: Path, change=bytes) -> Path:
    """Split one of our bags into two files of each kind of record; `change` packs a message."""
    target.mkdir()
    for i in range(2):
        rewritten(BagReader(bag), target / f'{target.name}_{i}.mcap',
                  lambda message, i=i: i * (10**9 + 1) <= message.time <= (i + 1) * 10**9,
                  change=lambda message: message._replace(data=change(message.data)))
    name_files(target, [f'{target.name}_{i}.mcap' for i in range(2)])
    return target


@pytest.mark.parametrize('change', [bytes, zstandard.compress], ids=['split', 'packed'])
def test_split_and_packed_bag_is_shown_verified_and_resumed(run, tmp_path, change):
    bag = with_attachments(run, tmp_path / 'bag', change)
    verdict = check_replay(bag)
    assert 'differs' not in verdict.text and verdict.good is check_replay(run).good
    assert resume(bag).step == TICKS
    assert write_picture(bag, tmp_path / 'a.rrd') == (TICKS, '')
    assert (tmp_path / 'a.rrd').stat().st_size > 0


def damaged(bag: Path, target: Path, part: float) -> Path:
    """Return a bag of which the chunk is damaged that ends behind this part of the file."""
    shutil.copytree(bag, target)
    path = target / 'bag_0.mcap'
    content = bytearray(path.read_bytes())
    chunk = next(piece for piece in McapFile(path).pieces
                 if piece.start + piece.length > part * len(content))
    content[chunk.start + chunk.length // 2] ^= 1
    path.write_bytes(content)
    return target


@pytest.fixture(scope='module')
def many_chunks(tmp_path_factory) -> Path:
    """Return a bag of ours that ends without a summary, each second in a chunk of its own."""
    folder = tmp_path_factory.mktemp('chunks') / 'bag'
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr('hnn_vi_ros.recording.bags.mcap_sink.CHUNK_SIZE', 2**15)
        return record_run(folder, load_scene('exact_pendulum'), 400)


def test_bag_with_an_unreadable_chunk_is_not_verified(many_chunks, tmp_path):
    bag = damaged(many_chunks, tmp_path / 'damaged', 0.5)
    whole, verdict = check_replay(many_chunks), check_replay(bag)
    assert whole.good and not verdict.good
    assert 'samples are bit-identical' in verdict.text and '\n' not in verdict.text
    gap = re.search(r'BUT (\d+) samples are missing in 1 gaps, the first from t = ([\d.]+) s',
                    verdict.text)
    reader = BagReader(bag)
    there = {message.time for message in reader.messages(
        [number for number, channel in reader.channels.items()
         if channel.topic == '/hnn_simulator/state'])}
    missing = [tick for tick in range(1, 401) if tick * 10**7 not in there]
    assert int(gap[1]) == len(missing) > 10
    assert float(gap[2]) == pytest.approx((missing[0] - 1) * 0.01)
    assert '1 damaged parts' in verdict.text and str(bag / 'bag_0.mcap') in verdict.text


@pytest.mark.parametrize('lost, there', [
    (lambda tick: 30 <= tick < 50, 80), (lambda tick: tick % 2, 50), (lambda tick: tick < 99, 2)],
    ids=['some', 'every second', 'all but two'])
def test_bag_that_lacks_samples_is_not_verified(tmp_path, lost, there):
    bag = record_run(tmp_path / 'bag', load_scene('exact_pendulum'), 100)
    thinned = rewritten(BagReader(bag), tmp_path / 'thinned.mcap',
                        lambda message: not lost(message.time // 10**7))
    verdict = check_replay(thinned)
    assert not verdict.good
    assert f'of {there} samples are bit-identical' in verdict.text
    assert f'BUT {100 - there} samples are missing' in verdict.text


def test_verify_of_a_damaged_bag_ends_non_zero_and_others_warn(many_chunks, tmp_path):
    bag = damaged(many_chunks, tmp_path / 'damaged', 0.5)
    status, out, _ = finish(start_executable('replay', bag, '--verify'), 120.0)
    assert status == 1 and 'samples are missing' in out and out.count('\n') == 1
    for words in (('replay', bag, '--rate', 100, '--discovery-time', 0),
                  ('replay', bag, '--rerun', tmp_path / 'a.rrd')):
        status, _, log = finish(start_executable(*words))
        assert status == 0 and log.count('damaged parts') == 1, log
    assert 'damaged parts' in make_dataset(DATA, 0, Path(), [bag]).description


@pytest.mark.parametrize('name', ['bag_0.db3', 'bag_0.mcap.zstd', 'bag_0.db3.zstd'])
def test_noise_in_the_place_of_a_bag_is_one_line(tmp_path, name):
    (tmp_path / name).write_bytes(b'no bag at all' * 100)
    for use in (BagReader, resume, check_replay):
        with refused(RecordingError):
            use(tmp_path)
    with refused(DataError):
        make_dataset(DATA, 0, Path(), [tmp_path])


def test_folder_of_several_bags_or_of_a_part_of_one_is_refused(run, tmp_path):
    for names in (('monday_0', 'tuesday_0'), ('a_3', 'a_5')):
        (tmp_path / names[0]).mkdir()
        for name in names:
            shutil.copy(run / 'bag_0.mcap', tmp_path / names[0] / f'{name}.mcap')
        with refused(RecordingError):
            BagReader(tmp_path / names[0])
    part = split(run, tmp_path / 'part', StoragePlugin.MCAP)
    (part / 'part_10.mcap').unlink()
    with refused(RecordingError):
        BagReader(part)
    (part / 'metadata.yaml').unlink()
    # Those of five topics in the first half of the ticks, and the scene.
    assert len(content_of(part)) == 5 * TICKS // 2 + 1


@pytest.mark.parametrize('named', [
    ['bag_0.mcap', ''], ['bag_0.mcap', 'metadata.yaml'], ['bag_0.mcap', '..']])
def test_description_that_names_what_is_no_file_of_a_bag_is_one_line(run, tmp_path, named):
    describe(run, tmp_path, named)
    with refused(RecordingError):
        BagReader(tmp_path)


def test_file_that_is_named_twice_is_read_once(run, tmp_path):
    describe(run, tmp_path, ['bag_0.mcap', 'bag_0.mcap'])
    assert content_of(tmp_path) == content_of(run)


def describe(run: Path, folder: Path, named: list[str]) -> None:
    """Write a bag of one file whose description names others."""
    shutil.copy(run / 'bag_0.mcap', folder)
    name_files(folder, named)


def name_files(folder: Path, named: list[str]) -> None:
    (folder / 'metadata.yaml').write_text(yaml.safe_dump(
        {'rosbag2_bagfile_information': {'relative_file_paths': named}}))


def test_split_bag_without_a_description_is_refused(run, tmp_path):
    for number in (3, 4):
        shutil.copy(run / 'bag_0.mcap', tmp_path / f'a_{number}.mcap')
    with refused(RecordingError):
        BagReader(tmp_path)


def test_path_that_is_too_long_is_one_line():
    with refused(RecordingError):
        BagReader(Path('a' * 300))
