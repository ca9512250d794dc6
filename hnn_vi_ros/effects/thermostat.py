# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A heat bath: Langevin dynamics."""

from collections.abc import Callable, Sequence
from functools import cache
import math

from hnn_vi_ros.compilation import inlined
from hnn_vi_ros.effects.base import Live, per_coordinate, StepEffect
from hnn_vi_ros.effects.noise import fill_normals
from hnn_vi_ros.effects.wrapped import energy_of, scratch
from hnn_vi_ros.hamiltonians.base import Kernel
from hnn_vi_ros.hamiltonians.parameters import check_positive
from hnn_vi_ros.integrators.base import Integrator, Memory, OK, Point
from hnn_vi_ros.phase_space import Coordinate
import numpy as np


class Thermostat(StepEffect):
    """
    Langevin dynamics, dp = -H_q dt - gamma p dt + sqrt(2 gamma m kT) dW, by BAOAB.

    The exact flow of friction and noise, p -> c p + sqrt((1 - c^2) m kT) N(0, 1) with
    c = exp(-gamma h), stands between the halves of a leapfrog step. The steady state has the
    density exp(-H / kT) where H is quadratic in p, with the masses m. Energy account: the flow's
    change of H, the heat taken up.

    Parameters
    ----------
    temperature : float
        kT > 0 [J].
    rate : float or list of float
        gamma > 0 [1/s], for all coordinates or for each.
    mass : float or list of float
        m > 0 [kg] or [kg m^2], of the coordinates.
    seed : int
        From 0; with the same seed the same noise.

    Raises
    ------
    ValueError
        A parameter out of its range.

    References
    ----------
    B. Leimkuhler, C. Matthews, Rational construction of stochastic numerical methods for
    molecular sampling, Appl. Math. Res. Express 2013.

    """

    def __init__(self, temperature: float, rate: float | list[float],
                 mass: float | list[float] = 1.0, seed: int = 0):
        check_positive(temperature=temperature)
        check_positive(rate=np.min(rate), mass=np.min(mass))
        if not 0 <= seed < 2 ** 63:
            raise ValueError(f'seed = {seed} must be from 0 to 2^63 - 1')
        self.temperature, self.rate, self.mass, self.seed = float(temperature), rate, mass, seed

    def accepts(self, integrator: Integrator) -> bool:
        """Tell whether the method's step has two halves to stand between."""
        return integrator.halves is not None

    def resolve(self, coordinates: Sequence[Coordinate], live: Live) -> tuple:
        """Return rates [1/s], variances of p [kg^2 m^2/s^2], the seed, and space for numbers."""
        mass = per_coordinate(coordinates, 'mass', self.mass)
        rate = per_coordinate(coordinates, 'rate', self.rate)
        return rate, self.temperature * mass, self.seed, np.zeros(rate.size)

    @staticmethod
    def inner_step(integrator: Integrator) -> tuple[Callable, Callable]:
        """Return the halves of the method's step."""
        return integrator.halves

    @staticmethod
    @cache
    def wrap(halves: tuple[Callable, Callable], keeps_gradient: bool) -> Callable:
        """Return the two halves with the bath between them; see StepEffect."""
        first_half, second_half = halves

        @inlined
        def bathed(kernel: Kernel, h: float, options: tuple, z: Point, z1: Point,
                   memory: tuple[Memory, ...]) -> tuple[int, float, int]:
            """Take one step; see Integrator."""
            inner, (rate, variance, seed, normals), live, effect = options
            middle = scratch(memory)
            outcome, residual, gradients = first_half(
                kernel, 0.5 * h, inner, z, middle, memory[:-1])
            if outcome != OK:
                return outcome, residual, gradients
            before = energy_of(kernel, middle)
            fill_normals(seed, live.draws, normals)
            for i in range(rate.size):
                c = math.exp(-rate[i] * h)
                middle.p[i] = c * middle.p[i] + math.sqrt((1.0 - c * c) * variance[i]) * normals[i]
                middle.p_carry[i] *= c
            live.pending[effect] += energy_of(kernel, middle) - before
            outcome, second, more = second_half(kernel, 0.5 * h, inner, middle, z1, memory[:-1])
            return outcome, max(residual, second), gradients + more
        return bathed
