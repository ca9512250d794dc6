# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The error of a single step, estimated by Richardson's extrapolation."""

import math

from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.simulation import Simulation
import numpy as np


def local_error(simulation: Simulation) -> float:
    """
    Return the estimated error that the next step of a simulation adds, and leave it unchanged.

    A step of h and two of h / 2 from the same state differ by (1 - 2^-p) of the error of the
    first, up to terms of higher order, with p the order of the method:

        e = max abs(z_h - z_(h/2, h/2)) / (1 - 2^-p)

    Parameters
    ----------
    simulation : Simulation
        In any state; it continues bit-identically.

    Returns
    -------
    float
        The largest error of a coordinate or momentum, in its own unit; NaN where such a step
        fails, and where a thermostat makes each step another one.

    References
    ----------
    E. Hairer, S. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, section II.4.

    """
    if any(label.partition('_')[0] == 'thermostat' for label in simulation.works):
        return math.nan
    h, start = simulation.step_size, simulation.snapshot()
    try:
        once, twice = (np.concatenate(simulation.trial(start, h / parts, parts))
                       for parts in (1, 2))
    except StepFailure:
        return math.nan
    difference = float(np.abs(once - twice).max())
    return difference / (1.0 - 0.5 ** simulation.integrator.order)
