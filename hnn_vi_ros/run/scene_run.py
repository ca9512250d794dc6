# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Differentiable runs of one scene, each with its own values of some of the scene's numbers."""

from collections.abc import Mapping
from typing import NamedTuple

from hnn_vi_ros.effects.base import Effect
from hnn_vi_ros.errors import SceneError
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.run.acting_effects import flow_rates
from hnn_vi_ros.run.dependences import Dependence, on_number
from hnn_vi_ros.run.derivatives import DifferentiableRun
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.scene.named_numbers import with_known_numbers
from hnn_vi_ros.simulation.system import System
import numpy as np

_EFFECTS = 'effects.'


class Numbers(NamedTuple):
    """
    Values that a run is made with.

    Parameters
    ----------
    values : mapping of str to float
        By names of ``numbers_of`` that were checked.
    step_size : float
        h [s].
    hamiltonian : Hamiltonian or None
        In place of the scene's, one of the same kind: with other weights.

    """

    values: Mapping[str, float]
    step_size: float
    hamiltonian: Hamiltonian | None = None


class SceneRun:
    """
    A differentiable run of a scene, and its dependences on numbers; for one thread at a time.

    Parameters
    ----------
    scene : Scene
        That names its method and its step size.
    hamiltonian : Hamiltonian
        That of the scene.

    Attributes
    ----------
    run : DifferentiableRun
        With the values that it was last told to hold.

    Raises
    ------
    HnnViRosError
        See DifferentiableRun.

    """

    def __init__(self, scene: Scene, hamiltonian: Hamiltonian):
        self._scene, self._integrator = scene, scene.create_integrator()
        # Kernels have working memory, which another run may be using.
        self._own = hamiltonian.copy(), scene.create_effects()
        self.run = DifferentiableRun(self._own[0], self._integrator, scene.known_step_size,
                                     self._own[1])
        self._held: Numbers | None = Numbers({}, scene.known_step_size)
        self._now = scene, *self._own
        self._beside: dict[tuple[str, int], System] = {}

    def hold(self, numbers: Numbers) -> None:
        """Let what runs from now on have these values, or raise SceneError."""
        if numbers is self._held or (self._held is not None and numbers == self._held
                                     and not numbers.values):
            self._held = numbers
            return
        self._held = None
        scene = with_known_numbers(self._scene, numbers.values)
        hamiltonian, effects = self._made(scene, numbers.values)
        if numbers.hamiltonian is not None:
            hamiltonian = numbers.hamiltonian.copy()
        self.run.take_numbers(hamiltonian, effects, numbers.step_size)
        self._now, self._held = (scene, hamiltonian, effects), numbers

    def on_number(self, name: str) -> Dependence:
        """Return the dependence on a number of the scene where it is now, or raise ValueError."""
        assert self._held is not None
        value = self._held.values[name]
        try:
            return on_number(lambda other, offset: self._changed(name, other, offset), value)
        except SceneError as problem:
            raise ValueError(f'{name} = {value:g} is too near to the end of its range to be '
                             f'differentiated by: {problem}') from problem

    def _made(self, scene: Scene, values: Mapping[str, float]
              ) -> tuple[Hamiltonian, list[Effect]]:
        """Return H and effects of a scene, those that were made already where none differs."""
        hamiltonian, effects = self._own
        if not all(name.startswith(_EFFECTS) for name in values):
            hamiltonian = scene.create_hamiltonian()
        if any(name.startswith(_EFFECTS) for name in values):
            effects = scene.create_effects()
        return hamiltonian, effects

    def _changed(self, name: str, value: float, offset: int
                 ) -> tuple[Kernel, np.ndarray | None]:
        """Return the kernel with another value, and the rates of damping that depend on it."""
        scene, hamiltonian, effects = self._now
        scene = with_known_numbers(scene, {name: value})
        # Numbers of H have no influence on effects, nor these on H.
        if name.startswith(_EFFECTS):
            effects = scene.create_effects()
        else:
            hamiltonian = scene.create_hamiltonian()
        system = self._beside.get((name, offset))
        if system is None or not system.take_numbers(hamiltonian, effects):
            system = System(hamiltonian, effects, self._integrator)
            self._beside[name, offset] = system
        return system.kernel, flow_rates(hamiltonian, self._integrator, effects) \
            if name.startswith(_EFFECTS) else None
