# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Differentiable runs of a scene with varying values of its numbers."""

from collections.abc import Iterable, Mapping
from copy import copy
from dataclasses import replace
from typing import Any, NamedTuple

from hnn_vi_ros.errors import ModelError, SceneError
from hnn_vi_ros.kernels import Kernel
from hnn_vi_ros.models import Checkpoint, LearnedHamiltonian, MechanicalCard
from hnn_vi_ros.scene import check_known, numbers_in, Parts, set_value, with_known_numbers
from hnn_vi_ros.simulation.gradients.acting_effects import flow_rates, on_numbers
from hnn_vi_ros.simulation.gradients.dependences import Dependence, OnDifferences
from hnn_vi_ros.simulation.gradients.derivatives import DifferentiableRun
from hnn_vi_ros.simulation.system import System
import numpy as np
from pydantic import ValidationError

_EFFECTS, _MODEL, _URDF, _LOOPS = 'effects.', 'model.', 'urdf.', 'hamiltonian.loops.'
_DRIVES = 'hamiltonian.drives.'
# Fields of the model card of a machine that affect its motion.
_IN_CARD = 'friction', 'prior', 'input_map', 'fade'


class Numbers(NamedTuple):
    """
    Parameter values of a run.

    Parameters
    ----------
    values : mapping of str to float
        Values by name; checked names of ``numbers_of``, ``numbers_of_model`` and links.
    step_size : float
        Step size h [s].
    model : Checkpoint or None
        Model with other weights that replaces that of H.

    """

    values: Mapping[str, float]
    step_size: float
    model: Checkpoint | None = None


class SceneRun:
    """
    Differentiable run of a scene, and its dependences on numbers; not thread-safe.

    Parameters
    ----------
    parts : Parts
        Parts of the scene; they are copied, so other runs can use them at the same time.

    Attributes
    ----------
    run : DifferentiableRun
        Run with the values of the last call of ``hold``.

    Raises
    ------
    HnnViRosError
        See DifferentiableRun.

    """

    def __init__(self, parts: Parts):
        # Copy the parts: kernels have working memory, which another run may be using.
        self._own = self._now = parts = parts.copy()
        h = parts.scene.known_step_size
        self.run = DifferentiableRun(parts.hamiltonian, parts.integrator, h, parts.effects)
        self._held: Numbers | None = Numbers({}, h)
        self._model: Checkpoint | None = None
        self._beside: dict[tuple[str, int], System] = {}

    def hold(self, numbers: Numbers) -> None:
        """Set the values of subsequent runs, or raise SceneError."""
        held = self._held
        if numbers is held or (held is not None and numbers.model is held.model
                               and numbers[:2] == held[:2] and not numbers.values):
            self._held = numbers
            return
        self._held = None
        self._model = numbers.model
        if any(name.startswith(_MODEL) for name in numbers.values):
            self._model = _with_card(numbers.model or model_of(self._own), numbers.values)
        made = _changed(self._own, numbers.values, self._model)
        self.run.take_numbers(made.hamiltonian, made.effects, numbers.step_size)
        self._now, self._held = made, numbers

    def on_number(self, name: str) -> Dependence:
        """Return the dependence on a number at its current value, or raise ValueError."""
        assert self._held is not None
        if name.startswith(_LOOPS):
            raise ValueError(f'{name}: points and frames of loops are not differentiable yet; '
                             'remove it')
        value = self._held.values[name]
        try:
            return OnDifferences(
                lambda other, offset: self._beside_now(name, other, offset), value)
        except SceneError as problem:
            raise ValueError(f'{name} = {value:g} is too close to the end of its range to '
                             f'differentiate with respect to it: {problem}') from problem

    def _beside_now(self, name: str, value: float, offset: int
                    ) -> tuple[Kernel, np.ndarray | None]:
        """Return the kernel with another value, and the damping rates if they depend on it."""
        model = self._model
        if name.startswith(_MODEL):
            model = _with_card(model or model_of(self._now), {name: value})
        assert self._held is not None
        links = {key: held for key, held in self._held.values.items() if key.startswith(_URDF)}
        _, hamiltonian, integrator, effects = _changed(self._now, links | {name: value}, model)
        before = self._beside.get((name, offset))
        system = None if before is None else before.with_numbers(hamiltonian, on_numbers(effects))
        if system is None:
            system = self.run.beside(hamiltonian, effects)
        self._beside[name, offset] = system
        return system.kernel, flow_rates(hamiltonian, integrator, effects) \
            if name.startswith(_EFFECTS) else None


def _changed(parts: Parts, values: Mapping[str, float], model: Checkpoint | None) -> Parts:
    """Return parts with other numbers; H and effects are rebuilt only if theirs change."""
    own = {name: value for name, value in values.items() if not name.startswith((_MODEL, _URDF))}
    links = {name.removeprefix(_URDF): value for name, value in values.items()
             if name.startswith(_URDF)}
    scene = with_known_numbers(parts.scene, own)
    # Other numbers of H do not influence effects, nor the reverse.
    if not all(name.startswith(_EFFECTS) for name in own):
        parts = parts._replace(hamiltonian=scene.create_hamiltonian())
    if links:
        try:
            parts = parts._replace(hamiltonian=robot_of(parts).with_numbers(links))
        except ModelError as problem:
            raise SceneError(str(problem)) from problem
    if any(name.startswith((_EFFECTS, _DRIVES)) for name in own):
        parts = parts._replace(effects=scene.create_effects())
    parts = parts._replace(scene=scene)
    if model is None:
        return parts
    H = parts.hamiltonian
    assert isinstance(H, LearnedHamiltonian), 'only a learned H has a model'
    before, effects = H.checkpoint, [copy(effect) for effect in parts.effects]
    for effect in effects:
        # Update friction and input map only in effects that use the same model file.
        if effect.model is not None and effect.model.sha256 == before.sha256:
            effect.model = model
    return parts._replace(hamiltonian=type(H)(model), effects=effects)


def check_in_files(parts: Parts, names: Iterable[str]) -> list[str]:
    """Return the names that belong to a model or URDF; raise ValueError for unknown ones."""
    inside = [name for name in names if name.startswith((_MODEL, _URDF))]
    known: dict[str, float] = {}
    if any(name.startswith(_MODEL) for name in inside):
        known |= numbers_of_model(model_of(parts))
    if any(name.startswith(_URDF) for name in inside):
        known |= {f'{_URDF}{name}': value
                  for name, value in robot_of(parts).robot.numbers().items()}
    check_known(parts.scene.name, inside, known)
    return inside


def robot_of(parts: Parts) -> Any:
    """Return H, or raise ValueError unless it is built from a URDF."""
    if parts.scene.hamiltonian.kind != 'urdf':
        raise ValueError(f'{_URDF}... are parameters of the links of a URDF, but '
                         f'{parts.scene.name} has none')
    return parts.hamiltonian


def model_of(parts: Parts) -> Checkpoint:
    """Return the model of H, or raise ValueError unless it is a single model of a machine."""
    checkpoint = getattr(parts.hamiltonian, 'checkpoint', None)
    if checkpoint is None or checkpoint.card.mechanical is None or checkpoint.members:
        raise ValueError(f'{_MODEL}... are parameters of one model of the family mechanical '
                         f'or rigid_body, but H of {parts.scene.name} is not such a model')
    return checkpoint


def numbers_of_model(model: Checkpoint) -> dict[str, float]:
    """Return the numbers of a machine's model card by name, as ``model.friction.viscous.0``."""
    assert model.card.mechanical is not None, 'checked by model_of'
    values = model.card.mechanical.model_dump(include={*_IN_CARD})
    prior = values['prior']
    values['prior'] = prior and {
        name: quantity['value'] for name, quantity in prior['parameters'].items()}
    return {name: value for key in _IN_CARD
            for name, value in numbers_in(f'{_MODEL}{key}', values[key])}


def _with_card(model: Checkpoint, values: Mapping[str, float]) -> Checkpoint:
    """Return a model with other numbers in its card, or raise SceneError."""
    assert model.card.mechanical is not None, 'checked by model_of'
    data = model.card.mechanical.model_dump()
    for name, value in values.items():
        if not name.startswith(_MODEL):
            continue
        key, *path = name.removeprefix(_MODEL).split('.')
        if key == 'prior':
            data['prior']['parameters']['.'.join(path)]['value'] = value
        else:
            set_value(data[key], path, value)
    try:
        card = MechanicalCard.model_validate(data)
    except ValidationError as problem:
        raise SceneError(f'{", ".join(values)}: {problem.errors()[0]["msg"]}') from problem
    return replace(model, card=model.card.model_copy(update={'mechanical': card}))
