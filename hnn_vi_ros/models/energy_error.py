# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""How far a learned energy is from the true one, over a box, and how well that is known."""

from typing import Annotated, Literal

from hnn_vi_ros.files.yaml_file import StrictModel
import numpy as np
from pydantic import Field

_RESAMPLES = 1000
_LEVEL = 95.0  # per cent

Interval = Annotated[list[float], Field(min_length=2, max_length=2)]


class EnergyError(StrictModel):
    """Error of H at states of the box, up to a constant, with 95 % bootstrap intervals."""

    against: Literal['true energy', 'mean along each trajectory'] = Field(description=(
        'what H is compared with: the H of the exact system; or, where that is not known, the '
        'constant that it should be along each motion of the data'))
    rms: float = Field(ge=0.0, description='root mean square [J]')
    rms_interval: Interval
    sup: float = Field(ge=0.0, description='largest [J]')
    sup_interval: Interval = Field(description='of the largest among as many states')
    spread: float = Field(ge=0.0, description='standard deviation of what it is compared with [J]')
    states: int = Field(gt=0, description='how many')


def energy_error(learned: np.ndarray, true: np.ndarray, seed: int) -> EnergyError:
    """
    Compare energies with true ones, up to a constant: the mean of the difference.

    Parameters
    ----------
    learned, true : np.ndarray, shape (n,)
        Energies of the same states [J].
    seed : int
        Of the resampling.

    """
    return _error(learned - true, None, 'true energy', float(np.std(true)), seed)


def energy_spread(learned: np.ndarray, trajectory: np.ndarray, seed: int) -> EnergyError:
    """
    Compare energies with their mean along each trajectory, where the motion conserves energy.

    Parameters
    ----------
    learned : np.ndarray, shape (n,)
        Energies of states [J].
    trajectory : np.ndarray of int, shape (n,)
        Of which each state is one.
    seed : int
        Of the resampling, of whole trajectories.

    """
    numbers = np.unique(trajectory, return_inverse=True)[1]
    means = np.bincount(numbers, learned) / np.bincount(numbers)
    return _error(learned - means[numbers], numbers, 'mean along each trajectory',
                  float(np.std(means[numbers])), seed)


def _error(errors: np.ndarray, groups: np.ndarray | None,
           against: Literal['true energy', 'mean along each trajectory'], spread: float, seed: int
           ) -> EnergyError:
    """Return the statistics of errors; groups are resampled as a whole."""
    rng, n = np.random.default_rng(seed), len(errors)
    members = None if groups is None else [
        np.flatnonzero(groups == group) for group in range(groups.max() + 1)]
    estimates = np.empty((_RESAMPLES, 2))
    for k in range(_RESAMPLES):
        if members is None:
            chosen = errors[rng.integers(0, n, n)]
            estimates[k] = _statistics(chosen - chosen.mean())
        else:
            drawn = rng.integers(0, len(members), len(members))
            estimates[k] = _statistics(errors[np.concatenate([members[i] for i in drawn])])
    rms, sup = _statistics(errors - errors.mean() if members is None else errors)
    low, high = np.percentile(estimates, [50.0 - _LEVEL / 2.0, 50.0 + _LEVEL / 2.0], axis=0)
    return EnergyError(against=against, rms=rms, rms_interval=[low[0], high[0]], sup=sup,
                       sup_interval=[low[1], high[1]], spread=spread, states=n)


def _statistics(errors: np.ndarray) -> tuple[float, float]:
    return float(np.sqrt(np.mean(errors**2))), float(np.abs(errors).max())
