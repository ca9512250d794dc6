# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Files of others that claim, or unpack to, more than memory holds: one line, before the work."""

from collections import Counter
from collections.abc import Callable
import json
from pathlib import Path
import re
import struct
import zipfile

from hnn_vi_ros.files import array_names, LONGEST_LINE, parse_json, text_lines, unpack_arrays
from hnn_vi_ros.files.limits import MOST_VALUES
import numpy as np
import pytest
from python_process import run_code

# What a refused file may take besides what is there before [MiB].
MOST = 200
# Of a process that calls a reader: what it says, and by how much its memory grew [MiB].
CHILD = """\
import sys
from pathlib import Path
from hnn_vi_ros.errors import HnnViRosError
{prepare}
def peak():
    text = Path('/proc/self/status').read_text()
    return int(text.partition('VmHWM:')[2].split()[0]) / 1024
path = Path(sys.argv[1])
Path('/proc/self/clear_refs').write_text('5')
before = peak()
try:
    {call}
    print('read')
except HnnViRosError as problem:
    print(problem)
print(peak() - before, file=sys.stderr)
"""
LOG = """\
from hnn_vi_ros.learning.data.text import MeasuredData, read_text
data = MeasuredData(kind='measured', columns=['t', 'q', 'p', 'v', 'f'], time='t', q=['q'],
                    p=['p'], dq_dt=['v'], dp_dt=['f'])
"""
AXIS = """\
from hnn_vi_ros.sweeps.axes import file_axis
"""
STATE = """\
from hnn_vi_ros.run.saved_state import restore_state
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation.construction import build
simulation = build(load_scene('exact_pendulum'))
"""
READERS = {
    'arrays': ('from hnn_vi_ros.learning.data.arrays import Archive', 'Archive(path)'),
    'log': (LOG, 'read_text(path, data)'),
    'axis': (AXIS, "file_axis(path, 'axis')"),
    'posterior': ('from hnn_vi_ros.sweeps.axes import read_posterior',
                  "read_posterior(path, 'posterior')"),
    'record': ('from hnn_vi_ros.sweeps.folder import SweepFolder',
               'SweepFolder(path.parent).record()'),
    'model': ('from hnn_vi_ros.models.checkpoint import load_checkpoint', 'load_checkpoint(path)'),
    'state': (STATE, "restore_state(simulation, path.read_bytes()[:2**26], 'bag')"),
    'scene': ('from hnn_vi_ros.scene import load_scene', 'load_scene(path)'),
}


def header(shape: str, kind: str = '<f8') -> bytes:
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b'\x93NUMPY\x01\x00' + struct.pack('<H', len(text)) + text


def archive(path: Path, *members: tuple[str, bytes]) -> None:
    with zipfile.ZipFile(path, 'w') as made:
        for name, content in members:
            made.writestr(name, content)


def bomb(path: Path) -> None:
    with zipfile.ZipFile(path, 'w', zipfile.ZIP_DEFLATED, compresslevel=1) as made, made.open(
            'q.npy', 'w', force_zip64=True) as member:
        member.write(header('(150994944,)'))
        for _ in range(36):
            member.write(bytes(1 << 25))


def sparse(size: int) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        with path.open('wb') as stream:
            stream.truncate(size)
    return write


def text(begin: str, part: str, size: int, end: str = '') -> Callable[[Path], None]:
    def write(path: Path) -> None:
        with path.open('w') as stream:
            stream.write(begin)
            for _ in range(size >> 20):
                stream.write(part * ((1 << 20) // len(part)))
            stream.write(end)
    return write


def tensors(size: int, names: int = 0, shape: str = '[1]', data: int = 8
            ) -> Callable[[Path], None]:
    """Return what writes a safetensors file: empty tensors, or one, and data behind them."""
    def write(path: Path) -> None:
        content = ','.join(f'"{k}":{{"dtype":"F64","shape":[0],"data_offsets":[0,0]}}'
                           for k in range(names)) or (
            f'"a":{{"dtype":"F64","shape":{shape},"data_offsets":[0,{data}]}}')
        raw = f'{{{content}}}'.encode()
        with path.open('wb') as stream:
            stream.write(struct.pack('<Q', len(raw)) + raw)
            stream.truncate(stream.tell() + size)
    return write


ATTACKS: dict[str, tuple[str, str, Callable[[Path], None], str]] = {
    'claims 10^13 numbers': ('arrays', 'a.npz', lambda path: archive(path, (
        'q.npy', header('(10000000000000,)') + bytes(8))), 'not an .npz file of plain'),
    'unpacks to 1.1 GiB': ('arrays', 'a.npz', bomb, 'unpacks to more than 1 GiB; give'),
    'a log of 5 GB': ('log', 'a.txt', sparse(5 * 10**9), 'larger than 256 MiB'),
    'zeros for a log': ('log', 'a.txt', sparse(250 << 20), 'a.txt:1: longer than'),
    'a table in one line': ('axis', 'a.csv', text('step_size\n', '1,', 250 << 20),
                            'a.csv:2: longer than'),
    'empty lists': ('posterior', 'a.json', text('[', '[],', 60 << 20, '[]]'), 'a.json: '),
    'empty objects in a record': ('record', 'sweep.json', text('[', '{},', 60 << 20, '{}]'),
                                  'sweep.json: '),
    'a header of a million tensors': ('model', 'a.safetensors', tensors(0, 10**6),
                                      'not a safetensors file'),
    'a tensor of 10^13 numbers': (
        'model', 'a.safetensors', tensors(8, shape='[10000000000000]', data=8 * 10**13),
        'have no model_card|not a safetensors file'),
    'a state of a million arrays': ('state', 'a.bin', tensors(0, 10**6),
                                    'state.safetensors is damaged'),
    'a scene of 1 GB': ('scene', 'a.yaml', sparse(10**9), 'larger than 1 MiB'),
}


# One of each room; each takes a process of its own.
FEW = ('claims 10^13 numbers', 'zeros for a log', 'a tensor of 10^13 numbers', 'a scene of 1 GB')


@pytest.mark.parametrize('attack', [
    pytest.param(name, marks=() if name in FEW else pytest.mark.long) for name in ATTACKS])
def test_file_is_refused_in_one_line_before_memory_is_taken(attack, tmp_path):
    reader, name, write, message = ATTACKS[attack]
    write(tmp_path / name)
    prepare, call = READERS[reader]
    found = run_code(CHILD.format(prepare=prepare, call=call), tmp_path / name)
    (tmp_path / name).unlink()
    assert 'Traceback' not in found.stderr, found.stderr[-2000:]
    (line,) = found.stdout.splitlines()
    assert re.search(message, line), line
    grown = float(found.stderr.split()[-1])
    assert grown < MOST, f'{grown:.0f} MiB'


@pytest.mark.parametrize('save', [np.savez, np.savez_compressed])
def test_arrays_are_those_that_numpy_reads(save, tmp_path):
    rng = np.random.default_rng(1)
    arrays = {'t': rng.random(100), 'run/q': rng.random((7, 3)), 'one': np.array(3.0),
              'none': np.empty((0, 4)), 'turned': np.asfortranarray(rng.random((5, 6))),
              'whole': np.arange(9, dtype=np.int32)[::2], 'label': np.array(['a', 'bc'])}
    save(tmp_path / 'a.npz', **arrays)
    found = unpack_arrays(tmp_path / 'a.npz', 1 << 20)
    with np.load(tmp_path / 'a.npz') as expected:
        assert [*found] == expected.files == array_names(tmp_path / 'a.npz', 1 << 20)
        for name in found:
            assert found[name].dtype == expected[name].dtype
            assert found[name].shape == expected[name].shape
            assert np.array_equal(found[name], expected[name])
    with pytest.raises(OSError, match='larger than 100 bytes'):
        unpack_arrays(tmp_path / 'a.npz', 100)


@pytest.mark.parametrize('count', [50, pytest.param(600, marks=pytest.mark.long)])
def test_damaged_archives_are_refused_without_another_error(tmp_path, count):
    path, rng = tmp_path / 'a.npz', np.random.default_rng(4)
    outcomes: Counter[str] = Counter()
    for save in (np.savez, np.savez_compressed):
        save(path, t=np.arange(20.0), q=rng.random((20, 2)), o=np.array(['x']))
        content = path.read_bytes()
        for k in range(count):
            raw = bytearray(content)
            if k % 3 == 0:
                raw = raw[:rng.integers(len(raw))]
            for place in rng.integers(max(len(raw), 1), size=1 + k % 5):
                raw[place:place + 1] = bytes([rng.integers(256)])
            path.write_bytes(raw)
            try:
                unpack_arrays(path, 1 << 20)
                outcomes['read'] += 1
            except (ValueError, OSError) as problem:
                assert '\n' not in str(problem) and 'pickle' not in str(problem)
                outcomes['refused'] += 1
    # Names and times of members are in no checksum.
    assert outcomes['refused'] > count and outcomes.total() == 2 * count


def test_archive_of_objects_is_not_unpickled(tmp_path):
    np.savez(tmp_path / 'a.npz', q=np.array([{}, 1], dtype=object))
    with pytest.raises(ValueError, match='^not an .npz file of plain arrays$'):
        unpack_arrays(tmp_path / 'a.npz', 1 << 20)


def test_lines_are_numbered_without_their_breaks(tmp_path):
    path = tmp_path / 'a.txt'
    path.write_bytes('\ufeffa é\r\n\n b\rc'.encode())
    assert list(text_lines(path, 100)) == [(1, 'a é'), (2, ''), (3, ' b'), (4, 'c')]
    path.write_text('x' * LONGEST_LINE + '\nlast')
    assert [number for number, _ in text_lines(path, 1 << 21)] == [1, 2]
    for content, message in (
            (b'a\n' + b'x' * (LONGEST_LINE + 1), '^2: longer than 1048576'),
            (b'a\nb\xff\n', ': not UTF-8 text, in this line or below: invalid start')):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=message):
            list(text_lines(path, 1 << 21))


@pytest.mark.parametrize(('text_of_json', 'message'), [
    (b'[' * 100_000, 'nested too deeply'), (b'[' + b'1,' * MOST_VALUES + b'1]', 'more than'),
    (b'{"a": ' + b'9' * 5000 + b'}', 'digits'), (b'', 'Expecting value'),
    (b'\xff', "can't decode")])
def test_json_that_is_none_is_one_line(text_of_json, message):
    with pytest.raises(ValueError, match=message) as problem:
        parse_json(text_of_json)
    assert '\n' not in str(problem.value)


def test_json_of_the_largest_covariance_is_read():
    n = 1000
    found = parse_json(json.dumps({
        'parameters': {str(k): {'value': 1.0} for k in range(n)},
        'covariance': {'names': [*map(str, range(n))], 'matrix': [[0.5] * n] * n}}).encode())
    assert np.array(found['covariance']['matrix']).shape == (n, n)
