# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The adaptive Dormand-Prince method of order 8 of scipy, a control."""

from typing import NamedTuple

from hnn_vi_ros.integrators.base import ENDLESS, Integrator, OK, Point
from hnn_vi_ros.integrators.requirements import Requirements
from hnn_vi_ros.kernels.kernel import Kernel
import numpy as np


class Tolerances(NamedTuple):
    """Relative and absolute error that an adaptive step may make."""

    relative: float
    absolute: float


class DOP853(Integrator):
    """
    scipy's DOP853: over each step h it takes as many steps of its own as its tolerances ask for.

    Neither symplectic nor symmetric; of order 8 in its own steps.

    Parameters
    ----------
    relative_tolerance, absolute_tolerance : float
        As scipy's rtol [1] and atol [units of q and p].

    Raises
    ------
    ValueError
        A tolerance that is not positive.

    References
    ----------
    E. Hairer, S. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, section II.5.

    """

    order, explicit = 8, True
    requirements = Requirements(symmetric=False, symplectic=False, coordinates='any')
    compiled = False

    def __init__(self, relative_tolerance: float = 1e-9, absolute_tolerance: float = 1e-12):
        for name, value in (('relative', relative_tolerance), ('absolute', absolute_tolerance)):
            if not value > 0.0:
                raise ValueError(f'{name}_tolerance = {value} must be positive')
        self._tolerances = Tolerances(relative_tolerance, absolute_tolerance)

    def options(self, attempt: int = 0, dimension: int = 1) -> Tolerances:
        """Return the tolerances."""
        return self._tolerances

    @staticmethod
    def step(kernel: Kernel, h: float, options: Tolerances, z: Point, z1: Point,
             memory: tuple) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        # Imported here: no other method needs scipy to start.
        from scipy.integrate import solve_ivp
        n = z.q.size
        dH_dq, dH_dp = np.empty(n), np.empty(n)

        def field(t: float, y: np.ndarray) -> np.ndarray:
            kernel.gradient(kernel.parameters, y[:n], y[n:], dH_dq, dH_dp)
            return np.concatenate([dH_dp, -dH_dq])

        solution = solve_ivp(field, (0.0, h), np.concatenate([z.q, z.p]), method='DOP853',
                             rtol=max(options.relative, 3e-14), atol=options.absolute)
        if not solution.success:
            return ENDLESS, np.inf, solution.nfev
        z1.q[:], z1.p[:] = solution.y[:n, -1], solution.y[n:, -1]
        return OK, 0.0, solution.nfev
