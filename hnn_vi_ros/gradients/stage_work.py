# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Workspace of the derivatives of steps, and what effects do to these steps."""

from typing import NamedTuple

from hnn_vi_ros.integrators.workspaces import SolverWork
import numpy as np


class StageWork(NamedTuple):
    """
    Workspace of one step's derivatives, of s stages of d coordinates.

    Parameters
    ----------
    solver : SolverWork
        Of the equation for the stages.
    change : np.ndarray, shape (2 d,)
        The mean rate of change in the step.
    v_q, v_p, product_q, product_p : np.ndarray, shape (s d,)
        A direction, and H'' times it or H' itself, at each stage.
    slopes : np.ndarray, shape (s, 2 d, 2 d)
        H'' at each stage.
    matrix : np.ndarray, shape (2 s d, 2 s d)
        I - G_Z, or its transpose; or its factors.
    pivots : np.ndarray of int, shape (2 s d,)
        The exchanges of rows of these factors.
    right : np.ndarray, shape (2 s d,)
        The right-hand side, then the solution.
    start, end : np.ndarray, shape (2 d,)
        A state, a tangent or a cotangent between the flows around a step.

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
    def empty(cls, s: int, d: int) -> 'StageWork':
        """Return the working space."""
        n = 2 * s * d
        v_q, v_p, product_q, product_p = np.zeros((4, s * d))
        return cls(SolverWork.empty(n), np.zeros(2 * d), v_q, v_p, product_q, product_p,
                   np.zeros((s, 2 * d, 2 * d)), np.zeros((n, n)),
                   np.zeros(n, dtype=np.int64), np.zeros(n), np.zeros(2 * d), np.zeros(2 * d))


class Acting(NamedTuple):
    """
    Input of effects that do work in K steps, and what they do around each.

    Parameters
    ----------
    clock, command : np.ndarray
        Arrays of the kernel's EffectState, restored for each step.
    times : np.ndarray, shape (K,)
        At the starts of the steps [s].
    commands : np.ndarray, shape (K, size of command)
        In the steps.
    flow : np.ndarray, shape (2 d,)
        Factors of friction on a state before a step, and after it; 0 for channels, which start
        over.

    """

    clock: np.ndarray
    command: np.ndarray
    times: np.ndarray
    commands: np.ndarray
    flow: np.ndarray
