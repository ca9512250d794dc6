# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Measured motions from ROS 2 bags: joint states as drivers of robots publish them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.bag_signals import ARRAY, JOINT_STATE, SignalReader
from hnn_vi_ros.learning.motions import as_motions, MeasuredRun, Motion, MotionData
import numpy as np
from pydantic import Field

EFFORT = 'effort'


class BagMotions(MotionData):
    """Joint states in bags, each bag a run; joints in any order, and others beside them."""

    paths: list[str] = Field([], description='bags: folders or files; or given by --data')
    joints: list[str] = Field([], description=(
        'names of the joints, one a coordinate; none: those of the coordinates'))
    topic: str = Field('joint_states', description='their name, or the end of it')
    estimate_velocity: bool = Field(False, description=(
        'estimate velocities from positions although they are published'))
    forces: str | None = Field(None, description=(
        'generalised forces of the motors: effort, or a topic of commands, of joint states with '
        'efforts or arrays, each of which holds until the next; default: effort where it is '
        'published; in bags of the simulator ~/commands, or else, where joints were commanded, '
        'effort'))
    stamps: Literal['header', 'log'] | None = Field(None, description=(
        "a message's time; default: header, log where forces are arrays, which have none"))


def read_bag_motions(paths: Sequence[Path], data: BagMotions, names: Sequence[str]
                     ) -> tuple[list[Motion], str]:
    """
    Read runs from bags, each named by its folder or file, and put each on even times.

    Parameters
    ----------
    paths : sequence of Path
        Folders with the files of one bag, or files.
    data : BagMotions
        What is where.
    names : sequence of str
        Of the coordinates.

    Returns
    -------
    list of Motion and str
        The runs, and what they are and lack, for the model card.

    Raises
    ------
    DataError
        A bag cannot be read, or lacks a topic or a joint; says what it holds.

    """
    joints = data.joints or list(names)
    if len(joints) != len(names):
        raise DataError(f'data.joints names {len(joints)} joints for {len(names)} coordinates: '
                        f'{", ".join(names)}')
    runs, digests = [], []
    for path in paths:
        reader, forces = _reader(path, joints, data)
        runs.append(_run(path.name if path.is_dir() else path.stem, reader, forces, data))
        digests.append(reader.digest[:16])
    return as_motions(runs, data, ', '.join(run.name for run in runs), ' '.join(digests))


def _reader(path: Path, joints: Sequence[str], data: BagMotions) -> tuple[SignalReader, str]:
    """Return what reads a bag, and where its forces are; empty for none."""
    reader = SignalReader(path, joints, [], 'header')
    forces = data.forces
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
            forces = EFFORT if reader.has(data.topic, EFFORT) else ''
    unstamped = forces not in ('', EFFORT) and reader.type_of(forces) == ARRAY
    if unstamped and data.stamps == 'header':
        raise DataError(f'{path}: {forces} has no stamps, and data.stamps is header; leave it out')
    if unstamped or data.stamps == 'log':
        reader = SignalReader(path, joints, [], 'log')
    return reader, forces


def _run(name: str, reader: SignalReader, forces: str, data: BagMotions) -> MeasuredRun:
    t, values = reader.states(data.topic)
    q, v, effort = values.swapaxes(0, 1)
    tau = None
    if forces == EFFORT:
        tau = effort
    elif forces:
        # The field of joint states; the whole of an array.
        signal = reader.read(forces, EFFORT if reader.type_of(forces) == JOINT_STATE else '*')
        if not 1 <= signal.values.shape[1] <= q.shape[1]:
            raise DataError(f'{reader.path}: {forces} has {signal.values.shape[1]} numbers for '
                            f'{q.shape[1]} coordinates')
        # Each holds until the next; before the first there is none.
        at = np.searchsorted(signal.t, t, side='right')
        tau = np.vstack([np.zeros((1, signal.values.shape[1])), signal.values])[at]
    return MeasuredRun(name, f'{reader.path}: {data.topic}', t, q,
                       None if data.estimate_velocity else v, tau, forces not in ('', EFFORT))
