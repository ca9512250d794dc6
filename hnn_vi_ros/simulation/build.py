# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""From a scene to a simulation."""

from hnn_vi_ros.models.learned import warn_of_scheme
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import Simulation


def build(scene: Scene) -> Simulation:
    """
    Return a simulation of a scene, in its initial state.

    Parameters
    ----------
    scene : Scene
        That names its method and its step size; ``automatic_choice.resolve`` replaces auto.

    Raises
    ------
    HnnViRosError
        The parts of the scene do not fit together, or cannot be made.

    """
    hamiltonian, integrator = scene.create_hamiltonian(), scene.create_integrator()
    effects, state = scene.create_effects(), scene.initial_state
    warn_of_scheme(hamiltonian, scene.integrator.kind, scene.known_step_size)
    with scene.placed('initial_state'):
        return Simulation(hamiltonian, integrator, scene.known_step_size, state.q, state.p,
                          effects, scene.on_failure)
