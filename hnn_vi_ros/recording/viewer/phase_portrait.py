# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The static part of a phase portrait: its frame, its ticks and the level sets of H."""

from dataclasses import dataclass
from typing import Any

from contourpy import contour_generator
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.phase_space import scalar_columns
import numpy as np

GRID, LEVELS, _GAPS = 81, 12, 5
# Margins relative to the extents: around a known path, and around one that leaves its frame.
_MARGIN, _LEFT = 0.1, 0.05
# Minimum and maximum of q and p, shape (d, 2) each.
Bounds = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Frame:
    """
    The visible rectangle in the plane of one coordinate and its momentum.

    Parameters
    ----------
    axis : int
        Index of the coordinate.
    q, p : tuple of float
        Minimum and maximum of the coordinate and of the momentum.

    """

    axis: int
    q: tuple[float, float]
    p: tuple[float, float]


def box_of(q: np.ndarray, p: np.ndarray) -> Bounds:
    """Return the minimum and maximum of finite q and p, of shape (n, d) each, with a margin."""
    states = np.hstack([q, p])
    states = states[np.isfinite(states).all(axis=1)]
    extremes = np.stack([states.min(axis=0), states.max(axis=0)], axis=-1)
    extent = np.ptp(extremes, axis=-1)
    # A constant quantity, up to rounding, is shown with one unit on either side.
    moves = extent > 1e-9 * np.maximum(1.0, abs(extremes).max(axis=-1))
    margin = np.where(moves, _MARGIN * extent, 1.0)[:, None]
    box = extremes + margin * np.array([-1.0, 1.0])
    return box[:q.shape[1]], box[q.shape[1]:]


def ends_of(hamiltonian: Hamiltonian, q0: np.ndarray, box: Bounds) -> np.ndarray:
    """Return the minimum and maximum q, shape (2, d), with the initial attitudes."""
    ends = np.array([q0, q0], dtype=np.float64)
    for axis in scalar_columns(hamiltonian.coordinates).values():
        ends[:, axis] = _widen(box[0][axis], q0[axis])
    return ends


def reach_of(hamiltonian: Hamiltonian, ends: np.ndarray) -> float:
    """Return the largest absolute coordinate in the range; 1 m for a point that does not move."""
    places = list(scalar_columns(hamiltonian.coordinates).values())
    return float(abs(ends[:, places]).max()) if places else 1.0


def frame_of(axis: int, q0: np.ndarray, p0: np.ndarray, box: Bounds) -> Frame:
    """
    Choose the visible rectangle, which contains the box and the initial state.

    Parameters
    ----------
    axis : int
        Index of the coordinate.
    q0, p0 : np.ndarray, shape (d,)
        Initial state.
    box : tuple of np.ndarray, shape (d, 2) each
        Minimum and maximum of q and p of the training data, or of a path.

    """
    return Frame(axis, _widen(box[0][axis], q0[axis]), _widen(box[1][axis], p0[axis]))


def fit_frame(frame: Frame, path: np.ndarray) -> Frame:
    """
    Return the frame, enlarged if necessary to contain a recorded path.

    Parameters
    ----------
    frame : Frame
        Frame chosen before the path was known.
    path : np.ndarray, shape (2, 2)
        Minimum and maximum of q (first row) and p on the path.

    """
    sides = []
    for (low, high), (least, most) in zip((frame.q, frame.p), path.tolist(), strict=True):
        margin = _LEFT * (high - low)
        sides.append((low if low <= least else least - margin,
                      high if most <= high else most + margin))
    return Frame(frame.axis, *sides)


def _widen(interval: np.ndarray, value: float) -> tuple[float, float]:
    return float(min(interval[0], value)), float(max(interval[1], value))


def contours(hamiltonian: Hamiltonian, frame: Frame, q0: np.ndarray, p0: np.ndarray
             ) -> list[tuple[float, list[np.ndarray]]]:
    """
    Return level sets of H in the frame, with the other coordinates at their initial values.

    The levels are H_min + (H_max - H_min) ((k - 1/2) / LEVELS)^2 for k = 1 to LEVELS, which spaces
    the ellipses of an oscillator evenly. Vertices are interpolated linearly along the edges of a
    grid with GRID points per side; H at a vertex deviates from its level by at most max(abs(H''))
    spacing^2 / 8.

    Returns
    -------
    list of (float, list of np.ndarray of shape (m, 2))
        Levels of H [J], each with its lines of points (q, p).

    """
    x, y = np.linspace(*frame.q, GRID), np.linspace(*frame.p, GRID)
    q = np.tile(np.asarray(q0, dtype=np.float64), (GRID, GRID, 1))
    p = np.tile(np.asarray(p0, dtype=np.float64), (GRID, GRID, 1))
    q[..., frame.axis], p[..., frame.axis] = x[None, :], y[:, None]
    # No line is drawn where H is infinite, as at the centre of a Kepler problem.
    energy = np.ma.masked_invalid(hamiltonian.energy(q, p))
    lowest, highest = float(energy.min()), float(energy.max())
    levels = lowest + (highest - lowest) * ((np.arange(LEVELS) + 0.5) / LEVELS) ** 2
    # Typed as Any: the form of the lines depends on an argument.
    generator: Any = contour_generator(x, y, energy)
    return [(float(level), generator.lines(level)) for level in levels]


def ticks(interval: tuple[float, float]) -> list[float]:
    """Return multiples of a round number in the interval, with at most five gaps."""
    low, high = interval
    rough = (high - low) / _GAPS
    power = 10.0 ** np.floor(np.log10(rough))
    spacing = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= rough)
    first, last = np.ceil(low / spacing - 1e-9), np.floor(high / spacing + 1e-9)
    # Adding zero turns -0.0 into 0.0.
    return [float(k * spacing) + 0.0 for k in np.arange(first, last + 1.0)]
