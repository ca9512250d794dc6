# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Selection of the guards that apply to a simulation."""

from collections.abc import Iterator
import math

from hnn_vi_ros.effects import LoopManifold
from hnn_vi_ros.models import domain_of
from hnn_vi_ros.simulation.guards.bands import (
    BarrierGuard, EnergyGuard, InvariantGuard, plain_share, ResolutionGuard)
from hnn_vi_ros.simulation.guards.base import Guard, Scale
from hnn_vi_ros.simulation.guards.bounds import BoxGuard
from hnn_vi_ros.simulation.guards.loops import ClosureGuard, SingularGuard
from hnn_vi_ros.simulation.guards.paths import ForcedPathGuard, PathGuard
from hnn_vi_ros.simulation.guards.poles import PoleGuard
from hnn_vi_ros.simulation.guards.saddles import MOST_COORDINATES, SaddleSearch
from hnn_vi_ros.simulation.guards.steps import (
    CostGuard, DriveGuard, RescueGuard, SolutionGuard, StiffnessGuard)
from hnn_vi_ros.simulation.simulation import Simulation
import numpy as np

# Default limits, as shares of the energy scale: see ResolutionGuard and EnergyGuard.
BAND_LIMIT, CHANGE_LIMIT = 0.05, 0.02


def make_guards(simulation: Simulation, scale: Scale, band_limit: float,
                change_limit: float, barrier: tuple[str, float] | None,
                rows: np.ndarray | None = None) -> Iterator[Guard]:
    """
    Yield the guards that apply to a simulation, in a study and in the node alike.

    Parameters
    ----------
    simulation : Simulation
        The simulation to watch.
    scale : callable
        Returns the energy scale at each sample of a block [J]; see SampledScale.
    band_limit, change_limit : float
        See ResolutionGuard, InvariantGuard and EnergyGuard.
    barrier : tuple of (str, float) or None
        Name and energy [J] of a barrier; see ``Hamiltonian.barrier``.
    rows : np.ndarray, shape (m, R), optional
        See ForcedPathGuard.

    """
    hamiltonian, method = simulation.hamiltonian, simulation.integrator
    if hamiltonian.box is not None:
        yield BoxGuard(hamiltonian.box, hamiltonian.gauge, domain_of(hamiltonian))
    if simulation.conservative:
        yield ResolutionGuard(band_limit, scale, plain_share(simulation), method.order)
    yield EnergyGuard(change_limit, scale, simulation.conservative)
    if simulation.usual_gradients:
        yield CostGuard(simulation)
    fastest = simulation.system.fastest_rate(np.atleast_2d(simulation.q)[0])
    if fastest:
        yield StiffnessGuard(simulation.step_size * fastest)
    frequency = max((effect.frequency for effect in simulation.effects), default=0.0)
    if frequency:
        yield DriveGuard(simulation.step_size * frequency, method.order)
    for name, function in hamiltonian.invariants.items():
        yield InvariantGuard(name, function, band_limit, hamiltonian)
    if barrier is not None and simulation.conservative:
        yield BarrierGuard(*barrier, method.order)
    elif searchable(simulation) and simulation.system.integrator is method:
        # On a constraint or between walls, saddles of H are not saddles of the motion.
        yield BarrierGuard('saddle', math.inf, method.order, SaddleSearch(
            hamiltonian, lambda: simulation.rescue_ready))
    # An H learned through a scheme is valid at its own step size only, not at half of it.
    if hamiltonian.scheme is None:
        if not simulation.conservative:
            if not any(effect.random for effect in simulation.effects):
                yield ForcedPathGuard(simulation, rows)
        elif simulation.q.size == hamiltonian.dimension:
            yield PathGuard(simulation)
    # Networks and robots have no poles.
    if searchable(simulation) and hamiltonian.box is None and hamiltonian.robot is None:
        yield PoleGuard(hamiltonian)
    loops = simulation.system.constraints
    if isinstance(loops, LoopManifold):
        yield ClosureGuard(loops)
        yield SingularGuard(loops)
    if simulation.connected:
        yield SolutionGuard(simulation)
    yield RescueGuard(simulation)


def searchable(simulation: Simulation) -> bool:
    """Return whether the system is small and simple enough for the guards with trials."""
    hamiltonian = simulation.hamiltonian
    return (simulation.conservative and hamiltonian.canonical and not hamiltonian.rotations
            and simulation.q.ndim == 1 and hamiltonian.dimension <= MOST_COORDINATES)
