# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Read motions of robot joints or of the simulator from ROS 2 bags."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, ClassVar, Literal, NamedTuple

from hnn_vi_ros.errors import counted, DataError, listed
from hnn_vi_ros.files import StrictModel
from hnn_vi_ros.learning.data.bag_signals import SignalReader, STATES
from hnn_vi_ros.learning.data.dataset import (
    BLOCKS, Derivatives, mass_matrix, Names, SavitzkyGolay, StateOptions, time_blocks)
from hnn_vi_ros.learning.data.motions import GAP, Motion, MotionData, NONE, Recording
from hnn_vi_ros.learning.data.sampling import cubic, increasing_samples, unwrap_turns
from hnn_vi_ros.recording import ARRAY, JOINT_STATE, MOMENTUM, RATE, TRAJECTORY
import numpy as np
from pydantic import Field

# Default window and degree of data.derivatives.
_WINDOW, _DEGREE = 9, 4
EFFORT = 'effort'

Topic = Annotated[str, Field(min_length=1, max_length=255)]
Columns = list[Annotated[int, Field(ge=0)]]


class MotionTopics(NamedTuple):
    """Topics of the channels of a motion, '' for none; EFFORT takes the forces from topic q."""

    q: str
    v: str = ''
    p: str = ''
    dp_dt: str = ''
    forces: str = ''


class BagOptions(StrictModel):
    """Options of bags, shared by all fits."""

    kind: Literal['bag'] = 'bag'
    paths: list[Topic] = Field([], description=(
        'bags: folders or .mcap files; --data overrides them'))
    estimate_velocity: bool = Field(False, description=(
        'estimate velocities from positions even if they are published'))
    stamps: Literal['header', 'log'] | None = Field(None, description=(
        'source of message times; default: header if all topics have one, else log'))


class BagData(BagOptions, StateOptions):
    """
    Topics of MCAP bags: joint states (positions, velocities and efforts) or arrays of one of them.

    A topic may be given by a suffix of its name that no other topic has.
    """

    # The spline is less accurate near its ends.
    margin: ClassVar[int] = 10
    least: ClassVar[int] = 2 * margin + 15

    joints: Names = Field(min_length=1, description='names of the joints, one per coordinate')
    columns: Columns = Field([], description=(
        'zero-based indices of the joints in arrays; default: all'))
    q: Topic | None = Field(None, description=(
        'topic of the positions; default: joint_states. If q, p, mass and dp_dt are all omitted, '
        'q, p and dp_dt are read from ~/state of the simulator, if the bag contains it'))
    velocity: Topic | None = Field(None, description=(
        'topic of dq/dt; default: the topic of q if it has velocities, else they are estimated'))
    p: Topic | None = Field(None, description=(
        'topic of the momenta, an array or ~/state; default: mass times dq/dt'))
    dp_dt: Topic | None = Field(None, description=(
        'topic of the total forces, as efforts that include gravity, or ~/state; default: '
        'estimated from p'))
    commands: Topic | None = Field(None, description=(
        'topic of commands; each is held until the next, and all are 0 before the first'))

    def _check(self) -> None:
        d = len(self.joints)
        if len(set(self.joints)) != d:
            raise ValueError('two joints have the same name')
        if self.columns and len(self.columns) != d:
            raise ValueError(f'columns has {len(self.columns)} entries, expected {d}, one for '
                             'each joint')
        if self.p is not None and self.mass is not None:
            raise ValueError('p and mass are mutually exclusive: the momenta are recorded')
        if self.velocity is not None and self.estimate_velocity:
            raise ValueError('velocity and estimate_velocity are mutually exclusive')
        mass_matrix(self.mass, d)

    @property
    def forces(self) -> str | None:
        """Return the topic of commands, named as in BagMotions."""
        return self.commands

    def method(self, spacing: float) -> Derivatives:
        """Return the differentiation method, by default with a window of nine rows."""
        return self.derivatives or SavitzkyGolay(window=_WINDOW * spacing, degree=_DEGREE)

    def blocks(self, t: np.ndarray, window: int) -> np.ndarray:
        """Return the block of each row; by default a block is a twentieth of the motion."""
        return time_blocks(t, self.block or (t[-1] - t[0]) * (1.0 + 1e-9) / BLOCKS)

    def topics(self, reader: SignalReader) -> MotionTopics:
        """Return the topics of the channels; fill in those that the configuration omits."""
        state = None
        if self.q is None and self.p is None and self.mass is None and self.dp_dt is None:
            state = reader.state_topic()
        velocity, q = self.velocity, state or self.q or 'joint_states'
        if velocity is None and not self.estimate_velocity:
            # The velocities of ~/state are published on ~/joint_states with the same stamps.
            beside = f'{q.rpartition("/")[0].rpartition("/")[0]}/joint_states' if state else q
            if (not state or reader.has_topic(beside)) and reader.type_of(beside) == JOINT_STATE:
                velocity = beside
        return MotionTopics(q, velocity or '', state or self.p or '', state or self.dp_dt or '',
                            self.commands or '')


class BagMotions(BagOptions, MotionData):
    """Joint states in bags, one run per bag; joints in any order, other joints are ignored."""

    joints: list[str] = Field([], description=(
        'names of the joints, one per coordinate; none: those of the coordinates'))
    topic: str = Field('joint_states', description=(
        'topic of the joint states, or the end of its name'))
    forces: str | None = Field(None, description=(
        'generalised forces of the motors: effort; or a topic of commands (joint states with '
        'efforts, or arrays), each held until the next; none: no forces act; default: effort if '
        'it is published; in bags of the simulator ~/commands, or effort if joints were '
        'commanded'))
    columns: Columns = Field([], description=(
        'zero-based indices of the joint forces in an array of commands; none: all'))
    command: Topic | None = Field(None, description=(
        'topic of positions commanded to servos, for identify: arrays, joint states with '
        'positions, or joint trajectories; none: no commands'))

    def topics(self, reader: SignalReader) -> MotionTopics:
        """Return the topics of the channels; fill in those that the configuration omits."""
        forces = '' if self.forces == NONE else self.command or self.forces
        if forces is None:
            state = reader.state_topic()
            node = state.rpartition('/')[0] if state else ''
            if state and reader.has_topic(f'{node}/commands'):
                forces = f'{node}/commands'
            elif state:
                # Older bags, without joint commands, have p' as effort.
                forces = EFFORT if any(reader.has_topic(f'{node}/{name}') for name in (
                    'joint_commands', 'joint_trajectory')) else ''
            else:
                forces = EFFORT
        return MotionTopics(
            self.topic, '' if self.estimate_velocity else self.topic, forces=forces)


def read_bags(paths: Sequence[Path], data: BagData | BagMotions, joints: Sequence[str]
              ) -> Recording:
    """
    Read the motions of bags; each is named after its folder or file.

    Parameters
    ----------
    paths : sequence of Path
        Folders with the files of one bag, or files; unfinished and damaged ones are read as far
        as possible.
    data : BagData or BagMotions
        Topics of the bags.
    joints : sequence of str
        Names of the coordinates' joints; overridden by ``data.joints``.

    Raises
    ------
    DataError
        A bag cannot be read, or a topic or joint is missing; the message lists the content.

    """
    if isinstance(data, BagMotions) and len(data.joints or joints) != len(joints):
        raise DataError(f'data.joints names {counted(len(data.joints), "joint")} for '
                        f'{counted(len(joints), "coordinate")}: {listed(joints)}')
    motions, digests = [], []
    for path in paths:
        reader = SignalReader(path, data.joints or joints,
                              data.columns if isinstance(data, BagData) else ())
        motions.append(_motion(path.name if path.is_dir() else path.stem, reader, data,
                               data.joints or joints))
        digests.append(reader.bag.digest()[:16])
    return Recording(motions, ', '.join(motion.name for motion in motions), ' '.join(digests))


def _motion(name: str, reader: SignalReader, data: BagData | BagMotions, joints: Sequence[str]
            ) -> Motion:
    """Return the motion in a bag."""
    topics = data.topics(reader)
    _choose_stamps(reader, topics, data)
    t, values = reader.read(topics.q, '', JOINT_STATE if isinstance(data, BagMotions) else STATES)

    def channel(topic: str, of: int, prefix: str = '', expected: str = STATES
                ) -> np.ndarray | None:
        if not topic:
            return None
        state = bool(prefix) and reader.is_state(topic)
        if state:
            reader.check_resets(topic)
        if topic == topics.q and not prefix:
            return values[:, of]
        own, found = reader.read(topic, prefix if state else '', STATES if state else expected)
        return _interpolate(t, own, found[:, 0 if state else of])
    q, v = values[:, 0], channel(topics.v, 1)
    if v is not None and isinstance(data, BagData) and data.velocity and not np.isfinite(v).any():
        raise DataError(f'{reader.path}: {topics.v} has no velocities; remove data.velocity to '
                        'estimate them')
    reader.warn_of_publishers(topics.q, unwrap_turns(t, q, v)[0])
    commanded = isinstance(data, BagMotions) and data.command is not None
    tau, notes = _forces(reader, topics, t, values[:, 2], data, joints)
    if reader.bag.damage:
        notes.append(reader.bag.damage)
    return Motion(name, f'{reader.path}: {topics.q}', t, q, v, tau,
                  p=channel(topics.p, 0, MOMENTUM, f'{ARRAY} or ~/state of the simulator'),
                  dp_dt=channel(topics.dp_dt, 2, RATE),
                  inputs='linear' if topics.forces in ('', EFFORT) else 'held',
                  commanded=commanded,
                  notes=tuple(notes),
                  names=(*joints, *(f'velocity of {joint}' for joint in joints)))


def _choose_stamps(reader: SignalReader, topics: MotionTopics, data: BagData | BagMotions) -> None:
    """Use the header stamps, unless a topic has none or the configuration chooses."""
    named = [topic for topic in topics if topic not in ('', EFFORT)]
    unstamped = [topic for topic in named if reader.type_of(topic) in (ARRAY, TRAJECTORY)]
    if unstamped and data.stamps == 'header':
        raise DataError(f'{reader.path}: {unstamped[0]} has no stamps, but data.stamps is header; '
                        'remove data.stamps')
    reader.stamps = data.stamps or ('log' if unstamped else 'header')
    stamped = [topic for topic in named if topic not in unstamped]
    if isinstance(data, BagData) and data.stamps is None and unstamped and stamped:
        reader.check_clocks(stamped[0], unstamped[0])


def _interpolate(t: np.ndarray, own: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Interpolate values with times ``own`` at times t [s]; NaN outside them and in gaps."""
    if np.array_equal(own, t):
        return values
    found = np.full((len(t), values.shape[1]), np.nan)
    rows = np.flatnonzero(np.isfinite(values).all(axis=1))
    rows = rows[increasing_samples(own[rows])]
    if len(rows) < 2:
        return found
    intervals = np.diff(own[rows])
    for part in np.split(rows, np.flatnonzero(intervals > GAP * np.median(intervals)) + 1):
        if len(part) >= 4:  # a cubic spline needs four points
            inside = (own[part[0]] <= t) & (t <= own[part[-1]])
            found[inside] = cubic(t[inside], own[part], values[part])
    return found


def _forces(reader: SignalReader, topics: MotionTopics, t: np.ndarray, efforts: np.ndarray,
            data: BagData | BagMotions, joints: Sequence[str]
            ) -> tuple[np.ndarray | None, list[str]]:
    """Return the forces of the motors at each time, shape (N, m), and notes about them."""
    tau, notes = efforts, list[str]()
    if isinstance(data, BagMotions) and data.command is not None:
        return _positions_commanded(reader, data, t, len(joints)), notes
    if topics.forces not in ('', EFFORT):
        tau, notes = _commands_at(reader, topics.forces, t, data)
        if isinstance(data, BagMotions) and not 1 <= tau.shape[1] <= len(joints):
            raise DataError(f'{reader.path}: {topics.forces} has {tau.shape[1]} numbers for '
                            f'{len(joints)} coordinates; select theirs with data.columns '
                            '(zero-based)')
    given = np.isfinite(tau).any(axis=0)
    if not given.any() and data.forces == EFFORT:
        raise DataError(f'{reader.path}: {topics.q} has no efforts, but data.forces is effort; '
                        'set it to a topic of commands, or remove it if there are no motors')
    if topics.forces == EFFORT and not given.any():
        notes.append('no efforts published')
    elif topics.forces and not given.all():
        of = joints if len(given) == len(joints) else [f'motor {k + 1}' for k in range(len(given))]
        lacking = [name for name, there in zip(of, given, strict=True) if not there]
        notes.append(f'no effort of {", ".join(lacking)}, taken as no motor')
        tau = np.where(given, tau, 0.0)
    return tau if topics.forces and given.any() else None, notes


def _positions_commanded(reader: SignalReader, data: BagMotions, t: np.ndarray, d: int
                         ) -> np.ndarray:
    """Return the position commanded at each time, shape (N, d), NaN before the first."""
    assert data.command is not None, 'read from this topic'
    stamps, values = reader.positions_commanded(data.command, data.columns)
    if values.shape[1] != d:
        raise DataError(f'{reader.path}: {data.command} has {values.shape[1]} numbers for {d} '
                        'coordinates; select theirs with data.columns (zero-based)')
    order = np.argsort(stamps, kind='stable')
    at = np.searchsorted(stamps[order], t, side='right') - 1
    return np.where((at < 0)[:, None], np.nan, values[order][at])


def _commands_at(reader: SignalReader, forces: str, t: np.ndarray,
                 data: BagData | BagMotions) -> tuple[np.ndarray, list[str]]:
    """Return the command at each time, shape (N, m), and notes about it."""
    stamps, values = reader.forces(forces, data.columns if isinstance(data, BagMotions) else ())
    motors = np.isfinite(values).any(axis=0)
    if not motors.any():
        raise DataError(f'{reader.path}: {forces} has no efforts of the joints and no other '
                        'forces (position targets are not forces); set data.forces to a topic of '
                        'forces, or to effort for those of the joint states')
    lacking = ~np.isfinite(values[:, motors]).all(axis=1)
    notes = []
    if lacking.any():
        if data.on_bad == 'fail':
            raise DataError(f'{reader.path}: {forces}: message {np.flatnonzero(lacking)[0] + 1} '
                            'lacks a number; remove it, or use data.on_bad: drop or split')
        notes.append(f'{lacking.sum()} commands that lack a number')
        if data.on_bad == 'drop':
            stamps, values = stamps[~lacking], values[~lacking]
    # Sorted by stamp: a command that arrives late still acts from its stamp on.
    order = np.argsort(stamps, kind='stable')
    # Each command holds until the next one; before the first there is none.
    at = np.searchsorted(stamps[order], t, side='right')
    before = int((at == 0).sum())
    if before == len(t):
        raise DataError(f'{reader.path}: all commands of {forces} are later than the last state; '
                        'check their stamps and data.stamps')
    held = reader.commanded_before
    if before:
        notes.append(f'{"an unknown" if held else "no"} force for {before} samples before the '
                     'first command')
    first = np.where(motors & (not held), 0.0, np.nan)
    return np.vstack([first[None], values[order]])[at], notes
