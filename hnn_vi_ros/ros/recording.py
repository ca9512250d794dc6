# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The files of a run: its MCAP bag and its rerun recording."""

from collections.abc import Sequence
import os
from pathlib import Path
import shlex
import shutil
import sys

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.mechanisms import MECHANISMS
from hnn_vi_ros.ros.run_folder import create_run_folder
from hnn_vi_ros.ros.scene_report import resolved_scene
from hnn_vi_ros.ros.timing import Figures
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.sinks.bag_metadata import Topic
from hnn_vi_ros.sinks.mcap_sink import McapSink
from hnn_vi_ros.sinks.sample import Sample
import numpy as np
from rclpy.impl.rcutils_logger import RcutilsLogger
import yaml

_VIEWER_URL = 'rerun+http://127.0.0.1:9876/proxy'
_SERVER_PORT = 9876
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
    values : dict
        The node's parameters.
    topics : sequence of Topic
        What the bag holds.
    box : tuple of np.ndarray, shape (d, 2) each
        Lowest and highest q and p that the picture leaves room for.

    Attributes
    ----------
    samples : int
        Samples that were handed in.
    problem : str
        Why something is missing; empty as long as nothing is.

    Raises
    ------
    RecordingError
        A file exists or cannot be created.

    """

    def __init__(self, logger: RcutilsLogger, scene: Scene, simulation: Simulation,
                 values: dict, topics: Sequence[Topic],
                 box: tuple[np.ndarray, np.ndarray]):
        self._logger = logger
        self.samples, self.problem = 0, ''
        self._bag: Path | None = None
        self._picture: Path | None = None
        self._choose_files(scene.name, values)
        self._bag_sink = self._open_bag(scene, simulation, values, topics)
        try:
            self._picture_sink = self._open_picture(scene, simulation, values, box)
        except BaseException:
            self._picture_sink = None
            self.close()
            raise

    def write(self, sample: Sample, payloads: Sequence[bytes]) -> None:
        """Record and show one sample."""
        self.samples += 1
        if self._bag_sink is not None:
            try:
                self._bag_sink.write(sample.stamp, payloads)
            except RecordingError as problem:
                self._bag_sink = None
                self._give_up(problem)
        if self._picture_sink is not None:
            try:
                self._picture_sink.write(sample)
            except RecordingError as problem:
                self._picture_sink = None
                self._give_up(problem)

    def write_other(self, topic: Topic, stamp: int, payload: bytes) -> None:
        """Record a message that does not come with each sample."""
        if self._bag_sink is not None:
            try:
                self._bag_sink.write_other(topic, stamp, payload)
            except RecordingError as problem:
                self._bag_sink = None
                self._give_up(problem)

    def event(self, text: str, level: str) -> None:
        """Show an event beside the samples; level is INFO, WARN or ERROR."""
        if self._picture_sink is not None:
            self._picture_sink.event(text, level)

    def timing(self, figures: Figures) -> None:
        """Show what steps cost lately, and the pace, at the newest sample."""
        if self._picture_sink is not None:
            self._picture_sink.timing(
                (figures.microseconds_per_step_median, figures.microseconds_per_step_p99),
                figures.real_time_factor)

    @property
    def targets(self) -> dict[str, str]:
        """Return where bag and picture go, as far as there are any."""
        targets = {'bag': self._bag, 'rerun': self._target}
        return {name: str(target) for name, target in targets.items() if target is not None}

    def close(self) -> bool:
        """Close what is open; tell whether everything was recorded."""
        sinks = [self._bag_sink, self._picture_sink]
        self._bag_sink = self._picture_sink = None
        for sink in sinks:
            if sink is not None:
                try:
                    sink.close()
                except RecordingError as problem:
                    self._give_up(problem)
        return not self.problem

    def report(self) -> None:
        """Print where the files are, and the command that opens each."""
        lines = []
        if self._bag is not None:
            file = self._bag / f'{self._bag.name}_0.mcap'
            lines.append(f'bag        {self._bag}')
            if shutil.which('ros2'):
                lines.append(f'  open it  {_command("ros2", "bag", "play", self._bag)}')
            lines.append(f'  open it  {_command(_rerun(), file)}')
        if self._picture is not None:
            lines.append(f'recording  {self._picture}')
            lines.append(f'  open it  {_command(_rerun(), self._picture)}')
        if lines:
            sys.stdout.write('\n'.join(lines) + '\n')
            sys.stdout.flush()

    def _choose_files(self, scene: str, values: dict) -> None:
        bag, picture = values['record_path'], values['rerun_path']
        to_file = values['rerun_sink'] == 'file'
        folder = Path()
        if (values['record'] and not bag) or (to_file and not picture):
            folder = create_run_folder(scene)
        if values['record']:
            self._bag = Path(os.path.expanduser(bag)) if bag else folder / 'bag'
        if to_file:
            default = folder / 'recording.rrd'
            self._picture = Path(os.path.expanduser(picture)) if picture else default
        self._target = {'file': self._picture, 'serve': _SERVER_PORT, 'none': None,
                        'connect': picture or _VIEWER_URL}[values['rerun_sink']]

    def _open_bag(self, scene: Scene, simulation: Simulation, values: dict,
                  topics: Sequence[Topic]) -> McapSink | None:
        if self._bag is None:
            return None
        attachments = {
            'scene.yaml': resolved_scene(scene, simulation), 'parameters.yaml': values}
        return McapSink(self._bag, topics, {
            name: yaml.safe_dump(data, sort_keys=False).encode()
            for name, data in attachments.items()})

    def _open_picture(self, scene: Scene, simulation: Simulation, values: dict,
                      box: tuple[np.ndarray, np.ndarray]):
        if self._target is None:
            return None
        # Imported here: a run without a picture starts without the viewer's libraries.
        from hnn_vi_ros.sinks.rerun_sink import RerunSink
        if values['rerun_sink'] == 'serve':
            self._logger.info(f'rerun viewers can connect to {_VIEWER_URL}')
        mechanism = MECHANISMS[scene.mechanism] if scene.mechanism else None
        return RerunSink(scene.name, self._target, simulation.hamiltonian, simulation.q.copy(),
                         simulation.p.copy(), box=box, mechanism=mechanism,
                         conservative=simulation.conservative,
                         modified=simulation.modified_energy is not None,
                         pace=values['real_time_factor'] or None,
                         interval=round((values['real_time_factor'] or 1.0) / _FRAME_RATE * 1e9))

    def _give_up(self, problem: RecordingError) -> None:
        self.problem = str(problem)
        self._logger.error(f'{problem}; the simulation goes on')


def _rerun() -> Path | str:
    """Return the viewer that is installed beside this interpreter, or its name on the PATH."""
    beside = Path(sys.prefix) / 'bin' / 'rerun'
    if not beside.exists():
        return 'rerun'
    here = os.path.relpath(beside)
    return beside if here.startswith('..') else here


def _command(*words: object) -> str:
    return shlex.join(str(word) for word in words)
