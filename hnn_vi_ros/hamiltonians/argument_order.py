# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Order in which a function of the user takes coordinates and momenta, by their names."""

from collections.abc import Callable
import inspect
import re
from typing import Any

TIME, TIMES = 't', frozenset({'t', 'time'})
TIME_DEPENDENT = ('{!r} names the time, on which only H of a scene can depend, as t: give a force '
                  'that oscillates as the effect periodic_drive, and any other as commands of '
                  'external_force')
_COORDINATES = re.compile(r'q|q_?[\dxyz]|q_\w+|pos\w*|coord\w*')
_MOMENTA = re.compile(r'p|p_?[\dxyz]|p_\w+|mom\w*')
_VELOCITIES = re.compile(r'v|v_?[\dxyz]|vel\w*|\w+dot|d[qx]')


def call_order(function: Callable[..., Any]) -> tuple[int, bool, str]:
    """
    Return the order of the arguments of H, whether the time is the last one, and a remark.

    Returns
    -------
    int, bool, str
        1 for (q, p), -1 for (p, q), 0 for another number of arguments; True for a further last
        argument t; and a remark if the names do not tell, '' otherwise.

    Raises
    ------
    ValueError
        The time is not the last argument, or an argument is a velocity.

    """
    try:
        given = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        # Scripted modules have no signature.
        return 0, False, ''
    names = [one.name for one in given if one.kind in (
        one.POSITIONAL_ONLY, one.POSITIONAL_OR_KEYWORD) and (
        one.default is one.empty or (one.name in TIMES and one.default is not None))]
    timed = bool(TIMES.intersection(names))
    if timed and names.pop() not in TIMES:
        raise ValueError(f'H({", ".join([*names, "..."])}): give the time last, as in H(q, p, t)')
    if len(names) != 2:
        return 0, timed, ''
    first, second = (name.lower() for name in names)
    for name in names:
        if _VELOCITIES.fullmatch(name.lower()):
            raise ValueError(f'{name!r} names a velocity, and H(q, p) takes momenta: write H with '
                             'p = dL/dv, and start at velocities with initial_state {q, v}')
    if _MOMENTA.fullmatch(first) and not _MOMENTA.fullmatch(second):
        return -1, timed, ''
    if _COORDINATES.fullmatch(first) or _MOMENTA.fullmatch(second):
        return 1, timed, ''
    return 1, timed, f'the arguments {first}, {second} of H are taken as q, p; name them so'
