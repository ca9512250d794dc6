# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Predictors of measured motions: models, scenes, and the baselines they are compared with."""

from collections.abc import Callable, Sequence
import logging
import math
from pathlib import Path

from hnn_vi_ros.effects import (
    Damping, Effect, ExternalForce, has_map, LearnedDissipation, LearnedFriction)
from hnn_vi_ros.errors import DataError, listed, prefixed
from hnn_vi_ros.files import is_path
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators import ImplicitMidpoint, VariationalMidpoint
from hnn_vi_ros.learning.data.motions import EvenMotion
from hnn_vi_ros.learning.fit.following import LogSimulation
from hnn_vi_ros.learning.fit.machine import Network, runge_kutta
from hnn_vi_ros.learning.fit.windows import FOREVER, ModelParts, windows_at
from hnn_vi_ros.models import load_checkpoint, load_learned
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import build, resolve
import numpy as np
import torch


# Inertia below which a joint needs that of its rotor, relative to the largest one.
_LIGHT = 1e-3
_LOGGER = logging.getLogger(__name__)

# ``predict(motion, starts, count)`` returns q, shape (starts, count + 1, d), at the samples from
# each start on, or at fewer if the motion ends before; NaN after a failure of the simulation.
Predict = Callable[[EvenMotion, np.ndarray, int], np.ndarray]


def parts_of(model: str) -> ModelParts:
    """Return the parts of a model, which takes the steps of the data, or of a scene."""
    parts = _parts(model)
    if parts.hamiltonian.time is not None:
        raise DataError(f'{model}: its H depends on the time, which evaluate does not support')
    return parts


def _parts(model: str) -> ModelParts:
    if model.endswith('.safetensors'):
        hamiltonian = load_learned(Path(model), confine=False)
        if not hamiltonian.canonical:
            return ModelParts(hamiltonian, VariationalMidpoint(), [], math.inf)
        return ModelParts(
            hamiltonian, ImplicitMidpoint(), own_effects(model, hamiltonian), math.inf)
    scene = load_scene(model if not is_path('scene', model) else Path(model))
    parts = resolve(scene)
    build(parts)  # checks that the parts fit each other
    scene, hamiltonian, integrator, effects = parts
    for i, effect in enumerate(effects):
        if isinstance(effect, ExternalForce):
            effect.timeout = FOREVER
            if effect.names:
                checkpoint = getattr(hamiltonian, 'checkpoint', None)
                if checkpoint is not None and has_map(checkpoint):
                    raise DataError(f'{model}: its model has a learned input map, but '
                                    'external_force acts directly on the joints; give it the '
                                    'model instead of coordinates')
                # All coordinates have a measured force, in the order of H.
                effects[i] = effect.on(names_of(hamiltonian), FOREVER)
    return ModelParts(hamiltonian, integrator, effects, scene.known_step_size)


def names_of(hamiltonian: Hamiltonian) -> list[str]:
    """Return the names of the coordinates."""
    return [coordinate.name for coordinate in hamiltonian.coordinates]


def own_effects(model: str, hamiltonian: Hamiltonian) -> list[Effect]:
    """Return the learned effects of a model besides H, and its external force."""
    checkpoint = load_checkpoint(model, ensembles=True)
    card = checkpoint.card
    effects: list[Effect] = [
        ExternalForce(model=model, timeout=FOREVER) if has_map(checkpoint) else
        ExternalForce(names_of(hamiltonian), timeout=FOREVER)]
    if card.mechanical is not None:
        effects.append(LearnedFriction(model))
    if card.friction is not None:
        effects.append(Damping(model=model))
    if 'dissipation' in checkpoint.networks:
        effects.append(LearnedDissipation(model))
    return effects


def simulated(parts: ModelParts) -> Predict:
    """
    Return a predictor that simulates a model with the measured forces.

    Its ``external_force`` takes as many commands as the motions have forces.
    """
    def predict(motion: EvenMotion, starts: np.ndarray, count: int) -> np.ndarray:
        windows = windows_at([motion], [(0, start) for start in starts], count)
        log = LogSimulation(parts, windows)
        states = log.starts(*windows.start.swapaxes(0, 1))
        for start, state in zip(starts, states, strict=True):
            with prefixed(f'{motion.name}: the state at {motion.t[start]:.6g} s cannot be '
                          'simulated', DataError):
                log.simulation.check_state(*np.split(state, 2))
        found: np.ndarray = log.states(states[:, None])[:, 0, :, :motion.q.shape[1]]
        fails = ~np.isfinite(found).all(axis=2) & windows.there
        if fails.any():
            row = int(fails.any(axis=1).argmax())
            _LOGGER.warning('warning: %s: errors are inf, since the simulation from %.4g s on '
                            'fails after %.3g s%s', motion.name, motion.t[starts[row]],
                            motion.spacing * fails[row].argmax(),
                            _light_joints(parts.hamiltonian, *np.split(states[row], 2)))
        return found
    return predict


def _light_joints(hamiltonian: Hamiltonian, q: np.ndarray, p: np.ndarray) -> str:
    """Return a remark on coordinates with next to no inertia at a state, '' for none."""
    inverse = [hamiltonian.hessian_vector(q, p, np.zeros_like(q), unit)[1]
               for unit in np.eye(len(q))]
    inertia = 1.0 / np.diag(inverse)
    light = [name for name, x in zip(names_of(hamiltonian), inertia, strict=True)
             if x < _LIGHT * inertia.max()]
    return f'; {listed(light)}: next to no inertia beside the others; geared joints have that ' \
        'of their motors, rotor_inertia' if light else ''


def constant_velocity(motion: EvenMotion, starts: np.ndarray, count: int) -> np.ndarray:
    """Predict motions with constant velocity, without any force."""
    t = motion.spacing * np.arange(count + 1)
    return motion.q_smooth[starts][:, None] + t[:, None] * motion.v_smooth[starts][:, None]


def linear_model(motions: Sequence[EvenMotion]) -> Predict:
    """Return a predictor x_(k+1) = A x_k + B tau_k + c, x = (q, v), fitted by least squares."""
    inputs, targets = [], []
    for motion in motions:
        x = np.hstack([motion.q_smooth, motion.v_smooth])
        tau = motion.forces
        inputs.append(np.hstack([x[:-1], tau, np.ones((len(tau), 1))]))
        targets.append(x[1:] - x[:-1])
    matrix = np.linalg.lstsq(np.concatenate(inputs), np.concatenate(targets), rcond=None)[0]
    spacing = motions[0].spacing

    def predict(motion: EvenMotion, starts: np.ndarray, count: int) -> np.ndarray:
        share = motion.spacing / spacing
        d = motion.q.shape[1]
        x = np.hstack([motion.q_smooth, motion.v_smooth])[starts]
        tau = motion.forces
        q = [x[:, :d]]
        # A may be unstable; overflow is scored as a failure.
        with np.errstate(over='ignore', invalid='ignore'):
            for k in range(count):
                row = np.minimum(starts + k, len(tau) - 1)
                x = x + share * np.hstack([x, tau[row], np.ones((len(x), 1))]) @ matrix
                q.append(x[:, :d])
        return np.stack(q, axis=1)
    return predict


def predicted_by(network: Network) -> Predict:
    """Return a predictor that integrates a network with the classical RK4 method."""
    def predict(motion: EvenMotion, starts: np.ndarray, count: int) -> np.ndarray:
        tau = torch.tensor(motion.forces)
        q, v = (torch.tensor(values[starts]) for values in (motion.q_smooth, motion.v_smooth))
        rows, found = torch.tensor(starts), [q]
        with torch.no_grad():
            for k in range(count):
                # Predictions beyond the end of the motion are not judged.
                held = tau[torch.clamp(rows + k, max=len(tau) - 1)]
                q, v = runge_kutta(network.accelerations, q, v, held, motion.spacing)
                found.append(q)
        return torch.stack(found, dim=1).numpy()
    return predict
