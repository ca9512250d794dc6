# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Networks of several outputs as parts of a Hamiltonian, using the loops for one output.

A network y = Y a_K + b of k outputs is packed as the network w . a_K of one output, whose last
weights w are set to c^T Y for a weighted sum c . y of its outputs, including its gradient.
"""

from typing import NamedTuple

from hnn_vi_ros.kernels import part
from hnn_vi_ros.models.checkpoint import Checkpoint
from hnn_vi_ros.models.learned import padded
from hnn_vi_ros.models.networks import perceptron
from hnn_vi_ros.models.networks.layers import Layers
from hnn_vi_ros.models.networks.perceptron_memory import pack, PackedPerceptron
import numpy as np


class PackedOutputs(NamedTuple):
    """
    Parameters of the functions here, their first argument: a network of k outputs.

    Parameters
    ----------
    network : PackedPerceptron
        Network of one output, w . a_K; see ``weigh``.
    last : np.ndarray, shape (k, n)
        Y.
    bias : np.ndarray, shape (k,)
        b.

    """

    network: PackedPerceptron
    last: np.ndarray
    bias: np.ndarray


def pack_outputs(checkpoint: Checkpoint, network: str, part: str = 'q') -> PackedOutputs:
    """
    Return a network of several outputs for the functions here.

    Parameters
    ----------
    checkpoint : Checkpoint
        A model.
    network : str
        Name of its network, with k outputs.
    part : str
        Its arguments: ``'q'``, ``'p'`` or ``'both'``.

    """
    return pack_layers(padded(checkpoint.networks[network], part), checkpoint.card.activation)


def pack_layers(layers: Layers, activation: str) -> PackedOutputs:
    """Return a network with an even number of inputs for the functions here."""
    weights, biases = layers
    one = np.zeros((1, weights[-1].shape[1]))
    packed = pack((*weights[:-1], one), (*biases[:-1], np.zeros(1)), activation)
    return PackedOutputs(packed, np.ascontiguousarray(weights[-1]),
                         np.ascontiguousarray(biases[-1]))


@part(error_model='numpy')
def part_gradient(network: PackedPerceptron, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
                  dH_dp: np.ndarray) -> None:
    """Fill the gradient of one network; not inlined, because inlining several compiles slowly."""
    perceptron.gradient(network, q, p, dH_dq, dH_dp)


@part(error_model='numpy')
def evaluate_outputs(outputs: PackedOutputs, q: np.ndarray, p: np.ndarray, y: np.ndarray) -> None:
    """Fill the outputs, shape (k,), at a state, q and p of shape (d,)."""
    last, bias = outputs.last, outputs.bias
    perceptron.energy(outputs.network, q, p)
    sizes, nodes = outputs.network.sizes, outputs.network.nodes
    for k in range(y.size):
        y[k] = bias[k]
        for i in range(last.shape[1]):
            y[k] += last[k, i] * nodes[0, sizes.size - 1, i]


@part(error_model='numpy')
def weigh(outputs: PackedOutputs, c: np.ndarray) -> None:
    """Set the weights of the network of one output c . y."""
    last = outputs.last
    sizes, rows = outputs.network.sizes, outputs.network.rows
    at = sizes[0] + sizes.size - 1
    for i in range(last.shape[1]):
        rows[at, i] = 0.0
        for k in range(c.size):
            rows[at, i] += c[k] * last[k, i]
