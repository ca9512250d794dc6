# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Launches of the two kernels in Triton for a gradient.

On the processor they run in Triton's interpreter alone, which is for tests.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.lockstep import triton_kernels
from hnn_vi_ros.models.checkpoint import Layers
import torch

# Blocks of products: at most so many rows, and so many columns and terms at once. With all rows of
# a layer in one block, tanh of the other is taken once. Compiled for sm_90, these spill no
# registers in the first kernel, and 31 numbers of a thread in the second; 32 columns spill 74 and
# 163. A block of 16 rows is a warp's.
_MOST_ROWS, COLUMNS, _TERMS, _MOST_WARPS = 256, 16, 16, 8


def power(least: int, n: int) -> int:
    """Return the smallest power of 2 that is neither less than n nor than another."""
    return max(least, 1 << (n - 1).bit_length())


def warps_of(rows: int) -> int:
    """Return how many warps share so many rows."""
    return min(rows // 16, _MOST_WARPS)


def on_device(device: torch.device) -> AbstractContextManager[Any]:
    """Return where launches go to a device: by itself Triton takes the current one."""
    return torch.cuda.device(device) if device.type == 'cuda' else nullcontext()


def passes(layers: list[tuple[torch.Tensor, torch.Tensor]], last: torch.Tensor,
           values: list[torch.Tensor], slopes: list[torch.Tensor], inputs: torch.Tensor,
           gradient: torch.Tensor) -> tuple[Callable[[], None], Callable[[], None]]:
    """
    Return the two launches of a gradient: forward through two layers, and back from the second.

    Parameters
    ----------
    layers : list of tuple
        Weights and biases, shapes (n_l, n_(l-1)) and (n_l, 1); at least two.
    last : torch.Tensor, shape (n, 1)
        Weights of the output.
    values, slopes : list of torch.Tensor, each (n_l, m)
        Of the layers: f(Z_l), and f'(Z_l) or, before the launch back, D_l. Those of the first
        are not touched, and where there are two neither is the value of the second.
    inputs, gradient : torch.Tensor, shape (n_0, m)
        What it starts from, and ends in; m is a multiple of 16.

    """
    (w1, b1), (w2, b2) = layers[:2]
    (n1, n), n2, m = w1.shape, len(w2), inputs.shape[1]
    assert m % COLUMNS == 0, 'batches are whole blocks'
    grid, device = (m // COLUMNS,), inputs.device
    rows, rows_back = (min(power(16, width), _MOST_ROWS) for width in (n2, n1))

    def forward() -> None:
        with on_device(device):
            triton_kernels.forward[grid](
                inputs, w1, b1, w2, b2, last, values[1], slopes[1], m, n1, n2, INPUTS=n,
                LAST=len(layers) == 2, ROWS=rows, COLUMNS=COLUMNS, DEPTH=_TERMS,
                numwarps_of=warps_of(rows))

    def backward() -> None:
        with on_device(device):
            triton_kernels.backward[grid](
                inputs, w1, b1, w2, slopes[1], gradient, m, n1, n2, INPUTS=n,
                PADDED=power(16, n), ROWS=rows_back, COLUMNS=COLUMNS, DEPTH=_TERMS,
                numwarps_of=warps_of(rows_back))
    return forward, backward


def check_network(layers: Layers, activation: str) -> None:
    """
    Check that a network has fused kernels.

    Raises
    ------
    UnsupportedSystem
        It has none; says which have.

    """
    if activation != 'tanh' or len(layers.weights) < 3:
        raise UnsupportedSystem(
            f'a network with {len(layers.weights) - 1} layers of {activation} has no fused '
            'kernels: they are for tanh and two layers or more, beside the output; leave /fused '
            'out')
