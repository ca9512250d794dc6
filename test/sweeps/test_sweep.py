# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Sweeps: the same bytes however they are cut, stopped and gone on with; what columns hold."""

from collections import Counter
from contextlib import suppress
import json
import os
from pathlib import Path
import re
import secrets
import shutil
import signal
import subprocess
import sys
import tempfile
from textwrap import dedent, indent
import time

from hnn_vi_ros.errors import HnnViRosError, RecordingError
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import lyapunov_time, simulate, simulate_many
from hnn_vi_ros.sweeps import parquet, sweep, trajectories
from hnn_vi_ros.sweeps.folder import SweepFolder
from hnn_vi_ros.sweeps.plan import make_plan
from hnn_vi_ros.sweeps.running import main
from hnn_vi_ros.sweeps.trajectories import Runner
from messages import refused
import numpy as np
from ports import free_port
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scene_files import scene_text

DOCS = Path(__file__).resolve().parents[2] / 'docs' / 'how-to' / 'scale.md'
STATE = ['initial_state.q.angle', 'initial_state.p.angle']
BOX = {'kind': 'box', 'keys': STATE, 'low': [-2.0, -2.0], 'high': [2.0, 2.0]}
# Three lengths of 70 states each, and 64 trajectories in a shard: blocks have two lengths in them.
# Else workers of Ray get what all other processes of a busy machine leave.
AT_ONCE = 'RAY_worker_niceness', '0'
LENGTHS = {'scene': 'exact_pendulum', 'duration': 0.2, 'shard_size': 64, 'vary': [
    {'kind': 'values', 'key': 'hamiltonian.length', 'values': [0.5, 1.0, 2.0]},
    BOX | {'count': 70}]}
COMMAND = [sys.executable, '-c',
           'import sys; sys.argv[0] = "sweep"; from hnn_vi_ros.cli import sweep; sweep()']
EVENTS = scene_text('pendulum', integrator='variational_euler', more=(
    'events: [{when: angle = 0}, {when: angle = -0.5, then: stop}]\n'))


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def table_of(folder: Path) -> pa.Table:
    return pa.concat_tables([pq.read_table(path) for path in sorted(folder.glob('part-*'))])


def shards(folder: Path) -> dict[str, bytes]:
    """Return the contents but for the record."""
    return {name: data for name, data in contents(folder).items() if name != 'sweep.json'}


def write(path: Path, definition: dict) -> str:
    path.write_text(json.dumps(definition))
    return str(path)


def reducing(folder: Path, name: str, body: str, columns: list[str],
             grid: tuple[float, float, int], **more: object) -> Path:
    """Write a sweep over initial angles with a reduction of the user's own; return its file."""
    (folder / f'{name}.py').write_text(
        'import ctypes, os, pathlib, signal, time\n'
        f'def reduce(path):\n{indent(dedent(body), 4 * " ")}\n')
    low, high, count = grid
    path = folder / 'a.yaml'
    path.write_text(json.dumps({'scene': 'exact_pendulum', 'duration': 0.2, 'vary': [
        {'kind': 'grid', 'keys': ['initial_state.q.0'], 'low': [low], 'high': [high],
         'counts': [count]}],
        'reduction': {'function': f'{name}:reduce', 'columns': columns}, **more}))
    return path


@pytest.fixture(scope='module')
def whole(tmp_path_factory):
    """Return the folder of a sweep that was made in one go."""
    return sweep(LENGTHS, tmp_path_factory.mktemp('sweep') / 'whole')


def test_shards_in_any_order_by_one_runner_are_the_same(whole):
    assert len(contents(whole)) == 5
    plan = make_plan(LENGTHS)
    runner = Runner(plan)
    for shard in (2, 0, 3, 0, 1):
        made = parquet.write_shard(plan, shard, runner.shard(shard))
        assert made == (whole / f'part-{shard:06d}.parquet').read_bytes()


@pytest.mark.filterwarnings('ignore::hnn_vi_ros.errors.AlarmWarning')
def test_rows_are_the_trajectories_of_their_values(whole):
    table = table_of(whole)
    assert table['index'].to_pylist() == list(range(210))
    assert table['failure'].null_count == 210
    scene = load_scene('exact_pendulum')
    for row in table.take([0, 31, 32, 69, 70, 139, 140, 209]).to_pylist():
        length = [0.5, 1.0, 2.0][row['index'] // 70]
        assert row['hamiltonian.length'] == length
        found = simulate(scene.changed({'hamiltonian': {
            **scene.hamiltonian.model_dump(), 'length': length}}), 0.2,
            initial_state=([row[STATE[0]]], [row[STATE[1]]]))
        # Both solve eq. (6) to 8 eps in each of 20 steps, which a pendulum stretches little.
        tolerance = 1e3 * np.finfo(float).eps
        assert row['t'] == found.t[-1]
        assert row['q_angle'] == pytest.approx(found.q[-1, 0], abs=tolerance)
        assert row['p_angle'] == pytest.approx(found.p[-1, 0], abs=tolerance)
        assert row['energy'] == pytest.approx(found.energy[-1], abs=1e2 * tolerance)


@pytest.mark.long
def test_columns_of_what_turns_are_those_of_its_attitude_and_momentum(tmp_path):
    folder = sweep({'scene': 'heavy_top', 'duration': 0.05, 'vary': [
        {'kind': 'values', 'key': 'initial_state.p.attitude_rz', 'values': [2.0, 6.0]}]},
        tmp_path / 'tops')
    table = table_of(folder)
    names = [name for name in table.column_names if name[:2] in ('q_', 'p_')]
    assert names == [f'q_attitude_q{axis}' for axis in 'xyzw'] + [
        f'p_attitude_r{axis}' for axis in 'xyz']
    q = load_scene('heavy_top').initial_state.q
    many = simulate_many('heavy_top', [q, q], [[0.0, 0.0, 2.0], [0.0, 0.0, 6.0]], 0.05, threads=1)
    for name, expected in zip(names, np.hstack([many.q[-1], many.p[-1]]).T, strict=True):
        assert table[name].to_numpy().tolist() == expected.tolist()


def test_axes_are_the_same_at_any_places():
    for axis in (BOX, BOX | {'kind': 'sobol'}):
        plan = make_plan(LENGTHS | {'seed': 3, 'vary': [
            LENGTHS['vary'][0], axis | {'count': 100}]})
        columns = plan.values(range(300))
        for part in (range(1), range(31, 65), range(95, 207), range(299, 300)):
            assert plan.values(part) == [column[part.start:part.stop] for column in columns]
        # Not the same twice, in the box, and other ones by another seed.
        states = list(zip(*columns[1:], strict=True))
        assert len(set(states)) == 100 and states[:100] == states[100:200]
        assert np.abs(states).max() <= 2.0
        other = make_plan(LENGTHS | {'seed': 4, 'vary': [axis | {'count': 100}]})
        assert not set(columns[1]) & set(other.values(range(100))[0])
    # Sobol's points are one in each cell of a partition, which drawn ones are not.
    plan = make_plan({**LENGTHS, 'vary': [BOX | {'kind': 'sobol', 'count': 64}]})
    cells = np.floor((np.array(plan.values(range(64))) + 2.0) * 2.0).astype(int)
    assert set(Counter(map(tuple, cells.T)).values()) == {1}


def test_grid_and_file_and_coordinates_by_name(tmp_path):
    (tmp_path / 'states.csv').write_text(f'{STATE[0]}, {STATE[1]}\n0.5,1\n-1,2e-1\n')
    (tmp_path / 'a.yaml').write_text(
        'scene: exact_pendulum\nduration: 0.1\nvary:\n- {kind: grid, keys: [hamiltonian.mass, '
        'hamiltonian.length], low: [1, 1], high: [2, 3], counts: [2, 3]}\n'
        '- {kind: file, path: states.csv}\n')
    plan = make_plan(tmp_path / 'a.yaml')
    assert plan.count == 12
    assert list(zip(*plan.values(range(3, 8)), strict=True)) == [
        (1.0, 2.0, -1.0, 0.2), (1.0, 3.0, 0.5, 1.0), (1.0, 3.0, -1.0, 0.2), (2.0, 1.0, 0.5, 1.0),
        (2.0, 1.0, -1.0, 0.2)]


def test_each_repeat_has_noise_of_its_own_by_index(tmp_path):
    scene = 'exact_brownian_oscillator'
    definition = {'scene': scene, 'duration': 0.1, 'vary': [
        {'kind': 'repeats', 'count': 40, 'key': 'effects.0.seed'}]}
    table = table_of(sweep(definition, tmp_path / 'a'))
    assert len(set(table['q_x'].to_pylist())) == 40
    assert len(set(table['effects.0.seed'].to_pylist())) == 40
    few = table_of(sweep(definition | {'vary': [{'kind': 'repeats', 'count': 40}]},
                         tmp_path / 'b'))
    start = load_scene(scene).initial_state
    many = simulate_many(scene, [start.q] * 40, [start.p] * 40, 0.1, threads=1)
    assert np.array_equal(np.array(few['q_x']), many.q[-1, :, 0])


def test_samples_are_rows_of_many_trajectories_bit_by_bit_and_shards_stay_small(
        tmp_path, monkeypatch):
    monkeypatch.setattr('hnn_vi_ros.sweeps.plan._MAX_SHARD_ROWS', 500)
    definition = {'scene': 'exact_pendulum', 'duration': 0.2, 'every': 4, 'keep': 'samples',
                  'vary': [BOX | {'count': 200}]}
    folder = sweep(definition, tmp_path / 'out')
    groups = []
    for path in sorted(folder.glob('part-*')):
        file = pq.ParquetFile(path)
        assert file.num_row_groups == 1
        groups.append(file.metadata.num_rows)
    # A whole number of blocks of 32, of 6 samples each.
    assert groups == [96 * 6, 96 * 6, 8 * 6] and groups[0] <= 500 + 32 * 6
    table = table_of(folder)
    q, p = (np.array(table[key])[::6, None] for key in STATE)
    many = simulate_many('exact_pendulum', q, p, 0.2, samples=5, threads=1)
    for column, values in (('q_angle', many.q[:, :, 0]), ('energy', many.energy)):
        assert np.array_equal(np.array(table[column]).reshape(200, 6).T, values)
    assert np.array_equal(np.array(table['t'])[:6], many.t)


def test_only_one_shard_and_one_block_are_held_at_a_time(tmp_path, monkeypatch):
    held, shard = [], Runner.shard

    def counted(self, number):
        for block in shard(self, number):
            held.append((number, sum(len(part.indices) for part in block)))
            yield block
    monkeypatch.setattr(Runner, 'shard', counted)
    sweep(LENGTHS, tmp_path / 'out')
    # 210 trajectories: blocks of 32, in shards of 64, of which one ends before the next begins.
    assert held == [(k, 32) for k in (0, 0, 1, 1, 2, 2)] + [(3, 18)]


@pytest.mark.filterwarnings('ignore::hnn_vi_ros.errors.AlarmWarning')
def test_statistics_are_those_of_the_samples(tmp_path):
    definition = {'scene': 'pendulum', 'duration': 1.0, 'every': 5, 'vary': [
        BOX | {'low': [-3.0, -8.0], 'high': [3.0, 8.0], 'count': 33}],
        'statistics': ['energy_band', 'out_of_box_time', 'path_error']}
    table = table_of(sweep(definition, tmp_path / 'out'))
    q, p = (np.array(table[key])[:, None] for key in STATE)
    many = simulate_many('pendulum', q, p, 1.0, samples=20, threads=1)
    assert np.array_equal(np.array(table['energy_band']),
                          many.energy.max(axis=0) - many.energy.min(axis=0))
    assert np.array(table['path_error']) == pytest.approx(
        [error.largest for error in many.path_error], rel=1e-9)
    (q_low, q_high), (p_low, p_high) = (
        half[0] for half in load_scene('pendulum').create_hamiltonian().box)
    outside = (many.q < q_low) | (many.q > q_high) | (many.p < p_low) | (many.p > p_high)
    expected = 0.05 * outside[1:, :, 0].sum(axis=0)
    assert np.array(table['out_of_box_time']) == pytest.approx(expected, abs=1e-12)
    assert 0 < np.count_nonzero(expected) < 33
    alarmed = [any('box' in kind for kind in kinds) for kinds in table['alarms'].to_pylist()]
    assert alarmed == list(outside.any(axis=(0, 2)))


def test_event_times_are_those_of_single_runs(tmp_path):
    path = tmp_path / 'scene.yaml'
    path.write_text(EVENTS)
    definition = {'scene': str(path), 'duration': 1.0, 'statistics': ['event_times'],
                  'vary': [{'kind': 'values', 'key': 'initial_state.q', 'values': [[0.3], [1.0]]}]}
    for row in table_of(sweep(definition, tmp_path / 'out')).to_pylist():
        q = json.loads(row['initial_state.q'])
        found = simulate(path, 1.0, initial_state=(q, [0.0]))
        assert row['event_times'] == [event.t for event in found.events] != []
        assert row['events'] == [event.when for event in found.events]
        assert row['t'] == found.t[-1] and (row['t'] < 1.0) == (q == [1.0])
        assert row['q_angle'] == found.q[-1, 0]


@pytest.mark.long
def test_lyapunov_time_is_that_of_the_scene(tmp_path):
    definition = {'scene': 'exact_double_pendulum', 'duration': 20.48, 'statistics': [
        'lyapunov_time'], 'vary': [{'kind': 'values', 'key': 'initial_state.q',
                                    'values': [[2.0, 2.5]]}]}
    scene = load_scene('exact_double_pendulum').with_overrides(
        initial_state={'q': [2.0, 2.5], 'p': [0.0, 0.0]})
    table = table_of(sweep(definition, tmp_path / 'out'))
    assert table['lyapunov_time'].to_pylist() == [lyapunov_time(scene, 20.48)]
    assert 0.0 < table['lyapunov_time'][0].as_py() < 20.48


def test_reduction_of_the_users(tmp_path, monkeypatch):
    path = reducing(tmp_path, 'mine_of_sweeps', """\
        if path.q[0, 0] > 1.0: raise RuntimeError("too far")
        return {"mean": path.q.mean(), "count": len(path.t)}""",
                    ['mean', 'count'], (0.0, 2.0, 3), every=4)
    monkeypatch.setattr(sys, 'path', list(sys.path))
    first, second, third = table_of(sweep(path, tmp_path / 'out')).to_pylist()
    found = simulate_many('exact_pendulum', [[0.0], [1.0], [2.0]], [[0.0]] * 3, 0.2, samples=5,
                          threads=1)
    assert (first['mean'], first['count']) == (0.0, 6.0)
    assert second['mean'] == pytest.approx(found.q[:, 1].mean(), rel=1e-13)
    assert third['failure'] == 'mine_of_sweeps:reduce: RuntimeError: too far'
    assert third['mean'] is None and third['q_angle'] is None


@pytest.mark.parametrize(('line', 'failure'), [
    ('raise SystemExit(0)', 'SystemExit: 0'),
    ('path.q[:] = 0.0', 'ValueError: assignment destination is read-only')])
def test_reduction_neither_ends_a_sweep_nor_changes_what_is_kept(
        tmp_path, monkeypatch, line, failure):
    path = reducing(tmp_path, 'rude_to_sweeps',
                    f'if path.q[0, 0] > 0.5: {line}\nreturn {{"one": 1.0}}', ['one'],
                    (0.25, 1.0, 2))
    monkeypatch.setattr(sys, 'path', list(sys.path))
    monkeypatch.delitem(sys.modules, 'rude_to_sweeps', raising=False)
    first, second = table_of(sweep(path, tmp_path / 'out')).to_pylist()
    assert (first['one'], first['failure']) == (1.0, None)
    assert second['failure'] == f'rude_to_sweeps:reduce: {failure}'


def test_failure_of_one_trajectory_is_a_row(tmp_path, capsys):
    # Of a length below zero there is no pendulum; at such a momentum no angle stays finite.
    (tmp_path / 'a.yaml').write_text(
        'scene: exact_pendulum\nduration: 2.0\nvary:\n'
        '- {kind: values, key: hamiltonian.length, values: [1.0, -1.0, "long", 0.5]}\n'
        '- {kind: grid, keys: [initial_state.p.0], low: [0], high: [1.7e308], counts: [2]}\n')
    assert main([str(tmp_path / 'a.yaml'), '--out', str(tmp_path / 'out'), '--jobs', '1']) == 0
    rows = table_of(tmp_path / 'out').to_pylist()
    assert [row['hamiltonian.length'] for row in rows] == [
        '1.0', '1.0', '-1.0', '-1.0', 'long', 'long', '0.5', '0.5']
    assert [row['failure'] is None for row in rows] == [True, False] + [False] * 4 + [True, False]
    assert all('length' in row['failure'] and row['q_angle'] is None for row in rows[2:6])
    assert '6 failed (see the column failure)' in capsys.readouterr().out


def test_metadata_and_record_tell_what_was_run(whole):
    record = json.loads((whole / 'sweep.json').read_text())
    assert record['trajectories'] == 210 and record['shards'] == 4
    metadata = pq.read_metadata(whole / 'part-000001.parquet').metadata
    assert metadata[b'hnn_vi_ros.digest'].decode() == record['digest']
    assert json.loads(metadata[b'hnn_vi_ros.scene']) == record['scene']
    assert json.loads(metadata[b'hnn_vi_ros.versions'])['numpy'] == np.__version__


def test_what_is_there_is_kept_and_what_is_damaged_is_made_anew(whole, tmp_path, monkeypatch):
    out = tmp_path / 'out'
    sweep(LENGTHS, out)
    (out / 'part-000001.parquet').write_bytes((whole / 'part-000001.parquet').read_bytes()[:-9])
    (out / 'part-000002.parquet').write_bytes((whole / 'part-000000.parquet').read_bytes())
    (out / '.part-000002.parquet.elsewhere.1').write_bytes(b'half')
    made = []
    shard = trajectories.Runner.shard
    monkeypatch.setattr('hnn_vi_ros.sweeps.trajectories.Runner.shard', lambda self, number: (
        made.append(number), shard(self, number))[1])
    sweep(LENGTHS, out)
    assert made == [1, 2] and contents(out) == contents(whole)


@pytest.mark.parametrize('jobs', [pytest.param(1, marks=pytest.mark.long), 2])
def test_killed_sweep_goes_on_where_it_stopped(whole, tmp_path, jobs):
    path, out = write(tmp_path / 'a.yaml', LENGTHS), tmp_path / 'out'
    # Slow enough to be killed in the middle.
    code = ('import sys, time; from hnn_vi_ros.sweeps import folder; '
            'put = folder.SweepFolder.put; '
            'folder.SweepFolder.put = lambda self, *a: (time.sleep(1.0), put(self, *a)); '
            'sys.argv[0] = "sweep"; from hnn_vi_ros.cli import sweep; sweep()')
    with subprocess.Popen([sys.executable, '-c', code, path, '--out', str(out), '--jobs',
                           str(jobs)], stdout=subprocess.DEVNULL, start_new_session=True) as run:
        deadline = time.monotonic() + 120.0
        while not list(out.glob('part-*')) and time.monotonic() < deadline:
            time.sleep(0.02)
        # Its processes as well: one that is left goes on with the shard that it has begun.
        os.killpg(run.pid, signal.SIGKILL)
    there = contents(out)
    assert 'part-000000.parquet' in there or 'part-000001.parquet' in there
    # What half a file would be left as; workers of their own may have come to the whole one.
    (out / 'part-000003.parquet').unlink(missing_ok=True)
    (out / '.part-000003.parquet.elsewhere.1').write_bytes(b'half')
    sweep(LENGTHS, out)
    assert shards(out) == shards(whole)


@pytest.fixture(scope='module')
def deadly(tmp_path_factory):
    """Return a sweep that kills a process at its 100th trajectory, once, and its folder."""
    folder = tmp_path_factory.mktemp('deadly')
    reducing(folder, 'deadly_to_sweeps', """\
        mark = pathlib.Path(__file__).with_name("done")
        if path.q[0, 0] == 1.0 and not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return {"mean": path.q.mean()}""", ['mean'], (0.0, 1.5, 151), every=5, shard_size=32)
    (folder / 'done').touch()
    before = list(sys.path)
    sweep(folder / 'a.yaml', folder / 'whole')
    sys.path[:] = before
    return folder


@pytest.mark.parametrize('way', [
    {'jobs': 2}, pytest.param({'ray': 'local'}, marks=pytest.mark.long)], ids=['processes', 'ray'])
def test_sweep_whose_worker_is_killed_is_completed(deadly, tmp_path, monkeypatch, way):
    if 'ray' in way:
        pytest.importorskip('ray', reason='ray is not installed')
        monkeypatch.setenv(*AT_ONCE)
    (deadly / 'done').unlink(missing_ok=True)
    if 'jobs' in way:
        # Those of Ray are replaced.
        with pytest.raises(HnnViRosError, match='a worker process was killed'):
            sweep(deadly / 'a.yaml', tmp_path / 'out', **way)
    sweep(deadly / 'a.yaml', tmp_path / 'out', **way)
    assert (deadly / 'done').exists()
    assert contents(tmp_path / 'out') == contents(deadly / 'whole')
    assert len(contents(tmp_path / 'out')) == 6


@pytest.mark.parametrize('jobs', [1, pytest.param(2, marks=pytest.mark.long)])
def test_first_interrupt_ends_a_sweep_whose_reduction_hangs(tmp_path, jobs):
    # With several processes in C, where nothing else of Python runs. One long sleep would miss an
    # interrupt that comes just before its system call.
    hang = 'while True: time.sleep(0.05)' if jobs == 1 else 'ctypes.PyDLL(None).pause()'
    path = reducing(
        tmp_path, 'hangs_in_sweeps',
        f'pathlib.Path(__file__).with_name(f"pid{{os.getpid()}}").touch()\n{hang}', ['mean'],
        (0.0, 1.5, 64), shard_size=32)
    with subprocess.Popen(
            [*COMMAND, str(path), '--out', str(tmp_path / 'out'), '--jobs', str(jobs)],
            stderr=subprocess.PIPE, text=True, start_new_session=True) as run:
        try:
            while len(workers := list(tmp_path.glob('pid*'))) < jobs:
                assert run.poll() is None
                time.sleep(0.02)
            # As a terminal does: to all of its processes.
            os.killpg(run.pid, signal.SIGINT)
            # Without an end of its own it would last for as long as the reduction, which is ever.
            _, error = run.communicate(timeout=60.0)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(run.pid, signal.SIGKILL)
    assert run.returncode == 130 and 'Traceback' not in error
    assert 'stopped; complete shards are in' in error
    for worker in workers:
        assert not Path('/proc', worker.name.removeprefix('pid'), 'exe').exists()


@pytest.fixture
def cluster(monkeypatch):
    """Return the address of a Ray cluster of two workers, begun as docs/how-to/scale.md says."""
    pytest.importorskip('ray', reason='ray is not installed')
    command = re.search(r'^ray (start --head [^#\n]*)', DOCS.read_text(), re.MULTILINE)[1].split()
    address = f'127.0.0.1:{free_port()}'
    monkeypatch.setenv(*AT_ONCE)
    # With a token of its own; Ray's default is the one that an earlier cluster may have left.
    monkeypatch.setenv('RAY_AUTH_MODE', 'token')
    monkeypatch.setenv('RAY_AUTH_TOKEN', secrets.token_hex(32))
    # In a short folder of its own, as its sockets ask for, and in the foreground, so that it ends
    # with the process that is ended here: `ray stop` ends all that there are on a machine.
    with tempfile.TemporaryDirectory(prefix='ray', ignore_cleanup_errors=True) as folder, \
            subprocess.Popen(
                [sys.executable, '-m', 'ray.scripts.scripts', *command, '--block', '--temp-dir',
                 folder, '--node-ip-address', '127.0.0.1', '--port', address.partition(':')[2],
                 '--include-dashboard', 'false'], stdout=subprocess.PIPE, text=True) as head:
        try:
            assert any('Ray runtime started' in line for line in head.stdout)
            yield address
        finally:
            head.terminate()
            head.communicate(timeout=60.0)


@pytest.mark.long
def test_cluster_begun_by_the_documented_command_makes_the_same_bytes(deadly, tmp_path, cluster):
    (deadly / 'done').unlink(missing_ok=True)
    run = subprocess.run(
        [*COMMAND, str(deadly / 'a.yaml'), '--out', str(tmp_path / 'out'), '--ray', cluster],
        capture_output=True, text=True, check=False, timeout=300.0)
    assert run.returncode == 0, run.stderr
    # A worker was killed on the way.
    assert (deadly / 'done').exists()
    assert contents(tmp_path / 'out') == contents(deadly / 'whole')


@pytest.mark.long
def test_ray_cluster_that_is_not_there_is_one_line(tmp_path):
    pytest.importorskip('ray', reason='ray is not installed')
    with pytest.raises(HnnViRosError, match='--ray auto: .*start a cluster with: ray start'):
        sweep(LENGTHS, tmp_path / 'out', ray='auto')


def test_sweep_on_a_device_is_recorded_and_continued_to_the_same_bytes(tmp_path):
    torch = pytest.importorskip('torch', reason='torch is not installed')
    definition = {'scene': 'pendulum', 'duration': 0.2, 'every': 4, 'shard_size': 40,
                  'statistics': ['energy_band'], 'vary': [BOX | {'count': 100}]}
    whole = sweep(definition, tmp_path / 'whole', device='cpu')
    before = contents(whole)
    (whole / 'part-000001.parquet').unlink()
    assert contents(sweep(definition, whole, device='cpu')) == before and len(before) == 4
    assert json.loads((whole / 'sweep.json').read_text())['device'] == {
        'kind': 'cpu', 'torch': torch.__version__}
    compiled = sweep(definition, tmp_path / 'compiled')
    with pytest.raises(RecordingError,
                       match='contains another sweep: device is null there, {"kind"'):
        sweep(definition, compiled, device='cpu')
    found, plain = (table_of(folder).drop_columns(['energy_band', 'energy', 'alarms', 'failure'])
                    for folder in (whole, compiled))
    for name in found.column_names:
        # Of 20 steps, 1e-13 each.
        assert np.abs(np.array(found[name]) - np.array(plain[name])).max() <= 20e-13


@pytest.mark.long
@pytest.mark.filterwarnings('ignore')
def test_failure_of_one_trajectory_on_a_device_is_a_row(tmp_path):
    pytest.importorskip('torch', reason='torch is not installed')
    vary = [{'kind': 'values', 'key': 'step_size', 'values': [0.01, 0.02, 0.03]},
            {'kind': 'values', 'key': 'initial_state.p', 'values': [[0.0], [1.0]]}]
    rows = table_of(sweep({'scene': 'pendulum', 'duration': 0.2, 'vary': vary}, tmp_path / 'out',
                          device='cpu')).to_pylist()
    assert [row['failure'] is None for row in rows] == [True] * 4 + [False] * 2
    assert rows[5]['failure'].startswith(
        'duration = 0.2 s is not a whole number of steps of 0.03 s')
    with pytest.raises(HnnViRosError, match='not made of perceptrons'):
        sweep(LENGTHS, tmp_path / 'exact', device='cpu')


def test_another_sweep_and_another_folder_are_refused(whole, tmp_path):
    for name, text in (('notes', ''), ('sweep.json', '[')):
        (tmp_path / f'of {name}').mkdir()
        (tmp_path / f'of {name}' / name).write_text(text)
    more = LENGTHS | {'vary': [LENGTHS['vary'][0], BOX | {'count': 71}]}
    for definition, folder in (
            (LENGTHS | {'duration': 0.3}, whole), (more, whole), (LENGTHS, tmp_path / 'of notes'),
            (LENGTHS, tmp_path / 'of sweep.json'), (LENGTHS, Path('/dev/null/x')),
            (LENGTHS, Path('/proc/x'))):
        with refused(RecordingError):
            sweep(definition, folder)


def test_folder_counts_what_failed_and_what_is_missing(whole):
    plan = make_plan(LENGTHS)
    folder = SweepFolder(whole)
    *rest, alarms = folder.survey(plan)
    # In four steps of order one some paths are off.
    assert rest == [[], [], 0] and alarms.keys() == {'path not resolved'}
    assert SweepFolder(whole / 'none').survey(plan).missing == [0, 1, 2, 3]


@pytest.mark.parametrize('count', [30, pytest.param(300, marks=pytest.mark.long)])
def test_every_change_of_a_shard_is_found_by_name(whole, tmp_path, count):
    plan, out = make_plan(LENGTHS), tmp_path / 'out'
    shutil.copytree(whole, out)
    folder, rng = SweepFolder(out), np.random.default_rng(3)
    file, content = folder.file(1), folder.file(1).read_bytes()
    # Those of the footer and of the seal, which no checksum of pages covers, as often as data.
    places = [*rng.integers(len(content), size=count),
              *range(len(content) - 300, len(content), 300 // count)]
    for place in places:
        damaged = bytearray(content)
        damaged[place] ^= 1 << int(rng.integers(8))
        file.write_bytes(damaged)
        missing, told = folder.survey(plan)[:2]
        assert missing == [1] and len(told) == 1, place
        assert told[0].startswith(f'{file}: ') and '\n' not in told[0]
    for cut in (0, 4, 7, 8, 100, len(content) // 2, len(content) - 1):
        file.write_bytes(content[:cut])
        assert folder.survey(plan).missing == [1], cut
    with pytest.warns(UserWarning,
                      match='part-000001.parquet: is damaged .*; it is computed again'):
        sweep(LENGTHS, out)
    assert contents(out) == contents(whole)


def test_shards_that_were_swapped_or_are_of_another_sweep_are_found(whole, tmp_path, capsys):
    path = write(tmp_path / 'a.yaml', LENGTHS)
    out, other = tmp_path / 'out', sweep(LENGTHS | {'seed': 7}, tmp_path / 'other')
    shutil.copytree(whole, out)
    for target, source in (('000000', whole / 'part-000002.parquet'),
                           ('000002', whole / 'part-000000.parquet'),
                           ('000003', other / 'part-000003.parquet')):
        (out / f'part-{target}.parquet').write_bytes(source.read_bytes())
    assert main([path, '--out', str(out), '--jobs', '1']) == 0
    told, lines = capsys.readouterr(), ['000000.parquet: is shard 2 of', '000002.parquet: is '
                                        'shard 0 of', '000003.parquet: belongs to another sweep']
    for line in lines:
        assert f'part-{line}' in told.err
    assert '4 of 4 shards of 210 trajectories, none failed' in told.out
    assert shards(out) == shards(whole)


def test_summary_counts_trajectories_with_alarms(tmp_path, capsys):
    path = write(tmp_path / 'a.yaml', {'scene': 'pendulum', 'duration': 0.2, 'vary': [
        {'kind': 'values', 'key': 'initial_state.p.angle', 'values': [0.0, 0.1, 40.0]}]})
    assert main([path, '--out', str(tmp_path / 'out')]) == 0
    assert 'none failed, 1 with alarm: out of the training box; ' in capsys.readouterr().out


@pytest.mark.parametrize(('old', 'new', 'message'), [
    ('"trajectories": 210', '"trajectories": 211', 'trajectories is 211 there, 210 here'),
    ('"step_size": 0.01', '"step_size": 0.02', 'scene.step_size is 0.02 there'),
    ('"digest": "', '"digest": "0', '[^.]digest is "0[0-9a-f]{64}" there, "[0-9a-f]{64}" here'),
    ('{', '', 'sweep.json: .*; restore it, remove it if'),
    ('"scene": {', '"scene": [{', 'restore it, remove it')])
def test_record_that_was_edited_is_told(whole, tmp_path, old, new, message):
    shutil.copytree(whole, out := tmp_path / 'out')
    text = (out / 'sweep.json').read_text()
    assert old in text
    (out / 'sweep.json').write_text(text.replace(old, new, 1))
    before = contents(out)
    with pytest.raises(RecordingError, match=message):
        sweep(LENGTHS, out)
    assert contents(out) == before
    # As it was but for its layout.
    (out / 'sweep.json').write_text(json.dumps(json.loads(text)))
    sweep(LENGTHS, out)
