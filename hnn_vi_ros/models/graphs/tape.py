# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Graphs as tapes: instructions for the compiled loops of machine.py, with places in memory."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
import math
from typing import NamedTuple

from hnn_vi_ros.models.graphs.graph import Builder, GraphNode, needed
from hnn_vi_ros.models.graphs.operations import BINARY, UNARY
import numpy as np

# Places in memory begin at whole cache lines.
_LINE = 8
# Instructions: an operation, the place of its result, and up to seven numbers.
WIDTH = 9
# Structural instructions come first, then elementwise ones in the order of their tables.
MATMUL, SUM, AMAX, FILL, TAKE, PUT, COPY, WHERE, NETWORK = range(9)
FIRST_UNARY = 9
CODES = {op: k for k, op in enumerate((*UNARY, *BINARY), start=FIRST_UNARY)}
# Flags of NETWORK: compute the activations, their tangents; then go back, and along a tangent.
VALUES, TANGENTS, BACK, ALONG = 1, 2, 4, 8
_OF_NETWORKS = {'perceptron': 0, 'pullback': BACK, 'pushforward': ALONG,
                'pullback_tangent': BACK + ALONG}


class Tape(NamedTuple):
    """
    Instructions that compute a node from the inputs.

    Parameters
    ----------
    code : np.ndarray of uint64, shape (instructions, WIDTH)
        The instructions.
    place : int
        Place of the result.

    """

    code: np.ndarray
    place: int


@dataclass
class _Evaluated:
    """A network's workspace at some place of a tape: its activations, its tangent's node."""

    values: bool = False
    tangent: int = -1


class Assembler:
    """
    Places of constants, indices and results in the memory that several tapes share.

    Parameters
    ----------
    b : Builder
        The graph.
    inputs : sequence of int
        Inputs, placed at the start of memory one after another.

    Attributes
    ----------
    networks : dict of int to int
        Networks that tapes evaluate, each at one node.

    """

    def __init__(self, b: Builder, inputs: Sequence[int]):
        self.b, self._places, self._end = b, dict[int, int](), 0
        self._values: list[tuple[int, np.ndarray]] = []
        self._indices, self._index_end = dict[int, int](), 0
        self._index: list[np.ndarray] = []
        self.networks = dict[int, int]()
        for x in inputs:
            self._places[x] = self._end
            self._end += math.prod(b.shape(x))
        self._end = _rounded(self._end)

    def memory(self) -> np.ndarray:
        """Return memory with the constants in place."""
        raw = np.zeros(self._end + _LINE)
        start = (-raw.ctypes.data // raw.itemsize) % _LINE
        memory = raw[start:start + self._end]
        for place, values in self._values:
            memory[place:place + values.size] = values.ravel()
        return memory

    def index(self) -> np.ndarray:
        """Return all indices."""
        return np.concatenate([*self._index, np.zeros(1, dtype=np.int64)]).astype(np.uint64)

    def tape(self, output: int) -> Tape:
        """Return the instructions that compute a node."""
        (found,) = self.tapes([output])
        return found

    def tapes(self, outputs: Sequence[int]) -> list[Tape]:
        """Return the instructions that compute each node from the inputs and the nodes before."""
        b, stages, known = self.b, list[list[int]](), set[int]()
        for output in outputs:
            stages.append([k for k in needed(b.nodes, [output]) if k not in known])
            known.update(stages[-1])
        order = [k for own in stages for k in own]
        roots = dict[int, tuple[int, int]]()
        for k in order:
            roots[k] = self._root(k, roots)
        last = {root: k for k in order for root in [
            roots[i][0] for i in b.nodes[k].inputs] + [roots[k][0]]}
        last |= {roots[output][0]: len(b.nodes) for output in outputs}
        # Places of free blocks by their size.
        free: dict[int, list[int]] = {}
        places, at = dict(self._places), dict.fromkeys(order, 0)
        states, code = dict[int, _Evaluated](), list[list[list[int]]]()
        for own in stages:
            code.append([])
            for k in own:
                node, (root, offset) = b.nodes[k], roots[k]
                if root == k and k not in places:
                    size = _rounded(math.prod(node.shape))
                    if node.op == 'constant':
                        places[k] = self._places[k] = self._end
                        self._values.append((self._end, b.tensors[node.tensor]))
                        self._end += size
                    else:
                        places[k] = self._free(free, size)
                at[k] = places[root] + offset
                if root == k and node.op not in ('constant', 'input'):
                    inputs = [at[i] for i in node.inputs]
                    code[-1] += [self._of_network(node, at[k], inputs, states.setdefault(
                        node.tensor, _Evaluated()))] if node.op in _OF_NETWORKS else \
                        self._instructions(node, at[k], inputs)
                for other in {roots[i][0] for i in node.inputs}:
                    if last[other] == k and other not in self._places:
                        free.setdefault(_rounded(math.prod(b.shape(other))), []).append(
                            places[other])
        return [Tape(np.array(rows, dtype=np.uint64).reshape(-1, WIDTH), at[output])
                for rows, output in zip(code, outputs, strict=True)]

    def _free(self, free: dict[int, list[int]], size: int) -> int:
        """Return a place of this size: in the smallest free block that fits, or at the end."""
        room = min((own for own in free if own >= size), default=0)
        if not room:
            self._end += size
            return self._end - size
        place = free[room].pop()
        if not free[room]:
            del free[room]
        if room > size:
            free.setdefault(room - size, []).append(place + size)
        return place

    def _root(self, k: int, roots: Mapping[int, tuple[int, int]]) -> tuple[int, int]:
        """Return the node whose memory holds a node, and where in it."""
        node = self.b.nodes[k]
        index = self.b.tensors[node.tensor].ravel() if node.op == 'take' else np.zeros(1)
        if node.op not in ('reshape', 'fixed', 'take') or not (np.diff(index) == 1).all():
            return k, 0
        root, offset = roots[node.inputs[0]]
        return root, offset + int(index[0])

    def _instructions(self, node: GraphNode, out: int, at: Sequence[int]) -> list[list[int]]:
        """Return the instructions of a node, given the places of its inputs."""
        b, size, shapes = self.b, math.prod(node.shape), [*map(self.b.shape, node.inputs)]
        rows: list[list[int]]
        match node.op:
            case 'matmul':
                rows = self._products(shapes, node.options, out, at)
            case 'sum' | 'amax':
                return self._reductions(node, shapes[0], out, at[0])
            case 'take':
                index = b.tensors[node.tensor].ravel()
                rows = [[FILL, out, size, at[0] + int(index[0])]] if (
                    index == index[0]).all() else [
                    [TAKE, out, size, at[0], self._place_of_index(node.tensor)]]
            case 'put':
                rows = [[PUT, out, size, at[0], self._place_of_index(node.tensor),
                         math.prod(shapes[0])]]
            case 'concatenate':
                sizes = [*map(math.prod, shapes)]
                rows = [[COPY, out + end - n, n, place] for end, n, place in zip(
                    accumulate(sizes), sizes, at, strict=True)]
            case 'where':
                rows = [[WHERE, out, size, *at]]
            case _:
                rows = [[CODES[node.op], out, size, *at]]
        return [row + [0] * (WIDTH - len(row)) for row in rows]

    def _of_network(self, node: GraphNode, out: int, at: Sequence[int], known: '_Evaluated'
                    ) -> list[int]:
        """Return the instruction of a node with a network; see mapping.py."""
        assert self.networks.setdefault(node.tensor, node.inputs[0]) == node.inputs[0], (
            'a network has memory for one state')
        flags, v = _OF_NETWORKS[node.op], node.inputs[-1]
        g = at[1] if flags & BACK else 0
        if flags & ALONG:
            assert known.tangent in (-1, v), 'a network has memory for one tangent'
            flags, known.tangent = flags + TANGENTS * (known.tangent == -1), v
        flags, known.values = flags + VALUES * (not known.values), True
        return [NETWORK, out, math.prod(node.shape), at[0], math.prod(
            self.b.shape(node.inputs[0])), g, at[-1], node.tensor, flags]

    def _products(self, shapes: Sequence[tuple[int, ...]], options: tuple[int, ...], out: int,
                  at: Sequence[int]) -> list[list[int]]:
        """Return one product of matrices for each matrix of a stack."""
        *stack, rows, inner = shapes[0]
        t_x, t_y = options
        if t_x:
            rows, inner = inner, rows
        columns = shapes[1][-2 if t_y else -1]
        return [[MATMUL, out + k * rows * columns, rows, columns, inner, at[0] + k * rows * inner,
                 at[1] + k * inner * columns, t_x, t_y] for k in range(math.prod(stack))]

    def _reductions(self, node: GraphNode, shape: tuple[int, ...], out: int, at: int
                    ) -> list[list[int]]:
        """Return sums or maxima over one block of axes."""
        axes = node.options
        first, last = axes[0], axes[-1] + 1
        outer, inner = math.prod(shape[:first]), math.prod(shape[last:])
        count = math.prod(shape[first:last])
        return [[SUM if node.op == 'sum' else AMAX, out, outer, count, inner, at, 0, 0, 0]]

    def _place_of_index(self, tensor: int) -> int:
        if tensor not in self._indices:
            self._indices[tensor] = self._index_end
            self._index.append(self.b.tensors[tensor].ravel())
            self._index_end += self.b.tensors[tensor].size
        return self._indices[tensor]


def program(b: Builder, inputs: Sequence[int], *stages: Sequence[int]
            ) -> tuple[Assembler, list[Tape]]:
    """Return a tape for each node of each stage, from the inputs and nodes before in its stage."""
    assembler = Assembler(b, inputs)
    return assembler, [tape for outputs in stages for tape in assembler.tapes(outputs)]


def _rounded(size: int) -> int:
    return -(-size // _LINE) * _LINE
