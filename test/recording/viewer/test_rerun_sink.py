# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What is written for the rerun viewer is read back, and closes as it should."""

from collections.abc import Callable, Iterator
from dataclasses import replace
import os
from pathlib import Path
import shutil
import socket
import subprocess
import sys
import time
from types import SimpleNamespace

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.hamiltonians import MECHANISMS
from hnn_vi_ros.hamiltonians.harmonic_oscillator import HarmonicOscillator
from hnn_vi_ros.recording import RerunSink, Sample
from hnn_vi_ros.recording.viewer import rerun_sink, rerun_stream
from hnn_vi_ros.recording.viewer.rerun_blueprint import series_of
from hnn_vi_ros.recording.viewer.rerun_stream import RerunStream
from messages import refused
import numpy as np
from PIL import Image
from ports import free_port
import pytest
from rerun.chunk import RrdReader
from rerun_reader import assert_verified, read, still_entities

STEP = 10_000_000
BOX = (np.array([[-1.5, 1.5]]), np.array([[-1.5, 1.5]]))
BANDS = '/state/q_band', '/state/p_band'
SERIES = ('/state/q', '/state/p', '/energy/H', '/energy/modified', '/energy/error')
DRAWN = ('/phase/x/trail', '/phase/x/state', '/world/spring', '/world/mass')


def oscillate(count: int) -> Iterator[Sample]:
    """Step the unit oscillator from (1, 0) by the variational Euler method."""
    h, q, p = STEP * 1e-9, 1.0, 0.0
    for n in range(count):
        energy = 0.5 * (q * q + p * p)
        yield Sample(n, n * STEP, np.array([q]), np.array([p]), np.array([q]), np.array([p]),
                     energy, energy + 0.5 * h * q * p, energy / 0.5 - 1.0)
        q = q + h * p
        p = p - h * q


def open_sink(target: Path | str | int, hamiltonian: HarmonicOscillator | None = None,
              **options) -> RerunSink:
    return RerunSink('test', target, hamiltonian or HarmonicOscillator(), np.array([1.0]),
                     np.array([0.0]), box=BOX, **options)


def record(target: Path | str | int, count: int,
           change: Callable[[Sample], Sample] = lambda sample: sample, **options) -> list[Sample]:
    sink, samples = open_sink(target, **options), [*map(change, oscillate(count))]
    for sample in samples:
        sink.write(sample)
    sink.close()
    return samples


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / 'recording.rrd'


@pytest.fixture(scope='module')
def drawn(tmp_path_factory) -> tuple[Path, list[Sample], dict]:
    """Record a mass on a spring once; give the file, the samples, and the entities in it."""
    path = tmp_path_factory.mktemp('drawn') / 'new' / 'folder' / 'recording.rrd'
    samples = record(path, 50, interval=0, mechanism=MECHANISMS['mass_spring'])
    return path, samples, read(path)


def test_recording_is_accepted_by_the_viewers_own_check(drawn):
    assert_verified(drawn[0])


def test_recording_holds_every_entity_and_a_blueprint(drawn):
    path, _, entities = drawn
    assert set(entities) == {*SERIES, *DRAWN}
    assert all(len(rows['step']) == 50 for rows in entities.values())
    assert {'/phase/x', '/phase/x/contours', '/phase/x/frame', '/phase/x/labels', '/world/wall',
            '/world/floor', *SERIES, *DRAWN} <= still_entities(path)
    # That of the beginning, and that with axes fitted to what there is.
    assert len(RrdReader(path).blueprints()) == 2


def test_frame_in_a_closed_recording_holds_the_path(path: Path):
    # Farther than its box: something drives it.
    record(path, 3, lambda sample: replace(
        sample, q=sample.q * 5.0, p=np.array([0.1 * sample.step])), interval=0)
    scales = [row for chunk in RrdReader(path).stream()
              if chunk.is_static and chunk.entity_path == '/phase/x'
              for row in chunk.to_record_batch().column('Transform3D:scale').to_pylist()]
    before, after = (1.0 / np.array(scale[0])[:2] for scale in scales)
    # Stored as float32.
    assert before == pytest.approx([1.5, -1.5], rel=1e-6)
    # p stayed within the box; q went to 5, beyond which a twentieth of its width is free.
    assert after == pytest.approx([0.5 * (5.0 + 0.15 + 1.5), -1.5], rel=1e-6)


def test_recording_without_a_mechanism_has_no_world(path: Path):
    record(path, 5)
    assert not any(entity.startswith('/world') for entity in {*read(path), *still_entities(path)})


def test_values_and_times_read_back_equal_those_written(drawn):
    _, samples, entities = drawn
    expected = ([s.q[0] for s in samples], [s.p[0] for s in samples],
                [s.energy for s in samples], [s.modified_energy for s in samples],
                [s.energy_error for s in samples])
    for entity, values in zip(SERIES, expected, strict=True):
        assert entities[entity]['Scalars:scalars'] == [[value] for value in values]
    for rows in entities.values():
        assert rows['step'] == [s.step for s in samples]
        assert rows['sim_time'] == [s.stamp for s in samples]
        assert rows['ros_time'] == [s.stamp for s in samples]


def test_recording_that_is_not_conservative_shows_work_and_no_modified_energy(path: Path):
    record(path, 3, lambda sample: replace(sample, work=-0.1 * sample.step), interval=0,
           conservative=False)
    entities = read(path)
    assert set(entities) == {*SERIES, *DRAWN[:2], '/energy/work'} - {'/energy/modified'}
    assert entities['/energy/work']['Scalars:scalars'] == [[0.0], [-0.1], [-0.2]]


def test_recording_shows_the_energy_by_cause_by_kind(path: Path):
    names = 'work/servo', 'stored/spring', 'stored/hamiltonian', 'error'
    samples = record(path, 3, lambda sample: replace(sample, causes=np.arange(4.0) * sample.step),
                     interval=0, causes=names)
    shown = read(path)
    assert '/energy_by_cause/heat' not in shown and len(samples) == 3
    assert shown['/energy_by_cause/work']['Scalars:scalars'] == [[0.0], [0.0], [0.0]]
    assert shown['/energy_by_cause/stored']['Scalars:scalars'] == [
        [s.causes[1], s.causes[2]] for s in samples]
    labels = {row.path: row.names for row in series_of(
        HarmonicOscillator(), True, False, False, causes=names)}
    assert labels['/energy_by_cause/stored'] == ['spring [J]', 'rest of H [J]']


def test_recording_shows_the_invariants_by_their_names(path: Path):
    oscillator = HarmonicOscillator()
    oscillator.invariants = {'twice_x': lambda q, p: 2.0 * q[0], 'p': lambda q, p: p[0]}
    samples = record(path, 3, hamiltonian=oscillator, interval=0)
    shown = read(path)['/invariants']['Scalars:scalars']
    assert shown == [[2.0 * s.q[0], s.p[0]] for s in samples]
    # That of the beginning, and that with axes fitted to what there is.
    assert len(RrdReader(path).blueprints()) == 2


@pytest.mark.parametrize('relative, conservative, expected', [
    (True, True, '(H - H0) / |H0|'), (True, False, '(H - H0 - W) / |H0|'),
    (False, True, 'H - H0 [J]'), (False, False, 'H - H0 - W [J]')])
@pytest.mark.parametrize('modified', [True, False])
def test_label_of_the_energy_error_says_what_it_is(relative, conservative, modified, expected):
    labels = {row.path: row.names for row in series_of(
        HarmonicOscillator(), relative, conservative, modified)}
    assert labels['/energy/error'] == [expected]
    assert ('/energy/work' in labels) is not conservative
    assert ('/energy/modified' in labels) is (conservative and modified)


def test_trail_joins_each_state_to_the_one_before(drawn):
    _, samples, entities = drawn
    # Positions are float32 in the viewer.
    states = np.array([[s.q[0], s.p[0]] for s in samples], dtype=np.float32)
    points = np.array(entities['/phase/x/state']['Points2D:positions'])[:, 0]
    segments = np.array(entities['/phase/x/trail']['LineStrips2D:strips'])[:, 0]
    np.testing.assert_array_equal(points, states)
    np.testing.assert_array_equal(segments[:, 1], states)
    np.testing.assert_array_equal(segments[1:, 0], states[:-1])


def test_mass_is_drawn_where_q_is(drawn):
    _, samples, entities = drawn
    centers = np.array(entities['/world/mass']['Boxes3D:centers'])[:, 0]
    np.testing.assert_array_equal(centers[:, 0], np.float32([s.q[0] for s in samples]))


def test_decimation_keeps_one_sample_an_interval_and_the_last(path: Path):
    record(path, 100, interval=4 * STEP)
    assert read(path)['/state/q']['step'] == [*range(0, 100, 4), 99]


def test_decimation_keeps_its_mean_rate_when_the_samples_do_not_fit(path: Path):
    record(path, 1001)
    # 30 Hz from 100 Hz over 10 s: samples 0 to 1000 give 301 rows, the last one included.
    assert len(read(path)['/state/q']['step']) == 301


def test_events_stand_at_the_newest_sample_and_before_the_first_at_the_initial_state(path: Path):
    """After a reset, or of a run that is resumed, that is not at zero."""
    sink = open_sink(path, begin=(5_000_000_000, 7))
    sink.event('reset')
    for sample in oscillate(12):
        sink.write(sample)
    sink.event('step failed', level='ERROR')
    sink.close()
    rows = read(path)['/events']
    # They are read back by their simulated time.
    names = 'sim_time', 'step', 'TextLog:text', 'TextLog:level'
    assert [*zip(*(rows[name] for name in names), strict=True)] == [
        (11 * STEP, 11, ['step failed'], ['ERROR']), (5_000_000_000, 7, ['reset'], ['INFO'])]


def test_timing_stands_at_the_newest_sample_and_nothing_unknown_is_shown(path: Path):
    sink = open_sink(path)
    sink.timing((1.0, 2.0), 1.0)
    for sample in oscillate(12):
        sink.write(sample)
        if sample.step in (0, 5, 11):
            sink.timing((2.0 + sample.step, 20.0), float('nan') if sample.step == 0 else 0.5)
    sink.close()
    entities = read(path)
    for entity, values in {'/timing/microseconds_per_step': [[7.0, 20.0], [13.0, 20.0]],
                           '/timing/real_time_factor': [[0.5], [0.5]]}.items():
        assert entities[entity]['Scalars:scalars'] == values
        assert entities[entity]['step'] == [5, 11]
        assert entity in still_entities(path)


def test_existing_file_is_refused_and_left_alone(path: Path):
    path.write_text('precious')
    with refused(RecordingError):
        open_sink(path)
    assert path.read_text() == 'precious'


def test_target_that_cannot_be_written_is_one_line(tmp_path: Path):
    (tmp_path / 'file').touch()
    with refused(RecordingError):
        open_sink(tmp_path / 'file' / 'recording.rrd')


@pytest.mark.parametrize('url', ['nonsense', 'http://127.0.0.1:1', 'rerun+http://127.0.0.1:x'])
def test_bad_url_is_refused(url: str):
    with pytest.raises(RecordingError):
        open_sink(url)


def test_viewer_that_is_not_there_is_refused_at_once(monkeypatch):
    # The SDK itself would try for five seconds.
    monkeypatch.setattr(rerun_stream, '_connect', lambda *_: pytest.fail('the SDK is asked'))
    with socket.socket() as reserved:
        reserved.bind(('127.0.0.1', 0))
        with pytest.raises(RecordingError, match='no rerun viewer listens'):
            open_sink(f'rerun+http://127.0.0.1:{reserved.getsockname()[1]}/proxy')


def test_port_that_is_taken_is_refused():
    with socket.socket() as taken:
        taken.bind(('', 0))
        taken.listen()
        with pytest.raises(RecordingError, match=str(taken.getsockname()[1])):
            open_sink(taken.getsockname()[1])


@pytest.fixture
def viewer() -> Iterator[tuple[str, subprocess.Popen]]:
    """Run a process that takes samples as a viewer does; give its URL and the process."""
    port = free_port()
    program = ('import rerun, sys, time; stream = rerun.RecordingStream("viewer"); '
               f'print(stream.serve_grpc(grpc_port={port}), flush=True); time.sleep(60)')
    process = subprocess.Popen([sys.executable, '-c', program], stdout=subprocess.PIPE, text=True)
    try:
        yield process.stdout.readline().strip(), process
    finally:
        process.kill()
        process.communicate()


def test_server_ends_with_a_killed_process():
    port = free_port()
    program = ('from hnn_vi_ros.recording.viewer.rerun_stream import RerunStream; import os; '
               f'stream = RerunStream("test", {port}); os.kill(os.getpid(), 9)')
    assert subprocess.run([sys.executable, '-c', program], check=False).returncode == -9
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        until = time.monotonic() + 60.0
        while True:
            try:
                probe.bind(('', port))
                break
            except OSError:
                assert time.monotonic() < until
                time.sleep(0.05)


def test_connected_viewer_takes_all_samples(viewer: tuple[str, subprocess.Popen]):
    record(viewer[0], 100)


def test_close_says_soon_that_the_viewer_is_gone(viewer: tuple[str, subprocess.Popen]):
    url, process = viewer
    sink = open_sink(url)
    process.kill()
    process.wait()
    for sample in oscillate(100):
        sink.write(sample)
    started = time.monotonic()
    with pytest.raises(RecordingError, match='lost'):
        sink.close()
    sink.close()
    # 0.8 s on an idle machine; the SDK itself would wait for ten.
    assert time.monotonic() - started < 8.0


def clock_of(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Return the wall time of sinks, which stands still."""
    clock = [0.0]
    monkeypatch.setattr(rerun_sink, 'time', SimpleNamespace(monotonic=lambda: clock[0]))
    return clock


def sizes_of(path: Path) -> list[int]:
    """Return how many rows of q each piece of a recording has."""
    return [chunk.num_rows for chunk in RrdReader(path).stream()
            if chunk.entity_path == '/state/q' and not chunk.is_static]


@pytest.mark.long
def test_file_of_an_hour_is_sent_in_few_pieces_and_none_waits_long(path, monkeypatch):
    """Each piece costs 20 kB of memory until the file is closed: these, 3.4 MB."""
    clock = clock_of(monkeypatch)
    sink = open_sink(path, interval=1)
    for n, sample in enumerate(oscillate(36_000)):
        clock[0] = 0.1 * n
        sink.write(replace(sample, stamp=n * 100_000_000))
    sink.close()
    sizes = sizes_of(path)
    assert sum(sizes) == 36_000
    # 10 in the first 5 s, ln(300 / 5) / 0.1 while they grow to half a minute, 110 more.
    assert len(sizes) <= 10 + 41 + 110 + 9
    assert max(sizes[:8]) <= 6
    assert max(sizes) <= 301


@pytest.mark.parametrize('call', ['event', 'timing'])
def test_what_comes_without_a_sample_is_sent_when_it_is_time_and_takes_the_rest_along(
        path, monkeypatch, call):
    clock = clock_of(monkeypatch)
    sink = open_sink(path, interval=1)
    for sample in oscillate(3):
        sink.write(sample)
    for due in (False, True):
        clock[0] = (1.1 if due else 0.5) * rerun_sink.GATHER_FILE
        sink.event('alarm') if call == 'event' else sink.timing((1.0, 2.0), 1.0)
        sink._stream.recording.flush()
        entity = {'event': '/events', 'timing': '/timing/real_time_factor'}[call]
        assert [len(read(path).get(name, {'step': []})['step'])
                for name in ('/state/q', entity)] == ([3, 2] if due else [0, 0])
    sink.close()


def test_samples_that_no_clock_holds_back_do_not_pile_up(path, monkeypatch):
    clock_of(monkeypatch)
    record(path, 3 * rerun_sink.MOST_PENDING, interval=1)
    assert sizes_of(path) == [rerun_sink.MOST_PENDING] * 3


def test_served_recording_listens_on_this_machine_only_until_it_is_closed():
    """A reset serves the next recording on the same port."""
    port = free_port()
    stream = RerunStream('test', port)
    socket.create_connection(('127.0.0.1', port)).close()
    # Loopback has more addresses; a server on all interfaces has them too.
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(('127.0.0.2', port))
    stream.close()
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind(('', port))


def test_blueprints_of_one_scene_have_the_same_paths(tmp_path):
    """The SDK keeps every path that it has seen for ever: 10 kB for a blueprint of new ones."""
    paths = []
    for number in range(2):
        record(tmp_path / f'{number}.rrd', 1)
        reader = RrdReader(tmp_path / f'{number}.rrd')
        paths.append({chunk.entity_path for entry in reader.blueprints()
                      for chunk in reader.stream(store=entry)})
    assert paths[0] == paths[1] and len(paths[0]) > 10


def test_closed_recording_takes_no_events_and_is_closed_twice_without_harm(path: Path):
    sink = open_sink(path)
    sink.close()
    sink.close()
    with refused(RecordingError):
        sink.event('too late')


@pytest.mark.parametrize('band', [True, False])
def test_bands_are_the_state_less_and_plus_its_spread_where_there_are_members(
        path: Path, band: bool):
    samples = record(path, 3, lambda sample: replace(
        sample, spread=np.array([0.25, 0.5]) * sample.step), interval=0, band=band)
    entities = read(path)
    if not band:
        assert not set(BANDS) & set(entities)
        return
    for entity, name, size in zip(BANDS, 'qp', (0.25, 0.5), strict=True):
        assert entities[entity]['Scalars:scalars'] == [
            [getattr(one, name)[0] - size * one.step, getattr(one, name)[0] + size * one.step]
            for one in samples]


@pytest.mark.skipif(shutil.which('xvfb-run') is None,
                    reason='needs xvfb-run and a software Vulkan driver (see .ci/run)')
def test_picture_is_drawn_by_the_viewer(tmp_path, path: Path):
    """On a virtual screen."""
    picture = tmp_path / 'picture.png'
    record(path, 500, mechanism=MECHANISMS['mass_spring'])
    subprocess.run(
        ['xvfb-run', '-a', '-s', '-screen 0 2800x1800x24', Path(sys.prefix) / 'bin' / 'rerun',
         path, '--window-size', '1400x900', '--screenshot-to', picture],
        env=os.environ | {'XDG_DATA_HOME': str(tmp_path), 'WGPU_BACKEND': 'vulkan'},
        capture_output=True, timeout=240, check=True)
    with Image.open(picture) as image:
        pixels = np.asarray(image.convert('RGB')).reshape(-1, 3).astype(int)
    # Orange marks the trail and the mass, green the modified energy: both are drawn.
    red, green, blue = pixels.T
    assert ((red > 200) & (abs(green - 150) < 40) & (blue < 100)).sum() > 500
    assert ((green > 180) & (red < 120) & (blue < 140)).sum() > 100
