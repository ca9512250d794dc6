# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of what Python callers hand in, told in a sentence."""

import math
from numbers import Integral, Real
from typing import Any

import numpy as np


def check_seconds(name: str, value: float) -> None:
    """
    Raise unless a value is a number of seconds, at least 0.

    Parameters
    ----------
    name : str
        Of the argument.
    value : float
        What the caller gave [s].

    Raises
    ------
    TypeError, ValueError
        Not a number; negative or not finite.

    """
    if isinstance(value, bool) or not isinstance(value, Real):
        raise TypeError(f'{name} = {value!r} must be a number of seconds')
    if not (math.isfinite(value) and value >= 0.0):
        raise ValueError(f'{name} = {value} must be a number of seconds, at least 0')


def check_count(name: str, value: int) -> None:
    """
    Raise unless a value is a whole number, at least 1.

    Parameters
    ----------
    name : str
        Of the argument.
    value : int
        What the caller gave.

    Raises
    ------
    TypeError, ValueError
        Not a whole number; less than 1.

    """
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise TypeError(f'{name} = {value!r} must be a whole number')
    if value < 1:
        raise ValueError(f'{name} = {value} must be at least 1')


def check_numbers(name: str, values: Any) -> np.ndarray:
    """
    Return numbers as a fresh array of float64, or raise.

    Parameters
    ----------
    name : str
        Of the argument.
    values : sequence of float, of any depth
        What the caller gave.

    Raises
    ------
    TypeError
        Not numbers, or lists of different lengths.

    """
    try:
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise TypeError(f'{name} = {values!r:.80} must be numbers, as an array or as lists of '
                        'equal lengths') from None
