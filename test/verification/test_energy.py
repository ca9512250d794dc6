# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""How each method treats the energy over long times."""

from helpers import GENERIC, long, Method, mostly_long, Uncompiled
from hnn_vi_ros import load_scene, simulate
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.simulation import Simulation
import numpy as np
import pytest


def block_maxima_slope(error: np.ndarray, blocks: int = 100) -> float:
    """Return the least-squares slope of the maxima of abs(error) in blocks, per whole run."""
    usable = error[:len(error) // blocks * blocks]
    maxima = np.abs(usable).reshape(blocks, -1).max(axis=1)
    return float(np.polyfit(np.linspace(0.0, 1.0, blocks), maxima, 1)[0])


@pytest.mark.parametrize('name, q, p', [
    ('harmonic_oscillator', 1.0, 0.0), long('tao', 0.0, -3.0)])
def test_variational_euler_energy_does_not_drift(name: str, q: float, p: float, measured):
    simulation = Simulation(HAMILTONIANS[name](), INTEGRATORS['variational_euler'](), 0.01,
                            [q], [p])
    h0 = simulation.energy
    q_all, p_all = simulation.record(1_000_000, 1)
    error = simulation.hamiltonian.energy(q_all, p_all) / h0 - 1.0
    # Order 1: the band is O(h) and stays where it was.
    band = np.ptp(error)
    assert band < 0.2
    slope = abs(block_maxima_slope(error))
    measured('energy drift over 1e6 steps, share of its band', f'variational_euler, {name}',
             slope / band, '<= 0.1')
    assert slope <= 0.1 * band
    assert np.ptp(error[-100_000:]) <= 1.5 * np.ptp(error[:100_000])


@pytest.mark.parametrize('method', mostly_long(
    (m for m in GENERIC if m.chart is not None), 'generalized_leapfrog'))
def test_symplectic_method_energy_does_not_drift(method: Method, measured):
    simulation = Simulation(method.hamiltonian, method.integrator, 0.05, [1.0], [-1.0])
    h0 = simulation.energy
    error = simulation.hamiltonian.energy(*simulation.record(100_000, 1)) / h0 - 1.0
    band, slope = np.ptp(error), abs(block_maxima_slope(error))
    measured('energy drift over 1e5 steps, share of its band', method.name, slope / band,
             '<= 0.1, or band < 1e-12')
    # Below that the band is that of rounding, whose random walk has no slope to speak of.
    assert slope <= 0.1 * band or band < 1e-12


def bands_of(system: str, method: str, step_sizes: tuple[float, ...], state: tuple
             ) -> np.ndarray:
    """Return the bands of H and of H~ over 20 s at each step size, shape (k, 2)."""
    bands = []
    for h in step_sizes:
        simulation = Simulation(Uncompiled(HAMILTONIANS[system]()), INTEGRATORS[method](), h,
                                *state)
        q, p = simulation.record(round(20.0 / h), 1)
        energy = simulation.hamiltonian.energy(q, p)
        modified = simulation.integrator.modified_energy(
            simulation.hamiltonian, h, q, p, energy, *simulation.hamiltonian.gradient(q, p))
        assert simulation.modified_energy == pytest.approx(modified[-1], rel=1e-14)
        bands.append((np.ptp(energy), np.ptp(modified)))
    return np.array(bands)


@pytest.mark.parametrize('system, method, state', [
    ('tao', 'variational_euler', ([1.0], [-1.0])),
    ('tao', 'generalized_leapfrog', ([1.0], [-1.0])),
    ('tao', 'implicit_midpoint', ([1.0], [-1.0])),
    long('double_pendulum', 'generalized_leapfrog', ([0.5, 1.0], [0.2, -0.3])),
    ('henon_heiles', 'stormer_verlet', ([0.1, 0.2], [0.3, 0.1]))])
def test_modified_energy_oscillates_with_twice_the_order_of_the_method(
        system, method, state, measured):
    """Halving h divides the band of H by 2 or 4 and that of the modified energy by 4 or 16."""
    order, first = INTEGRATORS[method]().order, 0.04
    bands = bands_of(system, method, (first, first / 2, first / 4) if order == 2 else
                     (first / 2, first / 4, first / 8), state)
    observed = np.log2(bands[:-1] / bands[1:])
    measured('order of the modified energy', f'{method}, {system}', observed[:, 1].min(),
             f'{2 * order} within 0.35')
    assert observed[:, 0] == pytest.approx(order, abs=0.35)
    # The smallest band, 1e-10, is far above the rounding of H.
    assert observed[:, 1] == pytest.approx(2.0 * order, abs=0.35)


def test_variational_euler_conserves_modified_energy_of_the_harmonic_oscillator(measured):
    """H + (h / 2) q p is an exact invariant: only rounding, a random walk, is left."""
    steps = 1_000_000
    simulation = Simulation(HAMILTONIANS['harmonic_oscillator'](),
                            INTEGRATORS['variational_euler'](), 0.01, [1.0], [0.0])
    start = simulation.modified_energy
    simulation.advance(steps)
    error = abs(simulation.modified_energy - start)
    measured('modified energy error after 1e6 steps [J]', 'variational_euler, oscillator', error,
             '< 1e-12')
    assert error < 1e-12


@pytest.mark.long
def test_explicit_euler_energy_grows_as_predicted_on_the_learned_oscillator():
    """Each step multiplies the energy of the oscillator by 1 + h^2."""
    scene = load_scene('harmonic_oscillator')
    h, duration = 0.01, 100.0
    energy = simulate(scene, duration, step_size=h, integrator='explicit_euler').energy
    assert energy[-1] / energy[0] == pytest.approx((1.0 + h * h) ** 10_000, rel=0.05)


def test_variational_euler_energy_error_stays_below_1_percent_on_the_learned_oscillator():
    energy = simulate(load_scene('harmonic_oscillator'), 1000.0).energy
    error = energy / energy[0] - 1.0
    assert np.abs(error).max() < 0.01
    assert abs(block_maxima_slope(error)) <= 0.1 * np.ptp(error)
