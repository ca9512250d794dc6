# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Steps that are cut at the knots of a reference, where forces jump."""

from functools import cache
from typing import Any, NamedTuple

from hnn_vi_ros.effects.base import EffectState, StepLayer
from hnn_vi_ros.effects.commands import Reference
from hnn_vi_ros.integrators import copy_array, copy_point, discard_history, OK, PhasePoint, Step
from hnn_vi_ros.kernels import inlined, Kernel, Parameters
import numpy as np

# A time counts as that of a knot up to this share of it before the knot: some roundings of a sum.
_ROUNDINGS = 8.0 * float(np.finfo(np.float64).eps)


class CutWork(NamedTuple):
    """State at the start of a part of the step, and EffectState.resting at that of the step."""

    start: PhasePoint
    resting: np.ndarray


class CutAtKnots(StepLayer):
    """
    Layer that takes a step in parts, each between two knots of the reference.

    All stages of a part, also those at its ends, use the reference between these knots, which
    EffectState.part names. It is smooth there, so that methods keep their order.
    """

    repeats = True

    @staticmethod
    def workspace(n: int, settings: tuple[Any, ...]) -> CutWork:
        """Return the workspace for n unknowns."""
        return CutWork(PhasePoint.empty(n), np.zeros(settings[0].resting.size))

    @staticmethod
    @cache
    def wrap(step: Step, keeps_gradient: bool) -> Step:
        """Return the step, cut into parts by knots."""
        @inlined
        def cut(kernel: Kernel, h: float, options: Parameters, z: PhasePoint, z1: PhasePoint,
                memory: tuple[Any, ...]) -> tuple[int, float, int]:
            """Take one step; see Integrator."""
            inner, state = options
            work, inside, done, total = memory[-1], memory[:-1], 0.0, 0
            copy_point(z, work.start)
            copy_array(state.resting, work.resting)
            while True:
                end = _end_of_part(state, done, h)
                state.part[0] = state.clock[0] + (state.clock[1] + 0.5 * (done + end))
                if keeps_gradient and done > 0.0:
                    kernel.gradient(kernel.parameters, work.start.q, work.start.p,
                                    work.start.dH_dq, work.start.dH_dp)
                    total += 1
                outcome, residual, gradients = step(
                    kernel, end - done, inner, work.start, z1, inside)
                total += gradients
                passed = knot_before(state.reference, state.part[0])
                state.part[0] = np.nan
                if outcome != OK:
                    copy_array(work.resting, state.resting)
                    return outcome, residual, total
                if end == h:
                    break
                copy_point(z1, work.start)
                discard_history(inside)
                done = end
            if keeps_gradient and passed < knot_before(
                    state.reference, with_rounding(state.clock[0] + h)):
                # The next step begins at a knot.
                kernel.gradient(kernel.parameters, z1.q, z1.p, z1.dH_dq, z1.dH_dp)
                total += 1
            return outcome, residual, total
        return cut


@inlined
def _end_of_part(state: EffectState, done: float, h: float) -> float:
    """Return the end of a part of a step of size h that begins at ``done`` [s]."""
    reference, begin = state.reference, with_rounding(state.clock[0] + done)
    k = knot_before(reference, begin)
    if reference.knots[k, 0] <= begin:
        k += 1
    if k < min(reference.extent[0], reference.knots.shape[0]) \
            and with_rounding(reference.knots[k, 0]) < state.clock[0] + h:
        return reference.knots[k, 0] - state.clock[0] - state.clock[1]
    return h


@inlined
def with_rounding(t: float) -> float:
    """Return the latest time that is t but for the rounding of sums [s]."""
    return t + _ROUNDINGS * abs(t)


@inlined
def knot_before(reference: Reference, t: float) -> int:
    """Return the last knot of the path that is not after a time; 0 before all of them."""
    # The count may come from a damaged file and must not exceed the knots.
    low, high = 0, min(reference.extent[0], reference.knots.shape[0]) - 1
    while low < high:
        middle = (low + high + 1) // 2
        if reference.knots[middle, 0] <= t:
            low = middle
        else:
            high = middle - 1
    return low
