# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Compiled operations of graphs with a network y = N(x) of several outputs, at one state.

They read and write places of a graph's memory. The workspace of the network keeps its activations
and, along a change v of x, their tangents, so that each is computed once per state, by the first
operation that needs them.
"""

from typing import Any

from hnn_vi_ros.kernels import part
from hnn_vi_ros.models.networks.activations import FASTMATH
from hnn_vi_ros.models.networks.perceptron import backward, forward, last_tile
from hnn_vi_ros.models.networks.perceptron_memory import Mapping
import numpy as np

_VALUES, _TANGENTS, _BACK, _ALONG = (np.uint64(1 << k) for k in range(4))
_part = part(fastmath=FASTMATH, error_model='numpy', forceinline=True)


@part(fastmath=FASTMATH, error_model='numpy')
def run_network(network: Mapping, memory: np.ndarray, out: Any, x: Any, n: Any, g: Any, v: Any,
                flags: Any) -> None:
    """
    Set out to N(x); along a change v of x, to its derivative; on the way back, of N'(x)^T g.

    Parameters
    ----------
    network : Mapping
        The network.
    memory : np.ndarray
        Memory of the graph.
    out, x, n, g, v : np.uint64
        Places of the result and of the arguments, and the number of inputs.
    flags : np.uint64
        1 to compute the activations, 2 their tangents, 4 for the way back, 8 for a derivative.

    """
    values, tangents = flags & _VALUES != 0, flags & _TANGENTS != 0
    back, along = flags & _BACK != 0, flags & _ALONG != 0
    sizes, nodes, bias = network.sizes, network.nodes, network.bias
    n_layers, at, size = sizes.size - 1, last_tile(network), sizes.size
    if values:
        _load(network, 0, memory, x, n)
    if tangents:
        _load(network, 2 * size, memory, v, n)
    if values or tangents:
        # On the way back the last layer is evaluated with the same read of its weights.
        forward(network, 1, max(1, n_layers - 1) if back and values else n_layers, values,
                tangents)
    if back:
        _weigh(network, memory, g)
        if along:
            for i in range(sizes[n_layers]):
                nodes[0, 3 * size + n_layers, i] = 0.0
        backward(network, 1, at, values, along)
        row = 3 * size if along else size
        for i in range(n):
            memory[out + i] = nodes[0, row, i]
    else:
        last, row = network.last, (2 * size if along else 0) + n_layers
        for k in range(np.uint64(bias.size)):
            total = 0.0 if along else bias[k]
            for i in range(last.shape[1]):
                total += last[k, i] * nodes[0, row, i]
            memory[out + k] = total


@_part
def _load(network: Mapping, row: int, memory: np.ndarray, x: Any, n: Any) -> None:
    nodes = network.nodes
    for i in range(n):
        nodes[0, row, i] = memory[x + i]


@_part
def _weigh(network: Mapping, memory: np.ndarray, g: Any) -> None:
    """Set g_K to Y^T g."""
    last, nodes = network.last, network.nodes
    row = 2 * network.sizes.size - 1
    for i in range(last.shape[1]):
        nodes[0, row, i] = last[0, i] * memory[g]
    for k in range(np.uint64(1), np.uint64(last.shape[0])):
        for i in range(last.shape[1]):
            nodes[0, row, i] += last[k, i] * memory[g + k]
