# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The study of path errors counts silent and false runs, and takes no run twice."""

import math

import pytest
from studies import path_error
from studies.path_error import Row, Summary
from studies.path_error_systems import SYSTEMS


def row(error: float, told: float, estimated: bool = True, alarm: bool = False) -> Row:
    return Row('orbit', 'rk4', 0.1, error, told, estimated, 1.0, alarm)


@pytest.mark.parametrize('found, words', [
    (row(0.4, 0.09), {'wrong', 'silent'}), (row(math.inf, math.nan), {'wrong', 'silent'}),
    (row(0.4, 0.3), {'wrong'}), (row(0.4, 0.09, alarm=True), {'wrong'}),
    (row(0.009, 0.3, alarm=True), {'right', 'false'}), (row(0.009, 0.3), {'right'}),
    (row(0.05, 0.01, estimated=False), {'broken'}), (row(0.05, 0.01), set()),
    (row(1e-7, 1e-12, estimated=False), {'right'})])
def test_run_is_judged_by_true_error_error_told_and_alarm(found, words):
    judgements = 'wrong', 'right', 'silent', 'false', 'broken'
    assert {word for word in judgements if getattr(found, word)} == words


def test_ratios_are_those_of_estimates_whose_path_is_not_lost():
    rows = [row(0.1, 0.2), row(0.1, 1.5), row(0.001, 0.005, estimated=False)]
    assert Summary.of('', rows).ratios == [2.0] * 3
    assert Summary.of('', rows[1:]).cells[-3:] == [''] * 3


def test_study_takes_no_run_twice_and_each_system_has_the_path_of_a_solver(tmp_path, monkeypatch):
    arguments = ['--docs', str(tmp_path), '--systems', 'one swing', '--methods', 'rk4']
    path_error.main(arguments)
    rows = path_error.read_rows(tmp_path)
    assert len(rows) == path_error.STEPS and min(found.error for found in rows) < 1e-3
    # An estimate of order 4 that is seen, not assumed.
    assert all(0.5 < found.ratio < 2.0 for found in rows if found.ratio == found.ratio)
    assert not any(found.silent or found.broken for found in rows)
    before = (tmp_path / path_error.FILE).read_bytes()
    monkeypatch.setattr(path_error, 'run', None)
    path_error.main(arguments)
    assert (tmp_path / path_error.FILE).read_bytes() == before
    assert '24 runs of 1 systems' in (tmp_path / path_error.PAGE).read_text()


def test_systems_and_methods_are_paired_in_rounds():
    pairs = [*path_error.pairs([*SYSTEMS], ['gauss4', 'rk4'])]
    assert len(pairs) == len(set(pairs)) == 2 * len(SYSTEMS)
