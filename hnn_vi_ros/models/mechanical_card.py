# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Card of a model of the family mechanical, without its networks."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal

from hnn_vi_ros.errors import listed
from hnn_vi_ros.files import StrictModel
from hnn_vi_ros.hamiltonians import Bodies, HAMILTONIANS
from hnn_vi_ros.models.box_error import Interval
from hnn_vi_ros.models.exact_prior import create
from hnn_vi_ros.models.families import NetworkShape
from hnn_vi_ros.models.planar_chain import (
    CHAINS, has_offsets, is_chain, knots_of, parameter_names, PLANAR_CHAIN, power_of_springs,
    symmetric)
from hnn_vi_ros.models.rigid_body_card import (
    bodies_of, check_values, EACH, Identification, RIGID_BODY, TreeCard)
import numpy as np
from pydantic import Field

NotNegative = Annotated[float, Field(ge=0.0)]
Positive = Annotated[float, Field(gt=0.0)]
Kind = Literal['revolute', 'continuous', 'prismatic']
# Maximum number of members of an ensemble.
MOST_MEMBERS = 64
# Fields that are equal in all members of an ensemble.
_SHARED = ('kinds', 'features', 'mass_features', 'diagonal_mass', 'friction_features', 'delay',
           'inputs')


class CoulombTerm(StrictModel):
    """Friction -c tanh(v / w) at each coordinate."""

    force: list[NotNegative] = Field(description='c, in the unit of the generalised force')
    width: list[Positive] = Field(description='w, in the unit of the velocity')
    back: list[NotNegative] | None = Field(None, description='c where v < 0; null: the same')


class StribeckTerm(StrictModel):
    """Friction -c tanh(v / w) exp(-(v / s)^2) at each coordinate: the breakaway part."""

    force: list[NotNegative] = Field(description='c, in the unit of the generalised force')
    width: list[Positive] = Field(description='w, in the unit of the velocity')
    speed: list[Positive] = Field(description='s, in the unit of the velocity')


class FrictionCard(StrictModel):
    """
    Friction at each coordinate, whose power is never positive, and the offset of a motor.

    If b and c of Coulomb terms depend on the sign of v, the transition is
    c_- + (c_+ - c_-) (1 + tanh(v / s)) / 2.
    """

    viscous: list[NotNegative] = Field(description='b of the friction -b v')
    viscous_back: list[NotNegative] | None = Field(None, description=(
        'b where v < 0; null: the same'))
    switch: list[Positive] | None = Field(None, description=(
        's, the speed of the transition between directions, and of full friction under load; '
        'null if there is neither'))
    offset: list[float] | None = Field(None, description=(
        'a constant force, in the unit of the generalised force'))
    load: list[NotNegative] | None = Field(None, description=(
        'k of the friction -k abs(a) tanh(v / s) under the motor force a; null: 0'))
    # The mean of an ensemble has the terms of all members.
    coulomb: list[CoulombTerm] = Field([], max_length=8 * MOST_MEMBERS)
    stribeck: list[StribeckTerm] = Field([], max_length=8 * MOST_MEMBERS)

    def _check(self) -> None:
        own = {name: getattr(self, name) for name in ('viscous_back', 'switch', 'offset', 'load')}
        for part in (own, *(dict(term) for term in (*self.coulomb, *self.stribeck))):
            for name, values in part.items():
                if values is not None and len(values) != len(self.viscous):
                    raise ValueError(f'friction: {name} has {len(values)} entries, expected '
                                     f'{len(self.viscous)}, one for each coordinate')
        if self.switch is None and any(back is not None for back in (
                self.load, self.viscous_back, *(term.back for term in self.coulomb))):
            raise ValueError('friction: values for v < 0, and load, need switch')


class Quantity(StrictModel):
    """A number and its unit."""

    value: float
    unit: str


class FittedNumber(Quantity):
    """A fitted number with its 95 % confidence interval, if the data determine it."""

    interval: Interval | None
    correlated: list[str] = Field([], description=(
        'numbers whose errors have a correlation above 0.99 with its own'))


class PriorCard(StrictModel):
    """A parametric system to whose M and V the networks are added."""

    kind: str = Field(description=(
        'planar chain of rigid links, rigid_body with its tree, or exact system in these '
        'coordinates'))
    parameters: dict[str, Quantity] = Field(description='fitted values')
    angles: list[list[float]] | None = Field(None, description=(
        'angles of the links of a planar_chain from the vertical, as rows of combinations of the '
        'coordinates; zeros for a cart'))
    tree: TreeCard | None = Field(None, description='tree of a rigid_body')
    alone: bool = Field(False, description='whether it is all of M and V, without networks')
    identification: Identification | None = Field(None, description='fit of a rigid_body')
    estimates: dict[str, FittedNumber] = Field({}, description=(
        'parameters, friction and motors of links fitted to positions; friction that is not among '
        'them is not in the data'))

    def _check(self) -> None:
        if (self.kind == RIGID_BODY) != (self.tree is not None):
            raise ValueError(f'prior: give tree for {RIGID_BODY} only')
        if (self.kind == PLANAR_CHAIN) != (self.angles is not None):
            raise ValueError(f'prior: give angles for {PLANAR_CHAIN} only')
        if self.tree is None:
            if self.identification is not None:
                raise ValueError(f'prior: give identification for {RIGID_BODY} only')
            return
        if self.parameters.keys() != self.tree.units.keys():
            raise ValueError('prior: parameters must be those of the bodies of its tree')
        check_values(self.tree, self.table)

    @property
    def values(self) -> dict[str, float]:
        """Return the parameters without their units."""
        return {name: quantity.value for name, quantity in self.parameters.items()}

    @property
    def table(self) -> np.ndarray:
        """Return the parameters of each body of a rigid_body, shape (d, 12)."""
        assert self.tree is not None, 'a rigid_body has one'
        return np.reshape([self.values[name] for name in self.tree.units], (-1, EACH))

    @property
    def bodies(self) -> Bodies:
        """Return the bodies of a rigid_body."""
        assert self.tree is not None, 'a rigid_body has one'
        return bodies_of(self.tree, self.table)


def is_periodic(kinds: Sequence[Kind], row: Sequence[float]) -> bool:
    """Return True if a network uses sine and cosine of a combination of coordinates."""
    return any(x and kind == 'continuous' for x, kind in zip(row, kinds, strict=True))


def check_row(key: str, kinds: Sequence[Kind], row: Sequence[float]) -> None:
    """Raise ValueError for a combination of coordinates that cannot be a feature."""
    if not any(row):
        raise ValueError(f'{key}: a row of zeros has no effect; remove it')
    turning = [x for x, kind in zip(row, kinds, strict=True) if kind == 'continuous' and x]
    if turning and (len(turning) < sum(x != 0.0 for x in row)
                    or any(x != round(x) for x in turning)):
        raise ValueError(f'{key}: {row} has no period of 2 pi, because it combines a continuous '
                         'coordinate with others, or uses a fraction of it; use whole multiples '
                         'of continuous coordinates')


def check_prior(kind: str, kinds: Sequence[Kind], angles: Sequence[Sequence[float]]) -> None:
    """Raise ValueError for a prior that does not exist or does not match these coordinates."""
    d = len(kinds)
    if kind in CHAINS:
        if not is_chain(kind, angles, kinds):
            least, most = CHAINS[kind]
            count = f'{least}' if least == most else f'{least} to {most}'
            raise ValueError(
                f'prior: a {kind} has {count} coordinates, prismatic ones first; features, or '
                'angles, must be the angles of its links from the vertical: [a, a + b] for an '
                'angle b from the first link, [a, b] for two angles from the vertical')
        return
    if kind not in HAMILTONIANS:
        raise ValueError(f'prior: no exact system {kind!r}; valid: {", ".join(HAMILTONIANS)}')
    dimension = HAMILTONIANS[kind]().dimension
    if dimension != d:
        raise ValueError(f'prior: {kind} has {dimension} coordinates, not {d}')


_FEATURES = 'features', 'mass_features', 'friction_features'


class MechanicalCard(StrictModel):
    """Features of the coordinates that are inputs of the networks of M, V and friction."""

    kinds: list[Kind] = Field(description='kind of each coordinate')
    features: list[list[float]] = Field(min_length=1, description=(
        'inputs of V: the rows of a matrix, each a linear combination of the coordinates'))
    mass_features: list[list[float]] = Field(description=(
        'inputs of M, in the same form; none for a constant M'))
    diagonal_mass: bool = Field(False, description='whether M is diagonal')
    mass_scale: list[Positive] = Field(description=(
        'S of M = S (L L^T + floor) S, the square roots of typical inertias'))
    floor: float = Field(ge=0.0, description=(
        'smallest eigenvalue of S^-1 M S^-1; 0 with a prior, whose M is positive definite'))
    friction: FrictionCard
    friction_features: list[list[float]] | None = Field(None, description=(
        'inputs of the network D of friction -D(q) v, in the same form; none for a constant D, '
        'null for no such network'))
    prior: PriorCard | None = None
    input_map: list[list[float]] | None = Field(None, description=(
        'forces of the motors on the coordinates, one row each, for commands of 1; null: each '
        'coordinate has its own motor'))
    fade: list[NotNegative] | None = Field(None, description=(
        'g of each motor, whose force for a command u is that of u / (1 + g abs(u)); null: 0'))
    delay: float = Field(0.0, description=(
        'delay of the commands relative to the data, to be applied to similar data [s]'))
    inputs: Literal['held', 'linear', 'spline'] | None = Field(None, description=(
        'course of the commands between samples, as selected for the data; null: the default'))
    step_size: Positive | None = Field(None, description=(
        'step size with which sharp friction was fitted [s]; null: that of the data'))

    def _check(self) -> None:
        d = len(self.kinds)
        lengths = {'mass_scale': len(self.mass_scale), 'friction': len(self.friction.viscous)}
        for name in _FEATURES:
            lengths |= {f'{name}[{k}]': len(row)
                        for k, row in enumerate(getattr(self, name) or ())}
        for name, length in lengths.items():
            if length != d:
                raise ValueError(f'{name} has {length} entries, expected {d}, one for each '
                                 'coordinate')
        for name in _FEATURES:
            for row in getattr(self, name) or ():
                check_row(name, self.kinds, row)
        self._check_prior(self.prior)
        if self.input_map is not None:
            columns = {len(row) for row in self.input_map}
            if len(self.input_map) != d or len(columns) > 1 or not 1 <= max(columns) <= d:
                raise ValueError(f'input_map must have {d} rows, one for each coordinate, and '
                                 f'1 to {d} columns, one for each motor')
        if self.fade is not None and len(self.fade) != len((self.input_map or [[]])[0]):
            raise ValueError('fade must have an entry for each motor of an input_map')

    def _check_prior(self, prior: PriorCard | None) -> None:
        if prior is None:
            if not self.floor:
                raise ValueError('floor must be positive without a prior')
            return
        if prior.tree is not None:
            if len(prior.tree.bodies) != len(self.kinds):
                raise ValueError(f'prior: {len(prior.tree.bodies)} bodies, expected '
                                 f'{len(self.kinds)}, one for each coordinate')
            return
        check_prior(prior.kind, self.kinds, self.angles)
        if prior.kind not in CHAINS:
            create(prior.kind, prior.values)
            return
        names = parameter_names(self.angles, power_of_springs(prior.parameters),
                                has_offsets(prior.parameters), knots_of(prior.parameters))
        if sorted(prior.parameters) != sorted(names):
            raise ValueError(f'prior: parameters {listed(prior.parameters)}, expected '
                             f'{", ".join(names)}')
        motors = [value for name, value in prior.values.items() if name.startswith('motor')]
        if min(motors, default=0.0) < 0.0 or not (
                np.linalg.eigvalsh(symmetric(len(self.kinds), prior.values))[0] > 0.0):
            raise ValueError('prior: its mass matrix is not positive definite')

    @property
    def angles(self) -> list[list[float]]:
        """Return the angles of rigid links from the vertical."""
        return self.features if self.prior is None or self.prior.angles is None else \
            self.prior.angles

    @property
    def networks(self) -> dict[str, NetworkShape]:
        """Return inputs and outputs of each network."""
        mass = NetworkShape(self.input_count(self.mass_features), lambda d, _: len(self.entries))
        found = {'mass': mass, 'potential': NetworkShape(self.input_count(self.features))}
        if self.friction_features is not None:
            k = len(self.kinds)
            found['friction'] = NetworkShape(
                self.input_count(self.friction_features), lambda d, _: k * (k + 1) // 2)
        return found

    def input_count(self, features: list[list[float]]) -> int:
        """Return the number of inputs for these features; without features it is one, 0."""
        return max(1, sum(2 if is_periodic(self.kinds, row) else 1 for row in features))

    @property
    def entries(self) -> list[tuple[int, int]]:
        """Return the places in L of the outputs of the network of M."""
        return entries_of(len(self.kinds), self.diagonal_mass)


def entries_of(d: int, diagonal: bool) -> list[tuple[int, int]]:
    """Return the places of the entries of a lower triangular or a diagonal matrix, row by row."""
    return [(i, j) for i in range(d) for j in range(i + 1) if i == j or not diagonal]


def check_alike(one: MechanicalCard, other: MechanicalCard) -> None:
    """Raise ValueError if two models cannot form a mean of the same kind."""
    for name in _SHARED:
        if getattr(one, name) != getattr(other, name):
            raise ValueError(f'ensemble: {name} must be the same for all members')
    kinds = [(None if card.prior is None else (card.prior.kind, card.prior.angles),
              None if card.input_map is None else len(card.input_map[0]))
             for card in (one, other)]
    if kinds[0] != kinds[1]:
        raise ValueError('ensemble: prior and motors of input_map must be the same for all '
                         'members')


def mean_card(cards: Sequence[MechanicalCard]) -> MechanicalCard:
    """
    Return the card of the mean of models, with the mean's friction and input map.

    The friction consists of the terms of all members, with forces divided by N. Scales and prior
    parameters are means, only for information; M and V come from the members themselves.
    """
    count, first = len(cards), cards[0]

    def shared(terms: list[Any]) -> list[Any]:
        return [term.model_copy(update={
            key: [force / count for force in forces]
            for key in ('force', 'back') if (forces := getattr(term, key, None)) is not None})
            for term in terms]

    def mean(values: list[Any]) -> Any:
        return None if values[0] is None else np.mean(values, axis=0).tolist()
    friction = FrictionCard(
        **{name: mean([getattr(card.friction, name) for card in cards])
           for name in ('viscous', 'viscous_back', 'switch', 'offset', 'load')},
        coulomb=[term for card in cards for term in shared(card.friction.coulomb)],
        stribeck=[term for card in cards for term in shared(card.friction.stribeck)])
    prior, priors = first.prior, [card.prior for card in cards if card.prior is not None]
    if prior is not None:
        prior = prior.model_copy(update={'identification': None, 'estimates': {}, 'parameters': {
            name: Quantity(value=mean([one.values[name] for one in priors]), unit=quantity.unit)
            for name, quantity in prior.parameters.items()}})
    return first.model_copy(update={
        'friction': friction, 'prior': prior,
        'mass_scale': mean([card.mass_scale for card in cards]),
        **{name: mean([getattr(card, name) for card in cards])
           for name in ('input_map', 'fade')}})
