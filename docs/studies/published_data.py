# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
The data sets of the published tables, drawn again as in the papers' public code.

Random numbers come from numpy's legacy generator, in the order of the published code, so that a
seed gives the very states and noise that the published numbers were measured on.
"""

from collections.abc import Callable
from dataclasses import dataclass

from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.hamiltonians.harmonic_oscillator import HarmonicOscillator
from hnn_vi_ros.hamiltonians.pendulum import Pendulum
import numpy as np
from scipy.integrate import solve_ivp

NOISE = 0.1
ORBITS = 50
TWO_BODY_ORBITS = 1000
_TOLERANCE = 1e-12


@dataclass(frozen=True)
class Orbits:
    """
    Sampled orbits of one system.

    Parameters
    ----------
    t : np.ndarray, shape (n,)
        Instants [s].
    clean, noisy : np.ndarray, shape (m, n, 2 d)
        States (q, p) of m orbits: the true and the measured ones.
    rates : np.ndarray, shape (m, n, 2 d)
        (dq/dt, dp/dt) at the true states.

    """

    t: np.ndarray
    clean: np.ndarray
    noisy: np.ndarray
    rates: np.ndarray

    def part(self, chosen: slice) -> 'Orbits':
        """Return some of the orbits."""
        return Orbits(self.t, self.clean[chosen], self.noisy[chosen], self.rates[chosen])

    def halves(self) -> tuple['Orbits', 'Orbits']:
        """Return the first half of the orbits, to learn from, and the second, to test with."""
        half = len(self.clean) // 2
        return self.part(slice(0, half)), self.part(slice(half, None))


@dataclass(frozen=True)
class Plane:
    """
    A system of one degree of freedom whose orbits begin on rings around (0, 0).

    Parameters
    ----------
    hamiltonian : Hamiltonian
        The true H.
    radii : tuple of float
        Bounds of the length of (q, p) at the start, drawn evenly.
    rate : float
        Samples a second in the table of the original HNN.

    """

    hamiltonian: Hamiltonian
    radii: tuple[float, float]
    rate: float

    def orbits(self, random: np.random.RandomState, duration: float, samples: int,
               count: int = ORBITS) -> Orbits:
        """Draw orbits with `samples` states over a duration [s], with noise on every state."""
        starts, noise = np.empty((count, 2)), np.empty((count, samples, 2))
        low, high = self.radii
        for i in range(count):
            direction = 2.0 * random.rand(2) - 1.0
            radius = (high - low) * random.rand() + low
            starts[i] = radius * direction / np.sqrt(direction @ direction)
            noise[i, :, 0], noise[i, :, 1] = random.randn(samples), random.randn(samples)
        t = np.linspace(0.0, duration, samples)
        clean = self.follow(starts, t)
        return Orbits(t, clean, clean + NOISE * noise, self.rates(clean))

    def starts(self, random: np.random.RandomState, count: int) -> np.ndarray:
        """Draw initial states, (count, 2), for the energy: 0.2 to 1 from zero in q and p."""
        states = 1.6 * random.rand(count, 2) - 0.8
        return states + 0.2 * np.sign(states)

    def follow(self, starts: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Return the true orbits, shape (m, n, 2), from initial states of shape (m, 2)."""
        return follow(self.rates, starts, t)

    def rates(self, z: np.ndarray) -> np.ndarray:
        """Return the true (dq/dt, dp/dt) at states of shape (..., 2)."""
        dH_dq, dH_dp = self.hamiltonian.gradient(z[..., :1], z[..., 1:])
        return np.concatenate([dH_dp, -dH_dq], axis=-1)

    def energy(self, z: np.ndarray) -> np.ndarray:
        """Return the true H of states (..., 2)."""
        return self.hamiltonian.energy(z[..., :1], z[..., 1:])

    def published_energy(self, z: np.ndarray) -> np.ndarray:
        """Return q^2 + p^2, the energy of both systems in the public code."""
        return (z * z).sum(axis=-1)


class TwoBody:
    """
    Two bodies of 1 kg, G = 1, opposite each other on nearly circular orbits in a plane.

    A state is (x1, x2, y1, y2) and the velocities in the same order, which are the momenta.
    """

    def orbits(self, random: np.random.RandomState, duration: float, samples: int,
               count: int = TWO_BODY_ORBITS) -> Orbits:
        """Draw orbits with `samples` states over a duration [s], without noise."""
        t = np.linspace(0.0, duration, samples)
        clean = self.follow(self.starts(random, count), t)
        return Orbits(t, clean, clean, self.rates(clean))

    def starts(self, random: np.random.RandomState, count: int) -> np.ndarray:
        """Draw initial states, (count, 8): the circular speed, but for 5 % of scatter."""
        return np.array([self.start(random) for _ in range(count)])

    def start(self, random: np.random.RandomState) -> np.ndarray:
        """Draw one initial state, shape (8,)."""
        x, y = random.rand(2) + 0.5
        speed = (1.0 + 0.05 * random.randn()) / (2.0 * np.hypot(x, y) ** 1.5)
        return np.array([x, -x, y, -y, -y * speed, y * speed, x * speed, -x * speed])

    def follow(self, starts: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Return the true orbits, shape (m, n, 8), from initial states of shape (m, 8)."""
        return follow(self.rates, starts, t)

    def rates(self, z: np.ndarray) -> np.ndarray:
        """Return the true (dq/dt, dp/dt) at states of shape (..., 8)."""
        pull = self._displacement(z)
        pull = pull / (pull * pull).sum(axis=-1, keepdims=True) ** 1.5
        return np.stack([*np.moveaxis(z[..., 4:], -1, 0), pull[..., 0], -pull[..., 0],
                         pull[..., 1], -pull[..., 1]], axis=-1)

    def energy(self, z: np.ndarray) -> np.ndarray:
        """Return the true H of states (..., 8)."""
        kinetic = 0.5 * (z[..., 4:] ** 2).sum(axis=-1)
        return kinetic - 1.0 / np.linalg.norm(self._displacement(z), axis=-1)

    published_energy = energy

    @staticmethod
    def _displacement(z: np.ndarray) -> np.ndarray:
        """Return the way from the first body to the second."""
        return z[..., [1, 3]] - z[..., [0, 2]]


# H = q^2 + p^2 and H = 3 (1 - cos q) + p^2.
SPRING = Plane(HarmonicOscillator(mass=0.5, stiffness=2.0), (0.1, 1.0), 10.0)
PENDULUM = Plane(Pendulum(mass=0.5, length=1.0, gravity=6.0), (1.3, 2.3), 15.0)
TWO_BODY = TwoBody()


def follow(rates: Callable[[np.ndarray], np.ndarray], starts: np.ndarray, t: np.ndarray
           ) -> np.ndarray:
    """
    Return true orbits, by a method that is not ours.

    Parameters
    ----------
    rates : callable
        The true (dq/dt, dp/dt) at states of shape (m, 2 d).
    starts : np.ndarray, shape (m, 2 d)
        Initial states (q, p).
    t : np.ndarray, shape (n,)
        Instants from 0 on [s].

    Returns
    -------
    np.ndarray, shape (m, n, 2 d)
        The states; the first are ``starts``.

    """
    shape = starts.shape
    path = solve_ivp(lambda _, z: rates(z.reshape(shape)).ravel(), (t[0], t[-1]), starts.ravel(),
                     method='DOP853', t_eval=t, rtol=_TOLERANCE, atol=_TOLERANCE)
    return path.y.reshape(*shape, len(t)).transpose(0, 2, 1)
