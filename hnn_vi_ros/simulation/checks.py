# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of what Python callers hand in, told in a sentence."""

from numbers import Integral, Real
import sys
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
        The caller's value [s].

    Raises
    ------
    TypeError, ValueError
        Not a number; negative or not finite.

    """
    if isinstance(value, bool) or not isinstance(value, Real):
        raise TypeError(f'{name} = {value!r} must be a number of seconds')
    if not 0 <= value <= sys.float_info.max:
        raise ValueError(f'{name} = {value!s:.40} must be a number of seconds, at least 0')


def check_count(name: str, value: int) -> None:
    """
    Raise unless a value is a whole number, at least 1.

    Parameters
    ----------
    name : str
        Of the argument.
    value : int
        The caller's argument.

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
        The caller's argument.

    Raises
    ------
    TypeError
        Not numbers, some that are masked or too large, or lists of different lengths.

    """
    try:
        array = np.asarray(values)
        # numpy would drop imaginary parts, and read texts and dates.
        if array.dtype.kind not in 'biufO' or np.ma.is_masked(values):
            raise TypeError
        return np.array(array, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        text = ' '.join(repr(values).split())
        raise TypeError(f'{name} = {text:.80} must be numbers, as an array or as lists of '
                        'equal lengths') from None
