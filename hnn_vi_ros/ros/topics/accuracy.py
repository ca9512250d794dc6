# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Message of ~/accuracy: errors and costs of a run."""

import math

from hnn_vi_ros.accuracy.diagnostics import local_error
from hnn_vi_ros.ros.topics.messages import array_message
from hnn_vi_ros.run.monitor import Monitor
from hnn_vi_ros.run.serialization import Template
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.sample import Sample

# The entries of its message.
ENTRIES = (
    'H', 'modified_H', 'energy_error', 'work', 'energy_balance', 'residual', 'iterations',
    'modified_energy_band', 'drift_per_hour', 'microseconds_per_step_median',
    'microseconds_per_step_p99', 'gradients_per_step', 'largest_real_time_factor', 'energy_scale',
    'local_error')
# Samples from one estimate of the local error to the next: an estimate takes three steps more.
_ESTIMATED = 64


class AccuracyEncoder:
    """
    Serialise the accuracy of a sample, in the order of ENTRIES.

    ``energy_balance`` is H - H0 - W [J]; ``residual`` is the relative one of the last implicit
    step; ``iterations`` are the gradients that each step since the sample before took, on average.
    What follows them is evaluated now and then; see EnergyRecord and Figures. ``energy_scale`` is
    the size of the energies in play [J], by which an error is judged; see EnergyScale.
    ``local_error`` is the estimated error that a step adds, at the first and then at every 64th
    sample; see local_error. The invariants of the scene follow, each under its name.

    Parameters
    ----------
    simulation : Simulation
        In its initial state.
    monitor : Monitor
        Its measurements.

    """

    def __init__(self, simulation: Simulation, monitor: Monitor):
        self._simulation, self._monitor = simulation, monitor
        self._energy0 = simulation.energy
        self._last = (simulation.steps, simulation.gradients)
        self._samples, self._local_error = 0, math.nan
        self._invariants = simulation.hamiltonian.invariants
        self._message = Template(array_message((*ENTRIES, *self._invariants)))

    def encode(self, sample: Sample) -> list[bytes]:
        """Return the serialised message that belongs to a sample, the newest one."""
        steps, gradients = self._simulation.steps, self._simulation.gradients
        if self._samples % _ESTIMATED == 0:
            self._local_error = local_error(self._simulation)
        self._samples += 1
        taken, spent = steps - self._last[0], gradients - self._last[1]
        self._last = (steps, gradients)
        record, figures = self._monitor.energy, self._monitor.timing.figures
        self._message.numbers[0][:] = (
            sample.energy, sample.modified_energy, sample.energy_error, sample.work,
            sample.energy - self._energy0 - sample.work, self._simulation.residual,
            spent / taken if taken else 0.0, record.band, record.drift_per_hour,
            figures.microseconds_per_step_median, figures.microseconds_per_step_p99,
            figures.gradients_per_step, figures.largest_real_time_factor,
            self._monitor.energy_scale, self._local_error,
            *(function(sample.q, sample.p) for function in self._invariants.values()))
        return [self._message.serialized()]
