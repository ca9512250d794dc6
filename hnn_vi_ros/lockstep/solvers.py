# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Solvers of the equations x = G(x) of many trajectories, each by itself, carried to round-off.

They are the fixed-point iteration, the secant method and Anderson's of ``integrators.solvers``,
which has what is accepted, and why. A trajectory whose equation is solved, or is not to be solved
so, leaves the iteration: the others go on in arrays that have become as much shorter.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import NamedTuple

from hnn_vi_ros.integrators.base import NO_CONVERGENCE, NOT_FINITE, OK
from hnn_vi_ros.integrators.solvers import BACK, COMMON, GO_ON, OWN
from hnn_vi_ros.integrators.workspaces import DEPTH
import numpy as np
import torch

EPS = float(np.finfo(np.float64).eps)
# As in integrators.solvers: residuals that are not rounding alone; residuals above which, after so
# many iterations, there is no contraction to speak of.
NOISE, HOPELESS, PATIENCE = 1e-11, 1e-8, 5
# Known quantities of an equation's trajectories, each of shape (..., m); G(x), shape (N, m), and
# by-products of its evaluation.
Known = tuple[torch.Tensor, ...]
Equation = Callable[[Known, torch.Tensor], tuple[torch.Tensor, torch.Tensor]]


def dot(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """
    Return the sum of the products of rows, added one after another.

    ``torch.sum`` adds in an order that depends on how many trajectories there are.
    """
    total = a[0] * b[0]
    for k in range(1, len(a)):
        total = total + a[k] * b[k]
    return total


class Scales(NamedTuple):
    """
    Scales of residuals, shape (N, m).

    Parameters
    ----------
    common, own : torch.Tensor
        The scale of the largest unknown of its kind, and each one's own.

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
        The solutions, and what G found on the way at these.
    iterations : torch.Tensor, shape (m,)
        Evaluations of G.
    slow_start : torch.Tensor of bool, shape (m,)
        Whether the first iteration did not halve the residual.

    """

    outcome: torch.Tensor
    x: torch.Tensor
    found: torch.Tensor
    iterations: torch.Tensor
    slow_start: torch.Tensor


class Iteration(ABC):
    """Rule that makes the next iterate of the last ones; of the trajectories that are left."""

    patient = False

    @abstractmethod
    def improved(self, k: int, value: torch.Tensor, defect: torch.Tensor, changed: torch.Tensor
                 ) -> torch.Tensor:
        """
        Return the next x, shape (N, m).

        Parameters
        ----------
        k : int
            Iterations so far.
        value, defect : torch.Tensor, shape (N, m)
            G(x), and the residual relative to the scale.
        changed : torch.Tensor of bool, shape (m,)
            Where residuals have become relative to something else.

        """

    @abstractmethod
    def keep(self, chosen: torch.Tensor) -> None:
        """Forget all trajectories but those chosen, by their places."""


class FixedPoint(Iteration):
    """x = G(x), as the paper does."""

    patient = True

    def improved(self, k: int, value: torch.Tensor, defect: torch.Tensor, changed: torch.Tensor
                 ) -> torch.Tensor:
        """See Iteration."""
        return value

    def keep(self, chosen: torch.Tensor) -> None:
        """See Iteration."""


class Secant(Iteration):
    """The secant method for each unknown, where none depends on another."""

    def __init__(self) -> None:
        self._old: tuple[torch.Tensor, torch.Tensor] | None = None

    def improved(self, k: int, value: torch.Tensor, defect: torch.Tensor, changed: torch.Tensor
                 ) -> torch.Tensor:
        """See Iteration."""
        x = value
        if self._old is not None:
            old_value, old_defect = self._old
            change = defect - old_defect
            moves = change != 0.0
            x = torch.where(moves, value - defect / torch.where(moves, change, 1.0)
                            * (value - old_value), value)
        self._old = value, defect
        return x

    def keep(self, chosen: torch.Tensor) -> None:
        """See Iteration."""
        if self._old is not None:
            self._old = self._old[0][:, chosen], self._old[1][:, chosen]


class Anderson(Iteration):
    """Anderson's method of depth 3; a least-squares problem for each trajectory."""

    def __init__(self) -> None:
        # The last evaluations, the newest first; and from which iteration on they may be combined.
        self._old: list[tuple[torch.Tensor, torch.Tensor]] = []
        self._origin: torch.Tensor | None = None

    def improved(self, k: int, value: torch.Tensor, defect: torch.Tensor, changed: torch.Tensor
                 ) -> torch.Tensor:
        """See Iteration."""
        if self._origin is None:
            self._origin = torch.ones_like(changed, dtype=torch.int64)
        self._origin = torch.where(changed, k, self._origin)
        depth = (k - self._origin).clamp_max(min(len(value), DEPTH))
        x, weights, used = value, *self._projected(defect, depth)
        for j in range(len(weights) - 1, -1, -1):
            x = torch.where(used[j], x - weights[j] * (value - self._old[j][0]), x)
        self._old = [(value, defect), *self._old[:DEPTH - 1]]
        return x

    def _projected(self, defect: torch.Tensor, depth: torch.Tensor
                   ) -> tuple[list[torch.Tensor], list[torch.Tensor]]:
        """Return the weights of the earlier evaluations, shape (m,) each, and where they count."""
        basis: list[torch.Tensor] = []
        triangle: list[list[torch.Tensor]] = []
        right: list[torch.Tensor] = []
        used: list[torch.Tensor] = []
        for j in range(min(len(self._old), len(defect))):
            change = defect - self._old[j][1]
            size = dot(change, change)
            triangle.append([])
            for column in basis:
                share = dot(column, change)
                triangle[j].append(share)
                change = change - share * column
            left = dot(change, change)
            counts = (depth > j) & (left > 1e-20 * size)
            used.append(counts & used[-1] if used else counts)
            length = torch.where(used[j], left, 1.0).sqrt()
            basis.append(change / length)
            triangle[j].append(length)
            right.append(dot(basis[j], defect))
        weights = list(right)
        for j in range(len(right) - 1, -1, -1):
            total = right[j]
            for i in range(j + 1, len(right)):
                total = total - torch.where(used[i], triangle[i][j] * weights[i], 0.0)
            weights[j] = total / triangle[j][j]
        return weights, used

    def keep(self, chosen: torch.Tensor) -> None:
        """See Iteration."""
        self._old = [(value[:, chosen], defect[:, chosen]) for value, defect in self._old]
        if self._origin is not None:
            self._origin = self._origin[chosen]


class _Judged(NamedTuple):
    """Judgement of iterates: outcomes, or GO_ON with the ingredients of the next ones."""

    outcome: torch.Tensor
    value: torch.Tensor
    defect: torch.Tensor
    residual: torch.Tensor
    stage: torch.Tensor
    accepted: torch.Tensor


def solve(iteration: Iteration, equation: Equation, known: Known, x: torch.Tensor,
          scales: Scales, max_iterations: int) -> Solved:
    """
    Solve x = G(x) for each of m trajectories.

    Parameters
    ----------
    iteration : Iteration
        How.
    equation : callable
        Returns G(x), shape (N, m), and what it found on the way, shape (..., m).
    known : tuple of torch.Tensor, each (..., m)
        Its first argument.
    x : torch.Tensor, shape (N, m)
        First guesses.
    scales : Scales
        Of the unknowns.
    max_iterations : int
        After which an equation counts as not solved.

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
            scales = Scales(*(array[:, left] for array in scales))
            iteration.keep(left)
        x = iteration.improved(k, value, defect, changed)
    assert solved is not None, 'there is at least one iteration'
    return solved


def _residual(value: torch.Tensor, x: torch.Tensor, scale: torch.Tensor
              ) -> tuple[torch.Tensor, torch.Tensor]:
    """Return G(x) - x relative to a scale, shape (N, m), and its largest entries, NaN as such."""
    difference = value - x
    # A state and slope of zero say nothing about the size of the solution.
    size = torch.where(scale > 0.0, scale, torch.maximum(value.abs(), x.abs()))
    defect = torch.where(difference == 0.0, difference, difference / size)
    return defect, defect.abs().amax(dim=0)


def _judge(value: torch.Tensor, x: torch.Tensor, scales: Scales, previous: torch.Tensor,
           stage: torch.Tensor, accepted: torch.Tensor, is_last: bool) -> _Judged:
    """Say of each iterate whether it is good enough; see ``judge`` of integrators.solvers."""
    bound = max(8, len(x)) * EPS
    defect, residual = _residual(value, x, scales.common)
    own_defect, own = _residual(value, x, scales.own)
    finite, last = residual.isfinite(), torch.full_like(stage, is_last, dtype=torch.bool)
    back = (stage == OWN) & (residual > bound) & ~last
    on = (stage == COMMON) & ~((residual <= EPS)
                               | ((residual <= bound) & ((residual >= previous) | last)))
    enough = (stage == BACK) | (own <= bound) | last | ((stage == OWN) & (own > 0.5 * previous))
    # In this order: what is not finite is nothing else, and so on.
    outcome = torch.where(back | on, GO_ON, torch.where(enough, OK, GO_ON))
    refined = finite & ~back & ~on & ~enough
    return _Judged(
        torch.where(finite, outcome, NOT_FINITE),
        torch.where(back, accepted, value),
        torch.where(back, 0.0, torch.where(refined, own_defect, defect)),
        torch.where(refined, own, residual),
        torch.where(back, BACK, torch.where(refined, OWN, stage)),
        torch.where(refined, x, accepted))
