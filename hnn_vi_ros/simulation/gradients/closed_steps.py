# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Derivatives of the impulses that keep loops closed, before and after the step of a method.

With the step A of the method and its tangents, RATTLE maps a tangent (q, p) as follows; G0 and G1
are the gradients of the equations at both ends, lambda and mu the multipliers, C = (G^T lambda)_q:

    p -= (h/2) C0 q,    (q, p) = A (q, p),    (q, p) -= A (0, G0^T) (G1 A_qp G0^T)^-1 G1 q
    p -= (h/2) C1 q,    p -= G1^T (G1 H_pp G1^T)^-1 ((G1 H_p)_q q + G1 H_pp p)

The first one is `before`, those after A are `after` in ``stages.Acting``.
"""

from collections.abc import Callable
from typing import NamedTuple

from hnn_vi_ros.effects import LoopManifold
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.simulation.gradients.dependences import MIDDLE
import numpy as np

# Spacing of differences of G, an analytic function of angles [rad] and slides.
_SPACING = 2e-3
_MAX_ITERATIONS = 12
# Largest distance from the next state at which the multipliers of a step are accepted, relative.
_TOLERANCE = 1e-9

# Takes starts and returns ends, both of shape (N, 2 D), and the tangents of the step if they are
# wanted, (N, 2 D, 2 D).
InnerStep = Callable[[np.ndarray, bool], tuple[np.ndarray, np.ndarray | None]]


class _End(NamedTuple):
    """G, shape (N, K, d), its derivative, the projection of tangents of p, and that of H_p."""

    gradient: np.ndarray
    curved: np.ndarray
    projection: np.ndarray
    by_velocity: np.ndarray


class ClosedSteps:
    """
    Derivatives of the steps of a robot with loops.

    Parameters
    ----------
    manifold : LoopManifold
        Its loops.
    hamiltonian : Hamiltonian
        H with the effects added to it, without channels.
    h : float
        Step size [s].

    """

    def __init__(self, manifold: LoopManifold, hamiltonian: Hamiltonian, h: float):
        self._manifold, self._hamiltonian, self._h = manifold, hamiltonian, h
        self._d = hamiltonian.dimension

    def initial(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the derivatives of the projection of initial states.

        Derivative of the states, (m, 2 d, 2 d), and of momenta with respect to H_p, (m, d, d).
        """
        end, d = self._end(z), self._d
        inverse = self._hamiltonian.inverse_mass(*np.split(z, 2, axis=-1))
        nearest = np.tile(np.eye(2 * d), (len(z), 1, 1))
        response = inverse @ end.gradient.swapaxes(1, 2)
        nearest[:, :d, :d] -= response @ np.linalg.solve(end.gradient @ response, end.gradient)
        return end.projection @ nearest, end.by_velocity

    def around(self, states: np.ndarray, step: InnerStep) -> tuple[np.ndarray, ...]:
        """
        Return the maps of tangents before and after steps, and that of changes of H_p to p.

        Parameters
        ----------
        states : np.ndarray, shape (2, N, 2 D)
            States before and after N steps, with channels.
        step : callable
            The step of the method; see InnerStep.

        Returns
        -------
        tuple of np.ndarray, shape (N, 2 D, 2 D) twice, (N, d, d) and (N, 2 D)
            The maps, and the starts of the method's steps.

        """
        d, D = self._d, states.shape[2] // 2
        own = np.r_[:d, D:D + d]
        z0, z1 = states[..., own]
        first, last = self._end(z0), self._end(z1)
        multipliers = np.zeros(first.gradient.shape[:2])
        starts, previous = states[0].copy(), np.inf
        for iteration in range(_MAX_ITERATIONS):
            starts[:, D:D + d] = z0[:, d:] - 0.5 * self._h * np.einsum(
                'nki,nk->ni', first.gradient, multipliers)
            ends, tangents = step(starts, iteration == 0)
            if tangents is not None:
                response = tangents[:, :d, D:D + d] @ first.gradient.swapaxes(1, 2)
                matrix = 0.5 * self._h * last.gradient @ response
            error = ends[:, :d] - z1[:, :d]
            size = float(np.abs(error).max(initial=0.0))
            if not size < 0.5 * previous:
                break
            previous = size
            multipliers += np.linalg.solve(matrix, last.gradient @ error[..., None])[..., 0]
        ends, tangents = step(starts, True)
        assert tangents is not None
        if not previous <= _TOLERANCE * max(1.0, float(np.abs(z1[:, :d]).max(initial=0.0))):
            starts[...] = np.nan  # so that its stages are not found
        kick = ends[:, D:D + d] - z1[:, d:]
        normal = last.gradient
        after_multipliers = np.linalg.solve(
            normal @ normal.swapaxes(1, 2), normal @ kick[..., None])[..., 0]
        before = np.tile(np.eye(2 * D), (len(z0), 1, 1))
        closing, after = before.copy(), before.copy()
        before[:, D:D + d, :d] -= 0.5 * self._h * np.einsum(
            'nk,nkij->nij', multipliers, first.curved)
        response = tangents[:, :, D:D + d] @ first.gradient.swapaxes(1, 2)
        closing[:, :, :d] -= response @ np.linalg.solve(normal @ response[:, :d], normal)
        after[:, D:D + d, :d] -= np.einsum('nk,nkij->nij', after_multipliers, last.curved)
        whole = np.tile(np.eye(2 * D), (len(z0), 1, 1))
        whole[np.ix_(np.arange(len(z0)), own, own)] = last.projection
        return before, whole @ after @ closing, last.by_velocity, starts

    def _end(self, z: np.ndarray) -> _End:
        """Return the quantities on the loops for states, shape (N, 2 d)."""
        d = self._d
        q, p = (np.ascontiguousarray(part) for part in np.split(z, 2, axis=-1))
        gradient = self._manifold.gradients(q)
        curved = np.zeros((*gradient.shape, d))
        for j in range(d):
            for offset, (weight, _) in MIDDLE.items():
                curved[..., j] += weight / _SPACING * self._manifold.gradients(
                    q + offset * _SPACING * (np.arange(d) == j))
        inverse = self._hamiltonian.inverse_mass(q, p)
        velocity = self._hamiltonian.gradient(q, p)[1]
        units = np.eye(d)
        turned = np.stack([self._hamiltonian.hessian_vector(
            q, p, np.broadcast_to(unit, q.shape), np.zeros_like(p))[1] for unit in units], axis=-1)
        by_q = np.einsum('nkij,ni->nkj', curved, velocity) + gradient @ turned
        lift = np.linalg.solve(gradient @ inverse @ gradient.swapaxes(1, 2),
                               np.concatenate([by_q, gradient @ inverse, gradient], axis=-1))
        lift = gradient.swapaxes(1, 2) @ lift
        projection = np.tile(np.eye(2 * d), (len(z), 1, 1))
        projection[:, d:] -= lift[..., :2 * d]
        return _End(gradient, curved, projection, -lift[..., 2 * d:])
