# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The networks of model files as torch modules."""

from hnn_vi_ros.models.networks.layers import Layers
import torch

_ACTIVATIONS = {
    'tanh': torch.tanh, 'sine': torch.sin, 'relu': torch.relu,
    # torch.nn.functional.softplus has a cut-off error of 2e-9.
    'softplus': lambda z: torch.logaddexp(z, torch.zeros_like(z))}


class Network(torch.nn.Module):
    """
    A network of a model file: N(x), shape (..., outputs), of inputs x, shape (..., inputs).

    Its parameters have the names of a file with one network: ``linear1.weight``.

    Parameters
    ----------
    layers : Layers
        The network.
    activation : str
        Activation between its layers.

    """

    def __init__(self, layers: Layers, activation: str):
        super().__init__()
        self._activation = _ACTIVATIONS[activation]
        for k, (weight, bias) in enumerate(zip(*layers, strict=True), start=1):
            linear = torch.nn.utils.skip_init(
                torch.nn.Linear, *weight.shape[::-1], dtype=torch.float64)
            linear.load_state_dict({'weight': torch.tensor(weight), 'bias': torch.tensor(bias)})
            self.add_module(f'linear{k}', linear)
        self.requires_grad_(False)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return N(x)."""
        *hidden, last = self.children()
        for linear in hidden:
            x = self._activation(linear(x))
        return last(x)
