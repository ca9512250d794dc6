# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Adaptive steps by a transformation of time that keeps the geometric structure."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import NamedTuple

from hnn_vi_ros.hamiltonians import check_between, check_positive
from hnn_vi_ros.integrators.arithmetic import copy_point, plus
from hnn_vi_ros.integrators.base import (
    ENDLESS, Integrator, NOT_FINITE, OK, PhasePoint, Requirements)
from hnn_vi_ros.integrators.gauss import GAUSS_METHODS
from hnn_vi_ros.integrators.implicit_midpoint import ImplicitMidpoint
from hnn_vi_ros.integrators.stormer_verlet import StormerVerlet
from hnn_vi_ros.integrators.workspaces import discard_history
from hnn_vi_ros.kernels import inlined, Kernel
import numpy as np

# Maximum number of internal steps in one step of the clock.
_MAX_STEPS = 100_000


class ClockState(NamedTuple):
    """
    State from which the next step of the clock continues.

    Parameters
    ----------
    count : np.ndarray, shape (1,)
        1 if the state is stored, 0 before the first step.
    clock : np.ndarray, shape (3,)
        Density of steps [1], time of the state minus time of the clock [s], and the rounding error
        of that time.
    state : Point
        The state, at a time of its own.

    """

    count: np.ndarray  # type: ignore[assignment]  # not tuple.count
    clock: np.ndarray
    state: PhasePoint


class ControlledWork(NamedTuple):
    """
    Workspace of a clock; arrays of shape (n,).

    Parameters
    ----------
    kept : Ahead
        State for the next step of the clock.
    own_step : np.ndarray, shape (1,)
        Step size of the base where the density is 1, 0 for the steps of the clock [s].
    at : Point
        The state at the start of a step of the base.
    v_q, v_p, change_q, change_p : np.ndarray
        The velocity, and the product of H'' with it.

    """

    kept: ClockState
    own_step: np.ndarray
    at: PhasePoint
    v_q: np.ndarray
    v_p: np.ndarray
    change_q: np.ndarray
    change_p: np.ndarray

    @classmethod
    def empty(cls, n: int, dtype: type = np.float64) -> 'ControlledWork':
        """Return the workspace for n coordinates, before the first step."""
        kept = ClockState(np.zeros(1, dtype=np.int64), np.zeros(3, dtype),
                          PhasePoint.empty(n, dtype))
        return cls(kept, np.zeros(1), PhasePoint.empty(n, dtype), *np.zeros((4, n), dtype))


@cache
def clock_step(base_step: Callable) -> Callable:
    """
    Return the step of a clock, which consists of steps of controlled size of a symmetric method.

        rho_(n+1/2) = rho_(n-1/2) + h G(z_n),  z_(n+1) = Phi_(h / rho_(n+1/2))(z_n)
        G = d/dt log(1 / g) = a (H_q . dH_q/dt) / (F^2 + abs(H_q)^2)

    is an explicit update of the density rho of the steps, which follows 1 / g and is invariant
    under time reversal: with a symmetric base, the map of (z, rho) is symmetric, so that in a
    reversible motion the energy does not drift.

    The memory contains that of the base twice, for clock and internal states, then its own.

    References
    ----------
    E. Hairer, G. Söderlind, Explicit, time reversible, adaptive step size control, SIAM J. Sci.
    Comput. 26 (2005).

    """
    @inlined
    def step(kernel: Kernel, h: float, options: tuple, z: PhasePoint, z1: PhasePoint,
             memory: tuple) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        inner, force, exponent = options
        at_clock, own, work = memory[0:1], memory[1:2], memory[2]
        ahead, at, clock = work.kept.state, work.at, work.kept.clock
        fresh = work.kept.count[0] == 0
        if fresh:
            discard_history(own)
            copy_point(z, ahead)
            clock[:] = 0.0
        copy_point(ahead, at)
        # As long as the step of the clock, unless its length is given.
        own_step = work.own_step[0] if work.own_step[0] > 0.0 else h
        worst, gradients, density, time, carry = 0.0, 0, clock[0], clock[1], clock[2]
        for _ in range(_MAX_STEPS):
            if time >= h:
                break
            rate, square = _rate(kernel, at, force, exponent, work)
            if fresh:
                # 1 / g at the start, and from there half a step back.
                density = (1.0 + square) ** (0.5 * exponent) - 0.5 * own_step * rate
                fresh = False
            density += own_step * rate
            if not density > 0.0:
                return NOT_FINITE, worst, gradients
            outcome, residual, more = base_step(kernel, own_step / density, inner, at, z1, own)
            worst, gradients = max(worst, residual), gradients + 2 + more
            if outcome != OK:
                return outcome, residual, gradients
            time, carry = plus(time, carry, own_step / density)
            copy_point(z1, at)
        if time < h:
            return ENDLESS, worst, gradients
        kernel.gradient(kernel.parameters, at.q, at.p, at.dH_dq, at.dH_dp)
        discard_history(at_clock)
        outcome, residual, more = base_step(kernel, h - time, inner, at, z1, at_clock)
        if outcome == OK:
            copy_point(at, ahead)
            clock[0], clock[1], clock[2], work.kept.count[0] = density, time - h, carry, 1
        return outcome, max(worst, residual), gradients + more + 1
    return step


@inlined
def _rate(kernel: Kernel, at: PhasePoint, force: float, exponent: float, work: ControlledWork
          ) -> tuple[float, float]:
    """Return G, and abs(H_q)^2 / F^2, at a state, and fill its gradient."""
    kernel.gradient(kernel.parameters, at.q, at.p, at.dH_dq, at.dH_dp)
    v_q, v_p, change_q, change_p = work.v_q, work.v_p, work.change_q, work.change_p
    for i in range(at.q.size):
        v_q[i], v_p[i] = at.dH_dp[i], -at.dH_dq[i]
    # The derivative of H_q in time: H'' times the velocity (H_p, -H_q).
    kernel.hessian_vector(kernel.parameters, at.q, at.p, v_q, v_p, change_q, change_p)
    square, product = 0.0, 0.0
    for i in range(at.q.size):
        square += (at.dH_dq[i] / force) ** 2
        product += at.dH_dq[i] * change_q[i] / force ** 2
    return exponent * product / (1.0 + square), square


BASES: dict[str, Callable[[], Integrator]] = {'implicit_midpoint': ImplicitMidpoint} | {
    name: GAUSS_METHODS[name] for name in ('gauss4', 'gauss6', 'gauss8')}
CONTROLS: dict[str, dict[str, Callable[[], Integrator]]] = {
    'hamiltonian': BASES, 'integrating': BASES | {'stormer_verlet': StormerVerlet}}
# Spacing of the difference of gradients that replaces the second derivatives of K.
_SPACING = float(np.finfo(np.float64).eps) ** (1.0 / 3.0)


class GradientWork(NamedTuple):
    """
    Workspace of the gradient and second derivatives of K, for up to s stages at once.

    Parameters
    ----------
    q, p, dH_dq, dH_dp : np.ndarray, shape (s d,)
        The stages without their times, and the gradient of H there.
    zero, w_q, w_p : np.ndarray, shape (s d,)
        Zeros, and the product of H'' with (H_q, 0).
    ahead_q, ahead_p, behind_q, behind_p : np.ndarray, shape (s (d + 1),)
        A point of a difference, and the gradient of K at its first end.

    """

    q: np.ndarray
    p: np.ndarray
    dH_dq: np.ndarray
    dH_dp: np.ndarray
    zero: np.ndarray
    w_q: np.ndarray
    w_p: np.ndarray
    ahead_q: np.ndarray
    ahead_p: np.ndarray
    behind_q: np.ndarray
    behind_p: np.ndarray

    @classmethod
    def empty(cls, stages: int, d: int, dtype: type = np.float64) -> 'GradientWork':
        """Return workspace for this number of stages of d coordinates."""
        return cls(*np.zeros((7, stages * d), dtype), *np.zeros((4, stages * (d + 1)), dtype))


class TransformedParameters(NamedTuple):
    """
    Parameters of the functions of K, their first argument.

    Parameters
    ----------
    kernel : Kernel
        H.
    work : GradientWork
        Workspace.
    start, force, exponent : float
        H_0 [J], F and a.

    """

    kernel: Kernel
    work: GradientWork
    start: float
    force: float
    exponent: float


class TransformedWork(NamedTuple):
    """
    Workspace of a step of the clock, with t as the last coordinate of each point.

    Parameters
    ----------
    kept : Ahead
        State for the next step of the clock; H_0 [J] replaces the density.
    own_step : np.ndarray, shape (1,)
        See ControlledWork.
    at, after : Point
        The states at the start and the end of a step of the base.

    """

    kept: ClockState
    own_step: np.ndarray
    at: PhasePoint
    after: PhasePoint

    @classmethod
    def empty(cls, n: int, dtype: type = np.float64) -> 'TransformedWork':
        """Return the workspace for n coordinates, before the first step."""
        ahead, first, second = (PhasePoint.empty(n + 1, dtype) for _ in range(3))
        kept = ClockState(np.zeros(1, dtype=np.int64), np.zeros(3, dtype), ahead)
        return cls(kept, np.zeros(1), first, second)


class TimeTransformed(Integrator):
    """
    Equal steps of a symplectic method in a transformed time s, dt = g ds, for close encounters.

    The method takes steps ds = h of

        K = g (H - H_0),  g = (1 + abs(H_q)^2 / F^2)^(-a/2) <= 1,

    with H_0 the energy at the start, and t as a further coordinate. If H = H_0, which the
    symplectic method nearly conserves, these are Hamilton's equations with dt = g ds: step sizes
    are h where the force is weak, and g h elsewhere. With a step size that depends on the state
    but does not derive from a Hamiltonian, the energy would drift.

    The times of these states differ from the clock. The output at each clock time is the next of
    these states, mapped there by one step of the method in H; no step continues from it. So the
    output has the accuracy of the method, and its energy does not drift, but the map between
    outputs is not itself symplectic.

    Effects that change the state between steps, or do work, are not supported.

    Parameters
    ----------
    base : str
        ``'implicit_midpoint'``, ``'gauss4'``, ``'gauss6'`` or ``'gauss8'``.
    force : float
        F, the size of H_q above which steps are shortened [N, or N m for angles].
    exponent : float
        a >= 0 [1]. With 3/4, and H_q as r^-2, steps scale as r^(3/2), like the period of an orbit.
    control : str
        ``'hamiltonian'`` uses K. ``'integrating'`` uses a symmetric controller, in which the
        density of steps is a further variable that follows 1 / g. It integrates H itself, also
        with the explicit base ``'stormer_verlet'``, with fewer evaluations. It is symmetric and
        not symplectic; the energy of reversible motions does not drift.

    Raises
    ------
    ValueError
        An unknown base or control, or a force or exponent out of range.

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section VIII.2.
    S. Reich, Backward error analysis for numerical integrators, SIAM J. Numer. Anal. 36 (1999).
    E. Hairer, G. Söderlind, Explicit, time reversible, adaptive step size control, SIAM J. Sci.
    Comput. 26 (2005).

    """

    explicit = False
    requirements = Requirements(symmetric=False, symplectic=False, forces=False, from_state=False)

    def __init__(self, base: str = 'gauss4', force: float = 1.0, exponent: float = 0.75,
                 control: str = 'hamiltonian'):
        if control not in CONTROLS:
            raise ValueError(f'control = {control!r}; valid: {", ".join(CONTROLS)}')
        bases = CONTROLS[control]
        if base not in bases:
            raise ValueError(f'base = {base!r}; valid with control {control}: {", ".join(bases)}')
        check_positive(force=force)
        check_between(0, 4, exponent=exponent)
        self.base, self._force, self._exponent = bases[base](), float(force), float(exponent)
        self._control, self.order = control, self.base.order
        self.requirements = replace(self.requirements, separable=self.base.requirements.separable)
        around = _transform if control == 'hamiltonian' else clock_step
        self.step = around(self.base.step)

    @property
    def kernel_name(self) -> str:
        """Return the name of the method and of its base."""
        return f'{type(self).__name__}({self._control}, {self.base.kernel_name})'

    def attempts(self, n: int) -> tuple[int, ...]:
        """Return the attempts of the base, for n coordinates and the time."""
        return self.base.attempts(n + 1)

    def options(self, attempt: int = 0, dimension: int = 1) -> tuple:
        """Return the options of the base, the force and the exponent."""
        return (self.base.options(attempt, dimension), self._force, self._exponent)

    def unknowns(self, n: int) -> tuple[int, ...]:
        """Return the unknowns of the equations of H, then of the internal steps."""
        more = 0 if self._control == 'integrating' else 1
        return (*self.base.unknowns(n), *self.base.unknowns(n + more))

    def own_times(self, kernel: Kernel) -> tuple[float, float]:
        """Return the times of a step, and of a gradient with the time transformation."""
        return 1.5e-7, 6e-8

    def memory(self, n: int, dtype: type = np.float64) -> tuple:
        """Return workspaces of the base for H and for internal steps, then those around them."""
        if self._control == 'integrating':
            at_clock, own = (self.base.memory(n, dtype) or ((),) for _ in range(2))
            return (*at_clock, *own, ControlledWork.empty(n, dtype))
        stages = self.base.unknowns(1)[0] // 2
        return (*self.base.memory(n, dtype), *self.base.memory(n + 1, dtype),
                GradientWork.empty(stages, n, dtype), TransformedWork.empty(n, dtype))


@cache
def _transform(base_step: Callable) -> Callable:
    @inlined
    def step(kernel: Kernel, h: float, options: tuple, z: PhasePoint, z1: PhasePoint,
             memory: tuple) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        inner, force, exponent = options
        n, at_clock, own, work = z.q.size, memory[0:1], memory[1:2], memory[3]
        ahead, at, after, clock = work.kept.state, work.at, work.after, work.kept.clock
        fresh = work.kept.count[0] == 0
        if fresh:
            discard_history(own)
            copy_point(z, ahead)
            ahead.q[n], ahead.p[n], ahead.q_carry[n], ahead.p_carry[n] = 0.0, 0.0, 0.0, 0.0
            clock[0], clock[1], clock[2] = kernel.energy(kernel.parameters, z.q, z.p), 0.0, 0.0
        parameters = TransformedParameters(kernel, memory[2], clock[0], force, exponent)
        transformed = Kernel(kernel.energy, _gradient, _hessian_vector, parameters, n + 1,
                             kernel.gradient_scale, kernel.compiled, 1, kernel.energy_scale,
                             kernel.rotations, False)
        copy_point(ahead, at)
        own_step = work.own_step[0] if work.own_step[0] > 0.0 else h
        worst, gradients, time, carry = 0.0, 0, clock[1], clock[2]
        if fresh:
            transformed.gradient(transformed.parameters, at.q, at.p, at.dH_dq, at.dH_dp)
        for _ in range(_MAX_STEPS):
            if time >= h:
                break
            outcome, residual, more = base_step(transformed, own_step, inner, at, after, own)
            # Each evaluation takes a gradient of H and a product with its second derivatives.
            worst, gradients = max(worst, residual), gradients + 2 * more
            if outcome != OK:
                return outcome, residual, gradients
            if not after.q[n] > 0.0:
                return NOT_FINITE, residual, gradients
            time, carry = plus(time, carry, after.q[n])
            copy_point(after, at)
            at.q[n], at.p[n], at.q_carry[n], at.p_carry[n] = 0.0, 0.0, 0.0, 0.0
        if time < h:
            return ENDLESS, worst, gradients
        seen = PhasePoint(at.q[:n], at.p[:n], at.q_carry[:n], at.p_carry[:n],
                          after.dH_dq[:n], after.dH_dp[:n])
        kernel.gradient(kernel.parameters, seen.q, seen.p, seen.dH_dq, seen.dH_dp)
        discard_history(at_clock)
        outcome, residual, more = base_step(kernel, h - time, inner, seen, z1, at_clock)
        worst, gradients = max(worst, residual), gradients + more + 1
        if outcome == OK:
            copy_point(at, ahead)
            clock[1], clock[2], work.kept.count[0] = time - h, carry, 1
        return outcome, worst, gradients
    return step


@inlined
def _gradient(parameters: TransformedParameters, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
              dH_dp: np.ndarray) -> None:
    """Fill the gradient of K at one or more stages, each with d coordinates and then t."""
    kernel, work = parameters.kernel, parameters.work
    start, force, exponent = parameters.start, parameters.force, parameters.exponent
    d = kernel.dimension
    stages = q.size // (d + 1)
    size = stages * d
    at_q, at_p, f_q, f_p = work.q[:size], work.p[:size], work.dH_dq[:size], work.dH_dp[:size]
    zero, w_q, w_p = work.zero[:size], work.w_q[:size], work.w_p[:size]
    for j in range(stages):
        for i in range(d):
            at_q[j * d + i], at_p[j * d + i] = q[j * (d + 1) + i], p[j * (d + 1) + i]
    kernel.gradient(kernel.parameters, at_q, at_p, f_q, f_p)
    # Half the derivatives of abs(H_q)^2.
    kernel.hessian_vector(kernel.parameters, at_q, at_p, f_q, zero, w_q, w_p)
    for j in range(stages):
        a, b = j * d, j * (d + 1)
        square = 1.0
        for i in range(d):
            square += (f_q[a + i] / force) ** 2
        g = square ** (-0.5 * exponent)
        excess = kernel.energy(kernel.parameters, at_q[a:a + d], at_p[a:a + d]) - start
        slope = -exponent * g / (square * force * force) * excess
        for i in range(d):
            dH_dq[b + i] = g * f_q[a + i] + slope * w_q[a + i]
            dH_dp[b + i] = g * f_p[a + i] + slope * w_p[a + i]
        dH_dq[b + d], dH_dp[b + d] = 0.0, g


@inlined
def _hessian_vector(parameters: TransformedParameters, q: np.ndarray, p: np.ndarray,
                    v_q: np.ndarray, v_p: np.ndarray, product_q: np.ndarray,
                    product_p: np.ndarray) -> None:
    """Fill K'' v from a central difference, accurate enough for Newton's method to converge."""
    work, size = parameters.work, 0.0
    for i in range(q.size):
        size = max(size, abs(v_q[i]), abs(v_p[i]))
    spacing = _SPACING / size if size > 0.0 else 1.0
    back_q, back_p = work.behind_q[:q.size], work.behind_p[:q.size]
    at_q, at_p = work.ahead_q[:q.size], work.ahead_p[:q.size]
    for i in range(q.size):
        at_q[i], at_p[i] = q[i] - spacing * v_q[i], p[i] - spacing * v_p[i]
    _gradient(parameters, at_q, at_p, back_q, back_p)
    for i in range(q.size):
        at_q[i], at_p[i] = q[i] + spacing * v_q[i], p[i] + spacing * v_p[i]
    _gradient(parameters, at_q, at_p, product_q, product_p)
    for i in range(q.size):
        product_q[i] = (product_q[i] - back_q[i]) / (2.0 * spacing)
        product_p[i] = (product_p[i] - back_p[i]) / (2.0 * spacing)
