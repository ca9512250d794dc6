# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Runs of formulas with steps too large that keep their energy are told all the same."""

from hnn_vi_ros import load_scene
from hnn_vi_ros.hamiltonians import Formula, HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.simulation import (
    build, judge_block, make_guards, PoleGuard, record_one, RunFacts, Schedule, Simulation)
from hnn_vi_ros.simulation.guards.bands import BarrierGuard
from hnn_vi_ros.simulation.guards.saddles import SaddleSearch
from hnn_vi_ros.simulation.guards.samples import SampleBlock
import numpy as np
import pytest

PENDULUM = 'p_q^2 / 2 + 1 - cos(q)'
WELLS = 'p_q^2 / 2 - q^2 / 2 + q^4 / 4'
SPHERICAL = 'p_theta^2 / 2 + p_phi^2 / (2 * sin(theta)^2) - cos(theta)'
POLAR = 'p_r^2 / 2 + p_phi^2 / (2 * r^2) + r^2 / 2'


def simulation_of(formula: str, names: str, method: str, h: float, q: list, p: list) -> Simulation:
    return Simulation(Formula(names.split(), formula), INTEGRATORS[method](), h, q, p)


def kinds(simulation: Simulation, steps: int, every: int = 1) -> list[str]:
    found = record_one(simulation, Schedule.until(
        steps * simulation.step_size, every, simulation))
    return [alarm.kind for alarm in found.alarms]


def block_of(simulation: Simulation, steps: int) -> SampleBlock:
    """Return the samples of a run as guards see them."""
    q, p = (np.vstack([start, path]) for start, path in zip(
        (simulation.q.copy(), simulation.p.copy()), simulation.record(steps, 1), strict=True))
    energy = simulation.hamiltonian.energy(q, p)
    return SampleBlock(np.arange(steps + 1), q, p, *simulation.hamiltonian.gradient(q, p), energy,
                       energy, 0.0 * energy)


def parts_of(block: SampleBlock, length: int) -> list[SampleBlock]:
    return [SampleBlock(*(part[i:i + length] for part in block))
            for i in range(0, len(block.step), length)]


@pytest.mark.parametrize('formula, q, p, method, h', [
    (PENDULUM, 3.052142479252326, 0.0, 'generalized_leapfrog', 0.1),
    (PENDULUM, 0.0, 1.998, 'stormer_verlet', 0.1),
    (WELLS, 1.0, 0.7072, 'stormer_verlet', 0.1),
    (WELLS, 1.0, 0.707, 'implicit_midpoint', 0.1)])
def test_motion_next_to_a_saddle_of_a_formula_is_told_as_that_of_a_system_that_names_it(
        formula, q, p, method, h):
    assert 'saddle not resolved' in kinds(simulation_of(formula, 'q', method, h, [q], [p]), 600)


def test_double_well_that_is_not_passed_although_its_energy_is_above_the_saddle_is_told():
    simulation = simulation_of(WELLS, 'q', 'implicit_midpoint', 0.2, [1.0], [0.708])
    block = block_of(simulation, 300)
    assert block.energy[0] > 0.0 and (block.q > 0.0).all()
    simulation.restart([1.0], [0.708])
    assert 'saddle not resolved' in kinds(simulation, 300)


@pytest.mark.parametrize('formula, names, q, p, energies', [
    (PENDULUM, 'q', [3.0], [0.0], [2.0]), (WELLS, 'q', [1.0], [0.72], [0.0]),
    ('(p_x^2 + p_y^2) / 2 + (x^2 + y^2) / 2 + x^2*y - y^3 / 3', 'x y', [0.0, 0.9], [0.0, 0.0],
     [1 / 6]),
    ('p_q^2 / 2 + q^2 / 2', 'q', [1.0], [0.0], []), ('p_q^2 / 2 + q^4', 'q', [1.0], [0.0], []),
    ('(p_x^2 + p_y^2) / 2 - 1 / sqrt(x^2 + y^2)', 'x y', [1.9, 0.0], [0.0, 0.23], [])])
def test_search_finds_the_energies_of_the_saddles_next_to_a_run(formula, names, q, p, energies):
    simulation = simulation_of(formula, names, 'gauss4', 0.05, q, p)
    search = SaddleSearch(simulation.hamiltonian, lambda: True)
    found = [energy for _, energy in search.take(block_of(simulation, 1000))]
    # A pendulum comes next to two, on its left and on its right.
    assert len(found) <= 2 * len(energies)
    assert sorted({round(energy, 12) for energy in found}) == pytest.approx(energies, abs=1e-11)


@pytest.mark.parametrize('formula, names, momentum', [
    (SPHERICAL, 'theta phi', 1e-8), (SPHERICAL, 'theta phi', 1e-4), (POLAR, 'r phi', 1e-6)])
@pytest.mark.parametrize('method', ['generalized_leapfrog', 'gauss4', 'discrete_gradient'])
def test_step_over_a_pole_is_told_however_small_the_angular_momentum(
        formula, names, momentum, method):
    """The energy is as good as ever, and the azimuth off by pi at each passage."""
    simulation = simulation_of(formula, names, method, 0.1, [1.0, 0.0], [0.0, momentum])
    assert set(kinds(simulation, 100)) & {'pole crossed', 'path not resolved'}


def test_pole_of_factor_zero_is_no_pole_of_the_motion():
    simulation = simulation_of(SPHERICAL, 'theta phi', 'gauss4', 0.1, [1.0, 0.0], [0.0, 0.0])
    assert kinds(simulation, 200) == []


@pytest.mark.parametrize('formula, names, q, p, h', [
    ('(p_x^2 + p_y^2) / 2 - 1 / sqrt(x^2 + y^2)', 'x y', [1.9, 0.0], [0.0, 0.23], 0.002),
    ('p_r^2 / 2 + 4 * (r^-12 - r^-6)', 'r', [1.6], [0.0], 0.002),
    (SPHERICAL, 'theta phi', [1.0, 0.0], [0.0, 0.2], 0.01)])
def test_motion_that_is_resolved_next_to_a_pole_is_not_told(formula, names, q, p, h):
    assert kinds(simulation_of(formula, names, 'gauss4', h, q, p), 4000) == []


@pytest.mark.parametrize('method, h, told', [
    ('generalized_leapfrog', 0.25, True), ('generalized_leapfrog', 0.15, False),
    ('implicit_midpoint', 0.18, True), ('implicit_midpoint', 0.1, False),
    ('discrete_gradient', 0.18, True), ('variational_euler', 0.25, True),
    ('variational_euler', 0.09, False), ('gauss4', 1.2, True), ('gauss4', 0.8, False)])
def test_path_guard_tells_where_a_tenth_of_the_amplitude_is_lost_in_ten_turns(method, h, told):
    """The frequency is off by h^2 / 24 (explicit), h^2 / 12 (midpoint) and h^4 / 720 (gauss4)."""
    simulation = simulation_of('p_q^2 / 2 + q^2 / 2', 'q', method, h, [1.0], [0.0])
    assert ('path not resolved' in kinds(simulation, int(20.0 * np.pi / h))) == told


@pytest.mark.parametrize('length', [1, 7])
@pytest.mark.parametrize('name', ['pole', 'saddle'])
def test_samples_in_parts_show_what_they_show_together(name, length):
    simulation = simulation_of(SPHERICAL, 'theta phi', 'gauss4', 0.1, [1.0, 0.0], [0.0, 1e-8])
    block = block_of(simulation, 60)
    if name == 'saddle':
        def find(blocks):
            search = SaddleSearch(simulation.hamiltonian, lambda: True)
            return [(int(part.step[i]), e) for part in blocks for i, e in search.take(part)]
    else:
        def find(blocks):
            guard = PoleGuard(simulation.hamiltonian)
            return [alarm for part in blocks for alarm in judge_block([guard], part)]
    assert find(parts_of(block, length)) == find([block])


@pytest.mark.parametrize('name', ['pendulum', 'henon_heiles'])
def test_system_that_names_its_barrier_is_not_searched(name):
    """What it says is 'separatrix' or 'escape barrier', from the first sample on."""
    d = HAMILTONIANS[name]().dimension
    simulation = Simulation(HAMILTONIANS[name](), INTEGRATORS['gauss4'](), 0.01, [0.1] * d,
                            [0.0] * d)
    assert kinds(simulation, 20) == []


def test_saddle_of_h_that_a_constraint_keeps_away_is_not_searched_for():
    simulation = build(load_scene('cartesian_pendulum'))
    guards = make_guards(RunFacts(simulation))
    assert BarrierGuard not in {type(guard) for guard in guards}


def test_search_waits_for_no_second_derivatives_that_are_being_compiled():
    simulation = simulation_of(PENDULUM, 'q', 'gauss4', 0.05, [3.0], [0.0])
    search = SaddleSearch(simulation.hamiltonian, lambda: False)
    assert not [*search.take(block_of(simulation, 1000))]


@pytest.mark.parametrize('every', [1, 20, 400])
def test_orbit_that_is_resolved_crosses_no_pole_however_few_its_samples(every):
    simulation = Simulation(HAMILTONIANS['kepler'](), INTEGRATORS['gauss8'](), 0.005, [0.1, 0.0],
                            [0.0, 19.0**0.5])
    assert 'pole crossed' not in kinds(simulation, 4000, every)
