# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Types of values that are kept: they are numba's, of values that only look alike as well."""

from typing import NamedTuple

from hnn_vi_ros.kernels import kind_of, type_of
import numba
import numpy as np


class One(NamedTuple):
    """A pair."""

    a: object
    b: object


class Other(NamedTuple):
    """Another pair."""

    a: object
    b: object


@numba.njit
def function() -> int:
    return 1


def values() -> list[object]:
    matrix = np.zeros((3, 4))
    fixed = np.zeros(3)
    fixed.setflags(write=False)
    odd = np.zeros(25, dtype=np.int8)[1:].view(np.float64)
    arrays = [np.zeros(3), np.zeros(3, dtype=np.float32), np.zeros(3, dtype=np.int64), fixed, odd,
              matrix, np.asfortranarray(matrix), matrix[:, 0], matrix[::2], np.zeros(()),
              np.zeros((1, 1)), np.zeros(0)]
    numbers = [1, 1.0, True, 2**63, -1, np.float64(1.0), np.float32(1.0), np.int64(1),
               np.bool_(True)]
    pairs = [kind(array, 1.0) for kind in (One, Other) for array in arrays]
    return [*arrays, *numbers, *pairs, (), ((),), (One(1.0, (2, fixed)), function), function]


def test_kept_types_are_those_of_numba():
    # Twice: as they are found, and as they are kept, after all that could be taken for them.
    for value in values() * 2:
        assert type_of(value) == numba.typeof(value), value


def test_values_of_one_kind_are_of_one_type():
    found: dict = {}
    for value in values():
        assert found.setdefault(kind_of(value), numba.typeof(value)) == numba.typeof(value)
    # Neither sizes nor contents tell kinds apart.
    assert kind_of((np.zeros(3), 1.0)) == kind_of((np.ones(7), 2.0))
