# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Loops over the steps of a method, assembled for one Hamiltonian and the effects around it.

Without effects, a method is compiled into its loop, for all Hamiltonians. With effects, the loop
is that of Account around the outermost effect, and each effect calls the step inside it by
address: methods and effects are compiled once each, for all combinations. The same holds for the
steps that rescue failed ones, for which one loop serves all methods.
"""

from collections.abc import Callable
from typing import Any

from hnn_vi_ros.effects import Wrapped
from hnn_vi_ros.integrators import (
    CALLERS, copy_array, copy_point, discard_history, Integrator, is_finite, memory_by_address,
    MemoryByAddress, NOT_FINITE, OK, PhasePoint, Step, steps_by_address, StepsByAddress)
from hnn_vi_ros.kernels import (
    bare, clear, compiled, compiled_loop, compiled_options, entry_point, Kernel, LINK_ONLY,
    Parameters, provide_for, Target)
from numba.core import types
from numba.extending import overload
import numpy as np


def compile_discard(memory: Any) -> Callable[[Any], None]:
    """Return the implementation of `discard_history` for one type of memory, a tuple."""
    def discard_first(memory: Any) -> None:
        memory[0].kept.count[0] = 0
        discard_history(memory[1:])

    def discard_by_address(memory: Any) -> None:
        counts = memory[0].counts
        for k in range(counts.size):
            clear(counts[k])
        discard_history(memory[1:])

    def discard_rest(memory: Any) -> None:
        discard_history(memory[1:])

    def discard_none(memory: Any) -> None:
        pass

    if not len(memory):
        return discard_none
    if getattr(memory[0], 'instance_class', None) is MemoryByAddress:
        return discard_by_address
    return discard_first if _counts(memory[0]) else discard_rest


def _counts(workspace: types.Type) -> bool:
    fields = getattr(workspace, 'fields', ())
    return 'kept' in fields and 'count' in getattr(workspace[fields.index('kept')], 'fields', ())


overload(discard_history, jit_options={'forceinline': True, **LINK_ONLY})(compile_discard)


def advance(step: Callable, kernel: Kernel, h: float, options: tuple, first: int, every: int,
            z: PhasePoint, z1: PhasePoint, memory: tuple, q_out: np.ndarray, p_out: np.ndarray,
            last: int) -> tuple[int, int, int, float, int, int, int]:
    """Take steps first to last - 1, and record samples; stop before a step that fails."""
    kernel, options, z, z1, memory, q_out, p_out = bare(
        (kernel, options, z, z1, memory, q_out, p_out))
    gradients, residual, spent, most, costliest = 0, 0.0, 0, 0, first
    for done in range(first, last):
        outcome, residual, spent = step(kernel, h, options, z, z1, memory)
        gradients += spent
        if outcome == OK and not is_finite(z1):
            outcome = NOT_FINITE
        if outcome != OK:
            return outcome, done, gradients, residual, spent, most, costliest
        if spent > most:
            most, costliest = spent, done
        copy_point(z1, z)
        if (done + 1) % every == 0:
            sample = done // every
            copy_array(z.q, q_out[sample])
            copy_array(z.p, p_out[sample])
    return OK, max(first, last), gradients, residual, spent, most, costliest


def take_substeps(substep: Callable, kernel: Kernel, h: float, options: tuple, parts: int,
                  most: int, z: PhasePoint, z1: PhasePoint, memory: tuple
                  ) -> tuple[bool, int]:
    """Take a step in equal sub-steps, with at most `most` gradients; z and z1 hold the result."""
    kernel, options, z, z1, memory = bare((kernel, options, z, z1, memory))
    gradients = 0
    for _ in range(parts):
        outcome, _, spent = substep(kernel, h / parts, options, z, z1, memory)
        gradients += spent
        if outcome != OK or gradients > most or not is_finite(z1):
            return False, gradients
        copy_point(z1, z)
    kernel.gradient(kernel.parameters, z.q, z.p, z.dH_dq, z.dH_dp)
    return True, gradients + 1


class Loop:
    """
    Loop over the steps of a method, for one Hamiltonian.

    Parameters
    ----------
    loop : callable
        Loop function, such as in this module.
    kernel : Kernel
        Kernel of the Hamiltonian.
    method : Integrator
        Method with the effects around it.
    attempt : int, optional
        Index of the attempt at a step; see ``Integrator.options``.
    apart : bool, optional
        Call the step by address even without effects, for code that runs rarely: one loop serves
        all methods, and the compiled step is shared with scenes with effects.
    provide : bool, optional
        Compile the functions of H that the step calls now, not at the first call.

    Attributes
    ----------
    function : callable
        After the first run the compiled loop; the loop itself if H or the method is not compiled.

    """

    def __init__(self, loop: Callable[..., Any], kernel: Kernel, method: Integrator,
                 attempt: int = 0, apart: bool = False, provide: bool = True):
        self.function, self._kernel, self._method = loop, kernel, method
        self._apart = apart and not isinstance(method, Wrapped)
        self._compiled = kernel.compiled and method.compiled
        self._step: Callable[..., Any] = method.step
        self._options: Parameters = method.options(attempt, kernel.dimension - kernel.channels)
        self._entry: Callable[..., Any] | None = None
        self._memory: tuple[Any, ...] | None = None
        self._passed: tuple[Any, ...] = ()
        if provide and self._compiled and isinstance(kernel.parameters, Target):
            provide_for(kernel, method.step, self._options)

    def __call__(self, h: float, first: int, second: int, z: PhasePoint, z1: PhasePoint,
                 memory: tuple[Any, ...], *others: Any) -> Any:
        """Run the loop; takes its arguments except step, kernel and options."""
        if self._entry is None:
            self.compile(h, first, second, z, z1, memory, *others)
        assert self._entry is not None
        if memory is not self._memory:
            self._memory, self._passed = memory, self._taken(memory)
        return self._entry(self._step, self._kernel, h, self._options, first, second, z, z1,
                           self._passed, *others)

    def compile(  # noqa: A003
            self, h: float, first: int, second: int, z: PhasePoint, z1: PhasePoint,
            memory: tuple[Any, ...], *others: Any) -> None:
        """Compile the loop for arguments of these types, or load it from the disk cache."""
        if self._entry is not None:
            return
        if not self._compiled:
            self._entry = self.function
            return
        kernel, method = self._kernel, self._method
        if isinstance(method, Wrapped):
            outermost, options, name = _layer(kernel, method, self._options)
        elif self._apart:
            outermost, name = CALLERS[0].py_func, 'by address'
            options = _inside(kernel, method, self._options, (method.step,))
        else:
            outermost, name = method.step, method.kernel_name
            options = compiled_options(self._options)
        step = compiled(outermost, name)
        loop = compiled_loop(self.function, kernel, name, (step, options),
                             self._apart or method.own)
        entry = entry_point(loop, step, kernel, h, options, first, second, z, z1,
                            self._taken(memory), *others)
        # Assigned last: after a failed compilation the next call compiles again.
        self.function, self._step, self._options, self._entry = loop, step, options, entry

    def shared(self, h: float, z: PhasePoint, z1: PhasePoint, memory: tuple[Any, ...],
               *others: Any) -> tuple[Any, ...]:
        """Return the kernel, the compiled step, and the arguments that calls of the loop share."""
        self.compile(h, 0, 1, z, z1, memory, *others)
        # Numba warns of tuples that begin with a function.
        return self._kernel, self._step, h, self._options, z, z1, self._taken(memory)

    def _taken(self, memory: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return the workspaces in the form that the loop takes, on the same arrays."""
        if not self._compiled:
            return memory
        taken = _memory_of(self._method, memory)
        return (memory_by_address(taken),) if self._apart else taken


def _memory_of(method: Integrator, memory: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return the workspaces for a method whose steps are called by address."""
    if not isinstance(method, Wrapped):
        return memory
    return memory_by_address(_memory_of(method.inner, memory[:-1])), memory[-1]


def _layer(kernel: Kernel, method: Wrapped, options: Parameters) -> tuple[Step, Parameters, str]:
    """Return the step of an effect around steps by address, its options, and its name."""
    inner_options, *settings = options
    inside = _inside(kernel, method.inner, inner_options, method.inner_steps)
    return (method.around(CALLERS), (inside, *compiled_options(tuple(settings))),
            method.layer_name)


def _inside(kernel: Kernel, method: Integrator, options: Parameters, steps: tuple[Step, ...]
            ) -> StepsByAddress:
    """Return the steps of a method by address; with effects, the step of the outermost one."""
    if isinstance(method, Wrapped):
        step, options, name = _layer(kernel, method, options)
        steps = (step,)
    else:
        name, options = method.kernel_name, compiled_options(options)
    memory = _memory_of(method, method.memory(kernel.dimension))
    return steps_by_address(steps, name, method.own, kernel, options, memory)
