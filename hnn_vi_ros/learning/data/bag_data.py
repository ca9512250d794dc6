# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Data from ROS 2 bags: recorded states of a robot or of the simulator, and runs of a machine.

``read_bags`` makes a Dataset of states and their rates, ``read_bag_motions`` runs that are put on
even times; both read their topics by a ``SignalReader``.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
import logging
from pathlib import Path
from typing import Annotated, final, Literal, NamedTuple, TypeVar

from hnn_vi_ros.bags.cdr import (
    decode_float64_multi_array, decode_joint_state, JointStates, MOMENTUM, RATE)
from hnn_vi_ros.bags.mcap_reader import BagReader, Recorded
from hnn_vi_ros.errors import DataError, listed, RecordingError
from hnn_vi_ros.files.yaml_file import StrictModel
from hnn_vi_ros.learning.data.dataset import (
    Block, Dataset, Derivatives, differentiate, joined, Mass, mass_matrix, Names, SavitzkyGolay,
    time_blocks, UNEVENNESS)
from hnn_vi_ros.learning.data.runs import even_runs, MeasuredRun, Run, RunData
from hnn_vi_ros.run.held_state import STATE_FILE
import numpy as np
from pydantic import Field, model_validator
import safetensors
import safetensors.numpy
from scipy.interpolate import CubicSpline

JOINT_STATE = 'sensor_msgs/msg/JointState'
ARRAY = 'std_msgs/msg/Float64MultiArray'
# Times agree with stamps that are off by less than this, in mean intervals.
_DISAGREEMENT = 0.01

Decoded = TypeVar('Decoded')


class Signal(NamedTuple):
    """
    Values of a topic over time.

    Parameters
    ----------
    t : np.ndarray, shape (N,)
        Increasing instants, since the first of the signal that was read first [s].
    values : np.ndarray, shape (N, d)
        The values at these instants.

    """

    t: np.ndarray
    values: np.ndarray


@final
class SignalReader:
    """
    A bag as signals of some joints; one that was cut off will do.

    Parameters
    ----------
    path : Path
        A folder with the files of one bag, or one file.
    joints : sequence of str
        Names of the joints, in the order of the coordinates.
    columns : sequence of int
        Which numbers of an array belong to them.
    stamps : str
        ``'header'`` or ``'log'``: what counts as a message's time.

    Attributes
    ----------
    bag : BagReader
        The bag.
    stamps : str
        As above; may be set before the first signal is read.

    Raises
    ------
    DataError
        It is no bag, or holds no messages.

    """

    def __init__(self, path: Path, joints: Sequence[str], columns: Sequence[int], stamps: str):
        try:
            self.bag = BagReader(path)
        except RecordingError as problem:
            raise DataError(str(problem)) from problem
        self.path = self.bag.path
        self._joints, self._columns, self.stamps = tuple(joints), list(columns), stamps
        self._origin: int | None = None
        self._topics: dict[str, list[int]] = {}
        for number, channel in self.bag.channels.items():
            self._topics.setdefault(channel.topic, []).append(number)
        if not any(self.bag.messages()):
            raise DataError(f'{self.path}: holds no messages; record while something moves')

    @property
    def commanded_before(self) -> bool:
        """Return whether a simulator held a command when it began the bag, which lacks that."""
        try:
            state = safetensors.numpy.load(self.bag.attachment(STATE_FILE))
        except (RecordingError, safetensors.SafetensorError, ValueError, KeyError):
            return False
        return 'live.command' in state and bool(state['live.command'].any())

    def type_of(self, topic: str) -> str:
        """Return the type of a topic; DataError if the bag does not hold it."""
        return self._found(topic)[1]

    def has_topic(self, topic: str) -> bool:
        """Return whether the bag holds exactly this topic."""
        return topic in self._topics

    def state_topic(self) -> str | None:
        """Return the simulator's ~/state, if the bag holds one with the joints, and no more."""
        found = [topic for topic in self._topics
                 if topic.endswith('/state') and self.is_state(topic)]
        return found[0] if len(found) == 1 else None

    def is_state(self, topic: str) -> bool:
        """Return whether a topic is a ~/state of the simulator, with the joints."""
        _, kind, messages = self._found(topic)
        first = next(messages, None)
        if first is None or kind != JOINT_STATE:
            return False
        names = self._joint_state(topic, first).names
        return {MOMENTUM + joint for joint in self._joints} <= set(names)

    def check_resets(self, state: str) -> None:
        """
        Raise DataError if a simulator was reset while a topic was recorded that is its ~/state.

        Between the samples around that there is no motion.
        """
        scene = f'{self._found(state)[0].rpartition("/")[0]}/scene'
        times: dict[bytes, int] = {}
        for message in self.bag.messages(self._topics.get(scene, [])):
            times.setdefault(message.data, message.time)
        if len(times) > 1:
            resets = ', '.join(map(str, list(times.values())[1:4]))
            raise DataError(f'{self.path}: the run was reset at log time {resets} ns; cut the bag '
                            'there, by `mcap filter`, and give the parts in data.paths; the '
                            'simulator begins a bag at each reset')

    def check_clocks(self, topic: str, unstamped: str) -> None:
        """
        Raise DataError if the log times of joint states differ from their stamps.

        Then messages of a topic without stamps cannot be assigned to states.
        """
        times = np.array([
            (message.time, self._joint_state(topic, message).stamp)
            for message in self._found(topic)[2]])
        log, stamps = (times - times[:1]).T * 1e-9
        largest = np.abs(log - stamps).max(initial=0.0)
        if largest > _DISAGREEMENT * stamps.max(initial=0.0) / max(len(stamps) - 1, 1):
            raise DataError(
                f'{self.path}: {topic} is stamped, {unstamped} is not, and the times at which the '
                f'messages were recorded are up to {largest:.3g} s away from the stamps: they '
                'cannot be paired. Use ~/state of the simulator, whose q and p have one stamp '
                '(data.p: state); data.stamps: log takes those times as they are')

    def has(self, topic: str, field: str) -> bool:
        """Return whether the first message of a topic of joint states fills a field."""
        first = next(self._found(topic)[2], None)
        return first is not None and len(getattr(self._joint_state(topic, first), field)) > 0

    def read(self, topic: str, field: str, prefix: str = '') -> Signal:
        """
        Return a signal.

        Parameters
        ----------
        topic : str
            Its name, or the end of it, if only one topic ends so.
        field : str
            Of joint states: ``'position'``, ``'velocity'`` or ``'effort'``; empty for a topic
            that must be an array, ``'*'`` for an array of any length.
        prefix : str
            What stands before the joints in the names of joint states.

        Raises
        ------
        DataError
            There is no such topic, it has another type, or a message cannot be used.

        """
        expected = {'': f'{ARRAY} or ~/state of the simulator', '*': ARRAY}
        name, kind, messages = self._found(
            topic, expected.get(field, f'{ARRAY} or {JOINT_STATE}'))
        names = [prefix + joint for joint in self._joints]
        stamps, rows = [], []
        for message in messages:
            found = self._from_array(name, message, field == '*') if kind == ARRAY else \
                self._from_joint_state(name, message, field, names)
            if found is not None:
                stamps.append(found[0])
                rows.append(found[1])
        if len(rows) < (1 if field == '*' else 2):
            raise DataError(f'{self.path}: {name} has {len(rows)} messages with the joints '
                            f'{listed(self._joints)}; record for longer, or name joints that '
                            'it has in data.joints')
        if len({len(row) for row in rows}) != 1:
            raise DataError(f'{self.path}: {name}: its messages have different lengths')
        return self._checked(name, stamps, np.array(rows))

    def states(self, topic: str) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the messages of a topic of joint states that hold a joint, complete or not.

        Parameters
        ----------
        topic : str
            Its name, or the end of it, if only one topic ends so.

        Returns
        -------
        t : np.ndarray, shape (N,)
            Since the first [s], in the order of the recording: late ones come late.
        values : np.ndarray, shape (N, 3, d)
            Positions, velocities and efforts; not a number where a message has none of a joint.

        Raises
        ------
        DataError
            There is no such topic, it has another type, or a message cannot be read.

        """
        name, stamps, rows, seen = self._joint_rows(topic)
        if not set(self._joints) <= seen:
            raise DataError(f'{self.path}: {name} has no joint '
                            f'{next(joint for joint in self._joints if joint not in seen)!r}; '
                            f'its joints: {listed(sorted(seen)) or "none"}')
        return self._times(name, stamps), np.array(rows)

    def forces(self, topic: str) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the commands of a topic, complete or not.

        Parameters
        ----------
        topic : str
            Its name, or the end of it, if only one topic ends so; of joint states with efforts,
            or of arrays.

        Returns
        -------
        t : np.ndarray, shape (N,)
            As in ``states``.
        values : np.ndarray, shape (N, m)
            Efforts of the joints, or the numbers of an array, selected by ``columns`` if there
            are any; NaN where a message has no effort of a joint, or an array has another length
            than most.

        Raises
        ------
        DataError
            There is no such topic, it has another type, or a message cannot be read.

        """
        if self.type_of(topic) == JOINT_STATE:
            name, stamps, rows, _ = self._joint_rows(topic)
            efforts = np.array([effort for _, _, effort in rows]).reshape(-1, len(self._joints))
            return self._times(name, stamps), efforts
        name, _, messages = self._found(topic, ARRAY)
        found = [self._from_array(name, message, True) for message in messages]
        lengths = [len(values) for _, values in found]
        usual = max(set(lengths), key=lengths.count, default=0)
        values = np.array([values if len(values) == usual else np.full(usual, np.nan)
                           for _, values in found]).reshape(-1, usual)
        if self._columns:
            if max(self._columns) >= usual:
                raise DataError(f'{self.path}: {name}: a message has {usual} numbers, and '
                                f'data.columns names number {max(self._columns)}, counted from 0')
            values = values[:, self._columns]
        return self._times(name, [stamp for stamp, _ in found]), values

    def _joint_rows(self, topic: str) -> tuple[str, list[int], list[list[list[float]]], set[str]]:
        """Return a topic's name, and of its messages stamps, numbers, and names of joints."""
        name, _, messages = self._found(topic, JOINT_STATE)
        stamps, rows, seen = [], [], set[str]()
        for message in messages:
            state = self._joint_state(name, message)
            seen.update(state.names)
            if not set(self._joints) & set(state.names):
                continue  # of another driver
            stamps.append(state.stamp if self.stamps == 'header' else message.time)
            rows.append([_by_name(state, values, self._joints) for values in (
                state.position, state.velocity, state.effort)])
        return name, stamps, rows, seen

    def _times(self, name: str, stamps: list[int]) -> np.ndarray:
        """Return times since the first of the signal that was read first [s]."""
        if len(stamps) > 1 and len(set(stamps)) == 1:
            raise DataError(f'{self.path}: {name}: all its stamps are {stamps[0]} ns; take '
                            'data.stamps: log, the times at which its messages were recorded')
        if self._origin is None and stamps:
            self._origin = stamps[0]
        origin = self._origin or 0
        return np.array([stamp - origin for stamp in stamps]) * 1e-9

    def _checked(self, name: str, stamps: list[int], values: np.ndarray) -> Signal:
        backward = np.flatnonzero(np.diff(stamps) <= 0)
        if backward.size:
            at = backward[0] + 1
            other = 'log' if self.stamps == 'header' else 'header'
            raise DataError(f'{self.path}: {name}: the stamp of message {at + 1}, {stamps[at]} ns,'
                            f' is not after the one before, {stamps[at - 1]} ns; try data.stamps: '
                            f'{other}, or split the bag where time was set back')
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if bad.size:
            raise DataError(f'{self.path}: {name}: message {bad[0] + 1} holds a value that is not '
                            f'finite: {values[bad[0]].tolist()}')
        return Signal(self._times(name, stamps), values)

    def _found(self, topic: str, expected: str = '') -> tuple[str, str, Iterator[Recorded]]:
        """Return name, type and messages of the one topic of this name, or that ends with it."""
        topic = '/' + topic.lstrip('/')
        if topic not in self._topics:
            found = [name for name in self._topics if name.endswith(topic)]
            if len(found) != 1:
                what = 'no topic' if not found else f'{len(found)} topics'
                choose = '; name one of them whole' if found else ''
                raise DataError(f'{self.path}: holds {what} {topic}; it holds: '
                                f'{self._contents()}{choose}')
            topic = found[0]
        numbers = self._topics[topic]
        kind = self._type(numbers[0])
        if expected and kind not in expected.split(' or '):
            raise DataError(f'{self.path}: {topic} has the type {kind}, expected {expected}; the '
                            f'bag holds: {self._contents()}')
        return topic, kind, self.bag.messages(numbers)

    def _contents(self) -> str:
        return listed(sorted({f'{topic} ({self._type(number)})' for topic, numbers
                              in self._topics.items() for number in numbers})) or 'nothing'

    def _type(self, number: int) -> str:
        schema = self.bag.schemas.get(number)
        return 'unknown type' if schema is None else schema.name

    def _from_array(self, topic: str, message: Recorded, whole: bool) -> tuple[int, np.ndarray]:
        if self.stamps == 'header':
            raise DataError(f'{self.path}: {topic}: an array has no header with a stamp; use '
                            'data.stamps: log')
        values = self._decoded(topic, message, decode_float64_multi_array)
        if whole or (not self._columns and len(values) == len(self._joints)):
            return message.time, values
        if not self._columns or max(self._columns) >= len(values):
            raise DataError(f'{self.path}: {topic}: a message has {len(values)} numbers, expected '
                            f'{len(self._joints)}, one for each of data.joints; say which of them '
                            'in data.columns, counted from 0')
        return message.time, values[self._columns]

    def _from_joint_state(self, topic: str, message: Recorded, field: str, names: list[str]
                          ) -> tuple[int, np.ndarray] | None:
        """Return time and values; None from a message without one of the names."""
        state = self._joint_state(topic, message)
        if not set(names) <= set(state.names):
            return None
        values = getattr(state, field)
        if len(values) != len(state.names):
            raise DataError(f'{self.path}: {topic}: a message has {len(values)} {field} values '
                            f'for {len(state.names)} joints; leave {field} out of data')
        time = state.stamp if self.stamps == 'header' else message.time
        return time, values[[state.names.index(name) for name in names]]

    def _joint_state(self, topic: str, message: Recorded) -> JointStates:
        return self._decoded(topic, message, decode_joint_state)

    def _decoded(self, topic: str, message: Recorded, decode: Callable[[bytes], Decoded]
                 ) -> Decoded:
        try:
            return decode(message.data)
        except (ValueError, UnicodeDecodeError) as problem:
            raise DataError(f'{self.path}: {topic}: the message at {message.time} ns cannot be '
                            f'read: {problem}') from problem


def _by_name(state: JointStates, values: np.ndarray, joints: Sequence[str]) -> list[float]:
    """Return the values of joints, NaN for a joint without one."""
    if len(values) != len(state.names):
        return [np.nan] * len(joints)
    return [values[state.names.index(joint)] if joint in state.names else np.nan
            for joint in joints]


MAX_ROWS = 1_000_000
# Blocks of a recording, unless data.block gives their length.
BLOCKS = 20
# Intervals without a message after which a new motion begins.
_GAP = 10.0
# Rows at each end of a motion whose spline is not as good as that of the others.
_MARGIN = 10
_LEAST = 2 * _MARGIN + 15
# Unless data.derivatives says more.
_WINDOW, _DEGREE = 9, 4

_LOGGER = logging.getLogger(__name__)

Topic = Annotated[str, Field(min_length=1, max_length=255)]


class BagData(StrictModel):
    """
    Topics of MCAP bags; joint states hold positions, velocities and efforts, arrays one of them.

    A topic may be named by the end of its name, if no other ends so.
    """

    kind: Literal['bag']
    paths: list[Topic] = Field([], description='bags: folders or .mcap files; --data overrides')
    joints: Names = Field(min_length=1, description='names of the joints, one a coordinate')
    columns: list[Annotated[int, Field(ge=0)]] = Field([], description=(
        'which numbers of arrays belong to the joints, counted from 0; default: all'))
    q: Topic | None = Field(None, description=(
        'topic of the positions; default: joint_states. Without q, p, mass and dp_dt, q, p and '
        'dp_dt are those of ~/state of the simulator, if the bag holds one'))
    velocity: Topic | None = Field(None, description=(
        'topic of dq/dt; default: that of q if it has them, else they are estimated'))
    estimate_velocity: bool = Field(False, description='estimate dq/dt from q in any case')
    p: Topic | None = Field(None, description=(
        'topic of the momenta, an array or ~/state; default: mass times dq/dt'))
    mass: Mass | None = Field(None, description=(
        'p = M dq/dt: one mass for each coordinate, or M by rows; default 1'))
    dp_dt: Topic | None = Field(None, description=(
        'topic of all forces, as efforts that include the weight, or ~/state; default: '
        'estimated from p'))
    commands: Topic | None = Field(None, description=(
        'topic of commands, an array; each holds until the next, before the first all are 0'))
    stamps: Literal['header', 'log'] | None = Field(None, description=(
        "a message's time; default: header if all topics have one, else log"))
    spacing: float | None = Field(None, gt=0.0, description=(
        'interval to resample at [s]; default: none if all messages come evenly and together, '
        'else the mean interval of the positions'))
    derivatives: Derivatives | None = Field(
        None, discriminator='kind', description=(
            'how what is not recorded is estimated; default: savitzky_golay, of degree 4 in a '
            'window of nine rows'))
    block: Block = None

    @model_validator(mode='after')
    def _check(self) -> 'BagData':
        d = len(self.joints)
        if len(set(self.joints)) != d:
            raise ValueError('two joints have the same name')
        if self.columns and len(self.columns) != d:
            raise ValueError(f'columns has {len(self.columns)} entries, expected {d}, one for '
                             'each joint')
        if self.p is not None and self.mass is not None:
            raise ValueError('p and mass exclude one another: the momenta are recorded')
        if self.velocity is not None and self.estimate_velocity:
            raise ValueError('velocity and estimate_velocity exclude one another')
        mass_matrix(self.mass, d)
        return self


def read_bags(paths: Sequence[Path], data: BagData) -> Dataset:
    """
    Read bags, resample their signals and estimate what they lack.

    Parameters
    ----------
    paths : sequence of Path
        Folders with the files of one bag, or files; unfinished and damaged ones are read as far
        as they go, these with a warning.
    data : BagData
        Topics and joints.

    Raises
    ------
    DataError
        A bag or a message cannot be used; names it, and what the bag holds.

    """
    parts, described, rows = list[dict[str, np.ndarray]](), [], 0
    for path in paths:
        reader, found = _reader(path, data)
        motions = [*_motions(reader, found)]
        count = sum(len(part['t']) for part in motions)
        parts, rows = parts + motions, rows + count
        if reader.bag.damage:
            _LOGGER.warning('train: warning: %s', reader.bag.damage)
        what = f'{count} rows, sha256 {reader.bag.digest()[:16]}'
        described.append(f'{path.name} ({what}{", damaged" if reader.bag.damage else ""})')
    if rows > MAX_ROWS:
        raise DataError(f'{rows} rows are more than {MAX_ROWS}; give a larger data.spacing, or '
                        'fewer bags')
    return joined(parts, ', '.join(described))


def _reader(path: Path, data: BagData) -> tuple[SignalReader, BagData]:
    """Return a reader of a bag, and the data with the topics in it."""
    reader = SignalReader(path, data.joints, data.columns, data.stamps or 'log')
    data = data.model_copy(update=_topics(reader, data))
    topics = [topic for topic in (data.q, data.velocity, data.p, data.dp_dt, data.commands)
              if topic is not None]
    stamped = [topic for topic in topics if reader.type_of(topic) == JOINT_STATE]
    if data.stamps is None and stamped == topics:
        reader.stamps = 'header'
    elif data.stamps is None and stamped:
        reader.check_clocks(
            stamped[0], next(topic for topic in topics if topic not in stamped))
    return reader, data


def _topics(reader: SignalReader, data: BagData) -> dict[str, Topic | None]:
    """Return where q, p, dp/dt and the velocities are that data does not say it of."""
    state = None
    if data.q is None and data.p is None and data.mass is None and data.dp_dt is None:
        state = reader.state_topic()
    velocity, q = data.velocity, state or data.q or 'joint_states'
    found: dict[str, Topic | None] = {'q': q}
    if state:
        found |= {'p': state, 'dp_dt': state}
    if velocity is None and not data.estimate_velocity:
        # The velocities of ~/state are on ~/joint_states, with the same stamps.
        beside = f'{q.rpartition("/")[0].rpartition("/")[0]}/joint_states' if state else q
        if (not state or reader.has_topic(beside)) and \
                reader.type_of(beside) == JOINT_STATE and reader.has(beside, 'velocity'):
            velocity = beside
    return found | {'velocity': velocity}


def _signals(reader: SignalReader, data: BagData) -> dict[str, Signal]:
    """Return the recorded signals among q, dq_dt, p and dp_dt."""
    topics = {'q': (data.q, 'position', ''), 'dq_dt': (data.velocity, 'velocity', ''),
              'p': (data.p, '', ''), 'dp_dt': (data.dp_dt, 'effort', '')}
    for name, prefix in (('p', MOMENTUM), ('dp_dt', RATE)):
        topic = topics[name][0]
        if topic is not None and reader.is_state(topic):
            reader.check_resets(topic)
            topics[name] = topic, 'position', prefix
    return {name: reader.read(topic, field, prefix)
            for name, (topic, field, prefix) in topics.items() if topic is not None}


def _motions(reader: SignalReader, data: BagData) -> Iterator[dict[str, np.ndarray]]:
    """Yield the columns of each stretch of a bag without a gap."""
    signals = _signals(reader, data)
    commands = None if data.commands is None else reader.read(data.commands, '*')
    found, begin = False, -np.inf
    if commands is not None and reader.commanded_before:
        begin = commands.t[0]
        _LOGGER.warning('train: warning: %s: was begun while a command was held, which is not in '
                        'it: what comes before the first one is left out', reader.path)
    for window in _windows(signals.values(), begin):
        parts = {name: _within(signal, window) for name, signal in signals.items()}
        grid = _grid(list(parts.values()), data.spacing)
        if len(grid) >= _LEAST:
            found = True
            states = {name: _resampled(signal, grid) for name, signal in parts.items()}
            yield _rows(reader, data, grid, states, commands)
    if not found:
        t = signals['q'].t
        raise DataError(f'{reader.path}: {data.q} has {len(t)} messages in {t[-1] - t[0]:.3g} s, '
                        f'and no {_LEAST} rows without a gap; record for longer, or give a '
                        'smaller data.spacing')


def _windows(signals: Iterable[Signal], start: float) -> Iterator[tuple[float, float]]:
    """Yield the intervals of time [s] in which no signal has a gap."""
    last = np.inf
    gaps: list[tuple[float, float]] = []
    for t, _ in signals:
        intervals = np.diff(t)
        gaps.extend((t[i], t[i + 1])
                    for i in np.flatnonzero(intervals > _GAP * np.median(intervals)))
        start, last = max(start, t[0]), min(last, t[-1])
    for before, after in [*sorted(gaps), (last, last)]:
        if start < min(before, last):
            yield start, min(before, last)
        start = max(start, after)


def _within(signal: Signal, window: tuple[float, float]) -> Signal:
    inside = (signal.t >= window[0]) & (signal.t <= window[1])
    return Signal(signal.t[inside], signal.values[inside])


def _grid(parts: Sequence[Signal], spacing: float | None) -> np.ndarray:
    """Return the instants of the rows: the messages' own if these are even, else new ones."""
    t = parts[0].t
    if any(len(part.t) < 2 for part in parts):
        return np.empty(0)
    mean = (t[-1] - t[0]) / (len(t) - 1)
    together = all(np.array_equal(part.t, t) for part in parts)
    if spacing is None and together and \
            np.abs(np.diff(t) - mean).max() <= UNEVENNESS * mean:
        return t
    first, last = max(part.t[0] for part in parts), min(part.t[-1] for part in parts)
    count = int((last - first) / (spacing or mean) * (1.0 + 1e-12)) + 1 if last > first else 0
    if count > MAX_ROWS:
        raise DataError(f'data.spacing = {spacing:g} s makes more than {MAX_ROWS} rows; give a '
                        'larger one')
    return first + (spacing or mean) * np.arange(count)


def _resampled(signal: Signal, grid: np.ndarray) -> np.ndarray:
    if np.array_equal(signal.t, grid):
        return signal.values
    if len(signal.t) < 4:
        raise DataError(f'{len(signal.t)} messages are too few to resample; record for longer')
    return CubicSpline(signal.t, signal.values)(grid)


def _rows(reader: SignalReader, data: BagData, t: np.ndarray, states: dict[str, np.ndarray],
          commands: Signal | None) -> dict[str, np.ndarray]:
    """Return the columns of a motion without its ends; missing ones are estimated."""
    method, window = _method(reader, t, data)

    def rate(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return differentiate(t - t[0], values, method, window, str(reader.path))

    if 'dq_dt' not in states:
        states['q'], states['dq_dt'] = rate(states['q'])
    if 'p' not in states:
        states['p'] = states['dq_dt'] @ mass_matrix(data.mass, len(data.joints))
    if 'dp_dt' not in states:
        states['p'], states['dp_dt'] = rate(states['p'])
    _, states['accelerations'] = rate(states['dq_dt'])
    if commands is not None:
        states['commands'] = _held(commands, t)
    states['t'] = t
    states['block'] = time_blocks(t, data.block or (t[-1] - t[0]) * (1.0 + 1e-9) / BLOCKS)
    margin = max(window // 2, _MARGIN)
    return {name: values[margin:len(t) - margin] for name, values in states.items()}


def _method(reader: SignalReader, t: np.ndarray, data: BagData) -> tuple[Derivatives, int]:
    """Return how to differentiate, and its window in rows, an odd number; 0 without one."""
    spacing = (t[-1] - t[0]) / (len(t) - 1)
    method = data.derivatives or SavitzkyGolay(window=_WINDOW * spacing, degree=_DEGREE)
    if not isinstance(method, SavitzkyGolay):
        return method, 0
    return method, method.rows(spacing, len(t) - _LEAST, str(reader.path), f'{len(t)} rows')


def _held(commands: Signal, t: np.ndarray) -> np.ndarray:
    """Return the newest command at each instant, zeros before the first."""
    at = np.searchsorted(commands.t, t, side='right')
    return np.vstack([np.zeros((1, commands.values.shape[1])), commands.values])[at]


EFFORT, NONE = 'effort', 'none'


class BagMotions(RunData):
    """Joint states in bags, each bag a run; joints in any order, possibly with others."""

    kind: Literal['bag'] = 'bag'
    paths: list[str] = Field([], description='bags: folders or files; or given by --data')
    joints: list[str] = Field([], description=(
        'names of the joints, one a coordinate; none: those of the coordinates'))
    topic: str = Field('joint_states', description='their name, or the end of it')
    estimate_velocity: bool = Field(False, description=(
        'estimate velocities from positions although they are published'))
    forces: str | None = Field(None, description=(
        'generalised forces of the motors: effort, or a topic of commands, of joint states with '
        'efforts or arrays, each of which holds until the next; none: no forces act; default: '
        'effort where it is published; in bags of the simulator ~/commands, or else, where '
        'joints were commanded, effort'))
    columns: list[Annotated[int, Field(ge=0)]] = Field([], description=(
        'which numbers of an array of commands are forces of the joints, counted from 0; none: '
        'all'))
    stamps: Literal['header', 'log'] | None = Field(None, description=(
        "a message's time; default: header, log where forces are arrays, which have none"))


def read_bag_motions(paths: Sequence[Path], data: BagMotions, names: Sequence[str]
                     ) -> tuple[list[Run], str]:
    """
    Read runs from bags, each named by its folder or file, and put each on even times.

    Parameters
    ----------
    paths : sequence of Path
        Folders with the files of one bag, or files.
    data : BagMotions
        Topics and joints.
    names : sequence of str
        Of the coordinates.

    Returns
    -------
    list of Run and str
        The runs, and what they are and lack, for the model card.

    Raises
    ------
    DataError
        A bag cannot be read, or lacks a topic or a joint; lists its content.

    """
    joints = data.joints or list(names)
    if len(joints) != len(names):
        raise DataError(f'data.joints names {len(joints)} joints for {len(names)} coordinates: '
                        f'{listed(names)}')
    runs, digests = [], []
    for path in paths:
        reader, forces = _forces(path, joints, data)
        runs.append(_run(path.name if path.is_dir() else path.stem, reader, forces, data, joints))
        digests.append(reader.bag.digest()[:16])
    return even_runs(runs, data, ', '.join(run.name for run in runs), ' '.join(digests))


def _forces(path: Path, joints: Sequence[str], data: BagMotions) -> tuple[SignalReader, str]:
    """Return a reader of a bag, and the topic of its forces; '' for none."""
    reader = SignalReader(path, joints, data.columns, 'header')
    forces = '' if data.forces == NONE else data.forces
    if forces is None:
        state = reader.state_topic()
        node = state.rpartition('/')[0] if state else ''
        if state and reader.has_topic(f'{node}/commands'):
            forces = f'{node}/commands'
        elif state:
            # In bags of before joints could be commanded the effort was p'.
            forces = EFFORT if any(reader.has_topic(f'{node}/{name}') for name in (
                'joint_commands', 'joint_trajectory')) else ''
        else:
            forces = EFFORT
    unstamped = forces not in ('', EFFORT) and reader.type_of(forces) == ARRAY
    if unstamped and data.stamps == 'header':
        raise DataError(f'{path}: {forces} has no stamps, and data.stamps is header; leave it out')
    if unstamped or data.stamps == 'log':
        reader.stamps = 'log'
    return reader, forces


def _run(name: str, reader: SignalReader, forces: str, data: BagMotions, joints: Sequence[str]
         ) -> MeasuredRun:
    t, values = reader.states(data.topic)
    q, v, tau = values.swapaxes(0, 1)
    notes: list[str] = []
    if forces not in ('', EFFORT):
        tau, notes = _commanded(reader, forces, t, data)
        if not 1 <= tau.shape[1] <= q.shape[1]:
            raise DataError(f'{reader.path}: {forces} has {tau.shape[1]} numbers for '
                            f'{q.shape[1]} coordinates; say in data.columns which are theirs, '
                            'counted from 0')
    given = np.isfinite(tau).any(axis=0)
    if not given.any() and data.forces == EFFORT:
        raise DataError(f'{reader.path}: {data.topic} has no efforts, and data.forces is effort; '
                        'name a topic of commands there, or leave it out if there are no motors')
    if forces == EFFORT and not given.any():
        notes.append('no efforts published')
    elif forces and not given.all():
        of = joints if len(given) == len(joints) else [f'motor {k + 1}' for k in range(len(given))]
        lacking = [name for name, there in zip(of, given, strict=True) if not there]
        notes.append(f'no effort of {", ".join(lacking)}, which counts as no motor')
        tau = np.where(given, tau, 0.0)
    if reader.bag.damage:
        notes.append(reader.bag.damage)
    return MeasuredRun(name, f'{reader.path}: {data.topic}', t, q,
                       None if data.estimate_velocity else v,
                       tau if forces and given.any() else None, forces not in ('', EFFORT),
                       notes=tuple(notes))


def _commanded(reader: SignalReader, forces: str, t: np.ndarray, data: BagMotions
               ) -> tuple[np.ndarray, list[str]]:
    """Return the command at each time, shape (N, m), and notes on them."""
    stamps, values = reader.forces(forces)
    motors = np.isfinite(values).any(axis=0)
    if not motors.any():
        raise DataError(f'{reader.path}: {forces} has no efforts of the joints, nor other forces: '
                        'targets of positions are none; name what has them in data.forces, effort '
                        'for those of the joint states')
    lacking = ~np.isfinite(values[:, motors]).all(axis=1)
    notes = []
    if lacking.any():
        if data.on_bad == 'fail':
            raise DataError(f'{reader.path}: {forces}: message {np.flatnonzero(lacking)[0] + 1} '
                            'lacks a number; leave it out, or take data.on_bad: drop or split')
        notes.append(f'{lacking.sum()} commands that lack a number')
        if data.on_bad == 'drop':
            stamps, values = stamps[~lacking], values[~lacking]
    # Sorted by stamps: a command that comes late still acts from its stamp on.
    order = np.argsort(stamps, kind='stable')
    # Each holds until the next; before the first there is none.
    at = np.searchsorted(stamps[order], t, side='right')
    before = int((at == 0).sum())
    if before == len(t):
        raise DataError(f'{reader.path}: no command of {forces} comes before the last state; look '
                        'at their stamps, and at data.stamps')
    held = reader.commanded_before
    if before:
        notes.append(f'{"an unknown" if held else "no"} force for {before} samples before the '
                     'first command')
    first = np.where(motors & (not held), 0.0, np.nan)
    return np.vstack([first[None], values[order]])[at], notes
