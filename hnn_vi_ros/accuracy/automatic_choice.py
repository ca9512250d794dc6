# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""From a scene with the integrator auto to one that names its method and its step size."""

from dataclasses import replace
import json
from typing import NamedTuple

from hnn_vi_ros.accuracy.calibration import calibrate, Choice, remembered
from hnn_vi_ros.accuracy.trials import InitialValueProblem, Tolerance
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.scene.choices import AutoChoice
import numpy as np
from pydantic import ValidationError


class Chosen(NamedTuple):
    """Question put to the integrator auto, its energy scale known now, and the choice it made."""

    tolerance: Tolerance
    choice: Choice


def tolerance_of(choice: AutoChoice) -> Tolerance:
    """Return what the integrator auto is asked for."""
    if choice.energy_error is not None:
        return Tolerance('energy_error', choice.energy_error, choice.horizon)
    assert choice.path_error is not None, 'its schema asks for one of them'
    return Tolerance('path_error', choice.path_error, choice.horizon)


def problem_of(scene: Scene) -> InitialValueProblem:
    """Return what a scene describes, whatever its method, or raise HnnViRosError."""
    state = scene.initial_state
    return InitialValueProblem(scene.create_hamiltonian(), tuple(scene.create_effects()),
                               np.array(state.q), np.array(state.p))


def resolve(scene: Scene, largest_step: float | None = None) -> tuple[Scene, Chosen | None]:
    """
    Return a scene with a method and a step size in place of the integrator auto, if it has that.

    Parameters
    ----------
    scene : Scene
        With the integrator auto or any other.
    largest_step : float, optional
        A time that the step must divide where the scene names none, such as that between two
        samples [s].

    Returns
    -------
    scene : Scene
        The same if it names its method.
    chosen : Chosen or None
        The choice, if the scene asks for one.

    Raises
    ------
    HnnViRosError
        No method holds the tolerance, or the scene cannot be built.

    """
    if not isinstance(scene.integrator, AutoChoice):
        return scene, None
    problem = problem_of(scene)
    tolerance = tolerance_of(scene.integrator)
    with scene.placed('integrator'):
        base = scene.step_size or largest_step
        if _names_code(scene):
            # The code, and its imports, may change from one time to the next.
            choice = calibrate(problem, tolerance, base)
        else:
            name = json.dumps([scene.model_dump_json(), scene.model_digests])
            choice = remembered(problem, tolerance, base, name)
    resolved = scene.changed({'step_size': choice.step_size,
                              'integrator': {'kind': choice.method, **choice.arguments}})
    return resolved, Chosen(replace(tolerance, energy_scale=choice.energy_scale), choice)


def _names_code(scene: Scene) -> bool:
    """Return whether the motion depends on Python code of the user's."""
    try:
        # As of a bag, for which none is run.
        Scene.model_validate(scene.model_dump(exclude={'invariants'}))
    except ValidationError:
        return True
    return False
