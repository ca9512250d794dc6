# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Bodies that turn in space: by their attitude about a point, or by their pose."""

from hnn_vi_ros.mechanisms.parts import (
    AMBER, CIRCLE_CORNERS, Line, Part, place, SILVER, STEEL, Trail)
import numpy as np

RED, GREEN, BLUE = (235, 87, 87), (86, 190, 100), (88, 136, 255)
# Corners of a cube, by number, in an order that goes along each of its edges at least once.
_EDGES = (0, 1, 3, 2, 0, 4, 5, 1, 5, 7, 3, 7, 6, 2, 6, 4)


def turning_body(q: np.ndarray, reach: float) -> dict[str, Part]:
    """
    Draw a body as the edges of a flat box, with its axes, and the path that it has come.

    Parameters
    ----------
    q : np.ndarray, shape (..., 4) or (..., 7)
        Its attitude, a quaternion x, y, z, w that takes vectors of the body to space; or its place
        [m] and its attitude. Without a place it turns about the origin, and the path is that of
        the end of its third axis; the vertical and a horizontal circle show how it stands.
    reach : float
        Largest coordinate that the drawing leaves room for [m]; it sets every other length.

    Returns
    -------
    dict of str to Part
        The parts ``body``, ``x_axis``, ``y_axis`` and ``z_axis``, red, green and blue, and
        ``path``; of one without a place ``vertical`` and ``circle`` as well.

    """
    q = np.asarray(q, dtype=np.float64)
    turns, flies = _matrices(q[..., -4:]), q.shape[-1] == 7
    center = q[..., :3] if flies else np.zeros_like(q[..., :3])
    length = (0.2 if flies else 0.8) * reach
    corners = 0.5 * length * np.array([[x, y, 0.25 * z] for x in (-1.0, 1.0) for y in (-1.0, 1.0)
                                       for z in (-1.0, 1.0)])[list(_EDGES)]
    body = center[..., None, :] + corners @ np.swapaxes(turns, -1, -2)
    ends = center[..., None] + length * turns
    parts: dict[str, Part] = {'body': Line(body, 0.01 * length, STEEL)}
    for i, (name, color) in enumerate((('x', RED), ('y', GREEN), ('z', BLUE))):
        parts[f'{name}_axis'] = Line(np.stack([center, ends[..., i]], axis=-2), 0.02 * length,
                                     color)
    if not flies:
        turn = np.linspace(0.0, 2.0 * np.pi, CIRCLE_CORNERS + 1)
        parts['vertical'] = Line(place(0.0, 0.0, np.array([-length, length])), 0.004 * length,
                                 SILVER)
        parts['circle'] = Line(length * place(np.cos(turn), np.sin(turn), 0.0), 0.004 * length,
                               SILVER)
    parts['path'] = Trail(center if flies else ends[..., 2], 0.01 * length, AMBER)
    return parts


def _matrices(quaternions: np.ndarray) -> np.ndarray:
    """Return the rotation matrices of unit quaternions of shape (..., 4)."""
    x, y, z, w = np.moveaxis(quaternions, -1, 0)
    rows = [[w * w + x * x - y * y - z * z, 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), w * w - x * x + y * y - z * z, 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
