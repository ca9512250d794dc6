# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled code on a full disk, and files of it that are damaged or in a wrong place."""

from concurrent.futures import ThreadPoolExecutor
import errno
from fcntl import flock, LOCK_EX, LOCK_UN
import hmac
import os
from pathlib import Path
import pickle
import shutil
import warnings

from hnn_vi_ros.kernels import linking
from hnn_vi_ros.kernels.linking import keep
import numba
import pytest
from python_process import run_code


def double(x):
    return 2 * x


def triple(x):
    return 3 * x


def refuse(*arguments):
    raise PermissionError


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Keep compiled code in a folder of the test's, and forget what was warned of."""
    monkeypatch.setattr(numba.config, 'CACHE_DIR', str(tmp_path))
    linking._warned.clear()
    linking._safe_folder.cache_clear()
    linking._owner.cache_clear()
    return tmp_path


def test_code_runs_where_it_cannot_be_kept_and_that_is_told_once(folder, monkeypatch):
    def full(self, path):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), path)
    monkeypatch.setattr(linking._Files, '_open_for_write', full)
    function = keep(numba.njit(double))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter('always')
        assert (function(2), function(2.0)) == (4, 4.0)
    message, = [str(warning.message) for warning in caught]
    assert str(folder) in message and 'No space left on device' in message
    assert 'NUMBA_CACHE_DIR' in message and '\n' not in message


def code(function):
    """Return a function compiled and kept under the name of the function, as a start has it."""
    return keep(numba.njit(function))


def assert_made_anew(folder: Path, reason: str) -> None:
    """Assert that a damaged cache is told of in a line, made anew, and then found."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter('always')
        again = code(double)
        assert (again(3), again(3.0)) == (6, 6.0)
    message, = {str(warning.message) for warning in caught}
    assert str(folder) in message and reason in message and '\n' not in message
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        third = code(double)
        assert (third(3), third(3.0)) == (6, 6.0) and len(third.stats.cache_hits) == 2


@pytest.fixture(scope='module')
def compiled(tmp_path_factory):
    """Return a folder with two functions, one of them for two types."""
    with pytest.MonkeyPatch.context() as change:
        change.setattr(numba.config, 'CACHE_DIR', str(tmp_path_factory.mktemp('compiled')))
        first = code(double)
        assert (first(3), first(3.0), code(triple)(3)) == (6, 6.0, 9)
        return numba.config.CACHE_DIR


@pytest.fixture
def kept(folder, compiled):
    """Return the files of the first function, in the folder of the test."""
    shutil.copytree(compiled, folder, dirs_exist_ok=True)
    return sorted(folder.rglob('*double*'))


@pytest.mark.parametrize('which', range(3))
@pytest.mark.parametrize('damage', [
    lambda whole: b'', lambda whole: whole[:3], lambda whole: whole[:-1],
    lambda whole: whole + b'x', lambda whole: b'x' * len(whole),
    # A byte of the machine code, or of an address in it.
    lambda whole: whole[:-500] + bytes([whole[-500] ^ 4]) + whole[-499:]],
    ids=['empty', 'begin', 'end', 'longer', 'other', 'bit'])
def test_damaged_file_is_told_of_and_made_anew(which, damage, kept, folder):
    kept[which].write_bytes(damage(kept[which].read_bytes()))
    assert_made_anew(folder, 'damaged')


@pytest.mark.parametrize('source, target', [
    ('*triple*.1.nbc', '*double*.1.nbc'), ('*double*.2.nbc', '*double*.1.nbc'),
    ('*triple*.nbi', '*double*.nbi')], ids=['code', 'type', 'index'])
def test_file_in_the_place_of_another_is_told_of_and_made_anew(source, target, kept, folder):
    (found,), (place,) = folder.rglob(source), folder.rglob(target)
    place.write_bytes(found.read_bytes())
    assert_made_anew(folder, 'belong to other functions')


@pytest.mark.parametrize('which', range(3))
def test_file_that_cannot_be_read_is_told_of(which, kept, folder):
    # Permissions do not stop the root user, as tests may be run by.
    kept[which].unlink()
    kept[which].mkdir()
    again = code(double)
    with pytest.warns(UserWarning, match='cannot be used .*Is a directory'):
        assert (again(3), again(3.0)) == (6, 6.0)


@pytest.mark.parametrize('content', [
    linking._MARK + b'0.1\n', pickle.dumps('0.1') + pickle.dumps(('stamp', {}))],
    ids=['numba', 'no digest'])
def test_code_of_another_version_is_made_anew_and_not_told_of(content, kept):
    index = kept[-1]
    assert index.suffix == '.nbi'
    index.write_bytes(content)
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        again = code(double)
        assert again(3) == 6 and not again.stats.cache_hits


def test_code_whose_types_are_gone_is_made_anew(kept, monkeypatch):
    def gone(data):
        raise AttributeError('no such type')
    monkeypatch.setattr(linking.pickle, 'loads', gone)
    assert code(double)(3) == 6


def test_code_runs_where_no_folder_can_be_written(monkeypatch):
    monkeypatch.setattr(numba.core.caching._CacheLocator, 'ensure_cache_path', refuse)
    with pytest.warns(UserWarning, match='compiled code cannot be cached .*NUMBA_CACHE_DIR'):
        assert code(double)(3) == 6


def test_code_that_another_process_is_compiling_is_waited_for():
    function = code(double)
    lock = Path(function._cache._cache_path, f'{function._cache._cache_file._index_name}.lock')
    lock.parent.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(1) as pool, lock.open('w') as file:
        flock(file, LOCK_EX)
        found = pool.submit(function, 3)
        with pytest.raises(TimeoutError):
            found.result(0.2)
        flock(file, LOCK_UN)
        assert found.result(60.0) == 6
    assert not lock.exists()


def test_code_that_is_kept_beside_the_source_is_used_by_who_cannot_write_there(
        monkeypatch, tmp_path):
    """As of a package that root has built and compiled."""
    monkeypatch.setattr(numba.config, 'CACHE_DIR', '')
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    first = code(double)
    assert first(3) == 6
    beside = Path(__file__).parent / '__pycache__'
    assert Path(first._cache._cache_path) == beside
    ensure = numba.core.caching._CacheLocator.ensure_cache_path
    monkeypatch.setattr(numba.core.caching._CacheLocator, 'ensure_cache_path', lambda self: (
        refuse() if self.get_cache_path() == str(beside) else ensure(self)))
    other = code(double)
    assert Path(other._cache._cache_path) != beside
    assert other(3) == 6 and other.stats.cache_hits and not other.stats.cache_misses


class Planted:
    """An object whose pickle runs code: it makes a file."""

    def __init__(self, path: Path):
        self.path = str(path)

    def __reduce__(self):
        return open, (self.path, 'w')


def plant(file: Path, ran: Path) -> None:
    """Replace a file of compiled code by one that whoever knows the format can write."""
    data = pickle.dumps(Planted(ran))
    file.write_bytes(linking._HEAD + hmac.digest(b'', data, 'sha256') + data)


@pytest.mark.parametrize('which', range(3))
def test_code_in_the_users_cache_that_was_not_written_with_his_key_is_not_unpickled(
        which, kept, folder, tmp_path):
    plant(kept[which], tmp_path / 'ran')
    assert_made_anew(folder, 'written by another user')
    assert not (tmp_path / 'ran').exists()


@pytest.fixture
def beside(monkeypatch, tmp_path):
    """Return the folder beside this file, in which a function is kept, as of an installation."""
    monkeypatch.setattr(numba.config, 'CACHE_DIR', '')
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'cache'))
    assert code(triple)(3) == 9
    found = Path(__file__).parent / '__pycache__'
    mode = found.stat().st_mode
    linking._owner.cache_clear()
    yield found
    found.chmod(mode)
    for file in found.glob('*triple*'):
        file.unlink()


@pytest.mark.parametrize('whose', ['writable by others', "another's"])
def test_code_beside_the_package_that_others_could_write_is_not_unpickled(
        whose, beside, tmp_path, monkeypatch):
    file, = beside.glob('*triple*.nbi')
    plant(file, tmp_path / 'ran')
    if whose == 'writable by others':
        file.chmod(0o666)
    else:
        monkeypatch.setattr(linking, 'is_own', lambda there, kind, *owners: kind == 0o040000)
    with pytest.warns(UserWarning, match='others can write'):
        assert code(triple)(3) == 9
    assert not (tmp_path / 'ran').exists()


def test_folder_beside_the_package_that_others_can_write_is_not_used(beside, tmp_path):
    file, = beside.glob('*triple*.nbi')
    plant(file, tmp_path / 'ran')
    beside.chmod(0o777)
    function = code(triple)
    assert function(3) == 9 and not (tmp_path / 'ran').exists()
    folder = Path(function._cache._cache_path)
    assert folder.is_relative_to(tmp_path / 'cache/hnn_vi_ros/private')
    assert code(triple)(3) == 9 and code(triple)._cache._cache_path == str(folder)


def test_folder_of_the_environment_that_others_can_write_is_told_of_and_not_used(
        folder, monkeypatch, tmp_path_factory):
    home = tmp_path_factory.mktemp('home')
    monkeypatch.setenv('XDG_CACHE_HOME', str(home))
    shared = Path(code(double)._cache._cache_path)
    shared.chmod(0o777)
    linking._safe_folder.cache_clear()
    with pytest.warns(UserWarning, match='others can write to it'):
        function = code(double)
    assert function(3) == 6 and home in Path(function._cache._cache_path).parents
    assert not [*shared.iterdir()]


@pytest.mark.filterwarnings('ignore:compiled code cannot be cached')
def test_files_are_not_for_others_to_write_whatever_the_umask(monkeypatch, tmp_path):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'cache'))
    before = os.umask(0)
    try:
        function = code(double)
        assert function(3) == 6
    finally:
        os.umask(before)
    folder = Path(function._cache._cache_path)
    private = tmp_path / 'cache/hnn_vi_ros/private'
    assert folder.is_relative_to(private) and private.stat().st_mode & 0o777 == 0o700
    # Kept by the next start too.
    assert code(double)(3) == 6 and code(double)._cache._cache_path == str(folder)
    files = [*folder.glob('*.nb?')]
    assert len(files) == 2 and all(not file.stat().st_mode & 0o022 for file in files)


def test_configuration_of_numba_in_the_working_folder_is_ignored_and_told_of(tmp_path):
    (tmp_path / '.numba_config.yaml').write_text('cache_dir: cache\ncache_locator_classes: a.B\n')
    found = run_code("""
import os, sys
os.chdir(sys.argv[1])
from hnn_vi_ros.kernels import linking
import numba
print(repr(numba.config.CACHE_DIR), repr(numba.config.CACHE_LOCATOR_CLASSES))
""", str(tmp_path))
    assert found.returncode == 0 and found.stdout == "'' ''\n", found.stderr
    assert '.numba_config.yaml of the working folder is ignored' in found.stderr
