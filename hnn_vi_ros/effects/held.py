# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Impulses by which several stops together hold what rests on them."""

from typing import NamedTuple

from hnn_vi_ros.effects.bouncing import HELD, Rates, STALLED
from hnn_vi_ros.effects.wrapped import energy_of
from hnn_vi_ros.integrators.base import Point
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.kernels.linear_algebra import solve_linear
from hnn_vi_ros.kernels.marks import called, inlined
import numpy as np

_EPS = float(np.finfo(np.float64).eps)
# Velocities are found to rounding, or to so many where that is all that is left.
_NEWTON_ITERATIONS, _NEAR = 50, 1e3
# Of a stop in a trial: nothing touches it, it pushes, it would have to pull and was let go.
OFF, ON, _LEFT = 0, 1, 2


class Stops(NamedTuple):
    """
    Parameters of the step with W stops; see JointLimits.

    Parameters
    ----------
    places : np.ndarray of int, shape (W,)
        Of their coordinates.
    positions, signs : np.ndarray, shape (W,)
        Where they stand, and 1 where the motion is free above, -1 below.
    restitution : float
        e [1].
    nodes, count, widths : np.ndarray, shape (W, 66, 5), (W, 2), (W, 3)
        Those of a search for each.
    kept : np.ndarray, shape (4, K)
        Space for what the K effects did before a part of the step, and before the step.
    cuts : np.ndarray, shape (1,)
        Impacts so far, those of trials as well.

    """

    places: np.ndarray
    positions: np.ndarray
    signs: np.ndarray
    restitution: float
    nodes: np.ndarray
    count: np.ndarray  # type: ignore[assignment]  # not tuple.count
    widths: np.ndarray
    kept: np.ndarray
    cuts: np.ndarray


class StopsWork(NamedTuple):
    """
    The workspace of a step with W stops.

    Parameters
    ----------
    start : Point
        The state that a part of the step begins with, with the impulses of stops.
    p : np.ndarray, shape (n,)
        Its momenta without them.
    rates : Rates
        For velocities and accelerations.
    touch : np.ndarray of int, shape (W,)
        Which stops push in this trial.
    impulse, change, target : np.ndarray, shape (W,)
        Of each stop, towards its free side; what it changed by last; the velocity that is asked.
    gap : np.ndarray, shape (3, W)
        Distances at the end of the trial, of the one before, and of the first.
    inverse, masses, matrix : np.ndarray, shape (W, W)
        What impulses change by for distances; H_pp of what touches; and space.
    right : np.ndarray, shape (2, W)
        Space.

    """

    start: Point
    p: np.ndarray
    rates: Rates
    touch: np.ndarray
    impulse: np.ndarray
    change: np.ndarray
    target: np.ndarray
    gap: np.ndarray
    inverse: np.ndarray
    masses: np.ndarray
    matrix: np.ndarray
    right: np.ndarray

    @classmethod
    def empty(cls, n: int, stops: int) -> 'StopsWork':
        """Return the workspace for n coordinates and so many stops."""
        return cls._make([
            Point.empty(n), np.zeros(n), Rates(*np.zeros((4, n))),
            np.zeros(stops, dtype=np.int64), *np.zeros((3, stops)), np.zeros((3, stops)),
            *np.zeros((3, stops, stops)), np.zeros((2, stops))])


@inlined
def is_in(resting: float, k: int) -> bool:
    """Return whether stop k is among those of a number: the sum of 2^k."""
    return (int(resting) >> k) & 1 == 1


@called
def take_back(kernel: Kernel, work: StopsWork) -> None:
    """Take the impulses of stops back."""
    start, pushed = work.start, False
    for k in range(work.touch.size):
        pushed = pushed or work.impulse[k] != 0.0
        work.touch[k], work.impulse[k] = OFF, 0.0
    if pushed:
        for i in range(start.p.size):
            start.p[i] = work.p[i]
        kernel.gradient(kernel.parameters, start.q, start.p, start.dH_dq, start.dH_dp)


@called
def push(kernel: Kernel, h: float, z: Point, stops: Stops, resting: float, work: StopsWork,
         tries: int) -> bool:
    """
    Change momenta at the start of a step so that what rests ends on its stops.

    Return whether a step from there is to be tried. By Broyden's method, from the masses at the
    start. A stop does not pull: one that a step without it leaves is left, as is one whose
    impulse would have to be negative.
    """
    touch, gap = work.touch, work.gap
    grown = False
    for k in range(touch.size):
        gap[0, k] = stops.signs[k] * (z.q[stops.places[k]] - stops.positions[k])
        if is_in(resting, k) and touch[k] == OFF and gap[0, k] < 0.0:
            touch[k], gap[2, k], grown = ON, -gap[0, k], True
    enough, any_on = True, False
    for k in range(touch.size):
        if touch[k] == ON:
            any_on = True
            size = abs(gap[0, k])
            stalled = not grown and tries > 1 and size >= 0.5 * abs(gap[1, k]) \
                and size <= STALLED * gap[2, k]
            enough = enough and (stalled or size <= HELD * _EPS * max(
                abs(stops.positions[k]), gap[2, k]))
    if not any_on:
        return False
    if enough:
        k = int(np.argmin(work.impulse))
        if work.impulse[k] >= 0.0:
            return False
        for i in range(touch.size):
            work.change[i] = -work.impulse[i] if i == k else 0.0
        touch[k] = _LEFT
        _apply(kernel, stops, work)
        _invert(kernel, h, stops, work)
        return True
    if grown:
        _invert(kernel, h, stops, work)
    else:
        _update(work)
    for i in range(touch.size):
        work.change[i] = 0.0
        for j in range(touch.size):
            if touch[i] == ON and touch[j] == ON:
                work.change[i] -= work.inverse[i, j] * gap[0, j]
    _apply(kernel, stops, work)
    return True


@called
def _apply(kernel: Kernel, stops: Stops, work: StopsWork) -> None:
    """Change the impulses, and the momenta at the start by them."""
    start = work.start
    for k in range(work.touch.size):
        work.impulse[k] += work.change[k]
        start.p[stops.places[k]] += stops.signs[k] * work.change[k]
        work.gap[1, k] = work.gap[0, k]
    kernel.gradient(kernel.parameters, start.q, start.p, start.dH_dq, start.dH_dp)


@called
def _fill_masses(kernel: Kernel, z: Point, stops: Stops, work: StopsWork) -> None:
    """Fill H_pp of what touches, towards the free sides; of what does not that of a unit mass."""
    n = work.touch.size
    zero, unit, product_q, product_p = work.rates
    for j in range(n):
        for i in range(n):
            work.masses[i, j] = 1.0 if i == j else 0.0
        if work.touch[j] != ON:
            continue
        for i in range(z.q.size):
            zero[i] = unit[i] = 0.0
        unit[stops.places[j]] = stops.signs[j]
        kernel.hessian_vector(kernel.parameters, z.q, z.p, zero, unit, product_q, product_p)
        for i in range(n):
            if work.touch[i] == ON:
                work.masses[i, j] = stops.signs[i] * product_p[stops.places[i]]


@called
def _solve(work: StopsWork) -> bool:
    """Solve with the masses for the first row of ``right``, in place."""
    for i in range(work.touch.size):
        for j in range(work.touch.size):
            work.matrix[i, j] = work.masses[i, j]
    return solve_linear(work.matrix, work.right[0]) != 0


@called
def _invert(kernel: Kernel, h: float, stops: Stops, work: StopsWork) -> None:
    """Fill the inverse of how distances at the end change with impulses: about h H_pp."""
    n = work.touch.size
    _fill_masses(kernel, work.start, stops, work)
    for column in range(n):
        for i in range(n):
            work.right[0, i] = 1.0 if i == column else 0.0
        solved = _solve(work)
        for i in range(n):
            work.inverse[i, column] = work.right[0, i] / h if solved else np.nan


@called
def _update(work: StopsWork) -> None:
    """Let the inverse give the last change for the last change of distances (Broyden)."""
    n, left, product = work.touch.size, work.right[0], 0.0
    for i in range(n):
        left[i] = work.right[1, i] = 0.0
        for j in range(n):
            if work.touch[i] == ON and work.touch[j] == ON:
                left[i] += work.change[j] * work.inverse[j, i]
                work.right[1, i] += work.inverse[i, j] * (work.gap[0, j] - work.gap[1, j])
        product += work.change[i] * work.right[1, i]
    if product == 0.0:
        return
    for i in range(n):
        for j in range(n):
            work.inverse[i, j] += (work.change[i] - work.right[1, i]) * left[j] / product


@called
def hold(kernel: Kernel, z: Point, stops: Stops, work: StopsWork) -> tuple[float, float]:
    """Take the velocities of what is held on stops; return the work [J], and which they are."""
    resting, pushed = 0.0, False
    for k in range(work.touch.size):
        work.target[k] = 0.0
        if work.touch[k] == ON:
            resting += 2.0 ** k
        pushed = pushed or work.impulse[k] != 0.0
    if resting == 0.0:
        return 0.0, 0.0
    done = -energy_of(kernel, z)
    if pushed:
        done += energy_of(kernel, work.start)
        # The state before the impulses, by what is no longer of use.
        for i in range(work.p.size):
            work.start.p[i], work.p[i] = work.p[i], work.start.p[i]
        done -= energy_of(kernel, work.start)
    if not match(kernel, z, stops, work):
        return np.nan, resting
    return done + energy_of(kernel, z), resting


@called
def match(kernel: Kernel, z: Point, stops: Stops, work: StopsWork) -> bool:
    """
    Put what touches on its stops, with momenta by which it has the velocities of the targets.

    Return whether such momenta were found.
    """
    for k in range(work.touch.size):
        if work.touch[k] == ON:
            z.q[stops.places[k]], z.q_carry[stops.places[k]] = stops.positions[k], 0.0
    kernel.gradient(kernel.parameters, z.q, z.p, z.dH_dq, z.dH_dp)
    scale, previous = 0.0, np.inf
    for i in range(kernel.dimension - kernel.channels):
        scale = max(scale, abs(z.dH_dp[i]))
    for _ in range(_NEWTON_ITERATIONS):
        error = 0.0
        for k in range(work.touch.size):
            work.right[0, k] = 0.0
            if work.touch[k] == ON:
                work.right[0, k] = stops.signs[k] * (work.target[k] - z.dH_dp[stops.places[k]])
                error = max(error, abs(work.right[0, k]))
        if error <= _EPS * scale or (error >= previous and error <= _NEAR * _EPS * scale):
            return True
        previous = error
        _fill_masses(kernel, z, stops, work)
        if not _solve(work):
            return False
        for k in range(work.touch.size):
            if work.touch[k] == ON:
                c = stops.places[k]
                z.p[c], z.p_carry[c] = z.p[c] + stops.signs[k] * work.right[0, k], 0.0
        kernel.gradient(kernel.parameters, z.q, z.p, z.dH_dq, z.dH_dp)
    return False
