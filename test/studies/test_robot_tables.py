# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Tables of what was identified of robots: the choice, what is kept, and coverage."""

import json

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.hamiltonians import parse_urdf
import numpy as np
import pytest
from studies import rigid_body_coverage, robot_tables
from studies.published_page import robot_rows, ROBOTS
from studies.robot_tables import (
    DFKI_URDF, MODELS, read_runs, ROBOTS_MEASURED, rows_of, two_runs)

UR10, MEASURE = 'real UR10', ROBOTS_MEASURED['real UR10'].chosen_by


def run_of(model: str, use: str, value: float) -> dict:
    return {'robot': UR10, 'model': model, 'use': use, 'measures': {MEASURE: [value] * 6}}


def test_networks_are_chosen_by_data_that_the_table_does_not_show(tmp_path):
    # The second is best in the choice, the first on the test.
    chosen, tested = (3.0, 1.0, 2.0), (0.1, 0.2, 0.3)
    runs = [run_of(model, use, value) for use, values in (('choice', chosen), ('test', tested))
            for model, value in zip(MODELS, values, strict=True)]
    rows = rows_of(runs)
    assert [row['chosen'] for row in rows] == [False, True, False]
    assert [row['ours'][0] for row in rows] == list(tested)
    # None is chosen before all were measured.
    assert not any(row['chosen'] for row in rows_of(runs[1:]))
    (tmp_path / ROBOTS).write_text(json.dumps(rows))
    cells = list(robot_rows(tmp_path / ROBOTS))
    assert [row[2].startswith('**') for row in cells] == [False, True, False]
    assert cells[1][-1] == '0.2, 0.2, 0.2, 0.2, 0.2, 0.2'


@pytest.mark.parametrize('text', ['[', '[{"robot": "no"}]', '[{"model": "rigid_body"}]', '3'])
def test_runs_that_are_none_are_refused_with_the_remedy(tmp_path, text):
    assert read_runs(tmp_path / 'none.json') == []
    file = tmp_path / 'runs.json'
    file.write_text(text)
    with pytest.raises(ParameterError, match='runs.json: cannot be read .* move it away'):
        read_runs(file)


def test_test_data_follow_what_is_learned_from_with_a_gap(tmp_path):
    np.savez(tmp_path / 'one.npz', t=np.arange(1000.0), q=np.zeros((1000, 2)))
    with np.load(two_runs(tmp_path / 'one.npz', tmp_path / 'two.npz')) as found:
        assert found['train/t'][-1] == 599.0 and found['test/t'][0] == 660.0
        assert found['test/q'].shape == (340, 2)


def test_first_guess_of_the_double_pendulum_is_two_rods():
    robot = parse_urdf(DFKI_URDF.encode(), 'dfki')
    for name, length in (('upper', 0.2), ('lower', 0.3)):
        inertial = robot.links[name].inertial
        assert inertial.centre[2] == pytest.approx(-0.5 * length)
        assert inertial.moments[0, 0] == pytest.approx(0.6 * length**2 / 12.0)


def test_coverage_counts_each_base_parameter_once():
    (names, hits), = rigid_body_coverage.held([3], 1)
    # Two inertias, first moments along and across each link, and offsets.
    assert len(names) == len(set(names)) == len(hits) == 8 and sum(hits) >= 5


def test_urdf_of_the_ur10_is_asked_for_only_where_it_is_measured(tmp_path, monkeypatch, capsys):
    words = ['--data', str(tmp_path), '--out', str(tmp_path)]
    with pytest.raises(SystemExit) as caught:
        robot_tables.main(words)
    assert caught.value.code == 2
    assert '--ur10 is required for the real UR10' in capsys.readouterr().err
    other = next(name for name in ROBOTS_MEASURED if name != UR10)
    kinds = [*ROBOTS_MEASURED[other].references, ROBOTS_MEASURED[other].chosen_by]
    monkeypatch.setattr(robot_tables, 'measure', lambda *job: {
        kind: [0.1, 0.2] for kind in kinds})
    robot_tables.main([*words, '--robot', other])
    assert {row['robot'] for row in json.loads((tmp_path / ROBOTS).read_text())} == {other}
    # Nor where the UR10 was measured before.
    runs = json.loads((tmp_path / robot_tables.RUNS).read_text())
    runs += [run_of(model, use, 0.1) for model in MODELS for use in ('choice', 'test')]
    (tmp_path / robot_tables.RUNS).write_text(json.dumps(runs))
    robot_tables.main(words)
