# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectories of a scene without ROS: one, or many in lock-step blocks on several threads."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
import os
from typing import TYPE_CHECKING

from hnn_vi_ros.phase_space import check_state, Trajectory
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.system import System
import numpy as np

if TYPE_CHECKING:
    from hnn_vi_ros.scene import Scene

# Trajectories that step together: a network's weights are read once for all of them. Larger
# blocks gain no more, and each waits for its slowest trajectory.
BLOCK = 32


def simulate(scene: 'Scene', duration: float, *, step_size: float | None = None,
             integrator: str | None = None, every: int = 1) -> Trajectory:
    """
    Simulate a scene without ROS.

    Parameters
    ----------
    scene : Scene
        From ``load_scene``.
    duration : float
        Simulated time [s]; rounded to a whole number of samples.
    step_size : float, optional
        h [s], in place of the scene's.
    integrator : str, optional
        A name from INTEGRATORS, in place of the scene's.
    every : int, optional
        Steps from one sample to the next.

    Returns
    -------
    Trajectory
        The first sample is the initial state.

    Raises
    ------
    HnnViRosError
        An unknown integrator, a model that cannot be loaded, or a StepFailure.
    ValueError
        A duration or step size that is not usable.

    """
    if not (np.isfinite(duration) and duration >= 0.0):
        raise ValueError(f'duration = {duration} must be a number of seconds, at least 0')
    if every < 1:
        raise ValueError(f'every = {every} must be at least 1 step')
    simulation = Simulation.from_scene(scene.with_overrides(step_size, integrator))
    samples = round(duration / (simulation.step_size * every))
    q0, p0 = simulation.q.copy(), simulation.p.copy()
    q, p = simulation.record(samples, every)
    q, p = np.vstack([q0, q]), np.vstack([p0, p])
    t = np.arange(samples + 1) * every * simulation.step_size
    return Trajectory(t, q, p, simulation.hamiltonian.energy(q, p))


def simulate_many(scene: 'Scene', q: Sequence[Sequence[float]], p: Sequence[Sequence[float]],
                  duration: float, *, samples: int = 1, threads: int | None = None) -> Trajectory:
    """
    Simulate one scene from many initial states.

    Trajectories do not depend on each other: a block of them is one system, the sum of their
    Hamiltonians, so the formula of a step is the same code. The implicit equations of a block
    are solved until each of its trajectories has converged. With a thermostat, an impact or a
    constraint each trajectory steps alone, and meets its own noise.

    Parameters
    ----------
    scene : Scene
        Its own initial state is not used.
    q, p : sequence, shape (m, d)
        Initial states.
    duration : float
        Simulated time [s], rounded to a whole number of steps between samples.
    samples : int, optional
        Samples after the initial one, evenly spaced.
    threads : int, optional
        By default as many as there are processors.

    Returns
    -------
    Trajectory
        t of shape (samples + 1,), q and p of shape (samples + 1, m, d), energy of shape
        (samples + 1, m).

    Raises
    ------
    HnnViRosError
        The scene cannot be built, or a step of some trajectory fails.
    ValueError
        States, duration or samples that are not usable.

    """
    scene = scene.resolved()
    hamiltonian, integrator = scene.create_hamiltonian(), scene.create_integrator()
    effects = scene.create_effects()
    system = System(hamiltonian, effects, integrator)
    d, size = hamiltonian.dimension, BLOCK if system.lockstep else 1
    q0, p0 = (part.reshape(-1, d) for part in check_state(q, p, d))
    if not (np.isfinite(duration) and duration > 0.0 and samples >= 1):
        raise ValueError(f'duration = {duration} and samples = {samples} must be positive')
    every = max(1, round(duration / (samples * scene.step_size)))

    def start(block: slice) -> Simulation:
        return Simulation(hamiltonian.twin(), integrator, scene.step_size, q0[block], p0[block],
                          effects, scene.on_failure)

    workers = min(threads or os.cpu_count() or 1, -(-len(q0) // size))
    q_all, p_all = np.empty((2, samples + 1, len(q0), d))
    q_all[0], p_all[0] = q0, p0
    with ThreadPoolExecutor(workers) as pool:
        # Taken from the iterator, so that a failure of one worker is raised here.
        list(pool.map(lambda worker: _fill(
            start, range(worker * size, len(q0), workers * size), size, every, q_all, p_all),
            range(workers)))
    t = np.arange(samples + 1) * every * scene.step_size
    return Trajectory(t, q_all, p_all, system.hamiltonian.energy(q_all, p_all))


def _fill(start: Callable[[slice], Simulation], firsts: range, size: int, every: int,
          q_all: np.ndarray, p_all: np.ndarray) -> None:
    """Simulate the blocks that begin at these trajectories, one after another."""
    samples, d = len(q_all) - 1, q_all.shape[2]
    simulation = start(slice(firsts[0], firsts[0] + size))
    for first in firsts:
        block = slice(first, first + size)
        # Each trajectory has noise of its own.
        simulation.restart(q_all[0, block], p_all[0, block], stream=first)
        q_block, p_block = simulation.record(samples, every)
        q_all[1:, block] = q_block.reshape(samples, -1, d)
        p_all[1:, block] = p_block.reshape(samples, -1, d)
