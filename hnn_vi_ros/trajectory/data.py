# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The samples of a run, with their names and their origin."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

from hnn_vi_ros.errors import listed
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.mechanisms import MECHANISMS
from hnn_vi_ros.mechanisms.parts import Mechanism
from hnn_vi_ros.mechanisms.skeleton import skeleton
from hnn_vi_ros.phase_space import column_units, columns, Coordinate, Event, momentum_name
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.build import build
import numpy as np


@dataclass(frozen=True, eq=False, repr=False)
class TrajectoryData:
    """Data of a Trajectory, see there; what draws it takes this."""

    t: np.ndarray
    q: np.ndarray
    p: np.ndarray
    energy: np.ndarray
    coordinates: tuple[Coordinate, ...]
    alarms: tuple[Any, ...] = ()
    events: tuple[Event, ...] = ()
    scene: Scene | None = None
    work: np.ndarray | None = None

    @property
    def names(self) -> tuple[list[str], list[str]]:
        """Return a name for each column of q and of p."""
        q, p = columns(self.coordinates)
        return q, [momentum_name(name) for name in p]

    @property
    def units(self) -> dict[str, str]:
        """Return the units of the named columns, of time ``t`` and of ``H``."""
        pairs = zip((*self.names[0], *self.names[1]),
                    (unit for own in column_units(self.coordinates) for unit in own), strict=True)
        return {'t': 's', **dict(pairs), 'H': 'J'}

    @property
    def title(self) -> str:
        """Return the name of the scene, the method and the step size, as far as known."""
        if self.scene is None:
            return 'trajectory'
        return (f'{self.scene.name}, {self.scene.integrator.kind}, '
                f'h = {self.scene.known_step_size:g} s')

    def select(self, index: int) -> Self:
        """
        Return one of m trajectories.

        Parameters
        ----------
        index : int
            Which, from 0; -1 for the last.

        Raises
        ------
        IndexError
            There are not so many.

        """
        count = self.q.shape[1] if self.q.ndim == 3 else 1
        if not -count <= index < count:
            raise IndexError(f'trajectory {index}: expected 0 to {count - 1}, or -{count} to -1 '
                             'counted from the last')
        if self.q.ndim == 2:
            return self
        return replace(self, q=self.q[:, index], p=self.p[:, index],
                       energy=self.energy[:, index], alarms=self.alarms[index])

    def of(self, names: Sequence[str] | None) -> Self:
        """Return it with some coordinates alone; ValueError if there is none of a name."""
        if names is None:
            return self
        known = [coordinate.name for coordinate in self.coordinates]
        wanted = [names] if isinstance(names, str) else list(names)
        for name in wanted:
            if name not in known:
                raise ValueError(f'no coordinate {name!r}; valid: {listed(known)}')
        kept = [known.index(name) for name in wanted]
        # Columns of q and of p that belong to each coordinate.
        q, p = (np.repeat(np.arange(len(known)), [
            len(columns([own])[half]) for own in self.coordinates]) for half in (0, 1))
        return replace(
            self, coordinates=tuple(self.coordinates[k] for k in kept),
            q=self.q[..., np.concatenate([np.flatnonzero(q == k) for k in kept])],
            p=self.p[..., np.concatenate([np.flatnonzero(p == k) for k in kept])])

    def single(self) -> Self:
        """Return it, or raise ValueError if it is several."""
        if self.q.ndim == 3:
            raise ValueError(f'{self.q.shape[1]} trajectories cannot be shown as one: choose one, '
                             'as in trajectory.select(0)')
        return self

    def hamiltonian(self) -> Hamiltonian:
        """Return H with the potentials among the effects of the scene."""
        return self.simulation().hamiltonian

    def mechanism(self) -> Mechanism | None:
        """Return what draws the mechanism of the scene, or the skeleton of its robot, if any."""
        if self.scene is None:
            return None
        if self.scene.mechanism is not None:
            return MECHANISMS[self.scene.mechanism]
        robot = self.hamiltonian().robot
        return None if robot is None else skeleton(robot, self.names[0])

    def simulation(self) -> Simulation:
        """Return a simulation of the scene, in its initial state."""
        if self.scene is None:
            raise ValueError('this trajectory knows no scene, by whose H it could be shown: take '
                             'one of simulate or simulate_many')
        return build(self.scene)

    def facts(self) -> list[str]:
        """Return in short what it holds."""
        many = f' of {self.q.shape[1]} trajectories' if self.q.ndim == 3 else ''
        change = float(np.abs(self.energy - self.energy[:1]).max(initial=0.0))
        first = np.ravel(self.energy[:1])
        balance = self.balance()
        by_effects = '' if balance is None else (
            f', the work of effects accounts for it to {np.abs(balance).max(initial=0.0):.2g} J')
        return [f'{len(self.t)} samples{many}',
                f't = {self.t[0]:g} to {self.t[-1]:g} s' if len(self.t) else 'no time',
                'H = ' + (f'{first[0]:.6g}' if first.size == 1 else
                          f'{first.min(initial=np.inf):.6g} to {first.max(initial=-np.inf):.6g}')
                + f' J, changed by {change:.2g} J at most{by_effects}']

    def balance(self) -> np.ndarray | None:
        """Return H - H(0) - W [J], shape (n,), where W is known; None where no effect works."""
        if self.work is None or self.energy.ndim == 2:
            return None
        return (self.energy - self.energy[:1] - self.work)[np.isfinite(self.work)]

    def alarm_kinds(self) -> list[str]:
        """Return what alarms there were, each kind once."""
        own = self.alarms if self.q.ndim == 2 else [one for each in self.alarms for one in each]
        return list(dict.fromkeys(getattr(alarm, 'kind', str(alarm)) for alarm in own))
