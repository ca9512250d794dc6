# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Weights and biases of multilayer perceptrons."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np


class Layers(NamedTuple):
    """
    A multilayer perceptron, with one entry per layer.

    Parameters
    ----------
    weights : tuple of np.ndarray, each (outputs, inputs)
        Weights in float64.
    biases : tuple of np.ndarray, each (outputs,)
        Biases in float64.

    """

    weights: tuple[np.ndarray, ...]
    biases: tuple[np.ndarray, ...]

    @property
    def widths(self) -> list[int]:
        """Return the number of inputs and the number of outputs of each layer."""
        return [self.weights[0].shape[1], *map(len, self.weights)]

    def widened(self, inputs: int, places: Sequence[int]) -> 'Layers':
        """Return the network with this number of inputs; it uses the inputs at ``places``."""
        first, *others = self.weights
        wide = np.zeros((len(first), inputs))
        # Inputs at the same place have the same value.
        np.add.at(wide.T, [*places], first.T[:len(places)])
        return Layers((wide, *others), self.biases)


def widths_of(networks: Mapping[str, Layers]) -> dict[str, Any]:
    """Return the card's entry for the widths of networks, if any; a single one is not named."""
    widths = {name: layers.widths for name, layers in networks.items()}
    return {'widths': next(iter(widths.values()))} if len(widths) == 1 else {
        'networks': widths or None}
