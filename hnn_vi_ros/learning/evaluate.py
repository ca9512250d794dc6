# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Judge a model or a scene with measured motions: ``ros2 run hnn_vi_ros evaluate``."""

from argparse import Namespace
from collections.abc import Sequence
import json
import math
from pathlib import Path
import shlex
from typing import Any, NamedTuple

from hnn_vi_ros.effects import Effect, ExternalForce
from hnn_vi_ros.errors import DataError, ParameterError, RecordingError
from hnn_vi_ros.files import check_new, elapsed, write_text
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators import Integrator
from hnn_vi_ros.learning import arguments as command_lines
from hnn_vi_ros.learning.data.arrays import ArraysData
from hnn_vi_ros.learning.data.bags import BagMotions
from hnn_vi_ros.learning.data.motions import delayed, EvenMotion, MotionData, train_and_test
from hnn_vi_ros.learning.data.sources import (
    guessed, make_dataset, motions_of, MotionSource, read_motions)
from hnn_vi_ros.learning.families.choices import Trajectory
from hnn_vi_ros.learning.fit.config import BodyConfig, FieldConfig, find_config, load_config
from hnn_vi_ros.learning.fit.excitation import ExcitationData
from hnn_vi_ros.learning.fit.rigid_body import best_rigid_body
from hnn_vi_ros.learning.judging.evaluation import (
    as_json, Fan, finite, judge, linear_model, names_of, outside, parts_of, Predict, predicted_by,
    simulated, simulation_of, table, unaccounted, variance_of, verdict, whole_records)
from hnn_vi_ros.learning.tasks import body
from hnn_vi_ros.models import domain_of, load_checkpoint
from hnn_vi_ros.phase_space import Coordinate
from hnn_vi_ros.simulation import Simulation
import numpy as np

_KEYS = 't', 'q', 'v', 'tau'
_NO_FORCES = ('with --keys t,q,dq of arrays, or in the data of --config: forces: none of bags, no '
              'tau of logs')


def main(argv: Sequence[str]) -> None:
    """Judge the model or scene on the command line."""
    arguments = command_lines.evaluate().parse_args(argv)
    _check_options(arguments)
    if arguments.model.endswith('.safetensors') and (
            load_checkpoint(arguments.model, ensembles=True).card.lie_group is not None):
        body.evaluate(arguments)
        return
    found = _judged(arguments)
    print(found.text)
    command = shlex.join(['ros2', 'run', 'hnn_vi_ros', 'evaluate', *argv])
    try:
        _write(arguments, found, f'{found.text}\n\n`{command}`')
    except OSError as problem:
        raise RecordingError(f'{problem.filename}: cannot be written: {problem.strerror}'
                             ) from problem


class _Judged(NamedTuple):
    """A table with remarks, the same as numbers, and predictions to draw."""

    text: str
    numbers: dict[str, Any]
    fans: list[Fan]
    coordinates: Sequence[Coordinate]


def _judged(arguments: Namespace) -> _Judged:
    """Judge a model or scene with scalar coordinates."""
    hamiltonian, integrator, step_size, effects = parts_of(arguments.model)
    names = names_of(hamiltonian)
    motions, description, data = _motions(arguments, arguments.data, names)
    if arguments.held_out:
        motions = train_and_test(motions, data.test_runs)[1]
        description += ', of which what a training with this configuration holds out'
    effects = _effects_for(arguments.model, effects, motions, description)
    checkpoint = getattr(hamiltonian, 'checkpoint', None)
    if checkpoint is not None and checkpoint.card.mechanical is not None \
            and (delay := checkpoint.card.mechanical.delay):
        motions = [delayed(motion, delay / motion.spacing) for motion in motions]
        description += f'; forces act {delay:.3g} s later, as in the data of the model'
    simulation = _simulation(arguments.model, hamiltonian, integrator, effects, motions, step_size)
    others = _baselines(arguments, hamiltonian)
    with elapsed('simulating'):
        scores, fans = judge(simulation, effects, motions, arguments.horizons, arguments.every,
                             arguments.longest, others)
    numbers = as_json(scores)
    text = (f'{arguments.model} on {description}, simulated freely from a state every '
            f'{arguments.every:g} s;\nroot mean square of the error at the end of each horizon, '
            'median of the valid prediction time,\nand what the energy changes by over each '
            f'horizon beside the work, as a share of its range{_left_out(effects)}\n\n'
            f'{table(scores, names)}\n\n{verdict(scores)}')
    if arguments.whole:
        whole = whole_records(simulated(
            simulation, motions[0].spacing, math.inf, variance_of(motions)), motions,
            arguments.first)
        text += f'\n\n{_whole(whole, motions, names, arguments.first)}'
        numbers['whole'] = [{'run': motion.name, 'rms': finite(rms)}
                            for motion, rms in zip(motions, whole, strict=True)]
    domain = domain_of(hamiltonian)
    if domain is not None:
        beyond = outside(domain, fans, arguments.horizons)
        text += f'\n{beyond.text}'
        numbers['outside'] = beyond.numbers
    return _Judged(text, numbers, fans, hamiltonian.coordinates)


def _effects_for(model: str, effects: list[Effect], motions: Sequence[EvenMotion],
                 description: str) -> list[Effect]:
    """Return the effects needed for motions; DataError if external_force is missing."""
    driven = any(motion.tau.any() for motion in motions)
    if driven and not any(isinstance(effect, ExternalForce) for effect in effects):
        raise DataError(f'{description}: the motions were driven, but {model} has no effect '
                        'external_force; add it with all coordinates, or leave the forces out, '
                        f'{_NO_FORCES}')
    # An external_force with an input map would require its own number of forces.
    return [effect for effect in effects
            if driven or not isinstance(effect, ExternalForce) or effect.names]


def _baselines(arguments: Namespace, hamiltonian: Hamiltonian) -> dict[str, Predict]:
    """Return the baseline predictors, fitted to other motions."""
    if arguments.baselines is None:
        return {}
    known, _, _ = _motions(arguments, arguments.baselines, names_of(hamiltonian))
    others = {'linear model': linear_model(known)}
    if all(coordinate.q_unit == 'rad' for coordinate in hamiltonian.coordinates):
        # Fitted on the default windows of training.
        rigid = best_rigid_body(Trajectory(), known)
        others |= {} if rigid is None else {'rigid body': predicted_by(rigid[0])}
    return others


def _check_options(arguments: Namespace) -> None:
    """Check, before the work starts, the options and that the output files can be written."""
    for name in ('horizons', 'every', 'longest', 'smoothing'):
        value = getattr(arguments, name)
        values = value if isinstance(value, list) else [value]
        if value is not None and not all(
                math.isfinite(number) and number > 0.0 for number in values):
            raise ParameterError(f'--{name} {value}: expected positive numbers')
    if arguments.first < 0 or (arguments.first and not arguments.whole):
        raise ParameterError(f'--from {arguments.first}: expected a sample, counted from 0, with '
                             '--whole')
    if arguments.held_out and arguments.config is None:
        raise ParameterError('--held-out: what a training holds out is in its configuration; name '
                             'it with --config')
    if not (arguments.data or arguments.config):
        raise ParameterError('--data: expected measured motions, or a training configuration with '
                             '--config that names its own')
    if arguments.out is not None and arguments.out == arguments.json:
        raise ParameterError(f'--out {arguments.out} is a folder, and --json a file of its own; '
                             'name another')
    for option in ('out', 'json'):
        if (path := getattr(arguments, option)) is not None:
            check_new(f'--{option}', path)


def _whole(errors: Sequence[np.ndarray], motions: Sequence[EvenMotion], names: Sequence[str],
           first: int) -> str:
    """Return the errors over whole runs as a Markdown table."""
    lines = [f'Simulated once, from sample {first} of each run to its end:', '',
             f'| run | lasts [s] | RMS error: {", ".join(names)} |', '|---|---|---|']
    for motion, error in zip(motions, errors, strict=True):
        rms = ' '.join(f'{value:.4g}' for value in error)
        lines.append(f'| {motion.name} | {motion.t[-1] - motion.t[first]:.3g} | {rms} |')
    return '\n'.join(lines)


def _write(arguments: Namespace, found: _Judged, text: str) -> None:
    """Write the files requested on the command line."""
    if arguments.json is not None:
        write_text(arguments.json, json.dumps(found.numbers, indent=2, allow_nan=False) + '\n')
    if arguments.out is not None:
        # Imported lazily: numbers alone need no plotting libraries.
        from hnn_vi_ros.learning.judging.report import write_evaluation
        # The folder may exist by now: --json may have written a file in it.
        arguments.out.mkdir(parents=True, exist_ok=True)
        write_evaluation(arguments.out, Path(arguments.model).stem, text, found.fans,
                         max(arguments.horizons), found.coordinates)
        print(f'\nreport: {arguments.out}')


def _simulation(model: str, hamiltonian: Hamiltonian, integrator: Integrator,
                effects: Sequence[Effect], motions: Sequence[EvenMotion], step_size: float | None
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


def _left_out(effects: Sequence[Effect]) -> str:
    """Return the reason for a missing energy mismatch, '' if there is one."""
    kinds = unaccounted(effects)
    return f'\n(not judged: states do not give the work of {", ".join(kinds)})' if kinds else ''


def _motions(arguments: Namespace, given: Sequence[str], names: Sequence[str]
             ) -> tuple[list[EvenMotion], str, MotionData]:
    """Read measured motions from the options or a configuration; return also their description."""
    changes: dict[str, object] = {} if arguments.smoothing is None else {
        'smoothing': arguments.smoothing}
    if arguments.config is None:
        return _read(arguments, Path(given[0]), guessed(given[0]), given, names, changes)
    source = find_config(arguments.config)
    config = load_config(source)
    if arguments.held_out and not hasattr(config.data, 'test_runs'):
        raise ParameterError(f'--held-out: {source} holds out states, and no runs; leave it out')
    if isinstance(config, FieldConfig):
        _check_format(arguments, config.data)
        data = MotionData.model_validate(changes)
        return *motions_of(make_dataset(config.data, config.seed, source, given), data), data
    if isinstance(config, BodyConfig):
        raise DataError(f'{source}: its data are motions of a body that turns, and '
                        f'{arguments.model} is of another family')
    if isinstance(config.data, ExcitationData):
        return *config.motions(source, names, given, **changes), config.data
    return _read(arguments, source, config.data, given, names, changes)


def _read(arguments: Namespace, source: Path, data: MotionSource, given: Sequence[str],
          names: Sequence[str], changes: dict[str, object]
          ) -> tuple[list[EvenMotion], str, MotionData]:
    """Read motions with a format that the options modify."""
    _check_format(arguments, data)
    if arguments.keys is not None:
        # An empty key, or one omitted at the end, means that the array is missing.
        t, q, *others = arguments.keys.split(',')
        v, tau = (key or None for key in (*others, '', '')[:2])
        changes |= {'time': t, 'q': q, 'v': v, 'tau': tau}
    if arguments.joints is not None:
        changes['joints'] = arguments.joints.split(',')
    return *read_motions(source, data.model_copy(update=changes), names, given), data


def _check_format(arguments: Namespace, data: object) -> None:
    """Raise ParameterError for options that belong to another data format."""
    if arguments.keys is not None and (len(arguments.keys.split(',')) not in (2, 3, 4)
                                       or not isinstance(data, ArraysData)):
        raise ParameterError(f'--keys {arguments.keys}: expected those of {", ".join(_KEYS)} in '
                             'an .npz file')
    if arguments.joints is not None and not isinstance(data, BagMotions):
        raise ParameterError(f'--joints {arguments.joints}: only a bag has joints')
