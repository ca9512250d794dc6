# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Look ahead at the first moments of a run: where it goes."""

import time

from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.recording import Bounds, box_of
from hnn_vi_ros.simulation import Simulation
import numpy as np

# Wall time that looking ahead may take, but for the batch of steps that exceeds it [s].
_LONGEST = 0.1


def look_ahead(simulation: Simulation, seconds: float) -> Bounds:
    """
    Return the lowest and highest q and p of the first moments of a run, with a margin.

    It is simulated on from the initial state, and goes back to it as if nothing had been.

    Parameters
    ----------
    simulation : Simulation
        In its initial state.
    seconds : float
        Simulated time to look ahead [s]; less where that takes long or a step fails.

    """
    simulation.compile()
    q0, p0, step = simulation.q.copy(), simulation.p.copy(), simulation.steps
    met = [np.concatenate([q0, p0])[None]]
    left, batch = max(1.0, seconds // simulation.step_size), 1
    until = time.monotonic() + _LONGEST
    while left > 0 and time.monotonic() < until:
        n = int(min(batch, left))
        try:
            states = np.hstack(simulation.record(n, 1))
        except StepFailure:
            break
        met += [states.min(axis=0, keepdims=True), states.max(axis=0, keepdims=True)]
        left, batch = left - n, 2 * batch
    simulation.restart(q0, p0, step=step)
    return box_of(*np.hsplit(np.vstack(met), [q0.size]))
