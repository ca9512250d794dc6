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

    Inertias are u exp(x); couplings sqrt(I_i I_j) tanh(x), which is all that M > 0 asks of two
    links; gravities u x; with the unit u.

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
        # What the parameters are multiplied with, since M and V are linear in them.
        units = [chain_terms(features, dict(zip(self.names, row, strict=True)))
                 for row in np.eye(len(self.names))]
        for name, values in (
                ('mass_rows', units[0].mass_rows),
                ('matrices', np.stack([unit.matrices for unit in units])),
                ('rows', units[0].rows),
                ('weights', np.stack([unit.weights for unit in units])),
                ('couples', np.array([name.startswith('coupling') for name in self.names])),
                ('pulls', np.array([name.startswith('gravity') for name in self.names])),
                ('means', self._means()), ('unit', np.array(inertia))):
            self.register_buffer(name, torch.tensor(values), persistent=False)
        self.raw = torch.nn.Parameter(torch.zeros(len(self.names), dtype=torch.float64))

    def _means(self) -> np.ndarray:
        """Return the rows that are means of x of what a parameter's size is made of."""
        rows = np.eye(len(self.names))
        for row, name in zip(rows, self.names, strict=True):
            if name.startswith('coupling'):
                row[:] = [0.5 * (other in (f'inertia{name[-2]}', f'inertia{name[-1]}'))
                          for other in self.names]
            elif name.startswith('gravity'):
                row[:] = 0.0  # linear in x, whose exponential might overflow
        return rows

    def values(self) -> torch.Tensor:
        """Return the parameters, shape (k,), in the order of their names."""
        # sqrt(I_i I_j) is u exp((x_i + x_j) / 2).
        size = torch.exp(self.means @ self.raw)
        size = torch.where(self.couples, torch.tanh(self.raw) * size, size)
        return self.unit * torch.where(self.pulls, self.raw, size)

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
        found = dict(zip(self.names, values, strict=True))
        raw = []
        for name, value in found.items():
            if name.startswith('coupling'):
                i, j = name[-2], name[-1]
                raw.append(torch.atanh(
                    value / (found[f'inertia{i}'] * found[f'inertia{j}']).sqrt()))
            else:
                raw.append(value / self.unit if name.startswith('gravity')
                           else torch.log(value / self.unit))
        return torch.stack(raw)

    def possible(self, values: torch.Tensor) -> torch.Tensor:
        """Return the next values of which M is positive definite, by some margin."""
        found = dict(zip(self.names, values.clone(), strict=True))
        for name, value in found.items():
            if name.startswith('coupling'):
                i, j = name[-2], name[-1]
                most = _MOST * (found[f'inertia{i}'] * found[f'inertia{j}']).sqrt()
                found[name] = torch.clamp(value, -most, most)
            elif not name.startswith('gravity'):
                found[name] = torch.clamp(value, min=_LEAST * float(self.unit))
        return torch.stack([*found.values()])

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
