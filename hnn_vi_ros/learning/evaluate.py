# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Judge a model or a scene by measured motions: ``ros2 run hnn_vi_ros evaluate``."""

from argparse import Namespace
from collections.abc import Sequence
import json
import math
from pathlib import Path
import shlex
from typing import Any

from hnn_vi_ros.effects.base import Effect
from hnn_vi_ros.effects.external_force import ExternalForce
from hnn_vi_ros.errors import DataError, ParameterError, RecordingError
from hnn_vi_ros.files.regular_file import check_new, write_text
from hnn_vi_ros.files.standard_streams import elapsed
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.integrators.base import Integrator
from hnn_vi_ros.learning import arguments as command_lines
from hnn_vi_ros.learning.data.arrays import ArraysData
from hnn_vi_ros.learning.data.bags import BagMotions
from hnn_vi_ros.learning.data.motions import delayed, EvenMotion, MotionData, train_and_test
from hnn_vi_ros.learning.data.sources import (
    guessed, make_dataset, motions_of, MotionSource, read_motions)
from hnn_vi_ros.learning.families.choices import RigidBodyChoice, Trajectory
from hnn_vi_ros.learning.fit.config import (
    BodyConfig, ExcitationData, excited_motions, FieldConfig, find_config, load_config)
from hnn_vi_ros.learning.fit.rigid_body import best_rigid_body
from hnn_vi_ros.learning.judging.evaluation import (
    as_json, Fan, finite, judge, linear_model, names_of, outside, parts_of, Predict, predicted_by,
    simulated, simulation_of, table, unaccounted, variance_of, verdict, whole_records)
from hnn_vi_ros.learning.tasks import body
from hnn_vi_ros.models.checkpoint import load_checkpoint
from hnn_vi_ros.models.seen import domain_of
from hnn_vi_ros.simulation import Simulation
import numpy as np

_KEYS = 't', 'q', 'v', 'tau'
_NO_FORCES = ('with --keys t,q,dq of arrays, or in the data of --config: forces: none of bags, no '
              'tau of logs')


def main(argv: Sequence[str]) -> None:
    """Judge what the command line names."""
    arguments = command_lines.evaluate().parse_args(argv)
    _check_options(arguments)
    if arguments.model.endswith('.safetensors') and (
            load_checkpoint(arguments.model, ensembles=True).card.lie_group is not None):
        body.evaluate(arguments)
        return
    hamiltonian, integrator, step_size, effects = parts_of(arguments.model)
    names = names_of(hamiltonian)
    motions, description, data = _motions(arguments, arguments.data, names)
    if arguments.held_out:
        motions = train_and_test(motions, data.test_runs)[1]
        description += ', of which what a training with this configuration holds out'
    driven = any(motion.tau.any() for motion in motions)
    if driven and not any(isinstance(effect, ExternalForce) for effect in effects):
        raise DataError(f'{description}: the motions were driven, but {arguments.model} has no '
                        'effect external_force; add it with all coordinates, or leave the forces '
                        f'out, {_NO_FORCES}')
    if not driven:
        # An input map would want its own number of them.
        effects = [effect for effect in effects
                   if not isinstance(effect, ExternalForce) or effect.names]
    checkpoint = getattr(hamiltonian, 'checkpoint', None)
    if checkpoint is not None and checkpoint.card.mechanical is not None \
            and (delay := checkpoint.card.mechanical.delay):
        motions = [delayed(motion, delay / motion.spacing) for motion in motions]
        description += f'; forces act {delay:.3g} s later, as in the data of the model'
    simulation = _simulation(arguments.model, hamiltonian, integrator, effects, motions, step_size)
    others = dict[str, Predict]()
    if arguments.baselines is not None:
        known, _, _ = _motions(arguments, arguments.baselines, names)
        others['linear model'] = linear_model(known)
        if all(coordinate.q_unit == 'rad' for coordinate in hamiltonian.coordinates):
            # Fitted by the default windows of training.
            rigid = best_rigid_body(Trajectory(), known)
            others |= {} if rigid is None else {'rigid body': predicted_by(rigid[0])}
    with elapsed('simulating'):
        scores, fans = judge(simulation, effects, motions, arguments.horizons, arguments.every,
                             arguments.longest, others)
    text = (f'{arguments.model} on {description}, simulated freely from a state every '
            f'{arguments.every:g} s;\nroot mean square of the error at the end of each horizon, '
            'median of the valid prediction time,\nand what the energy changes by over each '
            f'horizon beside the work, as a share of its range{_left_out(effects)}\n\n'
            f'{table(scores, names)}\n\n{verdict(scores)}')
    whole = None
    if arguments.whole:
        whole = whole_records(simulated(
            simulation, motions[0].spacing, math.inf, variance_of(motions)), motions,
            arguments.first)
        text += f'\n\n{_whole(whole, motions, names, arguments.first)}'
    domain = domain_of(hamiltonian)
    found = None if domain is None else outside(domain, fans, arguments.horizons)
    text += '' if found is None else f'\n{found.text}'
    print(text)
    command = shlex.join(['ros2', 'run', 'hnn_vi_ros', 'evaluate', *argv])
    try:
        more: dict[str, Any] = {} if whole is None else {'whole': [
            {'run': motion.name, 'rms': finite(rms)}
            for motion, rms in zip(motions, whole, strict=True)]}
        if found is not None:
            more['outside'] = found.numbers
        _write(arguments, as_json(scores) | more, f'{text}\n\n`{command}`', fans, hamiltonian)
    except OSError as problem:
        raise RecordingError(f'{problem.filename}: cannot be written: {problem.strerror}'
                             ) from problem


def _check_options(arguments: Namespace) -> None:
    """Refuse, before the work, options that are no good and files that cannot be written."""
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


def _write(arguments: Namespace, numbers: dict[str, Any], text: str, fans: Sequence[Fan],
           hamiltonian: Hamiltonian) -> None:
    """Write the files that the command line asks for."""
    if arguments.json is not None:
        write_text(arguments.json, json.dumps(numbers, indent=2, allow_nan=False) + '\n')
    if arguments.out is not None:
        # Imported here: numbers alone need no libraries that draw.
        from hnn_vi_ros.learning.judging.report import write_evaluation
        # It may hold the numbers by now: --json may name a file in it.
        arguments.out.mkdir(parents=True, exist_ok=True)
        write_evaluation(arguments.out, Path(arguments.model).stem, text, fans,
                         max(arguments.horizons), hamiltonian.coordinates)
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
    """Return why there is no energy mismatch, empty if there is one."""
    kinds = unaccounted(effects)
    return f'\n(not judged: states do not give the work of {", ".join(kinds)})' if kinds else ''


def _motions(arguments: Namespace, given: Sequence[str], names: Sequence[str]
             ) -> tuple[list[EvenMotion], str, MotionData]:
    """Return measured motions, read as the options or a configuration say; what these say."""
    changes: dict[str, object] = {} if arguments.smoothing is None else {
        'smoothing': arguments.smoothing}
    if arguments.config is None:
        data: MotionSource = guessed(given[0])
        source = Path(given[0])
    else:
        source = find_config(arguments.config)
        config = load_config(source)
        if arguments.held_out and not hasattr(config.data, 'test_runs'):
            raise ParameterError(f'--held-out: {source} holds out states, and no runs; leave it '
                                 'out')
        if isinstance(config, FieldConfig):
            _check_format(arguments, config.data)
            runs = MotionData.model_validate(changes)
            return *motions_of(make_dataset(config.data, config.seed, source, given), runs), runs
        if isinstance(config, BodyConfig):
            raise DataError(f'{source}: its data are motions of a body that turns, and '
                            f'{arguments.model} is of another family')
        if isinstance(config.data, ExcitationData):
            assert isinstance(config.family, RigidBodyChoice), 'checked with the configuration'
            return *excited_motions(config.data.model_copy(update=changes),
                                    config.family.robot(names), config.seed), config.data
        data = config.data
    _check_format(arguments, data)
    if arguments.keys is not None:
        # A key that is left empty, or out at the end, is of an array that is not there.
        t, q, *others = arguments.keys.split(',')
        v, tau = (key or None for key in (*others, '', '')[:2])
        changes |= {'time': t, 'q': q, 'v': v, 'tau': tau}
    if arguments.joints is not None:
        changes['joints'] = arguments.joints.split(',')
    return *read_motions(source, data.model_copy(update=changes), names, given), data


def _check_format(arguments: Namespace, data: object) -> None:
    """Refuse options that another format of data has."""
    if arguments.keys is not None and (len(arguments.keys.split(',')) not in (2, 3, 4)
                                       or not isinstance(data, ArraysData)):
        raise ParameterError(f'--keys {arguments.keys}: expected those of {", ".join(_KEYS)} in '
                             'an .npz file')
    if arguments.joints is not None and not isinstance(data, BagMotions):
        raise ParameterError(f'--joints {arguments.joints}: only a bag has joints')
