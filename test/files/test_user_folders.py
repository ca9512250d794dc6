# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Caches of a user without a home, of one whose home is read-only, and of one among others."""

from pathlib import Path
from subprocess import CompletedProcess
import tempfile

from hnn_vi_ros.files import (
    cache_folder, expand_user, private_folder, private_key, resources, usual_folder)
import pytest
from python_process import run_code


@pytest.fixture(autouse=True)
def temporary(tmp_path, monkeypatch):
    """Return the folder of temporary files; nothing else is set."""
    monkeypatch.delenv('XDG_CACHE_HOME', raising=False)
    folder = tmp_path / 'tmp'
    folder.mkdir()
    monkeypatch.setattr(tempfile, 'tempdir', str(folder))
    return folder


@pytest.fixture
def no_home(monkeypatch):
    """Let the user be in no list of users, as in some containers, and HOME not be set."""
    monkeypatch.delenv('HOME', raising=False)
    monkeypatch.setattr('pwd.getpwuid', lambda number: {}[number])


def test_cache_is_in_the_home_or_where_it_was_asked_for(tmp_path, monkeypatch):
    monkeypatch.setenv('HOME', str(tmp_path))
    assert cache_folder() == tmp_path / '.cache'
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'mine'))
    assert cache_folder() == tmp_path / 'mine'


def test_cache_without_a_home_is_private_and_the_same_each_time(no_home, temporary):
    assert usual_folder() is None
    folder = cache_folder()
    assert folder == cache_folder() and folder.parent == temporary
    assert folder.stat().st_mode & 0o777 == 0o700
    assert expand_user('~/a') == Path('~/a')


def test_cache_is_private_where_the_home_is_read_only(monkeypatch, temporary):
    # Nobody, not even root, makes files there.
    monkeypatch.setenv('HOME', '/proc/nobody')
    monkeypatch.setattr(resources.os, 'access', lambda folder, mode: folder != Path('/proc'))
    assert usual_folder() is None
    assert cache_folder().parent == temporary


@pytest.mark.parametrize('planted', ['writable by others', 'a link', "another's"])
def test_cache_that_others_could_write_is_not_taken(planted, no_home, tmp_path, monkeypatch):
    first = cache_folder()
    if planted == 'writable by others':
        first.chmod(0o777)
    elif planted == 'a link':
        first.rmdir()
        (tmp_path / 'theirs').mkdir()
        first.symlink_to(tmp_path / 'theirs')
    else:
        number = first.stat().st_uid
        first.rename(first.with_name(f'hnn_vi_ros-cache-{number + 1}'))
        monkeypatch.setattr(resources.os, 'getuid', lambda: number + 1)
    second = cache_folder()
    assert second != first and not second.is_symlink()
    assert second.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize('planted', ['a link to nothing', 'a file'])
def test_what_is_planted_in_place_of_the_private_folder_is_replaced_once(planted, temporary):
    first = private_folder()
    first.rmdir()
    if planted == 'a file':
        first.touch()
    else:
        first.symlink_to('/proc/nothing')
    second = private_folder()
    assert second != first and second == private_folder()
    assert second.stat().st_mode & 0o777 == 0o700 and len([*temporary.iterdir()]) == 2


def test_key_is_private_and_kept_unless_others_could_know_it(tmp_path, monkeypatch):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))

    def key() -> bytes:
        """Return the key that the next process has."""
        private_key.cache_clear()
        return private_key()

    first, file = key(), tmp_path / 'hnn_vi_ros' / 'private' / 'key'
    assert len(first) == 32 and key() == first == file.read_bytes()
    assert file.stat().st_mode & 0o777 == 0o600
    assert file.parent.stat().st_mode & 0o777 == 0o700
    for change in (lambda: file.chmod(0o644), lambda: file.write_bytes(first[:5])):
        change()
        second = key()
        assert second != first and key() == second and file.stat().st_mode & 0o777 == 0o600
        first = second
    # A link is not followed, and a folder that others can write is replaced.
    (tmp_path / 'theirs').write_bytes(bytes(32))
    file.unlink()
    file.symlink_to(tmp_path / 'theirs')
    assert key() != bytes(32)
    file.parent.chmod(0o777)
    assert key() != bytes(32) and file.is_symlink()
    private_key.cache_clear()


def run_without_a_home(*words: str) -> CompletedProcess:
    """Run a command of a user who is in no list of users."""
    code = """
import os, pwd, sys
for name in ('HOME', 'XDG_CACHE_HOME', 'ROS_HOME', 'ROS_LOG_DIR'):
    os.environ.pop(name, None)
pwd.getpwuid = lambda number: {}[number]
sys.argv = ['hnn', *sys.argv[1:]]
from hnn_vi_ros.cli import main
main()
"""
    return run_code(code, *words)


def test_command_of_a_user_without_a_home_runs():
    result = run_without_a_home('doctor')
    assert (result.returncode, result.stderr) == (0, '')


def test_log_of_ros_has_a_place_without_a_home():
    # ROS opens its log before it makes the node, which cannot have that name.
    result = run_without_a_home('listener', '--ros-args', '-r', '__node:=no+name')
    assert result.returncode == 1
    assert 'name' in result.stderr and 'logging' not in result.stderr
