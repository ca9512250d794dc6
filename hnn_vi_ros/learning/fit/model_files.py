# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Fitted networks as models with their cards, and as files that scenes and effects can read."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
import warnings

from hnn_vi_ros.errors import AlarmWarning
from hnn_vi_ros.learning.data.motions import EvenMotion, joined
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.models import (
    Box, Checkpoint, CoordinateCard, DomainCard, Layers, ModelCard, save_checkpoint, widths_of)
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.version import __version__
import numpy as np
import torch


def described(config: Any, networks: Mapping[str, Layers], name: str, command: str,
              **entries: Any) -> Checkpoint:
    """Return a trained model with its card; ``entries`` are task-specific card entries."""
    coordinates = [CoordinateCard(name=one.name, q_unit=one.q_unit, p_unit=one.p_unit)
                   for one in config.coordinates]
    return Checkpoint(ModelCard(
        name=name, coordinates=coordinates, seed=config.seed, training_command=command,
        package_version=__version__, **widths_of(networks), **entries), networks)


def describe_machine(network: MechanicalNetwork, config: MachineConfig,
                     motions: Sequence[EvenMotion], description: str = '',
                     losses: Mapping[str, float] | None = None, name: str = 'draft',
                     command: str = '', delay: float = 0.0, step_size: float | None = None,
                     **entries: Any) -> Checkpoint:
    """Return a trained network with its card: delay of the forces, and step of the fit [s]."""
    q, v, tau = joined(motions, 'q_smooth', 'v_smooth', 'tau')
    with torch.no_grad():
        p = (network.masses(torch.tensor(q)) @ torch.tensor(v)[:, :, None])[:, :, 0].numpy()
    return described(
        config, network.networks(), name, command, family='mechanical', box=Box.of(q, p),
        mechanical=network.card([one.p_unit for one in config.coordinates]).model_copy(
            update={'delay': delay, 'inputs': config.data.inputs, 'step_size': step_size}),
        dataset=description, losses=dict(losses or {}), domain=DomainCard.of(q, v, tau), **entries)


def with_prior(checkpoint: Checkpoint, **entries: Any) -> Checkpoint:
    """Return a model with other entries of the prior on its card."""
    mechanical = checkpoint.card.mechanical
    assert mechanical is not None and mechanical.prior is not None, 'of a prior'
    prior = mechanical.prior.model_copy(update=entries)
    return replace(checkpoint, card=checkpoint.card.model_copy(update={
        'mechanical': mechanical.model_copy(update={'prior': prior})}))


@contextmanager
def drafted(checkpoint: Checkpoint) -> Iterator[str]:
    """Write a model to a temporary file that scenes and effects can read."""
    with TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter('ignore', AlarmWarning)
        draft = Path(folder) / 'draft.safetensors'
        save_checkpoint(draft, checkpoint)
        yield str(draft)


def machine_scene(model: str, card: ModelCard, step_size: float, integrator: str, driven: bool,
                  start: tuple[EvenMotion, int] | None = None, place: Path | None = None) -> Scene:
    """
    Return the scene of a machine in a model file, with friction and, if driven, forces.

    It starts from a sample of a motion; without one it is at rest in the middle of the data;
    `place` is the scene's future file, in whose folder the model is.
    """
    motion, k = start or (None, 0)
    effects: list[dict[str, object]] = [{'kind': 'learned_friction', 'model': model}]
    if driven:
        assert card.mechanical is not None, 'the family has one'
        effects.append({'kind': 'external_force', 'timeout': 1e9} | (
            {'coordinates': [one.name for one in card.coordinates]}
            if card.mechanical.input_map is None else {'model': model}))
    return Scene.build(
        description=f'starts from a state of {motion.name}' if motion else '',
        hamiltonian={'kind': 'learned', 'model': model, 'confine': False}, effects=effects,
        integrator=integrator, step_size=step_size, name=str(place or card.name),
        initial_state={
            'q': motion.q_smooth[k].tolist(), 'v': motion.v_smooth[k].tolist()} if motion else {
            'q': np.mean(card.box.q, axis=1).tolist(), 'p': [0.0] * len(card.coordinates)})
