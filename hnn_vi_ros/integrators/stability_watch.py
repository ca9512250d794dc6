# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A watch over the stability of an explicit method."""

from collections.abc import Callable
from functools import cache
import math

from hnn_vi_ros.compilation import inlined
from hnn_vi_ros.hamiltonians.base import Kernel
from hnn_vi_ros.integrators.arithmetic import largest
from hnn_vi_ros.integrators.base import BEYOND, Integrator, Memory, Point

# Calm steps after which an explicit method comes back, at first: the changes of method, at each of
# which the energy may change, become ever fewer.
_CALM = 16.0


class StabilityWatch:
    """
    A step that is taken only while h omega stays between two bounds, and else ends as BEYOND.

    At once where h omega reaches the highest value; or after many calm steps, with h omega below
    the lowest one. As many as _CALM at first; each time that the highest value is reached, twice
    as many.

    omega^2 = abs((J H'')^2 v) / abs(v) for a v that each step maps and keeps: by the power method
    it turns into the fastest oscillation of the motion linearised at z.
    """

    @staticmethod
    def inner_step(integrator: Integrator) -> Callable:
        """Return the step of the method."""
        return integrator.step

    @staticmethod
    @cache
    def wrap(step: Callable, keeps_gradient: bool) -> Callable:
        """Return the step with its watch; its options are those of the step and the interval."""
        @inlined
        def watched(kernel: Kernel, h: float, options: tuple, z: Point, z1: Point,
                    memory: tuple[Memory, ...]) -> tuple[int, float, int]:
            """Take one step; see Integrator."""
            inner, low, high = options
            space = memory[len(memory) - 1]
            calm, wanted = space.count, space.triangle[0]
            # NaN is neither low nor high: it will be found not finite.
            extent = abs(h) * _frequency(kernel, z, space)
            if extent >= high:
                wanted[0] = max(_CALM, 2.0 * wanted[0])
                return BEYOND, 0.0, 2
            calm[0] = calm[0] + 1 if extent < low else 0
            if calm[0] > wanted[0]:
                return BEYOND, 0.0, 2
            outcome, residual, gradients = step(kernel, h, inner, z, z1, memory[:-1])
            return outcome, residual, gradients + 2
        return watched


@inlined
def _frequency(kernel: Kernel, z: Point, space: Memory) -> float:
    """Return omega at z, and keep v."""
    v_q, v_p, w_q, w_p = space.values[0], space.values[1], space.values[2], space.values[3]
    if max(largest(v_q), largest(v_p)) == 0.0:
        # A direction without a symmetry that a mode could have as well.
        for i in range(v_q.size):
            v_q[i], v_p[i] = math.cos(1.0 + i * i), math.sin(2.0 + i * i)
    growth = 1.0
    for _ in range(2):
        kernel.hessian_vector(kernel.parameters, z.q, z.p, v_q, v_p, w_q, w_p)
        size = max(largest(w_q), largest(w_p))
        growth *= size
        for i in range(v_q.size):
            v_q[i] = w_p[i] / size if size > 0.0 else 0.0
            v_p[i] = -w_q[i] / size if size > 0.0 else 0.0
    return math.sqrt(growth)
