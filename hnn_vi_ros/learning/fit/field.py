# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Fit families that learn a field of (q, p) to states and rates: losses and stages."""

from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.dataset import Dataset
from hnn_vi_ros.learning.families.base import Scales
from hnn_vi_ros.learning.fit.config import FieldConfig
from hnn_vi_ros.learning.fit.loop import Fitted, Stage, Train, trained, TrainingProblem
from hnn_vi_ros.learning.fit.steps import path
import numpy as np
import torch

PAIRS = 256  # number of state pairs for the penalty on nonlinearity
_VALIDATION_SHARE = 0.1  # share of the data held out for validation


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
    states = path(family.vector_field, choice.integrator, z0, choice.step_size, choice.count)
    return torch.cat([(z - z0) / (k * choice.step_size) for k, z in enumerate(states, 1)])


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


@dataclass(frozen=True)
class FieldSamples:
    """
    Data of a field as tensors, in the form that its loss needs.

    Parameters
    ----------
    config : FieldConfig
        Family, loss, widths, seed, split and penalties.
    dataset : Dataset
        Training and held-out data.
    train, validation, test : Batch
        The parts of the data.
    unit : torch.Tensor, shape (k,)
        Root mean square of the target.
    pairs : sequence of torch.Tensor
        Pairs of states for the penalty on nonlinearity.

    """

    config: FieldConfig
    dataset: Dataset
    train: Batch
    validation: Batch
    test: Batch | None
    unit: torch.Tensor
    pairs: Sequence[torch.Tensor]

    @classmethod
    def of(cls, config: FieldConfig, dataset: Dataset, device: str = 'cpu') -> 'FieldSamples':
        """Return the samples on a device; raise DataError for data that lack a channel."""
        test, rest = None, dataset
        if config.test_fraction > 0.0:
            rest, test = dataset.split(config.test_fraction, config.seed)
        batch = partial(LOSSES[config.loss.kind].batch, config.loss)
        train, validation = map(batch, rest.split(_VALIDATION_SHARE, config.seed))
        unit = train.target.square().mean(dim=0).sqrt()
        if not (unit > 0.0).all():
            raise DataError(f'{dataset.description}: a coordinate never changes; use data in '
                            'which every coordinate moves')
        rng, scales = np.random.default_rng(config.seed), Scales.of(dataset)
        pairs = [torch.tensor(scales.centre + scales.half * rng.uniform(
            -1, 1, (PAIRS, len(scales.centre)))) for _ in range(2)]
        return cls(config, dataset, train, validation, None if test is None else batch(test), unit,
                   pairs).on(device)

    def on(self, device: str) -> 'FieldSamples':
        """Return the samples on another device."""
        return replace(
            self, train=self.train.to(device), validation=self.validation.to(device),
            test=None if self.test is None else self.test.to(device),
            unit=self.unit.to(device), pairs=[pair.to(device) for pair in self.pairs])

    def _predicted(self, family: Any, batch: Batch) -> torch.Tensor:
        loss = self.config.loss
        return LOSSES[loss.kind].predict(loss, family, *batch.inputs)

    def errors(self, family: Any, batch: Batch) -> torch.Tensor:
        """Return prediction minus target, shape (N, k)."""
        return self._predicted(family, batch) - batch.target

    def _misfit(self, family: Any, batch: Batch) -> torch.Tensor:
        return family.misfit(
            batch.inputs[0], self._predicted(family, batch), batch.target, self.unit)

    def loss(self, family: Any) -> torch.Tensor:
        """Return the training loss, including penalties."""
        loss = self._misfit(family, self.train)
        if self.config.linearity:
            loss = loss + self.config.linearity * nonlinearity(
                family, self.pairs[0], self.pairs[1], self.unit)
        preference = family.preference(*self.train.inputs)
        return loss if preference is None else loss + preference

    def validation_loss(self, family: Any) -> float:
        """Return the loss on held-out data."""
        return float(self._misfit(family, self.validation).detach())

    def final_losses(self, family: Any) -> dict[str, float]:
        """Return the losses, and the RMS errors on held-out data in the data's units."""
        train = mean_square(self.errors(family, self.train), self.unit)
        values = {'train_loss': float(train.detach())}
        unseen = self.unseen_losses(family, self.validation)
        values['validation_loss'] = unseen.pop('loss')
        if self.test is not None:
            values['test_loss'] = self.unseen_losses(family, self.test)['loss']
        return values | unseen

    def unseen_losses(self, family: Any, batch: Batch) -> dict[str, float]:
        """Return the loss and the RMS errors, in the data's units, on data not trained on."""
        errors = self.errors(family, batch).detach()
        values, parts = {'loss': mean_square(errors, self.unit)}, LOSSES[
            self.config.loss.kind].parts
        if len(parts) > 1:
            values['field_rms'] = errors.square().mean().sqrt()
        for name, part in zip(parts, errors.chunk(len(parts), dim=1), strict=True):
            values[f'{name}_rms'] = part.square().mean().sqrt()
        return {name: float(value) for name, value in values.items()}


@dataclass(frozen=True)
class FittedField(Fitted):
    """
    A fitted field.

    Parameters
    ----------
    module, losses, history, noise
        See Fitted.
    samples : FieldSamples
        The data that it was fitted to.

    """

    samples: FieldSamples = field(kw_only=True)


def fit_field(config: FieldConfig, dataset: Dataset, device: str = 'cpu', train: Train = trained
              ) -> FittedField:
    """
    Fit a field to states and rates.

    Parameters
    ----------
    config, dataset
        See FieldSamples.
    device : str
        Training device, 'cpu' or 'cuda'.
    train : callable
        Runs the stages.

    Raises
    ------
    DataError
        The data lack a channel that the family or the loss needs.

    """
    samples = FieldSamples.of(config, dataset, device)
    found = train(TrainingProblem(network_of(config, dataset).to(device), _stages(samples)))
    samples = samples.on('cpu')
    module = found.module if device == 'cpu' else deepcopy(found.module).to('cpu')
    return FittedField(module, samples.final_losses(module), found.history, samples=samples)


def network_of(config: FieldConfig, dataset: Dataset) -> Any:
    """Return a new network with the scales of the data."""
    return config.family.network(config.hidden, Scales.of(dataset), config.seed)


def _stages(samples: FieldSamples) -> list[Stage]:
    """Return the stages: Adam finds a good basin, and L-BFGS converges in it."""
    config = samples.config
    return [Stage(name, lambda family, _: partial(samples.loss, family), steps, rate,
                  samples.validation_loss, config.patience, pairs=config.lbfgs_history)
            for name, steps, rate in (('Adam', config.adam_steps, config.learning_rate),
                                      ('L-BFGS', config.lbfgs_steps, None))]
