# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Losses of training: the difference between a model and the data."""

from collections.abc import Callable
from typing import Any, NamedTuple

from hnn_vi_ros.learning.data.dataset import Dataset
from hnn_vi_ros.learning.families.base import Trainable
from hnn_vi_ros.learning.fit.steps import step
import numpy as np
import torch


class Batch(NamedTuple):
    """
    Data as a loss takes them.

    Parameters
    ----------
    inputs : tuple of torch.Tensor
        What a prediction is made from, N rows each.
    target : torch.Tensor, shape (N, k)
        What is to be predicted: rates of change, or accelerations.

    """

    inputs: tuple[torch.Tensor, ...]
    target: torch.Tensor

    def to(self, device: str) -> 'Batch':
        """Return the same on another device."""
        return Batch(tuple(part.to(device) for part in self.inputs), self.target.to(device))


class Loss(NamedTuple):
    """
    A loss: the mean square of what a family predicts, less the target, in units of the target.

    Parameters
    ----------
    batch : callable
        ``batch(choice, dataset)`` returns a Batch.
    predict : callable
        ``predict(choice, family, *inputs)`` returns a tensor of the shape of the target.
    parts : tuple of str
        Names of the equal parts of a row.

    """

    batch: Callable[[Any, Dataset], Batch]
    predict: Callable[..., torch.Tensor]
    parts: tuple[str, ...]


def mean_square(errors: torch.Tensor, unit: torch.Tensor) -> torch.Tensor:
    """Return the mean square of errors, shape (N, k), in units of shape (k,)."""
    return (errors / unit).square().mean()


def nonlinearity(family: Trainable, z1: torch.Tensor, z2: torch.Tensor, unit: torch.Tensor
                 ) -> torch.Tensor:
    """
    Return how far the field between pairs of states is from linear, mean squared.

    It compares the field in the middle of each pair with the mean of the fields at its ends.
    Added with a small weight to the loss, it makes H plain where no data says otherwise: a
    single orbit leaves the energy inside it free.

    Parameters
    ----------
    family : Trainable
        With a vector field.
    z1, z2 : torch.Tensor, shape (N, 2 d)
        The states of each pair.
    unit : torch.Tensor, shape (2 d,)
        What each component's error is measured in.

    """
    ends = 0.5 * (family.vector_field(z1) + family.vector_field(z2))
    return mean_square(family.vector_field(0.5 * (z1 + z2)) - ends, unit)


def _rates(choice: Any, dataset: Dataset) -> Batch:
    z, rates = _joined(dataset.q, dataset.p), _joined(dataset.dq_dt, dataset.dp_dt)
    if dataset.commands is None:
        return Batch((z,), rates)
    return Batch((z, torch.tensor(dataset.commands)), rates)


def _field(choice: Any, family: Trainable, *inputs: torch.Tensor) -> torch.Tensor:
    return family.vector_field(*inputs)


def _paths(choice: Any, dataset: Dataset) -> Batch:
    """Return the first states, and the mean rates from there until each of the next ones."""
    windows = dataset.windows(choice.step_size, choice.count + 1)
    path = _joined(dataset.q[windows], dataset.p[windows])
    return Batch((path[:, 0],), torch.cat([
        (path[:, k] - path[:, 0]) / (k * choice.step_size) for k in range(1, choice.count + 1)]))


def _mean_rates(choice: Any, family: Trainable, z0: torch.Tensor) -> torch.Tensor:
    z, rates = z0, []
    for k in range(1, choice.count + 1):
        z = step(family.vector_field, choice.integrator, z, choice.step_size)
        rates.append((z - z0) / (k * choice.step_size))
    return torch.cat(rates)


def _pairs(choice: Any, dataset: Dataset) -> Batch:
    windows = dataset.windows(choice.step_size, 2)
    z0, z1 = _joined(dataset.q[windows], dataset.p[windows]).unbind(dim=1)
    return Batch((z0, z1), (z1 - z0) / choice.step_size)


def _discrete_field(choice: Any, family: Trainable, *inputs: torch.Tensor) -> torch.Tensor:
    return family.discrete_field(*inputs)


def _positions(choice: Any, dataset: Dataset) -> Batch:
    """Return three positions in a row each, and their second differences."""
    windows = dataset.windows(choice.step_size, 3)
    q0, q1, q2 = torch.tensor(dataset.q[windows]).unbind(dim=1)
    return Batch((q0, q1, q2), (q2 - 2.0 * q1 + q0) / choice.step_size**2)


def _discrete_euler_lagrange(choice: Any, family: Trainable, q0: torch.Tensor, q1: torch.Tensor,
                             q2: torch.Tensor) -> torch.Tensor:
    """
    Return what D_1 L_d(q1, q2) + D_2 L_d(q0, q1) = 0 makes of the second difference.

    With L = v . M v / 2 - V(q) it is -M^-1 V'(q1) by the trapezoid rule, and the mean of
    -M^-1 V' at the two midpoints by the midpoint rule.
    """
    if choice.rule == 'trapezoid':
        return family.acceleration(q1)
    before, after = family.acceleration(0.5 * (q0 + q1)), family.acceleration(0.5 * (q1 + q2))
    return 0.5 * (before + after)


def _velocities(choice: Any, dataset: Dataset) -> Batch:
    return Batch((_joined(dataset.q, dataset.dq_dt),), torch.tensor(dataset.accelerations))


def _acceleration(choice: Any, family: Trainable, *inputs: torch.Tensor) -> torch.Tensor:
    return family.acceleration(*inputs)


def _joined(*parts: np.ndarray) -> torch.Tensor:
    return torch.tensor(np.concatenate(parts, axis=-1))


LOSSES = {
    'vector_field': Loss(_rates, _field, ('dq_dt', 'dp_dt')),
    'steps': Loss(_paths, _mean_rates, ('dq_dt', 'dp_dt')),
    'discrete_gradient': Loss(_pairs, _discrete_field, ('dq_dt', 'dp_dt')),
    'discrete_lagrangian': Loss(_positions, _discrete_euler_lagrange, ('acceleration',)),
    'euler_lagrange': Loss(_velocities, _acceleration, ('acceleration',)),
}
