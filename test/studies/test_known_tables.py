# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The page of published tables: its studies on short runs, and their systems."""

from pathlib import Path
from shutil import copytree

import numpy as np
import pytest
from studies import energy_drift, known_tables, two_masses
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


def test_a_table_replaces_its_own_rows_only(out: Path):
    before = read_results(out, known_tables.CSV)
    known_tables.keep(out, 'energy_drift', [('chain', 0, 'gauss4', 0.5)])
    after = read_results(out, known_tables.CSV)
    others = [row for row in before if row.table != 'energy_drift']
    assert after[:len(others)] == others
    assert [(row.measure, row.value) for row in after[len(others):-1]] == [('gauss4', 0.5)]
    page = (out / known_tables.PAGE).read_text()
    # Larger than published, so in bold; and what was not measured is said to be so.
    assert '| **5.00e-01** | `gauss4` |' in page and '| not measured |' in page


def test_acrobot_is_that_of_gymnasium():
    angles = np.array([0.7, -0.4])
    fine = energy_drift.gymnasium(0.001, angles, 1.0)
    simulation = energy_drift.acrobot_simulation(0.01, angles)
    simulation.advance(100)
    # Order 4 with steps of 1 ms: below 1e-12 over 1 s, and so is gauss8 with 10 ms.
    assert np.abs(simulation.q - fine.end).max() < 1e-10


def test_energies_are_measured_on_short_runs(out: Path):
    energy_drift.main(['--quick', '--out', str(out)])
    found = measured(out, 'energy_drift')
    assert found['chain', 'gauss4'] < 1e-9 < found['chain', 'variational_euler'] < 0.1
    assert found['acrobot 0.2', 'gauss8'] < found['acrobot 0.2', 'Gymnasium rk4'] < 0.1
    assert (out / 'learning' / 'energy_drift.png').stat().st_size > 1000


def test_two_masses_are_identified_to_their_noise(out: Path):
    two_masses.main(['--quick', '--out', str(out)])
    found = measured(out, 'two_masses')
    # The noise of 1 mm/s is 0.0024 of the test's velocities; numbers from 30 s add no more to it.
    assert found['0.1', 'gauss4'] < 0.01 < found['0.1', 'variational_euler']
    # Order 1: half the step, half the error, to a tenth of it.
    ratio = found['0.05', 'variational_euler'] / found['0.1', 'variational_euler']
    assert abs(ratio - 0.5) < 0.05
