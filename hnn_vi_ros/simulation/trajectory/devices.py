# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Many trajectories of a scene on a torch device, with alarms about their steps."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from hnn_vi_ros.scene import Parts
from hnn_vi_ros.simulation.batches.batch_simulation import (
    BatchRecord, BatchSimulation, Counts, open_device)
from hnn_vi_ros.simulation.guards.base import Alarm
from hnn_vi_ros.simulation.guards.watch import look_at_block, watch_of_block
from hnn_vi_ros.simulation.simulation import Simulation
import numpy as np
import torch

# Number of trajectories that step together on the CPU: several batches of gradients, so that
# little of the last one is padding; results do not depend on it.
TOGETHER = 3840


def batch_on(device: str, parts: Parts) -> BatchSimulation:
    """Return a batch of a scene on a device, with its own copy of H."""
    scene, hamiltonian, integrator, effects = parts.copy()
    return BatchSimulation(hamiltonian, integrator, scene.known_step_size, effects,
                           scene.on_failure, device)


def record_on(batch: BatchSimulation, one: Simulation, q: np.ndarray, p: np.ndarray,
              samples: Sequence[int]) -> tuple[BatchRecord, dict[int, list[Alarm]]]:
    """
    Simulate many trajectories in torch, and return their samples and alarms.

    Parameters
    ----------
    batch : BatchSimulation
        Batch that takes the steps.
    one : Simulation
        Simulation of any one trajectory, shape (1, d).
    q, p : np.ndarray, shape (m, d)
        Initial states.
    samples : sequence of int
        Numbers of steps at which to take samples, in increasing order.

    Returns
    -------
    tuple of (BatchRecord, dict of int to list of Alarm)
        The samples, and the alarms about steps by number of trajectory.

    """
    found = batch.record(q, p, samples)
    return found, {k: _alarms_of(one, found.counts, k, samples[-1])
                   for k in _noteworthy(one, found.counts)}


@contextmanager
def one_thread_each(device: str) -> Iterator[None]:
    """Limit torch to one thread per calling thread on the CPU."""
    before = torch.get_num_threads()
    if open_device(device).type == 'cpu':
        torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _noteworthy(one: Simulation, counts: Counts) -> list[int]:
    """Return the numbers of the trajectories that may raise an alarm."""
    slow = counts.costliest > one.usual_gradients
    return np.flatnonzero((counts.rescued > 0) | (counts.several_solutions > 0) | slow).tolist()


def _alarms_of(one: Simulation, counts: Counts, k: int, steps: int) -> list[Alarm]:
    """Return the alarms of the guards of steps for a trajectory at its end."""
    one.steps = steps
    one.rescued, one.several_solutions = int(counts.rescued[k]), int(counts.several_solutions[k])
    one.costliest = int(counts.costliest[k]), int(counts.at[k])
    watch = watch_of_block(one)
    watch.update(look_at_block(one))
    return watch.alarms
