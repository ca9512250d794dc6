# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The members of an ensemble as companions of its mean, and how far they come apart."""

import warnings

from hnn_vi_ros.companions.spread import (
    deviation, ensemble_card, measured_momenta, members_of, same_velocity)
from hnn_vi_ros.effects.commands import Command
from hnn_vi_ros.errors import ModelError, StepFailure
from hnn_vi_ros.scene import Parts
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.build import build
import numpy as np


class Members:
    """
    The members of the ensemble of a scene; see Companion.

    One whose step fails stands still from then on, and the spread is infinite. Where momenta are a
    member's own, p = M_k(q) q', it begins at q and q' of the mean, and its q and q' are compared,
    as the momenta that the mean has for them.

    Parameters
    ----------
    parts : Parts
        Of a scene; its Hamiltonian is the mean of an ensemble.

    Attributes
    ----------
    count : int
        How many members there are.
    factors : np.ndarray, shape (2 d,), or None
        Factors on the standard deviations of q, then of p; None where the card
        knows none.
    level : float or None
        Share of errors that these bands cover.

    Raises
    ------
    SceneError
        The Hamiltonian is no mean of an ensemble.

    """

    def __init__(self, parts: Parts):
        card = ensemble_card(parts)
        self.count = len(card.members)
        self.factors = None if card.factors is None else np.array(card.factors)
        self.level = card.level if card.factors else None
        with warnings.catch_warnings():
            # The mean has already raised the warnings about the scene.
            warnings.simplefilter('ignore')
            self._simulations = [build(own) for own in members_of(parts)]
            # One compiles for all: they have one type.
            self._simulations[0].compile()
            self._simulations[0].compile_rescue()
            self._mean = None if measured_momenta(parts.hamiltonian) else \
                build(parts.copy()).hamiltonian
        if self._mean is not None:
            self._mean.compile()
            self._simulations[0].hamiltonian.compile()
        self._failed: set[int] = set()

    def advance(self, n: int) -> None:
        """See Companion."""
        for k, simulation in enumerate(self._simulations):
            if k not in self._failed:
                try:
                    simulation.advance(n)
                except StepFailure:
                    self._failed.add(k)

    def set_command(self, command: Command) -> None:
        """See Companion."""
        for simulation in self._simulations:
            simulation.set_command(command)

    def begin(self, simulation: Simulation) -> None:
        """See Companion."""
        self._failed.clear()
        for k, own in enumerate(self._simulations):
            try:
                p = simulation.p if self._mean is None else same_velocity(
                    self._mean, own.hamiltonian, simulation.q, simulation.p)
                own.restart(simulation.q, p, step=simulation.steps)
            except (ModelError, StepFailure, ValueError):
                self._failed.add(k)

    @property
    def failed(self) -> int:
        """Return how many members stand still."""
        return len(self._failed)

    @property
    def spread(self) -> np.ndarray:
        """Return the half-widths of the bands of q, then of p, shape (2 d,)."""
        states = np.array([np.concatenate(self._state(one)) for one in self._simulations])
        states[list(self._failed)] = np.inf
        spread = deviation(states)
        return spread if self.factors is None else self.factors * spread

    def _state(self, own: Simulation) -> tuple[np.ndarray, np.ndarray]:
        """Return q and p of a member; where p is its own, that of the mean for its velocity."""
        if self._mean is None:
            return own.q, own.p
        try:
            return own.q, same_velocity(own.hamiltonian, self._mean, own.q, own.p)
        except ModelError:
            return own.q, np.full_like(own.p, np.inf)
