# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Hamiltonians by address: a loop over steps is compiled once, for all Hamiltonians.

Each function of a kernel is compiled into an entry that takes addresses: of a block of memory that
contains the parameters in numba's layout, and of the arrays. The kernel that loops use instead has
one type for all Hamiltonians: its parameters are the addresses of its three entries, followed by
the block, and its functions call these entries.
"""

from collections.abc import Callable
import ctypes
import dis
from functools import cache
from hashlib import sha256
import re
from types import FunctionType
from typing import Any, NamedTuple

from hnn_vi_ros.kernels.blocks import (
    address_of, array_at, Block, check_words, entry_caller, flat, load, type_of)
from hnn_vi_ros.kernels.compilation import functions_of, kept, name_stably
from hnn_vi_ros.kernels.kernel import Kernel, Parameters
from hnn_vi_ros.kernels.linking import Part, Whole
from hnn_vi_ros.kernels.marks import is_own
from hnn_vi_ros.kernels.object_files import entry_address
from hnn_vi_ros.kernels.sources import digest_of, names_in, reached
from numba.core import types
from numba.core.dispatcher import Dispatcher
import numpy as np

# Number of array arguments of energy, gradient and hessian_vector; bytes of their addresses.
_ARRAYS, _BEFORE = (2, 4, 6), 24
# Entries bind these names to their own values; see _entry.
function: Any = None
kind: Any = None
_ENTRY: dict[str, Any] = {'nogil': True, 'no_cfunc_wrapper': True, 'error_model': 'numpy',
                          'pipeline_class': Whole}


class Target(NamedTuple):
    """
    Parameters of a kernel by address.

    Parameters
    ----------
    words : np.ndarray of int64
        Addresses of the entries of energy, gradient and hessian_vector, followed by their
        parameters. Their memory belongs to an object that keeps everything else alive.

    """

    words: np.ndarray


class _Memory(Block):
    """Memory of a target's words, with the objects that they point to."""

    kernel: Kernel
    # Substitutes for entries are kept, because machine code may be running inside them.
    late: list[Any]
    entries: 'dict[int, _Entry]'


def by_address(kernel: Kernel) -> Kernel:
    """
    Return a kernel of the same functions, of a type that all Hamiltonians share.

    Parameters
    ----------
    kernel : Kernel
        Kernel of a Hamiltonian, with or without effects; returned unchanged if it is not compiled.
        Its arrays are not copied.

    """
    if not kernel.compiled or isinstance(kernel.parameters, Target):
        return kernel
    # Three addresses, then the parameters; entries are compiled at their first call.
    words = [0, 0, 0, *flat(kernel.parameters)]
    memory = _Memory(np.array(words, dtype=np.int64).tobytes())
    memory.kernel, memory.held = kernel, kernel.parameters
    target = Target(memory.words)
    memory.late, memory.entries = [_late(memory, k) for k in range(3)], {}
    for k, call in enumerate(memory.late):
        target.words[k] = ctypes.cast(call, ctypes.c_void_p).value
    return kernel._replace(energy=energy, gradient=gradient, hessian_vector=hessian_vector,
                           parameters=target)


def provide(kernel: Kernel, *which: int) -> None:
    """
    Compile functions of a kernel by address now: 0 energy, 1 gradient, 2 hessian_vector.

    Functions that they call by address are compiled as well. Forces have no second derivatives:
    their Hessian-vector product uses differences of gradients.
    """
    target: Any = kernel.parameters
    memory = _memory_of(target)
    inner = memory.kernel.parameters
    if isinstance(inner, tuple) and inner and isinstance(inner[0], Target):
        provide(kernel._replace(parameters=inner[0]), *{*which, 1} if 2 in which else which)
    for k in which:
        if k not in memory.entries:
            function = functions_of(memory.kernel)[k]
            kind = type_of(memory.kernel.parameters)
            check_words(kind, len(target.words) - 3)
            memory.entries[k] = _entry(function, kind, _name(memory.kernel, kind, k), k)
            target.words[k] = memory.entries[k].address


def provide_all(target: Target) -> None:
    """Compile all functions at the addresses of a target, and those that they call."""
    provide(_memory_of(target).kernel._replace(parameters=target), *range(3))


def original(kernel: Kernel) -> Kernel:
    """Return the kernel whose functions are called by address; any other kernel unchanged."""
    return _memory_of(kernel.parameters).kernel if isinstance(kernel.parameters, Target) \
        else kernel


def provide_for(kernel: Kernel, step: Callable[..., Any], options: Parameters) -> None:
    """
    Compile the functions of a kernel by address that a step will call.

    Other functions are compiled when they are called. A function named ``..._tangent`` is called
    if a solver, one of the options, uses a name ``tangent``; see solvers.
    """
    functions = reached(step, options)
    solves = any(map(_takes_tangent, reached(options)))
    names = {name for function in functions
             if solves or not function.__name__.endswith('_tangent')
             for name in names_in(function.__code__)}
    provide(kernel, *(k for k, name in enumerate(Kernel._fields[:3]) if name in names))


@cache
def _takes_tangent(function: Callable[..., Any]) -> bool:
    return any(line.argval == 'tangent' and line.opname.startswith('LOAD')
               for line in dis.get_instructions(function))


def _memory_of(target: Target) -> _Memory:
    memory = Block.of(target.words)
    assert isinstance(memory, _Memory)
    return memory


def _late(memory: _Memory, k: int) -> Any:
    """Return a substitute for an entry, which compiles the entry at the first call."""
    def compile_and_call(result: int, error: int, *arguments: int) -> int:
        provide(memory.kernel._replace(parameters=Target(memory.words)), k)
        return memory.entries[k].native(result, error, *arguments)
    return _prototype(k)(compile_and_call)


@cache
def _prototype(k: int) -> Any:
    """Return the C type of an entry; the first arguments are pointers to result and exception."""
    return ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p,
                            *[ctypes.c_int64] * (_ARRAYS[k] + 2))


class _Entry:
    """The compiled entry of a function, for callers in machine code and in Python."""

    def __init__(self, dispatcher: Dispatcher, k: int):
        (result,) = dispatcher.overloads.values()
        self.call, self.address = result.entry_point, entry_address(result)
        self.native = _prototype(k)(self.address)


@cache
def _entry(function: Dispatcher, kind: types.Type, name: str, k: int) -> _Entry:
    """
    Return the compiled entry of a kernel's function for one type of parameters.

    It is a copy with global names of its own: a closure would be cached under a pickle of its
    cells, and the pickle of a compiled function differs between processes.
    """
    code = (_energy_entry, _gradient_entry, _hessian_vector_entry)[k].__code__
    options = {name: value for name, value in function.targetoptions.items()
               if name in ('fastmath', 'error_model')}
    # The part belongs to this entry only.
    copy = Part(function.py_func, targetoptions={**options, 'forceinline': True})
    entry = FunctionType(code, {**globals(), 'function': copy, 'kind': kind}, code.co_name)
    entry.__qualname__ = name
    dispatcher: Dispatcher = kept(is_own(function.py_func.__module__), **_ENTRY)(entry)
    dispatcher.compile((types.int64,) * (_ARRAYS[k] + 2))
    return _Entry(dispatcher, k)


def _name(kernel: Kernel, kind: types.Type, k: int) -> str:
    """Return a name that is determined by all sources of an entry, the same in every process."""
    # Numba caches a function by name and code, and ignores the values of global names.
    sources = digest_of(frozenset(part.__module__ for part in reached(kernel.parameters)))
    layout = re.sub(r' at 0x\w+', '', str(kind))
    text = '/'.join((name_stably(functions_of(kernel)[k]), layout, sources))
    return f'{Kernel._fields[k]}_{sha256(text.encode()).hexdigest()[:16]}'


def _energy_entry(block: int, q: int, p: int, n: int) -> float:
    # A function may return a float32 or an integer; callers read a float64.
    return np.float64(function(load(block, kind), array_at(q, n), array_at(p, n)))


def _gradient_entry(block: int, q: int, p: int, dH_dq: int, dH_dp: int, n: int) -> None:
    function(load(block, kind), array_at(q, n), array_at(p, n), array_at(dH_dq, n),
             array_at(dH_dp, n))


def _hessian_vector_entry(block: int, q: int, p: int, v_q: int, v_p: int, product_q: int,
                          product_p: int, n: int) -> None:
    function(load(block, kind), array_at(q, n), array_at(p, n), array_at(v_q, n),
             array_at(v_p, n), array_at(product_q, n), array_at(product_p, n))


_call_energy, _call = entry_caller(types.float64), entry_caller(types.none)


class _Linked(Part):
    """A function of every kernel by address; called from Python, it calls the entry."""

    def __call__(self, target: Target, *arrays: np.ndarray) -> Any:
        """Call the entry of the target's function."""
        k = _ARRAYS.index(len(arrays))
        memory = _memory_of(target)
        if k not in memory.entries:
            provide(memory.kernel._replace(parameters=target), k)
        for array in arrays:
            if array.dtype != np.float64 or array.ndim != 1 or not array.flags.c_contiguous:
                raise ValueError(f'an array has type {array.dtype} and shape {array.shape}, '
                                 'expected contiguous float64 of shape (n,)')
        return memory.entries[k].call(_address_of(target.words) + _BEFORE,
                                      *map(_address_of, arrays), arrays[0].size)


def _address_of(array: np.ndarray) -> int:
    """Return the address of an array; ``array.ctypes`` creates an object, which takes longer."""
    if array.size and array.flags.writeable:
        return ctypes.addressof(ctypes.c_char.from_buffer(array.data))
    return array.ctypes.data


def _linked(function: Callable[..., Any]) -> _Linked:
    return _Linked(function, targetoptions={'forceinline': True, 'error_model': 'numpy'})


@_linked
def energy(target: Target, q: np.ndarray, p: np.ndarray) -> float:
    """Return H(q, p) [J]; see Kernel."""
    return _call_energy(target.words[0], (
        address_of(target.words) + _BEFORE, address_of(q), address_of(p), q.size))


@_linked
def gradient(target: Target, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray, dH_dp: np.ndarray
             ) -> None:
    """Fill dH_dq and dH_dp; see Kernel."""
    _call(target.words[1], (
        address_of(target.words) + _BEFORE, address_of(q), address_of(p), address_of(dH_dq),
        address_of(dH_dp), q.size))


@_linked
def hessian_vector(target: Target, q: np.ndarray, p: np.ndarray, v_q: np.ndarray,
                   v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
    """Fill the last two with H''(q, p) (v_q, v_p); see Kernel."""
    _call(target.words[2], (
        address_of(target.words) + _BEFORE, address_of(q), address_of(p), address_of(v_q),
        address_of(v_p), address_of(product_q), address_of(product_p), q.size))


@kept(error_model='numpy')
def fill_energies(target: Target, q: np.ndarray, p: np.ndarray, energies: np.ndarray) -> None:
    """Fill H [J] at m states, of shape (m,), for q and p of shape (m d,)."""
    d = q.size // energies.size if energies.size else 1
    for i in range(energies.size):
        energies[i] = energy(target, q[i * d:(i + 1) * d], p[i * d:(i + 1) * d])
