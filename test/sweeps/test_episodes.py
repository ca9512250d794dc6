# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Episodes of sweeps: which are written, and a LeRobot dataset read by the rules of its format."""

import json
from pathlib import Path

from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.sweeps import lerobot
from hnn_vi_ros.sweeps.episodes import selected
from hnn_vi_ros.sweeps.sweep import main
from hnn_vi_ros.trajectory.simulate import simulate
from messages import refused
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from rerun.experimental import LeRobotReader

# The third one is no pendulum; the fourth ends by its event.
SCENE = """\
hamiltonian: {kind: pendulum, mass: 1.0, length: 1.0, gravity: 9.81}
integrator: {kind: variational_euler}
step_size: 0.01
initial_state: {q: [1.0], p: [0.0]}
events: [{when: angle = -1.2, then: stop}]
"""
SWEEP = """\
description: pendulums that swing
scene: scene.yaml
duration: 1.0
every: 2
vary:
- {kind: values, key: hamiltonian.length, values: [1.0, -1.0]}
- {kind: values, key: initial_state.q.angle, values: [0.5, 1.5]}
"""


@pytest.fixture(scope='module')
def sweep_file(tmp_path_factory):
    """Return a sweep of four trajectories."""
    folder = tmp_path_factory.mktemp('episodes')
    (folder / 'scene.yaml').write_text(SCENE)
    (folder / 'sweep.yaml').write_text(SWEEP)
    return folder / 'sweep.yaml'


def lerobot_words(sweep_file: Path, out: Path, *more: str) -> list[str]:
    """Return the words that make a dataset of a sweep."""
    return [str(sweep_file), '--episodes', 'lerobot', '--out', str(out), *more]


def frames_of(root: Path) -> tuple[dict, pa.Table, pa.Table]:
    """Return the info, the episodes and the frames of a dataset, found by its own templates."""
    info = json.loads((root / 'meta' / 'info.json').read_text())
    episodes = pa.concat_tables([pq.read_table(path) for path in sorted(
        (root / 'meta' / 'episodes').glob('*/*.parquet'))])
    parts = {}
    for row in episodes.to_pylist():
        path = info['data_path'].format(chunk_index=row['data/chunk_index'],
                                        file_index=row['data/file_index'])
        parts[path] = pq.read_table(root / path)
    return info, episodes, pa.concat_tables(parts.values())


def test_lerobot_dataset_is_read_by_the_rules_of_its_format(sweep_file, tmp_path, capsys):
    out = tmp_path / 'dataset'
    assert main(lerobot_words(sweep_file, out)) == 0
    assert capsys.readouterr().out.startswith(
        f'{out}: 2 of 4 episodes; 2 not: ') and (out / 'meta' / 'tasks.parquet').is_file()
    info, episodes, frames = frames_of(out)
    assert (info['codebase_version'], info['fps'], info['video_path']) == ('v3.0', 50, None)
    assert (info['total_episodes'], info['total_frames'], info['total_tasks']) == (
        2, len(frames), 1)
    assert info['splits'] == {'train': '0:2'}
    # Each feature is a column of its type; of several numbers, of lists of its length.
    assert set(frames.column_names) == set(info['features'])
    for name, feature in info['features'].items():
        kind, (size,) = frames.schema.field(name).type, feature['shape']
        if size > 1:
            assert kind.list_size == size == len(feature['names'])
            kind = kind.value_type
        assert kind == pa.from_numpy_dtype(feature['dtype'])
    assert frames['index'].to_pylist() == list(range(len(frames)))
    for number, (row, q) in enumerate(zip(episodes.to_pylist(), (0.5, 1.5), strict=True)):
        part = frames.slice(row['dataset_from_index'], row['length'])
        assert row['dataset_to_index'] == row['dataset_from_index'] + row['length']
        assert set(part['episode_index'].to_pylist()) == {row['episode_index']} == {number}
        assert row['tasks'] == ['pendulums that swing'] and row['sweep/index'] == number
        assert json.loads(row['sweep/values']) == {
            'hamiltonian.length': 1.0, 'initial_state.q.angle': q}
        found = simulate(sweep_file.parent / 'scene.yaml', 1.0, initial_state=([q], [0.0]),
                         every=2)
        # To the last sample before the event, which comes between two steps.
        count = len(found.t) - len(found.events)
        assert row['length'] == count and (count < 51) == (q == 1.5)
        expected = np.hstack([found.q, found.p])[:count].astype(np.float32)
        assert np.array(part['observation.state'].to_pylist(), np.float32).tolist() == \
            expected.tolist()
        assert part['frame_index'].to_pylist() == list(range(count))
        # What readers check: frames lie 1 / fps apart to 1e-4 s.
        assert np.abs(part['timestamp'].to_numpy() - found.t[:count]).max() < 1e-6
    tasks = pq.read_table(out / 'meta' / 'tasks.parquet')
    assert tasks.to_pylist() == [{'task_index': 0, 'task': 'pendulums that swing'}]
    assert tasks.schema.pandas_metadata['index_columns'] == ['task']


def test_statistics_of_a_lerobot_dataset_are_those_of_its_frames(sweep_file, tmp_path):
    out = tmp_path / 'dataset'
    main(lerobot_words(sweep_file, out, '--select', '0:2'))
    _, episodes, frames = frames_of(out)
    stats = json.loads((out / 'meta' / 'stats.json').read_text())
    whole = np.array(frames['observation.state'].to_pylist())
    for name, expected in (('min', whole.min(axis=0)), ('max', whole.max(axis=0)),
                           ('mean', whole.mean(axis=0)), ('std', whole.std(axis=0)),
                           ('count', [len(whole)])):
        assert stats['observation.state'][name] == pytest.approx(expected, rel=1e-12, abs=1e-12)
    first = episodes.to_pylist()[0]
    part = frames.slice(0, first['length'])['timestamp'].to_numpy()
    assert first['stats/timestamp/max'] == [part.max()]
    assert first['stats/timestamp/count'] == [len(part)]


def test_another_reader_takes_a_lerobot_dataset_of_many_files(sweep_file, tmp_path, monkeypatch):
    # A file for each episode, and a folder for each file.
    monkeypatch.setattr(lerobot, '_MEGABYTES', 0)
    monkeypatch.setattr(lerobot, '_CHUNK', 1)
    out = tmp_path / 'dataset'
    main(lerobot_words(sweep_file, out, '--select', '0,1'))
    assert sorted(path.relative_to(out).as_posix() for path in out.glob('data/*/*')) == [
        'data/chunk-000/file-000.parquet', 'data/chunk-001/file-000.parquet']
    reader = LeRobotReader(out)
    assert reader.version == 'v3' and reader.episodes() == [0, 1]
    _, episodes, _ = frames_of(out)
    assert [row['meta/episodes/chunk_index'] for row in episodes.to_pylist()] == [0, 1]
    assert any('state' in str(chunk.entity_path) for chunk in reader.stream(1))


def test_selections_are_numbers_and_slices():
    assert selected('', 3) == [0, 1, 2]
    assert selected('7, 2,2:9:3', 10) == [2, 5, 7, 8]
    assert selected('8:', 10) == [8, 9] and selected('::5', 10) == [0, 5]
    for text in ('x', '1:2:3:4', '-1', '10', '1,', '5:5', '0:9:0'):
        with refused(HnnViRosError):
            selected(text, 10)


@pytest.mark.parametrize('arguments', [
    ['--select', '0'], ['--episodes', 'lerobot', '--jobs', '2'],
    ['--episodes', 'lerobot', '--shard', '0/2'], ['--episodes', 'lerobot', '--select', '4'],
    ['--episodes', 'mcap', '--select', '0']], ids=' '.join)
def test_episodes_that_cannot_be_written_are_one_line(sweep_file, tmp_path, arguments):
    with refused(HnnViRosError):
        main([str(sweep_file), '--out', str(tmp_path / 'out'), *arguments])
    assert not (tmp_path / 'out').exists()


def test_lerobot_dataset_needs_whole_samples_a_second_and_a_folder_of_its_own(
        sweep_file, tmp_path):
    other = sweep_file.with_name('other.yaml')
    other.write_text(SWEEP.replace('every: 2', 'every: 3'))
    for file, out in ((other, tmp_path / 'out'), (sweep_file, tmp_path)):
        with refused(HnnViRosError):
            main(lerobot_words(file, out))


def test_dataset_that_cannot_be_written_whole_leaves_nothing(sweep_file, tmp_path):
    text = SWEEP.replace('scene.yaml', str(sweep_file.parent / 'scene.yaml'))
    # Of such a momentum the energy is beyond float32.
    text = text.replace('hamiltonian.length', 'initial_state.p.angle')
    (tmp_path / 'sweep.yaml').write_text(text.replace('[1.0, -1.0]', '[0.0, 1.0e+20]'))
    command = lerobot_words(tmp_path / 'sweep.yaml', tmp_path / 'out')
    with refused(HnnViRosError):
        main(command)
    assert not (tmp_path / 'out').exists()
    assert main([*command, '--select', '0:2']) == 0
