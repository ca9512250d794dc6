# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Newton's method without a Jacobian, for the equation x = G(x) of a step; see solvers."""

from collections.abc import Callable
import math
from typing import NamedTuple

from hnn_vi_ros.integrators.arithmetic import copy_array
from hnn_vi_ros.integrators.base import NO_CONVERGENCE
from hnn_vi_ros.integrators.newton import raise_scales
from hnn_vi_ros.integrators.solvers import BACK, COMMON, GO_ON, judge, OWN
from hnn_vi_ros.integrators.workspaces import NewtonWork, SolverWork
from hnn_vi_ros.kernels.marks import inlined
import numpy as np

# How far the linear system of an iteration is solved, relative to its right-hand side.
_FORCING = 1e-3


@inlined
def krylov(equation: Callable, tangent: Callable, problem: NamedTuple, x: np.ndarray,
           work: SolverWork, max_iterations: int) -> tuple[int, float, int]:
    """
    Iterate (I - G'(x)) step = G(x) - x, each step by the method GMRES; see the module.

    It takes products G'(x) v, keeps a few, and forms no matrix. Where they do not suffice for a
    linear system, the next iteration continues from as far as they lead. Scales are raised as
    in Newton's method with a Jacobian, but by abs(G'(x) x) for the sum of absolute values, which
    takes the matrix: the two agree where one unknown is much larger than the others.

    References
    ----------
    Y. Saad, M. Schultz, GMRES: a generalized minimal residual algorithm for solving nonsymmetric
    linear systems, SIAM J. Sci. Stat. Comput. 7 (1986). R. Dembo, S. Eisenstat, T. Steihaug,
    Inexact Newton methods, SIAM J. Numer. Anal. 19 (1982).

    """
    iterates, own = work.iterates, work.newton
    n, columns = x.size, own.hessenberg.shape[1]
    value, defect = iterates.values[0], iterates.residuals[0]
    v, product, weights = own.direction, own.product, own.weights
    sizes = iterates.scale, iterates.own_scale, iterates.accepted
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
                left = _extend(own, product, j)
                used = j + 1
            else:
                if k == 1:
                    for i in range(n):
                        own.known[i] = abs(product[i])
                    raise_scales(iterates.scale, iterates.own_scale, own.known)
                left = _begin(own, iterates.own_scale if stage == OWN else iterates.scale,
                              x, value)
                goal = _FORCING * left
            # Written so that NaN ends it.
            if used == columns or not left > goal:
                break
            for i in range(n):
                v[i] = weights[i] * own.directions[used, i]
        _add_combination(own, used, value, x)
    return NO_CONVERGENCE, residual, evaluations


@inlined
def _begin(work: NewtonWork, scale: np.ndarray, x: np.ndarray, value: np.ndarray) -> float:
    """Set the weights of unknowns, and the first direction to G(x) - x; return its length."""
    first, weights, length = work.directions[0], work.weights, 0.0
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
    work.rotations[2, 0] = length
    return length


@inlined
def _extend(work: NewtonWork, product: np.ndarray, j: int) -> float:
    """
    Add (I - G') times direction j to the space, orthogonalised; return what is left of G(x) - x.

    Rotations keep the small matrix triangular; the last one leaves the residual.
    """
    weights, column = work.weights, work.hessenberg[:, j]
    n = weights.size
    cosine, sine, right = work.rotations[0], work.rotations[1], work.rotations[2]
    new, length = work.directions[j + 1], 0.0
    for i in range(n):
        new[i] = work.directions[j, i]
        if weights[i] > 0.0:
            new[i] -= product[i] / weights[i]
    for a in range(j + 1):
        other, dot = work.directions[a], 0.0
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
def _add_combination(work: NewtonWork, used: int, value: np.ndarray, x: np.ndarray) -> None:
    """Add the combination of the directions that leaves least of G(x) - x."""
    right, weights = work.rotations[2], work.weights
    for j in range(used - 1, -1, -1):
        for a in range(j + 1, used):
            right[j] -= work.hessenberg[j, a] * right[a]
        right[j] /= work.hessenberg[j, j]
        for i in range(x.size):
            x[i] += weights[i] * right[j] * work.directions[j, i]
    for i in range(x.size):
        if weights[i] == 0.0:
            x[i] = value[i]
