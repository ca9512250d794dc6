# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
What a network sees of the coordinates: linear combinations y = F q, or their sine and cosine.

Each row of F gives one input y_k, or the two inputs (sin y_k, cos y_k) if it is periodic. Inputs
are padded with zeros to an even number n, since the loops of perceptron.py take two halves.
"""

from hnn_vi_ros.kernels.kernel import Parameters
from hnn_vi_ros.kernels.linking import part
from hnn_vi_ros.models.checkpoint import Layers
from hnn_vi_ros.models.mechanical_card import MechanicalCard
import numpy as np


def pack_features(card: MechanicalCard, features: list[list[float]]) -> Parameters:
    """
    Return the parameters of the functions here.

    Returns
    -------
    rows : np.ndarray, shape (k, d)
        F.
    periodic : np.ndarray of int, shape (k,)
        Whether a row is seen by its sine and cosine.
    space : np.ndarray, shape (4, n)
        For inputs, their change, and two cotangents.

    """
    rows = np.array(features, dtype=np.float64).reshape(len(features), len(card.kinds))
    periodic = np.array([card.is_periodic(row) for row in features], dtype=np.int64)
    return rows, periodic, np.zeros((4, _even(card.inputs(features))))


def even_layers(layers: Layers) -> Layers:
    """Return the same network with an even number of inputs, one of which may be of no effect."""
    first, *others = layers.weights
    missing = _even(first.shape[1]) - first.shape[1]
    return Layers((np.hstack([first, np.zeros((len(first), missing))]), *others), layers.biases)


def _even(n: int) -> int:
    return n + n % 2


def inputs_of(card: MechanicalCard, features: list[list[float]], q: np.ndarray
              ) -> tuple[np.ndarray, np.ndarray]:
    """Return the inputs (m, n) and their derivatives (m, n, d) at q of shape (m, d)."""
    q = q.astype(np.longdouble)
    n = card.inputs(features)
    x, slope = np.zeros((len(q), n), q.dtype), np.zeros((len(q), n, q.shape[1]), q.dtype)
    at = 0
    for row in features:
        y, direction = q @ np.array(row), np.array(row)
        if card.is_periodic(row):
            x[:, at], x[:, at + 1] = np.sin(y), np.cos(y)
            slope[:, at] = np.cos(y)[:, None] * direction
            slope[:, at + 1] = -np.sin(y)[:, None] * direction
            at += 2
        else:
            x[:, at], slope[:, at] = y, direction
            at += 1
    return x, slope


@part(error_model='numpy')
def see(seen: Parameters, q: np.ndarray) -> None:
    """Fill the inputs, the first row of the space, at one state."""
    rows, periodic, space = seen
    at = 0
    for k in range(periodic.size):
        y = 0.0
        for i in range(q.size):
            y += rows[k, i] * q[i]
        if periodic[k]:
            space[0, at], space[0, at + 1] = np.sin(y), np.cos(y)
            at += 2
        else:
            space[0, at] = y
            at += 1


@part(error_model='numpy')
def see_change(seen: Parameters, v_q: np.ndarray) -> None:
    """Fill the change of the inputs, the second row, along v_q; after ``see``."""
    rows, periodic, space = seen
    at = 0
    for k in range(periodic.size):
        change = 0.0
        for i in range(v_q.size):
            change += rows[k, i] * v_q[i]
        if periodic[k]:
            space[1, at], space[1, at + 1] = space[0, at + 1] * change, -space[0, at] * change
            at += 2
        else:
            space[1, at] = change
            at += 1


@part(error_model='numpy')
def add_covector(seen: Parameters, sign: float, row: int, covector: np.ndarray) -> None:
    """Add sign times what a cotangent of the inputs, that row of the space, is for q."""
    rows, periodic, space = seen
    at = 0
    for k in range(periodic.size):
        if periodic[k]:
            slope = space[row, at] * space[0, at + 1] - space[row, at + 1] * space[0, at]
            at += 2
        else:
            slope = space[row, at]
            at += 1
        for i in range(covector.size):
            covector[i] += sign * slope * rows[k, i]


@part(error_model='numpy')
def add_covector_change(seen: Parameters, sign: float, row: int, covector: np.ndarray) -> None:
    """Add sign times what that covector changes by with the inputs, at a held cotangent."""
    rows, periodic, space = seen
    at = 0
    for k in range(periodic.size):
        if periodic[k]:
            slope = space[row, at] * space[1, at + 1] - space[row, at + 1] * space[1, at]
            at += 2
            for i in range(covector.size):
                covector[i] += sign * slope * rows[k, i]
        else:
            at += 1
