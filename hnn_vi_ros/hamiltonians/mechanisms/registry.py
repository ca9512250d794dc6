# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Mechanisms for display: a scene's coordinates as lines, boxes and balls in metres.

A mechanism is a function ``(q, reach) -> {part name: Line | Box | Ball | Trail}``. It does not
depend on a viewer or a message type, so one description serves every display. Axes follow REP 103:
z points up. A moving part has the leading axes of q; a fixed part has none.
"""

from collections.abc import Sequence

from hnn_vi_ros.hamiltonians.mechanisms.parts import (
    AMBER, Ball, Cuboid, Line, Mechanism, Part, place, SILVER, STEEL, Trail)
import numpy as np

# Angles of the corners of a closed circle.
_ROUND = np.linspace(0.0, 2.0 * np.pi, 73)


def pendulum(q: np.ndarray, reach: float) -> dict[str, Part]:
    """
    Return a bob on a rod that swings about y and hangs along -z at rest, at q = 0.

    Parameters
    ----------
    q : np.ndarray, shape (..., 1)
        Angle from the lowest position [rad], positive towards x.
    reach : float
        Unused: the rod is 1 m long for all angles.

    Returns
    -------
    dict of str to Part
        Parts ``circle``, the path of the bob, ``pivot``, ``rod``, ``bob`` and its ``path``.

    """
    return _swinging(np.asarray(q, dtype=np.float64)[..., :1], ('rod',), ('bob',))


def double_pendulum(q: np.ndarray, reach: float) -> dict[str, Part]:
    """
    Return a bob on a rod that hangs from the bob of another, as in :func:`pendulum`.

    Parameters
    ----------
    q : np.ndarray, shape (..., 2)
        Angles of the upper and the lower rod from the vertical [rad], positive towards x.
    reach : float
        Unused: each rod is 1 m long for all angles.

    Returns
    -------
    dict of str to Part
        Parts ``circle``, which the lower bob cannot leave, ``pivot``, ``rod1``, ``bob1``,
        ``rod2``, ``bob2`` and its ``path``.

    """
    return _swinging(np.asarray(q, dtype=np.float64)[..., :2], ('rod1', 'rod2'), ('bob1', 'bob2'))


def cartesian_pendulum(q: np.ndarray, reach: float) -> dict[str, Part]:
    """
    Return a bob by its position, on a rod from the origin.

    Parameters
    ----------
    q : np.ndarray, shape (..., 2) or (..., 3)
        x and z of the bob in the plane y = 0, or its x, y and z [m].
    reach : float
        Largest coordinate in the drawing [m]; it determines all other lengths.

    Returns
    -------
    dict of str to Part
        Parts ``pivot``, ``rod``, as long as the distance of the bob from the origin, ``bob`` and
        its ``path``.

    """
    q = np.asarray(q, dtype=np.float64)
    bob = place(q[..., 0], q[..., 1] if q.shape[-1] == 3 else 0.0, q[..., -1])
    return {
        'pivot': Cuboid(np.zeros(3), (0.06 * reach,) * 3, STEEL),
        'rod': Line(np.stack([np.zeros_like(bob), bob], axis=-2), 0.02 * reach, SILVER),
        'bob': Ball(bob, 0.1 * reach, AMBER),
        'path': Trail(bob, 0.008 * reach, AMBER),
    }


def _swinging(angles: np.ndarray, rods: tuple[str, ...], bobs: tuple[str, ...]) -> dict[str, Part]:
    """Return rods of 1 m, each from the previous bob, with angles of shape (..., rods)."""
    steps = place(np.sin(angles), 0.0, -np.cos(angles))
    joints = np.concatenate([np.zeros_like(steps[..., :1, :]), np.cumsum(steps, axis=-2)], axis=-2)
    circle = len(rods) * place(np.sin(_ROUND), 0.0, -np.cos(_ROUND))
    parts: dict[str, Part] = {
        'circle': Line(circle, 0.005, STEEL),
        'pivot': Cuboid(np.zeros(3), (0.06, 0.06, 0.06), STEEL)}
    for i, (rod, bob) in enumerate(zip(rods, bobs, strict=True)):
        parts[rod] = Line(joints[..., i:i + 2, :], 0.02, SILVER)
        parts[bob] = Ball(joints[..., i + 1, :], 0.12, AMBER)
    parts['path'] = Trail(joints[..., -1, :], 0.008, AMBER)
    return parts


STIFF = (88, 166, 255)
COILS, SOFT_COILS, STIFF_COILS = 9, 5, 7
# Each mass and spring is a part; more would be neither visible nor drawn in time.
MOST_PAIRS = 20


def mass_spring(q: np.ndarray, reach: float) -> dict[str, Part]:
    """
    Return a mass on a spring from a wall; the mass slides along x, at rest at x = 0.

    Parameters
    ----------
    q : np.ndarray, shape (..., 1)
        Displacement of the mass [m].
    reach : float
        Largest displacement in the drawing [m]; it determines all other lengths.

    Returns
    -------
    dict of str to Part
        Parts ``wall``, ``floor``, ``spring`` and ``mass``.

    """
    x = np.asarray(q, dtype=np.float64)[..., 0]
    half, thick, wall, end = 0.4 * reach, 0.05 * reach, -2.7 * reach, 1.6 * reach
    depth, height = 1.7 * half, 2.6 * half
    spring = _zigzag(np.full_like(x, wall), x - half, half, 0.5 * half, COILS)
    return {
        'wall': Cuboid(np.array([wall - thick, 0.0, 0.5 * height - thick]),
                       (thick, depth, 0.5 * height + thick), STEEL),
        'floor': Cuboid(np.array([0.5 * (wall + end), 0.0, -thick]),
                        (0.5 * (end - wall), depth, thick), STEEL),
        'spring': Line(spring, 0.025 * reach, SILVER),
        'mass': Cuboid(place(x, 0.0, half), (half, half, half), AMBER),
    }


def spring_chain(q: np.ndarray, reach: float) -> dict[str, Part]:
    """
    Return the :class:`~hnn_vi_ros.hamiltonians.fput_chain.FputChain` between two walls.

    Parameters
    ----------
    q : np.ndarray, shape (..., 2 m)
        Centres c_1 to c_m and stretches s_1 to s_m of the m pairs of masses [m], m up to
        MOST_PAIRS; the masses of pair i are displaced by (c_i - s_i) / sqrt(2) and
        (c_i + s_i) / sqrt(2).
    reach : float
        Largest coordinate in the drawing [m]; it determines all other lengths.

    Returns
    -------
    dict of str to Part
        Parts ``wall1``, ``wall2`` and ``floor``, the soft springs ``soft0`` to ``soft<m>``, the
        stiff ones ``stiff1`` to ``stiff<m>``, and ``mass1`` to ``mass<2 m>``.

    """
    q = np.asarray(q, dtype=np.float64)
    m = q.shape[-1] // 2
    half, thick, soft, stiff = 0.3 * reach, 0.05 * reach, 2.4 * reach, 1.6 * reach
    moved = np.stack([q[..., :m] - q[..., m:], q[..., :m] + q[..., m:]], axis=-1) / np.sqrt(2.0)
    rest = soft * np.arange(1, m + 1)[:, None] + stiff * (np.arange(m)[:, None] + np.array([0, 1]))
    end = soft * (m + 1) + stiff * m
    x = (rest - 0.5 * end + moved).reshape(*q.shape[:-1], 2 * m)
    # Ends of each spring: a wall, or the face of a mass.
    wall = np.full_like(x[..., :1], 0.5 * end)
    begins = np.concatenate([-wall, x + half], axis=-1)
    ends = np.concatenate([x - half, wall], axis=-1)
    parts: dict[str, Part] = {
        'wall1': Cuboid(
            np.array([-0.5 * end - thick, 0.0, half]), (thick, half, 1.5 * half), STEEL),
        'wall2': Cuboid(
            np.array([0.5 * end + thick, 0.0, half]), (thick, half, 1.5 * half), STEEL),
        'floor': Cuboid(np.array([0.0, 0.0, -thick]), (0.5 * end, half, thick), STEEL)}
    for i in range(2 * m + 1):
        name, coils, width, color = (
            (f'soft{i // 2}', SOFT_COILS, 0.6 * half, SILVER) if i % 2 == 0
            else (f'stiff{i // 2 + 1}', STIFF_COILS, 0.35 * half, STIFF))
        parts[name] = Line(_zigzag(begins[..., i], ends[..., i], half, width, coils),
                           0.035 * reach, color)
    for i in range(2 * m):
        parts[f'mass{i + 1}'] = Cuboid(place(x[..., i], 0.0, half), (half, half, half), AMBER)
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


SUN, FIELD, LIMIT = (255, 221, 120), (88, 166, 255), (255, 123, 114)
# Number of field lines along each side of the frame.
FIELD_LINES = 7


def kepler(q: np.ndarray, reach: float) -> dict[str, Part]:
    """
    Return a body that moves around a centre in the plane z = 0.

    Parameters
    ----------
    q : np.ndarray, shape (..., 2)
        x and y of the body [m].
    reach : float
        Largest coordinate in the drawing [m]; it determines all other lengths.

    Returns
    -------
    dict of str to Part
        Parts ``circle`` of radius ``reach``, ``centre``, ``ray`` from there to the body, ``body``
        and its ``path``.

    """
    body = _in_plane(q)
    return {
        'circle': Line(reach * place(np.cos(_ROUND), np.sin(_ROUND), 0.0), 0.004 * reach, STEEL),
        'centre': Ball(np.zeros(3), 0.07 * reach, SUN),
        'ray': Line(np.stack([np.zeros_like(body), body], axis=-2), 0.006 * reach, STEEL),
        'body': Ball(body, 0.05 * reach, AMBER),
        'path': Trail(body, 0.008 * reach, AMBER),
    }


def henon_heiles(q: np.ndarray, reach: float) -> dict[str, Part]:
    """
    Return a star in the plane z = 0, in the triangle that it cannot leave below H = 1/6.

    Parameters
    ----------
    q : np.ndarray, shape (..., 2)
        x and y of the star [1].
    reach : float
        Unused: the triangle has its corners at (0, 1) and (+-sqrt(3) / 2, -1/2).

    Returns
    -------
    dict of str to Part
        Parts ``triangle``, ``star`` and its ``path``.

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
    Return a particle in the plane z = 0, with field lines along z.

    Parameters
    ----------
    q : np.ndarray, shape (..., 2)
        x and y of the particle [m].
    reach : float
        Largest coordinate in the drawing [m]; it determines all other lengths.

    Returns
    -------
    dict of str to Part
        Parts ``frame``, the boundary of the drawing, ``field<i>``, ``particle`` and its ``path``.

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
    Return a mass above a floor, with contact at z = 0.

    Parameters
    ----------
    q : np.ndarray, shape (..., 1)
        Height of the lower face of the mass [m].
    reach : float
        Largest height in the drawing [m]; it determines all other lengths.

    Returns
    -------
    dict of str to Part
        Parts ``floor``, ``rail``, a scale of the height, ``tick<i>`` and ``mass``.

    """
    z = np.asarray(q, dtype=np.float64)[..., 0]
    half, thick, wide = 0.1 * reach, 0.02 * reach, 0.6 * reach
    rail = -2.5 * half
    parts: dict[str, Part] = {
        'floor': Cuboid(np.array([0.0, 0.0, -thick]), (wide, 0.4 * wide, thick), STEEL),
        'rail': Line(place(rail, 0.0, np.array([0.0, reach])), 0.008 * reach, STEEL)}
    for i in range(5):
        height = 0.25 * reach * i
        parts[f'tick{i}'] = Line(place(rail + np.array([0.0, 0.6 * half]), 0.0, height),
                                 0.006 * reach, STEEL)
    parts['mass'] = Cuboid(place(0.0, 0.0, z + half), (half, half, half), AMBER)
    return parts


def _in_plane(q: np.ndarray) -> np.ndarray:
    q = np.asarray(q, dtype=np.float64)
    return place(q[..., 0], q[..., 1], 0.0)


RED, GREEN, BLUE = (235, 87, 87), (86, 190, 100), (88, 136, 255)
# Corners of a cube by index, in an order that passes each of its edges at least once.
_EDGES = (0, 1, 3, 2, 0, 4, 5, 1, 5, 7, 3, 7, 6, 2, 6, 4)


def turning_body(q: np.ndarray, reach: float) -> dict[str, Part]:
    """
    Return a body as the edges of a flat box, with its axes and its path.

    Parameters
    ----------
    q : np.ndarray, shape (..., 4) or (..., 7)
        Its attitude, a quaternion x, y, z, w that maps vectors of the body to space; or its
        position [m] and attitude. Without a position it rotates about the origin, with the path of
        the end of its third axis; the vertical and a horizontal circle show its orientation.
    reach : float
        Largest coordinate in the drawing [m]; it determines all other lengths.

    Returns
    -------
    dict of str to Part
        Parts ``body``, ``x_axis``, ``y_axis`` and ``z_axis``, red, green and blue, and ``path``;
        without a position also ``vertical`` and ``circle``.

    """
    q = np.asarray(q, dtype=np.float64)
    from scipy.spatial.transform import Rotation  # slow to import, and only bodies need it
    turns = Rotation.from_quat(q[..., -4:].reshape(-1, 4)).as_matrix().reshape(*q.shape[:-1], 3, 3)
    flies = q.shape[-1] == 7
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
        parts['vertical'] = Line(place(0.0, 0.0, np.array([-length, length])), 0.004 * length,
                                 SILVER)
        parts['circle'] = Line(length * place(np.cos(_ROUND), np.sin(_ROUND), 0.0),
                               0.004 * length, SILVER)
    parts['path'] = Trail(center if flies else ends[..., 2], 0.01 * length, AMBER)
    return parts


# Each mechanism, and the number of columns of q that it draws.
_COLUMNS: dict[Mechanism, Sequence[int]] = {
    bouncing_mass: (1,),
    cartesian_pendulum: (2, 3),
    charged_particle: (2,),
    double_pendulum: (2,),
    henon_heiles: (2,),
    kepler: (2,),
    mass_spring: (1,),
    pendulum: (1,),
    spring_chain: range(2, 2 * MOST_PAIRS + 1, 2),
    turning_body: (4, 7),
}
MECHANISMS = {draw.__name__: draw for draw in _COLUMNS}
COORDINATES = {draw.__name__: columns for draw, columns in _COLUMNS.items()}
# Mechanisms of rotating bodies.
ROTATING = frozenset(('turning_body',))
