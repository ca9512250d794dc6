# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What a bag tells of the run that it was recorded from: its scene, its states, its last one."""

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from hnn_vi_ros.choices import AutoChoice
from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.scene_origin import Origin
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.sinks.mcap_reader import BagReader
from hnn_vi_ros.yaml_file import validate
from hnn_vi_ros.yaml_text import parse_mapping
import numpy as np
from rclpy.serialization import deserialize_message
from std_msgs.msg import Float64MultiArray

# How far back from its end a bag is searched for its last state, each time farther [ns].
_BACK = (10**9, 10**11, 2**64)


@dataclass(frozen=True)
class Resumption:
    """
    From where a simulator goes on that is to continue a log.

    Of the run before, the log keeps the state (q, p) and the time. It keeps no solver memory, so
    that an implicit method's next steps differ from those of an unbroken run by round-off; nor
    the work so far, the random numbers drawn, or the last command.

    Parameters
    ----------
    scene : Scene
        The recorded one, its initial state the last state of the log.
    step : int
        Steps that the run had taken.
    origin : int
        Stamp of its step 0 [ns].
    parameters : dict
        The node's parameters, as they were recorded.

    """

    scene: Scene
    step: int
    origin: int
    parameters: dict[str, Any]

    def simulation(self) -> Simulation:
        """Return a simulation that stands where the log ends; HnnViRosError if none can be."""
        simulation = Simulation.from_scene(self.scene)
        state = self.scene.initial_state
        simulation.restart(state.q, state.p, step=self.step)
        return simulation


class RecordedRun:
    """
    A run of the simulator, read from its bag.

    Parameters
    ----------
    bag : Path
        A folder with the files of one bag, or one file; one that was cut off will do.
    trust_code : bool, optional
        Whether Python code that its scene names may be run.

    Attributes
    ----------
    reader : BagReader
        Of the bag.
    scene : Scene
        What was simulated, without the integrator auto.
    described : dict
        The scene as it was recorded, with where its model came from.
    origin, first_step : int
        Stamp of step 0 [ns], and the step at the scene's initial state.

    Raises
    ------
    RecordingError
        The bag cannot be read, or does not come from the simulator.

    """

    def __init__(self, bag: Path, trust_code: bool = False):
        self.reader = BagReader(bag)
        self.scene, self.described = described_scene(
            self.reader.attachment('scene.yaml'), self._where('scene.yaml'), trust_code)
        self.origin = self._count('origin')
        self.first_step = self._count('first_step')
        self._nanoseconds = Fraction(repr(self.scene.step_size)) * 10**9
        self._channels = self._find_channels()

    def samples(self, first: int = 0) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """Yield stamp [ns], q and p of each sample from a stamp on."""
        stamp, found = -1, {}
        for message in self.reader.messages(self._channels, first):
            if message.time != stamp:
                stamp, found = message.time, {}
            found[self._channels[message.channel]] = message.data
            if len(found) == 2:
                yield stamp, _array(found['q']), _array(found['p'])

    def step_of(self, stamp: int) -> int:
        """Return the step of a stamp; RecordingError if it is not that of a whole one."""
        step = round((stamp - self.origin) / self._nanoseconds)
        if self.origin + round(step * self._nanoseconds) != stamp or step < self.first_step:
            raise RecordingError(
                f'{self.reader.path}: the stamp {stamp} ns is no whole number of steps of '
                f'{self.scene.step_size:g} s from {self.origin} ns; was the step size changed, or '
                'the time set back, while it was recorded?')
        return step

    def resumption(self) -> Resumption:
        """Return what goes on from the last state; RecordingError if there is none."""
        last = None
        for back in _BACK:
            for last in self.samples(max(0, self.reader.last - back)):
                pass
            if last is not None:
                break
        else:
            raise RecordingError(f'{self.reader.path}: holds no state to go on from')
        stamp, q, p = last
        scene = self.scene.changed({'initial_state': {'q': q.tolist(), 'p': p.tolist()}})
        parameters, _ = parse_mapping(self.reader.attachment('parameters.yaml'),
                                      self._where('parameters.yaml'), RecordingError)
        return Resumption(scene, self.step_of(stamp), self.origin, parameters)

    def _where(self, attachment: str) -> str:
        return f'{self.reader.path}: its {attachment}'

    def _count(self, name: str) -> int:
        value = self.described.get(name, 0)
        if type(value) is not int or not 0 <= value < 2**63:
            raise RecordingError(f'{self._where("scene.yaml")}: {name} is no count')
        return value

    def _find_channels(self) -> dict[int, str]:
        topics = {channel.topic: number for number, channel in self.reader.channels.items()}
        for name, number in topics.items():
            node, _, last = name.rpartition('/')
            if last == 'q' and f'{node}/p' in topics:
                return {number: 'q', topics[f'{node}/p']: 'p'}
        raise RecordingError(f'{self.reader.path}: holds no topics q and p of one simulator; '
                             f'topics: {", ".join(sorted(topics)) or "none"}')


def described_scene(text: bytes | str, where: str, trust_code: bool = False
                    ) -> tuple[Scene, dict[str, Any]]:
    """
    Return the scene that a log or ~/scene describes, and all that is told with it.

    Whoever wrote it chooses none of what is run, or opened, here: code that it names is refused
    unless it is trusted, and then comes from the path of Python's modules alone; model files are
    those that the digests told with it belong to.

    Parameters
    ----------
    text : bytes or str
        YAML.
    where : str
        What describes it, for errors.
    trust_code : bool, optional
        Whether Python code that it names may be run.

    Raises
    ------
    RecordingError
        It is no scene, or names code; one line.

    """
    described, places = parse_mapping(text, where, RecordingError)
    fields = {name: value for name, value in described.items() if name in Scene.model_fields}
    scene = validate(fields, places, Scene, RecordingError, trust_code=trust_code)
    if isinstance(scene.integrator, AutoChoice):
        raise RecordingError(f'{places.place("integrator")}: does not say what auto chose')
    # Where models beside the scene are found again.
    source = str(described.get('source', 'scene'))
    files = described.get('model_files', {})
    digests = [described.get('model_sha256'), *(files.values() if isinstance(files, dict) else ())]
    scene._origin = Origin(
        Path(source if source.isprintable() else 'scene'), places,
        digests=frozenset(digest for digest in digests if isinstance(digest, str)))
    return scene, described


def resume(bag: str | Path, trust_code: bool = False) -> Resumption:
    """Return what a simulator needs to go on from the last state of a bag; see RecordedRun."""
    return RecordedRun(Path(bag).expanduser(), trust_code).resumption()


def _array(data: bytes) -> np.ndarray:
    return np.array(deserialize_message(data, Float64MultiArray).data)
