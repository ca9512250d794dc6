# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Memory of the compiled loops of perceptron.py: weights and workspace."""

from typing import NamedTuple

import numpy as np

# Eight rows of weights, used together, are a tile; layers are zero-padded to whole tiles.
TILE = 8
# Numbers in a cache line of 64 bytes, also the widest vector: no load should cross a line.
_LINE = 8
# Rows are whole pairs of lines, which the compiler loads at once: there is no remainder.
ROW = 2 * _LINE
# States that pass through the network together. Measured on a 2-200-200-1 network, 32 cost 7 %
# less per state than 8; their activations still fit into the L2 cache.
MAX_STATES = 32


class PackedPerceptron(NamedTuple):
    """
    Parameters of the functions of perceptron.py: a network of K hidden layers, and workspace.

    The activation between its layers is part of the type, so that compiled code knows it: a
    network is an instance of one of the classes below.

    Parameters
    ----------
    sizes : np.ndarray of int, shape (K + 1,)
        2 d, then the padded widths n_1, ..., n_K of the hidden layers.
    rows, tiles : np.ndarray
        The same memory, (rows, width) and (rows / 8, 8, width). Rows: the 2 d columns of W_1, the
        biases b_1, ..., b_K, w, b; from the next whole tile on the rows of W_2, ..., W_K.
    nodes, node_tiles : np.ndarray
        The same workspace, (MAX_STATES, 4 K + 4, width) and (MAX_STATES, 4 K + 4, width / 8, 8):
        a_0, ..., a_K of each state, then all g, all a', and all g'. Other classes than Tanh have 2
        K + 2 more rows: all slopes f'(z_l), then their derivatives f'(z_l)'.

    """

    sizes: np.ndarray
    rows: np.ndarray
    tiles: np.ndarray
    nodes: np.ndarray
    node_tiles: np.ndarray


class Tanh(PackedPerceptron):
    """A network with tanh between its layers."""

    __slots__ = ()


class Sine(PackedPerceptron):
    """A network with the sine between its layers."""

    __slots__ = ()


class Relu(PackedPerceptron):
    """A network with max(0, z) between its layers."""

    __slots__ = ()


class Softplus(PackedPerceptron):
    """A network with log(1 + exp(z)) between its layers."""

    __slots__ = ()


class Mapping(NamedTuple):
    """
    A network y = Y a_K + b of any activation and number of outputs, for graphs.

    Parameters
    ----------
    sizes, rows, tiles, nodes, node_tiles : np.ndarray
        As of a PackedPerceptron of another class than Tanh, without w and b.
    activation : int
        Number of the activation in the order of ACTIVATIONS.
    last : np.ndarray, shape (k, n)
        Y.
    bias : np.ndarray, shape (k,)
        b.

    """

    sizes: np.ndarray
    rows: np.ndarray
    tiles: np.ndarray
    nodes: np.ndarray
    node_tiles: np.ndarray
    activation: int
    last: np.ndarray
    bias: np.ndarray


_KINDS: dict[str, type[PackedPerceptron]] = {
    'tanh': Tanh, 'sine': Sine, 'relu': Relu, 'softplus': Softplus}


ACTIVATIONS = tuple(_KINDS)


def pack_mapping(weights: tuple[np.ndarray, ...], biases: tuple[np.ndarray, ...],
                 activation: str) -> Mapping:
    """Return a network of any number of inputs and outputs, with workspace for one state."""
    first, *others, last = weights
    # The loops take inputs in pairs.
    first = np.pad(first, ((0, 0), (0, first.shape[1] % 2)))
    one = np.zeros((1, last.shape[1]))
    packed = pack((first, *others, one), (*biases[:-1], np.zeros(1)), activation, 1, 6)
    return Mapping(*packed, ACTIVATIONS.index(activation), np.ascontiguousarray(last),
                   np.ascontiguousarray(biases[-1]))


def pack(weights: tuple[np.ndarray, ...], biases: tuple[np.ndarray, ...],
         activation: str = 'tanh', states: int = MAX_STATES, groups: int = 0
         ) -> PackedPerceptron:
    """
    Return a network for the functions of perceptron.py, with its own workspace.

    All rows are as long as the widest layer, zero-padded.

    Parameters
    ----------
    weights : tuple of np.ndarray, each (outputs, inputs)
        W_1, ..., W_K and w, the last with one output.
    biases : tuple of np.ndarray, each (outputs,)
        b_1, ..., b_K and b.
    activation : str
        Activation between the layers.
    states : int
        Number of states that the workspace is for.
    groups : int
        Groups of rows in the workspace of a state; default: those that the activation needs.

    """
    first, *middle, last = weights
    sizes = np.array([first.shape[1], *(_padded(len(w), TILE) for w in weights[:-1])])
    width = _padded(int(sizes.max()), ROW)
    heads = [*first.T, *biases[:-1], last[0], biases[-1]]
    at = _padded(len(heads), TILE)
    rows = _aligned(at + int(sizes[2:].sum()), width)
    for row, head in zip(rows, heads, strict=False):
        row[:head.size] = head
    for weight, n_out in zip(middle, sizes[2:], strict=True):
        rows[at:at + weight.shape[0], :weight.shape[1]] = weight
        at += n_out
    kind = _KINDS[activation]
    nodes = _aligned(states, (groups or (4 if kind is Tanh else 6)) * sizes.size, width)
    return kind(sizes, rows, rows.reshape(-1, TILE, width),
                nodes, nodes.reshape(*nodes.shape[:2], -1, TILE))


def _padded(n: int, multiple: int) -> int:
    return -(-n // multiple) * multiple


def _aligned(*shape: int) -> np.ndarray:
    """Return zeros aligned to a cache line."""
    size = int(np.prod(shape))
    memory = np.zeros(size + _LINE)
    start = (-memory.ctypes.data // memory.itemsize) % _LINE
    return memory[start:start + size].reshape(shape)
