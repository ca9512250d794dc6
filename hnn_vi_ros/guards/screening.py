# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Screening of many trajectories: those that no guard need look at one by one."""

from hnn_vi_ros.accuracy.energy_scale import EnergyScale
from hnn_vi_ros.guards import BAND_LIMIT, CHANGE_LIMIT
from hnn_vi_ros.guards.resolution import PLAIN
from hnn_vi_ros.simulation import Simulation
import numpy as np


def suspects(simulation: Simulation, steps: np.ndarray, q: np.ndarray, p: np.ndarray,
             energy: np.ndarray, modified: np.ndarray) -> np.ndarray:
    """
    Return which trajectories may raise an alarm.

    The bounds match the guards', with the whole band of a trajectory against the least energy
    scale along it: a trajectory within them raises no alarm at any sample.

    Parameters
    ----------
    simulation : Simulation
        Of any of them.
    steps : np.ndarray, shape (n,)
        Steps since the start.
    q, p : np.ndarray, shape (n, m, d)
        The trajectories.
    energy, modified : np.ndarray, shape (n, m)
        H and H~ there; see ``energies_of``.

    Returns
    -------
    np.ndarray, shape (m,)
        True where the guards must look.

    """
    hamiltonian, m = simulation.hamiltonian, q.shape[1]
    if not hamiltonian.canonical or hamiltonian.invariants or len(steps) < 2:
        return np.ones(m, bool)
    found = np.zeros(m, bool)
    if hamiltonian.box is not None:
        low, high = np.concatenate(hamiltonian.box).T
        x = p if hamiltonian.gauge is None else p - q @ hamiltonian.gauge.T
        z = np.concatenate([q, x], axis=2)
        found |= ~((low <= z) & (z <= high)).all(axis=(0, 2))
    if not simulation.conservative:
        return found
    known = modified if simulation.modification is not None else energy
    weights = np.maximum(np.diff(np.round(steps), prepend=steps[0]), 1.0)
    share = PLAIN * BAND_LIMIT if known is modified else BAND_LIMIT
    # Written so that what is not finite is suspect. A change for good is less than the band.
    with np.errstate(invalid='ignore', over='ignore'):
        scale = EnergyScale(hamiltonian).least(weights, q, p, *hamiltonian.gradient(q, p))
        good = np.ptp(known, axis=0) <= min(BAND_LIMIT, CHANGE_LIMIT) * scale
        good &= np.ptp(energy, axis=0) <= share * scale
        if hamiltonian.barrier is not None:
            _, height = hamiltonian.barrier
            kept = energy if simulation.integrator.order > 1 else known
            gap = np.where((height - energy[0]) * (height - kept[0]) > 0.0,
                           np.abs(height - kept[0]), 0.0)
            good &= np.ptp(kept, axis=0) <= gap
    return found | ~good
