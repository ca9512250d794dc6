# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The files of a run: its MCAP bag and its rerun recording."""

from collections.abc import Sequence
from dataclasses import asdict
import os
from pathlib import Path
from typing import Any

from hnn_vi_ros.bags.bag_metadata import BagTopics, Topic
from hnn_vi_ros.bags.mcap_sink import McapSink
from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files.yaml_text import dump_yaml
from hnn_vi_ros.mechanisms import MECHANISMS
from hnn_vi_ros.ros.parameters import Settings
from hnn_vi_ros.run.held_state import STATE_FILE, state_file
from hnn_vi_ros.run.run_folder import create_run_folder
from hnn_vi_ros.run.sampling import Sampler
from hnn_vi_ros.run.serialization import serialize
from hnn_vi_ros.run.timing import Figures
from hnn_vi_ros.run.told_files import tell_files
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.sample import Sample
import numpy as np
from rclpy.impl.rcutils_logger import RcutilsLogger
from std_msgs.msg import String

VIEWER_URL = 'rerun+http://127.0.0.1:9876/proxy'
SERVER_PORT = 9876
# Samples that the picture shows, per second of wall time.
_FRAME_RATE = 30.0


class Recording:
    """
    Where the samples of a run go besides ROS: a bag, a rerun recording, both or neither.

    A sink that fails is given up with an error in the log; the simulation goes on, and
    ``close`` says that something is missing.

    Parameters
    ----------
    logger : RcutilsLogger
        The node's.
    scene : Scene
        What is simulated.
    simulation : Simulation
        In its initial state.
    settings : Settings
        The node's parameters.
    topics : BagTopics
        What the bag holds.
    box : tuple of np.ndarray, shape (d, 2) each
        Lowest and highest q and p that the picture leaves room for.
    report : dict
        What ~/scene tells, and the bag.
    sampler : Sampler
        Whose stamps count.

    Attributes
    ----------
    samples : int
        Samples that were handed in since the files were opened.
    problem : str
        Why something is missing; empty as long as nothing is.

    Raises
    ------
    RecordingError
        A file exists or cannot be created.

    """

    def __init__(self, logger: RcutilsLogger, scene: Scene, simulation: Simulation,
                 settings: Settings, topics: BagTopics, box: tuple[np.ndarray, np.ndarray],
                 report: dict[str, Any], sampler: Sampler):
        self._logger, self._simulation = logger, simulation
        self._settings, self._topics, self._box = settings, topics, box
        self.problem = ''
        self._bag_wanted = settings.record
        self._home, self._folder = _working_folder(), None
        self._used: set[Path] = set()
        self._choose_files(scene, report, sampler)
        try:
            self._open_bag()
            self._open_picture()
            self._tell_bag()
        except BaseException:
            self.close()
            raise

    def renew(self, scene: Scene, report: dict[str, Any], sampler: Sampler) -> None:
        """
        Close the files and go on in new ones, beside them; nothing is ever overwritten.

        Parameters
        ----------
        scene : Scene
            With the initial state from which the simulation goes on.
        report : dict
            What ~/scene tells from now on.
        sampler : Sampler
            Whose stamps count from now on.

        """
        self.close(ended=False)
        self.report()
        self._choose_files(scene, report, sampler)
        for sink in (self._open_bag, self._open_picture):
            try:
                sink()
            except RecordingError as problem:
                self._give_up(problem)
        self._tell_bag()

    def start_bag(self) -> str:
        """Begin a new bag and return its absolute path, or raise RecordingError."""
        if self._bag_sink is not None:
            raise RecordingError(f'{self._bags[-1]}: is being recorded already')
        self._bags.append(self._free_bag())
        self._bag_wanted = True
        try:
            self._open_bag()
        except RecordingError:
            self._bags.pop()
            self._bag_wanted = False
            raise
        return str(self._bags[-1])

    def stop_bag(self) -> str:
        """Complete the bag and return its absolute path, or raise RecordingError."""
        if self._bag_sink is None:
            raise RecordingError('no bag is being recorded')
        sink, self._bag_sink, self._bag_wanted = self._bag_sink, None, False
        try:
            sink.close()
        except RecordingError as problem:
            self._give_up(problem)
            raise
        return str(self._bags[-1])

    def flush(self) -> None:
        """Hand the bag to the operating system, where no sample follows for a while."""
        if self._bag_sink is not None:
            try:
                self._bag_sink.flush()
            except RecordingError as problem:
                self._bag_sink = None
                self._give_up(problem)

    def write(self, sample: Sample, payloads: Sequence[bytes]) -> None:
        """Record and show one sample."""
        self.samples += 1
        if self._bag_sink is not None:
            try:
                self._bag_sink.write(sample.stamp, payloads)
            except RecordingError as problem:
                self._bag_sink = None
                self._give_up(problem)
        self._show('write', sample)

    def write_other(self, topic: Topic, stamp: int, payload: bytes) -> None:
        """Record a message that does not come with each sample."""
        if self._bag_sink is not None:
            try:
                self._bag_sink.write_other(topic, stamp, payload)
            except RecordingError as problem:
                self._bag_sink = None
                self._give_up(problem)

    def event(self, text: str, level: str, at: tuple[int, int] | None = None) -> None:
        """Show a line beside the samples, at a stamp and a step; level is INFO, WARN or ERROR."""
        self._show('event', text, level, at)

    def timing(self, figures: Figures) -> None:
        """Show what steps cost lately, and the pace, at the newest sample."""
        self._show('timing', (figures.microseconds_per_step_median,
                              figures.microseconds_per_step_p99), figures.real_time_factor)

    @property
    def targets(self) -> dict[str, str]:
        """Return where bag and picture go, as far as there are any."""
        bag = self._bags[-1] if self._bag_sink is not None else None
        picture = self._target if self._picture_sink is not None else None
        return {name: str(target) for name, target in {'bag': bag, 'rerun': picture}.items()
                if target is not None}

    def close(self, ended: bool = True) -> bool:
        """Close what is open, at the end or to go on; tell whether everything was recorded."""
        sinks = [self._bag_sink, self._picture_sink]
        self._bag_sink = self._picture_sink = None
        for sink in sinks:
            if sink is not None:
                try:
                    sink.close()
                except RecordingError as problem:
                    self._give_up(problem, ended)
        return not self.problem

    def report(self) -> None:
        """Print where the files are, and the command that opens each."""
        tell_files(self._bags, self._picture)

    def _show(self, what: str, *values: Any) -> None:
        """Call the picture's method of a name, if there is a picture."""
        if self._picture_sink is not None:
            try:
                getattr(self._picture_sink, what)(*values)
            except RecordingError as problem:
                self._picture_sink = None
                self._give_up(problem)

    def _choose_files(self, scene: Scene, report: dict[str, Any], sampler: Sampler) -> None:
        """Choose names; the first ones as they were asked for, later ones with a number."""
        self._scene, self._report, self._sampler = scene, report, sampler
        self.samples = 0
        self._bag_sink = self._picture_sink = None
        picture, sink = self._settings.rerun_path, self._settings.rerun_sink
        self._bags = [self._free_bag()] if self._bag_wanted else []
        self._picture = self._free(picture, 'recording.rrd') if sink == 'file' else None
        self._target = {'file': self._picture, 'serve': SERVER_PORT, 'none': None,
                        'connect': picture or VIEWER_URL}[sink]

    def _free_bag(self) -> Path:
        return self._free(self._settings.record_path, 'bag')

    def _free(self, asked: str, default: str) -> Path:
        """Return the path asked for or a default one, numbered if it is one of ours already."""
        if not asked and self._folder is None:
            self._folder = create_run_folder(self._scene.name, self._home)
        first = self._home / os.path.expanduser(asked) if asked else self._folder / default
        path, number = first, 1
        while path in self._used or (number > 1 and path.exists()):
            number += 1
            path = first.with_name(f'{first.stem}-{number}{first.suffix}')
        self._used.add(path)
        return path

    def _open_bag(self) -> None:
        if not self._bag_wanted:
            return
        scene = dump_yaml(self._report)
        attachments = {
            'scene.yaml': scene.encode(),
            'parameters.yaml': dump_yaml(asdict(self._settings)).encode()}
        if self._simulation.steps != self._report['first_step']:
            attachments[STATE_FILE] = state_file(self._simulation)
        sink = McapSink(self._bags[-1], self._topics.tick, attachments)
        # Stamped with the state that the bag begins at, from which on it acts.
        sink.write_other(
            self._topics.scene, self._sampler.stamp, serialize(String(data=scene)))
        sink.flush()
        self._bag_sink = sink

    def _open_picture(self) -> None:
        scene, simulation, settings = self._scene, self._simulation, self._settings
        if self._target is None:
            return
        # Imported here: a run without a picture starts without the viewer's libraries.
        from hnn_vi_ros.viewer.rerun_sink import RerunSink
        if settings.rerun_sink == 'serve':
            self._logger.info(f'rerun viewers can connect to {VIEWER_URL}')
        mechanism = MECHANISMS[scene.mechanism] if scene.mechanism else None
        pace = settings.real_time_factor
        self._picture_sink = RerunSink(
            scene.name, self._target, simulation.hamiltonian, simulation.q.copy(),
            simulation.p.copy(), box=self._box, mechanism=mechanism,
            conservative=simulation.conservative,
            modified=simulation.modified_energy is not None, pace=pace or None,
            begin=(self._sampler.stamp, simulation.steps),
            interval=round((pace or 1.0) / _FRAME_RATE * 1e9))

    def _tell_bag(self) -> None:
        if self._bag_sink is not None:
            self._logger.info(f'recording to {self._bags[-1]}')

    def _give_up(self, problem: RecordingError, ended: bool = False) -> None:
        self.problem = str(problem)
        self._logger.error(self.problem if ended else f'{problem}; the simulation goes on')


def _working_folder() -> Path:
    """Return the absolute path that others are relative to; an empty one if it was removed."""
    try:
        return Path.cwd()
    except FileNotFoundError:
        return Path()
