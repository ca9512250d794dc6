# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The machinery of `make bench`, on rows that are made up: needs none of the peers."""

from collections.abc import Callable, Iterator
from dataclasses import replace
import json
from pathlib import Path

from benchmarks.bench import run, write
from benchmarks.measurement import assert_close, compare, interleave, Row, Settings
from benchmarks.report import Group, measured_here, read_groups
import numpy as np
import pytest


class Clock:
    """A clock that goes on when it is told to."""

    now = 0.0

    def perf_counter(self) -> float:
        return self.now

    process_time = perf_counter

    def waiting(self, seconds: float) -> Callable:
        """Return a contestant whose runs take this long."""
        def wait() -> None:
            self.now += seconds
        return lambda: wait


CLOCK = Clock()


def measure(settings: Settings) -> Iterator[Row]:
    """Measure a run that takes half as long as its peer's, and make up one that misses."""
    settings.say('waiting')
    times = interleave([CLOCK.waiting(0.01), CLOCK.waiting(0.02)], settings.repetitions)
    yield compare('half', times[:, 0], times[:, 1], target=0.9, scale=1e3, unit='ms',
                  peer_name='sleep')
    yield Row('slow', '3 s', '1 s', 3.0, (3.0, 3.0), 2.5, 1, unit='s more', miss='It sleeps.')
    yield Row('told', '1', '1', 1.0, (1.0, 1.0), None, 1)


def test_bench_writes_the_ratios_and_says_which_rows_miss(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr('benchmarks.measurement.time', CLOCK)
    rows = run({'fake': (measure, 1.0)}, repetitions=5, quick=False)
    write({'fake': measured_here(rows['fake'], 7)}, tmp_path / 'out')
    written = json.loads((tmp_path / 'out' / 'benchmarks.json').read_text())['fake']['rows']
    assert [(row['name'], row['target']) for row in written] == [
        ('half', 0.9), ('slow', 2.5), ('told', None)]
    # To the rounding of sums of some tenths of a second.
    assert abs(written[0]['ratio'] - 0.5) < 1e-12
    text = (tmp_path / 'out' / 'benchmarks.md').read_text()
    assert '| slow | 3 s | 1 s | **3.00 s more** | 2.5 |' in text
    assert '- **slow**, 3.00 for 2.5: It sleeps.' in text and '**half**' not in text
    # Without a target it is in the JSON alone.
    assert '| told |' not in text
    assert 'left' in capsys.readouterr().out


def test_groups_that_are_measured_again_leave_the_others(tmp_path):
    first, second = (Row(name, '1', '2', 0.5, (0.4, 0.6), 1.0, 3) for name in ('one', 'two'))
    write({'many': Group('there', [first]), 'gradient': Group('there', [second])}, tmp_path)
    third = replace(first, ratio=0.004)
    write({'many': Group('here', [third])}, tmp_path)
    known = read_groups(tmp_path / 'benchmarks.json')
    assert known == {'gradient': Group('there', [second]), 'many': Group('here', [third])}
    text = (tmp_path / 'benchmarks.md').read_text()
    assert text.index('| two |') < text.index('| one | 1 | 2 | 0.004 |')
    assert '- gradient: there\n- many: here\n' in text


def test_rows_of_groups_that_were_measured_before_an_interruption_are_found_again(tmp_path):
    def broken(settings: Settings) -> Iterator[Row]:
        yield from ()
        raise RuntimeError('interrupted')

    row, again = Row('row', '1', '2', 0.5, (0.4, 0.6), 1.0, 3, note='Kept.'), []

    def once(settings: Settings) -> Iterator[Row]:
        again.append(1)
        yield row

    groups = {'once': (once, 1.0), 'broken': (broken, 1.0)}
    with pytest.raises(RuntimeError, match='interrupted'):
        run(groups, 1, quick=False, keep=tmp_path)
    assert run({'once': (once, 1.0)}, 1, quick=False, keep=tmp_path) == {'once': [row]}
    assert again == [1]
    assert [path.name for path in tmp_path.iterdir()] == ['once.json']


def test_ratio_is_the_median_of_those_of_each_turn():
    row = compare('name', np.array([1.0, 2.0, 9.0]), np.array([2.0, 2.0, 2.0]), target=1.0)
    assert (row.ratio, row.quartiles, row.repetitions, row.met) == (1.0, (0.75, 2.75), 3, True)


def test_interleave_prepares_each_run_and_alternates_the_order():
    order = []

    def contestant(name: str) -> Callable:
        def prepare() -> Callable:
            order.append(f'prepare {name}')
            return lambda: order.append(name)
        return prepare

    times = interleave([contestant('a'), contestant('b')], 2, warm_up=False, one_thread=False)
    assert times.shape == (2, 2) and np.all(times > 0.0)
    assert order == ['prepare a', 'a', 'prepare b', 'b', 'prepare b', 'b', 'prepare a', 'a']


def test_rows_of_one_name_are_refused():
    rows = Row('twice', '', '', 1.0, (1.0, 1.0), None, 1)
    with pytest.raises(ValueError, match='twice'):
        run({'fake': (lambda settings: iter([rows, rows]), 1.0)}, 1, quick=True)


@pytest.mark.parametrize('theirs', [1.1, np.nan])
def test_times_of_different_results_are_refused(theirs):
    assert_close('same', np.array([1.0]), np.array([1.0]), 0.0)
    with pytest.raises(RuntimeError, match='differ'):
        assert_close('other', np.array([1.0]), np.array([theirs]), 1e-12)


def test_benchmarks_are_not_collected_as_tests():
    folder = Path(__file__).parents[1] / 'docs' / 'benchmarks'
    assert not [*folder.glob('test_*.py'), *folder.glob('*_test.py')]
