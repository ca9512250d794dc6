# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Configuration models shared by families: machines, losses, features of q."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import math
import re
from typing import Annotated, Any, ClassVar, Literal

from hnn_vi_ros.errors import listed
from hnn_vi_ros.files import StrictModel
from hnn_vi_ros.hamiltonians import RigidBodyTree
from hnn_vi_ros.learning.families.base import keep
from hnn_vi_ros.models import (
    chain_angles, CHAINS, check_prior, check_row, exact_systems, FAMILIES, HIGHEST_POWER,
    is_periodic, Kind, PLANAR_CHAIN, RIGID_BODY, Scheme, tree_card, TreeCard, values_of)
import numpy as np
from pydantic import Field, field_validator
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


class FeaturesChoice(torch.nn.Module):
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
ON_THE_CPU = {'device': 'is trained on the CPU, within minutes'}
# Prior that is selected with held-out motions.
AUTO = 'auto'
# Term of a linear combination: sign, number, name.
_TERM = re.compile(r'\s*([+-]?)\s*(?:(\d+\.?\d*(?:e[+-]?\d+)?)\s*\*\s*)?([^\W\d]\w*)\s*')


class FamilyChoice(StrictModel):
    """
    Configuration of a family of models.

    ``losses`` can train it; ``refuses`` maps train options that it does not support to the
    reasons; ``driven`` families learn the effect of forces.
    """

    kind: str
    losses: ClassVar[tuple[str, ...]] = ('vector_field', 'steps')
    refuses: ClassVar[Mapping[str, str]] = {}
    driven: ClassVar[bool] = False

    def network(self, hidden: list[int], scales: Any, seed: int) -> Any:
        """Return a new network; see models.families.Family.trainer."""
        return FAMILIES[self.kind].trainer(self, hidden, scales, seed)


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
    step_size: float = Field(gt=0.0, description='step size h [s]')
    count: int = Field(1, ge=1, le=100, description='number of steps')

    @property
    def scheme(self) -> Scheme:
        """Return the one-step map used in training."""
        return Scheme(integrator=self.integrator, step_size=self.step_size)


class DiscreteGradientLoss(StrictModel):
    """Loss of the discrete gradient of H between states; for large even time steps or noise."""

    kind: Literal['discrete_gradient']
    step_size: float = Field(gt=0.0, description='step size h [s]')

    @property
    def scheme(self) -> Scheme:
        """Return the one-step map used in training."""
        return Scheme(integrator='discrete_gradient', step_size=self.step_size)


class DiscreteLagrangian(StrictModel):
    """Loss of the discrete Euler-Lagrange equation at three successive positions, without v."""

    kind: Literal['discrete_lagrangian']
    rule: Literal['trapezoid', 'midpoint'] = Field('trapezoid', description=(
        'quadrature of the action: trapezoid as in stormer_verlet, midpoint as in '
        'implicit_midpoint'))
    step_size: float = Field(gt=0.0, description='step size h [s]')

    @property
    def scheme(self) -> Scheme:
        """Return the one-step map used in training."""
        method = 'stormer_verlet' if self.rule == 'trapezoid' else 'implicit_midpoint'
        return Scheme(integrator=method, step_size=self.step_size)


class FrictionChoice(StrictModel):
    """Friction of a machine; all enabled terms are added."""

    viscous: bool = Field(True, description='include viscous friction -b v')
    coulomb: int = Field(2, ge=0, le=8, description='number of terms -c tanh(v / w)')
    stribeck: int = Field(0, ge=0, le=8, description=(
        'number of terms -c tanh(v / w) exp(-(v / s)^2)'))
    directed: bool = Field(False, description=(
        'let b and the c of Coulomb terms depend on the sign of v'))
    offset: bool = Field(False, description='include a constant force of each motor')
    fade: bool = Field(False, description=(
        'let the gain of a motor fall with its command u: u / (1 + g abs(u)), g >= 0'))
    load: bool = Field(False, description=(
        'include dry friction that grows with the motor force f of a joint, as in a gear: -k '
        'abs(f) tanh(v / s), k >= 0'))
    network: bool = Field(False, description=(
        'include -D(q) v with a network D = B B^T, which couples the joints and depends on q'))
    network_depends_on: list[str] | None = Field(None, description=(
        'inputs of D: linear combinations of coordinates; default: the inputs of M'))


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
    springs : int, optional
        Highest power of the springs of a chain, 0 without them.
    sensor_offsets : bool
        True if the sensors of a chain's joints have unknown offsets.
    spring_knots : tuple of float
        Coordinates at which the stiffness of a spring changes, for one coordinate.

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
    springs: int = 0
    sensor_offsets: bool = False
    spring_knots: tuple[float, ...] = ()


class MechanicalChoice(FamilyChoice):
    """Networks M(q) and V(q) with friction; for machines without a URDF, else see rigid_body."""

    kind: Literal['mechanical']
    losses: ClassVar[tuple[str, ...]] = ('trajectory', 'forward', 'inverse', 'discrete')
    refuses: ClassVar[Mapping[str, str]] = ON_THE_CPU
    features: list[str] | None = Field(None, min_length=1, description=(
        'inputs of V: linear combinations of coordinates, such as a + b; default: each '
        'coordinate'))
    mass: Literal['learned', 'diagonal', 'constant'] = Field('learned', description=(
        'mass matrix: full M(q), diagonal M(q), or constant'))
    mass_depends_on: list[str] | None = Field(None, description=(
        'inputs of M, likewise; default: each coordinate'))
    friction: FrictionChoice = Field(default_factory=FrictionChoice)
    input_map: Literal['identity', 'learned'] = Field('identity', description=(
        'identity: the data contain one force per joint; learned: the data contain the forces of '
        'at most as many motors as joints, and a constant matrix from motors to joints is '
        'learned'))
    prior: str | None = Field('auto', description=(
        'system with fitted parameters to which the networks are added: planar_chain, one to four '
        'rigid links in a plane, with or without carts; pendulum or double_pendulum, the same '
        'with the features as angles; or another exact system, by its name in scenes, with the '
        'coordinates in their order; none: only networks; auto: the best predictor of held-out '
        'motions among a planar_chain with and without networks, and networks alone'))
    angles: list[str] | None = Field(None, description=(
        'for a planar_chain: angles of its links from the vertical, as linear combinations of the '
        'rotating coordinates; default: the best fit among the features, the coordinates and '
        'their sums'))
    springs: bool | int = Field(False, ge=0, le=HIGHEST_POWER, description=(
        'for a planar_chain: springs at the joints and linear ones between them, with fitted '
        'stiffness and position of rest; true: linear, or the highest power of their force; '
        'prior: auto adds them if they predict held-out motions better, up to the fifth power '
        'for one coordinate with positions alone'))
    spring_knots: list[float] = Field([], max_length=100, description=(
        'for the springs of a planar_chain of one coordinate: coordinates at which the stiffness '
        'changes, between which the force is a straight line; prior: auto adds some if they '
        'predict held-out motions of positions better'))
    sensor_offsets: bool = Field(False, description=(
        'for a planar_chain: fit a constant offset of the sensor of each rotating coordinate; '
        'prior: auto adds them if they predict held-out motions of positions better'))
    residual: bool | list[Literal['potential', 'mass']] = Field(True, description=(
        'add networks to a prior: true, false, or a list of networks'))
    residual_weight: float = Field(1e-6, ge=0.0, description=(
        'weight in the loss of the size of the networks added to a prior, at states like those of '
        'the data'))
    fade_weight: float = Field(2e-3, ge=0.0, description=(
        'the same weight at all other states, where networks fade, and for their forces at twice '
        'the speeds of the data'))

    @field_validator('prior', mode='before')
    @classmethod
    def _named(cls, value: object) -> object:
        return None if value == 'none' else value

    def structure(self, names: Sequence[str], kinds: list[Kind]) -> Structure:
        """Return the structure of the networks; ValueError for an unknown coordinate name."""
        seen = names if self.mass_depends_on is None else self.mass_depends_on
        if self.mass == 'constant':
            if self.mass_depends_on:
                raise ValueError('mass_depends_on: a constant mass has no inputs; remove this key')
            seen = []
        friction = self.friction
        if not friction.network and friction.network_depends_on is not None:
            raise ValueError('friction.network_depends_on: there is no network; set network: '
                             'true, or remove this key')

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
                name for name in parts if name not in (self.residual or parts)), angles=angles,
            springs=int(self.springs), sensor_offsets=self.sensor_offsets,
            spring_knots=tuple(sorted({*self.spring_knots})))

    def _angles(self, names: Sequence[str], kinds: list[Kind], texts: Sequence[str]
                ) -> list[list[float]]:
        """Return the angles of a chain's links, with zeros for its carts."""
        found = iter([combination(text, names, 'angles') for text in texts])
        turning = [kind != 'prismatic' for kind in kinds]
        if len(texts) != sum(turning):
            raise ValueError(f'angles: {len(texts)} for {sum(turning)} rotating coordinates; give '
                             'one for each')
        return [next(found) if turns else [0.0] * len(kinds) for turns in turning]

    def _check_prior(self, kinds: list[Kind], angles: list[list[float]] | None) -> None:
        if self.angles is not None and self.prior not in (AUTO, PLANAR_CHAIN):
            raise ValueError('angles: valid only with prior: planar_chain or auto; remove it')
        if self.springs and self.prior not in (AUTO, *CHAINS):
            raise ValueError('springs: valid only with prior: planar_chain or auto; remove it')
        if self.spring_knots and not (self.springs and len(kinds) == 1):
            raise ValueError('spring_knots: valid only for one coordinate with springs; set '
                             'springs: true, or remove it')
        if self.prior in (None, AUTO):
            if self.residual is not True:
                raise ValueError('residual: valid only with a prior; set prior, or remove '
                                 'residual')
            return
        assert self.prior is not None, 'just looked'
        if self.prior not in CHAINS and self.prior not in exact_systems():
            valid = sorted({AUTO, 'none', *CHAINS, *exact_systems()})
            raise ValueError(f'prior: {self.prior!r} is not a system of the form p . M(q)^-1 p / '
                             f'2 + V(q); valid: {", ".join(valid)}')
        check_prior(self.prior, kinds, angles or [*chain_angles(kinds), []][0])
        if self.prior not in CHAINS and self.input_map != 'identity':
            raise ValueError(f'input_map: {self.prior} has its own energy scale, which a '
                             'learned input map would change; use input_map: identity')
        if self.friction.network and not self.residual:
            raise ValueError('friction.network: residual: false disables all networks; remove one '
                             'of the two')


class RigidBodyChoice(FamilyChoice):
    """A robot with a URDF, whose inertias and friction are identified; else see mechanical."""

    kind: Literal['rigid_body']
    losses: ClassVar[tuple[str, ...]] = ('trajectory', 'inverse')
    refuses: ClassVar[Mapping[str, str]] = ON_THE_CPU | {'ensemble': (
        'reports the uncertainty of its parameters as standard errors')}
    file: str = Field(description=(
        'URDF file: a path relative to the folder of the configuration or the working directory, '
        'or package://PACKAGE/PATH'))
    locked: dict[str, float] = Field({}, description=(
        'locked joints and their positions [rad], [m]'))
    gravity: list[float] = Field([0.0, 0.0, -9.81], min_length=3, max_length=3, description=(
        'gravitational acceleration in the frame of the base [m/s^2]'))
    base: str | None = Field(None, description='fixed link; default: the root')
    rotor_inertia: dict[str, float] | Literal['identified'] = Field({}, description=(
        'inertia of the rotors, reflected to the joints [kg m2], [kg]; or identified from the '
        'data'))
    offsets: bool = Field(True, description='identify a constant force offset of each motor')
    friction: FrictionChoice = Field(
        default_factory=lambda: FrictionChoice(coulomb=1), description='friction in the joints')
    residual: list[Literal['potential', 'friction', 'mass']] | Literal['auto'] = Field(
        [], description=('networks added to the rigid body: V(q), friction -D(q) v, M(q); one, or '
                         'a list; auto: those that predict held-out motions best, or none'))
    residual_weight: float = Field(1e-3, ge=0.0, description=(
        'weight in the loss of the size of those networks, at states like those of the data'))
    fade_weight: float = Field(0.1, ge=0.0, description=(
        'the same weight at all other states, where networks fade'))
    # The prior in terms of the family mechanical; each joint has a force of its own.
    prior: ClassVar[str] = RIGID_BODY
    input_map: ClassVar[str] = 'identity'

    @field_validator('residual', mode='before')
    @classmethod
    def _listed(cls, value: object) -> object:
        return [value] if isinstance(value, str) and value != AUTO else value

    def _check(self) -> None:
        if self.friction.network or self.friction.network_depends_on is not None:
            raise ValueError('friction.network: use residual: friction, which adds a network to '
                             'the friction of joints')
        if self.friction.offset or self.friction.fade:
            raise ValueError('friction: a rigid_body has its own offsets, and no fade; use '
                             'offsets: true, or the family mechanical')

    def robot(self, joints: Sequence[str]) -> RigidBodyTree:
        """Return the robot with these joints, or all movable ones; raise if that fails."""
        rotors = {} if isinstance(self.rotor_inertia, str) else self.rotor_inertia
        robot = RigidBodyTree(self.file, [*joints] or None, self.locked, self.gravity, self.base,
                              rotors)
        if robot.following is not None:
            names = robot.robot.followers
            raise ValueError(f'joints that mimic others are not supported by {RIGID_BODY}: '
                             f'{listed(names)}; lock them, for example with locked: '
                             f'{{{next(iter(names))}: 0.0}}, or fit a scene with hnn identify')
        return robot

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
            raise ValueError(f'{key}: {text!r} is not a linear combination of the coordinates '
                             f'{listed(names)}, such as {" + ".join(names[:2])}')
        row[names.index(term[3])] += float(f'{term[1]}{term[2] or 1.0}')
        at = term.end()
    return row


class WindowStage(StrictModel):
    """A number of Adam steps on windows of one length."""

    duration: float = Field(gt=0.0, description='duration of each window [s]')
    steps: int = Field(ge=1, le=1_000_000)
    learning_rate: float | None = Field(None, gt=0.0, le=1.0, description=(
        'learning rate of Adam; default: a fifth of the rate for accelerations, or two fifths '
        'with a prior'))


class Regression(StrictModel):
    """A fit on single samples with Adam, then L-BFGS."""

    kind: str
    steps: int = Field(400, ge=1, le=1_000_000, description='number of Adam steps')
    batch: int = Field(1024, ge=1, description='samples per Adam step')
    lbfgs_steps: int = Field(2000, ge=0, le=1_000_000, description=(
        'maximum number of L-BFGS steps that follow; they stop early when the error of a held-out '
        'tenth of the samples increases'))


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
        'step size [s], a multiple of the sampling interval; default: that at which the errors of '
        'noise and quadrature are about equal'))


class TrajectoryLoss(StrictModel):
    """Loss of accelerations, then of windows simulated from their smoothed first states."""

    kind: Literal['trajectory'] = 'trajectory'
    forward_steps: int = Field(400, ge=1, description='number of Adam steps on accelerations')
    forward_lbfgs_steps: int = Field(2000, ge=0, le=1_000_000, description=(
        'maximum number of L-BFGS steps on accelerations that follow; they stop early when the '
        'error of a held-out tenth of the samples increases, as it does with noise'))
    step_size: float | None = Field(None, gt=0.0, description=(
        'step size in the windows [s], a multiple of the sampling interval over which forces are '
        'averaged; default: the multiple closest to 0.01 s'))
    windows: list[WindowStage] = Field(
        [WindowStage(duration=0.1, steps=600), WindowStage(duration=0.25, steps=400)],
        description='stages of training on windows, in this order')
    method: WindowMethod = Field('implicit_midpoint', description=(
        'integrator in the windows: that of the scene in which the model will run, or rk4, which '
        'is not symplectic'))
    records: bool = Field(False, description=(
        'finally fit the positions of whole motions, each simulated from its first state: first '
        'the prior with its friction, then the networks, whose result is used only if it is not '
        'worse'))
    batch: int = Field(256, ge=1, description='windows per Adam step')


FieldLoss = Annotated[
    VectorField | Steps | DiscreteGradientLoss | DiscreteLagrangian | EulerLagrange,
    Field(discriminator='kind')]
MachineFamily = Annotated[MechanicalChoice | RigidBodyChoice, Field(discriminator='kind')]
MachineLoss = Annotated[Forward | Inverse | Discrete | TrajectoryLoss, Field(discriminator='kind')]
