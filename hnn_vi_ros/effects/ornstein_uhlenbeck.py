# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Friction and noise of the momenta at fixed coordinates, whatever the mass matrix is."""

import math
from typing import NamedTuple

from hnn_vi_ros.effects.noise import draw_uniform, fill_normals
from hnn_vi_ros.effects.wrapped import energy_of
from hnn_vi_ros.integrators.arithmetic import plus
from hnn_vi_ros.integrators.base import Point
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.kernels.linear_algebra import factorise, solve_lower, solve_upper
from hnn_vi_ros.kernels.marks import inlined
import numpy as np

# Rounding of the sum of terms that an energy is, in units of its last place.
_PLACES = 16.0
_EPS = float(np.finfo(np.float64).eps)


class Bath(NamedTuple):
    """
    A heat bath and its working space, for d coordinates and at most K channels of forces.

    Parameters
    ----------
    rate : np.ndarray, shape (d,)
        gamma of each coordinate [1/s].
    temperature : float
        kT [J].
    seed : int
        Of the random numbers.
    factor : np.ndarray, shape (d, d)
        The inverse mass matrix H_pp, then its Cholesky factor.
    before, after, drawn : np.ndarray, shape (d,)
        Reduced momenta before and after, and random numbers.
    zero, unit, H_q, H_p, product_q, product_p : np.ndarray, shape (d + K,)
        Momenta at rest, a direction, and what is evaluated there.

    """

    rate: np.ndarray
    temperature: float
    seed: int
    factor: np.ndarray
    before: np.ndarray
    after: np.ndarray
    drawn: np.ndarray
    zero: np.ndarray
    unit: np.ndarray
    H_q: np.ndarray
    H_p: np.ndarray
    product_q: np.ndarray
    product_p: np.ndarray

    @classmethod
    def of(cls, rate: np.ndarray, temperature: float, seed: int, channels: int) -> 'Bath':
        """Return a bath with rates of shape (d,) and room for so many channels."""
        d = rate.size
        return cls(rate, temperature, seed, np.zeros((d, d)), *np.zeros((3, d)),
                   *np.zeros((6, d + channels)))


@inlined
def stir(kernel: Kernel, h: float, bath: Bath, draws: np.ndarray, z: Point) -> tuple[bool, float]:
    """
    Let friction and noise act on the momenta of one state for the time h.

    With H_pp = C C^T at rest and P = p + H_pp^-1 H_p(q, 0), the momentum of the velocity, the
    reduced momenta x = C^T P have the kinetic energy x . x / 2. Each follows its own
    Ornstein-Uhlenbeck process, at the rate of its row, which is a coordinate's own where the
    masses are not coupled. Where H is not quadratic in p, the result is accepted with the
    probability of Metropolis and Hastings, and p stays otherwise: either way exp(-H / kT) at
    fixed q is kept.

    Returns
    -------
    tuple of (bool, float)
        Whether H_pp is positive definite, and the heat taken up [J].

    References
    ----------
    N. Bou-Rabee, E. Vanden-Eijnden, Pathwise accuracy and ergodicity of Metropolized integrators
    for SDEs, Comm. Pure Appl. Math. 63 (2010).

    """
    d = bath.rate.size
    if not _factorise_inverse_mass(kernel, bath, z.q):
        return False, 0.0
    # C^T P = C^T p + C^-1 H_p(q, 0).
    solve_lower(bath.factor, bath.H_p[:d])
    for i in range(d):
        bath.before[i] = bath.H_p[i]
        for j in range(i, d):
            bath.before[i] += bath.factor[j, i] * (z.p[j] + z.p_carry[j])
    fill_normals(bath.seed, draws, bath.drawn)
    for i in range(d):
        c = math.exp(-bath.rate[i] * h)
        noise = math.sqrt(-math.expm1(-2.0 * bath.rate[i] * h) * bath.temperature)
        bath.after[i] = c * bath.before[i] + noise * bath.drawn[i]
        bath.drawn[i] = bath.after[i] - bath.before[i]
    solve_upper(bath.factor, bath.drawn)
    energy = energy_of(kernel, z)
    for i in range(d):
        bath.zero[i], bath.unit[i] = z.p[i], z.p_carry[i]
        z.p[i], z.p_carry[i] = plus(z.p[i], z.p_carry[i], bath.drawn[i])
    heat = energy_of(kernel, z) - energy
    if not _accept(kernel, bath, draws, energy, heat):
        heat = 0.0
        for i in range(d):
            z.p[i], z.p_carry[i] = bath.zero[i], bath.unit[i]
    return True, heat


@inlined
def _factorise_inverse_mass(kernel: Kernel, bath: Bath, q: np.ndarray) -> bool:
    """Fill H_p(q, 0) and the factor C of H_pp(q, 0) = C C^T; False if there is none."""
    bath.zero[:] = 0.0
    bath.unit[:] = 0.0
    n = q.size
    kernel.gradient(kernel.parameters, q, bath.zero[:n], bath.H_q[:n], bath.H_p[:n])
    for j in range(bath.rate.size):
        bath.unit[j] = 1.0
        kernel.hessian_vector(kernel.parameters, q, bath.zero[:n], bath.zero[:n], bath.unit[:n],
                              bath.product_q[:n], bath.product_p[:n])
        bath.unit[j] = 0.0
        for i in range(bath.rate.size):
            bath.factor[i, j] = bath.product_p[i]
    return factorise(bath.factor)


@inlined
def _accept(kernel: Kernel, bath: Bath, draws: np.ndarray, energy: float, heat: float) -> bool:
    """Decide by Metropolis and Hastings; what is no more than rounding counts as nothing."""
    excess = heat
    for i in range(bath.rate.size):
        excess += 0.5 * (bath.before[i] * bath.before[i] - bath.after[i] * bath.after[i])
    rounding = _PLACES * _EPS * (abs(energy) + abs(energy + heat) + kernel.energy_scale)
    uniform = draw_uniform(bath.seed, draws)
    return excess <= rounding or math.log(uniform) * bath.temperature < -excess
