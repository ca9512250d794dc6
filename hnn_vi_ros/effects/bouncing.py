# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Steps that are cut where a coordinate meets a wall."""

from collections.abc import Callable
from typing import Any, NamedTuple

from hnn_vi_ros.effects.base import EffectState, Place, StepEffect
from hnn_vi_ros.effects.crossings import add, begin, FREE, LAND, LOST, Search, seek, TRY
from hnn_vi_ros.effects.wrapped import energy_of
from hnn_vi_ros.integrators.arithmetic import copy_point
from hnn_vi_ros.integrators.base import Integrator, NO_IMPACT, OK, Point, Step
from hnn_vi_ros.integrators.workspaces import forget
from hnn_vi_ros.kernels.kernel import Kernel, Parameters
from hnn_vi_ros.kernels.marks import called, inlined
import numpy as np

_EPS = float(np.finfo(np.float64).eps)
# Impacts in one step before it is given up.
MOST_IMPACTS = 10_000
# Of the step: flights shorter than this are no longer followed one by one, where the geometric
# series of all that are left ends within the step. Their height is below 2e-11 times the way
# that the same force makes in the step.
SHORTEST_FLIGHT = 1e-5
_NEWTON_ITERATIONS = 50
# What a body at rest needs of the wall in a step is found to so many roundings, by so many trials
# at most; or to this share of how far it would sink in, where rounding keeps it from more.
HELD, PUSHES, STALLED = 8.0, 30, 1e-9


class Bouncing(StepEffect):
    """Step effect that turns velocities where coordinates meet something rigid."""

    acts, repeats, lockstep = Place.OUTSIDE, True, False
    excludes = {Place.MANIFOLD: 'off which its impulses would lead'}

    def accepts(self, integrator: Integrator) -> bool:
        """Return whether the method's energy does not drift from impact to impact: order >= 2."""
        needs = integrator.requirements
        return needs.hamiltonian and integrator.order >= 2 and needs.from_state

    @staticmethod
    def inner_step(integrator: Integrator) -> tuple[Step, bool]:
        """Return the method's step, and whether it is good for steps of more than a turn."""
        return integrator.step, integrator.order > 2


class Wall(NamedTuple):
    """
    Parameters of the step with impacts; see Impact.

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


class Rates(NamedTuple):
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
    rates : Rates
        For the velocity at the wall.
    push : np.ndarray, shape (5,)
        Of a body that rests on the wall in this step: trials so far, the last change of p_c,
        where q_c ended before it, as a distance, and first of all; H before all changes.

    """

    start: Point
    rates: Rates
    push: np.ndarray

    @classmethod
    def empty(cls, n: int) -> 'BouncingWork':
        """Return the workspace for n coordinates."""
        return cls(Point.empty(n), Rates(*np.zeros((4, n))), np.zeros(5))


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
    fly = _flight(step, high)

    @inlined
    def bouncing(kernel: Kernel, h: float, options: Parameters, z: Point, z1: Point,
                 memory: tuple[Any, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        _, wall, state, effect = options
        (start, rates, push), inside = memory[-1], memory[:-1]
        copy_point(z, start)
        first = draws = keep(state, wall.kept, 2)
        rest, rounding, impacts, total = h, 0.0, 0, 0
        slope, bend = _slopes(kernel, start, wall, rates, high)
        begin(wall.search, wall.sign * (start.q[wall.place] - wall.position), slope, bend)
        while True:
            outcome, met, part, rounding, residual, gradients = fly(
                kernel, rest, h, options, z1, memory, rounding, draws)
            total += gradients
            rest -= part
            work, rests = 0.0, False
            if outcome == OK and met:
                work, rests = _meet(kernel, z1, wall, rates, rest, h, rounding)
            elif outcome == OK and state.resting[effect] > 0.0:
                work, rests = _hold(kernel, start, z1, wall, push)
            if np.isnan(work) or (impacts > MOST_IMPACTS and not rests):
                outcome = NO_IMPACT
            if outcome != OK:
                put_back(state, wall.kept, 2, first)
                return outcome, residual, total
            state.pending[effect] += work
            state.resting[effect] = 1.0 if rests else 0.0
            if not met:
                return OK, residual, total
            wall.cuts[0] += 1
            if rest <= 0.0:
                return OK, residual, total
            impacts += 1
            copy_point(z1, start)
            draws = keep(state, wall.kept, 0)
            slope, bend = _slopes(kernel, start, wall, rates, high)
            begin(wall.search, 0.0, max(0.0, slope), bend)
            forget(inside)
    return bouncing


def _flight(step: Step, high: bool) -> Callable[..., tuple[int, bool, float, float, float, int]]:
    """Return what takes the parts of a step with impacts; see bounce."""
    @inlined
    def fly(kernel: Kernel, rest: float, h: float, options: Parameters, z1: Point,
            memory: tuple[Any, ...], rounding: float, draws: int
            ) -> tuple[int, bool, float, float, float, int]:
        """
        Step on to where the wall is met, or for the rest of the step h.

        Return the outcome, whether the wall was met, the length of this part, the rounding of a
        distance, the residual and the number of gradients. What rests on the wall meets nothing.
        """
        inner, wall, state, effect = options
        (start, rates, push), inside = memory[-1], memory[:-1]
        # Once it is known what comes next, a step of that length is taken for its state alone.
        action, part, total = FREE if state.resting[effect] > 0.0 else TRY, rest, 0
        push[0] = 0.0
        while True:
            outcome, residual, gradients = step(kernel, part, inner, start, z1, inside)
            total += gradients
            if outcome == OK and state.resting[effect] > 0.0 and _push(
                    kernel, part, start, z1, wall, rates, push):
                if push[0] > PUSHES:
                    outcome = NO_IMPACT
                    break
                put_back(state, wall.kept, 0, draws)
                forget(inside)
                continue
            if outcome != OK or action != TRY:
                break
            total += 1
            position, reached = wall.position, z1.q[wall.place]
            rounding = max(rounding, 4.0 * _EPS * max(abs(position), abs(reached)))
            slope, bend = _slopes(kernel, z1, wall, rates, high)
            add(wall.search, part, wall.sign * (reached - position), slope, bend, rounding, high)
            action, wanted = seek(wall.search, h, rounding, high)
            if action == LOST:
                outcome = NO_IMPACT
                break
            if action == FREE:
                wanted = rest
            enough = action != TRY and (part == wanted or not wanted > 0.0)
            part = wanted
            if enough:
                break
            put_back(state, wall.kept, 0, draws)
            # Steps of other lengths are no guide to the next start.
            forget(inside)
        if outcome == OK and action == LAND and part == 0.0:
            copy_point(start, z1)
            put_back(state, wall.kept, 0, draws)
        return outcome, action == LAND, part, rounding, residual, total
    return fly


@called
def keep(state: EffectState, kept: np.ndarray, last: int) -> int:
    """Keep what the effects did so far, in every second row; return the random numbers drawn."""
    # Element by element: for slices numba compiles the texts of errors as well.
    for row in range(0, last + 1, 2):
        for k in range(state.pending.size):
            kept[row, k], kept[row + 1, k] = state.pending[k], state.resting[k]
    return state.draws[1]


@called
def put_back(state: EffectState, kept: np.ndarray, row: int, draws: int) -> None:
    """Forget what the effects did in a part of the step, in row 0, or in the step, in row 2."""
    for k in range(state.pending.size):
        state.pending[k], state.resting[k] = kept[row, k], kept[row + 1, k]
    state.draws[1] = draws


@called
def _slopes(kernel: Kernel, z: Point, wall: Wall, rates: Rates, high: bool
            ) -> tuple[float, float]:
    """Return the rates of the distance to the wall: g', and g'' or 0 if that is not asked for."""
    dH_dq, dH_dp, product_q, product_p = rates
    kernel.gradient(kernel.parameters, z.q, z.p, dH_dq, dH_dp)
    slope = wall.sign * dH_dp[wall.place]
    if not high:
        return slope, 0.0
    for i in range(z.q.size):
        dH_dq[i] = -dH_dq[i]
    # H_p changes by H'' (q', p').
    kernel.hessian_vector(kernel.parameters, z.q, z.p, dH_dp, dH_dq, product_q, product_p)
    return slope, wall.sign * product_p[wall.place]


@called
def _meet(kernel: Kernel, z: Point, wall: Wall, rates: Rates, rest: float, h: float,
          rounding: float) -> tuple[float, bool]:
    """
    Turn the velocity at the wall; return the work [J], NaN where that fails, and if it rests.

    After a bounce with speed v, against the acceleration a, flights of 2 v / a, 2 e v / a, ...
    follow: they end after 2 v / (a (1 - e)). Where that is within the rest of the step, and
    the flights are too short to be followed, or lower than rounding, the body comes to rest.
    """
    work = _turn(kernel, z, wall, wall.restitution)
    if np.isnan(work):
        return work, False
    slope, bend = _slopes(kernel, z, wall, rates, True)
    speed, pull = max(0.0, slope), -bend
    if not pull > 0.0:
        return work, False
    flight = 2.0 * speed / pull
    ends = flight <= SHORTEST_FLIGHT * h and flight <= (1.0 - wall.restitution) * rest
    if not (ends or 0.25 * speed * flight <= rounding):
        return work, False
    return work + _turn(kernel, z, wall, 0.0), True


@called
def _push(kernel: Kernel, h: float, start: Point, z: Point, wall: Wall, rates: Rates,
          push: np.ndarray) -> bool:
    """
    Change p_c at the start of a step so that q_c ends on the wall, by the secant method.

    Return whether a step from there is to be tried: not if the last one ended on the wall; nor
    if the first one, without the wall, left it. With what ``_hold`` takes at the end this is the
    method of Shake and Rattle: of order 2, where putting q_c back after a step is of order 1.
    """
    c, zero, unit = wall.place, rates.dH_dq, rates.dH_dp
    gap = z.q[c] - wall.position
    if push[0] == 0.0:
        if wall.sign * gap >= 0.0:
            return False
        for i in range(z.q.size):
            zero[i] = unit[i] = 0.0
        unit[c] = 1.0
        kernel.hessian_vector(kernel.parameters, start.q, start.p, zero, unit,
                              rates.product_q, rates.product_p)
        slope = h * rates.product_p[c]
        push[3], push[4] = gap, energy_of(kernel, start)
    else:
        enough = abs(gap) <= HELD * _EPS * max(abs(wall.position), abs(push[3]))
        stalled = abs(gap) >= 0.5 * abs(push[2]) and abs(gap) <= STALLED * abs(push[3])
        if enough or stalled:
            return False
        slope = (gap - push[2]) / push[1]
    push[0], push[1], push[2] = push[0] + 1.0, -gap / slope, gap
    start.p[c] += push[1]
    return True


@called
def _hold(kernel: Kernel, start: Point, z: Point, wall: Wall, push: np.ndarray
          ) -> tuple[float, bool]:
    """Take the velocity of what was held on the wall; return its work [J], and if it rests."""
    if push[0] == 0.0:
        return 0.0, False
    return energy_of(kernel, start) - push[4] + _turn(kernel, z, wall, 0.0), True


@called
def _turn(kernel: Kernel, z: Point, wall: Wall, restitution: float) -> float:
    """
    Set q_c on the wall and p_c so that the velocity v_c becomes -e v_c; return the work [J].

    NaN if no such momentum is found.
    """
    before, c = energy_of(kernel, z), wall.place
    z.q[c], z.q_carry[c] = wall.position, 0.0
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
