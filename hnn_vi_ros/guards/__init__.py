# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Guards that watch a run sample by sample and say when it is no longer to be trusted."""

from collections.abc import Iterator

from hnn_vi_ros.diagnostics import rounding_scale
from hnn_vi_ros.guards.barrier import BarrierGuard
from hnn_vi_ros.guards.base import Guard
from hnn_vi_ros.guards.box import BoxGuard
from hnn_vi_ros.guards.energy import EnergyGuard
from hnn_vi_ros.guards.resolution import ResolutionGuard
from hnn_vi_ros.simulation import Simulation
import numpy as np


def make_guards(simulation: Simulation, band_limit: float, change_limit: float,
                barrier: tuple[str, float] | None,
                box: tuple[np.ndarray, np.ndarray] | None = None) -> Iterator[Guard]:
    """
    Yield the guards that apply to a simulation: the same ones in a study and in the node.

    Parameters
    ----------
    simulation : Simulation
        In its initial state.
    band_limit, change_limit : float
        See ResolutionGuard and EnergyGuard.
    barrier : tuple of (str, float) or None
        Name and energy [J] of a barrier; see ``Hamiltonian.barrier``.
    box : tuple of np.ndarray, shape (d, 2) each, optional
        Lowest and highest q and p of the motion, for the energies in play where the initial
        state shows none: at rest at H = 0.

    """
    hamiltonian, method = simulation.hamiltonian, simulation.integrator
    if hamiltonian.box is not None:
        yield BoxGuard(hamiltonian.box)
    scale = energies_in_play(simulation, simulation.q, simulation.p)
    if scale == 0.0 and box is not None:
        scale = energies_in_play(simulation, box[0][:, 1], box[1][:, 1])
    if scale > 0.0 and simulation.conservative:
        order = method.order if simulation.modified_energy is None else 2
        yield ResolutionGuard(band_limit, scale, simulation.step_size, order)
    if scale > 0.0:
        yield EnergyGuard(change_limit, scale)
    if barrier is not None and simulation.conservative:
        name, energy = barrier
        yield BarrierGuard(name, energy - simulation.energy)


def energies_in_play(simulation: Simulation, q: np.ndarray, p: np.ndarray) -> float:
    """Return the size of the energies in play at a state [J]; see ``rounding_scale``."""
    hamiltonian = simulation.hamiltonian
    return rounding_scale(float(hamiltonian.energy(q, p)), q, p, *hamiltonian.gradient(q, p))
