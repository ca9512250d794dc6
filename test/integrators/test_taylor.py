# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The integrator taylor: closed forms, dense output, batches, and what it refuses."""

import sys

from helpers import Uncompiled
from hnn_vi_ros.effects import Damping, ExternalForce
from hnn_vi_ros.effects.potential import FormulaPotential
from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.hamiltonians import Formula, Hamiltonian, HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS, Taylor, taylor, TaylorWork
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.dense_step import record_at
from messages import refused
import numpy as np
import pytest

pytest.importorskip('heyoka', reason='heyoka, which computes the series, is not installed')
Q0, P0 = [0.4, 0.0], [0.0, 2.0]
# Where powers, functions and quotients stand that the exact systems have not.
RICH = ('(p_x^2 + p_y^2) / (2 + x^2) + exp(-x^2) + atan(y) + y^2 / 2 + sqrt(1 + x^2) '
        '+ log(2 + cos(y)) + (1 + x^2)^1.3 + tanh(x) * cosh(y / 3) + (1 - cos(x)) / (1 + y^2)^1.5')


def kepler(tolerance: float, h: float) -> Simulation:
    """Return an orbit of eccentricity 0.6 from its pericentre."""
    return Simulation(HAMILTONIANS['kepler'](), Taylor(tolerance), h, Q0, P0)


def orbit(times: np.ndarray) -> np.ndarray:
    """Return the same orbit by Kepler's equation, shape (k, 4)."""
    motion = HAMILTONIANS['kepler']().exact_motion(np.array(Q0), np.array(P0), times)
    assert motion is not None
    return motion.path


def test_taylor_meets_closed_forms_to_1e_13():
    simulation = kepler(1e-16, 3.0)
    simulation.advance(2)
    # One period; q' and p' reach 5, so that t alone, rounded, is worth 5 eps t = 7e-15.
    assert np.abs(np.append(simulation.q, simulation.p) - orbit(np.array([6.0]))).max() < 1e-13
    oscillator = Simulation(
        HAMILTONIANS['harmonic_oscillator'](), Taylor(1e-16), 1.0, [1.0], [0.5])
    oscillator.advance(10)
    assert abs(oscillator.q[0] - np.cos(10.0) - 0.5 * np.sin(10.0)) < 1e-13


def test_taylor_states_between_steps_are_those_of_the_series():
    times = np.array([0.7, 3.1, 9.99, 12.5])
    q, p = record_at(kepler(1e-15, 10.0), times)
    # Two steps, along which an error of 1e-15 grows as the phase does.
    assert np.abs(np.hstack([q, p]) - orbit(times)).max() < 1e-12
    assert np.diff(kepler(1e-15, 10.0).dense_step().places).max() < 0.01


def test_taylor_keeps_the_energy_to_round_off_over_long_times():
    simulation = kepler(1e-16, 100.0)
    energy = simulation.energy
    simulation.advance(100)
    # 7e4 series, each rounded: a random walk of eps sqrt(7e4), and as much again for its constant.
    assert abs(simulation.energy - energy) < 1e-13


def beside_gauss16(hamiltonian: Hamiltonian, time: float, parts: int, q: list[float],
                   p: list[float], effects: tuple = ()) -> list[np.ndarray]:
    """Return (q, p) at a time by taylor in one step, and by gauss16 in several."""
    found = []
    for system, method, steps in ((hamiltonian, Taylor(1e-15), 1),
                                  (Uncompiled(hamiltonian), INTEGRATORS['gauss16'](), parts)):
        simulation = Simulation(system, method, time / steps, q, p, effects)
        simulation.advance(steps)
        found.append(np.append(simulation.q, simulation.p))
    return found


@pytest.mark.parametrize('effects', [
    (), (FormulaPotential('k*(x - y)^2/2', {'k': 0.3}),)],
    ids=['alone', 'with a potential'])
def test_taylor_agrees_with_gauss16_on_a_rich_formula(effects):
    ours, other = beside_gauss16(
        Formula(['x', 'y'], RICH), 2.0, 40, [0.7, -0.2], [0.1, 0.4], effects)
    # Two methods, each at round-off.
    assert np.abs(ours - other).max() < 1e-13


def test_taylor_takes_a_formula_with_a_cyclic_coordinate():
    """H of a spherical pendulum does not depend on its azimuth; its momentum stays as it is."""
    H = Formula(['a', 'b'], 'p_a^2 / 2 + p_b^2 / (2 * sin(a)^2) + 9.81 * cos(a)')
    ours, other = beside_gauss16(H, 2.0, 100, [2.0, 0.0], [0.3, 0.8])
    assert ours[3] == 0.8 and np.abs(ours - other).max() < 1e-12


def test_taylor_holds_a_command_over_a_step_and_counts_its_work():
    ends, works, system = [], [], HAMILTONIANS['double_pendulum']()
    for H, method, h in ((system, Taylor(1e-15), 1.0),
                         (Uncompiled(system), INTEGRATORS['gauss16'](), 0.05)):
        simulation = Simulation(H, method, h, [0.7, -0.2],
                                [0.1, 0.4], [ExternalForce(['angle2', 'angle1'], timeout=1.5)])
        for command in ([0.6, -0.3], [-0.2, 0.5]):
            simulation.motors.command(command, simulation.q)
            simulation.advance(round(1.0 / h))
        ends.append(np.append(simulation.q, simulation.p))
        works.append(simulation.energy_balance)
    # Two methods, each at round-off of energies of some 40 J.
    assert np.abs(ends[0] - ends[1]).max() < 1e-12
    assert np.abs(works).max() < 1e-12


def test_a_step_longer_than_the_time_out_of_commands_is_said():
    with pytest.warns(UserWarning, match='acts for whole steps of 1 s, longer than its timeout'):
        Simulation(HAMILTONIANS['pendulum'](), Taylor(), 1.0, [0.7], [0.1],
                   [ExternalForce(['angle'], timeout=0.2)])


def test_taylor_takes_several_trajectories_as_one_batch():
    starts = np.array([[0.4, 0.0], [0.5, 0.1], [0.6, 0.0]])
    momenta = np.array([P0] * 3)
    batch = Simulation(HAMILTONIANS['kepler'](), Taylor(), 0.5, starts, momenta)
    batch.advance(6)
    for k, (q, p) in enumerate(zip(starts, momenta, strict=True)):
        one = Simulation(HAMILTONIANS['kepler'](), Taylor(), 0.5, q, p)
        one.advance(6)
        assert np.abs(np.append(one.q - batch.q[k], one.p - batch.p[k])).max() < 1e-11


def test_taylor_goes_on_with_other_numbers():
    simulation = Simulation(HAMILTONIANS['pendulum'](), Taylor(), 1.0, [1.0], [0.0])
    simulation.advance(1)
    other = HAMILTONIANS['pendulum'](length=2.0)
    assert simulation.take_numbers(other, [])
    simulation.restart([1.0], [0.0])
    simulation.advance(1)
    fresh = Simulation(other, Taylor(), 1.0, [1.0], [0.0])
    fresh.advance(1)
    assert simulation.q[0] == fresh.q[0]


@pytest.mark.parametrize(('size', 'mass'), [(1e-9, 1e-20), (1e-6, 1e-12), (1e3, 1e3), (1.0, 1e-9)])
def test_taylor_is_as_precise_in_small_units(size, mass):
    H = Formula(['x', 'y'], '(p_x^2 + p_y^2)/(2*m) - k/sqrt(x^2 + y^2)',
                {'m': mass, 'k': mass * size**3})
    simulation = Simulation(H, Taylor(1e-12), 10.0, size * np.array(Q0),
                            mass * size * np.array(P0))
    simulation.advance(1)
    found = np.append(simulation.q / size, simulation.p / (mass * size))
    # Errors of 1e-12 of some thirty series grow as the phase does over ten units of time.
    assert np.abs(found - orbit(np.array([10.0]))).max() < 1e-10


@pytest.mark.parametrize('h', [0.5, 1.0, 10.0])
@pytest.mark.parametrize('start', [0.0, 0.2])
def test_taylor_keeps_the_energy_at_walls_of_high_powers(start, h):
    simulation = Simulation(Formula(['x'], 'p_x^2/2 + x^34'), Taylor(1e-14), h, [start], [1.0])
    energy = simulation.energy
    simulation.advance(round(20.0 / h))
    # In each of 20 steps no more than 100 errors of 1e-14 for each of some 30 series, of 34 J.
    assert abs(simulation.energy - energy) < 1e-10
    end, q, p = simulation, simulation.q, simulation.p
    back = Simulation(Formula(['x'], 'p_x^2/2 + x^34'), Taylor(1e-14), h, q, -p)
    back.advance(round(20.0 / h))
    assert abs(back.q[0] - start) < 1e-9 and end.q[0] == q[0]


def test_taylor_gives_states_between_the_ends_of_a_step_at_a_wall():
    made = Simulation(Formula(['x'], 'p_x^2/2 + x^34'), Taylor(1e-14), 10.0, [0.2], [1.0])
    short = Simulation(Formula(['x'], 'p_x^2/2 + x^34'), Taylor(1e-14), 0.25, [0.2], [1.0])
    times = np.array([0.25, 1.0, 5.0, 10.0])
    q, p = record_at(made, times)
    other = record_at(short, times)
    assert np.abs(np.hstack([q, p]) - np.hstack(other)).max() < 1e-9


@pytest.mark.parametrize(('hamiltonian', 'effects'), [
    (Formula(['x'], 'p_x^2/2 + abs(x)'), ()), (Formula(['x'], 'p_x^2/2 + (x^2)^1.5'), ()),
    (Formula(['x', 'y'], 'p_x^2/2 + p_y^2/2 + sqrt(x^2*y^4) + y^2'), ()),
    (Formula(['x'], 'p_x^2/2 + sqrt(1 - cos(x))'), ()),
    (Formula(['x'], 'p_x^2/2 + acos(cos(x))'), ()),
    (Formula(['x'], 'p_x^2/2 + asin(-sin(2*x))'), ()),
    (Formula(['x'], 'p_x^2/2 + sqrt(4 - 4*cos(x)^2)'), ()),
    (Formula(['x'], 'p_x^2/2 + x^2'), (FormulaPotential('(sin(x)^2)^0.7'),)),
    (HAMILTONIANS['fput_chain'](), ()),
    (HAMILTONIANS['heavy_top'](), ()), (HAMILTONIANS['pendulum'](), (Damping(0.1),))])
def test_taylor_refuses_by_name(hamiltonian, effects):
    d = hamiltonian.dimension
    with refused(UnsupportedSystem):
        Simulation(hamiltonian, Taylor(), 0.1, np.ones(d), np.zeros(d), effects)


@pytest.mark.parametrize('H', ['p_x^2/2 + x^4', 'p_x^2/2 + (1 + x^2)^1.5 + x^3',
                               'p_x^2/2 + sqrt((x - 3)^2 + 0.01)',
                               'p_x^2/2 + acos(0.9*cos(x))'])
def test_taylor_takes_powers_and_roots_that_have_no_kink(H):
    simulation = Simulation(Formula(['x'], H), Taylor(1e-14), 1.0, [0.0], [1.0])
    energy = simulation.energy
    simulation.advance(3)
    assert abs(simulation.energy - energy) < 1e-12


def test_taylor_without_heyoka_is_one_line_with_the_command(monkeypatch):
    monkeypatch.setattr(taylor, 'find_spec', lambda name: None)
    with pytest.raises(UnsupportedSystem) as problem:
        kepler(1e-12, 1.0)
    assert f'{sys.executable} -m pip install "heyoka>=7.13,<8"' in str(problem.value)
    assert '\n' not in str(problem.value)


@pytest.mark.parametrize('tolerance', [0.0, 0.1, float('nan')])
def test_taylor_refuses_a_tolerance_that_is_none(tolerance):
    with refused(ValueError):
        Taylor(tolerance)


def test_a_restart_compiles_no_series_again_but_for_other_numbers(monkeypatch):
    made = []
    compiled = TaylorWork._compiled
    monkeypatch.setattr(TaylorWork, '_compiled', lambda self, *rest: (
        made.append(rest), compiled(self, *rest))[1])

    def after(stiffness: float) -> np.ndarray:
        run = Simulation(Formula(['x'], 'p_x^2/2 + k*x^4', parameters={'k': stiffness}),
                         Taylor(), 1.0, [0.5], [0.0])
        for _ in range(3):
            run.restart([0.5], [0.0])
            run.advance(2)
        return run.q

    first, other, again = after(0.3141), after(0.2718), after(0.3141)
    assert len(made) == 2
    assert (first == again).all() and (first != other).all()


def test_a_restart_derives_no_rates_again(monkeypatch):
    derived = []
    rates = taylor._rates
    run = kepler(1e-9, 1.0)
    monkeypatch.setattr(taylor, '_rates', lambda kernel: (derived.append(1), rates(kernel))[1])
    paths = []
    for _ in range(2):
        run.restart(Q0, P0)
        paths.append(run.record(2, 1)[0])
    assert len(derived) == 1 and (paths[0] == paths[1]).all()
