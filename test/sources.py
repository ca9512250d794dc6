# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Python files of the repository, which linters and rules judge; each is parsed once."""

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / 'hnn_vi_ros'


def python_files(*folders: str) -> list[Path]:
    """Return the Python files below folders, of which a checkout may lack some."""
    paths = [path for folder in folders for path in sorted((ROOT / folder).rglob('*.py'))]
    # What is built stands in folders such as docs/_build.
    return [path for path in paths
            if not any(part[0] in '._' for part in path.relative_to(ROOT).parts[:-1])]


PYTHON_FILES = [ROOT / 'setup.py', *python_files('docs', 'hnn_vi_ros', 'launch', 'test')]
MODULES = python_files('hnn_vi_ros')
TEST_FILES = [path for path in python_files('test') if path.name.startswith('test_')]


def relative(path: Path) -> str:
    """Return the path of a file from the top of the repository."""
    return path.relative_to(ROOT).as_posix()


@cache
def text(path: Path) -> str:
    """Return the text of a file."""
    return path.read_text(encoding='utf-8')


@cache
def tree(path: Path) -> ast.Module:
    """Return the syntax tree of a Python file."""
    return ast.parse(text(path))
