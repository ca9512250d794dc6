# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rigid stops at the limits of joints."""

from collections.abc import Sequence
from functools import cache
from typing import Any, Literal

from hnn_vi_ros.effects.base import EffectState
from hnn_vi_ros.effects.bouncing import Bouncing
from hnn_vi_ros.effects.crossings import Search
from hnn_vi_ros.effects.held import Stops, StopsWork
from hnn_vi_ros.effects.joints import check_given, joint_numbers
from hnn_vi_ros.effects.stops import stop
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.integrators.base import Step
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class JointLimits(Bouncing):
    """
    Rigid stops at the limits of joints, where the velocity v turns into -e v.

    Impacts are found as those of an ``impact``, to round-off. With e < 1 joints come to rest on
    their stops, and are held there together, until they are pulled away. Limits of velocity and
    effort are those of motors, and no business of a stop. Energy account: the change of H in the
    jumps, none for e = 1.

    Parameters
    ----------
    from_ : str, optional
        urdf: the limits of all joints as the URDF of H has them; continuous ones have none, and
        one that is missing beside the other is 0.
    lower, upper : dict of str to float, optional
        Limits by the names of coordinates, beside those of the URDF or in their place [rad], [m].
    restitution : float
        e, from 0 to 1 [1].

    Raises
    ------
    ValueError
        No limits, or a number that cannot be one.

    References
    ----------
    R. Fetecau, J. Marsden, M. Ortiz, M. West, Nonsmooth Lagrangian mechanics and variational
    collision integrators, SIAM J. Appl. Dyn. Syst. 2 (2003).

    """

    limits = True

    def __init__(self, from_: Literal['urdf'] | None = None,
                 lower: dict[str, float] | None = None, upper: dict[str, float] | None = None,
                 restitution: float = 0.0):
        check_given(from_, lower=lower, upper=upper)
        if not 0.0 <= restitution <= 1.0:
            raise ValueError(f'restitution = {restitution} must be from 0 to 1')
        self.source, self.lower, self.upper = from_, lower, upper
        self.restitution, self.conservative = float(restitution), restitution == 1.0

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> Stops:
        """Return the stops, the lower ones first, and space."""
        ends = [joint_numbers(coordinates, self.source, lambda joint: joint.bounds[0], self.lower),
                joint_numbers(coordinates, self.source, lambda joint: joint.bounds[1], self.upper)]
        for coordinate, low, high in zip(coordinates, *ends, strict=True):
            if low >= high:
                raise ValueError(f'the limits of {coordinate.name}, {low:g} and {high:g}, leave '
                                 'no room between; change them, or hold the joint by locked')
        # Copied to be contiguous, as those of one stop are: the same type to the compiler.
        rows, places = np.argwhere(np.isfinite(ends)).T.copy()
        n = len(places)
        if not n:
            raise ValueError('no joint of the URDF has limits; give lower or upper')
        return Stops(
            places, np.array(ends)[rows, places], 1.0 - 2.0 * rows, self.restitution,
            *Search.several(n), np.zeros((4, state.pending.size)), np.zeros(1, dtype=np.int64))

    def check_state(self, hamiltonian: Hamiltonian, parameters: Stops, q: np.ndarray) -> None:
        """Raise ValueError if a coordinate of q, shape (d,), is beyond a limit."""
        for place, position, sign in zip(
                parameters.places, parameters.positions, parameters.signs, strict=True):
            if sign * (q[place] - position) < 0.0:
                raise ValueError(
                    f'the initial {hamiltonian.coordinates[place].name} = {float(q[place])!r} is '
                    f'beyond the limit {float(position)!r}')

    @staticmethod
    def workspace(n: int, settings: tuple[Any, ...]) -> StopsWork:
        """Return the state before a part of the step, and space; see StepEffect."""
        return StopsWork.empty(n, settings[0].places.size)

    @staticmethod
    @cache
    def wrap(step: tuple[Step, bool], keeps_gradient: bool) -> Step:
        """Return the step in the parts that impacts cut it into; see StepEffect."""
        return stop(*step)
