# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Report on the simulated scene, with the measured cost of each of its effects."""

from dataclasses import asdict, dataclass
import math
import time
from typing import Any

from hnn_vi_ros.errors import HnnViRosError
from hnn_vi_ros.run.run_folder import working_folder
from hnn_vi_ros.scene import Parts, Scene
from hnn_vi_ros.simulation import build, Chosen, Simulation
import numpy as np


@dataclass(frozen=True)
class EffectCosts:
    """
    Processor times of one step.

    Parameters
    ----------
    total : float
        Time of the whole scene [s].
    bare : float
        Time of its Hamiltonian and integrator alone [s]; NaN if they cannot run alone.
    added : dict of str to float
        Time that each effect adds to the scene, by label [s]; NaN if the scene cannot run
        without the effect.

    """

    total: float
    bare: float
    added: dict[str, float]


def measure_effects(parts: Parts, batches: int = 15, batch_time: float = 0.02) -> EffectCosts:
    """
    Measure the scene, its bare integrator, and the scene without each of its effects.

    Each variant is compiled as a separate scene. The variants run in turns, so that other load on
    the machine affects all of them; a cost is the median of the differences within a turn. Times
    are processor times, as in ``measure_costs``.

    Parameters
    ----------
    parts : Parts
        Parts of the scene, which is run from its initial state.
    batches : int, optional
        Number of turns.
    batch_time : float, optional
        Approximate time of the whole scene in each turn [s].

    Raises
    ------
    HnnViRosError
        The whole scene cannot be built or fails.

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
    # The first run also loads code, which would look like the time of its steps.
    _run(simulation, scene, 4)
    # At least four: a step may fail late.
    steps, seconds = 2, 0.0
    while seconds < 0.5 * batch_time:
        steps *= 2
        seconds = _run(simulation, scene, steps)
    return steps


def _try_to_run(parts: Parts, steps: int) -> Simulation | None:
    """Build and warm up a scene with some of the parts; return None if it needs the others."""
    try:
        simulation = build(parts)
        simulation.compile()
        _run(simulation, parts.scene, steps)
    except HnnViRosError:
        return None
    return simulation


def _run(simulation: Simulation, scene: Scene, steps: int) -> float:
    """Take steps from the initial state; return their processor time [s]."""
    simulation.restart(scene.initial_state.q, scene.initial_state.p)
    start = time.process_time()
    simulation.advance(steps)
    return time.process_time() - start


def scene_report(scene: Scene, simulation: Simulation, origin: int = 0,
                 chosen: Chosen | None = None) -> dict[str, Any]:
    """
    Return the contents of ~/scene and of the log: the scene with all defaults, and its start.

    These include the choice of auto, the origins of H and the scene, and the conservation of H.

    Parameters
    ----------
    scene : Scene
        The simulated scene.
    simulation : Simulation
        Simulation of the scene in its initial state, whose step is reported, since a
        reproduction of the run needs it.
    origin : int
        Stamp of step 0 [ns].
    chosen : Chosen or None
        The choice of the integrator auto, if it made one.

    """
    choice = {} if chosen is None else {
        'tolerance': asdict(chosen.tolerance), 'choice': asdict(chosen.choice)}
    loops = getattr(simulation.system.constraints, 'report', '')
    said = {'loops': loops} if loops else {}
    # A scene may state velocities; a reproduction needs the momenta to all digits.
    said['initial_state'] = {'q': scene.initial_state.q, 'p': scene.initial_state.p}
    return (scene.model_dump() | choice | said | simulation.hamiltonian.provenance | {
        'model_files': scene.model_digests, 'source': str(working_folder() / scene.source),
        'origin': origin, 'first_step': simulation.steps, 'conservative': simulation.conservative})
