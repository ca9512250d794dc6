# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The model card: the description of a trained model, for people and for the loader."""

from typing import Annotated, Any, Literal

from hnn_vi_ros.files import StrictModel
from hnn_vi_ros.models.box_error import EnergyError, Interval
from hnn_vi_ros.models.domain import DomainCard, SelectionCard
from hnn_vi_ros.models.families import FAMILIES
from hnn_vi_ros.models.lie_group_card import LieGroupCard
from hnn_vi_ros.models.mechanical_card import check_alike, MechanicalCard, MOST_MEMBERS
from hnn_vi_ros.phase_space import UNIT
import numpy as np
from pydantic import Field, model_validator

Widths = Annotated[list[Annotated[int, Field(ge=1, le=100_000)]],
                   Field(min_length=3, max_length=100)]


class CoordinateCard(StrictModel):
    """One generalised coordinate of a model and its conjugate momentum."""

    name: str = Field(pattern=r'^[^\W\d]\w*$', max_length=64, description=(
        'a letter or underscore, then letters, digits, underscores'))
    q_unit: str = Field('1', pattern=f'^{UNIT}$', description='unit of the coordinate')
    p_unit: str = Field('1', pattern=f'^{UNIT}$', description='unit of its momentum')


class Box(StrictModel):
    """Bounds [low, high] of q and of p for each coordinate, and of t for H(q, p, t)."""

    q: list[Interval] = Field(min_length=1)
    p: list[Interval] = Field(min_length=1)
    t: list[Interval] | None = Field(None, min_length=1, max_length=1)

    def _check(self) -> None:
        if len(self.q) != len(self.p):
            raise ValueError(f'{len(self.q)} intervals of q but {len(self.p)} of p')
        for low, high in (*self.q, *self.p, *(self.t or ())):
            if not 0.0 < high - low < np.inf:
                raise ValueError(
                    f'[{low:g}, {high:g}] is not an interval of positive, finite size')

    @classmethod
    def of(cls, q: np.ndarray, p: np.ndarray) -> 'Box':
        """Return the bounds of states, of shape (N, d) each."""
        return cls(**{name: np.stack([part.min(axis=0), part.max(axis=0)], axis=-1).tolist()
                      for name, part in (('q', q), ('p', p))})

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the lower and the upper bounds of states (q, p), shape (2 d,) each."""
        low, high = np.concatenate([self.q, self.p]).T
        return low, high


class Scheme(StrictModel):
    """A one-step map."""

    integrator: str = Field(description='name of the method, as in a scene')
    step_size: float = Field(gt=0.0, description='h [s]')


class Units(StrictModel):
    """Normalisation of the network inputs: (x - centre) / scale."""

    centre: list[float] = Field(description='centre of the states (q, p)')
    scale: list[float] = Field(description='scale of the states (q, p)')
    target: list[float] = Field(description='scale of the targets, such as (dq/dt, dp/dt)')


class PredictionError(StrictModel):
    """Error of simulations from measured states that were held out."""

    horizons: dict[str, list[float | None]] = Field(description=(
        'root mean square error of each coordinate at the end of each horizon [s]; null if a '
        'simulation failed'))
    valid_prediction_time: float = Field(ge=0.0, description=(
        'median of the time until sum_i (error of q_i)^2 / var(q_i) reaches 0.01 [s]; of '
        'positions alone, var(q_i) is at least (50 noise_i)^2'))
    censored: float = Field(ge=0.0, le=1.0, description=(
        'share of predictions that were valid until they, or the motion, ended'))
    failed: int = Field(ge=0, description='number of failed simulations')
    energy_mismatch: dict[str, float | None] | None = Field(None, description=(
        'change of H minus the work over each horizon [s], as a share of the range of H; null '
        'if it is not finite'))
    noise: list[float] = Field([], description=(
        'standard deviation of the noise of the coordinates, then of the velocities if measured'))
    residuals: dict[str, list[float]] = Field({}, description=(
        'root mean square of the residuals of each coordinate in units of its noise, in windows '
        'of each length [s] whose initial states are fitted'))


class ModelCard(StrictModel):
    """Description of a model: its type, training data and accuracy."""

    format_version: Literal[1] = 1
    name: str = Field(min_length=1, max_length=255)
    family: Literal[tuple(FAMILIES)] = 'hnn'  # type: ignore[valid-type]
    activation: Literal['tanh', 'sine', 'relu', 'softplus'] = 'tanh'
    widths: Widths | None = Field(None, description=(
        'widths of all layers of the network, including input and output'))
    networks: dict[str, Widths] | None = Field(None, description=(
        'the same for each network, in a family with several'))
    coordinates: list[CoordinateCard] = Field(min_length=1)
    box: Box = Field(description='bounds of the data that the model was trained on')
    velocities: list[Interval] | None = Field(None, description=(
        'bounds of dq/dt in the data, for a Lagrangian'))
    mass: list[list[float]] | None = Field(None, description=(
        'M, for a family whose kinetic energy contains dq/dt . M dq/dt / 2, or theta M times p'))
    friction: list[Annotated[float, Field(ge=0.0)]] | None = Field(None, description=(
        'gamma [1/s], for a family that learned dp/dt = -H_q - gamma p'))
    mechanical: MechanicalCard | None = Field(None, description=(
        'inputs of the networks of the family mechanical, and its friction; for an ensemble, '
        'friction and input map of the mean'))
    lie_group: LieGroupCard | None = Field(None, description=(
        'inputs of the networks of the family lie_group; the box has an additional column of p, '
        'which is zero'))
    scheme: Scheme | None = Field(None, description=(
        'the one-step map that the model was trained through, and is valid for'))
    dataset: str
    seed: int
    losses: dict[str, float]
    units: Units | None = Field(None, description='normalisation used in training')
    energy_error: EnergyError | None = Field(None, description='error of H in the box, if known')
    prediction_error: PredictionError | None = Field(None, description=(
        'error of a machine, simulated with the measured forces'))
    domain: DomainCard | None = Field(None, description='training domain of a machine')
    selection: SelectionCard | None = Field(None, description=(
        'how a model of a machine was chosen, using motions that were held out'))
    training_command: str
    package_version: str
    confine: bool = Field(False, description=(
        'whether walls keep states near the box, unless a scene overrides it'))
    ensemble: 'EnsembleCard | None' = Field(None, description=(
        'members of a file with several models: H is their mean'))

    @property
    def layout(self) -> dict[str, list[int]]:
        """Return the widths of each network."""
        if self.networks is not None or not FAMILIES[self.family].networks:
            return self.networks or {}
        assert self.widths is not None, 'checked: one of the two is there'
        (first, *_) = FAMILIES[self.family].networks
        return {first: self.widths}

    def _check(self) -> None:
        d = len(self.coordinates)
        if len({coordinate.name for coordinate in self.coordinates}) != d:
            raise ValueError('two coordinates have the same name')
        columns = d if self.lie_group is None else self.lie_group.size + 1
        if len(self.box.q) != columns:
            raise ValueError(f'the box has {len(self.box.q)} coordinates, expected {columns}')
        self._check_constants(d)
        self._check_networks(d)
        if self.ensemble is not None:
            self._check_ensemble(self.ensemble)

    def _check_ensemble(self, ensemble: 'EnsembleCard') -> None:
        if not FAMILIES[self.family].averaged:
            raise ValueError(f'ensemble: not supported by the family {self.family}; valid: '
                             f'{", ".join(averaged_families())}')
        for member in ensemble.members:
            if member.ensemble is not None:
                raise ValueError('ensemble: a member must be a single model, not an ensemble')
            for name in ('family', 'activation', 'layout', 'coordinates'):
                if getattr(member, name) != getattr(self, name):
                    raise ValueError(f'ensemble: {name} must be the same for all members')
            if self.mechanical is not None and member.mechanical is not None:
                check_alike(self.mechanical, member.mechanical)
        factors = ensemble.factors
        if factors is not None and len(factors) != 2 * len(self.coordinates):
            raise ValueError(f'ensemble: {len(factors)} factors, expected '
                             f'{2 * len(self.coordinates)} for q and p')

    def _check_networks(self, d: int) -> None:
        own = self.mechanical or self.lie_group
        expected, units, why = (own.networks, 1, 'for the inputs in the card') if own else (
            FAMILIES[self.family].networks, d, f'for {d} coordinates')
        if not expected:
            if self.widths is not None or self.networks is not None:
                raise ValueError(f'the family {self.family} has no widths and no networks')
        elif len(expected) == 1:
            if self.widths is None or self.networks is not None:
                raise ValueError('give widths, and not networks, for a model of the family '
                                 f'{self.family}')
        elif self.widths is not None or (self.networks or {}).keys() != expected.keys():
            raise ValueError(f'give networks {", ".join(expected)}, and not widths, for a model '
                             f'of the family {self.family}')
        for name, widths in self.layout.items():
            network = expected[name]
            ends = network.inputs * units, network.outputs(units, widths[-1])
            if (widths[0], widths[-1]) != ends:
                raise ValueError(f'widths {widths} of {name} must start with {ends[0]} '
                                 f'and end with {ends[1]}, {why}')

    def _check_constants(self, d: int) -> None:
        for name in ('friction', 'mass', 'velocities', 'mechanical', 'lie_group'):
            value, needed = getattr(self, name), name in FAMILIES[self.family].constants
            if (value is not None) != needed:
                raise ValueError(f'{name} must {"" if needed else "not "}be given for the family '
                                 f'{self.family}')
            count = 1 if name == 'lie_group' else len(getattr(value, 'kinds', value or ()))
            if needed and count != d:
                raise ValueError(f'{name} has {count} coordinates, the card has {d}')
        if self.mass is not None:
            mass = np.array([row for row in self.mass if len(row) == d])
            if mass.shape != (d, d) or not (np.linalg.eigvalsh(mass) > 0.0).all():
                raise ValueError(f'mass must be a positive definite {d} x {d} matrix')


class EnsembleCard(StrictModel):
    """The members of an ensemble, and the scale from their spread to the error of their mean."""

    members: list[ModelCard] = Field(min_length=2, max_length=MOST_MEMBERS)
    factors: list[Annotated[float, Field(gt=0.0)]] | None = Field(None, description=(
        'factors of the standard deviation of the members, for each coordinate, then for each '
        'momentum, so that bands cover the share `level` of errors; none if the spread was not '
        'calibrated'))
    level: float = Field(0.9, gt=0.0, lt=1.0, description='share of errors that bands cover')
    coverage: float | None = Field(None, ge=0.0, le=1.0, description=(
        'share that the bands cover in motions that were used neither for training nor for the '
        'factors'))
    calibration: str = Field('', max_length=1000, description='data that determined the factors')

    @model_validator(mode='before')
    @classmethod
    def _with_one_factor(cls, data: Any) -> Any:
        """Apply the single factor of files of version 0.2.0 to all coordinates and momenta."""
        match data:
            case {'factor': factor, 'members': [{'coordinates': [*coordinates]}, *_], **others}:
                return {**others, 'members': data['members'],
                        'factors': 2 * len(coordinates) * [factor]}
        return data


def averaged_families() -> list[str]:
    """Return the families that can form ensembles."""
    return [name for name, family in FAMILIES.items() if family.averaged]


ModelCard.model_rebuild()
