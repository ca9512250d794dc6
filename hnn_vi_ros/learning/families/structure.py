# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Structure of a network of a machine: what it sees, and how large its motions are."""

from dataclasses import dataclass

from hnn_vi_ros.models.mechanical_card import Kind
from hnn_vi_ros.models.rigid_body_card import TreeCard
import numpy as np


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
        The parametric system whose M and V those of the networks are added to.
    residual : bool
        Whether there are networks beside it.
    friction_features : list of list of float, optional
        What the network D of friction -D(q) v sees, in the same way; None for no such network.
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
    Scales of what the data hold, each array of shape (d,) unless it says otherwise.

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
