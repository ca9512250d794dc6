# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A force that is commanded from outside while the simulation runs."""

from collections.abc import Sequence

from hnn_vi_ros.compilation import inlined
from hnn_vi_ros.effects.base import coordinate_index, Force, Live
from hnn_vi_ros.hamiltonians.parameters import check_positive
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class ExternalForce(Force):
    """
    The last commanded force on some coordinates, held until the next command or its time-out.

    The node takes commands from ``~/commands``. A command that is not renewed ends after the
    time-out, in simulated time, so that a controller that died does not push on (watchdog).
    Energy account: the power f . H_p.

    Parameters
    ----------
    coordinates : list of str
        The coordinates that a command has one number for, in this order.
    timeout : float
        How long a command holds, > 0 [s].

    Raises
    ------
    ValueError
        The time-out is not positive, or no coordinate is named, or one twice.

    References
    ----------
    J. Marsden, M. West, Discrete mechanics and variational integrators, Acta Numerica 2001,
    part 3.

    """

    depends_on_momentum = False

    def __init__(self, coordinates: list[str], timeout: float = 0.5):
        check_positive(timeout=timeout)
        if not coordinates or len(set(coordinates)) < len(coordinates):
            raise ValueError(f'coordinates = {coordinates} must name at least one, each once')
        self.coordinates, self.timeout = coordinates, float(timeout)

    def resolve(self, coordinates: Sequence[Coordinate], live: Live) -> tuple[np.ndarray]:
        """Return the command, the clock and the coordinates' places."""
        places = [coordinate_index(coordinates, name) for name in self.coordinates]
        return live.command, live.clock, np.array(places)

    def take(self, values: Sequence[float], parameters: tuple) -> None:
        """Take a command [N] or [N m] whole, or raise ValueError and leave the last one."""
        command, clock, places = parameters
        array = np.array(values, dtype=np.float64)
        if array.shape != places.shape or not np.isfinite(array).all():
            raise ValueError(f'command {array.tolist()}: expected {places.size} finite numbers, '
                             f'for {", ".join(self.coordinates)}')
        command[places], command[-1] = array, clock[0] + self.timeout

    @staticmethod
    @inlined
    def add_force(parameters: tuple, t: float, q: np.ndarray, p: np.ndarray,
                  velocity: np.ndarray, f_q: np.ndarray, f_p: np.ndarray) -> None:
        """Add the command while it holds."""
        command, clock, places = parameters
        # By the time at the start of the step: the force is constant over each step.
        if clock[0] < command[command.size - 1]:
            for k in range(places.size):
                f_p[places[k]] += command[places[k]]
