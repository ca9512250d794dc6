# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Linear damping takes energy and nothing else, whatever p means."""

from helpers import EPS, free, Uncompiled
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.simulation import Simulation
import numpy as np
import pytest

# One that takes the flow around its steps, and one that takes the force at its nodes.
METHODS = ['generalized_leapfrog', 'gauss8']


def in_field(method: str, h: float, q: list[float], velocity: list[float],
             rate: float | list[float]) -> Simulation:
    """Return a particle of 1 kg in a field of 1 T, with friction."""
    # c A(q) = B (-y, x) / 2.
    p = [velocity[0] - 0.5 * q[1], velocity[1] + 0.5 * q[0]]
    effects = [EFFECTS['damping'](rate), EFFECTS['magnetic_field'](['x', 'y'])]
    return Simulation(free('x', 'y'), INTEGRATORS[method](), h, q, p, effects)


@pytest.mark.parametrize('method', METHODS)
def test_damping_leaves_what_rests_in_a_magnetic_field_at_rest(method: str):
    simulation = in_field(method, 0.05, [1.0, -0.7], [0.0, 0.0], [0.5, 0.2])
    simulation.advance(200)
    # A step rounds p and the vector potential, by some eps each.
    assert np.abs(simulation.dH_dp).max() <= 200 * 4 * EPS
    assert simulation.q == pytest.approx([1.0, -0.7], abs=200 * 4 * EPS)


@pytest.mark.parametrize('method, error', [('generalized_leapfrog', 1e-4), ('gauss8', 1e-12)])
def test_damping_in_a_magnetic_field_slows_the_spiral_exponentially(method: str, error: float):
    """Solve v' = -gamma v + B J v: the speed falls as exp(-gamma t) and turns with B."""
    h, steps, rate = 0.01, 500, 0.4
    simulation = in_field(method, h, [1.0, 0.0], [0.0, -1.0], rate)
    q, p = simulation.record(steps, 1)
    velocity = simulation.hamiltonian.gradient(q, p)[1]
    t = h * np.arange(1, steps + 1)
    expected = np.exp(-rate * t)[:, None] * np.column_stack([-np.sin(t), -np.cos(t)])
    # Of order 2: h^2 over the five radians; of order 8 round-off.
    assert np.abs(velocity - expected).max() <= error


@pytest.mark.parametrize('method', METHODS)
def test_damping_in_a_magnetic_field_never_adds_energy(method: str):
    simulation = in_field(method, 0.05, [1.0, 0.3], [0.4, -1.0], [0.3, 0.9])
    q, p = simulation.record(400, 1)
    energy = simulation.hamiltonian.energy(q, p)
    # Rounding of H, which is a difference of squares of 1.
    assert (np.diff(energy) <= 8 * EPS).all()
    assert energy[-1] < 1e-3 * energy[0]


def test_damping_with_rates_that_feed_energy_into_coupled_masses_is_refused():
    """The double pendulum from angles at which its masses are not coupled."""
    def damped(rate: list[float]) -> Simulation:
        return Simulation(Uncompiled(HAMILTONIANS['double_pendulum']()),
                          INTEGRATORS['generalized_leapfrog'](), 0.01, [0.5 * np.pi, 0.0],
                          [0.0, 0.0], [EFFECTS['damping'](rate)])
    with pytest.raises(ValueError, match=r'rates \[0.0, 5.0\] .* would gain energy, at q = .*one'):
        damped([0.0, 5.0])
    assert damped([0.5, 0.5]).time == 0.0
