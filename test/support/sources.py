# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Python files of the repository, each parsed once, and processes without some packages."""

import ast
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path
import re
import subprocess
import sys

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / 'hnn_vi_ros'


def python_files(*folders: str) -> list[Path]:
    """Return the Python files below folders; folders missing in a checkout are skipped."""
    paths = [path for folder in folders for path in sorted((ROOT / folder).rglob('*.py'))]
    # Builds are in folders such as docs/_build.
    return [path for path in paths
            if not any(part[0] in '._' for part in path.relative_to(ROOT).parts[:-1])]


PYTHON_FILES = [ROOT / 'setup.py', *python_files('docs', 'hnn_vi_ros', 'launch', 'test')]
MODULES = python_files('hnn_vi_ros')
TEST_FILES = [path for path in python_files('test') if path.name.startswith('test_')]


def relative(path: Path) -> str:
    """Return the path of a file relative to the root of the repository."""
    return path.relative_to(ROOT).as_posix()


HIDE = """
import sys
hidden = {hidden!r}
class Hide:
    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] in hidden:
            raise ModuleNotFoundError(f'No module named {{name!r}}', name=name)
sys.meta_path.insert(0, Hide())
"""


def run_without(hidden: set[str], code: str, *arguments: str) -> subprocess.CompletedProcess:
    """Run code in a process in which the packages in the set `hidden` cannot be imported."""
    return subprocess.run([sys.executable, '-c', HIDE.format(hidden=hidden) + code, *arguments],
                          capture_output=True, text=True, timeout=300, check=False)


def requirements_of(*files: str) -> list[Requirement]:
    """Return the requirements in requirements files."""
    return [Requirement(line) for file in files
            for line in (ROOT / 'requirements' / f'{file}.txt').read_text().splitlines()
            if re.match('[A-Za-z]', line)]


def brought(requirements: list[Requirement], python: str) -> set[str]:
    """Return the normalised names of all packages that a Python installs for requirements."""
    environment = {'python_version': python, 'python_full_version': f'{python}.0'}
    pending, seen = [*requirements], set[tuple[str, frozenset[str]]]()
    while pending:
        requirement = pending.pop()
        key = canonicalize_name(requirement.name), frozenset(requirement.extras)
        if key in seen:
            continue
        seen.add(key)
        # Not for this platform or Python, or ROS is not from wheels: dependencies are unknown.
        with suppress(PackageNotFoundError):
            pending += [child for child in map(Requirement, requires(requirement.name) or ())
                        if child.marker is None or any(
                            child.marker.evaluate(environment | {'extra': extra})
                            for extra in ('', *requirement.extras))]
    return {name for name, _ in seen}


def blocks(page: Path, language: str) -> list[str]:
    """Return the code blocks of a page in a given language."""
    return re.findall(rf'```{language}\n(.*?)```', page.read_text(encoding='utf-8'), re.DOTALL)


@cache
def text(path: Path) -> str:
    """Return the text of a file."""
    return path.read_text(encoding='utf-8')


@cache
def tree(path: Path) -> ast.Module:
    """Return the syntax tree of a Python file."""
    return ast.parse(text(path))
