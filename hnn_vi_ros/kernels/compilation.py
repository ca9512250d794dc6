# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Compile a loop over steps of a Hamiltonian into machine code, cached for all processes."""

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
# Keyed by the function and the types of its arguments.
_entries: dict[Any, Callable[..., Any]] = {}


def kept(own: bool = True, **options: Any) -> Callable[[_Function], _Function]:
    """
    Return a decorator that compiles a function of this package, also for callers in Python.

    The cache on disk is valid as long as none of the sources of the function changes; numba itself
    only checks the function's own file.

    Parameters
    ----------
    own : bool, optional
        True if all its code is in this package; other code is compiled in each process.
    options
        Options of numba.njit.

    """
    def compile_(function: _Function) -> _Function:
        return (keep if own else aside)(numba.njit(**options)(function))
    return compile_


@cache
def compiled(function: Callable[..., Any], name: str) -> Part:
    """
    Return a function compiled by numba, with a cached dispatcher.

    Parameters
    ----------
    function : callable
        Plain Python in numba's subset.
    name : str
        Name that is unique among all compiled functions, in any process.

    """
    dispatcher = Part(function, targetoptions={'forceinline': True})
    name_stably(dispatcher, name)
    return dispatcher


@cache
def dispatcher(function: _Function) -> _Function:
    """Return a function of a Hamiltonian's kernel compiled, for Python and for other code."""
    return function if isinstance(function, Dispatcher) else kept(error_model='numpy')(function)


def entry_point(function: Callable[..., Any], *arguments: object) -> Callable[..., Any]:
    """
    Return a callable for arguments of exactly these types.

    For a dispatcher it is the compiled code without numba's look-up of the types, which for
    arguments of many arrays takes ten times as long as the call; other functions are returned
    unchanged.
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
    """Return options of a step with each function in them, at any depth, compiled."""
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
    Return a loop over steps, to be compiled for one Hamiltonian and one method.

    Parameters
    ----------
    loop : callable
        A loop of the module loops.
    kernel : Kernel
        Kernel of the Hamiltonian. If all its functions are in this package, the compiled code is
        cached for later processes; changes of other functions could not be detected.
    method : str
        Name of the method's step.
    parts : tuple, optional
        The step and its options; the compiled code changes with the sources of their functions.
    own : bool, optional
        True if all code of the step is in this package.

    """
    functions = functions_of(kernel)
    if not (own and all(is_own(function.py_func.__module__) for function in functions)):
        return _uncached(loop)
    return _cached(loop, *(name_stably(function) for function in functions), method,
                   _digest(loop, parts))


@cache
def _uncached(loop: _Function) -> _Function:
    return aside(numba.njit(loop, **_LOOP))


@cache
def _cached(loop: Callable[..., Any], *names: str) -> Callable[..., Any]:
    # With a name of its own it has its own index on disk. With one index for all, reading any
    # kernel would rebuild the functions of all others, even from older sources.
    copy = FunctionType(loop.__code__, loop.__globals__, loop.__name__)
    digest = sha256('/'.join(names).encode()).hexdigest()
    copy.__qualname__ = f'{loop.__name__}_{digest[:16]}'
    return keep(numba.njit(copy, **_LOOP))


def name_stably(dispatcher: Dispatcher, name: str = '') -> str:
    """Set a name of a compiled function that is the same in every process; return the function."""
    # A function passed to a compiled one is part of its signature, by which numba looks up its
    # cache on disk. Numba identifies such a function by a random number, new in each process; with
    # a name that changes with the sources the look-up succeeds.
    function = dispatcher.py_func
    # The name is set once, even if several threads request it at the same time.
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
        The inner kernel.
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
            # Before it is compiled into others, when numba assigns a random name.
            name_stably(function)
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
    # The name lists the composed parts, with the module of any part from outside; see identify and
    # compiled_loop.
    names = ','.join(kind.__qualname__ for kind in kinds)
    foreign = [kind.__module__ for kind in kinds if not is_own(kind.__module__)]
    function.__module__ = [*foreign, base.py_func.__module__][0]
    function.__qualname__ = f'{names}({base.py_func.__qualname__})'
    # Inlined like the functions it calls; see the network's gradient.
    inline = base.targetoptions.get('forceinline', False)
    return numba.njit(function, error_model='numpy', forceinline=inline, no_cfunc_wrapper=True)


def _digest(*values: object) -> str:
    """Return a digest of the sources of functions, also in tuples, and of all that they call."""
    return digest_of(frozenset(function.__module__ for function in reached(*values)))


# Compile time per byte of reached bytecode [s], 0.5 to 1.2 ms on one core of a server over ten
# scenes from an empty cache.
_SECONDS_PER_BYTE = 0.8e-3
# Shortest compile time that is announced [s].
_MIN_ANNOUNCED_SECONDS = 1.0
_NAMES = {'advance': 'the loop over steps', 'take_substeps': 'the sub-steps',
          '_step_entry': 'a step', '_energy_entry': 'H', '_gradient_entry': 'the gradient of H',
          '_hessian_vector_entry': "products with H''"}


class _Announcer(Listener):
    """
    Listener that reports outermost compilations.

    Estimates are scaled by earlier compilations; a late compilation is reported again.
    """

    def __init__(self, tell: Callable[[str], None]):
        self._tell, self._depth = tell, 0
        # Total of expected and measured seconds, starting with 1 s each from the default.
        self._expected, self._taken = 1.0, 1.0
        self._begin, self._seconds = 0.0, 0.0
        self._late: Timer | None = None

    def on_start(self, event: Event) -> None:
        """Announce a long compilation; code found on disk does not cause this event."""
        self._depth += 1
        function = event.data['dispatcher'].py_func
        seconds = _SECONDS_PER_BYTE * sum(len(part.__code__.co_code) for part in reached(
            function, *_functions_in(event.data['args'])))
        if self._depth > 1:
            return
        self._begin, self._seconds = time.perf_counter(), seconds
        seconds *= self._taken / self._expected
        if seconds >= _MIN_ANNOUNCED_SECONDS:
            what = _NAMES.get(function.__name__, 'the simulation')
            self._tell(f'compiling {what} once: about {seconds:.0f} s')
            self._wait(what, seconds)

    def on_end(self, event: Event) -> None:
        """Leave a nested compilation, or update the estimate from the measured time."""
        self._depth -= 1
        if self._depth == 0:
            self.stop()
            self._expected += self._seconds
            self._taken += time.perf_counter() - self._begin

    def _wait(self, what: str, seconds: float) -> None:
        """Report that it continues, after twice the expected time."""
        def tell() -> None:
            self._tell(f'still compiling {what}: this machine is slow or busy; '
                       f'about {2.0 * seconds:.0f} s more')
            self._wait(what, 2.0 * seconds)
        self._late = Timer(2.0 * seconds, tell)
        self._late.daemon = True
        self._late.start()

    def stop(self) -> None:
        """Stop reporting the present compilation."""
        if self._late is not None:
            self._late.cancel()


@contextmanager
def announced(tell: Callable[[str], None]) -> Iterator[None]:
    """
    Announce each function that is compiled inside the context, before it is compiled.

    Parameters
    ----------
    tell : callable
        Receives a line: the function, and an estimate of the time [s].

    """
    announcer = _Announcer(tell)
    try:
        with install_listener('numba:compile', announcer):
            yield
    finally:
        announcer.stop()


class NotKept(Exception):
    """Raised instead of compiling code that is not cached on disk."""


class _Refuser(Listener):
    """Listener that refuses compilations in the thread that created it."""

    def __init__(self) -> None:
        self._thread = get_ident()

    def on_start(self, event: Event) -> None:
        """Refuse the compilation; code found on disk does not cause this event."""
        if get_ident() == self._thread:
            raise NotKept

    def on_end(self, event: Event) -> None:
        """Do nothing: no compilation was started."""


@contextmanager
def kept_only() -> Iterator[None]:
    """Raise NotKept if this thread would compile a function inside the context."""
    with install_listener('numba:compile', _Refuser()):
        yield


def _functions_in(kinds: tuple[types.Type, ...]) -> Iterator[Callable[..., Any]]:
    """Yield the compiled functions among types of arguments, also in tuples."""
    for kind in kinds:
        if isinstance(kind, types.Dispatcher):
            yield kind.dispatcher.py_func
        elif isinstance(kind, types.BaseTuple):
            yield from _functions_in(kind.types)
