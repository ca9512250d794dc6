# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Order in which a function of the user takes coordinates and momenta, by their names."""

from collections.abc import Callable
import inspect
import re
from typing import Any

TIMES = frozenset({'t', 'time'})
TIME_DEPENDENT = ('{!r} names the time, on which H(q, p) cannot depend: give a force that '
                  'oscillates as the effect periodic_drive, and any other as commands of '
                  'external_force')
_COORDINATES = re.compile(r'q|q_?[\dxyz]|q_\w+|pos\w*|coord\w*')
_MOMENTA = re.compile(r'p|p_?[\dxyz]|p_\w+|mom\w*')
_VELOCITIES = re.compile(r'v|v_?[\dxyz]|vel\w*|\w+dot|d[qx]')


def call_order(function: Callable[..., Any]) -> tuple[int, str]:
    """
    Return the order of the arguments of H, and a remark.

    Returns
    -------
    int, str
        1 for (q, p), -1 for (p, q), 0 for another number of arguments; and a remark if the names
        do not tell, '' otherwise.

    Raises
    ------
    ValueError
        An argument is the time or a velocity.

    """
    try:
        given = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        # Scripted modules have no signature.
        return 0, ''
    for one in given:
        if one.name in TIMES and one.default is not None:
            raise ValueError(TIME_DEPENDENT.format(one.name))
    names = [one.name for one in given if one.default is one.empty and one.kind in (
        one.POSITIONAL_ONLY, one.POSITIONAL_OR_KEYWORD)]
    if len(names) != 2:
        return 0, ''
    first, second = (name.lower() for name in names)
    for name in names:
        if _VELOCITIES.fullmatch(name.lower()):
            raise ValueError(f'{name!r} names a velocity, and H(q, p) takes momenta: write H with '
                             'p = dL/dv, and start at velocities with initial_state {q, v}')
    if _MOMENTA.fullmatch(first) and not _MOMENTA.fullmatch(second):
        return -1, ''
    if _COORDINATES.fullmatch(first) or _MOMENTA.fullmatch(second):
        return 1, ''
    return 1, f'the arguments {first}, {second} of H are taken as q, p; name them so'
