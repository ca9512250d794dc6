# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Steps of variational methods for many trajectories, and the solvers of their equations.

The equations x = G(x) of each trajectory are solved separately to round-off, by the fixed-point
iteration or Anderson's method; ``integrators.solvers`` explains the acceptance criteria. A
trajectory leaves the iteration when its equation is solved or has failed; the iteration of the
others continues in shorter arrays.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators import (
    BACK, COMMON, DEPTH, FAST_MATRIX, fixed_point, Gauss, gauss_tableau, GO_ON, ImplicitIntegrator,
    IN_DOUBT, Integrator, LEAST_SCALE, method_name, methods_that, NO_CONVERGENCE, Node, NOT_FINITE,
    OK, OWN, QUICK, SolverOptions)
from hnn_vi_ros.simulation.batches.gradient import Gradient, row_dot
import numpy as np
import torch

EPS = float(np.finfo(np.float64).eps)
# As in integrators.solvers: residual that exceeds rounding; residual above which, after PATIENCE
# iterations, insufficient contraction counts as failure.
NOISE, HOPELESS, PATIENCE = 1e-11, 1e-8, 5
# Known quantities of the equations, each of shape (..., m). An equation returns G(x), shape
# (N, m), and by-products of its evaluation.
Known = tuple[torch.Tensor, ...]
Equation = Callable[[Known, torch.Tensor], tuple[torch.Tensor, torch.Tensor]]


class ResidualScales(NamedTuple):
    """
    Scales of residuals, shape (N, m).

    Parameters
    ----------
    common, own : torch.Tensor
        Scale of the largest unknown of the same kind, and individual scale of each unknown.

    """

    common: torch.Tensor
    own: torch.Tensor


class Solved(NamedTuple):
    """
    Solutions of the equations of m trajectories.

    Parameters
    ----------
    outcome : torch.Tensor, shape (m,)
        OK, NO_CONVERGENCE or NOT_FINITE.
    x, found : torch.Tensor, shape (N, m), (..., m)
        Solutions, and the by-products of G at them.
    iterations : torch.Tensor, shape (m,)
        Number of evaluations of G.
    slow_start : torch.Tensor of bool, shape (m,)
        True where the first iteration did not halve the residual.

    """

    outcome: torch.Tensor
    x: torch.Tensor
    found: torch.Tensor
    iterations: torch.Tensor
    slow_start: torch.Tensor


class Anderson:
    """
    Anderson's method, with a separate least-squares problem for each unsolved trajectory.

    With one unknown it is the secant method.

    Parameters
    ----------
    depth : int
        Number of earlier evaluations to combine; 0 is the fixed-point iteration x = G(x), as in
        the paper, which is not stopped early for slow contraction.

    """

    def __init__(self, depth: int = DEPTH) -> None:
        self._depth, self.patient = depth, not depth
        # Last evaluations, newest first; first iteration from which they may be combined.
        self._old: list[tuple[torch.Tensor, torch.Tensor]] = []
        self._origin: torch.Tensor | None = None

    def improved(self, k: int, value: torch.Tensor, defect: torch.Tensor, changed: torch.Tensor
                 ) -> torch.Tensor:
        """
        Return the next x, shape (N, m).

        Parameters
        ----------
        k : int
            Number of iterations so far.
        value, defect : torch.Tensor, shape (N, m)
            G(x), and the residual relative to the scale.
        changed : torch.Tensor of bool, shape (m,)
            True where the scale of the residuals has changed.

        """
        if self._origin is None:
            self._origin = torch.ones_like(changed, dtype=torch.int64)
        self._origin = torch.where(changed, k, self._origin)
        depth = (k - self._origin).clamp_max(min(len(value), self._depth))
        x, weights, used = value, *self._projected(defect, depth)
        for j in range(len(weights) - 1, -1, -1):
            x = torch.where(used[j], x - weights[j] * (value - self._old[j][0]), x)
        self._old = [(value, defect), *self._old][:self._depth]
        return x

    def _projected(self, defect: torch.Tensor, depth: torch.Tensor
                   ) -> tuple[list[torch.Tensor], list[torch.Tensor]]:
        """Return the weights of earlier evaluations, shape (m,) each, and masks of their use."""
        basis: list[torch.Tensor] = []
        triangle: list[list[torch.Tensor]] = []
        right: list[torch.Tensor] = []
        used: list[torch.Tensor] = []
        for j in range(min(len(self._old), len(defect))):
            change = defect - self._old[j][1]
            size = row_dot(change, change)
            triangle.append([])
            for column in basis:
                share = row_dot(column, change)
                triangle[j].append(share)
                change = change - share * column
            left = row_dot(change, change)
            counts = (depth > j) & (left > 1e-20 * size)
            used.append(counts & used[-1] if used else counts)
            length = torch.where(used[j], left, 1.0).sqrt()
            basis.append(change / length)
            triangle[j].append(length)
            right.append(row_dot(basis[j], defect))
        weights = list(right)
        for j in range(len(right) - 1, -1, -1):
            total = right[j]
            for i in range(j + 1, len(right)):
                total = total - torch.where(used[i], triangle[i][j] * weights[i], 0.0)
            weights[j] = total / triangle[j][j]
        return weights, used

    def keep(self, chosen: torch.Tensor) -> None:
        """Discard all trajectories except the chosen ones, given by index."""
        self._old = [(value[:, chosen], defect[:, chosen]) for value, defect in self._old]
        if self._origin is not None:
            self._origin = self._origin[chosen]


class _Judged(NamedTuple):
    """Assessment of iterates: outcome, or GO_ON with the data for the next iterate."""

    outcome: torch.Tensor
    value: torch.Tensor
    defect: torch.Tensor
    residual: torch.Tensor
    stage: torch.Tensor
    accepted: torch.Tensor


def solve(iteration: Anderson, equation: Equation, known: Known, x: torch.Tensor,
          scales: ResidualScales, max_iterations: int) -> Solved:
    """
    Solve x = G(x) for each of m trajectories.

    Parameters
    ----------
    iteration : Anderson
        Iteration method.
    equation : callable
        Function of known and x that returns G(x), shape (N, m), and by-products, shape (..., m).
    known : tuple of torch.Tensor, each (..., m)
        Known quantities of the equations.
    x : torch.Tensor, shape (N, m)
        Initial guesses.
    scales : Scales
        Scales of the unknowns.
    max_iterations : int
        Number of iterations after which an equation counts as unsolved.

    """
    m, device = x.shape[1], x.device
    at = torch.arange(m, device=device)
    stage, slow = (torch.zeros(m, dtype=kind, device=device) for kind in (torch.int64, torch.bool))
    previous, accepted = torch.full((m,), torch.inf, dtype=x.dtype, device=device), x
    solved: Solved | None = None
    for k in range(1, max_iterations + 1):
        value, found = equation(known, x)
        if solved is None:
            solved = Solved(torch.full_like(stage, NO_CONVERGENCE), torch.empty_like(x),
                            torch.empty_like(found), torch.zeros_like(stage), slow.clone())
        judged = _judge(value, x, scales, previous, stage, accepted, k == max_iterations)
        outcome, common = judged.outcome, judged.stage == COMMON
        if not iteration.patient and k > PATIENCE:
            outcome = torch.where((outcome == GO_ON) & common
                                  & (judged.residual > 0.5 * previous)
                                  & (judged.residual > HOPELESS), NO_CONVERGENCE, outcome)
        if k == 2:
            slow = (judged.residual > 0.5 * previous) & (0.5 * previous > NOISE)
        if k == max_iterations:
            outcome = torch.where(outcome == GO_ON, NO_CONVERGENCE, outcome)
        done, left = (outcome != GO_ON).nonzero()[:, 0], (outcome == GO_ON).nonzero()[:, 0]
        place = at[done]
        solved.outcome[place], solved.iterations[place] = outcome[done], k
        solved.x[:, place], solved.found[..., place] = x[:, done], found[..., done]
        solved.slow_start[place] = slow[done]
        if not len(left):
            break
        value, defect, changed = judged.value, judged.defect, judged.stage != stage
        previous, stage, accepted = judged.residual, judged.stage, judged.accepted
        if len(done):
            at, slow, previous, stage, changed = (
                row[left] for row in (at, slow, previous, stage, changed))
            value, defect, accepted = (array[:, left] for array in (value, defect, accepted))
            known = tuple(array[..., left] for array in known)
            scales = ResidualScales(*(array[:, left] for array in scales))
            iteration.keep(left)
        x = iteration.improved(k, value, defect, changed)
    assert solved is not None, 'there is at least one iteration'
    return solved


def _residual(value: torch.Tensor, x: torch.Tensor, scale: torch.Tensor
              ) -> tuple[torch.Tensor, torch.Tensor]:
    """Return G(x) - x relative to a scale, shape (N, m), and its largest entries, NaN included."""
    difference = value - x
    # If state and slope are zero, take the scale from the iterates.
    size = torch.where(scale > 0.0, scale, torch.maximum(value.abs(), x.abs()))
    defect = torch.where(difference == 0.0, difference, difference / size)
    return defect, defect.abs().amax(dim=0)


def _judge(value: torch.Tensor, x: torch.Tensor, scales: ResidualScales, previous: torch.Tensor,
           stage: torch.Tensor, accepted: torch.Tensor, is_last: bool) -> _Judged:
    """Assess the convergence of each iterate; see ``judge`` of integrators.solvers."""
    bound = max(8, len(x)) * EPS
    defect, residual = _residual(value, x, scales.common)
    own_defect, own = _residual(value, x, scales.own)
    finite, last = residual.isfinite(), torch.full_like(stage, is_last, dtype=torch.bool)
    back = (stage == OWN) & (residual > bound) & ~last
    on = (stage == COMMON) & ~((residual <= EPS)
                               | ((residual <= bound) & ((residual >= previous) | last)))
    enough = (stage == BACK) | (own <= bound) | last | ((stage == OWN) & (own > 0.5 * previous))
    # Precedence: not finite, then return to an accepted iterate or continue, then accept.
    outcome = torch.where(back | on, GO_ON, torch.where(enough, OK, GO_ON))
    refined = finite & ~back & ~on & ~enough
    return _Judged(
        torch.where(finite, outcome, NOT_FINITE),
        torch.where(back, accepted, value),
        torch.where(back, 0.0, torch.where(refined, own_defect, defect)),
        torch.where(refined, own, residual),
        torch.where(back, BACK, torch.where(refined, OWN, stage)),
        torch.where(refined, x, accepted))


_Pair = tuple[torch.Tensor, torch.Tensor]


class BatchState(NamedTuple):
    """
    States of m trajectories, and data for their next steps.

    Parameters
    ----------
    z, carry, slope : torch.Tensor, shape (2 d, m)
        q and p; their rounding errors in compensated summation; and (H_q, H_p) at z, or an
        approximation that scales the next solve.
    counts : torch.Tensor, shape (K, m)
        Number of stored earlier solutions of each of K equations.
    earlier : tuple of torch.Tensor, each (..., m)
        Earlier solutions of each equation.

    """

    z: torch.Tensor
    carry: torch.Tensor
    slope: torch.Tensor
    counts: torch.Tensor
    earlier: tuple[torch.Tensor, ...]

    def of(self, chosen: torch.Tensor) -> 'BatchState':
        """Return the states of the chosen trajectories."""
        return BatchState(self.z[:, chosen], self.carry[:, chosen], self.slope[:, chosen],
                          self.counts[:, chosen], tuple(a[..., chosen] for a in self.earlier))


class Stepped(NamedTuple):
    """
    Result of a step.

    Parameters
    ----------
    state : State
        State after the step; undefined where the step failed.
    outcome : torch.Tensor, shape (m,)
        OK, or the reason of failure.
    gradients : torch.Tensor, shape (m,)
        Number of gradients evaluated.

    """

    state: BatchState
    outcome: torch.Tensor
    gradients: torch.Tensor


class BatchSystem(NamedTuple):
    """
    Simulated system and its method.

    Parameters
    ----------
    gradient : callable
        Gradient of H.
    d : int
        Number of degrees of freedom.
    rounding : tuple of float
        See ``Kernel.gradient_scale``.
    h : float
        Step size [s].
    options : SolverOptions
        Solver options of the method.

    """

    gradient: Gradient
    d: int
    rounding: tuple[float, float]
    h: float
    options: SolverOptions

    def solve(self, equation: Equation, known: Known, x: torch.Tensor, scales: ResidualScales
              ) -> Solved:
        """Solve an equation; the outcome is IN_DOUBT if it may have other solutions."""
        solved = solve(Anderson(0) if self.options.solve is fixed_point else Anderson(), equation,
                       known, x, scales, self.options.max_iterations)
        if not self.options.connected or self.d > FAST_MATRIX:
            return solved
        quick = solved.iterations <= QUICK + min(self.d - 1, DEPTH)
        doubt = (solved.iterations >= 3) & (~quick | solved.slow_start)
        return solved._replace(outcome=torch.where(
            (solved.outcome == OK) & doubt, IN_DOUBT, solved.outcome))

    def scales(self, base: torch.Tensor, slope: torch.Tensor, h: float, which: int
               ) -> ResidualScales:
        """Return the scales of unknowns, shape (d, m); see ``set_scale`` of equations."""
        own = torch.maximum(base.abs(), abs(h) * slope.abs()).clamp_min(
            abs(h) * self.rounding[which])
        own = torch.where((own > 0.0) & (own < LEAST_SCALE), LEAST_SCALE, own)
        return ResidualScales(own.amax(dim=0).expand_as(own), own)


Step = Callable[[BatchSystem, BatchState], Stepped]


def plus(x: torch.Tensor, carry: torch.Tensor, increment: torch.Tensor) -> _Pair:
    """Return the compensated sum of x and an increment, and its carry; see ``arithmetic.plus``."""
    addend = increment + carry
    total = x + addend
    virtual = total - x
    return total, (x - (total - virtual)) + (addend - virtual)


def extrapolated(counts: torch.Tensor, earlier: torch.Tensor, base: torch.Tensor, x: torch.Tensor
                 ) -> torch.Tensor:
    """Return a guess from up to three earlier solutions, shape (3, N, m); x if there are none."""
    first, second, third = earlier
    x = torch.where(counts == 1, base + first, x)
    x = torch.where(counts == 2, base + (2.0 * first - second), x)
    return torch.where(counts == 3, base + (3.0 * (first - second) + third), x)


def remembered(counts: torch.Tensor, earlier: torch.Tensor, increment: torch.Tensor) -> _Pair:
    """Return the history with a solution, relative to its base, added for the next guess."""
    return (counts + 1).clamp_max(3), torch.cat([increment[None], earlier[:2]])


def _turned(gradient: torch.Tensor, dim: int = 0) -> torch.Tensor:
    """Return (H_p, -H_q) for a gradient (H_q, H_p)."""
    H_q, H_p = gradient.chunk(2, dim=dim)
    return torch.cat([H_p, -H_q], dim=dim)


def _halves(z: torch.Tensor, own: Sequence[int]) -> torch.Tensor:
    """Return q, p or both of (q, p), for own = [0], [1] or [0, 1]."""
    return torch.cat([z.chunk(2)[half] for half in own])


def _scales(system: BatchSystem, h: float, state: BatchState, own: Sequence[int]
            ) -> ResidualScales:
    rates = _turned(state.slope)
    found = (system.scales(_halves(state.z, [half]), _halves(rates, [half]), h, 1 - half)
             for half in own)
    return ResidualScales(*(torch.cat(parts) for parts in zip(*found, strict=True)))


def _solve_node(system: BatchSystem, h: float, own: Sequence[int], state: BatchState,
                history: _Pair) -> tuple[Solved, torch.Tensor, _Pair]:
    """
    Solve p1 = p - h H_q(q, p1), q1 = q + h H_p(q1, p), or both at once; own as in ``_halves``.

    Returns
    -------
    tuple
        The solution with the gradient at it; its carry; its history.

    """
    counts, earlier = history
    base, carry = _halves(state.z, own), _halves(state.carry, own)
    x = base + h * _halves(_turned(state.slope), own)
    if system.options.extrapolate:
        x = extrapolated(counts, earlier, base, x)

    def equation(known: Known, x: torch.Tensor) -> _Pair:
        z, carry = known
        found = system.gradient(_with_halves(z, own, x))
        return plus(_halves(z, own), carry, h * _halves(_turned(found), own))[0], found

    solved = system.solve(equation, (state.z, carry), x, _scales(system, h, state, own))
    total, rest = plus(base, carry, h * _halves(_turned(solved.found), own))
    return (solved, rest + (total - solved.x), remembered(counts, earlier, solved.x - base))


def _with_halves(z: torch.Tensor, own: Sequence[int], x: torch.Tensor) -> torch.Tensor:
    """Return (q, p) with q, p or both replaced by x."""
    halves = dict(zip(own, x.chunk(len(own)), strict=True))
    return torch.cat([halves.get(half, part) for half, part in enumerate(z.chunk(2))])


def _one_by_one(system: BatchSystem, state: BatchState, nodes: Sequence[Node]) -> Stepped:
    """Take a step of a method whose nodes are solved sequentially."""
    now, kept = state, list[_Pair]()
    outcome, iterations = torch.full_like(state.counts[0], OK), torch.zeros_like(state.counts[0])
    for a, b, u, w in nodes:
        if a or b:
            own, k = [half for half, part in enumerate((a, b)) if part], len(kept)
            solved, carry, history = _solve_node(
                system, (a or b) * system.h, own, now, (state.counts[k], state.earlier[k]))
            now = now._replace(z=_with_halves(now.z, own, solved.x), slope=solved.found,
                               carry=_with_halves(now.carry, own, carry))
            kept.append(history)
            outcome = torch.where(outcome == OK, solved.outcome, outcome)
            iterations = iterations + solved.iterations
        for half, move in enumerate((u - a, w - b)):
            if move:
                one, rest = plus(_halves(now.z, [half]), _halves(now.carry, [half]),
                                 move * system.h * _halves(_turned(now.slope), [half]))
                now = now._replace(z=_with_halves(now.z, [half], one),
                                   carry=_with_halves(now.carry, [half], rest))
    counts, earlier = zip(*kept, strict=True)
    return Stepped(now._replace(counts=torch.stack(counts), earlier=earlier), outcome, iterations)


def _gauss(system: BatchSystem, state: BatchState, stages: int) -> Stepped:
    """Take a Gauss step; the unknowns are the concatenated stages z, shape (s 2 d, m)."""
    h, n, m = system.h, 2 * system.d, state.z.shape[1]
    matrix, weights, start = (torch.from_numpy(a.T.copy()).to(state.z.device)[..., None, None]
                              for a in gauss_tableau(stages))
    flows = state.earlier[0]
    moved = row_dot(start, flows) if system.options.extrapolate else torch.zeros_like(flows)
    x = state.z + h * torch.where(state.counts[0] > 0, moved, 0.0)

    def equation(known: Known, x: torch.Tensor) -> _Pair:
        z, carry = known
        at = x.reshape(stages, n, -1).transpose(0, 1)
        found = system.gradient(at.reshape(n, -1)).reshape(at.shape).transpose(0, 1)
        flow = _turned(found, dim=1)
        value = z + (carry + h * row_dot(matrix, flow))
        return value.reshape(stages * n, -1), flow

    scales = ResidualScales(
        *(scale.repeat(stages, 1) for scale in _scales(system, h, state, [0, 1])))
    solved = system.solve(equation, (state.z, state.carry), x.reshape(stages * n, m), scales)
    flow = row_dot(weights, solved.found)
    z1, carry = plus(state.z, state.carry, h * flow)
    d_flow, e_flow = flow.chunk(2)
    return Stepped(BatchState(z1, carry, torch.cat([-e_flow, d_flow]),
                              torch.ones_like(state.counts), (solved.found,)),
                   solved.outcome, stages * solved.iterations)


# Methods whose nodes are solved sequentially.
_SEQUENTIAL = 'variational_euler', 'generalized_leapfrog', 'implicit_midpoint'


def step_of(integrator: Integrator, hamiltonian: Hamiltonian) -> Step:
    """
    Return the step of a method for many trajectories.

    Raises
    ------
    UnsupportedSystem
        The method is not supported; the message names supported methods for H.

    """
    if isinstance(integrator, Gauss):
        stages = integrator.stages
        return lambda system, state: _gauss(system, state, stages)
    name, tableau = method_name(integrator), integrator.partitioned
    if name not in _SEQUENTIAL or tableau is None:
        able = methods_that(lambda method: isinstance(method, Gauss) or
                            method_name(method) in _SEQUENTIAL, hamiltonian)
        raise UnsupportedSystem(f'{name} does not run on a device; remove device; valid methods: '
                                f'{able}')
    nodes = tableau.nodes()
    return lambda system, state: _one_by_one(system, state, nodes)


def first_state(system: BatchSystem, integrator: ImplicitIntegrator, z: torch.Tensor
                ) -> BatchState:
    """Return the State before the first step for z of shape (2 d, m)."""
    m, d = z.shape[1], system.d

    def zeros(*shape: int) -> torch.Tensor:
        return torch.zeros((*shape, m), dtype=z.dtype, device=z.device)
    earlier = [zeros(integrator.stages, 2 * d)] if isinstance(integrator, Gauss) else [
        zeros(3, n) for n in integrator.unknowns(d)]
    counts = torch.zeros((len(earlier), m), dtype=torch.int64, device=z.device)
    return BatchState(z, zeros(2 * d), system.gradient(z), counts, tuple(earlier))
