# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Lyapunov time: the rate at which neighbouring motions diverge."""

from collections.abc import Sequence
import math
from pathlib import Path

from hnn_vi_ros.effects import Effect
from hnn_vi_ros.errors import HnnViRosError, listed
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators import Integrator
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation.accuracy.diagnostics import state_scales
from hnn_vi_ros.simulation.checks import check_seconds
from hnn_vi_ros.simulation.construction import resolve
from hnn_vi_ros.simulation.simulation import Simulation
from hnn_vi_ros.simulation.system import System
import numpy as np

# Number of steps between renormalisations, and number of steps up to the first horizon.
_RENORMALISATION_STEPS, _FIRST_HORIZON_STEPS = 32, 1024
# Distance of the neighbour: far above round-off, and well within the linear regime.
_NEIGHBOUR_DISTANCE = 1e-7
# Threshold of the growth in the second half of a run. Regular motions diverge in proportion to
# time, or to its square, which gives a growth of at most 2 log 2 = 1.4.
_MIN_CHAOTIC_GROWTH = 10.0


def lyapunov_time(scene: Scene | str | Path, duration: float | None = None) -> float:
    """
    Return the Lyapunov time: the time in which neighbouring motions diverge by a factor e [s].

    The scene defines the method and the effects; a second motion is renormalised to stay near the
    first (Benettin's method). The criterion is the growth of the log distance in the second half
    of runs of doubling length: it exceeds 10 and increases for chaotic motion, and stays near 1
    for linear divergence. A close encounter causes growth in one half only.

    Parameters
    ----------
    scene : Scene, str or Path
        A scene, or an argument of ``load_scene``.
    duration : float, optional
        Maximum simulated time of the search for chaos [s]; by default 2^17 steps.

    Returns
    -------
    float
        The Lyapunov time; inf if no chaos is found within the duration.

    Raises
    ------
    HnnViRosError
        The scene cannot be built, a step fails, or the motion escapes to very large values.
    ValueError
        The duration is negative or not finite, or the scene supports only one motion at a time:
        thermostat, impact, joint_limits, holonomic_constraint, loops, time_transformed.
    TypeError
        The duration is not a number.

    References
    ----------
    G. Benettin, L. Galgani, A. Giorgilli, J.-M. Strelcyn, Meccanica 15 (1980).

    """
    if duration is not None:
        check_seconds('duration', duration)
    scene, hamiltonian, integrator, effects = resolve(
        scene if isinstance(scene, Scene) else load_scene(scene))
    steps = 2 ** 17 if duration is None else max(
        _FIRST_HORIZON_STEPS, duration / scene.known_step_size)
    state = scene.initial_state
    return time_between_motions(
        hamiltonian, effects, integrator, scene.known_step_size, np.array(state.q),
        np.array(state.p), steps, scene.on_failure)


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
    horizon = _FIRST_HORIZON_STEPS
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
