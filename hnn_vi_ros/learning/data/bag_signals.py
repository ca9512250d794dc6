# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Read joint signals from topics of ROS 2 bags: joint states and arrays."""

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, partial
import logging
from pathlib import Path
from typing import final, TypeVar

from hnn_vi_ros.errors import DataError, listed, RecordingError
from hnn_vi_ros.files import parse_mapping
from hnn_vi_ros.learning.data.sqlite_bag import SqliteBag
from hnn_vi_ros.recording import (
    ARRAY, bag_files, BagReader, decode, decode_float64_multi_array, decode_joint_state,
    decode_joint_trajectory, is_sqlite, JOINT_STATE, MOMENTUM, qos_profiles, RecordedMessage,
    STRING, TRAJECTORY)
from hnn_vi_ros.run import STATE_FILE
import numpy as np
import safetensors
import safetensors.numpy
from scipy.interpolate import CubicHermiteSpline

# Time between samples of the path of a trajectory [s].
_PATH_STEP = 0.01
# Message types allowed for a topic of states.
STATES = f'{ARRAY} or {JOINT_STATE}'
# Largest difference between log times and stamps that agree, in mean intervals.
_DISAGREEMENT = 0.01
# Size of a jump away and back in usual steps, and the number of jumps that triggers a warning.
_JUMP, _JUMPS = 10.0, 3

_LOGGER = logging.getLogger(__name__)

Decoded = TypeVar('Decoded')


def joint_names(path: Path) -> list[str]:
    """
    Return the joints in the first joint states of a bag.

    Joints that follow others are left out where ~/state of a simulator shows which have momenta.
    """
    reader = SignalReader(path, ())
    names, state = reader.names_in('joint_states'), reader.state_topic()
    momenta = () if state is None else reader.names_in(state)
    return [name for name in names if MOMENTUM + name in momenta] or names


@final
class SignalReader:
    """
    Reader of joint signals in a bag; truncated bags are accepted.

    Parameters
    ----------
    path : Path
        Folder with the files of one bag, or one file.
    joints : sequence of str
        Names of the joints in the order of the coordinates.
    columns : sequence of int
        Indices of the joints' numbers in an array; empty for all.

    Attributes
    ----------
    bag : BagReader or SqliteBag
        The open bag.
    stamps : str
        ``'header'`` or ``'log'``: source of the message times. It may be set before the first
        signal is read.

    Raises
    ------
    DataError
        The path is not a bag, or the bag is empty.

    """

    def __init__(self, path: Path, joints: Sequence[str], columns: Sequence[int] = ()):
        try:
            files = bag_files(path)
            self.bag = SqliteBag(path, files) if is_sqlite(files[0]) else BagReader(path)
        except RecordingError as problem:
            raise DataError(str(problem)) from problem
        self.path = self.bag.path
        self._joints, self._columns, self.stamps = tuple(joints), list(columns), 'header'
        self._origin: int | None = None
        self._topics: dict[str, list[int]] = {}
        for number, channel in self.bag.channels.items():
            # Writers without ROS may omit the slash at the start.
            self._topics.setdefault(f'/{channel.topic.lstrip("/")}', []).append(number)
        if not any(self.bag.messages()):
            raise DataError(f'{self.path}: contains no messages; record while something moves')

    @property
    def commanded_before(self) -> bool:
        """Return whether a simulator held a command at the start that the bag does not contain."""
        try:
            state = safetensors.numpy.load(self.bag.attachment(STATE_FILE) or b'')
        except (safetensors.SafetensorError, ValueError, KeyError):
            return False
        return 'live.command' in state and bool(state['live.command'].any())

    def type_of(self, topic: str) -> str:
        """Return the type of a topic; raise DataError if it is missing."""
        return self._messages_of(topic)[1]

    def has_topic(self, topic: str) -> bool:
        """Return whether the bag holds a topic of exactly this name."""
        return topic in self._topics

    def state_topic(self) -> str | None:
        """Return the ~/state topic of a simulator with the joints; None unless it is unique."""
        found = [topic for topic in self._topics
                 if topic.endswith('/state') and self.is_state(topic)]
        return found[0] if len(found) == 1 else None

    def is_state(self, topic: str) -> bool:
        """Return whether a topic is the ~/state of a simulator with the joints."""
        names = self.names_in(topic) if self.type_of(topic) == JOINT_STATE else []
        return bool(names) and {MOMENTUM + joint for joint in self._joints} <= {*names}

    def names_in(self, topic: str) -> list[str]:
        """Return the names in the first joint states of a topic."""
        name, _, messages = self._messages_of(topic, JOINT_STATE)
        first = next(messages, None)
        return [] if first is None else list(self._decode(name, first, decode_joint_state).names)

    def check_resets(self, state: str) -> None:
        """
        Raise DataError if a simulator was reset while its ~/state, this topic, was recorded.

        The samples before and after a reset are not of one motion.
        """
        scene = _scene_of(self._messages_of(state)[0])
        times: dict[bytes, int] = {}
        for message in self.bag.messages(self._topics.get(scene, [])):
            times.setdefault(message.data, message.time)
        if len(times) > 1:
            resets = ', '.join(map(str, list(times.values())[1:4]))
            raise DataError(f'{self.path}: the run was reset at log time {resets} ns; split the '
                            'bag there with `mcap filter`, and list the parts in data.paths; the '
                            'simulator starts a new bag at each reset')

    def check_clocks(self, topic: str, unstamped: str) -> None:
        """
        Raise DataError if the log times of joint states differ from their stamps.

        Messages of a topic without stamps could then not be assigned to states.
        """
        times = np.array([
            (message.time, self._decode(topic, message, decode_joint_state).stamp)
            for message in self._messages_of(topic)[2]])
        log, stamps = (times - times[:1]).T * 1e-9
        largest = np.abs(log - stamps).max(initial=0.0)
        if largest > _DISAGREEMENT * stamps.max(initial=0.0) / max(len(stamps) - 1, 1):
            raise DataError(
                f'{self.path}: {topic} has time stamps, {unstamped} does not, and the recording '
                f'times differ from the stamps by up to {largest:.3g} s, so their messages cannot '
                'be paired. Use ~/state of the simulator, whose q and p have one stamp (data.p: '
                'state); data.stamps: log uses the recording times as they are')

    def warn_of_publishers(self, topic: str, q: np.ndarray) -> None:
        """
        Warn if messages of a topic seem to come from several publishers.

        Parameters
        ----------
        topic : str
            Full name, or a suffix that matches one topic only.
        q : np.ndarray, shape (N, d)
            Positions of the joints in the order of the recording, with angles unwrapped.

        """
        name = self._messages_of(topic)[0]
        offered = max(len(qos_profiles(self.bag.channels[number].metadata.get(
            'offered_qos_profiles', ''))) for number in self._topics[name])
        jumps = _count_jumps(q[np.isfinite(q).all(axis=1)])
        seen = [f'it has {offered} publishers'] if offered > 1 else []
        if jumps >= _JUMPS:
            seen.append(f'positions jump away and back in {jumps} of its {len(q)} messages')
        if seen and not np.isnan(q).any():
            _LOGGER.warning(
                'warning: %s: %s: %s; if two nodes publish the same joints, record one of them, '
                'or remap the other', self.path, name, ', and '.join(seen))

    def read(self, topic: str, prefix: str = '', expected: str = STATES
             ) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the messages of a topic that contain at least one of the joints.

        Parameters
        ----------
        topic : str
            Full name, or a suffix that matches one topic only.
        prefix : str
            Prefix of the joint names in joint states.
        expected : str
            Allowed types, separated by ``or``.

        Returns
        -------
        t : np.ndarray, shape (N,)
            Times since the first message [s], in recording order: late messages come late.
        values : np.ndarray, shape (N, 3, d)
            Positions, velocities and efforts of joint states, NaN where a message lacks a joint;
            all three are equal for an array.

        Raises
        ------
        DataError
            The topic is missing, has another type, or a message cannot be read.

        """
        name, kind, messages = self._messages_of(topic, expected)
        if kind == ARRAY:
            found = [(message.time, self._from_array(name, message)) for message in messages]
            values = np.array([row for _, row in found]).reshape(-1, 1, len(self._joints))
            return self._times(name, [stamp for stamp, _ in found]), values.repeat(3, axis=1)
        stamps, rows, seen = self._joint_rows(name, prefix)
        for joint in self._joints:
            if prefix + joint not in seen:
                raise DataError(f'{self.path}: {name} has no joint {prefix + joint!r}; its joints:'
                                f' {listed(sorted(seen)) or "none"}')
        values = np.array(rows)
        there = np.isfinite(values[:, 0])
        if there.any(axis=0).all() and not there.all(axis=1).any():
            raise DataError(f'{self.path}: no message of {name} contains all of '
                            f'{listed(self._joints)}; only nodes merge partial states: record '
                            'complete ones, such as those of a single joint state broadcaster')
        return self._times(name, stamps), values

    def forces(self, topic: str, columns: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """
        Return all commands of a topic, including incomplete ones.

        Parameters
        ----------
        topic : str
            Full name of the topic, or a suffix that matches one topic only; it holds joint states
            with efforts, or arrays.
        columns : sequence of int
            Indices of the forces in an array; empty for all.

        Returns
        -------
        t : np.ndarray, shape (N,)
            As in ``read``.
        values : np.ndarray, shape (N, m)
            Efforts of the joints, or numbers of an array; NaN where a message lacks the effort of
            a joint, or an array has an unusual length.

        Raises
        ------
        DataError
            The topic is missing, has another type, or a message cannot be read.

        """
        name, kind, messages = self._messages_of(topic, STATES)
        if kind == JOINT_STATE:
            stamps, rows, _ = self._joint_rows(name)
            efforts = np.array([effort for _, _, effort in rows]).reshape(-1, len(self._joints))
            return self._times(name, stamps), efforts
        found = [(message.time, self._decode(name, message, decode_float64_multi_array))
                 for message in messages]
        lengths = [len(values) for _, values in found]
        usual = max(set(lengths), key=lengths.count, default=0)
        values = np.array([values if len(values) == usual else np.full(usual, np.nan)
                           for _, values in found]).reshape(-1, usual)
        if columns:
            if max(columns) >= usual:
                raise DataError(f'{self.path}: {name}: a message has {usual} numbers, but '
                                f'data.columns contains the index {max(columns)} (zero-based)')
            values = values[:, columns]
        return self._times(name, [stamp for stamp, _ in found]), values

    def command_topics(self) -> list[str]:
        """Return the topics of commanded positions of the joints, by types and names."""
        state, found = self.state_topic(), []
        for topic in self._topics:
            kind, name = self._type(self._topics[topic][0]), topic.rpartition('/')[2]
            named = name in ('command', 'commands', 'joint_commands') \
                and not {'effort', 'velocity'} & {*topic.replace('/', '_').split('_')}
            if kind == TRAJECTORY or (kind == ARRAY and named and state is None) or (
                    kind == JOINT_STATE and named and {*self.names_in(topic)} >= {*self._joints}
                    and np.isfinite(self.read(topic)[1][:, 0]).any()):
                found.append(topic)
        self._origin = None
        return found

    def positions_commanded(self, topic: str, columns: Sequence[int]
                            ) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the positions that a topic commands, shapes (N,) and (N, d), each until the next.

        A trajectory begins at its log time, at the last position commanded, and is sampled along
        its splines until the next one.
        """
        if self.type_of(topic) == JOINT_STATE:
            t, values = self.read(topic)
            return t, values[:, 0]
        if self.type_of(topic) == ARRAY:
            return self.forces(topic, columns)
        name, _, messages = self._messages_of(topic, TRAJECTORY)
        paths = [(message.time, *self._decode(name, message, decode_joint_trajectory))
                 for message in messages]
        starts = self._times(name, [stamp for stamp, _, _ in paths])
        times, rows = [np.zeros(0)], [np.zeros((0, len(self._joints)))]
        for (_, names, points), start, end in zip(paths, starts, [*starts[1:], np.inf],
                                                  strict=True):
            if not points or not {*self._joints} <= {*names}:
                continue
            order = [names.index(joint) for joint in self._joints]
            ends = np.array([time for time, _, _ in points])
            knots = np.array([own for _, own, _ in points])[:, order]
            slopes = np.array([own for _, _, own in points])[:, order] if all(
                len(own) for _, _, own in points) else None
            if ends[0] > 0.0:
                first = rows[-1][-1:] if len(rows[-1]) else knots[:1]
                ends, knots = np.append(0.0, ends), np.concatenate([first, knots])
                slopes = None if slopes is None else np.concatenate([0.0 * slopes[:1], slopes])
            at = np.append(np.arange(0.0, min(ends[-1], end - start), _PATH_STEP), ends[-1])
            at = at[at < end - start]
            rows.append(CubicHermiteSpline(ends, knots, slopes)(at) if slopes is not None
                        and len(ends) > 1 else np.stack([
                            np.interp(at, ends, one) for one in knots.T], axis=1))
            times.append(start + at)
        return np.concatenate(times), np.concatenate(rows)

    def _joint_rows(self, name: str, prefix: str = ''
                    ) -> tuple[list[int], list[list[list[float]]], set[str]]:
        """Return the stamps and values of a topic's messages, and all joint names in them."""
        names = [prefix + joint for joint in self._joints]
        stamps, rows, seen = [], [], set[str]()
        for message in self._messages_of(name)[2]:
            state = self._decode(name, message, decode_joint_state)
            seen.update(state.names)
            places = [state.names.index(one) if one in state.names else None for one in names]
            if any(place is not None for place in places):  # else from another driver
                stamps.append(state.stamp if self.stamps == 'header' else message.time)
                rows.append([[
                    np.nan if place is None or len(values) != len(state.names) else values[place]
                    for place in places]
                    for values in (state.position, state.velocity, state.effort)])
        return stamps, rows, seen

    def _times(self, name: str, stamps: list[int]) -> np.ndarray:
        """Return the times since step 0 of a simulator, or since the signal read first [s]."""
        if len(stamps) > 1 and len(set(stamps)) == 1:
            other = 'header' if self.stamps == 'log' else \
                'log, the recording times of the messages'
            raise DataError(f'{self.path}: {name}: all its stamps are {stamps[0]} ns; use '
                            f'data.stamps: {other}')
        if self._origin is None and stamps:
            self._origin = self._step_0 if self._step_0 is not None else stamps[0]
        origin = self._origin or 0
        return np.array([stamp - origin for stamp in stamps]) * 1e-9

    @cached_property
    def _step_0(self) -> int | None:
        """Return the stamp of step 0 of the simulator that wrote the bag [ns], None of others."""
        text = self.bag.attachment('scene.yaml') or self._published_scene()
        if text is None:
            return None
        described, _ = parse_mapping(text, f'{self.path}: its scene', DataError)
        origin = described.get('origin', 0)
        if type(origin) is not int or not 0 <= origin < 2**63:
            raise DataError(f'{self.path}: its scene: origin is not a valid count')
        return origin

    def _published_scene(self) -> str | None:
        """Return the first scene of the only ~/state, as other recorders keep it."""
        state = self.state_topic()
        if state is None:
            return None
        topic = _scene_of(state)
        first = next(self.bag.messages(self._topics.get(topic, [])), None)
        return None if first is None else self._decode(
            topic, first, partial(decode, STRING)).data

    def _messages_of(self, topic: str, expected: str = ''
                     ) -> tuple[str, str, Iterator[RecordedMessage]]:
        """Return name, type and messages of the one topic that has this name or ends with it."""
        topic = '/' + topic.lstrip('/')
        if topic not in self._topics:
            found = [name for name in self._topics if name.endswith(topic)]
            if len(found) != 1:
                what = 'no topic' if not found else f'{len(found)} topics'
                choose = '; give the full name of one' if found else ''
                raise DataError(f'{self.path}: contains {what} {topic}; it contains: '
                                f'{self._contents()}{choose}')
            topic = found[0]
        numbers = self._topics[topic]
        kind = self._type(numbers[0])
        if expected and kind not in expected.split(' or '):
            raise DataError(f'{self.path}: {topic} has the type {kind}, expected {expected}; the '
                            f'bag contains: {self._contents()}')
        return topic, kind, self.bag.messages(numbers)

    def _contents(self) -> str:
        return listed(sorted({f'{topic} ({self._type(number)})' for topic, numbers
                              in self._topics.items() for number in numbers})) or 'nothing'

    def _type(self, number: int) -> str:
        schema = self.bag.schemas.get(number)
        return 'unknown type' if schema is None else schema.name

    def _from_array(self, topic: str, message: RecordedMessage) -> np.ndarray:
        values = self._decode(topic, message, decode_float64_multi_array)
        if not self._columns and len(values) == len(self._joints):
            return values
        if not self._columns or max(self._columns) >= len(values):
            raise DataError(f'{self.path}: {topic}: a message has {len(values)} numbers, expected '
                            f'{len(self._joints)}, one for each of data.joints; select them with '
                            'data.columns (zero-based)')
        return values[self._columns]

    def _decode(self, topic: str, message: RecordedMessage, decode: Callable[[bytes], Decoded]
                ) -> Decoded:
        try:
            return decode(message.data)
        except (ValueError, UnicodeDecodeError) as problem:
            raise DataError(f'{self.path}: {topic}: the message at {message.time} ns cannot be '
                            f'read: {problem}') from problem


def _scene_of(state: str) -> str:
    """Return the topic of the scene of the node of a topic ~/state."""
    return f'{state.rpartition("/")[0]}/scene'


def _count_jumps(q: np.ndarray) -> int:
    """Return the number of rows of q, shape (N, d), that deviate while their neighbours agree."""
    steps, across = np.diff(q, axis=0), np.abs(q[2:] - q[:-2])
    usual = np.array([np.median(column[column > 0.0]) if column.any() else 0.0
                      for column in across.T])
    away = np.minimum(np.abs(steps[:-1]), np.abs(steps[1:]))
    return int(((away > _JUMP * usual) & (away > 2.0 * across)).any(axis=1).sum())
