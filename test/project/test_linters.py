# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Hold Python files to the style of ROS 2, to ruff.toml, and the core to its types."""

from collections.abc import Callable, Iterator
from configparser import ConfigParser
from contextlib import AbstractContextManager, contextmanager
import gc
from hashlib import sha256
from importlib.metadata import distributions, PackageNotFoundError, version
import os
from pathlib import Path
import re
import subprocess
import sys

import pytest
from sources import PYTHON_FILES, ROOT


@pytest.fixture
def rare_gc() -> Iterator[None]:
    """Collect garbage seldom: a fifth of the time of flake8 went into looking for it."""
    threshold = gc.get_threshold()
    gc.set_threshold(200_000)
    yield
    gc.set_threshold(*threshold)


@pytest.fixture
def changed_sources(pytestconfig: pytest.Config
                    ) -> Callable[[str], AbstractContextManager[list[str]]]:
    """Return a context of the Python files that a linter has not found to be right before."""
    # Another version of a plugin may find more.
    tools = sorted(f'{tool.name} {tool.version}' for tool in distributions())
    files = {str(path): sha256(f'{path} {tools}'.encode() + path.read_bytes()).hexdigest()
             for path in PYTHON_FILES}
    kept = getattr(pytestconfig, 'cache', None)

    @contextmanager
    def changed(linter: str) -> Iterator[list[str]]:
        right = kept.get(f'{linter}/right', []) if kept else []
        # At least one: without any, a linter would look for files by itself.
        yield [path for path, digest in files.items() if digest not in right] or [*files][:1]
        if kept:
            kept.set(f'{linter}/right', [*files.values()])
    return changed


@pytest.mark.flake8
@pytest.mark.linter
@pytest.mark.long
def test_python_files_satisfy_ament_flake8(changed_sources, rare_gc, monkeypatch, tmp_path):
    ament_flake8 = pytest.importorskip('ament_flake8.main', reason='needs ament_flake8')
    # It compares each file with every folder below the current one whose name begins with . or _,
    # of which .venv/ has thousands: from a folder without any.
    monkeypatch.chdir(tmp_path)
    rules = Path(ament_flake8.__file__).parent / 'configuration' / 'ament_flake8.ini'
    config = tmp_path / 'one_process.ini'
    own = ConfigParser()
    own.read(ROOT / 'setup.cfg')
    ignored = own['flake8']['per-file-ignores']
    config.write_text(f'{rules.read_text()}\njobs = 1\nper-file-ignores = {ignored}\n')
    with changed_sources('flake8') as files:
        code, errors = ament_flake8.main_with_errors(argv=[f'--config={config}', *files])
        assert code == 0, '\n'.join(errors)


@pytest.mark.linter
@pytest.mark.long
@pytest.mark.pep257
def test_docstrings_satisfy_ament_pep257(changed_sources, rare_gc, capfd):
    ament_pep257 = pytest.importorskip('ament_pep257.main', reason='needs ament_pep257')
    with changed_sources('pep257') as files:
        code = ament_pep257.main(argv=files)
        assert code == 0, '\n'.join(line for line in capfd.readouterr().err.splitlines()
                                    if not line.startswith('checking'))


@pytest.mark.linter
def test_python_files_satisfy_ruff():
    pytest.importorskip('ruff', reason='ruff is not installed')
    found = subprocess.run(
        [sys.executable, '-m', 'ruff', 'check', '--no-cache', '--output-format', 'concise',
         *map(str, PYTHON_FILES)], cwd=ROOT, capture_output=True, text=True, check=False,
        timeout=100)
    assert found.returncode == 0, found.stdout + found.stderr


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
