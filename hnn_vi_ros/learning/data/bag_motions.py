# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Runs of a machine from ROS 2 bags, put on even times."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from hnn_vi_ros.errors import DataError, listed
from hnn_vi_ros.learning.data.bag_signals import ARRAY, SignalReader
from hnn_vi_ros.learning.data.runs import even_runs, MeasuredRun, Run, RunData
import numpy as np
from pydantic import Field

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
