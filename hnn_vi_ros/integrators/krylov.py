# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Newton's method without a Jacobian, for the equation x = G(x) of a step; see solvers."""

from collections.abc import Callable
import math
from typing import NamedTuple

from hnn_vi_ros.integrators.arithmetic import copy_array
from hnn_vi_ros.integrators.base import Memory, NO_CONVERGENCE
from hnn_vi_ros.integrators.newton import raise_scales
from hnn_vi_ros.integrators.solvers import BACK, COMMON, GO_ON, judge, OWN
from hnn_vi_ros.kernels.marks import inlined
import numpy as np

# How far the linear system of an iteration is solved, relative to its right-hand side.
_FORCING = 1e-3


@inlined
def krylov(equation: Callable, tangent: Callable, problem: NamedTuple, x: np.ndarray,
           memory: Memory, max_iterations: int) -> tuple[int, float, int]:
    """
    Iterate (I - G'(x)) step = G(x) - x, each step by the method GMRES; see the module.

    It takes products G'(x) v, of which it keeps a few, and no matrix. Where those do not suffice
    for a linear system, the next iteration goes on from as far as they lead. Scales are raised as
    in Newton's method with a Jacobian, but by abs(G'(x) x) for the sum of absolute values, which
    takes the matrix: the two agree where one unknown is much larger than the others.

    References
    ----------
    Y. Saad, M. Schultz, GMRES: a generalized minimal residual algorithm for solving nonsymmetric
    linear systems, SIAM J. Sci. Stat. Comput. 7 (1986). R. Dembo, S. Eisenstat, T. Steihaug,
    Inexact Newton methods, SIAM J. Numer. Anal. 19 (1982).

    """
    n, columns = x.size, memory.hessenberg.shape[1]
    value, defect, product = memory.values[0], memory.residuals[0], memory.values[2]
    v, weights = memory.residuals[1], memory.residuals[2]
    sizes = memory.scale, memory.own_scale, memory.accepted
    previous, residual, stage, evaluations = math.inf, math.inf, COMMON, 0
    for k in range(1, max_iterations + 1):
        outcome, residual, stage = judge(equation, problem, x, sizes, value, defect, previous,
                                         stage, k == max_iterations)
        evaluations += 1
        if outcome != GO_ON:
            return outcome, residual, evaluations
        if k == max_iterations or columns == 0:
            break
        if stage == BACK:
            copy_array(value, x)
            continue
        previous, used, goal = residual, 0, 0.0
        copy_array(x, v)
        for j in range(-1, columns):
            if j >= 0 or k == 1:
                tangent(problem, x, v, product)
                evaluations += 1
            if j >= 0:
                left = _extend(memory, weights, product, j)
                used = j + 1
            else:
                if k == 1:
                    for i in range(n):
                        weights[i] = abs(product[i])
                    raise_scales(memory.scale, memory.own_scale, weights)
                left = _begin(memory, memory.own_scale if stage == OWN else memory.scale,
                              x, value, weights)
                goal = _FORCING * left
            # Written so that NaN ends it.
            if used == columns or not left > goal:
                break
            for i in range(n):
                v[i] = weights[i] * memory.directions[used, i]
        _add_combination(memory, weights, used, value, x)
    return NO_CONVERGENCE, residual, evaluations


@inlined
def _begin(memory: Memory, scale: np.ndarray, x: np.ndarray, value: np.ndarray,
           weights: np.ndarray) -> float:
    """Set the weights of unknowns, and the first direction to G(x) - x; return its length."""
    first, length = memory.directions[0], 0.0
    for i in range(x.size):
        weights[i] = scale[i]
        if scale[i] == 0.0:
            # A state and slope of zero say nothing about the size of the solution.
            weights[i] = max(abs(x[i]), abs(value[i]), 1.0)
        elif math.isinf(scale[i]):
            # What does not act back is no part of the system.
            weights[i] = 0.0
        first[i] = (value[i] - x[i]) / weights[i] if weights[i] > 0.0 else 0.0
        length += first[i] * first[i]
    length = math.sqrt(length)
    for i in range(x.size):
        first[i] = first[i] / length if length > 0.0 else 0.0
    memory.rotations[2, 0] = length
    return length


@inlined
def _extend(memory: Memory, weights: np.ndarray, product: np.ndarray, j: int) -> float:
    """
    Add (I - G') times direction j to the space, orthogonalised; return what is left of G(x) - x.

    The small matrix is kept triangular by rotations, of which the last leaves the residual.
    """
    n, column = weights.size, memory.hessenberg[:, j]
    cosine, sine, right = memory.rotations[0], memory.rotations[1], memory.rotations[2]
    new, length = memory.directions[j + 1], 0.0
    for i in range(n):
        new[i] = memory.directions[j, i]
        if weights[i] > 0.0:
            new[i] -= product[i] / weights[i]
    for a in range(j + 1):
        other, dot = memory.directions[a], 0.0
        for i in range(n):
            dot += other[i] * new[i]
        column[a] = dot
        for i in range(n):
            new[i] -= dot * other[i]
    for i in range(n):
        length += new[i] * new[i]
    length = math.sqrt(length)
    for i in range(n):
        new[i] = new[i] / length if length > 0.0 else 0.0
    for a in range(j):
        above = column[a]
        column[a] = cosine[a] * above + sine[a] * column[a + 1]
        column[a + 1] = cosine[a] * column[a + 1] - sine[a] * above
    size = math.hypot(column[j], length)
    if size == 0.0:
        # A direction that (I - G') maps to zero: none of it is of use.
        cosine[j], sine[j], column[j] = 1.0, 0.0, math.inf
    else:
        cosine[j], sine[j], column[j] = column[j] / size, length / size, size
    right[j + 1] = -sine[j] * right[j]
    right[j] *= cosine[j]
    return abs(right[j + 1])


@inlined
def _add_combination(memory: Memory, weights: np.ndarray, used: int, value: np.ndarray,
                     x: np.ndarray) -> None:
    """Add the combination of the directions that leaves least of G(x) - x."""
    right = memory.rotations[2]
    for j in range(used - 1, -1, -1):
        for a in range(j + 1, used):
            right[j] -= memory.hessenberg[j, a] * right[a]
        right[j] /= memory.hessenberg[j, j]
        for i in range(x.size):
            x[i] += weights[i] * right[j] * memory.directions[j, i]
    for i in range(x.size):
        if weights[i] == 0.0:
            x[i] = value[i]
