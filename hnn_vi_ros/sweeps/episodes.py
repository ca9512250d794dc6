# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectories of a sweep one by one, as others take them: each a run of a scene of its own."""

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
    A trajectory that is about to begin.

    Parameters
    ----------
    number : int
        Its index in the sweep.
    values : dict
        Of the keys that vary.
    scene : Scene
        With these values.
    simulation : Simulation or WatchedSimulation
        In its initial state, with the noise of its index.
    sampler : Sampler
        Of the simulation.
    length : int
        How many samples follow the initial state.

    """

    number: int
    values: dict[str, Any]
    scene: Scene
    simulation: Simulation | WatchedSimulation
    sampler: Sampler
    length: int

    def samples(self) -> Iterator[Sample]:
        """Yield the samples after the initial state, to the end or to what ends the run."""
        for _ in range(self.length):
            try:
                self.simulation.advance(self.sampler.every)
            except (StepFailure, StoppedByEvent):
                return
            yield self.sampler.sample()


# Writes episodes of a sweep to a folder.
EpisodeWriter = Callable[[SweepPlan, Iterator[Episode], Path], None]


def without_ros(plan: SweepPlan, episodes: Iterator[Episode], folder: Path) -> None:
    """Refuse to write bags."""
    raise DataError('--episodes mcap: bags are messages of ROS, which the executable sweep '
                    'writes, and write_bags of hnn_vi_ros.ros.replay.episode_bags')


def episodes(plan: SweepPlan, indices: list[int], failed: dict[int, str]) -> Iterator[Episode]:
    """
    Yield trajectories of a sweep, each before its first step.

    In a sweep neighbours step together, and the last digits of one depend on its neighbours;
    here each steps by itself, as it would in the simulator.

    Parameters
    ----------
    plan : SweepPlan
        Of the sweep.
    indices : list of int
        Which.
    failed : dict
        Takes, by number, why one cannot begin.

    """
    every = plan.sweep.every or 1
    for index in indices:
        values = dict(zip(plan.keys, (column[0] for column in plan.values(
            range(index, index + 1))), strict=True))
        try:
            with warnings.catch_warnings():
                # The start of the sweep raised the warnings about the scene.
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
    Return the numbers that a selection names, rising.

    Parameters
    ----------
    text : str
        Numbers and slices, with commas: ``3``, ``0,7``, ``10:20``, ``0:1000:50``; empty for all.
    count : int
        How many trajectories there are.

    Raises
    ------
    DataError
        It cannot be understood, or names what is not there.

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
            raise DataError(f'--select {text}: {part!r} is none of N, FIRST:END and '
                            'FIRST:END:STEP, with commas between several') from None
        if not all(number is not None and number < count for number in chosen) or not chosen:
            raise DataError(f'--select {text}: {part!r} names none of the {count} trajectories, '
                            f'0 to {count - 1}')
        found.update(number for number in chosen if number is not None)
    return sorted(found)
