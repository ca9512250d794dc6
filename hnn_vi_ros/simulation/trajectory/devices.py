# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Many trajectories of a scene on a device, with the guards' alarms about their steps."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from hnn_vi_ros.scene import Parts
from hnn_vi_ros.simulation.guards.base import Alarm
from hnn_vi_ros.simulation.guards.watch import look_at_block, watch_of_block
from hnn_vi_ros.simulation.lockstep.ensemble import Counts, LockstepEnsemble, open_device, Recorded
from hnn_vi_ros.simulation.simulation import Simulation
import numpy as np
import torch

# Trajectories that step together on the processor: as many as one batch of their gradients takes,
# several times, so that little of it is filled up; what comes of them does not depend on that.
TOGETHER = 3840


def ensemble_on(device: str, parts: Parts) -> LockstepEnsemble:
    """Return an ensemble of a scene on a device, with H of its own."""
    scene, hamiltonian, integrator, effects = parts.copy()
    return LockstepEnsemble(hamiltonian, integrator, scene.known_step_size, effects,
                            scene.on_failure, device)


def record_on(ensemble: LockstepEnsemble, one: Simulation, q: np.ndarray, p: np.ndarray,
              samples: Sequence[int]) -> tuple[Recorded, dict[int, list[Alarm]]]:
    """
    Take the steps of many trajectories in torch.

    Parameters
    ----------
    ensemble : LockstepEnsemble
        Takes them.
    one : Simulation
        Of any one trajectory, shape (1, d).
    q, p : np.ndarray, shape (m, d)
        Initial states.
    samples : sequence of int
        Numbers of steps, rising, at which to take samples.

    Returns
    -------
    tuple of (Recorded, dict of int to list of Alarm)
        The samples, and the alarms about the steps of those trajectories that have any.

    """
    found = ensemble.record(q, p, samples)
    return found, {k: _told(one, found.counts, k, samples[-1])
                   for k in _noteworthy(one, found.counts)}


@contextmanager
def one_thread_each(device: str) -> Iterator[None]:
    """Keep torch from starting threads besides the calling ones."""
    before = torch.get_num_threads()
    if open_device(device).type == 'cpu':
        torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _noteworthy(one: Simulation, counts: Counts) -> list[int]:
    """Return the trajectories that may raise an alarm of a guard."""
    slow = counts.costliest > one.usual_gradients
    return np.flatnonzero((counts.rescued > 0) | (counts.several_solutions > 0) | slow).tolist()


def _told(one: Simulation, counts: Counts, k: int, steps: int) -> list[Alarm]:
    """Return what the guards of steps say of a trajectory at its end."""
    one.steps = steps
    one.rescued, one.several_solutions = int(counts.rescued[k]), int(counts.several_solutions[k])
    one.costliest = int(counts.costliest[k]), int(counts.at[k])
    watch = watch_of_block(one)
    watch.update(look_at_block(one))
    return watch.alarms
