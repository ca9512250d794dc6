# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Python code named in data as ``package.module:function``: permission, and import.

A schema marks a value that names code with ``NAMES_CODE``. Such a value is rejected unless the
caller of the validation trusts the data, which holds only for files given by the user.
"""

from contextvars import ContextVar
from importlib import import_module
from pathlib import Path
import sys
from typing import Any

from pydantic import AfterValidator, ValidationInfo

_TRUST = 'trust_code'
# Part of the message of a rejected name.
CODE_REFUSED = 'is code, which is run only for scene files that you name'


def trust_context(trust_code: bool) -> dict[str, bool]:
    """Return a validation context that permits or forbids code in the data."""
    return {_TRUST: trust_code}


def _check(name: str | None, info: ValidationInfo) -> str | None:
    if name is not None and not (info.context or {}).get(_TRUST, False):
        raise ValueError(
            f'{repr(name)[:80]} {CODE_REFUSED}; if you trust its author, allow it with '
            '--trust-code or the parameter trust_code')
    return name


NAMES_CODE = AfterValidator(_check)


# Folder of the scene whose code is imported next, and folders of all scenes so far.
_folder: ContextVar[str | None] = ContextVar('folder', default=None)
_folders: set[str] = set()


def find_beside(folder: str | None) -> None:
    """Add the folder of a scene file to the path of Python's modules; None for none."""
    _folder.set(folder)
    if folder is None:
        return
    if folder not in sys.path:
        _folders.add(folder)
    elif folder in _folders:
        sys.path.remove(folder)
    else:
        return
    # After installed packages, and before the folders of other scenes.
    at = next((i for i, path in enumerate(sys.path) if path in _folders), len(sys.path))
    sys.path.insert(at, folder)


def import_named(name: str) -> Any:
    """
    Import ``package.module:function`` from the path of Python's modules.

    Raises
    ------
    ImportError
        A different module of that name is already loaded than the one next to the scene.
    Exception
        Any exception of the module at import, or AttributeError.

    """
    module, _, function = name.partition(':')
    found = import_module(module)
    if (folder := _folder.get()) is not None:
        _check_origins(module.partition('.')[0], Path(folder))
    return getattr(found, function)


def _check_origins(named: str, folder: Path) -> None:
    """Raise an error if a loaded module hides one of its name next to the scene."""
    for name, module in list(sys.modules.items()):
        # Without getattr, for which a module may define its own code.
        file = getattr(module, '__dict__', {}).get('__file__')
        if '.' in name or not isinstance(file, str):
            continue
        taken = Path(file)
        home = taken.parent.parent if taken.name == '__init__.py' else taken.parent
        if name != named and str(home) not in _folders:
            continue
        for own in (folder / f'{name}.py', folder / name / '__init__.py'):
            # An identical copy is accepted.
            if own.is_file() and not own.samefile(taken) and (
                    own.read_bytes() != taken.read_bytes()):
                raise ImportError(f'{name} was imported from {taken}, and {own} is another; '
                                  'rename one of them, because a process has only one module of '
                                  'each name')
