# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Construction of simulations from scenes."""

from hnn_vi_ros.integrators import PhasePoint
from hnn_vi_ros.models import warn_of_scheme
from hnn_vi_ros.scene import AutoChoice, Parts, Scene
from hnn_vi_ros.simulation.assembly import advance, Loop
from hnn_vi_ros.simulation.rescue import Rescue
from hnn_vi_ros.simulation.simulation import Simulation
from hnn_vi_ros.simulation.system import System
import numpy as np
from numpy.typing import ArrayLike


def resolve(scene: Scene) -> Parts:
    """
    Return the parts of a scene, with a method and a step size in place of `integrator: auto`.

    Raises
    ------
    HnnViRosError
        No method meets the tolerance, or the scene cannot be built.

    """
    if isinstance(scene.integrator, AutoChoice):
        # Imported lazily: few scenes use `integrator: auto`.
        from hnn_vi_ros.simulation.accuracy.automatic_choice import choose
        scene, _ = choose(scene)
    return scene.parts()


def build(scene: Scene | Parts) -> Simulation:
    """
    Return a simulation of a scene in its initial state.

    Parameters
    ----------
    scene : Scene or Parts
        Scene with a method and a step size (``resolve`` replaces auto), or its
        parts; the simulation then uses their H itself, not a copy.

    Raises
    ------
    HnnViRosError
        The parts of the scene are incompatible or cannot be created.

    """
    scene, hamiltonian, integrator, effects = scene if isinstance(scene, Parts) else scene.parts()
    state = scene.initial_state
    warn_of_scheme(hamiltonian, scene.integrator.kind, scene.known_step_size)
    with scene.placed('initial_state'):
        return Simulation(hamiltonian, integrator, scene.known_step_size, state.q, state.p,
                          effects, scene.on_failure, scene.energy_by_cause)


def build_at(parts: Parts, q: ArrayLike, p: ArrayLike) -> Simulation:
    """Return a simulation with its own copy of H, in one or several states; see Simulation."""
    scene, hamiltonian, integrator, effects = parts.copy()
    return Simulation(hamiltonian, integrator, scene.known_step_size, q, p, effects,
                      scene.on_failure, scene.energy_by_cause)


def compile_loop(parts: Parts) -> None:
    """Compile the loop over steps of a scene, or load it from disk, without its H."""
    system = System(parts.hamiltonian, parts.effects, parts.integrator,
                    by_joint=parts.scene.energy_by_cause)
    rescue = Rescue(system, parts.scene.on_failure)
    n = system.kernel.dimension
    Loop(advance, system.kernel, rescue.methods[0], provide=False).compile(
        parts.scene.known_step_size, 0, 1, PhasePoint.empty(n), PhasePoint.empty(n),
        rescue.memories(n)[0], *np.empty((2, 1, n)), 1)
