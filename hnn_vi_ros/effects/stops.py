# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Rigid stops: steps are cut at impacts, and impulses hold resting coordinates.

All stops of an effect are treated together. Joints share a mass matrix, so that an impact at one
stop changes the velocities at the others, and the impulses that hold several joints are coupled. A
step without an impact costs one more gradient at each end, for the velocities there.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, ClassVar, NamedTuple

from hnn_vi_ros.effects.base import EffectState, Place, StepEffect
from hnn_vi_ros.effects.crossings import (
    add_trial, begin_search, FREE, LAND, LOST, next_trial, Search, TRY)
from hnn_vi_ros.effects.wrapped import energy_of
from hnn_vi_ros.hamiltonians import check_between, Hamiltonian
from hnn_vi_ros.integrators import (
    copy_point, discard_history, Integrator, NO_IMPACT, OK, PhasePoint, Step)
from hnn_vi_ros.kernels import called, inlined, Kernel, Parameters, solve_linear
import numpy as np

_EPS = float(np.finfo(np.float64).eps)
# A step with more impacts than this fails. An elastic body that bounces forever must neither be
# brought to rest nor pass through the stop.
MOST_IMPACTS = 10_000
# Flights shorter than this fraction of the step are not followed individually if the geometric
# series of all remaining flights ends within the step. Such a flight reaches less than 3e-11 of
# the distance that the same acceleration covers in a step, so following it would only add cost.
_SHORTEST_FLIGHT = 1e-5
# After this many impacts per stop in a step, short flights count as the end of a series: joints
# that drive each other into their stops would otherwise bounce without end.
_MAX_FOLLOWED = 2
# Other joints count as driven by an impact above this fraction of its speed; less is rounding.
_MIN_DRIVEN_SHARE = 1e-12
# A coordinate is held if it ends within _HELD_ROUNDINGS of its stop. If rounding prevents that, a
# fraction _STALLED_SHARE of the first depth is accepted, because the velocity is exact either way.
# Each stop has at most _MAX_PUSHES trials.
_HELD_ROUNDINGS, _STALLED_SHARE, _MAX_PUSHES = 8.0, 1e-9, 30
# Velocities are iterated to rounding; a larger error, up to _ROUNDINGS, is accepted only if the
# iteration no longer reduces it.
_MAX_NEWTON_ITERATIONS, _ROUNDINGS = 50, 1e3
# State of a stop in a trial: not touched, pushing, or released because it would have to pull.
_OFF, _ON, _RELEASED = 0, 1, 2


class Stops(NamedTuple):
    """
    Parameters of a step with W stops.

    Parameters
    ----------
    columns : np.ndarray of int, shape (W,)
        Columns of their coordinates in q.
    positions : np.ndarray, shape (W,)
        Positions of the stops, in the units of the coordinates.
    signs : np.ndarray, shape (W,)
        1 where the motion is free above the stop, -1 where it is free below.
    restitution : float
        e [1].
    nodes, counts, widths : np.ndarray, shape (W, 66, 5), (W, 2), (W, 3)
        One ``Search`` for each stop.
    kept : np.ndarray, shape (4, K)
        Copies of the pending work and the internal variables of the K effects, before the present
        part of the step and before the step.
    kept_on : np.ndarray of int, shape (2, E, S)
        Copies of EffectState.on_stops, likewise.
    cuts : np.ndarray, shape (1,)
        Impacts so far, including impacts in trials.

    """

    columns: np.ndarray
    positions: np.ndarray
    signs: np.ndarray
    restitution: float
    nodes: np.ndarray
    counts: np.ndarray
    widths: np.ndarray
    kept: np.ndarray
    kept_on: np.ndarray
    cuts: np.ndarray

    @classmethod
    def of(cls, columns: np.ndarray, positions: np.ndarray, signs: np.ndarray,
           restitution: float, state: EffectState) -> 'Stops':
        """Return W stops with their workspace, in a scene with this state."""
        return cls(columns, positions, signs, restitution, *Search.several(columns.size),
                   np.zeros((4, state.pending.size)),
                   np.zeros((2, *state.on_stops.shape), dtype=np.int64),
                   np.zeros(1, dtype=np.int64))


class Rates(NamedTuple):
    """Arrays of shape (n,) for a gradient and a Hessian-vector product."""

    dH_dq: np.ndarray
    dH_dp: np.ndarray
    product_q: np.ndarray
    product_p: np.ndarray


class StopsWork(NamedTuple):
    """
    Workspace of a step with W stops.

    Parameters
    ----------
    start : Point
        State at the beginning of the present part of the step, with the impulses of stops.
    p : np.ndarray, shape (n,)
        The momenta of ``start`` without the impulses.
    rates : Rates
        Velocities and accelerations.
    touch : np.ndarray of int, shape (W,)
        _OFF, _ON or _RELEASED for each stop.
    impulse, change, target : np.ndarray, shape (W,)
        The impulse of each stop towards its free side, its last change, and the target velocity of
        the coordinate.
    gap : np.ndarray, shape (3, W)
        Distances at the end of this trial, of the previous trial, and of the first.
    inverse, masses, matrix : np.ndarray, shape (W, W)
        Changes of impulses for changes of distances; H_pp of the touched stops; workspace.
    right : np.ndarray, shape (2, W)
        Right-hand sides.

    """

    start: PhasePoint
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
        """Return the workspace for n coordinates and a number of stops."""
        return cls._make([
            PhasePoint.empty(n), np.zeros(n), Rates(*np.zeros((4, n))),
            np.zeros(stops, dtype=np.int64), *np.zeros((3, stops)), np.zeros((3, stops)),
            *np.zeros((3, stops, stops)), np.zeros((2, stops))])


class RigidContact(StepEffect):
    """
    An effect whose parameters are ``Stops``, which change velocities v to -e v.

    Parameters
    ----------
    restitution : float
        e, from 0 to 1 [1].

    Attributes
    ----------
    beyond : str
        Clause of the error for an initial state on the wrong side of a stop.

    """

    acts, repeats, batched, stops, passive = Place.OUTSIDE, True, False, True, True
    excludes = {Place.MANIFOLD: 'because its impulses would violate the constraints'}
    beyond: ClassVar[str]

    def __init__(self, restitution: float):
        check_between(0, 1, restitution=restitution)
        self.restitution, self.conservative = float(restitution), restitution == 1.0

    def accepts(self, integrator: Integrator) -> bool:
        """Return True if the energy of the method does not drift from impact to impact."""
        # The error of a method of order 1 is h at each impact, always with the same sign.
        needs = integrator.requirements
        return needs.hamiltonian and integrator.order >= 2 and needs.from_state

    def check_state(self, hamiltonian: Hamiltonian, parameters: Stops, q: np.ndarray) -> None:
        """Raise ValueError if a coordinate of q, shape (d,), is on the wrong side of a stop."""
        for column, position, sign in zip(
                parameters.columns, parameters.positions, parameters.signs, strict=True):
            if sign * (q[column] - position) < 0.0:
                raise ValueError(f'the initial {hamiltonian.coordinates[column].name} = '
                                 f'{float(q[column])!r} is {self.beyond} {float(position)!r}')

    @staticmethod
    def inner_step(integrator: Integrator) -> tuple[Step, bool]:
        """Return the method's step, and True if the path may turn more than once in a step."""
        return integrator.step, integrator.order > 2

    @staticmethod
    def workspace(n: int, settings: tuple[Any, ...]) -> StopsWork:
        """Return the workspace of a step with the stops of the settings."""
        return StopsWork.empty(n, settings[0].columns.size)

    @staticmethod
    @cache
    def wrap(step: tuple[Step, bool], keeps_gradient: bool) -> Step:
        """Return the step, cut into parts by impacts."""
        return stop(*step)


def stop(step: Step, high: bool) -> Step:
    """
    Return a step for one trajectory that reverses velocities at stops.

    Each impact in a step is located on the polynomial through the step, then by steps of the
    method that end on the stop to round-off, also if the path crosses the stop and returns within
    the step. Between impacts the method takes steps, symplectic if it is.

    Parameters
    ----------
    step : callable
        Step of the method; parts of a step are steps of another length.
    high : bool
        True if the path may turn more than once in a step. The polynomial then also matches
        accelerations.

    """
    fly = _flight(step, high)

    @inlined
    def stopping(kernel: Kernel, h: float, options: Parameters, z: PhasePoint, z1: PhasePoint,
                 memory: tuple[Any, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        _, stops, state, effect = options
        work, inside = memory[-1], memory[:-1]
        copy_point(z, work.start)
        resting = state.on_stops[effect]
        first = draws = _save_account(state, stops, 2)
        rest, rounding, impacts, total, met = h, 0.0, 0, 0, -1
        while True:
            _begin(kernel, stops, resting, work, met, high)
            outcome, met, part, rounding, residual, gradients = fly(
                kernel, rest, h, options, z1, memory, rounding, draws)
            total += gradients
            rest -= part
            done = 0.0
            if outcome == OK:
                done = _hold(kernel, z1, stops, resting, work)
                if met >= 0:
                    ends = (impacts > _MAX_FOLLOWED * stops.columns.size
                            and part <= _SHORTEST_FLIGHT * h)
                    done = _bounce(
                        kernel, z1, stops, work, met, done, resting, ends, rest, h, rounding)
            if np.isnan(done) or impacts > MOST_IMPACTS:
                outcome = NO_IMPACT
            if outcome != OK:
                _restore_account(state, stops, 2, first)
                return outcome, residual, total
            state.pending[effect] += done
            if met < 0:
                return OK, residual, total
            stops.cuts[0] += 1
            if rest <= 0.0:
                return OK, residual, total
            impacts += 1
            copy_point(z1, work.start)
            draws = _save_account(state, stops, 0)
            discard_history(inside)
    return stopping


def _flight(step: Step, high: bool) -> Callable[..., tuple[int, int, float, float, float, int]]:
    """Return the function that takes the parts of a step; see stop."""
    @inlined
    def fly(kernel: Kernel, rest: float, h: float, options: Parameters, z1: PhasePoint,
            memory: tuple[Any, ...], rounding: float, draws: int
            ) -> tuple[int, int, float, float, float, int]:
        """
        Step to the first impact, or for the rest of the step h.

        Return the outcome, the stop that was met or -1, the length of this part, the rounding of
        a distance, the residual and the number of gradients. A stop is not searched while its
        coordinate rests on it.
        """
        inner, stops, state, effect = options
        work, inside, resting = memory[-1], memory[:-1], state.on_stops[effect]
        # The stops are searched one after another, each only up to the earliest impact so far.
        wanted, until, met, tries, total = rest, rest, -1, 0, 0
        at = _next_free(resting, 0, stops.columns.size)
        while True:
            outcome, residual, gradients = step(kernel, wanted, inner, work.start, z1, inside)
            total += gradients
            if outcome != OK:
                break
            again = False
            if resting.any():
                again = _push(kernel, wanted, z1, stops, resting, work, tries)
                tries += 1
                if tries > _MAX_PUSHES * (stops.columns.size + 1):
                    outcome = NO_IMPACT
                    break
            if not again:
                if at == stops.columns.size:
                    break
                _fill_held_rates(kernel, z1, stops, work, high)
                total += 1
                have = wanted
                action, wanted, until, met, at, rounding = _find_impact(
                    stops, resting, z1, work.rates, have, until, met, at, h,
                    rounding, high)
                if action == LOST:
                    outcome = NO_IMPACT
                    break
                if action == FREE and (wanted == have or not wanted > 0.0):
                    break
                tries = 0
                _remove_impulses(kernel, work)
            _restore_account(state, stops, 0, draws)
            # Solutions of trials of another length are bad initial guesses for the next one.
            discard_history(inside)
        if outcome == OK and not until > 0.0:
            _remove_impulses(kernel, work)
            copy_point(work.start, z1)
            _restore_account(state, stops, 0, draws)
            for k in range(stops.columns.size):
                work.touch[k] = _ON if resting[k] else _OFF
        return outcome, met, until, rounding, residual, total
    return fly


@inlined
def _next_free(resting: np.ndarray, k: int, count: int) -> int:
    """Return the first stop from k on that nothing rests on; ``count`` if there is none."""
    while k < count and resting[k]:
        k += 1
    return k


@called
def _save_account(state: EffectState, stops: Stops, last: int) -> int:
    """Copy the account of the effects to rows 0 to ``last``; return the random numbers drawn."""
    # Copied element by element: for slices, numba also compiles error messages.
    for row in range(0, last + 1, 2):
        for k in range(state.pending.size):
            stops.kept[row, k], stops.kept[row + 1, k] = state.pending[k], state.resting[k]
        for k in range(state.on_stops.shape[0]):
            for i in range(state.on_stops.shape[1]):
                stops.kept_on[row // 2, k, i] = state.on_stops[k, i]
    return state.draws[1]


@called
def _restore_account(state: EffectState, stops: Stops, row: int, draws: int) -> None:
    """Restore the account of the effects before a part of the step (row 0) or the step (2)."""
    for k in range(state.pending.size):
        state.pending[k], state.resting[k] = stops.kept[row, k], stops.kept[row + 1, k]
    for k in range(state.on_stops.shape[0]):
        for i in range(state.on_stops.shape[1]):
            state.on_stops[k, i] = stops.kept_on[row // 2, k, i]
    state.draws[1] = draws


@called
def _fill_rates(kernel: Kernel, z: PhasePoint, rates: Rates, high: bool) -> None:
    """Fill the velocities H_p, and their rates of change if ``high``."""
    dH_dq, dH_dp, product_q, product_p = rates
    kernel.gradient(kernel.parameters, z.q, z.p, dH_dq, dH_dp)
    if high:
        for i in range(z.q.size):
            dH_dq[i] = -dH_dq[i]
        # The rate of H_p is the lower half of H'' (q', p').
        kernel.hessian_vector(kernel.parameters, z.q, z.p, dH_dp, dH_dq, product_q, product_p)


@called
def _fill_held_rates(kernel: Kernel, z: PhasePoint, stops: Stops, work: StopsWork, high: bool
                     ) -> None:
    """
    Fill the rates at the end of a step, as ``_hold`` will leave them.

    ``_hold`` removes the velocities of held coordinates with nearly the impulses at the beginning,
    which changes velocities of coordinates that share a mass matrix with them.
    """
    free = work.right[1]
    for k in range(work.touch.size):
        c = stops.columns[k]
        free[k] = z.p[c]
        z.p[c] += stops.signs[k] * work.impulse[k]
    _fill_rates(kernel, z, work.rates, high)
    for k in range(work.touch.size - 1, -1, -1):
        z.p[stops.columns[k]] = free[k]


@called
def _begin(kernel: Kernel, stops: Stops, resting: np.ndarray, work: StopsWork, met: int,
           high: bool) -> None:
    """Begin a part of the step: release all stops, and begin the search of the free ones."""
    start, rates, count = work.start, work.rates, stops.columns.size
    for i in range(start.p.size):
        work.p[i] = start.p[i]
    if _next_free(resting, 0, count) < count:
        _fill_rates(kernel, start, rates, high)
    for k in range(count):
        c, sign = stops.columns[k], stops.signs[k]
        work.touch[k], work.impulse[k] = _OFF, 0.0
        if resting[k]:
            continue
        distance, slope = sign * (start.q[c] - stops.positions[k]), sign * rates.dH_dp[c]
        bend = sign * rates.product_p[c] if high else 0.0
        if k == met:
            # The impact put the coordinate on the stop, up to a rounding error that must not count
            # as another crossing.
            distance, slope = 0.0, max(0.0, slope)
        begin_search(Search(stops.nodes[k], stops.counts[k], stops.widths[k]), distance, slope,
                     bend)


@called
def _find_impact(stops: Stops, resting: np.ndarray, z: PhasePoint, rates: Rates, have: float,
                 until: float, met: int, at: int, h: float, rounding: float, high: bool
                 ) -> tuple[int, float, float, int, int, float]:
    """
    Search the stops from ``at`` on for impacts, given the state after a time ``have``.

    Return the next action and its time as ``next_trial`` does, the time and the stop of the
    earliest impact so far, the stop to continue with, and the rounding of a distance.
    """
    while at < stops.columns.size:
        if resting[at]:
            at += 1
            continue
        c, sign = stops.columns[at], stops.signs[at]
        search = Search(stops.nodes[at], stops.counts[at], stops.widths[at])
        if search.counts[0] == 0 and have != until:
            # A search begins with the state at the end of the remaining time.
            return TRY, until, until, met, at, rounding
        position, reached = stops.positions[at], z.q[c]
        rounding = max(rounding, 4.0 * _EPS * max(abs(position), abs(reached)))
        bend = sign * rates.product_p[c] if high else 0.0
        add_trial(search, have, sign * (reached - position), sign * rates.dH_dp[c], bend, rounding,
                  high)
        action, time = next_trial(search, h, rounding, high)
        if action in (TRY, LOST):
            return action, time, until, met, at, rounding
        if action == LAND:
            until, met = time, at
            if not until > 0.0:
                at = stops.columns.size
        at += 1
    return FREE, until, until, met, stops.columns.size, rounding


@called
def _bounce(kernel: Kernel, z: PhasePoint, stops: Stops, work: StopsWork, met: int, done: float,
            resting: np.ndarray, ends: bool, rest: float, h: float, rounding: float) -> float:
    """
    Reverse the velocity at the stop that was met; return the work so far [J].

    A coordinate that rests on another stop stays there if the impact drives it into the stop, and
    leaves otherwise. The coordinate that hits comes to rest if e = 0, if ``ends``, or if the
    series of its flights is too short to be followed. After a bounce with speed v against the
    acceleration a, the flights take 2 v / a, 2 e v / a, ..., in total 2 v / (a (1 - e)).
    """
    c, sign, n = stops.columns[met], stops.signs[met], work.touch.size
    before = energy_of(kernel, z)
    for k in range(n):
        work.touch[k], work.target[k] = _OFF, 0.0
    kernel.gradient(kernel.parameters, z.q, z.p, z.dH_dq, z.dH_dp)
    speed = abs(z.dH_dp[c])
    work.touch[met], work.target[met] = _ON, -stops.restitution * z.dH_dp[c]
    for _ in range(n + 1):
        if not _project_to_stops(kernel, z, stops, work):
            return np.nan
        driven = False
        for k in range(n):
            if resting[k] and work.touch[k] == _OFF \
                    and stops.signs[k] * z.dH_dp[stops.columns[k]] < -_MIN_DRIVEN_SHARE * speed:
                work.touch[k], driven = _ON, True
        if not driven:
            break
    _fill_pressed_rates(kernel, z, stops, work, resting, _MIN_DRIVEN_SHARE * speed)
    kept = False
    for k in range(n):
        i = stops.columns[k]
        pull, leaving = -stops.signs[k] * work.rates.product_p[i], stops.signs[k] * z.dH_dp[i]
        if resting[k] and leaving > _MIN_DRIVEN_SHARE * speed:
            if _is_short(leaving, pull, rest, h, rounding):
                work.touch[k], kept = _ON, True
            else:
                resting[k] = 0
    if kept and not _project_to_stops(kernel, z, stops, work):
        return np.nan
    stays = stops.restitution == 0.0 or (
        ends and (stops.restitution < 1.0 or speed * h <= rounding)) or _is_short(
            max(0.0, sign * z.dH_dp[c]), -sign * work.rates.product_p[c],
            (1.0 - stops.restitution) * rest, h, rounding)
    if stays:
        work.target[met] = 0.0
        resting[met] = 1
        if not _project_to_stops(kernel, z, stops, work):
            return np.nan
    return done + energy_of(kernel, z) - before


@called
def _fill_pressed_rates(kernel: Kernel, z: PhasePoint, stops: Stops, work: StopsWork,
                        resting: np.ndarray, least: float) -> None:
    """
    Touch resting stops that no coordinate leaves faster than ``least``; fill rates under forces.

    The forces keep touched coordinates on their stops, and none of them pulls. Without them,
    accelerations of coordinates that share a mass matrix are wrong, up to their signs.
    """
    n = work.touch.size
    for k in range(n):
        if resting[k] and stops.signs[k] * z.dH_dp[stops.columns[k]] <= least:
            work.touch[k] = _ON
    while True:
        _fill_masses(kernel, z, stops, work)
        _fill_rates(kernel, z, work.rates, True)
        for k in range(n):
            work.right[0, k] = 0.0 if work.touch[k] != _ON else \
                -stops.signs[k] * work.rates.product_p[stops.columns[k]]
        if not _solve(work):
            return
        worst = int(np.argmin(work.right[0]))
        if work.right[0, worst] >= 0.0:
            break
        work.touch[worst] = _OFF
    dH_dq, dH_dp, product_q, product_p = work.rates
    for k in range(n):
        dH_dq[stops.columns[k]] += stops.signs[k] * work.right[0, k]
    kernel.hessian_vector(kernel.parameters, z.q, z.p, dH_dp, dH_dq, product_q, product_p)


@called
def _is_short(speed: float, pull: float, left: float, h: float, rounding: float) -> bool:
    """Return True if a flight is lower than rounding, or too short to be followed."""
    if not pull > 0.0:
        return False
    flight = 2.0 * speed / pull
    return 0.25 * speed * flight <= rounding or (flight <= _SHORTEST_FLIGHT * h and flight <= left)


@called
def _remove_impulses(kernel: Kernel, work: StopsWork) -> None:
    """Remove the impulses of all stops from the beginning of this part of the step."""
    start, pushed = work.start, False
    for k in range(work.touch.size):
        pushed = pushed or work.impulse[k] != 0.0
        work.touch[k], work.impulse[k] = _OFF, 0.0
    if pushed:
        for i in range(start.p.size):
            start.p[i] = work.p[i]
        kernel.gradient(kernel.parameters, start.q, start.p, start.dH_dq, start.dH_dp)


@called
def _push(kernel: Kernel, h: float, z: PhasePoint, stops: Stops, resting: np.ndarray,
          work: StopsWork, tries: int) -> bool:
    """
    Change momenta at the beginning of a step so that resting coordinates end on their stops.

    Return True to try a step from there. With the velocities that ``_hold`` removes at the end,
    this is the method of Shake and Rattle, of order 2; correcting q after a free step would be of
    order 1. The impulses are computed by Broyden's method, which needs one step per trial and the
    masses once; Newton's needs derivatives of the step. A stop does not pull: a coordinate leaves
    its stop if a free step takes it away, or if its impulse became negative.
    """
    touch, gap = work.touch, work.gap
    grown = False
    for k in range(touch.size):
        gap[0, k] = stops.signs[k] * (z.q[stops.columns[k]] - stops.positions[k])
        if resting[k] and touch[k] == _OFF and gap[0, k] <= 0.0:
            touch[k], gap[2, k], grown = _ON, -gap[0, k], True
    enough, any_on, shift = True, False, 0.0
    for i in range(kernel.dimension - kernel.channels):
        shift = max(shift, h * abs(work.start.dH_dp[i]))
    for k in range(touch.size):
        if touch[k] == _ON:
            any_on = True
            size = abs(gap[0, k])
            # Depths may begin at the rounding of what joints with the same mass matrix move.
            stalled = not grown and tries > 1 and size >= 0.5 * abs(gap[1, k]) and size <= max(
                _STALLED_SHARE * gap[2, k], _HELD_ROUNDINGS * _EPS * shift)
            enough = enough and (stalled or size <= _HELD_ROUNDINGS * _EPS * max(
                abs(stops.positions[k]), gap[2, k]))
    if not any_on:
        return False
    if enough:
        k = int(np.argmin(work.impulse))
        if work.impulse[k] >= 0.0:
            return False
        for i in range(touch.size):
            work.change[i] = -work.impulse[i] if i == k else 0.0
        touch[k] = _RELEASED
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
            if touch[i] == _ON and touch[j] == _ON:
                work.change[i] -= work.inverse[i, j] * gap[0, j]
    _apply(kernel, stops, work)
    return True


@called
def _apply(kernel: Kernel, stops: Stops, work: StopsWork) -> None:
    """Add the changes to the impulses, and to the momenta at the beginning."""
    start = work.start
    for k in range(work.touch.size):
        work.impulse[k] += work.change[k]
        start.p[stops.columns[k]] += stops.signs[k] * work.change[k]
        work.gap[1, k] = work.gap[0, k]
    kernel.gradient(kernel.parameters, start.q, start.p, start.dH_dq, start.dH_dp)


@called
def _fill_masses(kernel: Kernel, z: PhasePoint, stops: Stops, work: StopsWork) -> None:
    """Fill H_pp of the touched stops, towards their free sides; other rows are of the identity."""
    n = work.touch.size
    zero, unit, product_q, product_p = work.rates
    for j in range(n):
        for i in range(n):
            work.masses[i, j] = 1.0 if i == j else 0.0
        if work.touch[j] != _ON:
            continue
        for i in range(z.q.size):
            zero[i] = unit[i] = 0.0
        unit[stops.columns[j]] = stops.signs[j]
        kernel.hessian_vector(kernel.parameters, z.q, z.p, zero, unit, product_q, product_p)
        for i in range(n):
            if work.touch[i] == _ON:
                work.masses[i, j] = stops.signs[i] * product_p[stops.columns[i]]


@called
def _solve(work: StopsWork) -> bool:
    """Solve with the masses for the first row of ``right``, in place."""
    for i in range(work.touch.size):
        for j in range(work.touch.size):
            work.matrix[i, j] = work.masses[i, j]
    return solve_linear(work.matrix, work.right[0]) != 0


@called
def _invert(kernel: Kernel, h: float, stops: Stops, work: StopsWork) -> None:
    """Fill the inverse of the derivative of distances by impulses, which is about h H_pp."""
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
    """Update the inverse so that it maps the last change of distances to that of impulses."""
    n, left, product = work.touch.size, work.right[0], 0.0
    for i in range(n):
        left[i] = work.right[1, i] = 0.0
        for j in range(n):
            if work.touch[i] == _ON and work.touch[j] == _ON:
                left[i] += work.change[j] * work.inverse[j, i]
                work.right[1, i] += work.inverse[i, j] * (work.gap[0, j] - work.gap[1, j])
        product += work.change[i] * work.right[1, i]
    if product == 0.0:
        return
    for i in range(n):
        for j in range(n):
            work.inverse[i, j] += (work.change[i] - work.right[1, i]) * left[j] / product


@called
def _hold(kernel: Kernel, z: PhasePoint, stops: Stops, resting: np.ndarray, work: StopsWork
          ) -> float:
    """Remove the velocities of held coordinates, which then rest; return the work [J]."""
    held, pushed = False, False
    for k in range(work.touch.size):
        work.target[k] = 0.0
        resting[k] = 1 if work.touch[k] == _ON else 0
        held, pushed = held or work.touch[k] == _ON, pushed or work.impulse[k] != 0.0
    if not held:
        return 0.0
    done = -energy_of(kernel, z)
    if pushed:
        done += energy_of(kernel, work.start)
        # Exchange the momenta, for the energy before the impulses; they are not needed again.
        for i in range(work.p.size):
            work.start.p[i], work.p[i] = work.p[i], work.start.p[i]
        done -= energy_of(kernel, work.start)
    if not _project_to_stops(kernel, z, stops, work):
        return np.nan
    return done + energy_of(kernel, z)


@called
def _project_to_stops(kernel: Kernel, z: PhasePoint, stops: Stops, work: StopsWork) -> bool:
    """
    Put touched coordinates on their stops, with momenta that give them the target velocities.

    Return True if such momenta were found, by Newton's method with H_pp: one iteration if H is
    quadratic in p, but a learned H need not be.
    """
    for k in range(work.touch.size):
        if work.touch[k] == _ON:
            z.q[stops.columns[k]], z.q_carry[stops.columns[k]] = stops.positions[k], 0.0
    kernel.gradient(kernel.parameters, z.q, z.p, z.dH_dq, z.dH_dp)
    scale, previous = 0.0, np.inf
    for i in range(kernel.dimension - kernel.channels):
        scale = max(scale, abs(z.dH_dp[i]))
    for _ in range(_MAX_NEWTON_ITERATIONS):
        error = 0.0
        for k in range(work.touch.size):
            work.right[0, k] = 0.0
            if work.touch[k] == _ON:
                work.right[0, k] = stops.signs[k] * (work.target[k] - z.dH_dp[stops.columns[k]])
                error = max(error, abs(work.right[0, k]))
        if error <= _EPS * scale or (error >= previous and error <= _ROUNDINGS * _EPS * scale):
            return True
        previous = error
        _fill_masses(kernel, z, stops, work)
        if not _solve(work):
            return False
        for k in range(work.touch.size):
            if work.touch[k] == _ON:
                c = stops.columns[k]
                z.p[c], z.p_carry[c] = z.p[c] + stops.signs[k] * work.right[0, k], 0.0
        kernel.gradient(kernel.parameters, z.q, z.p, z.dH_dq, z.dH_dp)
    return False
