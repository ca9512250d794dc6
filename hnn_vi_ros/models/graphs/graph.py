# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Graphs of operations: building with simplification, and reading from untrusted data."""

from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from itertools import accumulate
import math
from typing import Any, NamedTuple

from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.models.graphs.operations import BINARY, STRUCTURAL, UNARY, VERSION
from hnn_vi_ros.models.networks.layers import Layers
import numpy as np

# Limits of graphs in files: nodes, values of one node and of all, and axes.
MAX_NODES, MAX_SIZE, MAX_TOTAL, MAX_AXES = 10_000, 1 << 22, 1 << 24, 16
# Maximum of entries of all nodes together, and of multiplications in products of matrices.
MAX_ENTRIES, MAX_PRODUCTS = 10 * MAX_NODES, 1 << 28
# Maximum of views and parts through which a take is followed to its source.
_MAX_STEPS = 32
Shape = tuple[int, ...]


class GraphNode(NamedTuple):
    """One operation: inputs are the numbers of earlier nodes."""

    op: str
    inputs: tuple[int, ...]
    shape: Shape
    # Axes, transposes or a shape; see operations.
    options: tuple[int, ...] = ()
    # Number of a tensor among the builder's tensors, or of a network among its networks.
    tensor: int = -1


class GraphNetwork(NamedTuple):
    """A network in a graph: its layers, and the activation between them."""

    layers: Layers
    activation: str


class Builder:
    """
    A graph under construction; each method adds a node unless an equal one exists.

    Operations on constants are computed at once, and products with 1 and 0, sums with 0 and the
    like are left out. Arguments must be valid: see ``read_graph`` for graphs of unknown origin.

    Attributes
    ----------
    nodes : list of GraphNode
        Nodes in the order of their computation.
    tensors : list of np.ndarray
        Constants (float64) and indices (int64).
    networks : list of GraphNetwork
        Networks of the nodes that ``fused`` finds; see perceptrons.py.
    products : int
        Multiplications of all products of matrices so far, also of constants.

    """

    def __init__(self) -> None:
        self.products = 0
        self.nodes: list[GraphNode] = []
        self.tensors: list[np.ndarray] = []
        self.networks: list[GraphNetwork] = []
        self._known: dict[GraphNode, int] = {}
        self._known_tensors: dict[tuple[str, Shape, bytes], int] = {}
        self._fills: dict[int, float | None] = {}
        self._ends: dict[int, list[int]] = {}

    def shape(self, x: int) -> Shape:
        """Return the shape of a node."""
        return self.nodes[x].shape

    def value(self, x: int) -> np.ndarray | None:
        """Return the values of a constant node, None for others."""
        node = self.nodes[x]
        return self.tensors[node.tensor] if node.op == 'constant' else None

    def is_constant(self, x: int) -> bool:
        """Return whether a node is constant."""
        return self.nodes[x].op == 'constant'

    def input(self, size: int, number: int = 0) -> int:  # noqa: A003
        """Return the input vector of the graph, or that of tangents, 1, or of the time, 2."""
        return self._add(GraphNode('input', (), (size,), (number,)))

    def constant(self, values: np.ndarray) -> int:
        """Return a constant."""
        number = self._tensor(np.asarray(values, dtype=np.float64))
        return self._add(GraphNode('constant', (), self.tensors[number].shape, (), number))

    def full(self, x: int, value: float) -> int:
        """Return a constant of the shape of x, all of whose values are equal."""
        return self.constant(np.full(self.shape(x), value))

    def unary(self, op: str, x: int) -> int:
        """Return an elementwise function of one node."""
        found = self.value(x)
        if found is not None:
            with np.errstate(all='ignore'):
                return self.constant(UNARY[op].values(found))
        node = self.nodes[x]
        if op == 'neg' and node.op == 'neg':
            return node.inputs[0]
        return self._add(GraphNode(op, (x,), self.shape(x)))

    def binary(self, op: str, x: int, y: int) -> int:
        """Return an elementwise function of two nodes of one shape."""
        one, other = self.value(x), self.value(y)
        if one is not None and other is not None:
            with np.errstate(all='ignore'):
                return self.constant(BINARY[op].values(one, other))
        left, right = self._fill(x), self._fill(y)
        if op in ('add', 'mul') and left is not None:
            # A constant comes second, so that equal sums and products are one node.
            x, y, left, right = y, x, right, left
        match op, right:
            case ('add', 0.0) | ('sub', 0.0) | ('mul', 1.0) | ('div', 1.0) | ('pow', 1.0):
                return x
            case ('mul', 0.0) | ('pow', 0.0):
                return self.full(x, 0.0 if op == 'mul' else 1.0)
            case ('mul', -1.0) | ('div', -1.0):
                return self.neg(x)
            case 'pow', (2.0 | 3.0):
                square = self.mul(x, x)
                return square if right == 2.0 else self.mul(square, x)
            case 'pow', 0.5:
                return self.unary('sqrt', x)
            case 'pow', -1.0:
                return self.unary('reciprocal', x)
        if op == 'sub' and left == 0.0:
            return self.neg(y)
        if op == 'div' and left == 1.0:
            return self.unary('reciprocal', y)
        if op == 'div' and left == 0.0:
            return x
        if op == 'add' and self.nodes[y].op == 'neg':
            op, y = 'sub', self.nodes[y].inputs[0]
        elif op == 'sub' and self.nodes[y].op == 'neg':
            op, y = 'add', self.nodes[y].inputs[0]
        if op in ('add', 'mul') and right is None and y < x:
            x, y = y, x
        return self._add(GraphNode(op, (x, y), self.shape(x)))

    def neg(self, x: int) -> int:
        """Return -x."""
        return self.unary('neg', x)

    def add(self, x: int, y: int) -> int:
        """Return x + y."""
        return self.binary('add', x, y)

    def sub(self, x: int, y: int) -> int:
        """Return x - y."""
        return self.binary('sub', x, y)

    def mul(self, x: int, y: int) -> int:
        """Return x * y."""
        return self.binary('mul', x, y)

    def div(self, x: int, y: int) -> int:
        """Return x / y."""
        return self.binary('div', x, y)

    def where(self, condition: int, x: int, y: int) -> int:
        """Return x where the condition is not 0, else y."""
        found = self.value(condition)
        if found is not None:
            if found.all() or not found.any():
                return x if found.all() else y
            own = np.arange(found.size).reshape(found.shape)
            return self.take(self.concatenate([x, y]), np.where(found, own, own + found.size))
        return x if x == y else self._add(GraphNode('where', (condition, x, y), self.shape(x)))

    def matmul(self, x: int, y: int, t_x: bool = False, t_y: bool = False) -> int:
        """Return the product of matrices, or of stacks of equal length, transposed first if t."""
        one, other = self.value(x), self.value(y)
        self.products += count_products(self.shape(x), self.shape(y), t_x, t_y)
        if one is not None and other is not None:
            return self.constant(_turned(one, t_x) @ _turned(other, t_y))
        a, b = self.shape(x), self.shape(y)
        shape = (*a[:-2], a[-1] if t_x else a[-2], b[-2] if t_y else b[-1])
        if self._fill(x) == 0.0 or self._fill(y) == 0.0:
            return self.constant(np.zeros(shape))
        return self._add(GraphNode('matmul', (x, y), shape, (int(t_x), int(t_y))))

    def sum(self, x: int, axes: Sequence[int]) -> int:  # noqa: A003
        """Return the sum over axes, which vanish."""
        return self._reduced('sum', np.sum, x, axes)

    def amax(self, x: int, axes: Sequence[int]) -> int:
        """Return the largest value over axes, which vanish."""
        return self._reduced('amax', np.max, x, axes)

    def _reduced(self, op: str, values: Callable[..., Any], x: int, axes: Sequence[int]) -> int:
        axes, shape = sorted(axes), self.shape(x)
        left = tuple(n for k, n in enumerate(shape) if k not in axes)
        if math.prod(left) == math.prod(shape):
            return self.reshape(x, left)
        found = self.value(x)
        if found is not None:
            return self.constant(values(found, axis=tuple(axes)))
        if axes[-1] - axes[0] >= len(axes):
            # The loops reduce neighbouring axes.
            order = [*(k for k in range(len(shape)) if k not in axes), *axes]
            x = self.take(x, np.arange(math.prod(shape)).reshape(shape).transpose(order))
            axes = [*range(len(left), len(shape))]
        return self._add(GraphNode(op, (x,), left, tuple(axes)))

    def reshape(self, x: int, shape: Sequence[int]) -> int:
        """Return the same values in another shape."""
        shape, node = tuple(shape), self.nodes[x]
        if node.op == 'constant':
            return self.constant(self.tensors[node.tensor].reshape(shape))
        if node.op == 'reshape':
            return self.reshape(node.inputs[0], shape)
        return x if shape == node.shape else self._add(GraphNode('reshape', (x,), shape, shape))

    def take(self, x: int, index: np.ndarray) -> int:
        """Return x.ravel()[index]."""
        for _ in range(_MAX_STEPS):
            node = self.nodes[x]
            if node.op == 'constant':
                return self.constant(self.tensors[node.tensor].ravel()[index])
            if index.size == math.prod(node.shape) and (
                    index.ravel() == np.arange(index.size)).all():
                return self.reshape(x, index.shape)
            if node.op == 'reshape':
                x = node.inputs[0]
            elif node.op == 'take':
                x, index = node.inputs[0], self.tensors[node.tensor].ravel()[index]
            elif node.op == 'concatenate' and index.size:
                # Values of one part only are taken from that part.
                ends = self._ends.setdefault(x, [])
                if not ends:
                    ends += accumulate(math.prod(self.shape(k)) for k in node.inputs)
                part = bisect_right(ends, int(index.min()))
                if index.max() >= ends[part]:
                    break
                x, index = node.inputs[part], index - (ends[part - 1] if part else 0)
            else:
                break
        number = self._tensor(np.asarray(index, dtype=np.int64))
        return self._add(GraphNode('take', (x,), index.shape, (), number))

    def put(self, x: int, index: np.ndarray, shape: Sequence[int]) -> int:
        """Return zeros of a shape, with the values of x added at an index."""
        shape = tuple(shape)
        found, size = self.value(x), math.prod(shape)
        if found is not None:
            values = np.zeros(size)
            np.add.at(values, index.ravel(), found.ravel())
            return self.constant(values.reshape(shape))
        flat = index.ravel()
        if flat.size == size and np.unique(flat).size == size:
            back = np.empty(size, dtype=np.int64)
            back[flat] = np.arange(size)
            return self.take(x, back.reshape(shape))
        if size == 1:
            return self.reshape(self.sum(x, range(len(self.shape(x)))), shape)
        number = self._tensor(np.asarray(index, dtype=np.int64))
        return self._add(GraphNode('put', (x,), shape, shape, number))

    def concatenate(self, parts: Sequence[int]) -> int:
        """Return the values of nodes as one vector."""
        parts = [part for part in parts if math.prod(self.shape(part))]
        values = [self.value(part) for part in parts]
        known = [found for found in values if found is not None]
        if len(known) == len(parts):
            return self.constant(np.concatenate([found.ravel() for found in known]))
        size = sum(math.prod(self.shape(part)) for part in parts)
        if len(parts) == 1:
            return self.reshape(parts[0], (size,))
        return self._add(GraphNode('concatenate', tuple(parts), (size,)))

    def perceptron(self, network: int, x: int) -> int:
        """Return N(x), a vector, of a network and its vector of inputs."""
        outputs = self.networks[network].layers.biases[-1].size
        return self._add(GraphNode('perceptron', (x,), (outputs,), (), network))

    def pullback(self, network: int, x: int, g: int) -> int:
        """Return N'(x)^T g."""
        return self._linear('pullback', network, (x, g), self.shape(x))

    def pushforward(self, network: int, x: int, v: int) -> int:
        """Return N'(x) v."""
        return self._linear('pushforward', network, (x, v), self.networks[
            network].layers.biases[-1].shape)

    def pullback_tangent(self, network: int, x: int, g: int, v: int) -> int:
        """Return the derivative of N'(x)^T g along the change v of x."""
        return self.full(x, 0.0) if self._fill(g) == 0.0 else self._linear(
            'pullback_tangent', network, (x, g, v), self.shape(x))

    def _linear(self, op: str, network: int, inputs: tuple[int, ...], shape: Shape) -> int:
        """Return a function that is linear in its last input."""
        return self.constant(np.zeros(shape)) if self._fill(inputs[-1]) == 0.0 else self._add(
            GraphNode(op, inputs, shape, (), network))

    def operation(self, op: str, at: Sequence[int], options: tuple[int, ...] = (),
                  tensor: np.ndarray | None = None) -> int:
        """Return any operation of a file but the input, given its entries there."""
        match op:
            case 'constant':
                assert tensor is not None, 'checked by the caller'
                return self.constant(tensor)
            case 'take':
                assert tensor is not None, 'checked by the caller'
                return self.take(at[0], tensor)
            case 'put':
                assert tensor is not None, 'checked by the caller'
                return self.put(at[0], tensor, options)
            case 'matmul':
                return self.matmul(at[0], at[1], *map(bool, options))
            case 'sum' | 'amax' | 'reshape':
                return getattr(self, op)(at[0], options)
            case 'concatenate':
                return self.concatenate(at)
            case 'where':
                return self.where(*at)
        return self.unary(op, *at) if op in UNARY else self.binary(op, *at)

    def broadcast(self, x: int, shape: Sequence[int]) -> int:
        """Return a node in a shape that numpy broadcasts its own to."""
        own = self.shape(x)
        return x if own == tuple(shape) else self.take(x, np.broadcast_to(
            np.arange(math.prod(own)).reshape(own), shape))

    def _fill(self, x: int) -> float | None:
        """Return the value of a constant whose values are all equal."""
        if x not in self._fills:
            found = self.value(x)
            self._fills[x] = float(found.flat[0]) if found is not None and found.size and (
                found == found.flat[0]).all() else None
        return self._fills[x]

    def _tensor(self, values: np.ndarray) -> int:
        key = values.dtype.str, values.shape, values.tobytes()
        if key not in self._known_tensors:
            self._known_tensors[key] = len(self.tensors)
            # Not ascontiguousarray, which makes vectors of single numbers.
            self.tensors.append(np.asarray(values, order='C'))
        return self._known_tensors[key]

    def _add(self, node: GraphNode) -> int:
        if node not in self._known:
            self._known[node] = len(self.nodes)
            self.nodes.append(node)
        return self._known[node]


def count_products(x: Shape, y: Shape, t_x: int, t_y: int) -> int:
    """Return the number of multiplications of a product of matrices of these shapes."""
    return math.prod(x) * y[-2 if t_y else -1]


def _turned(x: np.ndarray, t: bool) -> np.ndarray:
    return np.swapaxes(x, -1, -2) if t else x


def needed(nodes: Sequence[GraphNode], outputs: Sequence[int]) -> list[int]:
    """Return the nodes that outputs depend on, in their order."""
    wanted = set(outputs)
    for k in range(len(nodes) - 1, -1, -1):
        if k in wanted:
            wanted.update(nodes[k].inputs)
    return sorted(wanted)


def varied(nodes: Sequence[GraphNode], output: int) -> list[int]:
    """Return the nodes that the derivatives of an output depend on: not those that are fixed."""
    wanted = {output}
    for k in range(output, -1, -1):
        if k in wanted and nodes[k].op != 'fixed':
            wanted.update(nodes[k].inputs)
    return sorted(wanted)


def graph_data(b: Builder, output: int) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return the graph of one output as plain data, and its tensors by name."""
    own = needed(b.nodes, [output])
    number, names = {k: i for i, k in enumerate(own)}, dict[int, str]()
    rows = []
    for k in own:
        node = b.nodes[k]
        row: list[Any] = [node.op, *(number[i] for i in node.inputs)]
        if node.tensor >= 0:
            row.append(names.setdefault(node.tensor, f'tensor{len(names) + 1}'))
        if node.op in ('matmul', 'sum', 'amax', 'reshape', 'put', 'input'):
            row.append([*(node.shape if node.op == 'input' else node.options)])
        rows.append(row)
    return {'version': VERSION, 'nodes': rows}, {name: b.tensors[k] for k, name in names.items()}


def read_graph(data: Any, tensors: Mapping[str, np.ndarray], inputs: int, timed: bool = False
               ) -> tuple[Builder, int]:
    """
    Return the graph of plain data of unknown origin, and its output, the last node.

    Parameters
    ----------
    data : object
        As ``graph_data`` returns it.
    tensors : mapping of str to np.ndarray
        Tensors of the file.
    inputs : int
        Required size of the input vector.
    timed : bool, optional
        Return its last entry, the time, as an input of its own, number 2.

    Raises
    ------
    ModelError
        The data are not a graph of one finite number of this many inputs.

    """
    if not isinstance(data, dict) or data.get('version') != VERSION:
        raise ModelError(f'graph: its version is not {VERSION}; use the hnn_vi_ros that wrote it')
    rows = data.get('nodes')
    if not isinstance(rows, list) or not 0 < len(rows) <= MAX_NODES:
        raise ModelError(f'graph: expected a list of 1 to {MAX_NODES} nodes')
    if sum(len(row) for row in rows if isinstance(row, list)) > MAX_ENTRIES:
        raise ModelError(f'graph: its nodes have over {MAX_ENTRIES} entries')
    b, found, total, used = Builder(), list[int](), 0, set[str]()
    for k, row in enumerate(rows):
        try:
            node = _node(b, found, row, tensors, inputs)
            if timed and row[0] == 'input':
                node = b.concatenate([b.input(inputs - 1), b.input(1, 2)])
        except (ValueError, TypeError, KeyError, IndexError, OverflowError) as problem:
            raise ModelError(f'graph: node {k} is not valid: {_reason(problem)}') from problem
        found.append(node)
        total += math.prod(b.shape(node))
        if total > MAX_TOTAL:
            raise ModelError(f'graph: holds over {MAX_TOTAL} values')
        used |= {name for name in row if isinstance(name, str)}
    for name in tensors:
        if name not in used:
            raise ModelError(f'graph: no node uses tensor {name}')
    if math.prod(b.shape(found[-1])) != 1:
        raise ModelError(f'graph: its output has shape {b.shape(found[-1])}, expected one number')
    return b, found[-1]


def _reason(problem: Exception) -> str:
    return f'{problem.args[0]} is missing' if isinstance(problem, KeyError) else str(problem)


def _node(b: Builder, found: Sequence[int], row: Any, tensors: Mapping[str, np.ndarray],
          inputs: int) -> int:
    """Add a node of plain data; raise an error of Python for anything that is not valid."""
    if not isinstance(row, list) or not row or not isinstance(row[0], str):
        raise ValueError('expected a list that begins with an operation')
    op, *rest = row
    options = tuple(map(_whole, rest.pop())) if rest and isinstance(rest[-1], list) else ()
    tensor = None
    if rest and isinstance(rest[-1], str):
        tensor = tensors[rest.pop()]
    at = []
    for i in map(_whole, rest):
        if i >= len(found):
            raise ValueError(f'input {i} comes after it')
        at.append(found[i])
    shapes = [b.shape(x) for x in at]
    if op in UNARY or op in BINARY or op == 'where':
        count = 1 if op in UNARY else 2 if op in BINARY else 3
        _expect(len(at) == count and tensor is None and not options, f'{op} takes {count} inputs')
        _expect(len(set(shapes)) == 1, f'{op} of shapes {shapes}')
        return b.operation(op, at)
    _expect(op in STRUCTURAL, f'unknown operation {op[:40]!r}')
    kind = {'constant': 'f', 'take': 'i', 'put': 'i'}.get(op)
    _expect((tensor is None) == (kind is None) and (
        tensor is None or tensor.dtype.kind == kind), f'{op} has not its kind of tensor')
    if op in ('input', 'constant'):
        _expect(not at and options == ((inputs,) if op == 'input' else ()),
                f'{op} takes no inputs; the graph has {inputs}')
        return b.input(inputs) if tensor is None else b.constant(tensor)
    if op == 'concatenate':
        size = sum(math.prod(shape) for shape in shapes)
        _expect(0 < size <= MAX_SIZE and not options, 'concatenate of nothing, or of too much')
    else:
        _expect(len(at) == (2 if op == 'matmul' else 1), f'{op} takes another number of inputs')
        _check_structural(b, op, at, options, tensor)
    return b.operation(op, at, options, tensor)


def _check_structural(b: Builder, op: str, at: Sequence[int], options: tuple[int, ...],
                      tensor: np.ndarray | None) -> None:
    shape = b.shape(at[0])
    if op == 'matmul':
        other = b.shape(at[1])
        _expect(len(options) == 2 and max(options) <= 1, 'matmul needs two flags')
        _expect(len(shape) == len(other) >= 2 and shape[:-2] == other[:-2] and (
            shape[-2 if options[0] else -1] == other[-1 if options[1] else -2]),
            f'matmul of shapes {shape} and {other}')
        size = math.prod(shape[:-2]) * shape[-1 if options[0] else -2] * (
            other[-2 if options[1] else -1])
        _expect(0 < size <= MAX_SIZE, f'matmul gives {size} values, the limit is {MAX_SIZE}')
        _expect(b.products + count_products(shape, other, *options) <= MAX_PRODUCTS,
                f'its products of matrices take over {MAX_PRODUCTS} multiplications')
        return
    if op in ('sum', 'amax'):
        _expect(len(set(options)) == len(options) and all(k < len(shape) for k in options)
                and all(shape), f'{op} over axes {options} of shape {shape}')
        return
    size = math.prod(shape)
    if op == 'reshape':
        _expect(math.prod(options) == size and len(options) <= MAX_AXES,
                f'{shape} cannot become {options}')
        return
    assert tensor is not None, 'checked above'
    target = size if op == 'take' else math.prod(options)
    _expect(0 < target <= MAX_SIZE and 0 < tensor.size <= MAX_SIZE
            and len(options) <= MAX_AXES and tensor.ndim <= MAX_AXES,
            f'{op} of too many values, or of none')
    _expect(0 <= int(tensor.min()) and int(tensor.max()) < target,
            f'{op} has an index outside of its {target} values')
    _expect(op == 'put' or not options, 'take has no options')
    _expect(op == 'take' or tensor.size == size, f'put of {size} values to {tensor.size} places')


def _expect(holds: bool, otherwise: str) -> None:
    if not holds:
        raise ValueError(otherwise)


def _whole(x: Any) -> int:
    if not isinstance(x, int) or isinstance(x, bool) or not 0 <= x <= MAX_SIZE:
        raise ValueError(f'{str(x)[:40]} is not an integer from 0 to {MAX_SIZE}')
    return x
