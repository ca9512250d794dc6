# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What is told of the scene that is simulated."""

from dataclasses import asdict
import math
from pathlib import Path
from typing import Any

from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import Simulation
import yaml


def resolved_scene(scene: Scene, simulation: Simulation, origin: int = 0, first_step: int = 0
                   ) -> dict[str, Any]:
    """
    Return the scene with all defaults, what auto chose, and where it and H come from.

    Parameters
    ----------
    scene : Scene
        What is simulated.
    simulation : Simulation
        Made of it.
    origin, first_step : int
        Stamp of step 0 [ns], and the step at the scene's initial state: what else a run needs
        that is to be had again.

    """
    chosen = {}
    if scene.chosen is not None:
        chosen = dict(zip(('budget', 'choice'), map(asdict, scene.chosen), strict=True))
    begin = {'source': _place(scene.source), 'origin': origin, 'first_step': first_step}
    return scene.model_dump() | chosen | simulation.hamiltonian.provenance | begin


def _place(file: Path) -> str:
    """Return where a file is; its name alone once the working directory has been removed."""
    try:
        return str(file.absolute())
    except FileNotFoundError:
        return str(file)


def scene_report(scene: Scene, simulation: Simulation, microseconds_per_step: float | None,
                 explain: bool) -> str:
    """
    Return the resolved scene as YAML, with what is live in it and what that costs.

    Parameters
    ----------
    scene : Scene
        What is simulated.
    simulation : Simulation
        Made of it.
    microseconds_per_step : float or None
        Measured wall time of a step [us].
    explain : bool
        Whether to measure what each effect adds; compiles a kernel for each.

    """
    report = resolved_scene(scene, simulation) | {
        'live_effects': [effect.model_dump() for effect in scene.effects],
        'conservative': simulation.conservative,
        'microseconds_per_step': _rounded(microseconds_per_step),
    }
    if explain:
        # Imported here: only those who ask for it wait for it.
        from hnn_vi_ros.studies.effect_cost import measure_effects
        report['added_microseconds'] = {
            label: _rounded(1e6 * seconds)
            for label, seconds in measure_effects(scene).added.items()}
    return yaml.safe_dump(report, sort_keys=False)


def _rounded(microseconds: float | None) -> float | None:
    """Return it to the nanosecond, beyond which all is noise; None where there is none."""
    if microseconds is None or math.isnan(microseconds):
        return None
    return round(float(microseconds), 3)
