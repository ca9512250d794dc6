# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Blocks of memory: values as numba lays them out, for code that is given their addresses."""

from typing import Any

from hnn_vi_ros.kernels.bare_arrays import without_owners
from hnn_vi_ros.kernels.linking import Part
from llvmlite import ir
import numba
from numba.core import types
from numba.core.registry import cpu_target
from numba.extending import intrinsic
import numpy as np


class Block(bytearray):
    """Memory that holds a value as numba lays it out."""

    @property
    def words(self) -> np.ndarray:
        """Return the memory as an array of int64, which keeps it."""
        return np.frombuffer(self, dtype=np.int64)

    @staticmethod
    def of(words: np.ndarray) -> 'Block':
        """Return the memory of an array of its words."""
        base: Any = words.base
        memory: Any = base.obj if isinstance(base, memoryview) else base
        assert isinstance(memory, Block)
        return memory


def check_words(kind: types.Type, count: int) -> None:
    """Raise TypeError if a value of a type takes another number of words in memory."""
    context = cpu_target.target_context
    if context.get_abi_sizeof(context.get_data_type(kind)) != 8 * count:
        raise TypeError('parameters of a kernel that are no whole words: truth values '
                        'beside each other; give them as int')


def flat(value: object) -> list[int]:
    """
    Return a value as words, as numba lays it out in memory; arrays without an owner.

    Parameters
    ----------
    value : tuple
        Numbers, arrays, functions, and tuples of such.

    Raises
    ------
    TypeError
        Something else is among them.

    """
    if isinstance(value, tuple):
        return [word for part in value for word in flat(part)]
    if isinstance(value, np.ndarray):
        return [0, 0, value.size, value.itemsize, value.ctypes.data, *value.shape, *value.strides]
    if isinstance(value, float):
        return [int(np.float64(value).view(np.int64))]
    # A truth value is a byte, padded to a word unless another one follows; see check_words.
    if isinstance(value, int | np.integer):
        return [int(value)]
    if callable(value):
        return [0]
    raise TypeError(f'{type(value).__name__} in the parameters of a kernel; valid: int, float, '
                    'numpy arrays, functions, and tuples of such')


@intrinsic
def load(_context: Any, block: Any, kind: Any) -> Any:
    """Return the value that stands at an address, its arrays as plain memory; see bare."""
    def generate(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Any
                 ) -> ir.Value:
        model = context.data_model_manager[signature.return_type]
        pointer = builder.inttoptr(arguments[0], model.get_data_type().as_pointer())
        value = model.load_from_data_pointer(builder, pointer)
        return without_owners(context, builder, signature.return_type, value)
    return kind.instance_type(block, kind), generate


@Part
def array_at(address: int, n: int) -> np.ndarray:
    return numba.carray(_pointer(address), (n,))


@intrinsic
def _pointer(_context: Any, address: Any) -> Any:
    def generate(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Any
                 ) -> ir.Value:
        return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))
    return types.CPointer(types.float64)(address), generate
