# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled functions of an exported scene, which take addresses and call no Python."""

from collections.abc import Sequence
import math
from types import FunctionType
from typing import Any, NamedTuple

from hnn_vi_ros.integrators import is_finite, NOT_FINITE, OK, PhasePoint
from hnn_vi_ros.kernels import (
    array_at, inlined, Kernel, load, Parameters, Part, part, symbol_of, Whole)
from hnn_vi_ros.simulation import advance
import numba
from numba.core import types
import numpy as np

# Kinds of the numbers of a command.
EFFORTS, POSITIONS, VELOCITIES = range(3)
# Statuses besides those of steps.
INVALID_COMMAND, INVALID_STATE, INTERNAL = 100, 101, 102
_ON_POSITION, _ON_VELOCITY = 1, 2
_OPTIONS: dict[str, Any] = {'nogil': True, 'no_cpython_wrapper': True, 'no_cfunc_wrapper': True,
                            'pipeline_class': Whole}
_advance = Part(advance, targetoptions={'forceinline': True})
# Entries bind these names to their own values; see symbols.
kind: Any = None
add_forces: Any = None


class CommandTable(NamedTuple):
    """
    Numbers of a command, and where they act.

    Parameters
    ----------
    kinds, columns : np.ndarray of int64, shape (c,)
        EFFORTS, POSITIONS or VELOCITIES; and the entry of `command`, or the column of q. The
        velocity of a joint follows its position.
    low, high : np.ndarray, shape (c,)
        Limits.
    timeout : float
        Duration of efforts [s].
    command, clock, modes, targets : np.ndarray
        See EffectState and Reference.

    """

    kinds: np.ndarray
    columns: np.ndarray
    low: np.ndarray
    high: np.ndarray
    timeout: float
    command: np.ndarray
    clock: np.ndarray
    modes: np.ndarray
    targets: np.ndarray


class OutputTable(NamedTuple):
    """
    Sources of the outputs.

    Parameters
    ----------
    q_size, p_size : int
        Numbers of columns of q and p.
    sources : tuple of np.ndarray
        Arrays of which outputs are entries: q, p, velocities, forces of the motors and totals.
    table : np.ndarray of int64, shape (m, 2)
        Source of each output, and the index in it.
    scale : np.ndarray, shape (m, 2)
        Factor and offset of each output.
    totals : np.ndarray, shape (4 + K,)
        Steps and gradients so far, residual of the last step, H [J], and the work of each effect.
    work : np.ndarray, shape (K, 2)
        See EffectState.
    motors : tuple
        Parameters of the effects that take commands.
    forces : np.ndarray, shape (2, n)
        Forces of these on q' and p'.
    keeps_gradient : int
        1 if the point holds the gradient at the state.

    """

    q_size: int
    p_size: int
    sources: tuple[np.ndarray, ...]
    table: np.ndarray
    scale: np.ndarray
    totals: np.ndarray
    work: np.ndarray
    motors: tuple[Any, ...]
    forces: np.ndarray
    keeps_gradient: int


class Machine(NamedTuple):
    """Everything that steps of a scene read and write; see advance."""

    step: Any
    kernel: Kernel
    h: float
    options: Parameters
    z: PhasePoint
    z1: PhasePoint
    memory: tuple[Any, ...]
    nothing: np.ndarray
    inputs: CommandTable
    outputs: OutputTable


@part(forceinline=True)
def _words(address: int, n: int) -> np.ndarray:
    return array_at(address, n).view(np.int64)


def _init(state: int, image: int, size: int, pointers: int, count: int, places: int, entries: int,
          called: int) -> int:
    """Copy the image to a state, and make its offsets addresses."""
    words, own = _words(state, size), _words(image, size)
    for k in range(size):
        words[k] = own[k]
    own, targets = _words(pointers, count), _words(places, called)
    for k in range(count):
        words[own[k]] += state
    own = _words(entries, called)
    for k in range(called):
        words[targets[k]] = own[k]
    return OK


def _save(state: int, saved: int, first: int, size: int, digest: int) -> int:
    """Copy what changes in a state, after a digest."""
    words, target = _words(state, size), _words(saved, 1 + size - first)
    target[0] = digest
    for k in range(first, size):
        target[1 + k - first] = words[k]
    return OK


def _restore(state: int, saved: int, first: int, size: int, digest: int) -> int:
    """Copy back what _save has copied, if it is of this object."""
    words, source = _words(state, size), _words(saved, 1 + size - first)
    if source[0] != digest:
        return INVALID_STATE
    for k in range(first, size):
        words[k] = source[1 + k - first]
    return OK


def _step(block: int, commands: int, n: int) -> int:
    """Apply a command, if there is one, and take n steps; return the status."""
    own = load(block, kind)
    if commands != 0:
        status = _put(own, array_at(commands, own.inputs.kinds.size))
        if status != OK:
            return status
    outcome, done, gradients, residual, _, _, _ = _advance(
        own.step, own.kernel, own.h, own.options, 0, n + 1, own.z, own.z1, own.memory,
        own.nothing, own.nothing, n)
    totals = own.outputs.totals
    totals[0] += done
    totals[1] += gradients
    totals[2] = residual
    return outcome


@part(forceinline=True)
def _put(own: Machine, numbers: np.ndarray) -> int:
    """Apply a command as Simulation.set_command does; NaN leaves what it is."""
    inputs, efforts, changed = own.inputs, False, False
    for k in range(numbers.size):
        if not math.isnan(numbers[k]):
            if not inputs.low[k] <= numbers[k] <= inputs.high[k]:
                return INVALID_COMMAND
            changed, efforts = True, efforts or inputs.kinds[k] == EFFORTS
    command, now = inputs.command, inputs.clock[0]
    if efforts:
        if not now < command[command.size - 1]:
            command[:] = 0.0
        command[command.size - 1] = now + inputs.timeout
    for k in range(numbers.size):
        i, kind_of_number = inputs.columns[k], inputs.kinds[k]
        if kind_of_number == EFFORTS and not math.isnan(numbers[k]):
            command[i] = numbers[k]
        elif kind_of_number == POSITIONS:
            position, velocity = numbers[k], numbers[k + 1]
            if not (math.isnan(position) and math.isnan(velocity)):
                free = math.isnan(position)
                inputs.modes[i] = _ON_VELOCITY if free else _ON_POSITION
                inputs.targets[0, i] = 0.0 if free else position
                inputs.targets[1, i] = 0.0 if math.isnan(velocity) else velocity
    if changed:
        _evaluate(own)
    return OK


@part(forceinline=True)
def _evaluate(own: Machine) -> None:
    own.kernel.gradient(own.kernel.parameters, own.z.q, own.z.p, own.z.dH_dq, own.z.dH_dp)


def _start(block: int, q: int, p: int) -> int:
    """Start from another state, at time 0, with the commands of the image."""
    own = load(block, kind)
    outputs = own.outputs
    for k in range(outputs.q_size):
        own.z.q[k] = array_at(q, outputs.q_size)[k]
    for k in range(outputs.p_size):
        own.z.p[k] = array_at(p, outputs.p_size)[k]
    _evaluate(own)
    return OK if is_finite(own.z) else NOT_FINITE


def _energy(block: int) -> float:
    """Return H [J]."""
    own = load(block, kind)
    return own.kernel.energy(own.kernel.parameters, own.z.q, own.z.p)


def _outputs(block: int, values: int) -> int:
    """Fill the outputs in the order of their names."""
    own = load(block, kind)
    parts, z = own.outputs, own.z
    out, n, totals = array_at(values, parts.table.shape[0]), parts.q_size, parts.totals
    if parts.keeps_gradient == 0:
        own.kernel.gradient(own.kernel.parameters, z.q, z.p, own.z1.dH_dq, own.z1.dH_dp)
    parts.forces[:] = 0.0
    add_forces(parts.motors, own.inputs.clock[0], z.q[:n], z.p[:n], parts.sources[2][:n],
               parts.forces[0], parts.forces[1])
    totals[3] = own.kernel.energy(own.kernel.parameters, z.q, z.p)
    for k in range(parts.work.shape[0]):
        totals[4 + k] = parts.work[k, 0] + parts.work[k, 1]
    for k in range(out.size):
        value = parts.sources[parts.table[k, 0]][parts.table[k, 1]]
        out[k] = parts.scale[k, 0] * value + parts.scale[k, 1]
    return OK


def _forces_of(kinds: Sequence[type]) -> Any:
    """Return a function that adds the forces of up to two effects that take commands."""
    first, second = [*(kind.add_force for kind in kinds),  # type: ignore[attr-defined]
                     _add_none, _add_none][:2]

    @inlined
    def add_all(motors: tuple[Any, ...], t: float, q: np.ndarray, p: np.ndarray,
                velocity: np.ndarray, f_q: np.ndarray, f_p: np.ndarray) -> None:
        first(motors[0], t, q, p, velocity, f_q, f_p)
        second(motors[1], t, q, p, velocity, f_q, f_p)
    return add_all


@inlined
def _add_none(*_: Any) -> None:
    """Add no force."""


def symbols(machine: types.Type, motors: Sequence[type]) -> dict[str, str]:
    """
    Return the symbols of the compiled functions of a scene, by the name of each.

    Parameters
    ----------
    machine : numba type
        Type of its Machine.
    motors : sequence of type
        Classes of the effects that take commands and are forces.

    """
    found = {}
    for function in (_init, _save, _restore, _step, _start, _energy, _outputs):
        copy = FunctionType(function.__code__, {
            **globals(), 'kind': machine, 'add_forces': _forces_of(motors)}, function.__name__)
        name = function.__name__[1:]
        arguments = (types.int64,) * function.__code__.co_argcount
        found[name] = symbol_of(numba.njit(**_OPTIONS)(copy), *arguments)
    return found
