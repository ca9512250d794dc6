# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Facts of a run from which its guards are made."""

from dataclasses import dataclass
from functools import cached_property

from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.simulation.guards.scale import SampledScale
from hnn_vi_ros.simulation.simulation import Simulation

# Default limits, as shares of the energy scale: see ResolutionGuard and EnergyGuard.
BAND_LIMIT, CHANGE_LIMIT = 0.05, 0.02
# Maximum dimension for searches: that for a saddle solves 2 d equations, which takes one or two
# milliseconds.
_MOST_SEARCHED = 16


@dataclass(frozen=True)
class RunFacts:
    """
    Facts of a run that decide which guards it needs, and with which limits.

    Parameters
    ----------
    simulation : Simulation
        The simulation to watch, in any state.
    band_limit, change_limit : float
        See ResolutionGuard, InvariantGuard and EnergyGuard.
    in_rows : bool
        True if the states of the run are rows, with works that the simulation does not have.

    """

    simulation: Simulation
    band_limit: float = BAND_LIMIT
    change_limit: float = CHANGE_LIMIT
    in_rows: bool = False

    @cached_property
    def scale(self) -> SampledScale:
        """Return the energy scale that all guards of the run share."""
        return SampledScale(self.hamiltonian)

    @property
    def hamiltonian(self) -> Hamiltonian:
        """Return H including the potentials among the effects."""
        return self.simulation.hamiltonian

    @property
    def order(self) -> int:
        """Return the order of the method."""
        return self.simulation.integrator.order

    @property
    def conservative(self) -> bool:
        """Return whether no effect does work."""
        return self.simulation.conservative

    @property
    def searchable(self) -> bool:
        """Return whether the system is small and simple enough to search for saddles and poles."""
        return (self.conservative and self.hamiltonian.canonical and not self.hamiltonian.rotations
                and self.simulation.q.ndim == 1 and self.hamiltonian.dimension <= _MOST_SEARCHED)
