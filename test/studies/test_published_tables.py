# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The published tables: their data as published, their measures right on exact systems."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from studies import published_pendulum, published_tables
from studies.published_data import NOISE, PENDULUM, Plane, SPRING, TWO_BODY
from studies.published_measures import (
    exact_loss, field_error, least_loss, orbit_errors, published_loss)
from studies.published_models import Model
from studies.published_page import is_reached, PUBLISHED, read_results, ResultTable

DOCS = Path(__file__).parents[2] / 'docs' / 'evidence'


def random(seed: int = 0) -> np.random.RandomState:
    """Return the generator that the public code uses."""
    return np.random.RandomState(seed)


@pytest.mark.parametrize('plane, field', [
    (SPRING, lambda t, z: [2.0 * z[1], -2.0 * z[0]]),
    (PENDULUM, lambda t, z: [2.0 * z[1], -3.0 * np.sin(z[0])]),
], ids=['spring', 'pendulum'])
def test_orbits_are_those_of_the_published_equations(plane, field):
    orbits = plane.orbits(random(), 3.0, 30, 10)
    for clean, rates in zip(orbits.clean, orbits.rates, strict=True):
        solution = solve_ivp(field, (0.0, 3.0), clean[0], t_eval=orbits.t, rtol=1e-11, atol=1e-12)
        # Both are solved to their tolerance, 1e-11 a step, in some hundred steps.
        assert np.abs(solution.y.T - clean).max() < 1e-8
        assert np.allclose(rates, np.array(field(0.0, clean.T)).T, rtol=0.0, atol=1e-14)


def test_orbits_of_seed_0_begin_with_the_published_random_numbers():
    # numpy's documented legacy stream: rand() of seed 0 begins with these.
    u = [0.5488135039273248, 0.7151893663724195, 0.6027633760716439]
    direction = 2.0 * np.array(u[:2]) - 1.0
    start = (0.9 * u[2] + 0.1) * direction / np.linalg.norm(direction)
    assert np.allclose(SPRING.orbits(random(), 3.0, 30, 10).clean[0, 0], start, rtol=1e-14)


def test_noise_has_the_published_size_and_spares_the_rates():
    orbits = SPRING.orbits(random(), 3.0, 30)
    noise = orbits.noisy - orbits.clean
    # 3000 normal numbers: their deviation is known to 1 / sqrt(6000), here to five times that.
    assert abs(noise.std() / NOISE - 1.0) < 5.0 / np.sqrt(2.0 * noise.size)
    assert np.array_equal(orbits.rates, SPRING.rates(orbits.clean))


def test_two_bodies_keep_energy_and_centre_and_their_rates_are_newtons():
    orbits = TWO_BODY.orbits(random(), 20.0, 50, 10)
    assert np.ptp(TWO_BODY.energy(orbits.clean), axis=1).max() < 1e-9
    assert np.abs(orbits.clean[..., 0::2] + orbits.clean[..., 1::2]).max() == 0.0
    x1, x2, y1, y2 = orbits.clean[0, 7, :4]
    distance = np.hypot(x2 - x1, y2 - y1)
    rates = orbits.rates[0, 7]
    assert np.array_equal(rates[:4], orbits.clean[0, 7, 4:])
    assert np.allclose(rates[4:], np.array([x2 - x1, x1 - x2, y2 - y1, y1 - y2]) / distance**3,
                       rtol=1e-14)
    # Nearly circular: the start is a sample of a speed that scatters by 5 %.
    assert np.ptp(distance) < 0.5


def test_energies_are_those_of_the_systems_and_the_published_one_is_not_for_the_pendulum():
    z = np.array([[0.7, -0.4], [2.0, 1.5]])
    assert np.allclose(SPRING.energy(z), (z**2).sum(axis=1), rtol=1e-14)
    assert np.allclose(SPRING.energy(z), SPRING.published_energy(z), rtol=1e-14)
    assert np.allclose(PENDULUM.energy(z), 3.0 * (1.0 - np.cos(z[:, 0])) + z[:, 1]**2, rtol=1e-14)
    orbits = PENDULUM.orbits(random(), 3.0, 30, 10)
    assert np.ptp(PENDULUM.energy(orbits.clean), axis=1).max() < 1e-9
    assert np.ptp(PENDULUM.published_energy(orbits.clean), axis=1).min() > 0.1


@pytest.mark.parametrize('plane', [SPRING, PENDULUM], ids=['spring', 'pendulum'])
def test_measures_of_the_true_system_are_zero_but_for_the_noise_in_the_loss(plane):
    model = Model(plane.hamiltonian)
    orbits = plane.orbits(random(), 3.0, 30)
    assert field_error(model, orbits) == 0.0
    assert published_loss(model, orbits) == exact_loss(plane, orbits)
    errors = orbit_errors(plane, model, plane.starts(random(), 3), np.linspace(0.0, 5.0, 26),
                          'rk4', 0.005)
    # Of order 4: (2 h)^4 / 120 of a turn's angle in each unit of 2 t, or less.
    assert max(value for _, value in errors.items()) < 10.0 * 0.01**4 / 120.0


def test_test_loss_of_the_true_spring_is_the_noise_times_its_slope():
    orbits = SPRING.orbits(random(), 3.0, 30)
    # 3000 squares of 2 * 0.1 * normal: a mean of 0.04, known to sqrt(2 / 3000), here to 5 of it.
    assert abs(exact_loss(SPRING, orbits) / 0.04 - 1.0) < 5.0 * np.sqrt(2.0 / 3000.0)


def test_least_loss_is_below_that_of_the_true_system():
    _, test = SPRING.orbits(random(), 3.0, 30).halves()
    # The published 3.59e-2 is of this data: it lies between the two.
    assert least_loss(SPRING, test) < 3.59e-2 < exact_loss(SPRING, test)


def test_energy_error_of_a_wrong_system_is_that_of_its_motion():
    # Twice as fast as the spring: the same circles, so no energy error, but another path.
    fast = Plane(type(SPRING.hamiltonian)(mass=0.25, stiffness=4.0), SPRING.radii, SPRING.rate)
    errors = orbit_errors(SPRING, Model(fast.hamiltonian), np.array([[1.0, 0.0]]),
                          np.linspace(0.0, 2.0 * np.pi, 101), 'rk4', 0.005)
    assert errors.energy < 1e-12 and errors.published_energy < 1e-12
    # |exp(4 i t) - exp(2 i t)|^2 = 2 - 2 cos 2t, whose mean over whole turns is 2 (100 of 101).
    assert errors.path == pytest.approx(np.sqrt(2.0 * 100.0 / 101.0), rel=1e-6)


def log_of(friction: float, path: Path) -> Path:
    """Write a log like that of the real pendulum, with instants left out."""
    t = np.delete(5.0 + np.arange(300) / 6.0, [4, 50, 51, 260])
    decay = np.exp(-0.5 * friction * (t - t[0]))
    table = np.column_stack([0 * t, t, decay * np.cos(t), -decay * np.sin(t)])
    np.savetxt(path, table, header='o v', comments='%')
    return path


def test_real_pendulum_is_split_as_published_and_swings_on_over_gaps(tmp_path):
    t, z = published_pendulum.read(log_of(0.0, tmp_path / 'log.txt'))
    learn, test = published_pendulum.split_for_dgnet(t, z)
    assert len(learn.t) == int(0.8 * 295) and len(test.t) == int((1.0 - 0.8) * 295)
    assert test.t[0] == t[len(learn.t)]
    learn, test = published_pendulum.split_for_dissipative_hnn(t, z)
    assert len(learn.t) == int(0.8 * 296) and test.t[-1] == t[-1]
    # Central differences where instants are even: cos and sin less h^2 / 6 of themselves.
    even = slice(10, 40)
    wanted = np.stack([learn.clean[0, even, 1], -learn.clean[0, even, 0]], axis=-1)
    assert np.abs(learn.rates[0, even] - wanted).max() < (1.0 / 6.0)**2 / 6.0
    exact = Model(type(SPRING.hamiltonian)(mass=1.0, stiffness=1.0))
    # RK4 lags by h^4 / 120 of the time, here 10 s: less than 20 s of it, and its energy for that.
    lag = 20.0 * (1.0 / 6.0)**4 / 120.0
    assert test.path_error(exact, 'rk4') < lag
    assert test.energy_error(exact, 'rk4') < lag**2


@pytest.mark.long
def test_quick_run_writes_the_page_and_says_what_is_missing(tmp_path, capsys):
    assert published_tables.main(['--quick', '--out', str(tmp_path), '--data', 'nowhere']) == 0
    said = capsys.readouterr().out
    assert 'nowhere/real_pend_h_1.txt: not there' in said
    page = (tmp_path / 'learning.md').read_text()
    assert 'quick run' in page and page.count('not measured') >= 2
    results = ResultTable(read_results(tmp_path))
    for table, system, measure in PUBLISHED:
        assert len(results.values(table, system, measure)) == (system != 'real_pendulum')
    # Written anew from the values, without measuring.
    again = tmp_path / 'learning.md'
    again.unlink()
    assert published_tables.main(['--page', '--quick', '--out', str(tmp_path)]) == 0
    assert again.read_text() == page


def test_committed_values_are_at_or_below_the_published_ones_on_the_published_data():
    results = ResultTable(read_results(DOCS))
    for (table, system, measure), published in PUBLISHED.items():
        values = results.values(table, system, measure)
        assert is_reached(values, published)[0]
