# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled code on a full disk, and files of it that a power cut has damaged."""

import errno
import os
from pathlib import Path
import warnings

from hnn_vi_ros.kernels import linking
from hnn_vi_ros.kernels.linking import keep_loop
import numba
import pytest


def double(x):
    return 2 * x


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Keep compiled code in a folder of the test's, and forget what was warned of."""
    monkeypatch.setattr(numba.config, 'CACHE_DIR', str(tmp_path))
    linking._warn_of_lost.cache_clear()
    return tmp_path


def files(folder: Path, suffix: str) -> list[Path]:
    return list(folder.rglob(f'*.{suffix}'))


def test_code_runs_where_it_cannot_be_kept_and_that_is_told_once(folder, monkeypatch):
    def full(self, path):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), path)
    monkeypatch.setattr(linking._Files, '_open_for_write', full)
    function = keep_loop(numba.njit(double))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter('always')
        assert (function(2), function(2.0)) == (4, 4.0)
    message, = [str(warning.message) for warning in caught]
    assert str(folder) in message and 'No space left on device' in message
    assert 'NUMBA_CACHE_DIR' in message and '\n' not in message


@pytest.mark.parametrize('suffix', ['nbi', 'nbc'])
@pytest.mark.parametrize('rest', [0, 3, -1])
def test_damaged_file_is_made_anew(suffix, rest, folder):
    assert keep_loop(numba.njit(double))(3) == 6
    found, = files(folder, suffix)
    whole = found.read_bytes()
    found.write_bytes(whole[:rest])
    again = keep_loop(numba.njit(double))
    assert again(3) == 6 and not again.stats.cache_hits
    # It is whole: the next process finds it.
    third = keep_loop(numba.njit(double))
    assert third(3) == 6 and third.stats.cache_hits
