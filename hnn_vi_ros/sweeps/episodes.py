# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Simulate trajectories of a sweep one by one, each as a run of its own scene."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple
import warnings

from hnn_vi_ros.errors import DataError, StepFailure, StoppedByEvent
from hnn_vi_ros.files import one_line
from hnn_vi_ros.recording import Sample
from hnn_vi_ros.run import Sampler
from hnn_vi_ros.scene import Scene, with_values
from hnn_vi_ros.simulation import build, Simulation, watched, WatchedSimulation, whole_steps
from hnn_vi_ros.sweeps.plan import SweepPlan
from hnn_vi_ros.sweeps.trajectories import FAILURES


class Episode(NamedTuple):
    """
    A trajectory before its first step.

    Parameters
    ----------
    number : int
        Its index in the sweep.
    values : dict
        Values of the axes' keys.
    scene : Scene
        Scene with these values.
    simulation : Simulation or WatchedSimulation
        Simulation in its initial state, with the noise stream of this index.
    sampler : Sampler
        Sampler of the simulation.
    length : int
        Number of samples after the initial state.

    """

    number: int
    values: dict[str, Any]
    scene: Scene
    simulation: Simulation | WatchedSimulation
    sampler: Sampler
    length: int

    def samples(self) -> Iterator[Sample]:
        """Yield the samples after the initial state, until the end or an early stop."""
        for _ in range(self.length):
            try:
                self.simulation.advance(self.sampler.every)
            except (StepFailure, StoppedByEvent):
                return
            yield self.sampler.sample()


# Function that writes episodes of a sweep to a folder.
EpisodeWriter = Callable[[SweepPlan, Iterator[Episode], Path], None]


def without_ros(plan: SweepPlan, episodes: Iterator[Episode], folder: Path) -> None:
    """Raise an error: bags need ROS 2."""
    raise DataError('--episodes mcap: bags contain ROS messages; write them with the executable '
                    'sweep, or with write_bags of hnn_vi_ros.ros.replay.episode_bags')


def episodes(plan: SweepPlan, indices: list[int], failed: dict[int, str]) -> Iterator[Episode]:
    """
    Yield trajectories of a sweep, each before its first step.

    A sweep steps neighbouring trajectories together, which affects their last digits. Here each is
    stepped alone, as in the simulator.

    Parameters
    ----------
    plan : SweepPlan
        Plan of the sweep.
    indices : list of int
        Indices of the trajectories.
    failed : dict
        Filled with the reason, by index, for each trajectory that cannot start.

    """
    every = plan.sweep.every or 1
    for index in indices:
        values = dict(zip(plan.keys, (column[0] for column in plan.values(
            range(index, index + 1))), strict=True))
        try:
            with warnings.catch_warnings():
                # The warnings about the scene were already raised when the sweep started.
                warnings.simplefilter('ignore')
                scene = with_values(plan.scene, dict(zip(
                    plan.parts, values.values(), strict=True)))
                simulation = build(scene)
                simulation.restart(simulation.q.copy(), simulation.p.copy(), stream=index)
        except FAILURES as problem:
            failed[index] = one_line(problem) or type(problem).__name__
            continue
        steps, _ = whole_steps(plan.sweep.duration, simulation.step_size)
        run = watched(simulation, scene)
        yield Episode(index, values, scene, run, Sampler(
            simulation, 1.0 / (every * simulation.step_size)), steps // every)


def selected(text: str, count: int) -> list[int]:
    """
    Return the numbers selected by a text, in ascending order.

    Parameters
    ----------
    text : str
        Comma-separated numbers and slices: ``3``, ``0,7``, ``10:20``, ``0:1000:50``; '' for all.
    count : int
        Number of trajectories.

    Raises
    ------
    DataError
        The text is malformed, or a number is out of range.

    """
    found: set[int] = set()
    for part in text.split(',') if text else [':']:
        try:
            numbers = [int(number) if number.strip() else None for number in part.split(':')]
            if len(numbers) > 3 or any(number is not None and number < 0 for number in numbers):
                raise ValueError
            chosen: Sequence[int | None] = range(*slice(*numbers).indices(count)) \
                if len(numbers) > 1 else numbers
        except ValueError:
            raise DataError(f'--select {text}: {part!r} is not N, FIRST:END or FIRST:END:STEP; '
                            'separate several with commas') from None
        if not all(number is not None and number < count for number in chosen) or not chosen:
            raise DataError(f'--select {text}: {part!r} selects none of the {count} trajectories, '
                            f'0 to {count - 1}')
        found.update(number for number in chosen if number is not None)
    return sorted(found)
