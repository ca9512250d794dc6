# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The still part of a phase portrait: its frame, its ticks and the level sets of H."""

from dataclasses import dataclass

from contourpy import contour_generator
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.phase_space import scalar_columns
import numpy as np

GRID, LEVELS = 81, 12


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


def frames_of(hamiltonian: Hamiltonian, q0: np.ndarray, p0: np.ndarray,
              box: tuple[np.ndarray, np.ndarray] | None, count: int) -> list[Frame]:
    """Return what :func:`frame_of` chooses for each of the first coordinates."""
    return [frame_of(axis, hamiltonian, q0, p0, box) for axis in range(count)]


def ends_of(hamiltonian: Hamiltonian, q0: np.ndarray, p0: np.ndarray,
            box: tuple[np.ndarray, np.ndarray] | None) -> np.ndarray:
    """Return the lowest and the highest q, shape (2, d), with the attitudes of the start."""
    ends = np.array([q0, q0], dtype=np.float64)
    for axis in scalar_columns(hamiltonian.coordinates).values():
        ends[:, axis] = frame_of(axis, hamiltonian, q0, p0, box).q
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
        initial state and, where there are such, the states of its energy with this coordinate
        alone in motion.

    """
    if box is None:
        q_reach = 1.25 * _reach(axis, hamiltonian, q0, p0, 1.0, 0.0)
        p_reach = 1.25 * _reach(axis, hamiltonian, q0, p0, 0.0, 1.0)
        return Frame(axis, (-q_reach, q_reach), (-p_reach, p_reach))
    return Frame(axis, _widen(box[0][axis], q0[axis]), _widen(box[1][axis], p0[axis]))


def _reach(axis: int, hamiltonian: Hamiltonian, q0: np.ndarray, p0: np.ndarray,
           q_share: float, p_share: float) -> float:
    """Return how far q, or p, of one coordinate goes before H exceeds its initial value."""
    start = max(abs(q_share * q0[axis] + p_share * p0[axis]), 1e-6)
    # At most a factor of a million: a coordinate that no energy bounds is shown as it starts.
    lengths = start * 1.2 ** np.arange(76)
    q, p = np.tile(q0, (lengths.size, 1)), np.tile(p0, (lengths.size, 1))
    q[:, axis], p[:, axis] = q_share * lengths, p_share * lengths
    above = hamiltonian.energy(q, p) > hamiltonian.energy(q0, p0)
    if above.any():
        return float(lengths[np.argmax(above)])
    return start if start > 1e-6 else 1.0


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
    generator = contour_generator(x, y, energy)
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
