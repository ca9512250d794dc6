# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Python code that data name, as ``package.module:function``: who may name it, and how it is found.

A schema marks what names code by ``NAMES_CODE``. Such a value is refused unless whoever validates
the data says that it is trusted, as is done for files that the user names and for nothing else.
"""

from contextvars import ContextVar
from importlib import import_module
from pathlib import Path
import sys
from typing import Any

from pydantic import AfterValidator, ValidationInfo

_TRUST = 'trust_code'


def trusting(trust_code: bool) -> dict[str, bool]:
    """Return the context of a validation of data that may, or may not, name code."""
    return {_TRUST: trust_code}


def _check(name: str | None, info: ValidationInfo) -> str | None:
    if name is not None and not (info.context or {}).get(_TRUST, False):
        raise ValueError(
            f'{repr(name)[:80]} is code, which is run only for scene files that you name; if you '
            'trust who wrote this, allow it by --trust-code or the parameter trust_code')
    return name


NAMES_CODE = AfterValidator(_check)


# The folder of the scene whose code is imported next, and the folders of all scenes so far.
_folder: ContextVar[str | None] = ContextVar('folder', default=None)
_folders: set[str] = set()


def find_beside(folder: str | None) -> None:
    """Let Python's modules be found in a folder too, that of a scene file; None for none."""
    _folder.set(folder)
    if folder is None:
        return
    if folder not in sys.path:
        _folders.add(folder)
    elif folder in _folders:
        sys.path.remove(folder)
    else:
        return
    # After what is installed, and before the folders of other scenes.
    at = next((i for i, path in enumerate(sys.path) if path in _folders), len(sys.path))
    sys.path.insert(at, folder)


def import_named(name: str) -> Any:
    """
    Return what ``package.module:function`` names, from the path of Python's modules.

    Raises
    ------
    ImportError
        A module of that name is loaded already, and another one is next to the scene.
    Exception
        What importing the module raises, or AttributeError.

    """
    module, _, function = name.partition(':')
    found = import_module(module)
    if (folder := _folder.get()) is not None:
        _check_origins(module.partition('.')[0], Path(folder))
    return getattr(found, function)


def _check_origins(named: str, folder: Path) -> None:
    """Refuse a module in place of another one of its name next to the scene."""
    for name, module in list(sys.modules.items()):
        # Not by getattr, for which a module may run code of its own.
        file = getattr(module, '__dict__', {}).get('__file__')
        if '.' in name or not isinstance(file, str):
            continue
        taken = Path(file)
        home = taken.parent.parent if taken.name == '__init__.py' else taken.parent
        if name != named and str(home) not in _folders:
            continue
        for own in (folder / f'{name}.py', folder / name / '__init__.py'):
            # A copy does the same.
            if own.is_file() and not own.samefile(taken) and (
                    own.read_bytes() != taken.read_bytes()):
                raise ImportError(f'{name} was imported from {taken}, and {own} is another; '
                                  'rename one of them, as a process holds one module of a name')
