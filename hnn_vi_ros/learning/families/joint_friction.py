# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Friction that is learned with a machine: the effect learned_friction, in torch."""

from collections.abc import Sequence
import math

from hnn_vi_ros.learning.families.perceptron import Perceptron
from hnn_vi_ros.learning.families.structure import Features, MotionScales, Structure
from hnn_vi_ros.models.mechanical_card import CoulombTerm, FrictionCard, StribeckTerm
import numpy as np
import torch

# Widths of friction lie between these shares of the usual speed: freed, they leave all bounds.
_NARROWEST, _WIDEST = 0.003, 1.0
# The least friction next to networks, as log(exp(x) - 1) of its share of the usual force, 0.7 %.
_LEAST = -5.0
# The diagonal of B at first, in units of its own: D = B B^T is as small as other friction.
_FIRST_ROOT = 0.2


class JointFriction(torch.nn.Module):
    """
    b v + sum_k c_k tanh(v / w_k) [exp(-(v / s_k)^2)] + D(q) v, with D = B B^T.

    The entries of the lower triangular B are outputs of ``network``, so that D is positive
    semidefinite for any outputs, and all friction dissipates energy.

    Parameters
    ----------
    structure : Structure
        What friction there is, and what D sees.
    hidden : sequence of int
        Widths of the hidden layers of D.
    scales : MotionScales
        Of the data.
    seed : int
        Of the initial weights.

    """

    def __init__(self, structure: Structure, hidden: Sequence[int], scales: MotionScales,
                 seed: int):
        super().__init__()
        d = len(structure.kinds)
        self.structure = structure
        terms = structure.coulomb + structure.stribeck
        force = scales.inertia * scales.a
        for name, values in (
                ('viscous_unit', force / scales.v), ('force_unit', force),
                ('speed_unit', scales.v)):
            self.register_buffer(name, torch.tensor(values), persistent=False)
        # log(1 + exp(-3)) is 0.05: little friction at first.
        self.raw_viscous = torch.nn.Parameter(torch.full((d,), -3.0, dtype=torch.float64))
        self.raw_force = torch.nn.Parameter(torch.full((terms, d), -3.0, dtype=torch.float64))
        # Widths at first spread over their bounds.
        spread = torch.linspace(-1.0, 1.0, terms + 2, dtype=torch.float64)[1:-1, None]
        self.raw_width = torch.nn.Parameter(spread.repeat(1, d))
        self.raw_speed = torch.nn.Parameter(
            torch.zeros((structure.stribeck, d), dtype=torch.float64))
        if structure.friction_features is not None:
            self._make_network(structure.friction_features, hidden, scales, seed)

    def _make_network(self, features: list[list[float]], hidden: Sequence[int],
                      scales: MotionScales, seed: int) -> None:
        rows, columns = np.tril_indices(len(scales.v))
        d = len(scales.v)
        place = np.zeros((len(rows), d * d))
        place[np.arange(len(rows)), rows * d + columns] = 1.0
        self.register_buffer('place', torch.tensor(place), persistent=False)
        self.features = Features(self.structure.kinds, features)
        root = np.sqrt(self.viscous_unit.numpy())[rows]
        self.network = Perceptron(
            hidden if features else [1], *self.features.units(scales), root, seed)
        with torch.no_grad():
            # Not zero, where the slope of B B^T would be none.
            self.network.linears[-1].weight.mul_(0.1)
            self.network.linears[-1].bias.copy_(torch.tensor(_FIRST_ROOT * (rows == columns)))

    def coefficients(self) -> tuple[torch.Tensor, ...]:
        """Return b (d,), c and w of all terms (k, d), and s (l, d) of the last l."""
        positive = torch.nn.functional.softplus
        span = math.log(_WIDEST / _NARROWEST)
        width = self.speed_unit * _NARROWEST * torch.exp(span * torch.sigmoid(2 * self.raw_width))
        return (self.viscous_unit * positive(self.raw_viscous) * self.structure.viscous,
                self.force_unit * positive(self.raw_force), width,
                self.speed_unit * torch.sigmoid(self.raw_speed))

    def roots(self, q: torch.Tensor) -> torch.Tensor:
        """Return B, shape (N, d, d), of D = B B^T, at q of shape (N, d)."""
        d = q.shape[1]
        return (self.network(self.features(q)[0]) @ self.place).reshape(-1, d, d)

    def forward(self, q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        """Return the friction that is taken from tau, all of shape (N, d)."""
        b, c, w, s = self.coefficients()
        total = b * v
        if len(c):
            terms, n = c * torch.tanh(v[:, None, :] / w), self.structure.coulomb
            if len(s):
                ends = torch.exp(-(v[:, None, :] / s).square())
                terms = torch.cat([terms[:, :n], terms[:, n:] * ends], dim=1)
            total = total + terms.sum(dim=1)
        if self.structure.friction_features is not None:
            B = self.roots(q)
            total = total + (B @ (B.transpose(1, 2) @ v[:, :, None]))[:, :, 0]
        return total

    def columns(self, v: torch.Tensor) -> torch.Tensor:
        """Return the friction of each b and c where it alone is one, shape (N, d, k), at v."""
        _, _, widths, speeds = (part.detach() for part in self.coefficients())
        found = [v] * self.structure.viscous
        for k, width in enumerate(widths):
            slower = k - self.structure.coulomb
            ends = torch.exp(-(v / speeds[slower]).square()) if slower >= 0 else 1.0
            found.append(torch.tanh(v / width) * ends)
        identity = torch.eye(v.shape[1], dtype=v.dtype)
        return torch.stack([one * unit for one in found for unit in identity], dim=-1) \
            if found else v[:, :, None][:, :, :0]

    def raise_to_least(self) -> None:
        """Clamp coefficients away from zero, where the gradient vanishes."""
        with torch.no_grad():
            for raw in (self.raw_viscous, self.raw_force):
                raw.clamp_(min=_LEAST)

    def scale(self, factor: float) -> None:
        """Multiply all of it by a factor."""
        for unit in (self.viscous_unit, self.force_unit):
            unit *= factor
        if self.structure.friction_features is not None:
            self.network.output_scale *= math.sqrt(factor)

    def card(self) -> FrictionCard:
        """Return the coefficients for the model card."""
        b, c, w, s = (part.detach().tolist() for part in self.coefficients())
        n = self.structure.coulomb
        return FrictionCard(
            viscous=b, coulomb=[CoulombTerm(force=force, width=width)
                                for force, width in zip(c[:n], w[:n], strict=True)],
            stribeck=[StribeckTerm(force=force, width=width, speed=speed)
                      for force, width, speed in zip(c[n:], w[n:], s, strict=True)])
