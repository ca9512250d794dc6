# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
The graph of a torch module: traced by ``make_fx``, and translated to the operations of graphs.

Values that do not depend on the input are computed by torch. All operations that only move values
are translated in one way: applied to the numbers of the values, they give the index of a ``take``.
"""

from collections.abc import Callable, Sequence
from itertools import accumulate
from operator import getitem
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
          _aten.hardtanh, _aten.maximum, _aten.minimum, _aten.sinc, _aten.scatter,
          _aten.masked_fill, _aten.hypot, _aten.log_sigmoid_forward, _aten.xlogy)
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
_SCALED = {'log2': ('log', 1.0 / np.log(2.0)), 'log10': ('log', 1.0 / np.log(10.0))}

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
                found[node] = _Dependent(b.input(node.meta['val'].numel()))
            case 'get_attr':
                found[node] = _attribute(traced, node.target).detach()
            case 'output':
                (result,) = torch.fx.node.map_arg(node.args, lambda n: found[n])
                if not isinstance(result, _Dependent):
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
    return value


class _Dependent:
    """A value that depends on the input: a node of the builder; None for indices."""

    def __init__(self, node: int | None):
        self._node = node

    @property
    def node(self) -> int:
        """Return the node."""
        if self._node is None:
            raise ModelError('computes with the indices of sorted or largest values: use these '
                             'values themselves')
        return self._node


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
        if name in _SHAPED and isinstance(args[0], _Dependent):
            args = [torch.zeros(self.b.shape(args[0].node), dtype=torch.float64), *args[1:]]
        if not _depends((args, kwargs)):
            with torch.no_grad():
                found = target(*args, **kwargs)
            # Memory that is not set would differ from call to call.
            return found.zero_() if 'empty' in name else found
        _check_type(kwargs.get('dtype'))
        if name in _MOVES:
            return self._moved(name, target, args, kwargs)
        way = getattr(self, f'_{name.strip("_")}', None)
        if way is not None:
            found = way(*args, **kwargs)
            return tuple(map(_Dependent, found)) if isinstance(found, tuple) else _Dependent(found)
        if name in _UNARY and len(args) == 1 and not kwargs:
            return _Dependent(self.b.unary(_UNARY[name], self._node(args[0])))
        if name in _BINARY and not kwargs:
            return _Dependent(self.b.binary(_BINARY[name], *self._alike(*args)))
        if name in _SCALED:
            op, factor = _SCALED[name]
            x = self.b.unary(op, self._node(args[0]))
            return _Dependent(self.b.mul(x, self.b.full(x, factor)))
        _refuse(target)

    def _node(self, value: Any) -> int:
        """Return the node of a value, of a tensor, or of a number."""
        if isinstance(value, _Dependent):
            return value.node
        if isinstance(value, torch.Tensor):
            return self.b.constant(value.detach().cpu().double().numpy())
        if isinstance(value, complex):
            raise ModelError('contains complex numbers: write their real and imaginary parts')
        return self.b.constant(np.array(float(value)))

    def _alike(self, *values: Any) -> list[int]:
        """Return the nodes of values, broadcast to one shape."""
        nodes = [self._node(value) for value in values]
        shape = np.broadcast_shapes(*map(self.b.shape, nodes))
        return [self.b.broadcast(node, shape) for node in nodes]

    def _moved(self, name: str, target: Any, args: Sequence[Any], kwargs: dict[str, Any]) -> Any:
        """Translate an operation that moves values, by moving their numbers."""
        nodes, begin = list[int](), 0

        def numbered(value: Any) -> Any:
            nonlocal begin
            node = self._node(value)
            shape = self.b.shape(node)
            count = int(np.prod(shape, dtype=int))
            nodes.append(node)
            begin += count
            numbers = torch.arange(begin - count, begin).reshape(shape)
            return begin - 1 if isinstance(value, (int, float)) else numbers
        places = _PLACES_OF_VALUES.get(name, (0,))
        if _depends([part for k, part in enumerate(args) if k not in places]):
            raise ModelError(f'indexes with values of its input ({target}): write it with '
                             'torch.where')
        if name == 'index_put' and (kwargs.get('accumulate') or any(args[3:])):
            return _Dependent(self._accumulated(args[0], lambda numbers: numbers[tuple(
                slice(None) if part is None else part for part in args[1])], args[2]))
        if name == 'scatter_add':
            x, axis, index, values = args
            part = _Dependent(self.b.take(self._node(values), self._numbers(values)[tuple(
                slice(n) for n in index.shape)].numpy()))
            return _Dependent(self._accumulated(
                x, lambda numbers: torch.gather(numbers, axis, index), part))
        args = [torch.utils._pytree.tree_map(numbered, part) if k in places else part
                for k, part in enumerate(args)]
        index = target(*args, **kwargs)
        joined = nodes[0] if len(nodes) == 1 else self.b.concatenate(nodes)
        return torch.utils._pytree.tree_map(
            lambda x: _Dependent(self.b.take(joined, x.numpy())), index)

    def _numbers(self, value: Any) -> torch.Tensor:
        """Return the numbers of values, in their shape."""
        shape = self.b.shape(self._node(value))
        return torch.arange(int(np.prod(shape, dtype=int))).reshape(shape)

    def _accumulated(self, base: Any, index: Callable[[torch.Tensor], torch.Tensor], values: Any
                     ) -> int:
        """Return the base, to whose values at some places others are added."""
        b, places = self.b, index(self._numbers(base)).numpy()
        added = b.broadcast(self._node(values), places.shape)
        return b.add(self._node(base), b.put(added, places, b.shape(self._node(base))))

    def _add(self, x: Any, y: Any, alpha: Any = 1) -> int:
        left, right = self._alike(x, y)
        return self.b.add(left, self.b.mul(right, self.b.full(right, float(alpha))))

    def _sub(self, x: Any, y: Any, alpha: Any = 1) -> int:
        return self._add(x, y, -alpha)

    def _rsub(self, x: Any, y: Any, alpha: Any = 1) -> int:
        return self._add(y, x, -alpha)

    def _square(self, x: Any) -> int:
        return self.b.mul(self._node(x), self._node(x))

    def _rsqrt(self, x: Any) -> int:
        return self.b.unary('reciprocal', self.b.unary('sqrt', self._node(x)))

    def _exp2(self, x: Any) -> int:
        node = self._node(x)
        return self.b.unary('exp', self.b.mul(node, self.b.full(node, np.log(2.0))))

    def _where(self, condition: Any, x: Any, y: Any) -> int:
        return self.b.where(*self._alike(condition, x, y))

    def _softplus(self, x: Any, beta: float = 1.0, threshold: float = 20.0) -> int:
        # Without torch's cut-off above the threshold, where it errs by 2e-9.
        node = self._node(x)
        scale = self.b.full(node, float(beta))
        scaled = self.b.mul(node, scale)
        found = self.b.div(self.b.unary('softplus', scaled), scale)
        return found if threshold >= 20.0 else self.b.where(
            self.b.binary('gt', scaled, self.b.full(node, float(threshold))), node, found)

    def _log_sigmoid_forward(self, x: Any) -> tuple[int, int]:
        node = self.b.neg(self._softplus(_Dependent(self.b.neg(self._node(x)))))
        return node, node

    def _elu(self, x: Any, alpha: float = 1.0, scale: float = 1.0, input_scale: float = 1.0
             ) -> int:
        # Where x is positive, expm1 sees 0: it might overflow.
        b, node = self.b, self._node(x)
        positive, zero = b.binary('gt', node, b.full(node, 0.0)), b.full(node, 0.0)
        inner = b.mul(b.where(positive, zero, node), b.full(node, float(input_scale)))
        return b.mul(b.where(positive, node, b.mul(
            b.unary('expm1', inner), b.full(node, float(alpha)))), b.full(node, float(scale)))

    def _clamp(self, x: Any, low: Any = None, high: Any = None) -> int:
        # With slope 1 at the bounds, as in torch.
        found = self._node(x)
        for op, bound in (('lt', low), ('gt', high)):
            if bound is not None:
                found, limit = self._alike(_Dependent(found), bound)
                found = self.b.where(self.b.binary(op, found, limit), limit, found)
        return found

    def _clamp_min(self, x: Any, low: Any) -> int:
        return self._clamp(x, low)

    def _clamp_max(self, x: Any, high: Any) -> int:
        return self._clamp(x, None, high)

    def _hardtanh(self, x: Any, low: Any = -1.0, high: Any = 1.0) -> int:
        return self._clamp(x, low, high)

    def _isnan(self, x: Any) -> int:
        node = self._node(x)
        return self.b.binary('ne', node, node)

    def _isinf(self, x: Any) -> int:
        node = self.b.unary('abs', self._node(x))
        return self.b.binary('eq', node, self.b.full(node, np.inf))

    def _xlogy(self, x: Any, y: Any) -> int:
        b, (left, right) = self.b, self._alike(x, y)
        none = b.binary('eq', left, b.full(left, 0.0))
        return b.mul(left, b.unary('log', b.where(none, b.full(left, 1.0), right)))

    def _acosh(self, x: Any) -> int:
        # log(x + sqrt(x^2 - 1)), without cancellation at 1.
        b, node = self.b, self._node(x)
        above = b.sub(node, b.full(node, 1.0))
        return b.unary('log1p', b.add(above, b.unary('sqrt', b.mul(
            above, b.add(node, b.full(node, 1.0))))))

    def _atanh(self, x: Any) -> int:
        b, node = self.b, self._node(x)
        both = b.sub(b.unary('log1p', node), b.unary('log1p', b.neg(node)))
        return b.mul(both, b.full(node, 0.5))

    def _erfc(self, x: Any) -> int:
        node = self.b.unary('erf', self._node(x))
        return self.b.sub(self.b.full(node, 1.0), node)

    def _trunc(self, x: Any) -> int:
        b, node = self.b, self._node(x)
        return b.mul(b.unary('sign', node), b.unary('floor', b.unary('abs', node)))

    def _div(self, x: Any, y: Any, rounding_mode: str | None = None) -> int:
        found = self.b.div(*self._alike(x, y))
        return found if rounding_mode is None else self.b.unary('floor', found) \
            if rounding_mode == 'floor' else self._trunc(_Dependent(found))

    def _fmod(self, x: Any, y: Any) -> int:
        left, right = self._alike(x, y)
        return self.b.sub(left, self.b.mul(self._div(x, y, 'trunc'), right))

    def _masked_fill(self, x: Any, mask: Any, value: Any) -> int:
        return self._where(mask, value, x)

    def _hypot(self, x: Any, y: Any) -> int:
        return self._root_of_squares(self.b.add(*(self.b.mul(part, part) for part in (
            self._alike(x, y)))))

    def _root_of_squares(self, total: int) -> int:
        # With slope 0 at 0, as the norms of torch.
        return self.b.unary('root', total)

    def _linalg_vector_norm(self, x: Any, order: Any = 2, axes: Any = None, keepdim: bool = False,
                            dtype: Any = None) -> int:
        b, node = self.b, self._node(x)
        size, power = _Dependent(b.unary('abs', node)), float(order)
        single = self._sum(size, axes, keepdim)
        if power == 1.0 or np.prod(b.shape(single)) == np.prod(b.shape(node)):
            return single
        if np.isinf(power):
            return (self._amax if power > 0.0 else self._amin)(size, axes, keepdim)
        if power == 0.0:
            return self._sum(_Dependent(self._nonzero(node)), axes, keepdim)
        if power == 2.0:
            return self._root_of_squares(self._sum(_Dependent(b.mul(node, node)), axes, keepdim))
        total = self._sum(_Dependent(b.binary('pow', size.node, b.full(node, power))), axes,
                          keepdim)
        return b.binary('pow', total, b.full(total, 1.0 / power))

    def _cdist_forward(self, x: Any, y: Any, order: float, mode: Any) -> int:
        b, left, right = self.b, self._node(x), self._node(y)
        *first, d = b.shape(left)
        *second, rows, _ = b.shape(right)
        apart = self._sub(_Dependent(b.reshape(left, (*first, 1, d))),
                          _Dependent(b.reshape(right, (*second, 1, rows, d))))
        return self._linalg_vector_norm(_Dependent(apart), order, -1)

    def _pdist_forward(self, x: Any, order: float = 2.0) -> int:
        numbers = self._numbers(x).numpy()
        first, second = (self.b.take(self._node(x), numbers[rows])
                         for rows in np.triu_indices(len(numbers), 1))
        return self._linalg_vector_norm(_Dependent(self.b.sub(first, second)), order, -1)

    def _sinc(self, x: Any) -> int:
        b, node = self.b, self._node(x)
        at_zero = b.binary('eq', node, b.full(node, 0.0))
        inner = b.mul(b.where(at_zero, b.full(node, 1.0), node), b.full(node, np.pi))
        return b.where(at_zero, b.full(node, 1.0), b.div(b.unary('sin', inner), inner))

    def _logical_and(self, x: Any, y: Any) -> int:
        return self.b.mul(*map(self._nonzero, self._alike(x, y)))

    _bitwise_and = _logical_and

    def _logical_or(self, x: Any, y: Any) -> int:
        return self.b.binary('maximum', *map(self._nonzero, self._alike(x, y)))

    _bitwise_or = _logical_or

    def _nonzero(self, node: int) -> int:
        return self.b.binary('ne', node, self.b.full(node, 0.0))

    def _logical_xor(self, x: Any, y: Any) -> int:
        return self.b.binary('ne', *map(self._nonzero, self._alike(x, y)))

    _bitwise_xor = _logical_xor

    def _remainder(self, x: Any, y: Any) -> int:
        left, right = self._alike(x, y)
        return self.b.sub(left, self.b.mul(self._div(x, y, 'floor'), right))

    def _to(self, x: Any, dtype: torch.dtype | None = None, **others: Any) -> int:
        node = self._node(x)
        return node if dtype is not torch.bool else self._nonzero(node)

    def _sum(self, x: Any, axes: Any = None, keepdim: bool = False, dtype: Any = None) -> int:
        return self._over(self.b.sum, x, axes, keepdim)

    def _mean(self, x: Any, axes: Any = None, keepdim: bool = False, dtype: Any = None) -> int:
        total = self._sum(x, axes, keepdim)
        count = np.prod(self.b.shape(self._node(x))) / np.prod(self.b.shape(total))
        return self.b.mul(total, self.b.full(total, 1.0 / float(count)))

    def _shifted(self, x: Any, axis: Any) -> tuple[int, int, int]:
        """Return exp(x - m), its sum over an axis, in the shape of x, and m, the largest."""
        b, node = self.b, self._node(x)
        largest = b.unary('fixed', b.broadcast(self._amax(x, axis, True), b.shape(node)))
        powers = b.unary('exp', b.sub(node, largest))
        total = self._sum(_Dependent(powers), axis, True)
        return powers, b.broadcast(total, b.shape(node)), largest

    def _softmax(self, x: Any, axis: int, single: bool = False) -> int:
        powers, total, _ = self._shifted(x, axis)
        return self.b.div(powers, total)

    def _log_softmax(self, x: Any, axis: int, single: bool = False) -> int:
        _, total, largest = self._shifted(x, axis)
        return self.b.sub(self.b.sub(self._node(x), largest), self.b.unary('log', total))

    def _logsumexp(self, x: Any, axes: Any, keepdim: bool = False) -> int:
        _, total, largest = self._shifted(x, axes)
        found = self.b.add(self.b.unary('log', total), largest)
        # All values over the axes are equal: the first of each is taken.
        node = _Dependent(found)
        return self._over(self._first, node, axes, keepdim)

    def _first(self, node: int, axes: Sequence[int]) -> int:
        shape = self.b.shape(node)
        numbers = np.arange(int(np.prod(shape))).reshape(shape)
        return self.b.take(node, numbers[tuple(
            0 if k in axes else slice(None) for k in range(len(shape)))])

    def _var(self, x: Any, axes: Any = None, correction: Any = 1, keepdim: bool = False) -> int:
        b, node = self.b, self._node(x)
        mean = self._mean(x, axes, True)
        apart = b.sub(node, b.broadcast(mean, b.shape(node)))
        total = self._sum(_Dependent(b.mul(apart, apart)), axes, keepdim)
        count = np.prod(b.shape(node)) / np.prod(b.shape(mean)) - float(correction)
        return b.mul(total, b.full(total, 1.0 / float(count)))

    def _var_mean(self, x: Any, axes: Any = None, correction: Any = 1, keepdim: bool = False
                  ) -> tuple[int, int]:
        return self._var(x, axes, correction, keepdim), self._mean(x, axes, keepdim)

    def _any(self, x: Any, axes: Any = None, keepdim: bool = False) -> int:
        return self._amax(_Dependent(self._nonzero(self._node(x))), axes, keepdim)

    def _amax(self, x: Any, axes: Any = (), keepdim: bool = False) -> int:
        return self._over(self.b.amax, x, axes, keepdim)

    def _amin(self, x: Any, axes: Any = (), keepdim: bool = False) -> int:
        return self.b.neg(self._amax(_Dependent(self.b.neg(self._node(x))), axes, keepdim))

    def _max(self, x: Any, axis: Any = (), keepdim: bool = False) -> int | tuple[int, None]:
        values = self._amax(x, axis, keepdim)
        return (values, None) if isinstance(axis, int) else values

    def _min(self, x: Any, axis: Any = (), keepdim: bool = False) -> int | tuple[int, None]:
        values = self._amin(x, axis, keepdim)
        return (values, None) if isinstance(axis, int) else values

    def _parts(self, x: Any, axis: int) -> list[int]:
        """Return the slices of a value along an axis."""
        return [self.b.take(self._node(x), part.numpy()) for part in self._numbers(x).unbind(axis)]

    def _stacked(self, parts: Sequence[int], axis: int) -> int:
        """Return slices along an axis, joined."""
        shape, joined = self.b.shape(parts[0]), self.b.concatenate(parts)
        numbers = np.arange(len(parts) * int(np.prod(shape))).reshape(len(parts), *shape)
        return self.b.take(joined, np.moveaxis(numbers, 0, axis))

    def _prod(self, x: Any, axis: int | None = None, keepdim: bool = False, dtype: Any = None
              ) -> int:
        if axis is None:
            x, axis = _Dependent(self.b.reshape(self._node(x), (self._numbers(x).numel(),))), 0
        *_, total = accumulate(self._parts(x, axis), self.b.mul)
        return self._stacked([total], axis) if keepdim else total

    def _cumprod(self, x: Any, axis: int, dtype: Any = None) -> int:
        return self._stacked([*accumulate(self._parts(x, axis), self.b.mul)], axis)

    def _sort(self, x: Any, axis: int = -1, descending: bool = False, dim: int | None = None,
              stable: bool = False) -> tuple[int, None]:
        # Odd-even transposition: n rounds of comparisons of neighbours.
        axis = axis if dim is None else dim
        parts = self._parts(x, axis)
        for k in range(len(parts)):
            for i in range(k % 2, len(parts) - 1, 2):
                pair = parts[i:i + 2]
                parts[i], parts[i + 1] = (self.b.binary(op, *pair)
                                          for op in ('minimum', 'maximum'))
        return self._stacked(parts[::-1] if descending else parts, axis), None

    def _topk(self, x: Any, k: int, axis: int = -1, largest: bool = True, ordered: bool = True
              ) -> tuple[int, None]:
        values, _ = self._sort(x, axis, largest)
        return self._stacked(self._parts(_Dependent(values), axis)[:k], axis), None

    def _windows(self, x: Any, sizes: Sequence[int], steps: Sequence[int], pads: Sequence[int],
                 apart: Sequence[int], fill: float) -> tuple[int, np.ndarray]:
        """Return padded values, and their numbers, shape (..., positions, places in window)."""
        node, numbers = self._node(x), self._numbers(x).numpy()
        count, own = numbers.size, len(sizes)
        numbers = np.pad(numbers, [(0, 0)] * (numbers.ndim - own) + [(n, n) for n in pads],
                         constant_values=count)
        views = np.lib.stride_tricks.sliding_window_view(
            numbers, [d * (n - 1) + 1 for n, d in zip(sizes, apart, strict=True)],
            axis=(*range(-own, 0),))
        some: Any = (..., *(slice(None, None, step) for step in (*steps, *apart)))
        return self.b.concatenate([node, self.b.constant(np.full(1, fill))]), views[some]

    def _constant_pad_nd(self, x: Any, pads: Sequence[int], value: float = 0.0) -> int:
        b, numbers = self.b, self._numbers(x)
        index = torch.nn.functional.pad(numbers, [*pads], value=numbers.numel())
        return b.take(b.concatenate([self._node(x), b.constant(np.full(1, float(value)))]),
                      index.numpy())

    def _convolution(self, x: Any, weight: Any, bias: Any, steps: Sequence[int],
                     pads: Sequence[int], apart: Sequence[int], transposed: bool, extra: Any,
                     groups: int) -> int:
        if transposed:
            _refuse('transposed convolution')
        b, kernel = self.b, self._node(weight)
        outputs, inputs, *sizes = b.shape(kernel)
        padded, numbers = self._windows(x, sizes, steps, pads, apart, 0.0)
        n, _, *rest = numbers.shape
        # One product of matrices a group: rows are positions, columns are places in the window.
        rows = np.moveaxis(numbers.reshape(n, groups, inputs, *rest), (1, 2), (0, -1 - len(sizes)))
        inner = inputs * int(np.prod(sizes))
        found = b.matmul(b.take(padded, rows.reshape(groups, -1, inner)),
                         b.reshape(kernel, (groups, outputs // groups, inner)), t_y=True)
        back = np.moveaxis(np.arange(int(np.prod(b.shape(found)))).reshape(
            groups, n, *rest[:len(sizes)], -1), (0, -1), (1, 2))
        found = b.take(found, back.reshape(n, outputs, *rest[:len(sizes)]))
        return found if bias is None else self._add(_Dependent(found), _Dependent(b.reshape(
            self._node(bias), (outputs, *(1 for _ in sizes)))))

    def _avg_pool2d(self, x: Any, sizes: Sequence[int], steps: Sequence[int] = (),
                    pads: Sequence[int] = (0, 0), ceil: bool = False, counts: bool = True,
                    divisor: int | None = None) -> int:
        if ceil or divisor or (any(pads) and not counts):
            _refuse('avg_pool with ceil_mode, a divisor, or padding that does not count')
        padded, numbers = self._windows(x, sizes, steps or sizes, pads, (1, 1), 0.0)
        return self._mean(_Dependent(self.b.take(padded, numbers)), (-2, -1))

    def _max_pool2d_with_indices(self, x: Any, sizes: Sequence[int], steps: Sequence[int] = (),
                                 pads: Sequence[int] = (0, 0), apart: Sequence[int] = (1, 1),
                                 ceil: bool = False) -> tuple[int, None]:
        if ceil:
            _refuse('max_pool with ceil_mode')
        padded, numbers = self._windows(x, sizes, steps or sizes, pads, apart, -np.inf)
        return self._amax(_Dependent(self.b.take(padded, numbers)), (-2, -1)), None

    def _cumsum(self, x: Any, axis: int, dtype: Any = None) -> int:
        b, node = self.b, self._node(x)
        shape = b.shape(node)
        last = np.moveaxis(np.arange(int(np.prod(shape))).reshape(shape), axis, -1)
        rows = b.take(node, last.reshape(-1, shape[axis]))
        sums = b.matmul(rows, b.constant(np.triu(np.ones((shape[axis], shape[axis])))))
        back = np.empty(last.size, dtype=np.int64)
        back[last.ravel()] = np.arange(last.size)
        return b.take(sums, back.reshape(shape))

    def _over(self, way: Callable[[int, Sequence[int]], int], x: Any, axes: Any, keepdim: bool
              ) -> int:
        node = self._node(x)
        shape = self.b.shape(node)
        axes = [axes] if isinstance(axes, int) else axes
        own = [k % len(shape) for k in axes] if axes else [*range(len(shape))]
        total = way(node, own)
        return self.b.reshape(total, [1 if k in own else n for k, n in enumerate(shape)]
                              ) if keepdim else total

    def _mm(self, x: Any, y: Any) -> int:
        (left, t_x), (right, t_y) = self._matrix(x), self._matrix(y)
        return self.b.matmul(left, right, t_x, t_y)

    _bmm = _mm

    def _matrix(self, value: Any) -> tuple[int, bool]:
        """Return a matrix or a stack, and whether it is to be transposed: copies are avoided."""
        if isinstance(value, torch.Tensor) and value.ndim == 2 and not value.is_contiguous() \
                and value.t().is_contiguous():
            return self._node(value.t()), True
        node = self._node(value)
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
    return any(isinstance(leaf, _Dependent) for leaf in torch.utils._pytree.tree_leaves(values))


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
