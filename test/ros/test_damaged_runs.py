# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Damaged bags of runs: none is confirmed, trained on or judged by as if it were whole."""

from collections import Counter
import os
from pathlib import Path
import re
import shutil

from hnn_vi_ros import load_scene
from hnn_vi_ros.errors import HnnViRosError, RecordingError
from hnn_vi_ros.learning.data.bags import BagData, BagMotions
from hnn_vi_ros.learning.data.sources import make_dataset, read_motions
from hnn_vi_ros.recording.bags.mcap_file import MAGIC
from hnn_vi_ros.recording.bags.mcap_reader import BagReader
from hnn_vi_ros.recording.bags.mcap_recovery import recover
from hnn_vi_ros.ros.replay.recorded_run import resume
from hnn_vi_ros.ros.replay.replay_check import check_replay
from mcap.opcode import Opcode
import pytest
from recorded import record_run
from recording.bags.bag_mutations import Mutant, mutants, records_of
from scene_files import write_scene

# Of each kind in `make test-long`; from 50 on with the opcode of every record flipped in all ways.
MUTATIONS = int(os.environ.get('HNN_VI_ROS_MUTATIONS', '4'))
TICKS = 60
DATA = BagData.model_validate({'kind': 'bag', 'joints': ['angle'], 'commands': 'commands',
                               'stamps': 'log'})


@pytest.fixture(scope='module')
def bag(tmp_path_factory) -> Path:
    """Return a bag of ours of a driven run, in chunks of some samples."""
    folder = tmp_path_factory.mktemp('run')
    scene = write_scene(folder / 'scene.yaml', 'pendulum', (
        '{kind: external_force, coordinates: [angle], timeout: 0.1}'), step_size=0.005)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr('hnn_vi_ros.recording.bags.mcap_sink.CHUNK_SIZE', 2**13)
        return record_run(folder / 'bag', load_scene(scene), TICKS,
                          commands={step: [[0.01 * step]] for step in range(0, 100, 7)})


@pytest.fixture(scope='module')
def other(tmp_path_factory) -> bytes:
    folder = tmp_path_factory.mktemp('other')
    return (record_run(folder / 'bag', load_scene('exact_double_pendulum'), 30)
            / 'bag_0.mcap').read_bytes()


def without_end(content: bytes) -> bytes:
    """Return a file as its recorder leaves it that is killed."""
    records = records_of(content)
    end = next(i for i, record in enumerate(records) if record[0] == Opcode.DATA_END)
    return MAGIC + b''.join(records[:end])


def content_of(bag: Path) -> Counter[tuple[str, int, bytes]]:
    reader = BagReader(bag)
    return Counter((reader.channels[m.channel].topic, m.time, m.data) for m in reader.messages())


@pytest.mark.timeout(120 + 60 * MUTATIONS)
@pytest.mark.parametrize('count', [1, pytest.param(MUTATIONS, marks=pytest.mark.long)])
@pytest.mark.parametrize('end', ['killed', 'finished'])
def test_no_damaged_bag_is_confirmed_or_used_as_if_it_were_whole(
        bag, other, tmp_path, end, count):
    whole = content_of(bag)
    content = (bag / 'bag_0.mcap').read_bytes()
    if end == 'killed':
        content, other = without_end(content), without_end(other)
    states = sum(count for (topic, *_), count in whole.items() if topic.endswith('/state'))
    rows = len(make_dataset(DATA, 0, Path(), [bag]).t)
    outcomes = Counter[tuple[str, ...]]()
    every = 1 if count >= 50 else 3 if count > 1 else 12
    for found in mutants(content, other, count, every, 1 if count >= 50 else 40 * every):
        path = tmp_path / 'bag' / 'bag_0.mcap'
        shutil.rmtree(path.parent, ignore_errors=True)
        path.parent.mkdir()
        if end == 'finished':
            shutil.copy(bag / 'metadata.yaml', path.parent)
        path.write_bytes(found.content)
        # A killed recording ends where it breaks off, and nothing tells what would have come.
        cut_off = end == 'killed' and content.startswith(found.content)
        for stage in ('as it is', 'recovered'):
            verdict = verdict_on(path.parent, whole, states, cut_off, found)
            outcomes[stage, found.kind, verdict] += 1
            used_openly(path.parent, rows, cut_off, found)
            if stage == 'as it is':
                kept = recovered(path, whole, cut_off)
                assert kept or path.read_bytes() == found.content
                # What is lost was told, once.
                cut_off = True
    # For a long run: pytest -s shows it.
    print(end, sum(outcomes.values()), dict(outcomes))


def test_second_file_is_found_behind_a_record_that_breaks_off(bag, other, tmp_path):
    """The record's length covers the beginning of the other file, whose channels are alike."""
    path = tmp_path / 'bag' / 'bag_0.mcap'
    first = without_end((bag / 'bag_0.mcap').read_bytes())
    for end in range(len(first) // 4, len(first), 499):
        shutil.rmtree(path.parent, ignore_errors=True)
        path.parent.mkdir()
        path.write_bytes(first[:end] + without_end(other)[:len(other) // 2])
        with pytest.raises(RecordingError, match=re.escape(f'tail -c +{end + 1} ')):
            recover(path.parent)


def recovered(path: Path, whole: Counter, cut_off: bool) -> bool:
    """Recover a bag; return whether anything could be."""
    before = path.read_bytes()
    try:
        recovery = recover(path.parent)
    except HnnViRosError as problem:
        assert '\n' not in str(problem)
        return False
    assert (recovery.original if recovery.changed else path).read_bytes() == before
    # Of two files of the same topics, the second without its header, all messages are in one.
    assert content_of(path.parent) >= whole or recovery.lost or cut_off
    return True


def verdict_on(bag: Path, whole: Counter, states: int, cut_off: bool, found: Mutant) -> str:
    """Verify a bag, which confirms nothing but the run, each sample of which is there once."""
    try:
        verdict = check_replay(bag)
    except HnnViRosError as problem:
        assert '\n' not in str(problem), found.description
        return 'refused'
    assert '\n' not in verdict.text, found.description
    if not verdict.good:
        return 'not confirmed'
    there = content_of(bag)
    assert there <= whole, found.description
    assert cut_off or there == whole, (found.description, verdict.text)
    assert cut_off or f'of {states} samples agree' in verdict.text, found.description
    return 'confirmed'


def used_openly(bag: Path, rows: int, cut_off: bool, found: Mutant) -> None:
    """Read a bag as `train`, `evaluate` and `resume` do: what it lacks is told."""
    def rows_of_training() -> None:
        data = make_dataset(DATA, 0, Path(), [bag])
        assert len(data.t) == rows or cut_off or any(
            word in data.description for word in ('damaged', 'count', 'left out', 'resampled')
        ), (found.description, data.description)

    def motions() -> None:
        motions, told = read_motions(Path(), BagMotions(), ['angle'], [bag])
        there = sum(len(motion.t) for motion in motions)
        assert there == TICKS or cut_off or 'damaged' in told or 'count' in told, (
            found.description, told)

    def resumption() -> None:
        resumed = resume(bag)
        assert resumed.step == 2 * TICKS or cut_off or resumed.damage, found.description
    for use in (rows_of_training, motions, resumption):
        try:
            use()
        except HnnViRosError as problem:
            assert '\n' not in str(problem), found.description
