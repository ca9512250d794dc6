# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Averages in a heat bath against those of Boltzmann's distribution, whatever the masses are."""

from collections.abc import Callable
from functools import cached_property

from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.phase_space import Coordinate
from hnn_vi_ros.simulation import Simulation
from messages import refused
import numpy as np
import pytest
from scipy.integrate import quad

pytestmark = pytest.mark.filterwarnings('ignore:Formula is not a tanh network')

KT = 1.0


class Formula(Hamiltonian):
    """H = T(q, p) + |q|^2 / 2, with the derivatives of T given."""

    def __init__(self, d: int, kinetic: Callable, T_q: Callable, T_p: Callable, T_pp: Callable):
        self.coordinates = tuple(Coordinate(f'x{i}', '1', '1') for i in range(d))
        self._kinetic, self._T_q, self._T_p, self._T_pp = kinetic, T_q, T_p, T_pp

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions as plain Python."""
        def energy(_: tuple, q: np.ndarray, p: np.ndarray) -> float:
            return float(self._kinetic(q, p) + 0.5 * q @ q)

        def gradient(_: tuple, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
                     dH_dp: np.ndarray) -> None:
            dH_dq[:], dH_dp[:] = self._T_q(q, p) + q, self._T_p(q, p)

        def hessian_vector(_: tuple, q: np.ndarray, p: np.ndarray, v_q: np.ndarray,
                           v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
            # Only the block H_pp is asked for here.
            product_q[:], product_p[:] = np.nan, self._T_pp(q, p) @ v_p
        return Kernel(energy, gradient, hessian_vector, (), self.dimension, (0.0, 0.0), False)


def with_masses(*masses: float) -> Formula:
    """Return coordinates with these masses, each on a spring of 1 N/m."""
    inverse = np.diag(1.0 / np.array(masses))
    return Formula(len(masses), lambda q, p: 0.5 * p @ inverse @ p, lambda q, p: 0.0 * q,
                   lambda q, p: inverse @ p, lambda q, p: inverse)


def on_a_wire() -> Formula:
    """Return one coordinate with the mass 1 + q^2."""
    return Formula(1, lambda q, p: 0.5 * p[0] ** 2 / (1.0 + q[0] ** 2),
                   lambda q, p: -q * p ** 2 / (1.0 + q ** 2) ** 2,
                   lambda q, p: p / (1.0 + q ** 2), lambda q, p: np.array([1.0 / (1.0 + q ** 2)]))


def quartic() -> Formula:
    """Return one coordinate with the kinetic energy p^2 / 2 + p^4 / 4."""
    return Formula(1, lambda q, p: 0.5 * p[0] ** 2 + 0.25 * p[0] ** 4, lambda q, p: 0.0 * q,
                   lambda q, p: p + p ** 3, lambda q, p: np.array([1.0 + 3.0 * p ** 2]))


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


def assert_mean(values: np.ndarray, expected: float, bias: float = 0.0, blocks: int = 60) -> None:
    """Compare a mean with its expectation: 3.5 standard errors, of blocks, and the bias of h."""
    means = values[:len(values) // blocks * blocks].reshape(blocks, -1).mean(axis=1)
    error = means.std(ddof=1) / np.sqrt(blocks)
    assert abs(means.mean() - expected) < 3.5 * error + bias
    # Sharp enough to tell the wrong distributions: they differ by a fifth and more.
    assert error < 0.05 * max(abs(expected), KT)


# BAOAB's bias in p^2 is (w h)^2 / 4 of it for a linear force, in q^2 none.
BIAS = 0.25 * 0.2 ** 2 * KT


@pytest.mark.long
def test_thermostat_in_a_magnetic_field_gives_the_velocity_its_temperature():
    simulation, q, p = in_bath(with_masses(1.0, 1.0), 20_000,
                               ('magnetic_field', ['x0', 'x1'], 1.0, 1.0))
    velocity = simulation.hamiltonian.gradient(q, p)[1]
    for i in range(2):
        # Cyclotron and trap turn together with at most 1.7 rad/s.
        assert_mean(velocity[:, i] ** 2, KT, 3.0 * BIAS)


@pytest.mark.long
def test_thermostat_keeps_the_theorem_of_bohr_and_van_leeuwen():
    """No magnetic moment, and positions as if there were no field."""
    simulation, q, p = in_bath(with_masses(1.0, 1.0), 20_000,
                               ('magnetic_field', ['x0', 'x1'], 1.0, 1.0), seed=2)
    velocity = simulation.hamiltonian.gradient(q, p)[1]
    assert_mean(q[:, 0] * velocity[:, 1] - q[:, 1] * velocity[:, 0], 0.0, 3.0 * BIAS)
    assert_mean((q ** 2).sum(axis=1), 2.0 * KT, 6.0 * BIAS)


def test_thermostat_takes_the_masses_of_the_hamiltonian():
    _, _, p = in_bath(with_masses(1.0, 4.0), 20_000)
    assert_mean(p[:, 0] ** 2, KT, BIAS)
    assert_mean(p[:, 1] ** 2 / 4.0, KT, BIAS)
    assert_mean(p[:, 0] * p[:, 1], 0.0)


@pytest.mark.long
def test_thermostat_takes_a_rate_for_each_coordinate():
    """With nothing but friction and noise the autocorrelation is exp(-gamma t)."""
    simulation = Simulation(
        HAMILTONIANS['free_particle'](2.0, ('x', 'y')), INTEGRATORS['stormer_verlet'](), 0.5,
        [0.0, 0.0], [0.0, 0.0], [EFFECTS['thermostat'](KT, [0.5, 3.0], seed=4)])
    simulation.advance(50)
    p = simulation.record(20_000, 1)[1]
    for i, rate in enumerate([0.5, 3.0]):
        assert_mean(p[:, i] ** 2, 2.0 * KT)
        assert_mean(p[1:, i] * p[:-1, i], 2.0 * KT * np.exp(-0.5 * rate))


@pytest.mark.long
def test_thermostat_samples_a_mass_that_depends_on_q():
    _, q, p = in_bath(on_a_wire(), 30_000)
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
    _, _, p = in_bath(quartic(), 30_000)
    # The effective frequency there is up to 2 rad/s.
    assert_mean(p[:, 0] ** 2 + p[:, 0] ** 4, KT, 4.0 * BIAS)


def test_thermostat_with_another_mass_than_that_of_the_hamiltonian_is_refused():
    with refused(ValueError):
        in_bath(with_masses(1.0, 4.0), 1, mass=2.0)
    simulation, _, _ = in_bath(with_masses(1.0, 4.0), 1, mass=[1.0, 4.0])
    assert simulation.steps == 101


def test_thermostat_without_positive_masses_is_refused_at_the_start():
    with pytest.raises(ValueError, match='H_pp is not positive definite at the initial state'):
        in_bath(with_masses(1.0, -4.0), 1)


def test_thermostat_fails_the_step_where_the_masses_end():
    # The second mass becomes infinite at q_0 = 1, where the first coordinate soon is.
    turned = Formula(
        2, lambda q, p: 0.5 * (p[0] ** 2 + (1.0 - q[0]) * p[1] ** 2),
        lambda q, p: np.array([-0.5 * p[1] ** 2, 0.0]),
        lambda q, p: p * [1.0, 1.0 - q[0]], lambda q, p: np.diag([1.0, 1.0 - q[0]]))
    simulation = Simulation(turned, INTEGRATORS['generalized_leapfrog'](), 0.01, [0.5, 0.0],
                            [5.0, 0.0], [EFFECTS['thermostat'](KT, 1.0)])
    with pytest.raises(StepFailure, match='H_pp is not positive definite'):
        simulation.advance(10_000)
