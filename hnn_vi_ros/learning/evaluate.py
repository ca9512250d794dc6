# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Judge a model or a scene by measured motions: ``ros2 run hnn_vi_ros evaluate``."""

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
import json
import math
import os
from pathlib import Path
import shlex

from hnn_vi_ros.accuracy.automatic_choice import resolve
from hnn_vi_ros.effects.base import Effect
from hnn_vi_ros.effects.damping import Damping
from hnn_vi_ros.effects.external_force import ExternalForce
from hnn_vi_ros.effects.input_map import has_map
from hnn_vi_ros.effects.learned_dissipation import LearnedDissipation
from hnn_vi_ros.effects.learned_friction import LearnedFriction
from hnn_vi_ros.errors import DataError, ParameterError, RecordingError
from hnn_vi_ros.files.resources import is_path
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.integrators.base import Integrator
from hnn_vi_ros.integrators.implicit_midpoint import ImplicitMidpoint
from hnn_vi_ros.integrators.variational_midpoint import VariationalMidpoint
from hnn_vi_ros.learning import arguments as command_lines, body_train
from hnn_vi_ros.learning.data.motion_arrays import ArraysData
from hnn_vi_ros.learning.data.motion_bags import BagMotions
from hnn_vi_ros.learning.data.motion_sources import guessed, read_motions
from hnn_vi_ros.learning.data.motions import Motion, steps_between
from hnn_vi_ros.learning.fit.machine_config import load_machine, Trajectory
from hnn_vi_ros.learning.inertias.rigid_body import best_rigid_body
from hnn_vi_ros.learning.judging.energy_account import balance, energy_mismatch, unaccounted
from hnn_vi_ros.learning.judging.evaluation import (
    constant_velocity, Fan, fans_of, linear_model, score, score_fans, Scores, simulated, table,
    variance_of)
from hnn_vi_ros.learning.judging.plain_network import predicted_by
from hnn_vi_ros.models.checkpoint import load_checkpoint
from hnn_vi_ros.models.confined import load_learned
from hnn_vi_ros.scene import load_scene
from hnn_vi_ros.simulation import Simulation
import numpy as np

# Commands hold to the end of the simulation [s].
_FOREVER = 1e9
_KEYS = 't', 'q', 'v', 'tau'
_NO_FORCES = 'with --keys t,q,dq of arrays, or forces: none of bags in the data of --config'


def main(argv: Sequence[str]) -> None:
    """Judge what the command line names."""
    arguments = command_lines.evaluate().parse_args(argv)
    for name in ('horizons', 'every', 'longest', 'smoothing'):
        value = getattr(arguments, name)
        values = value if isinstance(value, list) else [value]
        if value is not None and not all(
                math.isfinite(number) and number > 0.0 for number in values):
            raise ParameterError(f'--{name} {value}: expected positive numbers')
    if arguments.out is not None and arguments.out == arguments.json:
        raise ParameterError(f'--out {arguments.out} is a folder, and --json a file of its own; '
                             'name another')
    for option in ('out', 'json'):
        _check_free(option, getattr(arguments, option))
    if arguments.model.endswith('.safetensors') and (
            load_checkpoint(arguments.model, ensembles=True).card.lie_group is not None):
        body_train.evaluate(arguments)
        return
    hamiltonian, integrator, step_size, effects = parts_of(arguments.model)
    names = _names(hamiltonian)
    motions, description = _motions(arguments, arguments.data, names)
    driven = any(motion.tau.any() for motion in motions)
    if driven and not any(isinstance(effect, ExternalForce) for effect in effects):
        raise DataError(f'{arguments.data[0]}: the motions were driven, but {arguments.model} has '
                        'no effect external_force; add it with all coordinates, or leave the '
                        f'forces out, {_NO_FORCES}')
    if not driven:
        # An input map would want its own number of them.
        effects = [effect for effect in effects
                   if not isinstance(effect, ExternalForce) or effect.names]
    if arguments.baselines is not None:
        known, _ = _motions(arguments, arguments.baselines, names)
    simulation = _simulation(arguments.model, hamiltonian, integrator, effects, motions, step_size)
    asked = motions, arguments.horizons, arguments.every, arguments.longest
    scores, fans = judge(simulation, effects, *asked)
    if arguments.baselines is not None:
        others = {'linear model': linear_model(known)}
        if all(coordinate.q_unit == 'rad' for coordinate in hamiltonian.coordinates):
            # Its windows are those that training has unless it is told otherwise.
            rigid = best_rigid_body(Trajectory(kind='trajectory'), known)
            others |= {} if rigid is None else {'rigid body': predicted_by(rigid)}
        scores |= {name: score(other, *asked) for name, other in others.items()}
    text = (f'{arguments.model} on {description}, simulated freely from a state every '
            f'{arguments.every:g} s;\nroot mean square of the error at the end of each horizon, '
            'median of the valid prediction time,\nand what the energy changes by over each '
            f'horizon beside the work, as a share of its range{_left_out(effects)}\n\n'
            f'{table(scores, names)}\n\n{verdict(scores)}')
    print(text)
    command = shlex.join(['ros2', 'run', 'hnn_vi_ros', 'evaluate', *argv])
    try:
        _write(arguments, scores, f'{text}\n\n`{command}`', fans, hamiltonian)
    except OSError as problem:
        raise RecordingError(f'{problem.filename}: cannot be written: {problem.strerror}'
                             ) from problem


def _write(arguments: Namespace, scores: dict[str, Scores], text: str, fans: Sequence[Fan],
           hamiltonian: Hamiltonian) -> None:
    """Write the files that the command line asks for."""
    if arguments.json is not None:
        arguments.json.write_text(
            json.dumps(as_json(scores), indent=2, allow_nan=False) + '\n', encoding='utf-8')
    if arguments.out is not None:
        # Imported here: numbers alone need no libraries that draw.
        from hnn_vi_ros.learning.judging.prediction_report import write_evaluation
        # It may hold the numbers by now: --json may name a file in it.
        arguments.out.mkdir(parents=True, exist_ok=True)
        write_evaluation(arguments.out, Path(arguments.model).stem, text, fans,
                         max(arguments.horizons), hamiltonian.coordinates)
        print(f'\nreport: {arguments.out}')


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
                effect.names = tuple(_names(hamiltonian))
    return hamiltonian, scene.create_integrator(), scene.step_size, effects


def _names(hamiltonian: Hamiltonian) -> list[str]:
    return [coordinate.name for coordinate in hamiltonian.coordinates]


def own_effects(model: str, hamiltonian: Hamiltonian) -> list[Effect]:
    """Return what a model file has learned beside H, and where forces act on it, for good."""
    checkpoint = load_checkpoint(model, ensembles=True)
    card = checkpoint.card
    effects: list[Effect] = [
        ExternalForce(model=model, timeout=_FOREVER) if has_map(checkpoint) else
        ExternalForce(_names(hamiltonian), timeout=_FOREVER)]
    if card.mechanical is not None:
        effects.append(LearnedFriction(model))
    if card.friction is not None:
        effects.append(Damping(model=model))
    if 'dissipation' in checkpoint.networks:
        effects.append(LearnedDissipation(model))
    return effects


def _simulation(model: str, hamiltonian: Hamiltonian, integrator: Integrator,
                effects: Sequence[Effect], motions: Sequence[Motion], step_size: float | None
                ) -> Simulation:
    """Return the simulation of the command line, or raise DataError."""
    try:
        simulation = simulation_of(hamiltonian, integrator, effects, motions, step_size)
    except ValueError as problem:
        raise DataError(f'{model} cannot simulate {motions[0].name}: {problem}') from problem
    if simulation.takes_commands:
        try:
            simulation.set_command(motions[0].tau[0])
        except ValueError as problem:
            raise DataError(f'{model}: does not take the {motions[0].tau.shape[1]} forces of the '
                            'motions, by its input map or one for each coordinate; leave them '
                            f'out, {_NO_FORCES}') from problem
    return simulation


def simulation_of(hamiltonian: Hamiltonian, integrator: Integrator, effects: Sequence[Effect],
                  motions: Sequence[Motion], step_size: float | None = None) -> Simulation:
    """
    Return the simulation that predicts motions, which share one interval.

    Steps are the data's interval, or the largest whole part of it that is about ``step_size`` or
    less.
    """
    spacing = motions[0].spacing
    steps = 1 if step_size is None else steps_between(spacing, step_size)
    return Simulation(hamiltonian, integrator, spacing / steps, motions[0].q_smooth[0],
                      np.zeros(hamiltonian.dimension), effects)


def judge(simulation: Simulation, effects: Sequence[Effect], motions: Sequence[Motion],
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


def verdict(scores: dict[str, Scores]) -> str:
    """Return one plain sentence."""
    said = [f'{"at least " if found.censored >= 0.5 else ""}{found.valid_prediction_time:.2g} s'
            for found in scores.values()]
    others = ', '.join(f'{name} {text}' for name, text in zip(
        [*scores][1:], said[1:], strict=True))
    return f'The model follows the machine for {said[0]} (median); {others}.'


def as_json(scores: dict[str, Scores]) -> dict:
    """Return what ``--json`` writes: the model's numbers, and the others' as its baselines."""
    model, *others = (numbers(found) for found in scores.values())
    return model | {'baselines': dict(zip([*scores][1:], others, strict=True))}


def numbers(scores: Scores) -> dict:
    """Return scores for JSON, which has no infinity: None for an error that has no bound."""
    def known(value: float) -> float | None:
        return value if math.isfinite(value) else None
    return {'horizons': {f'{horizon:.15g}': [known(value) for value in rms.tolist()]
                         for horizon, rms in scores.horizons.items()},
            'valid_prediction_time': scores.valid_prediction_time,
            'censored': scores.censored, 'failed': scores.failed,
            'energy_mismatch': scores.energy_mismatch and {
                f'{horizon:.15g}': known(value)
                for horizon, value in scores.energy_mismatch.items()}}


def _left_out(effects: Sequence[Effect]) -> str:
    """Return why there is no energy mismatch, empty if there is one."""
    kinds = unaccounted(effects)
    return f'\n(not judged: states do not give the work of {", ".join(kinds)})' if kinds else ''


def _motions(arguments: Namespace, given: Sequence[str], names: Sequence[str]
             ) -> tuple[list[Motion], str]:
    """Return measured motions, read as the options or a training configuration say."""
    if arguments.config is not None:
        config = load_machine(arguments.config)
        source, data = arguments.config, config.data
    else:
        source, data = Path(given[0]), guessed(given[0])
    changes: dict[str, object] = {} if arguments.smoothing is None else {
        'smoothing': arguments.smoothing}
    if arguments.keys is not None:
        keys = arguments.keys.split(',')
        if len(keys) not in (3, 4) or not isinstance(data, ArraysData):
            raise ParameterError(f'--keys {arguments.keys}: expected those of {", ".join(_KEYS)} '
                                 'in an .npz file')
        changes |= {'time': keys[0], 'q': keys[1], 'v': keys[2],
                    'tau': keys[3] if len(keys) == 4 else None}
    if arguments.joints is not None:
        if not isinstance(data, BagMotions):
            raise ParameterError(f'--joints {arguments.joints}: only a bag has joints')
        changes['joints'] = arguments.joints.split(',')
    return read_motions(source, data.model_copy(update=changes), names, given)


def _check_free(option: str, path: Path | None) -> None:
    """Refuse, before the work, an output that is there already or cannot be written."""
    if path is None:
        return
    if os.path.lexists(path):
        raise ParameterError(f'--{option} {path} exists already and is not overwritten; name '
                             'another')
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
        path.unlink()
    except OSError as problem:
        raise ParameterError(f'--{option} {path}: cannot be written ({problem.strerror}); name '
                             'another') from problem
