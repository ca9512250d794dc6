# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Parts of all families: their interface, perceptrons in torch, and Newton's method."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

from hnn_vi_ros.learning.data.dataset import Dataset
from hnn_vi_ros.models import Layers
import numpy as np
import torch

# Steps end where they change unknowns by less than this share of their usual sizes: the error
# that is left is the square of it. The first steps take the matrix that the caller has, which
# costs a third of a step with a new one. Where friction jumps there are more steps than
# elsewhere, and some of them are halved.
ENOUGH = 1e-6
_CHEAP, _MOST = 2, 40


def newton(residual: Callable[[torch.Tensor], torch.Tensor], guess: torch.Tensor,
           matrix: torch.Tensor | None, unit: torch.Tensor, residual_unit: torch.Tensor,
           enough: float = ENOUGH) -> tuple[torch.Tensor, torch.Tensor]:
    """
    Return the roots of equations, shape (N, d), and their matrices, by Newton's method.

    Parameters
    ----------
    residual : callable
        Of shape (N, d), at unknowns of that shape, row by row.
    guess : torch.Tensor, shape (N, d)
        Where to begin.
    matrix : torch.Tensor, shape (N, d, d), optional
        About the derivative of the residual, for the first steps.
    unit, residual_unit : torch.Tensor, shape (d,)
        Usual sizes of the unknowns, and of the residual.
    enough : float
        Share of the unknowns' sizes below which a step is the last one. The matrices returned
        are those before that step, so derivatives that they make are off by about this share.

    Returns
    -------
    tuple of torch.Tensor
        Roots, NaN where none was found, and the derivatives of the residual at them.

    """
    best = w = guess
    least = torch.full(guess.shape[:1], torch.inf, dtype=guess.dtype)
    share, step = torch.ones_like(least), torch.zeros_like(guess)
    unrecorded = torch.no_grad()(residual)
    for k in range(_MOST):
        cheap = matrix is not None and k < _CHEAP
        value, slopes = (unrecorded(w), matrix) if cheap else _with_slopes(residual, w)
        size = (value / residual_unit).square().sum(dim=1)
        # Halve a step that makes the residual worse, or not a number.
        better = size < least
        least, share = torch.where(better, size, least), torch.where(better, 1.0, 0.5 * share)
        best = torch.where(better[:, None], w, best)
        step = torch.where(better[:, None], _solve(slopes, value), step)
        w = best - share[:, None] * step
        # This also ends where only rounding is left, and no step improves the residual.
        done = (step.abs() <= enough * unit).all(dim=1)
        if not cheap and done.all():
            break
    return torch.where(done[:, None], w, torch.nan), slopes


def _with_slopes(residual: Callable[[torch.Tensor], torch.Tensor], w: torch.Tensor
                 ) -> tuple[torch.Tensor, torch.Tensor]:
    """Return r, shape (N, d), and r_w, shape (N, d, d), by one backward pass for all rows."""
    with torch.enable_grad():
        w = w.detach().requires_grad_()
        value = residual(w)
        units = torch.eye(w.shape[1], dtype=w.dtype)[:, None, :].expand(-1, len(w), -1)
        (rows,) = torch.autograd.grad(value, w, units, is_grads_batched=True)
    return value.detach(), rows.transpose(0, 1)


def _solve(matrix: torch.Tensor, right: torch.Tensor) -> torch.Tensor:
    return torch.linalg.solve_ex(matrix, right[:, :, None])[0][:, :, 0]


def keep(module: torch.nn.Module, **constants: np.ndarray) -> None:
    """Give a module arrays as tensors that are neither trained nor saved."""
    for name, values in constants.items():
        module.register_buffer(name, torch.tensor(values), persistent=False)


class Layer(NamedTuple):
    """Activations a of a layer, (N, n), 1 - a^2, and the changes of its z, (m, N, n)."""

    a: torch.Tensor
    slope: torch.Tensor
    rates: torch.Tensor


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
    first : torch.Tensor, shape (outputs,), optional
        About the outputs at first, in units of E: they change little with x then.

    """

    def __init__(self, hidden: Sequence[int], centre: np.ndarray, scale: np.ndarray,
                 output_scale: np.ndarray, seed: int, first: torch.Tensor | None = None):
        super().__init__()
        self.widths = [len(centre), *hidden, len(output_scale)]
        keep(self, centre=centre, scale=scale, output_scale=output_scale)
        self.linears = torch.nn.ModuleList(
            # Without first values, which would be drawn from the generator that all share.
            torch.nn.utils.skip_init(torch.nn.Linear, inputs, outputs, dtype=torch.float64)
            for inputs, outputs in pairwise(self.widths))
        generator = torch.Generator().manual_seed(seed)
        for linear in self.linears:
            torch.nn.init.xavier_normal_(linear.weight, generator=generator)
            # Spread biases: with zero ones every unit is odd, a poor start for an energy.
            torch.nn.init.normal_(linear.bias, std=0.5, generator=generator)
        if first is not None:
            with torch.no_grad():
                # Not zero, where a square of the outputs would have no slope.
                linear.weight.mul_(0.1)
                linear.bias.copy_(first)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return f, shape (N, outputs), of points x, shape (N, inputs)."""
        a = (x - self.centre) / self.scale
        for linear in self.linears[:-1]:
            a = torch.tanh(linear(a))
        return self.output_scale * self.linears[-1](a)

    def hidden(self, x: torch.Tensor, tangents: torch.Tensor) -> list[Layer]:
        """Return the hidden layers at points (N, inputs), with changes along (m, N, inputs)."""
        a, tangents, layers = (x - self.centre) / self.scale, tangents / self.scale, list[Layer]()
        for linear in self.linears[:-1]:
            if layers:
                a, tangents = layers[-1].a, layers[-1].slope * layers[-1].rates
            a = torch.tanh(linear(a))
            layers.append(Layer(a, 1.0 - a.square(), tangents @ linear.weight.T))
        return layers

    def outputs(self, layers: Sequence[Layer]) -> tuple[torch.Tensor, torch.Tensor]:
        """Return f, (N, outputs), and its changes, (m, N, outputs), of these layers."""
        last = self.linears[-1]
        return (self.output_scale * last(layers[-1].a),
                self.output_scale * ((layers[-1].slope * layers[-1].rates) @ last.weight.T))

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

    def folded(self) -> tuple[list[torch.Tensor], list[torch.Tensor]]:
        """Return weights and biases of a plain tanh perceptron of x that is f."""
        weights, biases = ([getattr(linear, part) for linear in self.linears]
                           for part in ('weight', 'bias'))
        weights[0] = weights[0] / self.scale
        biases[0] = biases[0] - weights[0] @ self.centre
        weights[-1] = self.output_scale[:, None] * weights[-1]
        biases[-1] = self.output_scale * biases[-1]
        return weights, biases

    def layers(self, x0: np.ndarray | None = None, value: float = 0.0, factor: float = 1.0
               ) -> Layers:
        """
        Return a plain tanh perceptron of x that is f, times a factor, but for a constant.

        Parameters
        ----------
        x0 : np.ndarray, shape (inputs,), optional
            A point with a given value; without it f stays unchanged.
        value : float
            What all outputs shall be there.
        factor : float
            Of f.

        """
        weights, biases = ([part.detach().numpy().copy() for part in parts]
                           for parts in self.folded())
        weights[-1], biases[-1] = factor * weights[-1], factor * biases[-1]
        if x0 is not None:
            a = x0
            for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
                a = np.tanh(weight @ a + bias)
            biases[-1] = value - weights[-1] @ a
        return Layers(tuple(weights), tuple(biases))


@dataclass(frozen=True)
class Scales:
    """
    Scales of the data: where they lie and how fast they change, each array of shape (d,).

    Parameters
    ----------
    q_centre, p_centre, v_centre : np.ndarray
        Middle of the coordinates, momenta and velocities dq/dt.
    q_half, p_half, v_half : np.ndarray
        Half of the range of each.
    q_rate, p_rate : np.ndarray
        Root mean square of dq/dt and of dp/dt.
    command : np.ndarray, shape (m,)
        Root mean square of the commands, if there are any.

    """

    q_centre: np.ndarray
    p_centre: np.ndarray
    v_centre: np.ndarray
    q_half: np.ndarray
    p_half: np.ndarray
    v_half: np.ndarray
    q_rate: np.ndarray
    p_rate: np.ndarray
    command: np.ndarray

    @classmethod
    def of(cls, dataset: Dataset) -> 'Scales':
        """Return the scales of data."""
        parts = dataset.q, dataset.p, dataset.dq_dt
        centres = [0.5 * (part.min(axis=0) + part.max(axis=0)) for part in parts]
        halves = [0.5 * np.ptp(part, axis=0) for part in parts]
        commands = np.empty((1, 0)) if dataset.commands is None else dataset.commands
        # Data too large for their squares end in a loss that is not finite, which is reported.
        with np.errstate(over='ignore'):
            rates = [np.sqrt(np.mean(part**2, axis=0))
                     for part in (dataset.dq_dt, dataset.dp_dt, commands)]
        return cls(*centres, *halves, *rates)

    @property
    def centre(self) -> np.ndarray:
        """Return the middle of the states (q, p), shape (2 d,)."""
        return np.concatenate([self.q_centre, self.p_centre])

    @property
    def half(self) -> np.ndarray:
        """Return half of the ranges of the states (q, p), shape (2 d,)."""
        return np.concatenate([self.q_half, self.p_half])

    @property
    def energy(self) -> float:
        """Return by how much H changes over half a range: its scale."""
        return float(np.mean(np.concatenate(
            [self.q_rate * self.p_half, self.p_rate * self.q_half])))


class Trainable(torch.nn.Module, ABC):
    """A model to train; its losses call the methods below and a subclass's."""

    @abstractmethod
    def networks(self, z0: np.ndarray, energy0: float) -> dict[str, Layers]:
        """
        Return the networks for the model file, by the names of models.families.FAMILIES.

        Parameters
        ----------
        z0 : np.ndarray, shape (2 d,)
            The state (q, p) whose energy is given.
        energy0 : float
            H there, in the unit of H.

        """

    def preference(self, *inputs: torch.Tensor) -> torch.Tensor | None:
        """
        Return a term that a family adds to its loss, to choose where the data leave it open.

        Parameters
        ----------
        *inputs : torch.Tensor
            Of the loss.

        """
        return None

    def constants(self) -> dict[str, Any]:
        """Return further learned entries of the model card."""
        return {}

    def momenta(self, dataset: Dataset) -> np.ndarray:
        """Return the momenta of the data, shape (N, d), as this model defines them."""
        return dataset.p


class EnergyFamily(Trainable):
    """A family with an energy H(q, p), and Hamilton's equations for its field."""

    @abstractmethod
    def energy(self, z: torch.Tensor) -> torch.Tensor:
        """Return H, shape (N,), of states z = (q, p), shape (N, 2 d)."""

    def gradient(self, z: torch.Tensor) -> torch.Tensor:
        """Return (H_q, H_p), shape (N, 2 d), by automatic differentiation."""
        return gradient(self.energy, z)

    def vector_field(self, z: torch.Tensor, commands: torch.Tensor | None = None
                     ) -> torch.Tensor:
        """
        Return (dq/dt, dp/dt), shape (N, 2 d): (H_p, -H_q), with the terms of a family.

        Parameters
        ----------
        z : torch.Tensor, shape (N, 2 d)
            States (q, p).
        commands : torch.Tensor, shape (N, m), optional
            The commands there, without effect in most families.

        """
        dH_dq, dH_dp = self.gradient(z).chunk(2, dim=1)
        return torch.cat([dH_dp, -dH_dq], dim=1)


def gradient(function: Any, z: torch.Tensor) -> torch.Tensor:
    """Return the gradient of the rows' values by the rows, which can be differentiated again."""
    z = z if z.requires_grad else z.detach().requires_grad_(True)
    (result,) = torch.autograd.grad(function(z).sum(), z, create_graph=True)
    return result
