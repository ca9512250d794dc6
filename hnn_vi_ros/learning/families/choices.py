# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The schema of what a training configuration chooses: a model family, and a loss."""

from typing import Annotated, ClassVar, Literal

from hnn_vi_ros.files.yaml_file import StrictModel
from hnn_vi_ros.models.model_card import Scheme
from pydantic import Field


class HNNChoice(StrictModel):
    """One network H(q, p)."""

    kind: Literal['hnn']
    losses: ClassVar[tuple[str, ...]] = ('vector_field', 'steps')


class SeparableHNNChoice(StrictModel):
    """Networks T(p) and V(q), for explicit methods."""

    kind: Literal['separable_hnn']
    losses: ClassVar[tuple[str, ...]] = ('vector_field', 'steps')


class DissipativeHNNChoice(StrictModel):
    """Networks H(q, p) and D(q, p): q' = H_p + D_q, p' = -H_q + D_p."""

    kind: Literal['dissipative_hnn']
    losses: ClassVar[tuple[str, ...]] = ('vector_field', 'steps')


class DGNetChoice(StrictModel):
    """One network H(q, p), and linear friction."""

    kind: Literal['dgnet']
    friction: bool = Field(True, description='whether dp/dt = -H_q - gamma p, or gamma = 0')
    losses: ClassVar[tuple[str, ...]] = ('discrete_gradient', 'vector_field')


class VINChoice(StrictModel):
    """A constant mass matrix and a network V(q), learned from positions."""

    kind: Literal['vin']
    mass: float = Field(1.0, gt=0.0, description=(
        'of the first coordinate, which sets the unit of energy: positions leave it open'))
    losses: ClassVar[tuple[str, ...]] = ('discrete_lagrangian',)


class LagrangianChoice(StrictModel):
    """A Lagrangian L(q, v), a network beside a constant mass."""

    kind: Literal['lagrangian']
    mass: float = Field(1.0, gt=0.0, description=(
        'mean of that of the first coordinate, which sets the unit of energy: motions leave it '
        'open'))
    losses: ClassVar[tuple[str, ...]] = ('euler_lagrange',)


class ControlAffineChoice(StrictModel):
    """Networks for the mass matrix, the potential and the input map of commands."""

    kind: Literal['control_affine']
    losses: ClassVar[tuple[str, ...]] = ('vector_field',)


class SymplecticFormChoice(StrictModel):
    """A one-form theta(u) and an energy H(u) in any coordinates u, such as (q, dq/dt)."""

    kind: Literal['symplectic_form']
    mass: float = Field(1.0, gt=0.0, description=(
        'mean of that of the first coordinate, d theta_q / dp, which sets the unit of energy: '
        'motions leave it open'))
    losses: ClassVar[tuple[str, ...]] = ('vector_field',)


class VectorField(StrictModel):
    """The rates of change against (H_p, -H_q), and what a family adds to it."""

    kind: Literal['vector_field']

    @property
    def scheme(self) -> Scheme | None:
        """Return the one-step map that is trained through: none."""
        return None


class Steps(StrictModel):
    """States some steps on against those that a variational integrator gives."""

    kind: Literal['steps']
    integrator: Literal['variational_euler', 'symplectic_euler', 'symplectic_euler_adjoint',
                        'generalized_leapfrog', 'implicit_midpoint']
    step_size: float = Field(gt=0.0, description='h [s]')
    count: int = Field(1, ge=1, le=100, description='how many steps')

    @property
    def scheme(self) -> Scheme:
        """Return the one-step map that is trained through."""
        return Scheme(integrator=self.integrator, step_size=self.step_size)


class DiscreteGradient(StrictModel):
    """Differences of states against the discrete gradient of H between them."""

    kind: Literal['discrete_gradient']
    step_size: float = Field(gt=0.0, description='h [s]')

    @property
    def scheme(self) -> Scheme:
        """Return the one-step map that is trained through."""
        return Scheme(integrator='discrete_gradient', step_size=self.step_size)


class DiscreteLagrangian(StrictModel):
    """Three positions in a row against the discrete Euler-Lagrange equation."""

    kind: Literal['discrete_lagrangian']
    rule: Literal['trapezoid', 'midpoint'] = Field('trapezoid', description=(
        'for the action of the potential: that of stormer_verlet, or of implicit_midpoint'))
    step_size: float = Field(gt=0.0, description='h [s]')

    @property
    def scheme(self) -> Scheme:
        """Return the one-step map that is trained through."""
        methods = {'trapezoid': 'stormer_verlet', 'midpoint': 'implicit_midpoint'}
        return Scheme(integrator=methods[self.rule], step_size=self.step_size)


class EulerLagrange(StrictModel):
    """Accelerations against those of the Euler-Lagrange equation."""

    kind: Literal['euler_lagrange']

    @property
    def scheme(self) -> Scheme | None:
        """Return the one-step map that is trained through: none."""
        return None


FamilyChoice = Annotated[
    HNNChoice | SeparableHNNChoice | DissipativeHNNChoice | DGNetChoice | VINChoice
    | LagrangianChoice | ControlAffineChoice | SymplecticFormChoice,
    Field(discriminator='kind')]
LossChoice = Annotated[
    VectorField | Steps | DiscreteGradient | DiscreteLagrangian | EulerLagrange,
    Field(discriminator='kind')]
