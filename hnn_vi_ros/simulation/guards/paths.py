# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Guard of the path error, estimated by trials with half the step size."""

import math

from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.simulation.guards.base import Alarm, BlockGuard, Observed, SampleBlock
from hnn_vi_ros.simulation.simulation import RescuePending, Simulation
import numpy as np

# Maximum number of turns and of steps of a trial; minimum number of steps.
_MAX_TURNS, _MAX_STEPS, _MIN_STEPS = 3, 128, 8
# A derivative of H beyond this multiple of its maximum so far triggers another trial.
_MIN_RATE_RATIO = 2.0
# Coordinates whose range is less than this share of the largest range are ignored.
_MIN_RANGE_SHARE = 1e-3
# Largest path error over path length: a quarter of a turn in a hundred turns.
_MAX_PATH_ERROR = 0.5 * math.pi / 400.0
# Maximum number of steps between samples for a trial to start at the earlier one.
_MAX_SAMPLE_STEPS = 16


class PathGuard(BlockGuard):
    """
    Path error: it stays below 0.4 % of the path length, so that 100 turns are counted correctly.

    Trials start at the initial state, and where a derivative of H has doubled; they take up to
    three turns and 128 steps of h, and the same with h / 2. The paths differ by (1 - 2^-p) times
    the error of the former, with p the order of the method. Each coordinate and momentum is
    compared with the length of its own path. For an oscillator with relative frequency error s,
    error over length is pi s / 2; it loses a quarter of a turn in a hundred turns at s = 1 / 400.
    A path error below 1 % of the size of the path raises no alarm, since the length of three
    turns is at least twelve times that size.

    With order 1 there is only the trial at the initial state: H~ - H changes along the path, so a
    trial from a later state would follow a different motion.

    Parameters
    ----------
    simulation : Simulation
        Simulation of one trajectory.

    References
    ----------
    E. Hairer, S. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, section II.4.

    """

    kind = 'path not resolved'
    remedy = ('use a smaller step_size or a method of higher order; the energy may still be '
              'accurate')

    def __init__(self, simulation: Simulation):
        self._simulation, self.raised, self._error = simulation, False, 0.0
        # Largest derivatives so far, and the previous sample.
        self._largest = np.zeros(0)
        self._before: tuple[int, np.ndarray, np.ndarray] | None = None

    def take(self, block: SampleBlock) -> list[Alarm]:
        alarms, at = [], 0
        slopes = np.abs(np.hstack([block.dH_dq, block.dH_dp]))
        later = self._simulation.integrator.order > 1
        while not self.raised and at < len(slopes):
            if self._before is not None:
                beyond = later & (slopes[at:] > _MIN_RATE_RATIO * self._largest).any(axis=1)
                at = at + int(beyond.argmax()) if beyond.any() else len(slopes)
            if at < len(slopes):
                if self._begin(block, at, slopes[at]):
                    self.raised = True
                    alarms.append(self._alarm(int(block.step[at])))
                self._before, at = self._sample(block, at), at + 1
        self._before = self._sample(block, -1)
        return alarms

    def renew(self, sample: Observed) -> Alarm | None:
        return self._alarm(sample.step)

    def _sample(self, block: SampleBlock, i: int) -> tuple[int, np.ndarray, np.ndarray]:
        return int(block.step[i]), block.q[i].copy(), block.p[i].copy()

    def _begin(self, block: SampleBlock, i: int, slopes: np.ndarray) -> bool:
        """Run a trial from just before a sample; return whether the path error is too large."""
        start = self._sample(block, i)
        before = self._sample(block, i - 1) if i > 0 else self._before
        if before is not None and start[0] - before[0] <= _MAX_SAMPLE_STEPS:
            start = before
        self._error, largest = self._try(*start[1:])
        if not self._largest.size:
            self._largest = np.zeros_like(slopes)
        self._largest = np.maximum(np.maximum(self._largest, slopes), largest)
        for half in np.split(self._largest, 2):
            half[:] = np.maximum(half, _MIN_RANGE_SHARE * half.max())
        return not self._error <= _MAX_PATH_ERROR

    def _try(self, q: np.ndarray, p: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the path error over the path length, and the largest derivatives of H."""
        simulation, h, start = self._simulation, self._simulation.step_size, np.append(q, p)
        try:
            row, = simulation.rows(start[None])
            path, better = (np.vstack([start, np.hstack(simulation.trial(
                row, h / parts, _MAX_STEPS, parts))]) for parts in (1, 2))
        except (StepFailure, RescuePending):
            # A failing step is reported by the run itself.
            return 0.0, np.zeros(start.size)
        lengths = np.vstack([np.zeros(start.size), np.cumsum(
            np.abs(np.diff(better, axis=0)), axis=0)])
        ranges = np.maximum.accumulate(better) - np.minimum.accumulate(better)
        counts = np.hstack([half > _MIN_RANGE_SHARE * half.max(axis=1, keepdims=True)
                            for half in np.split(ranges, [q.size], axis=1)])
        turned = ((lengths > 2.0 * _MAX_TURNS * ranges) & counts).any(axis=1)
        turned[:_MIN_STEPS] = False
        end = int(turned.argmax()) if turned.any() else _MAX_STEPS
        part, counted = np.s_[:end + 1], counts[end]
        order, begin = simulation.integrator.order, 0
        errors = np.abs(path - better) / (1.0 - 0.5 ** order)
        worst = errors[part].max(axis=0)
        if order == 1:
            # A method of order 1 may be conjugate to one of order 2 in states displaced by part
            # of a step. This displacement does not grow after the first turn: subtract it.
            begin = end // _MAX_TURNS
            worst -= errors[:begin + 1].max(axis=0) if turned.any() else worst
        slopes = np.hstack(simulation.hamiltonian.gradient(
            better[part, :q.size], better[part, q.size:]))
        return (float((worst / (lengths[end] - lengths[begin]))[counted].max(initial=0.0)),
                np.abs(slopes).max(axis=0))

    def _alarm(self, step: int) -> Alarm:
        return Alarm(self.kind, step, self._error, _MAX_PATH_ERROR,
                     f'the path error is {100.0 * self._error:.2g} % of the path length: the '
                     'number of turns is wrong; use a smaller step_size, or a method of higher '
                     'order', '1')
