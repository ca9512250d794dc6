# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of the arguments of Hamiltonians, integrators and effects, by the user's names."""

from collections.abc import Callable, Sequence
import math

import numpy as np

Numbers = float | Sequence[float]


def check_positive(**values: Numbers) -> None:
    """Raise ValueError with the name of the first value that is not positive and finite."""
    _check(values, lambda value: value > 0.0, 'a positive number')


def check_not_negative(**values: Numbers) -> None:
    """Raise ValueError with the name of the first value that is negative or not finite."""
    _check(values, lambda value: value >= 0.0, 'at least 0 and finite')


def check_finite(**values: Numbers) -> None:
    """Raise ValueError with the name of the first value that is not finite."""
    _check(values, lambda value: True, 'a finite number')


def check_between(low: float, high: float, /, **values: Numbers) -> None:
    """Raise ValueError with the name of the first value outside the range from low to high."""
    _check(values, lambda value: low <= value <= high, f'from {low} to {high}')


def _check(values: dict[str, Numbers], holds: Callable[[float], bool], what: str) -> None:
    for name, value in values.items():
        if not all(math.isfinite(one) and holds(one) for one in np.ravel(value)):
            raise ValueError(f'{name} = {value} must be {what}')


def check_names_once(**names: Sequence[str]) -> None:
    """Raise ValueError for a list of names that is empty or contains duplicates."""
    for key, given in names.items():
        if not given or len(set(given)) < len(given):
            raise ValueError(f'{key} = {list(given)} must contain at least one name, each once')
