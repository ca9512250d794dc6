# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Steps of variational methods in torch, for machines: what windows of motions are simulated by.

They are those of the compiled methods of the same names on the same H, with friction and commands
where these add forces: at the methods' own nodes. But their unknown is a velocity: with
F(q, v) = (v . M v)_q / 2 - V_q - friction + force = dp/dt and M(q) v = p, each equation is

    r(w) = M(y) w - b F(y, w) - c = 0 at y = x + a w

for some numbers a, b and known x and c. Newton's method solves it without being recorded; one
step of it more from where r is zero, with its matrix J = r_w held, is recorded and has the
derivatives of the solution, -J^-1 times those of r by all else (the implicit function theorem).
"""

from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple, Protocol

from hnn_vi_ros.learning.families.structure import MotionScales
import torch

MethodName = Literal['implicit_midpoint', 'variational_euler', 'generalized_leapfrog', 'rk4']
# Newton's method begins with steps by the matrix of the step before, which cost a third, and ends
# where it changes velocities by less than this share of the usual ones: what is left is the square
# of it. Jumps of friction take more steps, of which some are halved.
_CHEAP, _ENOUGH, _MOST = 2, 1e-6, 40


class Machine(Protocol):
    """Machine that is simulated."""

    scales: MotionScales

    def momenta(self, q: torch.Tensor, v: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return p = M v and dp/dt where tau is zero, all of shape (N, d)."""

    def velocities(self, q: torch.Tensor, p: torch.Tensor) -> torch.Tensor:
        """Return M^-1 p, all of shape (N, d)."""


class Node(NamedTuple):
    """
    Coordinates, velocities and momenta at one time, each of shape (N, d).

    ``ahead`` is about the velocity that the next step is to find.
    """

    q: torch.Tensor
    v: torch.Tensor
    p: torch.Tensor
    ahead: torch.Tensor


def first_node(machine: Machine, q: torch.Tensor, v: torch.Tensor) -> Node:
    """Return the node of a state (q, v)."""
    return Node(q, v, machine.momenta(q, v)[0], v)


class Solutions:
    """
    Solves the equations of steps, one after another, or knows what was found of the same ones.

    Parameters
    ----------
    found : sequence of tuple of torch.Tensor, optional
        Solutions and matrices, at the same parameters: for derivatives by them in forward mode,
        for which Newton's method need not be repeated.

    """

    def __init__(self, found: Sequence[tuple[torch.Tensor, torch.Tensor]] | None = None) -> None:
        self._found = [] if found is None else [*found]
        self._next = None if found is None else iter(found)
        self._matrices: dict[tuple[float, float], torch.Tensor] = {}

    def again(self) -> 'Solutions':
        """Return what knows all that this one has found."""
        return Solutions(self._found)

    def solve(self, machine: Machine, numbers: tuple[float, float], x: torch.Tensor,
              c: torch.Tensor, force: torch.Tensor, guess: torch.Tensor) -> torch.Tensor:
        """Return w, shape (N, d), with its derivatives; not a number where none is found."""
        a, b = numbers

        def residual(w: torch.Tensor, x: torch.Tensor, c: torch.Tensor, force: torch.Tensor
                     ) -> torch.Tensor:
            p, rate = machine.momenta(x + a * w, w)
            return p - b * (rate + force) - c
        if self._next is None:
            known = x.detach(), c.detach(), force.detach()
            scales = machine.scales
            w, J = newton(lambda w: residual(w, *known), guess.detach(),
                          self._matrices.get(numbers), torch.tensor(scales.v),
                          torch.tensor(scales.inertia * scales.v))
            self._found.append((w, J))
            self._matrices[numbers] = J
        else:
            w, J = next(self._next)
        return w - _solve(J, residual(w, x, c, force))


def newton(residual: Callable[[torch.Tensor], torch.Tensor], guess: torch.Tensor,
           matrix: torch.Tensor | None, unit: torch.Tensor, residual_unit: torch.Tensor
           ) -> tuple[torch.Tensor, torch.Tensor]:
    """
    Return the roots of equations, shape (N, d), and their matrices, by Newton's method.

    Parameters
    ----------
    residual : callable
        Of shape (N, d), at unknowns of that shape, row by row.
    guess : torch.Tensor, shape (N, d)
        Where to begin.
    matrix : torch.Tensor, shape (N, d, d), optional
        About the derivative of the residual, for the first steps.
    unit, residual_unit : torch.Tensor, shape (d,)
        Usual sizes of the unknowns, and of the residual.

    Returns
    -------
    tuple of torch.Tensor
        Roots, not a number where there is none, and the derivatives of the residual at them.

    """
    best = w = guess
    least = torch.full(guess.shape[:1], torch.inf, dtype=guess.dtype)
    share, step = torch.ones_like(least), torch.zeros_like(guess)
    for k in range(_MOST):
        cheap = matrix is not None and k < _CHEAP
        value, slopes = (_value(residual, w), matrix) if cheap else _with_slopes(residual, w)
        size = (value / residual_unit).square().sum(dim=1)
        # A step is halved that makes it worse, or no number.
        better = size < least
        least, share = torch.where(better, size, least), torch.where(better, 1.0, 0.5 * share)
        best = torch.where(better[:, None], w, best)
        step = torch.where(better[:, None], _solve(slopes, value), step)
        w = best - share[:, None] * step
        # Also where rounding is all that is left, and no step makes it better.
        done = (step.abs() <= _ENOUGH * unit).all(dim=1)
        if not cheap and done.all():
            break
    return torch.where(done[:, None], w, torch.nan), slopes


def _value(residual: Callable[[torch.Tensor], torch.Tensor], w: torch.Tensor) -> torch.Tensor:
    with torch.no_grad():
        return residual(w)


def _with_slopes(residual: Callable[[torch.Tensor], torch.Tensor], w: torch.Tensor
                 ) -> tuple[torch.Tensor, torch.Tensor]:
    """Return r, shape (N, d), and r_w, shape (N, d, d), by one backward pass for all rows."""
    with torch.enable_grad():
        w = w.detach().requires_grad_()
        value = residual(w)
        units = torch.eye(w.shape[1], dtype=w.dtype)[:, None, :].expand(-1, len(w), -1)
        (rows,) = torch.autograd.grad(value, w, units, is_grads_batched=True)
    return value.detach(), rows.transpose(0, 1)


def _solve(matrix: torch.Tensor, right: torch.Tensor) -> torch.Tensor:
    return torch.linalg.solve_ex(matrix, right[:, :, None])[0][:, :, 0]


Step = Callable[[Solutions, Machine, Node, torch.Tensor, float], Node]


def _implicit_midpoint(solutions: Solutions, machine: Machine, start: Node, force: torch.Tensor,
                       h: float) -> Node:
    w = solutions.solve(machine, (0.5 * h, 0.5 * h), start.q, start.p, force, start.ahead)
    q = start.q + h * w
    p = 2.0 * machine.momenta(start.q + 0.5 * h * w, w)[0] - start.p
    v = machine.velocities(q, p)
    return Node(q, v, p, 2.0 * v - w)


def _variational_euler(solutions: Solutions, machine: Machine, start: Node, force: torch.Tensor,
                       h: float) -> Node:
    q = start.q + h * start.v
    v = solutions.solve(machine, (0.0, h), q, start.p, force, start.ahead)
    return Node(q, v, machine.momenta(q, v)[0], 2.0 * v - start.v)


def _generalized_leapfrog(solutions: Solutions, machine: Machine, start: Node,
                          force: torch.Tensor, h: float) -> Node:
    half = 0.5 * h
    before = solutions.solve(machine, (0.0, half), start.q, start.p, force, start.ahead)
    p_half, x = machine.momenta(start.q, before)[0], start.q + half * before
    after = solutions.solve(machine, (half, 0.0), x, p_half, force, before)
    q = x + half * after
    p = p_half + half * (machine.momenta(q, after)[1] + force)
    v = machine.velocities(q, p)
    return Node(q, v, p, 2.0 * v - after)


STEPS: dict[MethodName, Step] = {
    'implicit_midpoint': _implicit_midpoint, 'variational_euler': _variational_euler,
    'generalized_leapfrog': _generalized_leapfrog}
