# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rescue of steps that fail, or that an explicit method cannot take."""

from collections.abc import Callable
from functools import cache
import math
import sys
from typing import Any, NamedTuple

from hnn_vi_ros.effects import Layer, Wrapped
from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.integrators import (
    arrays_of, BEYOND, Composition, copy_point, forget, ImplicitMidpoint, Integrator, INTEGRATORS,
    largest, LieIntegrator, NO_CONVERGENCE, NO_SOLUTION, OK, ON_FAILURE, Point, separate)
from hnn_vi_ros.kernels import inlined, Kernel
from hnn_vi_ros.simulation.assembly import advance, Loop, take_substeps
from hnn_vi_ros.simulation.system import System
import numpy as np

# A step that fails is tried again in at most 2^6 = 64 sub-steps. All tries of them together may
# take what twice as many take as a rule: those in fewer parts that came before end early.
_HALVINGS = 6
_MOST_PARTS = 2 * 2 ** _HALVINGS
# An explicit method comes back when h omega has been below this share of its limit for long:
# changes of method, each a chance for the energy to change, become ever fewer.
_BACK, _CALM = 0.9, 16.0
# Frequencies times h at which the stability of a method is looked at.
_FREQUENCIES = np.arange(0.05, 8.0, 0.05)


class Rescue:
    """
    The method of a simulation, and what takes a step where it fails: its fallbacks.

    First the later attempts of the method's own chain of solvers, then what the scene says:

    - ``substep``: 2, 4, ... 64 sub-steps of a symmetric method, until all of them have taken twice
      the gradients that 64 take as a rule;
    - ``implicit``: a step of the implicit midpoint rule, which has no limit of stability. An
      explicit method is watched as well: where h omega exceeds its limit, with omega the
      highest frequency of the motion's linearisation J H''(z), its steps would not fail but
      grow. That stretch is all taken by the implicit midpoint rule. Not watched is
      explicit_euler, whose steps grow wherever something oscillates;
    - ``stop``: nothing.

    A change of method leaves the energy where it is, but is itself not symplectic.

    Parameters
    ----------
    system : System
        Its kernel, method and effects.
    on_failure : str
        ``'substep'``, ``'implicit'`` or ``'stop'``.

    Attributes
    ----------
    methods : list of Integrator
        The method; and where it is watched the implicit one, which takes over while a step ends
        as BEYOND and gives back by ending so itself.

    Raises
    ------
    UnsupportedSystem
        The implicit midpoint rule cannot take an effect, or the coordinates.
    ValueError
        An unknown on_failure.

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
                    Wrapped(self._implicit, StabilityWatch, (_BACK * limit, math.inf))]

    def memories(self, n: int) -> list[tuple]:
        """Return the memory of each method, for n coordinates; they share the watch."""
        memories = [self._memory(method, n) for method in self.methods]
        return [memories[0], *((*memory[:-1], memories[0][-1]) for memory in memories[1:])]

    def _memory(self, method: Integrator, n: int) -> tuple:
        """Return the memory of a method, in which trajectories are solved each by itself."""
        memory, d = method.memory(n), self._system.kernel.dimension
        if n > d and not self._system.hamiltonian.rotations:
            separate(memory, n, d)
        return memory

    def take_step(self, active: int, h: float, z: Point, z1: Point, memory: tuple) -> 'Taken':
        """
        Take the step from z that has failed; z is unchanged if none can.

        Parameters
        ----------
        active : int
            Which of the methods has failed.
        h : float
            Step size [s].
        z, z1 : Point
            The state, which the step changes, and working space.
        memory : tuple
            The workspaces of that method.

        """
        solved = self._by_other_solvers(active, h, z, z1, memory)
        if solved.ok:
            return solved
        spent, most = 0, sys.maxsize
        for method, attempt, parts in self._fallbacks(active, z.q.size):
            if parts > 1 and method.usual_gradients:
                most = _MOST_PARTS * method.usual_gradients
            loop = self._loop(take_substeps, active, method, attempt)
            ok, gradients = self._in_parts(loop, method, parts, most - spent, h, z, z1)
            spent += gradients
            if ok:
                # What came before is no guide to the next start.
                forget(memory)
                return solved._replace(
                    ok=True, rescued=True, gradients=solved.gradients + spent)
            if spent > most:
                return solved._replace(gradients=solved.gradients + spent, given_up=most)
        return solved._replace(gradients=solved.gradients + spent)

    def compile(self, h: float, n: int) -> None:  # noqa: A003
        """Compile all that may take a step of n coordinates, or find it on disk; run nothing."""
        z, z1, memories = Point.empty(n), Point.empty(n), self.memories(n)
        for active, method in enumerate(self.methods):
            for attempt in method.attempts(n)[1:]:
                self._loop(advance, active, method, attempt).compile(
                    h, 0, 1, z, z1, memories[active], *np.empty((2, 1, n)), 1)
            for fallback, attempt in dict.fromkeys(
                    (fallback, attempt) for fallback, attempt, _ in self._fallbacks(active, n)):
                self._loop(take_substeps, active, fallback, attempt).compile(
                    h, 1, 1, z, z1, self._memory(fallback, n))

    def _by_other_solvers(self, active: int, h: float, z: Point, z1: Point,
                          memory: tuple) -> 'Taken':
        """Take the step with the later attempts of the method itself."""
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
        """Return a loop over a method, or over what takes its place, the same each time."""
        key = loop, active, attempt
        if key not in self._loops:
            self._loops[key] = Loop(
                loop, self._system.kernel, method, attempt, apart=True)
        return self._loops[key]

    def _fallbacks(self, active: int, n: int) -> list[tuple[Integrator, int, int]]:
        """Return the fallbacks in their order: method, attempt, and number of parts."""
        if self._on_failure == 'implicit' and active == 0:
            return [(self._implicit, attempt, 1) for attempt in self._implicit.attempts(n)]
        substep = _substep(self.methods[active]) if self._on_failure == 'substep' else None
        return [] if substep is None else [
            (substep, 0, 2 ** k) for k in range(1, _HALVINGS + 1)]

    def _in_parts(self, loop: Loop, method: Integrator, parts: int, most: int, h: float,
                  z: Point, z1: Point) -> tuple[bool, int]:
        """Take the step in equal parts; leave z and what the effects keep if one fails."""
        state = [array for _, array in arrays_of('state', self._system.effect_state)]
        before = [array.copy() for array in state]
        end = Point(*[array.copy() for array in z])
        ok, gradients = loop(h, parts, most, end, z1, self._memory(method, z.q.size))
        if ok:
            copy_point(end, z)
            return True, gradients
        # Parts of the step may have been taken, and their time and work counted.
        for array, value in zip(state, before, strict=True):
            array[...] = value
        return False, gradients


def _substep(method: Integrator) -> Integrator | None:
    """Return the symmetric method that redoes a failed step in sub-steps, None for no such."""
    if isinstance(method, Wrapped):
        inner = _substep(method.inner)
        return None if inner is None else method.with_method(inner)
    if isinstance(method, Composition):
        return _substep(method.base)
    if not method.fallback or method.requirements.symmetric:
        return method if method.fallback else None
    # Sub-steps of a method that is not symmetric would each conserve a 2-form of their own.
    return INTEGRATORS[method.fallback](
        *[method.retraction] if isinstance(method, LieIntegrator) else ())


class Taken(NamedTuple):
    """
    Result of a step that was taken again.

    Parameters
    ----------
    ok, rescued : bool
        Whether it was taken, and not by the method's own equations.
    gradients : int
        Evaluated for it.
    residual : float
        Of the last solver of the chain.
    outcome : int
        Of the same.
    given_up : int
        How many gradients sub-steps may take, if they have taken more; else 0.

    """

    ok: bool
    rescued: bool
    gradients: int
    residual: float
    outcome: int
    given_up: int = 0


class Watched(NamedTuple):
    """
    Record that a watch keeps of the steps so far.

    Parameters
    ----------
    count : np.ndarray, shape (1,)
        Calm steps one after another.
    wanted : np.ndarray, shape (1,)
        How many there are to be before the method is changed back.
    v_q, v_p : np.ndarray, shape (n,)
        The direction of the fastest oscillation.

    """

    count: np.ndarray  # type: ignore[assignment]  # not tuple.count
    wanted: np.ndarray
    v_q: np.ndarray
    v_p: np.ndarray


class WatchWork(NamedTuple):
    """
    The workspace of a watch.

    Parameters
    ----------
    kept : Watched
        For the next steps.
    w_q, w_p : np.ndarray, shape (n,)
        The product of H'' with the direction.

    """

    kept: Watched
    w_q: np.ndarray
    w_p: np.ndarray


class StabilityWatch(Layer):
    """
    A step that is taken only while h omega stays between two bounds, and else ends as BEYOND.

    At once where h omega reaches the highest value; or after many calm steps, with h omega below
    the lowest one. As many as _CALM at first; each time that the highest value is reached, twice
    as many.

    omega^2 = abs((J H'')^2 v) / abs(v) for a v that each step maps and keeps: by the power method
    it turns into the fastest oscillation of the motion linearised at z.
    """

    @staticmethod
    def workspace(n: int, settings: tuple) -> WatchWork:
        """Return the workspace for n coordinates, before the first step."""
        v_q, v_p, w_q, w_p = np.zeros((4, n))
        return WatchWork(Watched(np.zeros(1, dtype=np.int64), np.zeros(1), v_q, v_p), w_q, w_p)

    @staticmethod
    @cache
    def wrap(step: Callable, keeps_gradient: bool) -> Callable:
        """Return the step with its watch; its options are the step's and the interval."""
        @inlined
        def watched(kernel: Kernel, h: float, options: tuple, z: Point, z1: Point,
                    memory: tuple) -> tuple[int, float, int]:
            """Take one step; see Integrator."""
            inner, low, high = options
            work = memory[-1]
            calm, wanted = work.kept.count, work.kept.wanted
            # NaN is neither low nor high: it will be found not finite.
            extent = abs(h) * _frequency(kernel, z, work)
            if extent >= high:
                wanted[0] = max(_CALM, 2.0 * wanted[0])
                return BEYOND, 0.0, 2
            calm[0] = calm[0] + 1 if extent < low else 0
            if calm[0] > wanted[0]:
                return BEYOND, 0.0, 2
            outcome, residual, gradients = step(kernel, h, inner, z, z1, memory[:-1])
            return outcome, residual, gradients + 2
        return watched


@inlined
def _frequency(kernel: Kernel, z: Point, work: WatchWork) -> float:
    """Return omega at z, and keep v."""
    v_q, v_p, w_q, w_p = work.kept.v_q, work.kept.v_p, work.w_q, work.w_p
    if max(largest(v_q), largest(v_p)) == 0.0:
        # A direction without a symmetry that a mode could have as well.
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
    Return the h omega from which on a method lets an oscillation of frequency omega grow.

    Parameters
    ----------
    integrator : Integrator
        Any; infinity for one that is not explicit or not of this package's numba subset, and for
        one that is stable nowhere.

    """
    if not (integrator.explicit and integrator.compiled):
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
    """Return the largest size of an eigenvalue of the step h = 1 of H = (p^2 + omega^2 q^2)/2."""
    def gradient(parameters: tuple, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
                 dH_dp: np.ndarray) -> None:
        dH_dq[:], dH_dp[:] = frequency * frequency * q, p

    unused: Any = gradient
    kernel = Kernel(unused, gradient, unused, (), 1, (0.0, 0.0), compiled=False)
    columns = []
    for q, p in ((1.0, 0.0), (0.0, 1.0)):
        z, z1 = Point.empty(1), Point.empty(1)
        z.q[0], z.p[0] = q, p
        gradient((), z.q, z.p, z.dH_dq, z.dH_dp)
        integrator.step(kernel, 1.0, integrator.options(), z, z1, integrator.memory(1))
        columns.append([z1.q[0], z1.p[0]])
    return float(np.abs(np.linalg.eigvals(np.array(columns))).max())
