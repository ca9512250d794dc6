# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The effects of a simulation that take commands."""

from collections.abc import Sequence
from typing import Any

from hnn_vi_ros.effects.base import Effect, Force
from hnn_vi_ros.effects.commands import (
    Aim, Command, Commanded, contents, EFFORT, JointCommand, JointPath, NUMBERS, OBSERVATION,
    POSITION)
import numpy as np

# What digits of a limit leave, as a share of it and of one unit.
_ROUNDING = 1e-9


class Motors:
    """
    Motors that drive a system by commands.

    Parameters
    ----------
    effects : sequence of (Effect, tuple)
        All of a scene, each with what ``resolve`` returned.

    Attributes
    ----------
    takes : frozenset of str
        Possible contents of a command; see ``contents``.
    size : int
        How many numbers a command of plain ones has; 0 where none is taken.
    names : sequence of str
        What each of them is for, none where that has no name.

    """

    def __init__(self, effects: Sequence[tuple[Effect, Any]]):
        self._effects: list[tuple[Any, Any]] = [
            (effect, own) for effect, own in effects if isinstance(effect, Commanded)]
        self.takes = frozenset[str]().union(*(effect.takes for effect, _ in self._effects))
        driven = [(effect.names, own.columns.size) for effect, own in self._effects
                  if NUMBERS in effect.takes]
        self._stops: list[Any] = [own for effect, own in effects if effect.limits]
        # There is at most one.
        self.names: Sequence[str] = driven[0][0] if driven else ()
        self.size: int = driven[0][1] if driven else 0

    def command(self, command: Command, q: np.ndarray, limited: bool = True) -> None:
        """
        Pass a command to the effects that take it.

        Parameters
        ----------
        command : Command
            Of forces, of joints or of a path.
        q : np.ndarray, shape (d,)
            The coordinates now.
        limited : bool, optional
            Whether positions beyond the joint limits of the scene are refused.

        Raises
        ------
        ValueError
            No effect takes it, it cannot be used, or it asks for a position beyond the joint
            limits of the scene; nothing has changed.

        """
        held = contents(command)
        for content in sorted(held - self.takes):
            kind = 'an observer' if content == OBSERVATION else (
                'an external_force' if content in (NUMBERS, EFFORT) else 'a servo')
            raise ValueError(f'no effect of the scene is {kind} of joints: it takes no {content}')
        prepared = [effect.prepare(command, own, q) for effect, own in self._effects
                    if effect.takes & held]
        if limited and isinstance(command, JointCommand):
            self._check_limits(command.names, command.position[None])
        elif limited and isinstance(command, JointPath) and len(command.times):
            self._check_limits(command.names, command.positions)
        for put in prepared:
            put()

    def _check_limits(self, names: Sequence[str], positions: np.ndarray) -> None:
        """Raise ValueError for positions (n, m) of m joints where a stop keeps them from."""
        columns = {name: column for effect, own in self._effects if POSITION in effect.takes
                   for name, column in zip(effect.names, own.columns, strict=True)}
        for stops in self._stops:
            for name, wanted in zip(names, positions.T, strict=True):
                mine = stops.columns == columns.get(name)
                for limit, sign in zip(stops.positions[mine], stops.signs[mine], strict=True):
                    beyond = sign * (wanted - limit) < -_ROUNDING * (1.0 + abs(limit))
                    if beyond.any():
                        raise ValueError(
                            f'position of {name} is {wanted[beyond.argmax()]:g}, beyond its '
                            f'{"lower" if sign > 0 else "upper"} limit {limit:g}: give one within '
                            'the joint_limits of the scene')

    def forces(self, t: float, q: np.ndarray, p: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Return the generalised forces of all motors at a state, shape (d,) [N] or [N m]."""
        f_q, f_p = np.zeros((2, p.size))
        for effect, own in self._effects:
            if isinstance(effect, Force):
                effect.add_force(own, t, q, p, velocity, f_q, f_p)
        return f_p

    @property
    def aim(self) -> Aim | None:
        """Return the current aim of a servo; None without one."""
        aims = (effect.aim(own) for effect, own in self._effects)
        return next((aim for aim in aims if aim is not None), None)
