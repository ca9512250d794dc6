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


def compile_scenes(names: Sequence[str], rescue: bool = True) -> Iterator[CompiledScene]:
    """
    Compile the functions of scenes, in one process per core and at most eight.

    Parameters
    ----------
    names : sequence of str
        Names of shipped scenes, or files.
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
            futures = [pool.submit(_compile, name, rescue) for name in _by_method(names)]
        for future in as_completed(futures):
            yield future.result()


def _by_method(names: Sequence[str]) -> list[str]:
    """Return the names with one per method first, as later ones share its compiled functions."""
    turns: Counter[str] = Counter()
    places = []
    for name in names:
        method = ''
        with suppress(HnnViRosError):
            method = str(load_scene(name).integrator)
        places.append((turns[method], name))
        turns[method] += 1
    return [name for _, name in sorted(places, key=itemgetter(0))]


def _compile(name: str, rescue: bool) -> CompiledScene:
    begin, problem = time.perf_counter(), ''
    try:
        with warnings.catch_warnings():
            # Warnings about the motion do not matter, because no step is simulated.
            warnings.simplefilter('ignore')
            parts = resolve(load_scene(name))
            simulate(parts, 0.0)
            simulation = build(parts)
            simulation.compile()
            if rescue:
                simulation.compile_rescue()
    except HnnViRosError as error:
        problem = str(error)
    return CompiledScene(name, time.perf_counter() - begin, problem)
