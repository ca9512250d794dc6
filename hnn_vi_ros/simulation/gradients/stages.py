# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Compiled derivatives of steps of partitioned Runge-Kutta methods; see PartitionedTableau.

The stages Z of a step solve Z = G(Z; z). By the implicit function theorem, a tangent of z is
propagated by one solve with the matrix I - G_Z, and a cotangent by one with its transpose, using
the second derivatives H'' at the stages. Parameters enter a step only through the slopes
F = (H_q, H_p) at the stages: a change of F is a source of the tangent, and the cotangent of F is
returned for each stage.

The trajectory is given. States are (q, p), 2 d numbers; stages are the concatenated q of all s
stages, then p.
"""

from typing import NamedTuple

from hnn_vi_ros.integrators import (
    anderson, newton, NO_CONVERGENCE, OK, PartitionedTableau, set_scale, SolverWork)
from hnn_vi_ros.kernels import (
    bare, factorise_rows, inlined, Kernel, solve_factorised, solve_linear)
import numpy as np


class StageDerivatives(NamedTuple):
    """
    Workspace of the derivatives of one step with s stages of d coordinates.

    Parameters
    ----------
    solver : SolverWork
        Workspace of the solver of the stages.
    change : np.ndarray, shape (2 d,)
        Mean rate of change in the step.
    v_q, v_p, product_q, product_p : np.ndarray, shape (s d,)
        Direction, and its product with H'' or H' itself, at each stage.
    slopes : np.ndarray, shape (s, 2 d, 2 d)
        H'' at each stage.
    matrix : np.ndarray, shape (2 s d, 2 s d)
        I - G_Z or its transpose, or the LU factors of it.
    pivots : np.ndarray of int, shape (2 s d,)
        Row exchanges of the factorisation.
    right : np.ndarray, shape (2 s d,)
        Right-hand side, overwritten with the solution.
    start, end : np.ndarray, shape (2 d,)
        State, tangent or cotangent before and after a step, inside the flows around it.

    """

    solver: SolverWork
    change: np.ndarray
    v_q: np.ndarray
    v_p: np.ndarray
    product_q: np.ndarray
    product_p: np.ndarray
    slopes: np.ndarray
    matrix: np.ndarray
    pivots: np.ndarray
    right: np.ndarray
    start: np.ndarray
    end: np.ndarray

    @classmethod
    def empty(cls, s: int, d: int) -> 'StageDerivatives':
        """Return an empty workspace."""
        n = 2 * s * d
        v_q, v_p, product_q, product_p = np.zeros((4, s * d))
        return cls(SolverWork.empty(n), np.zeros(2 * d), v_q, v_p, product_q, product_p,
                   np.zeros((s, 2 * d, 2 * d)), np.zeros((n, n)),
                   np.zeros(n, dtype=np.int64), np.zeros(n), np.zeros(2 * d), np.zeros(2 * d))


class Acting(NamedTuple):
    """
    Inputs in K steps of effects that do work, and damping factors around steps.

    Parameters
    ----------
    clock, command : np.ndarray
        Arrays of the kernel's EffectState, restored for each step.
    times : np.ndarray, shape (K, m)
        Start times of the steps of m trajectories [s].
    commands : np.ndarray, shape (K, m, size of command)
        Commands during the steps.
    flow : np.ndarray, shape (2 d,)
        Damping factors on a state before and after each step; 0 for channels, which are reset,
        but 1 for internal variables.
    before, after : np.ndarray, shape (K, m, 2 d, 2 d)
        With loops, maps of tangents before and after each step, outside the damping; else K is 0.

    """

    clock: np.ndarray
    command: np.ndarray
    times: np.ndarray
    commands: np.ndarray
    flow: np.ndarray
    before: np.ndarray
    after: np.ndarray


_MAX_ITERATIONS = 20
# Largest distance from the next state, relative to the scale, of a step taken by the tableau.
_MAX_STATE_DISTANCE = 1e-9


class _TableauEquation(NamedTuple):
    """Equation for the stages of a step from z, with H' at the stages."""

    kernel: Kernel
    h: float
    tableau: PartitionedTableau
    z: np.ndarray
    dH_dq: np.ndarray
    dH_dp: np.ndarray


def find_stages(kernel: Kernel, h: float, tableau: PartitionedTableau, acting: Acting,
                starts: np.ndarray, ends: np.ndarray, checked: bool, stages: np.ndarray,
                work: StageDerivatives) -> int:
    """
    Compute the stages of steps.

    Parameters
    ----------
    kernel : Kernel
        Kernel of H.
    h : float
        Step size [s].
    tableau : PartitionedTableau
        Tableau of the method.
    acting : Acting
        Inputs of effects.
    starts, ends : np.ndarray, shape (K, m, 2 d)
        States of m trajectories before and after each of K steps; internal variables of the
        starts after the first one are output.
    checked : bool
        True if the ends are known and checked; False to replace guesses by the result.
    stages : np.ndarray, shape (K, m, 2 s d)
        Output: stages; NaN if they are not found.
    work : StageWork
        Workspace, overwritten.

    Returns
    -------
    int
        Flat index in (K, m) of the first step whose stages are not found, or -1.

    """
    kernel, tableau, acting, starts, ends, stages, work = bare(
        (kernel, tableau, acting, starts, ends, stages, work))
    start, end, flow = work.start, work.end, acting.flow
    failed, own = -1, kernel.dimension - kernel.channels
    for n in range(stages.shape[0]):
        for m in range(stages.shape[1]):
            _enter(acting, n, m)
            for k in range(own, own + kernel.internal):
                ends[n, m, k] = starts[n, m, k]
            for k in range(flow.size):
                start[k] = flow[k] * starts[n, m, k]
                end[k] = ends[n, m, k] / flow[k] if flow[k] != 0.0 else 0.0
            if not _find(kernel, h, tableau, start, end, checked, stages[n, m], work):
                stages[n, m] = np.nan
                failed = n * stages.shape[1] + m if failed < 0 else failed
            for k in range(0 if checked else flow.size):
                ends[n, m, k] = flow[k] * end[k]
            for k in range(own, own + kernel.internal if n + 1 < stages.shape[0] else own):
                # The integral of a channel is the change of its internal variable.
                starts[n + 1, m, k] = starts[n, m, k]
                for j in range(tableau.p_weights.size):
                    starts[n + 1, m, k] -= \
                        h * tableau.p_weights[j] * work.product_q[j * kernel.dimension + k]
    return failed


def fill_gradients(kernel: Kernel, h: float, tableau: PartitionedTableau, acting: Acting,
                   stages: np.ndarray, found: np.ndarray, work: StageDerivatives) -> int:
    """
    Compute (H_q, H_p) at stages whose channels hold the time, under the command of each step.

    Parameters
    ----------
    kernel, h, tableau, acting, stages, work
        See ``find_stages``; the kernel may be another one that shares the command array.
    found : np.ndarray, shape (2, K, m, s d)
        Output: (H_q, H_p).

    Returns
    -------
    int
        Always -1.

    """
    kernel, acting, stages, found = bare((kernel, acting, stages, found))
    acting.clock[:] = 0.0
    half = stages.shape[2] // 2
    for n in range(stages.shape[0]):
        for m in range(stages.shape[1]):
            for i in range(acting.command.size):
                acting.command[i] = acting.commands[n, m, i]
            kernel.gradient(kernel.parameters, stages[n, m, :half], stages[n, m, half:],
                            found[0, n, m], found[1, n, m])
    return -1


def pull_back(kernel: Kernel, h: float, tableau: PartitionedTableau, acting: Acting,
              stages: np.ndarray, cotangents: np.ndarray, directions: np.ndarray,
              felt: np.ndarray, work: StageDerivatives) -> int:
    """
    Propagate cotangents back through steps.

    Parameters
    ----------
    kernel, h, tableau, acting, stages, work
        See ``find_stages``.
    cotangents : np.ndarray, shape (K + 1, m, 2 d)
        Input: cotangents of each state alone. Output: including all later states.
    directions : np.ndarray, shape (K, m, 2 s d)
        Output: cotangents of H_q at the stages, then of H_p.
    felt : np.ndarray, shape (K, 2, m, 2 d)
        Output: cotangents after the flow that precedes each step, and after that which follows.

    Returns
    -------
    int
        Flat index in (K, m) of a step whose matrix is singular, or -1.

    """
    kernel, tableau, acting, stages, cotangents, directions, felt, work = bare(
        (kernel, tableau, acting, stages, cotangents, directions, felt, work))
    start, end, flow = work.start, work.end, acting.flow
    for k in range(stages.shape[0]):
        n = stages.shape[0] - 1 - k
        for m in range(stages.shape[1]):
            _enter(acting, n, m)
            for i in range(flow.size):
                felt[n, 1, m, i] = cotangents[n + 1, m, i]
            if acting.after.shape[0] > 0:
                _apply(acting.after[n, m].T, felt[n, 1, m], work.change)
            for i in range(flow.size):
                start[i], end[i] = 0.0, flow[i] * felt[n, 1, m, i]
            for i in range(_own(kernel) - kernel.internal, _own(kernel)):
                end[kernel.dimension + i] = cotangents[n + 1, m, i]
            if not _pull(kernel, h, tableau, stages[n, m], start, end, directions[n, m], work):
                return n * stages.shape[1] + m
            for i in range(flow.size):
                felt[n, 0, m, i] = start[i]
                end[i] = flow[i] * start[i]
            if acting.before.shape[0] > 0:
                _apply(acting.before[n, m].T, end, work.change)
            for i in range(flow.size):
                cotangents[n, m, i] += end[i]
    return -1


def push_forward(kernel: Kernel, h: float, tableau: PartitionedTableau, acting: Acting,
                 stages: np.ndarray, sources: np.ndarray, added: np.ndarray,
                 tangents: np.ndarray, work: StageDerivatives) -> int:
    """
    Propagate r tangents of each trajectory through steps, each factorised once.

    Parameters
    ----------
    kernel, h, tableau, acting, stages, work
        See ``find_stages``.
    sources : np.ndarray, shape (K, r, m, 2 s d)
        Changes of H_q at the stages, then of H_p, due to parameters.
    added : np.ndarray, shape (K, 2, r, m, 2 d)
        Changes due to parameters of the states after the flows before and after each step.
    tangents : np.ndarray, shape (K + 1, r, m, 2 d)
        Input: tangents of the first state. Output: tangents of all states.

    Returns
    -------
    int
        Flat index in (K, m) of the first singular step, or -1; tangents after it are NaN.

    """
    kernel, tableau, acting, stages, sources, added, tangents, work = bare(
        (kernel, tableau, acting, stages, sources, added, tangents, work))
    start, end, flow, failed = work.start, work.end, acting.flow, -1
    explicit = _is_explicit(tableau)
    for n in range(stages.shape[0]):
        for m in range(stages.shape[1]):
            _enter(acting, n, m)
            _fill_slopes(kernel, stages[n, m], work)
            if not (explicit or _factorise(h, tableau, work)):
                tangents[n + 1, :, m] = np.nan
                failed = n * stages.shape[1] + m if failed < 0 else failed
                continue
            for r in range(tangents.shape[1]):
                for k in range(flow.size):
                    start[k] = tangents[n, r, m, k]
                if acting.before.shape[0] > 0:
                    _apply(acting.before[n, m], start, work.change)
                for k in range(flow.size):
                    start[k] = flow[k] * start[k] + added[n, 0, r, m, k]
                _push(kernel, h, tableau, sources[n, r, m], start, end, explicit, work)
                for k in range(_own(kernel) - kernel.internal, _own(kernel)):
                    end[k] += end[kernel.dimension + k]
                for k in range(flow.size):
                    end[k] = flow[k] * end[k]
                if acting.after.shape[0] > 0:
                    _apply(acting.after[n, m], end, work.change)
                for k in range(flow.size):
                    tangents[n + 1, r, m, k] = end[k] + added[n, 1, r, m, k]
    return failed


@inlined
def _apply(matrix: np.ndarray, vector: np.ndarray, spare: np.ndarray) -> None:
    """Multiply a vector by a matrix, in place."""
    for i in range(spare.size):
        spare[i] = 0.0
        for j in range(spare.size):
            spare[i] += matrix[i, j] * vector[j]
    for i in range(spare.size):
        vector[i] = spare[i]


@inlined
def _enter(acting: Acting, n: int, m: int) -> None:
    """Set the time and the command of a step for the forces."""
    acting.clock[0], acting.clock[1] = acting.times[n, m], 0.0
    for i in range(acting.command.size):
        acting.command[i] = acting.commands[n, m, i]


@inlined
def _find(kernel: Kernel, h: float, tableau: PartitionedTableau, z: np.ndarray, z1: np.ndarray,
          checked: bool, x: np.ndarray, work: StageDerivatives) -> bool:
    """Compute the stages of a step from z to z1, or z1 too; return False if none are found."""
    s, d = tableau.q_weights.size, kernel.dimension
    scale, own = work.solver.iterates.scale, work.solver.iterates.own_scale
    for k in range(2 * d):
        work.change[k] = (z1[k] - z[k]) / h
    problem = _TableauEquation(kernel, h, tableau, z, work.product_q, work.product_p)
    for i in range(s):
        a, b = i * d, (s + i) * d
        set_scale(scale[a:a + d], own[a:a + d], z[:d], work.change[:d], h, kernel, 1)
        set_scale(scale[b:b + d], own[b:b + d], z[d:], work.change[d:], h, kernel, 0)
    outcome = NO_CONVERGENCE
    if _is_explicit(tableau):
        _walk(problem, x)
        outcome = OK
    # Try Newton's method after Anderson's fails, since it needs a matrix in addition.
    for attempt in range(0 if outcome == OK else 2):
        for i in range(s):
            node_q, node_p = 0.0, 0.0
            for j in range(s):
                node_q += tableau.q_matrix[i, j]
                node_p += tableau.p_matrix[i, j]
            for k in range(d):
                x[i * d + k] = z[k] + node_q * (z1[k] - z[k])
                x[(s + i) * d + k] = z[d + k] + node_p * (z1[d + k] - z[d + k])
        if attempt == 0:
            outcome, _, _ = anderson(_equation, _tangent, problem, x, work.solver, _MAX_ITERATIONS)
        else:
            outcome, _, _ = newton(_equation, _tangent, problem, x, work.solver, _MAX_ITERATIONS)
        if outcome == OK:
            break
    if outcome != OK:
        return False
    for k in range(d - kernel.channels):
        dq, dp = 0.0, 0.0
        for j in range(s):
            dq += tableau.q_weights[j] * problem.dH_dp[j * d + k]
            dp -= tableau.p_weights[j] * problem.dH_dq[j * d + k]
        end_q, end_p = z[k] + h * dq, z[d + k] + h * dp
        if not checked:
            z1[k], z1[d + k] = end_q, end_p
        if not (abs(end_q - z1[k]) <= _MAX_STATE_DISTANCE * scale[k]
                and abs(end_p - z1[d + k]) <= _MAX_STATE_DISTANCE * scale[s * d + k]):
            return False
    return True


@inlined
def _is_explicit(tableau: PartitionedTableau) -> bool:
    """Return whether each stage depends on earlier stages only."""
    s = tableau.q_weights.size
    for i in range(s):
        for j in range(i, s):
            if tableau.q_matrix[i, j] != 0.0 or tableau.p_matrix[i, j] != 0.0:
                return False
    return True


@inlined
def _walk(problem: _TableauEquation, x: np.ndarray) -> None:
    """Compute the stages of an explicit step in sequence, and H' at them."""
    s, d, z = problem.tableau.q_weights.size, problem.kernel.dimension, problem.z
    for i in range(s):
        a, b = i * d, (s + i) * d
        for k in range(d):
            dq, dp = _combine(problem.tableau, problem.dH_dq, problem.dH_dp, i, k, i)
            x[a + k], x[b + k] = z[k] + problem.h * dq, z[d + k] + problem.h * dp
        problem.kernel.gradient(problem.kernel.parameters, x[a:a + d], x[b:b + d],
                                problem.dH_dq[a:a + d], problem.dH_dp[a:a + d])


@inlined
def _combine(tableau: PartitionedTableau, dH_dq: np.ndarray, dH_dp: np.ndarray, i: int, k: int,
             stages: int) -> tuple[float, float]:
    """Return component k of the sums over the first stages j of a_ij H_p and of -A_ij H_q."""
    d = dH_dq.size // tableau.q_weights.size
    dq, dp = 0.0, 0.0
    for j in range(stages):
        dq += tableau.q_matrix[i, j] * dH_dp[j * d + k]
        dp -= tableau.p_matrix[i, j] * dH_dq[j * d + k]
    return dq, dp


@inlined
def _equation(problem: _TableauEquation, x: np.ndarray, value: np.ndarray) -> None:
    s, d, z = problem.tableau.q_weights.size, problem.kernel.dimension, problem.z
    problem.kernel.gradient(problem.kernel.parameters, x[:s * d], x[s * d:],
                            problem.dH_dq, problem.dH_dp)
    for i in range(s):
        for k in range(d):
            dq, dp = _combine(problem.tableau, problem.dH_dq, problem.dH_dp, i, k, s)
            value[i * d + k] = z[k] + problem.h * dq
            value[(s + i) * d + k] = z[d + k] + problem.h * dp


@inlined
def _tangent(problem: _TableauEquation, x: np.ndarray, v: np.ndarray, product: np.ndarray) -> None:
    s, d = problem.tableau.q_weights.size, problem.kernel.dimension
    # Reuse these arrays: the next evaluation of the equation overwrites them anyway.
    at_q, at_p = problem.dH_dq, problem.dH_dp
    problem.kernel.hessian_vector(problem.kernel.parameters, x[:s * d], x[s * d:],
                                  v[:s * d], v[s * d:], at_q, at_p)
    for i in range(s):
        for k in range(d):
            dq, dp = _combine(problem.tableau, at_q, at_p, i, k, s)
            product[i * d + k], product[(s + i) * d + k] = problem.h * dq, problem.h * dp


@inlined
def _fill_slopes(kernel: Kernel, x: np.ndarray, work: StageDerivatives) -> None:
    """Compute H'' at each stage, column by column."""
    n, d, own = work.v_q.size, kernel.dimension, _own(kernel)
    # Columns of channels are zero.
    for c in range(2 * own):
        column = c if c < own else d + c - own
        for j in range(n // d):
            for k in range(d):
                work.v_q[j * d + k] = 1.0 if k == column else 0.0
                work.v_p[j * d + k] = 1.0 if k == column - d else 0.0
        kernel.hessian_vector(kernel.parameters, x[:n], x[n:], work.v_q, work.v_p,
                              work.product_q, work.product_p)
        for j in range(n // d):
            for k in range(d):
                work.slopes[j, k, column] = work.product_q[j * d + k]
                work.slopes[j, d + k, column] = work.product_p[j * d + k]


@inlined
def _fill_matrix(h: float, tableau: PartitionedTableau, work: StageDerivatives, transposed: bool
                 ) -> None:
    """Assemble the matrix I - G_Z, or its transpose, from H'' at the stages."""
    s, d = tableau.q_weights.size, work.slopes.shape[1] // 2
    matrix, slopes = work.matrix, work.slopes
    for i in range(s):
        for j in range(s):
            for k in range(d):
                row_q, row_p = i * d + k, (s + i) * d + k
                for c in range(2 * d):
                    column = j * d + c if c < d else (s + j) * d + c - d
                    entry_q = -h * tableau.q_matrix[i, j] * slopes[j, d + k, c]
                    entry_p = h * tableau.p_matrix[i, j] * slopes[j, k, c]
                    if transposed:
                        matrix[column, row_q], matrix[column, row_p] = entry_q, entry_p
                    else:
                        matrix[row_q, column], matrix[row_p, column] = entry_q, entry_p
    for k in range(2 * s * d):
        matrix[k, k] += 1.0


@inlined
def _factorise(h: float, tableau: PartitionedTableau, work: StageDerivatives) -> bool:
    """Factorise I - G_Z from H'' at the stages; return False if it is singular."""
    _fill_matrix(h, tableau, work, False)
    return factorise_rows(work.matrix, work.pivots)


@inlined
def _pull(kernel: Kernel, h: float, tableau: PartitionedTableau, x: np.ndarray,
          before: np.ndarray, after: np.ndarray, direction: np.ndarray, work: StageDerivatives
          ) -> bool:
    """Propagate the cotangent after a step, added to that before it; return False if singular."""
    s, d, right, slopes = tableau.q_weights.size, kernel.dimension, work.right, work.slopes
    n = s * d
    _fill_slopes(kernel, x, work)
    _fill_matrix(h, tableau, work, True)
    for j in range(s):
        for k in range(d):
            direction[j * d + k] = -h * tableau.p_weights[j] * after[d + k]
            direction[n + j * d + k] = h * tableau.q_weights[j] * after[k]
        for c in range(d):
            at_q, at_p = 0.0, 0.0
            for k in range(d):
                on_q, on_p = direction[j * d + k], direction[n + j * d + k]
                at_q += slopes[j, k, c] * on_q + slopes[j, d + k, c] * on_p
                at_p += slopes[j, k, d + c] * on_q + slopes[j, d + k, d + c] * on_p
            right[j * d + c], right[n + j * d + c] = at_q, at_p
    if solve_linear(work.matrix, right) == 0:
        return False
    for k in range(d):
        before[k] += after[k]
        before[d + k] += after[d + k]
        for i in range(s):
            before[k] += right[i * d + k]
            before[d + k] += right[n + i * d + k]
    for j in range(s):
        for k in range(d):
            for i in range(s):
                direction[j * d + k] -= h * tableau.p_matrix[i, j] * right[n + i * d + k]
                direction[n + j * d + k] += h * tableau.q_matrix[i, j] * right[i * d + k]
    return True


@inlined
def _push(kernel: Kernel, h: float, tableau: PartitionedTableau, source: np.ndarray,
          before: np.ndarray, after: np.ndarray, explicit: bool, work: StageDerivatives) -> None:
    """Propagate a tangent through a step, whose matrix is already factorised if implicit."""
    s, d, right, own = tableau.q_weights.size, kernel.dimension, work.right, _own(kernel)
    n, changed_q, changed_p = s * d, work.v_q, work.v_p
    if not explicit:
        for k in range(n):
            changed_q[k], changed_p[k] = source[k], source[n + k]
    for i in range(s):
        for k in range(own if explicit else d):
            dq, dp = _combine(tableau, changed_q, changed_p, i, k, i if explicit else s)
            right[i * d + k] = before[k] + h * dq
            right[n + i * d + k] = before[d + k] + h * dp
        if explicit:
            _change(source, i, d, own, work)
    if not explicit:
        solve_factorised(work.matrix, work.pivots, right)
        for i in range(s):
            _change(source, i, d, own, work)
    for k in range(d):
        after[k], after[d + k] = before[k], before[d + k]
        for j in range(s if k < own else 0):
            after[k] += h * tableau.q_weights[j] * changed_p[j * d + k]
            after[d + k] -= h * tableau.p_weights[j] * changed_q[j * d + k]


@inlined
def _own(kernel: Kernel) -> int:
    """Return the number of coordinates and internal variables; states depend on these only."""
    return kernel.dimension - kernel.channels + kernel.internal


@inlined
def _change(source: np.ndarray, j: int, d: int, own: int, work: StageDerivatives) -> None:
    """Compute the change of H' at a stage, in v_q and v_p, for a change of stages in `right`."""
    n, right, slopes = work.v_q.size, work.right, work.slopes
    for k in range(own):
        at_q, at_p = source[j * d + k], source[n + j * d + k]
        for c in range(own):
            v_q, v_p = right[j * d + c], right[n + j * d + c]
            at_q += slopes[j, k, c] * v_q + slopes[j, k, d + c] * v_p
            at_p += slopes[j, d + k, c] * v_q + slopes[j, d + k, d + c] * v_p
        work.v_q[j * d + k], work.v_p[j * d + k] = at_q, at_p
