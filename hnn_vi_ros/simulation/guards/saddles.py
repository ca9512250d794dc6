# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Search for saddles of H near a run, by Newton's method from states with a small gradient."""

from collections.abc import Callable, Iterator

from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.kernels import kept
from hnn_vi_ros.simulation.guards.samples import SampleBlock
import numpy as np

# Threshold of the mean square of the derivatives of H, relative to that of the run so far (1 for
# a harmonic oscillator), and to the value at the last unsuccessful search.
_MAX_LULL_RATIO = 0.5
_MAX_ITERATIONS = 30
_EPS = float(np.finfo(np.float64).eps)


@kept(error_model='numpy')
def _size(squares: np.ndarray, sums: np.ndarray, count: float) -> float:
    """Return the mean of the squared derivatives, each relative to its mean along the run."""
    total, active = 0.0, 0
    for j in range(squares.size):
        if sums[j] > 0.0:
            total += squares[j] * count / sums[j]
            active += 1
    return total / max(active, 1)


@kept(error_model='numpy')
def _next_lull(own: np.ndarray, squares: np.ndarray, first: int, limit: float
               ) -> tuple[int, float]:
    """
    Return the index after the next minimum of the derivatives, and their size; or the end and 0.

    The rows of `own` are the sums of squared derivatives along the run and the squares at the
    last two samples; the first entry of the last row is the number of samples.
    """
    for i in range(first, len(squares)):
        count = own[3, 0] + 1.0
        own[0] += squares[i]
        if count >= 2.0:
            middle = _size(own[2], own[0], count)
            lull = middle < limit and middle < _size(squares[i], own[0], count) and (
                count == 2.0 or middle <= _size(own[1], own[0], count))
        else:
            middle, lull = 0.0, False
        own[1], own[2] = own[2], squares[i]
        own[3, 0] = count
        if lull:
            return i, middle
    return len(squares), 0.0


class SaddleSearch:
    """
    Search along a run for stationary points of H that are neither minimum nor maximum.

    It starts at samples with a small local minimum of the derivatives of H, where the motion
    turns or slows down. The limit of Newton's method is accepted as the nearest saddle if its
    energy rise agrees with the prediction of the first step, by the quadratic approximation of
    H, within a factor of two.

    Parameters
    ----------
    hamiltonian : Hamiltonian
        Hamiltonian of a run that is ``searchable``; see RunFacts.
    ready : callable
        Returns whether H'' is compiled; the search does not wait for a compilation in progress.

    """

    def __init__(self, hamiltonian: Hamiltonian, ready: Callable[[], bool]):
        self._hamiltonian, self._ready, self._limit = hamiltonian, ready, _MAX_LULL_RATIO
        self._own = np.zeros((4, 2 * hamiltonian.dimension))
        self._before: tuple[np.ndarray, np.ndarray] | None = None
        # Saddles found, each with the radius within which no new search is started.
        self._known: list[tuple[np.ndarray, float]] = []

    def take(self, block: SampleBlock) -> Iterator[tuple[int, float]]:
        """Search at the next samples; yield index in the block and energy of each saddle [J]."""
        squares = np.hstack([block.dH_dq, block.dH_dp]) ** 2
        at, end = 0, len(squares)
        while at < end:
            at, size = _next_lull(self._own, squares, at, self._limit)
            if at < end:
                z = self._state(block, at - 1)
                known = any(np.linalg.norm(z - saddle) <= radius for saddle, radius in self._known)
                if self._ready() and not known:
                    energy = self._search(z)
                    if energy is None:
                        self._limit = _MAX_LULL_RATIO * size
                    else:
                        yield at, energy
                at += 1
        self._before = block.q[-1].copy(), block.p[-1].copy()

    def _state(self, block: SampleBlock, i: int) -> np.ndarray:
        if i < 0:
            assert self._before is not None, 'a lull does not end at the first sample'
            return np.concatenate(self._before)
        return np.concatenate([block.q[i], block.p[i]])

    def _search(self, start: np.ndarray) -> float | None:
        """Return the energy of the saddle nearest to a state [J], None if there is none."""
        H, d, z, promised = self._hamiltonian, self._hamiltonian.dimension, start, 0.0
        unit = np.eye(2 * d)
        for iteration in range(_MAX_ITERATIONS):
            slope = np.concatenate(H.gradient(z[:d], z[d:]))
            states = np.tile(z, (2 * d, 1))
            curvature = np.hstack(H.hessian_vector(
                states[:, :d], states[:, d:], unit[:, :d], unit[:, d:]))
            if not (np.isfinite(slope).all() and np.isfinite(curvature).all()):
                return None
            step = np.linalg.lstsq(curvature, -slope)[0]
            if iteration == 0:
                promised = 0.5 * float(slope @ step)
            z = z + step
            if np.abs(step).max() <= 1e-10 * max(1.0, float(np.abs(z).max())):
                break
        else:
            return None
        signs = np.linalg.eigvalsh(curvature)
        energy, begun = (float(H.energy(x[:d], x[d:])) for x in (z, start))
        rise, rounding = energy - begun, 64.0 * _EPS * max(abs(energy), abs(begun))
        # A constant slope also gives a step of zero.
        if np.abs(slope).max() > 1e-8 * np.abs(curvature).max() or not (
                signs[0] < -1e-9 * signs[-1] < 0.0) or not (
                0.5 * abs(promised) - rounding <= abs(rise) <= 2.0 * abs(promised) + rounding):
            return None
        self._known.append((z, 1.5 * float(np.linalg.norm(start - z))))
        return energy
