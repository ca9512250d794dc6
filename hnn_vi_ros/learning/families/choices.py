# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Configuration models shared by families: machines, losses, features of q."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import math
import re
from typing import Annotated, ClassVar, Literal

from hnn_vi_ros.errors import listed
from hnn_vi_ros.files import StrictModel
from hnn_vi_ros.hamiltonians import RigidBodyTree
from hnn_vi_ros.learning.families.base import keep
from hnn_vi_ros.models import (
    chain_angles, CHAINS, check_prior, check_row, exact_systems, is_periodic, Kind, PLANAR_CHAIN,
    RIGID_BODY, Scheme, tree_card, TreeCard, values_of)
import numpy as np
from pydantic import Field, field_validator, model_validator
import torch


@dataclass(frozen=True)
class MotionScales:
    """
    Scales of the data, each array of shape (d,) unless stated otherwise.

    Parameters
    ----------
    q_centre, q_half : np.ndarray
        Centre and half-range of the coordinates.
    v, a : np.ndarray
        Root mean square of velocities and accelerations.
    inertia : np.ndarray
        Forces divided by accelerations.
    command : np.ndarray, shape (m,)
        Usual size of the commands of each motor.
    input_map : np.ndarray, shape (d, m), or None
        Initial map from commands to joint forces, if the map is learned; None if each joint has
        its own motor.

    """

    q_centre: np.ndarray
    q_half: np.ndarray
    v: np.ndarray
    a: np.ndarray
    inertia: np.ndarray
    command: np.ndarray
    input_map: np.ndarray | None = None


class Features(torch.nn.Module):
    """
    Network inputs G q, or sin(G q) and cos(G q) for periodic rows; one zero input without rows.

    Each input depends on a single row of G: ``rows`` holds that row for each input, ``features``
    the distinct rows, and ``of_feature`` the mask of inputs that depend on each row.

    Parameters
    ----------
    kinds : sequence of str
        Kinds of the coordinates.
    features : sequence of sequence of float
        Rows of G.

    """

    def __init__(self, kinds: Sequence[Kind], features: Sequence[list[float]]):
        super().__init__()
        rows = np.array([*features] or [[0.0] * len(kinds)], dtype=np.float64)
        periodic = np.array([is_periodic(kinds, row) for row in rows])
        self._turn = bool(periodic.all())
        number = np.repeat(np.arange(len(rows)), 1 + periodic)
        # The cosine is a sine with phase pi / 2.
        phase = 0.5 * math.pi * (np.diff(number, prepend=-1) == 0)
        keep(self, rows=rows[number], phase=phase, periodic=periodic[number], features=rows,
             of_feature=(np.arange(len(rows))[:, None] == number).astype(np.float64))

    def units(self, scales: MotionScales) -> tuple[np.ndarray, np.ndarray]:
        """Return centre and scale of the inputs, shape (n,) each."""
        rows, periodic = self.rows.numpy(), self.periodic.numpy()
        centre = np.where(periodic, 0.0, rows @ scales.q_centre)
        half = np.where(periodic, 1.0, np.abs(rows) @ scales.q_half)
        return centre, np.where(half > 0.0, half, 1.0)

    def forward(self, q: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the inputs and their derivatives by their rows, (N, n), at q of (N, d)."""
        y = torch.addmm(self.phase, q, self.rows.T)
        if self._turn:
            return torch.sin(y), torch.cos(y)
        return (torch.where(self.periodic, torch.sin(y), y),
                torch.where(self.periodic, torch.cos(y), 1.0))


# Integrators of simulated windows of machines.
WindowMethod = Literal['implicit_midpoint', 'variational_euler', 'generalized_leapfrog', 'rk4']
ON_THE_CPU = {'device': 'is trained on the CPU, in minutes'}
# Prior that is selected with held-out motions.
AUTO = 'auto'
# Term of a linear combination: sign, number, name.
_TERM = re.compile(r'\s*([+-]?)\s*(?:(\d+\.?\d*(?:e[+-]?\d+)?)\s*\*\s*)?([^\W\d]\w*)\s*')


class FamilyChoice(StrictModel):
    """
    Configuration of a family of models.

    ``losses`` can train it; ``refuses`` maps train options that it does not support to the
    reasons.
    """

    kind: str
    losses: ClassVar[tuple[str, ...]] = ('vector_field', 'steps')
    refuses: ClassVar[Mapping[str, str]] = {}


class VectorField(StrictModel):
    """Loss of the rates of change, (H_p, -H_q) plus terms of the family; for dense data."""

    kind: Literal['vector_field'] = 'vector_field'
    # One-step map used in training, if any.
    scheme: ClassVar[None] = None


class EulerLagrange(StrictModel):
    """Loss of accelerations from the Euler-Lagrange equation, for the family lagrangian."""

    kind: Literal['euler_lagrange']
    scheme: ClassVar[None] = None


class Steps(StrictModel):
    """Loss of states computed by an integrator; the model fits only this method and step."""

    kind: Literal['steps']
    integrator: Literal['variational_euler', 'symplectic_euler', 'symplectic_euler_adjoint',
                        'generalized_leapfrog', 'implicit_midpoint']
    step_size: float = Field(gt=0.0, description='h [s]')
    count: int = Field(1, ge=1, le=100, description='how many steps')

    @property
    def scheme(self) -> Scheme:
        """Return the one-step map used in training."""
        return Scheme(integrator=self.integrator, step_size=self.step_size)


class DiscreteGradient(StrictModel):
    """Loss of the discrete gradient of H between states; for large even time steps or noise."""

    kind: Literal['discrete_gradient']
    step_size: float = Field(gt=0.0, description='h [s]')

    @property
    def scheme(self) -> Scheme:
        """Return the one-step map used in training."""
        return Scheme(integrator='discrete_gradient', step_size=self.step_size)


class DiscreteLagrangian(StrictModel):
    """Loss of the discrete Euler-Lagrange equation at three successive positions, without v."""

    kind: Literal['discrete_lagrangian']
    rule: Literal['trapezoid', 'midpoint'] = Field('trapezoid', description=(
        'for the action of the potential: that of stormer_verlet, or of implicit_midpoint'))
    step_size: float = Field(gt=0.0, description='h [s]')

    @property
    def scheme(self) -> Scheme:
        """Return the one-step map used in training."""
        method = 'stormer_verlet' if self.rule == 'trapezoid' else 'implicit_midpoint'
        return Scheme(integrator=method, step_size=self.step_size)


class FrictionChoice(StrictModel):
    """Friction of a machine; all enabled terms are added."""

    viscous: bool = Field(True, description='-b v')
    coulomb: int = Field(2, ge=0, le=8, description='how many terms -c tanh(v / w)')
    stribeck: int = Field(0, ge=0, le=8, description=(
        'how many terms -c tanh(v / w) exp(-(v / s)^2)'))
    directed: bool = Field(False, description=(
        'whether b and the c of Coulomb terms depend on the sign of v'))
    offset: bool = Field(False, description='whether the motors add a constant force')
    fade: bool = Field(False, description=(
        'whether the gain of a motor falls with its command u: u / (1 + g abs(u)), g >= 0'))
    load: bool = Field(False, description=(
        'whether dry friction grows with the force f of the motor of a joint, as in a gear: '
        '-k abs(f) tanh(v / s), k >= 0'))
    network: bool = Field(False, description=(
        '-D(q) v with a network D = B B^T, which couples the joints and depends on where they '
        'are'))
    network_depends_on: list[str] | None = Field(None, description=(
        'the inputs of D: linear combinations of coordinates; default: the inputs of M'))


@dataclass(frozen=True)
class Structure:
    """
    Structure of the networks: inputs and friction terms.

    Parameters
    ----------
    kinds : list of str
        Kind of each coordinate.
    features : list of list of float
        Rows of the linear combinations that are inputs of V.
    mass_features : list of list of float
        The same for M; empty for a constant M.
    diagonal_mass : bool
        True if M is diagonal.
    friction : FrictionChoice
        Friction in the joints.
    prior : str, optional
        Parametric system whose M and V are added to the networks.
    residual : bool
        True if there are networks in addition to the prior.
    friction_features : list of list of float, optional
        Inputs of the network D of friction -D(q) v, as rows; None for no network.
    tree : TreeCard, optional
        Bodies of a prior that is a robot.
    values : np.ndarray, shape (d, 12), optional
        Initial parameters of the bodies.
    left_out : tuple of str
        Disabled networks among ``mass`` and ``potential``.
    angles : list of list of float, optional
        Angles of a chain's links from the vertical; None selects the best fit.

    """

    kinds: list[Kind]
    features: list[list[float]]
    mass_features: list[list[float]]
    diagonal_mass: bool = False
    friction: FrictionChoice = field(default_factory=FrictionChoice)
    prior: str | None = None
    residual: bool = True
    friction_features: list[list[float]] | None = None
    tree: TreeCard | None = None
    values: np.ndarray | None = None
    left_out: tuple[str, ...] = ()
    angles: list[list[float]] | None = None


class MechanicalChoice(FamilyChoice):
    """Networks M(q) and V(q) with friction; for machines without a URDF, else see rigid_body."""

    kind: Literal['mechanical']
    losses: ClassVar[tuple[str, ...]] = ('trajectory', 'forward', 'inverse', 'discrete')
    refuses: ClassVar[Mapping[str, str]] = ON_THE_CPU
    features: list[str] | None = Field(None, min_length=1, description=(
        'the inputs of V: linear combinations of coordinates, such as a + b; default: each '
        'coordinate'))
    mass: Literal['learned', 'diagonal', 'constant'] = Field('learned', description=(
        'M(q), a diagonal one, or a matrix that depends on nothing'))
    mass_depends_on: list[str] | None = Field(None, description=(
        'the inputs of M, in the same way; default: each coordinate'))
    friction: FrictionChoice = Field(default_factory=FrictionChoice)
    input_map: Literal['identity', 'learned'] = Field('identity', description=(
        'each joint has a force of its own in the data; or the forces are of motors, at most as '
        'many as joints, and a constant matrix of their effect on the joints is learned'))
    prior: str | None = Field('auto', description=(
        'a system whose parameters are fitted, and that the networks are added to: planar_chain, '
        'one to four rigid links in a plane, on carts or not; pendulum or double_pendulum, the '
        'same with the features for angles; or another exact system, by its name in scenes, of '
        'the coordinates in their order; none: networks alone; auto: what predicts held-out '
        'motions best, a planar_chain with networks or without, or networks alone'))
    angles: list[str] | None = Field(None, description=(
        'of a planar_chain: the angles of its links from the vertical, linear combinations of the '
        'coordinates that turn; default: those that fit best, of the features, the coordinates '
        'and their sums'))
    residual: bool | list[Literal['potential', 'mass']] = Field(True, description=(
        'whether there are networks in addition to a prior, or which'))
    residual_weight: float = Field(1e-6, ge=0.0, description=(
        'of the size of the networks added to a prior, at states like those of the data, in the '
        'loss'))
    fade_weight: float = Field(2e-3, ge=0.0, description=(
        'the same at all other states, where networks fade, and of the forces that they make at '
        'twice the speeds of the data'))

    @field_validator('prior', mode='before')
    @classmethod
    def _named(cls, value: object) -> object:
        return None if value == 'none' else value

    def structure(self, names: Sequence[str], kinds: list[Kind]) -> Structure:
        """Return the structure of the networks; ValueError for an unknown coordinate name."""
        seen = names if self.mass_depends_on is None else self.mass_depends_on
        if self.mass == 'constant':
            if self.mass_depends_on:
                raise ValueError('mass_depends_on: a constant mass depends on nothing; leave it '
                                 'out')
            seen = []
        friction = self.friction
        if not friction.network and friction.network_depends_on is not None:
            raise ValueError('friction.network_depends_on: there is no network; take network: '
                             'true, or leave it out')

        def rows(texts: Sequence[str], key: str) -> list[list[float]]:
            found = [combination(text, names, key) for text in texts]
            for row in found:
                check_row(key, kinds, row)
            return found
        features = rows(self.features or names, 'features')
        angles = None if self.angles is None else self._angles(names, kinds, self.angles)
        if self.prior in CHAINS and self.prior != PLANAR_CHAIN:
            angles = features
        self._check_prior(kinds, angles)
        parts = 'mass', 'potential'
        mass_features = rows(seen, 'mass_depends_on')
        rubbing = seen if friction.network_depends_on is None else friction.network_depends_on
        return Structure(
            kinds, features, mass_features, self.mass == 'diagonal', friction,
            PLANAR_CHAIN if self.prior in CHAINS else None if self.prior == AUTO else self.prior,
            bool(self.residual),
            rows(rubbing, 'friction.network_depends_on') if friction.network else None,
            left_out=() if self.residual is True else tuple(
                name for name in parts if name not in (self.residual or parts)), angles=angles)

    def _angles(self, names: Sequence[str], kinds: list[Kind], texts: Sequence[str]
                ) -> list[list[float]]:
        """Return the angles of a chain's links, with zeros for its carts."""
        found = iter([combination(text, names, 'angles') for text in texts])
        turning = [kind != 'prismatic' for kind in kinds]
        if len(texts) != sum(turning):
            raise ValueError(f'angles: {len(texts)} for {sum(turning)} coordinates that turn; '
                             'name one for each')
        return [next(found) if turns else [0.0] * len(kinds) for turns in turning]

    def _check_prior(self, kinds: list[Kind], angles: list[list[float]] | None) -> None:
        if self.angles is not None and self.prior not in (AUTO, PLANAR_CHAIN):
            raise ValueError('angles: of a planar_chain, and of prior: auto, alone')
        if self.prior in (None, AUTO):
            if self.residual is not True:
                raise ValueError('residual: needs a prior, without which there is nothing but the '
                                 'networks; name it')
            return
        assert self.prior is not None, 'just looked'
        if self.prior not in CHAINS and self.prior not in exact_systems():
            valid = sorted({AUTO, 'none', *CHAINS, *exact_systems()})
            raise ValueError(f'prior: {self.prior!r} is no system of the form p . M(q)^-1 p / 2 '
                             f'+ V(q); valid: {", ".join(valid)}')
        check_prior(self.prior, kinds, angles or [*chain_angles(kinds), []][0])
        if self.prior not in CHAINS and self.input_map != 'identity':
            raise ValueError(f'input_map: {self.prior} has its own scale of energy, which the '
                             'norm of the map would fix again; take input_map: identity')
        if self.friction.network and not self.residual:
            raise ValueError('friction.network: residual: false leaves out all networks; leave '
                             'out one of the two')


class RigidBodyChoice(FamilyChoice):
    """A robot with a URDF, whose inertias and friction are identified; else see mechanical."""

    kind: Literal['rigid_body']
    losses: ClassVar[tuple[str, ...]] = ('trajectory', 'inverse')
    refuses: ClassVar[Mapping[str, str]] = ON_THE_CPU | {'ensemble': (
        'has the uncertainty of each parameter by its standard errors')}
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
    residual: list[Literal['potential', 'friction', 'mass']] | Literal['auto'] = Field(
        [], description=('networks that are added: V(q), the friction -D(q) v, M(q); one, or a '
                         'list; auto: those that predict held-out motions best, or none'))
    residual_weight: float = Field(1e-3, ge=0.0, description=(
        'of the size of those networks, at states like those of the data, in the loss'))
    fade_weight: float = Field(0.1, ge=0.0, description=(
        'the same at all other states, where networks fade'))
    # The prior in terms of the family mechanical; each joint has a force of its own.
    prior: ClassVar[str] = RIGID_BODY
    input_map: ClassVar[str] = 'identity'

    @field_validator('residual', mode='before')
    @classmethod
    def _listed(cls, value: object) -> object:
        return [value] if isinstance(value, str) and value != AUTO else value

    @model_validator(mode='after')
    def _check(self) -> 'RigidBodyChoice':
        if self.friction.network or self.friction.network_depends_on is not None:
            raise ValueError('friction.network: take residual: friction, a network in addition '
                             'to the friction of joints')
        if self.friction.offset or self.friction.fade:
            raise ValueError('friction: a rigid_body has offsets of its own, and no fade; take '
                             'offsets: true, or the family mechanical')
        return self

    def robot(self, joints: Sequence[str]) -> RigidBodyTree:
        """Return the robot with these joints, or all movable ones; raise if that fails."""
        rotors = {} if isinstance(self.rotor_inertia, str) else self.rotor_inertia
        return RigidBodyTree(self.file, [*joints] or None, self.locked, self.gravity, self.base,
                             rotors)

    def structure(self, names: Sequence[str], kinds: list[Kind]) -> Structure:
        """Return the structure of the robot and its networks; their inputs are the coordinates."""
        robot, rows = self.robot(names), np.eye(len(names)).tolist()
        residual = [] if self.residual == AUTO else self.residual
        tree = tree_card(robot.bodies, dict(enumerate(robot.joints)), robot.robot.name[:200])
        left_out = tuple(name for name in ('mass', 'potential') if name not in residual)
        return Structure(
            kinds, rows, rows, False, self.friction, self.prior, bool(residual),
            rows if 'friction' in residual else None, tree, values_of(tree, robot.bodies),
            left_out)


def combination(text: str, names: Sequence[str], key: str) -> list[float]:
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


class WindowStage(StrictModel):
    """A number of Adam steps on windows of one length."""

    duration: float = Field(gt=0.0, description='of each window [s]')
    steps: int = Field(ge=1, le=1_000_000)
    learning_rate: float | None = Field(None, gt=0.0, le=1.0, description=(
        'of Adam; default: a fifth of that on accelerations, two fifths beside a prior'))


class Regression(StrictModel):
    """A fit on single samples with Adam, then L-BFGS."""

    kind: str
    steps: int = Field(400, ge=1, le=1_000_000, description='of Adam')
    batch: int = Field(1024, ge=1, description='samples in each of those steps')
    lbfgs_steps: int = Field(2000, ge=0, le=1_000_000, description=(
        'of L-BFGS, which follow; they end sooner when they make the samples worse that are left '
        'out of them, a tenth'))


class Forward(Regression):
    """Loss of accelerations at single samples; best if they were measured or are exact."""

    kind: Literal['forward']


class Inverse(Regression):
    """Loss of the motor forces at single samples, computed from accelerations."""

    kind: Literal['inverse']


class Discrete(Regression):
    """Loss of the forced discrete Euler-Lagrange equations (midpoint rule) from positions."""

    kind: Literal['discrete']
    step_size: float | None = Field(None, gt=0.0, description=(
        'a multiple of the interval of the samples [s]; default: that at which noise and the '
        'rule have about the same error'))


class Trajectory(StrictModel):
    """Loss of accelerations, then of windows simulated from their smoothed first states."""

    kind: Literal['trajectory'] = 'trajectory'
    forward_steps: int = Field(400, ge=1, description='of Adam on accelerations')
    forward_batch: int = Field(1024, ge=1, description='samples in each of those steps')
    forward_lbfgs_steps: int = Field(2000, ge=0, le=1_000_000, description=(
        'of L-BFGS on accelerations, which follow; they end sooner when they make the samples '
        'worse that are left out of them, a tenth, as noise lets them'))
    step_size: float | None = Field(None, gt=0.0, description=(
        'of the windows, a multiple of the interval of the samples [s]; forces are averaged over '
        'it; default: the multiple that is next to 0.01 s'))
    windows: list[WindowStage] = Field(
        [WindowStage(duration=0.1, steps=600), WindowStage(duration=0.25, steps=400)],
        description='the stages that follow, in this order')
    method: WindowMethod = Field('implicit_midpoint', description=(
        'of their steps: that of the scene in which the model is to run, or rk4, which conserves '
        'nothing'))
    records: bool = Field(False, description=(
        'whether the positions of whole motions are fitted in the end, each simulated from its '
        'first state: by a prior with its friction, then by the networks, which end no worse'))
    batch: int = Field(256, ge=1, description='windows in each of their steps')
    time_scale: float = Field(0.1, gt=0.0, description=(
        'an error of q counts as one of v does that makes it in this time [s]'))


FieldLoss = Annotated[
    VectorField | Steps | DiscreteGradient | DiscreteLagrangian | EulerLagrange,
    Field(discriminator='kind')]
MachineFamily = Annotated[MechanicalChoice | RigidBodyChoice, Field(discriminator='kind')]
MachineLoss = Annotated[Forward | Inverse | Discrete | Trajectory, Field(discriminator='kind')]
