# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion of a formula to the functions of a kernel: code without loops, for any parameters."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, cached_property
from hashlib import sha256
import math
import re
from types import MappingProxyType
from typing import Any, ClassVar, Self

from hnn_vi_ros.errors import did_you_mean, listed
from hnn_vi_ros.hamiltonians.arguments import TIME, TIME_DEPENDENT, TIMES
from hnn_vi_ros.hamiltonians.base import compiled_kernel, Hamiltonian
from hnn_vi_ros.hamiltonians.expressions import FUNCTIONS, Graph, Reader
from hnn_vi_ros.hamiltonians.parameters import check_finite
from hnn_vi_ros.kernels import Kernel
from hnn_vi_ros.phase_space import momentum_name
import numpy as np

# Names that look like constants, without a value: remedies.
CONSTANTS = {'e': '; write exp(x) for e^x', 'pi': '; did you mean pi?', **dict.fromkeys(
    ('inf', 'infinity', 'nan'), '; give finite numbers')}
NAME = r'^[^\W\d]\w*$'


class AnalyticHamiltonian(Hamiltonian):
    """
    A Hamiltonian given by a formula.

    Attributes
    ----------
    names : sequence of str
        Names of the columns of q in the formula; momenta have the prefix p. Missing columns of
        momenta, such as the fourth of a quaternion, stay zero.
    formula : str
        H, in these names and constants.
    constants : dict of str to float
        Values of the constants.

    """

    names: ClassVar[Sequence[str]]
    formula: ClassVar[str]
    constants: Mapping[str, float] = MappingProxyType({})

    def copy(self) -> Self:
        """Return the same function for use in another thread: its code has no workspace."""
        other = super().copy()
        if self.time is None:
            other.kernel = self.kernel
        return other

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions for simulations."""
        graph = Graph()
        root = read_hamiltonian(graph, self.names, self.formula, self.constants).root
        momenta = [f'p_{name}' for name in self.names]
        return graph_kernel(graph, root, self.names, momenta, self.constants)._replace(
            rotations=self.rotations)


def read_hamiltonian(graph: Graph, names: Sequence[str], text: str,
                     parameters: Mapping[str, float]) -> Reader:
    """
    Return H as parsed, with the momentum of each coordinate c named p_c; see read_formula.

    Unless a coordinate or a parameter has the name t, it is the time.
    """
    momenta = {f'p_{name}': name for name in names}
    momenta |= {own: name for name in names
                if (own := momentum_name(name)) not in {*momenta, *names, *parameters}}
    check_names('parameters', [*parameters], {*names, *momenta})
    # The code does not depend on the names of momenta.
    time = [TIME] if TIME not in {*names, *momenta, *parameters} else []
    return read_formula('H', graph, text, [*names, *momenta, *time], parameters, {
        name: f'p_{coordinate}' for name, coordinate in momenta.items()})


def graph_kernel(graph: Graph, root: int, names: Sequence[str], momenta: Sequence[str],
                 parameters: Mapping[str, float], time: np.ndarray | None = None) -> Kernel:
    """
    Return the functions of H as code without loops, the same for all values of the parameters.

    Parameters
    ----------
    graph : Graph
        The graph with H, to which its derivatives are added.
    root : int
        H.
    names, momenta : sequence of str
        Names of the d coordinates and their momenta.
    parameters : mapping of str to float
        Values of the other names.
    time : np.ndarray, shape (2,), optional
        See ``Hamiltonian.time``.

    """
    return graph_kernels(graph, root, names, momenta, time)(parameters)


def graph_kernels(graph: Graph, root: int, names: Sequence[str], momenta: Sequence[str],
                  time: np.ndarray | None = None) -> Callable[[Mapping[str, float]], Kernel]:
    """Return ``graph_kernel`` as a function of the values alone, for many of them."""
    d, both, timed = len(names), [*names, *momenta], [] if time is None else [TIME]
    slopes, changes = graph.gradient(root, both), {name: f'change of {name}' for name in both}
    products, rates = graph.tangents(slopes, changes), graph.gradient(root, timed)
    constants = constants_of(graph, [root, *slopes, *products, *rates],
                             [*both, *changes.values(), *timed])
    code = Code(graph, constants, {
        own: f'{array}[k + {i}]' for array, owners in (
            ('q', names), ('p', momenta), ('v_q', [changes[name] for name in names]),
            ('v_p', [changes[name] for name in momenta])) for i, own in enumerate(owners)}
        | dict.fromkeys(timed, 'time[0]'), ['time'] if timed else [])
    places, more = ([f'{half}[k + {i}]' for half in halves for i in range(d)] for halves in (
        ('dH_dq', 'dH_dp'), ('product_q', 'product_p')))
    loop = f'for k in range(0, q.size, {d}):'
    functions = (
        code.function('energy', 'q, p', [], [root], 'k = 0'),
        code.function('gradient', 'q, p, dH_dq, dH_dp', places + ['time[1]'] * len(rates),
                      slopes + rates, loop),
        code.function('hessian_vector', 'q, p, v_q, v_p, product_q, product_p', more, products,
                      loop))
    quadratic = not graph.depending(products[d:], [*both, *(changes[name] for name in names)])

    def kernel(parameters: Mapping[str, float]) -> Kernel:
        values = graph.values(constants, parameters)
        return compiled_kernel(
            functions, (*(() if time is None else (time,)),
                        *(float(values[a]) for a in constants)), d,
            (_largest_term(graph, slopes[:d], parameters),
             _largest_term(graph, slopes[d:], parameters)))._replace(quadratic=quadratic)
    return kernel


class Code:
    """
    Functions generated from a graph.

    Parameters
    ----------
    graph : Graph
        The graph with all results.
    constants : sequence of int
        Nodes whose values are the parameters of the functions, in this order.
    inputs : mapping of str to str
        Expressions for the other names, such as ``q[k + 0]``.
    first : sequence of str, optional
        Names of the parameters before the constants.

    """

    def __init__(self, graph: Graph, constants: Sequence[int], inputs: Mapping[str, str],
                 first: Sequence[str] = ()):
        self._graph, self._constants, self._inputs = graph, constants, inputs
        self._parameters = [*first, *(f'c{i}' for i in range(len(constants)))]

    def function(self, name: str, arguments: str, outputs: Sequence[str], roots: Sequence[int],
                 head: str = '', add: bool = False) -> Callable[..., Any]:
        """
        Return a function, the same one for the same code in every process.

        Parameters
        ----------
        name : str
            Its name.
        arguments : str
            Its arguments after ``parameters``.
        outputs : sequence of str
            Targets of the nodes, assigned or added to; without any, the single node is returned.
        roots : sequence of int
            The nodes.
        head : str, optional
            Its first line, a loop or a statement.
        add : bool, optional
            True to add the nodes to the targets.

        """
        graph = self._graph
        texts = {a: f'c{i}' for i, a in enumerate(self._constants)}
        lines, found = [], {}
        needed = set(graph.needed(roots))
        for i, (own, place) in enumerate(self._inputs.items()):
            node = graph.name(own)
            if node in needed:
                found[node] = f'x{i}'
                lines.append(f'x{i} = {place}')
        body, texts_of_roots = graph.code(roots, texts | found)
        lines += body
        sign = '+=' if add else '='
        lines += [f'{place} {sign} {text}' for place, text in zip(
            outputs, texts_of_roots, strict=True)] if outputs else [f'return {texts_of_roots[0]}']
        unpack = ''.join(f'{name}, ' for name in self._parameters)
        indent = '        ' if head.endswith(':') else '    '
        return _compile(name, '\n'.join([
            f'def {name}(parameters, {arguments}):',
            *([f'    {unpack}= parameters'] if unpack else []), *([f'    {head}'] if head else []),
            *(indent + line for line in lines)]))


@cache
def _compile(name: str, source: str) -> Callable[..., Any]:
    """Return the function of generated source, which contains no text of a user."""
    namespace: dict[str, Any] = {'np': np, '__name__': __name__}
    # As a part of this file, its machine code is cached like that of the other systems.
    exec(compile(source, __file__, 'exec'), namespace)
    function: Callable[..., Any] = namespace[name]
    function.__qualname__ = f'{name}_{sha256(source.encode()).hexdigest()[:16]}'
    return function


def constants_of(graph: Graph, roots: Sequence[int], names: Iterable[str]) -> list[int]:
    """Return the largest subexpressions that do not depend on names and are not numbers."""
    moving = graph.depending(roots, names)
    fixed = {part for a in moving for part in graph.arguments(a)} | set(roots)
    return sorted(a for a in fixed - moving if graph.nodes[a][0] != 'number')


def read_formula(key: str, graph: Graph, text: str, names: Sequence[str],
                 parameters: Mapping[str, float],
                 called: Mapping[str, str] = MappingProxyType({})) -> Reader:
    """
    Return a formula after a check that all names are known and all parameters are used.

    Parameters
    ----------
    key : str
        Name of the formula in error messages.
    graph : Graph
        The graph to extend.
    text : str
        The formula.
    names : sequence of str
        Names of the variables.
    parameters : mapping of str to float
        Values of the constants.
    called : mapping of str to str, optional
        Other names for some of the names.

    Raises
    ------
    ValueError
        The formula is invalid, or a name is unknown or unused.

    """
    check_finite(**{f'parameters {name}': value for name, value in parameters.items()})
    try:
        read = Reader(graph, text, called=called)
    except ValueError as problem:
        raise ValueError(f'{key} {problem}') from problem
    valid = [*names, *parameters]
    for name, column in read.names.items():
        if name not in valid:
            if name in TIMES and TIME in valid:
                raise ValueError(f'{key} column {column}: {name!r} names the time; write t')
            if name in TIMES:
                raise ValueError(f'{key} column {column}: {TIME_DEPENDENT.format(name)}')
            hint = CONSTANTS.get(name.lower()) or did_you_mean(name, valid)
            raise ValueError(f'{key} column {column}: unknown name {name!r}{hint}; valid: '
                             f'{listed(valid)}; give others a value in parameters')
    for name in parameters:
        if name not in read.names:
            raise ValueError(f'parameters {name}: not used in {key}; remove it')
    return read


def check_names(key: str, names: Sequence[str], taken: Iterable[str] = (),
                most: int = 1000) -> None:
    """Raise ValueError unless these are distinct valid names for a formula."""
    taken = {'pi', 'π', *FUNCTIONS, *taken}
    if len(names) > most:
        raise ValueError(f'{key} has {len(names)} entries, expected at most {most}')
    for i, name in enumerate(names):
        # fullmatch: `$` alone would accept a trailing line break.
        if not re.fullmatch(NAME, name):
            raise ValueError(f'{key} {name!r:.60} must be a letter or underscore, then letters, '
                             'digits, underscores')
        if name in taken or name in names[:i]:
            raise ValueError(f'{key}: the name {name!r} already has another meaning; rename it')


def _largest_term(graph: Graph, roots: Sequence[int], parameters: Mapping[str, float]) -> float:
    """Return the largest bound of a term of some sums, over terms that have a bound; else 0."""
    moving = graph.depending(roots, {
        node[1] for node in graph.nodes if node[0] == 'name'} - parameters.keys())
    fixed = graph.values([a for a in graph.needed(roots) if a not in moving], parameters)
    bounds: dict[int, float] = {}
    for a in graph.needed(roots):
        kind, *rest = graph.nodes[a]
        parts = [bounds[part] for part in graph.arguments(a)]
        if a in fixed:
            bounds[a] = abs(float(fixed[a]))
        elif kind == 'scaled':
            bounds[a] = abs(rest[0]) * parts[0]
        elif kind in ('product', 'sum'):
            bounds[a] = math.prod(parts) if kind == 'product' else sum(parts)
        else:
            bounds[a] = {'cos': 1.0, 'sin': 1.0, 'tanh': 1.0, 'versine': 2.0}.get(kind, math.inf)
    # The error of a single term is relative to its size.
    terms, rest = [0.0], [a for a in roots if graph.nodes[a][0] == 'sum']
    while rest:
        a = rest.pop()
        if graph.nodes[a][0] == 'sum':
            rest.extend(graph.arguments(a))
        elif math.isfinite(bounds[a]):
            terms.append(bounds[a])
    return max(terms)
