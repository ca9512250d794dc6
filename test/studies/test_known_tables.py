# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The page of published tables: its studies on short runs, and their systems."""

from pathlib import Path
from shutil import copytree

from gymnasium.envs.classic_control.acrobot import AcrobotEnv
from hnn_vi_ros.errors import DataError
import numpy as np
import pytest
from studies import (
    chnn, energy_drift, known_tables, short_motions, silverbox, symoden, two_masses)
from studies.published_page import read_results

DOCS = Path(__file__).parents[2] / 'docs' / 'evidence'


@pytest.fixture
def out(tmp_path) -> Path:
    """Return a copy of the results, to write to."""
    copytree(DOCS / 'learning', tmp_path / 'learning')
    return tmp_path


def measured(out: Path, table: str) -> dict[tuple[str, str], float]:
    """Return the values of a table, of the last seed."""
    return {(row.system, row.measure): row.value
            for row in read_results(out, known_tables.CSV) if row.table == table}


def test_a_study_replaces_the_rows_of_its_systems_only(out: Path):
    before = read_results(out, known_tables.CSV)
    known_tables.keep(out, 'energy_drift', [('chain', 0, 'gauss4', 0.5)])
    after = read_results(out, known_tables.CSV)
    others = [row for row in before if (row.table, row.system) != ('energy_drift', 'chain')]
    assert after[:len(others)] == others
    assert [row.measure for row in after[len(others):]] == ['gauss4', 'gauss4, seconds']
    page = (out / known_tables.PAGE).read_text()
    # Larger than published, so in bold; and what was not measured is said to be so.
    assert '| not measured, **0.5** | 1 |' in page


def test_acrobot_is_that_of_gymnasium():
    angles = np.array([0.7, -0.4])
    fine = energy_drift.gymnasium(0.001, angles, 1.0)
    simulation = energy_drift.acrobot_simulation(0.01, angles)
    simulation.advance(100)
    # Order 4 with steps of 1 ms: below 1e-12 over 1 s, and so is gauss8 with 10 ms.
    assert np.abs(simulation.q - fine.end).max() < 1e-10


@pytest.mark.long
def test_energies_are_measured_on_short_runs(out: Path):
    energy_drift.main(['--quick', '--out', str(out)])
    found = measured(out, 'energy_drift')
    assert found['chain', 'gauss4'] < 1e-9 < found['chain', 'variational_euler'] < 0.1
    assert found['acrobot 0.2', 'gauss8'] < found['acrobot 0.2', 'Gymnasium rk4'] < 0.1
    assert (out / 'learning' / 'energy_drift.png').stat().st_size > 1000


@pytest.mark.long
def test_two_masses_are_identified_to_their_noise(out: Path):
    two_masses.main(['--quick', '--out', str(out)])
    found = measured(out, 'two_masses')
    # The noise of 1 mm/s is 0.0024 of the test's velocities; numbers from 30 s add no more to it.
    assert found['0.1', 'gauss4'] < 0.01 < found['0.1', 'variational_euler']
    # Order 1: half the step, half the error, to a tenth of it.
    ratio = found['0.05', 'variational_euler'] / found['0.1', 'variational_euler']
    assert abs(ratio - 0.5) < 0.05


def test_chain_of_two_point_masses_is_the_double_pendulum_of_the_textbook():
    own = short_motions.chain_acceleration([1.0, 2.0], [0.5, 0.7], 9.81)
    q, v = np.array([[0.4, -1.1]]), np.array([[0.9, -0.3]])
    a = own(q, v, np.zeros((1, 2)))[0]
    between = q[0, 0] - q[0, 1]
    # Lagrange's equation of each angle, divided by its length.
    first = (3.0 * 0.5 * a[0] + 2.0 * 0.7 * (np.cos(between) * a[1] + np.sin(between) * v[0, 1]**2)
             + 3.0 * 9.81 * np.sin(q[0, 0]))
    second = (0.7 * a[1] + 0.5 * (np.cos(between) * a[0] - np.sin(between) * v[0, 0]**2)
              + 9.81 * np.sin(q[0, 1]))
    assert abs(first) < 1e-12 and abs(second) < 1e-12


def test_acrobot_of_symoden_is_that_of_gymnasium_with_torque():
    rng = np.random.default_rng(0)
    q, v, u = rng.normal(size=(3, 4, 2)) * [[[1.0]], [[1.0]], [[0.0]]]
    u[:, 1] = 0.7
    rates = AcrobotEnv()._dsdt
    wanted = [rates(np.array([*a, *b, 0.7]))[2:4] for a, b in zip(q, v, strict=True)]
    found = symoden.TASKS['acrobot'].mechanism.acceleration(q, v, u)
    assert np.abs(found - np.array(wanted)).max() < 1e-12


@pytest.mark.long
def test_mechanisms_are_identified_from_few_motions_without_noise(out: Path):
    chnn.main(['--quick', '--out', str(out)])
    symoden.main(['--quick', '--out', str(out)])
    found = measured(out, 'chnn') | measured(out, 'symoden')
    # The published measure has 1e-8 as its least; squares of 1e-6 in 40 x 6 numbers are 1e-10.
    assert all(found[name, chnn.MODEL] < 1e-6 for name in ('1 link', '2 links', 'rotor'))
    assert all(found[name, 'formula'] < 1e-10 for name in symoden.TASKS)
    assert (out / 'learning' / 'chnn.png').stat().st_size > 1000


def test_free_rotor_keeps_its_energy_and_its_axes_stay_orthogonal():
    system = chnn.rotor(np.random.default_rng(0), 3)
    q, v = np.split(system.starts, 2, axis=1)
    states = system.mechanism.motions(q, v, np.zeros((3, 3)), np.linspace(0.0, 5.0, 11))
    omega = np.array([chnn.turning(*np.split(run, 2, axis=1)) for run in states])
    energy = 0.5 * (omega**2 @ [1.0, 2.0, 3.0])
    # Solved to 1e-12 a step, in some hundred steps, near angles of which two are not defined.
    assert np.ptp(energy, axis=1).max() < 1e-8
    R = chnn.axes_of(states)[..., :9].reshape(3, 11, 3, 3)
    assert np.abs(R @ R.swapaxes(-1, -2) - np.eye(3)).max() < 1e-14


def test_magnets_pull_with_the_slope_of_their_potential(out: Path):
    system = chnn.magnets(np.random.default_rng(0), 2)
    numbers = 'J: 3.0, G: 25.0, Q: 0.006, d: 0.11, h: 1.06'
    assert numbers in system.mechanism.hamiltonian
    true = f'J: 3.0, G: {3.0 * 9.81}, Q: {0.3**2 / (4.0 * np.pi)}, d: 0.1, h: 1.05'
    (out / 'scene.yaml').write_text(
        f'hamiltonian:{system.mechanism.hamiltonian.replace(numbers, true)}\n'
        'integrator: {kind: gauss8}\nstep_size: 0.01\n'
        'initial_state: {q: [0.1, 0.1], p: [0.0, 0.0]}\n')
    hamiltonian = silverbox.load_scene(out / 'scene.yaml').create_hamiltonian()
    q = system.starts[:, :2]
    slope = hamiltonian.gradient(q, np.zeros_like(q))[0]
    found = system.mechanism.acceleration(q, np.zeros_like(q), np.zeros_like(q))
    mass = 3.0 * np.stack([np.cos(q[:, 1])**2, np.ones(2)], axis=-1)
    assert np.allclose(mass * found, -slope, rtol=1e-10)


@pytest.mark.long
def test_silverbox_of_its_own_formula_is_found_by_the_command_of_the_guide(tmp_path: Path,
                                                                           out: Path):
    data = {}
    for name, samples, seed in (('train', 700, 0), ('test', 400, 1)):
        t = 0.0016384 * np.arange(samples)
        rng, u = np.random.default_rng(seed), np.zeros(samples)
        for frequency in np.linspace(10.0, 120.0, 12):
            u += 0.01 * np.sin(2.0 * np.pi * (frequency * t + rng.random()))
        (tmp_path / 'scene.yaml').write_text(silverbox.documented()[0])
        simulation = silverbox.build(silverbox.load_scene(tmp_path / 'scene.yaml'))
        steps = silverbox.driven(simulation, t, u, positions=True)
        y = np.array([0.0, *(simulation.q[0] for _ in steps)])[::2]
        data |= {f'multisine_{name}/{key}': part
                 for key, part in zip('tuy', (t, u, y), strict=True)}
    (tmp_path / 'silverbox').mkdir()
    np.savez(tmp_path / silverbox.FILE, **data)
    silverbox.main(['--quick', '--data', str(tmp_path), '--out', str(out)])
    # Of 50 mV; the guide's scene is what made the record.
    assert measured(out, 'silverbox')['test', 'six numbers'] < 1e-3


def test_missing_record_of_the_silverbox_is_one_line(tmp_path: Path):
    with pytest.raises(DataError, match='silverbox.npz: cannot be read as the records'):
        silverbox.read(tmp_path / silverbox.FILE)
