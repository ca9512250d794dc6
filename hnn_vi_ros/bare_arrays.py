# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Arrays without owners: inside a compiled loop nothing counts who uses them."""

from typing import Any, TypeVar

from hnn_vi_ros.linking import LINK_ONLY
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.base import BaseContext
from numba.extending import intrinsic, overload

_Value = TypeVar('_Value')


def bare(value: _Value) -> _Value:
    """
    Return the value with all arrays in it, however deep in tuples, as plain memory.

    To be called once, at the top of a loop that is called from Python and returns no array: its
    caller holds the arrays until it returns. Compiled code counts a reference wherever an array
    is named, sliced or passed on, and each count is an atomic operation on memory. Without an
    owner, a null that the compiler knows, all that is deleted. Run as plain Python, nothing
    happens.

    Parameters
    ----------
    value : any
        An array, a number, a function, or a tuple of such.

    """
    return value


@overload(bare, jit_options={'forceinline': True, **LINK_ONLY})
def _bare(value):
    def without_owners(value):
        return _replace_owners(value)
    return without_owners


@intrinsic
def _replace_owners(_context, value):
    def generate(context, builder, signature, arguments):
        replaced = _replaced(context, builder, signature.return_type, arguments[0])
        # What is no array keeps its count: the result is a reference of its own.
        context.nrt.incref(builder, signature.return_type, replaced)
        return replaced
    return value(value), generate


def _replaced(context: BaseContext, builder: ir.IRBuilder, kind: types.Type, value: Any) -> Any:
    """Return a value of numba's type ``kind`` with null owners."""
    if isinstance(kind, types.Array):
        array = cgutils.create_struct_proxy(kind)(context, builder, value=value)
        array.meminfo = cgutils.get_null_value(array.meminfo.type)
        array.parent = cgutils.get_null_value(array.parent.type)
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        for k, part in enumerate(kind.types):
            new = _replaced(context, builder, part, builder.extract_value(value, k))
            value = builder.insert_value(value, new, k)
    return value
