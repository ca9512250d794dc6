# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Changes of the payload of a robot while a simulation runs."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from hnn_vi_ros.effects.base import Effect, EffectState, Place
from hnn_vi_ros.effects.commands import Command, Commanded, PAYLOAD
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators import Integrator
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class NoColumns(NamedTuple):
    """Parameters of an effect that acts on no coordinate."""

    columns: np.ndarray


class PayloadChanges(Effect, Commanded):
    """
    Changes of the payload at constant velocities; their work is the jump of the energy.

    Parameters
    ----------
    robot : Hamiltonian
        H of a robot with a payload.

    """

    acts, takes, label = Place.COMMANDS, frozenset({PAYLOAD}), PAYLOAD

    def __init__(self, robot: Hamiltonian):
        self._robot: Any = robot

    def accepts(self, integrator: Integrator) -> bool:
        """Return True, since it acts between steps."""
        return True

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> NoColumns:
        """Return no columns."""
        return NoColumns(np.zeros(0, dtype=np.int64))

    def changing(self, parameters: NoColumns) -> dict[str, np.ndarray]:
        """Return the inertias of the bodies."""
        return {'payload.inertia': self._robot.bodies.inertia}

    def begin(self, parameters: NoColumns) -> None:
        """Return to the payload of the scene."""
        self._robot.change_payload()

    def prepare(self, command: Command, parameters: NoColumns, q: np.ndarray
                ) -> Callable[[], None]:
        """Return a function that replaces the payload."""
        numbers = self._robot.payload_numbers(command)
        return lambda: self._robot.change_payload(numbers)
