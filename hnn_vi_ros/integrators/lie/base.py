# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Common part of the methods on a group."""

from typing import Any

from hnn_vi_ros.integrators.base import Integrator
from hnn_vi_ros.integrators.implicit import ImplicitIntegrator
from hnn_vi_ros.integrators.lie.equations import GroupWork, LieOptions
from hnn_vi_ros.integrators.lie.rotations import RETRACTIONS
import numpy as np


class LieIntegrator(ImplicitIntegrator):
    """
    A variational integrator for rotations and poses, from the discrete Hamilton-Pontryagin action.

    The action is the sum over k of <mu_k, tau^-1(g_k^-1 g_(k+1))> - h H(g_k, mu_k), with a
    retraction tau from angular velocities in the body frame, times h, to rotations. Of a scalar
    coordinate tau is the identity, and the action that of eq. (6). Attitudes are moved by
    multiplication, so that quaternions keep their norm. A body that would turn by 3 rad or more
    in a step fails it.

    Parameters
    ----------
    retraction : str
        ``'cayley'``, or ``'exponential'``.
    solver, max_iterations
        See ImplicitIntegrator.

    Raises
    ------
    ValueError
        An unknown retraction or solver, or less than one iteration.

    References
    ----------
    N. Bou-Rabee, J. Marsden, Hamilton-Pontryagin integrators on Lie groups, part I, Found.
    Comput. Math. 9 (2009).
    M. Kobilarov, J. Marsden, Discrete geometric optimal control on Lie groups, IEEE Trans. Robot.
    27 (2011).

    """

    def __init__(self, retraction: str = 'cayley', solver: str = 'chain',
                 max_iterations: int = 100):
        super().__init__(solver, max_iterations)
        if retraction not in RETRACTIONS:
            raise ValueError(f'retraction = {retraction!r}; valid: {", ".join(RETRACTIONS)}')
        self.retraction = retraction

    def options(self, attempt: int = 0, dimension: int = 1) -> Any:
        """Return the options of an attempt of the chain, and the retraction."""
        return LieOptions(super().options(attempt, dimension), RETRACTIONS[self.retraction])

    def memory(self, n: int, dtype: type = np.float64) -> tuple:
        """Return the workspace of the equation; see Integrator."""
        return (GroupWork.empty(n, dtype),)

    def substep(self) -> Integrator | None:
        """Return this method where it is symmetric, else the leapfrog on the group."""
        if self.solver == 'fixed_point':
            return None
        if self.requirements.symmetric:
            return self
        # Sub-steps of a method that is not symmetric would each conserve a 2-form of their own.
        from hnn_vi_ros.integrators.lie.lie_leapfrog import LieLeapfrog
        return LieLeapfrog(self.retraction)
