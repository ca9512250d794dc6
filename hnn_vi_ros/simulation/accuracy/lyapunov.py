# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Rate at which neighbouring motions part: chaos is measured, not guessed."""

from collections.abc import Sequence
import math
from pathlib import Path

from hnn_vi_ros.effects import Effect
from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators import Integrator
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation.accuracy.diagnostics import state_scales
from hnn_vi_ros.simulation.checks import check_seconds
from hnn_vi_ros.simulation.simulation import Simulation
from hnn_vi_ros.simulation.system import System
import numpy as np

# Steps from one renormalisation to the next, and of the first horizon that is looked at.
_EVERY, _FIRST = 32, 1024
# Distance of the neighbour: far above round-off, and far below where the motion is not linear.
_DISTANCE = 1e-7
# Motions that are not chaotic part in proportion to time, or to its square: by 2 log 2 = 1.4 in
# the second half of a run.
_CHAOTIC = 10.0


def lyapunov_time(scene: Scene | str | Path, duration: float | None = None) -> float:
    """
    Return the time in which neighbouring motions part by the factor e [s].

    The scene gives the method and the effects; a second motion is kept near the first (Benettin).
    The growth in the second half of ever longer runs decides: it is some 10 and grows
    where the motion is chaotic, and stays near 1 where neighbours part in proportion to time. A
    close encounter makes them part for a while only, and the half before reveals it.

    Parameters
    ----------
    scene : Scene, str or Path
        From ``load_scene``, or what that takes; one with the integrator auto through
        ``automatic_choice.resolve``.
    duration : float, optional
        Simulated time up to which chaos is looked for [s]; by default 2^17 steps.

    Returns
    -------
    float
        Infinity where no chaos is found within the duration.

    Raises
    ------
    HnnViRosError
        The scene cannot be built, a step fails, or the motion runs away.
    ValueError
        A duration that is negative or not finite; or the scene takes one motion at a time only:
        thermostat, impact, joint_limits, holonomic_constraint, time_transformed.
    TypeError
        The duration is not a number.

    References
    ----------
    G. Benettin, L. Galgani, A. Giorgilli, J.-M. Strelcyn, Meccanica 15 (1980).

    """
    if duration is not None:
        check_seconds('duration', duration)
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    steps = 2 ** 17 if duration is None else max(
        _FIRST, duration / scene.known_step_size)
    state = scene.initial_state
    _, hamiltonian, integrator, effects = scene.parts()
    return time_between_motions(
        hamiltonian, effects, integrator, scene.known_step_size, np.array(state.q),
        np.array(state.p), steps, scene.on_failure)


def time_between_motions(hamiltonian: Hamiltonian, effects: Sequence[Effect],
                         integrator: Integrator, h: float, q: np.ndarray, p: np.ndarray,
                         steps: float, on_failure: str = 'substep') -> float:
    """
    Return the Lyapunov time of a motion that no scene describes [s]; see ``lyapunov_time``.

    Parameters
    ----------
    hamiltonian, effects, integrator, h, q, p, on_failure
        As of Simulation.
    steps : float
        Up to how many of them chaos is looked for, some thousands at least.

    """
    pair = _Pair(hamiltonian, effects, integrator, h, q, p, on_failure)
    taken, half, seen = 0, 0.0, 0.0
    horizon = _FIRST
    while horizon <= steps:
        while taken < horizon:
            pair.advance()
            taken += _EVERY
            if taken == horizon // 2:
                half = pair.growth
        growth = pair.growth - half
        # In two halves that follow one another: a close encounter grows a distance as well, and
        # takes that back.
        if growth > _CHAOTIC and growth > seen > 0.25 * growth:
            return (horizon // 2) * h / growth
        seen, half, horizon = growth, pair.growth, 2 * horizon
    return math.inf


class _Pair:
    """Two neighbouring motions, and the logarithm of how far they have parted."""

    def __init__(self, hamiltonian: Hamiltonian, effects: Sequence[Effect],
                 integrator: Integrator, h: float, q: np.ndarray, p: np.ndarray,
                 on_failure: str):
        if not System(hamiltonian, effects, integrator).lockstep:
            raise ValueError('thermostat, impact, joint_limits, holonomic_constraint and '
                             'time_transformed take one motion at a time: their Lyapunov time '
                             'cannot be measured')
        self.growth, self._scale = 0.0, state_scales(hamiltonian, q, p)
        direction = np.random.default_rng(0).normal(size=q.size + p.size)
        self._offset = _DISTANCE * direction / np.linalg.norm(direction)
        self._simulation = Simulation(
            hamiltonian, integrator, h, *self._states(q, p), effects, on_failure)

    def advance(self) -> None:
        """Take the next steps, and bring the neighbour back to its distance."""
        simulation = self._simulation
        simulation.advance(_EVERY)
        q, p = simulation.q, simulation.p
        offset = np.concatenate([q[1] - q[0], p[1] - p[0]]) / self._scale
        size = float(np.linalg.norm(offset))
        if not size > 0.0:
            raise HnnViRosError(
                f'the motion has run so far away, to {max(np.abs(q).max(), np.abs(p).max()):.2g}, '
                f'that a neighbour is lost in rounding at t = {simulation.time:.3g} s: no '
                'Lyapunov time can be measured; use a smaller step_size, or a shorter duration')
        self.growth += math.log(size / _DISTANCE)
        self._offset = _DISTANCE / size * offset
        simulation.restart(*self._states(q[0].copy(), p[0].copy()), step=simulation.steps)

    def _states(self, q: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return q and p of the motion and of its neighbour, shape (2, d) each."""
        moved = np.concatenate([q, p]) + self._scale * self._offset
        return np.array([q, moved[:q.size]]), np.array([p, moved[q.size:]])
