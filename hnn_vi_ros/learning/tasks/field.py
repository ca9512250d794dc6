# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Train families that learn a field of (q, p) from states and rates: losses, loop, card."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.dataset import Dataset, ExactData, sample_exact
from hnn_vi_ros.learning.data.sources import make_dataset
from hnn_vi_ros.learning.families.base import EnergyFamily, Scales, Trainable
from hnn_vi_ros.learning.fit.config import FieldConfig
from hnn_vi_ros.learning.fit.loop import Stage, TrainingProblem
from hnn_vi_ros.learning.fit.steps import step
from hnn_vi_ros.learning.judging.ensemble import (
    bootstrapped, calibrated, ensemble_text, field_calibration, held_out)
from hnn_vi_ros.learning.judging.evaluation import friction_work, integrated
from hnn_vi_ros.learning.judging.report import Comparison, Judged, plot_field
from hnn_vi_ros.learning.tasks import described, TrainingTask
from hnn_vi_ros.models import (
    Checkpoint, energy_error, energy_spread, EnergyError, FAMILIES, load_member, Units)
import numpy as np
import torch

PAIRS = 256  # number of state pairs for the penalty on nonlinearity


class Batch(NamedTuple):
    """
    Training data in the form that a loss needs.

    Parameters
    ----------
    inputs : tuple of torch.Tensor
        Inputs of a prediction, N rows each.
    target : torch.Tensor, shape (N, k)
        Target values: rates of change or accelerations.

    """

    inputs: tuple[torch.Tensor, ...]
    target: torch.Tensor

    def to(self, device: str) -> 'Batch':
        """Return a copy on another device."""
        return Batch(tuple(part.to(device) for part in self.inputs), self.target.to(device))


class Loss(NamedTuple):
    """
    A loss: the mean squared error of a prediction in units of the target.

    Parameters
    ----------
    batch : callable
        ``batch(choice, dataset)`` returns a Batch.
    predict : callable
        ``predict(choice, family, *inputs)`` returns a tensor of the shape of the target.
    parts : tuple of str
        Names of the equal parts of a row.

    """

    batch: Callable[[Any, Dataset], Batch]
    predict: Callable[..., torch.Tensor]
    parts: tuple[str, ...] = ('dq_dt', 'dp_dt')


def mean_square(errors: torch.Tensor, unit: torch.Tensor) -> torch.Tensor:
    """Return the mean square of errors, shape (N, k), with units of shape (k,)."""
    return (errors / unit).square().mean()


def nonlinearity(family: Any, z1: torch.Tensor, z2: torch.Tensor, unit: torch.Tensor
                 ) -> torch.Tensor:
    """
    Return the mean squared nonlinearity of the field between pairs of states.

    Nonlinearity is the field at the midpoint of a pair minus the mean of the fields at its ends.
    As a small penalty, it keeps H simple where the data leave it free, for example inside of a
    single orbit.

    Parameters
    ----------
    family : Trainable
        Model with a vector field.
    z1, z2 : torch.Tensor, shape (N, 2 d)
        States of each pair.
    unit : torch.Tensor, shape (2 d,)
        Unit of each component's error.

    """
    ends = 0.5 * (family.vector_field(z1) + family.vector_field(z2))
    return mean_square(family.vector_field(0.5 * (z1 + z2)) - ends, unit)


def _rates(choice: Any, dataset: Dataset) -> Batch:
    z, rates = _joined(dataset.q, dataset.p), _joined(dataset.dq_dt, dataset.dp_dt)
    commands = () if dataset.commands is None else (torch.tensor(dataset.commands),)
    return Batch((z, *commands), rates)


def _paths(choice: Any, dataset: Dataset) -> Batch:
    """Return the first states, and the mean rates from there to each of the next states."""
    windows = dataset.windows(choice.step_size, choice.count + 1)
    path = _joined(dataset.q[windows], dataset.p[windows])
    return Batch((path[:, 0],), torch.cat([
        (path[:, k] - path[:, 0]) / (k * choice.step_size) for k in range(1, choice.count + 1)]))


def _mean_rates(choice: Any, family: Any, z0: torch.Tensor) -> torch.Tensor:
    z, rates = z0, []
    for k in range(1, choice.count + 1):
        z = step(family.vector_field, choice.integrator, z, choice.step_size)
        rates.append((z - z0) / (k * choice.step_size))
    return torch.cat(rates)


def _pairs(choice: Any, dataset: Dataset) -> Batch:
    windows = dataset.windows(choice.step_size, 2)
    z0, z1 = _joined(dataset.q[windows], dataset.p[windows]).unbind(dim=1)
    return Batch((z0, z1), (z1 - z0) / choice.step_size)


def _positions(choice: Any, dataset: Dataset) -> Batch:
    """Return triples of consecutive positions, and their second differences."""
    windows = dataset.windows(choice.step_size, 3)
    q0, q1, q2 = torch.tensor(dataset.q[windows]).unbind(dim=1)
    return Batch((q0, q1, q2), (q2 - 2.0 * q1 + q0) / choice.step_size**2)


def _discrete_euler_lagrange(choice: Any, family: Any, q0: torch.Tensor, q1: torch.Tensor,
                             q2: torch.Tensor) -> torch.Tensor:
    """
    Solve D_1 L_d(q1, q2) + D_2 L_d(q0, q1) = 0 for the second difference.

    For L = v . M v / 2 - V(q), the result is -M^-1 V'(q1) with the trapezoid rule, and the mean
    of -M^-1 V' at the two midpoints with the midpoint rule.
    """
    if choice.rule == 'trapezoid':
        return family.acceleration(q1)
    before, after = family.acceleration(0.5 * (q0 + q1)), family.acceleration(0.5 * (q1 + q2))
    return 0.5 * (before + after)


def _velocities(choice: Any, dataset: Dataset) -> Batch:
    if dataset.accelerations is None:
        raise DataError(f'{dataset.description}: no accelerations, which the loss euler_lagrange '
                        'requires; use a bag or exact data, or another family')
    return Batch((_joined(dataset.q, dataset.dq_dt),), torch.tensor(dataset.accelerations))


def _joined(*parts: np.ndarray) -> torch.Tensor:
    return torch.tensor(np.concatenate(parts, axis=-1))


LOSSES = {
    'vector_field': Loss(_rates, lambda choice, family, *inputs: family.vector_field(*inputs)),
    'steps': Loss(_paths, _mean_rates),
    'discrete_gradient': Loss(_pairs, lambda choice, family, z0, z1: family.discrete_field(
        z0, z1)),
    'discrete_lagrangian': Loss(_positions, _discrete_euler_lagrange, ('acceleration',)),
    'euler_lagrange': Loss(_velocities, lambda choice, family, x: family.acceleration(x),
                           ('acceleration',)),
}


class FieldProblem(TrainingProblem):
    """
    Training problem of a field: the data as tensors, a new model, and its loss.

    Parameters
    ----------
    config : FieldConfig
        Family, loss, widths, seed, split and penalties.
    dataset : Dataset
        Training and held-out data.
    device : str
        Training device, 'cpu' or 'cuda'.

    Raises
    ------
    DataError
        The data lack a channel that the family or the loss needs.

    """

    def __init__(self, config: FieldConfig, dataset: Dataset, device: str = 'cpu'):
        self._config, self._loss = config, LOSSES[config.loss.kind]
        test, rest = None, dataset
        if config.test_fraction > 0.0:
            rest, test = dataset.split(config.test_fraction, config.seed)
        train, validation = rest.split(config.validation_fraction, config.seed)
        scales = self._scales = Scales.of(dataset)
        self._exact = isinstance(config.data, ExactData) and config.data.noise == 0.0
        # Adam finds a good basin, and L-BFGS converges in it.
        super().__init__(FAMILIES[config.family.kind].trainer(
            config.family, config.hidden, scales, config.seed), [
                Stage('Adam', self.loss, config.adam_steps, config.learning_rate,
                      self.validation_loss, config.patience),
                Stage('L-BFGS', self.loss, config.lbfgs_steps, None,
                      self.validation_loss, config.patience, pairs=config.lbfgs_history)])
        self.dataset = dataset
        self._train, self._validation = (
            self._loss.batch(config.loss, part) for part in (train, validation))
        self._test = None if test is None else self._loss.batch(config.loss, test)
        self._unit = self._train.target.square().mean(dim=0).sqrt()
        if not (self._unit > 0.0).all():
            raise DataError(f'{dataset.description}: a coordinate never changes; use data in '
                            'which every coordinate moves')
        rng = np.random.default_rng(config.seed)
        self._pairs = [torch.tensor(scales.centre + scales.half * rng.uniform(
            -1, 1, (PAIRS, len(scales.centre)))) for _ in range(2)]
        self.to(device)

    def loss(self) -> torch.Tensor:
        """Return the training loss, including penalties."""
        loss = mean_square(self._errors(self._train), self._unit)
        if self._config.linearity:
            loss = loss + self._config.linearity * nonlinearity(
                self.module, self._pairs[0], self._pairs[1], self._unit)
        preference = self.module.preference(*self._train.inputs)
        return loss if preference is None else loss + preference

    def validation_loss(self) -> float:
        """Return the loss on held-out data."""
        return float(mean_square(self._errors(self._validation), self._unit).detach())

    def final_losses(self) -> dict[str, float]:
        """Return the losses, and the RMS errors on held-out data in the data's units."""
        errors = self._errors(self._validation).detach()
        train = mean_square(self._errors(self._train), self._unit)
        values = {'train_loss': train.detach(),
                  'validation_loss': mean_square(errors, self._unit)}
        if self._test is not None:
            values['test_loss'] = mean_square(self._errors(self._test).detach(), self._unit)
        parts = self._loss.parts
        if len(parts) > 1:
            values['field_rms'] = errors.square().mean().sqrt()
        for name, part in zip(parts, errors.chunk(len(parts), dim=1), strict=True):
            values[f'{name}_rms'] = part.square().mean().sqrt()
        return {name: float(value) for name, value in values.items()}

    def compare(self) -> Comparison:
        """Return the model's predictions together with the held-out data."""
        batch, parts = self._validation, self._loss.parts
        target = batch.target.cpu().numpy()
        predicted = target + self._errors(batch).detach().cpu().numpy()
        states = batch.inputs[0].cpu().numpy() if parts == ('dq_dt', 'dp_dt') else None
        return Comparison(states, target, predicted, self._unit.cpu().numpy(), parts, self._exact)

    @property
    def units(self) -> Units:
        """Return the scales of the networks' inputs and of the loss."""
        return Units(centre=self._scales.centre.tolist(), scale=self._scales.half.tolist(),
                     target=self._unit.tolist())

    def to(self, device: str) -> None:
        """Move the model and the data to a device."""
        self.module.to(device)
        self._train, self._validation = self._train.to(device), self._validation.to(device)
        self._test = None if self._test is None else self._test.to(device)
        self._unit = self._unit.to(device)
        self._pairs = [pair.to(device) for pair in self._pairs]

    def _errors(self, batch: Batch) -> torch.Tensor:
        return self._loss.predict(self._config.loss, self.module, *batch.inputs) - batch.target


# Number of states in the box at which learned and true energy are compared.
_STATES = 2000


class FieldTask(TrainingTask):
    """
    Training of H(q, p), a Lagrangian or a two-form on states; see Task.

    Parameters
    ----------
    source : Path
        Path of the configuration.
    config : FieldConfig
        Configuration of the training.
    given : sequence of str
        Files that override the configured ones.
    ensemble : bool
        True to train ensemble members, each on resampled data.

    """

    picture = 'field'

    def __init__(self, source: Path, config: FieldConfig, given: Sequence[str], ensemble: bool):
        self._config, self._ensemble = config, ensemble
        self._dataset = make_dataset(
            config.data, config.seed, source, given, [one.q_unit for one in config.coordinates])
        print(f'data: {self._dataset.description}', flush=True)
        self._known, self._test = held_out(config, self._dataset) if ensemble else (
            self._dataset, None)
        self.box = self._known.box

    def arrays(self) -> Iterator[np.ndarray]:
        """Yield the arrays of the data; see Task."""
        return (part for part in vars(self._dataset).values() if isinstance(part, np.ndarray))

    def problem(self, config: FieldConfig, device: str) -> FieldProblem:
        """Return a new model with its loss; see Task."""
        return FieldProblem(config, bootstrapped(self._known, config.seed) if self._ensemble
                            else self._known, device)

    def describe(self, problem: FieldProblem, config: FieldConfig, name: str, command: str
                 ) -> Checkpoint:
        """Return a trained model with its card; see Task."""
        problem.to('cpu')
        return describe(problem, config, name, command)

    def judged(self, checkpoint: Checkpoint, problem: FieldProblem) -> Judged:
        """Return the model with its energy error, if the energy is known; see Task."""
        config, card = self._config, checkpoint.card
        error = judge_energy(checkpoint, problem.module, config, self._known)
        where = _where_valid(checkpoint, problem.module, config, self._known)
        checkpoint = replace(checkpoint, card=card.model_copy(update={
            'energy_error': error, 'dataset': '; '.join(filter(None, (card.dataset, where)))}))
        if self._ensemble:
            checkpoint = calibrated(checkpoint, lambda: field_calibration(
                checkpoint, config, self._test))
        card = checkpoint.card
        lines = [', '.join(f'{key} {value:.3g}' for key, value in card.losses.items())]
        if error is not None:
            lines.append(f'energy error: RMS {error.rms:.3g} J, maximum {error.sup:.3g} J, '
                         f'compared with the {error.compared_with}')
        lines += [where, ensemble_text(card)]
        return Judged(checkpoint, '\n'.join(filter(None, lines)), ensemble_text(card),
                      lambda path: plot_field(problem.compare(), card, path))


def _where_valid(checkpoint: Checkpoint, family: Trainable, config: FieldConfig, dataset: Dataset
                 ) -> str:
    """Return a note on the part of its training domain that a model has seen; '' for all."""
    if isinstance(config.data, ExactData):
        return ''
    energies = load_member(checkpoint, None).energy(dataset.q, family.momenta(dataset))
    return (f'H is known near the states of the data, from {energies.min():.4g} to '
            f'{energies.max():.4g} J; elsewhere in the training domain it is extrapolated without '
            'an alarm')


def describe(problem: FieldProblem, config: FieldConfig, name: str, command: str) -> Checkpoint:
    """Return a trained model with its card."""
    family, dataset, reference = problem.module, problem.dataset, config.reference
    box = replace(dataset, p=family.momenta(dataset)).box
    centre = np.mean([*box.q, *box.p], axis=1)
    z0 = centre if reference is None else np.array([*reference.q, *reference.p])
    networks = family.networks(z0, 0.0 if reference is None else reference.energy)
    return described(
        config, networks, name, command, family=config.family.kind, scheme=config.loss.scheme,
        box=box, dataset=dataset.description, losses=problem.final_losses(), units=problem.units,
        confine=config.confine, **family.constants())


def judge_energy(checkpoint: Checkpoint, family: Trainable, config: FieldConfig,
                 dataset: Dataset) -> EnergyError | None:
    """
    Return the error of the learned energy, or None if no reference is known.

    For exact data, the reference is the true energy at new states of the box. For other data it
    is the energy along each motion, which changes by the work of the family's forces; for families
    without forces, by the work of fitted friction.

    Parameters
    ----------
    checkpoint : Checkpoint
        Trained model.
    family : Trainable
        The same model as a trainable family, which supplies momenta of the states.
    config : FieldConfig
        Configuration of the training.
    dataset : Dataset
        Training data.

    """
    row = FAMILIES[checkpoint.card.family]
    hamiltonian = load_member(checkpoint, None)  # raises for a singular Lagrangian
    if isinstance(config.data, ExactData):
        data = config.data.model_copy(update={
            'samples': _STATES, 'edge_share': 0.0, 'trajectory': None, 'noise': 0.0})
        dataset = sample_exact(data, config.seed + 1)
        assert dataset.energies is not None, 'exact data have them'
        return energy_error(hamiltonian.energy(dataset.q, family.momenta(dataset)),
                            dataset.energies, config.seed)
    if dataset.t is None:
        return None  # without times no motion, and so no energy reference, is known
    p = family.momenta(dataset)
    learned = hamiltonian.energy(dataset.q, p)
    if isinstance(family, EnergyFamily) and not row.conservative:
        work = model_work(family, replace(dataset, p=p), dataset.motion)
        return energy_spread(learned, dataset.motion, config.seed, work,
                             'work of forces and friction')
    work, power = friction_work(learned, dataset.motion, dataset.t, dataset.dq_dt)
    if power == 0.0:
        return energy_spread(learned, dataset.motion, config.seed)
    error = energy_spread(learned, dataset.motion, config.seed, work, 'work of fitted friction')
    return error.model_copy(update={'friction_power': power})


def model_work(family: EnergyFamily, dataset: Dataset, trajectory: np.ndarray) -> np.ndarray:
    """
    Return the work of a model's learned forces along measured motions.

    The power is H_q . q' + H_p . p' with the model's rates (q', p'); without forces it is 0.

    Parameters
    ----------
    family : EnergyFamily
        The trained model.
    dataset : Dataset
        States and commands with times.
    trajectory : np.ndarray of int, shape (N,)
        Trajectory number of each state.

    Returns
    -------
    np.ndarray, shape (N,)
        Work W [J] by the trapezoidal rule, zero at the start of each trajectory.

    """
    z = torch.tensor(np.hstack([dataset.q, dataset.p]))
    commands = None if dataset.commands is None else torch.tensor(dataset.commands)
    rates = family.vector_field(z, commands)
    power = (family.gradient(z) * rates).sum(dim=1).detach().numpy()
    assert dataset.t is not None, 'asked of motions alone'
    return integrated(power[:, None], trajectory, dataset.t)[:, 0]
