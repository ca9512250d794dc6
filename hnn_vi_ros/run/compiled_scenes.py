# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Compile what scenes run, on all cores, so that their first start finds it on disk."""

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

# Processes, of 0.3 GB each: of more of them several would wait for the same.
_MOST = 8


@dataclass(frozen=True)
class CompiledScene:
    """
    Result of compiling a scene.

    Parameters
    ----------
    name : str
        As it was given.
    seconds : float
        The wall time that it took [s].
    problem : str
        Why it cannot be compiled; empty where it was.

    """

    name: str
    seconds: float
    problem: str = ''


def compile_scenes(names: Sequence[str], rescue: bool = True) -> Iterator[CompiledScene]:
    """
    Compile what scenes run, in as many processes as there are cores, up to eight.

    Parameters
    ----------
    names : sequence of str
        Shipped names or files.
    rescue : bool, optional
        Whether to compile also what takes steps that fail: half of the time, and a run that finds
        it missing compiles it beside itself.

    Yields
    ------
    CompiledScene
        As they are done.

    """
    with worker_processes(min(usable_processors(), _MOST, len(names))) as pool:
        with ignore_sigint_in_children():
            futures = [pool.submit(_compile, name, rescue) for name in _in_turns(names)]
        for future in as_completed(futures):
            yield future.result()


def _in_turns(names: Sequence[str]) -> list[str]:
    """Return the names so that one of each method comes first: processes share what follows."""
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
            # They would be about the motion; nothing is simulated here.
            warnings.simplefilter('ignore')
            scene = resolve(load_scene(name))[0]
            simulate(scene, 0.0)
            simulation = build(scene)
            simulation.compile()
            if rescue:
                simulation.compile_rescue()
    except HnnViRosError as error:
        problem = str(error)
    return CompiledScene(name, time.perf_counter() - begin, problem)
