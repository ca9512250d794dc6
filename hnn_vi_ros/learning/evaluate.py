# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Judge a model or a scene with measured motions: ``hnn evaluate``."""

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
import json
import math
from pathlib import Path
import shlex
from typing import Any, NamedTuple

from hnn_vi_ros.effects import Commanded, Effect, ExternalForce, PeriodicDrive
from hnn_vi_ros.errors import DataError, listed, ParameterError, prefixed, RecordingError
from hnn_vi_ros.files import check_new, elapsed, make_folder, write_text
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.learning import arguments as command_lines
from hnn_vi_ros.learning.data.arrays import ArraysData
from hnn_vi_ros.learning.data.bags import BagMotions
from hnn_vi_ros.learning.data.motions import (
    delayed, EvenMotion, MotionData, of_positions, train_and_test)
from hnn_vi_ros.learning.data.sources import (
    make_dataset, motions_of, MotionSource, read_motions, source_of)
from hnn_vi_ros.learning.data.text import LogMotions
from hnn_vi_ros.learning.families.choices import TrajectoryLoss
from hnn_vi_ros.learning.fit.config import BodyConfig, FieldConfig, find_config, load_config
from hnn_vi_ros.learning.fit.excitation import ExcitationData
from hnn_vi_ros.learning.fit.fitted_rigid_body import positions_alone
from hnn_vi_ros.learning.fit.following import LogSimulation
from hnn_vi_ros.learning.fit.growing import first_noise
from hnn_vi_ros.learning.fit.rigid_body import best_rigid_body
from hnn_vi_ros.learning.fit.windows import KnownModel, ModelParts, windows_at
from hnn_vi_ros.learning.judging.energy import unaccounted
from hnn_vi_ros.learning.judging.evaluation import (
    as_json, finite, judge, Judging, outside, table, TrajectoryBundle, verdict, whole_records)
from hnn_vi_ros.learning.judging.predictors import (
    linear_model, names_of, parts_of, Predict, predicted_by, simulated)
from hnn_vi_ros.learning.judging.residuals import (
    errors_text, is_off, judged_along, resolving_step)
from hnn_vi_ros.learning.tasks import body
from hnn_vi_ros.models import domain_of, load_checkpoint, ModelCard
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

_KEYS = 't', 'q', 'v', 'tau'
_NO_FORCES = 'with --keys t,q,dq for arrays, or with forces: none in the data of --config'


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
    command = shlex.join(['hnn', 'evaluate', *argv])
    try:
        _write(arguments, found, f'{found.text}\n\n`{command}`')
    except OSError as problem:
        raise RecordingError(f'{problem.filename}: cannot be written: {problem.strerror}'
                             ) from problem


class _Judgement(NamedTuple):
    """A table with remarks, the same as numbers, and predictions to draw."""

    text: str
    numbers: dict[str, Any]
    fans: list[TrajectoryBundle]
    coordinates: Sequence[Coordinate]
    longest: float  # horizon [s]


def _judged(arguments: Namespace) -> _Judgement:
    """Judge a model or scene with scalar coordinates."""
    parts = parts_of(arguments.model)
    hamiltonian = parts.hamiltonian
    names = names_of(hamiltonian)
    motions, description, data = _motions(arguments, arguments.data, hamiltonian.coordinates)
    judging = Judging().paced(motions)
    judging = judging._replace(**{option: given for option in judging._fields
                                  if (given := getattr(arguments, option)) is not None})
    if arguments.held_out:
        motions = train_and_test(motions, data.test_runs)[1]
        description += ', only the runs held out by a training with this configuration'
    if not (arguments.model.endswith('.safetensors') or any(one.tau.any() for one in motions)):
        kinds = [type(one).__name__ for one in parts.effects if isinstance(one, Commanded)]
        description += f'; no forces, with which {listed(kinds)} acts: they are 0' * bool(kinds)
    effects = _effects_for(arguments.model, parts.effects, motions, description)
    own = [one.coordinate for one in parts.effects if isinstance(one, PeriodicDrive)
           and one not in effects]
    description += f'; the forces in the log replace the periodic_drive of {listed(own)}' \
        * bool(own)
    parts = parts._replace(effects=effects)
    checkpoint = getattr(hamiltonian, 'checkpoint', None)
    card = None if checkpoint is None or checkpoint.card.mechanical is None else checkpoint.card
    if card is not None:
        motions, description = _as_in_training(card, data.inputs, motions, description)
    known: dict[str, Any] = {} if card is None else {'noise': [], 'residuals': {}}
    said, noise, judged = '', None, card if positions_alone(motions) else None
    if judged is not None:
        parts = parts._replace(step_size=min(parts.step_size, resolving_step(judged)))
    _check_simulation(arguments.model, parts, motions)
    if judged is not None:
        # As in training.
        error = judged.prediction_error
        noise = np.array(error.noise) if error and error.noise else first_noise(motions)
        residuals, motions, _ = judged_along(KnownModel('the model', parts), motions, noise)
        known = {'noise': noise.tolist(), 'residuals': residuals}
    others = _baselines(arguments, hamiltonian)
    with elapsed('simulating'):
        scores, fans = judge(parts, motions, judging.horizons, judging.every,
                             judging.longest, others, noise)
    if judged is not None and noise is not None:
        said = '\n' + errors_text(residuals, noise, judged.coordinates, is_off(
            scores['model'].horizons.values(), motions))
    numbers = as_json(scores) | known
    text = (f'{arguments.model} on {description}, simulated from a measured state every '
            f'{judging.every:g} s:\nRMS error at the end of each horizon, median of the valid '
            'prediction time, and energy mismatch\n(change of energy minus work over each '
            'horizon, relative to its range; - if that is below a tenth of the kinetic energy)'
            f'{_left_out(parts.effects)}\n\n'
            f'{table(scores, hamiltonian.coordinates)}\n\n{verdict(scores)}{said}')
    if arguments.whole:
        whole = whole_records(simulated(parts), motions, arguments.first)
        text += f'\n\n{_whole(whole, motions, names, arguments.first)}'
        numbers['whole'] = [{'run': motion.name, 'rms': finite(rms)}
                            for motion, rms in zip(motions, whole, strict=True)]
    domain = domain_of(hamiltonian)
    if domain is not None:
        beyond = outside(domain, fans, judging.horizons)
        text += f'\n{beyond.text}'
        numbers['outside'] = beyond.numbers
    return _Judgement(text, numbers, fans, hamiltonian.coordinates, max(judging.horizons))


def _as_in_training(card: ModelCard, stated: str | None, motions: list[EvenMotion],
                    description: str) -> tuple[list[EvenMotion], str]:
    """Return motions with the course, delay and velocities of the data of a machine's model."""
    mechanical = card.mechanical
    assert mechanical is not None, 'of a machine'
    if mechanical.inputs and not (stated or motions[0].held):
        motions = [replace(motion, inputs=mechanical.inputs) for motion in motions]
        description += (f'; forces between samples as {mechanical.inputs}, as in the data of the '
                        'model')
    if mechanical.delay:
        motions = [delayed(motion, mechanical.delay / motion.spacing) for motion in motions]
        description += (f'; forces delayed by {mechanical.delay:.3g} s, as in the data of the '
                        'model')
    if card.prediction_error is not None and card.prediction_error.noise:
        motions = of_positions(motions)
    return motions, description


def _effects_for(model: str, effects: Sequence[Effect], motions: Sequence[EvenMotion],
                 description: str) -> list[Effect]:
    """Return the effects needed for motions; DataError if external_force is missing."""
    driven = any(motion.tau.any() for motion in motions)
    if driven and not any(isinstance(effect, ExternalForce) for effect in effects):
        raise DataError(f'{description}: the motions contain forces, but {model} has no effect '
                        'external_force; add it with all coordinates, or omit the forces, '
                        f'{_NO_FORCES}')
    # An external_force with an input map would require its own number of forces; measured forces
    # are all that a motor does.
    return [effect for effect in effects if not (
        isinstance(effect, PeriodicDrive) if driven else
        isinstance(effect, ExternalForce) and not effect.names)]


def _baselines(arguments: Namespace, hamiltonian: Hamiltonian) -> dict[str, Predict]:
    """Return the baseline predictors, fitted to other motions."""
    if arguments.baselines is None:
        return {}
    known, _, _ = _motions(arguments, arguments.baselines, hamiltonian.coordinates)
    others = {'linear model': linear_model(known)}
    if all(coordinate.q_unit == 'rad' for coordinate in hamiltonian.coordinates):
        # Fitted on the default windows of training.
        rigid = best_rigid_body(TrajectoryLoss(), known)
        others |= {} if rigid is None else {'rigid body': predicted_by(rigid.module)}
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
        raise ParameterError(f'--from {arguments.first}: expected the zero-based index of a '
                             'sample, and --whole')
    if arguments.held_out and arguments.config is None:
        raise ParameterError('--held-out: a training configuration defines the held-out runs; '
                             'name it with --config')
    if not (arguments.data or arguments.config):
        raise ParameterError('--data: expected measured motions, or --config with a training '
                             'configuration that names its data')
    if arguments.out is not None and arguments.out == arguments.json:
        raise ParameterError(f'--out {arguments.out} is a folder, but --json is a file; use '
                             'different names')
    for option in ('out', 'json'):
        if (path := getattr(arguments, option)) is not None:
            check_new(f'--{option}', path)


def _whole(errors: Sequence[np.ndarray], motions: Sequence[EvenMotion], names: Sequence[str],
           first: int) -> str:
    """Return the errors over whole runs as a Markdown table."""
    lines = [f'Each run simulated once, from sample {first} to its end:', '',
             f'| run | lasts [s] | RMS error: {", ".join(names)} |', '|---|---|---|']
    for motion, error in zip(motions, errors, strict=True):
        rms = ' '.join(f'{value:.4g}' for value in error)
        lines.append(f'| {motion.name} | {motion.t[-1] - motion.t[first]:.3g} | {rms} |')
    return '\n'.join(lines)


def _write(arguments: Namespace, found: _Judgement, text: str) -> None:
    """Write the files requested on the command line."""
    if arguments.json is not None:
        write_text(arguments.json, json.dumps(found.numbers, indent=2, allow_nan=False) + '\n')
    if arguments.out is not None:
        # Imported lazily: numbers alone need no plotting libraries.
        from hnn_vi_ros.learning.judging.report import write_evaluation
        # The folder may exist by now: --json may have written a file in it.
        make_folder(arguments.out)
        write_evaluation(arguments.out, Path(arguments.model).stem, text, found.fans,
                         found.longest, found.coordinates)
        print(f'\nreport: {arguments.out}')


def _check_simulation(model: str, parts: ModelParts, motions: Sequence[EvenMotion]) -> None:
    """Raise DataError unless a model can be simulated with the forces of motions."""
    with prefixed(f'{model} cannot simulate {motions[0].name}', DataError):
        log = LogSimulation(parts, windows_at(motions[:1], [(0, 0)], 1))
        simulation = log.simulation
    if log.driven:
        try:
            simulation.set_command(motions[0].tau[0])
        except ValueError as problem:
            raise DataError(f'{model}: {motions[0].tau.shape[1]} forces in the motions match '
                            'neither its input map nor its coordinates; omit them, '
                            f'{_NO_FORCES}') from problem


def _left_out(effects: Sequence[Effect]) -> str:
    """Return the reason for a missing energy mismatch, '' if there is one."""
    kinds = unaccounted(effects)
    return '' if not kinds else (
        f'\n(no energy mismatch: states do not determine the work of {", ".join(kinds)})')


def _motions(arguments: Namespace, given: Sequence[str], coordinates: Sequence[Coordinate]
             ) -> tuple[list[EvenMotion], str, MotionData]:
    """Read measured motions from the options or a configuration; return also their description."""
    changes: dict[str, object] = {} if arguments.smoothing is None else {
        'smoothing': arguments.smoothing}
    if arguments.config is None:
        return _read(arguments, Path(given[0]), source_of(
            given[0], coordinates, arguments.counts), given, coordinates, changes)
    source = find_config(arguments.config)
    config = load_config(source)
    if arguments.held_out and (
            isinstance(config, FieldConfig) or not hasattr(config.data, 'test_runs')):
        raise ParameterError(f'--held-out: {source} holds out states, not runs; remove the option')
    if isinstance(config, FieldConfig):
        if isinstance(config.data, ArraysData | LogMotions):
            return _read(arguments, source, config.data, given, coordinates, changes)
        _check_format(arguments, config.data)
        data = MotionData.model_validate(changes)
        dataset = make_dataset(config.data, config.seed, source, given,
                               [one.q_unit for one in config.coordinates])
        return *motions_of(dataset, data), data
    if isinstance(config, BodyConfig):
        raise DataError(f'{source}: its data are motions of a rotating body, but '
                        f'{arguments.model} is of another family')
    if isinstance(config.data, ExcitationData):
        names = [one.name for one in coordinates]
        return *config.motions(source, names, given, **changes), config.data
    return _read(arguments, source, config.data, given, coordinates, changes)


def _read(arguments: Namespace, source: Path, data: MotionSource, given: Sequence[str],
          coordinates: Sequence[Coordinate], changes: dict[str, object]
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
    return *read_motions(
        source, data.model_copy(update=changes), [one.name for one in coordinates], given,
        [one.q_unit for one in coordinates]), data


def _check_format(arguments: Namespace, data: object) -> None:
    """Raise ParameterError for options that belong to another data format."""
    if arguments.keys is not None and (len(arguments.keys.split(',')) not in (2, 3, 4)
                                       or not isinstance(data, ArraysData)):
        raise ParameterError(f'--keys {arguments.keys}: expected the keys of {", ".join(_KEYS)} '
                             'in an .npz file')
    if arguments.joints is not None and not isinstance(data, BagMotions):
        raise ParameterError(f'--joints {arguments.joints}: valid only for bags; remove it')
