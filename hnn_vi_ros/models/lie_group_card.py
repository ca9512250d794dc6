# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Card of a model of the family lie_group, without its networks."""

from collections.abc import Callable, Sequence
from typing import Annotated, Literal

from hnn_vi_ros.files import StrictModel
from hnn_vi_ros.models.families import NetworkShape
from pydantic import Field

PoseInput = Literal['position', 'attitude']
Positive = Annotated[float, Field(gt=0.0)]


class LieGroupCard(StrictModel):
    """Inputs, functions of (g, p), of the networks of a rotating body, with pi = (R^T p, L)."""

    kind: Literal['rotation', 'pose'] = Field(description='kind of the coordinate')
    mass_scale: list[Positive] = Field(description=(
        'S of M^-1 = S (L L^T + floor) S, one entry per column of pi'))
    floor: float = Field(ge=0.0, description='smallest eigenvalue of S^-1 M^-1 S^-1')
    diagonal: Literal['softplus', 'any'] = Field('softplus', description=(
        'diagonal of L: log(1 + exp(y)), or y itself, as in networks of others'))
    mass_depends_on: list[PoseInput] = Field(max_length=2, description=(
        'inputs of L; none for a constant M'))
    potential_depends_on: list[Literal['position', 'attitude', 'momentum']] = Field(
        min_length=1, max_length=3, description='inputs of V; with the momentum, V is all of H')
    dissipation_depends_on: list[PoseInput] | None = Field(None, max_length=2, description=(
        'inputs of D of the force -D v; none for a constant D, null for no dissipation'))
    input_map_depends_on: list[PoseInput] | None = Field(None, max_length=2, description=(
        'inputs of B of the force B u; none for a constant B, null for no input map'))

    def _check(self) -> None:
        if len(self.mass_scale) != self.size:
            raise ValueError(f'mass_scale has {len(self.mass_scale)} entries, expected '
                             f'{self.size}')
        if self.floor == 0.0 and self.diagonal == 'softplus':
            raise ValueError('floor must be greater than 0 unless diagonal is any')
        for name in ('mass', 'potential', 'dissipation', 'input_map'):
            seen = getattr(self, f'{name}_depends_on') or []
            if len(set(seen)) < len(seen):
                raise ValueError(f'{name}_depends_on lists an input twice')
            if self.kind == 'rotation' and 'position' in seen:
                raise ValueError(f'{name}_depends_on: a rotation has no position')

    @property
    def size(self) -> int:
        """Return the number k of columns of p."""
        return 3 if self.kind == 'rotation' else 6

    @property
    def networks(self) -> dict[str, NetworkShape]:
        """Return inputs and outputs of each network; an input map has k outputs for each input."""
        outputs: dict[str, Callable[[int, int], int]] = {
            'mass': lambda d, _: len(self.entries), 'potential': lambda d, _: 1,
            'dissipation': lambda d, _: len(self.entries),
            'input_map': lambda d, found: -(-found // self.size) * self.size}
        seen = {name: getattr(self, f'{name}_depends_on') for name in outputs}
        # A network without inputs has one input, 0.
        return {name: NetworkShape(max(1, len(self.columns(columns))), outputs[name])
                for name, columns in seen.items() if columns is not None}

    def columns(self, seen: Sequence[str]) -> list[int]:
        """Return the places of a network's inputs in (x, R row by row, pi)."""
        places = self.size - 3
        ends = {'position': (0, places), 'attitude': (places, places + 9),
                'momentum': (places + 9, places + 9 + self.size)}
        return [i for name, (first, last) in ends.items() if name in seen
                for i in range(first, last)]

    @property
    def entries(self) -> list[tuple[int, int]]:
        """Return the places of outputs in L, and in the root of D: triangles on the diagonal."""
        return [(first + i, first + j) for first in range(0, self.size, 3)
                for i in range(3) for j in range(i + 1)]
