# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Declaration of a method's demands on a system, and of its conservation properties."""

from dataclasses import dataclass
from typing import Literal

from hnn_vi_ros.errors import listed
from hnn_vi_ros.hamiltonians.base import Hamiltonian


@dataclass(frozen=True)
class Requirements:
    """
    Needs and claims of a method; every refusal of a system or an effect derives from it.

    Parameters
    ----------
    symmetric, symplectic : bool
        Properties of the map; symplectic in the 2-form that the method's docstring names.
    separable : bool
        Whether it needs H = T(p) + V(q), and forces that do not depend on p.
    coordinates : str
        ``'canonical'`` if it needs (q, p) that are; ``'any'`` if it is as good for a field
        u' = f(u) in any coordinates; ``'other'`` if it is made for those that are not canonical,
        on which no effect acts; ``'group'`` if it is made for those that turn. No other method
        takes such.
    hamiltonian : bool
        False if the map is made of something else than the kernel's H, which no effect can join.
    forces : bool
        Whether the map stays right where the kernel's gradient holds forces as well.
    from_state : bool
        False if the next step starts elsewhere than at the state that the last one ended in:
        nothing may change that state between them.

    """

    symmetric: bool
    symplectic: bool
    separable: bool = False
    coordinates: Literal['canonical', 'any', 'other', 'group'] = 'canonical'
    hamiltonian: bool = True
    forces: bool = True
    from_state: bool = True

    def take_force(self, depends_on_momentum: bool) -> bool:
        """Return whether the method takes a force at its nodes."""
        return self.hamiltonian and self.forces and not (depends_on_momentum and self.separable)

    def refusal(self, hamiltonian: Hamiltonian) -> str:
        """Return why a Hamiltonian cannot be integrated, to follow the method's name, or ''."""
        turning = listed(coordinate.name for coordinate in hamiltonian.coordinates
                         if coordinate.kind != 'scalar')
        if turning and self.coordinates != 'group':
            return (f'adds to coordinates, which would take a rotation ({turning}) off its '
                    'group')
        if not turning and self.coordinates == 'group':
            return 'is made for rotations and poses, of which this H has none'
        if not hamiltonian.canonical and self.coordinates == 'canonical':
            names = listed(coordinate.name for coordinate in hamiltonian.coordinates)
            return (f'needs canonical coordinates, which those of this model ({names}) are not: '
                    'its steps, those of eq. (6) too, would keep another 2-form than the one it '
                    'learned')
        if hamiltonian.canonical and self.coordinates == 'other':
            return ('is made for coordinates that are not canonical, those of a model of the '
                    'family symplectic_form')
        if self.separable and not hamiltonian.separable:
            return (f'needs H = T(p) + V(q), but {type(hamiltonian).__name__} does not '
                    'separate')
        return ''
