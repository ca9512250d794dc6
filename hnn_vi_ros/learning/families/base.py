# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Interface of a family to the training loop and to the model file."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

from hnn_vi_ros.learning.data.dataset import Dataset
from hnn_vi_ros.models.checkpoint import Layers
import numpy as np
import torch


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
