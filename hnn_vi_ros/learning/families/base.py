# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Shared parts of all families: interface, perceptrons in torch, Newton's method."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar, NamedTuple

from hnn_vi_ros.learning.data.dataset import Dataset
from hnn_vi_ros.models import Layers
import numpy as np
import torch

# Tolerance of a Newton step relative to the unknowns' usual sizes; the remaining error is its
# square. The first _CHEAP steps use the caller's matrix, at a third of the cost of a step with a
# new one. Discontinuous friction needs more steps, some of them halved.
ENOUGH = 1e-6
_CHEAP, _MOST = 2, 40


def newton(residual: Callable[[torch.Tensor], torch.Tensor], guess: torch.Tensor,
           matrix: torch.Tensor | None, unit: torch.Tensor, residual_unit: torch.Tensor,
           enough: float = ENOUGH) -> tuple[torch.Tensor, torch.Tensor]:
    """
    Solve equations with Newton's method; return the roots, shape (N, d), and their Jacobians.

    Parameters
    ----------
    residual : callable
        Function of unknowns, shape (N, d), that returns residuals of that shape, row by row.
    guess : torch.Tensor, shape (N, d)
        Initial values.
    matrix : torch.Tensor, shape (N, d, d), optional
        Approximate Jacobian of the residual for the first steps.
    unit, residual_unit : torch.Tensor, shape (d,)
        Usual sizes of the unknowns and of the residual.
    enough : float
        Relative step size below which a step is the last one. The returned Jacobians precede that
        step, so derivatives computed with them have about this relative error.

    Returns
    -------
    tuple of torch.Tensor
        Roots, NaN for rows without convergence, and the Jacobians of the residual there.

    """
    best = w = guess
    least = guess.new_full(guess.shape[:1], torch.inf)
    share, step = torch.ones_like(least), torch.zeros_like(guess)
    unrecorded = torch.no_grad()(residual)
    for k in range(_MOST):
        cheap = matrix is not None and k < _CHEAP
        value, slopes = (unrecorded(w), matrix) if cheap else _with_slopes(residual, w)
        size = (value / residual_unit).square().sum(dim=1)
        # Halve a step that increases the residual or makes it NaN.
        better = size < least
        least, share = torch.where(better, size, least), torch.where(better, 1.0, 0.5 * share)
        best = torch.where(better[:, None], w, best)
        step = torch.where(better[:, None], _solve(slopes, value), step)
        w = best - share[:, None] * step
        # This criterion also stops when only rounding is left and no step reduces the residual.
        done = (step.abs() <= enough * unit).all(dim=1)
        if not cheap and done.all():
            break
    return torch.where(done[:, None], w, torch.nan), slopes


def _with_slopes(residual: Callable[[torch.Tensor], torch.Tensor], w: torch.Tensor
                 ) -> tuple[torch.Tensor, torch.Tensor]:
    """Return r, shape (N, d), and r_w, shape (N, d, d), from one backward pass for all rows."""
    with torch.enable_grad():
        w = w.detach().requires_grad_()
        value = residual(w)
        units = torch.eye(w.shape[1]).to(w)[:, None, :].expand(-1, len(w), -1)
        (rows,) = torch.autograd.grad(value, w, units, is_grads_batched=True)
    return value.detach(), rows.transpose(0, 1)


def _solve(matrix: torch.Tensor, right: torch.Tensor) -> torch.Tensor:
    return torch.linalg.solve_ex(matrix, right[:, :, None])[0][:, :, 0]


def keep(module: torch.nn.Module, **constants: np.ndarray) -> None:
    """Register arrays as buffers of a module, neither trained nor saved."""
    for name, values in constants.items():
        module.register_buffer(name, torch.tensor(values), persistent=False)


class Layer(NamedTuple):
    """Activations a of a layer, (N, n), 1 - a^2, and tangents of its z, (m, N, n)."""

    a: torch.Tensor
    slope: torch.Tensor
    rates: torch.Tensor


class Perceptron(torch.nn.Module):
    """
    f(x) = E MLP((x - c) / s), in float64.

    The centre c, the scale s and the output scale E make the inputs and the slope of the
    perceptron of order one; they are constants, and ``layers`` folds them into the weights.

    Parameters
    ----------
    hidden : sequence of int
        Widths of the hidden layers.
    centre, scale : np.ndarray, shape (inputs,)
        Constants c and s, in the units of x.
    output_scale : np.ndarray, shape (outputs,)
        Constant E, in the units of f.
    seed : int
        Seed of the initial weights.
    first : torch.Tensor, shape (outputs,), optional
        Approximate initial outputs, in units of E; they initially change little with x.

    """

    def __init__(self, hidden: Sequence[int], centre: np.ndarray, scale: np.ndarray,
                 output_scale: np.ndarray, seed: int, first: torch.Tensor | None = None):
        super().__init__()
        self.widths = [len(centre), *hidden, len(output_scale)]
        keep(self, centre=centre, scale=scale, output_scale=output_scale)
        self.linears = torch.nn.ModuleList(
            # skip_init avoids default values, which would advance the global random generator.
            torch.nn.utils.skip_init(torch.nn.Linear, inputs, outputs, dtype=torch.float64)
            for inputs, outputs in pairwise(self.widths))
        generator = torch.Generator().manual_seed(seed)
        for linear in self.linears:
            torch.nn.init.xavier_normal_(linear.weight, generator=generator)
            # Random biases: with zero biases every unit is odd, a poor start for an energy.
            torch.nn.init.normal_(linear.bias, std=0.5, generator=generator)
        if first is not None:
            with torch.no_grad():
                # Not zero: the gradient of a squared output would vanish.
                linear.weight.mul_(0.1)
                linear.bias.copy_(first)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return f, shape (N, outputs), at points x, shape (N, inputs)."""
        a = (x - self.centre) / self.scale
        for linear in self.linears[:-1]:
            a = torch.tanh(linear(a))
        return self.output_scale * self.linears[-1](a)

    def hidden(self, x: torch.Tensor, tangents: torch.Tensor) -> list[Layer]:
        """Return the hidden layers at points (N, inputs), with tangents along (m, N, inputs)."""
        a, tangents, layers = (x - self.centre) / self.scale, tangents / self.scale, list[Layer]()
        for linear in self.linears[:-1]:
            if layers:
                a, tangents = layers[-1].a, layers[-1].slope * layers[-1].rates
            a = torch.tanh(linear(a))
            layers.append(Layer(a, 1.0 - a.square(), tangents @ linear.weight.T))
        return layers

    def outputs(self, layers: Sequence[Layer]) -> tuple[torch.Tensor, torch.Tensor]:
        """Return f, (N, outputs), and its tangents, (m, N, outputs), from these layers."""
        last = self.linears[-1]
        return (self.output_scale * last(layers[-1].a),
                self.output_scale * ((layers[-1].slope * layers[-1].rates) @ last.weight.T))

    def gradient(self, x: torch.Tensor, weights: torch.Tensor | None = None) -> torch.Tensor:
        """
        Return the gradient of a weighted sum of outputs, shape (N, inputs), in one backward pass.

        Parameters
        ----------
        x : torch.Tensor, shape (N, inputs)
            Points x.
        weights : torch.Tensor, shape (N, outputs), optional
            Weights of the outputs in the sum; default 1, for networks with one output.

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
        """Return weights and biases of a plain tanh perceptron that computes f from x."""
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
        Return a plain tanh perceptron that computes a multiple of f plus a constant from x.

        Parameters
        ----------
        x0 : np.ndarray, shape (inputs,), optional
            Point at which the value is given; without it, the constant is zero.
        value : float
            Value of all outputs at x0.
        factor : float
            Factor of f.

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
    Scales of the data: location and speed, each array of shape (d,).

    Parameters
    ----------
    q_centre, p_centre, v_centre : np.ndarray
        Centres of the coordinates, momenta and velocities dq/dt.
    q_half, p_half, v_half : np.ndarray
        Half-ranges of the same.
    q_rate, p_rate : np.ndarray
        Root mean squares of dq/dt and dp/dt.
    command : np.ndarray, shape (m,)
        Root mean square of the commands, if any.

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
        """Return the scales of a dataset."""
        parts = dataset.q, dataset.p, dataset.dq_dt
        centres = [0.5 * (part.min(axis=0) + part.max(axis=0)) for part in parts]
        halves = [0.5 * np.ptp(part, axis=0) for part in parts]
        commands = np.empty((1, 0)) if dataset.commands is None else dataset.commands
        # Overflow of squares is ignored: such data lead to a non-finite loss, which is reported.
        with np.errstate(over='ignore'):
            rates = [np.sqrt(np.mean(part**2, axis=0))
                     for part in (dataset.dq_dt, dataset.dp_dt, commands)]
        return cls(*centres, *halves, *rates)

    @property
    def centre(self) -> np.ndarray:
        """Return the centre of the states (q, p), shape (2 d,)."""
        return np.concatenate([self.q_centre, self.p_centre])

    @property
    def half(self) -> np.ndarray:
        """Return the half-ranges of the states (q, p), shape (2 d,)."""
        return np.concatenate([self.q_half, self.p_half])

    @property
    def energy(self) -> float:
        """Return the energy scale: the change of H over half a range."""
        return float(np.mean(np.concatenate(
            [self.q_rate * self.p_half, self.p_rate * self.q_half])))


class Trainable(torch.nn.Module, ABC):
    """
    A trainable model; losses call the methods below and methods of subclasses.

    Attributes
    ----------
    schema : type
        Schema of its configuration.

    """

    schema: ClassVar[type]

    def networks(self, z0: np.ndarray, energy0: float) -> dict[str, Layers]:
        """
        Return the networks for the model file, keyed as in models.families.FAMILIES.

        There are none if H is stored as a graph, traced from ``energy``.

        Parameters
        ----------
        z0 : np.ndarray, shape (2 d,)
            State (q, p) of given energy.
        energy0 : float
            Value of H there, in the unit of H.

        """
        return {}

    def preference(self, *inputs: torch.Tensor) -> torch.Tensor | None:
        """
        Return a penalty that a family adds to its loss to fix what the data leave free, or None.

        Parameters
        ----------
        *inputs : torch.Tensor
            Inputs of the loss.

        """
        return None

    def misfit(self, states: torch.Tensor, predicted: torch.Tensor, target: torch.Tensor,
               unit: torch.Tensor) -> torch.Tensor:
        """
        Return the loss of predictions, without penalties.

        Parameters
        ----------
        states : torch.Tensor
            First input of the prediction.
        predicted, target : torch.Tensor, shape (N, k)
            Predictions and data.
        unit : torch.Tensor, shape (k,)
            Unit of each column, the root mean square of the target.

        """
        return ((predicted - target) / unit).square().mean()

    def constants(self) -> dict[str, Any]:
        """Return additional learned entries of the model card."""
        return {}

    def momenta(self, dataset: Dataset) -> np.ndarray:
        """Return the momenta of the data as this model defines them, shape (N, d)."""
        return dataset.p


class EnergyFamily(Trainable):
    """A family with an energy H(q, p) and the field of Hamilton's equations."""

    @property
    def name(self) -> str:
        """Return its name in messages."""
        return type(self).__name__

    @abstractmethod
    def energy(self, z: torch.Tensor) -> torch.Tensor:
        """Return H, shape (N,), at states z = (q, p), shape (N, 2 d)."""

    def gradient(self, z: torch.Tensor) -> torch.Tensor:
        """Return (H_q, H_p), shape (N, 2 d), by automatic differentiation."""
        return gradient(self.energy, z)

    def vector_field(self, z: torch.Tensor, commands: torch.Tensor | None = None) -> torch.Tensor:
        """
        Return (dq/dt, dp/dt), shape (N, 2 d): (H_p, -H_q) plus terms of the family.

        Parameters
        ----------
        z : torch.Tensor, shape (N, 2 d)
            States (q, p).
        commands : torch.Tensor, shape (N, m), optional
            Commands at the states; ignored by most families.

        """
        dH_dq, dH_dp = self.gradient(z).chunk(2, dim=1)
        return torch.cat([dH_dp, -dH_dq], dim=1)


class ShiftedEnergy(torch.nn.Module):
    """H of a family, with the value energy0 at z0."""

    def __init__(self, family: EnergyFamily, z0: np.ndarray, energy0: float):
        super().__init__()
        self.family = family
        self.shift = energy0 - float(family.energy(torch.tensor(z0)[None]).detach())

    def forward(self, z: torch.Tensor) -> torch.Tensor:
        """Return H, shape (n,), at states z, shape (n, 2 d)."""
        return self.family.energy(z) + self.shift


def gradient(function: Any, z: torch.Tensor) -> torch.Tensor:
    """Return the gradient of the rows' values by the rows, differentiable again if recorded."""
    recorded = torch.is_grad_enabled()
    with torch.enable_grad():
        z = z if recorded and z.requires_grad else z.detach().requires_grad_(True)
        (result,) = torch.autograd.grad(function(z).sum(), z, create_graph=recorded)
    return result
