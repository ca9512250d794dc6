# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A training problem: the data as tensors, a fresh model, and the loss between the two."""

from typing import NamedTuple

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.data.dataset import Dataset
from hnn_vi_ros.learning.data.exact_data import ExactData
from hnn_vi_ros.learning.families.base import Scales
from hnn_vi_ros.learning.fit.config import TrainingConfig
from hnn_vi_ros.learning.fit.losses import Batch, LOSSES, mean_square, nonlinearity
from hnn_vi_ros.models.families import FAMILIES
from hnn_vi_ros.models.model_card import Units
import numpy as np
import torch

PAIRS = 256  # of states, for the preference for a linear field


class Comparison(NamedTuple):
    """
    Predictions of a model for held-out data, beside what they are.

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


class TrainingProblem:
    """
    The data as tensors, a fresh model, and the loss that it is trained on.

    Parameters
    ----------
    config : TrainingConfig
        Family, loss, widths, seed, split and preferences.
    dataset : Dataset
        What to learn from.

    Attributes
    ----------
    family : Family
        The model.

    Raises
    ------
    DataError
        The data lack what the family or the loss needs.

    """

    def __init__(self, config: TrainingConfig, dataset: Dataset):
        self._choice, self._linearity = config.loss, config.linearity
        self._loss = LOSSES[self._choice.kind]
        test, rest = None, dataset
        if config.test_fraction > 0.0:
            rest, test = dataset.split(config.test_fraction, config.seed)
        train, validation = rest.split(config.validation_fraction, config.seed)
        scales = self._scales = Scales.of(dataset)
        self._exact = isinstance(config.data, ExactData) and config.data.noise == 0.0
        self.family = FAMILIES[config.family.kind].trainer(
            config.family, config.hidden, scales, config.seed)
        self._train, self._validation = (
            self._loss.batch(self._choice, part) for part in (train, validation))
        self._test = None if test is None else self._loss.batch(self._choice, test)
        self._unit = self._train.target.square().mean(dim=0).sqrt()
        if not (self._unit > 0.0).all():
            raise DataError(f'{dataset.description}: a coordinate never changes; learn from data '
                            'in which every coordinate moves')
        rng = np.random.default_rng(config.seed)
        self._pairs = [torch.tensor(scales.centre + scales.half * rng.uniform(
            -1, 1, (PAIRS, len(scales.centre)))) for _ in range(2)]

    def loss(self) -> torch.Tensor:
        """Return what training makes small."""
        loss = mean_square(self._errors(self._train), self._unit)
        if self._linearity:
            loss = loss + self._linearity * nonlinearity(self.family, *self._pairs, self._unit)
        preference = self.family.preference(*self._train.inputs)
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
        """Return what the model says of the held-out data."""
        batch, parts = self._validation, self._loss.parts
        target = batch.target.cpu().numpy()
        predicted = target + self._errors(batch).detach().cpu().numpy()
        states = batch.inputs[0].cpu().numpy() if parts == ('dq_dt', 'dp_dt') else None
        return Comparison(states, target, predicted, self._unit.cpu().numpy(), parts, self._exact)

    @property
    def units(self) -> Units:
        """Return what the networks' inputs and the loss are scaled by."""
        return Units(centre=self._scales.centre.tolist(), scale=self._scales.half.tolist(),
                     target=self._unit.tolist())

    def to(self, device: str) -> None:
        """Move the model and the data to a device."""
        self.family.to(device)
        self._train, self._validation = self._train.to(device), self._validation.to(device)
        self._test = None if self._test is None else self._test.to(device)
        self._unit = self._unit.to(device)
        self._pairs = [pair.to(device) for pair in self._pairs]

    def _errors(self, batch: Batch) -> torch.Tensor:
        return self._loss.predict(self._choice, self.family, *batch.inputs) - batch.target
