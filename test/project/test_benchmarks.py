# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The machinery of `make bench`, on rows that are made up: needs none of the peers."""

import ast
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
import json
import os
from pathlib import Path
import platform
import re
import subprocess
import sys

from benchmarks.bench import GROUPS, run, write
from benchmarks.choosing import accurate_ways, cheapest, first_good, path_run, problem_of, Way
from benchmarks.measurement import assert_close, compare, interleave, race, Row, Settings
from benchmarks.report import as_markdown, as_table, Group, measured_here, read_groups
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.simulation import Method
import numpy as np
from packaging.utils import canonicalize_name
import pytest
from sources import brought, requirements_of, ROOT

DOCS = ROOT / 'docs'
# The files of docs that each target of the Makefile runs, and whether it may call any function of
# them: peers are imported in functions, which only --peers calls.
IMPORTING = {
    'bench': (['benchmarks/*.py'], True),
    'accuracy': (['studies/*.py'], True),
    'study': (['studies/*.py'], False),
    'hard-cases': (['studies/*.py'], False),
    'docs': (['conf.py', 'tools/*.py', 'tutorials/*.ipynb'], True),
}
# Files of requirements of a group of make_venv that has others than one of its name.
FILES = {'run': ['build', 'runtime', 'rerun', 'sweep', 'jazzy']}
# Distributions of other names than that of the package, with or without ros-.
DISTRIBUTIONS = {'PIL': 'pillow', 'pinocchio': 'pin', 'rerun': 'rerun-sdk', 'yaml': 'pyyaml'}
# Peers of scripts that name them as their own needs.
OPTIONAL = {'crocoddyl', 'pytorch_mppi'}


class Clock:
    """A clock that goes on when it is told to."""

    now = 0.0

    def perf_counter(self) -> float:
        return self.now

    process_time = perf_counter


CLOCK = Clock()


@pytest.fixture(autouse=True)
def clock(request, monkeypatch):
    """Have runs timed by that clock, but where they are real; no garbage is in the way."""
    monkeypatch.setattr('gc.collect', int)
    if 'alternates' not in request.node.name:
        monkeypatch.setattr('benchmarks.measurement.time', CLOCK)


def waiting(*seconds: float) -> Callable:
    """Return a contestant whose runs take these times in turn, the last of them from then on."""
    times = [*seconds]

    def wait() -> None:
        CLOCK.now += times.pop(0) if len(times) > 1 else times[0]
    return lambda: wait


def measure(settings: Settings) -> Iterator[Row]:
    """Measure a run that takes half as long as its peer's, and make up one that misses."""
    settings.say('waiting')
    times = interleave([waiting(0.01), waiting(0.02)], settings.repetitions)
    yield compare('half', times[:, 0], times[:, 1], target=0.9, scale=1e3, unit='ms',
                  peer_name='sleep')
    yield Row('slow', '3 s', '1 s', 3.0, (3.0, 3.0), 2.5, 1, unit='s more', miss='It sleeps.')
    yield Row('told', '1', '1', 1.0, (1.0, 1.0), None, 1)


def test_bench_writes_the_ratios_and_says_which_rows_miss(tmp_path, capsys):
    rows = run({'fake': (measure, 1.0)}, repetitions=5, quick=False)
    write({'fake': measured_here(rows['fake'], 7)}, tmp_path / 'out')
    written = json.loads((tmp_path / 'out' / 'benchmarks.json').read_text())['fake']['rows']
    assert [(row['name'], row['target']) for row in written] == [
        ('half', 0.9), ('slow', 2.5), ('told', None)]
    # To the rounding of sums of some tenths of a second.
    assert abs(written[0]['ratio'] - 0.5) < 1e-12
    text = (tmp_path / 'out' / 'benchmarks.md').read_text()
    assert '| slow | 3 s | 1 s | **3.00 s more** |' in text
    assert '- **slow**, 3.00 (target 2.5): It sleeps.' in text and '**half**' not in text
    # Without a target it is in the JSON alone, as are comparisons with ourselves that meet theirs.
    assert '| told |' not in text
    own = as_markdown({'effects': measured_here(rows['fake'])})
    assert '| slow |' in own and '| half |' not in own
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


def test_groups_that_were_measured_before_an_interruption_are_kept():
    def broken(settings: Settings) -> Iterator[Row]:
        yield from ()
        raise RuntimeError('interrupted')

    row, kept = Row('row', '1', '2', 0.5, (0.4, 0.6), 1.0, 3), []
    with pytest.raises(RuntimeError, match='interrupted'):
        run({'once': (lambda settings: iter([row]), 1.0), 'broken': (broken, 1.0)}, 1, True,
            lambda *group: kept.append(group))
    assert kept == [('once', [row])]


def test_ratio_is_the_median_of_those_of_each_turn():
    row = compare('name', np.array([1.0, 2.0, 9.0]), np.array([2.0, 2.0, 2.0]), target=1.0)
    assert (row.ratio, row.quartiles, row.repetitions, row.met) == (1.0, (0.75, 2.75), 3, True)


def test_row_of_a_contestant_on_several_processors_is_reported_as_not_judged(monkeypatch, capsys):
    monkeypatch.setattr('benchmarks.measurement._seconds', lambda run: run())
    row = race('busy', {'ours': lambda: (1.0, 1.0)}, {'peer': lambda: (2.0, 3.0)},
               Settings(3, True, print), target=1.0, scale=1.0, unit='s')
    assert 'contestant 1 keeps 1.5 processors busy' in capsys.readouterr().out
    assert row.met is None and row.ours == '1 s'
    assert as_table([row]).splitlines()[-1] == '| busy | 1 s | peer nan s | not judged |'
    assert '**busy**' not in as_markdown({'gradient': Group('here', [row])})


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


def test_race_is_between_the_least_medians_not_the_least_times():
    # One is fast once, and so is a peer; the first run of each warms up.
    ours = {'lucky': waiting(30.0, 1.0, 30.0), 'steady': waiting(10.0)}
    peers = {'lucky': waiting(50.0, 2.0, 50.0), 'steady': waiting(40.0)}
    row = race('race', ours, peers, Settings(5, True, print), target=1.0, scale=1.0, unit='s')
    assert (row.ours, row.peer) == ('10 s', 'steady 40 s') and abs(row.ratio - 0.25) < 1e-12


def test_times_of_a_peer_that_makes_several_results_are_shared():
    row = race('batch', {'ours': waiting(1.0)}, {'peer': waiting(16.0)}, Settings(3, True, print),
               target=None, scale=1.0, unit='s', copies=8)
    assert abs(row.ratio - 0.5) < 1e-12 and row.peer == 'peer 2 s'


def test_methods_are_chosen_by_work_however_busy_the_machine_is(monkeypatch):
    problem, duration, names = problem_of('exact_pendulum'), 20.0, ('stormer_verlet', 'gauss8')
    count = round(duration / 0.05)
    reference = path_run(problem, problem.simulation('gauss16', 0.05), 2, count // 2)()()
    steps = dict.fromkeys(names, 0.4 * 0.5 ** np.arange(9.0))
    first = accurate_ways(problem, steps, reference, duration, 1e-3)
    random = np.random.default_rng(0)
    monkeypatch.setattr('time.perf_counter', lambda: random.uniform(0.0, 1e3))
    again = accurate_ways(problem, steps, reference, duration, 1e-3)
    assert [(way.name, way.work) for way in again] == [(way.name, way.work) for way in first]
    assert [way.method.kind for way in first] == [*names]
    # The first steps that are accurate enough: twice as long ones are not.
    for way in first:
        longer = {way.method.kind: [2.0 * way.step_size]}
        assert accurate_ways(problem, longer, reference, duration, 1e-3) == []


def test_ways_of_the_least_work_are_timed():
    ways = [Way(Method(name), 0.1, work, lambda: print)
            for name, work in (('gauss8', 3.0), ('rk4', 1.0), ('gauss4', 4.0), ('gauss6', 2.0))]
    assert [*cheapest(ways)] == ['rk4, h = 0.1', 'gauss6, h = 0.1', 'gauss8, h = 0.1']


def test_first_good_setting_passes_over_those_that_fail():
    def error(setting: float) -> float:
        if setting == 3.0:
            raise StepFailure('no convergence', 0.0, 0.1, 1.0, 7)
        return setting

    assert first_good([3.0, 2.0, 1.0, 0.5], error, 1.0) == 1.0
    assert first_good([3.0, 2.0], error, 1.0) is None


def test_page_on_effects_has_the_measured_cost_of_each():
    rows = read_groups(DOCS / 'evidence' / 'benchmarks.json')['effects'].rows
    costs = {}
    for row in rows:
        if found := re.search(r' with (\w+): time per step', row.name):
            # '0.238 us' and 'without 0.101 us'.
            ours, peer = (float(side.split()[-2]) for side in (row.ours, row.peer))
            costs[found[1]] = f'{1e3 * (ours - peer):.0f}'
    assert set(costs) == {*EFFECTS, 'drives'}
    page = (DOCS / 'reference' / 'effects.md').read_text(encoding='utf-8')
    shown = dict(re.findall(r'^\| \[?`(\w+)`.* \| (\d+) \|$', page, re.MULTILINE))
    assert shown == costs


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize('group', GROUPS)
def test_group_of_rows_is_measured(group, tmp_path):
    module = DOCS / f'{GROUPS[group][0].replace(".", "/")}.py'
    for name in imported_by([module], nested=True):
        pytest.importorskip(name, reason=f'{name}, of requirements/bench.txt, is not installed')
    one = dict.fromkeys(['OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'], '1')
    flags = '--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1'
    path = os.pathsep.join([str(DOCS), *filter(None, [os.environ.get('PYTHONPATH')])])
    told = subprocess.run(
        [sys.executable, '-m', 'benchmarks.bench', '--quick', '--rows', group], cwd=ROOT,
        env=os.environ | one | {'PYTHONPATH': path, 'XLA_FLAGS': flags}, capture_output=True,
        text=True, check=False)
    assert told.returncode == 0, told.stdout + told.stderr
    assert '  = ' in told.stdout


def text_of(path: Path) -> str:
    """Return the Python of a file; of a notebook that of its cells."""
    text = path.read_text(encoding='utf-8')
    if path.suffix != '.ipynb':
        return text
    cells = [''.join(cell['source']) for cell in json.loads(text)['cells']
             if cell['cell_type'] == 'code']
    lines = '\n'.join(cell for cell in cells if not cell.startswith('%%')).splitlines()
    return '\n'.join(line for line in lines if line[:1] not in ('%', '!'))


@cache
def names_in(path: Path, nested: bool) -> frozenset[str]:
    """Return what a file imports, each with all of its dots; nested: in functions as well."""
    found, rest = set(), [ast.parse(text_of(path))]
    while rest:
        node = rest.pop()
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {node.module, *(f'{node.module}.{alias.name}' for alias in node.names)}
        elif isinstance(node, ast.If) and 'TYPE_CHECKING' in ast.unparse(node.test):
            continue
        elif nested or not isinstance(node, ast.FunctionDef):
            rest += ast.iter_child_nodes(node)
    return frozenset(found)


@cache
def files_of(module: str) -> list[Path]:
    """Return the files of a module of ours, none of one of others."""
    place = module.replace('.', '/')
    return [root / file for root in (DOCS, DOCS / 'tools', ROOT)
            for file in (f'{place}.py', f'{place}/__init__.py') if (root / file).is_file()]


def imported_by(starts: list[Path], nested: bool) -> dict[str, str]:
    """Return packages of others that files import, directly or through ours, and by which file."""
    found: dict[str, str] = {}
    rest, seen = [*starts], set()
    while rest:
        path = rest.pop()
        if path in seen:
            continue
        seen.add(path)
        ours = ROOT / 'hnn_vi_ros' in path.parents
        # What the package imports in a function is an extra, whose lack it answers.
        for name in names_in(path, nested and not ours):
            top = name.partition('.')[0]
            if top in OPTIONAL or top in sys.stdlib_module_names:
                continue
            rest += files_of(name)
            if not files_of(top):
                found[top] = str(path.relative_to(ROOT))
    return found


def missing(target: str, without: str = '') -> dict[str, str]:
    """Return the packages that a target imports and does not install, and where."""
    recipe = subprocess.run(['make', '-n', target], cwd=ROOT, capture_output=True, text=True,
                            check=True).stdout
    groups = re.search(r'requirements/make_venv(( \w+)+)', recipe)[1].split()
    files = [file for group in groups for file in FILES.get(group, [group])]
    there = brought(requirements_of(*files), '.'.join(platform.python_version_tuple()[:2]))
    there -= {without}
    pattern, nested = IMPORTING[target]
    starts = [path for glob in pattern for path in DOCS.glob(glob)]
    assert starts
    return {name: where for name, where in imported_by(starts, nested).items()
            if not {canonicalize_name(DISTRIBUTIONS.get(name, name)),
                    canonicalize_name(f'ros-{name}')} & there}


@pytest.mark.parametrize('target', IMPORTING)
def test_target_installs_what_its_modules_import(target):
    assert missing(target) == {}


def test_package_that_a_target_does_not_install_is_found():
    assert [*missing('bench', without='heyoka')] == ['heyoka']
    assert [*missing('accuracy', without='torchdiffeq')] == ['torchdiffeq']
