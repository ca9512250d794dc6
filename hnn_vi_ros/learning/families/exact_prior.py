# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""An exact system in torch, whose parameters are fitted: its own functions, run on tensors."""

from collections.abc import Callable, Sequence
from types import FunctionType
from typing import Any

from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.models.exact_prior import exact_system, functions_of
from hnn_vi_ros.models.mechanical_card import Quantity
import torch

# Parameters begin at their defaults, and stay above this share of them.
_LEAST = 1e-6


class ExactPrior(torch.nn.Module):
    """
    M and V of an exact system; see models/exact_prior.py. Parameters are those of it times exp(x).

    Parameters
    ----------
    kind : str
        Its name.

    """

    linear = False

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
        return torch.log(torch.clamp(values / self.defaults, min=_LEAST))

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

    def forces(self, q: torch.Tensor, v: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
        """Return (M v)' at held v - (v . M v)_q / 2 + V_q, shape (N, d)."""
        turned, slope = self.slopes(q, v, values)
        return turned - slope

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
    """Numbers of one state each for all states at once: what stands for an array of shape (d,)."""

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
    """Return columns, of which some may be one number, as a tensor."""
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
