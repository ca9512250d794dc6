# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The schema of a training configuration, and where the shipped ones lie."""

from pathlib import Path
from typing import Annotated

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.files.resources import find_yaml
from hnn_vi_ros.files.yaml_file import load_yaml, StrictModel
from hnn_vi_ros.learning.data.sources import dimension, Source
from hnn_vi_ros.learning.families.choices import FamilyChoice, HNNChoice, LossChoice, VectorField
from hnn_vi_ros.models.families import FAMILIES
from hnn_vi_ros.models.model_card import CoordinateCard
from pydantic import Field, model_validator


class ReferenceState(StrictModel):
    """The state that sets the zero of the energy, which its gradient leaves open."""

    q: list[float]
    p: list[float]
    energy: float = Field(0.0, description='H there')


class TrainingConfig(StrictModel):
    """One training run; a file states only what differs from the defaults."""

    description: str = Field('', max_length=1000)
    coordinates: list[CoordinateCard] = Field(min_length=1)
    data: Source
    family: FamilyChoice = Field(HNNChoice(kind='hnn'), description='what is learned')
    loss: LossChoice = Field(VectorField(kind='vector_field'), description='how')
    hidden: list[Annotated[int, Field(ge=1, le=4096)]] = Field(
        [64, 64], min_length=1, max_length=16, description=(
            'widths of the hidden layers, of each network'))
    seed: int = Field(0, ge=0, lt=2**63, description='of data, split and initial weights')
    validation_fraction: float = Field(0.1, gt=0.0, le=0.5, description='of the data, held out')
    test_fraction: float = Field(0.0, ge=0.0, le=0.5, description=(
        'of the data, held out as well, and looked at once, at the end'))
    adam_steps: int = Field(1000, ge=1, le=1_000_000)
    learning_rate: float = Field(5e-3, gt=0.0, le=1.0, description='of Adam at its start')
    lbfgs_steps: int = Field(2000, ge=0, le=1_000_000)
    lbfgs_history: int = Field(50, ge=1, le=1000, description=(
        'steps that L-BFGS remembers; more go deeper for the same number of steps'))
    patience: int | None = Field(None, ge=1, description=(
        'looks at the validation loss, one every 20 steps, without a lower one after which '
        'training stops early, and goes back to the best weights'))
    linearity: float = Field(0.0, ge=0.0, description=(
        'weight of a preference for a linear field where the data leave H open'))
    reference: ReferenceState | None = Field(None, description='default: H = 0 in the box centre')
    confine: bool = Field(False, description=(
        'whether scenes hold states near the box of the data, unless they say otherwise'))

    @model_validator(mode='after')
    def _check(self) -> 'TrainingConfig':
        d = len(self.coordinates)
        lengths = {'data': dimension(self.data)}
        if self.reference is not None:
            lengths |= {'reference.q': len(self.reference.q),
                        'reference.p': len(self.reference.p)}
        for key, length in lengths.items():
            if length != d:
                raise ValueError(f'{key} has {length} coordinates, but coordinates names {d}')
        self._check_loss()
        return self

    def _check_loss(self) -> None:
        if self.loss.kind not in self.family.losses:
            raise ValueError(f'loss: {self.loss.kind} does not train the family '
                             f'{self.family.kind}; valid: {", ".join(self.family.losses)}')
        if self.linearity and self.loss.kind in ('discrete_lagrangian', 'euler_lagrange'):
            raise ValueError(f'linearity: needs a field of (q, p), which the loss '
                             f'{self.loss.kind} does not train; leave it out')
        if self.confine and not FAMILIES[self.family.kind].canonical:
            raise ValueError(f'confine: needs canonical momenta, which the family '
                             f'{self.family.kind} has not')


def find_config(config: str) -> Path:
    """
    Return the file of a training configuration.

    Parameters
    ----------
    config : str
        The name of a shipped one, or the path of a YAML file.

    Raises
    ------
    DataError
        No such configuration; lists the valid names.

    """
    return find_yaml('training', config, DataError)


def load_config(path: Path) -> TrainingConfig:
    """Read and validate a training configuration; a DataError names file, line and key."""
    return load_yaml(path, TrainingConfig, DataError)
