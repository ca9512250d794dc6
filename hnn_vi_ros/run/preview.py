# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Preview of the motion at the beginning of a run."""

import time

from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.recording import Bounds, box_of
from hnn_vi_ros.simulation import Simulation
import numpy as np

# Wall time of the preview, which the last batch of steps may exceed [s].
_MAX_WALL_TIME = 0.1


def preview_bounds(simulation: Simulation, seconds: float) -> Bounds:
    """
    Return the lowest and highest q and p at the beginning of a run, with a margin.

    The run is simulated from the initial state, and the initial state is then restored.

    Parameters
    ----------
    simulation : Simulation
        Simulation in its initial state.
    seconds : float
        Simulated time of the preview [s]; shortened if it takes long or a step fails.

    """
    simulation.compile()
    q0, p0, step = simulation.q.copy(), simulation.p.copy(), simulation.steps
    row = simulation.row
    met = [np.concatenate([q0, p0])[None]]
    left, batch = max(1.0, seconds // simulation.step_size), 1
    until = time.monotonic() + _MAX_WALL_TIME
    while left > 0 and time.monotonic() < until:
        n = int(min(batch, left))
        try:
            states = np.hstack(simulation.record(n, 1))
        except StepFailure:
            break
        met += [states.min(axis=0, keepdims=True), states.max(axis=0, keepdims=True)]
        left, batch = left - n, 2 * batch
    simulation.restart(q0, p0, step=step)
    # A resumed run also has a memory of its solver, its work, and held commands.
    simulation.put(row)
    return box_of(*np.hsplit(np.vstack(met), [q0.size]))
