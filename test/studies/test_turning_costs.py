# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The study of what accuracy costs for bodies that turn."""

from importlib.util import find_spec
import math
from pathlib import Path
import shutil

from hnn_vi_ros.errors import ParameterError
from messages import refused
import numpy as np
import pytest
from studies import turning_costs
from studies.explore_page import page_data
from studies.measuring import StudyRow
from studies.references import make_reference
from studies.results import read_results

DOCS = Path(__file__).parents[2] / 'docs'
PEERS = all(find_spec(name) is not None for name in ('diffrax', 'mujoco'))


@pytest.fixture
def docs(tmp_path: Path) -> Path:
    """Return a folder of documentation with one scene's rows and the page."""
    folder = DOCS / turning_costs.FOLDER
    for path in (DOCS / turning_costs.PAGE, folder / 'floors.json', *folder.glob('*.csv')):
        copy = tmp_path / path.relative_to(DOCS)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, copy)
    return tmp_path


@pytest.mark.long
@pytest.mark.skipif(not PEERS, reason='needs diffrax and mujoco')
@pytest.mark.timeout(300)
def test_study_of_a_second_writes_the_page_and_rows_that_agree(docs: Path):
    turning_costs.main(['--docs', str(docs), '--quick'])
    folder = docs / turning_costs.FOLDER
    for scene in ('heavy_top', 'quadrotor'):
        rows = {row.method.partition(' ')[0]: row for row in read_results(folder)[scene].rows
                if row.finished}
        # Each in coordinates of its own: all of them have the same body and the same start.
        assert {'lie_gauss8', 'scipy', 'diffrax', 'RK4', 'MuJoCo'} <= rows.keys()
        assert rows['lie_gauss8'].path_error < 1e-9 and rows['diffrax'].path_error < 1e-7
        assert rows['RK4'].path_error < 1e-6
        assert page_data(folder)['scenes'][scene]['horizons'].keys() == {'1.0'}
        assert (folder / f'{scene}_1s.png').stat().st_size > 1000
    page = (docs / turning_costs.PAGE).read_text()
    # The last table tells what is kept, of ours and of two of the peers.
    assert page.count('| `lie_gauss8` |') == 2 and page.count('| MuJoCo RK4 |') == 2
    assert page.count('| RK4 on quaternions |') == 3
    assert page.index('## Bands of ensembles') > page.index(turning_costs.END)


def test_table_has_the_cheapest_good_row_of_each_method_and_the_best_of_others():
    def row(method: str, h: float, error: float, seconds: float, status: str = 'ok') -> StudyRow:
        return StudyRow(method, h, 10.0, error, 0.0, seconds, seconds, 1.0, status)
    rows = turning_costs.best_rows([
        row('kahan_li8', 0.1, 1e-9, 3e-3), row('kahan_li8', 0.2, 5e-9, 1e-3),
        row('a peer tolerance=1e-09', math.nan, 2e-7, 1e-5),
        row('a peer tolerance=1e-07', math.nan, 2e-5, 1e-6),
        row('MuJoCo RK4', 0.1, math.nan, 1e-3, 'not finite at t = 1 s')])
    assert [(row.method, row.path_error) for row in rows] == [
        ('kahan_li8', 5e-9), ('a peer tolerance=1e-09', 2e-7)]


def test_what_a_top_keeps_is_that_of_its_attitude_whatever_the_norm():
    case = turning_costs.cases()[0]
    z = np.array([np.concatenate([share * case.q, case.p]) for share in (1.0, 1.5)])
    energy, vertical, norm = turning_costs.invariants(case, z)
    assert energy[1] == pytest.approx(energy[0], rel=1e-15)
    assert vertical[1] == pytest.approx(vertical[0], rel=1e-15)
    assert norm == pytest.approx([1.0, 1.5], rel=1e-15)


def test_page_without_its_marks_is_one_line(docs: Path):
    (docs / turning_costs.PAGE).write_text('# Bodies\n')
    with refused(ParameterError):
        turning_costs.write(docs, {}, [])


@pytest.mark.long
def test_reference_of_a_body_that_turns_is_known_to_round_off():
    case = turning_costs.cases()[0]
    reference = make_reference(case.hamiltonian, case.q, case.p, 1.0)
    assert reference.verified and reference.accuracy < 1e-11
    assert np.allclose(np.sum(reference.states[:, :4] ** 2, axis=1), 1.0, rtol=0.0, atol=1e-14)
