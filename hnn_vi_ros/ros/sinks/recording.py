# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The sinks of a run: opened, written to, and given up together."""

from collections.abc import Callable, Sequence
from typing import Any

from hnn_vi_ros.bags.bag_metadata import BagTopics, Topic
from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.ros.parameters.settings import Settings
from hnn_vi_ros.ros.plumbing.rclpy_internals import Logger
from hnn_vi_ros.ros.sinks.bag_output import BagOutput
from hnn_vi_ros.ros.sinks.picture_output import PictureOutput
from hnn_vi_ros.run.run_folder import report_files, RunFiles
from hnn_vi_ros.run.sampling import Sampler
from hnn_vi_ros.run.sinks import Beginning, Sink
from hnn_vi_ros.run.timing import Figures
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.sample import Sample
import numpy as np


class Recording:
    """
    Sinks of the samples of a run besides ROS, such as a bag and a picture.

    A sink that fails is given up with an error in the log; the simulation continues, and
    ``close`` says that something is missing.

    Parameters
    ----------
    logger : Logger
        The node's.
    scene : Scene
        The simulated scene.
    simulation : Simulation
        In its initial state.
    settings : Settings
        The node's parameters.
    topics : BagTopics
        Topics in the bag.
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

    def __init__(self, logger: Logger, scene: Scene, simulation: Simulation,
                 settings: Settings, topics: BagTopics, box: tuple[np.ndarray, np.ndarray],
                 report: dict[str, Any], sampler: Sampler):
        self._logger, self._simulation = logger, simulation
        self.problem = ''
        files = RunFiles()
        self._bag = BagOutput(settings, topics, files)
        # A new sink is one more here.
        self._sinks: tuple[Sink, ...] = (self._bag, PictureOutput(settings, box, files))
        self._open: list[Sink] = []
        try:
            self._begin(Beginning(scene, simulation, report, sampler))
        except BaseException:
            self.close()
            raise

    def renew(self, scene: Scene, report: dict[str, Any], sampler: Sampler) -> None:
        """
        Close the files and continue in new ones next to them; nothing is ever overwritten.

        Parameters
        ----------
        scene : Scene
            With the initial state from which the simulation continues.
        report : dict
            What ~/scene tells from now on.
        sampler : Sampler
            Whose stamps count from now on.

        """
        self.close(ended=False)
        self.report()
        self._begin(Beginning(scene, self._simulation, report, sampler), self._give_up)

    def start_bag(self) -> str:
        """Begin a new bag and return its absolute path, or raise RecordingError."""
        if self._bag in self._open:
            raise RecordingError(f'{self._bag.target}: is being recorded already')
        self._bag.start()
        self._open.insert(0, self._bag)
        return self._bag.target

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
        return self._bag.target

    def flush(self) -> None:
        """Hand the files to the operating system, where no sample follows for a while."""
        self._each(lambda sink: sink.flush())

    def write(self, sample: Sample, payloads: Sequence[bytes]) -> None:
        """Record and show one sample."""
        self.samples += 1
        self._each(lambda sink: sink.write(sample, payloads))

    def write_other(self, topic: Topic, stamp: int, payload: bytes) -> None:
        """Record a message that does not come with each sample."""
        self._each(lambda sink: sink.write_other(topic, stamp, payload))

    def event(self, text: str, level: str, at: tuple[int, int] | None = None) -> None:
        """Show a line with the samples, at a stamp and a step; level is INFO, WARN or ERROR."""
        self._each(lambda sink: sink.event(text, level, at))

    def timing(self, figures: Figures) -> None:
        """Show what steps cost lately, and the pace, at the newest sample."""
        self._each(lambda sink: sink.timing(figures))

    @property
    def targets(self) -> dict[str, str]:
        """Return where each open sink goes."""
        return {sink.name: sink.target for sink in self._open}

    def close(self, ended: bool = True) -> bool:
        """Close what is open, at the end or to continue; return whether all was recorded."""
        self._each(lambda sink: sink.close(), ended)
        self._open.clear()
        return not self.problem

    def report(self) -> None:
        """Print where the files are, and the command that opens each."""
        report_files([line for sink in self._sinks for line in sink.files()])

    def _begin(self, begin: Beginning,
               give_up: Callable[[RecordingError], None] | None = None) -> None:
        """Open what is wanted; without someone who takes them, errors are raised."""
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
        """Do something with each open sink; one that fails is given up."""
        for sink in tuple(self._open):
            try:
                act(sink)
            except RecordingError as problem:
                self._open.remove(sink)
                self._give_up(problem, ended)

    def _give_up(self, problem: RecordingError, ended: bool = False) -> None:
        self.problem = str(problem)
        self._logger.error(self.problem if ended else f'{problem}; the simulation goes on')
