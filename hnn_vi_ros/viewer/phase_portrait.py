# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The still part of a phase portrait: its frame, its ticks and the level sets of H."""

from dataclasses import dataclass
from typing import Any

from contourpy import contour_generator
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.phase_space import column_units, columns, scalar_columns
import numpy as np

GRID, LEVELS = 81, 12
# Shares of a scale: for the lowest energy, and to where energy ends, which is passed by 2 %.
_SHARES, _LENGTHS = np.linspace(-1.0, 1.0, 41), 1e-6 * 1.02 ** np.arange(1396)
# Share of an energy that may be rounding.
_LEAST = 1e-12


@dataclass(frozen=True)
class Frame:
    """
    The plane of one coordinate and its momentum, and the rectangle of it that is shown.

    Parameters
    ----------
    axis : int
        Index of the coordinate.
    q, p : tuple of float
        Lowest and highest coordinate and momentum.

    """

    axis: int
    q: tuple[float, float]
    p: tuple[float, float]


def ends_of(hamiltonian: Hamiltonian, q0: np.ndarray, p0: np.ndarray,
            box: tuple[np.ndarray, np.ndarray] | None) -> np.ndarray:
    """Return the lowest and the highest q, shape (2, d), with the attitudes of the start."""
    ends = np.array([q0, q0], dtype=np.float64)
    for axis in scalar_columns(hamiltonian.coordinates).values():
        ends[:, axis] = (_around_q(axis, hamiltonian, q0, p0) if box is None
                         else _widen(box[0][axis], q0[axis]))
    return ends


def reach_of(hamiltonian: Hamiltonian, ends: np.ndarray) -> float:
    """Return the largest coordinate between the ends; 1 m about a point that does not move."""
    places = list(scalar_columns(hamiltonian.coordinates).values())
    return float(abs(ends[:, places]).max()) if places else 1.0


def frame_of(axis: int, hamiltonian: Hamiltonian, q0: np.ndarray, p0: np.ndarray,
             box: tuple[np.ndarray, np.ndarray] | None) -> Frame:
    """
    Choose the rectangle to show: the box of the training data, and the initial state.

    Parameters
    ----------
    axis : int
        Index of the coordinate.
    hamiltonian : Hamiltonian
        H.
    q0, p0 : np.ndarray, shape (d,)
        Initial state.
    box : tuple of np.ndarray, shape (d, 2) each, or None
        Lowest and highest q and p of the training data. Without it the rectangle holds the
        initial state, and a quarter more than where this coordinate alone has the energy of the
        start, and where its momentum alone has what :func:`free_energy` tells.

    """
    if box is None:
        return Frame(axis, _around_q(axis, hamiltonian, q0, p0),
                     _around_p(axis, hamiltonian, q0, p0))
    return Frame(axis, _widen(box[0][axis], q0[axis]), _widen(box[1][axis], p0[axis]))


def fitted(frame: Frame, path: np.ndarray, boxed: bool) -> Frame:
    """
    Return the frame that a recorded path has.

    Parameters
    ----------
    frame : Frame
        The one that was chosen before the path was known.
    path : np.ndarray, shape (2, 2)
        Its lowest and highest q (first row) and p.
    boxed : bool
        Whether the frame is the box of the training data, which is shown in any case.

    """
    return Frame(frame.axis, *(
        _fitted(interval, low, high, boxed)
        for interval, (low, high) in zip((frame.q, frame.p), path.tolist(), strict=True)))


def _fitted(interval: tuple[float, float], low: float, high: float, boxed: bool
            ) -> tuple[float, float]:
    width = interval[1] - interval[0]
    # A quantity that only rounding or an error of the method changes keeps its scale.
    if boxed or high - low < 1e-3 * width:
        margin = 0.05 * width
        return (interval[0] if interval[0] <= low else low - margin,
                interval[1] if high <= interval[1] else high + margin)
    margin = 0.125 * (high - low)
    return low - margin, high + margin


def free_energy(hamiltonian: Hamiltonian, q0: np.ndarray, p0: np.ndarray) -> float:
    """
    Return the energy that one coordinate could take from all: exact where H is a sum over them.

    It is the kinetic energy of the start, and what each coordinate gives up where it alone goes
    to its lowest energy, an angle within a turn and others as far from zero as all of their unit
    together are at the start.
    """
    still = np.zeros_like(p0, dtype=np.float64)
    rest = float(hamiltonian.energy(q0, still))
    free = max(float(hamiltonian.energy(q0, p0)) - rest, 0.0)
    for axis in scalar_columns(hamiltonian.coordinates).values():
        free += rest - _lowest(axis, hamiltonian, q0)[0]
    return free if free > _LEAST * abs(rest) else 0.0


def _around_q(axis: int, hamiltonian: Hamiltonian, q0: np.ndarray, p0: np.ndarray
              ) -> tuple[float, float]:
    """Return how far the energy of the start lets a coordinate go, the others at their lowest."""
    still, far = np.zeros_like(p0, dtype=np.float64), _scale(axis, hamiltonian, q0)
    energy, base = float(hamiltonian.energy(q0, p0)), np.array(q0, dtype=np.float64)
    for other in {*scalar_columns(hamiltonian.coordinates).values()} - {axis}:
        base[other] = _lowest(other, hamiltonian, q0)[1]
    if not hamiltonian.energy(base, still) <= energy:
        # Together they are not low.
        base = np.asarray(q0, dtype=np.float64)
    ends = []
    for side in (-1.0, 1.0):
        places = q0[axis] + side * far * _LENGTHS
        above = _along(hamiltonian, base, axis, places) > energy
        # What no energy bounds is shown as far as its scale.
        ends.append(places[np.argmax(above)] if above.any() else side * max(far, side * q0[axis]))
    if ends[1] - ends[0] < 1e-3 * far:
        # At rest where energy is lowest.
        ends = [q0[axis] - far, q0[axis] + far]
    margin = 0.125 * (ends[1] - ends[0])
    return float(ends[0] - margin), float(ends[1] + margin)


def _around_p(axis: int, hamiltonian: Hamiltonian, q0: np.ndarray, p0: np.ndarray
              ) -> tuple[float, float]:
    """Return how far a momentum alone goes at the coordinates of the start, both ways alike."""
    still, free = np.zeros_like(p0, dtype=np.float64), free_energy(hamiltonian, q0, p0)
    far = float(np.linalg.norm(p0)) or 1.0
    q, p = np.tile(q0, (_LENGTHS.size, 1)), np.tile(still, (_LENGTHS.size, 1))
    p[:, axis] = far * _LENGTHS
    above = hamiltonian.energy(q, p) > float(hamiltonian.energy(q0, still)) + free
    reach = p[np.argmax(above), axis] if free and above.any() else far
    reach = 1.25 * float(max(reach, abs(p0[axis])))
    return -reach, reach


def _scale(axis: int, hamiltonian: Hamiltonian, q0: np.ndarray) -> float:
    """Return half a turn of an angle, and how far all coordinates of a unit are from zero."""
    units = column_units(hamiltonian.coordinates)[0]
    if units[axis] == 'rad':
        return float(max(np.pi, abs(q0[axis])))
    own = [i for i in scalar_columns(hamiltonian.coordinates).values() if units[i] == units[axis]]
    return float(np.linalg.norm(q0[own])) or 1.0


def _along(hamiltonian: Hamiltonian, q0: np.ndarray, axis: int, places: np.ndarray
           ) -> np.ndarray:
    """Return H at rest where one coordinate has these places and the others stay."""
    q = np.tile(q0, (places.size, 1)).astype(np.float64)
    q[:, axis] = places
    # An attitude has a momentum less.
    still = np.zeros((places.size, len(columns(hamiltonian.coordinates)[1])))
    return np.asarray(hamiltonian.energy(q, still))


def _lowest(axis: int, hamiltonian: Hamiltonian, q0: np.ndarray) -> tuple[float, float]:
    """Return the least energy at rest along a coordinate, and where: no centre of Kepler's."""
    places = np.append(_scale(axis, hamiltonian, q0) * _SHARES, q0[axis])
    energy = _along(hamiltonian, q0, axis, places)
    least = np.argmin(np.where(np.isfinite(energy), energy, np.inf))
    return float(energy[least]), float(places[least])


def _widen(interval: np.ndarray, value: float) -> tuple[float, float]:
    return float(min(interval[0], value)), float(max(interval[1], value))


def contours(hamiltonian: Hamiltonian, frame: Frame, q0: np.ndarray, p0: np.ndarray
             ) -> list[tuple[float, list[np.ndarray]]]:
    """
    Return level sets of H in the frame, the other coordinates at their initial values.

    The levels lie at H_min + (H_max - H_min) ((k - 1/2) / LEVELS)^2 for k = 1 to LEVELS, which
    spaces the ellipses of an oscillator evenly. Vertices are linear interpolations along the
    edges of a grid with GRID points a side: H there is off its level by at most
    max(abs(H'')) spacing^2 / 8.

    Returns
    -------
    list of (float, list of np.ndarray of shape (m, 2))
        Each level of H [J] with its lines of points (q, p).

    """
    x, y = np.linspace(*frame.q, GRID), np.linspace(*frame.p, GRID)
    q = np.tile(np.asarray(q0, dtype=np.float64), (GRID, GRID, 1))
    p = np.tile(np.asarray(p0, dtype=np.float64), (GRID, GRID, 1))
    q[..., frame.axis], p[..., frame.axis] = x[None, :], y[:, None]
    # Where H is infinite, as in the centre of a Kepler problem, no line is drawn.
    energy = np.ma.masked_invalid(hamiltonian.energy(q, p))
    lowest, highest = float(energy.min()), float(energy.max())
    levels = lowest + (highest - lowest) * ((np.arange(LEVELS) + 0.5) / LEVELS) ** 2
    # One of several forms of lines, by another argument.
    generator: Any = contour_generator(x, y, energy)
    return [(float(level), generator.lines(level)) for level in levels]


def ticks(interval: tuple[float, float], gaps: int = 5) -> list[float]:
    """Return the multiples in the interval of a round number, with at most ``gaps`` gaps."""
    low, high = interval
    rough = (high - low) / gaps
    power = 10.0 ** np.floor(np.log10(rough))
    spacing = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= rough)
    first, last = np.ceil(low / spacing - 1e-9), np.floor(high / spacing + 1e-9)
    # Adding zero turns -0.0 into 0.0, which reads better.
    return [float(k * spacing) + 0.0 for k in np.arange(first, last + 1.0)]
