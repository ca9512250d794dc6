# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Compile the functions of scenes on all cores into the disk cache, for a fast first start."""

from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import as_completed
from contextlib import suppress
from dataclasses import dataclass
from operator import itemgetter
import time
import warnings

from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import (
    build, ignore_sigint_in_children, resolve, simulate, usable_processors, worker_processes)

# Maximum number of processes, of 0.3 GB each: more would wait for the same functions.
_MAX_PROCESSES = 8
# Number of steps that are simulated.
_STEPS = 4


@dataclass(frozen=True)
class CompiledScene:
    """
    Result of compiling a scene.

    Parameters
    ----------
    name : str
        Name as given.
    seconds : float
        Wall time of the compilation [s].
    problem : str
        Reason that it cannot be compiled; empty on success.

    """

    name: str
    seconds: float
    problem: str = ''


def compile_scenes(names: Sequence[str | tuple[str, str]], rescue: bool = True
                   ) -> Iterator[CompiledScene]:
    """
    Compile the functions of scenes, in one process per core and at most eight.

    Parameters
    ----------
    names : sequence of str, or of (str, str)
        Names of shipped scenes, or files; in a pair with the integrator that replaces theirs.
    rescue : bool, optional
        True to compile the rescue of failed steps too, which takes half of the time. A run
        without a cached rescue compiles it in the background.

    Yields
    ------
    CompiledScene
        Results in the order of completion.

    """
    with worker_processes(min(usable_processors(), _MAX_PROCESSES, len(names))) as pool:
        with ignore_sigint_in_children():
            futures = [pool.submit(_compile, *one, rescue) for one in _by_method(
                [(name, None) if isinstance(name, str) else name for name in names])]
        for future in as_completed(futures):
            yield future.result()


def _by_method(names: Sequence[tuple[str, str | None]]) -> list[tuple[str, str | None]]:
    """Return the scenes with one per method first, as later ones share its compiled functions."""
    turns: Counter[str] = Counter()
    places = []
    for name, method in names:
        key = method or ''
        with suppress(HnnViRosError):
            key = method or str(load_scene(name).integrator)
        places.append((turns[key], (name, method)))
        turns[key] += 1
    return [one for _, one in sorted(places, key=itemgetter(0))]


def _compile(name: str, method: str | None, rescue: bool) -> CompiledScene:
    begin, problem = time.perf_counter(), ''
    try:
        with warnings.catch_warnings():
            # Warnings about the motion do not matter here.
            warnings.simplefilter('ignore')
            parts = resolve(load_scene(name).with_overrides(integrator=method))
            # Some steps, since the guards of a run call functions from the second sample on.
            simulate(parts, _STEPS * parts.scene.known_step_size)
            simulation = build(parts)
            simulation.compile()
            if rescue:
                simulation.compile_rescue()
    except HnnViRosError as error:
        problem = str(error)
    name += f' with {method}' if method else ''
    return CompiledScene(name, time.perf_counter() - begin, problem)
