# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The planar double pendulum: non-separable, and chaotic unless its energy is low."""


from hnn_vi_ros.hamiltonians.parameters import check_positive
from hnn_vi_ros.hamiltonians.straight_code import AnalyticHamiltonian
from hnn_vi_ros.phase_space import Coordinate


class DoublePendulum(AnalyticHamiltonian):
    """
    A bob on a massless rod that hangs from the bob of another, H = p . M(q)^-1 p / 2 + V(q).

    Both angles are measured from the vertical, so the momenta of the rates v are p = M v, with

        M = [ (m1 + m2) l1^2           m2 l1 l2 cos(q1 - q2) ]
            [ m2 l1 l2 cos(q1 - q2)    m2 l2^2               ]

        V = (m1 + m2) g l1 (1 - cos q1) + m2 g l2 (1 - cos q2)

    H = 0 in the hanging rest position. In terms of momenta, with D = m1 + m2 sin(q1 - q2)^2,

        T = (p1 / l1 - cos(q1 - q2) p2 / l2)^2 / (2 D) + p2^2 / (2 m2 l2^2).

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
    names = ('q1', 'q2')
    formula = ('(p1 / l1 - cos(q1 - q2) * p2 / l2)^2 / (2 * (m1 + m2 * sin(q1 - q2)^2))'
               '+ p2^2 / (2 * m2 * l2^2)'
               '+ (m1 + m2) * g * l1 * (1 - cos(q1)) + m2 * g * l2 * (1 - cos(q2))')

    def __init__(self, mass1: float = 1.0, mass2: float = 1.0, length1: float = 1.0,
                 length2: float = 1.0, gravity: float = 9.81):
        check_positive(mass1=mass1, mass2=mass2, length1=length1, length2=length2, gravity=gravity)
        self.mass1, self.mass2 = float(mass1), float(mass2)
        self.length1, self.length2 = float(length1), float(length2)
        self.gravity = float(gravity)
        self.constants = {'m1': self.mass1, 'm2': self.mass2, 'l1': self.length1,
                          'l2': self.length2, 'g': self.gravity}
