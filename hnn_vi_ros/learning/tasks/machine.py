# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Train models of machines on measured motions, and judge them on other motions."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
import math
from pathlib import Path

from hnn_vi_ros.effects import Effect
from hnn_vi_ros.errors import DataError
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators import ImplicitMidpoint
from hnn_vi_ros.learning.data.log_warnings import warnings_of
from hnn_vi_ros.learning.data.motions import (
    delayed, EvenMotion, MotionData, of_positions, train_and_test)
from hnn_vi_ros.learning.families.choices import Forward, TrajectoryLoss
from hnn_vi_ros.learning.families.mechanical import MechanicalNetwork, PlainNetwork
from hnn_vi_ros.learning.fit.config import MachineConfig
from hnn_vi_ros.learning.fit.fitted_rigid_body import FittedRigidBody, positions_alone
from hnn_vi_ros.learning.fit.growing import first_noise
from hnn_vi_ros.learning.fit.inertias import identified_text, with_force_errors
from hnn_vi_ros.learning.fit.loop import Fitted, Train, trained
from hnn_vi_ros.learning.fit.machine import fit_network, scales_of
from hnn_vi_ros.learning.fit.machine_fit import check_motors, estimated_delay, fit_machine
from hnn_vi_ros.learning.fit.model_files import (
    describe_machine, drafted, machine_scene, with_prior)
from hnn_vi_ros.learning.fit.rigid_body import best_rigid_body
from hnn_vi_ros.learning.fit.windows import KnownModel, ModelParts
from hnn_vi_ros.learning.judging.energy import balance
from hnn_vi_ros.learning.judging.ensemble import (
    bootstrapped_blocks, calibrated, ensemble_text, kept_and_held, machine_calibration)
from hnn_vi_ros.learning.judging.evaluation import judge as judged_scores
from hnn_vi_ros.learning.judging.evaluation import Judging, numbers, outside, table, verdict
from hnn_vi_ros.learning.judging.missing import missing_force
from hnn_vi_ros.learning.judging.predictors import (
    linear_model, own_effects, Predict, predicted_by)
from hnn_vi_ros.learning.judging.report import draw_predictions, Judged, shown
from hnn_vi_ros.learning.judging.residuals import (
    errors_text, is_noise, is_off, judged_along, resolving_step)
from hnn_vi_ros.learning.tasks import OPEN_BY_MAP, TrainingTask
from hnn_vi_ros.learning.tasks.selection import selected, trust_text
from hnn_vi_ros.models import (
    CHAINS, Checkpoint, domain_of, energy_spread, equation_text, interval_text, load_member,
    ModelCard, parameters_text, PredictionError, ratio_unit, RIGID_BODY, SelectionCard)
import numpy as np
import torch

# Range of test motions, relative to that of the training motions, that shows how a model moves.
_MOVING = 0.3


@dataclass(frozen=True)
class MachineData:
    """
    Motions of a machine.

    Parameters
    ----------
    config : MachineConfig
        Configuration of the training; after the selection that of the selected model.
    measured : tuple of sequence of EvenMotion
        Training and test motions as they were measured.
    description : str
        Description of the data, with source and licence, for the model card.
    ensemble : bool
        True if members are trained, each on resampled blocks of the motions.
    train, test, known, held : sequence of EvenMotion
        Motions with the selected velocities and forces: training and test motions; and the parts
        of the training motions that a fit uses, and that no member of an ensemble is trained on.
    delay : float
        Delay of the forces [samples].
    selection : SelectionCard, optional
        Record of the selection.
    rigid : FittedRigidBody, optional
        The selected model, if the selection has fitted it to all training motions.

    """

    config: MachineConfig
    measured: tuple[Sequence[EvenMotion], Sequence[EvenMotion]]
    description: str
    ensemble: bool
    train: Sequence[EvenMotion] = ()
    test: Sequence[EvenMotion] = ()
    known: Sequence[EvenMotion] = ()
    held: Sequence[EvenMotion] = ()
    delay: float = 0.0
    selection: SelectionCard | None = None
    rigid: FittedRigidBody | None = None

    box = None

    @property
    def arrays(self) -> Iterator[np.ndarray]:
        """Return the arrays of the training motions, which identify an interrupted run."""
        return (part for motion in self.train for part in vars(motion).values()
                if isinstance(part, np.ndarray))

    def chosen(self, config: MachineConfig) -> MachineConfig:
        """Return a configuration of another seed with the selected family and loss."""
        return config.model_copy(update={
            'family': self.config.family, 'loss': self.config.loss, 'data': self.config.data})


def read(source: Path, config: MachineConfig, given: Sequence[str], ensemble: bool) -> MachineData:
    """Read the motions of a configuration, or of given files in their place."""
    motions, description = config.motions(
        source, [coordinate.name for coordinate in config.coordinates], given)
    train, test = train_and_test(motions, config.data.test_runs)
    if not train:
        raise DataError(f'{source}: data.test_runs leave no run for training')
    longest = max(motion.t[-1] - motion.t[0] for motion in test)
    shortest = min(Judging().paced(test).horizons)
    if longest < shortest:
        raise DataError(f'{source}: the held-out data last {longest:.3g} s, expected at least '
                        f'{shortest:g} s for an evaluation; name longer runs in '
                        'data.test_runs')
    return MachineData(config, (train, test), description, ensemble)


def select(data: MachineData) -> MachineData:
    """Return the data with the configuration that suits them, and a delay of forces."""
    config, description, (train, _) = data.config, data.description, data.measured
    delay = estimated_delay(config, train) if config.data.delay == 'estimate' else \
        config.data.delay
    if delay:
        train = [delayed(motion, delay) for motion in train]
        description += f'; forces delayed by {delay:.3g} samples'
    print(f'data: {description}; {_ranges(config, train)}', flush=True)
    for one in warnings_of(train, [one.name for one in config.coordinates],
                           [one.q_unit for one in config.coordinates]):
        print(f'warning: {one.text}', flush=True)
    check_motors(config, train)
    chosen, selection = selected(config, train)
    if isinstance(chosen.data.delay, float):
        delay = chosen.data.delay
    train, test = (as_selected(part, chosen.data, delay) for part in data.measured)
    known, held = kept_and_held(train, config) if data.ensemble else (train, [])
    found = replace(
        data, config=chosen, train=train, test=test, known=known, held=held, delay=delay,
        selection=selection,
        description=f'{config.description} {description}'.lstrip() + _scale(chosen, train))
    return found if data.ensemble or selection is None else _with_smooth_forces(found, config)


def _with_smooth_forces(data: MachineData, given: MachineConfig) -> MachineData:
    """Return the data with a spline of the forces if long windows show that it is better."""
    if given.data.inputs or data.train[0].inputs != 'linear' or data.config.structure().residual:
        return data
    rigid = fit_machine(data.config, data.known)
    assert isinstance(rigid, FittedRigidBody)
    data = replace(data, rigid=rigid)
    if not rigid.is_driven(data.train):
        return data
    chosen = data.config.data.model_copy(update={'inputs': 'spline'})
    train, test = (as_selected(part, chosen, data.delay) for part in data.measured)
    if not rigid.is_evidence(rigid.gain_with(train, data.config.windows)):
        return data
    config = data.config.model_copy(update={'data': chosen})
    try:
        found = fit_machine(config, train)
    except DataError:
        return data
    length = rigid.no_worse(found)
    if length is None or not isinstance(found, FittedRigidBody):
        return data
    text = f'forces between samples as spline, which fits windows of {length:.3g} s better'
    print(text, flush=True)
    return replace(data, config=config, train=train, test=test, known=train, rigid=found,
                   description=f'{data.description}; {text}')


def fit(data: MachineData, config: MachineConfig, device: str, train: Train = trained) -> Fitted:
    """Fit the selected model."""
    config = data.chosen(config)
    motions = bootstrapped_blocks(data.known, config.seed) if data.ensemble else data.known
    fitted = fit_machine(config, motions, data.rigid, train)
    return with_scale(fitted, data.train) if _opens_scale(config, data.train) else fitted


def with_scale(fitted: Fitted, motions: Sequence[EvenMotion]) -> Fitted:
    """Scale the mean inertia of the first coordinate to 1, for motions without forces."""
    with torch.no_grad():
        inertia = float(fitted.module.masses(torch.tensor(_joined(motions)))[:, 0, 0].mean())
    return replace(fitted, module=fitted.module.scaled(1.0 / inertia))


def describe(data: MachineData, fitted: Fitted, config: MachineConfig, name: str, command: str
             ) -> Checkpoint:
    """Return a trained network with its card."""
    config, description, estimates = data.chosen(config), data.description, {}
    step_size = None
    if isinstance(fitted, FittedRigidBody) and fitted.numbers is not None:
        opens, step_size = _opens_scale(config, data.train), fitted.known().parts.step_size
        estimates = fitted.estimates(config.coordinates, _joined(data.train) if opens else None)
        if data.selection is None and fitted.is_driven(data.train):
            courses = fitted.courses(data.train, config.windows, config.data.inputs is not None)
            if courses.better:
                text = courses.text('data.inputs:')
                print(text, flush=True)
                description += f'. {text}'
    found = describe_machine(
        fitted.module, config, data.train, description, fitted.losses, name, command,
        data.delay * data.train[0].spacing, step_size, selection=data.selection)
    return with_prior(found, estimates=estimates) if estimates else found


def judge(data: MachineData, checkpoint: Checkpoint, fitted: Fitted) -> Judged:
    """Return the model with the prediction errors of itself and of the baselines."""
    if data.ensemble:
        checkpoint = calibrated(checkpoint, lambda: machine_calibration(
            checkpoint, data.held, data.test))
    else:
        checkpoint = with_force_errors(checkpoint, fitted.module, data.test)
    config, test, network = data.config, data.test, fitted.module
    judging = Judging().paced(test)
    horizons = [horizon for horizon in judging.horizons if any(
        motion.t[-1] - motion.t[0] >= horizon for motion in test)]
    hamiltonian, effects = _parts_of(checkpoint)
    step = resolving_step(checkpoint.card)
    parts = ModelParts(hamiltonian, ImplicitMidpoint(), effects, math.inf)
    names, open_scale = [one.name for one in config.coordinates], _scale_unit(config, data.train)
    said, known, noise = '', {}, None
    residuals, longest = dict[str, list[float]](), None
    if positions_alone(test):
        noise = first_noise(test) if fitted.noise is None else fitted.noise
        parts = parts._replace(step_size=step)
        residuals, test, longest = judged_along(KnownModel('the model', parts), test, noise)
        known = {'residuals': residuals, 'noise': noise.tolist()}
    scores, fans = judged_scores(
        parts, test, horizons, judging.every, judging.longest, _baselines(data, network), noise)
    everything = [*data.train, *data.test]
    off = is_off(scores['model'].horizons.values(), everything)
    if noise is not None:
        missing = '' if is_noise(residuals) else missing_force(network, everything, names)
        said = errors_text(residuals, noise, config.coordinates, off) + (
            f'\nOf all motions, also those of the training: {missing}' if missing else '')
    domain = domain_of(hamiltonian)
    checkpoint = with_energy_error(checkpoint, test)
    card = checkpoint.card.model_copy(update={
        'prediction_error': PredictionError.model_validate(numbers(scores['model']) | known)})
    if card.selection is not None:
        card = card.model_copy(update={'selection': card.selection.model_copy(
            update={'trust': trust_text(card.selection, config, residuals, everything, off)})})
    text = '\n\n'.join(filter(None, (
        table(scores, hamiltonian.coordinates), verdict(scores), said.rstrip(),
        '' if domain is None else outside(domain, fans, horizons).text,
        '' if card.selection is None else card.selection.text,
        parameters_text(card, open_scale), equation_text(card),
        ensemble_text(card))))
    return Judged(
        replace(checkpoint, card=card), text,
        f'{text}\n\n{_remarks(config, card, judging.every, open_scale)}\n'
        f'{identified_text(card)}'.rstrip(),
        lambda path: draw_predictions(path, card.name, hamiltonian.coordinates,
                                      shown(fans, max(horizons))),
        longest, lambda model, place: machine_scene(
            model, card, float(f'{min(step, test[0].spacing):.9g}'), 'implicit_midpoint',
            any(motion.tau.any() for motion in data.train),
            start_of(test, data.train), place), open_scale)


def start_of(test: Sequence[EvenMotion], train: Sequence[EvenMotion]) -> tuple[EvenMotion, int]:
    """Return the first test motion, or that of the training if it nearly rests, and a sample."""
    first, other = test[0], train[0]
    ranges = np.ptp(first.q, axis=0) / np.maximum(np.ptp(other.q, axis=0), 1e-300)
    if ranges.max() > _MOVING:
        return first, 0
    # At the edges of the filter, velocities are worse.
    return other, min(math.ceil(1.0 / (other.cutoff * other.spacing)), len(other.t) - 1)


MACHINE = TrainingTask('predictions', read, select, fit, describe, judge)


def _baselines(data: MachineData, network: MechanicalNetwork) -> dict[str, Predict]:
    """Return other models of the training motions, to compare with."""
    config, others = data.config, {'linear model': linear_model(data.train)}
    if config.baseline:
        print('baseline, a plain network of (q, v, tau):', flush=True)
        plain = PlainNetwork(network.structure.kinds, config.hidden, scales_of(
            data.train, config.family.input_map == 'learned'), config.seed)
        others['plain network'] = predicted_by(
            fit_network(plain, _of_plain_network(config), data.train).module)
    if network.structure.residual and 'prismatic' not in network.structure.kinds:
        rigid = best_rigid_body(config.windows, data.train)
        others |= {} if rigid is None else {'rigid body': predicted_by(rigid.module)}
    return others


def as_selected(motions: Sequence[EvenMotion], chosen: MotionData, delay: float
                ) -> list[EvenMotion]:
    """Return motions with the selected velocities, and forces of this delay [samples]."""
    if chosen.velocities and not positions_alone(motions):
        motions = of_positions(motions)
    # A delay that is no whole number interpolates forces by their course.
    motions = [replace(motion, inputs=chosen.inputs or motion.inputs) for motion in motions]
    return [delayed(motion, delay) for motion in motions] if delay else motions


def learn(config: MachineConfig, motions: Sequence[EvenMotion]) -> Fitted:
    """Select and fit a model of motions."""
    config, _ = selected(config, motions)
    delay = config.data.delay
    return fit_machine(config, as_selected(
        motions, config.data, 0.0 if isinstance(delay, str) else delay))


def _joined(motions: Sequence[EvenMotion]) -> np.ndarray:
    return np.concatenate([motion.q_smooth for motion in motions])


def with_energy_error(checkpoint: Checkpoint, motions: Sequence[EvenMotion]) -> Checkpoint:
    """Add the energy error along motions, relative to the work on them, to a model's card."""
    hamiltonian, effects = _parts_of(checkpoint)
    balances = [balance(hamiltonian, effects, motion) for motion in motions]
    error = energy_spread(
        np.concatenate([found.energy for found in balances]),
        np.repeat(np.arange(len(motions)), [len(found.energy) for found in balances]),
        checkpoint.card.seed, np.concatenate([found.work for found in balances]),
        'work of forces and friction')
    return replace(checkpoint, card=checkpoint.card.model_copy(update={'energy_error': error}))


def _parts_of(checkpoint: Checkpoint) -> tuple[Hamiltonian, list[Effect]]:
    """Return H and the effects of a model; the effects read a draft file of it."""
    hamiltonian = load_member(checkpoint, None)
    with drafted(checkpoint) as draft:
        return hamiltonian, own_effects(draft, hamiltonian)


def _opens_scale(config: MachineConfig, motions: Sequence[EvenMotion]) -> bool:
    """Return True if the motions have no forces that could fix the energy scale."""
    own_scale = config.family.prior not in (None, RIGID_BODY, *CHAINS)
    return not own_scale and not any(motion.tau.any() for motion in motions)


def _scale_unit(config: MachineConfig, motions: Sequence[EvenMotion]) -> str:
    """Return the unit of the number set to 1, '' if the data fix the scale of forces."""
    if config.family.input_map == 'learned':
        return 'input map'
    if not _opens_scale(config, motions):
        return ''
    return 'kg' if config.coordinates[0].kind == 'prismatic' else 'kg m2'


def _ranges(config: MachineConfig, motions: Sequence[EvenMotion]) -> str:
    """Describe the sampling interval and coordinate ranges, which reveal wrong units."""
    q = np.concatenate([motion.q for motion in motions])
    return ', '.join([f'every {motions[0].spacing:.4g} s', *(
        f'{one.name} {low:.3g} to {high:.3g} {one.q_unit}' for one, low, high in zip(
            config.coordinates, q.min(axis=0), q.max(axis=0), strict=True))])


def _scale(config: MachineConfig, motions: Sequence[EvenMotion]) -> str:
    """Return a note on the energy scale for the model card, '' if forces fix the scale."""
    text = ''
    if config.family.prior not in (None, RIGID_BODY, *CHAINS):
        text = f'; the energy scale is that of {config.family.prior}'
    elif _opens_scale(config, motions):
        text = ('; the energy scale is arbitrary, since there are no forces: the mean inertia of '
                f'{config.coordinates[0].name} is 1')
    if config.family.input_map == 'learned':
        text += OPEN_BY_MAP
    return text


def _remarks(config: MachineConfig, card: ModelCard, every: float, open_scale: str) -> str:
    """Return the remarks below the table of a report."""
    held, error = ', '.join(config.data.test_runs) or 'the last fifth of each run', \
        card.energy_error
    unit = ratio_unit('J', open_scale)
    energy = '' if error is None else (
        f'On held-out data the RMS error of H is {error.rms:.3g} {unit} '
        f'({interval_text(error.rms_interval)}), compared with the {error.compared_with}, with '
        f'which it varies by {error.spread:.3g} {unit}.\n')
    return (f'Held out: {held}. The table contains the RMS error at the end of each horizon, in '
            'simulations of the held-out data with the measured forces, started every '
            f'{every:g} s. The energy mismatch is the change of H over each horizon minus the '
            'work of forces and friction, relative to its range; it is omitted if that is below a '
            'tenth of the kinetic energy. A plain network of (q, v, tau) has the same hidden '
            f'layers; a rigid body is a chain of links fitted by least squares.\n\n{energy}')


def _of_plain_network(config: MachineConfig) -> MachineConfig:
    """Return the configuration of a plain network; losses that need masses are replaced."""
    return config if isinstance(config.loss, Forward | TrajectoryLoss | None) else \
        config.model_copy(update={'loss': TrajectoryLoss()})
