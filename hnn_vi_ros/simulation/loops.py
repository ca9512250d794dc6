# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The loops over steps that numba compiles, each over one method and one Hamiltonian."""

from collections.abc import Callable

from hnn_vi_ros.integrators.arithmetic import copy_array, copy_point, is_finite
from hnn_vi_ros.integrators.base import NOT_FINITE, OK, Point
from hnn_vi_ros.integrators.compiled_workspaces import compile_forget  # noqa: F401  registers
from hnn_vi_ros.kernels.bare_arrays import bare
from hnn_vi_ros.kernels.kernel import Kernel
import numpy as np


def advance(step: Callable, kernel: Kernel, h: float, options: tuple, first: int, every: int,
            z: Point, z1: Point, memory: tuple, q_out: np.ndarray, p_out: np.ndarray,
            last: int) -> tuple[int, int, int, float, int, int, int]:
    """Take the steps from the first to before the last, and sample; stop before one that fails."""
    kernel, options, z, z1, memory, q_out, p_out = bare(
        (kernel, options, z, z1, memory, q_out, p_out))
    gradients, residual, spent, most, costliest = 0, 0.0, 0, 0, first
    for done in range(first, last):
        outcome, residual, spent = step(kernel, h, options, z, z1, memory)
        gradients += spent
        if outcome == OK and not is_finite(z1):
            outcome = NOT_FINITE
        if outcome != OK:
            return outcome, done, gradients, residual, spent, most, costliest
        if spent > most:
            most, costliest = spent, done
        copy_point(z1, z)
        if (done + 1) % every == 0:
            sample = done // every
            copy_array(z.q, q_out[sample])
            copy_array(z.p, p_out[sample])
    return OK, max(first, last), gradients, residual, spent, most, costliest


def take_substeps(substep: Callable, kernel: Kernel, h: float, options: tuple, parts: int,
                  most: int, z: Point, z1: Point, memory: tuple
                  ) -> tuple[bool, int]:
    """Go by equal sub-steps, while they take at most so many gradients; end in z and z1."""
    kernel, options, z, z1, memory = bare((kernel, options, z, z1, memory))
    gradients = 0
    for _ in range(parts):
        outcome, _, spent = substep(kernel, h / parts, options, z, z1, memory)
        gradients += spent
        if outcome != OK or gradients > most or not is_finite(z1):
            return False, gradients
        copy_point(z1, z)
    kernel.gradient(kernel.parameters, z.q, z.p, z.dH_dq, z.dH_dp)
    return True, gradients + 1
