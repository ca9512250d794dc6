# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Plan a sweep: the values of each trajectory, and its division into shards and blocks."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from importlib.metadata import version
import json
from math import prod
from pathlib import Path
import platform
from typing import Any

from hnn_vi_ros.errors import DataError, optional
from hnn_vi_ros.files import is_path
from hnn_vi_ros.phase_space import columns
from hnn_vi_ros.scene import AutoChoice, load_scene, Parts, Scene
from hnn_vi_ros.simulation import BLOCK, resolve, whole_steps
from hnn_vi_ros.sweeps.axes import Axis, find_key, make_axis
from hnn_vi_ros.sweeps.definition import load_sweep, MAX_COUNT, Sweep
from hnn_vi_ros.version import __version__
import numpy as np

# Maximum of numbers in the samples of a block (64 MiB) and of rows in a shard (20 MiB with about
# ten columns); temporary arrays take several times as much.
_MAX_BLOCK_NUMBERS, _MAX_SHARD_ROWS = 2**23, 2**18
# Default number of steps per shard, and its maximum number of trajectories: about ten seconds, so
# that an interruption loses little and files cost little time.
_SHARD_STEPS, _MAX_SHARD_TRAJECTORIES = 10**7, 2**13
# Number of trajectories stepped together on a device.
_DEVICE_BLOCKS = {'cpu': 3840, 'cuda': 2**17}
_PACKAGES = ('numba', 'numpy', 'pyarrow', 'scipy')


@dataclass(frozen=True)
class SweepPlan:
    """
    A sweep, its scene and its axes.

    Parameters
    ----------
    sweep : Sweep
        Definition of the sweep.
    folder : Path
        Folder its paths are relative to.
    made : Parts
        Parts of the scene, with a method and a step size.
    axes : list of Axis
        Axes; the last one varies fastest.
    parts : list of tuple
        Path of each varied key as a tuple; see ``find_key``.
    device : str or None
        Torch device that computes the trajectories; None for compiled loops.

    """

    sweep: Sweep
    folder: Path
    made: Parts
    axes: list[Axis]
    parts: list[tuple[str | int, ...]]
    device: str | None = None

    @property
    def scene(self) -> Scene:
        """Return the scene, with a method and a step size."""
        return self.made.scene

    @property
    def keys(self) -> list[str]:
        """Return the varied keys, which are columns of the results."""
        return [key for axis in self.axes for key in axis.keys]

    @property
    def names(self) -> dict[str, list[str]]:
        """Return the column names of q and of p: several for a coordinate that is a rotation."""
        return dict(zip('qp', columns(self.made.hamiltonian.coordinates), strict=True))

    @property
    def count(self) -> int:
        """Return the number of trajectories."""
        return prod(axis.count for axis in self.axes)

    @property
    def steps(self) -> int:
        """Return the number of steps of a trajectory of the unchanged scene."""
        return max(whole_steps(self.sweep.duration, self.scene.known_step_size)[0], 1)

    @property
    def samples(self) -> int:
        """Return the approximate number of samples of a trajectory held in memory."""
        return self.steps // self.sweep.every + 2 if self.sweep.every else 2

    @cached_property
    def block(self) -> int:
        """Return the number of neighbours stepped together; the results depend on it."""
        most = _MAX_BLOCK_NUMBERS // (2 * self.made.hamiltonian.dimension * self.samples)
        if self.device is None:
            return min(BLOCK, most)
        together = _DEVICE_BLOCKS[self.device.partition(':')[0]]
        return min(together, most, self.sweep.shard_size or together)

    @cached_property
    def shard_size(self) -> int:
        """Return the number of trajectories of a shard: a multiple of the block size."""
        rows = self.samples if self.sweep.keep == 'samples' else 1
        most = min(max(_MAX_SHARD_TRAJECTORIES, self.block), _SHARD_STEPS // self.steps)
        size = min(self.sweep.shard_size or max(most, 1), max(_MAX_SHARD_ROWS // rows, 1))
        return -(-size // self.block) * self.block

    @property
    def shards(self) -> int:
        """Return the number of shards."""
        return -(-self.count // self.shard_size)

    def indices(self, shard: int) -> range:
        """Return the indices of the trajectories of a shard."""
        first = shard * self.shard_size
        return range(first, min(first + self.shard_size, self.count))

    def values(self, indices: range) -> list[list[Any]]:
        """Return the values of each key for the given trajectories, as plain Python objects."""
        found: list[list[Any]] = []
        places = np.arange(indices.start, indices.stop)
        for axis in reversed(self.axes):
            places, along = np.divmod(places, axis.count)
            found = [np.asarray(values).tolist() if isinstance(values, np.ndarray)
                     else list(values) for values in axis.values(along)] + found
        return found

    @cached_property
    def record(self) -> dict[str, Any]:
        """Return everything that determines the results and their division, as plain JSON data."""
        record: dict[str, Any] = {}
        if self.device is not None:
            from hnn_vi_ros.simulation import description
            record['device'] = description(self.device)
        record |= {
            'sweep': self.sweep.model_dump(mode='json'),
            'scene': self.scene.model_dump(mode='json'),
            'models': self.scene.model_digests,
            'files': [axis.digest for axis in self.axes if axis.digest is not None],
            'versions': {'hnn_vi_ros': __version__, 'python': platform.python_version(),
                         'machine': platform.machine(),
                         **{name: version(name) for name in _PACKAGES}},
            'columns': self.keys,
            'trajectories': self.count, 'shards': self.shards, 'shard_size': self.shard_size,
            'block': self.block,
        }
        return record | {'digest': sha256(canonical_json(record).encode()).hexdigest()}


def canonical_json(data: object) -> str:
    """Return plain data as JSON; equal data give equal text."""
    return json.dumps(data, indent=2, ensure_ascii=False)


def make_plan(definition: str | Path | Mapping[str, Any],
              chosen: Mapping[str, Any] | None = None, device: str | None = None) -> SweepPlan:
    """
    Make the plan of a sweep.

    Parameters
    ----------
    definition : str, Path or mapping
        See ``load_sweep``.
    chosen : mapping, optional
        Integrator and step size chosen by `auto` at the first start of the sweep.
    device : str, optional
        See ``simulate_many``.

    Returns
    -------
    SweepPlan
        Plan with `integrator: auto` resolved for the unchanged scene.

    Raises
    ------
    HnnViRosError
        The sweep, its scene or its axes cannot be used; the message is one line.
    ValueError
        The device is unknown.

    """
    if device is not None:
        with optional('torch', f'device = {device}'):
            from hnn_vi_ros.simulation import open_device
        open_device(device)
    sweep, places, folder = load_sweep(definition)
    beside = folder / sweep.scene
    scene = load_scene(
        beside if is_path('scene', sweep.scene) and beside.is_file() else sweep.scene)
    if chosen is not None and isinstance(scene.integrator, AutoChoice):
        scene = scene.changed({name: chosen[name] for name in ('step_size', 'integrator')})
    made = resolve(scene)
    axes = [make_axis(axis, sweep.seed, number, folder, places.place('vary', number))
            for number, axis in enumerate(sweep.vary)]
    plan = SweepPlan(sweep, folder, made, axes, [], device)
    for number, axis in enumerate(axes):
        plan.parts.extend(find_key(made.scene, key, plan.names, places.place('vary', number))
                          for key in axis.keys)
    _check(plan, places.where)
    return plan


def _check(plan: SweepPlan, where: str) -> None:
    """Raise DataError for inconsistent settings."""
    sweep, keys = plan.sweep, plan.keys
    for i, part in enumerate(plan.parts):
        for j, other in enumerate(plan.parts[:i]):
            if part[:len(other)] == other or other[:len(part)] == part:
                raise DataError(f'{where}: vary: {keys[j]} and {keys[i]} both set the same value; '
                                'remove one')
    if plan.count > MAX_COUNT:
        raise DataError(f'{where}: vary: gives {plan.count:.3g} trajectories, more than '
                        f'{MAX_COUNT}; use fewer, or several sweeps')
    if plan.block == 0:
        raise DataError(f'{where}: every: {plan.samples} samples per trajectory do not fit into '
                        'memory; use a larger every')
    if 'out_of_box_time' in sweep.statistics and plan.made.hamiltonian.box is None:
        raise DataError(f'{where}: statistics: out_of_box_time: {plan.scene.name} has no training '
                        'domain; remove it')
    if 'event_times' in sweep.statistics and not plan.scene.events:
        raise DataError(f'{where}: statistics: event_times: {plan.scene.name} has no events; add '
                        'them to the scene, or remove it')
    used = {'index', 't', 'energy', 'alarms', 'failure', 'events', *sweep.statistics, *(
        f'{half}_{name}' for half, names in plan.names.items() for name in names)}
    for name in (*keys, *(sweep.reduction.columns if sweep.reduction else ())):
        if name in used:
            raise DataError(f'{where}: two columns would be named {name}; rename one')
        used.add(name)
