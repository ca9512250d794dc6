# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Commands to a simulation while it runs, and what servos keep of them."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from hnn_vi_ros.errors import listed
import numpy as np


class JointCommand(NamedTuple):
    """
    Command to some joints, from now on.

    Parameters
    ----------
    names : sequence of str
        Of n coordinates.
    position, velocity, effort : np.ndarray, shape (n,)
        In the units of the coordinates, per second [s], and of their generalised forces [N] or
        [N m]; NaN where nothing is commanded.

    """

    names: Sequence[str]
    position: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray


class JointPath(NamedTuple):
    """
    Points through which joints are to go.

    Parameters
    ----------
    names : sequence of str
        Of m coordinates.
    delay : float
        From now to the start of the path [s]; negative where that was before.
    times : np.ndarray, shape (n,)
        Of the points, since the start of the path [s].
    positions : np.ndarray, shape (n, m)
        In the units of the coordinates.
    velocities, accelerations : np.ndarray, shape (n, m), or None
        Derivatives by the time there; None where the points have none.

    """

    names: Sequence[str]
    delay: float
    times: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray | None = None
    accelerations: np.ndarray | None = None


class Observation(NamedTuple):
    """
    Observation of the machine that a simulation is the twin of.

    Parameters
    ----------
    names : sequence of str
        Of n joints, those that are not asked for among them.
    delay : float
        From now to when they were seen [s]; negative for before.
    position, velocity : np.ndarray, shape (n,)
        In the units of the coordinates, and per second [s]; NaN where nothing was seen.

    """

    names: Sequence[str]
    delay: float
    position: np.ndarray
    velocity: np.ndarray


# Plain numbers are forces, or what the motors of a learned input map take.
Command = Sequence[float] | np.ndarray | JointCommand | JointPath | Observation
# What a command can hold, and what that is called.
NUMBERS, POSITION, VELOCITY, EFFORT, PATH = 'commands', 'position', 'velocity', 'effort', 'path'
OBSERVATION = 'observation'
# No number of a command is larger: splines and forces of such are finite, of any unit.
LARGEST = 1e12


def contents(command: Command) -> set[str]:
    """Return what a command holds, or raise ValueError if that is nothing."""
    if isinstance(command, JointPath):
        return {PATH}
    if isinstance(command, Observation):
        return {OBSERVATION}
    if not isinstance(command, JointCommand):
        return {NUMBERS}
    found = {name for name in (POSITION, VELOCITY, EFFORT)
             if not np.isnan(getattr(command, name)).all()}
    if not found:
        raise ValueError('the command holds no number: give a position, a velocity or an effort')
    return found


class Reference(NamedTuple):
    """
    Reference that servos follow.

    Parameters
    ----------
    modes : np.ndarray of int64, shape (d,)
        What drives each coordinate; see servo_targets.
    targets : np.ndarray, shape (2, d)
        Position and velocity that were commanded.
    extent : np.ndarray of int64, shape (2,)
        How many knots the path has, and the degree of its polynomials.
    knots : np.ndarray, shape (n, 1 + 3 d)
        Time [s], positions, velocities and accelerations of the path at its knots; where there is
        an observer the last row is its own.

    """

    modes: np.ndarray
    targets: np.ndarray
    extent: np.ndarray
    knots: np.ndarray

    @classmethod
    def empty(cls, dimension: int, knots: int) -> 'Reference':
        """Return one that holds no command, with room for some knots."""
        return cls(np.zeros(dimension, dtype=np.int64), np.zeros((2, dimension)),
                   np.zeros(2, dtype=np.int64), np.zeros((knots, 1 + 3 * dimension)))


class Aim(NamedTuple):
    """
    Aim that a servo follows.

    Parameters
    ----------
    names : sequence of str
        Of its n joints.
    places : np.ndarray, shape (n,)
        Theirs among the coordinates.
    targets : np.ndarray, shape (3, n)
        Positions, velocities and accelerations that they are to have; NaN for none.
    on_path : bool
        Whether they are those of a path.

    """

    names: Sequence[str]
    places: np.ndarray
    targets: np.ndarray
    on_path: bool


class Commanded(ABC):
    """
    An effect that takes commands while the simulation runs.

    Attributes
    ----------
    takes : frozenset of str
        What of a command is for it; see ``contents``.
    names : sequence of str
        What it drives, as far as that has names; of plain numbers, what each is for.

    """

    takes: frozenset[str]
    names: Sequence[str] = ()

    @abstractmethod
    def prepare(self, command: Command, parameters: Any, q: np.ndarray) -> Callable[[], None]:
        """
        Return what puts its part of a command into effect.

        Parameters
        ----------
        command : Command
            Of whose contents it takes some.
        parameters : tuple
            What ``resolve`` returned.
        q : np.ndarray, shape (d,)
            The coordinates now.

        Raises
        ------
        ValueError
            The command cannot be used; the last one stays.

        """

    def aim(self, parameters: Any) -> Aim | None:
        """Return what the effect follows now; None where it follows nothing."""
        return None


def places_of(names: Sequence[str], known: Sequence[str], wanted: np.ndarray) -> np.ndarray:
    """Return the places among known names of those that are wanted, or raise ValueError."""
    if len(set(names)) < len(names):
        raise ValueError(f'name = [{told(names)}] names a joint twice: give each once')
    asked = [name for name, one in zip(names, wanted, strict=True) if one]
    for name in asked:
        if name not in known:
            raise ValueError(f'no joint {name[:80]!r} is driven so; valid joints: '
                             f'{listed(known)}')
    return np.array([known.index(name) for name in asked], dtype=np.int64)


def told(names: Sequence[str]) -> str:
    """Return the beginning of a list of names that others gave, in characters that print."""
    return repr(', '.join(names)[:80])[1:-1]
