# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Steps called by address: effects around a step are compiled once for all inner steps.

A step is compiled into an entry that takes addresses: of the arguments of the call, of its options
and of its workspaces. The caller reads the address of the entry and its options from its own
options, and the workspaces from its own workspaces. So the step of a method is compiled once for
all combinations of effects, and an effect once for all methods.
"""

from functools import cache
from hashlib import sha256
import re
from threading import Lock
from types import FunctionType
from typing import Any, NamedTuple

from hnn_vi_ros.integrators.base import PhasePoint, Step
from hnn_vi_ros.integrators.workspaces import MemoryByAddress
from hnn_vi_ros.kernels import (
    address_of, array_at, block, check_words, digest_of, entry_address, entry_caller, kept, Kernel,
    load, Parameters, Part, part, reached, type_of, Whole)
from numba.core import types
import numpy as np

# Entries bind these names to their own values; see _entry.
function: Any = None
inside_kind: Any = None
memory_kind: Any = None
_ENTRY: dict[str, Any] = {'nogil': True, 'no_cfunc_wrapper': True, 'pipeline_class': Whole}
# Words before the options in a block: a method has a step, or two halves of one.
_ADDRESSES = 2
_call_step = entry_caller(types.Tuple((types.int64, types.float64, types.int64)))
# Threads that ask for the same entry get the same one.
_compiling = Lock()


class StepsByAddress(NamedTuple):
    """
    Addresses of inner steps, in the options of the outer step.

    Parameters
    ----------
    words : np.ndarray of int64
        Addresses of one or two entries, then of the kernel and the options that they share. This
        kernel replaces the one of the call.

    """

    words: np.ndarray


def steps_by_address(steps: tuple[Step, ...], name: str, own: bool, kernel: Kernel,
                     options: Parameters, memory: tuple[Any, ...]) -> StepsByAddress:
    """
    Return steps, compiled, for callers that use their addresses.

    Parameters
    ----------
    steps : tuple of callable
        One or two steps, which share options and workspaces.
    name : str
        Name that distinguishes them from the steps of other methods and effects.
    own : bool
        True if all of their code is in this package, so that it can be cached on disk.
    kernel : Kernel
        Kernel by address.
    options : tuple
        Options of the steps, with compiled functions.
    memory : tuple
        Workspaces of the steps; only the type is used.

    """
    inside = kernel, options
    kinds = type_of(inside), type_of(memory)
    with _compiling:
        entries = [_entry(step, kinds, _name(step, name, kinds, options), own) for step in steps]
    words = block(inside, *entries, *[0] * (_ADDRESSES - len(steps)))
    check_words(kinds[0], words.size - _ADDRESSES)
    return StepsByAddress(words)


def memory_by_address(memory: tuple[Any, ...]) -> MemoryByAddress:
    """Return the workspaces of steps, for callers that use their addresses."""
    return MemoryByAddress(block(memory), np.array(
        [address for workspace in memory for address in _counts(workspace)], dtype=np.int64))


def _counts(workspace: Any) -> list[int]:
    """Return the addresses of the counts in a workspace that ``discard_history`` sets to zero."""
    if isinstance(workspace, MemoryByAddress):
        return workspace.counts.tolist()
    kept_group: Any = getattr(workspace, 'kept', None)
    return ([kept_group.count.ctypes.data]
            if 'count' in getattr(kept_group, '_fields', ()) else [])


@cache
def _entry(step: Step, kinds: tuple[types.Type, ...], name: str, own: bool) -> int:
    """
    Return the address of the compiled entry of a step.

    It is a copy with global names of its own; see addresses.
    """
    # The part belongs to this entry only.
    copy = Part(step, targetoptions={'forceinline': True})
    entry = FunctionType(_step_entry.__code__, {
        **globals(), 'function': copy, 'inside_kind': kinds[0], 'memory_kind': kinds[1]},
        _step_entry.__name__)
    entry.__qualname__ = name
    dispatcher: Any = kept(own, **_ENTRY)(entry)
    dispatcher.compile((types.int64, types.int64, types.float64, *[types.int64] * 13))
    (result,) = dispatcher.overloads.values()
    return entry_address(result)


def _name(step: Step, name: str, kinds: tuple[types.Type, ...], options: Parameters) -> str:
    """Return a name that is determined by all sources of an entry, the same in every process."""
    # Numba caches a function by name and code, and ignores the values of global names.
    parts = reached(step, options)
    sources = digest_of(frozenset(part.__module__ for part in parts))
    names = sorted(f'{part.__module__}.{part.__qualname__}' for part in parts)
    layout = re.sub(r' at 0x\w+', '', str(kinds))
    # A method's step and its halves share a name and come from the same sources.
    text = f'{name}/{step.__module__}.{step.__qualname__}/{layout}/{names}/{sources}'
    return f'step_{sha256(text.encode()).hexdigest()[:16]}'


def _step_entry(inside: int, memory: int, h: float, n: int, q: int, p: int, q_carry: int,
                p_carry: int, dH_dq: int, dH_dp: int, q1: int, p1: int, q1_carry: int,
                p1_carry: int, dH_dq1: int, dH_dp1: int) -> tuple[int, float, int]:
    kernel, options = load(inside, inside_kind)
    z = PhasePoint(array_at(q, n), array_at(p, n), array_at(q_carry, n), array_at(p_carry, n),
                   array_at(dH_dq, n), array_at(dH_dp, n))
    z1 = PhasePoint(array_at(q1, n), array_at(p1, n), array_at(q1_carry, n), array_at(p1_carry, n),
                    array_at(dH_dq1, n), array_at(dH_dp1, n))
    outcome, residual, spent = function(kernel, h, options, z, z1, load(memory, memory_kind))
    return outcome, residual, spent


@part(forceinline=True)
def _addresses_of(z: PhasePoint) -> tuple[int, ...]:
    return (address_of(z.q), address_of(z.p), address_of(z.q_carry), address_of(z.p_carry),
            address_of(z.dH_dq), address_of(z.dH_dp))


def _caller(k: int) -> Part:
    """Return the step that calls the k-th of its inner steps by address."""
    @part(forceinline=True)
    def step_by_address(kernel: Kernel, h: float, options: StepsByAddress, z: PhasePoint,
                        z1: PhasePoint, memory: tuple[MemoryByAddress]
                        ) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        inside = address_of(options.words) + 8 * _ADDRESSES
        return _call_step(options.words[k], (
            inside, address_of(memory[0].words), h, z.q.size,
            *_addresses_of(z), *_addresses_of(z1)))
    return step_by_address


# Replacements, in compiled code only, of one or two inner steps.
CALLERS: tuple[Part, ...] = tuple(_caller(k) for k in range(_ADDRESSES))
