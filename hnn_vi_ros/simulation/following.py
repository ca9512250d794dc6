# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled loop over steps of many states, each with its own commands and memory."""

from typing import NamedTuple

from hnn_vi_ros.integrators import copy_point, is_finite, NOT_FINITE, OK, PhasePoint, Step
from hnn_vi_ros.kernels import bare, inlined, Kernel, Parameters
import numpy as np


class CommandLaw(NamedTuple):
    """
    Linear feedback added to N commands, with limits on the sum.

    Parameters
    ----------
    gains : np.ndarray, shape (m, N, c, 2 d)
        Gains on the deviations of the states of m trajectories; empty for none.
    about : np.ndarray, shape (m, N, 2 d)
        Reference states of the deviations.
    low, high : np.ndarray, shape (c,)
        Lower and upper limits of commands.

    """

    gains: np.ndarray
    about: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @classmethod
    def none(cls, size: int) -> 'CommandLaw':
        """Return a law without feedback and without limits."""
        limit = np.full(size, np.inf)
        return cls(np.zeros((0, 0, 0, 0)), np.zeros((0, 0, 0)), -limit, limit)

    def of(self, part: slice) -> 'CommandLaw':
        """Return the law of some of the trajectories."""
        return self._replace(gains=self.gains[part], about=self.about[part])


def follow_each(step: Step, kernel: Kernel, h: float, options: Parameters, hold: int, count: int,
                z: PhasePoint, z1: PhasePoint, memory: Parameters, arrays: tuple[np.ndarray, ...],
                rows: np.ndarray, command: np.ndarray, places: np.ndarray, law: CommandLaw,
                wanted: np.ndarray, path: np.ndarray, taken: np.ndarray) -> None:
    """
    Take steps from each row, with each command held in turn; see ``Simulation.follow``.

    A row consists of the initial energy, the number of steps so far, the active method (-1: the
    first, and H' of the point is not evaluated yet), and then the contents of the arrays.
    """
    kernel, options, z, z1, memory, arrays, rows, command, places, law, wanted, path, taken = bare(
        (kernel, options, z, z1, memory, arrays, rows, command, places, law, wanted, path, taken))
    d = path.shape[2] // 2
    for m in range(rows.shape[0]):
        place = 3
        for array in arrays:
            for k in range(array.size):
                array[k] = rows[m, place + k]
            place += array.size
        _note(z, path[m, 0], d)
        path[m, 1:], taken[m] = np.nan, 0
        # Steps by another method are left to the caller's fallbacks.
        for n in range(count if rows[m, 2] <= 0.0 else 0):
            if wanted.shape[2]:
                _put(law, m, n, z, places, wanted[m, n], command)
            # A command changes H', which methods cache in the point.
            if wanted.shape[2] or rows[m, 2] < 0.0:
                kernel.gradient(kernel.parameters, z.q, z.p, z.dH_dq, z.dH_dp)
                rows[m, 2] = 0.0
            outcome = OK
            for _ in range(hold):
                outcome, _, _ = step(kernel, h, options, z, z1, memory)
                if outcome != OK or not is_finite(z1):
                    outcome = NOT_FINITE
                    break
                copy_point(z1, z)
                taken[m] += 1
            if outcome != OK:
                break
            _note(z, path[m, n + 1], d)
        rows[m, 1] += taken[m]
        place = 3
        for array in arrays:
            for k in range(array.size):
                rows[m, place + k] = array[k]
            place += array.size


@inlined
def _note(z: PhasePoint, state: np.ndarray, d: int) -> None:
    """Copy q and p without the channels of forces."""
    for k in range(d):
        state[k], state[d + k] = z.q[k], z.p[k]


@inlined
def _put(law: CommandLaw, m: int, n: int, z: PhasePoint, places: np.ndarray, wanted: np.ndarray,
         command: np.ndarray) -> None:
    """Add feedback to wanted commands, apply limits, and write them to the command array."""
    d = law.gains.shape[3] // 2
    command[:] = 0.0
    # The command does not expire.
    command[command.size - 1] = np.inf
    for i in range(wanted.size):
        for k in range(d):
            wanted[i] += law.gains[m, n, i, k] * (z.q[k] - law.about[m, n, k])
        for k in range(d):
            wanted[i] += law.gains[m, n, i, d + k] * (z.p[k] - law.about[m, n, d + k])
        wanted[i] = min(max(wanted[i], law.low[i]), law.high[i])
        for k in range(places.shape[1]):
            command[k] += wanted[i] * places[i, k]
