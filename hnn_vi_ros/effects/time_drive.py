# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The work of an H that depends on the time."""

from collections.abc import Sequence

from hnn_vi_ros.effects.base import EffectState, Force
from hnn_vi_ros.integrators import Integrator
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class TimeDrive(Force):
    """
    Explicit time in H(q, p, t), which a system adds to the effects of the scene.

    It applies no force. Its channel is the conjugate pair of the extended phase space, the time
    with t' = 1 and the work with W' = H_t: K = H(q, p, t) - W does not depend on the time, so
    methods keep their order and conserve K as they conserve another H. The derivative of a state
    at a time contains no change of t, so products with H'' do not need H_qt.

    Parameters
    ----------
    time : np.ndarray, shape (2,)
        See ``Hamiltonian.time``.

    References
    ----------
    B. Leimkuhler, S. Reich, Simulating Hamiltonian Dynamics, 2004, section 5.4.

    """

    depends_on_momentum, depends_on_state, turns, label = False, False, True, 'drive'

    def __init__(self, time: np.ndarray):
        self.time = time

    def accepts(self, integrator: Integrator) -> bool:
        """Return True: methods that do not support it refuse H; see ``Requirements.refusal``."""
        return True

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> tuple[np.ndarray]:
        """Return the memory of the time and of H_t."""
        return (self.time,)
