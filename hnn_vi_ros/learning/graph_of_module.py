# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
The graph of a torch module: traced by ``make_fx``, and translated to the operations of graphs.

Values that do not depend on the input are computed by torch. All operations that only move values
are translated in one way: applied to the numbers of the values, they give the index of a ``take``.
"""

from collections.abc import Callable, Sequence
from functools import partial, partialmethod
from itertools import accumulate
import math
from operator import getitem, mul
from pathlib import Path
import re
import traceback
from typing import Any, NoReturn

from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.learning.linear_systems import eliminated, LINEAR_SYSTEMS
from hnn_vi_ros.models import Builder
import numpy as np
import torch
from torch._decomp import core_aten_decompositions, get_decompositions
from torch.fx.experimental.proxy_tensor import make_fx
from torch.utils._python_dispatch import TorchDispatchMode

_aten = torch.ops.aten
# Kept whole, since they are operations of graphs, or since others are decomposed into less.
_WHOLE = (_aten.sigmoid, _aten.expm1, _aten.log1p, _aten.sqrt, _aten.erf, _aten.var,
          _aten.var_mean, _aten.softplus, _aten._softmax, _aten._log_softmax, _aten.logsumexp,
          _aten.linalg_vector_norm, _aten.elu, _aten.clamp, _aten.clamp_min, _aten.clamp_max,
          _aten.hardtanh, _aten.maximum, _aten.minimum, _aten.sinc, _aten.scatter, _aten.hypot,
          _aten.log_sigmoid_forward, _aten.xlogy)
_FURTHER = (
    _aten.native_layer_norm, _aten.gelu, _aten.silu,
    _aten.native_group_norm, _aten._native_batch_norm_legit_no_training, _aten.addmm,
    _aten.leaky_relu,
    _aten.baddbmm, _aten.hardsigmoid, _aten.hardswish,
    _aten.norm, _aten.std, _aten.mish,
    _aten._native_batch_norm_legit, _aten.native_batch_norm, _aten.addcmul,
    _aten.addcdiv, _aten.lerp, _aten.threshold, _aten.logaddexp, _aten.dot,
    _aten.mv, _aten.trace, _aten.diag_embed, _aten._adaptive_avg_pool2d)
# Operations that only move the values of their first argument, or of their tensors.
_MOVES = frozenset((
    '_reshape_alias', '_unsafe_index', '_unsafe_view', 'alias', 'as_strided',
    'as_strided_scatter', 'cat', 'chunk', 'clone', 'contiguous', 'copy', 'detach', 'diagonal',
    'diagonal_scatter', 'expand', 'flip', 'gather', 'index', 'index_put', 'index_select',
    'lift_fresh', 'movedim', 'narrow', 'permute', 'repeat', 'repeat_interleave', 'reshape',
    'roll', 'scatter', 'scatter_add', 'select', 'select_scatter', 'slice', 'slice_scatter',
    'split', 'split_with_sizes', 'squeeze', 'stack', 'swapaxes', 't', 'take', 'transpose',
    'unbind', 'unfold', 'unsqueeze', 'view'))
# Operations that see no values of their first argument, only its shape.
_SHAPED = frozenset((
    'empty_like', 'full_like', 'new_empty', 'new_full', 'new_ones', 'new_zeros', 'ones_like',
    'scalar_tensor', 'zeros_like'))
_UNARY = {name: name for name in (
    'neg', 'abs', 'sign', 'floor', 'ceil', 'reciprocal', 'sqrt', 'exp', 'expm1', 'log',
    'log1p', 'sin', 'cos', 'tan', 'asin', 'acos', 'atan', 'sinh', 'cosh', 'tanh', 'asinh',
    'sigmoid', 'erf', 'relu')} | {
        'round': 'rint', 'logical_not': 'not', 'bitwise_not': 'not', 'sgn': 'sign'}
_BINARY = {name: name for name in (
    'mul', 'atan2', 'lt', 'le', 'gt', 'ge', 'eq', 'ne', 'maximum', 'minimum', 'pow')} | {
    'fmax': 'maximum', 'fmin': 'minimum'}

# Positions of the arguments whose values they move; the first one of others.
_PLACES_OF_VALUES = {
    'as_strided_scatter': (0, 1), 'copy': (0, 1), 'diagonal_scatter': (0, 1), 'index_put': (0, 2),
    'scatter': (0, 3), 'scatter_add': (0, 3), 'select_scatter': (0, 1), 'slice_scatter': (0, 1)}


class UntranslatedModule(ModelError):
    """A module with an operation that graphs do not have."""


def graph_of(function: Callable[[torch.Tensor], torch.Tensor], states: torch.Tensor
             ) -> tuple[Builder, int]:
    """
    Trace a function of one vector, and return its graph and the output.

    Parameters
    ----------
    function : callable
        Returns a tensor of one value, for a tensor of shape (2 d,) in float64.
    states : torch.Tensor, shape (2, 2 d)
        Two states at which it is traced; both graphs must be the same.

    Raises
    ------
    ModelError
        The two graphs differ, or the function uses random numbers, or the values of its input
        decide what it computes.
    UntranslatedModule
        It has an operation that graphs do not have.

    """
    # TorchScript would change its graph from call to call.
    with torch.jit.optimized_execution(False):
        found = [_translated(_trace(function, state)) for state in states]
    (b, output), (other, other_output) = found
    if b.nodes != other.nodes or output != other_output or any(
            not np.array_equal(x, y, equal_nan=True)
            for x, y in zip(b.tensors, other.tensors, strict=True)):
        raise ModelError('its operations differ between two states: constants that change from '
                         'call to call (random numbers, counters), or Python code that looks at '
                         'values of its input; make it a function of tensors alone')
    return b, output


def _trace(function: Callable[[torch.Tensor], torch.Tensor], state: torch.Tensor
           ) -> torch.fx.GraphModule:
    table = {op: way for op, way in core_aten_decompositions().items()
             if op._overloadpacket not in _WHOLE} | get_decompositions(_FURTHER) | {
                 getattr(_aten, name).default: way for name, way in LINEAR_SYSTEMS.items()}

    def copied(z: torch.Tensor) -> torch.Tensor:
        # The function may change its argument.
        return function(z.clone())
    try:
        # Derivatives inside are traced first; changes in place are removed from what they call.
        traced = make_fx(copied, decomposition_table=table)(state.clone().requires_grad_(True))
        traced = make_fx(torch.func.functionalize(traced, remove='mutations_and_views'),
                         decomposition_table=table)(state)
        traced.graph.eliminate_dead_code()
        return traced
    except ModelError:
        raise
    except Exception as problem:  # noqa: B902  the user's code may raise any
        text, place = ' '.join(str(problem).split()), _place(problem)
        if 'tracing tensor' in text or 'data-dependent' in text:
            raise ModelError(
                f'Python code in it{place} branches on values of its input (if, float(x), '
                '.item(), one_hot): write it with torch.where') from problem
        if 'non-functional tensor' in text:
            raise ModelError(f'changes a buffer or a weight{place}: compute H in forward, and '
                             'nothing else') from problem
        if 'alias annotations' in text and (op := re.search(r'aten::(\w+)', text)):
            raise ModelError(f'uses {op[1]}, which torch does not trace: write it without'
                             ) from problem
        raise ModelError(f'raises {type(problem).__name__}{place}: {text[:300]}; it is called '
                         f'with a row of {len(state)} numbers in float64') from problem


def _place(problem: Exception) -> str:
    """Return the line of the user's code that raised, '' if there is none."""
    own = Path(torch.__file__).parent, Path(__file__).parents[1]
    lines = [f' at {frame.line!r}'
             for frame in traceback.extract_tb(problem.__traceback__)
             if Path(frame.filename).is_file()
             and not any(Path(frame.filename).is_relative_to(folder) for folder in own)]
    return lines[-1] if lines else ''


def _translated(traced: torch.fx.GraphModule) -> tuple[Builder, int]:
    """Return the graph of a traced module."""
    b, found = Builder(), dict[Any, Any]()
    translator = _Translator(b)
    for node in traced.graph.nodes:
        match node.op:
            case 'placeholder':
                found[node] = _Value(b, b.input(node.meta['val'].numel()))
            case 'get_attr':
                found[node] = _attribute(traced, node.target)
            case 'output':
                (result,) = torch.fx.node.map_arg(node.args, lambda n: found[n])
                if not isinstance(result, _Value):
                    raise ModelError('does not depend on its input: compute with tensors '
                                     'throughout, without numpy, detach() and float()')
                return b, b.reshape(result.node, ())
            case _:
                args, kwargs = torch.fx.node.map_arg((node.args, node.kwargs), lambda n: found[n])
                found[node] = translator.translated(node.target, args, kwargs)
    raise AssertionError('every graph has an output')


def _attribute(traced: torch.fx.GraphModule, name: str) -> torch.Tensor:
    value: Any = traced
    for part in name.split('.'):
        value = getattr(value, part)
    if not isinstance(value, torch.Tensor):
        raise ModelError('has branches or loops of torch (cond, while_loop, map): write them with '
                         'torch.where')
    return value.detach()


class _Value:
    """A value that depends on the input, or a constant beside it; the node of indices is None."""

    def __init__(self, b: Builder, node: int | None):
        self._b, self._node = b, node

    @property
    def node(self) -> int:
        """Return its node of the builder."""
        if self._node is None:
            raise ModelError('computes with the indices of sorted or largest values: use these '
                             'values themselves')
        return self._node

    @property
    def numbers(self) -> torch.Tensor:
        """Return the numbers of its entries, in its shape."""
        shape = self._b.shape(self.node)
        return torch.arange(math.prod(shape)).reshape(shape)

    @property
    def truth(self) -> '_Value':
        """Return 1 where it is not 0."""
        return self.binary('ne', 0.0)

    def take(self, index: torch.Tensor | np.ndarray) -> '_Value':
        """Return the entries of these numbers."""
        return _Value(self._b, self._b.take(self.node, np.asarray(index)))

    def unary(self, op: str) -> '_Value':
        """Return a function of each entry."""
        return _Value(self._b, self._b.unary(op, self.node))

    def binary(self, op: str, other: Any) -> '_Value':
        """Return a function of each entry and that of another value, broadcast to one shape."""
        return _Value(self._b, self._b.binary(op, *_alike(self._b, self, other)))

    def where(self, x: Any, y: Any) -> '_Value':
        """Return x where it is not 0, else y."""
        return _Value(self._b, self._b.where(*_alike(self._b, self, x, y)))

    __neg__ = partialmethod(unary, 'neg')
    __add__, __sub__ = partialmethod(binary, 'add'), partialmethod(binary, 'sub')
    __mul__, __truediv__ = partialmethod(binary, 'mul'), partialmethod(binary, 'div')


def _node_of(b: Builder, value: Any) -> int:
    """Return the node of a value, of a tensor, or of a number."""
    if isinstance(value, _Value):
        return value.node
    if isinstance(value, torch.Tensor):
        return b.constant(value.detach().cpu().double().numpy())
    if isinstance(value, complex):
        raise ModelError('contains complex numbers: write their real and imaginary parts')
    return b.constant(np.array(float(value)))


def _alike(b: Builder, *values: Any) -> list[int]:
    """Return the nodes of values, broadcast to one shape."""
    nodes = [_node_of(b, value) for value in values]
    shape = np.broadcast_shapes(*map(b.shape, nodes))
    return [b.broadcast(node, shape) for node in nodes]


def _trunc(x: _Value) -> _Value:
    return x.unary('sign') * x.unary('abs').unary('floor')


def _sinc(x: _Value) -> _Value:
    at_zero = x.binary('eq', 0.0)
    inner = at_zero.where(1.0, x) * np.pi
    return at_zero.where(1.0, inner.unary('sin') / inner)


def _acosh(x: _Value) -> _Value:
    # log(x + sqrt(x^2 - 1)), without cancellation at 1.
    above = x - 1.0
    return (above + (above * (x + 1.0)).unary('sqrt')).unary('log1p')


# Functions of the entries of values.
_ENTRYWISE: dict[str, Callable[..., _Value]] = {
    **{name: partial(lambda op, x: x.unary(op), op) for name, op in _UNARY.items()},
    **{name: partial(lambda op, x, y: x.binary(op, y), op) for name, op in _BINARY.items()},
    'where': _Value.where, 'trunc': _trunc, 'sinc': _sinc,
    'acosh': _acosh, 'rsqrt': lambda x: x.unary('sqrt').unary('reciprocal'),
    'exp2': lambda x: (x * np.log(2.0)).unary('exp'),
    'log2': lambda x: x.unary('log') * (1.0 / np.log(2.0)),
    'log10': lambda x: x.unary('log') * (1.0 / np.log(10.0)),
    'isnan': lambda x: x.binary('ne', x), 'isinf': lambda x: x.unary('abs').binary('eq', np.inf),
    'xlogy': lambda x, y: x * x.binary('eq', 0.0).where(1.0, y).unary('log'),
    'atanh': lambda x: (x.unary('log1p') - (-x).unary('log1p')) * 0.5,
    'erfc': lambda x: -x.unary('erf') + 1.0,
    'fmod': lambda x, y: x - _trunc(x / y) * y,
    'remainder': lambda x, y: x - (x / y).unary('floor') * y,
    # With slope 0 at 0, as the norms of torch.
    'hypot': lambda x, y: (x * x + y * y).unary('root'),
    **{f'{kind}_{name}': way for kind in ('logical', 'bitwise') for name, way in {
        'and': lambda x, y: x.truth * y.truth,
        'or': lambda x, y: x.truth.binary('maximum', y.truth),
        'xor': lambda x, y: x.truth.binary('ne', y.truth)}.items()}}


class _Translator:
    """Translates one call of an operation at a time."""

    def __init__(self, b: Builder):
        self.b = b

    def translated(self, target: Any, args: Sequence[Any], kwargs: dict[str, Any]) -> Any:
        """Return a value or several: tensors if they do not depend on the input."""
        if target is getitem:
            return args[0][args[1]]
        if torch.Tag.nondeterministic_seeded in getattr(target, 'tags', ()):
            raise ModelError(f'draws random numbers ({target}); call eval() if it is Dropout, or '
                             'fix them in __init__')
        # An operation in place gives its result to all that use its argument afterwards.
        name = str(target).split('.')[1].removesuffix('_copy').rstrip('_')
        if name in _SHAPED and isinstance(args[0], _Value):
            args = [torch.zeros(args[0].numbers.shape, dtype=torch.float64), *args[1:]]
        if not _depends((args, kwargs)):
            with torch.no_grad():
                found = target(*args, **kwargs)
            # Memory that is not set would differ from call to call.
            return found.zero_() if 'empty' in name else found
        _check_type(kwargs.get('dtype'))
        if name in _MOVES:
            return self._moved(name, target, args, kwargs)
        if name in ('mm', 'bmm'):
            return self._product(*args)
        if (way := getattr(self, f'_{name.strip("_")}', None)) is not None:
            return way(*(self._value(part) if isinstance(part, torch.Tensor) else part
                         for part in args), **kwargs)
        if name in _ENTRYWISE and not kwargs:
            return _ENTRYWISE[name](*map(self._value, args))
        _refuse(target)

    def _value(self, value: Any) -> _Value:
        return _Value(self.b, _node_of(self.b, value))

    def _joined(self, parts: Sequence[Any]) -> _Value:
        """Return the entries of values as one vector."""
        return _Value(self.b, self.b.concatenate([_node_of(self.b, part) for part in parts]))

    def _moved(self, name: str, target: Any, args: Sequence[Any], kwargs: dict[str, Any]) -> Any:
        """Translate an operation that moves values, by moving their numbers."""
        values, begin = list[_Value](), 0

        def numbered(value: Any) -> Any:
            nonlocal begin
            values.append(self._value(value))
            numbers = begin + values[-1].numbers
            begin += numbers.numel()
            return begin - 1 if isinstance(value, (int, float)) else numbers
        places = _PLACES_OF_VALUES.get(name, (0,))
        if _depends([part for k, part in enumerate(args) if k not in places]):
            raise ModelError(f'indexes with values of its input ({target}): write it with '
                             'torch.where')
        if name == 'index_put' and (kwargs.get('accumulate') or any(args[3:])):
            return self._accumulated(args[0], lambda numbers: numbers[tuple(
                slice(None) if part is None else part for part in args[1])], args[2])
        if name == 'scatter_add':
            x, axis, index, added = args
            added = self._value(added)
            return self._accumulated(
                x, lambda numbers: torch.gather(numbers, axis, index),
                added.take(added.numbers[tuple(slice(n) for n in index.shape)]))
        args = [torch.utils._pytree.tree_map(numbered, part) if k in places else part
                for k, part in enumerate(args)]
        index = target(*args, **kwargs)
        joined = values[0] if len(values) == 1 else self._joined(values)
        return torch.utils._pytree.tree_map(joined.take, index)

    def _accumulated(self, base: Any, index: Callable[[torch.Tensor], torch.Tensor],
                     values: Any) -> _Value:
        """Return the base, to whose values at some places others are added."""
        b, base = self.b, self._value(base)
        places = index(base.numbers).numpy()
        added = b.broadcast(_node_of(b, values), places.shape)
        return base + _Value(b, b.put(added, places, b.shape(base.node)))

    def _add(self, x: Any, y: Any, alpha: Any = 1) -> _Value:
        x, y = (_Value(self.b, node) for node in _alike(self.b, x, y))
        return x + y * alpha

    def _sub(self, x: Any, y: Any, alpha: Any = 1) -> _Value:
        return self._add(x, y, -alpha)

    def _softplus(self, x: _Value, beta: float = 1.0, threshold: float = 20.0) -> _Value:
        # Without torch's cut-off above the threshold, where it errs by 2e-9.
        scaled = x * beta
        found = scaled.unary('softplus') / beta
        return found if threshold >= 20.0 else scaled.binary('gt', threshold).where(x, found)

    def _log_sigmoid_forward(self, x: _Value) -> tuple[_Value, _Value]:
        found = -self._softplus(-x)
        return found, found

    def _elu(self, x: _Value, alpha: float = 1.0, scale: float = 1.0,
             input_scale: float = 1.0) -> _Value:
        # Where x is positive, expm1 sees 0: it might overflow.
        positive = x.binary('gt', 0.0)
        inner = positive.where(0.0, x) * input_scale
        return positive.where(x, inner.unary('expm1') * alpha) * scale

    def _clamp(self, x: _Value, low: Any = None, high: Any = None) -> _Value:
        # With slope 1 at the bounds, as in torch.
        for op, bound in (('lt', low), ('gt', high)):
            if bound is not None:
                x = x.binary(op, bound).where(bound, x)
        return x

    _clamp_min = _clamp

    def _clamp_max(self, x: _Value, high: Any) -> _Value:
        return self._clamp(x, None, high)

    def _hardtanh(self, x: _Value, low: Any = -1.0, high: Any = 1.0) -> _Value:
        return self._clamp(x, low, high)

    def _div(self, x: Any, y: Any, rounding_mode: str | None = None) -> _Value:
        found = self._value(x) / y
        return found if rounding_mode is None else found.unary('floor') \
            if rounding_mode == 'floor' else _trunc(found)

    def _linalg_vector_norm(self, x: _Value, order: Any = 2, axes: Any = None,
                            keepdim: bool = False, dtype: Any = None) -> _Value:
        size, power = x.unary('abs'), float(order)
        total = self._sum(size, axes, keepdim)
        if power == 1.0 or total.numbers.numel() == x.numbers.numel():
            return total
        if np.isinf(power):
            return (self._amax if power > 0.0 else self._amin)(size, axes, keepdim)
        if power == 0.0:
            return self._sum(x.truth, axes, keepdim)
        if power == 2.0:
            return self._sum(x * x, axes, keepdim).unary('root')
        return self._sum(size.binary('pow', power), axes, keepdim).binary('pow', 1.0 / power)

    def _cdist_forward(self, x: _Value, y: _Value, order: float, mode: Any) -> _Value:
        apart = x.take(x.numbers[..., None, :]) - y.take(y.numbers[..., None, :, :])
        return self._linalg_vector_norm(apart, order, -1)

    def _pdist_forward(self, x: _Value, order: float = 2.0) -> _Value:
        first, second = (x.take(x.numbers[rows]) for rows in np.triu_indices(len(x.numbers), 1))
        return self._linalg_vector_norm(first - second, order, -1)

    def _to(self, x: _Value, dtype: torch.dtype | None = None, **others: Any) -> _Value:
        return x if dtype is not torch.bool else x.truth

    def _sum(self, x: _Value, axes: Any = None, keepdim: bool = False,
             dtype: Any = None) -> _Value:
        return self._over(self.b.sum, x, axes, keepdim)

    def _mean(self, x: _Value, axes: Any = None, keepdim: bool = False,
              dtype: Any = None) -> _Value:
        return self._shared(self._sum(x, axes, keepdim), x)

    def _shared(self, total: _Value, x: _Value, less: float = 0.0) -> _Value:
        """Return a total of x divided by the number of entries in each sum, less a number."""
        count = x.numbers.numel() / total.numbers.numel() - less
        return total * (1.0 / count)

    def _shifted(self, x: _Value, axis: Any) -> tuple[_Value, _Value, _Value]:
        """Return exp(x - m), its sum over an axis, and m, the largest, which keep that axis."""
        largest = self._amax(x, axis, True).unary('fixed')
        powers = (x - largest).unary('exp')
        return powers, self._sum(powers, axis, True), largest

    def _softmax(self, x: _Value, axis: int, single: bool = False) -> _Value:
        powers, total, _ = self._shifted(x, axis)
        return powers / total

    def _log_softmax(self, x: _Value, axis: int, single: bool = False) -> _Value:
        _, total, largest = self._shifted(x, axis)
        return x - largest - total.unary('log')

    def _logsumexp(self, x: _Value, axes: Any, keepdim: bool = False) -> _Value:
        _, total, largest = self._shifted(x, axes)
        return self._sum(total.unary('log') + largest, axes, keepdim)

    def _var(self, x: _Value, axes: Any = None, correction: Any = 1,
             keepdim: bool = False) -> _Value:
        apart = x - self._mean(x, axes, True)
        return self._shared(self._sum(apart * apart, axes, keepdim), x, float(correction))

    def _var_mean(self, x: _Value, axes: Any = None, correction: Any = 1, keepdim: bool = False
                  ) -> tuple[_Value, _Value]:
        return self._var(x, axes, correction, keepdim), self._mean(x, axes, keepdim)

    def _any(self, x: _Value, axes: Any = None, keepdim: bool = False) -> _Value:
        return self._amax(x.truth, axes, keepdim)

    def _amax(self, x: _Value, axes: Any = (), keepdim: bool = False) -> _Value:
        return self._over(self.b.amax, x, axes, keepdim)

    def _amin(self, x: _Value, axes: Any = (), keepdim: bool = False) -> _Value:
        return -self._amax(-x, axes, keepdim)

    def _max(self, x: _Value, axis: Any = (), keepdim: bool = False) -> Any:
        return self._with_indices(self._amax(x, axis, keepdim), isinstance(axis, int))

    def _min(self, x: _Value, axis: Any = (), keepdim: bool = False) -> Any:
        return self._with_indices(self._amin(x, axis, keepdim), isinstance(axis, int))

    def _with_indices(self, values: _Value, has: bool = True) -> Any:
        """Return values and, if an operation has them, their indices, which nothing may use."""
        return (values, _Value(self.b, None)) if has else values

    def _parts(self, x: _Value, axis: int) -> list[_Value]:
        """Return the slices of a value along an axis."""
        return [x.take(part) for part in x.numbers.unbind(axis)]

    def _stacked(self, parts: Sequence[_Value], axis: int) -> _Value:
        """Return slices along an axis, joined."""
        joined = self._joined(parts)
        return joined.take(joined.numbers.reshape(
            len(parts), *parts[0].numbers.shape).movedim(0, axis))

    def _prod(self, x: _Value, axis: int | None = None, keepdim: bool = False,
              dtype: Any = None) -> _Value:
        if axis is None:
            x, axis = x.take(x.numbers.ravel()), 0
        *_, total = accumulate(self._parts(x, axis), mul)
        return self._stacked([total], axis) if keepdim else total

    def _cumprod(self, x: _Value, axis: int, dtype: Any = None) -> _Value:
        return self._stacked([*accumulate(self._parts(x, axis), mul)], axis)

    def _sort(self, x: _Value, axis: int = -1, descending: bool = False, dim: int | None = None,
              stable: bool = False) -> Any:
        # Odd-even transposition: n rounds of comparisons of neighbours.
        axis = axis if dim is None else dim
        parts = self._parts(x, axis)
        for k in range(len(parts)):
            for i in range(k % 2, len(parts) - 1, 2):
                one, other = parts[i:i + 2]
                parts[i:i + 2] = (one.binary(op, other) for op in ('minimum', 'maximum'))
        return self._with_indices(self._stacked(parts[::-1] if descending else parts, axis))

    def _topk(self, x: _Value, k: int, axis: int = -1, largest: bool = True,
              ordered: bool = True) -> Any:
        values, _ = self._sort(x, axis, largest)
        return self._with_indices(self._stacked(self._parts(values, axis)[:k], axis))

    def _windows(self, x: _Value, sizes: Sequence[int], steps: Sequence[int], pads: Sequence[int],
                 apart: Sequence[int], fill: float) -> _Value:
        """Return the padded entries of windows, shape (..., positions, places in window)."""
        numbers, own = x.numbers.numpy(), len(sizes)
        numbers = np.pad(numbers, [(0, 0)] * (numbers.ndim - own) + [(n, n) for n in pads],
                         constant_values=numbers.size)
        views = np.lib.stride_tricks.sliding_window_view(
            numbers, [d * (n - 1) + 1 for n, d in zip(sizes, apart, strict=True)],
            axis=(*range(-own, 0),))
        some: Any = (..., *(slice(None, None, step) for step in (*steps, *apart)))
        return self._joined([x, fill]).take(views[some])

    def _constant_pad_nd(self, x: _Value, pads: Sequence[int], value: float = 0.0) -> _Value:
        numbers = x.numbers
        return self._joined([x, value]).take(
            torch.nn.functional.pad(numbers, [*pads], value=numbers.numel()))

    def _convolution(self, x: _Value, weight: _Value, bias: _Value | None, steps: Sequence[int],
                     pads: Sequence[int], apart: Sequence[int], transposed: bool, extra: Any,
                     groups: int) -> _Value:
        if transposed:
            _refuse('transposed convolution')
        b = self.b
        outputs, inputs, *sizes = weight.numbers.shape
        windows = self._windows(x, sizes, steps, pads, apart, 0.0)
        n, _, *rest = windows.numbers.shape
        # One product of matrices a group: rows are positions, columns are places in the window.
        rows = windows.numbers.reshape(n, groups, inputs, *rest).movedim(
            (1, 2), (0, -1 - len(sizes)))
        inner = inputs * math.prod(sizes)
        found = _Value(b, b.matmul(
            windows.take(rows.reshape(groups, -1, inner)).node,
            b.reshape(weight.node, (groups, outputs // groups, inner)), t_y=True))
        back = found.numbers.reshape(groups, n, *rest[:len(sizes)], -1).movedim((0, -1), (1, 2))
        found = found.take(back.reshape(n, outputs, *rest[:len(sizes)]))
        return found if bias is None else found + bias.take(
            bias.numbers.reshape(outputs, *(1 for _ in sizes)))

    def _avg_pool2d(self, x: _Value, sizes: Sequence[int], steps: Sequence[int] = (),
                    pads: Sequence[int] = (0, 0), ceil: bool = False, counts: bool = True,
                    divisor: int | None = None) -> _Value:
        if ceil or divisor or (any(pads) and not counts):
            _refuse('avg_pool with ceil_mode, a divisor, or padding that does not count')
        return self._mean(self._windows(x, sizes, steps or sizes, pads, (1, 1), 0.0), (-2, -1))

    def _max_pool2d_with_indices(self, x: _Value, sizes: Sequence[int], steps: Sequence[int] = (),
                                 pads: Sequence[int] = (0, 0), apart: Sequence[int] = (1, 1),
                                 ceil: bool = False) -> Any:
        if ceil:
            _refuse('max_pool with ceil_mode')
        return self._with_indices(self._amax(
            self._windows(x, sizes, steps or sizes, pads, apart, -np.inf), (-2, -1)))

    def _cumsum(self, x: _Value, axis: int, dtype: Any = None) -> _Value:
        b, last = self.b, x.numbers.movedim(axis, -1)
        n = last.shape[-1]
        sums = _Value(b, b.matmul(x.take(last.reshape(-1, n)).node,
                                      b.constant(np.triu(np.ones((n, n))))))
        return sums.take(sums.numbers.reshape(last.shape).movedim(-1, axis))

    def _over(self, way: Callable[[int, Sequence[int]], int], x: _Value, axes: Any,
              keepdim: bool) -> _Value:
        shape = x.numbers.shape
        axes = [axes] if isinstance(axes, int) else axes
        own = [k % len(shape) for k in axes] if axes else [*range(len(shape))]
        total = way(x.node, own)
        return _Value(self.b, self.b.reshape(
            total, [1 if k in own else n for k, n in enumerate(shape)]) if keepdim else total)

    def _product(self, x: Any, y: Any) -> _Value:
        """Return the product of matrices, or of stacks."""
        (left, t_x), (right, t_y) = self._matrix(x), self._matrix(y)
        return _Value(self.b, self.b.matmul(left, right, t_x, t_y))

    def _matrix(self, value: Any) -> tuple[int, bool]:
        """Return a matrix or a stack, and whether it is to be transposed: copies are avoided."""
        if isinstance(value, torch.Tensor) and value.ndim == 2 and not value.is_contiguous() \
                and value.t().is_contiguous():
            return _node_of(self.b, value.t()), True
        node = _node_of(self.b, value)
        row, shape = self.b.nodes[node], self.b.shape(node)
        if row.op == 'take' and np.prod(self.b.shape(row.inputs[0])) == np.prod(shape):
            turned = (*shape[:-2], shape[-1], shape[-2])
            numbers = np.arange(int(np.prod(shape))).reshape(turned)
            if np.array_equal(self.b.tensors[row.tensor], np.swapaxes(numbers, -1, -2)):
                return self.b.reshape(row.inputs[0], turned), True
        return node, False


def _check_type(dtype: torch.dtype | None) -> None:
    if dtype not in (None, torch.float64, torch.bool):
        name = str(dtype).removeprefix('torch.')
        raise ModelError(
            f'casts to {name} inside: ' + (
                'compute in the type of the input, as with x.new_tensor or .to(x)'
                if dtype.is_floating_point else 'integers from values of its input, such as '
                'indices, are not supported: write it with torch.where or comparisons'))


def _depends(values: Any) -> bool:
    return any(isinstance(leaf, _Value) for leaf in torch.utils._pytree.tree_leaves(values))


def _refuse(target: Any) -> NoReturn:
    raise UntranslatedModule(f'uses {str(target).removeprefix("aten.")}, which stored graphs do '
                             'not have')


# Operations with pivots, and the smallest one relative to the largest entry of its matrix.
_PIVOTED = 'linalg_inv_ex', '_linalg_solve_ex', '_linalg_det', '_linalg_slogdet'
_MIN_PIVOT = 1e-9


class PivotWatch(TorchDispatchMode):
    """
    Watch of the pivots of a module's linear systems, without exchanges of rows, while it runs.

    Attributes
    ----------
    safe : bool
        False if the sign of a pivot depends on the state, or a pivot is almost zero.

    """

    def __init__(self) -> None:
        super().__init__()
        self.safe, self._signs, self._at = True, list[torch.Tensor](), 0

    def __torch_dispatch__(self, op: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Call an operation of torch."""
        if op.name().removeprefix('aten::') in _PIVOTED:
            pivots = eliminated(args[0], args[0][..., :0])[1]
            sizes = pivots.abs() / args[0].abs().amax((-1, -2))[..., None]
            signs, first = pivots.sign(), self._signs[self._at:self._at + 1]
            self.safe &= bool((sizes > _MIN_PIVOT).all()) and all(
                torch.equal(signs, one) for one in first)
            self._signs += [] if first else [signs]
            self._at += 1
        return op(*args, **(kwargs or {}))

    def __enter__(self) -> 'PivotWatch':
        """Begin with the first system of the module."""
        self._at = 0
        super().__enter__()
        return self
