# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Divergence of two neighbouring motions."""

from collections.abc import Sequence
import math

from hnn_vi_ros.effects import Effect
from hnn_vi_ros.errors import HnnViRosError, listed
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators import Integrator
from hnn_vi_ros.simulation.accuracy.diagnostics import state_scales
from hnn_vi_ros.simulation.simulation import Simulation
from hnn_vi_ros.simulation.system import System
import numpy as np

# Number of steps between renormalisations, and number of steps up to the first horizon.
_RENORMALISATION_STEPS, FIRST_HORIZON_STEPS = 32, 1024
# Distance of the neighbour: far above round-off, and well within the linear regime.
_NEIGHBOUR_DISTANCE = 1e-7
# Threshold of the growth in the second half of a run. Regular motions diverge in proportion to
# time, or to its square, which gives a growth of at most 2 log 2 = 1.4.
_MIN_CHAOTIC_GROWTH = 10.0


def time_between_motions(hamiltonian: Hamiltonian, effects: Sequence[Effect],
                         integrator: Integrator, h: float, q: np.ndarray, p: np.ndarray,
                         steps: float, on_failure: str = 'substep') -> float:
    """
    Return the Lyapunov time of a motion given without a scene [s]; see ``lyapunov_time``.

    Parameters
    ----------
    hamiltonian, effects, integrator, h, q, p, on_failure
        Arguments of Simulation.
    steps : float
        Maximum number of steps of the search for chaos, at least some thousands.

    """
    pair = _Pair(hamiltonian, effects, integrator, h, q, p, on_failure)
    taken, half, seen = 0, 0.0, 0.0
    horizon = FIRST_HORIZON_STEPS
    while horizon <= steps:
        while taken < horizon:
            pair.advance()
            taken += _RENORMALISATION_STEPS
            if taken == horizon // 2:
                half = pair.growth
        growth = pair.growth - half
        # Require growth in two successive halves: the growth from a close encounter is reversed
        # afterwards.
        if growth > _MIN_CHAOTIC_GROWTH and growth > seen > 0.25 * growth:
            return (horizon // 2) * h / growth
        seen, half, horizon = growth, pair.growth, 2 * horizon
    return math.inf


class _Pair:
    """Two neighbouring motions and the logarithm of their relative divergence."""

    def __init__(self, hamiltonian: Hamiltonian, effects: Sequence[Effect],
                 integrator: Integrator, h: float, q: np.ndarray, p: np.ndarray,
                 on_failure: str):
        if alone := System(hamiltonian, effects, integrator).unbatched:
            raise ValueError(f'{listed(alone)}: supported for one motion at a time; the Lyapunov '
                             'time cannot be measured')
        self.growth, self._scale = 0.0, state_scales(hamiltonian, q, p)
        direction = np.random.default_rng(0).normal(size=q.size + p.size)
        self._offset = _NEIGHBOUR_DISTANCE * direction / np.linalg.norm(direction)
        self._simulation = Simulation(
            hamiltonian, integrator, h, *self._states(q, p), effects, on_failure)

    def advance(self) -> None:
        """Advance both motions, and rescale their distance to its initial value."""
        simulation = self._simulation
        simulation.advance(_RENORMALISATION_STEPS)
        q, p = simulation.q, simulation.p
        offset = np.concatenate([q[1] - q[0], p[1] - p[0]]) / self._scale
        size = float(np.linalg.norm(offset))
        if not size > 0.0:
            raise HnnViRosError(
                f'the motion diverged to {max(np.abs(q).max(), np.abs(p).max()):.2g}, where '
                f'rounding hides a neighbour, at t = {simulation.time:.3g} s: the Lyapunov time '
                'cannot be measured; use a smaller step_size, or a shorter duration')
        self.growth += math.log(size / _NEIGHBOUR_DISTANCE)
        self._offset = _NEIGHBOUR_DISTANCE / size * offset
        simulation.restart(*self._states(q[0].copy(), p[0].copy()), step=simulation.steps)

    def _states(self, q: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return q and p of the motion and its neighbour, shape (2, d) each."""
        moved = np.concatenate([q, p]) + self._scale * self._offset
        return np.array([q, moved[:q.size]]), np.array([p, moved[q.size:]])
