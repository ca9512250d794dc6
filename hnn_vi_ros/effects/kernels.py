# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Kernels of a Hamiltonian with effects that are added to it, or with forces.

They call the Hamiltonian by address, so that effects are compiled once for all Hamiltonians.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any, cast

from hnn_vi_ros.effects.attitudes import lift_torques
from hnn_vi_ros.effects.base import EffectState, Force, InternalForce, Joined
from hnn_vi_ros.effects.time_drive import TimeDrive
from hnn_vi_ros.integrators import largest
from hnn_vi_ros.kernels import (
    by_address, composed, Energy, Functions, functions_of, Gradient, HessianVector, inlined,
    Kernel, Parameters)
import numpy as np

# The cube root balances the truncation error of a central difference, spacing^2, with the rounding
# error, eps / spacing.
_SPACING = float(np.cbrt(np.finfo(np.float64).eps))


def add_effect(kernel: Kernel, effect: Joined, parameters: Parameters) -> Kernel:
    """Return the kernel of H with an effect added to it, resolved to parameters."""
    kernel, kind = by_address(kernel), effect.formulas(parameters)
    return composed(kernel, kind.compose(*functions_of(kernel)), (kind,),
                    (kernel.parameters, parameters, np.zeros((2, kernel.dimension))))


# The first channel for the further joints of each force, and their number.
_Further = tuple[tuple[int, int], ...]


class ByJoint:
    """Mark, in names of compiled functions, of each further joint of the force that follows it."""


def add_forces(kernel: Kernel, forces: Sequence[Force], parameters: Sequence[Parameters],
               state: EffectState, indices: Sequence[int],
               joints: Mapping[int, np.ndarray]) -> Kernel:
    """
    Return a kernel whose gradient is (H_q - f_p, H_p + f_q), extended by time and work.

    Each force adds a channel, a further coordinate and momentum: the coordinate is the time since
    the start of the step, t' = 1, the momentum is the work of the force, w' = power. So every
    method integrates both at its own nodes and to its own order, which a quadrature after the step
    would not. The first channels are those of internal variables x, one for each InternalForce:
    the coordinate, constant in a step, is added to x of EffectState.resting, whose indices are
    given, and the momentum is the change of x. ``joints`` has the columns, by index, of forces
    with a channel for each joint; those after the first follow all other channels. For rotations,
    f_p contains torques in the frame of the body; they are converted to covectors of quaternions
    before they are subtracted from H_q.
    """
    kernel = by_address(kernel)
    d, internal = kernel.dimension, sum(force.internal for force in forces)
    channels = internal + len(forces) + sum(own.size - 1 for own in joints.values())
    nested, first, more = cast(Parameters, ()), channels, [(0, 0)] * len(forces)
    for k, (force, own, i) in reversed([*enumerate(zip(
            forces, parameters, indices, strict=True))]):
        if i in joints:
            first -= joints[i].size - 1
            more[k], own = (first, joints[i].size - 1), (own, joints[i])
        nested = ((own, state.resting[i:i + 1], state.step) if force.internal else own, nested)
    kinds = tuple(type(force) for force in forces)
    functions = _with_forces(*functions_of(kernel), kinds, tuple(more))
    marks = list[type]()
    for (_, count), kind in zip(more, kinds, strict=True) if joints else ():
        marks += [*[ByJoint] * count, kind]
    rounding_q, rounding_p = (sum(parts) for parts in zip(
        kernel.gradient_scale, *(force.rounding[::-1] for force in forces), strict=True))
    space = np.zeros((12, max(d, channels)))
    differ = int(bool(kernel.rotations) or any(
        force.depends_on_state and not force.internal for force in forces))
    rotations = np.array(kernel.rotations, dtype=np.int64)
    return composed(
        kernel, functions, (*kinds, *marks),
        (kernel.parameters, nested, state.clock, space, rotations, d, channels, differ)
    )._replace(dimension=d + channels, channels=channels, internal=internal,
               gradient_scale=(rounding_q, rounding_p))


@cache
def _with_forces(base_energy: Energy, base_gradient: Gradient, base_hessian_vector: HessianVector,
                 kinds: tuple[type[Force], ...], more: _Further) -> Functions:
    internal = sum(kind.internal for kind in kinds)
    add_all = _chain(kinds, internal, 0, True, more)
    # Forces with internal variables have derivatives.
    add_others, add_tangents = (
        _chain(kinds, internal, 0, False, more), _tangents(kinds, internal, 0))
    set_time = _time_setter(kinds, internal)

    def energy(parameters: Parameters, q: np.ndarray, p: np.ndarray) -> float:
        base, forces, clock, _, _, d, _, _ = parameters
        set_time(forces, clock, q[d:])
        return base_energy(base, q[:d], p[:d])

    def gradient(parameters: Parameters, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
                 dH_dp: np.ndarray) -> None:
        base, forces, clock, space, rotations, d, channels, _ = parameters
        for a in range(0, q.size, d + channels):
            b, end = a + d, a + d + channels
            set_time(forces, clock, q[b:end])
            base_gradient(base, q[a:b], p[a:b], dH_dq[a:b], dH_dp[a:b])
            space[2:4] = 0.0
            add_all(forces, clock, q[b:end], q[a:b], p[a:b], dH_dq[a:b], dH_dp[a:b],
                    dH_dq[b:end], dH_dp[b:end], space)
            if rotations.size > 0:
                lift_torques(rotations, q[a:b], space[3])
            for i in range(d):
                dH_dq[a + i] -= space[3, i]
                dH_dp[a + i] += space[2, i]

    def hessian_vector(parameters: Parameters, q: np.ndarray, p: np.ndarray, v_q: np.ndarray,
                       v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
        # Forces are differentiated by central differences, not by formulas: only the Jacobian of
        # Newton's method uses this product, and its errors cost iterations, not accuracy.
        base, forces, clock, space, rotations, d, channels, differ = parameters
        for a in range(0, q.size, d + channels):
            b, end = a + d, a + d + channels
            set_time(forces, clock, q[b:end])
            base_hessian_vector(base, q[a:b], p[a:b], v_q[a:b], v_p[a:b],
                                product_q[a:b], product_p[a:b])
            product_q[b:end] = 0.0
            product_p[b:end] = 0.0
            # Fractions of the coordinates, and of a velocity of 1: momenta have no scale.
            size = largest(q[a:b])
            reach = max(largest(v_q[a:b]) / (size if size > 0.0 else 1.0), largest(product_p[a:b]))
            reach = reach if reach > 0.0 else largest(v_p[a:b])
            if differ and reach > 0.0:
                spacing = _SPACING / reach
                for sign in (-1.0, 1.0):
                    for i in range(d):
                        space[4, i] = q[a + i] + sign * spacing * v_q[a + i]
                        space[5, i] = p[a + i] + sign * spacing * v_p[a + i]
                    base_gradient(base, space[4, :d], space[5, :d], space[6, :d], space[7, :d])
                    space[2:4] = 0.0
                    add_others(forces, clock, q[b:end], space[4, :d], space[5, :d], space[6, :d],
                               space[7, :d], space[8], space[9], space)
                    if rotations.size > 0:
                        lift_torques(rotations, space[4, :d], space[3])
                    for i in range(d):
                        product_q[a + i] -= sign * space[3, i] / (2.0 * spacing)
                        product_p[a + i] += sign * space[2, i] / (2.0 * spacing)
            if internal > 0:
                base_gradient(base, q[a:b], p[a:b], space[6, :d], space[7, :d])
                add_tangents(forces, q[b:end], space[7, :d], v_q[b:end], product_p[a:b],
                             product_q[a:b], product_q[b:end])
    return energy, gradient, hessian_vector


@cache
def _chain(kinds: tuple[type[Force], ...], k: int, j: int, internal: bool,
           more: _Further) -> Callable[..., None]:
    """
    Return a function that adds the forces from channel k on, each with its power.

    The variables of forces with internal ones begin at channel j; without ``internal`` such
    forces are left out. The channels of further joints are constants of the compiled code, which
    halves the time of their powers.
    """
    if not kinds:
        return _add_none
    if issubclass(kinds[0], InternalForce):
        return _internal_chain(kinds, k, j, more) if internal else _without_first(
            _chain(kinds[1:], k + 1, j + 1, False, more[1:]))
    rest = _chain(kinds[1:], k + 1, j, internal, more[1:])

    @inlined
    def add_work(forces: Parameters, clock: np.ndarray, times: np.ndarray, q: np.ndarray,
                 p: np.ndarray, H_q: np.ndarray, H_p: np.ndarray, minus_power: np.ndarray,
                 pace: np.ndarray, space: np.ndarray) -> None:
        (time,), others = forces
        minus_power[k], pace[k] = -time[1], 1.0
        rest(others, clock, times, q, p, H_q, H_p, minus_power, pace, space)

    if issubclass(kinds[0], TimeDrive):
        return add_work
    add_force, (first, count) = kinds[0].add_force, more[0]

    @inlined
    def add_by_joint(forces: Parameters, clock: np.ndarray, times: np.ndarray, q: np.ndarray,
                     p: np.ndarray, H_q: np.ndarray, H_p: np.ndarray, minus_power: np.ndarray,
                     pace: np.ndarray, space: np.ndarray) -> None:
        (own, columns), others = forces
        f_q, f_p = space[0, :q.size], space[1, :q.size]
        f_q[:] = 0.0
        f_p[:] = 0.0
        add_force(own, clock[0] + (clock[1] + times[k]), q, p, H_p, f_q, f_p)
        for i in range(q.size):
            space[2, i] += f_q[i]
            space[3, i] += f_p[i]
        i = columns[0]
        # The time is in the first of its channels.
        minus_power[k], pace[k] = -(H_q[i] * f_q[i] + H_p[i] * f_p[i]), 1.0
        for n in range(count):
            i = columns[n + 1]
            minus_power[first + n] = -(H_q[i] * f_q[i] + H_p[i] * f_p[i])
            pace[first + n] = 0.0
        rest(others, clock, times, q, p, H_q, H_p, minus_power, pace, space)

    if count:
        return add_by_joint

    @inlined
    def add_all(forces: Parameters, clock: np.ndarray, times: np.ndarray, q: np.ndarray,
                p: np.ndarray, H_q: np.ndarray, H_p: np.ndarray, minus_power: np.ndarray,
                pace: np.ndarray, space: np.ndarray) -> None:
        own, others = forces
        f_q, f_p, power = space[0, :q.size], space[1, :q.size], 0.0
        f_q[:] = 0.0
        f_p[:] = 0.0
        add_force(own, clock[0] + (clock[1] + times[k]), q, p, H_p, f_q, f_p)
        for i in range(q.size):
            power += H_q[i] * f_q[i] + H_p[i] * f_p[i]
            space[2, i] += f_q[i]
            space[3, i] += f_p[i]
        minus_power[k], pace[k] = -power, 1.0
        rest(others, clock, times, q, p, H_q, H_p, minus_power, pace, space)
    return add_all


def _internal_chain(kinds: tuple[type[Force], ...], k: int, j: int, more: _Further
                    ) -> Callable[..., None]:
    respond, rest = cast(type[InternalForce], kinds[0]).respond, _chain(
        kinds[1:], k + 1, j + 1, True, more[1:])

    @inlined
    def add_all(forces: Parameters, clock: np.ndarray, times: np.ndarray, q: np.ndarray,
                p: np.ndarray, H_q: np.ndarray, H_p: np.ndarray, minus_power: np.ndarray,
                pace: np.ndarray, space: np.ndarray) -> None:
        (own, internal, step), others = forces
        column = own[0]
        force, rate = respond(own, internal[0] + times[j], H_p[column], times[k], step[0])
        space[3, column] += force
        minus_power[k], pace[k] = -force * H_p[column], 1.0
        minus_power[j], pace[j] = -rate, 0.0
        rest(others, clock, times, q, p, H_q, H_p, minus_power, pace, space)
    return add_all


def _without_first(rest: Callable[..., None]) -> Callable[..., None]:
    @inlined
    def add_all(forces: Parameters, clock: np.ndarray, times: np.ndarray, q: np.ndarray,
                p: np.ndarray, H_q: np.ndarray, H_p: np.ndarray, minus_power: np.ndarray,
                pace: np.ndarray, space: np.ndarray) -> None:
        rest(forces[1], clock, times, q, p, H_q, H_p, minus_power, pace, space)
    return add_all


@cache
def _tangents(kinds: tuple[type[Force], ...], k: int, j: int) -> Callable[..., None]:
    """Return a function that adds the tangents of forces with internal variables to products."""
    if not any(kind.internal for kind in kinds):
        return _add_none
    rest = _tangents(kinds[1:], k + 1, j + kinds[0].internal)
    tangent = getattr(kinds[0], 'respond_tangent', None)
    if tangent is None:
        @inlined
        def passed(forces: Parameters, times: np.ndarray, velocity: np.ndarray, v: np.ndarray,
                   change: np.ndarray, product: np.ndarray, rates: np.ndarray) -> None:
            rest(forces[1], times, velocity, v, change, product, rates)
        return passed

    @inlined
    def add_tangents(forces: Parameters, times: np.ndarray, velocity: np.ndarray, v: np.ndarray,
                     change: np.ndarray, product: np.ndarray, rates: np.ndarray) -> None:
        (own, internal, step), others = forces
        column = own[0]
        force, rate = tangent(own, internal[0] + times[j], velocity[column], times[k], step[0],
                              v[j], change[column])
        product[column] -= force
        rates[j] -= rate
        rest(others, times, velocity, v, change, product, rates)
    return add_tangents


@cache
def _time_setter(kinds: tuple[type[Force], ...], k: int) -> Callable[..., None]:
    """Return a function that sets the time of H(q, p, t); forces begin at channel k."""
    if TimeDrive not in kinds:
        return _add_none
    if kinds[0] is TimeDrive:
        @inlined
        def set_time(forces: Parameters, clock: np.ndarray, times: np.ndarray) -> None:
            forces[0][0][0] = clock[0] + (clock[1] + times[k])
        return set_time
    rest = _time_setter(kinds[1:], k + 1)

    @inlined
    def set_later(forces: Parameters, clock: np.ndarray, times: np.ndarray) -> None:
        rest(forces[1], clock, times)
    return set_later


@inlined
def _add_none(*_: Any) -> None:
    """End the chain of forces."""
