# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
A network, its gradient and its second derivative as compiled loops over plain arrays.

With a_0 = (q, p), z_l = W_l a_(l-1) + b_l, a_l = f(z_l) and H = w . a_K + b, the gradient is
propagated back by g_K = w, delta_l = f'(z_l) g_l, g_(l-1) = W_l^T delta_l, so (H_q, H_p) = g_0.
The derivatives of these lines along a_0' = v, marked by a prime, end in H''(q, p) v = g_0'.

A network is a PackedPerceptron of perceptron_memory: a_l of state s is nodes[s, l], followed by
g_l, a_l' and g_l' in K + 1 rows each; activations.py contains all code that depends on f. Layers
are processed in tiles of eight rows of weights.
"""

from typing import Any

from hnn_vi_ros.kernels import address_of, kept, LINK_ONLY, part, row_multiplier
from hnn_vi_ros.models.networks.activations import (
    activate, FASTMATH, in_columns, scale, scale_forth, scale_tangent)
from hnn_vi_ros.models.networks.perceptron_memory import MAX_STATES, PackedPerceptron, ROW, TILE
from llvmlite.binding import get_host_cpu_features
from numba import types
from numba.extending import overload
import numpy as np

_compiled = kept(fastmath=FASTMATH, error_model='numpy')
# The gradient is inlined even into the caller's loop: behind a call the compiler knows nothing
# about the arrays and counts a reference for each, which is as slow as twenty additions.
_inlined = kept(fastmath=FASTMATH, error_model='numpy', forceinline=True)
_part = part(fastmath=FASTMATH, error_model='numpy', forceinline=True)

# Rows whose sums stay in registers: there are 32 of 512 bits, or 16 of 256.
_ROWS = 8 if get_host_cpu_features().get('avx512f') else 4
_multiply_pair, _multiply_rows = row_multiplier(2), row_multiplier(_ROWS)
_called = part(fastmath=FASTMATH, error_model='numpy')

# States that are evaluated one by one; more are columns of matrices.
_FEW = 8
# Number of weights used forwards and backwards while they stay in the L1 cache, 32 KiB.
_BLOCK = 4096


@_compiled
def energy(network: PackedPerceptron, q: np.ndarray, p: np.ndarray) -> float:
    """Return H(q, p) [J] for q and p of shape (d,)."""
    sizes, rows, nodes = network.sizes, network.rows, network.nodes
    n_layers = sizes.size - 1
    _load(network, 0, 1, 0, q, p)
    forward(network, 1, n_layers, True, False)
    last = sizes[0] + n_layers
    total = rows[last + 1, 0]
    for i in range(sizes[n_layers]):
        total += rows[last, i] * nodes[0, n_layers, i]
    return total


@_inlined
def gradient(network: PackedPerceptron, q: np.ndarray, p: np.ndarray,
             dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    """Fill dH_dq and dH_dp, all of shape (m d,): m states in sequence."""
    sizes = network.sizes
    n_states = 2 * q.size // sizes[0]
    for chunk in range((n_states + MAX_STATES - 1) // MAX_STATES):
        first = chunk * MAX_STATES
        n = min(MAX_STATES, n_states - first)
        if n > _FEW:
            _fill_many(network, first, n, q, p, dH_dq, dH_dp)
        else:
            _fill_few(network, first, n, q, p, dH_dq, dH_dp)


@part(error_model='numpy')
def part_gradient(network: PackedPerceptron, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
                  dH_dp: np.ndarray) -> None:
    """Fill the gradient of one network; not inlined, because inlining several compiles slowly."""
    gradient(network, q, p, dH_dq, dH_dp)


@_part
def _fill_few(network: PackedPerceptron, first: int, n: int, q: np.ndarray, p: np.ndarray,
              dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    _load(network, first, n, 0, q, p)
    _propagate(network, n, False)
    _store(network, first, n, network.sizes.size, dH_dq, dH_dp)


def _fill_many(network: PackedPerceptron, first: int, n: int, q: np.ndarray, p: np.ndarray,
               dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    raise NotImplementedError('compiled code only')


@overload(_fill_many, jit_options={
    'fastmath': FASTMATH, 'error_model': 'numpy', 'forceinline': True, **LINK_ONLY})
def _fill_many_compiled(network: Any, first: int, n: int, q: np.ndarray, p: np.ndarray,
                        dH_dq: np.ndarray, dH_dp: np.ndarray) -> Any:
    def by_columns(network: Any, first: int, n: int, q: np.ndarray, p: np.ndarray,
                   dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
        _gradient_of_many(network, first, n, q, p, dH_dq, dH_dp)

    def in_turn(network: Any, first: int, n: int, q: np.ndarray, p: np.ndarray,
                dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
        _fill_few(network, first, n, q, p, dH_dq, dH_dp)
    kinds = dict(zip(network.fields, network.types, strict=True))
    # Studies evaluate networks in single precision.
    return by_columns if kinds['nodes'].dtype == types.float64 else in_turn


@_compiled
def hessian_vector(network: PackedPerceptron, q: np.ndarray, p: np.ndarray, v_q: np.ndarray,
                   v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
    """Fill the last two with H''(q, p) (v_q, v_p), all of shape (m d,)."""
    sizes = network.sizes
    n_states = 2 * q.size // sizes[0]
    for chunk in range((n_states + MAX_STATES - 1) // MAX_STATES):
        first = chunk * MAX_STATES
        n = min(MAX_STATES, n_states - first)
        _load(network, first, n, 0, q, p)
        _load(network, first, n, 2 * sizes.size, v_q, v_p)
        _propagate(network, n, True)
        _store(network, first, n, 3 * sizes.size, product_q, product_p)


@_called
def _gradient_of_many(network: PackedPerceptron, first: int, n_states: int, q: np.ndarray,
                      p: np.ndarray, dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    """
    Fill the gradients of n_states states from the first on.

    States are columns: a_l is a matrix of n_l rows, each in adjacent lanes of memory, so that
    vectors are of states, and each weight that is read serves eight of them.
    """
    sizes, rows = network.sizes, network.rows
    d, n_layers, g = sizes[0] // 2, sizes.size - 1, sizes.size
    lanes, line = (n_states + TILE - 1) & -TILE, 8 * rows.shape[1]
    columns = in_columns(network)
    nodes = columns.nodes
    nodes[0, 0, :sizes[0] * lanes] = 0.0
    for s in range(n_states):
        for i in range(d):
            nodes[0, 0, i * lanes + s] = q[(first + s) * d + i]
            nodes[0, 0, (d + i) * lanes + s] = p[(first + s) * d + i]
    at = (sizes[0] + sizes.size + TILE) & -TILE
    for layer in range(1, n_layers + 1):
        # The columns of W_1 are in rows.
        first_row, across, along = (at, line, 8) if layer > 1 else (0, 8, line)
        for i in range(0, sizes[layer], _ROWS):
            _multiply_rows(address_of(rows[first_row]) + i * across, across, along,
                           sizes[layer - 1], address_of(nodes[0, layer - 1]),
                           address_of(nodes[0, layer]) + 8 * lanes * i, lanes)
        _spread(rows[sizes[0] + layer - 1], sizes[layer], lanes, nodes[0, g + layer])
        activate(columns, 0, layer, g + layer, 0, sizes[layer] * lanes // TILE)
        at += sizes[layer] if layer > 1 else 0
    _spread(rows[sizes[0] + n_layers], sizes[n_layers], lanes, nodes[0, g + n_layers])
    for layer in range(n_layers, 0, -1):
        scale(columns, 0, layer, g, 0, sizes[layer] * lanes // TILE)
        at -= sizes[layer]
        for i in range(0, sizes[layer - 1] if layer > 1 else 0, _ROWS):
            _multiply_rows(address_of(rows[at]) + 8 * i, 8, line, sizes[layer],
                           address_of(nodes[0, g + layer]),
                           address_of(nodes[0, g + layer - 1]) + 8 * lanes * i, lanes)
    for i in range(0, sizes[0], 2):
        _multiply_pair(address_of(rows[i]), line, 8, sizes[1], address_of(nodes[0, g + 1]),
                       address_of(nodes[0, g]) + 8 * lanes * i, lanes)
    for s in range(n_states):
        for i in range(d):
            dH_dq[(first + s) * d + i] = nodes[0, g, i * lanes + s]
            dH_dp[(first + s) * d + i] = nodes[0, g, (d + i) * lanes + s]


@_part
def _spread(row: np.ndarray, n: int, lanes: int, columns: np.ndarray) -> None:
    """Fill n rows of all lanes with one number each."""
    for i in range(n):
        for s in range(lanes):
            columns[i * lanes + s] = row[i]


@_part
def _load(network: PackedPerceptron, first: int, n_states: int, row: int, q: np.ndarray,
          p: np.ndarray) -> None:
    sizes, nodes = network.sizes, network.nodes
    d = sizes[0] // 2
    for s in range(n_states):
        for i in range(d):
            nodes[s, row, i] = q[(first + s) * d + i]
            nodes[s, row, d + i] = p[(first + s) * d + i]


@_part
def _store(network: PackedPerceptron, first: int, n_states: int, row: int, q: np.ndarray,
           p: np.ndarray) -> None:
    sizes, nodes = network.sizes, network.nodes
    d = sizes[0] // 2
    for s in range(n_states):
        for i in range(d):
            q[(first + s) * d + i] = nodes[s, row, i]
            p[(first + s) * d + i] = nodes[s, row, d + i]


@_part
def _propagate(network: PackedPerceptron, n_states: int, tangent: bool) -> None:
    """Fill g_0 from a_0 of the first states; with ``tangent``, also g_0' from a_0'."""
    sizes, rows, nodes = network.sizes, network.rows, network.nodes
    n_layers, g = sizes.size - 1, sizes.size
    at = forward(network, n_states, max(1, n_layers - 1), True, tangent)
    for s in range(n_states):
        if tangent:
            for i in range(sizes[n_layers]):
                nodes[s, 3 * g + n_layers, i] = 0.0
        for i in range(sizes[n_layers]):
            nodes[s, g + n_layers, i] = rows[sizes[0] + n_layers, i]
    # As ``backward``, written out: with a call of it, gradients that are inlined into loops took
    # up to 1.2 times as long.
    for layer in range(n_layers, 1, -1):
        if layer < n_layers:
            at -= sizes[layer] // TILE
        _back(network, n_states, at, layer, layer == n_layers, tangent)
    for s in range(n_states):
        if tangent:
            scale_tangent(network, s, 1, 0, sizes[1] // TILE)
            _transposed_columns(network, s, 3 * g)
        scale(network, s, 1, g, 0, sizes[1] // TILE)
        _transposed_columns(network, s, g)


@_part
def backward(network: PackedPerceptron, n_states: int, at: int, forth: bool, tangent: bool
             ) -> None:
    """
    Fill g_0 from g_K of the first states; with ``tangent``, also g_0' from g_K'.

    With ``forth`` the last layer, whose first tile is ``at``, is evaluated as well.
    """
    sizes, n_layers, g = network.sizes, network.sizes.size - 1, network.sizes.size
    for layer in range(n_layers, 1, -1):
        if layer < n_layers:
            at -= sizes[layer] // TILE
        _back(network, n_states, at, layer, forth and layer == n_layers, tangent)
    for s in range(n_states):
        if tangent:
            scale_tangent(network, s, 1, 0, sizes[1] // TILE)
            _transposed_columns(network, s, 3 * g)
        scale(network, s, 1, g, 0, sizes[1] // TILE)
        _transposed_columns(network, s, g)


@_part
def last_tile(network: PackedPerceptron) -> int:
    """Return the first tile of the last hidden layer, or of the next one if there is one."""
    sizes = network.sizes
    at = (sizes[0] + sizes.size + TILE) // TILE
    for layer in range(2, sizes.size - 1):
        at += sizes[layer] // TILE
    return at


@_part
def forward(network: PackedPerceptron, n_states: int, n_layers: int, values: bool, tangent: bool
            ) -> int:
    """
    Fill a_1 to a_l of layer l = n_layers; return the first tile of the next layer.

    Activations are filled with ``values``, their changes along a_0' with ``tangent``.
    """
    sizes = network.sizes
    for s in range(n_states):
        if values:
            _columns(network, s, 0)
            activate(network, s, 1, sizes[0], 0, sizes[1] // TILE)
        if tangent:
            _columns(network, s, 2 * sizes.size)
            scale_forth(network, s, 1, 0, sizes[1] // TILE)
    at = (sizes[0] + sizes.size + TILE) // TILE
    for layer in range(2, n_layers + 1):
        n_tiles = sizes[layer] // TILE
        n_blocks, size = _blocks(sizes[layer - 1], n_tiles)
        for block in range(n_blocks):
            first, last = block * size, min(block * size + size, n_tiles)
            for s in range(n_states):
                _block_forth(network, at, s, layer, first, last, values, tangent)
        at += n_tiles
    return at


@_part
def _back(network: PackedPerceptron, n_states: int, at: int, layer: int, forth: bool, tangent: bool
          ) -> None:
    """Propagate back through a layer, first forward if it is the last: one read of its weights."""
    sizes = network.sizes
    n_tiles = sizes[layer] // TILE
    n_blocks, size = _blocks(sizes[layer - 1], n_tiles)
    for block in range(n_blocks):
        first, last = block * size, min(block * size + size, n_tiles)
        for s in range(n_states):
            if forth:
                _block_forth(network, at, s, layer, first, last, True, tangent)
            _block_back(network, at, s, layer, first, last, tangent)


@_part
def _blocks(n_in: int, n_tiles: int) -> tuple[int, int]:
    """Return the number of blocks of n_tiles tiles of n_in columns, and the tiles of a block."""
    size = max(1, _BLOCK // (TILE * n_in))
    return (n_tiles + size - 1) // size, size


@_part
def _block_forth(network: PackedPerceptron, at: int, s: int, layer: int, first: int, last: int,
                 values: bool, tangent: bool) -> None:
    sizes = network.sizes
    if values:
        _product(network, at, s, layer, sizes[layer - 1], first, last)
        activate(network, s, layer, sizes[0] + layer - 1, first, last)
    if tangent:
        _product(network, at, s, 2 * sizes.size + layer, sizes[layer - 1], first, last)
        scale_forth(network, s, layer, first, last)


@_part
def _block_back(network: PackedPerceptron, at: int, s: int, layer: int, first: int, last: int,
                tangent: bool) -> None:
    sizes = network.sizes
    g = sizes.size
    if tangent:
        scale_tangent(network, s, layer, first, last)
        _transposed_product(network, at, s, 3 * g + layer, sizes[layer - 1], first, last)
    scale(network, s, layer, g, first, last)
    _transposed_product(network, at, s, g + layer, sizes[layer - 1], first, last)


@_part
def _columns(network: PackedPerceptron, s: int, row: int) -> None:
    """Set row + 1 to W_1 times row; W_1 has too few columns to vectorise along its rows."""
    sizes, rows, nodes = network.sizes, network.rows, network.nodes
    for j in range(0, sizes[0], 2):
        x, y = nodes[s, row, j], nodes[s, row, j + 1]
        for i in range(sizes[1]):
            before = nodes[s, row + 1, i] if j > 0 else 0.0
            nodes[s, row + 1, i] = before + rows[j, i] * x + rows[j + 1, i] * y


@_part
def _transposed_columns(network: PackedPerceptron, s: int, row: int) -> None:
    """Set row to W_1^T times row + 1."""
    sizes, rows, nodes = network.sizes, network.rows, network.nodes
    for j in range(0, sizes[0], 2):
        x, y = 0.0, 0.0
        for i in range(sizes[1]):
            x += rows[j, i] * nodes[s, row + 1, i]
            y += rows[j + 1, i] * nodes[s, row + 1, i]
        nodes[s, row, j], nodes[s, row, j + 1] = x, y


@_part
def _product(network: PackedPerceptron, at: int, s: int, row: int, n_in: int, first: int, last: int
             ) -> None:
    """Set tiles first to last of a row to W_l times the previous row."""
    tiles, nodes, node_tiles = network.tiles, network.nodes, network.node_tiles
    whole = (n_in + ROW - 1) & -ROW
    for t in range(first, last):
        w = at + t
        z0 = z1 = z2 = z3 = z4 = z5 = z6 = z7 = 0.0
        for j in range(whole):
            a = nodes[s, row - 1, j]
            z0 += tiles[w, 0, j] * a
            z1 += tiles[w, 1, j] * a
            z2 += tiles[w, 2, j] * a
            z3 += tiles[w, 3, j] * a
            z4 += tiles[w, 4, j] * a
            z5 += tiles[w, 5, j] * a
            z6 += tiles[w, 6, j] * a
            z7 += tiles[w, 7, j] * a
        z = node_tiles[s, row, t]
        z[0], z[1], z[2], z[3], z[4], z[5], z[6], z[7] = z0, z1, z2, z3, z4, z5, z6, z7


@_part
def _transposed_product(network: PackedPerceptron, at: int, s: int, row: int, n_in: int,
                        first: int, last: int) -> None:
    """Add the contribution of tiles first to last of a row, by W_l^T, to the previous row."""
    tiles, nodes, node_tiles = network.tiles, network.nodes, network.node_tiles
    for t in range(first, last):
        w, d = at + t, node_tiles[s, row, t]
        d0, d1, d2, d3, d4, d5, d6, d7 = d[0], d[1], d[2], d[3], d[4], d[5], d[6], d[7]
        for j in range(n_in):
            before = nodes[s, row - 1, j] if t > 0 else 0.0
            nodes[s, row - 1, j] = before + (
                tiles[w, 0, j] * d0 + tiles[w, 1, j] * d1
                + tiles[w, 2, j] * d2 + tiles[w, 3, j] * d3
                + tiles[w, 4, j] * d4 + tiles[w, 5, j] * d5
                + tiles[w, 6, j] * d6 + tiles[w, 7, j] * d7)
