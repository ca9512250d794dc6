# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The network that is trained: a tanh multilayer perceptron in torch, its scales made one."""

from collections.abc import Sequence
from itertools import pairwise

from hnn_vi_ros.models.checkpoint import Layers
import numpy as np
import torch


class Perceptron(torch.nn.Module):
    """
    f(x) = E MLP((x - c) / s), in float64.

    The centre c, the scale s and the scale E of the outputs make the inputs and the slope of the
    perceptron of order one; they are constants, and ``layers`` folds them into the weights.

    Parameters
    ----------
    hidden : sequence of int
        Widths of the hidden layers.
    centre, scale : np.ndarray, shape (inputs,)
        c and s, in the units of x.
    output_scale : np.ndarray, shape (outputs,)
        E, in the units of f.
    seed : int
        Of the initial weights.

    """

    def __init__(self, hidden: Sequence[int], centre: np.ndarray, scale: np.ndarray,
                 output_scale: np.ndarray, seed: int):
        super().__init__()
        self.widths = [len(centre), *hidden, len(output_scale)]
        for name, values in (('centre', centre), ('scale', scale), ('output_scale', output_scale)):
            self.register_buffer(name, torch.tensor(values), persistent=False)
        self.linears = torch.nn.ModuleList(
            torch.nn.Linear(inputs, outputs, dtype=torch.float64)
            for inputs, outputs in pairwise(self.widths))
        generator = torch.Generator().manual_seed(seed)
        for linear in self.linears:
            torch.nn.init.xavier_normal_(linear.weight, generator=generator)
            # Spread biases: with zero ones every unit is odd, a poor start for an energy.
            torch.nn.init.normal_(linear.bias, std=0.5, generator=generator)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return f, shape (N, outputs), of points x, shape (N, inputs)."""
        a = (x - self.centre) / self.scale
        for linear in self.linears[:-1]:
            a = torch.tanh(linear(a))
        return self.output_scale * self.linears[-1](a)

    def slope(self, x: torch.Tensor) -> torch.Tensor:
        """Return the derivatives of f, shape (N, outputs, inputs), at points of (N, inputs)."""
        a = (x - self.centre) / self.scale
        tangent = torch.diag(1.0 / self.scale)
        for linear in self.linears[:-1]:
            a = torch.tanh(linear(a))
            tangent = (1.0 - a.square())[:, :, None] * (linear.weight @ tangent)
        return self.output_scale[:, None] * (self.linears[-1].weight @ tangent)

    def gradient(self, x: torch.Tensor, weights: torch.Tensor | None = None) -> torch.Tensor:
        """
        Return the gradient of a sum of the outputs, shape (N, inputs), by one backward pass.

        Parameters
        ----------
        x : torch.Tensor, shape (N, inputs)
            Points.
        weights : torch.Tensor, shape (N, outputs), optional
            Of the outputs in the sum; none for the one output of a network.

        """
        a, activations = (x - self.centre) / self.scale, []
        *hidden, last = self.linears
        for linear in hidden:
            a = torch.tanh(linear(a))
            activations.append(a)
        g = self.output_scale * last.weight if weights is None else \
            (weights * self.output_scale) @ last.weight
        for linear, a in zip(hidden[::-1], activations[::-1], strict=True):
            g = (g * (1.0 - a.square())) @ linear.weight
        return g / self.scale

    def layers(self, x0: np.ndarray | None = None, value: float = 0.0) -> Layers:
        """
        Return a plain tanh perceptron of x that is f, or differs from it by a constant.

        Parameters
        ----------
        x0 : np.ndarray, shape (inputs,), optional
            A point with a given value; without it f stays unchanged.
        value : float
            What all outputs shall be there.

        """
        weights = [linear.weight.detach().numpy().copy() for linear in self.linears]
        biases = [linear.bias.detach().numpy().copy() for linear in self.linears]
        weights[0] /= self.scale.numpy()
        biases[0] -= weights[0] @ self.centre.numpy()
        scale = self.output_scale.numpy()
        weights[-1] *= scale[:, None]
        biases[-1] *= scale
        if x0 is not None:
            a = x0
            for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
                a = np.tanh(weight @ a + bias)
            biases[-1] = value - weights[-1] @ a
        return Layers(tuple(weights), tuple(biases))
