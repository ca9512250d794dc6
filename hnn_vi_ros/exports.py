# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Lazily imported exports of a package (PEP 562)."""

import ast
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
import sys


@cache
def exported(path: Path) -> dict[str, str]:
    """Return the module of each lazy export in the ``__init__`` of a package."""
    block = next((node for node in ast.parse(path.read_text(encoding='utf-8')).body
                  if isinstance(node, ast.If)), None)
    return {alias.name: statement.module or '' for statement in (block.body if block else ())
            if isinstance(statement, ast.ImportFrom) for alias in statement.names}


def lazy_exports(package: str) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """
    Return ``__getattr__`` and ``__dir__`` for the ``__init__`` of a package.

    The package exports the names imported in its ``if TYPE_CHECKING:`` block, where type checkers
    and editors find them. Importing the package is cheap, and an executable can report a missing
    dependency.

    Parameters
    ----------
    package : str
        ``__name__`` of the package.

    """
    module = sys.modules[package]

    def names() -> dict[str, str]:
        return exported(Path(module.__file__ or ''))

    def export(name: str) -> object:
        # Python looks for __path__ and others, which are not in the source.
        if name.startswith('__') or name not in names():
            raise AttributeError(f'module {package!r} has no attribute {name!r}')
        value = getattr(import_module(names()[name]), name)
        setattr(module, name, value)
        return value
    return export, lambda: sorted(names())
