# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The measures of the published tables, as the papers' public code defines them, and ours."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from studies.published_data import NOISE, Orbits, Plane
from studies.published_models import Model

# Learned orbits are solved with this method at steps of at most this much [s]: their energy
# errors come from the model, not from the steps.
METHOD, STEP = 'gauss6', 0.06
# A sample of all orbits that could have been drawn, for the least possible loss; its seed is in no
# table.
_PRIOR_ORBITS, _PRIOR_SEED = 1500, 20_000_001
_CHUNK = 100


class TrueSystem(Protocol):
    """True system as the measures need it; see published_data."""

    def follow(self, starts: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Return the true orbits."""

    def energy(self, z: np.ndarray) -> np.ndarray:
        """Return the true H."""

    def published_energy(self, z: np.ndarray) -> np.ndarray:
        """Return the energy as the public code defines it."""


@dataclass(frozen=True)
class OrbitErrors:
    """
    Distances of simulated orbits from the true ones, over all instants and orbits.

    Parameters
    ----------
    published_energy : float
        Mean squared difference of the published energy, at the same instant.
    energy : float
        Mean squared difference of the true H.
    path : float
        Root mean square distance of the states.

    """

    published_energy: float
    energy: float
    path: float

    def items(self) -> Iterator[tuple[str, float]]:
        """Yield the names of the tables and the values."""
        yield 'published energy MSE', self.published_energy
        yield 'true energy MSE', self.energy
        yield 'path error', self.path


def published_loss(model: Model, orbits: Orbits) -> float:
    """
    Return the published test loss: the mean squared error of the field at the noisy states.

    The rates that it is compared with are those at the true states, so the noise on the states
    stays in the loss even where the field is exact.
    """
    return float(np.mean((model.field(orbits.noisy) - orbits.rates) ** 2))


def field_error(model: Model, orbits: Orbits) -> float:
    """Return the mean squared error of the field where it is meant to hold: without noise."""
    return float(np.mean((model.field(orbits.clean) - orbits.rates) ** 2))


def exact_loss(plane: Plane, orbits: Orbits) -> float:
    """Return the published test loss of the true H."""
    return float(np.mean((plane.rates(orbits.noisy) - orbits.rates) ** 2))


def least_loss(plane: Plane, orbits: Orbits) -> float:
    """
    Return the published test loss of the best function of a noisy state, E[rate | state].

    A noisy state says less than the true one, and the mean of the rates at all true states that
    it may come from, weighted by how probable each is, errs least. Without knowledge of the
    system no training can be expected to come below it. The mean is over the states of 1500
    orbits that are drawn as the data is.
    """
    drawn = plane.orbits(np.random.RandomState(_PRIOR_SEED), float(orbits.t[-1]),
                         len(orbits.t), _PRIOR_ORBITS)
    true, rates = drawn.clean.reshape(-1, 2), drawn.rates.reshape(-1, 2)
    noisy, wanted = orbits.noisy.reshape(-1, 2), orbits.rates.reshape(-1, 2)
    squares = 0.0
    for first in range(0, len(noisy), _CHUNK):
        part = slice(first, first + _CHUNK)
        distances = ((noisy[part, None] - true) ** 2).sum(axis=-1)
        # Less the smallest, so that a state far from all others still has weights.
        distances -= distances.min(axis=1, keepdims=True)
        weights = np.exp(-0.5 * distances / NOISE ** 2)
        best = weights @ rates / weights.sum(axis=1, keepdims=True)
        squares += ((best - wanted[part]) ** 2).sum()
    return float(squares / wanted.size)


def orbit_errors(system: TrueSystem, model: Model, starts: np.ndarray, t: np.ndarray,
                 method: str = METHOD, longest: float = STEP) -> OrbitErrors:
    """
    Simulate a learned model and compare with the true orbits.

    Parameters
    ----------
    system : TrueSystem
        The true one.
    model : Model
        The learned one.
    starts : np.ndarray, shape (m, 2 d)
        Initial states of both.
    t : np.ndarray, shape (n,)
        Instants at which they are compared, evenly spaced from 0 [s].
    method, longest : str, float
        Our method, and a bound of its step size [s].

    """
    true = system.follow(starts, t)
    found = model.follow(starts, float(t[1]), len(t), method, longest)

    def mean_square(energy: Callable[[np.ndarray], np.ndarray]) -> float:
        return float(np.mean((energy(found) - energy(true)) ** 2))

    distance = np.mean(((found - true) ** 2).sum(axis=-1))
    return OrbitErrors(mean_square(system.published_energy), mean_square(system.energy),
                       float(np.sqrt(distance)))
