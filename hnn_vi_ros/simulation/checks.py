# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Validation of arguments from Python callers."""

from numbers import Integral, Real
import sys
from typing import Any

import numpy as np


def check_seconds(name: str, value: float) -> None:
    """
    Check that a value is a non-negative number of seconds.

    Parameters
    ----------
    name : str
        Name of the argument.
    value : float
        Value of the argument [s].

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
    Check that a value is a positive integer.

    Parameters
    ----------
    name : str
        Name of the argument.
    value : int
        Value of the argument.

    Raises
    ------
    TypeError, ValueError
        Not an integer; less than 1.

    """
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise TypeError(f'{name} = {value!r} must be a whole number')
    if value < 1:
        raise ValueError(f'{name} = {value} must be at least 1')


def check_numbers(name: str, values: Any) -> np.ndarray:
    """
    Return numbers as a new float64 array, or raise TypeError.

    Parameters
    ----------
    name : str
        Name of the argument.
    values : sequence of float, of any depth
        Value of the argument.

    Raises
    ------
    TypeError
        Values that are not numbers, masked or too large, or lists of different lengths.

    """
    try:
        array = np.asarray(values)
        # numpy would discard imaginary parts and convert strings and dates.
        if array.dtype.kind not in 'biufO' or np.ma.is_masked(values):
            raise TypeError
        return np.array(array, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        text = ' '.join(repr(values).split())
        raise TypeError(f'{name} = {text:.80} must be numbers in an array, or in lists of '
                        'equal lengths') from None
