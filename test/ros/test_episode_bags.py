# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Episodes of sweeps as bags: what the simulator would have recorded, and replayed as its own."""

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.recording.bags.mcap_reader import BagReader
from hnn_vi_ros.ros.replay.episode_bags import main
from hnn_vi_ros.ros.replay.recorded_run import RecordedRun
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.sweeps.running import sweep
from messages import refused
import numpy as np
import pyarrow.parquet as pq
import pytest
from recorded import assert_agrees, record_run
import yaml

SWEEP = {'scene': 'brownian_oscillator', 'duration': 0.5, 'every': 5, 'seed': 2, 'vary': [
    {'kind': 'values', 'key': 'initial_state.q.x', 'values': [0.5, 1.0]},
    {'kind': 'repeats', 'count': 2}]}


@pytest.fixture(scope='module')
def bags(tmp_path_factory):
    """Return the folder of bags of a sweep with noise, of all but the first of four."""
    folder = tmp_path_factory.mktemp('bags')
    (folder / 'sweep.yaml').write_text(yaml.safe_dump(SWEEP))
    assert main([str(folder / 'sweep.yaml'), '--episodes', 'mcap', '--select', '1:4',
                 '--out', str(folder / 'out')]) == 0
    return folder / 'out'


def test_bags_of_episodes_are_confirmed_by_replay(bags):
    names = [f'episode-{index:06d}' for index in (1, 2, 3)]
    assert sorted(path.name for path in bags.iterdir()) == names
    for name in names:
        assert_agrees(bags / name, 10)


def test_bags_of_episodes_hold_the_trajectories_of_the_sweep(bags, tmp_path):
    rows = pq.read_table(sweep(SWEEP, tmp_path / 'out') / 'part-000000.parquet').to_pylist()
    for row in rows[1:]:
        bag = bags / f'episode-{row["index"]:06d}'
        *_, (stamp, q, p) = RecordedRun(bag).samples()
        # With noise trajectories step one by one, here and there.
        assert (stamp, q.tolist(), p.tolist()) == (
            500_000_000, [row['q_x']], [row['p_x']])
        told = yaml.safe_load(BagReader(bag).attachment('sweep.yaml'))
        assert told['index'] == row['index']
        assert told['values'] == {'initial_state.q.x': row['initial_state.q.x']}
    assert len({row['q_x'] for row in rows}) == 4


def test_bags_of_episodes_are_made_as_recordings_are(bags, tmp_path):
    recorded = BagReader(record_run(
        tmp_path / 'bag', load_scene('brownian_oscillator'), 10, rate=20.0))
    written = BagReader(bags / 'episode-000001')

    def described(reader):
        return {(channel.topic, channel.message_encoding, reader.schemas[channel.schema_id].name,
                 reader.schemas[channel.schema_id].data, *channel.metadata.items())
                for channel in reader.channels.values()}
    assert described(written) == described(recorded)
    times = [[message.time for message in reader.messages(list(reader.channels))]
             for reader in (written, recorded)]
    assert np.array_equal(*times)


def test_bags_that_are_there_are_not_overwritten(bags):
    with refused(RecordingError):
        main([str(bags.parent / 'sweep.yaml'), '--episodes', 'mcap', '--select', '1',
              '--out', str(bags)])
