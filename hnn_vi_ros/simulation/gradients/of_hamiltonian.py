# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Dependences of runs on parameters of H, via its velocities in forces and Lagrangians."""

from typing import NamedTuple

from hnn_vi_ros.hamiltonians import compiled_kernel
from hnn_vi_ros.kernels import (
    by_address, energy as base_energy, gradient as base_gradient,
    hessian_vector as base_hessian_vector, Kernel, original, Target)
from hnn_vi_ros.simulation.gradients.dependences import Dependence, MIDDLE, StateSequence
import numpy as np

# Spacing of differences with respect to velocities, relative to the largest velocity.
_RELATIVE_SPACING = float(np.cbrt(np.finfo(np.float64).eps))


def base_of(kernel: Kernel) -> Kernel:
    """Return the kernel of H without forces, given that of H with forces."""
    return kernel if not kernel.channels else kernel._replace(
        parameters=original(kernel).parameters[0], channels=0,
        dimension=kernel.dimension - kernel.channels)


def _cut(states: np.ndarray, kernel: Kernel) -> np.ndarray:
    """Return concatenated states as rows without channels, shape (..., N, d)."""
    rows = states.reshape(*states.shape[:-1], -1, kernel.dimension)
    return rows[..., :kernel.dimension - kernel.channels]


class OnHamiltonian:
    """
    Dependence of a run on a parameter of H, but not of the forces.

    With forces f(t, q, p, v) the steps use G = (H_q - f_p, H_p + f_q) with v = H_p: the parameter
    changes G through H' directly, and through the dependence of forces on v. The derivatives G_v
    are finite differences of order 6.

    Parameters
    ----------
    own : Dependence
        Dependence of H' without forces.
    kernel : Kernel
        Kernel of H with forces, by address.

    """

    def __init__(self, own: Dependence, kernel: Kernel):
        self._own, self._kernel = own, kernel
        self._d = kernel.dimension - kernel.channels

    def contracted(self, at: StateSequence, weights: np.ndarray) -> np.ndarray:
        """Return the gradient; see Dependence."""
        if not self._kernel.channels:
            return self._own.contracted(at, weights)
        felt = _cut(weights, self._kernel)
        by_velocity = np.einsum('jhni,hni->nj', self._slopes(at), felt)
        return self._own.contracted(self._without_channels(at),
                                    np.stack([felt[0], by_velocity]).reshape(2, -1))

    def changed(self, at: StateSequence, change: np.ndarray) -> np.ndarray:
        """Return the change; see Dependence."""
        if not self._kernel.channels:
            return self._own.changed(at, change)
        by_q, by_p = self._own.changed(self._without_channels(at), change).reshape(2, -1, self._d)
        found = np.zeros((2, len(by_q), self._kernel.dimension))
        found[..., :self._d] = np.einsum('jhni,nj->hni', self._slopes(at), by_p)
        found[0, :, :self._d] += by_q
        return found.reshape(2, -1)

    def _without_channels(self, at: StateSequence) -> StateSequence:
        return StateSequence.at(_cut(at.q, self._kernel).ravel(), _cut(at.p, self._kernel).ravel())

    def _slopes(self, at: StateSequence) -> np.ndarray:
        """Return the derivatives of G with respect to each velocity, shape (d, 2, N, d)."""
        total = original(self._kernel)
        shifted = _Shifted(total.parameters[0], np.zeros(self._d))
        base = by_address(compiled_kernel((_energy, _gradient, _hessian_vector), shifted, self._d))
        kernel = by_address(total._replace(parameters=(base.parameters, *total.parameters[1:])))
        fastest = np.abs(_cut(at.gradient(kernel), self._kernel)[1]).max(initial=0.0)
        spacing = _RELATIVE_SPACING * (float(fastest) or 1.0)
        slopes = np.zeros((self._d, 2, at.q.size // kernel.dimension, self._d))
        for j in range(self._d):
            for offset, (weight, _) in MIDDLE.items():
                shifted.shift[j] = offset * spacing
                slopes[j] += weight / spacing * _cut(at.gradient(kernel), self._kernel)
            shifted.shift[j] = 0.0
        return slopes


class OnLagrangian:
    """
    Dependence of H' on a parameter w, from that of the negative Lagrangian -L(q, v).

    It uses H_w(q, p) = -L_w(q, v) at the velocity v = H_p(q, p), so that neither a prior nor a
    mass matrix is inverted: the derivative of v is a product with H''. A force -f(q, v) that
    depends on w is included in -L_q.

    Parameters
    ----------
    own : Dependence
        Dependence of (-L_q + f, -L_v), at q and v.
    kernel : Kernel
        Kernel of H without forces.

    """

    def __init__(self, own: Dependence, kernel: Kernel):
        self._own, self._kernel = own, kernel

    def contracted(self, at: StateSequence, weights: np.ndarray) -> np.ndarray:
        """Return the gradient; see Dependence."""
        changed = self._kernel.products(at.q, at.p, *weights)[1]
        return self._own.contracted(self._moving(at), np.stack([weights[0], changed]))

    def changed(self, at: StateSequence, change: np.ndarray) -> np.ndarray:
        """Return the change; see Dependence."""
        by_q, by_v = self._own.changed(self._moving(at), change)
        found = self._kernel.products(at.q, at.p, np.zeros_like(by_v), by_v)
        found[0] += by_q
        return found

    def _moving(self, at: StateSequence) -> StateSequence:
        """Return the states with velocities in place of momenta."""
        return StateSequence.at(at.q, self._kernel.slopes(at.q, at.p)[1])


class _Shifted(NamedTuple):
    """Parameters of H + c . p, which adds c to velocities: H, and c of shape (d,)."""

    base: Target
    shift: np.ndarray


def _energy(parameters: _Shifted, q: np.ndarray, p: np.ndarray) -> float:
    return base_energy(parameters.base, q, p) + np.dot(parameters.shift, p)


def _gradient(parameters: _Shifted, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
              dH_dp: np.ndarray) -> None:
    base_gradient(parameters.base, q, p, dH_dq, dH_dp)
    for i in range(p.size):
        dH_dp[i] += parameters.shift[i]


def _hessian_vector(parameters: _Shifted, q: np.ndarray, p: np.ndarray, v_q: np.ndarray,
                    v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
    base_hessian_vector(parameters.base, q, p, v_q, v_p, product_q, product_p)
