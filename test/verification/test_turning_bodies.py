# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Hard cases of bodies that turn: tops that sleep, tumbling, turns of nearly pi in a step."""

from helpers import long, Uncompiled
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.hamiltonians.ball_joint_pendulum import BallJointPendulum
from hnn_vi_ros.hamiltonians.free_rigid_body import FreeRigidBody
from hnn_vi_ros.hamiltonians.heavy_top import HeavyTop
from hnn_vi_ros.hamiltonians.quadrotor import Quadrotor
from hnn_vi_ros.hamiltonians.turning_body import spatial_momentum
from hnn_vi_ros.integrators.base import REASONS, TURNED
from hnn_vi_ros.integrators.lie.lie_leapfrog import LieLeapfrog
from hnn_vi_ros.integrators.lie.rotations import RETRACTIONS
from hnn_vi_ros.simulation import Simulation
import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.special import ellipk

UPRIGHT = [0.0, 0.0, 0.0, 1.0]


def tilted(angle: float) -> list[float]:
    """Return the attitude that is turned about x."""
    return [np.sin(0.5 * angle), 0.0, 0.0, np.cos(0.5 * angle)]


@pytest.mark.parametrize('share', [0.9, long(1.0), long(1.1)])
def test_top_falls_from_sleep_as_far_as_its_spin_lets_it(share: float, measured):
    """
    Let go upright but for 1e-3 rad, at 0.9, 1 and 1.1 of the critical spin p_3^2 = 4 m g l I_1.

    From rest at u_0 = cos(theta_0), u'^2 = (u_0 - u) (b (1 - u^2) - a^2 (u_0 - u)) with b =
    2 m g l / I_1 and a = p_3 / I_1: it turns back at u = x - sqrt(x^2 - 2 x u_0 + 1) with
    x = a^2 / (2 b), which is the square of the share.
    """
    top, tilt = HeavyTop(), 1e-3
    p3 = share * np.sqrt(4.0 * top.moment * top.inertia[0])
    fall = {}
    for h in (0.002, 0.001):
        run = Simulation(top, LieLeapfrog(), h, tilted(tilt), [0.0, 0.0, p3])
        q, _ = run.record(round(40.0 / h), 1)
        # 1 - u, of the third axis, without cancellation.
        fall[h] = 2.0 * (q[:, 0] ** 2 + q[:, 1] ** 2).max()
    x, rise = share ** 2, 2.0 * np.sin(0.5 * tilt) ** 2
    exact = 1.0 - x + np.sqrt((1.0 - x) ** 2 + 2.0 * x * rise)
    errors = [abs(value / exact - 1.0) for value in fall.values()]
    measured(f'fall of a top at {share} of its critical spin, relative error', 'lie_leapfrog',
             errors[1], '<= 1e-2, and a quarter of that at twice the step')
    assert errors[1] <= 1e-2 and errors[1] <= 0.3 * errors[0]


@pytest.mark.long
def test_tumbling_keeps_its_rhythm_and_its_invariants_for_a_million_steps(measured):
    """
    Turn about the middle axis but for 1e-3: it turns over again and again.

    Between two flips half of the period of Jacobi's functions passes, 2 K(m) / rate; see Landau
    and Lifshitz, eq. (37.12), with m next to 1.
    """
    body, p0, h, n = FreeRigidBody(), np.array([1e-3, 2.0, 1e-3]), 0.02, 1_000_000
    I1, I2, I3 = body.inertia
    energy, squared = 0.5 * np.sum(p0 * p0 / body.inertia), np.sum(p0 * p0)
    # The other way round where the motion is about the first axis.
    low, high = (I1, I3) if squared > 2.0 * energy * I2 else (I3, I1)
    rate = np.sqrt((high - I2) * (squared - 2.0 * energy * low) / (I1 * I2 * I3))
    modulus = ((I2 - low) * (2.0 * energy * high - squared)
               / ((high - I2) * (squared - 2.0 * energy * low)))
    run = Simulation(body, LieLeapfrog(), h, UPRIGHT, p0)
    q, p = run.record(n // 20, 20)
    flips = np.flatnonzero(np.diff(np.sign(p[:, 1])))
    between = np.diff(flips).mean() * 20 * h
    expected = 2.0 * ellipk(modulus) / rate
    measured('time between two flips, relative error', 'lie_leapfrog, free_rigid_body',
             between / expected - 1.0, '1e-3')
    assert abs(between / expected - 1.0) < 1e-3
    drift = abs(spatial_momentum(q, p) - p0).max()
    measured('spatial momentum, 1e6 steps', 'lie_leapfrog, free_rigid_body', drift, '<= 1e-12')
    assert drift <= 1e-12
    energies = body.energy(q, p)
    tenth = len(energies) // 10
    band = np.ptp(energies[:tenth])
    assert abs(energies[-tenth:].max() - energies[:tenth].max()) < 1e-2 * band
    assert abs(energies[-tenth:].min() - energies[:tenth].min()) < 1e-2 * band


@pytest.mark.parametrize('retraction', RETRACTIONS)
def test_turns_up_to_nearly_pi_are_right_and_beyond_it_fail_by_type(retraction: str):
    """About a fixed axis: in each half of a step of h = 1 the momentum asks for p / 2."""
    body, axis = Uncompiled(FreeRigidBody([1.0, 1.0, 1.0])), np.array([2.0, -1.0, 2.0]) / 3.0
    p = 5.9
    run = Simulation(body, LieLeapfrog(retraction), 1.0, UPRIGHT, p * axis, on_failure='stop')
    run.advance(1)
    np.testing.assert_allclose(run.p, p * axis, rtol=0.0, atol=1e-14)
    if retraction == 'cayley':
        # x (1 + x^2 / 4) = p / 2 for x, and a turn by 2 atan(x / 2).
        x = brentq(lambda x: x * (1.0 + 0.25 * x * x) - 0.5 * p, 0.0, 3.0, xtol=1e-15)
        p = 4.0 * np.arctan(0.5 * x)
    exact = Rotation.from_rotvec(p * axis).as_quat()
    assert min(abs(run.q - exact).max(), abs(run.q + exact).max()) < 1e-14
    run = Simulation(body, LieLeapfrog(retraction), 1.0, UPRIGHT, 6.1 * axis, on_failure='stop')
    with pytest.raises(StepFailure) as failure:
        run.advance(1)
    assert failure.value.reason == REASONS[TURNED]
    assert run.steps == 0 and run.q.tolist() == UPRIGHT


def test_body_that_a_torque_spins_up_fails_by_type_where_a_step_would_turn_it_by_3_rad():
    h, torque, inertia = 0.1, 2.0, 0.5
    run = Simulation(Uncompiled(Quadrotor(1.0, [inertia] * 3, 0.0)), LieLeapfrog('exponential'),
                     h, [0.0, 0.0, 0.0, *UPRIGHT], np.zeros(6),
                     [EFFECTS['external_force'](['body_rz'], timeout=1e9)], on_failure='stop')
    run.set_command([torque])
    with pytest.raises(StepFailure) as failure:
        run.advance(1000)
    assert failure.value.reason == REASONS[TURNED]
    # Each half of step k turns by (k + 1/2) h^2 torque / (2 I), at most by 3 rad: k <= 149.5.
    assert run.steps == 150
    assert run.p[5] == pytest.approx(150 * h * torque, rel=1e-12)
    assert run.work == pytest.approx(run.energy, rel=1e-12)


def test_ball_joint_pendulum_swings_in_a_plane_as_a_pendulum_and_spins_without_notice(measured):
    """Its quarter period is K(sin^2(theta_0 / 2)) / omega with omega^2 = m g l / I_1."""
    ball, angle = BallJointPendulum(radius=0.3), 2.0
    omega = np.sqrt(-ball.moment / ball.inertia[0])
    modulus = np.sin(0.5 * angle) ** 2
    quarter, errors = ellipk(modulus) / omega, []
    for n in (50, 100):
        run = Simulation(ball, LieLeapfrog(), quarter / n, tilted(angle), np.zeros(3))
        run.advance(n)
        # At the lowest point, with the momentum of all its energy.
        expected = -np.sqrt(2.0 * ball.inertia[0] * -ball.moment * (1.0 - np.cos(angle)))
        errors.append(np.linalg.norm([*(run.q - UPRIGHT), *(run.p - [expected, 0.0, 0.0])]))
    measured('order against the period of a pendulum', 'lie_leapfrog, ball_joint_pendulum',
             np.log2(errors[0] / errors[1]), '2 +- 0.2')
    assert abs(np.log2(errors[0] / errors[1]) - 2.0) < 0.2
    run = Simulation(ball, LieLeapfrog(), 0.01, tilted(angle), [0.0, 1.0, 0.5])
    start = spatial_momentum(run.q, run.p)[2]
    run.advance(1000)
    assert spatial_momentum(run.q, run.p)[2] == pytest.approx(start, abs=1e-13)
    assert run.p[2] == pytest.approx(0.5, abs=1e-13)
