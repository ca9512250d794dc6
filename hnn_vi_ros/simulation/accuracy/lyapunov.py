# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Lyapunov time: the rate at which neighbouring motions diverge."""

from pathlib import Path

from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation.accuracy.neighbouring_motions import (
    FIRST_HORIZON_STEPS, time_between_motions)
from hnn_vi_ros.simulation.checks import check_seconds
from hnn_vi_ros.simulation.construction import resolve
import numpy as np


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
        FIRST_HORIZON_STEPS, duration / scene.known_step_size)
    state = scene.initial_state
    return time_between_motions(
        hamiltonian, effects, integrator, scene.known_step_size, np.array(state.q),
        np.array(state.p), steps, scene.on_failure)
