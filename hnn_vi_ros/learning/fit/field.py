# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Losses and stages of families that learn a field of (q, p) from states and their rates."""

from collections.abc import Callable
from typing import Any, NamedTuple

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.dataset import Dataset
from hnn_vi_ros.learning.data.exact_data import ExactData
from hnn_vi_ros.learning.families.base import Scales
from hnn_vi_ros.learning.fit.config import FieldConfig
from hnn_vi_ros.learning.fit.loop import Problem, Stage
from hnn_vi_ros.learning.fit.steps import step
from hnn_vi_ros.models.families import FAMILIES
from hnn_vi_ros.models.model_card import Units
import numpy as np
import torch

PAIRS = 256  # of states, for the preference for a linear field


class Batch(NamedTuple):
    """
    Data as a loss takes them.

    Parameters
    ----------
    inputs : tuple of torch.Tensor
        The inputs of a prediction, N rows each.
    target : torch.Tensor, shape (N, k)
        The values to predict: rates of change, or accelerations.

    """

    inputs: tuple[torch.Tensor, ...]
    target: torch.Tensor

    def to(self, device: str) -> 'Batch':
        """Return the same on another device."""
        return Batch(tuple(part.to(device) for part in self.inputs), self.target.to(device))


class Loss(NamedTuple):
    """
    A loss: the mean square of prediction less target, in units of the target.

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
    """Return the mean square of errors, shape (N, k), in units of shape (k,)."""
    return (errors / unit).square().mean()


def nonlinearity(family: Any, z1: torch.Tensor, z2: torch.Tensor, unit: torch.Tensor
                 ) -> torch.Tensor:
    """
    Return how far the field between pairs of states is from linear, mean squared.

    It compares the field in the middle of each pair with the mean of the fields at its ends.
    Added with a small weight to the loss, it makes H plain where no data says otherwise: a
    single orbit leaves the energy inside it free.

    Parameters
    ----------
    family : Trainable
        With a vector field.
    z1, z2 : torch.Tensor, shape (N, 2 d)
        The states of each pair.
    unit : torch.Tensor, shape (2 d,)
        What each component's error is measured in.

    """
    ends = 0.5 * (family.vector_field(z1) + family.vector_field(z2))
    return mean_square(family.vector_field(0.5 * (z1 + z2)) - ends, unit)


def _rates(choice: Any, dataset: Dataset) -> Batch:
    z, rates = _joined(dataset.q, dataset.p), _joined(dataset.dq_dt, dataset.dp_dt)
    commands = () if dataset.commands is None else (torch.tensor(dataset.commands),)
    return Batch((z, *commands), rates)


def _paths(choice: Any, dataset: Dataset) -> Batch:
    """Return the first states, and the mean rates from there until each of the next ones."""
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
    """Return three positions in a row each, and their second differences."""
    windows = dataset.windows(choice.step_size, 3)
    q0, q1, q2 = torch.tensor(dataset.q[windows]).unbind(dim=1)
    return Batch((q0, q1, q2), (q2 - 2.0 * q1 + q0) / choice.step_size**2)


def _discrete_euler_lagrange(choice: Any, family: Any, q0: torch.Tensor, q1: torch.Tensor,
                             q2: torch.Tensor) -> torch.Tensor:
    """
    Return the second difference by D_1 L_d(q1, q2) + D_2 L_d(q0, q1) = 0.

    With L = v . M v / 2 - V(q) it is -M^-1 V'(q1) by the trapezoid rule, and the mean of
    -M^-1 V' at the two midpoints by the midpoint rule.
    """
    if choice.rule == 'trapezoid':
        return family.acceleration(q1)
    before, after = family.acceleration(0.5 * (q0 + q1)), family.acceleration(0.5 * (q1 + q2))
    return 0.5 * (before + after)


def _velocities(choice: Any, dataset: Dataset) -> Batch:
    if dataset.accelerations is None:
        raise DataError(f'{dataset.description}: no accelerations, which the loss euler_lagrange '
                        'learns from; give a bag or exact data, or take another family')
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


class Comparison(NamedTuple):
    """
    Predictions of a model for held-out data, next to the data.

    Parameters
    ----------
    states : np.ndarray, shape (M, 2 d), or None
        Where, in the loss's first rows; None where a prediction is not made from a state.
    target, predicted : np.ndarray, shape (N, k)
        Rates of change, or accelerations.
    units : np.ndarray, shape (k,)
        Root mean square of the target.
    parts : tuple of str
        Names of the equal parts of a row.
    exact : bool
        Whether the target is the field of an exact system.

    """

    states: np.ndarray | None
    target: np.ndarray
    predicted: np.ndarray
    units: np.ndarray
    parts: tuple[str, ...]
    exact: bool


class FieldProblem(Problem):
    """
    The data as tensors, a fresh model, and the loss that it is trained on.

    Parameters
    ----------
    config : FieldConfig
        Family, loss, widths, seed, split and preferences.
    dataset : Dataset
        What to learn from.
    device : str
        Where to train: 'cpu' or 'cuda'.

    Raises
    ------
    DataError
        The data lack what the family or the loss needs.

    """

    def __init__(self, config: FieldConfig, dataset: Dataset, device: str = 'cpu'):
        self._config, self._loss = config, LOSSES[config.loss.kind]
        test, rest = None, dataset
        if config.test_fraction > 0.0:
            rest, test = dataset.split(config.test_fraction, config.seed)
        train, validation = rest.split(config.validation_fraction, config.seed)
        scales = self._scales = Scales.of(dataset)
        self._exact = isinstance(config.data, ExactData) and config.data.noise == 0.0
        # Adam finds a good valley, and L-BFGS descends it.
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
            raise DataError(f'{dataset.description}: a coordinate never changes; learn from data '
                            'in which every coordinate moves')
        rng = np.random.default_rng(config.seed)
        self._pairs = [torch.tensor(scales.centre + scales.half * rng.uniform(
            -1, 1, (PAIRS, len(scales.centre)))) for _ in range(2)]
        self.to(device)

    def loss(self) -> torch.Tensor:
        """Return the loss that training minimises, with preferences."""
        loss = mean_square(self._errors(self._train), self._unit)
        if self._config.linearity:
            loss = loss + self._config.linearity * nonlinearity(
                self.module, self._pairs[0], self._pairs[1], self._unit)
        preference = self.module.preference(*self._train.inputs)
        return loss if preference is None else loss + preference

    def validation_loss(self) -> float:
        """Return the loss on the held-out data."""
        return float(mean_square(self._errors(self._validation), self._unit).detach())

    def final_losses(self) -> dict[str, float]:
        """Return the losses, and the RMS errors on the held-out data in its own units."""
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
        """Return predictions of the model next to the held-out data."""
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
