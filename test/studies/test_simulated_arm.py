# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The simulated arm: that its messages are those of a robot, and how long one is followed."""

from hnn_vi_ros.learning.data.runs import smoothed, train_and_test
from hnn_vi_ros.learning.data.sources import read_motions
from hnn_vi_ros.learning.fit.config import find_config, load_machine
from hnn_vi_ros.learning.judging.evaluation import balance
import numpy as np
import pytest
from studies import simulated_arm
from studies.simulated_arm import followed_times, JOINTS, LEAST, MEAN, the_arm, write_arm


def test_messages_are_late_lost_and_quantised_and_obey_the_arm(tmp_path, monkeypatch):
    monkeypatch.setattr(simulated_arm, '_DURATION', 4.0)
    file = tmp_path / 'arm.npz'
    write_arm(file)
    with np.load(file) as runs:
        intervals = np.concatenate([np.diff(runs[f'train_{k}/t']) for k in range(6)])
        counts = runs['train_0/q'] * 4096 / (2.0 * np.pi)
    assert np.abs(counts - np.round(counts)).max() <= 1e-9
    # Of 999 intervals of each run 2 % are twice as long; jitter of 0.4 ms at both ends.
    lost = (intervals > 0.006).mean()
    assert 0.01 <= lost <= 0.03
    assert np.std(intervals[intervals < 0.006]) == pytest.approx(0.0004 * 2**0.5, rel=0.05)
    config = load_machine(find_config('two_link_arm_chirps'))
    motions, _ = read_motions(file, config.data, JOINTS, [str(file)])
    train, test = train_and_test(motions, config.data.test_runs)
    assert (len(train), len(test)) == (6, 4)
    # What motors and friction do is what the energy of the arm changes by.
    arm, effects = the_arm()
    for motion in train:
        found = balance(arm, effects, motion)
        # Of noise of 0.03 rad/s the filter leaves 0.02, in H some 0.02 of its range.
        assert np.abs(found.energy - found.energy[0] - found.work).max() <= 0.05 * np.ptp(
            found.energy)


def test_run_is_followed_until_one_coordinate_is_off_by_two_fifths_of_its_deviation(tmp_path):
    t = 0.01 * np.arange(1001)
    q = np.stack([np.sin(t), 3.0 * np.cos(2.0 * t)], axis=-1)
    motions = [smoothed(name, t, q, None, np.zeros_like(q), 40.0) for name in 'abcd']
    deviation = q.std(axis=0)

    def predict(motion, starts, count):
        off = np.array([0.0, 0.0 if motion.name == 'a' else 0.41]) * deviation
        return (motion.q + off * (t >= 5.0)[:, None])[None]
    found = followed_times(predict, motions, tmp_path)
    assert found == {MEAN: [pytest.approx((10.01 + 3 * 5.0) / 4)], LEAST: [pytest.approx(5.0)]}
    # Nor is what is no number followed.
    assert followed_times(lambda *_: np.full((1, *q.shape), np.nan), motions, tmp_path) == {
        MEAN: [0.0], LEAST: [0.0]}
