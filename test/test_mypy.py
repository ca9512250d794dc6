# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Hold the core to its types; mypy.ini says which rooms are strict."""

from importlib.metadata import PackageNotFoundError, version
import os
import re
import subprocess
import sys

import pytest
from sources import ROOT

# What mypy reads the types of, or is extended by.
TYPED = ('mypy', 'numpy', 'pydantic')


def pins() -> dict[str, str]:
    """Return the version of each package that the requirements pin."""
    text = ''.join((ROOT / 'requirements' / f'{name}.txt').read_text()
                   for name in ('constraints', 'test'))
    return dict(re.findall(r'^([\w.-]+)==(\S+)$', text, re.MULTILINE))


def other_version() -> str:
    """Return which package is not there as the requirements pin it, nothing if all are."""
    for name in TYPED:
        try:
            if version(name) != pins()[name]:
                return f'{name} is {version(name)}, its types are those of {pins()[name]}'
        except PackageNotFoundError:
            return f'{name} is not installed'
    return ''


@pytest.mark.linter
def test_core_satisfies_mypy(pytestconfig):
    if problem := other_version():
        pytest.skip(problem)
    # What it found of files that have not changed since is read again.
    cache = getattr(pytestconfig, 'cache', None)
    kept = cache.mkdir('mypy') if cache else os.devnull
    found = subprocess.run(
        [sys.executable, '-m', 'mypy', '--config-file', 'mypy.ini', '--no-error-summary',
         '--cache-dir', str(kept)], cwd=ROOT, capture_output=True, text=True,
        check=False, timeout=300)
    assert found.returncode == 0, found.stdout + found.stderr
