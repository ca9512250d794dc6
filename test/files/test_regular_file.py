# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Readers of files, given what looks like one: a FIFO without a writer would hold them up."""

import ast
from collections.abc import Callable
import errno
import fcntl
import os
from pathlib import Path
import re

from hnn_vi_ros.errors import DataError, HnnViRosError, SceneError
from hnn_vi_ros.files import (
    read_yaml, save_figure, write_bytes, write_new_scene, write_text, writing, written)
from hnn_vi_ros.hamiltonians import read_urdf
from hnn_vi_ros.identify.identify import _arrays
from hnn_vi_ros.learning import ArraysData
from hnn_vi_ros.learning.data.arrays import Archive
from hnn_vi_ros.learning.data.text import LogMotions, read_log
from hnn_vi_ros.learning.import_model import read_state
from hnn_vi_ros.models import load_checkpoint
from hnn_vi_ros.recording import BagReader
from hnn_vi_ros.recording.bags.bag_metadata import write_bag_metadata
from hnn_vi_ros.ros.worlds import open_world, WorldError
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.sweeps.axes import file_axis, read_posterior
from matplotlib.figure import Figure
from messages import refused
import pytest
from scene_files import write_scene


def robot_of_a_scene(path: Path) -> None:
    scene = write_scene(path.with_name('scene.yaml'), f'urdf, file: {path.name}')
    load_scene(scene).create_hamiltonian()


READERS: dict[str, Callable[[Path], object]] = {
    'urdf': read_urdf, 'robot of a scene': robot_of_a_scene,
    'log': lambda path: read_log(path, LogMotions(columns=['t', 'q'], time='t', q=['q'])),
    'scene': load_scene, 'yaml': lambda path: read_yaml(path, Scene, DataError)[0],
    'arrays': Archive, 'posterior': lambda path: read_posterior(path, 'posterior'),
    'axis': lambda path: file_axis(path, 'axis')}
# Readers of what is often kept in Git LFS.
LARGE: dict[str, Callable[[Path], object]] = {
    'model': load_checkpoint, 'weights': read_state, 'bag': BagReader}


@pytest.mark.timeout(60)
@pytest.mark.parametrize('reader', READERS | LARGE)
def test_fifo_is_no_missing_file_and_is_not_waited_for(reader, tmp_path):
    os.mkfifo(tmp_path / 'pipe.yaml')
    for name in ('pipe.yaml', 'none.yaml'):
        with refused(HnnViRosError):
            (READERS | LARGE)[reader](tmp_path / name)


@pytest.mark.parametrize('reader', LARGE)
def test_pointer_of_git_lfs_is_named_as_such(reader, tmp_path):
    path = tmp_path / 'a.mcap'
    path.write_text('version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12\n')
    with refused(HnnViRosError):
        LARGE[reader](path)


def test_keys_of_a_fifo_are_left_to_its_reader_and_as_a_world_it_is_no_missing_one(tmp_path):
    os.mkfifo(tmp_path / 'pipe.yaml')
    data = ArraysData()
    assert _arrays(tmp_path / 'pipe.yaml', data, False) is data
    with refused(WorldError):
        open_world(str(tmp_path / 'pipe.yaml'))


@pytest.mark.parametrize('before', ['', 'old'])
def test_scene_on_a_full_disk_leaves_what_was_there(tmp_path, monkeypatch, before):
    path = tmp_path / 'scene.yaml'
    if before:
        path.write_text(before)

    def fill(handle: int) -> None:
        os.ftruncate(handle, 3)
        raise OSError(errno.ENOSPC, 'No space left on device')

    monkeypatch.setattr(os, 'fsync', fill)
    with refused(SceneError):
        write_new_scene(path, 'description: new', force=bool(before))
    assert [one.name for one in tmp_path.iterdir()] == (['scene.yaml'] if before else [])
    assert not before or path.read_text() == before


@pytest.mark.parametrize('second_names', [True, False])
def test_new_file_is_whole_when_it_appears_and_replaces_none(tmp_path, monkeypatch, second_names):
    path, seen, link = tmp_path / 'a.json', [], os.link

    def link_it(temporary: str, target: Path) -> None:
        seen.append((target.exists(), Path(temporary).read_bytes()))
        if not second_names:
            raise PermissionError(errno.EPERM, 'Operation not permitted')
        link(temporary, target)

    monkeypatch.setattr(os, 'link', link_it)
    write_bytes(path, b'whole', new=True, mode=0o600)
    with pytest.raises(FileExistsError):
        write_bytes(path, b'other', new=True)
    assert seen == [(False, b'whole'), (True, b'other')]
    assert path.read_bytes() == b'whole' and [*tmp_path.iterdir()] == [path]
    assert path.stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize('write', [
    lambda path: write_text(path, 'new'), lambda path: write_bytes(path, b'new', new=True),
    lambda path: _write_again(path), lambda path: write_bag_metadata(path.parent, {'new': 1})],
    ids=['write_text', 'write_bytes', 'written', 'write_bag_metadata'])
def test_temporary_file_is_none_that_was_planted(tmp_path, monkeypatch, write):
    victim, path = tmp_path / 'victim', tmp_path / 'new' / 'metadata.yaml'
    victim.write_text('precious')
    path.parent.mkdir()
    # Names of before, which could be foreseen; and each name that is drawn now, once.
    for name in (f'.metadata.{os.getpid()}.yaml', 'metadata.yaml.tmp', '.metadata.planted.yaml'):
        (path.parent / name).symlink_to(victim)
    monkeypatch.setattr(writing, 'token_hex', lambda count: 'planted')
    with pytest.raises(FileExistsError):
        write(path)
    monkeypatch.undo()
    write(path)
    assert 'new' in path.read_text() and not path.is_symlink()
    assert victim.read_text() == 'precious'
    assert path.stat().st_mode & 0o777 == 0o666 & ~_umask()
    # Nothing is left but the links.
    assert len([*path.parent.iterdir()]) == 4


def test_temporary_file_of_a_killed_process_is_removed_by_the_next_writer(tmp_path):
    path, names = tmp_path / ('a' * 250 + '.txt'), [f'{k:016x}' for k in range(4)]
    left, held, young, link = (tmp_path / f'.{"a" * 40}.{name}.txt' for name in names)
    for one in (left, held, young, tmp_path / '.a.0.txt'):
        one.write_text('half')
        os.utime(one, (0, 0) if one != young else None)
    link.symlink_to(held)
    with held.open() as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        write_text(path, 'whole')
    assert {*tmp_path.iterdir()} == {held, young, link, tmp_path / '.a.0.txt', path}
    assert held.read_text() == 'half'
    # The lock of a process ends with it.
    write_text(path, 'other')
    assert {*tmp_path.iterdir()} == {young, link, tmp_path / '.a.0.txt', path}


def test_temporary_file_is_locked_while_it_is_written(tmp_path):
    with written(tmp_path / 'a.txt') as stream, open(stream.name) as other, \
            pytest.raises(BlockingIOError):
        fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _write_again(path: Path) -> None:
    with written(path) as stream:
        os.unlink(stream.name)
        Path(stream.name).write_text('new')


def _umask() -> int:
    before = os.umask(0)
    os.umask(before)
    return before


def test_file_in_a_missing_folder_is_named_without_its_temporary_one(tmp_path):
    path = tmp_path / 'none/run.txt'
    with pytest.raises(FileNotFoundError) as found:
        write_text(path, 'text')
    assert found.value.filename == str(path)


def test_link_at_the_path_is_replaced_and_not_followed(tmp_path):
    victim, path = tmp_path / 'victim', tmp_path / 'a.txt'
    victim.write_text('precious')
    path.symlink_to(victim)
    with pytest.raises(FileExistsError):
        write_text(path, 'new', new=True)
    write_text(path, 'new')
    assert victim.read_text() == 'precious' and path.read_text() == 'new'
    assert not path.is_symlink()


def test_only_a_regular_file_is_replaced_and_a_private_one_stays_private(tmp_path):
    path, pipe = tmp_path / 'a.txt', tmp_path / 'pipe'
    os.mkfifo(pipe)
    with pytest.raises(OSError, match='is not a regular file'):
        write_text(pipe, 'new')
    path.touch(0o600)
    write_text(path, 'new')
    assert path.read_text() == 'new' and path.stat().st_mode & 0o777 == 0o600


def test_full_disk_is_told_with_the_name_of_the_file(tmp_path, monkeypatch):
    def fill(handle: int) -> None:
        raise OSError(errno.ENOSPC, 'No space left on device')

    monkeypatch.setattr(os, 'fsync', fill)
    path = tmp_path / 'fit.png'
    for write in (lambda: write_text(path, 'new'), lambda: save_figure(path, Figure())):
        with pytest.raises(OSError) as found:
            write()
        assert found.value.filename == str(path) and [*tmp_path.iterdir()] == []


# Functions that write, and the only files that call them, with the reason. Files that a user
# names are written with `written`.
WRITERS = {
    'files/writing.py': {'open', 'savefig', 'link', 'replace'},
    'files/standard_streams.py': {'open'},         # the null device
    'files/regular_file.py': {'open'},             # opens for reading; and the opener itself
    'kernels/linking.py': {'open'},                # an empty file to lock
    'codegen/fmu.py': {'ZipFile', 'savefig'},      # to the stream of `written`, and to memory
    'learning/torch_file.py': {'ZipFile'},         # to memory
    'simulation/trajectory/trajectory.py': {'savetxt', 'save_file'},  # to that of `written`
    'learning/fit/loop.py': {'save'},              # to that of `written`
    # Recordings grow; their files are created exclusively, and renamed when they can be read.
    'recording/bags/mcap_sink.py': {'open', 'rename'},
    'recording/bags/mcap_recovery.py': {'link', 'rename'},
    'recording/bags/bag_files.py': {'open'},       # in a temporary folder
    'recording/viewer/rerun_stream.py': {'open'},
    'recording/viewer/rerun_entities.py': {'NamedTemporaryFile'},
    'sweeps/parquet.py': {'write_table'}}          # to memory
WRITING = {'write_text', 'write_bytes', 'savefig', 'save', 'save_file', 'savetxt', 'savez',
           'savez_compressed', 'to_parquet', 'write_table', 'copy', 'copyfile', 'copy2',
           'copytree', 'move', 'touch', 'rename', 'renames', 'link', 'hardlink_to', 'symlink',
           'symlink_to', 'NamedTemporaryFile'}
# Modules of functions whose names others have too.
OWNERS = {'save': ('torch', 'np'), 'copy': ('shutil',), 'move': ('shutil',)}


def writes(call: ast.Call) -> str:
    """Return the name of a function that writes a file, '' for any other call."""
    function, arguments = call.func, [*call.args, *(word.value for word in call.keywords)]
    owner = getattr(getattr(function, 'value', None), 'id', '')
    name = getattr(function, 'attr', getattr(function, 'id', ''))
    words = [one.value for one in arguments[:3] if isinstance(one, ast.Constant)]
    if name in ('open', 'fdopen', 'ZipFile'):
        modes = [one for one in words if isinstance(one, str) and re.fullmatch('[rwxabt+]+', one)]
        creates = any({*'wxa+'} & {*mode} for mode in modes)
        return name if creates or (owner, name) == ('os', 'open') else ''
    if name == 'replace':
        # That of os, or of a path, which has one argument.
        return name if owner == 'os' or (len(call.args) == 1 and owner) else ''
    by_name = isinstance(function, ast.Name) and name in ('write_text', 'write_bytes')
    return name if name in WRITING and not by_name and owner in OWNERS.get(name, {owner}) else ''


def test_files_are_written_in_one_place():
    package, found = Path(writing.__file__).parents[1], {}
    for path in package.rglob('*.py'):
        calls = [node for node in ast.walk(ast.parse(path.read_text(encoding='utf-8')))
                 if isinstance(node, ast.Call)]
        if names := {writes(call) for call in calls} - {''}:
            found[path.relative_to(package).as_posix()] = names
    assert found == WRITERS, 'write with files.written, or say why not'
    for code in ("open('a', 'w')", "path.open(mode='xb')", 'path.write_text(x)', 'os.open(a, 1)',
                 'figure.savefig(path)', "ZipFile(path, 'w')", 'os.replace(a, b)',
                 'shutil.copy(a, b)', 'torch.save(x, path)'):
        assert writes(ast.parse(code).body[0].value), code


def test_temporary_files_are_made_in_one_place():
    for path in Path(writing.__file__).parents[1].rglob('*.py'):
        assert not re.search('getpid|mkstemp|mktemp', path.read_text(encoding='utf-8')), path
