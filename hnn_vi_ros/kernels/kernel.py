# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A Hamiltonian as functions to be compiled."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

# First argument of the functions of a Hamiltonian, an effect or a network: numbers, arrays and
# tuples of these, with a different type for each.
Parameters = tuple[Any, ...]
# Functions of a `Kernel`.
Energy = Callable[[Any, np.ndarray, np.ndarray], float]
Gradient = Callable[[Any, np.ndarray, np.ndarray, np.ndarray, np.ndarray], None]
HessianVector = Callable[[Any, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray,
                          np.ndarray], None]
Functions = tuple[Energy, Gradient, HessianVector]


class Kernel(NamedTuple):
    """
    A Hamiltonian as functions of plain arrays, ready to be compiled into the loop over steps.

    Parameters
    ----------
    energy : callable
        ``energy(parameters, q, p)`` returns H [J]; q and p have shape (d,).
    gradient : callable
        ``gradient(parameters, q, p, dH_dq, dH_dp)`` fills the last two. All have shape (m d,): m
        states in sequence.
    hessian_vector : callable
        ``hessian_vector(parameters, q, p, v_q, v_p, product_q, product_p)`` fills the last two
        with H''(q, p) (v_q, v_p); shapes as for the gradient.
    parameters : tuple
        Numbers and arrays, the first argument of all functions.
    dimension : int
        The number d of degrees of freedom, channels included.
    gradient_scale : tuple of float
        Rounding error of dH/dq and of dH/dp in units of the unit round-off, if it exceeds that of
        a number of their size; else 0.
    compiled : bool
        True if the functions are numba dispatchers, False if they are plain Python.
    channels : int
        Number of channels, the last coordinates: times since the start of the step, whose momenta
        are integrals over it; implicit equations ignore the residuals of the integrals.
    energy_scale : float
        Rounding error of H in units of the unit round-off, if it exceeds that of its value.
    rotations : tuple of int
        Columns of q at which unit quaternions (x, y, z, w) begin, in order; H is also smooth
        around norm 1, and dH_dq is its derivative by each of the four. The momentum of a rotation
        has three columns, immediately followed by the next ones; as many columns as there are
        rotations stay zero at the end of p and of dH_dp, before the channels.

    quadratic : bool
        True if H = p . M^-1 p / 2 + V(q) with constant masses and gradients that take nanoseconds.
    internal : int
        Number of the first channels whose coordinates are not times, but constants of a step that
        the integrals change after it.

    """

    energy: Energy
    gradient: Gradient
    hessian_vector: HessianVector
    parameters: Parameters
    dimension: int
    gradient_scale: tuple[float, float]
    compiled: bool
    channels: int = 0
    energy_scale: float = 0.0
    rotations: tuple[int, ...] = ()
    quadratic: bool = False
    internal: int = 0

    def energies(self, q: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return H [J] at m states in sequence, shape (m,), for q and p of shape (m d,)."""
        d = self.dimension
        found = np.empty(q.size // d)
        if self.compiled:
            # Imported lazily: reading a scene needs no compiler.
            from hnn_vi_ros.kernels.addresses import fill_energies, Target
            if isinstance(self.parameters, Target):
                fill_energies(self.parameters, q, p, found)
                return found
        for i in range(found.size):
            a, b = i * d, (i + 1) * d
            found[i] = self.energy(self.parameters, q[a:b], p[a:b])
        return found

    def slopes(self, q: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return (H_q, H_p), shape (2, m d), for q and p of shape (m d,)."""
        both = np.empty((2, q.size))
        self.gradient(self.parameters, q, p, *both)
        return both

    def products(self, q: np.ndarray, p: np.ndarray, v_q: np.ndarray, v_p: np.ndarray
                 ) -> np.ndarray:
        """Return H''(q, p) (v_q, v_p), shape (2, m d), for arrays of shape (m d,)."""
        both = np.empty((2, q.size))
        self.hessian_vector(self.parameters, q, p, v_q, v_p, *both)
        return both
