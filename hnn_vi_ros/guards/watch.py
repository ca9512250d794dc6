# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The guards of a run outside of ROS, and what they find."""

import math

from hnn_vi_ros.guards import BAND_LIMIT, CHANGE_LIMIT, make_guards
from hnn_vi_ros.guards.base import Alarm, Look
from hnn_vi_ros.guards.scale import SampledScale
from hnn_vi_ros.simulation import Simulation
import numpy as np

# Samples of a path that the guards are shown at most, beside its extremes.
_SHOWN = 4000


class Watch:
    """
    The guards of one run, and the first alarm of each kind.

    Parameters
    ----------
    simulation : Simulation
        In its initial state.
    barrier : tuple of (str, float) or None
        Name and energy [J] of a barrier; see ``Hamiltonian.barrier``.
    band_limit, change_limit : float, optional
        See ResolutionGuard and EnergyGuard.

    Attributes
    ----------
    alarms : list of Alarm
        The first of each kind, in the order in which they were raised.

    """

    def __init__(self, simulation: Simulation, barrier: tuple[str, float] | None,
                 band_limit: float = BAND_LIMIT, change_limit: float = CHANGE_LIMIT):
        self.alarms: list[Alarm] = []
        self._guards = list(make_guards(simulation, SampledScale(simulation.hamiltonian),
                                        band_limit, change_limit, barrier))
        self._heard: set[str] = set()

    def update(self, look: Look) -> None:
        """Show the next state to all guards."""
        for guard in self._guards:
            alarm = guard.update(look)
            if alarm is not None and alarm.kind not in self._heard:
                self._heard.add(alarm.kind)
                self.alarms.append(alarm)

    def show(self, simulation: Simulation, steps: np.ndarray, states: tuple[np.ndarray, ...],
             energies: tuple[np.ndarray, np.ndarray], most: int = _SHOWN) -> None:
        """
        Show a path: states at equal distances, the extremes of energy, the first outside a box.

        Parameters
        ----------
        simulation : Simulation
            That took it, with no work done.
        steps : np.ndarray, shape (n,)
            Steps since the start.
        states : tuple of np.ndarray, shape (n, d)
            q and p there.
        energies : tuple of np.ndarray, shape (n,)
            H and H~ there; see ``energies_of``.
        most : int, optional
            States to show at equal distances.

        """
        (q, p), (energy, modified), hamiltonian = states, energies, simulation.hamiltonian
        chosen = set(range(0, len(steps), max(1, len(steps) // most)))
        for values in (energy, modified):
            if np.isfinite(values).all():
                chosen |= {int(values.argmin()), int(values.argmax())}
        if hamiltonian.box is not None:
            low, high = np.concatenate(hamiltonian.box).T
            z = np.hstack([q, p])
            chosen.add(int(((z < low) | (z > high)).any(axis=1).argmax()))
        shown = np.array(sorted(chosen))
        slopes = hamiltonian.gradient(q[shown], p[shown])
        for i, H_q, H_p in zip(shown, *slopes, strict=True):
            self.update(Look(int(steps[i]), q[i], p[i], H_q, H_p, float(energy[i]),
                             float(modified[i])))


def energies_of(simulation: Simulation, q: np.ndarray, p: np.ndarray
                ) -> tuple[np.ndarray, np.ndarray]:
    """Return H and H~ of states of shape (n, d), each of shape (n,); H~ is NaN where none is."""
    hamiltonian = simulation.hamiltonian
    energy = hamiltonian.energy(q, p)
    if simulation.modified_energy is None:
        return energy, np.full(energy.shape, math.nan)
    return energy, simulation.integrator.modified_energy(
        simulation.step_size, energy, *hamiltonian.gradient(q, p))


def look(simulation: Simulation) -> Look:
    """Return the present state as guards look at it."""
    energy, modified = simulation.energies
    return Look(simulation.steps, simulation.q.copy(), simulation.p.copy(),
                simulation.dH_dq.copy(), simulation.dH_dp.copy(), energy,
                math.nan if modified is None else modified, simulation.work)
