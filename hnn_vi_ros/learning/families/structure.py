# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Structure of a network of a machine: its features, and the scales of its motions."""

from collections.abc import Sequence
from dataclasses import dataclass
import math

from hnn_vi_ros.models.mechanical_card import is_periodic, Kind
from hnn_vi_ros.models.rigid_body_card import TreeCard
import numpy as np
import torch


@dataclass(frozen=True)
class Structure:
    """
    Structure of the networks: what they see, and what friction there is.

    Parameters
    ----------
    kinds : list of str
        Of each coordinate.
    features : list of list of float
        Rows of the linear combinations that V sees.
    mass_features : list of list of float
        The same that M sees; none for a constant M.
    diagonal_mass : bool
        Whether M is diagonal.
    viscous : bool
        Whether there is friction -b v.
    coulomb, stribeck : int
        How many terms -c tanh(v / w), and how many that end with speed.
    prior : str, optional
        The parametric system to whose M and V the networks are added.
    residual : bool
        Whether there are networks in addition to it.
    friction_features : list of list of float, optional
        The inputs of the network D of friction -D(q) v, in the same way; None for no network.
    tree : TreeCard, optional
        The bodies of a prior that is a robot.
    values : np.ndarray, shape (d, 12), optional
        Their parameters to begin with.
    left_out : tuple of str
        Which of the networks, ``mass`` and ``potential``, add nothing.

    """

    kinds: list[Kind]
    features: list[list[float]]
    mass_features: list[list[float]]
    diagonal_mass: bool = False
    viscous: bool = True
    coulomb: int = 2
    stribeck: int = 0
    prior: str | None = None
    residual: bool = True
    friction_features: list[list[float]] | None = None
    tree: TreeCard | None = None
    values: np.ndarray | None = None
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True)
class MotionScales:
    """
    Scales of the data, each array of shape (d,) unless stated otherwise.

    Parameters
    ----------
    q_centre, q_half : np.ndarray
        Middle and half of the range of the coordinates.
    v, a : np.ndarray
        Root mean square of velocities and accelerations.
    inertia : np.ndarray
        Force per acceleration.
    command : np.ndarray, shape (m,)
        Usual size of what each motor is commanded.
    input_map : np.ndarray, shape (d, m), or None
        About what forces on the joints the motors make of it, to learn that from; None where
        each joint has a motor of its own.

    """

    q_centre: np.ndarray
    q_half: np.ndarray
    v: np.ndarray
    a: np.ndarray
    inertia: np.ndarray
    command: np.ndarray
    input_map: np.ndarray | None = None


class Features(torch.nn.Module):
    """
    The inputs G q, or sin(G q) and cos(G q) for rows that turn; one input 0 without any row.

    Each input depends on one row of G alone: ``rows`` holds it for each input, ``features`` all
    of them once, and ``of_feature`` which inputs depend on which.

    Parameters
    ----------
    kinds : sequence of str
        Of the coordinates.
    features : sequence of sequence of float
        The rows of G.

    """

    def __init__(self, kinds: Sequence[Kind], features: Sequence[list[float]]):
        super().__init__()
        rows, phases, periodic, of_feature = [], [], list[bool](), []
        for number, row in enumerate(features):
            turns = is_periodic(kinds, row)
            # The cosine is a sine that is a quarter of a turn ahead.
            rows += [row, row] if turns else [row]
            phases += [0.0, 0.5 * math.pi] if turns else [0.0]
            periodic += [turns, turns] if turns else [turns]
            of_feature += [number, number] if turns else [number]
        if not features:
            rows, phases, periodic, of_feature = [[0.0] * len(kinds)], [0.0], [False], [0]
        self._turn = all(periodic)
        for key, values in (
                ('rows', rows), ('phase', phases), ('periodic', periodic),
                ('features', features or rows),
                ('of_feature', np.arange(len(features) or 1)[:, None] == of_feature)):
            self.register_buffer(key, torch.tensor(
                values, dtype=torch.bool if key == 'periodic' else torch.float64),
                persistent=False)

    def units(self, scales: MotionScales) -> tuple[np.ndarray, np.ndarray]:
        """Return centre and scale of the inputs, each of shape (n,)."""
        rows, periodic = self.rows.numpy(), self.periodic.numpy()
        centre = np.where(periodic, 0.0, rows @ scales.q_centre)
        half = np.where(periodic, 1.0, np.abs(rows) @ scales.q_half)
        return centre, np.where(half > 0.0, half, 1.0)

    def forward(self, q: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the inputs and their derivatives by their rows, (N, n), at q of (N, d)."""
        y = torch.addmm(self.phase, q, self.rows.T)
        if self._turn:
            return torch.sin(y), torch.cos(y)
        return (torch.where(self.periodic, torch.sin(y), y),
                torch.where(self.periodic, torch.cos(y), 1.0))
