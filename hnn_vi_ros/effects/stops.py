# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Steps that are cut where any of several coordinates meets a stop, on which some may rest together.

As in bouncing.py, whose searches and tests these are, but for all stops of a scene at once: what
rests is held by impulses that are found together, since joints share a mass matrix, and only a
step that meets a stop takes more than one gradient at each end.
"""

from collections.abc import Callable
from typing import Any

from hnn_vi_ros.effects.bouncing import (
    keep, MOST_IMPACTS, PUSHES, put_back, Rates, SHORTEST_FLIGHT)
from hnn_vi_ros.effects.crossings import add, begin, FREE, LAND, LOST, Search, seek, TRY
from hnn_vi_ros.effects.held import (
    hold, is_in, match, OFF, ON, push, Stops, StopsWork, take_back)
from hnn_vi_ros.effects.wrapped import energy_of
from hnn_vi_ros.integrators.arithmetic import copy_point
from hnn_vi_ros.integrators.base import NO_IMPACT, OK, Point, Step
from hnn_vi_ros.integrators.workspaces import forget
from hnn_vi_ros.kernels.kernel import Kernel, Parameters
from hnn_vi_ros.kernels.marks import called, inlined
import numpy as np

_EPS = float(np.finfo(np.float64).eps)
# Of the speed of an impact: what it drives other joints by that is no rounding.
_DRIVEN = 1e-12
# Impacts in a step, for each stop, after which short flights are taken for the end of a series.
_MANY = 2


def stop(step: Step, high: bool) -> Step:
    """
    Return a step for one trajectory that turns velocities at stops; see JointLimits.

    Parameters
    ----------
    step : callable
        Of the method; parts of a step are steps of another length.
    high : bool
        Whether steps may be so long that the path turns round more than once in one.

    """
    fly = _flight(step, high)

    @inlined
    def stopping(kernel: Kernel, h: float, options: Parameters, z: Point, z1: Point,
                 memory: tuple[Any, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        _, stops, state, effect = options
        work, inside = memory[-1], memory[:-1]
        copy_point(z, work.start)
        first = draws = keep(state, stops.kept, 2)
        rest, rounding, impacts, total, met = h, 0.0, 0, 0, -1
        while True:
            _begin(kernel, stops, state.resting[effect], work, met, high)
            outcome, met, part, rounding, residual, gradients = fly(
                kernel, rest, h, options, z1, memory, rounding, draws)
            total += gradients
            rest -= part
            done, resting = 0.0, state.resting[effect]
            if outcome == OK:
                done, resting = hold(kernel, z1, stops, work)
                if met >= 0:
                    # Joints that drive each other into their stops, in flights without end.
                    ends = impacts > _MANY * stops.places.size and part <= SHORTEST_FLIGHT * h
                    done, resting = _meet(
                        kernel, z1, stops, work, met, done, resting, ends, rest, h, rounding)
            if np.isnan(done) or impacts > MOST_IMPACTS:
                outcome = NO_IMPACT
            if outcome != OK:
                put_back(state, stops.kept, 2, first)
                return outcome, residual, total
            state.pending[effect] += done
            state.resting[effect] = resting
            if met < 0:
                return OK, residual, total
            stops.cuts[0] += 1
            if rest <= 0.0:
                return OK, residual, total
            impacts += 1
            copy_point(z1, work.start)
            draws = keep(state, stops.kept, 0)
            forget(inside)
    return stopping


def _flight(step: Step, high: bool) -> Callable[..., tuple[int, int, float, float, float, int]]:
    """Return what takes the parts of a step with impacts; see stop."""
    @inlined
    def fly(kernel: Kernel, rest: float, h: float, options: Parameters, z1: Point,
            memory: tuple[Any, ...], rounding: float, draws: int
            ) -> tuple[int, int, float, float, float, int]:
        """
        Step on to where the first stop is met, or for the rest of the step h.

        Return the outcome, the stop that was met or -1, the length of this part, the rounding of a
        distance, the residual and the number of gradients. What rests on a stop meets nothing.
        """
        inner, stops, state, effect = options
        work, inside = memory[-1], memory[:-1]
        # The stops are looked at one after another; each of them only until the first that was
        # met so far.
        wanted, until, met, at, tries, total = rest, rest, -1, 0, 0, 0
        while True:
            outcome, residual, gradients = step(kernel, wanted, inner, work.start, z1, inside)
            total += gradients
            if outcome != OK:
                break
            again = False
            if state.resting[effect] > 0.0:
                again = push(kernel, wanted, z1, stops, state.resting[effect], work, tries)
                tries += 1
                if tries > PUSHES * (stops.places.size + 1):
                    outcome = NO_IMPACT
                    break
            if not again:
                if at == stops.places.size:
                    break
                _rates(kernel, z1, work.rates, high)
                total += 1
                have = wanted
                action, wanted, until, met, at, rounding = _look(
                    stops, state.resting[effect], z1, work.rates, have, until, met, at, h,
                    rounding, high)
                if action == LOST:
                    outcome = NO_IMPACT
                    break
                if action == FREE and (wanted == have or not wanted > 0.0):
                    break
                tries = 0
                take_back(kernel, work)
            put_back(state, stops.kept, 0, draws)
            # Steps of other lengths are no guide to the next start.
            forget(inside)
        if outcome == OK and not until > 0.0:
            take_back(kernel, work)
            copy_point(work.start, z1)
            put_back(state, stops.kept, 0, draws)
            for k in range(stops.places.size):
                work.touch[k] = ON if is_in(state.resting[effect], k) else OFF
        return outcome, met, until, rounding, residual, total
    return fly


@called
def _rates(kernel: Kernel, z: Point, rates: Rates, high: bool) -> None:
    """Fill the velocities H_p, and what they change by if that is asked for."""
    dH_dq, dH_dp, product_q, product_p = rates
    kernel.gradient(kernel.parameters, z.q, z.p, dH_dq, dH_dp)
    if high:
        for i in range(z.q.size):
            dH_dq[i] = -dH_dq[i]
        # H_p changes by H'' (q', p').
        kernel.hessian_vector(kernel.parameters, z.q, z.p, dH_dp, dH_dq, product_q, product_p)


@called
def _begin(kernel: Kernel, stops: Stops, resting: float, work: StopsWork, met: int, high: bool
           ) -> None:
    """Begin a part of the step: no stop pushes yet, those on which nothing rests are watched."""
    start, rates = work.start, work.rates
    for i in range(start.p.size):
        work.p[i] = start.p[i]
    _rates(kernel, start, rates, high)
    for k in range(stops.places.size):
        c, sign = stops.places[k], stops.signs[k]
        work.touch[k], work.impulse[k] = OFF, 0.0
        if is_in(resting, k):
            continue
        distance, slope = sign * (start.q[c] - stops.positions[k]), sign * rates.dH_dp[c]
        bend = sign * rates.product_p[c] if high else 0.0
        if k == met:
            distance, slope = 0.0, max(0.0, slope)
        begin(Search(stops.nodes[k], stops.count[k], stops.widths[k]), distance, slope, bend)


@called
def _look(stops: Stops, resting: float, z: Point, rates: Rates, have: float, until: float,
          met: int, at: int, h: float, rounding: float, high: bool
          ) -> tuple[int, float, float, int, int, float]:
    """
    Look for impacts, from the stop ``at`` on, by the state after a time ``have``.

    Return what is to be done and at what time, as ``seek``; the time and the stop of the first
    impact so far; at which stop to go on; and the rounding of a distance.
    """
    while at < stops.places.size:
        if is_in(resting, at):
            at += 1
            continue
        c, sign = stops.places[at], stops.signs[at]
        search = Search(stops.nodes[at], stops.count[at], stops.widths[at])
        if search.count[0] == 0 and have != until:
            # Its search begins with the state at the end of what is left.
            return TRY, until, until, met, at, rounding
        position, reached = stops.positions[at], z.q[c]
        rounding = max(rounding, 4.0 * _EPS * max(abs(position), abs(reached)))
        bend = sign * rates.product_p[c] if high else 0.0
        add(search, have, sign * (reached - position), sign * rates.dH_dp[c], bend, rounding, high)
        action, time = seek(search, h, rounding, high)
        if action in (TRY, LOST):
            return action, time, until, met, at, rounding
        if action == LAND:
            until, met = time, at
            if not until > 0.0:
                at = stops.places.size
        at += 1
    return FREE, until, until, met, stops.places.size, rounding


@called
def _meet(kernel: Kernel, z: Point, stops: Stops, work: StopsWork, met: int, done: float,
          resting: float, ends: bool, rest: float, h: float, rounding: float
          ) -> tuple[float, float]:
    """
    Turn the velocity at the stop that was met; return the work so far [J], and what rests.

    What rests on other stops stays there if the impact drives it into them, and leaves them
    otherwise. Whether the flights that follow are too short to be followed is told as for a wall
    (see bouncing.py), or by ``ends``; with e = 0 none follows.
    """
    c, sign, n = stops.places[met], stops.signs[met], work.touch.size
    before = energy_of(kernel, z)
    for k in range(n):
        work.touch[k], work.target[k] = OFF, 0.0
    kernel.gradient(kernel.parameters, z.q, z.p, z.dH_dq, z.dH_dp)
    speed = abs(z.dH_dp[c])
    work.touch[met], work.target[met] = ON, -stops.restitution * z.dH_dp[c]
    for _ in range(n + 1):
        if not match(kernel, z, stops, work):
            return np.nan, resting
        driven = False
        for k in range(n):
            if is_in(resting, k) and work.touch[k] == OFF \
                    and stops.signs[k] * z.dH_dp[stops.places[k]] < -_DRIVEN * speed:
                work.touch[k], driven = ON, True
        if not driven:
            break
    _rates(kernel, z, work.rates, True)
    kept = False
    for k in range(n):
        at, pull = stops.places[k], -stops.signs[k] * work.rates.product_p[stops.places[k]]
        leaving = stops.signs[k] * z.dH_dp[at]
        if is_in(resting, k) and leaving > _DRIVEN * speed:
            if _is_short(leaving, pull, rest, h, rounding):
                work.touch[k], kept = ON, True
            else:
                resting -= 2.0 ** k
    if kept and not match(kernel, z, stops, work):
        return np.nan, resting
    stays = stops.restitution == 0.0 or (
        ends and (stops.restitution < 1.0 or speed * h <= rounding)) or _is_short(
            max(0.0, sign * z.dH_dp[c]), -sign * work.rates.product_p[c],
            (1.0 - stops.restitution) * rest, h, rounding)
    if stays:
        work.target[met] = 0.0
        resting += 2.0 ** met
        if not match(kernel, z, stops, work):
            return np.nan, resting
    return done + energy_of(kernel, z) - before, resting


@called
def _is_short(speed: float, pull: float, left: float, h: float, rounding: float) -> bool:
    """Return whether a flight is lower than rounding, or too short to be followed."""
    if not pull > 0.0:
        return False
    flight = 2.0 * speed / pull
    return 0.25 * speed * flight <= rounding or (
        flight <= SHORTEST_FLIGHT * h and flight <= left)
