# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Compiled loops that run tapes: one loop for each operation, over one memory.

Places and counts are unsigned, since a check for negative indices would prevent vectorisation. The
loops are compiled once, and called by address, because they are the same for all graphs.
"""

from collections.abc import Callable, Sequence
from functools import cache, partial
import math
from typing import Any, NamedTuple

from hnn_vi_ros.kernels import (
    address_of, block, entry_address, entry_caller, flat, kept, load, Part, part, type_of, Whole)
from hnn_vi_ros.models.graphs.operations import BINARY, UNARY
from hnn_vi_ros.models.graphs.tape import (
    AMAX, Assembler, COPY, FILL, FIRST_UNARY, MATMUL, NETWORK, PUT, SUM, TAKE, Tape, WHERE)
from hnn_vi_ros.models.networks.activations import (
    exponential, FASTMATH, logarithm, sine_and_cosine, softplus_and_slope, tanh)
from hnn_vi_ros.models.networks.mapping import run_network
from hnn_vi_ros.models.networks.perceptron_memory import pack_mapping
from numba.core import types
import numpy as np

_part = part(fastmath=FASTMATH, error_model='numpy', forceinline=True)
_compiled = kept(error_model='numpy')
_ONE, _TILE = np.uint64(1), np.uint64(8)
_1, _2, _3, _4, _5, _6, _7 = (np.uint64(k) for k in range(1, 8))
# The type of a network, and its size in memory in bytes.
_EXAMPLE = pack_mapping(2 * (np.zeros((1, 1)),), 2 * (np.zeros(1),), 'tanh')
_NETWORK, _BYTES = type_of(_EXAMPLE), 8 * len(flat(_EXAMPLE))


class Program(NamedTuple):
    """
    Tapes with everything that they use.

    Parameters
    ----------
    memory : np.ndarray
        Inputs, constants and results.
    numbers : np.ndarray of uint64
        Indices of take and put.
    code : np.ndarray of uint64, shape (instructions, 9)
        All tapes, one after another; see tape.
    ends : np.ndarray of uint64, shape (tapes + 1,)
        Where each tape begins, and the last one ends.
    networks : np.ndarray of int64
        Networks in the graph, each a Mapping, as words in numba's layout.

    """

    memory: np.ndarray
    numbers: np.ndarray
    code: np.ndarray
    ends: np.ndarray
    networks: np.ndarray


_PROGRAM = type_of(Program(
    np.zeros(1), np.zeros(1, dtype=np.uint64), np.zeros((1, 9), dtype=np.uint64),
    np.zeros(1, dtype=np.uint64), np.zeros(1, dtype=np.int64)))


class GraphParameters(NamedTuple):
    """
    Parameters of the functions of a graph.

    Parameters
    ----------
    words : np.ndarray of int64
        Address of ``_run``, then a Program as words in numba's layout.
    memory : np.ndarray
        Memory of the program.
    places : np.ndarray of int64, shape (tapes + 1,)
        Places of the results of the tapes, and d.

    """

    words: np.ndarray
    memory: np.ndarray
    places: np.ndarray


def assembled(assembler: Assembler, tapes: Sequence[Tape], d: int) -> GraphParameters:
    """Return the parameters of tapes and their memory."""
    memory = assembler.memory()
    networks = tuple(pack_mapping(*layers, activation)
                     for layers, activation in assembler.b.networks)
    ends = np.cumsum([0, *(len(tape.code) for tape in tapes)]).astype(np.uint64)
    program = Program(memory, assembler.index(), np.concatenate([tape.code for tape in tapes]),
                      ends, block(networks, 0)[1:])
    return GraphParameters(block(program, _address()), memory, np.array(
        [*(tape.place for tape in tapes), d], dtype=np.int64))


@cache
def _entry() -> Any:
    entry: Any = kept(fastmath=FASTMATH, error_model='numpy', nogil=True, no_cfunc_wrapper=True,
                      pipeline_class=Whole)(_run)
    entry.compile((types.int64, types.int64))
    (found,) = entry.overloads.values()
    return found


@cache
def _address() -> int:
    return entry_address(_entry())


_call = entry_caller(types.none)


class _ByAddress(Part):
    """A call of ``_run`` by its address; from Python, of its entry point."""

    def __call__(self, graph: GraphParameters, which: int) -> None:
        """Run a tape."""
        _entry().entry_point(graph.words.ctypes.data + 8, which)


@partial(_ByAddress, targetoptions={'forceinline': True, 'error_model': 'numpy'})
def run(graph: GraphParameters, which: int) -> None:
    """Run a tape of a graph; those of a Hamiltonian are 0 H, 1 its gradient, 2 a product."""
    _call(graph.words[0], (address_of(graph.words) + 8, which))


@part(error_model='numpy')
def fill(graph: GraphParameters, which: int, values: np.ndarray) -> None:
    """Run a tape, and fill an array of any shape with its result."""
    run(graph, which)
    place = graph.places[which]
    for i in range(values.size):
        values.flat[i] = graph.memory[place + i]


@_compiled
def energy(graph: GraphParameters, q: np.ndarray, p: np.ndarray) -> float:
    """Return H(q, p) [J] for q and p of shape (d,)."""
    _load(graph.memory, 0, q.size, q, p, 0)
    run(graph, 0)
    return float(graph.memory[graph.places[0]])


@_compiled
def gradient(graph: GraphParameters, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
             dH_dp: np.ndarray) -> None:
    """Fill dH_dq and dH_dp, all of shape (m d,): m states in sequence."""
    memory, place, d = graph.memory, graph.places[1], graph.places[3]
    for s in range(0, q.size, d):
        _load(memory, 0, d, q, p, s)
        run(graph, 1)
        for i in range(d):
            dH_dq[s + i], dH_dp[s + i] = memory[place + i], memory[place + d + i]


@_compiled
def hessian_vector(graph: GraphParameters, q: np.ndarray, p: np.ndarray, v_q: np.ndarray,
                   v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
    """Fill the last two with H''(q, p) (v_q, v_p), all of shape (m d,)."""
    memory, place, d = graph.memory, graph.places[2], graph.places[3]
    for s in range(0, q.size, d):
        _load(memory, 0, d, q, p, s)
        _load(memory, 2 * d, d, v_q, v_p, s)
        run(graph, 2)
        for i in range(d):
            product_q[s + i], product_p[s + i] = memory[place + i], memory[place + d + i]


# The same for H(q, p, t): the time follows the state and its tangent in the memory, and H_t the
# gradient; see ``Hamiltonian.time``.
@_compiled
def energy_at(parameters: tuple[GraphParameters, np.ndarray], q: np.ndarray, p: np.ndarray
              ) -> float:
    """Return H(q, p, t) [J]; see ``energy``."""
    graph, time = parameters
    graph.memory[4 * graph.places[3]] = time[0]
    return energy(graph, q, p)


@_compiled
def gradient_at(parameters: tuple[GraphParameters, np.ndarray], q: np.ndarray, p: np.ndarray,
                dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    """Fill dH_dq and dH_dp; see ``gradient``."""
    graph, time = parameters
    graph.memory[4 * graph.places[3]] = time[0]
    gradient(graph, q, p, dH_dq, dH_dp)
    time[1] = graph.memory[graph.places[1] + 2 * graph.places[3]]


@_compiled
def hessian_vector_at(parameters: tuple[GraphParameters, np.ndarray], q: np.ndarray,
                      p: np.ndarray, v_q: np.ndarray, v_p: np.ndarray, product_q: np.ndarray,
                      product_p: np.ndarray) -> None:
    """Fill the last two; see ``hessian_vector``."""
    graph, time = parameters
    graph.memory[4 * graph.places[3]] = time[0]
    hessian_vector(graph, q, p, v_q, v_p, product_q, product_p)


@_part
def _load(memory: np.ndarray, at: int, d: int, q: np.ndarray, p: np.ndarray, s: int) -> None:
    for i in range(d):
        memory[at + i], memory[at + d + i] = q[s + i], p[s + i]


def _run(program: int, which: int) -> None:
    """Run a tape of a program, given its address."""
    own = load(program, _PROGRAM)
    x, index, code = own.memory, own.numbers, own.code
    for k in range(own.ends[which], own.ends[which + 1]):
        op, out, n, a, b = code[k, 0], code[k, 1], code[k, 2], code[k, 3], code[k, 4]
        if op >= FIRST_UNARY:
            _apply(op, x, out, n, a, b)
        elif op == NETWORK:
            network = load(address_of(own.networks) + _BYTES * np.int64(code[k, 7]), _NETWORK)
            run_network(network, x, out, a, b, code[k, 5], code[k, 6], code[k, 8])
        elif op == MATMUL:
            if code[k, 8]:
                _times_rows(x, code[k])
            else:
                _times_columns(x, code[k])
        elif op == SUM:
            _sum(x, out, n, a, b, code[k, 5])
        elif op == AMAX:
            _amax(x, out, n, a, b, code[k, 5])
        elif op == FILL:
            for i in range(n):
                x[out + i] = x[a]
        elif op == TAKE:
            for i in range(n):
                x[out + i] = x[a + index[b + i]]
        elif op == PUT:
            for i in range(n):
                x[out + i] = 0.0
            for i in range(code[k, 5]):
                x[out + index[b + i]] += x[a + i]
        elif op == COPY:
            for i in range(n):
                x[out + i] = x[a + i]
        elif op == WHERE:
            c = code[k, 5]
            for i in range(n):
                x[out + i] = x[b + i] if x[a + i] != 0.0 else x[c + i]


@_part
def _times_columns(x: np.ndarray, code: np.ndarray) -> None:
    """Set out to a b, of shapes (rows, inner) and (inner, columns), row by row of out."""
    out, rows, columns, inner, a, b = code[1], code[2], code[3], code[4], code[5], code[6]
    step, across = (_ONE, rows) if code[7] else (inner, _ONE)
    whole = inner // _TILE * _TILE
    for i in range(rows):
        o, y = out + i * columns, a + i * step
        for j in range(columns):
            x[o + j] = 0.0
        for k in range(np.uint64(0), whole, _TILE):
            w, u = b + k * columns, y + k * across
            c0, c1, c2, c3 = x[u], x[u + across], x[u + _2 * across], x[u + _3 * across]
            c4, c5 = x[u + _4 * across], x[u + _5 * across]
            c6, c7 = x[u + _6 * across], x[u + _7 * across]
            for j in range(columns):
                v = w + j
                x[o + j] += (
                    x[v] * c0 + x[v + columns] * c1 + x[v + _2 * columns] * c2
                    + x[v + _3 * columns] * c3 + x[v + _4 * columns] * c4
                    + x[v + _5 * columns] * c5 + x[v + _6 * columns] * c6
                    + x[v + _7 * columns] * c7)
        for k in range(whole, inner):
            c = x[y + k * across]
            for j in range(columns):
                x[o + j] += x[b + k * columns + j] * c


@_part
def _times_rows(x: np.ndarray, code: np.ndarray) -> None:
    """Set out to a b^T, of shapes (rows, inner) and (columns, inner), by eight rows of b."""
    out, rows, columns, inner, a, b = code[1], code[2], code[3], code[4], code[5], code[6]
    step, across = (_ONE, rows) if code[7] else (inner, _ONE)
    whole = columns // _TILE * _TILE
    for i in range(rows):
        o, y = out + i * columns, a + i * step
        for j in range(np.uint64(0), whole, _TILE):
            w = b + j * inner
            z0 = z1 = z2 = z3 = z4 = z5 = z6 = z7 = 0.0
            for k in range(inner):
                c, v = x[y + k * across], w + k
                z0 += x[v] * c
                z1 += x[v + inner] * c
                z2 += x[v + _2 * inner] * c
                z3 += x[v + _3 * inner] * c
                z4 += x[v + _4 * inner] * c
                z5 += x[v + _5 * inner] * c
                z6 += x[v + _6 * inner] * c
                z7 += x[v + _7 * inner] * c
            t = o + j
            x[t], x[t + _1], x[t + _2], x[t + _3] = z0, z1, z2, z3
            x[t + _4], x[t + _5], x[t + _6], x[t + _7] = z4, z5, z6, z7
        for j in range(whole, columns):
            z = 0.0
            for k in range(inner):
                z += x[y + k * across] * x[b + j * inner + k]
            x[o + j] = z


@_part
def _sum(x: np.ndarray, out: Any, outer: Any, count: Any, inner: Any, a: Any) -> None:
    """Set out to sums over the second of three axes."""
    if inner == 1:
        for i in range(outer):
            total, begin = 0.0, a + i * count
            for k in range(count):
                total += x[begin + k]
            x[out + i] = total
        return
    for i in range(outer):
        o, begin = out + i * inner, a + i * count * inner
        for j in range(inner):
            x[o + j] = x[begin + j]
        for k in range(_ONE, count):
            for j in range(inner):
                x[o + j] += x[begin + k * inner + j]


@_part
def _amax(x: np.ndarray, out: Any, outer: Any, count: Any, inner: Any, a: Any) -> None:
    """Set out to the largest values over the second of three axes; NaN is the largest."""
    for i in range(outer):
        for j in range(inner):
            begin = a + i * count * inner + j
            best = x[begin]
            for k in range(_ONE, count):
                y = x[begin + k * inner]
                best = y if y > best or y != y else best
            x[out + i * inner + j] = best


def _elementwise(function: Callable[..., Any], binary: bool) -> Part:
    """Return the loop that sets out to a function of a, or of a and b."""
    one = _part(function)

    @_part
    def of_one(op: Any, x: np.ndarray, out: Any, n: Any, a: Any, b: Any) -> None:
        for i in range(n):
            x[out + i] = one(x[a + i])

    @_part
    def of_two(op: Any, x: np.ndarray, out: Any, n: Any, a: Any, b: Any) -> None:
        for i in range(n):
            x[out + i] = one(x[a + i], x[b + i])

    return of_two if binary else of_one


def _chosen(loops: Sequence[Part], first: int) -> Part:
    """Return one loop for operations numbered from ``first``; the number is found by halves."""
    if len(loops) == 1:
        return loops[0]
    middle = len(loops) // 2
    limit = np.uint64(first + middle)
    low, high = _chosen(loops[:middle], first), _chosen(loops[middle:], first + middle)

    @_part
    def choose(op: Any, x: np.ndarray, out: Any, n: Any, a: Any, b: Any) -> None:
        if op < limit:
            low(op, x, out, n, a, b)
        else:
            high(op, x, out, n, a, b)

    return choose


_OF_ONE: dict[str, Callable[[float], float]] = {
    'neg': lambda y: -y,
    'abs': lambda y: abs(y),
    'sign': lambda y: 1.0 if y > 0.0 else -1.0 if y < 0.0 else y,
    'floor': lambda y: math.floor(y),
    'ceil': lambda y: math.ceil(y),
    'rint': lambda y: np.rint(y),
    'not': lambda y: 1.0 if y == 0.0 else 0.0,
    'relu': lambda y: 0.0 if y <= 0.0 else y,
    'reciprocal': lambda y: 1.0 / y,
    'sqrt': lambda y: math.sqrt(y),
    'exp': lambda y: exponential(y),
    'expm1': lambda y: math.expm1(y),
    'log': lambda y: logarithm(y),
    'log1p': lambda y: math.log1p(y),
    'sin': lambda y: sine_and_cosine(y)[0],
    'cos': lambda y: sine_and_cosine(y)[1],
    'tan': lambda y: math.tan(y),
    'asin': lambda y: math.asin(y),
    'acos': lambda y: math.acos(y),
    'atan': lambda y: math.atan(y),
    'sinh': lambda y: math.sinh(y),
    'cosh': lambda y: math.cosh(y),
    'tanh': lambda y: tanh(y),
    'asinh': lambda y: math.asinh(y),
    'sigmoid': lambda y: softplus_and_slope(y)[1],
    'softplus': lambda y: softplus_and_slope(y)[0],
    'fixed': lambda y: y,
    'erf': lambda y: math.erf(y),
    'root': lambda y: math.sqrt(y)}
_OF_TWO: dict[str, Callable[[float, float], float]] = {
    'add': lambda y, z: y + z,
    'sub': lambda y, z: y - z,
    'mul': lambda y, z: y * z,
    'div': lambda y, z: y / z,
    'pow': lambda y, z: math.pow(y, z),
    'maximum': lambda y, z: y if y > z or y != y else z,
    'minimum': lambda y, z: y if y < z or y != y else z,
    'atan2': lambda y, z: math.atan2(y, z),
    'lt': lambda y, z: 1.0 if y < z else 0.0,
    'le': lambda y, z: 1.0 if y <= z else 0.0,
    'gt': lambda y, z: 1.0 if y > z else 0.0,
    'ge': lambda y, z: 1.0 if y >= z else 0.0,
    'eq': lambda y, z: 1.0 if y == z else 0.0,
    'ne': lambda y, z: 1.0 if y != z else 0.0}
_apply = _chosen([*(_elementwise(_OF_ONE[op], False) for op in UNARY),
                  *(_elementwise(_OF_TWO[op], True) for op in BINARY)], FIRST_UNARY)
