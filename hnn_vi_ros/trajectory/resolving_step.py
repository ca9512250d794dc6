# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The step size that resolves a motion which a run did not, found by trials of that run."""

from collections.abc import Callable, Sequence
import math
import warnings

from hnn_vi_ros.accuracy.trials import InitialValueProblem
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.guards.bands import ResolutionGuard
from hnn_vi_ros.guards.base import Alarm
from hnn_vi_ros.simulation import Simulation
import numpy as np

# Share of the gradients that a run of a calibration may take: tenths of a second.
_SHARE = 0.1


def name_step(alarms: Sequence[Alarm], simulation: Simulation,
              repeat: Callable[[float], Sequence[Alarm]]) -> list[Alarm]:
    """
    Return the alarms of a run, that of ResolutionGuard with a step size that raises none.

    How far an energy has gone says little of the step that would keep it: where steps do not
    resolve a motion its error is as large as the energies in play, at any of them. So the run is
    repeated with a half of its step, a quarter and so on; none is named where that takes more
    gradients than some tenths of a second hold.

    Parameters
    ----------
    alarms : sequence of Alarm
        Of the run.
    simulation : Simulation
        That took it.
    repeat : callable
        Repeats it at another step size [s], and returns its alarms.

    """
    told = list(alarms)
    for k, alarm in enumerate(alarms):
        if alarm.kind == ResolutionGuard.kind:
            step = _resolving_step(simulation, repeat)
            if step is not None:
                told[k] = alarm._replace(
                    message=f'{alarm.message}; step_size {step:g} resolves this run')
    return told


def _resolving_step(simulation: Simulation, repeat: Callable[[float], Sequence[Alarm]]
                    ) -> float | None:
    h, cost = simulation.step_size, simulation.gradients
    if simulation.usual_gradients:
        # Steps that are hard to solve take more, which shorter ones do not.
        cost = min(cost, simulation.steps * simulation.usual_gradients)
    most = _SHARE * InitialValueProblem(
        simulation.hamiltonian, (), simulation.q, simulation.p).gradients
    while (cost := 2 * cost) <= most:
        h *= 0.5
        # Rounded down, to two digits.
        digit = 10.0 ** (math.floor(math.log10(h)) - 1)
        h = float(f'{math.floor(h / digit * (1.0 + 1e-12)) * digit:.2g}')
        with warnings.catch_warnings(), np.errstate(all='ignore'):
            warnings.simplefilter('ignore')
            try:
                if all(alarm.kind != ResolutionGuard.kind for alarm in repeat(h)):
                    return h
            except StepFailure:
                continue
    return None
