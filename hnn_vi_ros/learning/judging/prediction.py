# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Predict measured motions by a model or a scene, with the measured forces."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from hnn_vi_ros.accuracy.automatic_choice import resolve
from hnn_vi_ros.effects.base import Effect
from hnn_vi_ros.effects.damping import Damping
from hnn_vi_ros.effects.external_force import ExternalForce
from hnn_vi_ros.effects.input_map import has_map
from hnn_vi_ros.effects.learned_dissipation import LearnedDissipation
from hnn_vi_ros.effects.learned_friction import LearnedFriction
from hnn_vi_ros.errors import DataError
from hnn_vi_ros.files.resources import is_path
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.integrators.base import Integrator
from hnn_vi_ros.integrators.implicit_midpoint import ImplicitMidpoint
from hnn_vi_ros.integrators.variational_midpoint import VariationalMidpoint
from hnn_vi_ros.learning.data.runs import Run, steps_between
from hnn_vi_ros.learning.judging.energy_account import balance, energy_mismatch, unaccounted
from hnn_vi_ros.learning.judging.evaluation import (
    constant_velocity, Fan, fans_of, score, score_fans, Scores, simulated, variance_of)
from hnn_vi_ros.models.checkpoint import load_checkpoint
from hnn_vi_ros.models.confined import load_learned
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import Simulation
import numpy as np

# Commands hold to the end of the simulation [s].
_FOREVER = 1e9


def parts_of(model: str) -> tuple[Hamiltonian, Integrator, float | None, list[Effect]]:
    """Return H, method, step size (None: that of the data) and effects of a model or scene."""
    if model.endswith('.safetensors'):
        hamiltonian = load_learned(Path(model), confine=False)
        if not hamiltonian.canonical:
            return hamiltonian, VariationalMidpoint(), None, []
        return hamiltonian, ImplicitMidpoint(), None, own_effects(model, hamiltonian)
    scene = load_scene(model if not is_path('scene', model) else Path(model))
    scene, _ = resolve(scene)
    hamiltonian, effects = scene.create_hamiltonian(), scene.create_effects()
    for effect in effects:
        if isinstance(effect, ExternalForce):
            effect.timeout = _FOREVER
            if effect.names:
                checkpoint = getattr(hamiltonian, 'checkpoint', None)
                if checkpoint is not None and has_map(checkpoint):
                    raise DataError(f'{model}: its model has learned what the motors do to the '
                                    'joints, and external_force acts on the joints themselves; '
                                    'give it the model in place of coordinates')
                # Each coordinate has a measured force, in the order of H.
                effect.names = tuple(names_of(hamiltonian))
    return hamiltonian, scene.create_integrator(), scene.step_size, effects


def names_of(hamiltonian: Hamiltonian) -> list[str]:
    """Return the names of the coordinates."""
    return [coordinate.name for coordinate in hamiltonian.coordinates]


def own_effects(model: str, hamiltonian: Hamiltonian) -> list[Effect]:
    """Return what a model file has learned beside H, and where forces act on it, for good."""
    checkpoint = load_checkpoint(model, ensembles=True)
    card = checkpoint.card
    effects: list[Effect] = [
        ExternalForce(model=model, timeout=_FOREVER) if has_map(checkpoint) else
        ExternalForce(names_of(hamiltonian), timeout=_FOREVER)]
    if card.mechanical is not None:
        effects.append(LearnedFriction(model))
    if card.friction is not None:
        effects.append(Damping(model=model))
    if 'dissipation' in checkpoint.networks:
        effects.append(LearnedDissipation(model))
    return effects


def simulation_of(hamiltonian: Hamiltonian, integrator: Integrator, effects: Sequence[Effect],
                  motions: Sequence[Run], step_size: float | None = None) -> Simulation:
    """
    Return the simulation that predicts motions, which share one interval.

    Steps are the data's interval, or the largest whole part of it that is about ``step_size`` or
    less.
    """
    spacing = motions[0].spacing
    steps = 1 if step_size is None else steps_between(spacing, step_size)
    return Simulation(hamiltonian, integrator, spacing / steps, motions[0].q_smooth[0],
                      np.zeros(hamiltonian.dimension), effects)


def judge(simulation: Simulation, effects: Sequence[Effect], motions: Sequence[Run],
          horizons: Sequence[float], every: float, longest: float
          ) -> tuple[dict[str, Scores], list[Fan]]:
    """Return the scores of a model, and of constant velocity for scale; and its predictions."""
    variance = variance_of(motions)
    predict = simulated(simulation, motions[0].spacing, max(horizons), variance)
    fans = fans_of(predict, motions, horizons, every, longest)
    scores = {'model': score_fans(fans, horizons, variance),
              'constant velocity': score(constant_velocity, motions, horizons, every, longest)}
    if not unaccounted(effects):
        mismatch = energy_mismatch(
            [balance(simulation.hamiltonian, effects, motion) for motion in motions],
            motions[0].spacing, horizons)
        scores['model'] = replace(scores['model'], energy_mismatch=mismatch)
    return scores, fans
