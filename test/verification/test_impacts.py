# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Impacts at steps that are much longer than the time between them, against exact paths."""

from helpers import Uncompiled
from hnn_vi_ros.effects import bouncing, EFFECTS
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.simulation import Simulation
import numpy as np
import pytest
from scipy.integrate import solve_ivp

pytestmark = pytest.mark.filterwarnings('ignore:Uncompiled is not a tanh network')

G = 9.81


def falling(method: str, h: float, restitution: float, height: float = 1.0) -> Simulation:
    """Return a mass of 1 kg that falls from rest on a floor at z = 0."""
    return Simulation(
        Uncompiled(HAMILTONIANS['free_particle'](names=['z'])), INTEGRATORS[method](), h,
        [height], [0.0], [EFFECTS['gravity']('z'), EFFECTS['impact']('z', 0.0, 'above',
                                                                     restitution)], 'stop')


def fallen(t: float, restitution: float, height: float = 1.0) -> tuple[float, float]:
    """Return the height and the speed of that mass."""
    speed = np.sqrt(2.0 * G * height)
    start = -speed / G
    while start + 2.0 * speed / G <= t:
        start, speed = start + 2.0 * speed / G, restitution * speed
    return speed * (t - start) - 0.5 * G * (t - start) ** 2, speed - G * (t - start)


@pytest.mark.parametrize('method', ['stormer_verlet', 'gauss4'])
@pytest.mark.parametrize('h', [1.0, 4.0])
def test_more_than_eight_bounces_in_a_step_are_all_followed(method, h):
    """With e = 0.9 eighteen bounces lie between 4 s and 8 s, and 0.04 J are left of 9.81 J."""
    simulation = falling(method, h, 0.9)
    for _ in range(round(8.0 / h)):
        simulation.advance(1)
        height, speed = fallen(simulation.time, 0.9)
        # A polynomial of degree two is integrated exactly. Each of 50 times of impact rounds at
        # 4 eps (1 m + 5 m/s t), which the speed, below 5 m/s, turns into a height.
        assert simulation.q[0] == pytest.approx(height, abs=50 * 5.0 * 4e-16 * 41.0)
        assert simulation.p[0] == pytest.approx(speed, abs=50 * G * 4e-16 * 41.0)
    assert simulation.energy > 0.04
    assert abs(simulation.energy_balance) < 1e-13


@pytest.mark.parametrize('restitution, h', [(0.0, 1.0), (0.5, 0.3), (0.9, 3.0), (0.99, 50.0)])
def test_body_comes_to_rest_only_when_the_series_of_its_flights_has_ended(restitution, h):
    """It ends at t1 (1 + 2 e / (1 - e)), with t1 the time of the fall."""
    simulation = falling('stormer_verlet', h, restitution)
    end = np.sqrt(2.0 / G) * (1.0 + 2.0 * restitution / (1.0 - restitution))
    while simulation.time + h < end:
        simulation.advance(1)
        assert simulation.energy > 0.0
    simulation.advance(1)
    assert (simulation.q[0], simulation.p[0]) == (0.0, 0.0)
    assert simulation.work == pytest.approx(-G, rel=1e-12)


@pytest.mark.parametrize('phase', [0.5, 1.1, 1.7])
@pytest.mark.parametrize('wall', [-0.999, -0.7])
def test_wall_that_is_crossed_and_left_within_a_step_is_met(phase, wall):
    """An oscillator of 1 rad/s, h = 1 s: x = cos(t + phase), mirrored in time at each impact."""
    hamiltonian = Uncompiled(HAMILTONIANS['harmonic_oscillator']())
    name = hamiltonian.coordinates[0].name
    simulation = Simulation(hamiltonian, INTEGRATORS['gauss16'](), 1.0, [np.cos(phase)],
                            [-np.sin(phase)], [EFFECTS['impact'](name, wall)], 'stop')
    q, _ = simulation.record(20, 1)
    half = np.arccos(wall)
    t = (np.arange(1, 21) + phase + half) % (2.0 * half) - half
    # A wall at -0.999 is met at sin = 0.045 m/s: rounding of 4 eps makes 2e-14 s there, and five
    # impacts lie within 20 s; the method itself errs by 1e-15 a step.
    assert np.abs(q[:, 0] - np.cos(t)).max() < 1e-12


def test_wall_is_met_in_a_step_of_a_whole_period():
    """The path begins and ends at its top with no speed: only its acceleration tells of more."""
    hamiltonian = Uncompiled(HAMILTONIANS['harmonic_oscillator']())
    simulation = Simulation(
        hamiltonian, INTEGRATORS['gauss16'](), 2.0 * np.pi, [1.0], [0.0],
        [EFFECTS['impact'](hamiltonian.coordinates[0].name, -0.9, restitution=0.5)], 'stop')
    simulation.advance(1)
    # The speed, sin(arccos(0.9)), is halved; the method errs by 1e-6 over the whole period.
    assert simulation.work == pytest.approx(-0.75 * 0.5 * (1.0 - 0.81), abs=1e-6)


@pytest.mark.parametrize('depth, impacts', [(1e-9, 1), (-1e-9, 0)])
def test_path_that_all_but_touches_a_wall_meets_it_or_does_not(depth, impacts):
    """A ball thrown at a ceiling: its top, at 0.5 s, lies a nanometre above or below that."""
    top = G * 0.125
    simulation = Simulation(
        Uncompiled(HAMILTONIANS['free_particle'](names=['z'])), INTEGRATORS['stormer_verlet'](),
        0.8, [0.0], [0.5 * G], [EFFECTS['gravity']('z'),
                                EFFECTS['impact']('z', top - depth, 'below', 0.0)], 'stop')
    simulation.advance(1)
    # An impact takes the kinetic energy that it finds there, g times the depth.
    assert simulation.work == pytest.approx(-impacts * G * depth, rel=1e-5, abs=1e-20)


@pytest.mark.parametrize('restitution', [1.0, 0.8])
def test_two_walls_are_met_in_turn_within_one_step(restitution):
    """A free body between x = 0 and x = 1 meets the walls at intervals of 1 / (e^k v)."""
    simulation = Simulation(
        Uncompiled(HAMILTONIANS['free_particle'](names=['x'])), INTEGRATORS['stormer_verlet'](),
        1.0, [0.3], [5.0], [EFFECTS['impact']('x', 0.0, 'above', restitution),
                            EFFECTS['impact']('x', 1.0, 'below', restitution)], 'stop')
    simulation.advance(2)
    x, speed, left = 0.3, 5.0, 2.0
    while True:
        way = 1.0 - x if speed > 0.0 else x
        if way / abs(speed) > left:
            break
        left -= way / abs(speed)
        x, speed = (1.0 if speed > 0.0 else 0.0), -restitution * speed
    assert simulation.q[0] == pytest.approx(x + speed * left, abs=1e-13)
    assert simulation.p[0] == pytest.approx(speed, abs=1e-13)


@pytest.mark.parametrize('method', ['generalized_leapfrog', 'implicit_midpoint'])
def test_wall_that_a_body_rests_on_does_no_work_on_what_moves_along_it(method):
    """A charge is pressed on a wall and moves along it: the magnetic force is held by the wall."""
    simulation = Simulation(
        Uncompiled(HAMILTONIANS['free_particle'](names=['x', 'y'])), INTEGRATORS[method](), 0.02,
        [0.0, 0.0], [0.0, 1.0], [
            EFFECTS['gravity']('x', 1.0, 10.0), EFFECTS['magnetic_field'](['x', 'y'], 1.0, 1.0),
            EFFECTS['impact']('x', 0.0, 'above', 0.0)], 'stop')
    energy = simulation.energy
    simulation.advance(50)
    # In each step x leaves the wall and comes back, so that its means cancel in y: what is left
    # is the rounding of 50 steps, of energies and positions of order 1.
    assert simulation.q[0] == 0.0
    assert simulation.p[1] - 0.5 * simulation.q[0] == pytest.approx(1.0, abs=50 * 4e-16)
    assert simulation.energy == pytest.approx(energy, abs=50 * 4e-16)
    assert abs(simulation.energy_balance) < 50 * 4e-16


def test_what_is_coupled_to_a_body_at_a_stop_moves_with_the_order_of_the_method():
    """The upper rod of a double pendulum lies on a stop: the lower one is a pendulum."""
    lower = HAMILTONIANS['pendulum']()

    def rates(t: float, z: np.ndarray) -> list[float]:
        dH_dq, dH_dp = lower.gradient(z[:1], z[1:])
        return [dH_dp[0], -dH_dq[0]]

    exact = solve_ivp(rates, (0.0, 1.0), [0.8, 0.0], method='DOP853', rtol=1e-12, atol=1e-12)
    errors, sizes = [], np.array([0.02, 0.01])
    for h in sizes:
        simulation = Simulation(
            Uncompiled(HAMILTONIANS['double_pendulum']()), INTEGRATORS['generalized_leapfrog'](),
            h, [0.5, 0.8], [0.0, 0.0], [EFFECTS['impact']('angle1', 0.5, 'above', 0.0)], 'stop')
        simulation.advance(round(1.0 / h))
        assert simulation.q[0] == 0.5
        errors.append(abs(simulation.q[1] - exact.y[0, -1]))
    # The next term of the error is h^2 smaller: 0.1 leaves a hundred times of that.
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)


def test_body_on_a_wall_leaves_it_when_it_is_pulled_away():
    """A force -cos(t) presses a mass on the floor until pi / 2; then it goes up by x'' = -cos."""
    simulation = Simulation(
        Uncompiled(HAMILTONIANS['free_particle'](names=['z'])), INTEGRATORS['stormer_verlet'](),
        0.01, [0.0], [0.0], [EFFECTS['periodic_drive']('z', 1.0, 0.5 / np.pi, np.pi),
                             EFFECTS['impact']('z', 0.0, 'above', 0.0)], 'stop')
    simulation.advance(157)
    assert (simulation.q[0], simulation.p[0]) == (0.0, 0.0)
    simulation.advance(143)
    t = 3.0
    # x' = 1 - sin t and x = t - pi / 2 + cos t from pi / 2 on; leaving up to h late costs h^2 / 2
    # in x', which lasts for 1.5 s, and the method errs by h^2 / 12 in each.
    assert simulation.p[0] == pytest.approx(1.0 - np.sin(t), abs=1e-4)
    assert simulation.q[0] == pytest.approx(t - 0.5 * np.pi + np.cos(t), abs=2e-4)


def test_step_with_more_impacts_than_can_be_followed_fails(monkeypatch):
    """An elastic ball that bounces for ever must not be taken to rest, nor let through."""
    monkeypatch.setattr(bouncing, 'MOST_IMPACTS', 20)
    simulation = falling('stormer_verlet', 1.0, 1.0, 1e-4)
    with pytest.raises(StepFailure, match='impacts cannot be followed.* s after .*smaller step'):
        simulation.advance(1)
    assert (simulation.q[0], simulation.p[0], simulation.work) == (1e-4, 0.0, 0.0)
