# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Networks of several outputs, as graphs, for compiled functions of effects."""

from hnn_vi_ros.kernels import part
from hnn_vi_ros.models.checkpoint import Checkpoint
from hnn_vi_ros.models.graphs.family_graphs import add_network, friction_entries
from hnn_vi_ros.models.graphs.graph import Builder
from hnn_vi_ros.models.graphs.machine import assembled, fill, GraphParameters
from hnn_vi_ros.models.graphs.tape import program
from hnn_vi_ros.models.networks.layers import Layers
import numpy as np


def pack_network(layers: Layers, activation: str) -> GraphParameters:
    """Return a network for fill_outputs."""
    b = Builder()
    x = b.input(layers.widths[0])
    return assembled(*program(b, [x], [add_network(b, layers, activation, x)]), 0)


def pack_friction(checkpoint: Checkpoint) -> GraphParameters:
    """Return the network of the entries of B, of one member after another; see fill_outputs."""
    b = Builder()
    q = b.input(len(checkpoint.card.coordinates))
    return assembled(*program(b, [q], [friction_entries(b, checkpoint, q)]), 0)


@part(error_model='numpy')
def fill_outputs(graph: GraphParameters, x: np.ndarray, outputs: np.ndarray) -> None:
    """Fill the outputs of a network of x."""
    for i in range(x.size):
        graph.memory[i] = x[i]
    fill(graph, 0, outputs)
