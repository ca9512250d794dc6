# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""What a model of a machine has seen, and how it was chosen: entries of its card."""

from collections.abc import Sequence
from typing import Annotated

from hnn_vi_ros.files.yaml_file import StrictModel
import numpy as np
from pydantic import Field

Range = Annotated[list[float], Field(min_length=2, max_length=2)]
Errors = dict[str, list[float | None]]


class DomainCard(StrictModel):
    """The ranges [low, high] of the motions that a model was learned from."""

    q: list[Range] = Field(min_length=1, description='of each coordinate')
    v: list[Range] = Field(min_length=1, description='of each velocity')
    forces: list[Range] = Field(description='of each motor; empty where no forces were measured')

    @classmethod
    def of(cls, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> 'DomainCard':
        """Return the ranges of motions, each of shape (N, d), and of forces (N, m)."""
        parts = {'q': q, 'v': v, 'forces': tau if tau.any() else tau[:, :0]}
        return cls(**{name: np.stack([part.min(axis=0), part.max(axis=0)], axis=-1).tolist()
                      for name, part in parts.items()})

    def excess(self, q: np.ndarray, v: np.ndarray, tau: np.ndarray, kinds: Sequence[str]
               ) -> np.ndarray:
        """
        Return how far samples are outside.

        Parameters
        ----------
        q, v : np.ndarray, shape (N, d)
            Coordinates and velocities.
        tau : np.ndarray, shape (N, m)
            Forces; they count if there were as many in the data.
        kinds : sequence of str
            Of the coordinates; the range of a continuous one is on its circle.

        Returns
        -------
        np.ndarray, shape (N, k)
            Of each coordinate, velocity and force, in half-widths of its range; 0 inside.

        """
        ranges = np.array([*self.q, *self.v, *self.forces])
        forces = tau[:, :len(self.forces)] if tau.shape[1] == len(self.forces) else \
            np.tile(ranges[2 * len(self.q):].mean(axis=1), (len(q), 1))
        x, (low, high) = np.hstack([q, v, forces]), ranges.T
        for i, kind in enumerate(kinds):
            if kind == 'continuous':
                # The turn of it that is least beyond.
                middle = 0.5 * (low[i] + high[i])
                x[:, i] = middle + np.remainder(x[:, i] - middle + np.pi, 2.0 * np.pi) - np.pi
        half = np.maximum(0.5 * (high - low), np.finfo(float).tiny)
        return np.maximum(np.maximum(low - x, x - high), 0.0) / half

    def beyond(self, q: np.ndarray, v: np.ndarray, tau: np.ndarray, kinds: Sequence[str],
               names: Sequence[tuple[str, str, str]]) -> list[str]:
        """
        Say what goes beyond, the furthest first, as "elbow to 30 rad/s, seen 15".

        ``names`` has the name of each coordinate, its unit and that of its momentum.
        """
        excess = self.excess(q, v, tau, kinds)
        d, found = len(names), []
        values = np.hstack([q, v, tau])
        for i in np.argsort(-excess.max(axis=0, initial=0.0)):
            if not excess[:, i].any():
                break
            name, unit, p_unit = names[i % d] if i < 2 * d else (
                (f'force of {names[i - 2 * d][0]}', '', names[i - 2 * d][2]))
            unit = unit if i < d else f'{unit}/s' if i < 2 * d else p_unit.removesuffix(' s')
            at = values[excess[:, i].argmax(), i]
            low, high = [*self.q, *self.v, *self.forces][i]
            seen = high if at > high else low
            found.append(f'{name} to {at:.3g} {unit}, seen {seen:.3g}')
        return found


class CandidateCard(StrictModel):
    """A candidate, and its errors on motions that were held out when it was tried."""

    name: str
    furthest: Errors = Field({}, description=(
        'root mean square of the error of each coordinate at the end of each horizon [s], on the '
        'pieces that go furthest; null where it is not finite'))
    ordinary: Errors = Field({}, description='the same on other pieces')
    failed: str = Field('', max_length=1000, description='why it could not be tried')


class SelectionCard(StrictModel):
    """How a model was chosen among candidates."""

    held_out: str = Field(max_length=1000)
    candidates: list[CandidateCard] = Field(min_length=1)
    chosen: str
    trust: str = Field(max_length=1000, description='what to trust the model for')

    @property
    def text(self) -> str:
        """Return the whole table, as Markdown, and what to trust the model for."""
        first = next(one for one in self.candidates if not one.failed)
        heads = [f'{part}, {horizon} s' for part in ('ordinary', 'furthest')
                 for horizon in getattr(first, part)]
        lines = [f'| candidate | {" | ".join(heads)} |', f'|---|{len(heads) * "---|"}']
        for one in self.candidates:
            cells = [' '.join('inf' if x is None else f'{x:.3g}' for x in errors)
                     for part in (one.ordinary, one.furthest) for errors in part.values()]
            name = f'**{one.name}**' if one.name == self.chosen else one.name
            lines.append(f'| {name} | {" | ".join(cells) or one.failed} |')
        return '\n'.join([f'Chosen by {self.held_out}:', '', *lines, '', self.trust])
