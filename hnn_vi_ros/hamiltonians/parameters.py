# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of the constants that define a Hamiltonian."""

import math


def check_positive(**values: float) -> None:
    """
    Raise unless every value is positive and finite.

    Parameters
    ----------
    **values : float
        Constants by the name that the user gave them.

    Raises
    ------
    ValueError
        Names the first constant that is not, with its value.

    """
    for name, value in values.items():
        if not (math.isfinite(value) and value > 0.0):
            raise ValueError(f'{name} = {value} must be a positive number')


def check_not_negative(**values: float) -> None:
    """
    Raise unless every value is finite and at least zero.

    Parameters
    ----------
    **values : float
        Constants by the name that the user gave them.

    Raises
    ------
    ValueError
        Names the first constant that is not, with its value.

    """
    for name, value in values.items():
        if not (math.isfinite(value) and value >= 0.0):
            raise ValueError(f'{name} = {value} must be a finite number of at least 0')


def check_finite(**values: float) -> None:
    """
    Raise unless every value is finite.

    Parameters
    ----------
    **values : float
        Constants by the name that the user gave them.

    Raises
    ------
    ValueError
        Names the first constant that is not, with its value.

    """
    for name, value in values.items():
        if not math.isfinite(value):
            raise ValueError(f'{name} = {value} must be a finite number')
