# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The schema of a training configuration of a machine: of the family mechanical."""

from pathlib import Path
import re
from typing import Annotated, Literal

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.files.yaml_file import load_yaml, StrictModel
from hnn_vi_ros.learning.families.structure import Structure
from hnn_vi_ros.learning.motion_arrays import ArraysData
from hnn_vi_ros.learning.motion_bags import BagMotions
from hnn_vi_ros.learning.motion_logs import LogMotions
from hnn_vi_ros.learning.window_steps import MethodName
from hnn_vi_ros.models.exact_prior import exact_systems
from hnn_vi_ros.models.mechanical_card import check_prior, check_row, Kind
from hnn_vi_ros.models.model_card import CoordinateCard
from hnn_vi_ros.models.planar_chain import CHAINS
from pydantic import Field, model_validator

# A term of a linear combination: sign, number, name.
_TERM = re.compile(r'\s*([+-]?)\s*(?:(\d+\.?\d*(?:e[+-]?\d+)?)\s*\*\s*)?([^\W\d]\w*)\s*')


class MachineCoordinate(CoordinateCard):
    """A joint."""

    kind: Kind = Field('revolute', description=(
        'revolute: an angle with ends; continuous: one that turns over, of period 2 pi; '
        'prismatic: a length'))


class _TestRuns(StrictModel):
    test_runs: list[str] = Field([], description=(
        'runs to judge the model by; none: the last fifth of each run in time'))


class MachineArrays(ArraysData, _TestRuns):
    """Measured motions in an .npz file."""

    kind: Literal['arrays']


class MachineBags(BagMotions, _TestRuns):
    """Measured motions in bags."""

    kind: Literal['bag']


class MachineLog(LogMotions, _TestRuns):
    """Measured motions in a text file."""

    kind: Literal['log']


MachineData = Annotated[MachineArrays | MachineBags | MachineLog, Field(discriminator='kind')]


class FrictionChoice(StrictModel):
    """What friction there is; all that is named adds up."""

    viscous: bool = Field(True, description='-b v')
    coulomb: int = Field(2, ge=0, le=8, description='how many terms -c tanh(v / w)')
    stribeck: int = Field(0, ge=0, le=8, description=(
        'how many terms -c tanh(v / w) exp(-(v / s)^2)'))
    network: bool = Field(False, description=(
        '-D(q) v with a network D = B B^T, which couples the joints and depends on where they '
        'are'))
    network_depends_on: list[str] | None = Field(None, description=(
        'what D sees: linear combinations of coordinates; what M sees'))


class MechanicalChoice(StrictModel):
    """Networks M(q) and V(q), and friction."""

    kind: Literal['mechanical']
    features: list[str] | None = Field(None, min_length=1, description=(
        'what V sees: linear combinations of coordinates, such as a + b; each coordinate'))
    mass: Literal['learned', 'diagonal', 'constant'] = Field('learned', description=(
        'M(q), a diagonal one, or a matrix that depends on nothing'))
    mass_depends_on: list[str] | None = Field(None, description=(
        'what M sees, in the same way; each coordinate'))
    friction: FrictionChoice = Field(default_factory=FrictionChoice)
    input_map: Literal['identity', 'learned'] = Field('identity', description=(
        'each joint has a force of its own in the data; or the forces are of motors, at most as '
        'many as joints, and a constant matrix of what they do to the joints is learned'))
    prior: str | None = Field(None, description=(
        'what is fitted, and the networks are added to: pendulum or double_pendulum, rigid links '
        'that turn by the angles that are the features; or another exact system, by its name in '
        'scenes, of the coordinates in their order'))
    residual: bool = Field(True, description='whether there are networks beside a prior')
    residual_weight: float = Field(1e-3, ge=0.0, description=(
        'of the size of the networks beside a prior, at random states, in the loss'))


class Stage(StrictModel):
    """Some steps of Adam on windows of one length."""

    duration: float = Field(gt=0.0, description='of each window [s]')
    steps: int = Field(ge=1, le=1_000_000)


class _Regression(StrictModel):
    steps: int = Field(400, ge=1, le=1_000_000, description='of Adam')
    batch: int = Field(1024, ge=1, description='samples in each of those steps')
    lbfgs_steps: int = Field(2000, ge=0, le=1_000_000, description=(
        'of L-BFGS, which follow; they end sooner when they make a tenth of the samples worse '
        'that is left out of them'))


class Forward(_Regression):
    """The accelerations at each sample: best where they were measured, or are exact."""

    kind: Literal['forward']


class Inverse(_Regression):
    """The forces of the motors at each sample, from its acceleration."""

    kind: Literal['inverse']


class Discrete(_Regression):
    """The forced discrete Euler-Lagrange equations of the midpoint rule, from positions alone."""

    kind: Literal['discrete']
    step_size: float | None = Field(None, gt=0.0, description=(
        'a multiple of the interval of the samples [s]; default: that at which noise and the '
        'rule have about the same error'))


class Trajectory(StrictModel):
    """Accelerations first; then windows that are simulated from their smoothed first state."""

    kind: Literal['trajectory']
    forward_steps: int = Field(400, ge=1, description='of Adam on accelerations')
    forward_batch: int = Field(1024, ge=1, description='samples in each of those steps')
    step_size: float | None = Field(None, gt=0.0, description=(
        'of the windows, a multiple of the interval of the samples [s]; forces are averaged over '
        'it; default: the multiple that is next to 0.01 s'))
    windows: list[Stage] = Field(
        [Stage(duration=0.1, steps=600), Stage(duration=0.25, steps=400)],
        description='what follows, in this order')
    method: MethodName = Field('implicit_midpoint', description=(
        'of their steps: that of the scene in which the model is to run, or rk4, which conserves '
        'nothing'))
    batch: int = Field(256, ge=1, description='windows in each of their steps')
    time_scale: float = Field(0.1, gt=0.0, description=(
        'an error of q counts as one of v does that makes it in this time [s]'))


Loss = Annotated[Forward | Inverse | Discrete | Trajectory, Field(discriminator='kind')]


class MachineConfig(StrictModel):
    """One training run of the family mechanical; a file states what differs from the defaults."""

    description: str = Field('', max_length=1000)
    coordinates: list[MachineCoordinate] = Field(min_length=1, max_length=7)
    data: MachineData
    family: MechanicalChoice
    loss: Loss | None = Field(None, description=(
        'how; default: forward where the data hold accelerations, else trajectory'))
    hidden: list[Annotated[int, Field(ge=1, le=4096)]] = Field(
        [32, 32], min_length=1, max_length=16, description=(
            'widths of the hidden layers, of each network'))
    seed: int = Field(0, ge=0, lt=2**63, description='of the initial weights and the batches')
    learning_rate: float = Field(0.01, gt=0.0, le=1.0, description=(
        'of Adam on accelerations; a fifth of it on windows'))

    @model_validator(mode='after')
    def _check(self) -> 'MachineConfig':
        self.structure()
        return self

    @property
    def windows(self) -> Trajectory:
        """Return the windows that a rigid body is fitted by, whatever networks are."""
        return self.loss if isinstance(self.loss, Trajectory) else Trajectory(kind='trajectory')

    def loss_of(self, measured: bool) -> Forward | Inverse | Discrete | Trajectory:
        """Return the loss, for data whose accelerations were measured or not."""
        if self.loss is not None:
            return self.loss
        return Forward(kind='forward') if measured and self.family.prior is None else \
            Trajectory(kind='trajectory')

    def structure(self) -> Structure:
        """Return what the networks see; ValueError for what names no coordinate."""
        family, names = self.family, [coordinate.name for coordinate in self.coordinates]
        seen = names if family.mass_depends_on is None else family.mass_depends_on
        if family.mass == 'constant':
            if family.mass_depends_on:
                raise ValueError('mass_depends_on: a constant mass depends on nothing; leave it '
                                 'out')
            seen = []
        friction = family.friction
        rubbing = seen if friction.network_depends_on is None else friction.network_depends_on
        if not friction.network and friction.network_depends_on is not None:
            raise ValueError('friction.network_depends_on: there is no network; take network: '
                             'true, or leave it out')
        features = [combination(text, names, 'features') for text in family.features or names]
        self._check_map()
        self._check_prior(features)
        kinds = [coordinate.kind for coordinate in self.coordinates]
        mass_features = [combination(text, names, 'mass_depends_on') for text in seen]
        friction_features = [
            combination(text, names, 'friction.network_depends_on') for text in rubbing
        ] if friction.network else None
        for row in (*features, *mass_features, *(friction_features or ())):
            check_row(kinds, row)
        return Structure(
            kinds, features, mass_features, family.mass == 'diagonal', friction.viscous,
            friction.coulomb, friction.stribeck, family.prior, family.residual, friction_features)

    def _check_map(self) -> None:
        if self.family.input_map == 'identity':
            return
        prior = self.family.prior
        if prior is not None and prior not in CHAINS:
            raise ValueError(f'input_map: {prior} has its own scale of energy, which the norm of '
                             'the map would fix again; take input_map: identity')
        if isinstance(self.loss, Inverse):
            raise ValueError('input_map: the loss inverse would make the forces on a joint small '
                             'by a small input map; take forward, discrete or trajectory')

    def _check_prior(self, features: list[list[float]]) -> None:
        family = self.family
        if family.prior is None:
            if not family.residual:
                raise ValueError('residual: without a prior there is nothing but the networks')
            return
        if family.prior not in CHAINS and family.prior not in exact_systems():
            raise ValueError(f'prior: {family.prior!r} is no system of the form p . M(q)^-1 p / 2 '
                             f'+ V(q); valid: {", ".join(sorted({*CHAINS, *exact_systems()}))}')
        check_prior(family.prior, [coordinate.kind for coordinate in self.coordinates], features)
        if not isinstance(self.loss, Trajectory | None):
            raise ValueError(f'loss: {self.loss.kind} fits no prior; take trajectory')
        if family.friction.network and not family.residual:
            raise ValueError('friction.network: residual: false leaves out all networks; leave '
                             'out one of the two')


def combination(text: str, names: list[str], key: str) -> list[float]:
    """Return the coefficients of a linear combination such as ``a - 2 * b``, or ValueError."""
    row, at = [0.0] * len(names), 0
    while at < len(text):
        term = _TERM.match(text, at)
        if term is None or (at > 0 and not term[1]) or term[3] not in names:
            raise ValueError(f'{key}: {text!r} is no linear combination of the coordinates '
                             f'{", ".join(names)}, such as {" + ".join(names[:2])}')
        row[names.index(term[3])] += float(f'{term[1]}{term[2] or 1.0}')
        at = term.end()
    return row


def load_machine(path: Path) -> MachineConfig:
    """Read and validate a configuration; a DataError names file, line and key."""
    return load_yaml(path, MachineConfig, DataError)
