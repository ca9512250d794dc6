# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
The real pendulum of the published tables, a measured log that we may not ship.

M. Schmidt and H. Lipson, Distilling Free-Form Natural Laws from Experimental Data, Science 324
(2009), supplement: trial, t [s], angle q [rad] and angular velocity v [rad/s], at 6 Hz, with some
instants left out.
"""

from dataclasses import dataclass
from pathlib import Path

from hnn_vi_ros.errors import DataError
import numpy as np
from studies.published_data import Orbits
from studies.published_models import Model

FILE = 'real_pend_h_1.txt'
INTERVAL = 1.0 / 6.0
TRAIN_SHARE = 0.8
# The published energy is 2.4 (1 - cos q) + v^2; the number was fitted to the log.
_STRENGTH = 2.4


@dataclass(frozen=True)
class Swing:
    """
    Rest of the log for the test: instants t, shape (n,) [s], and states, shape (n, 2).

    Parameters
    ----------
    t, z : np.ndarray
        Instants and states (q, v).

    """

    t: np.ndarray
    z: np.ndarray

    def energy_error(self, model: Model, method: str) -> float:
        """
        Return the published measure: the mean squared difference of the energies.

        The model swings on from the first state of the test; what it is compared with is the
        log, so the noise of the log stays in the measure however good the model is.
        """
        path = self._swing_on(model, method)
        return float(np.mean((published_energy(path) - published_energy(self.z)) ** 2))

    def path_error(self, model: Model, method: str) -> float:
        """Return the root mean square distance of the states from the log."""
        return float(np.sqrt(np.mean(((self._swing_on(model, method) - self.z) ** 2).sum(axis=1))))

    def _swing_on(self, model: Model, method: str) -> np.ndarray:
        numbers = np.round((self.t - self.t[0]) / INTERVAL).astype(int)
        return model.follow(self.z[:1], INTERVAL, numbers[-1] + 1, method, INTERVAL)[0, numbers]

    def least_error(self) -> float:
        """Return the error of the best parabola in time, fitted to the test data."""
        energy = published_energy(self.z)
        return float(np.mean((np.polyval(np.polyfit(self.t, energy, 2), self.t) - energy) ** 2))


def published_energy(z: np.ndarray) -> np.ndarray:
    """Return 2.4 (1 - cos q) + v^2 for states (q, v) of shape (..., 2)."""
    return _STRENGTH * (1.0 - np.cos(z[..., 0])) + z[..., 1] ** 2


def read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the instants, shape (N,) [s], and the states (q, v), shape (N, 2), of the log.

    Raises
    ------
    DataError
        The file is not there or holds something else.

    """
    try:
        table = np.loadtxt(path, comments='%', ndmin=2)
    except (OSError, ValueError) as problem:
        raise DataError(f'{path}: cannot be read as the log of the real pendulum '
                        f'({" ".join(str(problem).split())}); see --data') from problem
    if table.shape[0] < 100 or table.shape[1] != 4:
        raise DataError(f'{path}: has {table.shape[0]} rows of {table.shape[1]} numbers, expected '
                        'hundreds of trial, t, angle, velocity; see --data')
    return table[:, 1], table[:, 2:]


def split_for_dgnet(t: np.ndarray, z: np.ndarray) -> tuple[Orbits, Swing]:
    """Return the training and the test data as Matsubara et al. split them."""
    # The last instant has no difference to the next.
    t, z = t[:-1], z[:-1]
    count, tested = int(TRAIN_SHARE * len(t)), int((1.0 - TRAIN_SHARE) * len(t))
    test = slice(count, count + tested)
    return _orbit(t[:count], z[:count], np.zeros((count, 2))), Swing(t[test], z[test])


def split_for_dissipative_hnn(t: np.ndarray, z: np.ndarray) -> tuple[Orbits, Swing]:
    """Return the training and the test data as Sosanya and Greydanus split them."""
    rates = np.diff(z, axis=0) / np.diff(t)[:, None]
    # At an instant the mean of the slopes before and after it; the last one has but one.
    rates[:-1] = 0.5 * (rates[:-1] + rates[1:])
    count = int(TRAIN_SHARE * len(t))
    t, z = t[1:], z[1:]
    return _orbit(t[:count], z[:count], rates[:count]), Swing(t[count:], z[count:])


def _orbit(t: np.ndarray, z: np.ndarray, rates: np.ndarray) -> Orbits:
    return Orbits(t, z[None], z[None], rates[None])
