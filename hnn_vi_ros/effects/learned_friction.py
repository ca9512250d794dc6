# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Friction that was trained together with a mechanism."""

from collections.abc import Sequence
import math
from typing import Self, TYPE_CHECKING

from hnn_vi_ros.effects.base import EffectState, Force
from hnn_vi_ros.effects.commands import plus_motors
from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.kernels import inlined
from hnn_vi_ros.models import Checkpoint, load_checkpoint
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

if TYPE_CHECKING:
    from hnn_vi_ros.effects.friction_network import LearnedFrictionParameters


class LearnedFriction(Force):
    """
    The friction of a model of the family mechanical or lie_group, where v = H_p.

        f = -b v - sum_k c_k tanh(v / w_k) - sum_l c_l tanh(v / w_l) exp(-(v / s_l)^2)
            - k abs(a) tanh(v / s) - D(q) v

    The terms are viscous, Coulomb (smoothed at v = 0), Stribeck, that of a gear which transmits
    the commanded force a of its motor (see JointFriction), and a network B(q), if the model has
    it. All b, c, k >= 0 and w, s > 0, and D = B B^T, so friction can only dissipate. With directed
    friction, b and c depend on the sign of v, with a tanh transition; the constant offset of the
    motors is added. A rotating body has only D, in its own frame. For known coefficients use
    `joint_friction`. Energy account: f . H_p, <= 0 for friction.

    Parameters
    ----------
    model : str
        A shipped model, one trained into models/ of the working directory, or the path of a
        .safetensors file; usually the model of H. An ensemble acts by the mean friction of its
        members.
    member : int, optional
        Number of the single member of an ensemble that acts, from 1.

    Raises
    ------
    ModelError
        The model does not exist, is damaged, belongs to another family or has no such member.

    References
    ----------
    E. Pennestrì et al., Review and comparison of dry friction force models, Nonlinear Dynamics
    83 (2016), sections 2.2 and 2.4.

    """

    depends_on_momentum = turns = True
    model: Checkpoint

    def __init__(self, model: str, member: int | None = None):
        checkpoint = load_checkpoint(model, ensembles=True).member(member)
        card = checkpoint.card
        if card.mechanical is None and (
                card.lie_group is None or 'dissipation' not in checkpoint.networks):
            raise ModelError(f'{model}: this model of the family {card.family} has no friction; '
                             'use one of the family mechanical, or lie_group with dissipation, or '
                             'the effects damping and dry_friction')
        self._take(checkpoint)

    @classmethod
    def of(cls, checkpoint: Checkpoint) -> Self:
        """Return the friction of a model that is in no file."""
        own = cls.__new__(cls)
        own._take(checkpoint)
        return own

    def _take(self, checkpoint: Checkpoint) -> None:
        card, self.model = checkpoint.card, checkpoint
        self.feels_command = card.mechanical is not None and \
            card.mechanical.friction.load is not None
        self.passive = card.mechanical is None or not any(card.mechanical.friction.offset or ())
        if self.feels_command and card.mechanical is not None:
            self.by_motors = card.mechanical.input_map is not None

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState
                ) -> 'LearnedFrictionParameters':
        """Return the coefficients, and the function that adds the friction of the network."""
        # Imported lazily: reading a scene needs no compiler.
        from hnn_vi_ros.effects.friction_network import friction_of
        return friction_of(self.model, coordinates, state)

    @staticmethod
    @inlined
    def add_force(parameters: 'LearnedFrictionParameters', t: float, q: np.ndarray, p: np.ndarray,
                  velocity: np.ndarray, f_q: np.ndarray, f_p: np.ndarray) -> None:
        """Add the friction at each coordinate, and that of the network."""
        switch, offset, viscous, coulomb, stribeck, load, add, own = parameters
        acts = load.clock[0] < load.command[load.command.size - 1]
        for i in range(q.size):
            v, side = velocity[i], math.tanh(velocity[i] * switch[i])
            # Without directed friction the differences are exactly zero.
            ahead = 0.5 + 0.5 * side
            friction = (viscous[1, i] + ahead * (viscous[0, i] - viscous[1, i])) * v
            for k in range(coulomb.shape[0]):
                force = coulomb[k, 1, i] + ahead * (coulomb[k, 0, i] - coulomb[k, 1, i])
                friction += force * math.tanh(v * coulomb[k, 2, i])
            for k in range(stribeck.shape[0]):
                ratio = v * stribeck[k, 2, i]
                friction += (stribeck[k, 0, i] * math.tanh(v * stribeck[k, 1, i])
                             * math.exp(-ratio * ratio))
            if acts:
                passed = plus_motors(0.0, load.motors.matrix, load.motors.fade, load.command, i)
                friction += load.share[i] * abs(passed) * side
            f_p[i] += offset[i] - friction
        add(own, q, velocity, f_p)
