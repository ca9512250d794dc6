# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Marks of functions that are compiled into others; marking one does not load the compiler.

A marked function stays plain Python when called from Python. What is marked is only noted here;
the compiler, once it is loaded, asks for it (see linking.py). So the classes of effects and
integrators can be read, as a scene does for its schema, in a process without numba.
"""

from collections.abc import Callable
from threading import Lock
from typing import Any, TypeVar

_Function = TypeVar('_Function', bound=Callable[..., Any])
_Registrar = Callable[[Callable[..., Any], bool], None]

_PACKAGE = __name__.partition('.')[0]

_lock = Lock()
# Functions marked and not registered yet, and the registrars, once there is one.
_waiting: list[tuple[Callable[..., Any], bool]] = []
_registrars: list[_Registrar] = []


def inlined(function: _Function) -> _Function:
    """
    Mark a function that is inlined where compiled code calls it.

    A call that is not inlined passes every field of every array and counts its references.
    """
    return _mark(function, True)


def called(function: _Function) -> _Function:
    """Mark one called so seldom that a call costs less than a larger function to compile."""
    return _mark(function, False)


def _mark(function: _Function, inline: bool) -> _Function:
    with _lock:
        _waiting.append((function, inline))
        _register_waiting()
    return function


def register_by(registrar: _Registrar) -> None:
    """
    Register all marked functions, now and at later marks.

    Parameters
    ----------
    registrar : callable
        Makes a function known to the compiler; its second argument is whether it is inlined.

    """
    with _lock:
        _registrars[:] = [registrar]
        _register_waiting()


def _register_waiting() -> None:
    if _registrars:
        while _waiting:
            _registrars[0](*_waiting.pop(0))


def is_own(module: str | None) -> bool:
    """Return whether a module (None for none) is of this package, whose changes are noticed."""
    return module is not None and module.startswith(f'{_PACKAGE}.')
