# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Arguments of a function H of the user: coordinates, momenta and the time, by their names."""

from collections.abc import Callable, Sequence
from functools import partial
import inspect
import re
from typing import Any, NamedTuple

TIME, TIMES = 't', frozenset({'t', 'time'})
TIME_DEPENDENT = ('{!r} names the time, on which only H of a scene can depend, as t: give a force '
                  'that oscillates as the effect periodic_drive, and any other as commands of '
                  'external_force')
_COORDINATES = re.compile(
    r'[qxyzrs]|[qxyz]s|[qxyzrs]_?\d|q_[xyz]|pos(itions?)?|coord(inate)?s?|angles?|th|theta|phi|psi'
    r'|alpha|beta|[θφϕψα]')
_MOMENTA = re.compile(r'ps?|p_?[\dxyz]|mom|moment(um|a)')
# Names of one vector that is not (q, p).
_OTHER_VECTORS = re.compile(r'[qpv]|p_?q|[qx]_?(v|d[qx]?|[qx]?_?dot)')


class Arguments(NamedTuple):
    """
    Arguments of H.

    Parameters
    ----------
    order : int
        1 for (q, p), -1 for (p, q), 0 for one vector (q, p).
    places : tuple of bool
        Positional arguments: True for the time, False for the next part of the state.
    keyword : str
        Name of the time if it is given by keyword, else ''.

    """

    order: int
    places: tuple[bool, ...]
    keyword: str

    @property
    def timed(self) -> bool:
        """Return whether H takes the time."""
        return any(self.places) or bool(self.keyword)

    def call(self, function: Callable[..., Any], state: Sequence[Any], t: Any = None) -> Any:
        """Return H of a state, (q, p) or (z,), at the time t."""
        parts = iter(state[::self.order or 1])
        return function(*(t if timed else next(parts) for timed in self.places),
                        **({self.keyword: t} if self.keyword else {}))


def read_arguments(function: Callable[..., Any]) -> Arguments:
    """
    Return the arguments of H; those with default values, except the time, are constants.

    Raises
    ------
    ValueError
        The names do not show which arguments are coordinates, momenta and the time.

    """
    given = _parameters(function)
    shown = f'H({", ".join(map(_text, given))})'
    times = [one for one in given if one.name in TIMES]
    bound = function.keywords if isinstance(function, partial) else {}
    if len(times) > 1 or any(one.name in bound or not (
            one.default is one.empty or (one.kind is not one.POSITIONAL_ONLY
            and (one.default is None or one.default == 0.0))) for one in times):
        raise ValueError(f'{shown}: the time is one argument t, without a value or with t=0.0; '
                         'give a constant another name than t or time')
    states = [one for one in given if one.default is one.empty and one.name not in TIMES]
    if len(states) not in (1, 2) or any(one.kind is one.KEYWORD_ONLY for one in states):
        raise ValueError(f'{shown}: expected the arguments (q, p), and t if H depends on the time;'
                         ' bind others with functools.partial')
    return Arguments(
        _order(shown, [one.name.lower() for one in states]),
        tuple(one.name in TIMES for one in given if one.default is one.empty
              and one.kind is not one.KEYWORD_ONLY),
        next((one.name for one in times if one.kind is one.KEYWORD_ONLY
              or one.default is not one.empty), ''))


def _text(one: inspect.Parameter) -> str:
    """Return a parameter in a line, without its type."""
    return ' '.join(str(one.replace(annotation=one.empty)).split())[:40]


def _parameters(function: Callable[..., Any]) -> list[inspect.Parameter]:
    """Return the parameters of a function, also of one of numpy.vectorize or of TorchScript."""
    function = getattr(function, 'pyfunc', function)
    try:
        # A wrapper may have other arguments than the function that it wraps.
        given = [*inspect.signature(function, follow_wrapped=False).parameters.values()]
    except (TypeError, ValueError):
        arguments = getattr(getattr(function, 'schema', None), 'arguments', None)
        given = [inspect.Parameter('_', inspect.Parameter.VAR_POSITIONAL)] if arguments is None \
            else [inspect.Parameter(
                one.name, inspect.Parameter.POSITIONAL_OR_KEYWORD,
                default=one.default_value if one.has_default_value() else inspect.Parameter.empty)
                for one in arguments if one.name != 'self']
    if any(one.kind in (one.VAR_POSITIONAL, one.VAR_KEYWORD) for one in given):
        if wrapped := getattr(function, '__wrapped__', None):
            return _parameters(wrapped.__get__(function.__self__) if inspect.ismethod(function)
                               else wrapped)
        raise ValueError(f'H({", ".join(map(_text, given))}): the names of its arguments are '
                         'hidden; give the function or module that it calls, or write H(q, p)')
    return given


def _order(shown: str, names: Sequence[str]) -> int:
    """Return 1 for (q, p), -1 for (p, q), 0 for one vector."""
    if len(names) == 1:
        if _OTHER_VECTORS.fullmatch(names[0]):
            raise ValueError(f'{shown}: {names[0]!r} names another vector than (q, p), with which '
                             'it is called; write H(q, p), or rename it x')
        return 0
    for order in (1, -1):
        q, p = names[::order]
        own = p in (f'p{q}', f'p_{q}')
        if (own or _COORDINATES.fullmatch(q)) and (own or _MOMENTA.fullmatch(p)):
            return order
    raise ValueError(f'{shown}: the names do not tell coordinates from momenta; rename them as '
                     'in (q, p), (p, q) or (x, p_x); of a velocity v write H with p = dL/dv, and '
                     'start at velocities with initial_state {q, v}')
