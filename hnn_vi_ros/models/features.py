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
    inputs, change : np.ndarray, shape (n,)
        Workspace for the inputs of the network, and their change.
    cotangent, cotangent_change : np.ndarray, shape (n,)
        Workspace for a derivative by the inputs, and its change.

    """

    rows: np.ndarray
    periodic: np.ndarray
    starts: np.ndarray
    inputs: np.ndarray
    change: np.ndarray
    cotangent: np.ndarray
    cotangent_change: np.ndarray


def pack_features(card: MechanicalCard, features: list[list[float]]) -> Features:
    """Return the features of a network for the functions here, with their own workspace."""
    rows = np.array(features, dtype=np.float64).reshape(len(features), len(card.kinds))
    periodic = np.array([is_periodic(card.kinds, row) for row in features], dtype=np.int64)
    starts = np.cumsum(1 + periodic) - 1 - periodic
    return Features(rows, periodic, starts, *np.zeros((4, _even(card.input_count(features)))))


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


@part(error_model='numpy')
def see_change(seen: Features, v_q: np.ndarray) -> None:
    """Fill the change of the inputs along v_q; call ``see`` first."""
    rows, periodic, inputs, x_v = seen.rows, seen.periodic, seen.inputs, seen.change
    for k in range(periodic.size):
        change, at = 0.0, seen.starts[k]
        for i in range(v_q.size):
            change += rows[k, i] * v_q[i]
        if periodic[k]:
            x_v[at], x_v[at + 1] = inputs[at + 1] * change, -inputs[at] * change
        else:
            x_v[at] = change


@part(error_model='numpy')
def add_covector(seen: Features, sign: float, cotangent: np.ndarray, covector: np.ndarray
                 ) -> None:
    """Add sign times the derivative by q that follows from a derivative by the inputs."""
    rows, periodic, inputs = seen.rows, seen.periodic, seen.inputs
    for k in range(periodic.size):
        at = seen.starts[k]
        slope = cotangent[at]
        if periodic[k]:
            slope = cotangent[at] * inputs[at + 1] - cotangent[at + 1] * inputs[at]
        for i in range(covector.size):
            covector[i] += sign * slope * rows[k, i]


@part(error_model='numpy')
def add_covector_change(seen: Features, sign: float, covector: np.ndarray) -> None:
    """Add sign times the change of that derivative with the inputs, at constant cotangent."""
    rows, periodic = seen.rows, seen.periodic
    cotangent, change = seen.cotangent, seen.change
    for k in range(periodic.size):
        if periodic[k]:
            at = seen.starts[k]
            slope = cotangent[at] * change[at + 1] - cotangent[at + 1] * change[at]
            for i in range(covector.size):
                covector[i] += sign * slope * rows[k, i]
