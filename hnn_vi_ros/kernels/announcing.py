# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Announcement of what numba is about to compile, and for about how long; or refusal of it."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import get_ident
from typing import Any

from hnn_vi_ros.kernels.sources import reached
from numba.core import types
from numba.core.event import Event, install_listener, Listener

# What compiling took for each byte of the bytecode that is reached [s], 0.5 to 1.2 ms on one core
# of a server over ten scenes from an empty cache.
_SECONDS = 0.8e-3
# What takes less is not worth a line [s].
_SHORT = 1.0
_NAMES = {'advance': 'the loop over steps', 'take_substeps': 'the sub-steps',
          '_step_entry': 'a step', '_energy_entry': 'H', '_gradient_entry': 'the gradient of H',
          '_hessian_vector_entry': "products with H''"}


class _Announcer(Listener):
    """Listener to compilations, which reports those that are not a part of another."""

    def __init__(self, tell: Callable[[str], None]):
        self._tell, self._depth = tell, 0

    def on_start(self, event: Event) -> None:
        """Announce it, if it takes long; what is found on disk comes here not at all."""
        self._depth += 1
        function = event.data['dispatcher'].py_func
        seconds = _SECONDS * sum(len(part.__code__.co_code) for part in reached(
            function, *_functions_in(event.data['args'])))
        if self._depth == 1 and seconds >= _SHORT:
            what = _NAMES.get(function.__name__, function.__name__)
            self._tell(f'compiling {what}, once: about {seconds:.0f} s')

    def on_end(self, event: Event) -> None:
        """Return to the compilation that this one is a part of."""
        self._depth -= 1


@contextmanager
def announced(tell: Callable[[str], None]) -> Iterator[None]:
    """
    Announce each function that is compiled meanwhile, before that is begun.

    Parameters
    ----------
    tell : callable
        Takes a line: what is compiled, and an estimate of the time [s].

    """
    with install_listener('numba:compile', _Announcer(tell)):
        yield


class NotKept(Exception):
    """Refusal to compile what is not on disk."""


class _Refuser(Listener):
    """Listener that refuses compilations of the thread that it was made in."""

    def __init__(self) -> None:
        self._thread = get_ident()

    def on_start(self, event: Event) -> None:
        """Refuse it; what is found on disk comes here not at all."""
        if get_ident() == self._thread:
            raise NotKept

    def on_end(self, event: Event) -> None:
        """Nothing was begun."""


@contextmanager
def kept_only() -> Iterator[None]:
    """Raise NotKept where this thread would compile a function meanwhile."""
    with install_listener('numba:compile', _Refuser()):
        yield


def _functions_in(kinds: tuple[types.Type, ...]) -> Iterator[Callable[..., Any]]:
    """Yield the compiled functions among types of arguments, in tuples too."""
    for kind in kinds:
        if isinstance(kind, types.Dispatcher):
            yield kind.dispatcher.py_func
        elif isinstance(kind, types.BaseTuple):
            yield from _functions_in(kind.types)
