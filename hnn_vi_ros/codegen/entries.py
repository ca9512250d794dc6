# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled functions of an exported scene, which take addresses and call no Python."""

from collections.abc import Sequence
import math
from types import FunctionType
from typing import Any, NamedTuple

from hnn_vi_ros.effects import EffectState, LARGEST
from hnn_vi_ros.integrators import (
    BEYOND, copy_array, copy_point, discard_history, IN_DOUBT, is_finite, NO_CONVERGENCE,
    NO_SOLUTION, NOT_FINITE, OK, PhasePoint)
from hnn_vi_ros.kernels import (
    array_at, inlined, Kernel, load, Parameters, Part, part, symbol_of, Whole)
from hnn_vi_ros.simulation import advance, Fallbacks, take_substeps
import numba
from numba.core import types
import numpy as np

# Kinds of the numbers of a command.
EFFORTS, POSITIONS, VELOCITIES = range(3)
# Further statuses, not of steps.
INVALID_COMMAND, INVALID_STATE, INTERNAL, EVENT = range(100, 104)
_ON_POSITION, _ON_VELOCITY = 1, 2
_OPTIONS: dict[str, Any] = {'nogil': True, 'no_cpython_wrapper': True, 'no_cfunc_wrapper': True,
                            'pipeline_class': Whole}
_advance, _take_substeps = (
    Part(loop, targetoptions={'forceinline': True}) for loop in (advance, take_substeps))
# Entries bind these names to their own values; see symbols.
kind: Any = None
add_forces: Any = None
fill_differences: Any = None
retry: Any = None
take_in_parts: Any = None


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
    state : EffectState
        State that the effects share.

    """

    kinds: np.ndarray
    columns: np.ndarray
    low: np.ndarray
    high: np.ndarray
    timeout: float
    state: EffectState


class EventTable(NamedTuple):
    """
    Events: conditions whose difference changes its sign.

    Parameters
    ----------
    directions : np.ndarray of int64, shape (k,)
        1 for changes to positive values, -1 for those to negative ones, 0 for both.
    before, now : np.ndarray, shape (k,)
        Differences at the last state, and space for those after a step.
    counts : np.ndarray, shape (k,)
        Numbers of events so far.

    """

    directions: np.ndarray
    before: np.ndarray
    now: np.ndarray
    counts: np.ndarray


class OutputTable(NamedTuple):
    """
    Sources of the outputs.

    Parameters
    ----------
    q_size, p_size : int
        Numbers of columns of q and p.
    sources : tuple of np.ndarray
        Arrays whose entries are outputs: q, p, velocities, forces of the motors, totals and
        counts of events.
    table : np.ndarray of int64, shape (m, 2)
        Source of each output, and the index in it.
    scale : np.ndarray, shape (m, 2)
        Factor and offset of each output.
    totals : np.ndarray, shape (8 + K,)
        Steps and gradients so far, residual of the last step, H, H at the start and H minus this
        and all works [J], distance from the domain of the model, steps taken by fallbacks, and
        the work of each effect.
    domain : np.ndarray, shape (4, m)
        Bounds of q and p, or of q and v: low, high, half-widths and periods; m = 0 without.
    domain_of : int
        Source of the second half: 1 for p, 2 for velocities.
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
    domain: np.ndarray
    domain_of: int
    motors: tuple[Any, ...]
    forces: np.ndarray
    keeps_gradient: int


class Machine(NamedTuple):
    """Everything that steps of a scene read and write; see advance and Rescue."""

    kernel: Kernel
    step: Any
    h: float
    options: Parameters
    z: PhasePoint
    z1: PhasePoint
    memory: tuple[Any, ...]
    fallbacks: Fallbacks
    nothing: np.ndarray
    inputs: CommandTable
    outputs: OutputTable
    events: EventTable


@part(forceinline=True)
def _words(address: int, n: int) -> np.ndarray:
    return array_at(address, n).view(np.int64)


@part(forceinline=True)
def _copy(source: int, target: int, size: int) -> int:
    own, words = _words(source, size), _words(target, size)
    for k in range(size):
        words[k] = own[k]
    return OK


def _init(state: int, image: int, size: int, pointers: int, count: int, places: int, entries: int,
          called: int) -> int:
    """Unpack the image to a state, and make its offsets addresses; see Image.packed."""
    words, targets = _words(state, size), _words(places, called)
    unpacked, packed = words.view(np.uint8), _words(image, size).view(np.uint8)
    words[:] = 0
    done = taken = 0
    while done < unpacked.size:
        unpacked[done] = packed[taken]
        if packed[taken] == 0:
            taken += 1
            done += packed[taken]
        done += 1
        taken += 1
    offsets, functions = _words(pointers, count).view(np.int32), _words(entries, called)
    for k in range(count):
        words[offsets[k]] += state
    for k in range(called):
        words[targets[k]] = functions[k]
    return OK


def _save(state: int, saved: int, first: int, size: int, digest: int) -> int:
    """Copy what changes in a state, after the digest of the object."""
    _copy(digest, saved, 1)
    return _copy(state + 8 * first, saved + 8, size - first)


def _restore(state: int, saved: int, first: int, size: int, digest: int) -> int:
    """Copy back what _save has copied, if it is of this object."""
    if _words(saved, 1)[0] != _words(digest, 1)[0]:
        return INVALID_STATE
    return _copy(saved + 8, state + 8 * first, size - first)


def _step(block: int, commands: int, n: int) -> int:
    """Apply a command, if there is one, and take n steps, or those up to an event."""
    own = load(block, kind)
    if commands != 0:
        status = _put(own, array_at(commands, own.inputs.kinds.size))
        if status != OK:
            return status
    totals, watched, taken = own.outputs.totals, own.events.before.size > 0, 0
    while taken < n:
        outcome, done, gradients, residual, _, _, _ = _advance(
            own.step, own.kernel, own.h, own.options, 0, n + 1, own.z, own.z1, own.memory,
            own.nothing, own.nothing, 1 if watched else n - taken)
        totals[1] += gradients
        totals[2] = residual
        if outcome != OK and outcome != BEYOND:
            outcome = take_in_parts(own, retry(own, outcome))
            done += outcome == OK
        taken += done
        totals[0] += done
        if outcome != OK:
            return outcome
        if watched and _happened(own, fill_differences):
            return EVENT
    return OK


@part(forceinline=True)
def _retry(own: Machine, outcome: int) -> int:
    """Retry a failed step with the later attempts of its solvers; see Rescue.take_step."""
    others, totals, last = own.fallbacks, own.outputs.totals, NO_CONVERGENCE
    kernel, step, h, _, z, z1, memory = others.step
    for options in others.attempts:
        last, _, gradients, residual, _, _, _ = _advance(
            step, kernel, h, options, 0, 2, z, z1, memory, own.nothing, own.nothing, 1)
        totals[1] += gradients
        totals[2] = totals[2] if math.isnan(residual) else residual
        if last in (OK, NO_SOLUTION):
            return last
    return last if outcome == IN_DOUBT else outcome


@part(forceinline=True)
def _take_in_parts(own: Machine, outcome: int) -> int:
    """Retry a failed step in parts; see Rescue.take_step."""
    others, totals, spent = own.fallbacks, own.outputs.totals, 0
    kernel, step, h, _, end, z1, memory = others.substep
    for i in range(others.effects):
        copy_array(others.state[i], others.before[i])
    for k in range(0 if outcome == OK else others.parts.size):
        copy_point(own.z, end)
        ok, gradients = _take_substeps(
            step, kernel, h, others.substeps[k], others.parts[k], others.most - spent, end, z1,
            memory)
        spent += gradients
        for i in range(others.effects if ok else 0, len(others.state)):
            copy_array(others.before[i], others.state[i])
        if ok:
            copy_point(end, own.z)
            discard_history(own.memory)
            totals[7] += 1.0
            outcome = OK
        if ok or spent > others.most:
            break
    totals[1] += spent
    return outcome


_fail = part(forceinline=True)(lambda own, outcome: outcome)


@part(forceinline=True)
def _happened(own: Machine, fill: Any) -> bool:
    """Count the events of a step: differences of opposite signs at its ends, or a new zero."""
    events, found = own.events, False
    _evaluate_differences(own, fill, events.now)
    for k in range(events.now.size):
        before, now = events.before[k], events.now[k]
        rises = now > 0.0 or before < 0.0
        if (before * now < 0.0 or (now == 0.0 and abs(before) > 0.0)) and (
                events.directions[k] == 0 or (events.directions[k] > 0) == rises):
            events.counts[k] += 1.0
            found = True
        events.before[k] = now
    return found


@part(forceinline=True)
def _evaluate_differences(own: Machine, fill: Any, values: np.ndarray) -> None:
    _update_velocity(own)
    fill(own.z.q, own.z.p, own.outputs.sources[2],
         own.kernel.energy(own.kernel.parameters, own.z.q, own.z.p), values)


@part(forceinline=True)
def _update_velocity(own: Machine) -> None:
    if own.outputs.keeps_gradient == 0:
        own.kernel.gradient(
            own.kernel.parameters, own.z.q, own.z.p, own.z1.dH_dq, own.z1.dH_dp)


@part(forceinline=True)
def _put(own: Machine, numbers: np.ndarray) -> int:
    """Apply a command as Simulation.set_command does; NaN leaves what it is."""
    inputs, efforts, changed = own.inputs, False, False
    for k in range(numbers.size):
        if not math.isnan(numbers[k]):
            if not inputs.low[k] <= numbers[k] <= inputs.high[k]:
                return INVALID_COMMAND
            changed, efforts = True, efforts or inputs.kinds[k] == EFFORTS
    command, now = inputs.state.command, inputs.state.clock[0]
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
                inputs.state.reference.modes[i] = _ON_VELOCITY if free else _ON_POSITION
                targets = inputs.state.reference.targets
                targets[0, i] = 0.0 if free else position
                targets[1, i] = 0.0 if math.isnan(velocity) else velocity
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
    copy_array(array_at(q, outputs.q_size), own.z.q[:outputs.q_size])
    copy_array(array_at(p, outputs.p_size), own.z.p[:outputs.p_size])
    _evaluate(own)
    _evaluate_differences(own, fill_differences, own.events.before)
    outputs.totals[4] = own.kernel.energy(own.kernel.parameters, own.z.q, own.z.p)
    return OK if is_finite(own.z) else NOT_FINITE


def _tune(state: int, size: int, block: int, numbers: int, lows: int, count: int, powers: int,
          rows: int) -> int:
    """Change numbers of the scene; NaN means its own value."""
    values, table = array_at(numbers, count), array_at(powers, 5 * rows)
    low, words, own = array_at(lows, count), array_at(state, size), load(block, kind)
    for k in range(count):
        if not (math.isnan(values[k]) or low[k] <= values[k] <= LARGEST):
            return INVALID_COMMAND
    parts, z = own.outputs, own.z
    change = -own.kernel.energy(own.kernel.parameters, z.q, z.p)
    for k in range(rows):
        # Each word with its contents in the scene, then a factor for each number in it.
        word, value = int(table[5 * k]), values[int(table[5 * k + 2])]
        before, power = table[5 * k + 3], table[5 * k + 4]
        if k == 0 or table[5 * k] != table[5 * k - 5]:
            words[word] = table[5 * k + 1]
        if not math.isnan(value):
            words[word] = value if words[word] == before and power == 1.0 else (
                words[word] * (value / before)**power)
    change += own.kernel.energy(own.kernel.parameters, z.q, z.p)
    parts.totals[4] += change if math.isfinite(change) else 0.0
    _evaluate(own)
    return OK if is_finite(z) else NOT_FINITE


def _energy(block: int) -> float:
    """Return H [J]."""
    own = load(block, kind)
    return own.kernel.energy(own.kernel.parameters, own.z.q, own.z.p)


def _outputs(block: int, values: int) -> int:
    """Fill the outputs in the order of their names."""
    own = load(block, kind)
    parts, z = own.outputs, own.z
    out, n, totals = array_at(values, parts.table.shape[0]), parts.q_size, parts.totals
    _update_velocity(own)
    parts.forces[:] = 0.0
    add_forces(parts.motors, own.inputs.state.clock[0], z.q[:n], z.p[:n], parts.sources[2][:n],
               parts.forces[0], parts.forces[1])
    totals[3] = own.kernel.energy(own.kernel.parameters, z.q, z.p)
    totals[5] = totals[3] - totals[4]
    work = own.inputs.state.work
    for k in range(work.shape[0]):
        totals[8 + k] = work[k, 0] + work[k, 1]
        totals[5] -= totals[8 + k]
    totals[6] = _outside(parts, z)
    for k in range(out.size):
        value = parts.sources[parts.table[k, 0]][parts.table[k, 1]]
        out[k] = parts.scale[k, 0] * value + parts.scale[k, 1]
    return OK


@part(forceinline=True)
def _outside(parts: OutputTable, z: PhasePoint) -> float:
    """Return the distance from the domain of the model in half-widths, 0 inside."""
    excess, d = 0.0, parts.domain.shape[1] // 2
    for k in range(2 * d):
        low, high, period = parts.domain[0, k], parts.domain[1, k], parts.domain[3, k]
        x, middle = z.q[k] if k < d else parts.sources[parts.domain_of][k - d], 0.5 * (low + high)
        if period > 0.0:
            # The revolution of an angle that is least outside.
            x = middle + (x - middle + 0.5 * period) % period - 0.5 * period
        beyond = max(low - x, x - high) / parts.domain[2, k]
        if not beyond <= excess:
            excess = beyond
    return excess


def _differences_of(conditions: Sequence[Any]) -> Any:
    """Return a function that fills in the differences of conditions."""
    fill: Any = part(forceinline=True)(lambda *_: None)
    for k, condition in enumerate(conditions):
        fill = _then(fill, inlined(condition), k)
    return fill


def _then(before: Any, condition: Any, k: int) -> Any:
    @part(forceinline=True)
    def fill(q: np.ndarray, p: np.ndarray, v: np.ndarray, H: float, values: np.ndarray) -> None:
        before(q, p, v, H, values)
        values[k] = condition((), q, p, v, H)
    return fill


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


def symbols(machine: types.Type, fallbacks: Fallbacks, motors: Sequence[type],
            conditions: Sequence[Any]) -> dict[str, str]:
    """
    Return the symbols of the compiled functions of a scene, by the name of each.

    Parameters
    ----------
    machine : numba type
        Type of its Machine.
    fallbacks : Fallbacks
        Its fallbacks.
    motors : sequence of type
        Classes of the effects that take commands and are forces.
    conditions : sequence of callable
        Functions of the events; see Condition.

    """
    found = {}
    for function in (_init, _save, _restore, _step, _start, _tune, _energy, _outputs):
        copy = FunctionType(function.__code__, {
            **globals(), 'kind': machine, 'add_forces': _forces_of(motors),
            'fill_differences': _differences_of(conditions),
            'retry': _retry if fallbacks.attempts else _fail,
            'take_in_parts': _take_in_parts if fallbacks.substeps else _fail}, function.__name__)
        name = function.__name__[1:]
        arguments = (types.int64,) * function.__code__.co_argcount
        found[name] = symbol_of(numba.njit(**_OPTIONS)(copy), *arguments)
    return found
