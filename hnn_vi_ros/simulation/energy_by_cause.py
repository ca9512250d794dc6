# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Account of the energy of a simulation by cause.

    H - H0 = sum of the works of all effects + error,    H = sum of the energies stored in H

A passive effect turns its work into heat, except energy stored outside of H, such as in
bristles: heat = -(work + stored energy). The error is what no effect explains, H - H0 - W, which
is of the order of the method.
"""

from hnn_vi_ros.effects import NUMBERS, Potential
from hnn_vi_ros.phase_space import columns
from hnn_vi_ros.simulation.system import Cause, System
import numpy as np

WORK, STORED, HEAT, ERROR = 'work/', 'stored/', 'heat/', 'error'
# The energy in H that no listed effect stores.
REST = f'{STORED}hamiltonian'


class Ledger:
    """
    Account of the energy of one trajectory by cause.

    Parameters
    ----------
    system : System
        System that accounts for works by joint.
    q : np.ndarray, shape (d,)
        Coordinates at which H is finite.

    Attributes
    ----------
    names : tuple of str
        Names of the C entries, all in J: ``work/CAUSE`` on the system since the start,
        ``stored/CAUSE`` at present, ``heat/CAUSE`` since the start, and ``error``. A cause is an
        effect, or one of its joints, as in ``servo/elbow``; a motor and the external_force that
        commands it are one.

    """

    def __init__(self, system: System, q: np.ndarray):
        self._state, causes = system.effect_state, system.causes()
        # Rows of works by cause; heats also have an effect, which may store a part outside of H.
        self._works, self._heats = dict[str, list[int]](), dict[str, tuple[int, Cause]]()
        self._stores = [cause for cause in causes if self._stored(cause, q)]
        for cause in causes:
            rows = {f'{cause.label}{joint}': row for joint, row in cause.rows.items()}
            if not (isinstance(cause.effect, Potential) or cause.effect.corrects_command):
                self._works |= {name: [row] for name, row in rows.items()}
            if cause.effect.passive:
                self._heats |= {name: (row, cause) for name, row in rows.items()}
        self._join_motors(causes, columns(system.hamiltonian.coordinates)[1])
        self.names = (
            *(WORK + name for name in self._works),
            *(f'{STORED}{cause.label}{joint}' for cause in self._stores
              for joint in self._stored(cause, q)),
            REST, *(HEAT + name for name in self._heats), ERROR)

    def _join_motors(self, causes: list[Cause], names: list[str]) -> None:
        """Add the works of motors to the external_force of their joints."""
        for motor in (cause for cause in causes if cause.effect.corrects_command):
            force = next(cause for cause in causes if NUMBERS in getattr(
                cause.effect, 'takes', ()))
            joint = f'/{names[motor.parameters.column]}' if len(force.rows) > 1 else ''
            label = force.label + joint
            rows = self._works.pop(label)
            self._works[f'{force.label}+{motor.label}{joint}'] = [*rows, *motor.rows.values()]

    def _stored(self, cause: Cause, q: np.ndarray) -> dict[str, float]:
        return {joint and f'/{joint}': float(energy) for joint, energy in
                cause.effect.stored_energy(
                    cause.parameters, q, float(self._state.resting[cause.place])).items()}

    def values(self, q: np.ndarray, energy: float, error: float) -> np.ndarray:
        """Return the entries at coordinates q, shape (d,), with H and H - H0 - W, all [J]."""
        works = self._state.work.sum(axis=1).tolist()
        stored = [self._stored(cause, q) for cause in self._stores]
        inside = sum(sum(own.values()) for cause, own in zip(self._stores, stored, strict=True)
                     if isinstance(cause.effect, Potential))
        heats = [-works[row] - sum(self._stored(cause, q).values())
                 for row, cause in self._heats.values()]
        return np.array([*(sum(works[row] for row in rows) for rows in self._works.values()),
                         *(value for own in stored for value in own.values()),
                         energy - inside, *heats, error])
