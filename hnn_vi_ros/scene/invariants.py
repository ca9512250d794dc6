# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Invariants of a motion besides H: the known ones of a system, and the user's own functions."""

from collections.abc import Callable, Sequence
import math
from typing import Annotated

from hnn_vi_ros.errors import listed, SceneError
from hnn_vi_ros.files.named_code import NAMES_CODE
from hnn_vi_ros.files.yaml_file import StrictModel
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.scene.choices import load_code
import numpy as np
from pydantic import Field, StringConstraints


class InvariantChoice(StrictModel):
    """Something that the motion conserves besides H."""

    name: str = Field(pattern=r'^[^\W\d]\w*$', max_length=100, description=(
        'what it is called; without a function, a known one of the system'))
    function: Annotated[str, NAMES_CODE, StringConstraints(
        pattern=r'^[\w.]+:\w+$')] | None = Field(None, description=(
            'package.module:function of yours; takes q and p, arrays of d numbers each, and '
            'returns a number'))


class Invariant:
    """
    A user's function of the state, called with arrays that it may keep or change.

    Parameters
    ----------
    function : callable
        Of q and p, each of shape (d,).
    where : str
        Where the scene names it, for errors.

    """

    def __init__(self, function: Callable[[np.ndarray, np.ndarray], float], where: str):
        self._function, self._where = function, where

    def __call__(self, q: np.ndarray, p: np.ndarray) -> float:
        """Return its value, NaN where its arithmetic fails; SceneError where it is no number."""
        try:
            value = self._function(q.copy(), p.copy())
            # A power of a negative number is complex.
            return math.nan if isinstance(value, complex) else float(value)
        except (ArithmeticError, ValueError):
            # Such as that of math.sqrt and math.acos.
            return math.nan
        except (Exception, SystemExit) as problem:  # noqa: B902  the user's code may raise any
            raise SceneError(f'{self._where}: {type(problem).__name__}: '
                             f'{" ".join(str(problem).split())}, at q = {q.tolist()}, '
                             f'p = {p.tolist()}') from problem


def invariants_of(choices: Sequence[InvariantChoice], hamiltonian: Hamiltonian, alone: bool,
                  state: tuple[np.ndarray, np.ndarray], place: Callable[..., str],
                  folder: str | None) -> dict[str, Callable[[np.ndarray, np.ndarray], float]]:
    """
    Return the invariants of a scene by name, each a function of q and p, of shape (d,).

    Parameters
    ----------
    choices : sequence of InvariantChoice
        The scene's invariants.
    hamiltonian : Hamiltonian
        H, whose known invariants count where nothing else acts.
    alone : bool
        Whether no effect acts on the system.
    state : tuple of np.ndarray, shape (d,)
        The initial q and p, with which each function is tried.
    place : callable
        Returns where a key of the scene stands, for errors.
    folder : str or None
        Where a module is found that is not installed, if anywhere.

    Raises
    ------
    SceneError
        A name that stands twice or is not known, or a function that cannot be imported or called.

    """
    known = hamiltonian.known_invariants
    found = dict(known) if alone else {}
    for index, choice in enumerate(choices):
        where = place('invariants', index)
        if choice.name in [other.name for other in choices[:index]]:
            raise SceneError(f'{where}: {choice.name} stands twice; give it another name')
        if choice.function is not None:
            where = f'{where}: {choice.function}'
            found[choice.name] = own = Invariant(
                load_code(choice.function, place('invariants', index), folder), where)
            if not math.isfinite(value := own(*state)):
                raise SceneError(f'{where}: is {value} at the initial state; return a finite '
                                 'number')
        elif choice.name in known:
            found[choice.name] = known[choice.name]
        else:
            raise SceneError(f'{where}: no invariant {choice.name!r} of this system is known; '
                             f'known: {listed(known) or "none"}; or give a function')
    return found
