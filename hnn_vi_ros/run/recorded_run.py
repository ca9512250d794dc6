# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Run that a bag was recorded from: its scene, its samples, its last state."""

from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
import math
from pathlib import Path
from typing import Any

from hnn_vi_ros.effects import Command
from hnn_vi_ros.errors import did_you_mean, listed, RecordingError
from hnn_vi_ros.files import expand_user, parse_mapping
from hnn_vi_ros.recording import (
    BagReader, decode, decode_state, JOINT_STATE, RecordedMessage, StateMessage, STRING)
from hnn_vi_ros.run.command_messages import COMMAND_TOPICS, REMAPPED
from hnn_vi_ros.run.sampling import nanoseconds_of, stamp_of, steps_between
from hnn_vi_ros.run.saved_state import LAST_STATE_FILE
from hnn_vi_ros.scene import described_scene, ONE_RUN, only_scene, Scene
import numpy as np

# Upper bound on the time between two stamps [ns].
_MAX_SPACING = 2**63
# The last state is searched for in the last part of the bag; increasing lengths of it [ns].
_SEARCH_LENGTHS = (10**9, 10**11, 2**64)


@dataclass(frozen=True)
class ResumePoint:
    """
    The point from which a simulator continues a log.

    A log that was closed keeps the complete state, with which the next steps are those of an
    uninterrupted run. That of a killed process keeps q, p and the time alone: without the memory
    of the solver, steps of an implicit method differ by round-off; the work so far, the random
    numbers drawn and the last command are missing.

    Parameters
    ----------
    scene : Scene
        Recorded scene, whose initial state is the last state of the log.
    step : int
        Number of steps that the run had taken.
    origin : int
        Stamp of step 0 of the run [ns].
    damage : str
        Report on the unreadable parts of the log, '' if there are none.
    state : bytes or None
        Complete last state; see ``restore_state``.

    """

    scene: Scene
    step: int
    origin: int
    damage: str = ''
    state: bytes | None = None


# Name of the energy by cause among the values of a sample.
CAUSES = 'energy by cause'


class RecordedRun:
    """
    A run of the simulator, read from its own bag or from that of another recorder.

    Other recorders stamp messages with their times of arrival. Simulated time is then only in the
    headers, and the bag does not show at which step a command acted.

    Parameters
    ----------
    bag : Path
        A folder with the files of one bag, or one file; a truncated bag is accepted.
    trust_code : bool, optional
        True to allow the execution of Python code that the scene names.
    node : str, optional
        Name of the simulator; required if the bag holds several.

    Attributes
    ----------
    reader : BagReader
        Reader of the bag.
    node : str
        Full name of the simulator.
    scene : Scene
        Simulated scene, in which the integrator auto is replaced by the chosen method.
    channel : int
        Channel of ~/state.
    described : dict
        Recorded scene as a mapping, including the provenance of the model.
    origin, first_step : int
        Stamp of step 0 [ns], and number of the step at the initial state of the scene.

    Raises
    ------
    RecordingError
        The bag cannot be read, does not come from the simulator, or holds several simulators and
        none of that name.

    """

    def __init__(self, bag: Path, trust_code: bool = False, node: str = ''):
        self.reader = BagReader(bag)
        self._topics = own_topics(self.reader)
        self.node = _simulator_name(simulators(self.reader, self._topics), node,
                                    str(self.reader.path))
        self.channel = self._topics[f'{self.node}/state']
        self._where = f'{self.reader.path}: its scene'
        kept = self.reader.attachment('scene.yaml')
        self.scene, self.described = described_scene(
            self._published_scene() if kept is None else kept, self._where, trust_code)
        assert self.scene.step_size is not None, 'a recorded scene has one'
        self._step_size = self.scene.step_size
        self.origin = self._count('origin')
        self.first_step = self._count('first_step')

    @property
    def names(self) -> dict[int, str]:
        """Return the last part of each topic's original name, by channel."""
        return {number: topic.rpartition('/')[2] for topic, number in self._topics.items()}

    def reported(self, first: int = 0) -> Iterator[tuple[int, dict[str, np.ndarray]]]:
        """Yield the stamp [ns] of each sample from a log time on, and arrays of its values."""
        causes = self._causes()
        for state in (sample for _, sample in self.in_order([self.channel], first) if sample):
            values = {'q': state.q, 'p': state.p, 'dp/dt': state.dp_dt,
                      'H': np.array([state.energy]), 'work': np.array([state.work])}
            if state.stamp in causes:
                values[CAUSES] = causes[state.stamp]
            yield state.stamp, values

    def _causes(self) -> dict[int, np.ndarray]:
        """Return the energy by cause at each stamp [ns]; empty if it was not recorded."""
        topic, found = f'{self.node}/energy_by_cause', {}
        channels = [self._topics[topic]] if topic in self._topics and \
            self.scene.energy_by_cause else []
        for message in self.reader.messages(channels):
            own = self.decoded(message, JOINT_STATE)
            found[own.header.stamp.sec * 10**9 + own.header.stamp.nanosec] = own.position
        return found

    def samples(self, first: int = 0) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """Yield the stamp [ns], q and p of each sample from a log time on."""
        for stamp, values in self.reported(first):
            yield stamp, values['q'], values['p']

    def state(self, message: RecordedMessage) -> StateMessage:
        """Decode a message of ~/state to a sample; RecordingError if it is invalid."""
        try:
            return decode_state(message.data)
        except ValueError as problem:
            raise RecordingError(f'{self.reader.path}: the message of {self.node}/state at '
                                 f'{message.time} ns cannot be read: {problem}') from problem

    def decoded(self, message: RecordedMessage, kind: str) -> Any:
        """Decode a message of a type; RecordingError if the bytes are invalid."""
        try:
            return decode(kind, message.data)
        except ValueError as problem:
            topic = self.reader.channels[message.channel].topic
            raise RecordingError(
                f'{self.reader.path}: the message of {topic} at {message.time} ns cannot be '
                f'read: it is not a {kind.rpartition("/")[2]}') from problem

    def in_order(self, channels: Collection[int], first: int = 0
                 ) -> Iterator[tuple[RecordedMessage, StateMessage | None]]:
        """
        Yield messages from a log time on, each with the sample that it holds.

        RecordingError if the time of samples goes back: the bag then holds several runs.
        """
        stamp = -2**63
        for message in self.reader.messages(channels, first):
            state = None
            if message.channel == self.channel:
                state = self.state(message)
                if state.stamp < stamp:
                    raise RecordingError(
                        f'{self.reader.path}: the time of {self.node} goes back, from '
                        f'{stamp * 1e-9:.9g} s to {state.stamp * 1e-9:.9g} s, at log time '
                        f'{message.time} ns: {ONE_RUN}')
                stamp = state.stamp
            yield message, state

    @property
    def stamped(self) -> bool:
        """Return True if log times are stamps of the simulator, as in its own bags."""
        return all(self.state(message).stamp == message.time
                   for message in self.reader.messages([self.channel]))

    def joint_states(self) -> Iterator[Any]:
        """Yield the messages of joint_states; nothing if the bag holds none."""
        topic = f'{self.node.rpartition("/")[0]}/joint_states'
        if topic in self._topics:
            for message in self.reader.messages([self._topics[topic]]):
                yield self.decoded(message, JOINT_STATE)

    def commands(self) -> Iterator[tuple[int, str, Command]]:
        """
        Yield the step from which each command acted, its topic, and the command.

        Nothing is yielded if the bag does not show the steps at which commands acted.
        """
        inputs = {self._topics[name]: one for one in COMMAND_TOPICS
                  if (name := f'{self.node}{one.topic[1:]}') in self._topics}
        if inputs and self.stamped:
            for message in self.reader.messages(inputs):
                one = inputs[message.channel]
                topic = self.reader.channels[message.channel].topic
                try:
                    command = one.read(self.decoded(message, one.kind), message.time)
                except ValueError as problem:
                    if not self.own:
                        continue  # Other recorders also record commands that are refused.
                    raise RecordingError(f'{self.reader.path}: {topic}: {problem}') from problem
                yield self.step_of(message.time), topic, command

    @cached_property
    def own(self) -> bool:
        """Return True if the simulator recorded the bag, which then has all samples of the run."""
        return bool(self.reader.attachment('scene.yaml'))

    @property
    def spacing(self) -> int | None:
        """Return the requested time between two samples [ns]; None if it was not recorded."""
        if (text := self.reader.attachment('parameters.yaml')) is None:
            return None
        where = f'{self.reader.path}: its parameters'
        rate = parse_mapping(text, where, RecordingError)[0].get('publish_rate')
        try:
            if isinstance(rate, float | int) and 0 < rate < math.inf:
                spacing = stamp_of(steps_between(rate, self._step_size), self._step_size)
                if spacing < _MAX_SPACING:
                    return spacing
        except (OverflowError, ZeroDivisionError):
            # The number of steps between two samples, or the stamp, exceeds the range of a float.
            pass
        raise RecordingError(f'{where}: publish_rate is not a valid rate')

    def stamp_of(self, step: int) -> int:
        """Return the stamp of a step [ns]."""
        return stamp_of(step, self._step_size, self.origin)

    def step_of(self, stamp: int) -> int:
        """Return the step of a stamp; RecordingError if the stamp is not that of a whole step."""
        step = round((stamp - self.origin) / nanoseconds_of(self._step_size))
        if self.stamp_of(step) != stamp or step < self.first_step:
            raise RecordingError(
                f'{self.reader.path}: the stamp {stamp} ns is not a whole number of steps of '
                f'{self.scene.step_size:g} s after {self.origin} ns; was the step size changed, '
                'or the time set back, during the recording?')
        return step

    def resumption(self) -> ResumePoint:
        """Return the resumption from the last state; RecordingError if there is none."""
        last = None
        for back in _SEARCH_LENGTHS:
            for last in self.samples(max(0, self.reader.last - back)):  # noqa: B007
                pass
            if last is not None:
                break
        else:
            raise RecordingError(f'{self.reader.path}: contains no state from which to resume')
        stamp, q, p = last
        scene = self.scene.changed({'initial_state': {'q': q.tolist(), 'p': p.tolist()}})
        return ResumePoint(scene, self.step_of(stamp), self.origin, self.reader.damage,
                           self.reader.attachment(LAST_STATE_FILE))

    def _count(self, name: str) -> int:
        value = self.described.get(name, 0)
        if type(value) is not int or not 0 <= value < 2**63:
            raise RecordingError(f'{self._where}: {name} is not a valid count')
        return value

    def _published_scene(self) -> str:
        """Return the text of ~/scene, used for bags without an attached scene."""
        name = f'{self.node}/scene'
        channels = [self._topics[name]] if name in self._topics else []
        return only_scene(((self.decoded(message, STRING).data, message.time) for message
                           in self.reader.messages(channels)), name, self.reader.path)


def simulators(reader: BagReader, topics: dict[str, int]) -> list[str]:
    """
    Return the full names of the simulators of a bag.

    Parameters
    ----------
    reader : BagReader
        Reader of the bag.
    topics : dict
        Channels of the bag by topic; see ``own_topics``.

    Raises
    ------
    RecordingError
        The bag holds no simulator.

    """
    nodes = []
    for topic, number in topics.items():
        schema = reader.schemas.get(reader.channels[number].schema_id)
        if topic.endswith('/state') and schema is not None and schema.name == JOINT_STATE:
            nodes.append(topic.removesuffix('/state'))
    if not nodes:
        raise RecordingError(f'{reader.path}: contains no topic state of a simulator; topics: '
                             f'{listed(sorted(topics)) or "none"}')
    # Other nodes may have a topic of that name, but no scene.
    return sorted(node for node in nodes if f'{node}/scene' in topics) or nodes[:1]


def _simulator_name(nodes: Sequence[str], name: str, where: str) -> str:
    """Return the full name of the requested simulator, or of the only one."""
    if not name and len(nodes) == 1:
        return nodes[0]
    wanted = f'/{name.lstrip("/")}'
    if wanted not in nodes:
        asked = f'contains no simulator {name}{did_you_mean(wanted, nodes)}' if name else \
            f'contains {len(nodes)} simulators, so one must be chosen'
        raise RecordingError(f'{where}: {asked}; simulators: {listed(nodes)}; `replay --verify` '
                             'checks all, `ros2 bag convert` extracts the topics of one')
    return wanted


def resume(bag: str | Path, trust_code: bool = False) -> ResumePoint:
    """Return the point from which a simulator can continue a bag; see RecordedRun."""
    return RecordedRun(expand_user(bag), trust_code).resumption()


def own_topics(reader: BagReader) -> dict[str, int]:
    """
    Return the channels of a bag by topic; a remapped one also has its original name as a key.

    Parameters
    ----------
    reader : BagReader
        Reader of a bag of the simulator, or of another recorder that contains ~/scene.

    """
    topics = {channel.topic: number for number, channel in reader.channels.items()}
    found: dict[str, int] = {}
    for text in _scenes(reader, topics):
        try:
            remapped = parse_mapping(text, reader.path, RecordingError)[0].get(REMAPPED)
        except RecordingError:
            # The code that needs the scene reports its faults.
            continue
        for own, called in (remapped if isinstance(remapped, dict) else {}).items():
            if isinstance(called, str) and called in topics:
                found[own] = topics[called]
    return topics | found


def _scenes(reader: BagReader, topics: dict[str, int]) -> Iterator[bytes | str]:
    """Yield possible texts of scenes: that of the bag, or the first message of each such topic."""
    if (kept := reader.attachment('scene.yaml')) is not None:
        yield kept
        return
    for topic, number in topics.items():
        schema = reader.schemas.get(reader.channels[number].schema_id)
        if topic.endswith('/scene') and schema is not None and schema.name == STRING:
            for message in reader.messages([number]):
                # A message of another type is reported by the code that needs it.
                with suppress(ValueError):
                    yield decode(STRING, message.data).data
                break
