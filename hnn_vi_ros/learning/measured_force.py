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
    A force on some coordinates, one for each step of a simulation, by the clock.

    It is no effect of scenes: there commands come one by one, by ``external_force``, and each
    takes a call. This one knows all of them when the first step is taken.

    Parameters
    ----------
    names : sequence of str
        m coordinates.
    steps : int
        Most steps of a run.

    Attributes
    ----------
    table : np.ndarray, shape (steps, m)
        The force in each step of a run [N], [N m]; to be filled before a start, as are ``times``.
    times : np.ndarray, shape (2,)
        The time at which the run begins [s], and steps per second.

    """

    depends_on_momentum, single, turns = False, True, False

    def __init__(self, names: Sequence[str], steps: int):
        self.names = tuple(names)
        self.table, self.times = np.zeros((steps, len(self.names))), np.zeros(2)

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> MeasuredParameters:
        """Return the clock, the coordinates' places, and the table."""
        places = np.array([coordinate_index(coordinates, name) for name in self.names])
        return MeasuredParameters(state.clock, places, self.table, self.times)

    @staticmethod
    @inlined
    def add_force(own: MeasuredParameters, t: float, q: np.ndarray, p: np.ndarray,
                  velocity: np.ndarray, f_q: np.ndarray, f_p: np.ndarray) -> None:
        """Add the force of the step that is being taken, by the time at its start."""
        row = int((own.clock[0] - own.times[0]) * own.times[1] + 0.5)
        row = max(0, min(row, own.table.shape[0] - 1))
        for k in range(own.places.size):
            f_p[own.places[k]] += own.table[row, k]
