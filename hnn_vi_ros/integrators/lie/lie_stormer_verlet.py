# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Explicit Störmer-Verlet on a group: kicks, and the exact motion of free bodies between them."""

from typing import NamedTuple

from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators.arithmetic import plus
from hnn_vi_ros.integrators.base import Integrator, OK, PhasePoint, Requirements, TURNED
from hnn_vi_ros.integrators.lie.equations import (
    fill_forces, FURTHEST, FURTHEST_CAYLEY, move, turns_beyond)
from hnn_vi_ros.integrators.lie.rotations import cayley, dot
from hnn_vi_ros.kernels import called, inlined, Kernel
import numpy as np


class FlightWork(NamedTuple):
    """
    Workspace of a step; all arrays but the last have shape (n,).

    Parameters
    ----------
    forces : np.ndarray
        g^* H_g.
    change : np.ndarray
        Momenta of 1, at which H_p is the inverse moments of inertia; then the changes of the
        momenta of freely rotating bodies.
    x : np.ndarray
        The changes of coordinates; for rotations in the chart of the Cayley map.
    quaternion : np.ndarray, shape (4,)
        Rotation of one body.

    """

    forces: np.ndarray
    change: np.ndarray
    x: np.ndarray
    quaternion: np.ndarray


class LieStormerVerlet(Integrator):
    """
    Störmer-Verlet (leapfrog) for H = T(p) + V(g), with bodies in frames of principal axes.

        p_half = p_n - (h/2) g_n^* V_g,  (g_(n+1), p_free) = the motion by T for h,
        p_(n+1) = p_free - (h/2) g_(n+1)^* V_g

    A body with two equal moments of inertia moves by T exactly: it rotates about its spatial
    angular momentum and its axis. With three different moments, T is split into a body with the
    middle moment for all axes, which commutes with the rest, and the differences of the other two,
    in three rotations: one of half a step, one of a step, one of half a step.

    Symplectic, symmetric, order 2; for accuracy use it in `kahan_li8`. Spatial momentum is
    kept if V is independent of the attitude. A rotation of 3 rad or more in a step fails.

    References
    ----------
    A. Dullweber, B. Leimkuhler, R. McLachlan, Symplectic splitting methods for rigid body
    molecular dynamics, J. Chem. Phys. 107 (1997).
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section VII.5.

    """

    order, explicit, fallback = 2, True, 'lie_stormer_verlet'
    requirements = Requirements(symmetric=True, symplectic=True, separable=True,
                                coordinates='group')

    def refusal(self, hamiltonian: Hamiltonian) -> str:
        """Refuse bodies whose frames are not principal axes."""
        if problem := super().refusal(hamiltonian):
            return problem
        start = 0
        for coordinate in hamiltonian.coordinates:
            width = {'scalar': 1, 'rotation': 3, 'pose': 6}[coordinate.kind]
            start += width
            if width > 1 and not _has_principal_axes(hamiltonian, slice(start - 3, start)):
                return ('needs body frames along principal axes, but that of '
                        f'{coordinate.name} is not')
        return ''

    def memory(self, n: int, dtype: type = np.float64) -> tuple:
        """Return the workspace of a step."""
        return (FlightWork(np.zeros(n, dtype), np.zeros(n, dtype), np.zeros(n, dtype),
                           np.zeros(4, dtype)),)

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: tuple, z: PhasePoint, z1: PhasePoint,
             memory: tuple) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        work = memory[0]
        # V' does not depend on p: z.dH_dq is V'(q_n) of the previous step.
        _kick(kernel, 0.5 * h, z.q, z.dH_dq, z, z1, work.forces)
        kernel.gradient(kernel.parameters, z.q, z1.p, z1.dH_dq, z1.dH_dp)
        # The momenta are the same; but the power of a force, in a channel, depends on p.
        _kick(kernel, 0.5 * h, z.q, z1.dH_dq, z, z1, work.forces)
        for i in range(z.q.size):
            work.x[i], work.change[i] = h * z1.dH_dp[i], 1.0
        if turns_beyond(kernel, work.x, FURTHEST):
            return TURNED, np.inf, 1
        kernel.gradient(kernel.parameters, z.q, work.change, z1.dH_dq, z1.dH_dp)
        _fly(kernel, h, z1.p, z1.dH_dp, work)
        if turns_beyond(kernel, work.x, FURTHEST_CAYLEY):
            return TURNED, np.inf, 2
        move(kernel, cayley, z, work.x, z1)
        for i in range(z.q.size):
            z1.p[i], z1.p_carry[i] = plus(z1.p[i], z1.p_carry[i], work.change[i])
        kernel.gradient(kernel.parameters, z1.q, z1.p, z1.dH_dq, z1.dH_dp)
        _kick(kernel, 0.5 * h, z1.q, z1.dH_dq, z1, z1, work.forces)
        return OK, 0.0, 3


def _has_principal_axes(hamiltonian: Hamiltonian, columns: slice) -> bool:
    """Return True if angular momenta in these columns of p rotate a body about its own axes."""
    d, turning = hamiltonian.dimension, hamiltonian.rotations
    q, p = np.zeros((3, d)), np.zeros((3, d - len(turning)))
    q[:, [at + 3 for at in turning]] = 1.0
    p[:, columns] = np.eye(3)
    inverse = hamiltonian.gradient(q, p)[1][:, columns]
    return bool((inverse == np.diag(np.diag(inverse))).all())


@called
def _kick(kernel: Kernel, h: float, q: np.ndarray, dH_dq: np.ndarray, z: PhasePoint,
          z1: PhasePoint, forces: np.ndarray) -> None:
    """Fill the momenta of z1 with the momenta of z minus h g^* H_g."""
    fill_forces(kernel, q, dH_dq, forces)
    for i in range(forces.size):
        z1.p[i], z1.p_carry[i] = plus(z.p[i], z.p_carry[i], -h * forces[i])


@called
def _fly(kernel: Kernel, h: float, p: np.ndarray, moments: np.ndarray, work: FlightWork) -> None:
    """Fill ``x`` and ``change`` with the free motion of bodies over h."""
    quaternion = work.quaternion
    for i in range(p.size):
        work.change[i] = 0.0
    for start in range(0, p.size, kernel.dimension):
        for k in range(len(kernel.rotations)):
            at = start + kernel.rotations[k] - k
            # The differences to the middle moment of inertia are smallest.
            middle, first, second = _axes(moments, at)
            rate = moments[at + middle]
            size = np.sqrt(dot(p, p, at))
            half = 0.5 * h * rate
            share = np.sin(half * size) / size if size > 0.0 else half
            for i in range(3):
                quaternion[i] = share * p[at + i]
            quaternion[3] = np.cos(half * size)
            one, other = moments[at + first] - rate, moments[at + second] - rate
            if one != 0.0:
                _turn_about(first, 0.5 * h * one, p, at, work)
            _turn_about(second, h * other, p, at, work)
            if one != 0.0:
                _turn_about(first, 0.5 * h * one, p, at, work)
            for i in range(3):
                work.x[at + i] = 2.0 * quaternion[i] / quaternion[3]


@inlined
def _axes(moments: np.ndarray, at: int) -> tuple[int, int, int]:
    """Return the axis of the middle moment of inertia, then the axis with the closest moment."""
    middle = 0
    for i in range(2, -1, -1):
        own = moments[at + i]
        if (own - moments[at + (i + 1) % 3]) * (own - moments[at + (i + 2) % 3]) <= 0.0:
            middle = i
    first, second = (middle + 1) % 3, (middle + 2) % 3
    if abs(moments[at + first] - moments[at + middle]) > abs(
            moments[at + second] - moments[at + middle]):
        return middle, second, first
    return middle, first, second


@inlined
def _turn_about(axis: int, factor: float, p: np.ndarray, at: int, work: FlightWork) -> None:
    """Rotate a body about one of its axes by its momentum there times a factor."""
    change, quaternion = work.change, work.quaternion
    b, d = (axis + 1) % 3, (axis + 2) % 3
    half = 0.5 * factor * (p[at + axis] + change[at + axis])
    s, c = np.sin(half), np.cos(half)
    sine, less_one = 2.0 * s * c, -2.0 * s * s
    # In the frame of the body, momenta rotate in the opposite direction.
    m_b, m_d = p[at + b] + change[at + b], p[at + d] + change[at + d]
    change[at + b] += less_one * m_b + sine * m_d
    change[at + d] += less_one * m_d - sine * m_b
    v_b, v_d, along, w = quaternion[b], quaternion[d], quaternion[axis], quaternion[3]
    quaternion[b], quaternion[d] = c * v_b + s * v_d, c * v_d - s * v_b
    quaternion[axis], quaternion[3] = c * along + s * w, c * w - s * along
