# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Friction of joints in torch, trained with the networks of a machine or fitted with its body."""

from collections.abc import Sequence
import math

from hnn_vi_ros.learning.families.base import keep, Perceptron
from hnn_vi_ros.learning.families.choices import FeaturesChoice, MotionScales, Structure
from hnn_vi_ros.models import CoulombTerm, FrictionCard, StribeckTerm
import numpy as np
import torch

# Bounds of friction widths relative to the usual speed; without bounds they diverge.
NARROWEST, WIDEST = 3e-4, 1.0
_SPAN = math.log(WIDEST / NARROWEST)
# Narrowest initial width.
_FIRST = 0.003
# Initial diagonal of B in its own units: D = B B^T is initially as small as other friction.
_FIRST_ROOT = 0.2


class JointFrictionModule(torch.nn.Module):
    """
    b v + sum_k c_k tanh(v / w_k) [exp(-(v / s_k)^2)] + k abs(tau) tanh(v / s) + D(q) v, D = B B^T.

    ``network`` returns the entries of the lower triangular B, so that D is positive semidefinite
    for any outputs, and all friction dissipates energy. Directed friction has two values of each b
    and of each Coulomb c, by the sign of v. The offset of a motor is a friction independent of v.
    The force tau of a joint's motor loads its gear: the parameter of load friction is its size at
    a usual force, which fits treat as one more c.

    Parameters
    ----------
    structure : Structure
        Friction terms, and inputs of D.
    hidden : sequence of int
        Widths of the hidden layers of D.
    scales : MotionScales
        Scales of the data.
    seed : int
        Seed of the initial weights.

    """

    def __init__(self, structure: Structure, hidden: Sequence[int], scales: MotionScales,
                 seed: int):
        super().__init__()
        self.structure, self.choice = structure, structure.friction
        d, sides = len(structure.kinds), 1 + self.choice.directed
        force = scales.inertia * scales.a
        keep(self, viscous_unit=force / scales.v, force_unit=force, speed_unit=scales.v)
        # log(1 + exp(-3)) is 0.05: the initial friction is small.
        self.raw_viscous = torch.nn.Parameter(torch.full((sides, d), -3.0, dtype=torch.float64))
        self.raw_force = torch.nn.Parameter(
            torch.full((self.choice.coulomb * sides + self.choice.stribeck + self.choice.load, d),
                       -3.0, dtype=torch.float64))
        self.raw_offset = torch.nn.Parameter(
            torch.zeros((int(self.choice.offset), d), dtype=torch.float64))
        # The initial widths are spread over the usual ones.
        spread = torch.cat([
            torch.linspace(-1.0, 1.0, count + 2, dtype=torch.float64)[1:-1, None]
            for count in (self.choice.coulomb, self.choice.stribeck)])
        widths = self.speed_unit * _FIRST**(1.0 - torch.sigmoid(2.0 * spread))
        self.raw_width = torch.nn.Parameter(self.raw_of_widths(widths))
        self.raw_speed = torch.nn.Parameter(
            torch.zeros((self.choice.stribeck, d), dtype=torch.float64))
        if structure.friction_features is not None:
            self._make_network(structure.friction_features, hidden, scales, seed)

    def _make_network(self, features: list[list[float]], hidden: Sequence[int],
                      scales: MotionScales, seed: int) -> None:
        d = len(scales.v)
        rows, columns = np.tril_indices(d)
        keep(self, place=np.eye(d * d)[rows * d + columns])
        self.features = FeaturesChoice(self.structure.kinds, features)
        root = np.sqrt(self.viscous_unit.numpy())[rows]
        self.network = Perceptron(
            hidden if features else [1], *self.features.units(scales), root, seed,
            torch.tensor(_FIRST_ROOT * (rows == columns)))

    def coefficients(self) -> tuple[torch.Tensor, ...]:
        """
        Return b, c, w, s and k.

        b has shape (n, d) for n signs of v. c has n rows per Coulomb term, then one row per
        Stribeck term. w (k, d) belongs to all terms, s (l, d) to the last l. k has shape (1, d),
        or (0, d) without load-dependent friction.
        """
        positive = torch.nn.functional.softplus
        width = self.speed_unit * NARROWEST * torch.exp(_SPAN * torch.sigmoid(2 * self.raw_width))
        shares = positive(self.raw_force)
        terms = len(shares) - self.choice.load
        return (self.viscous_unit * positive(self.raw_viscous) * self.choice.viscous,
                self.force_unit * shares[:terms], width,
                self.speed_unit * torch.sigmoid(self.raw_speed), shares[terms:])

    def raw_of_widths(self, width: torch.Tensor) -> torch.Tensor:
        """Return the parameters of widths (k, d); see ``coefficients``."""
        share = torch.log(width / self.speed_unit / NARROWEST) / _SPAN
        return 0.5 * torch.logit(share, eps=1e-9)

    @property
    def switch(self) -> torch.Tensor:
        """Return the width of the sign change of load and directed friction, shape (d,)."""
        return self.speed_unit * math.sqrt(_FIRST * WIDEST)

    def shares(self, v: torch.Tensor) -> torch.Tensor:
        """Return the weight of the parameters of each sign at v, shape (N, n, d)."""
        if not self.choice.directed:
            return torch.ones_like(v)[:, None]
        ahead = torch.sigmoid(2.0 * v / self.switch)
        return torch.stack([ahead, 1.0 - ahead], dim=1)

    def offset(self) -> torch.Tensor:
        """Return the constant force, shape (1, d), or (0, d) if disabled."""
        return self.force_unit * self.raw_offset

    def roots(self, q: torch.Tensor) -> torch.Tensor:
        """Return B in D = B B^T, shape (N, d, d), at q of shape (N, d)."""
        d = q.shape[1]
        return (self.network(self.features(q)[0]) @ self.place).reshape(-1, d, d)

    def forward(self, q: torch.Tensor, v: torch.Tensor, tau: torch.Tensor | None = None
                ) -> torch.Tensor:
        """Return the friction to subtract from tau (default 0), all of shape (N, d)."""
        b, c, w, s, load = self.coefficients()
        shares = self.shares(v)
        total = (shares * b).sum(dim=1) * v - self.offset().sum(dim=0)
        if len(c):
            n, (sided, rest) = self.choice.coulomb, c.split([len(c) - len(s), len(s)])
            sided = (shares[:, None] * sided.unflatten(0, (n, -1))).sum(dim=2) if n else \
                v[:, None, :][:, :0]
            c = torch.cat([sided, rest.expand(len(v), -1, -1)], dim=1)
            terms = c * torch.tanh(v[:, None, :] / w)
            if len(s):
                ends = torch.exp(-(v[:, None, :] / s).square())
                terms = torch.cat([terms[:, :n], terms[:, n:] * ends], dim=1)
            total = total + terms.sum(dim=1)
        if self.choice.load and tau is not None:
            total = total + load[0] * tau.abs() * torch.tanh(v / self.switch)
        if self.structure.friction_features is not None:
            B = self.roots(q)
            total = total + (B @ (B.transpose(1, 2) @ v[:, :, None]))[:, :, 0]
        return total

    def values(self) -> torch.Tensor:
        """Return all b, c and offsets, shape (k,), in the order of ``columns``."""
        b, c, _, _, load = self.coefficients()
        return torch.cat([b[:self.choice.viscous * len(b)].flatten(), c.flatten(),
                          (self.force_unit * load).flatten(), self.offset().flatten()])

    def columns(self, v: torch.Tensor, tau: torch.Tensor) -> torch.Tensor:
        """Return the friction per unit of each of ``values``, shape (N, d, k)."""
        _, _, widths, speeds, _ = (part.detach() for part in self.coefficients())
        n = self.choice.coulomb
        sided = [*[v] * self.choice.viscous, *(torch.tanh(v / w) for w in widths[:n])]
        found = [one * share for one in sided for share in self.shares(v).unbind(dim=1)]
        found += [torch.tanh(v / w) * torch.exp(-(v / s).square())
                  for w, s in zip(widths[n:], speeds, strict=True)]
        found += [tau.abs() / self.force_unit * torch.tanh(v / self.switch)] * self.choice.load
        found += [-torch.ones_like(v)] * self.choice.offset
        identity = torch.eye(v.shape[1], dtype=v.dtype)
        return torch.stack([one * unit for one in found for unit in identity], dim=-1) \
            if found else v[:, :, None][:, :, :0]

    def card(self) -> FrictionCard:
        """Return the coefficients for the model card."""
        b, c, w, s, load = (part.detach().tolist() for part in self.coefficients())
        n, directed = self.choice.coulomb, self.choice.directed
        sides = 1 + directed
        return FrictionCard(
            viscous=b[0], viscous_back=b[1] if directed else None,
            switch=self.switch.tolist() if directed or load else None,
            load=load[0] if load else None,
            offset=self.offset().detach().tolist()[0] if self.choice.offset else None,
            coulomb=[CoulombTerm(force=c[sides * k], width=w[k],
                                 back=c[sides * k + 1] if directed else None) for k in range(n)],
            stribeck=[StribeckTerm(force=force, width=width, speed=speed)
                      for force, width, speed in zip(c[sides * n:], w[n:], s, strict=True)])
