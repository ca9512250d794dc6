# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Steps that are cut where a coordinate meets a wall."""

from typing import Any, NamedTuple

from hnn_vi_ros.effects.base import EffectState
from hnn_vi_ros.effects.crossings import add, begin, FREE, LOST, Search, seek, TRY
from hnn_vi_ros.effects.wrapped import energy_of
from hnn_vi_ros.integrators.arithmetic import copy_point
from hnn_vi_ros.integrators.base import NO_CONVERGENCE, OK, Point, Step
from hnn_vi_ros.integrators.workspaces import forget
from hnn_vi_ros.kernels.kernel import Kernel, Parameters
from hnn_vi_ros.kernels.marks import called, inlined
import numpy as np

_EPS = float(np.finfo(np.float64).eps)
# Impacts in one step before it is given up.
_MOST_IMPACTS = 10_000
# Of the step: flights shorter than this are no longer followed one by one, where the geometric
# series of all that are left ends within the step. Their height is below 2e-11 times the way
# that the same force makes in the step.
_SHORTEST_FLIGHT = 1e-5
_NEWTON_ITERATIONS = 50


class Wall(NamedTuple):
    """
    What the step with impacts takes; see Impact.

    Parameters
    ----------
    place : int
        Of the coordinate.
    position, sign : float
        a, and 1 where the motion is free above it, -1 below.
    restitution : float
        e [1].
    search : Search
        Space for that of a crossing.
    kept : np.ndarray, shape (4, K)
        Space for what the K effects did before a part of the step, and before the step.
    cuts : np.ndarray, shape (1,)
        Impacts so far, those of trials as well.

    """

    place: int
    position: float
    sign: float
    restitution: float
    search: Search
    kept: np.ndarray
    cuts: np.ndarray


class Motion(NamedTuple):
    """Space for a velocity and an acceleration: a gradient and a product; of shape (n,)."""

    dH_dq: np.ndarray
    dH_dp: np.ndarray
    product_q: np.ndarray
    product_p: np.ndarray


class BouncingWork(NamedTuple):
    """
    The workspace of a step that is cut where it meets a wall.

    Parameters
    ----------
    start : Point
        The state that a part of the step begins with.
    motion : Motion
        For the velocity at the wall.

    """

    start: Point
    motion: Motion

    @classmethod
    def empty(cls, n: int) -> 'BouncingWork':
        """Return the workspace for n coordinates."""
        return cls(Point.empty(n), Motion(*np.zeros((4, n))))


def bounce(step: Step, high: bool) -> Step:
    """
    Return a step for one trajectory that turns a velocity at a wall; see Impact.

    Parameters
    ----------
    step : callable
        Of the method; parts of a step are steps of another length.
    high : bool
        Whether steps may be so long that the path turns round more than once in one: its
        polynomial then takes the acceleration into account as well.

    """
    @inlined
    def bouncing(kernel: Kernel, h: float, options: Parameters, z: Point, z1: Point,
                 memory: tuple[Any, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        inner, (c, position, sign, restitution, search, kept, cuts), state, effect = options
        work, inside = memory[-1], memory[:-1]
        start, motion = work.start, work.motion
        copy_point(z, start)
        draws, impacts, total = _keep(state, kept, 2), 0, 0
        rest, part, rounding = h, h, 0.0
        # Settled: what comes next is known, and the trial was taken for its state alone.
        action, wanted, settled = TRY, h, False
        speed, bend = _motion(kernel, start, c, motion, high)
        begin(search, sign * (start.q[c] - position), sign * speed, sign * bend)
        while True:
            outcome, residual, gradients = step(kernel, part, inner, start, z1, inside)
            total += gradients
            if outcome != OK:
                _put_back(state, kept, 2, draws)
                return outcome, residual, total
            distance = sign * (z1.q[c] - position)
            if state.resting[effect] > 0.0:
                if distance >= 0.0:
                    state.resting[effect] = 0.0
                    return OK, residual, total
                # What pulls it into the wall at the end held it there all the time.
                work = _turn(kernel, z1, c, position, 0.0)
                state.pending[effect] += work
                return NO_CONVERGENCE if np.isnan(work) else OK, residual, total
            if not settled:
                total += 1
                rounding = max(rounding, 4.0 * _EPS * max(abs(position), abs(z1.q[c])))
                speed, bend = _motion(kernel, z1, c, motion, high)
                add(search, part, distance, sign * speed, sign * bend, rounding, high)
                action, wanted = seek(search, h, rounding, high)
                if action == FREE:
                    wanted = rest
            if action == LOST or impacts > _MOST_IMPACTS:
                _put_back(state, kept, 2, draws)
                return NO_CONVERGENCE, residual, total
            if action == TRY or (part != wanted and wanted > 0.0):
                part, settled = wanted, action != TRY
                _put_back(state, kept, 0, draws)
            elif action == FREE:
                return OK, residual, total
            else:
                if wanted == 0.0:
                    copy_point(start, z1)
                    _put_back(state, kept, 0, draws)
                rest -= wanted
                work, rests = _meet(kernel, z1, c, position, sign, restitution, motion,
                                    rest, h, rounding)
                if np.isnan(work):
                    _put_back(state, kept, 2, draws)
                    return NO_CONVERGENCE, residual, total
                state.pending[effect] += work
                cuts[0] += 1
                state.resting[effect] = 1.0 if rests else 0.0
                if rest <= 0.0:
                    return OK, residual, total
                impacts += 1
                copy_point(z1, start)
                draws = _keep(state, kept, 0)
                speed, bend = _motion(kernel, start, c, motion, high)
                begin(search, 0.0, max(0.0, sign * speed), sign * bend)
                part, settled = rest, False
            # Steps of other lengths are no guide to the next start.
            forget(inside)
    return bouncing


@called
def _keep(state: EffectState, kept: np.ndarray, last: int) -> int:
    """Keep what the effects did so far, in every second row; return the random numbers drawn."""
    for row in range(0, last + 1, 2):
        for k in range(state.pending.size):
            kept[row, k], kept[row + 1, k] = state.pending[k], state.resting[k]
    return state.draws[1]


@called
def _put_back(state: EffectState, kept: np.ndarray, row: int, draws: int) -> None:
    """Forget what the effects did in a trial, or in the step, which is in row 2."""
    # Element by element: for slices numba compiles the texts of errors as well.
    for k in range(state.pending.size):
        state.pending[k], state.resting[k] = kept[row, k], kept[row + 1, k]
    state.draws[1] = draws


@called
def _motion(kernel: Kernel, z: Point, c: int, motion: Motion, high: bool) -> tuple[float, float]:
    """Return the velocity of a coordinate, and its acceleration or 0 if that is not asked for."""
    dH_dq, dH_dp, product_q, product_p = motion
    kernel.gradient(kernel.parameters, z.q, z.p, dH_dq, dH_dp)
    if not high:
        return dH_dp[c], 0.0
    speed = dH_dp[c]
    for i in range(z.q.size):
        dH_dq[i] = -dH_dq[i]
    # H_p changes by H'' (q', p').
    kernel.hessian_vector(kernel.parameters, z.q, z.p, dH_dp, dH_dq, product_q, product_p)
    return speed, product_p[c]


@called
def _meet(kernel: Kernel, z: Point, c: int, position: float, sign: float, restitution: float,
          motion: Motion, rest: float, h: float, rounding: float) -> tuple[float, bool]:
    """
    Turn the velocity at the wall; return the work [J], NaN where that fails, and if it rests.

    After a bounce with speed v, against the acceleration a, flights of 2 v / a, 2 e v / a, ...
    follow: they end after 2 v / (a (1 - e)). Where that is within the rest of the step, and
    the flights are too short to be followed, or lower than rounding, the body comes to rest.
    """
    work = _turn(kernel, z, c, position, restitution)
    if np.isnan(work):
        return work, False
    speed, bend = _motion(kernel, z, c, motion, True)
    speed, pull = max(0.0, sign * speed), -sign * bend
    if not pull > 0.0:
        return work, False
    flight = 2.0 * speed / pull
    ends = flight <= _SHORTEST_FLIGHT * h and flight <= (1.0 - restitution) * rest
    if not (ends or 0.25 * speed * flight <= rounding):
        return work, False
    return work + _turn(kernel, z, c, position, 0.0), True


@called
def _turn(kernel: Kernel, z: Point, c: int, position: float, restitution: float) -> float:
    """
    Set q_c on the wall and p_c so that the velocity v_c becomes -e v_c; return the work [J].

    NaN if no such momentum is found.
    """
    before = energy_of(kernel, z)
    z.q[c], z.q_carry[c] = position, 0.0
    kernel.gradient(kernel.parameters, z.q, z.p, z.dH_dq, z.dH_dp)
    speed = z.dH_dp[c]
    target = -restitution * speed
    # Of each Hessian-vector product only H_pp is of interest.
    unit, zero = np.zeros_like(z.p), np.zeros_like(z.p)
    product_q, product_p = np.zeros_like(z.p), np.zeros_like(z.p)
    unit[c] = 1.0
    previous = np.inf
    for _ in range(_NEWTON_ITERATIONS):
        error = abs(z.dH_dp[c] - target)
        if error <= _EPS * abs(speed) or (error >= previous and error <= 64 * _EPS * abs(speed)):
            return energy_of(kernel, z) - before
        previous = error
        kernel.hessian_vector(
            kernel.parameters, z.q, z.p, zero, unit, product_q, product_p)
        if not product_p[c] > 0.0:
            break
        z.p[c] -= (z.dH_dp[c] - target) / product_p[c]
        z.p_carry[c] = 0.0
        kernel.gradient(kernel.parameters, z.q, z.p, z.dH_dq, z.dH_dp)
    return np.nan
