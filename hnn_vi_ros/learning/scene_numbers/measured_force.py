# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Forces that were measured, as an effect: what an external force would be commanded to do."""

from collections.abc import Sequence
from typing import NamedTuple

from hnn_vi_ros.effects.base import coordinate_index, EffectState, Force
from hnn_vi_ros.kernels.marks import inlined
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class MeasuredParameters(NamedTuple):
    """The clock, the places of the coordinates, and what ``MeasuredForce`` is given."""

    clock: np.ndarray
    places: np.ndarray
    table: np.ndarray
    times: np.ndarray


class MeasuredForce(Force):
    """
    A force on some coordinates that holds for a while, and then another one, by the clock.

    It is no effect of scenes: there commands come one by one, by ``external_force``, and each
    takes a call. This one knows all of them when the first step is taken.

    Parameters
    ----------
    names : sequence of str
        m coordinates.
    most : int
        Most forces of a run.

    """

    depends_on_momentum, single, turns = False, True, False

    def __init__(self, names: Sequence[str], most: int):
        self.names = tuple(names)
        self._table, self._times = np.zeros((most, len(self.names))), np.zeros(3)

    def take(self, forces: np.ndarray, begin: float, duration: float) -> None:
        """
        Take the forces of a run, before it starts.

        Parameters
        ----------
        forces : np.ndarray, shape (n, m)
            One after another [N], [N m]; the first one acts before, too, and the last one after.
        begin, duration : float
            Time at which the first one begins, and how long each holds [s].

        """
        self._table[:len(forces)] = forces
        self._times[:] = begin, 1.0 / duration, len(forces) - 1

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> MeasuredParameters:
        """Return the clock, the coordinates' places, and the table."""
        places = np.array([coordinate_index(coordinates, name) for name in self.names])
        return MeasuredParameters(state.clock, places, self._table, self._times)

    @staticmethod
    @inlined
    def add_force(own: MeasuredParameters, t: float, q: np.ndarray, p: np.ndarray,
                  velocity: np.ndarray, f_q: np.ndarray, f_p: np.ndarray) -> None:
        """Add the force of the step that is being taken, by the time at its start."""
        # Steps begin where a force does, or well after: by rounding also a little before.
        row = int(max(0.0, min((own.clock[0] - own.times[0]) * own.times[1] + 1e-9, own.times[2])))
        for k in range(own.places.size):
            f_p[own.places[k]] += own.table[row, k]
