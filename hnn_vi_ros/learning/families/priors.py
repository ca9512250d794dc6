# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Priors of a mechanical network in torch: rigid links in a plane, and exact systems."""

from collections.abc import Callable, Sequence
from types import FunctionType
from typing import Any

from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.models.exact_prior import exact_system, functions_of
from hnn_vi_ros.models.mechanical_card import Quantity
from hnn_vi_ros.models.planar_chain import chain_terms, parameter_names
import numpy as np
import torch

# The units of inertia and of torque, by the unit of momenta.
_UNITS = {'N m s': ('kg m2', 'N m'), 'kg m2/s': ('kg m2', 'N m')}
# A fit of links begins with at least this inertia, in units of that of the data, and with at most
# this share of the largest possible coupling.
_LEAST, _MOST = 1e-3, 0.9
# Parameters of exact systems begin at their defaults, and stay above this share of them.
_LEAST_SHARE = 1e-6


class Prior(torch.nn.Module):
    """
    M and V of a system whose parameters are fitted.

    ``names`` are its parameters; ``linear`` is whether M and V are linear in them.
    """

    names: list[str]
    linear = False

    def mass(self, q: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
        """Return M, shape (N, d, d)."""
        raise NotImplementedError

    def slopes(self, q: torch.Tensor, v: torch.Tensor, values: torch.Tensor
               ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return (M v)' at held v, and (v . M v)_q / 2 - V_q, both of shape (N, d)."""
        raise NotImplementedError

    def forces(self, q: torch.Tensor, v: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
        """Return (M v)' at held v - (v . M v)_q / 2 + V_q, shape (N, d)."""
        turned, slope = self.slopes(q, v, values)
        return turned - slope


class PlanarChain(Prior):
    """
    The parameters of models/planar_chain.py, by unknowns for which M is always positive definite.

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


class ExactPrior(Prior):
    """
    M and V of an exact system; see models/exact_prior.py.

    Its parameters are their defaults times exp(x).

    Parameters
    ----------
    kind : str
        Its name in scenes.

    """

    def __init__(self, kind: str):
        super().__init__()
        self.system = exact_system(kind)
        self.names = [*self.system.defaults]
        _, gradient, hessian_vector = functions_of(HAMILTONIANS[kind]())
        self._gradient, self._hessian_vector = in_torch(gradient), in_torch(hessian_vector)
        d = self.system.dimension
        for name, values in (
                ('defaults', torch.tensor([*self.system.defaults.values()], dtype=torch.float64)),
                ('identity', torch.eye(d, dtype=torch.float64))):
            self.register_buffer(name, values, persistent=False)
        self.raw = torch.nn.Parameter(torch.zeros(len(self.names), dtype=torch.float64))

    def values(self) -> torch.Tensor:
        """Return the parameters, shape (k,), in the order of their names."""
        return self.defaults * torch.exp(self.raw)

    def raw_of(self, values: torch.Tensor) -> torch.Tensor:
        """Return the raw parameters of values."""
        return torch.log(torch.clamp(values / self.defaults, min=_LEAST_SHARE))

    def scale(self) -> torch.Tensor:
        """Return the usual sizes of the parameters, shape (k,)."""
        return self.defaults

    def quantities(self, p_unit: str) -> dict[str, Quantity]:
        """Return the parameters, in the units of the system."""
        return {name: Quantity(value=value, unit=f'that of {self.system.kind}')
                for name, value in zip(self.names, self.values().tolist(), strict=True)}

    def mass(self, q: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
        """Return M, shape (N, d, d)."""
        columns = [self._slopes(q, unit.expand(q.shape), values)[1] for unit in self.identity]
        return torch.linalg.inv(torch.stack(columns, dim=2))

    def slopes(self, q: torch.Tensor, v: torch.Tensor, values: torch.Tensor
               ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return (M v)' at held v, and (v . M v)_q / 2 - V_q, both of shape (N, d)."""
        mass = self.mass(q, values)
        momentum = (mass @ v[:, :, None])[:, :, 0]
        at_q, at_p = (_Columns([None] * q.shape[1]) for _ in range(2))
        self._hessian_vector(self._parameters_of(values), columns(q), columns(momentum),
                             columns(v), columns(torch.zeros_like(v)), at_q, at_p)
        turned = -(mass @ stacked(at_p, q)[:, :, None])[:, :, 0]
        return turned, -self._slopes(q, momentum, values)[0]

    def _slopes(self, q: torch.Tensor, p: torch.Tensor, values: torch.Tensor
                ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return H_q and H_p, both of shape (N, d)."""
        dH_dq, dH_dp = (_Columns([None] * q.shape[1]) for _ in range(2))
        self._gradient(self._parameters_of(values), columns(q), columns(p), dH_dq, dH_dp)
        return stacked(dH_dq, q), stacked(dH_dp, q)

    def _parameters_of(self, values: torch.Tensor) -> tuple[Any, ...]:
        found = [*self.system.others]
        for place, value in zip(self.system.places, values, strict=True):
            found[place] = value
        return tuple(found)


class _Columns(list[Any]):
    """The columns of all states at once, in place of the array (d,) of one state."""

    @property
    def size(self) -> int:
        """Return d."""
        return len(self)

    def __getitem__(self, place: Any) -> Any:
        """Return one, or some of them."""
        found = super().__getitem__(place)
        return _Columns(found) if isinstance(place, slice) else found


def columns(x: torch.Tensor) -> _Columns:
    """Return the columns of states (N, d)."""
    return _Columns(x.unbind(dim=1))


def stacked(found: Sequence[Any], like: torch.Tensor) -> torch.Tensor:
    """Return columns as a tensor; some of them may be one number."""
    zero = torch.zeros_like(like[:, 0])
    return torch.stack([zero + column for column in found], dim=1)


def in_torch(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of a kernel that takes tensors for numbers: ``np`` is torch in it."""
    assert isinstance(function, FunctionType)
    names = {name: in_torch(value) if isinstance(value, FunctionType) else value
             for name, value in function.__globals__.items()
             if name in function.__code__.co_names}
    names |= {'np': torch} if 'np' in names else {}
    return FunctionType(function.__code__, function.__globals__ | names, function.__name__)
