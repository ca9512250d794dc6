# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Report on the scene that is simulated."""

from dataclasses import asdict
import math
from pathlib import Path
from typing import Any

from hnn_vi_ros.accuracy.automatic_choice import Chosen
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import Simulation


def resolved_scene(scene: Scene, simulation: Simulation, origin: int = 0, first_step: int = 0,
                   chosen: Chosen | None = None) -> dict[str, Any]:
    """
    Return the scene with all defaults, what auto chose, and where it and H come from.

    Parameters
    ----------
    scene : Scene
        The simulated scene.
    simulation : Simulation
        Made of it.
    origin, first_step : int
        Stamp of step 0 [ns], and the step at the scene's initial state: what else a run needs
        that is to be had again.
    chosen : Chosen or None
        The choice of the integrator auto, if it made one.

    """
    choice = {} if chosen is None else {
        'tolerance': asdict(chosen.tolerance), 'choice': asdict(chosen.choice)}
    begin = {'source': _place(scene.source), 'origin': origin, 'first_step': first_step}
    return (scene.model_dump() | choice | simulation.hamiltonian.provenance
            | {'model_files': scene.model_digests} | begin)


def _place(file: Path) -> str:
    """Return where a file is; its name alone once the working directory has been removed."""
    try:
        return str(file.absolute())
    except FileNotFoundError:
        return str(file)


def scene_report(scene: Scene, simulation: Simulation, origin: int = 0,
                 microseconds_per_step: float | None = None, explain: bool = False,
                 chosen: Chosen | None = None) -> dict[str, Any]:
    """
    Return the resolved scene, and whether it conserves H: what ~/scene and the log tell.

    Parameters
    ----------
    scene : Scene
        The simulated scene.
    simulation : Simulation
        Made of it, in its initial state.
    origin : int
        Stamp of step 0 [ns].
    microseconds_per_step : float or None
        Measured wall time of a step [us].
    explain : bool
        Whether to tell that, and to measure what each effect adds; compiles a kernel for each.
        Without it equal runs tell the same.
    chosen : Chosen or None
        The choice of the integrator auto, if it made one.

    """
    report = resolved_scene(scene, simulation, origin, simulation.steps, chosen) | {
        'conservative': simulation.conservative}
    if explain:
        # Imported here: only those who ask for it wait for it.
        from hnn_vi_ros.run.effect_cost import measure_effects
        report['microseconds_per_step'] = _rounded(microseconds_per_step)
        report['added_microseconds'] = {
            label: _rounded(1e6 * seconds)
            for label, seconds in measure_effects(scene.parts()).added.items()}
    return report


def _rounded(microseconds: float | None) -> float | None:
    """Return it to the nanosecond, beyond which all is noise; None for no measured time."""
    if microseconds is None or math.isnan(microseconds):
        return None
    return round(float(microseconds), 3)
