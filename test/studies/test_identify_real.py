# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The study of real pendulums, on motions that its own scenes make: the data are not shipped."""

from dataclasses import replace

import hnn_vi_ros
from hnn_vi_ros.learning.data.runs import smoothed
from hnn_vi_ros.learning.scene_numbers.free_numbers import free_scene
import numpy as np
import pytest
from studies.identify_real import CASES, motions_of, predicted, scene_of


@pytest.mark.parametrize('name', ['dfki', 'double'])
def test_scene_is_free_in_what_is_fitted_and_predicts_what_it_made(name, tmp_path):
    case = CASES[name]
    scene = scene_of(case, tmp_path, 0.05)
    free = free_scene(scene.parts(), case.free, {}, tmp_path, True)
    assert all(number.start != 0.0 for number in free.numbers)
    made = hnn_vi_ros.simulate(scene, 0.2, initial_state=([0.5, -0.3], [0.0, 0.0]))
    v = scene.create_hamiltonian().gradient(made.q, made.p)[1]
    if case.relative:
        made, v = replace(made, q=np.cumsum(made.q, axis=1)), np.cumsum(v, axis=1)
    motion = replace(smoothed('made', made.t, made.q, v, np.zeros_like(v), 40.0),
                     q_smooth=made.q, v_smooth=v)
    found = predicted(scene, case, [motion])(motion, np.array([0, 20]), 50)
    # The residuals of the steps, of 1e-16 each, and p = M v, grown by a second of motion.
    assert np.abs(found[0] - made.q[:51]).max() < 1e-11
    assert np.abs(found[1] - made.q[20:71]).max() < 1e-11


def test_absolute_angles_become_those_of_joints(tmp_path):
    t = 0.01 * np.arange(300)
    hanging = np.stack([0.3 * np.sin(5.0 * t), 0.2 * np.cos(4.0 * t)], axis=1)
    rates = np.gradient(hanging, t, axis=0)
    (tmp_path / 'multiarm_pendulum').mkdir()
    runs = ['train_00', 'val_00', 'val_01', 'val_02', 'val_03']
    np.savez(tmp_path / CASES['double'].file, dt=0.001, **{
        f'{run}/{key}': np.repeat(values, 10, axis=0)
        for run in runs for key, values in (('q', hanging + np.pi), ('dq', rates))})
    train, test = motions_of(CASES['double'], tmp_path, tmp_path)
    assert [motion.name for motion in (*train, *test)] == runs
    # Of one sample in ten, what was put there.
    np.testing.assert_allclose(np.cumsum(train[0].q, axis=1), hanging, atol=1e-12)
    np.testing.assert_allclose(np.cumsum(train[0].v, axis=1), rates, atol=1e-12)
