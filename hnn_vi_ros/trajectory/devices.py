# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Many trajectories of a scene on a device, with the guards' alarms about their steps."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from operator import itemgetter

from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.guards.base import Alarm
from hnn_vi_ros.guards.watch import look_at_block, watch_of_block
from hnn_vi_ros.lockstep.ensemble import Counts, LockstepEnsemble, open_device, Recorded
from hnn_vi_ros.scene import Parts
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.trajectory.record import in_blocks
import numpy as np
import torch

# Trajectories that step together on the processor: as many as one batch of their gradients takes,
# several times, so that little of it is filled up; what comes of them does not depend on that.
_TOGETHER = 3840


def ensemble_on(device: str, parts: Parts) -> LockstepEnsemble:
    """Return an ensemble of a scene on a device, with H of its own."""
    scene, hamiltonian, integrator, effects = parts.copy()
    return LockstepEnsemble(hamiltonian, integrator, scene.known_step_size, effects,
                            scene.on_failure, device)


def record_on_device(one: Simulation, make: Callable[[], LockstepEnsemble], device: str,
                     q: np.ndarray, p: np.ndarray, samples: Sequence[int], threads: int | None,
                     alarms: list[list[Alarm]]
                     ) -> tuple[np.ndarray, np.ndarray, dict[int, StepFailure]]:
    """
    Take the steps of many trajectories in torch.

    Parameters
    ----------
    one : Simulation
        Of any one trajectory, shape (1, d).
    make : callable
        Returns an ensemble of the same scene, with working memory of its own.
    device : str
        See ``open_device``.
    q, p : np.ndarray, shape (m, d)
        Initial states.
    samples : sequence of int
        Numbers of steps, rising, at which to take samples.
    threads : int or None
        On the processor; as many as there are processors, if None.
    alarms : list of list of Alarm
        One list for each trajectory, to which what is to be told of its steps is added.

    Returns
    -------
    tuple of (np.ndarray, np.ndarray, dict)
        q and p, shape (n, m, d), NaN from a failure on; and the failures by number.

    """
    size = min(_TOGETHER, len(q)) if open_device(device).type == 'cpu' else len(q)
    found: dict[int, Recorded] = {}

    def start(first: slice) -> Callable[[slice], None]:
        ensemble = make()

        def take(block: slice) -> None:
            found[block.start] = ensemble.record(q[block], p[block], samples)
        return take

    with _one_thread_each(device):
        in_blocks(len(q), size, threads, start)
    failures: dict[int, StepFailure] = {}
    blocks = sorted(found.items(), key=itemgetter(0))
    for first, part in blocks:
        failures |= {first + k: failure for k, failure in part.failures.items()}
        for k in _noteworthy(one, part.counts):
            alarms[first + k] += _told(one, part.counts, k, samples[-1])
    return (np.concatenate([part.q for _, part in blocks], axis=1),
            np.concatenate([part.p for _, part in blocks], axis=1), failures)


@contextmanager
def _one_thread_each(device: str) -> Iterator[None]:
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
