# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Energy scales, wherever H is zero and a path starts, and errors of single steps."""

import math

from helpers import kepler_orbit
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.errors import StoppedByEvent
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.scene import Condition
from hnn_vi_ros.simulation import (
    local_error, secular_change, Simulation, System, WatchedSimulation)
from hnn_vi_ros.simulation.accuracy.diagnostics import (
    energy_band, energy_scale, EnergyScale, rounding_walk, scales_along, scales_of)
from hnn_vi_ros.simulation.events import EventFunction
import numpy as np
from plain_systems import double_well, Motion, MOTIONS, pendulum, Plain
import pytest

_SAMPLES = 2000


def path(motion: Motion, periods: float) -> tuple[np.ndarray, np.ndarray]:
    """Return q and p at equal distances in time, by many small steps of Störmer and Verlet."""
    kernel, q, p = motion.hamiltonian.kernel, motion.q.copy(), motion.p.copy()
    steps = round(periods * _SAMPLES)
    h, H_q, H_p = motion.period / _SAMPLES, np.empty_like(q), np.empty_like(q)
    states = np.empty((steps + 1, 2, q.size))
    kernel.gradient(kernel.parameters, q, p, H_q, H_p)
    for state in states:
        state[:] = q, p
        p -= 0.5 * h * H_q
        kernel.gradient(kernel.parameters, q, p, H_q, H_p)
        q += h * H_p
        kernel.gradient(kernel.parameters, q, p, H_q, H_p)
        p -= 0.5 * h * H_q
    return states[:, 0], states[:, 1]


@pytest.mark.parametrize('eccentricity', [0.0, 0.5, 0.9, 0.99])
@pytest.mark.parametrize('start', [0.0, np.pi, 2.0])
def test_energy_scale_of_an_orbit_does_not_depend_on_where_it_starts(eccentricity, start):
    """The virial theorem makes it 2 abs(H) = 1 J over whole periods."""
    scale = energy_scale(HAMILTONIANS['kepler'](), *kepler_orbit(
        np.linspace(start, start + 6.0 * np.pi, 4001), eccentricity))
    # A circle never turns energy over, so that its potential counts too: the largest value of
    # (1 / r + v^2) / 2 = 1. Else the mean leaves out up to a sample of 1.3 ms at a pericentre
    # where v^2 is 199.
    assert scale == pytest.approx(1.0, abs=0.3 if eccentricity == 0.99 else 0.03)


def test_energy_scale_is_of_a_period_after_one_period():
    """From the pericentre, where abs(q . H_q) + abs(p . H_p) is 29 J, it comes down in time."""
    scale = energy_scale(HAMILTONIANS['kepler'](), *kepler_orbit(
        np.linspace(0.0, 2.0 * np.pi, 4001), 0.9))
    assert scale == pytest.approx(1.0, abs=0.03)


def test_energy_scale_of_an_unbound_path_comes_down_to_its_kinetic_energy():
    """What leaves along a hyperbola turns energy over only once: it falls to p . H_p = 1 J."""
    t = np.linspace(0.0, 100.0, 2001)[:, None]
    free = Plain(lambda q, p: 0.5 * p @ p, lambda q, p: (0.0 * q, p), 1)
    scale = energy_scale(free, t, 1.0 + 4.0 * np.exp(-t))
    # The mean of (1 + 4 e^-t)^2 is 1 + (8 + 8) / 100.
    assert scale == pytest.approx(1.16, rel=0.01)


@pytest.mark.parametrize('name, other, offset', [
    ('pendulum', 'pendulum, plus 1000 J', 0.0),
    ('figure eight of three bodies', 'figure eight of three bodies', 1e3)], ids=['of H', 'of q'])
def test_energy_scale_is_changed_by_no_constant(name, other, offset):
    # Along one path, so that only the scale is compared: it is rounded by q, 1e3 eps.
    q, p = path(MOTIONS[name], 1.1)
    assert energy_scale(MOTIONS[other].hamiltonian, q + offset, p) == pytest.approx(
        energy_scale(MOTIONS[name].hamiltonian, q, p), rel=1e-9)


@pytest.mark.parametrize('motion', [
    double_well(1e-3, 0.0), double_well(-0.1, 0.1), pendulum(3.1415, 0.0, 40.0)])
def test_energy_scale_of_a_motion_that_rests_near_a_saddle_is_not_that_of_its_rest(motion):
    # A swing between saddles takes the 2 J or 0.25 J to the well's floor; it lasts a third of
    # the time here at least.
    depth = np.ptp(motion.hamiltonian.energy(*path(motion, 0.0))) or 0.25
    q, p = path(motion, 2.0)
    values = scales_along(motion.hamiltonian, q, p, np.ones(len(q)))
    assert values[len(values) // 2:].min() > 0.1 * depth


@pytest.mark.parametrize('name', MOTIONS)
def test_energy_scale_is_proportional_to_the_mass(name):
    """In units of another mass every energy is multiplied by the same factor."""
    motion = MOTIONS[name]
    q, p = path(motion._replace(period=0.3 * motion.period), 0.5)
    H_q, H_p = motion.hamiltonian.gradient(q, p)
    scale, ones = EnergyScale(motion.hamiltonian), np.ones(len(q))
    one = scales_of(*scale.virials(q, p, H_q, H_p), ones)
    other = scales_of(*scale.virials(q, 8.0 * p, 8.0 * H_q, H_p), ones)
    assert other[-1] == 8.0 * one[-1] > 0.0


@pytest.mark.parametrize('name', MOTIONS)
@pytest.mark.parametrize('every', [1, 100])
def test_least_energy_scale_of_many_paths_is_that_of_each(name, every):
    motion = MOTIONS[name]
    q, p = (x[::every] for x in path(motion._replace(period=0.3 * motion.period), 2.0))
    many_q, many_p = (np.stack([x, 0.7 * x, 1.1 * x[::-1]], axis=1) for x in (q, p))
    weights = np.random.default_rng(1).integers(1, 5, len(q)).astype(float)
    expected = []
    for k in range(3):
        own = scales_along(motion.hamiltonian, many_q[:, k], many_p[:, k], weights)
        expected.append(own[1:].min())
    found = scales_along(motion.hamiltonian, many_q, many_p, weights)[1:].min(axis=0)
    # Sums of n terms in two orders.
    assert found == pytest.approx(expected, rel=4 * len(q) * np.finfo(float).eps)


def test_energy_scale_of_an_angle_does_not_grow_with_its_turns():
    motion = pendulum(0.0, 5.0, 1.3)
    q, p = path(motion, 4.0)
    many = q + 2.0 * np.pi * 1e4
    assert energy_scale(motion.hamiltonian, many, p) == pytest.approx(
        energy_scale(motion.hamiltonian, q, p), rel=1e-9)


def test_energy_scale_where_states_are_not_canonical_is_that_of_the_energy():
    """With velocities for momenta, v . q' lacks the mass of 3 kg, which H holds."""
    class Velocities(Plain):
        canonical = False

    u = Velocities(lambda q, v: 1.5 * float(v @ v + q @ q), lambda q, v: (q, v), 1)
    t = np.linspace(0.0, 4.0 * np.pi, 2001)[:, None]
    # The mean of m v^2 = 3 sin^2 t.
    assert energy_scale(u, np.cos(t), -np.sin(t)) == pytest.approx(1.5, rel=1e-2)


@pytest.mark.parametrize('centre', [0.0, 1e3])
def test_energy_scale_in_a_magnetic_field_does_not_depend_on_where_the_circle_is(centre):
    """The exact circle of 1 kg at 1 m/s in 1 T: P . H_p / 2 = 0.5 J, turned over nowhere."""
    hamiltonian = System(HAMILTONIANS['free_particle'](1.0, ('x', 'y')),
                         [EFFECTS['magnetic_field'](['x', 'y'])],
                         INTEGRATORS['implicit_midpoint']()).hamiltonian
    t = np.linspace(0.0, 2.0 * np.pi, 50)[:, None]
    q = centre + np.hstack([np.cos(t), -np.sin(t)])
    p = np.hstack([-np.sin(t), -np.cos(t)]) + 0.5 * np.column_stack([-q[:, 1], q[:, 0]])
    # p and A are of the size of the centre, and rounded so.
    assert energy_scale(hamiltonian, q, p) == pytest.approx(0.5, abs=1e-12 * (1.0 + centre))


def test_energy_scale_at_rest_is_zero():
    rest = np.zeros((10, 1))
    assert energy_scale(HAMILTONIANS['pendulum'](), rest, rest) == 0.0


def test_secular_change_is_the_slope_over_the_run():
    t = np.linspace(0.0, 1.0, 101)
    assert secular_change(3.0 - 2.0 * t) == pytest.approx(-2.0, rel=1e-12)
    assert secular_change(np.cos(20.0 * np.pi * t)) == pytest.approx(0.0, abs=1e-2)
    assert np.isnan(secular_change(np.array([1.0, np.nan, 2.0])))
    assert secular_change(np.array([1.0])) == 0.0


def test_energy_band_is_of_absolute_values():
    assert energy_band(np.array([1.0, -3.0, 2.0])) == 3.0
    assert energy_band(np.empty(0)) == 0.0


def test_rounding_walk_grows_with_the_root_of_the_steps():
    assert rounding_walk(2.0, 400) == pytest.approx(20.0 * rounding_walk(2.0, 1))


# The estimate of a step's error is that error, and the run does not notice it.

def oscillator(method: str, h: float, effects=()) -> Simulation:
    """Return an oscillation of unit amplitude and frequency."""
    return Simulation(HAMILTONIANS['harmonic_oscillator'](), INTEGRATORS[method](), h, [1.0],
                      [0.5], effects)


@pytest.mark.parametrize('method, h', [('generalized_leapfrog', 0.05), ('gauss4', 0.2)])
def test_local_error_is_that_of_a_step(method: str, h: float):
    simulation = oscillator(method, h)
    q, p = simulation.q[0], simulation.p[0]
    estimate = local_error(simulation)
    simulation.advance(1)
    exact = np.array([q * math.cos(h) + p * math.sin(h), p * math.cos(h) - q * math.sin(h)])
    error = np.abs([*simulation.q, *simulation.p] - exact).max()
    # The next term of a symmetric method is h^2 times the first, with coefficients below one.
    assert estimate == pytest.approx(error, rel=2.0 * h ** 2)


def test_local_error_leaves_the_run_bit_identical():
    watched, alone = (oscillator('generalized_leapfrog', 0.05) for _ in range(2))
    for _ in range(20):
        local_error(watched)
        watched.advance(3)
        alone.advance(3)
        assert np.array_equal([*watched.q, *watched.p], [*alone.q, *alone.p])
    assert (watched.steps, watched.gradients, watched.time) == (
        alone.steps, alone.gradients, alone.time)


def test_local_error_finds_no_events_and_does_not_end_the_run():
    alone = oscillator('variational_euler', 0.1)
    stop = EventFunction(Condition('x = 1.04'), stops=True)
    simulation = WatchedSimulation(oscillator('variational_euler', 0.1), [stop])
    assert local_error(simulation) == local_error(alone)
    assert simulation.events == []
    with pytest.raises(StoppedByEvent):
        simulation.advance(1)
    assert local_error(simulation) == local_error(alone)


def test_local_error_of_noise_is_not_a_number():
    bath = EFFECTS['thermostat'](0.1, 1.0)
    assert math.isnan(local_error(oscillator('generalized_leapfrog', 0.05, [bath])))
