# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rescue of failed steps, and of steps beyond the stability limit of explicit methods."""

from collections.abc import Callable
from functools import cache
import math
import sys
from typing import Any, NamedTuple

from hnn_vi_ros.effects import StepLayer, Wrapped
from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.integrators import (
    arrays_of, BEYOND, Composition, copy_point, discard_history, ImplicitMidpoint, Integrator,
    INTEGRATORS, largest, LieIntegrator, mark_commanded, mark_independent, NO_CONVERGENCE,
    NO_SOLUTION, OK, ON_FAILURE, PhasePoint)
from hnn_vi_ros.kernels import inlined, Kernel
from hnn_vi_ros.simulation.assembly import advance, Loop, take_substeps
from hnn_vi_ros.simulation.system import System
import numpy as np

# A failed step is retried in up to 2^6 = 64 sub-steps. The limit of gradients of all tries is the
# usual amount for twice as many sub-steps, since failing tries with fewer parts end early.
_MAX_HALVINGS = 6
_MAX_PARTS = 2 * 2 ** _MAX_HALVINGS
# An explicit method resumes when h omega has been below _RESUME_SHARE times its limit for at least
# _MIN_CALM_STEPS, a number that doubles, since each change of method may change the energy.
_RESUME_SHARE, _MIN_CALM_STEPS = 0.9, 16.0
# Values of h omega at which the stability of a method is evaluated.
_FREQUENCIES = np.arange(0.05, 8.0, 0.05)


class Rescue:
    """
    Method of a simulation, and its fallbacks for failed steps.

    First come the later attempts of the method's own chain of solvers, then `on_failure`:

    - ``substep``: 2, 4, ... 64 sub-steps of a symmetric method, until their total exceeds twice
      the usual number of gradients of 64 sub-steps;
    - ``implicit``: a step of the implicit midpoint rule, which has no stability limit. Explicit
      methods are also monitored: while h omega exceeds the stability limit, with omega the
      highest frequency of the linearised motion J H''(z), their steps would not fail but grow,
      and the implicit midpoint rule takes all steps instead. explicit_euler is not monitored,
      since its steps grow for any oscillation;
    - ``stop``: none.

    A change of method leaves the energy unchanged, but is itself not symplectic.

    Parameters
    ----------
    system : System
        System with kernel, method and effects.
    on_failure : str
        ``'substep'``, ``'implicit'`` or ``'stop'``.

    Attributes
    ----------
    methods : list of Integrator
        The method, and the implicit one if the method is monitored. A step that returns BEYOND
        switches from either to the other.

    Raises
    ------
    UnsupportedSystem
        The implicit midpoint rule does not support an effect or the coordinates.
    ValueError
        Unknown on_failure.

    """

    def __init__(self, system: System, on_failure: str):
        if on_failure not in ON_FAILURE:
            raise ValueError(f'on_failure = {on_failure!r}; valid: {", ".join(ON_FAILURE)}')
        self._system, self._on_failure = system, on_failure
        self._loops: dict[tuple[Callable, int, int], Loop] = {}
        self.methods = [system.integrator]
        problem = ImplicitMidpoint.requirements.refusal(system.hamiltonian)
        if on_failure == 'implicit' and problem:
            raise UnsupportedSystem(f'on_failure: implicit_midpoint {problem}; '
                                    'use on_failure: substep or stop')
        if on_failure == 'implicit':
            self._implicit = system.around(ImplicitMidpoint())
            limit = stability_limit(system.method)
            if limit < math.inf:
                self.methods = [
                    Wrapped(system.integrator, StabilityWatch, (-math.inf, limit)),
                    Wrapped(self._implicit, StabilityWatch, (_RESUME_SHARE * limit, math.inf))]

    def memories(self, n: int) -> list[tuple]:
        """Return the memory of each method, for n coordinates; the watch is shared."""
        memories = [self._memory(method, n) for method in self.methods]
        return [memories[0], *((*memory[:-1], memories[0][-1]) for memory in memories[1:])]

    def _memory(self, method: Integrator, n: int) -> tuple:
        """Return the memory of a method; several trajectories are solved separately."""
        memory, d = method.memory(n), self._system.kernel.dimension
        if n > d and not self._system.hamiltonian.rotations:
            mark_independent(memory, n, d, n)
        elif self._system.joints:
            # The last digits may differ, so the works of joints need not be accelerated.
            own = self._system.hamiltonian.dimension
            mark_independent(memory, n, own, own)
        if self._system.commanded:
            mark_commanded(memory)
        return memory

    def take_step(self, active: int, h: float, z: PhasePoint, z1: PhasePoint, memory: tuple
                  ) -> 'Taken':
        """
        Retry a failed step from z with the fallbacks; z is unchanged if all of them fail.

        Parameters
        ----------
        active : int
            Index of the method that failed.
        h : float
            Step size [s].
        z, z1 : Point
            State, changed by the step, and workspace.
        memory : tuple
            Workspaces of that method.

        """
        solved = self._by_other_solvers(active, h, z, z1, memory)
        if solved.ok:
            return solved
        spent = 0
        for method, attempt, parts in self._fallbacks(active, z.q.size):
            most = _most(method, parts)
            loop = self._loop(take_substeps, active, method, attempt)
            ok, gradients = self._in_parts(loop, method, parts, most - spent, h, z, z1)
            spent += gradients
            if ok:
                # Earlier solutions do not fit the next initial guess.
                discard_history(memory)
                return solved._replace(ok=True, rescued=True, gradients=solved.gradients + spent)
            if spent > most:
                return solved._replace(gradients=solved.gradients + spent, given_up=most)
        return solved._replace(gradients=solved.gradients + spent)

    def fallbacks(self, active: int, h: float, z: PhasePoint, z1: PhasePoint, memory: tuple
                  ) -> 'Fallbacks':
        """Return the fallbacks of a method, compiled or loaded from disk; see take_step."""
        method, n, last = self.methods[active], z.q.size, self._fallbacks(active, z.q.size)
        inside, end = self._memory(last[0][0], n) if last else (), PhasePoint.empty(n)
        state, kept = ([array.reshape(-1).view(np.int64) for group in groups
                        for _, array in arrays_of('', group)] for groups in (
            [self._system.effect_state], [one.kept for one in inside if hasattr(one, 'kept')]))
        calls = [self._loop(advance, active, method, attempt).shared(
            h, z, z1, memory, *np.empty((2, 1, n)), 1) for attempt in method.attempts(n)[1:]], [
                self._loop(take_substeps, active, fallback, attempt).shared(h, end, z1, inside)
                for fallback, attempt, _ in last]
        return Fallbacks(
            np.array([parts for *_, parts in last], dtype=np.int64),
            _most(*last[0][::2]) if last else 0, (*state, *kept),
            tuple(np.zeros_like(array) for array in (*state, *kept)), len(state),
            *(part for own in calls for part in (
                own[0] if own else (), tuple(one[3] for one in own))))

    def _by_other_solvers(self, active: int, h: float, z: PhasePoint, z1: PhasePoint,
                          memory: tuple) -> 'Taken':
        """Retry the step with the later attempts of the method's own solvers."""
        method, spent, residual, outcome = self.methods[active], 0, math.nan, NO_CONVERGENCE
        for attempt in method.attempts(z.q.size)[1:]:
            loop = self._loop(advance, active, method, attempt)
            outcome, _, gradients, residual, *_ = loop(
                h, 0, 1, z, z1, memory, *np.empty((2, 1, z.q.size)), 1)
            spent += gradients
            if outcome in (OK, NO_SOLUTION):
                break
        return Taken(outcome == OK, False, spent, residual, outcome)

    def _loop(self, loop: Callable, active: int, method: Integrator, attempt: int) -> Loop:
        """Return the cached loop of a method or of its fallback."""
        key = loop, active, attempt
        if key not in self._loops:
            self._loops[key] = Loop(loop, self._system.kernel, method, attempt, apart=True)
        return self._loops[key]

    def _fallbacks(self, active: int, n: int) -> list[tuple[Integrator, int, int]]:
        """Return the fallbacks in order of use: method, attempt, number of parts."""
        if self._on_failure == 'implicit' and active == 0:
            return [(self._implicit, attempt, 1) for attempt in self._implicit.attempts(n)]
        substep = _substep(self.methods[active]) if self._on_failure == 'substep' else None
        return [] if substep is None else [
            (substep, 0, 2 ** k) for k in range(1, _MAX_HALVINGS + 1)]

    def _in_parts(self, loop: Loop, method: Integrator, parts: int, most: int, h: float,
                  z: PhasePoint, z1: PhasePoint) -> tuple[bool, int]:
        """Take the step in equal parts; z and the effects' state are unchanged if one fails."""
        state = [array for _, array in arrays_of('state', self._system.effect_state)]
        before = [array.copy() for array in state]
        end = PhasePoint(*[array.copy() for array in z])
        ok, gradients = loop(h, parts, most, end, z1, self._memory(method, z.q.size))
        if ok:
            copy_point(end, z)
            return True, gradients
        # Restore the effects' state: successful parts have added to their time and work.
        for array, value in zip(state, before, strict=True):
            array[...] = value
        return False, gradients


def _most(method: Integrator, parts: int) -> int:
    """Return the limit of gradients of all sub-steps."""
    return _MAX_PARTS * method.usual_gradients if parts > 1 and method.usual_gradients \
        else sys.maxsize


def _substep(method: Integrator) -> Integrator | None:
    """Return the symmetric method for sub-steps of a failed step, None if there is none."""
    if isinstance(method, Wrapped):
        inner = _substep(method.inner)
        return None if inner is None else method.with_method(inner)
    if isinstance(method, Composition):
        return _substep(method.base)
    if not method.fallback or method.requirements.symmetric:
        return method if method.fallback else None
    # Sub-steps of a method that is not symmetric would each conserve a different 2-form.
    return INTEGRATORS[method.fallback](
        *[method.retraction] if isinstance(method, LieIntegrator) else ())


class Taken(NamedTuple):
    """
    Result of a retried step.

    Parameters
    ----------
    ok, rescued : bool
        True if the step succeeded, and if by other equations than the method's own.
    gradients : int
        Number of gradients evaluated.
    residual : float
        Residual of the last solver of the chain.
    outcome : int
        Outcome of the last solver of the chain.
    given_up : int
        Limit of gradients of sub-steps if it was exceeded, otherwise 0.

    """

    ok: bool
    rescued: bool
    gradients: int
    residual: float
    outcome: int
    given_up: int = 0


class Fallbacks(NamedTuple):
    """
    Fallbacks of a method, for compiled code; see Rescue.take_step.

    Parameters
    ----------
    parts : np.ndarray of int64
        Number of sub-steps in each attempt.
    most : int
        Limit of gradients of all sub-steps.
    state, before : tuple of np.ndarray of int64
        Arrays of the state of effects, then those in workspaces of sub-steps that persist from
        step to step; and space for their contents before the step.
    effects : int
        Number of arrays of the state of effects.
    step : tuple
        Result of Loop.shared for the first of the later attempts of its own solvers.
    attempts : tuple
        Options of each of these.
    substep, substeps : tuple
        The same for sub-steps, which begin at another point.

    """

    parts: np.ndarray
    most: int
    state: tuple[np.ndarray, ...]
    before: tuple[np.ndarray, ...]
    effects: int
    step: tuple[Any, ...]
    attempts: tuple[Any, ...]
    substep: tuple[Any, ...]
    substeps: tuple[Any, ...]


class Watched(NamedTuple):
    """
    State of a stability watch.

    Parameters
    ----------
    count : np.ndarray, shape (1,)
        Number of consecutive calm steps.
    wanted : np.ndarray, shape (1,)
        Number of calm steps required before the method is changed back.
    v_q, v_p : np.ndarray, shape (n,)
        Direction of the fastest oscillation.

    """

    count: np.ndarray  # type: ignore[assignment]  # not tuple.count
    wanted: np.ndarray
    v_q: np.ndarray
    v_p: np.ndarray


class WatchWork(NamedTuple):
    """
    Workspace of a stability watch.

    Parameters
    ----------
    kept : Watched
        State kept for the next steps.
    w_q, w_p : np.ndarray, shape (n,)
        Product of H'' with the direction.

    """

    kept: Watched
    w_q: np.ndarray
    w_p: np.ndarray


class StabilityWatch(StepLayer):
    """
    Layer around a step that returns BEYOND if h omega leaves an interval.

    It does so at once if h omega reaches the upper bound, or after a number of consecutive calm
    steps with h omega below the lower bound. This number is _MIN_CALM_STEPS at first, and doubles
    each time the upper bound is reached.

    omega^2 = abs((J H'')^2 v) / abs(v), where v is stored and updated at each step: by the power
    method it converges to the fastest oscillation of the motion linearised at z.
    """

    @staticmethod
    def workspace(n: int, settings: tuple) -> WatchWork:
        """Return the workspace for n coordinates, before the first step."""
        v_q, v_p, w_q, w_p = np.zeros((4, n))
        return WatchWork(Watched(np.zeros(1, dtype=np.int64), np.zeros(1), v_q, v_p), w_q, w_p)

    @staticmethod
    @cache
    def wrap(step: Callable, keeps_gradient: bool) -> Callable:
        """Return the step with a watch; its options are the step's and the interval."""
        @inlined
        def watched(kernel: Kernel, h: float, options: tuple, z: PhasePoint, z1: PhasePoint,
                    memory: tuple) -> tuple[int, float, int]:
            """Take one step; see Integrator."""
            inner, low, high = options
            work = memory[-1]
            calm, wanted = work.kept.count, work.kept.wanted
            # NaN fails both comparisons; the step then returns a non-finite state.
            extent = abs(h) * _frequency(kernel, z, work)
            if extent >= high:
                wanted[0] = max(_MIN_CALM_STEPS, 2.0 * wanted[0])
                return BEYOND, 0.0, 2
            calm[0] = calm[0] + 1 if extent < low else 0
            if calm[0] > wanted[0]:
                return BEYOND, 0.0, 2
            outcome, residual, gradients = step(kernel, h, inner, z, z1, memory[:-1])
            return outcome, residual, gradients + 2
        return watched


@inlined
def _frequency(kernel: Kernel, z: PhasePoint, work: WatchWork) -> float:
    """Return omega at z, and update v."""
    v_q, v_p, w_q, w_p = work.kept.v_q, work.kept.v_p, work.w_q, work.w_p
    if max(largest(v_q), largest(v_p)) == 0.0:
        # Start from an asymmetric direction, which has components of all modes.
        for i in range(v_q.size):
            v_q[i], v_p[i] = math.cos(1.0 + i * i), math.sin(2.0 + i * i)
    growth = 1.0
    for _ in range(2):
        kernel.hessian_vector(kernel.parameters, z.q, z.p, v_q, v_p, w_q, w_p)
        size = max(largest(w_q), largest(w_p))
        growth *= size
        for i in range(v_q.size):
            v_q[i] = w_p[i] / size if size > 0.0 else 0.0
            v_p[i] = -w_q[i] / size if size > 0.0 else 0.0
    return math.sqrt(growth)


def stability_limit(integrator: Integrator) -> float:
    """
    Return the largest h omega at which an oscillation of frequency omega is stable.

    Parameters
    ----------
    integrator : Integrator
        Any method; the limit is inf if it is not explicit, if it is adaptive, or if it is
        unstable for all h.

    """
    if integrator.tolerances or not integrator.explicit:
        return math.inf

    def grows(frequency: float) -> bool:
        return _spectral_radius(integrator, frequency) > 1.0 + 1e-9

    first = next((k for k, frequency in enumerate(_FREQUENCIES) if grows(frequency)), 0)
    if first == 0:
        return math.inf
    stable, unstable = _FREQUENCIES[first - 1], _FREQUENCIES[first]
    while unstable - stable > 1e-9:
        middle = 0.5 * (stable + unstable)
        stable, unstable = (stable, middle) if grows(middle) else (middle, unstable)
    return float(stable)


def _spectral_radius(integrator: Integrator, frequency: float) -> float:
    """Return the spectral radius of a step of h = 1 for H = (p^2 + omega^2 q^2) / 2."""
    def gradient(parameters: tuple, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
                 dH_dp: np.ndarray) -> None:
        dH_dq[:], dH_dp[:] = frequency * frequency * q, p

    unused: Any = gradient
    kernel = Kernel(unused, gradient, unused, (), 1, (0.0, 0.0), compiled=False)
    columns = []
    for q, p in ((1.0, 0.0), (0.0, 1.0)):
        z, z1 = PhasePoint.empty(1), PhasePoint.empty(1)
        z.q[0], z.p[0] = q, p
        gradient((), z.q, z.p, z.dH_dq, z.dH_dp)
        integrator.step(kernel, 1.0, integrator.options(), z, z1, integrator.memory(1))
        columns.append([z1.q[0], z1.p[0]])
    return float(np.abs(np.linalg.eigvals(np.array(columns))).max())
