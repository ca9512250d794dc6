# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Names that a package exports, imported at their first use (PEP 562)."""

import ast
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
import sys


@cache
def exported(path: Path) -> dict[str, str]:
    """Return the module of each name that the ``__init__`` of a package exports lazily."""
    block = next((node for node in ast.parse(path.read_text(encoding='utf-8')).body
                  if isinstance(node, ast.If)), None)
    return {alias.name: statement.module or '' for statement in (block.body if block else ())
            if isinstance(statement, ast.ImportFrom) for alias in statement.names}


def lazy_exports(package: str) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """
    Return ``__getattr__`` and ``__dir__`` for the ``__init__`` of a package.

    The package exports the names that its ``if TYPE_CHECKING:`` block imports, where type checkers
    and editors find them. Importing the package costs nothing, and an executable can report a
    missing dependency.

    Parameters
    ----------
    package : str
        ``__name__`` of the package.

    """
    module = sys.modules[package]

    def names() -> dict[str, str]:
        return exported(Path(module.__file__ or ''))

    def export(name: str) -> object:
        # Python looks for __path__ and others, which are not read from the source.
        if name.startswith('__') or name not in names():
            raise AttributeError(f'module {package!r} has no attribute {name!r}')
        value = getattr(import_module(names()[name]), name)
        setattr(module, name, value)
        return value
    return export, lambda: sorted(names())
