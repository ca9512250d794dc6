# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Averages in a heat bath against those of Boltzmann's distribution, whatever the masses are."""

from helpers import Uncompiled
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.hamiltonians import Formula, Hamiltonian, HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.simulation import Simulation
from messages import refused
import numpy as np
import pytest
from scipy.integrate import quad

KT = 1.0


def with_masses(mass: float) -> Formula:
    """Return two coordinates, one of 1 kg and one of this mass, each on a spring of 1 N/m."""
    return Formula(['x', 'y'], 'p_x^2/2 + p_y^2/(2*m) + (x^2 + y^2)/2', {'m': mass})


def in_bath(hamiltonian: Hamiltonian, steps: int, *more: tuple, h: float = 0.2, seed: int = 1,
            rate: float = 1.0, **arguments: object) -> tuple[Simulation, np.ndarray, np.ndarray]:
    """Return a simulation in a bath, and q and p after each step once the start is forgotten."""
    effects = [EFFECTS[kind](*values) for kind, *values in more]
    d = hamiltonian.dimension
    simulation = Simulation(
        hamiltonian, INTEGRATORS['generalized_leapfrog'](), h, np.zeros(d), np.zeros(d),
        [*effects, EFFECTS['thermostat'](KT, rate, seed=seed, **arguments)])
    simulation.advance(100)
    return simulation, *simulation.record(steps, 1)


def assert_mean(values: np.ndarray, expected: float, bias: float = 0.0, blocks: int = 60
                ) -> tuple[float, float]:
    """
    Compare a mean with its expectation: 3 standard errors, of blocks, and the bias of h.

    Return both; blocks are much longer than the correlation.
    """
    means = values[:len(values) // blocks * blocks].reshape(blocks, -1).mean(axis=1)
    mean, error = means.mean(), means.std(ddof=1) / np.sqrt(blocks)
    assert abs(mean - expected) < 3.0 * error + bias
    # Sharp enough to tell the wrong distributions: they differ by a fifth and more.
    assert error < 0.05 * max(abs(expected), KT)
    return mean, error


# BAOAB's bias in p^2 is (w h)^2 / 4 of it for a linear force, in q^2 none.
BIAS = 0.25 * 0.2 ** 2 * KT


@pytest.fixture(scope='module')
def in_a_field() -> tuple[np.ndarray, np.ndarray]:
    """Return places and velocities of a charge in a trap and a magnetic field."""
    simulation, q, p = in_bath(with_masses(1.0), 20_000, ('magnetic_field', ['x', 'y'], 1.0, 1.0))
    return q, simulation.hamiltonian.gradient(q, p)[1]


@pytest.mark.long
def test_thermostat_in_a_magnetic_field_gives_the_velocity_its_temperature(in_a_field):
    for i in range(2):
        # Cyclotron and trap turn together with at most 1.7 rad/s.
        assert_mean(in_a_field[1][:, i] ** 2, KT, 3.0 * BIAS)


@pytest.mark.long
def test_thermostat_keeps_the_theorem_of_bohr_and_van_leeuwen(in_a_field):
    """No magnetic moment, and positions as if there were no field."""
    q, velocity = in_a_field
    assert_mean(q[:, 0] * velocity[:, 1] - q[:, 1] * velocity[:, 0], 0.0, 3.0 * BIAS)
    assert_mean((q ** 2).sum(axis=1), 2.0 * KT, 6.0 * BIAS)


def test_thermostat_takes_the_masses_of_the_hamiltonian():
    _, _, p = in_bath(Uncompiled(with_masses(4.0)), 20_000)
    assert_mean(p[:, 0] ** 2, KT, BIAS)
    assert_mean(p[:, 1] ** 2 / 4.0, KT, BIAS)
    assert_mean(p[:, 0] * p[:, 1], 0.0)


def test_thermostat_lets_velocities_decay_exponentially_with_the_rate_of_each_coordinate():
    """With nothing but friction and noise the autocorrelation of p is m kT exp(-gamma t)."""
    h, mass, rates = 0.25, 2.0, (0.8, 3.0)
    simulation = Simulation(
        Uncompiled(HAMILTONIANS['free_particle'](mass, ('x', 'y'))),
        INTEGRATORS['stormer_verlet'](), h, [0.0, 0.0], [0.0, 0.0],
        [EFFECTS['thermostat'](KT, [*rates], mass, 3)])
    simulation.advance(100)
    p = simulation.record(40_000, 1)[1]
    for own, rate in zip(p.T, rates, strict=True):
        for lag in (0, 1, 4, 10):
            assert_mean(own[:len(own) - lag] * own[lag:], mass * KT * np.exp(-rate * h * lag))


@pytest.mark.long
def test_thermostat_gives_the_oscillator_its_exact_temperature(measured):
    """BAOAB on a linear force: <q^2> = kT / k for any h, <p^2> = m kT (1 - (w h)^2 / 4)."""
    temperature, h = 0.7, 0.5
    simulation = Simulation(HAMILTONIANS['harmonic_oscillator'](), INTEGRATORS['stormer_verlet'](),
                            h, [0.0], [0.0], [EFFECTS['thermostat'](temperature, 1.0, seed=1)])
    simulation.advance(100)
    q, p = simulation.record(1_000_000, 1)
    for name, values, expected in (
            ('<k q^2> / kT', q[:, 0] ** 2, temperature),
            ('<p^2 / m> / kT', p[:, 0] ** 2, temperature * (1.0 - 0.25 * h * h))):
        mean, error = assert_mean(values, expected, blocks=100)
        measured(f'temperature, {name}', 'thermostat, oscillator, h = 0.5', mean / temperature,
                 f'{expected / temperature:.4g} ± {3.0 * error / temperature:.2g}')
        # Sharp enough to tell the two apart.
        assert error < 0.005 * temperature


@pytest.mark.long
def test_thermostat_gives_the_pendulum_kinetic_and_configurational_temperature(measured):
    """<p^2 / m> = kT and <V'^2> = kT <V''>, whatever V."""
    temperature, h = 3.0, 0.02
    simulation = Simulation(HAMILTONIANS['pendulum'](), INTEGRATORS['stormer_verlet'](), h,
                            [0.0], [0.0], [EFFECTS['thermostat'](temperature, 2.0, seed=2)])
    simulation.advance(1000)
    q, p = simulation.record(1_000_000, 1)
    # The bias of BAOAB in p^2 is (w h)^2 / 4 = 1e-3 of it, a third of the standard error.
    mean, error = assert_mean(p[:, 0] ** 2, temperature, blocks=100)
    measured('temperature, <p^2 / m> / kT', 'thermostat, pendulum', mean / temperature,
             f'1 ± {3.0 * error / temperature:.2g}')
    slope, curvature = 9.81 * np.sin(q[:, 0]), 9.81 * np.cos(q[:, 0])
    share = temperature * curvature.mean()
    _, error = assert_mean((slope ** 2 - temperature * curvature) / share, 0.0, blocks=100)
    measured("temperature, <V'^2> / <V''> / kT", 'thermostat, pendulum',
             (slope ** 2).mean() / share, f'1 ± {3.0 * error:.2g}')
    # Far from small swings, for which any thermostat would do.
    assert np.abs(q).max() > np.pi
    # Heat that is taken up and given back again leaves the system with some kT.
    assert abs(simulation.work) < 50.0 * temperature


@pytest.mark.long
def test_thermostat_samples_a_mass_that_depends_on_q():
    _, q, p = in_bath(Formula(['x'], 'p_x^2/(2*(1 + x^2)) + x^2/2'), 30_000)
    weights = [quad(lambda x: x ** k * np.sqrt(1.0 + x * x) * np.exp(-0.5 * x * x / KT), -12, 12)
               for k in (0, 2)]
    # Where the mass is least the frequency is 1.
    assert_mean(p[:, 0] ** 2 / (1.0 + q[:, 0] ** 2), KT, 2.0 * BIAS)
    assert_mean(q[:, 0] ** 2, weights[1][0] / weights[0][0], 4.0 * BIAS)


@pytest.mark.long
def test_thermostat_samples_a_coupled_mass_that_depends_on_q():
    """The double pendulum, whose kinetic energy p . H_p is two degrees' at any angle."""
    simulation, q, p = in_bath(HAMILTONIANS['double_pendulum'](), 200_000, h=0.01, rate=2.0)
    velocity = simulation.hamiltonian.gradient(q, p)[1]
    # The fastest mode has some 8 rad/s: (w h)^2 / 4 of it.
    assert_mean((p * velocity).sum(axis=1), 2.0 * KT, 2.0 * 0.25 * 0.08 ** 2 * KT)


@pytest.mark.long
def test_thermostat_samples_a_kinetic_energy_that_is_not_quadratic():
    """<p H_p> = kT, whatever H is."""
    _, _, p = in_bath(Formula(['x'], 'p_x^2/2 + p_x^4/4 + x^2/2'), 30_000)
    # The effective frequency there is up to 2 rad/s.
    assert_mean(p[:, 0] ** 2 + p[:, 0] ** 4, KT, 4.0 * BIAS)


def test_thermostat_with_another_mass_than_that_of_the_hamiltonian_is_refused():
    two = Uncompiled(with_masses(4.0))
    with refused(ValueError):
        in_bath(two, 1, mass=2.0)
    simulation, _, _ = in_bath(two, 1, mass=[1.0, 4.0])
    assert simulation.steps == 101


def test_thermostat_without_positive_masses_is_refused_at_the_start():
    with pytest.raises(ValueError, match='H_pp is not positive definite at the initial state'):
        in_bath(Uncompiled(with_masses(-4.0)), 1)


def test_thermostat_fails_the_step_where_the_masses_end():
    # The second mass becomes infinite at x = 1, where the first coordinate soon is.
    turned = Formula(['x', 'y'], 'p_x^2/2 + (1 - x)*p_y^2/2 + (x^2 + y^2)/2')
    simulation = Simulation(Uncompiled(turned), INTEGRATORS['generalized_leapfrog'](), 0.01,
                            [0.5, 0.0], [5.0, 0.0], [EFFECTS['thermostat'](KT, 1.0)])
    with pytest.raises(StepFailure, match='H_pp is not positive definite'):
        simulation.advance(10_000)
