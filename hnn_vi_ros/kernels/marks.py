# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Marks of functions that are compiled into others; marking does not load the compiler.

A marked function is plain Python when called from Python. Marks are only recorded here; the
compiler reads them once it is loaded (see linking.py). So the classes of effects and integrators
can be read, for example for the schema of scenes, in a process without numba.
"""

from collections.abc import Callable
from threading import Lock
from typing import Any, TypeVar

_Function = TypeVar('_Function', bound=Callable[..., Any])
_Registrar = Callable[[Callable[..., Any], bool], None]

_PACKAGE = __name__.partition('.')[0]

_lock = Lock()
# Marked functions that are not registered yet, and the registrars.
_waiting: list[tuple[Callable[..., Any], bool]] = []
_registrars: list[_Registrar] = []


def inlined(function: _Function) -> _Function:
    """
    Mark a function to be inlined where compiled code calls it.

    A call that is not inlined passes every field of every array and counts its references.
    """
    return _mark(function, True)


def called(function: _Function) -> _Function:
    """Mark a rarely called function: a call costs less than compiling a larger function."""
    return _mark(function, False)


def _mark(function: _Function, inline: bool) -> _Function:
    with _lock:
        _waiting.append((function, inline))
        _register_waiting()
    return function


def register_by(registrar: _Registrar) -> None:
    """
    Register all marked functions, and functions marked later.

    Parameters
    ----------
    registrar : callable
        Function that registers a function with the compiler; its second argument is ``inline``.

    """
    with _lock:
        _registrars[:] = [registrar]
        _register_waiting()


def _register_waiting() -> None:
    if _registrars:
        while _waiting:
            _registrars[0](*_waiting.pop(0))


def is_own(module: str | None) -> bool:
    """Return True if a module, possibly None, is in this package, whose changes are detected."""
    return module is not None and module.startswith(f'{_PACKAGE}.')
