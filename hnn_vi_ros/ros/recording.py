# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The sinks of a run, such as bag and picture: opened, written to, and closed together."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, final, NamedTuple

from hnn_vi_ros.errors import optional, RecordingError
from hnn_vi_ros.files import dump_yaml
from hnn_vi_ros.hamiltonians import MECHANISMS
from hnn_vi_ros.recording import BagTopics, FLUSH_INTERVAL, McapSink, Sample, serialize, Topic
from hnn_vi_ros.ros.plumbing.environment import distribution
from hnn_vi_ros.ros.plumbing.rclpy_internals import Logger
from hnn_vi_ros.ros.settings import Settings
from hnn_vi_ros.run import (
    bag_lines, LAST_STATE_FILE, picture_lines, report_files, RunFiles, Sampler, STATE_FILE,
    state_file, TimingFigures)
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import Simulation
import numpy as np
from std_msgs.msg import String


class RecordingStart(NamedTuple):
    """
    Start of a sink's recording.

    Parameters
    ----------
    scene : Scene
        Scene with the initial state from which the simulation continues.
    simulation : Simulation
        Simulation in its current state.
    report : dict
        Contents of ``~/scene``.
    sampler : Sampler
        Sampler of the time stamps.

    """

    scene: Scene
    simulation: Simulation
    report: dict[str, Any]
    sampler: Sampler


class Sink(ABC):
    """
    A destination that a run is recorded to or displayed by.

    Any method may raise RecordingError, which names the loss: the sink is then not called until
    it is opened again. Samples and other data are passed between ``open`` and ``close``; a sink
    implements the methods that it needs.

    Attributes
    ----------
    name : str
        Key of the target in /diagnostics.
    target : Path, str or int
        Destination while the sink is open: a path, a URL or a port.
    greeting : str
        Line to log once all sinks are open; empty for none.

    """

    name: str
    target: Path | str | int
    greeting: str = ''

    @abstractmethod
    def open(self, begin: RecordingStart) -> bool:  # noqa: A003
        """Begin, also again after ``close``; return True if the sink wants any data."""

    @abstractmethod
    def write(self, sample: Sample, payloads: Sequence[bytes | None]) -> None:
        """Record a sample and its published messages."""

    @abstractmethod
    def close(self) -> None:
        """Complete the recording; makes no ROS call."""

    def write_other(self, topic: Topic, stamp: int, payload: bytes) -> None:
        """Record a message that is not part of each sample."""
        return

    def event(self, text: str, level: str, at: tuple[int, int] | None) -> None:
        """Record a line of text at a stamp [ns] and a step; level is INFO, WARN or ERROR."""
        return

    def timing(self, figures: TimingFigures) -> None:
        """Record the recent cost of steps, and the pace, at the newest sample."""
        return

    def flush(self) -> None:
        """Write out buffered samples, when no sample follows for a while."""
        return

    def files(self) -> list[str]:
        """Return lines with the files created since ``open``, and how to open them."""
        return []


@final
class BagOutput(Sink):
    """
    MCAP bags: one from the start if `record` is set, and others on request.

    Parameters
    ----------
    settings : Settings
        The node's parameters.
    topics : BagTopics
        Topics in the bag.
    files : RunFiles
        Provider of file names.

    """

    name = 'bag'

    def __init__(self, settings: Settings, topics: BagTopics, files: RunFiles):
        self._settings, self._topics, self._files = settings, topics, files
        # Takes effect at the next start of a recording.
        self.wanted = settings.record
        self._bags: list[Path] = []
        self._begin: RecordingStart
        self._begun_at: bytes
        self._sink: McapSink

    def open(self, begin: RecordingStart) -> bool:  # noqa: A003
        self._begin, self._bags = begin, []
        self._begun_at = state_file(begin.simulation)
        if self.wanted:
            self.start()
        return self.wanted

    def start(self) -> None:
        """Start another bag in the current state."""
        scene, simulation, report, sampler = self._begin
        bag = self._files.free(self._settings.record_path, 'bag', scene.name)
        described = dump_yaml(report)
        attachments = {
            'scene.yaml': described.encode(),
            'parameters.yaml': dump_yaml(asdict(self._settings)).encode()}
        # Data that the topics lack: the state after earlier steps, and a command that is held.
        state, held = state_file(simulation), simulation.snapshot()['live.command']
        if state != self._begun_at or held.any() or self._settings.resume:
            attachments[STATE_FILE] = state
        sink = McapSink(bag, self._topics.tick, attachments, distribution() or 'unknown')
        latched = [(self._topics.scene, described)]
        robot = simulation.hamiltonian.robot
        if robot is not None and self._topics.robot is not None:
            latched.append((self._topics.robot, robot.text))
        for topic, text in latched:
            # Stamped with the first state of the bag, from which it applies.
            sink.write_other(topic, sampler.stamp, serialize(String(data=text)))
        sink.flush()
        self._sink, self.target, self.wanted = sink, bag, True
        self._bags.append(bag)
        self.greeting = f'recording to {self.target}'

    def write(self, sample: Sample, payloads: Sequence[bytes | None]) -> None:
        self._sink.write(sample.stamp, payloads)

    def write_other(self, topic: Topic, stamp: int, payload: bytes) -> None:
        self._sink.write_other(topic, stamp, payload)

    def flush(self) -> None:
        self._sink.flush()

    def close(self) -> None:
        self._sink.close({LAST_STATE_FILE: state_file(self._begin.simulation)})

    @property
    def delay(self) -> float:
        """Return the duration of the last write to the disk [s]."""
        return self._sink.delay

    def files(self) -> list[str]:
        return [line for bag in self._bags for line in bag_lines(bag)]


VIEWER_URL = 'rerun+http://127.0.0.1:9876/proxy'
SERVER_PORT = 9876
# Samples displayed per second of wall time.
_FRAME_RATE = 30.0


@final
class PictureOutput(Sink):
    """
    A rerun recording: to a file, to a viewer, or to viewers that connect.

    Parameters
    ----------
    settings : Settings
        The node's parameters.
    box : tuple of np.ndarray, shape (d, 2) each
        Lowest and highest q and p that fit into the picture.
    files : RunFiles
        Provider of a file name.

    """

    name = 'rerun'

    def __init__(self, settings: Settings, box: tuple[np.ndarray, np.ndarray], files: RunFiles):
        self._settings, self._box, self._files = settings, box, files
        self._path: Path | None = None
        if settings.rerun_sink == 'serve':
            self.greeting = f'rerun viewers can connect to {VIEWER_URL}'
        if settings.rerun_sink != 'none':
            # Imported lazily: a run without a picture needs no viewer libraries. An error about
            # missing ones is raised before anything is recorded.
            with optional('rerun', f'rerun_sink = {settings.rerun_sink} (none: no visualisation)'):
                from hnn_vi_ros.recording import RerunSink
            self._make = RerunSink

    def open(self, begin: RecordingStart) -> bool:  # noqa: A003
        settings, (scene, simulation, _, sampler) = self._settings, begin
        if settings.rerun_sink == 'none':
            return False
        if settings.rerun_sink == 'file':
            self._path = self._files.free(settings.rerun_path, 'recording.rrd', scene.name)
            self.target = self._path
        else:
            self.target = SERVER_PORT if settings.rerun_sink == 'serve' else (
                settings.rerun_path or VIEWER_URL)
        pace = settings.real_time_factor
        self._sink = self._make(
            scene.name, self.target, simulation.hamiltonian, simulation.q.copy(),
            simulation.p.copy(), box=self._box,
            mechanism=MECHANISMS[scene.mechanism] if scene.mechanism else None,
            effects=simulation.effects, step_size=simulation.step_size,
            conservative=simulation.conservative,
            causes=simulation.ledger.names if simulation.ledger else (),
            modified=simulation.modified_energy is not None, pace=pace or None,
            band=scene.uncertainty is not None,
            begin=(sampler.stamp, simulation.steps),
            interval=round((pace or 1.0) / _FRAME_RATE * 1e9))
        return True

    def write(self, sample: Sample, payloads: Sequence[bytes | None]) -> None:
        self._sink.write(sample)

    def event(self, text: str, level: str, at: tuple[int, int] | None) -> None:
        self._sink.event(text, level, at)

    def timing(self, figures: TimingFigures) -> None:
        self._sink.timing((figures.microseconds_per_step_median,
                           figures.microseconds_per_step_p99), figures.real_time_factor)

    def close(self) -> None:
        self._sink.close()

    def files(self) -> list[str]:
        return picture_lines(self._path) if self._path is not None else []


class RunRecording:
    """
    Sinks of the samples of a run besides ROS, such as a bag and a picture.

    A sink that fails is closed with an error in the log; the simulation continues, and ``close``
    reports that data are missing.

    Parameters
    ----------
    logger : Logger
        Logger of the node.
    scene : Scene
        The simulated scene.
    simulation : Simulation
        Simulation in its initial state.
    settings : Settings
        The node's parameters.
    topics : BagTopics
        Topics in the bag.
    box : tuple of np.ndarray, shape (d, 2) each
        Lowest and highest q and p that fit into the picture.
    report : dict
        Contents of ~/scene and of the bag's scene.
    sampler : Sampler
        Sampler of the time stamps.

    Attributes
    ----------
    samples : int
        Number of samples since the files were opened.
    problem : str
        Reason for missing data; empty if nothing is missing.

    Raises
    ------
    RecordingError
        A file exists or cannot be created.

    """

    def __init__(self, logger: Logger, scene: Scene, simulation: Simulation,
                 settings: Settings, topics: BagTopics, box: tuple[np.ndarray, np.ndarray],
                 report: dict[str, Any], sampler: Sampler):
        self._logger, self._simulation = logger, simulation
        self.problem = ''
        files = RunFiles()
        self._bag = BagOutput(settings, topics, files)
        # To add a sink, add it here.
        self._sinks: tuple[Sink, ...] = (self._bag, PictureOutput(settings, box, files))
        self._open: list[Sink] = []
        try:
            self._begin(RecordingStart(scene, simulation, report, sampler))
        except BaseException:
            self.close()
            raise

    def renew(self, scene: Scene, report: dict[str, Any], sampler: Sampler) -> None:
        """
        Close the files and continue in new ones next to them; nothing is ever overwritten.

        Parameters
        ----------
        scene : Scene
            Scene with the initial state from which the simulation continues.
        report : dict
            New contents of ~/scene.
        sampler : Sampler
            New sampler of the time stamps.

        """
        self.close(ended=False)
        self.report()
        self._begin(RecordingStart(scene, self._simulation, report, sampler), self._give_up)

    def start_bag(self) -> str:
        """Start a new bag and return its absolute path, or raise RecordingError."""
        if self._bag in self._open:
            raise RecordingError(f'{self._bag.target}: is already being recorded')
        self._bag.start()
        self._open.insert(0, self._bag)
        return str(self._bag.target)

    def stop_bag(self) -> str:
        """Complete the bag and return its absolute path, or raise RecordingError."""
        if self._bag not in self._open:
            raise RecordingError('no bag is being recorded')
        self._open.remove(self._bag)
        self._bag.wanted = False
        try:
            self._bag.close()
        except RecordingError as problem:
            self._give_up(problem)
            raise
        return str(self._bag.target)

    def flush(self) -> None:
        """Flush the files to the operating system, when no sample follows for a while."""
        self._each(lambda sink: sink.flush())

    def write(self, sample: Sample, payloads: Sequence[bytes | None]) -> None:
        """Record and display one sample."""
        self.samples += 1
        self._each(lambda sink: sink.write(sample, payloads))

    def write_other(self, topic: Topic, stamp: int, payload: bytes) -> None:
        """Record a message that is not part of each sample."""
        self._each(lambda sink: sink.write_other(topic, stamp, payload))

    def event(self, text: str, level: str, at: tuple[int, int] | None = None) -> None:
        """Display a line with the samples, at a stamp and a step; level is INFO, WARN or ERROR."""
        self._each(lambda sink: sink.event(text, level, at))

    def timing(self, figures: TimingFigures) -> None:
        """Display the recent cost of steps, and the pace, at the newest sample."""
        self._each(lambda sink: sink.timing(figures))

    def slow_disk(self) -> str:
        """Describe a disk that takes longer to write than the bag waits between; '' if none."""
        delay = self._bag.delay if self._bag in self._open else 0.0
        return f'the disk of {self._bag.target} takes {delay:.2g} s for a write' \
            if delay > FLUSH_INTERVAL else ''

    @property
    def targets(self) -> dict[str, str]:
        """Return the destination of each open sink."""
        return {sink.name: str(sink.target) for sink in self._open}

    def close(self, ended: bool = True) -> bool:
        """Close the open sinks, finally or to continue; return True if everything was recorded."""
        self._each(lambda sink: sink.close(), ended)
        self._open.clear()
        return not self.problem

    def report(self) -> None:
        """Print the paths of the files, and the command that opens each."""
        report_files([line for sink in self._sinks for line in sink.files()])

    def _begin(self, begin: RecordingStart,
               give_up: Callable[[RecordingError], None] | None = None) -> None:
        """Open the sinks; pass errors to `give_up`, or raise them if it is None."""
        self.samples = 0
        for sink in self._sinks:
            try:
                if sink.open(begin):
                    self._open.append(sink)
            except RecordingError as problem:
                if give_up is None:
                    raise
                give_up(problem)
        for sink in self._open:
            if sink.greeting:
                self._logger.info(sink.greeting)

    def _each(self, act: Callable[[Sink], None], ended: bool = False) -> None:
        """Call a function with each open sink; remove a sink that fails."""
        for sink in tuple(self._open):
            try:
                act(sink)
            except RecordingError as problem:
                self._open.remove(sink)
                self._give_up(problem, ended)

    def _give_up(self, problem: RecordingError, ended: bool = False) -> None:
        self.problem = str(problem)
        self._logger.error(self.problem if ended else f'{problem}; the simulation continues')
