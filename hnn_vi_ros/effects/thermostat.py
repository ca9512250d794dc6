# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A heat bath: Langevin dynamics."""

from collections.abc import Sequence
from functools import cache
from typing import Any

from hnn_vi_ros.effects.base import EffectState, per_coordinate, Place, StepEffect
from hnn_vi_ros.effects.masses import check_masses
from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.hamiltonians.parameters import check_positive
from hnn_vi_ros.integrators.base import NO_MASS, OK, Point, Step
from hnn_vi_ros.kernels.kernel import Kernel, Parameters
from hnn_vi_ros.kernels.marks import inlined
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class Thermostat(StepEffect):
    """
    Langevin dynamics, dP = -H_q dt - gamma P dt + sqrt(2 gamma M kT) dW, by BAOAB.

    P = M v is the velocity's; M, the inverse of H_pp, may depend on q. Friction and noise act amid
    a leapfrog step and keep the density exp(-H / kT); see ``stir``. Energy account: the heat.

    Parameters
    ----------
    temperature : float
        kT > 0 [J].
    rate : float or list of float
        gamma > 0 [1/s], for all coordinates or for each; those of coupled masses see ``stir``.
    mass : float or list of float, optional
        M of each coordinate [kg] or [kg m^2], which is H's own: one that differs is refused.
    seed : int
        From 0; with the same seed the same noise.

    Raises
    ------
    ValueError
        A parameter out of its range.

    References
    ----------
    B. Leimkuhler, C. Matthews, Appl. Math. Res. Express 2013.

    """

    acts, single, lockstep, random = Place.MIDDLE, True, False, True
    excludes = {Place.MANIFOLD: 'off which its impulses would lead'}

    def __init__(self, temperature: float, rate: float | list[float],
                 mass: float | list[float] | None = None, seed: int = 0):
        check_positive(temperature=temperature, rate=np.min(rate),
                       mass=1.0 if mass is None else np.min(mass))
        if not 0 <= seed < 2 ** 63:
            raise ValueError(f'seed = {seed} must be from 0 to 2^63 - 1')
        self.temperature, self.rate, self.mass, self.seed = float(temperature), rate, mass, seed

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> Parameters:
        """Return the bath."""
        from hnn_vi_ros.effects.ornstein_uhlenbeck import Bath
        return (Bath.of(per_coordinate(coordinates, 'rate', self.rate), self.temperature,
                        self.seed, state.pending.size),)

    def check_state(self, hamiltonian: Hamiltonian, parameters: Parameters, q: np.ndarray) -> None:
        """Raise ValueError if H has no masses at q, shape (d,), or others than those given."""
        check_masses(hamiltonian, q, None if self.mass is None else per_coordinate(
            hamiltonian.coordinates, 'mass', self.mass))

    @staticmethod
    @cache
    def wrap(halves: tuple[Step, Step], keeps_gradient: bool) -> Step:
        """Return the two halves with the bath between them; see StepEffect."""
        from hnn_vi_ros.effects.ornstein_uhlenbeck import stir
        first_half, second_half = halves

        @inlined
        def bathed(kernel: Kernel, h: float, options: Parameters, z: Point, z1: Point,
                   memory: tuple[Any, ...]) -> tuple[int, float, int]:
            """Take one step; see Integrator."""
            inner, (bath,), state, effect = options
            middle = memory[-1].point
            outcome, residual, gradients = first_half(
                kernel, 0.5 * h, inner, z, middle, memory[:-1])
            if outcome != OK:
                return outcome, residual, gradients
            possible, heat = stir(kernel, h, bath, state.draws, middle)
            gradients += 1 + bath.rate.size
            if not possible:
                return NO_MASS, residual, gradients
            state.pending[effect] += heat
            outcome, second, more = second_half(kernel, 0.5 * h, inner, middle, z1, memory[:-1])
            return outcome, max(residual, second), gradients + more
        return bathed
