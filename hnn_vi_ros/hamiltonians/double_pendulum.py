# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The plane double pendulum: non-separable, and chaotic unless its energy is low."""

from functools import cached_property

from hnn_vi_ros.hamiltonians.base import compiled_kernel, Hamiltonian
from hnn_vi_ros.hamiltonians.parameters import check_positive
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.kernels.marks import inlined
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class DoublePendulum(Hamiltonian):
    """
    A bob on a massless rod that hangs from the bob of another, H = p . M(q)^-1 p / 2 + V(q).

    Both angles are measured from the vertical, so the momenta are p = M v of the rates v, with

        M = [ (m1 + m2) l1^2           m2 l1 l2 cos(q1 - q2) ]
            [ m2 l1 l2 cos(q1 - q2)    m2 l2^2               ]

        V = (m1 + m2) g l1 (1 - cos q1) + m2 g l2 (1 - cos q2)

    H = 0 where it hangs at rest. With D = m1 + m2 sin(q1 - q2)^2, the inverse gives the rates

        v1 = H_p1 = (l2 p1 - l1 cos(q1 - q2) p2) / (l1^2 l2 D)
        v2 = H_p2 = ((m1 + m2) l1 p2 - m2 l2 cos(q1 - q2) p1) / (m2 l1 l2^2 D)

    and, since the derivative of M^-1 is -M^-1 M' M^-1, with k = m2 l1 l2 sin(q1 - q2) v1 v2,

        H_q1 = (m1 + m2) g l1 sin q1 + k,    H_q2 = m2 g l2 sin q2 - k.

    Parameters
    ----------
    mass1, mass2 : float
        m1, m2 > 0 [kg], of the upper and the lower bob.
    length1, length2 : float
        l1, l2 > 0 [m], of the upper and the lower rod.
    gravity : float
        g > 0 [m/s^2].

    Raises
    ------
    ValueError
        A parameter is not a positive finite number.

    References
    ----------
    L. D. Landau, E. M. Lifshitz, Mechanics, 1976, section 5, problem 1.

    """

    coordinates = (Coordinate('angle1', 'rad', 'kg m2/s'), Coordinate('angle2', 'rad', 'kg m2/s'))
    separable = False

    def __init__(self, mass1: float = 1.0, mass2: float = 1.0, length1: float = 1.0,
                 length2: float = 1.0, gravity: float = 9.81):
        check_positive(mass1=mass1, mass2=mass2, length1=length1, length2=length2,
                       gravity=gravity)
        self.mass1, self.mass2 = float(mass1), float(mass2)
        self.length1, self.length2 = float(length1), float(length2)
        self.gravity = float(gravity)

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions that simulations compile."""
        parameters = (self.mass1, self.mass2, self.length1, self.length2, self.gravity)
        torques = ((self.mass1 + self.mass2) * self.gravity * self.length1,
                   self.mass2 * self.gravity * self.length2)
        return compiled_kernel((_energy, _gradient, _hessian_vector), parameters,
                               self.dimension, (max(torques), 0.0))


@inlined
def _rates(parameters: tuple[float, ...], difference: float, p1: float, p2: float
           ) -> tuple[float, float]:
    """Return H_p for the difference q1 - q2 and the momenta."""
    m1, m2, l1, l2, _ = parameters
    sine, cosine = np.sin(difference), np.cos(difference)
    common = l1 * l2 * (m1 + m2 * sine * sine)
    return ((l2 * p1 - l1 * cosine * p2) / (l1 * common),
            ((m1 + m2) * l1 * p2 - m2 * l2 * cosine * p1) / (m2 * l2 * common))


def _energy(parameters: tuple[float, ...], q: np.ndarray, p: np.ndarray) -> float:
    m1, m2, l1, l2, gravity = parameters
    v1, v2 = _rates(parameters, q[0] - q[1], p[0], p[1])
    # 1 - cos q = 2 sin(q / 2)^2 keeps its digits in small swings.
    half1, half2 = np.sin(0.5 * q[0]), np.sin(0.5 * q[1])
    height1, height2 = 2.0 * l1 * half1 * half1, 2.0 * l2 * half2 * half2
    return (0.5 * (p[0] * v1 + p[1] * v2)
            + gravity * ((m1 + m2) * height1 + m2 * height2))


def _gradient(parameters: tuple[float, ...], q: np.ndarray, p: np.ndarray,
              dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    m1, m2, l1, l2, gravity = parameters
    for i in range(0, q.size, 2):
        v1, v2 = _rates(parameters, q[i] - q[i + 1], p[i], p[i + 1])
        coupling = m2 * l1 * l2 * np.sin(q[i] - q[i + 1]) * v1 * v2
        dH_dq[i] = (m1 + m2) * gravity * l1 * np.sin(q[i]) + coupling
        dH_dq[i + 1] = m2 * gravity * l2 * np.sin(q[i + 1]) - coupling
        dH_dp[i] = v1
        dH_dp[i + 1] = v2


def _hessian_vector(parameters: tuple[float, ...], q: np.ndarray, p: np.ndarray, v_q: np.ndarray,
                    v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
    m1, m2, l1, l2, gravity = parameters
    for i in range(0, q.size, 2):
        p1, p2 = p[i], p[i + 1]
        sine, cosine = np.sin(q[i] - q[i + 1]), np.cos(q[i] - q[i + 1])
        v1, v2 = _rates(parameters, q[i] - q[i + 1], p1, p2)
        # The change of each intermediate result along (v_q, v_p).
        d_sine = cosine * (v_q[i] - v_q[i + 1])
        d_cosine = -sine * (v_q[i] - v_q[i + 1])
        common = l1 * l2 * (m1 + m2 * sine * sine)
        d_common = l1 * l2 * 2.0 * m2 * sine * d_sine
        top1 = l2 * v_p[i] - l1 * (d_cosine * p2 + cosine * v_p[i + 1])
        top2 = (m1 + m2) * l1 * v_p[i + 1] - m2 * l2 * (d_cosine * p1 + cosine * v_p[i])
        d_v1 = (top1 / l1 - d_common * v1) / common
        d_v2 = (top2 / (m2 * l2) - d_common * v2) / common
        d_coupling = m2 * l1 * l2 * (d_sine * v1 * v2 + sine * (d_v1 * v2 + v1 * d_v2))
        product_q[i] = (m1 + m2) * gravity * l1 * np.cos(q[i]) * v_q[i] + d_coupling
        product_q[i + 1] = m2 * gravity * l2 * np.cos(q[i + 1]) * v_q[i + 1] - d_coupling
        product_p[i] = d_v1
        product_p[i + 1] = d_v2
