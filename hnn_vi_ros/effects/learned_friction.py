# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Friction that was learned with a mechanism."""

from collections.abc import Sequence
import math
from typing import Any

from hnn_vi_ros.effects.base import EffectState, Force
from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.kernels.kernel import Parameters
from hnn_vi_ros.kernels.marks import inlined
from hnn_vi_ros.models.checkpoint import load_checkpoint
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class LearnedFriction(Force):
    """
    The friction of a model of the family mechanical, with v = H_p at each coordinate.

        f = -b v - sum_k c_k tanh(v / w_k) - sum_l c_l tanh(v / w_l) exp(-(v / s_l)^2)

    All b, c >= 0 and w > 0, so that it can only take energy: viscous, Coulomb made smooth where
    the motion turns, and Stribeck. Energy account: the power f . H_p <= 0.

    Parameters
    ----------
    model : str
        A shipped model, one trained into models/ of the working directory, or the path of a
        .safetensors file; that of H as a rule.

    Raises
    ------
    ModelError
        The model does not exist, is damaged, or is of another family.

    References
    ----------
    E. Pennestrì et al., Review and comparison of dry friction force models, Nonlinear Dynamics
    83 (2016), sections 2.2 and 2.4.

    """

    depends_on_momentum = True

    def __init__(self, model: str):
        checkpoint = load_checkpoint(model)
        if checkpoint.card.mechanical is None:
            raise ModelError(f'{model}: a model of the family {checkpoint.card.family} has no '
                             'friction of its own; take one of the family mechanical, or the '
                             'effects damping and dry_friction')
        self.friction = checkpoint.card.mechanical.friction

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> Parameters:
        """Return b, shape (d,), Coulomb terms (c, 1/w) and Stribeck terms (c, 1/w, 1/s)."""
        viscous = np.array(self.friction.viscous)
        d = len(coordinates)
        if viscous.size != d:
            raise ValueError(f'the model has {viscous.size} coordinates, H has {d}')
        coulomb: list[Any] = [
            (term.force, np.reciprocal(term.width)) for term in self.friction.coulomb]
        stribeck: list[Any] = [
            (term.force, np.reciprocal(term.width), np.reciprocal(term.speed))
            for term in self.friction.stribeck]
        return viscous, np.reshape(coulomb, (-1, 2, d)), np.reshape(stribeck, (-1, 3, d))

    @staticmethod
    @inlined
    def add_force(parameters: Parameters, t: float, q: np.ndarray, p: np.ndarray,
                  velocity: np.ndarray, f_q: np.ndarray, f_p: np.ndarray) -> None:
        """Add the friction at each coordinate."""
        viscous, coulomb, stribeck = parameters
        for i in range(q.size):
            v = velocity[i]
            friction = viscous[i] * v
            for k in range(coulomb.shape[0]):
                friction += coulomb[k, 0, i] * math.tanh(v * coulomb[k, 1, i])
            for k in range(stribeck.shape[0]):
                ratio = v * stribeck[k, 2, i]
                friction += (stribeck[k, 0, i] * math.tanh(v * stribeck[k, 1, i])
                             * math.exp(-ratio * ratio))
            f_p[i] -= friction
