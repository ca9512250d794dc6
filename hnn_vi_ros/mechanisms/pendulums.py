# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Bobs on rods, which swing in the plane y = 0 or in space."""

from hnn_vi_ros.mechanisms.parts import (
    AMBER, Ball, Box, CIRCLE_CORNERS, Line, Part, place, SILVER, STEEL, Trail)
import numpy as np


def pendulum(q: np.ndarray, reach: float) -> dict[str, Part]:
    """
    Draw a bob on a rod that swings about y; it hangs down along -z at rest, in q = 0.

    Parameters
    ----------
    q : np.ndarray, shape (..., 1)
        Angle from the lowest position [rad], positive towards x.
    reach : float
        Without effect: a rod is drawn 1 m long, whatever the angles are.

    Returns
    -------
    dict of str to Part
        The parts ``circle``, on which the bob moves, ``pivot``, ``rod``, ``bob`` and its ``path``.

    """
    return _swinging(np.asarray(q, dtype=np.float64)[..., :1], ('rod',), ('bob',))


def double_pendulum(q: np.ndarray, reach: float) -> dict[str, Part]:
    """
    Draw a bob on a rod that hangs from the bob of another, as :func:`pendulum` does.

    Parameters
    ----------
    q : np.ndarray, shape (..., 2)
        Angles of the upper and the lower rod from the vertical [rad], positive towards x.
    reach : float
        Without effect: a rod is drawn 1 m long, whatever the angles are.

    Returns
    -------
    dict of str to Part
        The parts ``circle``, which the lower bob cannot leave, ``pivot``, ``rod1``, ``bob1``,
        ``rod2``, ``bob2`` and its ``path``.

    """
    return _swinging(np.asarray(q, dtype=np.float64)[..., :2], ('rod1', 'rod2'), ('bob1', 'bob2'))


def cartesian_pendulum(q: np.ndarray, reach: float) -> dict[str, Part]:
    """
    Draw a bob by its place, on a rod from the origin.

    Parameters
    ----------
    q : np.ndarray, shape (..., 2) or (..., 3)
        x and z of the bob in the plane y = 0, or its x, y and z [m].
    reach : float
        Largest coordinate that the drawing leaves room for [m]; it sets every other length.

    Returns
    -------
    dict of str to Part
        The parts ``pivot``, ``rod``, as long as the bob is away from the origin, ``bob`` and its
        ``path``.

    """
    q = np.asarray(q, dtype=np.float64)
    bob = place(q[..., 0], q[..., 1] if q.shape[-1] == 3 else 0.0, q[..., -1])
    return {
        'pivot': Box(np.zeros(3), (0.06 * reach,) * 3, STEEL),
        'rod': Line(np.stack([np.zeros_like(bob), bob], axis=-2), 0.02 * reach, SILVER),
        'bob': Ball(bob, 0.1 * reach, AMBER),
        'path': Trail(bob, 0.008 * reach, AMBER),
    }


def _swinging(angles: np.ndarray, rods: tuple[str, ...], bobs: tuple[str, ...]
              ) -> dict[str, Part]:
    """Draw rods of 1 m, each from the bob of the one before, with angles of shape (..., rods)."""
    steps = place(np.sin(angles), 0.0, -np.cos(angles))
    joints = np.concatenate([np.zeros_like(steps[..., :1, :]), np.cumsum(steps, axis=-2)], axis=-2)
    turn = np.linspace(0.0, 2.0 * np.pi, CIRCLE_CORNERS + 1)
    circle = len(rods) * place(np.sin(turn), 0.0, -np.cos(turn))
    parts: dict[str, Part] = {
        'circle': Line(circle, 0.005, STEEL),
        'pivot': Box(np.zeros(3), (0.06, 0.06, 0.06), STEEL)}
    for i, (rod, bob) in enumerate(zip(rods, bobs, strict=True)):
        parts[rod] = Line(joints[..., i:i + 2, :], 0.02, SILVER)
        parts[bob] = Ball(joints[..., i + 1, :], 0.12, AMBER)
    parts['path'] = Trail(joints[..., -1, :], 0.008, AMBER)
    return parts
