# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Motions of systems, mostly not shipped, in plain Python without compilation."""

from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

from benchmarks.systems import orbit, System, system, systems
from helpers import Uncompiled
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.kernels import Kernel
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

_SPACING = 1e-5


class Plain(Hamiltonian):
    """
    A Hamiltonian given by two functions.

    Parameters
    ----------
    energy, gradient : callable
        Functions of q and p, each of shape (d,); the second one returns (H_q, H_p).
    dimension : int
        Number d of coordinates.
    q_unit : str, optional
        Unit of all coordinates.
    separable : bool, optional
        True if H = T(p) + V(q).

    """

    def __init__(self, energy: Callable, gradient: Callable, dimension: int, q_unit: str = 'm',
                 separable: bool = True):
        self._functions = energy, gradient
        self.coordinates = tuple(Coordinate(f'x{i}', q_unit) for i in range(dimension))
        self.separable = separable

    @cached_property
    def kernel(self) -> Kernel:
        """Return the uncompiled functions; second derivatives are finite differences."""
        H, slope = self._functions

        def energy(parameters, q, p):
            return float(H(q, p))

        def gradient(parameters, q, p, dH_dq, dH_dp):
            d = self.dimension
            for a in range(0, q.size, d):
                dH_dq[a:a + d], dH_dp[a:a + d] = slope(q[a:a + d], p[a:a + d])

        def hessian_vector(parameters, q, p, v_q, v_p, product_q, product_p):
            sides = np.empty((2, 2, q.size))
            for side, sign in zip(sides, (1.0, -1.0), strict=True):
                gradient(parameters, q + sign * _SPACING * v_q, p + sign * _SPACING * v_p, *side)
            product_q[:], product_p[:] = (sides[0] - sides[1]) / (2.0 * _SPACING)

        return Kernel(energy, gradient, hessian_vector, (), self.dimension, (0.0, 0.0), False)


class Motion(NamedTuple):
    """A system, an initial state, and its period or another time scale [s]."""

    hamiltonian: Hamiltonian
    q: np.ndarray
    p: np.ndarray
    period: float


def motion_of(system: System) -> Motion:
    """Return the uncompiled motion of a system of the benchmarks."""
    problem, period = system
    return Motion(Uncompiled(problem.hamiltonian), problem.q, problem.p, period)


def kepler(eccentricity: float, end: str) -> Motion:
    """Return an orbit with semi-major axis 1 m about mu = 1 m^3/s^2, starting at an apsis."""
    return motion_of(orbit(eccentricity, end == 'apocentre'))


def pendulum(q: float, p: float, period: float, constant: float = 0.0) -> Motion:
    """Return the motion of H = p^2 / 2 + 1 - cos q plus a constant."""
    return Motion(Plain(lambda q, p: 0.5 * p[0] ** 2 + 2.0 * np.sin(0.5 * q[0]) ** 2 + constant,
                        lambda q, p: (np.sin(q), p), 1, 'rad'), np.array([q]), np.array([p]),
                  period)


def network(seed: int, gain: float, state: tuple[float, float]) -> Motion:
    """Return the motion of a random 2-32-32-1 network in a harmonic well."""
    rng = np.random.default_rng(seed)
    first, bias = gain / np.sqrt(2.0) * rng.normal(size=(32, 2)), 0.1 * rng.normal(size=32)
    second, last = gain / np.sqrt(32.0) * rng.normal(size=(32, 32)), rng.normal(size=32) / 6.0

    def energy(q, p):
        z = np.concatenate([q, p])
        return last @ np.tanh(second @ np.tanh(first @ z + bias)) + 0.5 * z @ z

    def gradient(q, p):
        z = np.concatenate([q, p])
        a = np.tanh(first @ z + bias)
        b = np.tanh(second @ a)
        slope = z + first.T @ ((1.0 - a * a) * (second.T @ ((1.0 - b * b) * last)))
        return slope[:1], slope[1:]

    return Motion(Plain(energy, gradient, 1, separable=False), *np.array(state)[:, None], 8.0)


def double_well(q: float, p: float) -> Motion:
    """Return the motion of H = p^2 / 2 - q^2 / 2 + q^4 / 4, with a saddle at the origin."""
    return motion_of(system('x0^4 / 4 - x0^2 / 2', [q], [p], 20.0))


MEASURED = {name: motion_of(one) for name, one in systems().items() if 'network' not in name}
MOTIONS = MEASURED | {
    'kepler 0.1': kepler(0.1, 'pericentre'),
    'pendulum': pendulum(2.0, 0.0, 8.3),
    'pendulum, plus 1000 J': pendulum(2.0, 0.0, 8.3, 1000.0),
    'pendulum from its saddle': pendulum(3.1, 0.0, 17.0),
    'pendulum around': pendulum(0.0, 3.0, 2.5),
    'network': network(1, 1.0, (1.0, 0.0)),
    'steep network': network(2, 2.0, (0.5, 0.5)),
    'into a saddle': double_well(-0.1, 0.1),
}
