# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Error of a learned energy relative to the true one, over a box, with confidence interval."""

from collections.abc import Sequence
from typing import Annotated, Literal

from hnn_vi_ros.files import StrictModel
import numpy as np
from pydantic import Field

_RESAMPLES = 1000
_LEVEL = 95.0  # per cent
# With fewer blocks, the variation between blocks is too uncertain.
_MIN_BLOCKS = 10

Interval = Annotated[list[float], Field(min_length=2, max_length=2)]
Reference = Literal['true energy', 'mean along each trajectory', 'work of forces and friction',
                    'work of fitted friction']


class EnergyError(StrictModel):
    """Error of H at states of the box, up to a constant, with 95 % bootstrap intervals."""

    against: Reference = Field(description=(
        'reference for H: the H of the exact system; or, if that is unknown, its expected value '
        'along each motion of the data: constant, or changed by the work of the forces and of '
        'the friction of the model, or of friction fitted to it'))
    rms: float = Field(ge=0.0, description='root mean square [J]')
    rms_interval: Interval | None = Field(None, description=(
        'none if the errors of too few blocks of time are independent'))
    sup: float = Field(ge=0.0, description='largest error [J]')
    sup_interval: Interval | None = Field(None, description=(
        'no longer computed: no resampling tells how much larger errors of other states are'))
    spread: float = Field(ge=0.0, description='standard deviation of the reference [J]')
    states: int = Field(gt=0, description='number of states')
    friction_power: float | None = Field(None, ge=0.0, description=(
        'mean power of the fitted friction [W]'))

    @property
    def compared_with(self) -> str:
        """Return a description of the reference for H."""
        if self.friction_power is None:
            return self.against
        return f'{self.against}, {self.friction_power:.3g} W on average'


def interval_text(interval: list[float] | None) -> str:
    """Return a description of an interval."""
    if interval is None:
        return 'no interval: too few errors are independent'
    return f'95 %: {interval[0]:.2g} to {interval[1]:.2g}'


def energy_error(learned: np.ndarray, true: np.ndarray, seed: int) -> EnergyError:
    """
    Compare energies with true ones, up to a constant, the mean of the difference.

    Parameters
    ----------
    learned, true : np.ndarray, shape (n,)
        Energies of the same independent states [J].
    seed : int
        Seed of the resampling.

    """
    rng, errors = np.random.default_rng(seed), learned - true
    estimates = np.array([np.std(errors[rng.integers(0, len(errors), len(errors))])
                          for _ in range(_RESAMPLES)])
    return _error(errors - errors.mean(), estimates, 'true energy', float(np.std(true)))


def energy_spread(learned: np.ndarray, trajectory: np.ndarray, seed: int,
                  work: np.ndarray | None = None,
                  against: Reference = 'mean along each trajectory') -> EnergyError:
    """
    Compare energies with their expected time course along each trajectory, up to a constant.

    Parameters
    ----------
    learned : np.ndarray, shape (n,)
        Energies of states [J], in the order of time within each trajectory.
    trajectory : np.ndarray of int, shape (n,)
        Trajectory of each state.
    seed : int
        Seed of the resampling of blocks of time.
    work : np.ndarray, shape (n,), optional
        Work done on the system up to each state [J]; by default 0, for conserved energy.
    against : str
        Source of the work; see EnergyError.

    References
    ----------
    H. R. Künsch, The jackknife and the bootstrap for general stationary observations, Annals of
    Statistics 17 (1989).

    """
    work = np.zeros(len(learned)) if work is None else work
    pieces = rows_of_each(trajectory)
    errors, reference = learned - work, work.copy()
    for rows in pieces:
        mean = errors[rows].mean()
        errors[rows] -= mean
        reference[rows] += mean
    squares = errors**2
    # The RMS has the same uncertainty as the mean of the squares: if the size of errors is
    # constant within a motion, there are few independent values, whatever the signs.
    length = max(_correlation([errors[rows] for rows in pieces]),
                 _correlation([squares[rows] - squares.mean() for rows in pieces]))
    blocks = [rows[i:i + length] for rows in pieces for i in range(0, len(rows), length)]
    estimates = None
    if len(blocks) >= _MIN_BLOCKS:
        drawn = np.random.default_rng(seed).integers(0, len(blocks), (_RESAMPLES, len(blocks)))
        sums, sizes = (np.array([function(squares[rows]) for rows in blocks])
                       for function in (np.sum, len))
        estimates = np.sqrt(sums[drawn].sum(axis=1) / sizes[drawn].sum(axis=1))
    return _error(errors, estimates, against, float(np.std(reference)))


def rows_of_each(trajectory: np.ndarray) -> list[np.ndarray]:
    """Return the rows of each trajectory, in their order."""
    order = np.argsort(trajectory, kind='stable')
    return np.split(order, np.flatnonzero(np.diff(trajectory[order])) + 1)


def _correlation(pieces: Sequence[np.ndarray]) -> int:
    """
    Return the correlation length of a series in samples, at least 1.

    It is 1 + 2 sum_k rho_k, up to the first correlation rho_k that is not positive.
    """
    longest = max(map(len, pieces))
    products, counts = np.zeros(longest), np.zeros(longest)
    for piece in pieces:
        n = len(piece)
        products[:n] += np.fft.irfft(np.abs(np.fft.rfft(piece, 2 * n))**2, 2 * n)[:n]
        counts[:n] += n - np.arange(n)
    if not products[0] > 0.0:
        return 1
    correlation = products / counts / (products[0] / counts[0])
    end = int(np.argmax(np.append(correlation, 0.0) <= 0.0))
    return max(1, round(1.0 + 2.0 * float(correlation[1:end].sum())))


def _error(errors: np.ndarray, estimates: np.ndarray | None, against: Reference, spread: float
           ) -> EnergyError:
    """Return statistics of errors, with the interval of the RMS, from resamplings (m,)."""
    found = EnergyError(
        against=against, rms=float(np.sqrt(np.mean(errors**2))), sup=float(np.abs(errors).max()),
        spread=spread, states=len(errors))
    if estimates is None:
        return found
    low, high = np.percentile(estimates, [50.0 - _LEVEL / 2.0, 50.0 + _LEVEL / 2.0]).tolist()
    # An interval of zero width contains no information about the variation.
    return found.model_copy(update={'rms_interval': [low, high] if low < high else None})
