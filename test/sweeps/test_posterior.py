# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers of an identified model as what varies in a sweep."""

import json
from pathlib import Path
from typing import Any

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.sweeps import sweep
from hnn_vi_ros.sweeps.axes import read_posterior
from hnn_vi_ros.sweeps.plan import make_plan
from messages import refused
import numpy as np
import pyarrow.parquet as pq
import pytest

MEAN = [1.5, 0.8, 9.8]
COVARIANCE = [[4e-4, 1.8e-4, 0.0], [1.8e-4, 1e-4, 0.0], [0.0, 0.0, 0.0]]
NAMES = ['hamiltonian.mass', 'hamiltonian.length', 'hamiltonian.gravity']


def posterior(tmp_path: Path, **changed: Any) -> str:
    content = {
        'parameters': {name: {'value': value, 'low': 0.0, 'high': 10.0, 'standard_error': 0.01}
                       for name, value in zip(NAMES, MEAN, strict=True)},
        'covariance': {'names': NAMES, 'matrix': COVARIANCE}, 'seconds': 3.0} | changed
    path = tmp_path / 'posterior.json'
    path.write_text(json.dumps(content))
    return str(path)


def definition(path: str, **more: Any) -> dict[str, Any]:
    return {'scene': 'exact_pendulum', 'duration': 0.1, 'seed': 3, 'vary': [
        {'kind': 'posterior', 'path': path, 'count': 4000} | more]}


def test_draws_have_the_mean_and_the_covariance_that_were_found(tmp_path):
    plan = make_plan(definition(posterior(tmp_path)))
    assert plan.keys == NAMES and plan.count == 4000
    drawn = np.array(plan.values(range(4000)))
    spread = np.sqrt(np.diag(COVARIANCE))
    # The mean of 4000 draws is off by 5 of its standard deviations once in two million times; a
    # variance by 5 times sqrt(2 / 4000) of itself.
    assert (np.abs(drawn.mean(axis=1) - MEAN) <= 5.0 * spread / 4000**0.5 + 1e-12).all()
    scale = np.maximum(spread, 1e-12)
    error = (np.cov(drawn) - np.array(COVARIANCE)) / scale / scale[:, None]
    assert np.abs(error).max() <= 5.0 * (2.0 / 4000) ** 0.5
    # What is known exactly does not vary.
    assert np.ptp(drawn[2]) <= 1e-12


def test_number_is_drawn_at_its_place_in_the_scene(tmp_path):
    path = Path(posterior(tmp_path))
    text = path.read_text()
    path.write_text(text.replace(NAMES[0], 'mass').replace(
        '"mass": {', f'"mass": {{"place": "{NAMES[0]}", '))
    plan = make_plan(definition(str(path)))
    assert plan.keys == NAMES
    # A key that is given counts for more.
    other = make_plan(definition(str(path), keys={'mass': NAMES[1]}))
    assert other.keys == NAMES[1:2]


def test_draws_are_by_index_and_seed_alone(tmp_path):
    path = posterior(tmp_path)
    vary = [{'kind': 'values', 'key': 'initial_state.q', 'values': [[0.1], [0.2], [0.3]]},
            *definition(path, count=100)['vary']]
    plan = make_plan(definition(path) | {'vary': vary})
    columns = plan.values(range(300))
    assert columns[1][:100] == columns[1][100:200]
    for part in (range(1), range(31, 65), range(95, 207), range(299, 300)):
        assert plan.values(part) == [column[part.start:part.stop] for column in columns]
    other = make_plan(definition(path) | {'seed': 4})
    assert not set(other.values(range(300))[0]) & set(columns[1])


def test_sweep_over_some_numbers_by_their_keys(tmp_path):
    path = posterior(tmp_path, parameters={'m': {'value': 1.5}, 'l': {'value': 0.8}}, covariance={
        'names': ['l', 'm'], 'matrix': [[1e-4, 1.8e-4], [1.8e-4, 4e-4]]})
    few = definition(path, count=8, keys={'l': 'hamiltonian.length'})
    folder = sweep(few, tmp_path / 'out')
    table = pq.read_table(folder / 'part-000000.parquet')
    lengths = np.array(table['hamiltonian.length'])
    assert len(set(lengths)) == 8 and np.abs(lengths - 0.8).max() <= 6.0 * 0.01
    assert table['failure'].null_count == 8 and len(set(table['q_angle'].to_pylist())) == 8
    # Another file is another sweep.
    before = make_plan(few).record['digest']
    Path(path).write_text(Path(path).read_text().replace('0.8', '0.9'))
    assert make_plan(few).record['digest'] != before


@pytest.mark.parametrize('changed', [
    {'covariance': None}, {'parameters': {'hamiltonian.mass': {'value': 'x'}}},
    {'covariance': {'names': NAMES, 'matrix': COVARIANCE[:2]}},
    {'covariance': {'names': NAMES, 'matrix': [[1e-4, 1.0, 0.0], *COVARIANCE[1:]]}},
    {'covariance': {'names': NAMES[:2], 'matrix': [[1.0, 2.0], [2.0, 1.0]]}},
    {'covariance': {'names': NAMES[:1], 'matrix': [[float('nan')]]}},
    {'parameters': {'hamiltonian.mass': {'value': True}}},
    {'covariance': {'names': NAMES[:1], 'matrix': [['1e-4']]}},
    {'covariance': {'names': ['\x1b[31m'], 'matrix': [[1e-4]]}}, {'parameters': {}}], ids=str)
def test_file_that_cannot_be_used_is_one_line(tmp_path, changed):
    with refused(DataError):
        make_plan(definition(posterior(tmp_path, **changed)))


def test_name_that_is_not_there_and_file_that_is_not_are_told(tmp_path):
    with refused(DataError):
        read_posterior(Path(posterior(tmp_path)), 'sweep: vary.0',
                       {'hamiltonian.mas': 'hamiltonian.mass'})
    # Of which no more is read than shows that it is too large.
    with (tmp_path / 'huge.json').open('wb') as stream:
        stream.truncate(2**40)
    (tmp_path / 'bad.json').write_text('{')
    for name in ('none', 'huge', 'bad'):
        with refused(DataError):
            read_posterior(tmp_path / f'{name}.json', 'sweep: vary.0')
