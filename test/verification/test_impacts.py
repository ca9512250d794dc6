# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Impacts against exact paths, also at steps much longer than the time between them."""

import re

from helpers import free, Uncompiled
from hnn_vi_ros.effects import Effect, EFFECTS, stops
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.hamiltonians import HAMILTONIANS, RigidBodyTree
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.simulation import Simulation
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from urdf_robots import mimic_tree

G = 9.81


def falling(method: str, h: float, restitution: float, height: float = 1.0, *more: Effect
            ) -> Simulation:
    """Return a mass of 1 kg that falls from rest on a floor at z = 0."""
    return Simulation(
        free('z'), INTEGRATORS[method](), h, [height], [0.0],
        [EFFECTS['gravity']('z'), EFFECTS['impact']('z', 0.0, 'above', restitution), *more],
        'stop')


def fallen(t: float, restitution: float, height: float = 1.0) -> tuple[float, float]:
    """Return the height and the speed of that mass."""
    speed = np.sqrt(2.0 * G * height)
    start = -speed / G
    while start + 2.0 * speed / G <= t:
        start, speed = start + 2.0 * speed / G, restitution * speed
    return speed * (t - start) - 0.5 * G * (t - start) ** 2, speed - G * (t - start)


@pytest.mark.parametrize('method', ['stormer_verlet', 'gauss4'])
@pytest.mark.parametrize('h, restitution, duration, impacts', [
    (0.01, 0.8, 3.5, 10), (1.0, 0.9, 8.0, 50), (4.0, 0.9, 8.0, 50)])
def test_impact_keeps_its_share_of_the_speed_and_happens_in_time_also_many_in_a_step(
        method, h, restitution, duration, impacts, measured):
    """With e = 0.9 eighteen bounces lie between 4 s and 8 s, and 0.04 J are left of 9.81 J."""
    simulation = falling(method, h, restitution)
    # A polynomial of degree two is integrated exactly. Each time of impact rounds at
    # 4 eps (1 m + 5 m/s t), which the speed, below 5 m/s, turns into a height.
    rounding = impacts * 4e-16 * (1.0 + 5.0 * duration)
    for _ in range(round(duration / h)):
        simulation.advance(1)
        height, speed = fallen(simulation.time, restitution)
        assert simulation.q[0] == pytest.approx(height, abs=5.0 * rounding)
        assert simulation.p[0] == pytest.approx(speed, abs=G * rounding)
    assert simulation.energy > 0.04
    measured('largest energy balance [J]', f'{method}, bouncing mass, h = {h:g}',
             abs(simulation.energy_balance), '< 1e-13')
    assert abs(simulation.energy_balance) < 1e-13


@pytest.mark.parametrize('restitution, h', [
    (0.0, 1.0), (0.5, 0.3), (0.5, 0.01), (0.9, 3.0), (0.99, 50.0)])
def test_body_comes_to_rest_only_when_the_series_of_its_flights_has_ended_and_stays(
        restitution, h):
    """It ends at t1 (1 + 2 e / (1 - e)), with t1 the time of the fall."""
    simulation = falling('stormer_verlet', h, restitution)
    end = np.sqrt(2.0 / G) * (1.0 + 2.0 * restitution / (1.0 - restitution))
    while simulation.time + h < end:
        simulation.advance(1)
        assert simulation.energy > 0.0
    simulation.advance(1)
    for steps in (0, 100):
        simulation.advance(steps)
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
        free('z'), INTEGRATORS['stormer_verlet'](), 0.8, [0.0], [0.5 * G],
        [EFFECTS['gravity']('z'), EFFECTS['impact']('z', top - depth, 'below', 0.0)], 'stop')
    simulation.advance(1)
    # An impact takes the kinetic energy that it finds there, g times the depth.
    assert simulation.work == pytest.approx(-impacts * G * depth, rel=1e-5, abs=1e-20)


@pytest.mark.parametrize('restitution', [1.0, 0.8])
def test_two_walls_are_met_in_turn_within_one_step(restitution):
    """A free body between x = 0 and x = 1 meets the walls at intervals of 1 / (e^k v)."""
    simulation = Simulation(
        free('x'), INTEGRATORS['stormer_verlet'](), 1.0, [0.3], [5.0],
        [EFFECTS['impact']('x', 0.0, 'above', restitution),
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
        free('x', 'y'), INTEGRATORS[method](), 0.02, [0.0, 0.0], [0.0, 1.0], [
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


@pytest.mark.parametrize('side, position', [('above', -0.3), ('below', 0.4)])
def test_impact_on_either_side_of_a_wall_mirrors_the_path(side, position):
    sign = 1.0 if side == 'above' else -1.0
    simulation = Simulation(free('x'), INTEGRATORS['implicit_midpoint'](), 0.07,
                            [position + sign], [-2.0 * sign],
                            [EFFECTS['impact']('x', position, side, 0.5)])
    q, _ = simulation.record(20, 1)
    t = 0.07 * np.arange(1, 21)
    exact = np.where(t < 0.5, 1.0 - 2.0 * t, t - 0.5)
    assert np.abs(sign * (q[:, 0] - position) - exact).max() < 1e-14 * 20


def test_elastic_impact_returns_to_its_height_for_ten_thousand_steps_without_drift(measured):
    simulation = falling('stormer_verlet', 0.01, 1.0)
    q, p = simulation.record(10_000, 1)
    assert simulation.conservative
    error = G * q[:, 0] + 0.5 * p[:, 0] ** 2 - G
    measured('energy error over 10,000 steps', 'stormer_verlet, elastic impacts',
             np.abs(error).max(), '< 1e-11')
    # Some 110 impacts and 1e4 steps, a random walk of roundings of 10 J.
    assert np.abs(error).max() < 1e-11
    # The highest of 90 samples of a flight is within g h^2 / 8 of its top.
    assert q[-100:].max() > 1.0 - G * 0.01 ** 2 / 8.0 - 1e-12


def test_body_at_rest_on_a_wall_is_lifted_off_by_a_drive():
    """It rests until F sin(w t) = m g, then m z'' = F sin(w t) - m g."""
    force, omega, h = 20.0, np.pi, 0.002
    simulation = falling('stormer_verlet', h, 0.0, 0.0, EFFECTS['periodic_drive'](
        'z', force, 0.5 * omega / np.pi, -0.5 * np.pi))
    q, p = simulation.record(200, 1)
    t, off = h * np.arange(1, 201), np.arcsin(G / force) / omega
    rests = t < off
    assert (q[rests] == 0.0).all() and (p[rests] == 0.0).all()
    late, phase = t[~rests] - off, omega * off
    gained = force / omega * (np.cos(phase) - np.cos(omega * t[~rests])) - G * late
    exact = force / omega ** 2 * (np.sin(phase) - np.sin(omega * t[~rests])) \
        + force / omega * np.cos(phase) * late - 0.5 * G * late ** 2
    assert exact[-1] > 0.05
    # It starts up to a step late, in which the force grows to F w h: v lacks F w h^2 / 2 at most.
    bound = force * omega * h ** 2
    assert np.abs(q[~rests, 0] - exact).max() < bound
    assert np.abs(p[~rests, 0] - gained).max() < bound


def test_body_that_was_lifted_off_bounces_where_it_lands():
    """Pushed up by 20 N for 0.2 s; with e = 0.5 a quarter of the height comes back."""
    simulation = falling(
        'stormer_verlet', 0.001, 0.5, 0.0, EFFECTS['external_force'](['z'], 0.2))
    simulation.advance(20)
    assert (simulation.q[0], simulation.p[0]) == (0.0, 0.0)
    simulation.set_command([20.0])
    q, _ = simulation.record(1400, 1)
    rise = (20.0 - G) * 0.2
    top = 0.1 * rise + rise ** 2 / (2.0 * G)
    # A top is sampled within g h^2 / 8.
    assert q.max() == pytest.approx(top, abs=G * 1e-6)
    landed = int(1000 * (0.2 + rise / G + np.sqrt(2.0 * top / G))) + 1
    assert q[landed:].max() == pytest.approx(0.25 * top, abs=G * 1e-6)
    assert abs(simulation.energy_balance) < 1e-12


def test_step_with_more_impacts_than_can_be_followed_fails(monkeypatch):
    """An elastic ball that bounces for ever must not be taken to rest, nor let through."""
    monkeypatch.setattr(stops, 'MOST_IMPACTS', 20)
    simulation = falling('stormer_verlet', 1.0, 1.0, 1e-4)
    with pytest.raises(StepFailure, match='impacts cannot be resolved.* s after .*smaller step'):
        simulation.advance(1)
    assert (simulation.q[0], simulation.p[0], simulation.work) == (1e-4, 0.0, 0.0)


@pytest.mark.parametrize('count', [54, 70])
def test_any_number_of_stops_holds_what_rests_on_them(count):
    """Masses fly at 1 m/s to stops of their own; the first and the last also have weight."""
    names, starts = [f'x{i}' for i in range(count)], np.linspace(0.795, 0.105, count)
    simulation = Simulation(
        HAMILTONIANS['free_particle'](1.0, names), INTEGRATORS['stormer_verlet'](), 0.1, starts,
        -np.ones(count), [EFFECTS['potential'](f'{G}*x0 + {G}*{names[-1]}'),
                          EFFECTS['joint_limits'](lower=dict.fromkeys(names, 0.0))], 'stop')
    for steps in range(1, 10):
        simulation.advance(1)
        t = 0.1 * steps
        flies = starts - t - np.where(np.isin(names, [names[0], names[-1]]), 0.5 * G * t * t, 0.0)
        assert np.array_equal(simulation.q > 0.0, flies > 0.0) and (simulation.q >= 0.0).all()
        assert not simulation.p[flies < 0.0].any()


def test_joints_at_rest_on_stops_are_held_while_others_hit_theirs(tmp_path):
    """Eight joints that share a mass matrix fall: resting ones leave, return, and are held."""
    for seed in range(78, 86):
        rng, path = np.random.default_rng(seed), tmp_path / f'{seed}.urdf'
        path.write_text(re.sub('prismatic|continuous', 'revolute', mimic_tree(rng, 8, 8)[0]))
        ends = {f'j{i}': float(rng.integers(1, 6)) / 10.0 for i in range(8)}
        limits = EFFECTS['joint_limits'](lower={name: -end for name, end in ends.items()},
                                         upper=ends)
        simulation = Simulation(
            RigidBodyTree(str(path), joints=[*ends]), INTEGRATORS['generalized_leapfrog'](),
            0.005, np.zeros(8), np.zeros(8), [limits])
        distances = np.array([*ends.values()]) - np.abs(simulation.record(200, 1)[0])
        # Impacts take energy; the stops hold some joints in the end, to the last bit.
        assert (distances >= 0.0).all() and np.count_nonzero(distances[-1] == 0.0) >= 2
        assert simulation.works['joint_limits'] < 0.0 and simulation.rescued == 0
