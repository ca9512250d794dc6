# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Masses on springs, which slide along x."""

from hnn_vi_ros.mechanisms.parts import AMBER, Box, Line, Part, place, SILVER, STEEL
import numpy as np

STIFF = (88, 166, 255)
COILS, SOFT_COILS, STIFF_COILS = 9, 5, 7
# A part each for every mass and spring: more would neither be seen nor drawn in time.
MOST_PAIRS = 20


def mass_spring(q: np.ndarray, reach: float) -> dict[str, Part]:
    """
    Draw a mass that a spring ties to a wall; the mass slides along x, at rest in x = 0.

    Parameters
    ----------
    q : np.ndarray, shape (..., 1)
        Displacement of the mass [m].
    reach : float
        Largest displacement that the drawing leaves room for [m]; it sets every other length.

    Returns
    -------
    dict of str to Part
        The parts ``wall``, ``floor``, ``spring`` and ``mass``.

    """
    x = np.asarray(q, dtype=np.float64)[..., 0]
    half, thick, wall, end = 0.4 * reach, 0.05 * reach, -2.7 * reach, 1.6 * reach
    depth, height = 1.7 * half, 2.6 * half
    spring = _zigzag(np.full_like(x, wall), x - half, half, 0.5 * half, COILS)
    return {
        'wall': Box(np.array([wall - thick, 0.0, 0.5 * height - thick]),
                    (thick, depth, 0.5 * height + thick), STEEL),
        'floor': Box(np.array([0.5 * (wall + end), 0.0, -thick]),
                     (0.5 * (end - wall), depth, thick), STEEL),
        'spring': Line(spring, 0.025 * reach, SILVER),
        'mass': Box(place(x, 0.0, half), (half, half, half), AMBER),
    }


def spring_chain(q: np.ndarray, reach: float) -> dict[str, Part]:
    """
    Draw the chain of :class:`~hnn_vi_ros.hamiltonians.fput_chain.FputChain` between two walls.

    Parameters
    ----------
    q : np.ndarray, shape (..., 2 m)
        Centres c_1 to c_m and stretches s_1 to s_m of the m pairs of masses [m], m up to
        MOST_PAIRS; the masses of pair i are displaced by (c_i - s_i) / sqrt(2) and
        (c_i + s_i) / sqrt(2).
    reach : float
        Largest coordinate that the drawing leaves room for [m]; it sets every other length.

    Returns
    -------
    dict of str to Part
        The parts ``wall1``, ``wall2`` and ``floor``, the soft springs ``soft0`` to ``soft<m>``,
        the stiff ones ``stiff1`` to ``stiff<m>``, and ``mass1`` to ``mass<2 m>``.

    """
    q = np.asarray(q, dtype=np.float64)
    m = q.shape[-1] // 2
    half, thick, soft, stiff = 0.3 * reach, 0.05 * reach, 2.4 * reach, 1.6 * reach
    moved = np.stack([q[..., :m] - q[..., m:], q[..., :m] + q[..., m:]], axis=-1) / np.sqrt(2.0)
    rest = soft * np.arange(1, m + 1)[:, None] + stiff * (np.arange(m)[:, None] + np.array([0, 1]))
    end = soft * (m + 1) + stiff * m
    x = (rest - 0.5 * end + moved).reshape(*q.shape[:-1], 2 * m)
    # Where each spring begins and ends: at a wall, or at the faces of two masses.
    wall = np.full_like(x[..., :1], 0.5 * end)
    begins = np.concatenate([-wall, x + half], axis=-1)
    ends = np.concatenate([x - half, wall], axis=-1)
    parts: dict[str, Part] = {
        'wall1': Box(np.array([-0.5 * end - thick, 0.0, half]), (thick, half, 1.5 * half), STEEL),
        'wall2': Box(np.array([0.5 * end + thick, 0.0, half]), (thick, half, 1.5 * half), STEEL),
        'floor': Box(np.array([0.0, 0.0, -thick]), (0.5 * end, half, thick), STEEL)}
    for i in range(2 * m + 1):
        name, coils, width, color = (
            (f'soft{i // 2}', SOFT_COILS, 0.6 * half, SILVER) if i % 2 == 0
            else (f'stiff{i // 2 + 1}', STIFF_COILS, 0.35 * half, STIFF))
        parts[name] = Line(_zigzag(begins[..., i], ends[..., i], half, width, coils),
                           0.035 * reach, color)
    for i in range(2 * m):
        parts[f'mass{i + 1}'] = Box(place(x[..., i], 0.0, half), (half, half, half), AMBER)
    return parts


def _zigzag(start: np.ndarray, end: np.ndarray, height: float, width: float, coils: int
            ) -> np.ndarray:
    """Return a spring's corners along x from start to end, shape (..., 2 coils + 4, 3)."""
    lead = 0.06
    share = np.concatenate([[0.0], np.linspace(lead, 1.0 - lead, 2 * coils + 2), [1.0]])
    side = np.zeros(share.size)
    side[2:-2] = np.where(np.arange(2 * coils) % 2, -width, width)
    along = start[..., None] + share * (end - start)[..., None]
    return place(along, 0.0, height + side)
