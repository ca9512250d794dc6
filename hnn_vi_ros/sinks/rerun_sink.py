# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Show samples in the rerun viewer: to a file, to a running viewer, or as a server."""

from pathlib import Path
import socket
import threading
import time
from typing import final
from urllib.parse import urlsplit

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.mechanisms.parts import bounds_of, Line, Mechanism
from hnn_vi_ros.sinks import rerun_layout as layout
from hnn_vi_ros.sinks.phase_portrait import frames_of, reach_of
from hnn_vi_ros.sinks.rerun_blueprint import Arrangement, make_blueprint
from hnn_vi_ros.sinks.sample import Sample
import numpy as np
import rerun as rr

Target = Path | str | int
# More phase portraits would not fit into a window.
MOST_PORTRAITS = 8
# Wall time between sends [s]. A viewer should not lag; a file is half the size with longer
# gathering, and still loses less than a second when the process is killed. It grows with a long
# run, up to a bound: of each send the SDK keeps some 20 kB, for the index at the file's end.
GATHER_LIVE, GATHER_FILE = 0.15, 0.5
GATHER_SHARE, GATHER_MOST = 0.01, 15.0
# What closing may take [s]: for the last samples to leave, for the connection to end.
FLUSH, HANG_UP = 0.5, 0.3


@final
class RerunSink:
    """
    A recording of one run: state and energy series, phase portraits, the mechanism, events.

    Phase portraits are drawn of the first MOST_PORTRAITS coordinates. Three timelines:
    ``sim_time`` (simulated time), ``step`` and ``ros_time``. Samples are thinned out in
    simulated time and gathered for a moment of wall time between sends.

    Parameters
    ----------
    name : str
        Name of the scene; recordings of one name share a layout in the viewer.
    target : Path, str or int
        A file to write (must not exist), the URL of a viewer to connect to
        (``rerun+http://127.0.0.1:9876/proxy``), or the port to serve viewers on.
    hamiltonian : Hamiltonian
        H, for the contours of the phase portraits and the names and units of the series.
    q0, p0 : np.ndarray, shape (d,)
        Initial state.
    box : tuple of np.ndarray, shape (d, 2) each, optional
        Lowest and highest q and p of the training data.
    mechanism : callable, optional
        What to draw for q; see :mod:`hnn_vi_ros.mechanisms`.
    conservative : bool
        Whether no effect does work; else the work is shown.
    modified : bool
        Whether a modified energy is known, to be shown where no work is done.
    interval : int
        Simulated time between two samples that are shown [ns]; 0 shows every sample.
    pace : float, optional
        The real-time factor that is asked for.
    epoch : int
        ROS time at the start of the run [ns].

    Raises
    ------
    RecordingError
        The file exists or cannot be written, no viewer listens, or the port is taken.

    """

    def __init__(self, name: str, target: Target, hamiltonian: Hamiltonian, q0: np.ndarray,
                 p0: np.ndarray, *, box: tuple[np.ndarray, np.ndarray] | None = None,
                 mechanism: Mechanism | None = None, conservative: bool = True,
                 modified: bool = True, interval: int = 33_333_333,
                 pace: float | None = None, epoch: int = 0):
        self._coordinates, self._mechanism = hamiltonian.coordinates, mechanism
        self._interval, self._epoch, self._due = max(1, interval), epoch, 0
        self._pending: list[Sample] = []
        # Stamp, step, microseconds per step (median and p99), real-time factor.
        self._timings: list[tuple[int, int, tuple[float, float], float]] = []
        # The newest sample, the newest that is to be shown, the newest that was sent.
        self._newest: Sample | None = None
        self._kept: Sample | None = None
        self._sent: Sample | None = None
        self._reach = 0.0
        self._live = not isinstance(target, Path)
        self._closed = False
        self._stream = rr.RecordingStream(f'hnn_vi_ros_{name}')
        _open(self._stream, target)
        relative = float(hamiltonian.energy(q0, p0)) != 0.0
        self._labels = layout.series_labels(
            self._coordinates, relative, conservative, modified)
        self._draw_still(hamiltonian, q0, p0, box, pace)
        self._began = self._sent_at = time.monotonic()

    def write(self, sample: Sample) -> None:
        """Show a sample, unless it falls in the same interval as the one shown before it."""
        self._newest = sample
        if sample.stamp < self._due:
            return
        # On the grid of the interval, so that the mean rate holds for any rate of samples.
        self._due = (sample.stamp // self._interval + 1) * self._interval
        self._kept = sample
        self._pending.append(sample)
        if self._sent_at + self._gather() <= time.monotonic():
            self._send()

    def event(self, text: str, level: str = 'INFO') -> None:
        """Show a line of text at the time of the newest sample; level INFO, WARN or ERROR."""
        stamp, step = (self._newest.stamp, self._newest.step) if self._newest else (0, 0)
        self._columns('/events', self._times([stamp], [step]),
                      rr.TextLog.columns(text=[text], level=[level]))

    def timing(self, microseconds_per_step: tuple[float, float], real_time_factor: float
               ) -> None:
        """Show the wall time of a step [us], median and p99, and the pace, if there is one."""
        if self._newest is not None and np.isfinite(real_time_factor):
            self._timings.append((self._newest.stamp, self._newest.step,
                                  microseconds_per_step, real_time_factor))

    def close(self) -> None:
        """
        Send what is left, the newest sample included, and close the target within a second.

        Closing again does nothing.

        Raises
        ------
        RecordingError
            Not everything was taken, because the viewer is gone or the disk is full.

        """
        if self._closed:
            return
        if self._newest is not None and self._newest is not self._kept:
            self._pending.append(self._newest)
        self._send()
        self._closed = True
        try:
            self._stream.flush(timeout_sec=FLUSH)
        except RuntimeError as problem:
            raise RecordingError(f'the end of the rerun recording is lost: {problem}') \
                from problem
        finally:
            _hang_up(self._stream, self._live)

    def _gather(self) -> float:
        """Return the wall time from the last send to the next [s]."""
        if self._live:
            return GATHER_LIVE
        share = GATHER_SHARE * (self._sent_at - self._began)
        return min(max(GATHER_FILE, share), GATHER_MOST)

    def _draw_still(self, hamiltonian: Hamiltonian, q0: np.ndarray, p0: np.ndarray,
                    box: tuple[np.ndarray, np.ndarray] | None, pace: float | None) -> None:
        shown = hamiltonian.coordinates[:MOST_PORTRAITS]
        framed = hamiltonian.dimension if self._mechanism is not None else len(shown)
        frames = frames_of(hamiltonian, q0, p0, box, framed)
        parts, bounds = {}, None
        if self._mechanism is not None:
            self._reach = reach_of(frames)
            ends = np.array([frame.q for frame in frames]).T
            parts = self._mechanism(ends, self._reach)
            bounds = bounds_of(parts)
        arrangement = Arrangement(len(shown), bounds)
        self._stream.send_blueprint(
            make_blueprint(shown, self._labels, arrangement, self._interval, pace))
        layout.log_series_styles(self._stream, self._labels | layout.TIMING)
        for frame in frames[:len(shown)]:
            layout.log_phase_portrait(
                self._stream, hamiltonian, frame, q0, p0, arrangement.side)
        if parts:
            layout.log_mechanism_styles(self._stream, parts)

    def _send(self) -> None:
        samples, self._pending = self._pending, []
        self._sent_at = time.monotonic()
        self._send_timings()
        if not samples:
            return
        times = self._times([s.stamp for s in samples], [s.step for s in samples])
        q, p = np.array([s.q for s in samples]), np.array([s.p for s in samples])
        series = {'/state/q': q, '/state/p': p,
                  '/energy/H': [s.energy for s in samples],
                  '/energy/modified': [s.modified_energy for s in samples],
                  '/energy/work': [s.work for s in samples],
                  '/energy/error': [s.energy_error for s in samples]}
        for path in self._labels:
            self._columns(path, times, _scalars(np.asarray(series[path])))
        self._send_portraits(times, samples, q, p)
        if self._mechanism is not None:
            self._send_mechanism(times, q)
        self._sent = samples[-1]

    def _send_timings(self) -> None:
        timings, self._timings = self._timings, []
        if timings:
            stamps, steps, *series = zip(*timings, strict=True)
            times = self._times(list(stamps), list(steps))
            for path, values in zip(layout.TIMING, series, strict=True):
                self._columns(path, times, _scalars(np.array(values)))

    def _send_portraits(self, times: list[rr.TimeColumn], samples: list[Sample], q: np.ndarray,
                        p: np.ndarray) -> None:
        """Add to each trail the segments that lead to the new points."""
        before = self._sent or samples[0]
        points = np.stack([np.vstack([before.q, q]), np.vstack([before.p, p])], axis=-1)
        for axis, coordinate in enumerate(self._coordinates[:MOST_PORTRAITS]):
            path = layout.phase_path(coordinate)
            segments = np.stack([points[:-1, axis], points[1:, axis]], axis=1)
            self._columns(f'{path}/trail', times, rr.LineStrips2D.columns(strips=segments))
            self._columns(f'{path}/state', times, rr.Points2D.columns(positions=points[1:, axis]))

    def _send_mechanism(self, times: list[rr.TimeColumn], q: np.ndarray) -> None:
        for name, part in self._mechanism(q, self._reach).items():
            if part.moves:
                columns = rr.LineStrips3D.columns(strips=part.points) \
                    if isinstance(part, Line) else rr.Boxes3D.columns(centers=part.center)
                self._columns(layout.part_path(name), times, columns)

    def _times(self, stamps: list[int], steps: list[int]) -> list[rr.TimeColumn]:
        stamp = np.array(stamps, dtype=np.int64)
        return [rr.TimeColumn('sim_time', duration=stamp.astype('timedelta64[ns]')),
                rr.TimeColumn('step', sequence=steps),
                rr.TimeColumn('ros_time',
                              timestamp=(self._epoch + stamp).astype('datetime64[ns]'))]

    def _columns(self, path: str, times: list[rr.TimeColumn], columns: rr.ComponentColumnList
                 ) -> None:
        if self._closed:
            raise RecordingError('the rerun recording is closed; open a new one')
        self._stream.send_columns(path, times, columns, strict=True)


def _scalars(values: np.ndarray) -> rr.ComponentColumnList:
    """Make one row a sample, of shape (n,) or (n, d)."""
    columns = rr.Scalars.columns(scalars=values.reshape(-1))
    return columns if values.ndim == 1 else columns.partition([values.shape[1]] * len(values))


def _open(stream: rr.RecordingStream, target: Target) -> None:
    try:
        if isinstance(target, Path):
            target.parent.mkdir(parents=True, exist_ok=True)
            # Creating it here, exclusively, is what keeps an existing file from being overwritten.
            target.open('xb').close()
            stream.save(target)
        elif isinstance(target, str):
            _check_viewer(target)
            stream.connect_grpc(target)
        else:
            _check_port(target)
            stream.serve_grpc(grpc_port=target)
            stream.flush(timeout_sec=FLUSH)
    except FileExistsError as problem:
        raise RecordingError(f'{target}: exists and is not overwritten; choose another '
                             'rerun_path') from problem
    except (OSError, RuntimeError, ValueError, OverflowError) as problem:
        raise RecordingError(f'{target}: cannot record for rerun there: {problem}') from problem


def _check_viewer(url: str) -> None:
    """Knock first: connecting to a viewer that is not there takes the SDK five seconds."""
    parts = urlsplit(url)
    if parts.scheme not in ('rerun', 'rerun+http', 'rerun+https') or not parts.hostname:
        raise RecordingError(f'{url}: no address of a rerun viewer; it looks like '
                             'rerun+http://127.0.0.1:9876/proxy')
    port = parts.port or {'rerun+http': 80}.get(parts.scheme, 443)
    try:
        socket.create_connection((parts.hostname, port), timeout=2.0).close()
    except OSError as problem:
        raise RecordingError(f'{url}: no rerun viewer listens there ({problem}); '
                             'start one with: rerun') from problem


def _check_port(port: int) -> None:
    """Bind it once: the SDK only logs that a port is taken."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind(('', port))


def _hang_up(stream: rr.RecordingStream, live: bool) -> None:
    """Close the target; a viewer that is gone would keep the caller waiting for ten seconds."""
    if not live:
        stream.disconnect()
        return
    waiter = threading.Thread(target=stream.disconnect, daemon=True)
    waiter.start()
    waiter.join(HANG_UP)
