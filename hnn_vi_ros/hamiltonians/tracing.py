# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Formulas of Python functions: called with symbols, and compared with their values of numbers.

A symbol is a node of ``expressions`` with operators. Arrays of symbols are object arrays of numpy.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
import math
from typing import Any, NoReturn

from hnn_vi_ros.hamiltonians.arguments import Arguments, read_arguments, TIME
from hnn_vi_ros.hamiltonians.expressions import CALLS, COMPARISONS, Graph
import numpy as np


class Untraceable(TypeError, AttributeError):
    """An operation on a symbol that no formula contains."""


def _refused(what: str) -> Callable[..., Any]:
    return lambda one, *_others: one._refuse(f'{what} needs values of q and p')


def _compared(sign: str) -> Callable[['Symbol', Any], Any]:
    return lambda one, other: one._made(partial(COMPARISONS[sign], one.graph), other)


def _combined(name: str) -> Callable[['Symbol', Any], Any]:
    return lambda *parts: _on_symbols(name)(*parts)


class Symbol:
    """A node with arithmetic operators: functions of numbers applied to it build formulas."""

    def __init__(self, graph: Graph, node: int):
        self.graph, self.node = graph, node

    def _refuse(self, why: str) -> NoReturn:
        # An `except` of the function may hide the error.
        self.graph.refusals.append(why)
        raise Untraceable(why)

    def _made(self, make: Callable[[int, int], int], other: Any) -> Any:
        if isinstance(other, np.ndarray):
            # numpy applies the operator to each element.
            return NotImplemented
        node = other.node if isinstance(other, Symbol) else self.graph.number(other)
        return Symbol(self.graph, make(self.node, node))

    def __add__(self, other: Any) -> Any:
        """Return the sum."""
        return self._made(self.graph.plus, other)

    def __mul__(self, other: Any) -> Any:
        """Return the product."""
        return self._made(self.graph.product, other)

    def __truediv__(self, other: Any) -> Any:
        """Return the quotient."""
        return self._made(self.graph.over, other)

    def __neg__(self) -> Any:
        """Return the negative."""
        return self * -1.0

    def __sub__(self, other: Any) -> Any:
        """Return the difference."""
        return self + -other

    def __rsub__(self, other: Any) -> Any:
        """Return the difference."""
        return -self + other

    def __rtruediv__(self, other: Any) -> Any:
        """Return the quotient."""
        return Symbol(self.graph, self.graph.number(other)) / self

    def __pow__(self, other: Any) -> Any:
        """Return the power."""
        return self._made(self.graph.raised, other)

    def __rpow__(self, other: Any) -> Any:
        """Return the power."""
        return Symbol(self.graph, self.graph.number(other)) ** self

    def __pos__(self) -> 'Symbol':
        """Return the symbol."""
        return self

    def __abs__(self) -> 'Symbol':
        """Return the absolute value."""
        return Symbol(self.graph, self.graph.apply('abs', self.node))

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        """Call a function of numpy on symbols, element by element."""
        name, plain = ufunc.__name__, [_object_array(one) for one in inputs]
        if name in _SMOOTH or name in _OF_SYMBOLS:
            ufunc = np.frompyfunc(_on_symbols(name), ufunc.nin, 1)
        elif not any('O' in types for types in ufunc.types):
            next(one for one in np.ravel(_object_array(self)) if isinstance(one, Symbol))._refuse(
                f'no formula contains {name}')
        if 'out' in options:
            options['out'] = tuple(map(_object_array, options['out']))
        found = getattr(ufunc, method)(*plain, **options)
        return _as_symbols(found)

    __radd__, __rmul__ = __add__, __mul__
    __lt__, __le__, __gt__, __ge__ = map(_compared, ('<', '<=', '>', '>='))
    __and__, __or__ = _combined('logical_and'), _combined('logical_or')
    __invert__ = _combined('invert')
    # Operations on values: a branch would be taken for all values.
    __eq__, __ne__ = _refused('=='), _refused('!=')
    __mod__ = __rmod__ = _refused('%')
    __floordiv__ = __rfloordiv__ = _refused('//')
    __bool__ = _refused('a branch (if, and, or)')
    __float__ = _refused('a conversion (float, or a function of math)')
    __int__, __complex__ = _refused('a conversion (int)'), _refused('a conversion (complex)')
    __index__, __round__ = _refused('an index'), _refused('round')
    __hash__ = _refused('a hash (lru_cache, set, dict)')

    def __getattr__(self, name: str) -> Callable[..., Any]:
        """Return the method that numpy calls for its function of this name."""
        if name in _REDUCTIONS:
            return getattr(_as_symbols(_object_array(self)), name)
        if name not in _SMOOTH and name not in _OF_SYMBOLS:
            if isinstance(getattr(np, name, None), np.ufunc):
                self._refuse(f'no formula contains {name}')
            raise Untraceable(f'no formula contains {name}')
        return partial(_on_symbols(name), self)


# Methods of numpy's numbers and arrays.
_REDUCTIONS = 'sum', 'prod', 'mean', 'max', 'min', 'item', 'copy'
# Names in numpy: functions of one number, and of others, as nodes.
_SMOOTH = {CALLS[name].__name__: name for name in CALLS if name != 'versine'}
_OF_SYMBOLS: dict[str, Callable[..., int]] = {
    'arctan2': Graph.atan2, 'maximum': Graph.largest, 'fmax': Graph.largest,
    'minimum': Graph.smallest, 'fmin': Graph.smallest,
    'clip': lambda g, x, low, high: g.smallest(g.largest(x, low), high),
    'hypot': lambda g, x, y: g.apply('sqrt', g.plus(g.power(x, 2), g.power(y, 2))),
    'greater': COMPARISONS['>'], 'greater_equal': COMPARISONS['>='],
    'less': COMPARISONS['<'], 'less_equal': COMPARISONS['<='],
    'logical_and': Graph.product, 'bitwise_and': Graph.product, 'where': Graph.where,
    'logical_or': Graph.largest, 'bitwise_or': Graph.largest,
    **dict.fromkeys(('logical_not', 'invert'), lambda g, x: g.minus(g.number(1.0), x)),
    # Symbols are real numbers.
    'conjugate': lambda g, x: x, 'float_power': Graph.raised,
    'exp2': lambda g, x: g.raised(g.number(2.0), x),
    **dict.fromkeys(('deg2rad', 'radians'), lambda g, x: g.scaled(math.pi / 180.0, x)),
    **dict.fromkeys(('rad2deg', 'degrees'), lambda g, x: g.scaled(180.0 / math.pi, x)),
    'log2': lambda g, x: g.scaled(1.0 / math.log(2.0), g.apply('log', x)),
    'log10': lambda g, x: g.scaled(1.0 / math.log(10.0), g.apply('log', x)),
    'logaddexp': lambda g, x, y: g.plus(g.largest(x, y), g.apply('log1p', g.apply(
        'exp', g.scaled(-1.0, g.apply('abs', g.minus(x, y))))))}


def _object_array(value: Any) -> Any:
    """Return an array without the class of symbols; a symbol as an array of it."""
    if getattr(value, 'dtype', None) == np.longdouble:
        # Its operators would call ufuncs again.
        return np.asarray(value, np.float64)[()]
    return np.asarray(value, dtype=object).view(np.ndarray) if isinstance(
        value, Symbol | _Symbols) else value


def _on_symbols(name: str) -> Callable[..., Any]:
    """Return a function of numpy as one of symbols and numbers."""
    def call(*parts: Any) -> Any:
        graph = next((one.graph for one in parts if isinstance(one, Symbol)), None)
        if graph is None:
            return getattr(np, name)(*(float(one) for one in parts))
        nodes = [one.node if isinstance(one, Symbol) else graph.number(one) for one in parts]
        return Symbol(graph, _OF_SYMBOLS[name](graph, *nodes) if name in _OF_SYMBOLS else
                      graph.apply(_SMOOTH[name], *nodes))
    return call


class _Symbols(np.ndarray):
    """An array of symbols, for which functions of numpy are formulas."""

    __array_ufunc__ = Symbol.__array_ufunc__


def _as_symbols(found: Any) -> Any:
    return found.view(_Symbols) if isinstance(found, np.ndarray) else found


def _elementwise(name: str) -> Callable[..., Any]:
    return lambda *parts: _as_symbols(np.frompyfunc(_on_symbols(name), len(parts), 1)(
        *map(_object_array, parts)))


def _norm(x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:  # noqa: A002
    if ord is not None and np.ndim(x) > 1 and not isinstance(axis, int):
        raise Untraceable('no formula contains this norm of a matrix')
    size, over = _as_symbols(np.asarray(abs(x))), {'axis': axis, 'keepdims': keepdims}
    if ord in (None, 2):
        return np.sqrt(np.sum(np.square(_as_symbols(x)), **over))
    if abs(ord) == np.inf:
        return (np.maximum if ord > 0 else np.minimum).reduce(size, **over)
    return np.sum(size ** ord, **over) ** (1.0 / ord)


def _determinant(a: Any) -> Any:
    # Cofactors: without values no row is known to be the pivot.
    if len(a) > _MAX_ROWS:
        raise Untraceable(f'no formula contains a matrix with more than {_MAX_ROWS} rows')
    return sum(((-1.0) ** k * a[0, k] * _determinant(np.delete(a[1:], k, axis=1))
                for k in range(len(a))), 0.0) if len(a) else 1.0


def _inverse(a: Any) -> Any:
    whole, rows = _determinant(a), range(len(a))
    return _as_symbols(np.array([[(-1.0) ** (i + k) * _determinant(
        np.delete(np.delete(a, k, axis=0), i, axis=1)) / whole for k in rows] for i in rows]))


def _select(conditions: Any, choices: Any, default: Any = 0.0) -> Any:
    for condition, choice in zip(conditions[::-1], choices[::-1], strict=True):
        default = np.where(condition, choice, default)
    return default


_MAX_ROWS = 4
# Functions of numpy that do not ask the symbols in an array, with those for symbols.
_WITHOUT_DISPATCH: dict[tuple[Any, str], Callable[..., Any]] = {
    (np, 'where'): _elementwise('where'), (np, 'clip'): _elementwise('clip'),
    (np, 'select'): _select,
    (np.linalg, 'norm'): _norm, (np.linalg, 'det'): lambda a: _determinant(_object_array(a)),
    (np.linalg, 'inv'): lambda a: _inverse(_object_array(a)),
    (np.linalg, 'solve'): lambda a, b: np.linalg.inv(a) @ _as_symbols(np.asarray(b))}


def _also_of_symbols(usual: Callable[..., Any], own: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of numpy that takes symbols as well."""
    return lambda *parts, **options: (own if any(
        np.asarray(part).dtype == object for part in parts) else usual)(*parts, **options)


@contextmanager
def _symbolic_numpy() -> Iterator[None]:
    """
    Let functions of numpy take arrays of symbols that np.array made, inside the context.

    numpy asks the class of an array for its functions; that of ``np.array([q[0], 1.0])`` is always
    np.ndarray, so no protocol reaches the symbols in it. Other arrays are passed on unchanged.
    """
    usual = {(module, name): getattr(module, name) for module, name in _WITHOUT_DISPATCH}
    try:
        for (module, name), function in usual.items():
            setattr(module, name, _also_of_symbols(function, _WITHOUT_DISPATCH[module, name]))
        yield
    finally:
        for (module, name), function in usual.items():
            setattr(module, name, function)


def trace(function: Callable[..., Any], q: Any) -> tuple[list[str], str]:
    """
    Return the names of the coordinates and the formula of a function H(q, p) or H(q, p, t).

    The formula must have the values of the function at 100 states, also at large ones.

    Parameters
    ----------
    function : callable
        Function with operators and functions of numpy; it is called with symbols, then with
        numbers. One whose arguments are named (p, q) is called with p first.
    q : float or sequence of float, shape (d,)
        Coordinates of a state: for a number they are q, with the momentum p; for a sequence q1,
        q2 and so on, with momenta p1, p2 and so on.

    Raises
    ------
    ValueError
        It uses values, as in branches, or is not a formula for other reasons; one line.

    """
    if hasattr(function, 'state_dict'):
        raise ValueError(f'H is the torch module {type(function).__name__}: write it to a file '
                         'with hnn_vi_ros.export, and name that in hamiltonian: {kind: hnn, model:'
                         ' FILE} of a scene')
    single, arguments = np.ndim(q) == 0, read_arguments(function)
    if not arguments.order:
        raise ValueError('H of one argument: expected H(q, p), or H(q, p, t) with the time t')
    graph, ends = Graph(), [''] if single else range(1, len(q) + 1)
    halves = [[Symbol(graph, graph.name(f'{half}{end}')) for end in ends] for half in 'qp']
    given = [own[0] if single else np.array(own, dtype=object).view(_Symbols) for own in halves]
    try:
        with _symbolic_numpy():
            # Functions of numba take no symbols.
            made = np.asarray(arguments.call(getattr(function, 'py_func', function), given, Symbol(
                graph, graph.name(TIME))), dtype=object)
        if graph.refusals:
            raise Untraceable(graph.refusals[0])
    except Exception as problem:  # noqa: B902  the user's code may raise any
        told: BaseException | None = problem
        while told is not None and not isinstance(told, Untraceable):
            # numpy reports its own errors instead.
            told = told.__cause__ or told.__context__
        raise ValueError(
            f'H cannot be traced: {" ".join(str(told or problem).split()):.300}; valid: + - * / '
            f"**, sums, products and norms of arrays, linalg.solve, inv and det, and numpy's "
            f'{", ".join([*_SMOOTH, *_OF_SYMBOLS])}; or give H as code (kind: python)'
            ) from problem
    if made.shape:
        raise ValueError(f'H returns an array of shape {made.shape}, expected a number; sum over '
                         'the coordinates')
    if not isinstance(root := made.item(), Symbol):
        raise ValueError(f'H returns {root!r:.60}, which depends on neither q nor p')
    _compare(function, arguments, graph, root.node, np.array(q, dtype=np.float64))
    return [f'q{end}' for end in ends], graph.formula(root.node)


# Number of states at which a formula must have the values of its function, and the largest
# difference relative to the largest part of the formula: cancellation in the function, as in
# 1 - cos(q), which the formula has not.
_STATES, _TOLERANCE = 100, 1e-6


def _compare(function: Callable[..., Any], arguments: Arguments, graph: Graph, root: int,
             start: np.ndarray) -> None:
    """Raise ValueError unless a formula has the values of its function, with numbers."""
    chance, names = np.random.default_rng(0), [node[1] for node in graph.nodes[:2 * start.size]]
    states = [*chance.normal(size=(_STATES, 2, *start.shape))]
    first, times = complex(math.nan), 10.0 ** chance.uniform(-2.0, 3.0, _STATES)
    # The first one is repeated at the end.
    for k, state in enumerate((*states, states[0])):
        number = k % _STATES
        state = state * (0.3, 2.0, 20.0, 200.0)[number % 8 // 2]
        state[0] += start * (number % 2)
        t = times[number]
        known = {TIME: t, **dict(zip(names, state.ravel(), strict=True))}
        values = graph.values([root], known)
        with np.errstate(all='ignore'):
            try:
                own = complex(np.asarray(arguments.call(
                    function, [half.copy()[()] for half in state], t)).item())
            except Exception as problem:  # noqa: B902  the user's code may raise any
                raise ValueError(f'H raises {type(problem).__name__} with numbers: '
                                 f'{" ".join(str(problem).split())}') from problem
            first = own if k == 0 else first
            again = k < _STATES or own == first or not np.isfinite(first)
            size = max(abs(value) for value in values.values() if np.isfinite(value))
            if not again or (np.isfinite(own) and not own.imag and not (
                    abs(values[root] - own.real) <= _TOLERANCE * size)):
                raise ValueError(
                    f'H with numbers differs from its formula: at q = {state[0].tolist()}, p = '
                    f'{state[1].tolist()} it is {own.real:.9g}, and {values[root]:.9g} by '
                    f'{graph.formula(root):.200}; make it a function of q, p and t alone, without '
                    'random numbers, counters, and code that depends on the type of q and p')
