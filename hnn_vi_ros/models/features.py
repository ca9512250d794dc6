# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Features of the coordinates: linear combinations y = F q, or their sine and cosine.

Each row of F gives one input y_k, or two inputs (sin y_k, cos y_k) if it is periodic. Inputs are
padded with zeros to an even number n, because the loops of perceptron.py use two halves.
"""

from typing import NamedTuple

from hnn_vi_ros.kernels import part
from hnn_vi_ros.models.mechanical_card import is_periodic, MechanicalCard
from hnn_vi_ros.models.networks.layers import Layers
import numpy as np


class Features(NamedTuple):
    """
    Parameters of the functions here, their first argument.

    Parameters
    ----------
    rows : np.ndarray, shape (k, d)
        F.
    periodic : np.ndarray of int, shape (k,)
        1 if the network uses the sine and cosine of a row.
    starts : np.ndarray of int, shape (k,)
        Index of the first input of each row.
    inputs : np.ndarray, shape (n,)
        Workspace for the inputs of the network.

    """

    rows: np.ndarray
    periodic: np.ndarray
    starts: np.ndarray
    inputs: np.ndarray


def pack_features(card: MechanicalCard, features: list[list[float]]) -> Features:
    """Return the features of a network for the functions here, with their own workspace."""
    rows = np.array(features, dtype=np.float64).reshape(len(features), len(card.kinds))
    periodic = np.array([is_periodic(card.kinds, row) for row in features], dtype=np.int64)
    starts = np.cumsum(1 + periodic) - 1 - periodic
    return Features(rows, periodic, starts, np.zeros(_even(card.input_count(features))))


def even_layers(layers: Layers) -> Layers:
    """Return the same network with an even number of inputs, the last one possibly unused."""
    inputs = layers.widths[0]
    return layers.widened(_even(inputs), range(inputs))


def _even(n: int) -> int:
    return n + n % 2


@part(error_model='numpy')
def see(seen: Features, q: np.ndarray) -> None:
    """Fill the inputs at one state."""
    rows, periodic, inputs = seen.rows, seen.periodic, seen.inputs
    for k in range(periodic.size):
        y, at = 0.0, seen.starts[k]
        for i in range(q.size):
            y += rows[k, i] * q[i]
        if periodic[k]:
            inputs[at], inputs[at + 1] = np.sin(y), np.cos(y)
        else:
            inputs[at] = y
