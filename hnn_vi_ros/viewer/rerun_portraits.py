# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Phase portraits in a rerun recording: their still parts, and the paths through them."""

from typing import final

from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.viewer import rerun_layout as layout
from hnn_vi_ros.viewer.phase_portrait import fitted, frames_of
import numpy as np
import rerun as rr


@final
class Portraits:
    """
    The phase portraits of the first coordinates.

    Parameters
    ----------
    recording : rerun.RecordingStream
        What takes the data.
    hamiltonian : Hamiltonian
        H.
    q0, p0 : np.ndarray, shape (d,)
        Initial state.
    box : tuple of np.ndarray, shape (d, 2) each, or None
        Lowest and highest q and p of the training data.
    count : int
        Of the portraits.
    side : float
        Width of a frame in points.

    """

    def __init__(self, recording: rr.RecordingStream, hamiltonian: Hamiltonian, q0: np.ndarray,
                 p0: np.ndarray, box: tuple[np.ndarray, np.ndarray] | None, count: int,
                 side: float):
        self._recording, self._hamiltonian, self._boxed = recording, hamiltonian, box is not None
        self._start, self._side = (q0, p0), side
        self._frames = frames_of(hamiltonian, q0, p0, box, count)
        # The newest (q, p) of each, and the lowest and highest: shapes (count, 2), (count, 2, 2).
        self._last: np.ndarray | None = None
        self._path = np.tile([np.inf, -np.inf], (count, 2, 1))
        self._draw()

    def send(self, times: list[rr.TimeColumn], q: np.ndarray, p: np.ndarray) -> None:
        """
        Add to each path the segments that lead to n new points.

        Parameters
        ----------
        times : list of rerun.TimeColumn
            Of n samples.
        q, p : np.ndarray, shape (n, d)
            Where they are.

        """
        count = len(self._frames)
        if not count:
            return
        new = np.stack([q[:, :count], p[:, :count]], axis=-1)
        points = np.concatenate([new[:1] if self._last is None else self._last[None], new])
        self._last = points[-1]
        finite = np.isfinite(new)
        self._path[..., 0] = np.minimum(
            self._path[..., 0], np.where(finite, new, np.inf).min(axis=0))
        self._path[..., 1] = np.maximum(
            self._path[..., 1], np.where(finite, new, -np.inf).max(axis=0))
        for frame in self._frames:
            path = layout.phase_path(self._hamiltonian.coordinates[frame.axis])
            own = points[:, frame.axis]
            for child, columns in (
                    ('trail', rr.LineStrips2D.columns(strips=np.stack([own[:-1], own[1:]], 1))),
                    ('state', rr.Points2D.columns(positions=own[1:]))):
                self._recording.send_columns(f'{path}/{child}', times, columns, strict=True)

    def fit(self) -> None:
        """Draw the still parts again, in frames that hold the paths."""
        self._frames = [
            fitted(frame, self._path[frame.axis], self._boxed)
            if np.isfinite(self._path[frame.axis]).all() else frame for frame in self._frames]
        self._draw()

    def _draw(self) -> None:
        for frame in self._frames:
            layout.log_phase_portrait(
                self._recording, self._hamiltonian, frame, *self._start, self._side)
