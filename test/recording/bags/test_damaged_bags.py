# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Damaged recordings: nothing that can be read is lost, and nothing is lost in silence."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
import os
from pathlib import Path
import random
import re
import shutil
import socket

from bag_content import content_of
from bag_mutations import Mutant, mutants, records_of
from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.recording import BagReader, McapSink, Topic
from hnn_vi_ros.recording.bags.mcap_file import MAGIC
from hnn_vi_ros.recording.bags.mcap_recovery import recover, Recovery
from hnn_vi_ros.recording.bags.recover_bag import main
from mcap.opcode import Opcode
from messages import refused
import pytest
from python_process import run_code
from test_mcap_sink import payloads, PERIOD, TOPICS
from test_recover_bag import cut

TICKS, EVERY = 100, 10
# Of each kind; from 100 on with the opcode of every record flipped in all ways.
MUTATIONS = int(os.environ.get('HNN_VI_ROS_MUTATIONS', '8'))
# Of another scene: under the numbers of TOPICS are others.
OTHERS = ('/simulator/p', '/simulator/q', '/other/energy')
SCENE = {'scene.yaml': b'step_size: 0.01\n' * 200}
Content = list[tuple[str, int, bytes]]


def make(folder: Path, ticks: int, close: bool, topics: Sequence[Topic] = TOPICS,
         first: int = 0) -> bytes:
    """Return a file with a chunk each EVERY ticks, as it was closed or killed."""
    sink = McapSink(folder, topics, SCENE)
    sink._closed.set()  # No flushes by the clock.
    for tick in range(ticks):
        sink.write(tick * PERIOD, payloads(first + tick))
        if tick % EVERY == 0:
            sink.flush()
    sink.flush()
    killed = sink._path.read_bytes()
    sink.close()
    return sink._path.read_bytes() if close else killed


@pytest.fixture(scope='module')
def killed(tmp_path_factory) -> bytes:
    return make(tmp_path_factory.mktemp('killed') / 'bag', TICKS, close=False)


@pytest.fixture(scope='module')
def finished(tmp_path_factory) -> bytes:
    return make(tmp_path_factory.mktemp('finished') / 'bag', TICKS, close=True)


def expected(ticks: int = TICKS, topics: Sequence[Topic] = TOPICS, first: int = 0) -> Content:
    return [(topic.name, tick * PERIOD, data) for tick in range(ticks)
            for topic, data in zip(topics, payloads(first + tick), strict=True)]


def attempt(folder: Path, content: bytes) -> tuple[Recovery, Content] | None:
    """Recover a file; None if nothing can be. The original stays, the result is whole."""
    shutil.rmtree(folder, ignore_errors=True)
    path = cut(folder, content) / f'{folder.name}_0.mcap'
    try:
        recovery = recover(folder)
    except RecordingError as problem:
        assert '\n' not in str(problem)
        assert path.read_bytes() == content and list(folder.iterdir()) == [path]
        return None
    assert (recovery.original if recovery.changed else path).read_bytes() == content
    found = content_of(folder)
    assert len(found) == recovery.messages
    if recovery.changed:
        assert not recover(path).changed
    return recovery, found


def flip(content: bytes, byte: int, bit: int) -> bytes:
    changed = bytearray(content)
    changed[byte] ^= 1 << bit
    return bytes(changed)


def chunks_of(content: bytes) -> list[int]:
    """Return where the chunks begin."""
    return [match.start() for match in re.finditer(
        rb'\x06.{4}\x00{4}.{28}\x04\x00\x00\x00zstd', content, re.DOTALL)]


@pytest.mark.parametrize('change, least, lost', [
    (lambda content: content[:28672] + bytes(4096) + content[32768:], 2100, True),
    (lambda content: flip(content, 9, 3), 2400, True),
    (lambda content: flip(content, 8, 7), 2400, True),
    (lambda content: content[:-100], 2200, False),
], ids=['a page of zeros', 'length of the header', 'opcode of the header', 'cut off'])
def test_killed_bag_keeps_all_but_what_is_damaged(tmp_path, change, least, lost):
    killed = make(tmp_path / 'whole', 800, close=False)
    recovery, found = attempt(tmp_path / 'bag', change(killed))
    assert recovery.lost == lost
    assert len(found) >= least
    assert set(found) <= set(expected(800))


# A last chunk that lacks a part may as well be one with which the recording breaks off.
LAST = Counter(expected()[:-3 * EVERY])


@pytest.mark.timeout(60 + 30 * MUTATIONS)
@pytest.mark.parametrize('end', ['killed', pytest.param('finished', marks=pytest.mark.long)])
def test_no_mutation_ends_in_a_traceback_a_silent_loss_or_a_message_that_never_was(
        tmp_path, end, killed, finished):
    content = finished if end == 'finished' else killed
    others = [replace(topic, name=name) for topic, name in zip(TOPICS, OTHERS, strict=True)]
    other = make(tmp_path / 'other', 60, end == 'finished', others, 1000)
    whole, foreign = Counter(expected()), Counter(expected(60, others, 1000))
    outcomes = Counter[tuple[str, str]]()
    # Each opcode of each record takes a minute.
    for found in mutants(content, other, MUTATIONS, flip=1 if MUTATIONS >= 100 else 23):
        cut_off = content.startswith(found.content)
        allowed = whole + foreign if found.kind == 'join' else whole
        assert_nothing_unsaid(tmp_path / 'read.mcap', found, allowed, whole, cut_off)
        result = attempt(tmp_path / 'bag', found.content)
        if result is None:
            outcomes[found.kind, 'nothing can be read'] += 1
            continue
        recovery, kept = result[0], Counter(result[1])
        reader = BagReader(tmp_path / 'read.mcap')
        assert reader.damage or not recovery.altered, found.description
        assert kept <= allowed, found.description
        assert recovery.lost or kept == whole or cut_off or (
            recovery.incomplete and kept >= LAST), (found.description, recovery)
        outcomes[found.kind, 'lost, told' if recovery.lost else
                 'all kept' if kept == whole else 'broke off'] += 1
    # For a long run: pytest -s shows it.
    print(end, sum(outcomes.values()), dict(outcomes))


def assert_nothing_unsaid(path: Path, found: Mutant, allowed: Counter, whole: Counter,
                          cut_off: bool) -> None:
    """Read a file as it is: no message that never was, and none is missing that is not told."""
    path.write_bytes(found.content)
    try:
        reader = BagReader(path)
    except RecordingError as problem:
        assert '\n' not in str(problem)
        return
    there = Counter((reader.channels[m.channel].topic, m.time, m.data)
                    for m in reader.messages())
    assert there <= allowed, found.description
    assert there == whole or reader.damage or cut_off or (
        reader._sources[0].incomplete and there >= LAST), found.description
    assert '\n' not in reader.damage


def test_second_file_is_told_with_the_command_that_cuts_it_out(tmp_path, killed, finished, capsys):
    path = tmp_path / 'a.mcap'
    path.write_bytes(killed + finished)
    assert main([str(path)]) == 1
    error = capsys.readouterr().err
    begin = int(re.search(r'a second file begins inside it: .* `tail -c \+(\d+)', error)[1])
    assert path.read_bytes()[begin - 1:] == finished and error.count('\n') == 1


def test_flip_behind_the_data_loses_no_message(tmp_path, finished):
    data_end = finished.rindex(b'\x0f\x04\0\0\0\0\0\0\0')
    for byte in range(data_end + 13, len(finished), 97):
        recovery, found = attempt(tmp_path / 'bag', flip(finished, byte, byte % 8))
        assert found == expected(), byte
        assert recovery.changed and not recovery.lost, recovery


def test_swapped_chunks_lose_nothing(tmp_path, killed):
    records = records_of(killed)
    one, two = [i for i, record in enumerate(records) if record[0] == Opcode.CHUNK][3:8:4]
    records[one], records[two] = records[two], records[one]
    recovery, found = attempt(tmp_path / 'bag', MAGIC + b''.join(records))
    assert not recovery.lost and found == expected()


def test_messages_that_metadata_counts_are_missed(tmp_path, finished, killed):
    bag = tmp_path / 'bag'
    make(bag, TICKS, close=True)
    # The end of it, chunks and all, is gone without a trace in the file.
    (bag / 'bag_0.mcap').write_bytes(killed[:chunks_of(killed)[-1]])
    recovery = recover(bag)
    assert recovery.fewer == 3 * TICKS - recovery.messages > 0 and recovery.lost


def test_original_is_kept_under_a_name_that_none_has_or_replaced(tmp_path, killed):
    bag = cut(tmp_path / 'bag', killed)
    path = bag / 'bag_0.mcap'
    (bag / 'bag_0.mcap.orig').write_bytes(b'mine')
    assert main([str(bag)]) == 0
    assert (bag / 'bag_0.mcap.orig').read_bytes() == b'mine'
    assert (bag / 'bag_0.mcap.orig-2').read_bytes() == killed
    path.write_bytes(killed)
    assert main(['--replace', str(bag)]) == 0
    assert sorted(p.name for p in bag.iterdir()) == [
        'bag_0.mcap', 'bag_0.mcap.orig', 'bag_0.mcap.orig-2', 'metadata.yaml']


def test_status_says_whether_something_was_lost(tmp_path, killed, capsys):
    def status(name: str, content: bytes) -> int:
        (tmp_path / name).write_bytes(content)
        return main([str(tmp_path / name)])

    begins = chunks_of(killed)
    assert status('killed.mcap', killed[:-9]) == 0
    assert '9 bytes' not in capsys.readouterr().out
    assert status('damaged.mcap', flip(killed, begins[4] + 200, 0)) == 1
    out = capsys.readouterr().out
    assert 'LOST: 1 damaged parts' in out and 'damaged.mcap.orig' in out
    assert status('noise.mcap', killed[:8] + random.Random(3).randbytes(4000)) == 1
    error = capsys.readouterr().err
    assert 'nothing can be recovered' in error and error.count('\n') == 1
    # The failure of one counts, and does not keep another from being recovered.
    (tmp_path / 'again.mcap').write_bytes(killed)
    assert main([str(tmp_path / 'noise.mcap'), str(tmp_path / 'again.mcap')]) == 1
    assert 'again.mcap: recovered: 300 messages' in capsys.readouterr().out
    assert not (tmp_path / 'noise.mcap.orig').exists()


def test_result_that_does_not_read_back_leaves_the_bag_as_it_is(tmp_path, killed, monkeypatch):
    monkeypatch.setattr('hnn_vi_ros.recording.bags.mcap_recovery.copy_messages',
                        lambda file, stamps, target: target.write(killed))
    bag = cut(tmp_path / 'bag', killed)
    with pytest.raises(RecordingError, match='reads back with'):
        recover(bag)
    assert [(p.name, p.read_bytes()) for p in bag.iterdir()] == [('bag_0.mcap', killed)]


def fifo(path: Path) -> Path:
    os.mkfifo(path)
    return path


def bound_socket(path: Path) -> Path:
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(path))
    return path


@pytest.mark.parametrize('make_path', [
    fifo, bound_socket, lambda path: Path('/dev/zero'), lambda path: Path('/dev/null'),
], ids=['fifo', 'socket', 'endless device', 'device'])
@pytest.mark.parametrize('use', [recover, BagReader])
def test_what_is_no_regular_file_is_refused_at_once(tmp_path, make_path, use):
    with refused(RecordingError):
        use(make_path(tmp_path / 'x.mcap'))


@pytest.mark.parametrize('suffix', ['.db3', '.mcap.zstd'])
def test_what_recover_bag_cannot_write_is_refused(tmp_path, suffix):
    (tmp_path / f'a{suffix}').write_bytes(b'x')
    assert main([str(tmp_path / f'a{suffix}')]) == 1


def test_stopped_disk_or_interruption_leaves_no_second_file(tmp_path, killed):
    bag = cut(tmp_path / 'bag', killed)
    code = ('import sys, hnn_vi_ros.recording.bags.mcap_recovery as r\n'
            'def stop(*arguments): raise KeyboardInterrupt\n'
            'r._read_back = stop\n'
            'from hnn_vi_ros.cli import recover_bag\nrecover_bag()')
    assert run_code(code, bag).returncode == 130
    assert [p.name for p in bag.iterdir()] == ['bag_0.mcap']


def test_changes_of_a_file_are_not_taken_for_whole(tmp_path, finished):
    """A chunk replaced by another of the file: every checksum holds, the counts do not."""
    begins = chunks_of(finished)
    changed = finished[:begins[2]] + finished[begins[3]:begins[4]] + finished[begins[3]:]
    recovery, _ = attempt(tmp_path / 'bag', changed)
    assert recovery.changed


def test_flip_in_the_header_is_damage_to_readers_and_to_recover_bag(tmp_path, finished):
    path = tmp_path / 'bag.mcap'
    path.write_bytes(finished)
    assert not BagReader(path).damage
    path.write_bytes(finished.replace(b'ros2', b'ros3', 1))
    assert 'checksum' in BagReader(path).damage and recover(path).altered
