# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Formulas: parsed from text without executing it, differentiated, and converted to code.

In the graph of a formula equal subexpressions are one node. Its derivatives are nodes of the same
graph: common parts of H, its gradient and its Hessian-vector product are computed once.
"""

from collections import Counter
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
import math
import re
from types import MappingProxyType
from typing import Any
import unicodedata

from hnn_vi_ros.errors import did_you_mean
from hnn_vi_ros.hamiltonians.kinks import is_continuous
import numpy as np

# Maximum number of characters, of nested brackets, and of graph nodes with all derivatives.
LONGEST, DEEPEST, MOST_NODES = 4000, 60, 10_000
# Number of lines on which kinks are sought.
_LINES = 512
# Syntax of a formula, for error messages.
GRAMMAR = ('numbers, names, + - * / ^ or **, brackets, pi, and the functions abs, acos, acosh, '
           'asin, asinh, atan, atan2(y, x), atanh, cbrt, cos, cosh, exp, expm1, log, log1p, '
           'max, min, piecewise(x > 0, a, b), sign, sin, sinh, sqrt, tan and tanh')

# Derivatives of functions by their argument x, at the value z.
_SLOPES: dict[str, Callable[['Graph', int, int], int]] = {
    'abs': lambda g, x, z: g.apply('sign', x),
    'acos': lambda g, x, z: g.scaled(-1.0, _root_of_rest(g, x)),
    'acosh': lambda g, x, z: g.over(g.number(1.0), g.apply('sqrt', g.plus(
        g.power(x, 2), g.number(-1.0)))),
    'asin': lambda g, x, z: _root_of_rest(g, x),
    'asinh': lambda g, x, z: g.over(g.number(1.0), g.apply('sqrt', g.plus(
        g.number(1.0), g.power(x, 2)))),
    'atan': lambda g, x, z: g.over(g.number(1.0), g.plus(g.number(1.0), g.power(x, 2))),
    'atanh': lambda g, x, z: g.over(g.number(1.0), g.plus(
        g.number(1.0), g.scaled(-1.0, g.power(x, 2)))),
    'cbrt': lambda g, x, z: g.over(g.number(1.0 / 3.0), g.power(z, 2)),
    'cos': lambda g, x, z: g.scaled(-1.0, g.apply('sin', x)),
    'cosh': lambda g, x, z: g.apply('sinh', x),
    'exp': lambda g, x, z: z,
    'expm1': lambda g, x, z: g.apply('exp', x),
    'log': lambda g, x, z: g.over(g.number(1.0), x),
    'log1p': lambda g, x, z: g.over(g.number(1.0), g.plus(g.number(1.0), x)),
    'sign': lambda g, x, z: g.number(0.0),
    'sin': lambda g, x, z: g.apply('cos', x),
    'sinh': lambda g, x, z: g.apply('cosh', x),
    'sqrt': lambda g, x, z: g.over(g.number(0.5), z),
    'tan': lambda g, x, z: g.plus(g.number(1.0), g.power(z, 2)),
    'tanh': lambda g, x, z: g.plus(g.number(1.0), g.scaled(-1.0, g.power(z, 2))),
    'versine': lambda g, x, z: g.apply('sin', x),
}
FUNCTIONS = (*(name for name in _SLOPES if name != 'versine'), 'atan2', 'max', 'min', 'piecewise')
# Kinds of nodes whose values or slopes jump: expressions that change their signs there.
SWITCHES: dict[str, Callable[..., int]] = {
    'abs': lambda g, x: x, 'atan2': lambda g, y, x: y, 'sign': lambda g, x: x,
    'where': lambda g, c, a, b: c}
# 1 - cos x as 2 sin(x / 2)^2 is accurate for small x, as for the heights of pendulums.
_NUMPY: dict[str, Callable[..., Any]] = {
    'acos': np.arccos, 'acosh': np.arccosh, 'asin': np.arcsin, 'asinh': np.arcsinh,
    'atan': np.arctan, 'atanh': np.arctanh,
    'versine': lambda x: 2.0 * np.sin(0.5 * x) ** 2}
# 1 - sin(x)^2 is cos(x)^2: its root, as of acos(cos x), keeps its kink.
_COMPLEMENTS = {'sin': 'cos', 'cos': 'sin'}
CALLS = {name: _NUMPY.get(name) or getattr(np, name) for name in _SLOPES}


class Graph:
    """
    Expressions as integers, larger than their arguments'; equal ones have equal integers.

    Attributes
    ----------
    nodes : list of tuple
        ``('number', x)``, ``('name', name)``, ``('scaled', c, a)`` for c a, ``('sum', a, b)``,
        ``('product', a, b)``, ``('over', a, b)`` for a / b, ``('power', a, n)`` with an integer n
        > 1, ``('raised', a, b)`` for any power, ``('atan2', a, b)``, ``('where', c, a, b)`` for a
        where c > 0 and b elsewhere, and ``(function, a)``.
    refusals : list of str
        Why operations on symbols of the graph were refused.

    """

    def __init__(self) -> None:
        self.nodes: list[tuple[Any, ...]] = []
        self.refusals: list[str] = []
        self._known: dict[tuple[Any, ...], int] = {}

    def _node(self, *node: Any) -> int:
        if node not in self._known:
            if len(self.nodes) == MOST_NODES:
                raise ValueError(f'the formula and its derivatives have more than {MOST_NODES} '
                                 'parts; shorten it, or give H as code (kind: python)')
            self._known[node] = len(self.nodes)
            self.nodes.append(node)
        return self._known[node]

    def number(self, value: float) -> int:
        """Return the node of a number; -0 becomes 0."""
        if not math.isfinite(value):
            raise ValueError(f'this is {value}, not a finite number')
        return self._node('number', float(value) + 0.0)

    def name(self, name: str) -> int:
        """Return the node bound to a name."""
        return self._node('name', name)

    def value(self, a: int) -> float | None:
        """Return the value of a number node, None for other nodes."""
        kind, *rest = self.nodes[a]
        return rest[0] if kind == 'number' else None

    def _factor(self, a: int) -> tuple[float, int]:
        """Return c and b of a = c b, where c is a numerical factor."""
        kind, *rest = self.nodes[a]
        return (rest[0], rest[1]) if kind == 'scaled' else (1.0, a)

    def scaled(self, c: float, a: int) -> int:
        """Return c a."""
        value, (inner, rest) = self.value(a), self._factor(a)
        if value is not None:
            return self.number(c * value)
        c *= inner
        if c == 0.0 or not math.isfinite(c):
            return self.number(c)
        return rest if c == 1.0 else self._node('scaled', c, rest)

    def plus(self, a: int, b: int) -> int:
        """Return a + b."""
        x, y = self.value(a), self.value(b)
        if x is not None and y is not None:
            return self.number(x + y)
        if x == 0.0:
            return b
        if y == 0.0:
            return a
        (c, rest), (d, other) = self._factor(a), self._factor(b)
        if rest == other:
            return self.scaled(c + d, rest)
        for value, factor, part in ((x, d, other), (y, c, rest)):
            kind, *inside = self.nodes[part]
            if value == -factor and kind == 'cos':
                return self.scaled(value, self._node('versine', *inside))
            if kind == 'power' and inside[1] == 2:
                own, base = self._factor(inside[0])
                kind, *inside = self.nodes[base]
                if value == -factor * own * own and kind in _COMPLEMENTS:
                    return self.scaled(value, self.power(
                        self.apply(_COMPLEMENTS[kind], *inside), 2))
        return self._node('sum', a, b)

    def minus(self, a: int, b: int) -> int:
        """Return a - b."""
        return self.plus(a, self.scaled(-1.0, b))

    def product(self, a: int, b: int) -> int:
        """Return a b, with numerical factors in front."""
        for value, other in ((self.value(a), b), (self.value(b), a)):
            if value is not None:
                return self.scaled(value, other)
        (c, a), (d, b) = self._factor(a), self._factor(b)
        for whole, other in ((a, b), (b, a)):
            kind, *rest = self.nodes[whole]
            if kind == 'where' and 0.0 in map(self.value, rest[1:]):
                # The slope of a branch may be infinite where the other one is valid.
                return self.scaled(c * d, self.where(rest[0], *(
                    self.product(part, other) for part in rest[1:])))
            if kind == 'over' and self.value(rest[0]) == 1.0:
                return self.scaled(c * d, self.over(other, rest[1]))
        return self.scaled(c * d, self.power(a, 2) if a == b else self._node(
            'product', *sorted((a, b))))

    def over(self, a: int, b: int) -> int:
        """Return a / b; division by a number becomes multiplication by its inverse."""
        value = self.value(b)
        if value:
            return self.scaled(1.0 / value, a)
        if value == 0.0:
            raise ValueError('division by zero')
        if self.value(a) == 0.0:
            return a
        (c, a), (d, b) = self._factor(a), self._factor(b)
        if a == b:
            return self.number(c / d)
        number = self.value(a)
        if number is not None:
            c, a = c * number, self.number(1.0)
        return self.scaled(c / d, self._node('over', a, b))

    def power(self, a: int, n: int) -> int:
        """Return a to an integer power n >= 0."""
        value = self.value(a)
        if value is not None:
            return self.raised(a, self.number(float(n)))
        return (self.number(1.0), a)[n] if n < 2 else self._node('power', a, n)

    def raised(self, a: int, b: int) -> int:
        """Return a to the power b."""
        base, exponent = self.value(a), self.value(b)
        if exponent is None:
            return self._node('raised', a, b)
        if base is not None:
            with np.errstate(all='ignore'):
                return self.number(float(np.float_power(base, exponent)))
        if exponent < 0.0:
            return self.over(self.number(1.0), self.raised(a, self.number(-exponent)))
        if exponent <= 64.0 and exponent == int(exponent):
            return self.power(a, int(exponent))
        if exponent in (0.5, 1.5, 2.5):
            return self.product(self.power(a, int(exponent)), self.apply('sqrt', a))
        return self._node('raised', a, b)

    def apply(self, function: str, a: int) -> int:
        """Return a function of a."""
        value = self.value(a)
        if value is not None:
            with np.errstate(all='ignore'):
                return self.number(float(CALLS[function](value)))
        kind, *rest = self.nodes[a]
        if function == 'sqrt' and kind == 'power':
            # The rule of roots gives 0 / 0 at a base of 0.
            base = self.apply('abs', rest[0]) if rest[1] % 4 == 2 else rest[0]
            return self.raised(base, self.number(0.5 * rest[1]))
        return self._node(function, a)

    def where(self, c: int, a: int, b: int) -> int:
        """Return a where c > 0, and b elsewhere."""
        kind, *rest = self.nodes[c]
        if kind == 'where' and {*map(self.value, rest[1:])} == {0.0, 1.0}:
            # The condition is a comparison, as 0 or 1.
            return self.where(rest[0], *((a, b) if self.value(rest[1]) else (b, a)))
        value = self.value(c)
        if value is not None or a == b:
            return b if a == b or not value > 0.0 else a  # type: ignore[operator]
        return self._node('where', c, a, b)

    def largest(self, a: int, b: int, sign: float = 1.0) -> int:
        """Return the larger of a and b, or the smaller for sign = -1."""
        return self.where(self.plus(self.scaled(sign, a), self.scaled(-sign, b)), a, b)

    def smallest(self, a: int, b: int) -> int:
        """Return the smaller of a and b."""
        return self.largest(a, b, -1.0)

    def atan2(self, y: int, x: int) -> int:
        """Return the angle of the point (x, y)."""
        values = self.value(y), self.value(x)
        return self._node('atan2', y, x) if None in values else self.number(
            math.atan2(*values))  # type: ignore[arg-type]

    def arguments(self, a: int) -> Sequence[int]:
        """Return the arguments of a node."""
        kind, *rest = self.nodes[a]
        if kind in ('number', 'name'):
            return ()
        return rest[1:] if kind == 'scaled' else rest[:1] if kind == 'power' else rest

    def _slopes(self, a: int) -> list[tuple[int, int]]:
        """Return each argument of a node, or base of a power, with the node's derivative by it."""
        kind, *rest = self.nodes[a]
        one = self.number(1.0)
        if kind in ('product', 'power') and (found := self._half_power(kind, rest)) is not None:
            return [found]
        if kind == 'scaled':
            return [(rest[1], self.number(rest[0]))]
        if kind == 'sum':
            return [(part, one) for part in rest]
        if kind == 'product':
            return [(rest[0], rest[1]), (rest[1], rest[0])]
        if kind == 'over':
            return [(rest[0], self.over(one, rest[1])),
                    (rest[1], self.scaled(-1.0, self.over(a, rest[1])))]
        if kind == 'power':
            base, n = rest
            return [(base, self.scaled(float(n), self.power(base, n - 1)))]
        if kind == 'raised':
            base, exponent = rest
            less = self.plus(exponent, self.number(-1.0))
            return [(base, self.product(exponent, self.raised(base, less))),
                    (exponent, self.product(a, self.apply('log', base)))]
        if kind == 'where':
            zero = self.number(0.0)
            return [(rest[1], self.where(rest[0], one, zero)),
                    (rest[2], self.where(rest[0], zero, one))]
        if kind == 'atan2':
            y, x = rest
            squares = self.plus(self.power(x, 2), self.power(y, 2))
            return [(y, self.over(x, squares)), (x, self.scaled(-1.0, self.over(y, squares)))]
        return [(rest[0], _SLOPES[kind](self, rest[0], a))]

    def _half_power(self, kind: str, rest: Sequence[int]) -> tuple[int, int] | None:
        """
        Return x with the slope of x^n sqrt(c x) or of sqrt(x)^n; None of other nodes.

        The rules of products and of roots give 0 * inf at x = 0.
        """
        for whole, other in ((rest[0], rest[1]), (rest[1], rest[0])) if kind == 'product' else ():
            root, *inside = self.nodes[other]
            base, n = self.nodes[whole][1:] if self.nodes[whole][0] == 'power' else (whole, 1)
            if root == 'sqrt' and self._factor(inside[0])[1] == self._factor(base)[1]:
                return base, self.scaled(n + 0.5, self.product(self.power(base, n - 1), other))
        root, *inside = self.nodes[rest[0]]
        if kind == 'power' and root == 'sqrt':
            half = 0.5 * rest[1]
            return inside[0], self.scaled(half, self.raised(inside[0], self.number(half - 1.0)))
        return None

    def needed(self, roots: Iterable[int], known: Container[int] = ()) -> list[int]:
        """Return all nodes that the roots depend on, arguments first, except known ones."""
        found, rest = set(), list(roots)
        while rest:
            if (a := rest.pop()) not in found and a not in known:
                found.add(a)
                rest.extend(self.arguments(a))
        return sorted(found)

    def depending(self, roots: Iterable[int], names: Iterable[str]) -> set[int]:
        """Return the nodes below the roots that depend on names."""
        names = frozenset(names)
        found: set[int] = set()
        for a in self.needed(roots):
            kind, *rest = self.nodes[a]
            if (kind == 'name' and rest[0] in names) or found.intersection(self.arguments(a)):
                found.add(a)
        return found

    def gradient(self, root: int, names: Sequence[str]) -> list[int]:
        """Return the derivatives by names, by reverse accumulation."""
        own = self.depending([root], names)
        adjoints = {root: self.number(1.0)}
        for a in sorted(own, reverse=True):
            if a in adjoints and self.nodes[a][0] != 'name':
                for part, slope in self._slopes(a):
                    if part in own:
                        more = self.product(adjoints[a], slope)
                        adjoints[part] = self.plus(adjoints[part], more) \
                            if part in adjoints else more
        return [adjoints.get(self.name(name), self.number(0.0)) for name in names]

    def tangents(self, roots: Sequence[int], changes: Mapping[str, str]) -> list[int]:
        """Return the changes of nodes; ``changes`` maps names to the names of their changes."""
        found = {self.name(name): self.name(change) for name, change in changes.items()}
        for a in self.needed(roots):
            if a not in found and found.keys() & self.arguments(a):
                total = self.number(0.0)
                for part, slope in self._slopes(a):
                    if part in found:
                        total = self.plus(total, self.product(slope, found[part]))
                found[a] = total
        return [found.get(root, self.number(0.0)) for root in roots]

    def is_smooth(self, root: int, names: Sequence[str], parameters: Mapping[str, float]) -> bool:
        """Return whether a node and its derivatives by names are continuous functions of these."""
        # The gradient contains the kinks of acos(cos(x)) and others.
        roots = [root, *self.gradient(root, names)]
        kinked = [self.nodes[a] for a in sorted(self.depending(roots, names))
                  if self.nodes[a][0] in SWITCHES]
        if not kinked:
            return True
        both = roots + [SWITCHES[kind](self, *parts) for kind, *parts in kinked]

        def values(z: np.ndarray) -> np.ndarray:
            found = self.values(both, {**parameters, **dict(zip(names, z.T, strict=True))})
            return np.stack([np.broadcast_to(found[a], len(z)) for a in both], axis=1)
        # The lengths of H are unknown: lines of many.
        rng = np.random.default_rng(0)
        scales = 10.0**rng.uniform(-4.0, 4.0, (_LINES, 1))
        return is_continuous(values, len(roots), scales * rng.normal(size=(2, _LINES, len(names))))

    def values(self, roots: Sequence[int], known: Mapping[str, Any]) -> dict[int, Any]:
        """Return the value of each node that the roots depend on, given the values of names."""
        found: dict[int, Any] = {}
        with np.errstate(all='ignore'):
            for a in self.needed(roots):
                kind, *rest = self.nodes[a]
                parts = [found[part] for part in self.arguments(a)]
                if kind == 'number':
                    found[a] = np.float64(rest[0])
                elif kind == 'name':
                    # A Python float would raise where a numpy float becomes infinite.
                    found[a] = np.asarray(known[rest[0]])[()]
                elif kind == 'scaled':
                    found[a] = rest[0] * parts[0]
                elif kind == 'power':
                    found[a] = parts[0] ** rest[1]
                else:
                    found[a] = {**CALLS, **_OPERATIONS}[kind](*parts)
        return found

    def code(self, roots: Sequence[int], texts: Mapping[int, str]) -> tuple[list[str], list[str]]:
        """
        Return lines of Python that compute nodes, and an expression for each of them.

        Parameters
        ----------
        roots : sequence of int
            The nodes.
        texts : mapping of int to str
            Expressions for the known nodes.

        """
        order = self.needed(roots, texts.keys())
        divisors = Counter(self.nodes[a][2] for a in order if self.nodes[a][0] == 'over')
        lines, text, inverses = list[str](), dict(texts), dict[int, str]()
        for a in order:
            kind, *rest = self.nodes[a]
            if kind == 'number':
                text[a] = f'({rest[0]!r})'
                continue
            made = self._text(kind, rest, [text[part] for part in self.arguments(a)])
            if kind == 'over' and divisors[rest[1]] > 1:
                # A repeated divisor is inverted once: a product is ten times faster.
                if rest[1] not in inverses:
                    inverses[rest[1]] = f'i{rest[1]}'
                    lines.append(f'i{rest[1]} = 1.0 / {text[rest[1]]}')
                made = inverses[rest[1]] if self.value(rest[0]) == 1.0 else \
                    f'{text[rest[0]]} * {inverses[rest[1]]}'
            text[a] = f't{a}'
            lines.append(f't{a} = {made}')
        return lines, [text[root] for root in roots]

    def formula(self, root: int) -> str:
        """Return the formula of a node, or raise ValueError if it is too long."""
        # Texts with their precedence: 0 for sums and signs, 1 for products, 2 for powers.
        texts: dict[int, tuple[str, int]] = {}

        def put(a: int, least: int) -> str:
            text, level = texts[a]
            return text if level >= least else f'({text})'

        for a in self.needed([root]):
            kind, *rest = self.nodes[a]
            if kind == 'name':
                texts[a] = rest[0], 3
            elif kind == 'number':
                texts[a] = _shortest(rest[0]), 3 if rest[0] >= 0.0 else 0
            elif kind == 'scaled':
                sign = '-' if rest[0] < 0.0 else ''
                factor = '' if abs(rest[0]) == 1.0 else f'{_shortest(abs(rest[0]))}*'
                texts[a] = f'{sign}{factor}{put(rest[1], 1)}', 0 if sign else 1
            elif kind == 'sum':
                texts[a] = f'{put(rest[0], 0)} + {put(rest[1], 0)}'.replace('+ -', '- '), 0
            elif kind in ('product', 'over'):
                texts[a] = f'{put(rest[0], 1)}{_SIGNS[kind]}{put(rest[1], 2)}', 1
            elif kind == 'power':
                texts[a] = f'{put(rest[0], 3)}^{rest[1]}', 2
            elif kind == 'raised':
                texts[a] = f'{put(rest[0], 3)}^{put(rest[1], 3)}', 2
            elif kind == 'versine':
                texts[a] = f'1 - cos({put(rest[0], 0)})', 0
            else:
                first, *others = (put(part, 0) for part in rest)
                name, sign = ('piecewise', ' > 0') if kind == 'where' else (kind, '')
                texts[a] = f'{name}({", ".join([first + sign, *others])})', 3
            if len(texts[a][0]) > LONGEST:
                raise ValueError(f'the formula of H has more than {LONGEST} characters; give H '
                                 'as code (kind: python)')
        return texts[root][0]

    def _text(self, kind: str, rest: Sequence[Any], own: Sequence[str]) -> str:
        if kind == 'scaled':
            return f'-{own[0]}' if rest[0] == -1.0 else f'{rest[0]!r} * {own[0]}'
        if kind == 'power':
            return ' * '.join(own * rest[1]) if rest[1] <= 4 else f'{own[0]} ** {rest[1]}'
        if kind == 'raised':
            return f'np.power({", ".join(own)})'
        if kind in _SIGNS:
            return f' {_SIGNS[kind]} '.join(own)
        if kind == 'versine':
            return f'2.0 * np.sin(0.5 * {own[0]}) ** 2'
        if kind == 'where':
            return f'({own[1]} if {own[0]} > 0.0 else {own[2]})'
        return f'np.{(CALLS.get(kind) or _OPERATIONS[kind]).__name__}({", ".join(own)})'


def _shortest(value: float) -> str:
    """Return the shortest text that is read back as this number."""
    return repr(value).removesuffix('.0')


def _root_of_rest(graph: Graph, x: int) -> int:
    """Return 1 / sqrt(1 - x^2)."""
    rest = graph.plus(graph.number(1.0), graph.scaled(-1.0, graph.power(x, 2)))
    return graph.over(graph.number(1.0), graph.apply('sqrt', rest))


_SIGNS = {'sum': '+', 'product': '*', 'over': '/'}
_OPERATIONS: dict[str, Callable[..., Any]] = {
    'sum': np.add, 'product': np.multiply, 'over': np.divide, 'raised': np.float_power,
    'atan2': np.arctan2, 'where': lambda c, a, b: np.asarray(np.where(c > 0.0, a, b))[()]}
# Nodes of functions of several arguments, and their number; None for two or more.
_OF_SEVERAL: dict[str, tuple[Callable[..., int], int | None]] = {
    'atan2': (Graph.atan2, 2), 'max': (Graph.largest, None),
    'min': (Graph.smallest, None)}
COMPARISONS: dict[str, Callable[[Graph, int, int], int]] = {
    '>': lambda g, a, b: g.where(g.minus(a, b), g.number(1.0), g.number(0.0)),
    '<': lambda g, a, b: COMPARISONS['>'](g, b, a),
    '>=': lambda g, a, b: g.where(g.minus(b, a), g.number(0.0), g.number(1.0)),
    '<=': lambda g, a, b: COMPARISONS['>='](g, b, a)}


_TOKEN = re.compile(r'\s*(?:(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)'
                    r'|(?P<name>[^\W\d]\w*)|(?P<sign>\*\*|[<>]=?|[-+*/^(),]))')


def _is_number(sign: str) -> bool:
    """Return whether a sign is a superscript, a subscript, a fraction or a digit not of ASCII."""
    return not sign.isascii() and (sign.isdecimal() or unicodedata.decomposition(
        sign).startswith(('<super>', '<sub>', '<fraction>')))


class Reader:
    """
    Parser of a formula into a graph.

    Parameters
    ----------
    graph : Graph
        The graph to extend.
    text : str
        The formula.
    start : int, optional
        Column of its first character in the user's text.
    called : mapping of str to str, optional
        Other names for some of the names.

    Attributes
    ----------
    root : int
        The formula.
    names : dict of str to int
        Names in the formula, with the column of their first occurrence.
    parts : dict of int to (int, int)
        Start and end of the text of nodes.

    Raises
    ------
    ValueError
        The text is invalid; the message gives the column and the expected token.

    """

    def __init__(self, graph: Graph, text: str, start: int = 1,
                 called: Mapping[str, str] = MappingProxyType({})):
        self._graph, self._text, self._start, self._called = graph, text, start, called
        if len(text) > LONGEST:
            raise ValueError(f'{len(text)} characters, expected at most {LONGEST}')
        self.names: dict[str, int] = {}
        self.parts: dict[int, tuple[int, int]] = {}
        self._depth = self._end = self._at = 0
        self._kind, self._token = '', ''
        self._next()
        self.root = self._sum()
        if self._kind:
            raise self._wrong('an operator')

    def column(self, place: int) -> int:
        """Return the column of a position in the text."""
        return self._start + place

    def _next(self) -> None:
        """Advance to the next token."""
        self._end = self._at + len(self._token)
        match = _TOKEN.match(self._text, self._end)
        if match is None:
            self._at = len(self._text) - len(self._text[self._end:].lstrip())
            self._kind, self._token = '', ''
            if self._at < len(self._text):
                self._token = self._text[self._at]
                raise self._wrong('')
            return
        self._kind = match.lastgroup or ''
        self._token, self._at = match[self._kind], match.start(self._kind)
        if self._kind == 'name' and (sign := next(filter(_is_number, self._token), '')):
            raise ValueError(f'column {self.column(self._at)}: {sign!r} in {self._token!r}; write '
                             'powers as x^2, fractions as 1/2, and digits as 0 to 9')

    def _wrong(self, expected: str) -> ValueError:
        where = f'column {self.column(self._at)}'
        found = f'found {self._token!r}' if self._token else 'the formula ends'
        hint = f', expected {expected}' if expected else ''
        return ValueError(f'{where}: {found}{hint}; valid: {GRAMMAR}')

    def _takes(self, *signs: str) -> str:
        """Return the present sign and advance if it is one of these, else return ''."""
        if self._kind != 'sign' or self._token not in signs:
            return ''
        sign = self._token
        self._next()
        return sign

    def _made(self, begin: int, make: Callable[..., int], *parts: Any) -> int:
        """Return the node of the text from a position, or raise an error at that position."""
        try:
            node = make(*parts)
        except ValueError as problem:
            raise ValueError(f'column {self.column(begin)}: '
                             f'{self._text[begin:self._end]!r:.60}: {problem}') from problem
        self.parts.setdefault(node, (begin, self._end))
        return node

    def _deeper(self, read: Callable[[], int]) -> int:
        self._depth += 1
        if self._depth > DEEPEST:
            raise ValueError(f'column {self.column(self._at)}: brackets, signs or powers are '
                             f'nested more than {DEEPEST} deep')
        node = read()
        self._depth -= 1
        return node

    def _sum(self) -> int:
        begin, graph = self._at, self._graph
        node = self._product()
        while sign := self._takes('+', '-'):
            other = self._product()
            node = self._made(begin, graph.plus if sign == '+' else graph.minus, node, other)
        return node

    def _product(self) -> int:
        begin, graph = self._at, self._graph
        node = self._signed()
        while sign := self._takes('*', '/'):
            make = graph.product if sign == '*' else graph.over
            node = self._made(begin, make, node, self._signed())
        return node

    def _signed(self) -> int:
        begin = self._at
        if sign := self._takes('+', '-'):
            node = self._deeper(self._signed)
            return self._made(begin, self._graph.scaled, -1.0, node) if sign == '-' else node
        return self._power()

    def _power(self) -> int:
        begin = self._at
        base = self._atom()
        if not self._takes('^', '**'):
            return base
        # Right-associative, as in mathematics: 2^3^2 is 2^9.
        return self._made(begin, self._graph.raised, base, self._deeper(self._signed))

    def _atom(self) -> int:
        begin, kind, token = self._at, self._kind, self._token
        if self._takes('('):
            return self._closed(begin)
        if kind == 'number':
            self._next()
            return self._made(begin, self._graph.number, float(token))
        if kind != 'name':
            raise self._wrong('a number, a name or a bracket')
        self._next()
        if self._takes('('):
            if token not in FUNCTIONS:
                raise ValueError(f'column {self.column(begin)}: unknown function {token!r}'
                                 f'{did_you_mean(token, FUNCTIONS)}; write a product as '
                                 f'{token}*(...); valid: {GRAMMAR}')
            return self._called_with(begin, token, self._arguments(begin))
        if token in ('pi', 'π'):
            return self._graph.number(math.pi)
        self.names.setdefault(token, self.column(begin))
        return self._graph.name(self._called.get(token, token))

    def _arguments(self, begin: int) -> list[int]:
        """Return the nodes up to the closing bracket; comparisons are 0 or 1."""
        found = list[int]()
        while not found or self._takes(','):
            node = self._deeper(self._sum)
            if sign := self._takes(*COMPARISONS):
                node = self._made(begin, COMPARISONS[sign], self._graph, node,
                                  self._deeper(self._sum))
            found.append(node)
        self._close(begin)
        return found

    def _called_with(self, begin: int, name: str, parts: list[int]) -> int:
        """Return the node of a function of several arguments."""
        make, count = _OF_SEVERAL.get(name, (None, 1))
        if name == 'piecewise':
            if len(parts) % 2 == 0 or len(parts) < 3:
                raise ValueError(f'column {self.column(begin)}: piecewise expects condition, '
                                 'value, ..., and the value elsewhere')
            *rest, node = parts
            for value, condition in zip(rest[::-2], rest[-2::-2], strict=True):
                node = self._made(begin, self._graph.where, condition, value, node)
            return node
        if len(parts) != (count or max(2, len(parts))):
            raise ValueError(f'column {self.column(begin)}: {name} of {len(parts)} arguments, '
                             f'expected {count or "two or more"}')
        node = parts[0]
        if make is None:
            return self._made(begin, self._graph.apply, name, node)
        for part in parts[1:]:
            node = self._made(begin, make, self._graph, node, part)
        return node

    def _closed(self, begin: int) -> int:
        """Return the node up to the closing bracket."""
        node = self._deeper(self._sum)
        self._close(begin)
        return node

    def _close(self, begin: int) -> None:
        if not self._takes(')'):
            raise self._wrong(f'an operator, or the bracket that closes the one in column '
                              f'{self.column(begin)}')
