# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Arrays without owners: inside a compiled loop nothing counts who uses them."""

from typing import Any, TypeVar

from hnn_vi_ros.kernels.linking import LINK_ONLY
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
def _bare(value: Any) -> Any:
    def replace_owners(value: Any) -> Any:
        return _replace_owners(value)
    return replace_owners


@intrinsic
def _replace_owners(_context: Any, value: Any) -> Any:
    def generate(context: BaseContext, builder: ir.IRBuilder, signature: Any, arguments: Any
                 ) -> ir.Value:
        return without_owners(context, builder, signature.return_type, arguments[0])
    return value(value), generate


def without_owners(context: BaseContext, builder: ir.IRBuilder, kind: types.Type,
                   value: ir.Value, place: tuple[int, ...] = ()) -> ir.Value:
    """Return a value, of numba's type ``kind`` at this place in it, with null owners there."""
    if isinstance(kind, types.Array):
        model = context.data_model_manager[kind]
        for owner in ('meminfo', 'parent'):
            null = cgutils.get_null_value(context.get_value_type(model.get_type(owner)))
            value = builder.insert_value(value, null, (*place, model.get_field_position(owner)))
    elif isinstance(kind, types.BaseTuple):
        for k, part in enumerate(kind.types):
            value = without_owners(context, builder, part, value, (*place, k))
    elif context.data_model_manager[kind].contains_nrt_meminfo():
        # Anything but an array keeps its count: the result is a reference of its own.
        context.nrt.incref(builder, kind, builder.extract_value(value, place) if place else value)
    return value
