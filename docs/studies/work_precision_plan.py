# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Plan of a work-precision study: its grid, checked before any time is spent."""

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
import json
import math
from pathlib import Path
from typing import Annotated

from hnn_vi_ros.errors import ParameterError
from hnn_vi_ros.files.yaml_file import read_yaml, StrictModel
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.accuracy.automatic_choice import resolve
from hnn_vi_ros.version import __version__
import numpy as np
from pydantic import Field
from studies.measuring import MethodRun, OwnRun, Peer, PeerRun, whole_steps
from studies.results import machine, ResultsFolder
from studies.variants import applicable, create, MethodLabel, parse_method

# The longest step over the scene's own: 0.2 s where that is 0.01 s. Each further one is half.
LONGEST, HALVINGS = 20.0, 8
# Methods of this order or higher begin with longer ones, and end as many halvings earlier.
HIGH_ORDER, LONGER = 8, (5.0, 2.5, 2.0, 1.25)

Positive = Annotated[float, Field(gt=0.0, lt=1e12)]


class Grid(StrictModel):
    """Grid of measurements; the schema of work_precision.yaml."""

    methods: list[str] = Field(min_length=1)
    horizons: list[Positive] = Field(min_length=1, description='[s]')
    tolerances: list[Positive] = Field(min_length=1, description='of the adaptive peers')
    runs: int = Field(ge=1, le=10_000, description='timed at the shortest horizon')
    limit: Positive = Field(description='longest single run [s]')


@dataclass(frozen=True)
class Setting:
    """One line of the plan: a factory of its runs, and the key of its rows without the horizon."""

    label: str
    step_size: float
    stages: int
    create: Callable[[], MethodRun]


@dataclass(frozen=True)
class Study:
    """Everything that is to be measured for one scene, checked."""

    scene: Scene
    hamiltonian: Hamiltonian
    settings: list[Setting]
    horizons: list[float]
    runs: int
    limit: float
    results: ResultsFolder

    @property
    def start(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the initial q and p."""
        return np.array(self.scene.initial_state.q), np.array(self.scene.initial_state.p)


def prepare(arguments: argparse.Namespace, name: str, out: Path | None) -> Study:
    """
    Check the whole plan, and load existing results.

    Parameters
    ----------
    arguments : argparse.Namespace
        The command line.
    name : str
        Name of a shipped scene, or path of a scene.
    out : Path or None
        Folder of the results.

    Raises
    ------
    HnnViRosError
        An unknown scene or method, a horizon that a step does not divide, a folder that cannot
        be written or holds other results.

    """
    grid = read_yaml(Path(__file__).with_name('work_precision.yaml'), Grid, ParameterError)[0]
    scene, _ = resolve(load_scene(name))
    if scene.effects:
        raise ParameterError(f'{scene.source}: lists effects; accuracy is studied on the motion '
                             'of H alone: give a scene without effects')
    runs, limit = arguments.runs or grid.runs, arguments.limit or grid.limit
    horizons = sorted(set(arguments.horizons or grid.horizons))
    for name, values in (('horizons', horizons), ('steps', arguments.steps or []),
                         ('runs', [runs]), ('limit', [limit])):
        if not all(0.0 < value < math.inf for value in values):
            raise ParameterError(f'--{name}: must be positive numbers')
    hamiltonian = scene.create_hamiltonian()
    methods = [parse_method(label) for label in arguments.methods or grid.methods]
    if not arguments.methods:
        methods = [method for method in methods if applicable(method, hamiltonian)]
    settings = list(_own_settings(scene, hamiltonian, methods, arguments.steps))
    if arguments.peers:
        # Before any time is spent: a package may be missing.
        from studies.peers import create_peers
        settings += _peer_settings(scene, hamiltonian, create_peers(hamiltonian), arguments.steps,
                                   grid.tolerances)
    _check_division(horizons, settings)
    results = ResultsFolder(out or Path('work_precision') / scene.name,
                            _identity(scene, hamiltonian, runs))
    return Study(scene, hamiltonian, settings, horizons, runs, limit, results)


def step_sizes(scene: Scene, order: int) -> list[float]:
    """Return the default step sizes [s] of a method of some order, the longest first."""
    longest = LONGEST * scene.step_size
    halved = [longest / 2 ** k for k in range(HALVINGS + 1)]
    return ([factor * longest for factor in LONGER] + halved[:-len(LONGER)]
            if order >= HIGH_ORDER else halved)


def _own_settings(scene: Scene, hamiltonian: Hamiltonian, methods: Sequence[MethodLabel],
                  steps: list[float] | None) -> Iterator[Setting]:
    start = scene.initial_state.q, scene.initial_state.p

    def run(method: MethodLabel, step_size: float) -> MethodRun:
        integrated, integrator = create(method, hamiltonian)
        return OwnRun(method.label, Simulation(integrated, integrator, step_size, *start),
                      hamiltonian)

    for method in methods:
        create(method, hamiltonian)
        order, stages = (getattr(INTEGRATORS[method.kind], name, 1)
                         for name in ('order', 'stages'))
        for h in sorted(set(steps or step_sizes(scene, order)), reverse=True):
            yield Setting(method.label, h, stages, partial(run, method, h))


def _peer_settings(scene: Scene, hamiltonian: Hamiltonian, peers: Sequence[Peer],
                   steps: list[float] | None, tolerances: Sequence[float]) -> Iterator[Setting]:
    z0 = np.concatenate([scene.initial_state.q, scene.initial_state.p])
    for peer in peers:
        choices = tolerances if peer.adaptive else steps or step_sizes(scene, 1)
        for choice in sorted(choices, reverse=True):
            run = PeerRun(peer, choice, hamiltonian, z0)
            yield Setting(run.label, run.step_size, 1, partial(lambda run: run, run))


def _check_division(horizons: Sequence[float], settings: Sequence[Setting]) -> None:
    for horizon in horizons:
        for setting in settings:
            h = setting.step_size
            if not math.isnan(h) and whole_steps(horizon, h) is None:
                raise ParameterError(
                    f'--horizons {horizon:g}: not a whole number of steps of {h:g} s, which '
                    f'{setting.label} is to take; give --steps that divide it, such as '
                    f'{horizon / 100.0:g}')


def _identity(scene: Scene, hamiltonian: Hamiltonian, runs: int) -> dict[str, str]:
    content = scene.model_dump(include={'hamiltonian', 'initial_state', 'step_size'})
    text = json.dumps([content, hamiltonian.provenance], sort_keys=True)
    return {'scene': f'{scene.name}, sha256 {sha256(text.encode()).hexdigest()}',
            'version': __version__, 'machine': machine(), 'number of --runs': str(runs)}
