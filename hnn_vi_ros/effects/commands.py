# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Commands to a running simulation, and the resulting reference of servos."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
import math
from typing import Any, NamedTuple

from hnn_vi_ros.errors import listed
from hnn_vi_ros.hamiltonians import Payload
from hnn_vi_ros.kernels import inlined
import numpy as np


class JointCommand(NamedTuple):
    """
    Command to some joints, effective immediately.

    Parameters
    ----------
    names : sequence of str
        Names of n coordinates.
    position, velocity, effort : array_like, shape (n,), optional
        Values in the units of the coordinates, per second for velocities; generalised forces in
        [N] or [N m]; NaN for no command.

    """

    names: Sequence[str]
    position: np.ndarray = np.array(math.nan)
    velocity: np.ndarray = np.array(math.nan)
    effort: np.ndarray = np.array(math.nan)


class JointPath(NamedTuple):
    """
    Points of a joint trajectory.

    Parameters
    ----------
    names : sequence of str
        Names of m coordinates.
    delay : float
        Time from now to the start of the path [s]; negative if it has started already.
    times : array_like, shape (n,)
        Times of the points since the start of the path [s].
    positions : array_like, shape (n, m)
        In the units of the coordinates.
    velocities, accelerations : array_like, shape (n, m), or None
        Time derivatives of the positions; None if the points have none.

    """

    names: Sequence[str]
    delay: float
    times: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray | None = None
    accelerations: np.ndarray | None = None


class Observation(NamedTuple):
    """
    Observation of the machine whose twin the simulation is.

    Parameters
    ----------
    names : sequence of str
        Names of n joints, possibly more than needed.
    delay : float
        Time from now to the observation [s]; negative for the past.
    position, velocity : array_like, shape (n,)
        In the units of the coordinates, and their units per second; NaN if not observed.

    """

    names: Sequence[str]
    delay: float
    position: np.ndarray
    velocity: np.ndarray


class LinkWrench(NamedTuple):
    """
    Command of a wrench on a link of a robot, effective immediately.

    Parameters
    ----------
    frame : str
        Name of the link, for its own axes; BASE/LINK for axes of the base.
    force, torque : sequence of float
        Force at the origin of the link [N], and torque [N m].

    """

    frame: str
    force: Sequence[float]
    torque: Sequence[float]


# Plain numbers are forces, or the inputs of a learned input map.
Command = (Sequence[float] | np.ndarray | JointCommand | JointPath | Observation | Payload
           | LinkWrench)
# Names of the contents of a command.
NUMBERS, POSITION, VELOCITY, EFFORT, PATH = 'commands', 'position', 'velocity', 'effort', 'path'
OBSERVATION, PAYLOAD, LINK_WRENCH = 'observation', 'payload', 'wrench'
# Upper bound on the numbers of a command in any unit, so that splines and forces stay finite.
LARGEST = 1e12
# Upper bounds on the observed position and velocity of a joint, so that numbers do not overflow.
_MAX_OBSERVED = 1e9


def with_arrays(command: Command) -> Command:
    """Return a command of joints with arrays of the shapes that it needs, or raise ValueError."""
    if not isinstance(command, JointCommand | JointPath | Observation):
        return command
    names = len(command.names)
    shape = (len(command.times), names) if isinstance(command, JointPath) else (names,)
    arrays: dict[str, Any] = {}
    for kind, given in command._asdict().items():
        if kind in ('names', 'delay') or given is None:
            continue
        wanted = shape[:1] if kind == 'times' else shape
        values = np.asarray(given, dtype=float)
        if values.ndim and values.shape != wanted:
            raise ValueError(f'the shape of {kind} is {values.shape}, expected {wanted}')
        arrays[kind] = np.broadcast_to(values, wanted)
    return command._replace(**arrays)


def contents(command: Command) -> set[str]:
    """Return the names of the contents of a command, or raise ValueError if it is empty."""
    if isinstance(command, JointPath):
        return {PATH}
    if isinstance(command, Observation):
        return {OBSERVATION}
    if isinstance(command, Payload | LinkWrench):
        return {PAYLOAD if isinstance(command, Payload) else LINK_WRENCH}
    if not isinstance(command, JointCommand):
        return {NUMBERS}
    found = {name for name in (POSITION, VELOCITY, EFFORT)
             if not np.isnan(getattr(command, name)).all()}
    if not found:
        raise ValueError('the command is empty; give a position, a velocity or an effort')
    return found


class Reference(NamedTuple):
    """
    Reference that servos follow.

    Parameters
    ----------
    modes : np.ndarray of int64, shape (d,)
        Mode of each coordinate; see the modes of servos.
    targets : np.ndarray, shape (2, d)
        Commanded positions and velocities.
    extent : np.ndarray of int64, shape (2,)
        Number of knots of the path, and degree of its polynomials.
    knots : np.ndarray, shape (n, 1 + 3 d)
        Time [s], positions, velocities and accelerations of the path at its knots. An observer
        uses the last row.

    """

    modes: np.ndarray
    targets: np.ndarray
    extent: np.ndarray
    knots: np.ndarray

    @classmethod
    def empty(cls, dimension: int, knots: int) -> 'Reference':
        """Return a reference without a command, with space for ``knots`` knots."""
        return cls(np.zeros(dimension, dtype=np.int64), np.zeros((2, dimension)),
                   np.zeros(2, dtype=np.int64), np.zeros((knots, 1 + 3 * dimension)))


class ServoTarget(NamedTuple):
    """
    Present targets of a servo.

    Parameters
    ----------
    names : sequence of str
        Names of its n joints.
    columns : np.ndarray, shape (n,)
        Their columns in q.
    targets : np.ndarray, shape (3, n)
        Their target positions, velocities and accelerations; NaN for none.
    on_path : bool
        True if the targets are on a path.

    """

    names: Sequence[str]
    columns: np.ndarray
    targets: np.ndarray
    on_path: bool


class Commanded(ABC):
    """
    An effect that accepts commands while the simulation runs.

    Attributes
    ----------
    takes : frozenset of str
        The contents of a command that it accepts; see ``contents``.
    names : sequence of str
        Names of the driven joints; for plain numbers, the name of each number if it has one.

    """

    takes: frozenset[str]
    names: Sequence[str] = ()

    @abstractmethod
    def prepare(self, command: Command, parameters: Any, q: np.ndarray) -> Callable[[], None]:
        """
        Return a function that applies the effect's part of a command.

        The checks come first, so that a command to several effects acts on all of them or on none.

        Parameters
        ----------
        command : Command
            A command with contents that the effect accepts.
        parameters : tuple
            The result of ``resolve``.
        q : np.ndarray, shape (d,)
            The present coordinates.

        Raises
        ------
        ValueError
            The command is invalid; the last one stays active.

        """

    def begin(self, parameters: Any) -> None:
        """Apply the settings that act before the first command; by default none."""
        return

    def servo_target(self, parameters: Any) -> ServoTarget | None:
        """Return the present targets, None if the effect follows none."""
        return None


def select(command: Observation, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """
    Return positions and velocities of named joints, shape (n,); unobserved velocities are NaN.

    Raises
    ------
    ValueError
        A joint is missing or listed twice, or a number is not finite.

    """
    given = list(command.names)
    for name in names:
        if given.count(name) != 1:
            raise ValueError(f'joint {name!r} is listed {given.count(name)} times, expected once; '
                             f'observed joints: {listed(names)}')
    rows = [given.index(name) for name in names]
    position, velocity = command.position[rows], command.velocity[rows]
    if not (np.abs(position) <= _MAX_OBSERVED).all() or (np.abs(velocity) > _MAX_OBSERVED).any():
        raise ValueError('positions and known velocities must be finite and at most '
                         f'{_MAX_OBSERVED:g}')
    return position, velocity


def whole_turns(difference: np.ndarray, turning: np.ndarray) -> np.ndarray:
    """Return the whole turns nearest to differences of positions of rotating joints [rad]."""
    # Impossible differences are left for ``select`` to refuse.
    turning = turning & (np.abs(difference) <= _MAX_OBSERVED)
    return 2.0 * math.pi * np.where(turning, np.round(difference / (2.0 * math.pi)), 0.0)


@inlined
def plus_motors(force: float, matrix: np.ndarray, fade: np.ndarray, command: np.ndarray, i: int
                ) -> float:
    """Return a force plus (A u / (1 + g abs(u)))_i, where u is the first part of the command."""
    for k in range(matrix.shape[1]):
        force += matrix[i, k] * command[k] / (1.0 + fade[k] * abs(command[k]))
    return force


def indices_of(names: Sequence[str], known: Sequence[str], wanted: np.ndarray) -> np.ndarray:
    """Return the indices of wanted names in a list of known names, or raise ValueError."""
    if len(set(names)) < len(names):
        raise ValueError(f'name = [{printable(names)}] lists a joint twice; list each once')
    asked = [name for name, one in zip(names, wanted, strict=True) if one]
    for name in asked:
        if name not in known:
            raise ValueError(f'joint {name[:80]!r} does not accept this command; valid joints: '
                             f'{listed(known)}')
    return np.array([known.index(name) for name in asked], dtype=np.int64)


def printable(names: Sequence[str]) -> str:
    """Return the start of a list of names from external input, in printable characters."""
    return repr(', '.join(names)[:80])[1:-1]
