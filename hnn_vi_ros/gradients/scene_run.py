# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Differentiable runs of one scene, each with its own values of some of the scene's numbers."""

from collections.abc import Mapping
from typing import NamedTuple

from hnn_vi_ros.errors import SceneError
from hnn_vi_ros.gradients.acting_effects import flow_rates
from hnn_vi_ros.gradients.dependences import Dependence, on_number
from hnn_vi_ros.gradients.derivatives import DifferentiableRun
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.scene import Parts
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
    parts : Parts
        Of the scene; others can run with them at the same time.

    Attributes
    ----------
    run : DifferentiableRun
        With the values that it was last told to hold.

    Raises
    ------
    HnnViRosError
        See DifferentiableRun.

    """

    def __init__(self, parts: Parts):
        # Kernels have working memory, which another run may be using.
        self._own = self._now = parts = parts.copy()
        h = parts.scene.known_step_size
        self.run = DifferentiableRun(parts.hamiltonian, parts.integrator, h, parts.effects)
        self._held: Numbers | None = Numbers({}, h)
        self._beside: dict[tuple[str, int], System] = {}

    def hold(self, numbers: Numbers) -> None:
        """Let what runs from now on have these values, or raise SceneError."""
        if numbers is self._held or (self._held is not None and numbers == self._held
                                     and not numbers.values):
            self._held = numbers
            return
        self._held = None
        made = _changed(self._own, numbers.values)
        if numbers.hamiltonian is not None:
            made = made._replace(hamiltonian=numbers.hamiltonian.copy())
        self.run.take_numbers(made.hamiltonian, made.effects, numbers.step_size)
        self._now, self._held = made, numbers

    def on_number(self, name: str) -> Dependence:
        """Return the dependence on a number of the scene where it is now, or raise ValueError."""
        assert self._held is not None
        value = self._held.values[name]
        try:
            return on_number(lambda other, offset: self._beside_now(name, other, offset), value)
        except SceneError as problem:
            raise ValueError(f'{name} = {value:g} is too near to the end of its range to be '
                             f'differentiated by: {problem}') from problem

    def _beside_now(self, name: str, value: float, offset: int
                    ) -> tuple[Kernel, np.ndarray | None]:
        """Return the kernel with another value, and the rates of damping that depend on it."""
        _, hamiltonian, integrator, effects = _changed(self._now, {name: value})
        system = self._beside.get((name, offset))
        if system is None or not system.take_numbers(hamiltonian, effects):
            system = System(hamiltonian, effects, integrator)
            self._beside[name, offset] = system
        return system.kernel, flow_rates(hamiltonian, integrator, effects) \
            if name.startswith(_EFFECTS) else None


def _changed(parts: Parts, values: Mapping[str, float]) -> Parts:
    """Return parts with other numbers; of H or of effects alone, where the others stay."""
    scene = with_known_numbers(parts.scene, values)
    # Numbers of H have no influence on effects, nor these on H.
    if not all(name.startswith(_EFFECTS) for name in values):
        parts = parts._replace(hamiltonian=scene.create_hamiltonian())
    if any(name.startswith(_EFFECTS) for name in values):
        parts = parts._replace(effects=scene.create_effects())
    return parts._replace(scene=scene)
