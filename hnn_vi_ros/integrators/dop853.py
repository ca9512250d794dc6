# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""DOP853: an explicit pair of order 8 with internal steps of controlled size."""

import math
from typing import Any, NamedTuple

from hnn_vi_ros.hamiltonians import check_positive
from hnn_vi_ros.integrators.arithmetic import copy_array, copy_point, plus
from hnn_vi_ros.integrators.base import (
    ENDLESS, Integrator, NOT_FINITE, OK, PhasePoint, Requirements)
from hnn_vi_ros.integrators.dop853_tableau import DOP853_TABLEAU, PairTableau
from hnn_vi_ros.kernels import inlined, Kernel
import numpy as np
from numpy.polynomial import legendre

# Number of slopes: of 12 stages, at the new state, and of 3 stages for dense output.
_SLOPES, _NEW = 16, 12
# Step size control: new size over old one = 0.9 error^-alpha last_error^beta, within bounds. With
# beta > 0, a PI controller, sizes vary less and fewer steps are rejected.
_SAFETY, _ALPHA, _BETA, _LEAST, _MOST = 0.9, 0.7 / 8.0, 0.4 / 8.0, 0.2, 10.0
_LEAST_ERROR = 1e-4
# The smallest relative tolerance: below some roundings the estimate of the error is noise.
_ROUNDING = 3e-14
# Bounds on internal steps: their number in a step of the clock, and their length relative to it.
_MAX_STEPS, _SHORTEST, _LONGEST = 1_000_000, 2.0**-50, 1000.0
# A step that leaves less than this share of itself until a fixed end takes all of it.
_END_SHARE = 0.01
# h times the fastest rate of the linearised motion, beyond which stability limits steps: the
# boundary of the region of stability is 6.0 to 6.8 away from 0 in the left half plane, and sizes
# vary below it; a tolerance of 0.1 limits those of an oscillator to 3.5. The number of such steps
# after which a motion counts as stiff, and of others after which it no longer does.
_STABLE, _STIFF_STEPS, _CALM_STEPS = 5.0, 15, 6


class PairOptions(NamedTuple):
    """Relative and absolute error tolerances of internal steps, and the coefficients."""

    relative: float
    absolute: float
    tableau: PairTableau


class PairState(NamedTuple):
    """
    State from which the next step of the clock continues; n is the number of all coordinates.

    Rows of trajectories that step together have the numbers of their first coordinates.

    Parameters
    ----------
    count : np.ndarray, shape (1,)
        1 if the other arrays are valid, 0 before the first step.
    clock : np.ndarray, shape (n, 2)
        Time of the end of the last internal step minus that of the clock [s], and its rounding
        error.
    length : np.ndarray, shape (n,)
        Length of that internal step [s].
    control : np.ndarray, shape (n, 2)
        Proposed size of the next internal step [s], and error of the last one over its tolerance.
    tally : np.ndarray, shape (5,)
        Accepted and rejected internal steps, accepted ones that stability limits; consecutive
        steps beyond and within the limit of stability.
    end : PhasePoint
        State at the end of the last internal step, and the gradient there.
    path_q, path_p : np.ndarray, shape (8, n)
        Coefficients of the dense output through that step; see ``dense_value``.
    out_q, out_p : np.ndarray, shape (n,)
        State at the clock. If the next step does not start from it, an effect has changed it.

    """

    count: np.ndarray  # type: ignore[assignment]  # not tuple.count
    clock: np.ndarray
    length: np.ndarray
    control: np.ndarray
    tally: np.ndarray
    end: PhasePoint
    path_q: np.ndarray
    path_p: np.ndarray
    out_q: np.ndarray
    out_p: np.ndarray


class PairWork(NamedTuple):
    """
    Workspace of a step.

    Parameters
    ----------
    kept : PairState
        State for the next step of the clock.
    own_step : np.ndarray, shape (2,)
        Size of the step of the clock, and its rest, if the next step is a part of it; else 0 [s].
    factor : np.ndarray, shape (1,)
        Factor of the tolerances, below 1 in repetitions that are to be more accurate.
    ends_at_clock : np.ndarray, shape (1,)
        1 if internal steps end at the clock, since commands change the forces there.
    slopes_q, slopes_p : np.ndarray, shape (16, n)
        Slopes q' and -p' of all stages.
    new : PhasePoint
        New state and its gradient.
    stage : PhasePoint
        The last stage; its gradients are those of trajectories under way, one after another.
    size : np.ndarray, shape (n,)
        Size of the internal step [s].
    at_clock, ends, passes, rejected : np.ndarray of int64, shape (n,)
        1 if internal steps end at the clock, if this one does, if it passes the clock, if it
        follows a rejected one.
    streaks : np.ndarray, shape (n, 2)
        Consecutive steps beyond and within the limit of stability.
    active : np.ndarray, shape (n,)
        First coordinates of the trajectories under way.

    """

    kept: PairState
    own_step: np.ndarray
    factor: np.ndarray
    ends_at_clock: np.ndarray
    slopes_q: np.ndarray
    slopes_p: np.ndarray
    new: PhasePoint
    stage: PhasePoint
    size: np.ndarray
    at_clock: np.ndarray
    ends: np.ndarray
    passes: np.ndarray
    rejected: np.ndarray
    streaks: np.ndarray
    active: np.ndarray

    @classmethod
    def empty(cls, n: int, dtype: type = np.float64) -> 'PairWork':
        """Return the workspace for n coordinates, before the first step."""
        kept = PairState(
            np.zeros(1, dtype=np.int64), np.zeros((n, 2), dtype), np.zeros(n, dtype),
            np.zeros((n, 2), dtype),
            np.zeros(5, dtype=np.int64), PhasePoint.empty(n, dtype),
            *np.zeros((2, 8, n), dtype), *np.zeros((2, n), dtype))
        slopes: np.ndarray = np.zeros((2, _SLOPES, n), dtype)
        flags = np.zeros((4, n), dtype=np.int64)
        return cls(kept, np.zeros(2), np.ones(1), np.zeros(1, dtype=np.int64), slopes[0],
                   slopes[1], PhasePoint.empty(n, dtype), PhasePoint.empty(n, dtype),
                   np.zeros(n), flags[0], flags[1], flags[2], flags[3],
                   np.zeros((n, 2), dtype=np.int64), np.zeros(n, dtype=np.int64))


class Dop853(Integrator):
    """
    DOP853: internal steps of an explicit pair of order 8, whose error satisfies the tolerances.

    Internal steps are as long as the tolerances allow, also beyond the step of the clock, whose
    state then follows from dense output of order 7; where commands or effects change forces or
    state, they end at the clock. Neither symplectic nor symmetric: the energy drifts. Cheapest for
    short runs, and for the errors of a learned H; for long runs use a symplectic method, for high
    accuracy of formulas `taylor`, for stiff systems an implicit method.

    Parameters
    ----------
    relative_tolerance, absolute_tolerance : float
        Error of an internal step: relative [1], and in addition absolute [units of q and p].

    Raises
    ------
    ValueError
        A tolerance is not positive.

    References
    ----------
    E. Hairer, S. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, sections II.4 to
    II.6; II, section IV.2 for the control of step sizes and the test of stiffness.

    """

    order, explicit = 8, True
    tolerances = 'relative_tolerance', 'absolute_tolerance'
    useful_tolerances = 1e-14, 0.1
    requirements = Requirements(symmetric=False, symplectic=False, coordinates='any')

    def __init__(self, relative_tolerance: float = 1e-9, absolute_tolerance: float = 1e-12):
        check_positive(relative_tolerance=relative_tolerance,
                       absolute_tolerance=absolute_tolerance)
        self._options = PairOptions(relative_tolerance, absolute_tolerance, DOP853_TABLEAU)

    def scaled(self, factor: float) -> 'Dop853':
        """Return the method with its tolerances times a factor."""
        return self if factor == 1.0 else Dop853(
            factor * self._options.relative, factor * self._options.absolute)

    def options(self, attempt: int = 0, dimension: int = 1) -> PairOptions:
        """Return the tolerances and coefficients."""
        return self._options

    def own_times(self, kernel: Kernel) -> tuple[float, float]:
        """Return the time of a step of the clock, and that of a stage."""
        return 2.8e-7, 3e-8

    def memory(self, n: int, dtype: type = np.float64) -> tuple[PairWork]:
        """Return the workspace."""
        return (PairWork.empty(n, dtype),)

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: PairOptions, z: PhasePoint, z1: PhasePoint,
             memory: tuple[PairWork, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        work, d, gradients = memory[0], kernel.dimension, 0
        copy_array(work.kept.tally[3:], work.streaks[0])
        for a in range(0, z.q.size, d):
            gradients += _begin(kernel, options, z, work, a)
        outcome, spent = _to_clock(kernel, h, options, work)
        gradients += spent
        if outcome != OK:
            return outcome, 0.0, gradients
        gradients += _set_paths(kernel, options.tableau, work)
        for a in range(0, z.q.size, d):
            _store(kernel, h, z1, work, a)
        copy_array(work.streaks[0], work.kept.tally[3:])
        work.kept.count[0] = 1
        return OK, 0.0, gradients


@inlined
def _begin(kernel: Kernel, options: PairOptions, z: PhasePoint, work: PairWork, a: int) -> int:
    """Prepare the trajectory from index a on; return the number of gradients."""
    kept, b, n = work.kept, a + kernel.dimension, a + kernel.dimension - kernel.channels
    clock, control = kept.clock[a], kept.control[a]
    end, new = part_of(kept.end, a, b), part_of(work.new, a, b)
    continues = kept.count[0] > 0
    if not continues and a > 0:
        work.streaks[a, 0], work.streaks[a, 1] = 0, 0
    for i in range(a, n):
        continues = continues and z.q[i] == kept.out_q[i] and z.p[i] == kept.out_p[i]
    at_clock = work.ends_at_clock[0] > 0 or (kept.count[0] > 0 and not continues)
    work.at_clock[a], work.rejected[a], work.passes[a] = 1 if at_clock else 0, 0, 0
    gradients = 0
    if not continues:
        copy_point(part_of(z, a, b), end)
        clock[0], clock[1], kept.length[a] = 0.0, 0.0, 0.0
    if not continues or (at_clock and clock[0] == 0.0):
        kernel.gradient(kernel.parameters, end.q, end.p, end.dH_dq, end.dH_dp)
        gradients += 1
    if control[0] == 0.0:
        control[0], control[1] = _first_step(kernel, options, end, new, work), _LEAST_ERROR
        gradients += 1
    return gradients


@inlined
def _to_clock(kernel: Kernel, h: float, options: PairOptions, work: PairWork) -> tuple[int, int]:
    """
    Advance all trajectories to the clock or past it; return the outcome and number of gradients.

    Each takes its own steps, but all evaluate a stage together, until the last one arrives.
    """
    kept, active, d, gradients = work.kept, work.active, kernel.dimension, 0
    part = work.own_step[0] > 0.0
    until, longest = (work.own_step[1], work.own_step[0]) if part else (h, h)
    for _ in range(_MAX_STEPS):
        count = 0
        for a in range(0, kept.end.q.size, d):
            if kept.clock[a, 0] < h:
                active[count] = a
                count += 1
        if count == 0:
            return OK, gradients
        for r in range(count):
            a = active[r]
            size = min(kept.control[a, 0], _LONGEST * longest)
            clock = kept.clock[a]
            ends = work.at_clock[a] > 0 and clock[0] + size * (1.0 + _END_SHARE) >= until
            work.size[a] = until - clock[0] if ends else size
            work.ends[a] = 1 if ends else 0
            for k in _places(a, d):
                work.slopes_q[0, k], work.slopes_p[0, k] = kept.end.dH_dp[k], kept.end.dH_dq[k]
        for i in range(1, _NEW):
            _stage(kernel, i, options.tableau, work, count)
        gradients += (_NEW - 1) * count
        accepted = 0
        for r in range(count):
            a = active[r]
            control, size = kept.control[a], work.size[a]
            error = _error(kernel, options, work, a)
            if not error <= 1.0:
                if not size > _SHORTEST * longest:
                    return (ENDLESS if math.isfinite(error) else NOT_FINITE), gradients
                # Not finite: NaN fails every comparison.
                factor = _SAFETY * error ** -0.125 if error < math.inf else _LEAST
                control[0], work.rejected[a] = size * max(factor, _LEAST), 1
                kept.tally[1] += 1
                continue
            factor = _SAFETY * max(error, 1e-12) ** -_ALPHA * control[1] ** _BETA
            factor = min(max(factor, _LEAST), 1.0 if work.rejected[a] > 0 else _MOST)
            if work.ends[a] > 0:
                # A step that ends early says little about those that do not.
                control[0] = max(control[0], size * factor)
                kept.clock[a, 0], kept.clock[a, 1] = until, 0.0
            else:
                control[0], control[1] = size * factor, max(error, _LEAST_ERROR)
                kept.clock[a, 0], kept.clock[a, 1] = plus(kept.clock[a, 0], kept.clock[a, 1], size)
            kept.length[a], work.rejected[a] = size, 0
            work.passes[a] = 1 if kept.clock[a, 0] > h else 0
            active[accepted] = a
            accepted += 1
        _fill_gradients(kernel, work, accepted, work.new, work.new.dH_dq, work.new.dH_dp)
        gradients += accepted
        for r in range(accepted):
            a = active[r]
            _note_stiffness(kernel, work, a)
            if not work.passes[a] > 0:
                copy_point(part_of(work.new, a, a + d), part_of(kept.end, a, a + d))
    return ENDLESS, gradients


@inlined
def _store(kernel: Kernel, h: float, z1: PhasePoint, work: PairWork, a: int) -> None:
    """Fill the state at the clock, from which the time counts from now on."""
    kept, b, n = work.kept, a + kernel.dimension, a + kernel.dimension - kernel.channels
    clock, end = kept.clock[a], kept.end
    share = 1.0 - (clock[0] - h) / kept.length[a]
    for i in range(a, b):
        if clock[0] > h:
            z1.q[i], z1.q_carry[i] = dense_value(kept.path_q, share, i), 0.0
            z1.p[i], z1.p_carry[i] = dense_value(kept.path_p, share, i), 0.0
        else:
            z1.q[i], z1.q_carry[i] = end.q[i], end.q_carry[i]
            z1.p[i], z1.p_carry[i] = end.p[i], end.p_carry[i]
        kept.out_q[i], kept.out_p[i] = z1.q[i], z1.p[i]
    for i in range(n, b):
        # Channels of forces count time and work from the clock on.
        end.q[i], end.q_carry[i] = end.q[i] - z1.q[i], 0.0
        end.p[i], end.p_carry[i] = end.p[i] - z1.p[i], 0.0
        kept.path_q[0, i] -= z1.q[i]
        kept.path_p[0, i] -= z1.p[i]
    clock[0], clock[1] = plus(clock[0], clock[1], -h)


@inlined
def _fill_gradients(kernel: Kernel, work: PairWork, count: int, z: PhasePoint,
                    dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    """Fill the gradients at z of the trajectories under way."""
    d, together = kernel.dimension, work.stage
    if count * d == z.q.size:
        kernel.gradient(kernel.parameters, z.q, z.p, dH_dq, dH_dp)
    elif count > 0:
        # Carries of stages are not used.
        n = count * d
        for r in range(count):
            for k in range(d):
                a = work.active[r] + k
                together.q_carry[r * d + k], together.p_carry[r * d + k] = z.q[a], z.p[a]
        kernel.gradient(kernel.parameters, together.q_carry[:n], together.p_carry[:n],
                        together.dH_dq[:n], together.dH_dp[:n])
        for r in range(count):
            for k in range(d):
                a = work.active[r] + k
                dH_dq[a], dH_dp[a] = together.dH_dq[r * d + k], together.dH_dp[r * d + k]


@inlined
def part_of(z: PhasePoint, a: int, b: int) -> PhasePoint:
    """Return the coordinates a to b - 1 of a point."""
    return PhasePoint(z.q[a:b], z.p[a:b], z.q_carry[a:b], z.p_carry[a:b], z.dH_dq[a:b],
                      z.dH_dp[a:b])


@inlined
def _first_step(kernel: Kernel, options: PairOptions, end: PhasePoint, new: PhasePoint,
                work: PairWork) -> float:
    """Return the size of the first step [s], from the size of z, z' and z'' (section II.4)."""
    n = end.q.size - kernel.channels
    state, slope, bend = 0.0, 0.0, 0.0
    for i in range(n):
        scale_q = _scale(options, work, end.q[i], 0.0)
        scale_p = _scale(options, work, end.p[i], 0.0)
        state += (end.q[i] / scale_q) ** 2 + (end.p[i] / scale_p) ** 2
        slope += (end.dH_dp[i] / scale_q) ** 2 + (end.dH_dq[i] / scale_p) ** 2
    state, slope = math.sqrt(state / (2 * n)), math.sqrt(slope / (2 * n))
    size = 0.01 * state / slope if min(state, slope) > 1e-5 else 1e-6
    for i in range(end.q.size):
        new.q[i], new.p[i] = end.q[i] + size * end.dH_dp[i], end.p[i] - size * end.dH_dq[i]
    kernel.gradient(kernel.parameters, new.q, new.p, new.dH_dq, new.dH_dp)
    for i in range(n):
        scale_q = _scale(options, work, end.q[i], 0.0)
        scale_p = _scale(options, work, end.p[i], 0.0)
        bend += ((new.dH_dp[i] - end.dH_dp[i]) / scale_q) ** 2 \
            + ((new.dH_dq[i] - end.dH_dq[i]) / scale_p) ** 2
    steepest = max(slope, math.sqrt(bend / (2 * n)) / size)
    if steepest > 1e-15:
        return min(100.0 * size, (0.01 / steepest) ** 0.125)
    # At rest, or not finite, which the step finds.
    return max(1e-6, 1e-3 * size)


@inlined
def _scale(options: PairOptions, work: PairWork, x: float, y: float) -> float:
    """Return the tolerance of a coordinate that moves from x to y."""
    factor = work.factor[0]
    return factor * options.absolute \
        + max(factor * options.relative, _ROUNDING) * max(abs(x), abs(y))


@inlined
def _sum(weights: np.ndarray, slopes: np.ndarray, first: int, last: int, k: int) -> float:
    """Return the weighted sum of the first slope and of slopes first to last - 1."""
    total = weights[0] * slopes[0, k]
    for j in range(first, last):
        total += weights[j] * slopes[j, k]
    return total


@inlined
def _places(a: int, d: int) -> range:
    """Return d places from a on, which compiled code knows are not negative."""
    return range(np.uint64(a), np.uint64(a + d))


@inlined
def _stage(kernel: Kernel, i: int, tableau: PairTableau, work: PairWork, count: int) -> None:
    """Fill the slopes of stage i + 1 of the trajectories under way."""
    # Weights before these are zero, except for the first one.
    weights, first = tableau.stages[i], 1 if i < 5 else (3 if i < _NEW else 5)
    end, stage = work.kept.end, work.stage
    for r in range(count):
        a = work.active[r]
        size = work.size[a]
        for k in _places(a, kernel.dimension):
            stage.q[k] = end.q[k] + size * _sum(weights, work.slopes_q, first, i, k)
            stage.p[k] = end.p[k] - size * _sum(weights, work.slopes_p, first, i, k)
    _fill_gradients(kernel, work, count, stage, work.slopes_p[i], work.slopes_q[i])


@inlined
def _error(kernel: Kernel, options: PairOptions, work: PairWork, a: int) -> float:
    """Fill the new state of a trajectory; return the error of the step over the tolerance."""
    tableau, n, size = options.tableau, kernel.dimension - kernel.channels, work.size[a]
    weights, end, new = tableau.stages[_NEW], work.kept.end, work.new
    fifth, third = 0.0, 0.0
    for k in _places(a, kernel.dimension):
        new.q[k], new.q_carry[k] = plus(
            end.q[k], end.q_carry[k], size * _sum(weights, work.slopes_q, 5, _NEW, k))
        new.p[k], new.p_carry[k] = plus(
            end.p[k], end.p_carry[k], -size * _sum(weights, work.slopes_p, 5, _NEW, k))
        if k < a + n:
            scale_q = _scale(options, work, end.q[k], new.q[k])
            scale_p = _scale(options, work, end.p[k], new.p[k])
            fifth += (_sum(tableau.errors[0], work.slopes_q, 5, _NEW, k) / scale_q) ** 2 \
                + (_sum(tableau.errors[0], work.slopes_p, 5, _NEW, k) / scale_p) ** 2
            third += (_sum(tableau.errors[1], work.slopes_q, 5, _NEW, k) / scale_q) ** 2 \
                + (_sum(tableau.errors[1], work.slopes_p, 5, _NEW, k) / scale_p) ** 2
    if fifth == 0.0:
        return 0.0
    return size * fifth / math.sqrt((fifth + 0.01 * third) * (2 * n))


@inlined
def _note_stiffness(kernel: Kernel, work: PairWork, a: int) -> None:
    """
    Count steps whose size stability limits, from the last two stages, both at the end.

    The differences D between these stages are along the fastest motion. Its rate follows from

        rate^2 = (abs(D H_q) / abs(D q)) (abs(D H_p) / abs(D p)),

    which does not depend on the units of q and p, unlike the ratio of z' and z.
    """
    tally, streak, last, new = work.kept.tally, work.streaks[a], _NEW - 1, work.new
    change_q, change_p, force, velocity = 0.0, 0.0, 0.0, 0.0
    for k in _places(a, kernel.dimension - kernel.channels):
        change_q += (new.q[k] - work.stage.q[k]) ** 2
        change_p += (new.p[k] - work.stage.p[k]) ** 2
        force += (new.dH_dq[k] - work.slopes_p[last, k]) ** 2
        velocity += (new.dH_dp[k] - work.slopes_q[last, k]) ** 2
    tally[0] += 1
    if work.size[a] ** 4 * force * velocity > _STABLE ** 4 * change_q * change_p:
        streak[0], streak[1] = streak[0] + 1, 0
        if streak[0] >= _STIFF_STEPS:
            tally[2] += 1
    else:
        streak[1] += 1
        if streak[1] == _CALM_STEPS:
            streak[0] = 0


@inlined
def _set_paths(kernel: Kernel, tableau: PairTableau, work: PairWork) -> int:
    """
    Fill the coefficients of the dense output of steps that pass the clock; see ``dense_value``.

    Returns the number of gradients.
    """
    path_q, path_p, d, count = work.kept.path_q, work.kept.path_p, kernel.dimension, 0
    end, new = work.kept.end, work.new
    for a in range(0, end.q.size, d):
        if work.passes[a] > 0:
            work.active[count] = a
            count += 1
            for k in range(a, a + d):
                work.slopes_q[_NEW, k], work.slopes_p[_NEW, k] = new.dH_dp[k], new.dH_dq[k]
    for i in range(_NEW + 1, _SLOPES if count > 0 else 0):
        _stage(kernel, i, tableau, work, count)
    for r in range(count):
        a = work.active[r]
        size = work.size[a]
        for k in _places(a, d):
            _set_ends(path_q, k, end.q[k], new.q[k], size * end.dH_dp[k], size * new.dH_dp[k])
            _set_ends(path_p, k, end.p[k], new.p[k], -size * end.dH_dq[k], -size * new.dH_dq[k])
            for j in range(4):
                weights = tableau.dense[j]
                path_q[4 + j, k] = size * _sum(weights, work.slopes_q, 5, _SLOPES, k)
                path_p[4 + j, k] = -size * _sum(weights, work.slopes_p, 5, _SLOPES, k)
        copy_point(part_of(new, a, a + d), part_of(end, a, a + d))
    return 3 * count


@inlined
def _set_ends(path: np.ndarray, k: int, x0: float, x1: float, first: float, last: float) -> None:
    """Fill the coefficients that follow from the states at both ends and the slopes there."""
    rise = x1 - x0
    path[0, k], path[1, k], path[2, k] = x0, rise, first - rise
    path[3, k] = 2.0 * rise - first - last


@inlined
def dense_value(path: np.ndarray, x: float, k: int) -> float:
    """
    Return a coordinate inside a step, at x = t / h.

        c0 + x (c1 + (1 - x) (c2 + x (c3 + (1 - x) (c4 + x (c5 + (1 - x) (c6 + x c7))))))
    """
    y = 1.0 - x
    return path[0, k] + x * (path[1, k] + y * (path[2, k] + x * (path[3, k] + y * (
        path[4, k] + x * (path[5, k] + y * (path[6, k] + x * path[7, k]))))))


def path_in_legendre(path: np.ndarray, begin: float, end: float) -> np.ndarray:
    """
    Return a part of the dense output as Legendre coefficients on it, shape (8, n).

    Parameters
    ----------
    path : np.ndarray, shape (8, n)
        Coefficients for ``dense_value``.
    begin, end : float
        The part, in fractions of the internal step.

    """
    nodes, weights = legendre.leggauss(len(path))
    # Gauss quadrature of the projections is exact.
    basis = legendre.legvander(nodes, len(path) - 1) * (np.arange(len(path)) + 0.5)
    shares = begin + 0.5 * (nodes[:, None] + 1.0) * (end - begin)
    values: Any = dense_value(path, shares, slice(None))  # type: ignore[arg-type]  # vectorised
    return np.einsum('j,jk,jn->kn', weights, basis, values)
