# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Simulations that go along with another one, under the same commands."""

from collections.abc import Sequence
import math
from typing import Any, cast, Protocol

from hnn_vi_ros.effects.commands import Command
from hnn_vi_ros.simulation import Simulation
import numpy as np


class Companion(Protocol):
    """Companion of a simulation, which never disturbs it: it raises nothing."""

    def advance(self, n: int) -> None:
        """Take as many steps as the simulation did."""

    def set_command(self, command: Command) -> None:
        """Take a command that the simulation has taken."""

    def begin(self, simulation: Simulation) -> None:
        """Restart from the state of the simulation, at its step."""


def accompany(simulation: Simulation, companions: Sequence[Companion]) -> Simulation:
    """Return a simulation with its companions, in its place; itself if there are none."""
    return cast(Simulation, Accompanied(simulation, companions)) if companions else simulation


class Accompanied:
    """
    A simulation with companions, which step with it and meet the same commands.

    Parameters
    ----------
    simulation : Simulation
        All that is not listed below is its own.
    companions : sequence of Companion
        What goes along.

    """

    def __init__(self, simulation: Simulation, companions: Sequence[Companion]):
        self._simulation, self._companions = simulation, companions
        self._begin()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._simulation, name)

    def advance(self, n: int, until: float = math.inf) -> int:
        """Take n steps, or fewer, and return how many, or raise; see Simulation."""
        taken = self._simulation.advance(n, until)
        for companion in self._companions:
            companion.advance(taken)
        return taken

    def set_command(self, command: Command) -> None:
        """Set a command, or raise ValueError and change nothing; see Simulation."""
        self._simulation.set_command(command)
        for companion in self._companions:
            companion.set_command(command)

    def restart(self, *arguments: Any, **more: Any) -> None:
        """Restart; see Simulation."""
        self._simulation.restart(*arguments, **more)
        self._begin()

    def restore(self, snapshot: dict[str, np.ndarray]) -> None:
        """Go back to a snapshot; companions go on from its state."""
        self._simulation.restore(snapshot)
        self._begin()

    def _begin(self) -> None:
        for companion in self._companions:
            companion.begin(self._simulation)
