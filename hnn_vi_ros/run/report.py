# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Report on the simulated scene, with the measured cost of each of its effects."""

from dataclasses import asdict, dataclass
import math
from pathlib import Path
import time
from typing import Any

from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.scene import Parts, Scene
from hnn_vi_ros.simulation import build, Chosen, Simulation
import numpy as np


@dataclass(frozen=True)
class EffectCosts:
    """
    Wall times of one step.

    Parameters
    ----------
    total : float
        Of the whole scene [s].
    bare : float
        Of its Hamiltonian and integrator alone [s]; NaN where they cannot run alone.
    added : dict of str to float
        For each effect, by its label, what the scene takes longer with it than without it [s];
        NaN where the scene cannot run without it.

    """

    total: float
    bare: float
    added: dict[str, float]


def measure_effects(parts: Parts, batches: int = 15, batch_time: float = 0.02) -> EffectCosts:
    """
    Measure the scene, its bare integrator, and the scene without each of its effects in turn.

    Each variant is compiled as a scene of its own. They take turns, so that whatever else the
    machine does hits all of them; a share is the median of the differences in the same turn.

    Parameters
    ----------
    parts : Parts
        Parts of the scene to measure, from its initial state on.
    batches : int, optional
        Turns.
    batch_time : float, optional
        About how long the whole scene runs in each turn [s].

    Raises
    ------
    HnnViRosError
        The scene itself cannot be built or fails.

    """
    scene, effects = parts.scene, parts.effects
    kept = [effects, [], *(effects[:i] + effects[i + 1:] for i in range(len(effects)))]
    simulation = build(parts)
    steps = _calibrate(simulation, scene, batch_time)
    simulations = [simulation, *(_try_to_run(parts.copy()._replace(effects=some), steps)
                                 for some in kept[1:])]
    times = np.full((batches, len(kept)), math.nan)
    for turn in times:
        for i, variant in enumerate(simulations):
            if variant is not None:
                turn[i] = _run(variant, scene, steps) / steps
    whole, bare, *without = times.T
    return EffectCosts(
        float(np.median(whole)), float(np.median(bare)),
        {label: float(np.median(whole - other))
         for label, other in zip(simulation.works, without, strict=True)})


def _calibrate(simulation: Simulation, scene: Scene, batch_time: float) -> int:
    """Compile, and return a number of steps that takes about the given time [s]."""
    simulation.compile()
    steps, seconds = 1, 0.0
    while seconds < 0.5 * batch_time:
        steps *= 2
        seconds = _run(simulation, scene, steps)
    return steps


def _try_to_run(parts: Parts, steps: int) -> Simulation | None:
    """Build and warm up some of the parts; None where it cannot do without the rest."""
    try:
        simulation = build(parts)
        simulation.compile()
        _run(simulation, parts.scene, steps)
    except HnnViRosError:
        return None
    return simulation


def _run(simulation: Simulation, scene: Scene, steps: int) -> float:
    """Take steps from the initial state on; return the wall time they took [s]."""
    simulation.restart(scene.initial_state.q, scene.initial_state.p)
    start = time.perf_counter()
    simulation.advance(steps)
    return time.perf_counter() - start


def _place(file: Path) -> str:
    """Return where a file is; its name alone once the working directory has been removed."""
    try:
        return str(file.absolute())
    except FileNotFoundError:
        return str(file)


def scene_report(scene: Scene, simulation: Simulation, origin: int = 0,
                 explain: bool = False, chosen: Chosen | None = None) -> dict[str, Any]:
    """
    Return what ~/scene and the log tell: the scene with all defaults, and where it begins.

    What auto chose, where H and the scene come from, and whether H is conserved are among it.

    Parameters
    ----------
    scene : Scene
        The simulated scene.
    simulation : Simulation
        Made of it, in its initial state, whose step is told: what else a run needs that is to be
        had again.
    origin : int
        Stamp of step 0 [ns].
    explain : bool
        Whether to measure the wall time of a step, and what each effect adds; compiles a kernel
        for each. Without it equal runs tell the same.
    chosen : Chosen or None
        The choice of the integrator auto, if it made one.

    """
    choice = {} if chosen is None else {
        'tolerance': asdict(chosen.tolerance), 'choice': asdict(chosen.choice)}
    report = (scene.model_dump() | choice | simulation.hamiltonian.provenance | {
        'model_files': scene.model_digests, 'source': _place(scene.source), 'origin': origin,
        'first_step': simulation.steps, 'conservative': simulation.conservative})
    if explain:
        costs = measure_effects(scene.parts())
        report['microseconds_per_step'] = _microseconds(costs.total)
        report['added_microseconds'] = {
            label: _microseconds(seconds) for label, seconds in costs.added.items()}
    return report


def _microseconds(seconds: float) -> float | None:
    """Return a time to the nanosecond, beyond which all is noise; None if it was not measured."""
    return None if math.isnan(seconds) else round(1e6 * seconds, 3)
