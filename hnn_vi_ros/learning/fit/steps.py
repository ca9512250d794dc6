# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Differentiable steps of variational methods in torch, from the tableaus of the integrators.

``path`` advances a field of (q, p). ``simulated`` advances windows of machine motions with the
compiled methods of the same names on the same H, with friction and commands added at the methods'
own nodes. The unknowns there are velocities w: with p = M(y) w and
F(y, w) = (w . M w)_q / 2 - V_q - friction, every method is a chain of nodes

    y = x + a w,    p - b (F + force) = c;    the next x = y + g w,    c = p + e (F + force)

with method-specific numbers a, b, g and e. Newton's method solves many nodes at once, of all
windows and several steps, starting at measured velocities: one batch for the network, with linear
terms passed from node to node. These iterations are not recorded by autograd. One more Newton
step at the solution is recorded, with the derivatives by x, c and w held constant; it yields the
derivatives of the solution by everything else (implicit function theorem).
"""

from collections.abc import Callable, Sequence
from functools import partial
import math
from typing import NamedTuple

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.integrators import INTEGRATORS, Node
from hnn_vi_ros.learning.families.base import ENOUGH, newton
from hnn_vi_ros.learning.families.choices import WindowMethod
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork
import torch

# Number of unknowns solved at once: fewer waste time on calls, more need memory and have
# worse initial guesses. Number of Newton iterations before each step is solved alone.
_AT_ONCE, _PATIENCE = 4096, 12
# Maximum number of steps solved at once; over more, dry friction makes Newton's method fail.
_MOST_STEPS = 100
# Relative tolerance of the equations before the last Newton step. Losses fall to 1e-10 of the
# squared rates, where an error of 1e-6 in their gradients would be visible.
_ENOUGH = 1e-9
# Fixed-point iterations, which cost a fraction of one of Newton's, go on while each reduces the
# residual by this factor.
_FAST = 0.3
_EPS = torch.finfo(torch.float64).eps

Field = Callable[[torch.Tensor], torch.Tensor]


def nodes(integrator: str) -> list[Node]:
    """Return the nodes of a diagonally implicit method, from its tableau."""
    tableau = INTEGRATORS[integrator]().partitioned
    assert tableau is not None, 'the methods of training have one'
    return tableau.nodes()


def path(field: Field, integrator: str, z0: torch.Tensor, h: float, count: int
         ) -> list[torch.Tensor]:
    """
    Return the states after each of some steps, differentiable with respect to all inputs.

    Newton's method solves the implicit equation R(Z, z, theta) = 0 of each node. By the implicit
    function theorem dZ = -(R_Z)^-1 (R_z dz + R_theta dtheta), which is the derivative of one more
    Newton step from the solution with its matrix held fixed.

    Parameters
    ----------
    field : callable
        ``field(z)`` returns (dq/dt, dp/dt) at states z = (q, p), shape (N, 2 d).
    integrator : str
        Name of the integrator.
    z0 : torch.Tensor, shape (N, 2 d)
        Initial states.
    h : float
        Step size [s].
    count : int
        Number of steps.

    Raises
    ------
    DataError
        Newton's method did not converge: the step is too large for the field.

    """
    z, found, rates, d = z0, list[torch.Tensor](), None, z0.shape[1] // 2
    chain = [[h * z0.new_tensor(pair).repeat_interleave(d) for pair in (
        (node.a, node.b), (node.u, node.w))] for node in nodes(integrator)]
    for _ in range(count):
        for own, onward in chain:
            rates = _rates(field, z, own, rates) if own.any() else field(z)
            z = z + onward * rates
        found.append(z)
    if not z.isfinite().all():
        raise DataError(f'a step of {h:g} s is too large for the learned field: its equation was '
                        'not solved; reduce loss.step_size')
    return found


def _rates(field: Field, z: torch.Tensor, own: torch.Tensor, before: torch.Tensor | None
           ) -> torch.Tensor:
    """Return field(Z) at the solution of Z = z + own field(Z), shape (N, 2 d)."""
    def explicit(z: torch.Tensor, about: torch.Tensor, share: float = 0.0) -> torch.Tensor | None:
        rates = field(z + own * about)
        same = torch.allclose(own * rates, own * about, share, 0.0)
        return rates if same else None

    start = z.detach()
    # If H is separable, the changes of an explicit node leave its own rates, which may be
    # those of the node before; two rows, which round otherwise, tell most fields that are not,
    # before all rows are evaluated.
    with torch.no_grad():
        known = before is not None and explicit(start[:2], before[:2], _ENOUGH) is not None
        separable = known or explicit(start[:2], field(start[:2])) is not None
    if separable:
        rates = explicit(z, before if known and before is not None else field(z))
        if rates is not None:
            return rates
    part = own.nonzero()[:, 0]
    unit, step = (start.abs().amax(dim=0) + _EPS)[part], own[part]

    def missing(z: torch.Tensor, at: torch.Tensor) -> torch.Tensor:
        return at - z[:, part] - step * field(z.index_copy(1, part, at))[:, part]

    with torch.no_grad():
        at, change = start[:, part], math.inf
        if before is not None:
            at = at + step * before[:, part]
        while change > _ENOUGH:
            left = missing(start, at)
            last, change = change, float((left / unit).abs().max())
            if not change < _FAST * last:
                break
            at = at - left
    found, matrix = newton(partial(missing, start), at, None, unit, unit, _ENOUGH)
    end = found - torch.linalg.solve_ex(matrix, missing(z, found)[:, :, None])[0][:, :, 0]
    return (end - z) / own if own.all() else field(z.index_copy(1, part, end))


class NodeChain(NamedTuple):
    """
    A method as a chain of nodes, in units of the step size h.

    Parameters
    ----------
    before : float
        Coefficient of the first x = q + before h v.
    nodes : list of tuple of float
        Coefficients a, b, g and e of each node of a step.
    after : float
        Coefficient of the end of a step, q = y + after h w and p = c, at the last node.

    """

    before: float
    nodes: list[tuple[float, float, float, float]]
    after: float


def _method(integrator: str) -> NodeChain:
    """Return the nodes of a method; an initial node with known velocity is used only once."""
    found = [(node.a, node.b, node.u - node.a, node.w - node.b) for node in nodes(integrator)]
    (a, b, before, force), *others = found
    after = found[-1][2]
    if a or b or force:
        return NodeChain(0.0, found, after)
    # The first node coincides with the last one of the previous step: both velocities are H_p.
    *inner, (a, b, g, e) = others
    return NodeChain(before, [*inner, (a, b, g + before, e)], after)


METHODS: dict[WindowMethod, NodeChain] = {
    name: _method(name) for name in ('implicit_midpoint', 'variational_euler',
                                     'generalized_leapfrog')}


class States(NamedTuple):
    """Coordinates, velocities and momenta after each step, shape (K, N, d) each."""

    q: torch.Tensor
    v: torch.Tensor
    p: torch.Tensor


class Chain(NamedTuple):
    """
    Successive nodes of N windows.

    Parameters
    ----------
    x, c : torch.Tensor, shape (N, d)
        Values at the first node.
    forces, guess : torch.Tensor, shape (n, N, d)
        Force and initial guess of the velocity at each node.
    numbers : torch.Tensor, shape (4, n, 1, 1)
        Coefficients a, b, g and e of each node.

    """

    x: torch.Tensor
    c: torch.Tensor
    forces: torch.Tensor
    guess: torch.Tensor
    numbers: torch.Tensor

    def of(self, rows: torch.Tensor) -> 'Chain':
        """Return the chain of some of the windows, detached from autograd."""
        return Chain(self.x.detach()[rows], self.c.detach()[rows], self.forces.detach()[:, rows],
                     self.guess[:, rows], self.numbers)

    def coordinates(self, w: torch.Tensor) -> torch.Tensor:
        """Return y of each node for velocities w, shape (n, N, d)."""
        a, _, g, _ = self.numbers
        return self.x + ((a + g) * w).cumsum(dim=0) - g * w

    def residuals(self, p: torch.Tensor, rate: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return p - b (F + force) - c, and the next c, shape (n, N, d) each."""
        _, b, _, e = self.numbers
        total = rate + self.forces
        after = p + e * total
        return p - b * total - torch.cat([self.c[None], after[:-1]]), after


class LinearisedChain(NamedTuple):
    """
    First x, shape (N, d), node velocities, (n, N, d), and the equations linearised at these.

    For changes z = (dx, dc) at a node and a residual r, dw = back z - inverse r; the change at the
    next node is z' = onward z - push r.
    """

    x: torch.Tensor
    w: torch.Tensor
    inverse: torch.Tensor
    back: torch.Tensor
    onward: torch.Tensor
    push: torch.Tensor

    def moves(self, r: torch.Tensor, first: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Propagate `first`, (N, 2 d); return all z, shape (n + 1, N, 2 d), and dw, (n, N, d)."""
        pushed = -(self.push @ r[..., None])
        z = [first[:, :, None]]
        for push, onward in zip(pushed, self.onward, strict=True):
            z.append(torch.baddbmm(push, onward, z[-1]))
        all_z = torch.stack(z)
        return all_z[..., 0], (self.back @ all_z[:-1] - self.inverse @ r[..., None])[..., 0]

    def update(self, rows: torch.Tensor, other: 'LinearisedChain') -> None:
        """Copy the solution of some windows from another."""
        for old, new in zip(self[1:], other[1:], strict=True):
            old[:, rows] = new


class Solutions:
    """
    Solver of the equations of successive chains; it can replay earlier solutions.

    Parameters
    ----------
    found : sequence of Found, optional
        Solutions to replay, at the same parameters; forward-mode derivatives need no iteration.

    Attributes
    ----------
    alone : int
        Number of window parts whose nodes had to be solved one after another.

    """

    def __init__(self, found: Sequence[LinearisedChain] | None = None) -> None:
        self._found = [] if found is None else [*found]
        self._next = None if found is None else iter(found)
        self.alone = 0

    def again(self) -> 'Solutions':
        """Return a solver that replays the solutions of this one."""
        return Solutions(self._found)

    def solve(self, machine: MechanicalNetwork, chain: Chain) -> LinearisedChain:
        """Return the solution of a chain, NaN in windows without one."""
        if self._next is not None:
            return next(self._next)
        with torch.no_grad():
            found, left = _solved(machine, chain)
            if len(left):
                self.alone += len(left)
                part = chain.of(left)
                w = _one_by_one(machine, part)
                found.update(left, _equations(machine, part, w)[0])
        self._found.append(found)
        return found


def simulated(machine: MechanicalNetwork, method: WindowMethod, q: torch.Tensor, v: torch.Tensor,
              forces: torch.Tensor, h: float, guess: torch.Tensor | None = None,
              solutions: Solutions | None = None) -> States:
    """
    Simulate windows, differentiable with respect to parameters and forces.

    Parameters
    ----------
    machine : MechanicalNetwork
        Network of the machine.
    method : str
        Name of the integrator.
    q, v : torch.Tensor, shape (N, d)
        Initial coordinates and velocities.
    forces : torch.Tensor, shape (K, N, d)
        Forces on the joints, held over each step.
    h : float
        Step size [s].
    guess : torch.Tensor, shape (K, N, d), optional
        Estimated mean velocity of each step, for example measured; default v.
    solutions : Solutions, optional
        Solver of the equations, if solutions are reused.

    Returns
    -------
    States
        States after each step, NaN in windows with an unsolvable step.

    """
    before, nodes, after = METHODS[method]
    solutions = solutions or Solutions()
    guess = v.detach().expand_as(forces) if guess is None else guess
    x, c, missed = q + before * h * v, machine.momenta(q, v)[0], torch.zeros_like(q)
    ends = []
    parts = max(-(-forces.numel() * len(nodes) // _AT_ONCE), -(-len(forces) // _MOST_STEPS))
    for force, about in zip(forces.tensor_split(min(parts, len(forces))),
                            guess.tensor_split(min(parts, len(forces))), strict=True):
        numbers = h * torch.tensor(nodes, dtype=q.dtype).repeat(len(force), 1)
        chain = Chain(
            x, c, force.repeat_interleave(len(nodes), dim=0),
            # Extrapolate the error of the measured velocities.
            (about + missed).repeat_interleave(len(nodes), dim=0), numbers.T[:, :, None, None])
        y, w, c_after = _recorded(machine, chain, solutions.solve(machine, chain))
        last = slice(len(nodes) - 1, None, len(nodes))
        ends.append(torch.stack([(y + after * h * w)[last], c_after[last]]))
        x, c = y[-1] + chain.numbers[2, -1] * w[-1], c_after[-1]
        missed = w[-1].detach() - about[-1]
    q, p = torch.cat(ends, dim=1)
    return States(q, machine.velocities(q.flatten(0, 1), p.flatten(0, 1)).view_as(q), p)


def _recorded(machine: MechanicalNetwork, chain: Chain, found: LinearisedChain
              ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return y, w and the next c of all nodes from one recorded Newton step."""
    y = chain._replace(x=found.x).coordinates(found.w)
    p, rate = (part.view_as(y) for part in machine.momenta(*(
        part.flatten(0, 1) for part in (y, found.w, chain.forces))))
    r, c_after = chain.residuals(p, rate)
    # The first residual already contains the change of c.
    z, dw = found.moves(r, torch.cat([chain.x - found.x, torch.zeros_like(chain.x)], dim=1))
    d = y.shape[2]
    return (y + z[:-1, :, :d] + chain.numbers[0] * dw, found.w + dw, c_after + z[1:, :, d:])


def _solved(machine: MechanicalNetwork, chain: Chain) -> tuple[LinearisedChain, torch.Tensor]:
    """Return the solution of a chain, and the indices of windows that did not converge."""
    w, unit = chain.guess.clone(), torch.tensor(machine.scales.v)
    left, found = torch.arange(len(chain.x)), None
    for _ in range(_PATIENCE):
        part = chain.of(left)
        at, r = _equations(machine, part, w[:, left])
        _, dw = at.moves(r, torch.zeros_like(r[0]).repeat(1, 2))
        w[:, left] += dw
        if found is None:
            found = at._replace(w=w)
        else:
            found.update(left, at._replace(w=w[:, left]))
        left = left[~(dw.abs() <= ENOUGH * unit).all(dim=2).all(dim=0)]
        if not len(left):
            break
    assert found is not None
    return found, left


def _equations(machine: MechanicalNetwork, chain: Chain, w: torch.Tensor
               ) -> tuple[LinearisedChain, torch.Tensor]:
    """Return the equations of a chain linearised at w, and their residuals, (n, N, d)."""
    y = chain.coordinates(w)
    p, rate, p_v, p_q, rate_q, rate_v = (
        part.unflatten(0, w.shape[:2])
        for part in machine.linearised(*(
            part.flatten(0, 1) for part in (y, w, chain.forces))))
    a, b, g, e = chain.numbers[..., None]
    d, one = w.shape[2], torch.eye(w.shape[2], dtype=w.dtype)
    by_x, c_by_x = p_q - b * rate_q, p_q + e * rate_q
    inverse = torch.linalg.inv_ex(p_v - b * rate_v + a * by_x)[0]
    # Derivatives of the next x and c by w.
    follows = torch.cat([(a + g) * one.expand_as(p_v), p_v + e * rate_v + a * c_by_x], dim=2)
    back = inverse @ torch.cat([-by_x, one.expand_as(by_x)], dim=3)
    onward = follows @ back
    onward[..., :d, :d] += one
    onward[..., d:, :d] += c_by_x
    return (LinearisedChain(chain.x, w, inverse, back, onward, follows @ inverse),
            chain.residuals(p, rate)[0])


def _one_by_one(machine: MechanicalNetwork, chain: Chain) -> torch.Tensor:
    """Return the node velocities, shape (n, N, d), solved one node after another."""
    scales, x, c, found = machine.scales, chain.x, chain.c, []
    unit, momentum = torch.tensor(scales.v), torch.tensor(scales.inertia * scales.v)
    w = chain.guess[0]
    for force, (a, b, g, e) in zip(chain.forces, chain.numbers[..., 0, 0].T, strict=True):
        w, _ = newton(partial(_residual, machine, x, c, force, a, b), w, None, unit, momentum)
        p, rate = machine.momenta(x + a * w, w, force)
        x, c = x + (a + g) * w, p + e * (rate + force)
        found.append(w)
    return torch.stack(found)


def _residual(machine: MechanicalNetwork, x: torch.Tensor, c: torch.Tensor, force: torch.Tensor,
              a: torch.Tensor, b: torch.Tensor, w: torch.Tensor) -> torch.Tensor:
    p, rate = machine.momenta(x + a * w, w, force)
    return p - b * (rate + force) - c
