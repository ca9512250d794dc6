# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The schema of a training configuration of a machine: of the family mechanical."""

from collections.abc import Sequence
import os
from pathlib import Path
import re
from typing import Annotated, Any, ClassVar, Literal

from hnn_vi_ros.errors import DataError, listed, ModelError
from hnn_vi_ros.files.package_uri import package_file, SCHEME
from hnn_vi_ros.files.yaml_file import load_yaml, StrictModel
from hnn_vi_ros.hamiltonians.rigid_body.tree import MOST_JOINTS
from hnn_vi_ros.hamiltonians.rigid_body_tree import RigidBodyTree
from hnn_vi_ros.learning.excitation import ExcitationData
from hnn_vi_ros.learning.families.structure import Structure
from hnn_vi_ros.learning.motion_arrays import ArraysData
from hnn_vi_ros.learning.motion_bags import BagMotions
from hnn_vi_ros.learning.motion_logs import LogMotions
from hnn_vi_ros.learning.window_steps import MethodName
from hnn_vi_ros.models.exact_prior import exact_systems
from hnn_vi_ros.models.mechanical_card import check_prior, check_row, Kind
from hnn_vi_ros.models.model_card import CoordinateCard
from hnn_vi_ros.models.planar_chain import CHAINS
from hnn_vi_ros.models.rigid_body_card import RIGID_BODY, tree_card, values_of
import numpy as np
from pydantic import Field, field_validator, model_validator, ValidationError

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


class MachineExcitation(ExcitationData, _TestRuns):
    """Computed motions of a rigid_body."""


MachineData = Annotated[MachineArrays | MachineBags | MachineLog | MachineExcitation,
                        Field(discriminator='kind')]


class FrictionChoice(StrictModel):
    """Friction of a machine; all that is named adds up."""

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


class RigidBodyChoice(StrictModel):
    """A robot that a URDF describes, whose inertias and friction are identified."""

    kind: Literal['rigid_body']
    file: str = Field(description=(
        'the URDF: a path, from the folder of the configuration or else the working directory, or '
        'package://PACKAGE/PATH'))
    locked: dict[str, float] = Field({}, description=(
        'joints that do not move, and where they are held [rad], [m]'))
    gravity: list[float] = Field([0.0, 0.0, -9.81], min_length=3, max_length=3, description=(
        'the acceleration of free fall in the frame of the base [m/s^2]'))
    base: str | None = Field(None, description='the link that rests; default: the root')
    rotor_inertia: dict[str, float] | Literal['identified'] = Field({}, description=(
        'of the rotors behind joints, as they feel it [kg m2], [kg]; or it is identified'))
    offsets: bool = Field(True, description='whether the motors are off by a constant force')
    friction: FrictionChoice = Field(
        default_factory=lambda: FrictionChoice(coulomb=1), description='in the joints')
    residual: list[Literal['potential', 'friction', 'mass']] = Field([], description=(
        'what networks add to it: V(q), the friction -D(q) v, M(q); one, or a list'))
    residual_weight: float = Field(1e-3, ge=0.0, description=(
        'of the size of those networks, at random states, in the loss'))
    # It is a prior of the family mechanical, whose joints have a force each.
    prior: ClassVar[str] = RIGID_BODY
    input_map: ClassVar[str] = 'identity'

    @field_validator('residual', mode='before')
    @classmethod
    def _listed(cls, value: Any) -> Any:
        return [value] if isinstance(value, str) else value

    @model_validator(mode='after')
    def _check(self) -> 'RigidBodyChoice':
        if self.friction.network or self.friction.network_depends_on is not None:
            raise ValueError('friction.network: take residual: friction, a network beside the '
                             'friction of joints')
        return self

    def robot(self, joints: Sequence[str]) -> RigidBodyTree:
        """Return the robot of the file, of these joints, or of all that move; or raise."""
        rotors = {} if isinstance(self.rotor_inertia, str) else self.rotor_inertia
        return RigidBodyTree(self.file, [*joints] or None, self.locked, self.gravity, self.base,
                             rotors)

    def structure(self, names: Sequence[str], kinds: list[Kind]) -> Structure:
        """Return what is identified, and what networks see: each coordinate."""
        robot, rows = self.robot(names), np.eye(len(names)).tolist()
        tree = tree_card(robot.bodies, dict(enumerate(robot.joints)), robot.robot.name[:200])
        left_out = tuple(name for name in ('mass', 'potential') if name not in self.residual)
        return Structure(
            kinds, rows, rows, False, self.friction.viscous, self.friction.coulomb,
            self.friction.stribeck, self.prior, bool(self.residual),
            rows if 'friction' in self.residual else None, tree, values_of(tree, robot.bodies),
            left_out)


class Stage(StrictModel):
    """Some steps of Adam on windows of one length."""

    duration: float = Field(gt=0.0, description='of each window [s]')
    steps: int = Field(ge=1, le=1_000_000)
    learning_rate: float | None = Field(None, gt=0.0, le=1.0, description=(
        'of Adam; default: a fifth of that on accelerations'))


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
    forward_lbfgs_steps: int = Field(2000, ge=0, le=1_000_000, description=(
        'of L-BFGS on accelerations, which follow; they end sooner when they make a tenth of the '
        'samples worse that is left out of them, as noise lets them'))
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
    coordinates: list[MachineCoordinate] = Field([], max_length=MOST_JOINTS, description=(
        'at least one; of a rigid_body joints of its URDF, and all that move if none is named'))
    data: MachineData
    family: Annotated[MechanicalChoice | RigidBodyChoice, Field(discriminator='kind')]
    loss: Loss | None = Field(None, description=(
        'how; default: forward where the data hold accelerations, else trajectory'))
    hidden: list[Annotated[int, Field(ge=1, le=4096)]] = Field(
        [32, 32], min_length=1, max_length=16, description=(
            'widths of the hidden layers, of each network'))
    seed: int = Field(0, ge=0, lt=2**63, description='of the initial weights and the batches')
    learning_rate: float = Field(0.01, gt=0.0, le=1.0, description=(
        'of Adam on accelerations; a fifth of it on windows that name none'))

    @model_validator(mode='after')
    def _check(self) -> 'MachineConfig':
        if isinstance(self.family, RigidBodyChoice):
            if not isinstance(self.loss, Trajectory | Inverse | None):
                raise ValueError(f'loss: {self.loss.kind} fits no rigid_body; take inverse or '
                                 'trajectory')
            return self
        if isinstance(self.data, MachineExcitation):
            raise ValueError('data: excitation computes motions of a rigid_body; take arrays, bag '
                             'or log')
        if not self.coordinates:
            raise ValueError('coordinates: expected at least one')
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
        kinds = [coordinate.kind for coordinate in self.coordinates]
        if isinstance(family, RigidBodyChoice):
            return family.structure(names, kinds)
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
        assert isinstance(family, MechanicalChoice), 'a rigid_body has a prior of its own'
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
                             f'{listed(names)}, such as {" + ".join(names[:2])}')
        row[names.index(term[3])] += float(f'{term[1]}{term[2] or 1.0}')
        at = term.end()
    return row


def load_machine(path: Path) -> MachineConfig:
    """Read and validate a configuration; a DataError names file, line and key."""
    config = load_yaml(path, MachineConfig, DataError)
    return _with_robot(path, config, config.family) if isinstance(
        config.family, RigidBodyChoice) else config


def _with_robot(path: Path, config: MachineConfig, family: RigidBodyChoice) -> MachineConfig:
    """Return a configuration whose URDF was found, with the coordinates of its joints."""
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
