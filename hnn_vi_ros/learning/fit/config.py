# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Schema of training configurations, one per family."""

from collections.abc import Sequence
from functools import reduce
from operator import or_
import os
from pathlib import Path
from typing import Annotated, Any, Literal, TYPE_CHECKING, get_args

from hnn_vi_ros.errors import DataError, ModelError, offered
from hnn_vi_ros.files import (
    dump_yaml, find_yaml, package_file, parse_mapping, read_text, SCHEME, StrictModel, validate)
from hnn_vi_ros.hamiltonians import MOST_JOINTS
from hnn_vi_ros.learning.data.arrays import ArraysData, BodyArrays, BodyWindows
from hnn_vi_ros.learning.data.bags import BagMotions
from hnn_vi_ros.learning.data.motions import EvenMotion, Motion
from hnn_vi_ros.learning.data.sources import configuration_of, dimension, read_motions, Source
from hnn_vi_ros.learning.data.text import LogMotions
from hnn_vi_ros.learning.families.base import Trainable
from hnn_vi_ros.learning.families.choices import (
    AUTO, Discrete, FamilyChoice, FieldLoss, Forward, Inverse, MachineFamily, MachineLoss,
    Regression, RigidBodyChoice, Structure, TrajectoryLoss, VectorField)
from hnn_vi_ros.learning.families.hnn import HNNChoice
from hnn_vi_ros.learning.families.lie_group import (
    BodyStage, LieGroupChoice, LieMethod, RetractionName)
from hnn_vi_ros.learning.fit.excitation import ExcitationData, excited_motions
from hnn_vi_ros.models import CoordinateCard, FAMILIES, Kind, RIGID_BODY
from hnn_vi_ros.phase_space import IN_DEGREES
from pydantic import Field, field_validator, ValidationError

_OF_FIELDS: list[Any] = [row.trainer.schema for row in FAMILIES.values()
                         if row.trained and issubclass(row.trainer, Trainable)]
if TYPE_CHECKING:
    FieldFamily = FamilyChoice
else:
    FieldFamily = Annotated[reduce(or_, _OF_FIELDS), Field(discriminator='kind')]
Widths = Annotated[list[Annotated[int, Field(ge=1, le=4096)]], Field(
    min_length=1, max_length=16, description='widths of the hidden layers, for each network')]
Seed = Annotated[int, Field(ge=0, lt=2**63, description=(
    'seed of data, split, initial weights and batches'))]
Rate = Annotated[float, Field(gt=0.0, le=1.0)]


class TrainingConfig(StrictModel):
    """Configuration of one training run; omitted keys take the defaults."""

    description: str = Field('', max_length=1000)

    @field_validator('coordinates', check_fields=False)
    @classmethod
    def _check_units(cls, coordinates: list[CoordinateCard]) -> list[CoordinateCard]:
        for one in coordinates:
            if IN_DEGREES.search(one.q_unit):
                raise ValueError(f'{one.name} has q_unit: {one.q_unit}; angles are in rad: name '
                                 'columns in degrees in data.degrees')
        return coordinates

    def check_loss(self, family: FamilyChoice, kind: str) -> None:
        """Raise ValueError if a loss cannot train a family."""
        if kind not in family.losses:
            raise ValueError(f'loss: {kind} does not train the family {family.kind}; valid: '
                             f'{", ".join(family.losses)}')


class ReferenceState(StrictModel):
    """The state of zero energy; it fixes the constant that the gradient of H leaves free."""

    q: list[float]
    p: list[float]
    energy: float = Field(0.0, description='H at this state')


class FieldConfig(TrainingConfig):
    """Configuration of a family that learns H or a vector field of (q, p)."""

    coordinates: list[CoordinateCard] = Field(min_length=1)
    data: Source
    family: FieldFamily = Field(HNNChoice(kind='hnn'), description='family of models')
    loss: FieldLoss = Field(VectorField(), description='loss function')
    hidden: Widths = [64, 64]
    seed: Seed = 0
    test_fraction: float = Field(0.0, ge=0.0, le=0.5, description=(
        'share of the data held out for the final test'))
    adam_steps: int = Field(1000, ge=1, le=1_000_000)
    learning_rate: Rate = Field(5e-3, description='initial learning rate of Adam')
    lbfgs_steps: int = Field(2000, ge=0, le=1_000_000)
    lbfgs_history: int = Field(50, ge=1, le=1000, description=(
        'history length of L-BFGS; a longer one reduces the loss further in the same number of '
        'steps'))
    patience: int | None = Field(None, ge=1, description=(
        'evaluations of the validation loss, one every 20 steps, without improvement after which '
        'training stops early and restores the best weights'))
    linearity: float = Field(0.0, ge=0.0, description=(
        'weight of a penalty on nonlinearity of the field where the data do not determine H'))
    reference: ReferenceState | None = Field(None, description=(
        'state of known energy; default: H = 0 at the centre of the box'))
    confine: bool = Field(False, description=(
        'confine states near the box of the data by default in scenes'))

    def _check(self) -> None:
        d = len(self.coordinates)
        lengths = {'data': dimension(self.data) or d}
        if self.reference is not None:
            lengths |= {'reference.q': len(self.reference.q), 'reference.p': len(self.reference.p)}
        for key, length in lengths.items():
            if length != d:
                raise ValueError(f'{key} has {length} coordinates, but coordinates names {d}')
        self.check_loss(self.family, self.loss.kind)
        for key in sorted(self.data.model_fields_set & {'delay', 'measured', 'test_runs'}):
            raise ValueError(f'data.{key}: not for states (q, p); remove this key')
        if self.linearity and self.loss.kind in ('discrete_lagrangian', 'euler_lagrange'):
            raise ValueError('linearity: requires a field of (q, p), which the loss '
                             f'{self.loss.kind} does not train; remove this key')
        if self.confine and not FAMILIES[self.family.kind].canonical:
            raise ValueError('confine: requires canonical momenta, which the family '
                             f'{self.family.kind} does not have; remove this key')


class MachineCoordinate(CoordinateCard):
    """A joint of a machine."""

    kind: Kind = Field('revolute', description=(
        'revolute: an angle with limits; continuous: an angle of period 2 pi; prismatic: a '
        'length'))


class MachineConfig(TrainingConfig):
    """Configuration of a family that learns a machine from (q, v, tau)."""

    coordinates: list[MachineCoordinate] = Field([], max_length=MOST_JOINTS, description=(
        'at least one; for a rigid_body, joints of its URDF (default: all movable joints)'))
    data: Annotated[ArraysData | BagMotions | LogMotions | ExcitationData,
                    Field(discriminator='kind')]
    family: MachineFamily
    baseline: bool = Field(False, description=(
        'whether a plain network of (q, v, tau) is trained as well, to compare with'))
    loss: MachineLoss | None = Field(None, description=(
        'loss function; default: forward if the data contain accelerations, else trajectory'))
    hidden: Widths = [32, 32]
    seed: Seed = 0
    learning_rate: Rate = Field(0.01, description=(
        'learning rate of Adam on accelerations; windows without their own rate use a fifth of '
        'it'))

    def _check(self) -> None:
        family, loss = self.family, self.loss
        if loss is not None:
            self.check_loss(family, loss.kind)
        if self.windows.records and (isinstance(family, RigidBodyChoice) or not family.prior):
            raise ValueError('loss.records: requires a prior of the family mechanical; remove '
                             'this key')
        if isinstance(family, RigidBodyChoice):
            return
        if isinstance(self.data, ExcitationData):
            raise ValueError('data: excitation computes motions of a rigid_body; use arrays, bag '
                             'or log')
        if not self.coordinates:
            raise ValueError('coordinates: expected at least one')
        for one in self.coordinates:
            unit, length = one.q_unit, one.kind == 'prismatic'
            if unit in ('rad', 'm') and length != (unit == 'm'):
                raise ValueError(f'coordinates: {one.name}: q_unit: {unit} and kind: {one.kind} '
                                 f'differ; write kind: {"revolute" if length else "prismatic"}')
        if family.prior not in (None, AUTO) and isinstance(loss, Regression):
            raise ValueError(f'loss: {loss.kind} does not fit a prior; use trajectory')
        if family.input_map == 'learned' and isinstance(loss, Inverse):
            raise ValueError('input_map: the loss inverse could be reduced with a small input '
                             'map, since it compares forces; use forward, discrete or trajectory')
        self.structure()

    @property
    def windows(self) -> TrajectoryLoss:
        """Return the windows used to fit a rigid body."""
        return self.loss if isinstance(self.loss, TrajectoryLoss) else TrajectoryLoss()

    def loss_of(self, motions: Sequence[Motion]) -> Forward | Inverse | Discrete | TrajectoryLoss:
        """Return the configured loss, or the default for these motions."""
        if self.loss is not None:
            return self.loss
        alone = self.family.prior in (None, AUTO)
        measured = all(motion.a is not None for motion in motions)
        return Forward(kind='forward') if measured and alone else TrajectoryLoss()

    def motions(self, source: Path, names: Sequence[str], given: Sequence[str], **changes: object
                ) -> tuple[list[EvenMotion], str]:
        """
        Return the motions of the data, measured or computed, and their description.

        Parameters
        ----------
        source, given
            As in ``read_motions``.
        names : sequence of str
            Names of the coordinates.
        **changes
            Changed options of the data.

        Raises
        ------
        DataError
            The motions cannot be read, or files are given for computed motions.

        """
        data = self.data.model_copy(update=changes)
        if not isinstance(data, ExcitationData):
            return read_motions(source, data, names, given,
                                [one.q_unit for one in self.coordinates])
        if given:
            raise DataError(f'{source}: its data are computed, so --data {given[0]} is not used; '
                            'remove it')
        assert isinstance(self.family, RigidBodyChoice), 'checked with the configuration'
        return excited_motions(data, self.family.robot(names), self.seed)

    def structure(self) -> Structure:
        """Return the structure of the networks; ValueError for an unknown coordinate name."""
        return self.family.structure([coordinate.name for coordinate in self.coordinates],
                                     [coordinate.kind for coordinate in self.coordinates])


class BodyCoordinate(CoordinateCard):
    """The coordinate of a body."""

    kind: Literal['rotation', 'pose'] = Field(description=(
        'rotation: the body rotates about a fixed point; pose: it also translates'))


class BodyConfig(TrainingConfig):
    """Configuration of a family that learns a rotating body."""

    coordinates: list[BodyCoordinate] = Field(min_length=1, max_length=1)
    data: Annotated[BodyArrays | BodyWindows, Field(discriminator='kind')]
    family: LieGroupChoice
    method: LieMethod = Field('lie_leapfrog', description=(
        'integrator in the windows: that of the scene in which the model will run'))
    retraction: RetractionName = Field('exponential', description='retraction of the integrator')
    substeps: int = Field(1, ge=1, le=1000, description='steps per interval of the data')
    windows: list[BodyStage] = Field(
        [BodyStage(intervals=1, adam_steps=200, lbfgs_steps=300)],
        min_length=1, description='stages of training, in this order')
    batch: int = Field(256, ge=1, description='windows per Adam step')
    hidden: Widths = [32, 32]
    seed: Seed = 0
    learning_rate: Rate = Field(0.005, description='learning rate of Adam')

    def _check(self) -> None:
        self.family.card(self.kind, [1.0] * (3 if self.kind == 'rotation' else 6), True)

    @property
    def kind(self) -> Literal['rotation', 'pose']:
        """Return the kind of motion of the body."""
        return self.coordinates[0].kind


AnyConfig = FieldConfig | MachineConfig | BodyConfig
_SCHEMAS: dict[str, type[FieldConfig] | type[MachineConfig] | type[BodyConfig]] = {
    **{name: FieldConfig for name, row in FAMILIES.items() if row.trained},
    'mechanical': MachineConfig, RIGID_BODY: MachineConfig, 'lie_group': BodyConfig}


def family_schemas() -> dict[str, type[FamilyChoice]]:
    """Return the schema of the key `family` of a training configuration, by its kind."""
    return {get_args(schema.model_fields['kind'].annotation)[0]: schema for schema in (
        *_OF_FIELDS, *get_args(get_args(MachineFamily)[0]), LieGroupChoice)}


def find_config(config: str) -> Path:
    """
    Return the path of a training configuration.

    Parameters
    ----------
    config : str
        Name of a shipped configuration, or path of a YAML file.

    Raises
    ------
    DataError
        The configuration does not exist; the message lists the valid names.

    """
    return find_yaml('training', config, DataError)


def guess_config(given: Sequence[str], counts: float | None = None) -> tuple[MachineConfig, str]:
    """Return a configuration for the only reading of some data, also as YAML, or DataError."""
    text = dump_yaml(configuration_of(given, counts))
    data, places = parse_mapping(text, given[0], DataError)
    return validate(data, places, MachineConfig, DataError), text


def guess_states(given: Sequence[str], counts: float | None = None) -> tuple[FieldConfig, str]:
    """Return the same for H(q, p), with velocities as momenta."""
    machine = configuration_of(given, counts)
    text = dump_yaml({'coordinates': [
        {'name': one['name'], 'q_unit': one['q_unit'], 'p_unit': f'{one["q_unit"]}/s'}
        for one in machine['coordinates']], 'data': machine['data']})
    data, places = parse_mapping(text, given[0], DataError)
    return validate(data, places, FieldConfig, DataError), text


def load_config(path: Path) -> AnyConfig:
    """
    Read a training configuration and validate it with the schema of its family.

    Raises
    ------
    DataError
        The file cannot be read or is invalid; the message names file, line and key.

    """
    data, places = parse_mapping(read_text(path, DataError), path, DataError)
    family = data.get('family')
    kind = family.get('kind') if isinstance(family, dict) else None
    if isinstance(kind, str) and kind not in _SCHEMAS:
        raise DataError(
            f'{places.place("family", "kind")}: unknown kind {kind[:80]!r}'
            f'{offered(kind, sorted(_SCHEMAS), "valid kinds")}')
    config = validate(data, places, _SCHEMAS[kind if isinstance(kind, str) else 'hnn'], DataError,
                      trust_code=True)
    if isinstance(config, MachineConfig) and isinstance(config.family, RigidBodyChoice):
        return _with_robot(path, config, config.family)
    return config


def load_machine(path: Path) -> MachineConfig:
    """Read a training configuration of a machine; raise DataError for other families."""
    config = load_config(path)
    if not isinstance(config, MachineConfig):
        raise DataError(f'{path}: the family {config.family.kind} does not describe a machine; '
                        f'use a configuration of mechanical or {RIGID_BODY}')
    return config


def _with_robot(path: Path, config: MachineConfig, family: RigidBodyChoice) -> MachineConfig:
    """Return a configuration with its URDF located and the coordinates of its joints filled in."""
    given = {coordinate.name: coordinate for coordinate in config.coordinates}
    try:
        file = package_file(family.file) if family.file.startswith(SCHEME) else \
            path.parent / family.file
        family = family.model_copy(update={
            'file': str(file if os.path.exists(file) else family.file)})
        robot = family.robot([*given])
        found = [MachineCoordinate(
            name=joint.name, q_unit=coordinate.q_unit, p_unit=coordinate.p_unit,
            kind=joint.kind)  # type: ignore[arg-type]  # those that move are of these kinds
            for joint, coordinate in zip(robot.joints, robot.coordinates, strict=True)]
    except ValidationError as problem:
        first = problem.errors(include_url=False)[0]
        raise DataError(f'{path}: family: {first["input"]!r}: the name of a joint must be a '
                        'letter or underscore, then letters, digits, underscores; rename it'
                        ) from problem
    except (ModelError, ValueError) as problem:
        raise DataError(f'{path}: family: {problem}') from problem
    return config.model_copy(update={'family': family, 'coordinates': found})
