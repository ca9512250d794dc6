# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The schema of a training configuration of a body that turns: of the family lie_group."""

from pathlib import Path
from typing import Annotated, Literal

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.files.yaml_file import load_yaml, StrictModel
from hnn_vi_ros.learning.data.body_data import BodyArrays, BodyWindows
from hnn_vi_ros.learning.fit.lie_steps import MethodName, RetractionName
from hnn_vi_ros.models.lie_group_card import LieGroupCard, Seen
from hnn_vi_ros.models.model_card import CoordinateCard
from pydantic import Field, model_validator

# Least eigenvalue of S^-1 M^-1 S^-1.
FLOOR = 1e-3


class BodyCoordinate(CoordinateCard):
    """A body."""

    kind: Literal['rotation', 'pose'] = Field(description=(
        'rotation: it turns about a point; pose: it moves as well'))


class LieGroupChoice(StrictModel):
    """Networks of M(q)^-1 and V(q), or one of H(q, p); dissipation and input map."""

    kind: Literal['lie_group']
    structured: bool = Field(True, description=(
        'whether H = p . M^-1 p / 2 + V(q); or V sees the momentum as well, and M is constant'))
    mass_depends_on: list[Seen] = Field([], max_length=2, description=(
        'what M sees; none: it is constant in the frame of the body'))
    potential_depends_on: list[Seen] = Field(
        ['attitude'], min_length=1, max_length=2, description='what V sees')
    dissipation: Literal['none', 'constant', 'learned'] = Field('none', description=(
        'D of the force -D v, positive semidefinite: constant, or by what M sees'))
    input_map: Literal['identity', 'learned'] = Field('learned', description=(
        'the inputs are forces in the frame of the body, one for each velocity; or a matrix of '
        'what they do is learned'))
    input_map_depends_on: list[Seen] = Field([], max_length=2, description='what that sees')

    @model_validator(mode='after')
    def _check(self) -> 'LieGroupChoice':
        if not self.structured and self.mass_depends_on:
            raise ValueError('mass_depends_on: structured: false has a constant M beside the '
                             'network of all; leave it out')
        return self


class BodyStage(StrictModel):
    """Some steps on windows of so many intervals of the data."""

    intervals: int = Field(ge=1, description='of each window')
    adam_steps: int = Field(0, ge=0, le=1_000_000)
    lbfgs_steps: int = Field(0, ge=0, le=1_000_000, description='on the same windows each')
    lbfgs_windows: int = Field(1024, ge=1, description='so many at most, drawn at random')


class BodyConfig(StrictModel):
    """One training run of the family lie_group; a file states what differs from the defaults."""

    description: str = Field('', max_length=1000)
    coordinates: list[BodyCoordinate] = Field(min_length=1, max_length=1)
    data: Annotated[BodyArrays | BodyWindows, Field(discriminator='kind')]
    family: LieGroupChoice
    method: MethodName = Field('lie_leapfrog', description=(
        'of the steps of windows: that of the scene in which the model is to run'))
    retraction: RetractionName = Field('exponential', description='of these steps')
    substeps: int = Field(1, ge=1, le=1000, description='steps in each interval of the data')
    windows: list[BodyStage] = Field(
        [BodyStage(intervals=1, adam_steps=200, lbfgs_steps=300)],
        min_length=1, description='what training does, in this order')
    batch: int = Field(256, ge=1, description='windows in each step of Adam')
    time_scale: float = Field(1.0, gt=0.0, description=(
        'an error of the pose counts as one of the velocity does that makes it in this time [s]'))
    hidden: list[Annotated[int, Field(ge=1, le=4096)]] = Field(
        [32, 32], min_length=1, max_length=16, description='widths of the hidden layers')
    seed: int = Field(0, ge=0, lt=2**63, description='of the initial weights and the batches')
    learning_rate: float = Field(0.005, gt=0.0, le=1.0, description='of Adam')

    @model_validator(mode='after')
    def _check(self) -> 'BodyConfig':
        self.card([1.0] * (3 if self.coordinates[0].kind == 'rotation' else 6), True)
        return self

    def card(self, mass_scale: list[float], driven: bool) -> LieGroupCard:
        """Return what the networks see; ValueError for what this body has not."""
        family = self.family
        potential: list[str] = [*family.potential_depends_on]
        if not family.structured:
            potential.append('momentum')
        drag = {'none': None, 'constant': [], 'learned': family.mass_depends_on or ['attitude']}
        return LieGroupCard.model_validate({
            'kind': self.coordinates[0].kind, 'mass_scale': mass_scale, 'floor': FLOOR,
            'mass_depends_on': family.mass_depends_on, 'potential_depends_on': potential,
            'dissipation_depends_on': drag[family.dissipation],
            'input_map_depends_on': family.input_map_depends_on
            if driven and family.input_map == 'learned' else None})


def load_body(path: Path) -> BodyConfig:
    """Read and validate a configuration; a DataError names file, line and key."""
    return load_yaml(path, BodyConfig, DataError)
