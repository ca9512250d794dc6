# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Bags that an earlier version recorded are had again, bit by bit; see test/fixtures/recorded."""

from pathlib import Path

from hnn_vi_ros.files import share_folder
from hnn_vi_ros.kernels import identity
from hnn_vi_ros.recording import BagReader
from hnn_vi_ros.ros.replay.recorded_run import RecordedRun
from hnn_vi_ros.ros.replay.replay_check import check_replay
import pytest

RECORDED = Path(__file__).resolve().parents[1] / 'fixtures' / 'recorded'
BAGS = sorted(path.parent for path in RECORDED.glob('*/metadata.yaml'))
# What bits depend on, when the sources are meant to compute the same.
BITS = ('numpy', 'numba', 'llvmlite', 'machine', 'processor', 'processor_features')
SAMPLES = {'servo_arm': 37}


def test_bags_are_those_of_ten_scenes():
    assert [bag.name for bag in BAGS] == [
        'bouncing_mass', 'brownian_oscillator', 'damped_driven_pendulum', 'emps_drive',
        'heavy_top', 'pendulum', 'servo_arm', 'six_joint_arm', 'spherical_pendulum', 'twin_arm']
    assert RecordedRun(RECORDED / 'damped_driven_pendulum').first_step == 50
    heard = {topic.rpartition('/')[2] for name in ('servo_arm', 'twin_arm')
             for _, topic, _ in RecordedRun(RECORDED / name).commands()}
    assert heard == {'commands', 'joint_commands', 'joint_trajectory', 'observations'}


@pytest.mark.parametrize('bag', BAGS, ids=lambda bag: bag.name)
def test_recorded_bag_is_had_again_bit_by_bit(bag, tmp_path, monkeypatch):
    # Elsewhere than the bag, with the robots that are installed with the package.
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(share_folder().parents[1]))
    verdict = check_replay(bag)
    assert verdict.good, verdict.text
    there, here = BagReader(bag).metadata('hnn_vi_ros'), identity()
    if all(there[name] == here[name] for name in BITS):
        # Other sources alone would let replay explain a difference by round-off.
        assert f' of {SAMPLES.get(bag.name, 50)} samples are bit-identical' in verdict.text
        assert '; then ' not in verdict.text
