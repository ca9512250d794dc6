# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Compile a loop over a step over a Hamiltonian into one kernel, once for all processes."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from hashlib import sha256
from threading import get_ident, Lock, Timer
import time
from types import FunctionType
from typing import Any, TypeVar

from hnn_vi_ros.kernels.blocks import kind_of, type_of
from hnn_vi_ros.kernels.kernel import Functions, Kernel, Parameters
from hnn_vi_ros.kernels.linking import aside, keep, Part, set_identity, Whole
from hnn_vi_ros.kernels.marks import is_own
from hnn_vi_ros.kernels.sources import digest_of, reached
import numba
from numba.core import types
from numba.core.dispatcher import Dispatcher
from numba.core.event import Event, install_listener, Listener

# These options suit loops, which only Python calls.
_Function = TypeVar('_Function', bound=Callable[..., Any])
_LOOP: dict[str, Any] = {'nogil': True, 'no_cfunc_wrapper': True, 'pipeline_class': Whole}
_naming = Lock()
_identities: dict[Dispatcher, str] = {}
# Keyed by the function and the kinds of its arguments.
_entries: dict[Any, Callable[..., Any]] = {}


def kept(own: bool = True, **options: Any) -> Callable[[_Function], _Function]:
    """
    Return a decorator that compiles a function of this package, for callers in Python as well.

    It is found again on disk for as long as no source changes that it is compiled from: numba by
    itself looks at the function's own file only.

    Parameters
    ----------
    own : bool, optional
        Whether all of it is this package's; what is not is compiled in each process.
    options
        Of numba.njit.

    """
    def compile_(function: _Function) -> _Function:
        return (keep if own else aside)(numba.njit(**options)(function))
    return compile_


@cache
def compiled(function: Callable[..., Any], name: str) -> Part:
    """
    Return a function compiled by numba, the same dispatcher each time.

    Parameters
    ----------
    function : callable
        Plain Python in numba's subset.
    name : str
        What tells it from every other function that is compiled, in any process.

    """
    dispatcher = Part(function, targetoptions={'forceinline': True})
    identify(dispatcher, name)
    return dispatcher


@cache
def dispatcher(function: _Function) -> _Function:
    """Return a function of a Hamiltonian's kernel compiled, for Python and for other code."""
    return function if isinstance(function, Dispatcher) else kept(error_model='numpy')(function)


def entry_point(function: Callable[..., Any], *arguments: object) -> Callable[..., Any]:
    """
    Return what calls a function with arguments of these very types and no others.

    For a dispatcher that is the compiled code without numba's look-up of the types, which for
    arguments of many arrays takes ten times as long as the call; anything else is returned as it
    is.
    """
    if not isinstance(function, Dispatcher):
        return function
    key = function, kind_of(arguments)
    if key not in _entries:
        signature = tuple(map(type_of, arguments))
        function.compile(signature)
        _entries[key] = function.overloads[signature].entry_point
    return _entries[key]


def compiled_options(options: Parameters) -> Parameters:
    """Return options of a step with each function in them, however deep, compiled."""
    parts = []
    for part in options:
        if callable(part):
            part = compiled(part, f'{part.__module__}.{part.__name__}')
        elif isinstance(part, tuple):
            part = compiled_options(part)
        parts.append(part)
    return type(options)(*parts) if hasattr(options, '_fields') else tuple(parts)


def compiled_loop(loop: Callable[..., Any], kernel: Kernel, method: str,
                  parts: Parameters = (), own: bool = True) -> Callable[..., Any]:
    """
    Return a loop over steps, to be compiled over one Hamiltonian and one method.

    Parameters
    ----------
    loop : callable
        One of the module loops.
    kernel : Kernel
        Of the Hamiltonian. Where all its functions are this package's, what is compiled is found
        again by later processes; changes of functions from elsewhere could not be noticed.
    method : str
        Name of the method's step.
    parts : tuple, optional
        The step and its options: with the sources of their functions, what is compiled changes.
    own : bool, optional
        Whether the step is all of this package.

    """
    functions = functions_of(kernel)
    if not (own and all(is_own(function.py_func.__module__) for function in functions)):
        return _uncached(loop)
    return _cached(loop, *(identify(function) for function in functions), method,
                   _digest(loop, parts))


@cache
def _uncached(loop: _Function) -> _Function:
    return aside(numba.njit(loop, **_LOOP))


@cache
def _cached(loop: Callable[..., Any], *names: str) -> Callable[..., Any]:
    # Under a name of its own it has an index of its own on disk. In one index for all, reading
    # any kernel would rebuild the functions of every other one, even from older sources.
    copy = FunctionType(loop.__code__, loop.__globals__, loop.__name__)
    digest = sha256('/'.join(names).encode()).hexdigest()
    copy.__qualname__ = f'{loop.__name__}_{digest[:16]}'
    return keep(numba.njit(copy, **_LOOP))


def identify(dispatcher: Dispatcher, name: str = '') -> str:
    """Give a compiled function the name that it has in every process, and return it."""
    # A function that is passed to a compiled one is part of its signature, by which numba looks
    # up its cache on disk. Numba knows such a function by a random number, new in each process;
    # a name that changes with our sources makes the look-up succeed.
    function = dispatcher.py_func
    # A name is given once, also where threads ask for it at the same time.
    with _naming:
        if dispatcher not in _identities:
            name = name or f'{function.__module__}.{function.__qualname__}'
            _identities[dispatcher] = f'{name}-{_digest(dispatcher)}'
            set_identity(dispatcher, _identities[dispatcher])
        return _identities[dispatcher]


def functions_of(kernel: Kernel) -> tuple[Dispatcher, Dispatcher, Dispatcher]:
    """Return energy, gradient and hessian_vector."""
    return kernel.energy, kernel.gradient, kernel.hessian_vector


def composed(kernel: Kernel, functions: Functions, kinds: tuple[type, ...],
             parameters: Parameters) -> Kernel:
    """
    Return a kernel whose functions call another kernel's.

    Parameters
    ----------
    kernel : Kernel
        The other.
    functions : tuple of callable
        Replacements for ``functions_of(kernel)``: plain Python, the same functions for the same
        kernel and kinds.
    kinds : tuple of type
        Types joined to the kernel; their names distinguish the functions from others.
    parameters : tuple
        First argument of the functions.

    """
    if kernel.compiled:
        for function in functions_of(kernel):
            # Before it is compiled into others, when numba names what has no name yet.
            identify(function)
        energy, gradient, hessian_vector = (
            _compile(function, base, kinds)
            for function, base in zip(functions, functions_of(kernel), strict=True))
    else:
        energy, gradient, hessian_vector = functions
    return kernel._replace(energy=energy, gradient=gradient, hessian_vector=hessian_vector,
                           parameters=parameters, quadratic=False)


@cache
def _compile(function: Callable[..., Any], base: Dispatcher, kinds: tuple[type, ...]
             ) -> Callable[..., Any]:
    # The name lists the composed parts, with the module of any part from elsewhere; see identify
    # and compiled_loop.
    names = ','.join(kind.__qualname__ for kind in kinds)
    foreign = [kind.__module__ for kind in kinds if not is_own(kind.__module__)]
    function.__module__ = [*foreign, base.py_func.__module__][0]
    function.__qualname__ = f'{names}({base.py_func.__qualname__})'
    # Inlined like what it calls; see the network's gradient.
    inline = base.targetoptions.get('forceinline', False)
    return numba.njit(function, error_model='numpy', forceinline=inline, no_cfunc_wrapper=True)


def _digest(*values: object) -> str:
    """Return a digest of the sources of functions, in tuples too, and of all that they call."""
    return digest_of(frozenset(function.__module__ for function in reached(*values)))


# What compiling took for each byte of the bytecode that is reached [s], 0.5 to 1.2 ms on one core
# of a server over ten scenes from an empty cache.
_SECONDS = 0.8e-3
# What takes less is not worth a line [s].
_SHORT = 1.0
_NAMES = {'advance': 'the loop over steps', 'take_substeps': 'the sub-steps',
          '_step_entry': 'a step', '_energy_entry': 'H', '_gradient_entry': 'the gradient of H',
          '_hessian_vector_entry': "products with H''"}


class _Announcer(Listener):
    """
    Listener to compilations, which reports those that are not a part of another.

    Estimates follow what those before have taken here; who is late is reported again.
    """

    def __init__(self, tell: Callable[[str], None]):
        self._tell, self._depth = tell, 0
        # Seconds expected and taken so far, of which the first second is what others took.
        self._expected, self._taken = 1.0, 1.0
        self._begin, self._seconds = 0.0, 0.0
        self._late: Timer | None = None

    def on_start(self, event: Event) -> None:
        """Announce it, if it takes long; what is found on disk comes here not at all."""
        self._depth += 1
        function = event.data['dispatcher'].py_func
        seconds = _SECONDS * sum(len(part.__code__.co_code) for part in reached(
            function, *_functions_in(event.data['args'])))
        if self._depth > 1:
            return
        self._begin, self._seconds = time.perf_counter(), seconds
        seconds *= self._taken / self._expected
        if seconds >= _SHORT:
            what = _NAMES.get(function.__name__, function.__name__)
            self._tell(f'compiling {what}, once: about {seconds:.0f} s')
            self._wait(what, seconds)

    def on_end(self, event: Event) -> None:
        """Return to the compilation that this one is a part of, or learn from its time."""
        self._depth -= 1
        if self._depth == 0:
            self.stop()
            self._expected += self._seconds
            self._taken += time.perf_counter() - self._begin

    def _wait(self, what: str, seconds: float) -> None:
        """Report, after twice the time that was expected, that it goes on."""
        def tell() -> None:
            self._tell(f'still compiling {what}: this machine is slower or busy, '
                       f'about {2.0 * seconds:.0f} s more')
            self._wait(what, 2.0 * seconds)
        self._late = Timer(2.0 * seconds, tell)
        self._late.daemon = True
        self._late.start()

    def stop(self) -> None:
        """Report no more of what goes on."""
        if self._late is not None:
            self._late.cancel()


@contextmanager
def announced(tell: Callable[[str], None]) -> Iterator[None]:
    """
    Announce each function that is compiled meanwhile, before that is begun.

    Parameters
    ----------
    tell : callable
        Takes a line: what is compiled, and an estimate of the time [s].

    """
    announcer = _Announcer(tell)
    try:
        with install_listener('numba:compile', announcer):
            yield
    finally:
        announcer.stop()


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
