# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Studies of machines that are simulated: their equations, messages and measures."""

from dataclasses import replace
from pathlib import Path

import hnn_vi_ros
from hnn_vi_ros.identify.free_numbers import free_scene
from hnn_vi_ros.learning import load_machine, read_motions
from hnn_vi_ros.learning.data.arrays import Archive
from hnn_vi_ros.learning.data.motions import smoothed, train_and_test
from hnn_vi_ros.learning.fit.config import find_config
from hnn_vi_ros.learning.judging.energy import balance
import numpy as np
import pytest
from studies import simulated_arm
from studies.beyond_data import Machine, REAL, runs_for_test, step, write_machine
from studies.identify_real import CASES, motions_of, predicted, scene_of
from studies.simulated_arm import followed_times, JOINTS, LEAST, MEAN, the_arm, write_arm


# The machines of beyond_data.

def energy(machine: Machine, q: np.ndarray, v: np.ndarray) -> float:
    """Return the energy of two links, a rotor that its gear turns, and the ripple."""
    (I1, I2), (g1, g2) = machine.inertia, machine.gravity
    first, second = v[0, 0], v[0].sum()
    links = 0.5 * I1 * first**2 + 0.5 * I2 * second**2 + machine.coupling * np.cos(
        q[0, 1]) * first * second
    rotor = 0.5 * machine.rotor * (first + machine.gear * v[0, 1])**2
    return links + rotor - g1 * np.cos(q[0, 0]) - g2 * np.cos(q[0].sum()) - \
        machine.ripple / 12.0 * np.cos(12.0 * q[0, 1])


def test_machine_without_friction_conserves_its_energy():
    machine = Machine.of(0)
    free = machine._replace(viscous=0.0 * machine.viscous, coulomb=0.0 * machine.coulomb)
    q, v, none = np.array([[0.5, -0.9]]), np.array([[2.0, -3.0]]), np.zeros((1, 2))
    before = energy(free, q, v)
    for _ in range(500):
        q, v = step(free, q, v, none, 1e-3)
    # Of order 4, with rates of some 36 rad/s (12 times 3 rad/s): (36e-3)^4 of about 5 J.
    assert abs(energy(free, q, v) - before) < 1e-5
    for _ in range(500):
        q, v = step(machine, q, v, none, 1e-3)
    assert energy(machine, q, v) < before


def test_second_half_of_the_runs_is_twice_as_fast(tmp_path: Path):
    write_machine(tmp_path / 'machine.npz', 0)
    arrays = Archive(tmp_path / 'machine.npz').arrays
    assert {key.partition('/')[2] for key in arrays} == {'t', 'q', 'dq', 'tau'}
    slow, fast = (np.sqrt(np.mean([arrays[f'{name}_{k}/dq']**2 for k in range(4)]))
                  for name in ('slow', 'fast'))
    assert 1.5 * slow < fast < 3.0 * slow


def test_runs_are_split_by_peaks_in_both_directions():
    """The runs differ in the force only; its sign does not matter."""
    arrays = {f'{run}/{key}': np.array([0.0, peak if key == 'tau' else 1.0]) for run, peak in zip(
        'abcd', (1.0, -4.0, 3.0, 2.0), strict=True) for key in ('t', 'q', 'dq', 'tau')}
    assert [runs_for_test(f'{REAL}, {way} force', arrays) for way in ('rising', 'falling')] == [
        ['c', 'b'], ['d', 'a']]


# The simulated arm.

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


# Real pendulums, on motions that their scenes make: the data are not shipped.

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
    found = predicted(scene, case)(motion, np.array([0, 20]), 50)
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
