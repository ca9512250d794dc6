# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers of joints from the URDF and the scene."""

from collections.abc import Callable, Mapping, Sequence

from hnn_vi_ros.effects.base import coordinate_index
from hnn_vi_ros.hamiltonians import Joint, JointCoordinate
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


def check_joint_numbers(source: str | None, check: Callable[..., None],
                        **given: Mapping[str, float] | None) -> None:
    """Raise ValueError unless there is a source or a number, and all numbers pass a check."""
    if source is None and not any(given.values()):
        raise ValueError(f'give from: urdf, or {" or ".join(given)}')
    check(**{f'{name} of {joint}': value for name, values in given.items()
             for joint, value in (values or {}).items()})


def joint_numbers(coordinates: Sequence[Coordinate], source: str | None,
                  of: Callable[[Joint], float | None], given: Mapping[str, float] | None
                  ) -> np.ndarray:
    """
    Return one number for each coordinate, shape (d,); NaN for none.

    Parameters
    ----------
    coordinates : sequence of Coordinate
        The coordinates of the system.
    source : str or None
        ``'urdf'`` for numbers of its joints.
    of : callable
        Function that returns the number of a joint, or None.
    given : mapping of str to float or None
        Numbers that replace the source's, by coordinate.

    Raises
    ------
    ValueError
        A coordinate is not a joint of a URDF, or a name is unknown.

    """
    values = np.full(len(coordinates), np.nan)
    for i, coordinate in enumerate(coordinates) if source == 'urdf' else ():
        if coordinate.rotor_of:
            continue
        if not isinstance(coordinate, JointCoordinate):
            raise ValueError(f'from = urdf, but {coordinate.name} is not a joint of a URDF; use '
                             'hamiltonian: {kind: urdf}, or give the numbers here')
        number = of(coordinate.joint)
        values[i] = np.nan if number is None else number
    for name, value in (given or {}).items():
        values[coordinate_index(coordinates, name)] = value
    return values
