# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Send samples to the rerun viewer: to a file, to a running viewer, or as a server."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
import math
import time
from typing import Any, final
import warnings

from hnn_vi_ros.effects import Effect
from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.hamiltonians import (
    Ball, bones, bounds_of, Cuboid, Hamiltonian, Line, Mechanism, Part, Robot, Trail)
from hnn_vi_ros.recording.sample import Sample
from hnn_vi_ros.recording.viewer import rerun_blueprint as layout
from hnn_vi_ros.recording.viewer.phase_portrait import Bounds, ends_of, reach_of
from hnn_vi_ros.recording.viewer.rerun_blueprint import (
    Arrangement, make_blueprint, Series, SeriesExtent)
from hnn_vi_ros.recording.viewer.rerun_entities import (
    bounds_of_path, bounds_of_robot, collisions_of, ForceArrows, Portraits, RobotPicture,
    trails_of)
from hnn_vi_ros.recording.viewer.rerun_stream import RerunStream, Target
import numpy as np
import rerun as rr

# Maximum number of phase portraits that fit into a window.
MOST_PORTRAITS = 8
# Wall time between sends [s], short for a live viewer. A file loses this much when the process is
# killed, at most a tenth of the run; but the SDK keeps some 20 kB of each send for the file's
# index until it is closed, and a send takes 0.2 MB per second: 2.4 MB an hour and 6 MB once.
GATHER_LIVE, GATHER_FILE = 0.15, 0.5
GATHER_SHARE, GATHER_MOST = 0.1, 30.0
# Number of pending samples that triggers a send: an unpaced run produces samples quickly.
MOST_PENDING = 1024


@final
class RerunSink:
    """
    A recording of one run: series of states and energies, phase portraits, mechanism, events.

    A robot from a URDF is drawn by the SDK, with an arrow at each joint with an active motor.
    Arrows on the bodies of a mechanism show the forces of effects; see ForceArrows. The first
    MOST_PORTRAITS coordinates have phase portraits, next to a mechanism only of systems of at most
    MOST_BESIDE coordinates. There are three timelines: ``sim_time``
    (simulated time), ``step`` and ``ros_time``. Samples are thinned out in simulated time and sent
    in batches.

    Parameters
    ----------
    name : str
        Name of the scene; recordings of one name share a layout in the viewer.
    target : Path, str or int
        File to write (must not exist), URL of a viewer (``rerun+http://127.0.0.1:9876/proxy``), or
        port to serve viewers on.
    hamiltonian : Hamiltonian
        H for the contours of the phase portraits, and for the names and units of the series.
    q0, p0 : np.ndarray, shape (d,)
        Initial state.
    box : tuple of np.ndarray, shape (d, 2) each
        Minimum and maximum of q and p of the training data, or of a path.
    mechanism : callable, optional
        Function that draws q; see :mod:`hnn_vi_ros.hamiltonians.mechanisms`.
    effects : sequence of Effect, optional
        Effects of the scene; their forces are shown on the bodies of the mechanism.
    step_size : float
        Step size h [s], for forces that depend on time.
    conservative : bool
        True if no effect does work; otherwise the work is shown.
    modified : bool
        True if a modified energy is known; it is shown if no work is done.
    band : bool
        True if samples have a spread, which is shown as bands around q and p.
    interval : int
        Simulated time between two shown samples [ns]; 0 shows every sample.
    pace : float, optional
        Requested real-time factor.
    begin : tuple of int
        Stamp [ns] and step of the initial state.
    causes : sequence of str
        Names of the energies by cause that samples have.

    Raises
    ------
    RecordingError
        The file exists or cannot be written, no viewer listens, or the port is taken.

    """

    def __init__(self, name: str, target: Target, hamiltonian: Hamiltonian, q0: np.ndarray,
                 p0: np.ndarray, *, box: Bounds,
                 mechanism: Mechanism | None = None, effects: Sequence[Effect] = (),
                 step_size: float = math.nan, conservative: bool = True,
                 modified: bool = True, band: bool = False, interval: int = 33_333_333,
                 pace: float | None = None, begin: tuple[int, int] = (0, 0),
                 causes: Sequence[str] = ()):
        self._coordinates, self._mechanism = hamiltonian.coordinates, mechanism
        # For a rotating body, coordinates and momenta do not pair up in planes. A plane of more
        # than two coordinates shows little of the motion, and leaves a mechanism little room.
        most = 0 if hamiltonian.rotations else MOST_PORTRAITS
        if mechanism is not None or hamiltonian.robot is not None:
            most = most if len(self._coordinates) <= layout.MOST_BESIDE else 0
        self._portrayed = self._coordinates[:most]
        self._robot = hamiltonian.robot
        self._picture: RobotPicture | None = None
        self._interval, self._due = max(1, interval), 0
        self._begin = begin
        self._pending: list[Sample] = []
        # Stamp, step, microseconds per step (median and p99), real-time factor.
        self._timings: list[tuple[int, int, tuple[float, float], float]] = []
        # The newest sample, and the newest one selected for display.
        self._newest: Sample | None = None
        self._kept: Sample | None = None
        self._reach = 0.0
        # Effects, h, their arrows, and the arrows that have a style.
        self._effects, self._step_size = effects, step_size
        self._forces: ForceArrows | None = None
        self._arrows: set[str] = set()
        # End of each trail by name.
        self._trails: dict[str, np.ndarray] = {}
        # Stamp, step, text and level.
        self._events: list[tuple[int, int, str, str]] = []
        # Extent of the sent data: first and last stamp [ns], minimum and maximum by entity.
        self._times_shown: tuple[int, int] | None = None
        self._values_shown: dict[str, tuple[float, float]] = {}
        # Bounds of everything drawn [m].
        self._bounds_shown: np.ndarray | None = None
        self._closed = False
        self._stream = RerunStream(f'hnn_vi_ros_{name}', target)
        relative = float(hamiltonian.energy(q0, p0)) != 0.0
        self._series = [*layout.series_of(
            hamiltonian, relative, conservative, modified, band, causes)]
        self._draw_still(hamiltonian, q0, p0, box, pace)
        self._began = self._sent_at = time.monotonic()

    def write(self, sample: Sample) -> None:
        """Show a sample, unless one in the same interval has been shown."""
        self._newest = sample
        if sample.stamp < self._due:
            return
        # Align to a grid of the interval, which keeps the mean rate for any rate of samples.
        self._due = (sample.stamp // self._interval + 1) * self._interval
        self._kept = sample
        self._pending.append(sample)
        if len(self._pending) == MOST_PENDING:
            self._send()
        else:
            self._send_if_due()

    def event(self, text: str, level: str = 'INFO', at: tuple[int, int] | None = None) -> None:
        """Show an event at a stamp [ns] and step, by default of the newest sample."""
        if self._closed:
            raise RecordingError('the rerun recording is closed; open a new one')
        newest = (self._newest.stamp, self._newest.step) if self._newest else self._begin
        self._events.append((*(at or newest), text, level))
        if self._stream.live:
            self._send_events()
        else:
            self._send_if_due()

    def timing(self, microseconds_per_step: tuple[float, float], real_time_factor: float) -> None:
        """Show the wall time of a step [us], median and p99, and the real-time factor if paced."""
        if self._newest is not None and np.isfinite(real_time_factor):
            self._timings.append((self._newest.stamp, self._newest.step,
                                  microseconds_per_step, real_time_factor))
        # If no sample follows, this is the last call, and sends pending samples.
        self._send_if_due()

    def close(self) -> None:
        """
        Send the pending data with the newest sample, and close the target within a second.

        Closing again does nothing.

        Raises
        ------
        RecordingError
            Some data are lost, because the viewer is gone or the disk is full.

        """
        if self._closed:
            return
        if self._newest is not None and self._newest is not self._kept:
            self._pending.append(self._newest)
        self._closed = True
        try:
            self._send()
            if not self._stream.live and self._times_shown is not None:
                # When the file is opened, frames, axes and camera fit its content.
                self._portraits.fit()
                self._stream.send_blueprint(self._blueprint(
                    self._arrangement if self._bounds_shown is None else
                    replace(self._arrangement, bounds=self._bounds_shown),
                    extent=SeriesExtent(self._times_shown, self._values_shown)))
        finally:
            self._stream.close()

    def _gather(self) -> float:
        """Return the wall time from the last send to the next [s]."""
        if self._stream.live:
            return GATHER_LIVE
        share = GATHER_SHARE * (self._sent_at - self._began)
        return min(max(GATHER_FILE, share), GATHER_MOST)

    def _draw_still(self, hamiltonian: Hamiltonian, q0: np.ndarray, p0: np.ndarray,
                    box: Bounds, pace: float | None) -> None:
        shown = self._portrayed
        parts, bounds = {}, None
        if self._mechanism is not None:
            ends = ends_of(hamiltonian, q0, box)
            self._reach = reach_of(hamiltonian, ends)
            parts = self._mechanism(ends, self._reach)
            bounds = bounds_of(parts)
            if not hamiltonian.rotations:
                self._forces = ForceArrows(
                    self._effects, hamiltonian, self._mechanism, self._step_size, self._reach,
                    0.5 * float(np.ptp(bounds, axis=0).max()))
        hidden = ''
        if self._robot is not None:
            own, hidden = bounds_of_robot(self._robot), collisions_of(self._robot)
            bounds = _union_of_boxes(own, bounds)
            parts |= trails_of(self._robot, self._bones(self._robot, q0[None]))
        self._arrangement = Arrangement(len(shown), bounds, hidden)
        self._blueprint = partial(
            make_blueprint, shown, self._series, interval=self._interval, pace=pace,
            trails=[name for name, part in parts.items() if isinstance(part, Trail)])
        self._stream.send_blueprint(self._blueprint(self._arrangement))
        recording = self._stream.recording
        layout.log_series_styles(recording, [*self._series, *layout.TIMING])
        self._portraits = Portraits(
            recording, hamiltonian, q0, p0, box, len(shown), self._arrangement.side)
        if parts:
            layout.log_mechanism_styles(recording, parts)
        if self._robot is not None:
            self._picture = self._draw_robot(self._robot)

    def _bones(self, robot: Robot, q: np.ndarray) -> dict[str, np.ndarray]:
        return bones(robot, [coordinate.name for coordinate in self._coordinates], q)

    def _draw_robot(self, robot: Robot) -> RobotPicture | None:
        """Draw the robot; if the SDK fails, report it and show the rest."""
        names = [coordinate.name for coordinate in self._coordinates]
        try:
            picture = RobotPicture(robot, names, self._stream.recording)
        except RecordingError as problem:
            self._events.append((*self._begin, str(problem), 'WARN'))
            return None
        if picture.problem:
            self._events.append((*self._begin, picture.problem, 'WARN'))
            warnings.warn(picture.problem, stacklevel=4)
        return picture

    def _send_if_due(self) -> None:
        if self._sent_at + self._gather() <= time.monotonic():
            self._send()

    def _send(self) -> None:
        samples, self._pending = self._pending, []
        self._sent_at = time.monotonic()
        self._stream.check()
        self._send_events()
        self._send_timings()
        if not samples:
            return
        times = self._times([s.stamp for s in samples], [s.step for s in samples])
        q, p = np.array([s.q for s in samples]), np.array([s.p for s in samples])
        first = samples[0].stamp if self._times_shown is None else self._times_shown[0]
        self._times_shown = first, samples[-1].stamp
        self._send_series(self._series, times, samples)
        self._portraits.send(times, q, p)
        if self._mechanism is not None:
            self._send_mechanism(times, self._mechanism(q, self._reach))
        if self._forces is not None:
            self._send_forces(self._forces, times, samples)
        if self._robot is not None:
            places = self._bones(self._robot, q)
            self._show(bounds_of_path(places))
            if trails := trails_of(self._robot, places):
                self._send_mechanism(times, trails)
        if self._picture is not None:
            driven = any(s.motors is not None for s in samples)
            self._picture.send(times, q, np.array([
                np.zeros(q.shape[1]) if s.motors is None else s.motors for s in samples])
                if driven else None)

    def _send_events(self) -> None:
        events, self._events = self._events, []
        if events:
            stamps, steps, texts, levels = (list(column) for column in zip(*events, strict=True))
            self._columns('/events', self._times(stamps, steps),
                          rr.TextLog.columns(text=texts, level=levels))

    def _send_timings(self) -> None:
        timings, self._timings = self._timings, []
        if timings:
            stamps, steps, *_ = zip(*timings, strict=True)
            self._send_series(layout.TIMING, self._times(list(stamps), list(steps)), timings)

    def _send_series(self, rows: Sequence[Series], times: list[rr.TimeColumn],
                     samples: Sequence[Any]) -> None:
        """Send the values of series, and extend their known ranges."""
        for row in rows:
            values = np.array([row.value(sample) for sample in samples])
            finite = values[np.isfinite(values)]
            if finite.size:
                low, high = self._values_shown.get(row.path, (np.inf, -np.inf))
                self._values_shown[row.path] = (min(low, float(finite.min())),
                                                max(high, float(finite.max())))
            self._columns(row.path, times, rr.Scalars.columns(
                scalars=values.reshape(-1)).partition([len(row.names)] * len(values)))

    def _show(self, bounds: np.ndarray) -> None:
        """Extend the known bounds of the picture; NaN is ignored."""
        if np.isfinite(bounds).all():
            self._bounds_shown = _union_of_boxes(bounds, self._bounds_shown)

    def _send_mechanism(self, times: list[rr.TimeColumn], parts: dict[str, Part]) -> None:
        self._show(bounds_of(parts))
        for name, part in parts.items():
            if isinstance(part, Trail):
                # The segments up to the new points.
                before = self._trails.get(name, part.point[0])
                points = np.vstack([before, part.point])
                self._trails[name] = points[-1]
                self._columns(layout.part_path(name), times, rr.LineStrips3D.columns(
                    strips=np.stack([points[:-1], points[1:]], axis=1)))
            elif part.moves:
                self._columns(layout.part_path(name), times, _pose_columns(part))

    def _send_forces(self, forces: ForceArrows, times: list[rr.TimeColumn],
                     samples: Sequence[Sample]) -> None:
        found = dict(forces.columns(samples))
        if new := [name for name in found if name not in self._arrows]:
            self._arrows.update(new)
            self._events.append((samples[0].stamp, samples[0].step, forces.legend(new), 'INFO'))
            self._send_events()
        for name, columns in found.items():
            path = f'/world/forces/{rr.escape_entity_path_part(name)}'
            if name in new:
                self._stream.recording.log(path, forces.style(name), static=True, strict=True)
            self._columns(path, times, columns)

    def _times(self, stamps: list[int], steps: list[int]) -> list[rr.TimeColumn]:
        stamp = np.array(stamps, dtype=np.int64)
        return [rr.TimeColumn('sim_time', duration=stamp.astype('timedelta64[ns]')),
                rr.TimeColumn('step', sequence=steps),
                rr.TimeColumn('ros_time', timestamp=stamp.astype('datetime64[ns]'))]

    def _columns(self, path: str, times: list[rr.TimeColumn], columns: rr.ComponentColumnList
                 ) -> None:
        self._stream.recording.send_columns(path, times, columns, strict=True)


def _union_of_boxes(one: np.ndarray, other: np.ndarray | None) -> np.ndarray:
    """Return the corners of the union of two boxes, of shape (2, 3) each."""
    if other is None:
        return one
    return np.array([np.minimum(one[0], other[0]), np.maximum(one[1], other[1])])


def _pose_columns(part: Line | Cuboid | Ball) -> rr.ComponentColumnList:
    if isinstance(part, Line):
        return rr.LineStrips3D.columns(strips=part.points)
    kind = rr.Ellipsoids3D if isinstance(part, Ball) else rr.Boxes3D
    return kind.columns(centers=part.center)
