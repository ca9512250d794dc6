# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Domain of the model of a machine, and its selection among candidates: entries of its card."""

from collections.abc import Sequence
from typing import Any

from hnn_vi_ros.files import StrictModel
from hnn_vi_ros.models.box_error import Interval
import numpy as np
from pydantic import Field

# Units of forces, as momenta in base units.
_FORCES = {'kg m/s': 'N', 'kg m2/s': 'N m', '1': '1'}

Errors = dict[str, list[float | None]]


def force_unit(p_unit: str) -> str:
    """Return the unit of forces that change momenta in this unit."""
    return _FORCES.get(
        p_unit, p_unit.removesuffix(' s') if p_unit.endswith(' s') else f'{p_unit}/s')


class DomainCard(StrictModel):
    """Ranges [low, high] of the motions that a model was trained on."""

    q: list[Interval] = Field(min_length=1, description='range of each coordinate')
    v: list[Interval] = Field(min_length=1, description='range of each velocity')
    forces: list[Interval] = Field(description=(
        'range of the force of each motor; empty if no forces were measured'))

    def text(self, names: Sequence[tuple[str, str, str]]) -> str:
        """Describe the ranges; for the name, unit, and unit of momentum of each coordinate."""
        found = []
        for (name, unit, _), *ranges in zip(names, self.q, self.v, strict=True):
            found.append(name + ','.join(
                f' {low:.3g} to {_with_unit(high, of)}' for (low, high), of in zip(
                    ranges, (unit, f'{unit}/s'), strict=True)))
        found += [f'force {i + 1}: {low:.3g} to {_with_unit(high, force_unit(p_unit))}' for i, (
            (low, high), (_, _, p_unit)) in enumerate(zip(self.forces, names, strict=False))]
        return '; '.join(found)

    @classmethod
    def of(cls, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> 'DomainCard':
        """Return the ranges of motions, each of shape (N, d), and of forces (N, m)."""
        parts = {'q': q, 'v': v, 'forces': tau if tau.any() else tau[:, :0]}
        return cls(**{name: np.stack([part.min(axis=0), part.max(axis=0)], axis=-1).tolist()
                      for name, part in parts.items()})


class Domain:
    """
    The domain of a machine's model, for checks of motions.

    Parameters
    ----------
    card : DomainCard
        Its ranges.
    kinds : sequence of str
        Kinds of the coordinates; the range of a continuous one is on its circle.
    names : sequence of (str, str, str)
        Name and unit of each coordinate, and unit of its momentum.

    """

    def __init__(self, card: DomainCard, kinds: Sequence[str],
                 names: Sequence[tuple[str, str, str]]):
        self._names = names
        self._motors = len(card.forces)
        self._low, self._high = np.array([*card.q, *card.v, *card.forces]).T
        self._turns = np.flatnonzero([kind == 'continuous' for kind in kinds])
        # The round-off of a nearly constant coordinate must not count as outside.
        self._half = np.maximum(0.5 * (self._high - self._low), 1e-9)

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return low and high bounds of q and v, half-widths, and the periods, 0 without one."""
        d, period = len(self._names), np.zeros(2 * len(self._names))
        period[self._turns] = 2.0 * np.pi
        return self._low[:2 * d], self._high[:2 * d], self._half[:2 * d], period

    def excess(self, q: np.ndarray, v: np.ndarray, tau: np.ndarray | None = None) -> np.ndarray:
        """
        Return the distance of samples from the domain, in half-widths, shape (..., k); 0 inside.

        Parameters
        ----------
        q, v : np.ndarray, shape (..., d)
            Coordinates and velocities.
        tau : np.ndarray, shape (..., m), optional
            Forces; they are used if their number is the same as in the data.

        """
        x = np.concatenate(
            [q, v] if tau is None or tau.shape[-1] != self._motors else [q, v, tau], axis=-1)
        low, high, half = (part[:x.shape[-1]] for part in (self._low, self._high, self._half))
        # The revolution of an angle that is least outside.
        turns = self._turns
        middle = 0.5 * (low + high)[turns]
        x[..., turns] = middle + np.remainder(x[..., turns] - middle + np.pi, 2.0 * np.pi) - np.pi
        return np.maximum(np.maximum(low - x, x - high), 0.0) / half

    def beyond(self, q: np.ndarray, v: np.ndarray, tau: np.ndarray | None = None) -> list[str]:
        """Describe what is outside, furthest first, as in "elbow = 30 rad/s, trained to 15"."""
        excess, d = self.excess(q, v, tau), len(self._names)
        values = np.hstack([q, v] if tau is None else [q, v, tau])
        found = []
        for i in np.argsort(-excess.max(axis=0)):
            if not excess[:, i].any():
                break
            name, unit, p_unit = self._names[i % d]
            if i >= 2 * d:
                name, unit = f'force {i - 2 * d + 1}', force_unit(p_unit)
            elif i >= d:
                unit += '/s'
            at = values[excess[:, i].argmax(), i]
            seen = self._high[i] if at > self._high[i] else self._low[i]
            found.append(f'{name} = {_with_unit(at, unit)}, trained to {seen:.3g}')
        return found


def _with_unit(value: float, unit: str) -> str:
    return f'{value:.3g}' if unit == '1' else f'{value:.3g} {unit}'


def domain_of(model: Any) -> Domain | None:
    """Return the domain of a Hamiltonian, None if it is not of a machine with a domain."""
    card = getattr(getattr(getattr(model, 'base', model), 'checkpoint', None), 'card', None)
    if card is None or card.domain is None or card.mechanical is None:
        return None
    return Domain(card.domain, card.mechanical.kinds,
                  [(one.name, one.q_unit, one.p_unit) for one in card.coordinates])


class CandidateCard(StrictModel):
    """A candidate, and its errors on motions that were held out when it was tried."""

    name: str
    furthest: Errors = Field({}, description=(
        'root mean square error of each coordinate at the end of each horizon [s], on the '
        'pieces that go furthest; null if it is not finite'))
    ordinary: Errors = Field({}, description='the same, on the other pieces')
    residuals: dict[str, list[float]] = Field({}, description=(
        'of a rigid body, on the same pieces: root mean square of the residuals of each '
        'coordinate in units of its noise, by the length of the windows [s]'))
    failed: str = Field('', max_length=1000, description='reason why it could not be evaluated')


class SelectionCard(StrictModel):
    """Choice of a model among candidates, using motions that were held out."""

    held_out: str = Field(max_length=1000)
    candidates: list[CandidateCard] = Field(min_length=1)
    chosen: str
    trust: str = Field('', max_length=1000, description='range in which to trust the model')

    @property
    def text(self) -> str:
        """Return the table as Markdown, with the range in which to trust the model."""
        first = next(one for one in self.candidates if not one.failed)
        heads = [f'{part}, {horizon} s' for part in ('ordinary', 'furthest')
                 for horizon in getattr(first, part)]
        lines = [f'| candidate | {" | ".join(heads)} |', f'|---|{len(heads) * "---|"}']
        for one in self.candidates:
            cells = [' '.join('inf' if x is None else f'{x:.3g}' for x in errors)
                     for part in (one.ordinary, one.furthest) for errors in part.values()]
            name = f'**{one.name}**' if one.name == self.chosen else one.name
            lines.append(f'| {name} | {" | ".join(cells) or one.failed} |')
        return '\n'.join([
            f'Chosen by {self.held_out}. RMS errors of each coordinate, in its unit, which '
            'include the noise of the sensors:', '',
            *lines, '', self.trust])
