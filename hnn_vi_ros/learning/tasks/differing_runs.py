# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Runs that a rigid body explains one by one, but not together."""

from collections.abc import Sequence

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.motions import EvenMotion, run_of
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.learning.fit.fitted_rigid_body import FittedRigidBody
from hnn_vi_ros.learning.fit.machine_fit import fit_machine
from hnn_vi_ros.learning.judging.residuals import ONLY_NOISE
from hnn_vi_ros.models import FittedNumber
import numpy as np

# Number of runs that are fitted one by one.
_MOST_RUNS = 4
# Difference of two numbers relative to the sum of the half-widths of their intervals that shows
# two machines. A larger ratio than 1, since models err beyond the noise.
_APART = 3.0


def differing_runs(config: MachineConfig, motions: Sequence[EvenMotion]) -> str:
    """
    Return a sentence if the first runs are of different machines, loads or units, else ''.

    They are if a rigid body leaves nothing but noise in each run alone, with numbers that differ
    by several times their 95 % intervals. Use it for a rigid body that does not explain all runs.

    Parameters
    ----------
    config : MachineConfig
        Configuration of a rigid body.
    motions : sequence of EvenMotion
        Motions, with positions alone.

    """
    runs: dict[str, list[EvenMotion]] = {}
    for motion in motions:
        runs.setdefault(run_of(motion), []).append(motion)
    free = not any(motion.tau.any() for motion in motions)
    q = np.concatenate([motion.q_smooth for motion in motions]) if free else None
    found = dict[str, dict[str, FittedNumber]]()
    for name in [*runs][:_MOST_RUNS if len(runs) > 1 else 0]:
        try:
            fitted = fit_machine(config, runs[name])
        except DataError:
            return ''
        if not (isinstance(fitted, FittedRigidBody) and fitted.numbers is not None
                and fitted.numbers.stages[-1][1] <= ONLY_NOISE):
            return ''
        found[name] = fitted.estimates(config.coordinates, q)
    apart = {}
    for key in set.intersection(*map(set, found.values())) if found else ():
        low, *_, high = sorted(found, key=lambda name: found[name][key].value)
        first, last = found[low][key], found[high][key]
        # An inertia that is set to 1 has no interval.
        halves = max(first.interval[1] - first.value + last.interval[1] - last.value,
                     1e-6 * abs(last.value))
        apart[(last.value - first.value) / (halves or 1.0)] = key, low, high
    most = max(apart, default=0.0)
    if most < _APART:
        return ''
    key, *ends = apart[most]
    values = ' and '.join(f'{found[name][key].value:.4g} in {name}' for name in ends)
    # Without forces, numbers are relative to the inertia.
    unit = '' if free else f' [{found[ends[0]][key].unit}]'
    return (f'a rigid body explains each run alone, but not together: {key} is {values}{unit}; '
            'train on runs of one machine, load and unit')
