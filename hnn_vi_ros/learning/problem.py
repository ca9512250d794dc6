# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A training problem: the data as tensors, a fresh model, and the loss between the two."""

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.learning.config import TrainingConfig
from hnn_vi_ros.learning.dataset import Dataset
from hnn_vi_ros.learning.families import FAMILIES
from hnn_vi_ros.learning.families.base import Scales
from hnn_vi_ros.learning.losses import Batch, LOSSES, mean_square, nonlinearity
import numpy as np
import torch

PAIRS = 256  # of states, for the preference for a linear field


class Problem:
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
        scales = Scales.of(dataset)
        self.family = FAMILIES[config.family.kind](
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

    def _errors(self, batch: Batch) -> torch.Tensor:
        return self._loss.predict(self._choice, self.family, *batch.inputs) - batch.target
