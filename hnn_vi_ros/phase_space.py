# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""States and trajectories in the phase space of (q, p)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Coordinate:
    """
    One generalised coordinate and its conjugate momentum.

    Parameters
    ----------
    name : str
        The name that topics, logs and plots carry.
    q_unit, p_unit : str
        Units of the coordinate and of the momentum.

    """

    name: str
    q_unit: str = '1'
    p_unit: str = '1'


@dataclass(frozen=True, eq=False)
class Event:
    """
    An instant at which a condition on the state came true.

    Parameters
    ----------
    when : str
        The condition, an equation.
    direction : str
        ``'up'`` if its left less its right side went from below zero to above, else ``'down'``.
    stops : bool
        Whether it ends the run.
    t : float
        Simulated time [s].
    q, p : np.ndarray, shape (d,)
        The state there.
    energy : float
        H(q, p) [J].

    """

    when: str
    direction: str
    stops: bool
    t: float
    q: np.ndarray
    p: np.ndarray
    energy: float

    def __str__(self) -> str:
        return f'{self.when} ({self.direction}) at t = {self.t:.9g} s'


@dataclass(frozen=True)
class Trajectory:
    """
    The samples of one run.

    Parameters
    ----------
    t : np.ndarray, shape (N,)
        Simulated time [s].
    q, p : np.ndarray, shape (N, d)
        Generalised coordinates and conjugate momenta.
    energy : np.ndarray, shape (N,)
        H(q, p) [J].
    alarms : tuple
        What guards found, the first Alarm of each kind; see guards. Of m trajectories, m tuples.
    events : tuple of Event
        What the scene's ``events`` ask for, in the order of time.

    """

    t: np.ndarray
    q: np.ndarray
    p: np.ndarray
    energy: np.ndarray
    alarms: tuple[Any, ...] = ()
    events: tuple[Event, ...] = ()


def check_state(q: ArrayLike, p: ArrayLike, dimension: int
                ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return fresh float64 arrays of a state, or of several, in the shape given, or raise.

    Parameters
    ----------
    q, p : array_like, shape (d,) or (m, d)
        Generalised coordinates and conjugate momenta.
    dimension : int
        The number d of degrees of freedom that the Hamiltonian has.

    Raises
    ------
    ValueError
        A wrong length, or a value that is not a finite number.

    """
    arrays = []
    for name, values in (('q', q), ('p', p)):
        array = np.array(values, dtype=np.float64)
        if array.ndim not in (1, 2) or array.shape[-1] != dimension:
            raise ValueError(f'{name} has shape {array.shape}, expected ({dimension},): '
                             'one value for each coordinate')
        if not np.isfinite(array).all():
            raise ValueError(f'{name} = {array.tolist()} is not finite')
        arrays.append(array)
    if arrays[0].shape != arrays[1].shape:
        raise ValueError(f'q and p have different shapes, {arrays[0].shape}, {arrays[1].shape}')
    return arrays[0], arrays[1]
