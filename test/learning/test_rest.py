# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A free body is at rest before the release, in a pause, at the end; joined motions are cut."""

from hnn_vi_ros.learning.data.motions import even_motions, Motion, MotionData, Recording
from hnn_vi_ros.learning.data.rest import cut_at_rest
from hnn_vi_ros.learning.data.sampling import velocity_jumps
import numpy as np
import pytest
from scipy.integrate import solve_ivp

SPACING = 0.02
T = SPACING * np.arange(1500)


def swing(start: float, damping: float = 0.1) -> np.ndarray:
    """Return a pendulum that is released at an angle."""
    return solve_ivp(lambda _, y: [y[1], -20.0 * np.sin(y[0]) - damping * y[1]], (0.0, T[-1]),
                     [start, 0.0], 'DOP853', T, rtol=1e-10, atol=1e-12).y[0]


def hold(angle: float, samples: int, tremor: float = 0.0) -> np.ndarray:
    """Return an angle at which a hand holds a body."""
    return angle + tremor * np.sin(0.9 * np.arange(samples))


def lift(low: float, high: float) -> np.ndarray:
    return low + (high - low) * 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, 40)))


# Parts of a log, and those of them in which the body moves freely.
CUT = {
    'before the release': ([hold(1.0, 75), swing(1.0)], [1]),
    'a hand that trembles': ([hold(0.6, 150, 0.004), swing(0.6)], [1]),
    'quanta': ([hold(1.0, 75), np.round(swing(1.0), 2)], [1]),
    'lift before the release': ([hold(0.0, 100), lift(0.0, 1.0), hold(1.0, 80), swing(1.0)], [3]),
    'pause between two swings': (
        [swing(1.0), hold(swing(1.0)[-1], 200), lift(swing(1.0)[-1], 0.8), hold(0.8, 80),
         swing(0.8)], [0, 4]),
    'short hold after a lift': ([hold(0.0, 20), lift(0.0, 1.0), hold(1.0, 30), swing(1.0)], [3]),
    'at the end': ([swing(1.0, 1.5), hold(0.0, 400)], [0])}
KEPT = {
    'swing': swing(1.0), 'turning near the top': swing(3.1, 0.0),
    'over the top': solve_ivp(
        lambda _, y: [y[1], -20.0 * np.sin(y[0])], (0.0, T[-1]), [0.0, 8.945], 'DOP853', T,
        rtol=1e-10, atol=1e-12).y[0],
    'double well': solve_ivp(
        lambda _, y: [y[1], 6.0 * (y[0] - y[0]**3) - 0.05 * y[1]], (0.0, T[-1]), [1.5, 0.0],
        'DOP853', T, rtol=1e-10, atol=1e-12).y[0],
    'strong damping': swing(1.0, 4.0)[:100],
    'dry friction': solve_ivp(
        lambda _, y: [y[1], -20.0 * y[0] - 0.6 * np.tanh(y[1] / 0.01)], (0.0, T[400]), [1.0, 0.0],
        'LSODA', T[:401], rtol=1e-10, atol=1e-12).y[0],
    'beats': np.stack([np.cos(4.0 * T) + sign * np.cos(4.2 * T) for sign in (1, -1)], axis=-1),
    'noise alone': np.random.default_rng(1).normal(size=len(T)), 'constant': 0.0 * T}


def noisy(q: np.ndarray, noise: float) -> np.ndarray:
    return q.reshape(len(q), -1) + noise * np.random.default_rng(0).normal(size=(len(q), 1))


@pytest.mark.parametrize('noise', [0.0, 2e-3, 2e-2])
@pytest.mark.parametrize('case', CUT)
def test_standstill_is_cut_and_said(case, noise):
    pieces, free = CUT[case]
    q = noisy(np.concatenate(pieces), noise)
    ends = np.cumsum([0, *map(len, pieces)])
    parts, said = cut_at_rest(SPACING * np.arange(len(q)), q)
    assert 'stands still from' in said and len(parts) == len(free)
    assert ('moved by hand' in said) == (case in ('lift before the release',
                                                  'pause between two swings',
                                                  'short hold after a lift'))
    for part, k in zip(parts, free, strict=True):
        # A fading motion ends within some samples of noise. A twentieth of the range, 1 - cos of
        # 0.45 rad, hides 0.1 s of a release at 4.5 rad/s, and noise of 0.02 rad as much again.
        assert ends[k] <= part[0] <= ends[k] + 0.2 / SPACING
        assert part[-1] < ends[k + 1] + 5


@pytest.mark.parametrize('noise', [0.0, 2e-3])
@pytest.mark.parametrize('case', KEPT)
def test_free_motion_is_not_cut(case, noise):
    q = noisy(KEPT[case], noise)
    parts, said = cut_at_rest(T[:len(q)], q)
    assert not said and len(parts) == 1 and len(parts[0]) == len(q)


def test_steps_of_a_coarse_sensor_are_no_rest():
    assert not cut_at_rest(T, 0.4 * np.round(noisy(swing(1.0, 0.0), 2e-3) / 0.4))[1]


@pytest.mark.parametrize('noise', [0.0, 2e-3, 1e-2])
def test_wrong_stamp_is_no_rest(noise):
    q, t = noisy(swing(1.0), noise), T.copy()
    t[700] = t[699] + 1e-3
    (motion,), said = even_motions(Recording([Motion('log', 'log', t, q)], 'log', ''),
                                   MotionData())
    assert len(motion.t) == len(T) and 'stands still' not in said


@pytest.mark.parametrize('noise', [0.0, 2e-3])
@pytest.mark.parametrize('measured', [False, True])
def test_motions_joined_at_one_place_are_cut(noise, measured):
    one = solve_ivp(lambda _, y: [y[1], -20.0 * np.sin(y[0])], (0.0, T[-1]), [1.0, 0.0], 'DOP853',
                    T, rtol=1e-10, atol=1e-12).y
    end = 600 + int(np.argmax(np.abs(one[1, 600:660])))
    # The second goes back the way that the first came.
    q, v = np.hstack([one[:, :end], one[:, end - 1::-1] * [[1.0], [-1.0]]])
    random = np.random.default_rng(0)
    log = Motion('log', 'log', SPACING * np.arange(len(q)), noisy(q, noise),
                 (v + 5.0 * noise * random.normal(size=len(v)))[:, None] if measured else None)
    motions, said = even_motions(Recording([log], 'log', ''), MotionData())
    assert [len(motion.t) for motion in motions] == [end, end]
    assert f'velocity of coordinate 1 jumps in a sample (at {SPACING * end:.6g} s)' in said


def ball(t: np.ndarray) -> np.ndarray:
    """Return a ball that bounces on the ground, at 1 kHz."""
    return 1.0 - 4.905 * ((t + 0.45152) % 0.90305 - 0.45152)**2


@pytest.mark.parametrize('q', [
    ball(1e-3 * np.arange(4000)), swing(1.0, 0.0), swing(3.1, 0.0), KEPT['dry friction'],
    KEPT['double well'], np.round(swing(1.0), 2), 1.0 / (1.0 + (10.0 * np.sin(T))**2),
    np.cumsum(np.random.default_rng(2).normal(size=1000))], ids=range(8))
@pytest.mark.parametrize('noise', [0.0, 2e-3])
def test_no_velocity_jumps_in_one_motion(q, noise):
    t = (1e-3 if len(q) == 4000 else SPACING) * np.arange(len(q))
    assert not velocity_jumps(t, noisy(q, noise)[:, 0], None).size


def test_rest_of_a_driven_machine_is_kept_and_that_of_a_free_one_is_in_the_description():
    q = noisy(np.concatenate([hold(1.0, 75), swing(1.0)]), 2e-3)
    t, tau = SPACING * np.arange(len(q)), np.zeros((len(q), 1))
    for force, count in ((0.0, 1500), (1.0, 1575)):
        (motion,), said = even_motions(Recording(
            [Motion('log', 'log', t, q, tau=tau + force)], 'log', ''), MotionData())
        assert abs(len(motion.t) - count) < 20
        assert ('log stands still from 0 to 1.' in said) == (not force)
