# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Networks as parts of a Hamiltonian, and those of several outputs, by the compiled loops for one.

A network y = Y a_K + b of k outputs is packed as the network w . a_K of one, whose last weights w
are set to c^T Y for the sum c . y of its outputs with any numbers c, its gradient included.
"""

from hnn_vi_ros.kernels.kernel import Parameters
from hnn_vi_ros.kernels.linking import part
from hnn_vi_ros.models.checkpoint import Checkpoint, Layers
from hnn_vi_ros.models.learned import padded
from hnn_vi_ros.networks import perceptron
from hnn_vi_ros.networks.perceptron_memory import pack
import numpy as np


def pack_outputs(checkpoint: Checkpoint, network: str, part: str = 'q') -> Parameters:
    """
    Return the parameters of the functions here: those of the loops, and Y and b.

    Parameters
    ----------
    checkpoint : Checkpoint
        Of the model.
    network : str
        The name of its network, with k outputs.
    part : str
        What it is a network of: ``'q'``, ``'p'`` or ``'both'``.

    """
    return pack_layers(padded(checkpoint.networks[network], part), checkpoint.card.activation)


def pack_layers(layers: Layers, activation: str) -> Parameters:
    """Return the same of a network of an even number of inputs."""
    weights, biases = layers
    one = np.zeros((1, weights[-1].shape[1]))
    packed = pack((*weights[:-1], one), (*biases[:-1], np.zeros(1)), activation)
    return packed, np.ascontiguousarray(weights[-1]), np.ascontiguousarray(biases[-1])


@part(error_model='numpy')
def part_gradient(network: Parameters, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
                  dH_dp: np.ndarray) -> None:
    """Fill the gradient of one network: a call, since inlining several compiles for long."""
    perceptron.gradient(network, q, p, dH_dq, dH_dp)


@part(error_model='numpy')
def evaluate_outputs(parameters: Parameters, q: np.ndarray, p: np.ndarray, y: np.ndarray) -> None:
    """Fill the outputs, shape (k,), at a state, q and p of shape (d,)."""
    network, last, bias = parameters
    perceptron.energy(network, q, p)
    sizes, nodes = network[0], network[3]
    for k in range(y.size):
        y[k] = bias[k]
        for i in range(last.shape[1]):
            y[k] += last[k, i] * nodes[0, sizes.size - 1, i]


@part(error_model='numpy')
def output_tangents(parameters: Parameters, y: np.ndarray) -> None:
    """Fill the change of the outputs along the direction of the last Hessian-vector product."""
    network, last, _ = parameters
    sizes, nodes = network[0], network[3]
    for k in range(y.size):
        y[k] = 0.0
        for i in range(last.shape[1]):
            y[k] += last[k, i] * nodes[0, 3 * sizes.size - 1, i]


@part(error_model='numpy')
def weigh(parameters: Parameters, c: np.ndarray) -> None:
    """Make the network of one output c . y."""
    network, last, _ = parameters
    sizes, rows = network[0], network[1]
    at = sizes[0] + sizes.size - 1
    for i in range(last.shape[1]):
        rows[at, i] = 0.0
        for k in range(c.size):
            rows[at, i] += c[k] * last[k, i]
