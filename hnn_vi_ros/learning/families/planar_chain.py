# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A chain of rigid links in a plane, in torch: what is fitted of it."""

from collections.abc import Sequence

from hnn_vi_ros.models.mechanical_card import Quantity
from hnn_vi_ros.models.planar_chain import chain_terms, parameter_names
import numpy as np
import torch

# Units of inertia and of torque, by those of momenta.
_UNITS = {'N m s': ('kg m2', 'N m'), 'kg m2/s': ('kg m2', 'N m')}
# Least inertia, in units of that of the data, and largest share of what a coupling can be, that
# a fit begins with.
_LEAST, _MOST = 1e-3, 0.9


class PlanarChain(torch.nn.Module):
    """
    The parameters of models/planar_chain.py, of which M is positive definite whatever they are.

    Inertias are u exp(x); the coupling of two links is sqrt(I_1 I_2) tanh(x), all that M > 0
    demands; gravities are u x; with the unit u.

    Parameters
    ----------
    features : sequence of sequence of float
        Rows of the angles of the links from the vertical.
    inertia : float
        The unit of inertias, and of gravities.

    """

    linear = True

    def __init__(self, features: Sequence[Sequence[float]], inertia: float):
        super().__init__()
        self.names = parameter_names(features)
        # The numbers of inertias, couplings, gravities and inertias of motors.
        self._sizes = [sum(name.startswith(kind) for name in self.names)
                       for kind in ('inertia', 'coupling', 'gravity', 'motor_inertia')]
        # M and V are linear in the parameters; these are the terms of each.
        units = [chain_terms(features, dict(zip(self.names, row, strict=True)))
                 for row in np.eye(len(self.names))]
        for name, values in (
                ('mass_rows', units[0].mass_rows),
                ('matrices', np.stack([unit.matrices for unit in units])),
                ('rows', units[0].rows),
                ('weights', np.stack([unit.weights for unit in units])),
                ('unit', np.array(inertia))):
            self.register_buffer(name, torch.tensor(values), persistent=False)
        self.raw = torch.nn.Parameter(torch.zeros(len(self.names), dtype=torch.float64))

    def values(self) -> torch.Tensor:
        """Return the parameters, shape (k,), in the order of their names."""
        inertias, couplings, gravities, motors = self.raw.split(self._sizes)
        # sqrt(I_1 I_2) is u exp((x_1 + x_2) / 2).
        size = torch.exp(0.5 * inertias.sum())
        return self.unit * torch.cat([
            torch.exp(inertias), torch.tanh(couplings) * size, gravities, torch.exp(motors)])

    def scale(self) -> torch.Tensor:
        """Return the usual sizes of the parameters, shape (k,)."""
        return self.unit.expand(len(self.names))

    def quantities(self, p_unit: str) -> dict[str, Quantity]:
        """Return the parameters with their units, for momenta in this one and angles in rad."""
        inertia, gravity = _UNITS.get(p_unit, (f'{p_unit} s', f'{p_unit}/s'))
        return {name: Quantity(
            value=value, unit=gravity if name.startswith('gravity') else inertia)
            for name, value in zip(self.names, self.values().tolist(), strict=True)}

    def raw_of(self, values: torch.Tensor) -> torch.Tensor:
        """Return the raw parameters of values; not a number where M would not be positive."""
        inertias, couplings, gravities, motors = values.split(self._sizes)
        return torch.cat([
            torch.log(inertias / self.unit), torch.atanh(couplings / inertias.prod().sqrt()),
            gravities / self.unit, torch.log(motors / self.unit)])

    def possible(self, values: torch.Tensor) -> torch.Tensor:
        """Return the next values with a positive definite M, by some margin."""
        inertias, couplings, gravities, motors = values.split(self._sizes)
        least = _LEAST * float(self.unit)
        inertias = inertias.clamp(min=least)
        most = _MOST * inertias.prod().sqrt()
        return torch.cat([inertias, torch.clamp(couplings, -most, most), gravities,
                          motors.clamp(min=least)])

    def mass(self, q: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
        """Return M, shape (N, d, d)."""
        d = q.shape[1]
        matrices = (values @ self.matrices.flatten(1)).reshape(-1, d * d)
        return (torch.cos(q @ self.mass_rows.T) @ matrices).reshape(-1, d, d)

    def forces(self, q: torch.Tensor, v: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
        """Return (M v)' at held v - (v . M v)_q / 2 + V_q, shape (N, d)."""
        turned, slope = self.slopes(q, v, values)
        return turned - slope

    def slopes(self, q: torch.Tensor, v: torch.Tensor, values: torch.Tensor
               ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return (M v)' at held v, and (v . M v)_q / 2 - V_q, both of shape (N, d)."""
        d = q.shape[1]
        rows = (values @ self.matrices.flatten(1)).reshape(-1, d)
        slope = -torch.sin(q @ self.mass_rows.T)
        products = (v @ rows.T).reshape(len(v), -1, d)
        turned = ((slope * (v @ self.mass_rows.T))[:, None, :] @ products)[:, 0]
        squares = (products @ v[:, :, None])[:, :, 0]
        weights = values @ self.weights
        return turned, (0.5 * (slope * squares) @ self.mass_rows
                        - (weights * torch.sin(q @ self.rows.T)) @ self.rows)
