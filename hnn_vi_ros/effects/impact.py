# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A rigid wall that a coordinate bounces off."""

from collections.abc import Sequence
from functools import cache
from typing import Any, Literal

from hnn_vi_ros.effects.base import coordinate_index, EffectState
from hnn_vi_ros.effects.bouncing import bounce, Bouncing, BouncingWork, Wall
from hnn_vi_ros.effects.crossings import Search
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.hamiltonians.parameters import check_finite
from hnn_vi_ros.integrators.base import Step
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class Impact(Bouncing):
    """
    A rigid wall at q_c = a: where the coordinate meets it, its velocity v turns into -e v.

    Each impact in a step is found, on the polynomial through the step and then by steps of the
    method that end on the wall to round-off; so are those of a path that leaves the wall again
    within the step. Between impacts are steps of the method, symplectic if the method is. The
    momentum p_c alone jumps. With e < 1 a body comes to rest where the geometric series of its
    flights ends, until it is pulled away. A step whose impacts cannot be resolved fails. Energy
    account: the change of H in the jump, none for e = 1 where H is quadratic in p.

    Parameters
    ----------
    coordinate : str
        The coordinate that the wall bounds.
    position : float
        a, in the coordinate's unit.
    side : str
        ``'above'`` or ``'below'``: where the motion is free.
    restitution : float
        e, from 0 to 1 [1].

    Raises
    ------
    ValueError
        A parameter out of its range.

    References
    ----------
    R. Fetecau, J. Marsden, M. Ortiz, M. West, Nonsmooth Lagrangian mechanics and variational
    collision integrators, SIAM J. Appl. Dyn. Syst. 2 (2003).

    """

    def __init__(self, coordinate: str, position: float = 0.0,
                 side: Literal['above', 'below'] = 'above', restitution: float = 1.0):
        check_finite(position=position)
        if not 0.0 <= restitution <= 1.0:
            raise ValueError(f'restitution = {restitution} must be from 0 to 1')
        self.coordinate, self.position = coordinate, float(position)
        self.conservative = restitution == 1.0
        self.sign, self.restitution = {'above': 1.0, 'below': -1.0}[side], float(restitution)

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> Wall:
        """Return the coordinate's place, a, the sign of the free side, e, and space."""
        return Wall(coordinate_index(coordinates, self.coordinate), self.position, self.sign,
                    self.restitution, Search.empty(), np.zeros((4, state.pending.size)),
                    np.zeros(1, dtype=np.int64))

    def check_state(self, hamiltonian: Hamiltonian, parameters: Wall, q: np.ndarray) -> None:
        """Raise ValueError if q, shape (d,), is behind the wall."""
        place, position = parameters.place, parameters.position
        if parameters.sign * (q[place] - position) < 0.0:
            raise ValueError(f'the initial {self.coordinate} = {float(q[place])!r} is behind the '
                             f'wall of an impact at {position!r}')

    @staticmethod
    def workspace(n: int, settings: tuple[Any, ...]) -> BouncingWork:
        """Return the state before a part of the step, and space; see StepEffect."""
        return BouncingWork.empty(n)

    @staticmethod
    @cache
    def wrap(step: tuple[Step, bool], keeps_gradient: bool) -> Step:
        """Return the step in the parts that impacts cut it into; see StepEffect."""
        return bounce(*step)
