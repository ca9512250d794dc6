# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Blocks of memory: values in numba's layout, for code that is given their addresses."""

from functools import cache
from typing import Any, TypeVar

from hnn_vi_ros.kernels.linking import LINK_ONLY, Part, without_owners
from llvmlite import ir
import numba
from numba.core import cgutils, types
from numba.core.registry import cpu_target
from numba.extending import intrinsic, overload
import numpy as np

_Value = TypeVar('_Value')


def bare(value: _Value) -> _Value:
    """
    Return the value with all arrays in it, at any depth of tuples, as arrays without owner.

    Call it once, at the top of a loop that is called from Python and returns no array: its caller
    owns the arrays until it returns. Compiled code counts a reference whenever an array is named,
    sliced or passed on, and each count is an atomic operation on memory. If the owner is a null
    known to the compiler, these operations are removed. In plain Python the value is returned
    unchanged.

    Parameters
    ----------
    value : any
        An array, a number, a function, or a tuple of these.

    """
    return value


@overload(bare, jit_options={'forceinline': True, **LINK_ONLY})
def _bare(value: Any) -> Any:
    def borrowed(value: Any) -> Any:
        # As all that a part returns.
        return value
    return borrowed


_known: dict[Any, types.Type] = {}


def type_of(value: object) -> types.Type:
    """Return ``numba.typeof`` of a value, ten times as fast for tuples of many arrays."""
    key = kind_of(value)
    if key not in _known:
        _known[key] = numba.typeof(value)
    return _known[key]


def kind_of(value: object) -> Any:
    """Return a cache key that determines the type of a value, without its size or contents."""
    if isinstance(value, tuple):
        return type(value), *map(kind_of, value)
    if type(value) is np.ndarray:
        return value.dtype, value.ndim, value.flags.num
    # For an integer the value also determines the type.
    return float if type(value) is float else numba.typeof(value)


class Block(bytearray):
    """
    Memory that contains a value in numba's layout.

    Attributes
    ----------
    held : any
        Objects that own the memory at the addresses in it.

    """

    held: Any

    @property
    def words(self) -> np.ndarray:
        """Return the memory as an array of int64 that keeps it alive."""
        return np.frombuffer(self, dtype=np.int64)

    @staticmethod
    def of(words: np.ndarray) -> 'Block':
        """Return the memory of an array of its words."""
        base: Any = words.base
        memory: Any = base.obj if isinstance(base, memoryview) else base
        assert isinstance(memory, Block)
        return memory


def block(value: Any, *before: int) -> np.ndarray:
    """
    Return the words of a value, after given words, in memory that keeps its arrays alive.

    Parameters
    ----------
    value : tuple
        See flat.
    *before : int
        Words that precede it.

    """
    memory = Block(np.array([*before, *flat(value)], dtype=np.int64).tobytes())
    memory.held = value
    return memory.words


def check_words(kind: types.Type, count: int) -> None:
    """Raise TypeError if a value of a type has another number of words in memory."""
    if _size_of(kind) != 8 * count:
        raise TypeError('parameters of a kernel and options of a step must not contain adjacent '
                        'bools, which do not fill whole words; give them as int')


@cache
def _size_of(kind: types.Type) -> int:
    """Return the size of a value of a type in bytes."""
    context = cpu_target.target_context
    return context.get_abi_sizeof(context.get_data_type(kind))


def flat(value: object) -> list[int]:
    """
    Return a value as words in numba's memory layout; arrays have no owner.

    Parameters
    ----------
    value : tuple
        Numbers, arrays, functions, and tuples of these.

    Raises
    ------
    TypeError
        The value contains anything else.

    """
    if isinstance(value, tuple):
        return [word for part in value for word in flat(part)]
    if isinstance(value, np.ndarray):
        return [0, 0, value.size, value.itemsize, value.ctypes.data, *value.shape, *value.strides]
    if isinstance(value, float):
        return [int(np.float64(value).view(np.int64))]
    # A bool is a byte, padded to a word unless another one follows; see check_words.
    if isinstance(value, int | np.integer):
        return [int(value)]
    if callable(value):
        return [0]
    raise TypeError(f'{type(value).__name__} in the parameters of a kernel; valid: int, float, '
                    'numpy arrays, functions, and tuples of these')


@intrinsic
def load(_context: Any, block: Any, kind: Any) -> Any:
    """Return the value at an address, with arrays that have no owner; see bare."""
    def generate(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Any) -> ir.Value:
        model = context.data_model_manager[signature.return_type]
        pointer = builder.inttoptr(arguments[0], model.get_data_type().as_pointer())
        value = model.load_from_data_pointer(builder, pointer)
        return without_owners(context, builder, signature.return_type, value)
    return kind.instance_type(block, kind), generate


@Part
def array_at(address: int, shape: Any) -> np.ndarray:
    return numba.carray(_pointer(address), shape)


@intrinsic
def _pointer(_context: Any, address: Any) -> Any:
    def generate(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Any) -> ir.Value:
        return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))
    return types.CPointer(types.float64)(address), generate


@intrinsic
def address_of(_context: Any, array: Any) -> Any:
    """Return the address of the elements of a contiguous array."""
    if array.ndim != 1 or array.dtype not in (types.float64, types.int64):
        raise numba.TypingError(f'{array} by address, expected float64 and shape (n,)')

    def generate(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Any) -> ir.Value:
        part = context.make_array(signature.args[0])(context, builder, arguments[0])
        if signature.args[0].layout != 'C':  # numba does not know a row is contiguous
            step = builder.extract_value(part.strides, 0)
            strided = builder.icmp_signed('!=', step, part.itemsize)
            with builder.if_then(strided, likely=False):
                context.call_conv.return_user_exc(
                    builder, ValueError, ('an array by address is not contiguous',))
        return builder.ptrtoint(part.data, context.get_value_type(types.int64))
    return types.int64(array), generate


@intrinsic
def clear(_context: Any, address: Any) -> Any:
    """Write a zero of 64 bits to an address."""
    def generate(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Any) -> ir.Value:
        word = context.get_value_type(types.int64)
        builder.store(ir.Constant(word, 0), builder.inttoptr(arguments[0], word.as_pointer()))
        return context.get_dummy_value()
    return types.none(address), generate


def entry_caller(result: types.Type) -> Any:
    """Return the intrinsic that calls an entry with this result type at an address."""
    @intrinsic
    def call(_context: Any, address: Any, words: Any) -> Any:
        def generate(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Any
                     ) -> ir.Value:
            kinds = signature.args[1].types
            pointer = context.call_conv.get_function_type(result, kinds).as_pointer()
            status, value = context.call_conv.call_function(
                builder, builder.inttoptr(arguments[0], pointer), result, kinds,
                [builder.extract_value(arguments[1], i) for i in range(len(kinds))])
            with builder.if_then(status.is_error, likely=False):
                context.call_conv.return_status_propagate(builder, status)
            return context.get_dummy_value() if result is types.none else value
        return result(address, words), generate
    return call


def row_multiplier(count: int) -> Any:
    """
    Return the intrinsic that multiplies some rows of a matrix by another matrix.

    Its arguments are the address of the first row, the bytes between rows and between columns, the
    number of columns, the addresses of the other matrix and of the product, and their number of
    columns, a multiple of 8. Eight sums of each row stay in registers; no Python loop compiles to
    that.
    """
    @intrinsic
    def multiply(_context: Any, rows: Any, across: Any, along: Any, n: Any, factor: Any,
                 product: Any, lanes: Any) -> Any:
        def generate(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Any
                     ) -> ir.Value:
            rows, across, along, n, factor, product, lanes = arguments
            word, index, real = rows.type, ir.IntType(32), ir.DoubleType()
            vector = ir.VectorType(real, 8)
            undefined, first = vector(ir.Undefined), ir.VectorType(index, 8)(None)
            line = builder.mul(lanes, word(8))

            def at(base: ir.Value, step: ir.Value, k: ir.Value, kind: ir.Type) -> ir.Value:
                address = builder.add(base, builder.mul(step, k))
                return builder.inttoptr(address, kind.as_pointer())
            with cgutils.for_range(builder, builder.udiv(lanes, word(8))) as eight:
                right, below = (builder.add(base, builder.mul(eight.index, word(64)))
                                for base in (factor, product))
                sums = [cgutils.alloca_once_value(builder, vector(None)) for _ in range(count)]
                with cgutils.for_range(builder, n) as column:
                    values = builder.load(at(right, line, column.index, vector), align=8)
                    left = builder.add(rows, builder.mul(along, column.index))
                    for i, total in enumerate(sums):
                        weight = builder.insert_element(undefined, builder.load(
                            at(left, across, word(i), real)), index(0))
                        added = builder.fmul(builder.shuffle_vector(
                            weight, undefined, first), values, flags=('contract',))
                        builder.store(builder.fadd(
                            builder.load(total), added, flags=('contract',)), total)
                for i, total in enumerate(sums):
                    builder.store(builder.load(total), at(below, line, word(i), vector), align=8)
            return context.get_dummy_value()
        return types.none(rows, across, along, n, factor, product, lanes), generate
    return multiply
