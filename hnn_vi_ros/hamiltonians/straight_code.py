# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""From a formula to the functions of a kernel: code without loops, the same for all parameters."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, cached_property
from hashlib import sha256
import math
import re
from types import MappingProxyType
from typing import Any, ClassVar

from hnn_vi_ros.errors import did_you_mean, listed
from hnn_vi_ros.hamiltonians.base import compiled_kernel, Hamiltonian
from hnn_vi_ros.hamiltonians.expressions import FUNCTIONS, Graph, Reader
from hnn_vi_ros.hamiltonians.parameters import check_finite
from hnn_vi_ros.kernels import Kernel
from hnn_vi_ros.phase_space import momentum_name
import numpy as np

NAME = r'^[^\W\d]\w*$'


class AnalyticHamiltonian(Hamiltonian):
    """
    A Hamiltonian whose formula is known.

    Attributes
    ----------
    names : sequence of str
        The names that the formula has for the columns of q; those of momenta begin with p.
        Columns of momenta that there are not, as of a quaternion's fourth, stay zero.
    formula : str
        H, in these names and those of constants.
    constants : dict of str to float
        Their values.

    """

    names: ClassVar[Sequence[str]]
    formula: ClassVar[str]
    constants: Mapping[str, float] = MappingProxyType({})

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions that simulations compile."""
        graph = Graph()
        root = read_hamiltonian(graph, self.names, self.formula, self.constants).root
        momenta = [f'p_{name}' for name in self.names]
        return graph_kernel(graph, root, self.names, momenta, self.constants)._replace(
            rotations=self.rotations)


def read_hamiltonian(graph: Graph, names: Sequence[str], text: str,
                     parameters: Mapping[str, float]) -> Reader:
    """Return H as it was read, the momentum of each coordinate c as p_c; see read_formula."""
    momenta = {f'p_{name}': name for name in names}
    momenta |= {own: name for name in names
                if (own := momentum_name(name)) not in {*momenta, *names, *parameters}}
    check_names('parameters', [*parameters], {*names, *momenta})
    # What the momenta are called makes no difference to the code.
    return read_formula('H', graph, text, [*names, *momenta], parameters, {
        name: f'p_{coordinate}' for name, coordinate in momenta.items()})


def graph_kernel(graph: Graph, root: int, names: Sequence[str], momenta: Sequence[str],
                 parameters: Mapping[str, float]) -> Kernel:
    """
    Return the functions of H as straight code, the same for all values of the parameters.

    Parameters
    ----------
    graph : Graph
        Where H is; its derivatives are added.
    root : int
        H.
    names, momenta : sequence of str
        What the d coordinates and their momenta are called.
    parameters : mapping of str to float
        Values of the other names.

    """
    d, both = len(names), [*names, *momenta]
    slopes, changes = graph.gradient(root, both), {name: f'change of {name}' for name in both}
    products = graph.tangents(slopes, changes)
    constants = constants_of(graph, [root, *slopes, *products], [*both, *changes.values()])
    code = Code(graph, constants, {
        own: f'{array}[k + {i}]' for array, owners in (
            ('q', names), ('p', momenta), ('v_q', [changes[name] for name in names]),
            ('v_p', [changes[name] for name in momenta])) for i, own in enumerate(owners)})
    places, more = ([f'{half}[k + {i}]' for half in halves for i in range(d)] for halves in (
        ('dH_dq', 'dH_dp'), ('product_q', 'product_p')))
    loop = f'for k in range(0, q.size, {d}):'
    values = graph.values(constants, parameters)
    return compiled_kernel(
        (code.function('energy', 'q, p', [], [root], 'k = 0'),
         code.function('gradient', 'q, p, dH_dq, dH_dp', places, slopes, loop),
         code.function('hessian_vector', 'q, p, v_q, v_p, product_q, product_p', more, products,
                       loop)),
        tuple(float(values[a]) for a in constants), d,
        (_largest_term(graph, slopes[:d], parameters),
         _largest_term(graph, slopes[d:], parameters)))._replace(
             quadratic=not graph.depending(products[d:], [*both, *(
                 changes[name] for name in names)]))


class Code:
    """
    Functions made of a graph.

    Parameters
    ----------
    graph : Graph
        With all that they compute.
    constants : sequence of int
        Nodes that come as the parameters of the functions, in this order.
    inputs : mapping of str to str
        Where the other names are found, such as ``q[k + 0]``.

    """

    def __init__(self, graph: Graph, constants: Sequence[int], inputs: Mapping[str, str]):
        self._graph, self._constants, self._inputs = graph, constants, inputs

    def function(self, name: str, arguments: str, outputs: Sequence[str], roots: Sequence[int],
                 head: str = '', add: bool = False) -> Callable[..., Any]:
        """
        Return a function, the same one for the same code in every process.

        Parameters
        ----------
        name : str
            What it is called.
        arguments : str
            After ``parameters``.
        outputs : sequence of str
            Where it puts the nodes, or adds them to; none: it returns the one that there is.
        roots : sequence of int
            The nodes.
        head : str, optional
            Its first line, a loop or a statement.
        add : bool, optional
            Whether the nodes are added to what is there.

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
        unpack = ''.join(f'c{i}, ' for i in range(len(self._constants)))
        indent = '        ' if head.endswith(':') else '    '
        return _compile(name, '\n'.join([
            f'def {name}(parameters, {arguments}):',
            *([f'    {unpack}= parameters'] if unpack else []), *([f'    {head}'] if head else []),
            *(indent + line for line in lines)]))


@cache
def _compile(name: str, source: str) -> Callable[..., Any]:
    """Return the function of generated source, which holds nothing of a user's text."""
    namespace: dict[str, Any] = {'np': np, '__name__': __name__}
    # As a part of this file its machine code is kept beside that of the other systems.
    exec(compile(source, __file__, 'exec'), namespace)
    function: Callable[..., Any] = namespace[name]
    function.__qualname__ = f'{name}_{sha256(source.encode()).hexdigest()[:16]}'
    return function


def constants_of(graph: Graph, roots: Sequence[int], names: Iterable[str]) -> list[int]:
    """Return the largest parts of nodes that do not depend on names and are no numbers."""
    moving = graph.depending(roots, names)
    fixed = {part for a in moving for part in graph.arguments(a)} | set(roots)
    return sorted(a for a in fixed - moving if graph.nodes[a][0] != 'number')


def read_formula(key: str, graph: Graph, text: str, names: Sequence[str],
                 parameters: Mapping[str, float],
                 called: Mapping[str, str] = MappingProxyType({})) -> Reader:
    """
    Return a formula whose names are known, all of whose parameters are used.

    Parameters
    ----------
    key : str
        What the user calls it, for errors.
    graph : Graph
        Where it is put.
    text : str
        The formula.
    names : sequence of str
        Of what changes.
    parameters : mapping of str to float
        Of what does not.
    called : mapping of str to str, optional
        Other names for some of the names.

    Raises
    ------
    ValueError
        It cannot be read, or a name is not known or not used.

    """
    check_finite(**{f'parameters {name}': value for name, value in parameters.items()})
    try:
        read = Reader(graph, text, called=called)
    except ValueError as problem:
        raise ValueError(f'{key} {problem}') from problem
    valid = [*names, *parameters]
    for name, column in read.names.items():
        if name not in valid:
            hint = did_you_mean(name, valid)
            raise ValueError(f'{key} column {column}: no name {name!r}{hint}; there are: '
                             f'{listed(valid)}; give others a value in parameters')
    for name in parameters:
        if name not in read.names:
            raise ValueError(f'parameters {name}: not in {key}; leave it out')
    return read


def check_names(key: str, names: Sequence[str], taken: Iterable[str] = (),
                most: int = 1000) -> None:
    """Raise ValueError unless these are names, each once, that a formula can have."""
    taken = {'pi', *FUNCTIONS, *taken}
    if len(names) > most:
        raise ValueError(f'{key}: {len(names)} of them; give at most {most}')
    for i, name in enumerate(names):
        # fullmatch: `$` alone lets a line break follow.
        if not re.fullmatch(NAME, name):
            raise ValueError(f'{key} {name!r:.60} must be a letter or underscore, then letters, '
                             'digits, underscores')
        if name in taken or name in names[:i]:
            raise ValueError(f'{key} {name} has another meaning already; call it otherwise')


def _largest_term(graph: Graph, roots: Sequence[int], parameters: Mapping[str, float]) -> float:
    """Return the largest bound of a term of some sums, of the terms that have one; else 0."""
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
    # A term alone is as exact as its size says.
    terms, rest = [0.0], [a for a in roots if graph.nodes[a][0] == 'sum']
    while rest:
        a = rest.pop()
        if graph.nodes[a][0] == 'sum':
            rest.extend(graph.arguments(a))
        elif math.isfinite(bounds[a]):
            terms.append(bounds[a])
    return max(terms)
