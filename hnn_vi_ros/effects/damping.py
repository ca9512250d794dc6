# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Linear damping of the motion."""

from collections.abc import Sequence
from functools import cache
import math

from hnn_vi_ros.effects.base import EffectState, Force, per_coordinate, Place, StepEffect
from hnn_vi_ros.effects.masses import check_rates, Friction, vector_potential
from hnn_vi_ros.effects.splitting import strang
from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.hamiltonians import check_not_negative, Hamiltonian
from hnn_vi_ros.integrators import Integrator, Step
from hnn_vi_ros.kernels import inlined, Parameters
from hnn_vi_ros.models import load_checkpoint
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class Damping(Force, StepEffect):
    """
    Linear damping, f = -gamma P, with one rate for each coordinate, or each component of p.

    P is the kinetic momentum: p, or p - c A(q) in magnetic fields. Methods of order 1 and 2 use
    its exact flow P -> exp(-gamma h / 2) P before and after a step (Strang splitting), which is
    stable for any rate; other methods, whose order splitting would reduce, evaluate f at their
    nodes. For friction coefficients of joints use `joint_friction`. Energy account: change of H,
    or f . H_p.

    Parameters
    ----------
    rate : float or list of float, optional
        gamma >= 0 [1/s], for all coordinates or for each if no motion gains energy.
    model : str, optional
        A model with learned friction (family dgnet), instead of the rate.

    Raises
    ------
    ModelError, ValueError
        The model has no learned friction, or the rate is invalid.

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section II.5.

    """

    depends_on_momentum = turns = drawn = passive = True

    def __init__(self, rate: float | list[float] | None = None, model: str | None = None):
        if (rate is None) == (model is None):
            raise ValueError('give either rate or model')
        if model is not None:
            rate = load_checkpoint(model).card.friction
        if rate is None:
            raise ModelError(f'{model}: the model has no learned friction; give a rate, or a '
                             'model of the family dgnet')
        check_not_negative(rate=rate)
        self.rate = rate

    def place(self, integrator: Integrator) -> Place:
        """Return the place of the flow, or of the force."""
        splits = integrator.order <= 2 and integrator.requirements.from_state
        return Place.AROUND if splits else Place.NODES

    def accepts(self, integrator: Integrator) -> bool:
        """Return True if the method supports the flow, or the force."""
        return integrator.requirements.hamiltonian and (
            self.place(integrator) is Place.AROUND or Force.accepts(self, integrator))

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> Friction:
        """Return the rates of the columns of p [1/s], and the gauge of magnetic fields."""
        return Friction(per_coordinate(coordinates, 'rate', self.rate), state.gauge)

    def check_state(self, hamiltonian: Hamiltonian, parameters: Parameters, q: np.ndarray) -> None:
        """Raise ValueError if the rates would add energy near q, shape (m d,)."""
        check_rates(hamiltonian, q, per_coordinate(hamiltonian.coordinates, 'rate', self.rate))

    @staticmethod
    @inlined
    def add_force(own: Friction, t: float, q: np.ndarray, p: np.ndarray,
                  velocity: np.ndarray, f_q: np.ndarray, f_p: np.ndarray) -> None:
        """Add -gamma P."""
        for i in range(own.rate.size):
            f_p[i] -= own.rate[i] * (p[i] - vector_potential(own.gauge, q, i))

    @staticmethod
    @cache
    def wrap(step: Step, keeps_gradient: bool) -> Step:
        """Return the step between two half flows."""
        return strang(_flow, step, keeps_gradient)


@inlined
def _flow(own: Friction, h: float, q: np.ndarray, p: np.ndarray, p_carry: np.ndarray) -> None:
    rate, gauge = own.rate, own.gauge
    for i in range(rate.size):
        factor = math.exp(-rate[i] * h)
        p[i] = factor * p[i] - math.expm1(-rate[i] * h) * vector_potential(gauge, q, i)
        p_carry[i] *= factor
