# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Read ROS 2 bags: as states of a robot or the simulator and rates, or as runs of a machine."""

from collections.abc import Iterable, Iterator, Sequence
import logging
from pathlib import Path
from typing import Annotated, Literal

from hnn_vi_ros.bags.cdr import MOMENTUM, RATE
from hnn_vi_ros.errors import DataError, listed
from hnn_vi_ros.files.yaml_file import StrictModel
from hnn_vi_ros.learning.data.bag_signals import ARRAY, JOINT_STATE, Signal, SignalReader
from hnn_vi_ros.learning.data.dataset import (
    Block, Dataset, Derivatives, differentiate, joined, Mass, mass_matrix, Names, SavitzkyGolay,
    time_blocks, UNEVENNESS)
from hnn_vi_ros.learning.data.runs import even_runs, MeasuredRun, Run, RunData, unwound
import numpy as np
from pydantic import Field, model_validator
from scipy.interpolate import CubicSpline

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
    signals = {name: reader.read(topic, field, prefix)
               for name, (topic, field, prefix) in topics.items() if topic is not None}
    (t, q), rates = signals['q'], signals.get('dq_dt')
    q, turning = unwound(
        t, q, rates.values if rates is not None and np.array_equal(rates.t, t) else None)
    for k in turning:
        _LOGGER.warning('%s: turns of %s counted', reader.path, data.joints[k])
    assert data.q is not None, 'found by _topics'
    reader.warn_of_publishers(data.q, q)
    return signals | {'q': Signal(t, q)}


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
    spacing = (t[-1] - t[0]) / (len(t) - 1)
    method = data.derivatives or SavitzkyGolay(window=_WINDOW * spacing, degree=_DEGREE)
    window = method.rows(spacing, len(t) - _LEAST, str(reader.path), f'its {len(t)} rows') \
        if isinstance(method, SavitzkyGolay) else 0

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
    reader.warn_of_publishers(data.topic, unwound(t, q, v)[0])
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
