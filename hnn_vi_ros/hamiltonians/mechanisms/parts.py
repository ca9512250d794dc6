# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Parts of mechanisms: lines, boxes, balls and trails in metres, independent of the viewer."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Color = tuple[int, int, int]
STEEL, SILVER, AMBER = (92, 102, 118), (190, 200, 214), (242, 165, 65)


@dataclass(frozen=True)
class Line:
    """
    A polyline with a round cross-section.

    Parameters
    ----------
    points : np.ndarray, shape (..., m, 3)
        Corners in order [m].
    radius : float
        Radius of the cross-section [m].
    color : tuple of int
        Red, green, blue, 0 to 255.

    """

    points: np.ndarray
    radius: float
    color: Color

    @property
    def moves(self) -> bool:
        """Return True if the part has a position for each q, False if it has a single one."""
        return self.points.ndim > 2


@dataclass(frozen=True)
class Cuboid:
    """
    A solid box, its edges along the axes.

    Parameters
    ----------
    center : np.ndarray, shape (..., 3)
        Centre [m].
    half_size : tuple of float
        Half of the edge lengths along x, y, z [m].
    color : tuple of int
        Red, green, blue, 0 to 255.

    """

    center: np.ndarray
    half_size: tuple[float, float, float]
    color: Color

    @property
    def moves(self) -> bool:
        """Return True if the part has a position for each q, False if it has a single one."""
        return self.center.ndim > 1


@dataclass(frozen=True)
class Ball:
    """
    A solid ball.

    Parameters
    ----------
    center : np.ndarray, shape (..., 3)
        Centre [m].
    radius : float
        Its radius [m].
    color : tuple of int
        Red, green, blue, 0 to 255.

    """

    center: np.ndarray
    radius: float
    color: Color

    @property
    def moves(self) -> bool:
        """Return True if the part has a position for each q, False if it has a single one."""
        return self.center.ndim > 1


@dataclass(frozen=True)
class Trail:
    """
    A point that leaves a trail of its past positions, as far as a viewer stores them.

    Parameters
    ----------
    point : np.ndarray, shape (..., 3)
        Its position [m].
    radius : float
        Radius of the line's cross-section [m].
    color : tuple of int
        Red, green, blue, 0 to 255.

    """

    point: np.ndarray
    radius: float
    color: Color

    @property
    def moves(self) -> bool:
        """Return True if the part has a position for each q, False if it has a single one."""
        return self.point.ndim > 1


Part = Line | Cuboid | Ball | Trail
Mechanism = Callable[[np.ndarray, float], dict[str, Part]]


def place(x: np.ndarray | float, y: np.ndarray | float, z: np.ndarray | float) -> np.ndarray:
    """Return points with these coordinates, which are broadcast against each other, (..., 3)."""
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1).astype(np.float64)


def bounds_of(parts: dict[str, Part]) -> np.ndarray:
    """Return the lowest and the highest corner [m] around all parts, shape (2, 3)."""
    corners = []
    for part in parts.values():
        if isinstance(part, Line):
            corners.append(part.points.reshape(-1, 3))
        elif isinstance(part, Trail):
            corners.append(part.point.reshape(-1, 3))
        else:
            half_size = np.array(
                part.half_size if isinstance(part, Cuboid) else 3 * (part.radius,))
            corners += [part.center.reshape(-1, 3) - half_size,
                        part.center.reshape(-1, 3) + half_size]
    points = np.vstack(corners)
    return np.array([points.min(axis=0), points.max(axis=0)])
