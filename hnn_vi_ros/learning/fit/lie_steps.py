# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Steps of the methods on a group in torch: what windows of bodies that turn are simulated by.

They are those of the compiled methods of the same names on the same H, with friction and inputs
where these add forces, so that a model runs as it was trained. Each implicit equation r(w) = 0 is
solved by Newton's method, which is not recorded; one step of it more, with its matrix held, is
recorded, and has the derivatives of the solution (the implicit function theorem).
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol

from hnn_vi_ros.learning.families.choices import LieMethod, RetractionName
from hnn_vi_ros.learning.families.newton import newton
import torch

# |x|^2 / 4 below which coefficients are those at it: what they are multiplied by is |x|^2.
_LEAST = 1e-8
# x cross, row by row, of x along each axis.
_CROSS = torch.tensor([[0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0],
                       [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0],
                       [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]], dtype=torch.float64)


class Held(Protocol):
    """A body at a held pose, under a held input."""

    def rates(self, p: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return H_p, and g^* H_g less all forces, both of shape (N, k), at momenta (N, k)."""

    def velocity(self, p: torch.Tensor) -> torch.Tensor:
        """Return H_p, shape (N, k)."""


class Body(Protocol):
    """Body that is simulated; k is 3 for a rotation, 6 for a pose."""

    velocity_unit: torch.Tensor
    momentum_unit: torch.Tensor

    def held(self, x: torch.Tensor, R: torch.Tensor, u: torch.Tensor) -> Held:
        """Return the body at places (N, k - 3) and attitudes (N, 3, 3), inputs (N, m)."""


class Node(NamedTuple):
    """Places (N, k - 3), attitudes (N, 3, 3) and momenta (N, k) at one time."""

    x: torch.Tensor
    R: torch.Tensor
    p: torch.Tensor


class Retraction(NamedTuple):
    """The coefficients of integrators.lie.retractions, at vectors of squared length 4 y."""

    turn: torch.Tensor
    twist: torch.Tensor
    along: torch.Tensor
    squared: torch.Tensor
    own: torch.Tensor
    cross: torch.Tensor
    line: torch.Tensor


def _cayley(x: torch.Tensor) -> Retraction:
    share = 1.0 / (1.0 + 0.25 * x.square().sum(dim=1, keepdim=True))
    zero = torch.zeros_like(share)
    return Retraction(share, 0.5 * share, zero + 0.25, zero, share, 0.5 * share, zero)


def _exponential(x: torch.Tensor) -> Retraction:
    y = (0.25 * x.square().sum(dim=1, keepdim=True)).clamp_min(_LEAST)
    half = y.sqrt()
    sine, cosine = half.sin() / half, half.cos()
    sines, cosines = (1.0 - sine) / y, (1.0 - cosine) / y
    bend = (cosines - sines) / (4.0 * sine)
    return Retraction(sine * cosine, 0.5 * sine.square(), bend, bend, sine * cosine,
                      0.5 * sine.square(), 0.25 * (sines + sine * cosines))


RETRACTIONS: dict[RetractionName, Callable[[torch.Tensor], Retraction]] = {
    'cayley': _cayley, 'exponential': _exponential}


def hat(x: torch.Tensor) -> torch.Tensor:
    """Return the matrices, shape (N, 3, 3), of x cross."""
    return (x @ _CROSS).reshape(-1, 3, 3)


def turned(R: torch.Tensor, x: torch.Tensor, tau: Retraction) -> torch.Tensor:
    """Return R tau(x), shape (N, 3, 3)."""
    cross = hat(x)
    return R + R @ (tau.turn[:, :, None] * cross + tau.twist[:, :, None] * (cross @ cross))


def _bend(x: torch.Tensor, m: torch.Tensor, tau: Retraction, side: float) -> torch.Tensor:
    """Return what (dtau^-1_(side x))^* m is more than m."""
    return (0.5 * side * torch.linalg.cross(x, m)
            + tau.along * (x * m).sum(dim=1, keepdim=True) * x
            - tau.squared * x.square().sum(dim=1, keepdim=True) * m)


class LieSteps:
    """
    Steps of a body, one after another, of one size.

    Parameters
    ----------
    body : Body
        What is simulated.
    method, retraction : str
        As a scene names them.
    step_size : float
        h [s].

    """

    def __init__(self, body: Body, method: LieMethod, retraction: RetractionName,
                 step_size: float):
        self._body, self._h = body, step_size
        self._tau = RETRACTIONS[retraction]
        self._step = {'lie_leapfrog': self._leapfrog,
                      'lie_variational_euler': self._variational_euler}[method]
        self._matrices: dict[str, torch.Tensor] = {}

    def __call__(self, node: Node, u: torch.Tensor) -> Node:
        """Return the node after one step with a held input, shape (N, m)."""
        return self._step(node, u)

    def _solve(self, name: str, residual: Callable[[torch.Tensor], torch.Tensor],
               guess: torch.Tensor, unit: torch.Tensor) -> torch.Tensor:
        w, J = newton(residual, guess.detach(), self._matrices.get(name), unit, unit)
        self._matrices[name] = J.detach()
        return w - torch.linalg.solve_ex(J, residual(w)[:, :, None])[0][:, :, 0]

    def _inside(self, name: str, held: Held, h: float, right: torch.Tensor) -> torch.Tensor:
        """Return mu of (dtau^-1_(h xi))^* mu = right - h g^* H_g(mu)."""
        def residual(mu: torch.Tensor) -> torch.Tensor:
            velocity, slope = held.rates(mu)
            x = h * velocity[:, -3:]
            bend = _bend(x, mu[:, -3:], self._tau(x), 1.0)
            return mu + h * slope - right + _only_turn(bend, mu)

        # Recorded: what the held body knows from here on is used by the recorded step as well.
        guess = right - h * held.rates(right)[1]
        return self._solve(name, residual, guess, self._body.momentum_unit)

    def _leapfrog(self, node: Node, u: torch.Tensor) -> Node:
        h = 0.5 * self._h
        held = self._body.held(node.x, node.R, u)
        mu = self._inside('momenta', held, h, node.p)
        velocity, slope = held.rates(mu)
        x = h * velocity[:, -3:]
        place, R = node.x + h * velocity[:, :-3], turned(node.R, x, self._tau(x))
        p = node.p - h * slope - _only_turn(torch.linalg.cross(x, mu[:, -3:]), mu)
        return self._outside(Node(place, R, p), u, h, h * velocity)

    def _outside(self, node: Node, u: torch.Tensor, h: float, guess: torch.Tensor) -> Node:
        """Return the node after half a step that is implicit in the pose."""
        def pose(change: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
            x = change[:, -3:]
            tau, turning = self._tau(x), node.p[:, -3:]
            mu = (tau.own * turning - tau.cross * torch.linalg.cross(x, turning)
                  + tau.line * (x * turning).sum(dim=1, keepdim=True) * x)
            return (node.x + change[:, :-3], turned(node.R, x, tau),
                    torch.cat([node.p[:, :-3], mu], dim=1))

        def residual(change: torch.Tensor) -> torch.Tensor:
            place, R, mu = pose(change)
            return change - h * self._body.held(place, R, u).velocity(mu)

        change = self._solve('pose', residual, guess, abs(h) * self._body.velocity_unit)
        place, R, mu = pose(change)
        slope = self._body.held(place, R, u).rates(mu)[1]
        bend = torch.linalg.cross(change[:, -3:], mu[:, -3:])
        return Node(place, R, node.p - h * slope - _only_turn(bend, mu))

    def _variational_euler(self, node: Node, u: torch.Tensor) -> Node:
        h = self._h
        velocity = self._body.held(node.x, node.R, u).velocity(node.p)
        x = h * velocity[:, -3:]
        tau = self._tau(x)
        place, R = node.x + h * velocity[:, :-3], turned(node.R, x, tau)
        right = node.p + _only_turn(_bend(x, node.p[:, -3:], tau, -1.0), node.p)
        held = self._body.held(place, R, u)
        return Node(place, R, self._inside('momenta', held, h, right))


def _only_turn(torque: torch.Tensor, p: torch.Tensor) -> torch.Tensor:
    """Return vectors of shape (N, 3) in the last columns of those of the shape of p."""
    return torch.nn.functional.pad(torque, (p.shape[1] - 3, 0))
