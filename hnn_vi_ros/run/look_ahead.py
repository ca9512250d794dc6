# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Look ahead at the first moments of a run: where it goes, and what a step costs."""

import time
from typing import NamedTuple

from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.viewer.phase_portrait import Bounds, box_of
import numpy as np

# Wall time that looking ahead may take, but for the batch of steps that exceeds it [s].
_LONGEST = 0.1


class LookAhead(NamedTuple):
    """
    Findings of a look ahead.

    Parameters
    ----------
    box : tuple of np.ndarray, shape (d, 2) each
        Lowest and highest q and p, with a margin.
    microseconds_per_step : float or None
        Of the compiled kernel, in the fastest batch; None if already the first step fails.

    """

    box: Bounds
    microseconds_per_step: float | None


def look_ahead(simulation: Simulation, seconds: float) -> LookAhead:
    """
    Simulate on from the initial state, and go back to it as if nothing had been.

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
    left, batch, fastest = max(1.0, seconds // simulation.step_size), 1, None
    until = time.monotonic() + _LONGEST
    while left > 0 and time.monotonic() < until:
        n = int(min(batch, left))
        begin = time.perf_counter()
        try:
            states = np.hstack(simulation.record(n, 1))
        except StepFailure:
            break
        cost = (time.perf_counter() - begin) / n * 1e6
        fastest = cost if fastest is None else min(fastest, cost)
        met += [states.min(axis=0, keepdims=True), states.max(axis=0, keepdims=True)]
        left, batch = left - n, 2 * batch
    simulation.restart(q0, p0, step=step)
    return LookAhead(box_of(*np.hsplit(np.vstack(met), [q0.size])), fastest)
