# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Single bodies that move freely: in the plane z = 0, or up and down."""

from hnn_vi_ros.mechanisms.parts import (
    AMBER, Ball, Box, CIRCLE_CORNERS, Line, Part, place, STEEL, Trail)
import numpy as np

SUN, FIELD, LIMIT = (255, 221, 120), (88, 166, 255), (255, 123, 114)
# Field lines along each side of the frame.
FIELD_LINES = 7


def kepler(q: np.ndarray, reach: float) -> dict[str, Part]:
    """
    Draw a body that moves around a centre in the plane z = 0.

    Parameters
    ----------
    q : np.ndarray, shape (..., 2)
        x and y of the body [m].
    reach : float
        Largest coordinate that the drawing leaves room for [m]; it sets every other length.

    Returns
    -------
    dict of str to Part
        The parts ``circle`` of radius ``reach``, ``centre``, ``ray`` from there to the body,
        ``body`` and its ``path``.

    """
    body = _in_plane(q)
    turn = np.linspace(0.0, 2.0 * np.pi, CIRCLE_CORNERS + 1)
    return {
        'circle': Line(reach * place(np.cos(turn), np.sin(turn), 0.0), 0.004 * reach, STEEL),
        'centre': Ball(np.zeros(3), 0.07 * reach, SUN),
        'ray': Line(np.stack([np.zeros_like(body), body], axis=-2), 0.006 * reach, STEEL),
        'body': Ball(body, 0.05 * reach, AMBER),
        'path': Trail(body, 0.008 * reach, AMBER),
    }


def henon_heiles(q: np.ndarray, reach: float) -> dict[str, Part]:
    """
    Draw a star in the plane z = 0, in the triangle that it cannot leave below H = 1/6.

    Parameters
    ----------
    q : np.ndarray, shape (..., 2)
        x and y of the star [1].
    reach : float
        Without effect: the triangle has its corners in (0, 1) and (+-sqrt(3) / 2, -1/2).

    Returns
    -------
    dict of str to Part
        The parts ``triangle``, ``star`` and its ``path``.

    """
    corner = 2.0 * np.pi * (0.25 + np.arange(4) / 3.0)
    star = _in_plane(q)
    return {
        'triangle': Line(place(np.cos(corner), np.sin(corner), 0.0), 0.008, LIMIT),
        'star': Ball(star, 0.045, AMBER),
        'path': Trail(star, 0.006, AMBER),
    }


def charged_particle(q: np.ndarray, reach: float) -> dict[str, Part]:
    """
    Draw a particle in the plane z = 0 among the lines of a field along z.

    Parameters
    ----------
    q : np.ndarray, shape (..., 2)
        x and y of the particle [m].
    reach : float
        Largest coordinate that the drawing leaves room for [m]; it sets every other length.

    Returns
    -------
    dict of str to Part
        The parts ``frame``, around what the drawing leaves room for, ``field<i>``,
        ``particle`` and its ``path``.

    """
    corner = np.array([-1.0, 1.0, 1.0, -1.0, -1.0])
    parts: dict[str, Part] = {
        'frame': Line(reach * place(corner, np.roll(corner, 1), 0.0), 0.008 * reach, STEEL)}
    grid = reach * np.linspace(-1.0, 1.0, FIELD_LINES + 2)[1:-1]
    tall = 0.1 * reach
    for i, (x, y) in enumerate((x, y) for x in grid for y in grid):
        parts[f'field{i}'] = Line(place(x, y, np.array([-tall, tall])), 0.006 * reach, FIELD)
    particle = _in_plane(q)
    parts['particle'] = Ball(particle, 0.06 * reach, AMBER)
    parts['path'] = Trail(particle, 0.01 * reach, AMBER)
    return parts


def bouncing_mass(q: np.ndarray, reach: float) -> dict[str, Part]:
    """
    Draw a mass above a floor, which it touches in z = 0.

    Parameters
    ----------
    q : np.ndarray, shape (..., 1)
        Height of the lower face of the mass [m].
    reach : float
        Largest height that the drawing leaves room for [m]; it sets every other length.

    Returns
    -------
    dict of str to Part
        The parts ``floor``, ``rail``, on which the height can be read, ``tick<i>`` and ``mass``.

    """
    z = np.asarray(q, dtype=np.float64)[..., 0]
    half, thick, wide = 0.1 * reach, 0.02 * reach, 0.6 * reach
    rail = -2.5 * half
    parts: dict[str, Part] = {
        'floor': Box(np.array([0.0, 0.0, -thick]), (wide, 0.4 * wide, thick), STEEL),
        'rail': Line(place(rail, 0.0, np.array([0.0, reach])), 0.008 * reach, STEEL)}
    for i in range(5):
        height = 0.25 * reach * i
        parts[f'tick{i}'] = Line(place(rail + np.array([0.0, 0.6 * half]), 0.0, height),
                                 0.006 * reach, STEEL)
    parts['mass'] = Box(place(0.0, 0.0, z + half), (half, half, half), AMBER)
    return parts


def _in_plane(q: np.ndarray) -> np.ndarray:
    q = np.asarray(q, dtype=np.float64)
    return place(q[..., 0], q[..., 1], 0.0)
