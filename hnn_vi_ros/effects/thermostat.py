# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A heat bath: Langevin dynamics with any mass matrix."""

from collections.abc import Sequence
from functools import cache
import math
from typing import Any, NamedTuple

from hnn_vi_ros.effects.base import EffectState, per_coordinate, Place, StepEffect
from hnn_vi_ros.effects.masses import check_masses
from hnn_vi_ros.effects.wrapped import energy_of
from hnn_vi_ros.hamiltonians import check_positive, Hamiltonian
from hnn_vi_ros.integrators import NO_MASS, OK, PhasePoint, plus, Step
from hnn_vi_ros.kernels import factorise, inlined, Kernel, Parameters, solve_lower, solve_upper
from hnn_vi_ros.phase_space import Coordinate
import numpy as np

# Rounding error of an energy, which is a sum of several terms, in units of its last place.
_ROUNDING_ERRORS = 16.0
_EPS = float(np.finfo(np.float64).eps)


class Bath(NamedTuple):
    """
    A heat bath and its workspace, for d coordinates and at most K channels of forces.

    Parameters
    ----------
    rate : np.ndarray, shape (d,)
        gamma of each coordinate [1/s].
    temperature : float
        kT [J].
    seed : int
        Seed of the random numbers.
    factor : np.ndarray, shape (d, d)
        The inverse mass matrix H_pp, then its Cholesky factor.
    before, after, drawn : np.ndarray, shape (d,)
        Reduced momenta before and after, and random numbers.
    zero, unit, H_q, H_p, product_q, product_p : np.ndarray, shape (d + K,)
        Momenta at rest, a direction, and the derivatives of H there.

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
        """Return a bath with rates of shape (d,) and workspace for a number of channels."""
        d = rate.size
        return cls(rate, temperature, seed, np.zeros((d, d)), *np.zeros((3, d)),
                   *np.zeros((6, d + channels)))


class Thermostat(StepEffect):
    """
    Langevin dynamics, dP = -H_q dt - gamma P dt + sqrt(2 gamma M kT) dW, by BAOAB.

    P = M v is the kinetic momentum; M, the inverse of H_pp, may depend on q. Friction and noise
    act in the middle of a leapfrog step and preserve the density exp(-H / kT). Without noise use
    `damping`. Energy account: the heat.

    Parameters
    ----------
    temperature : float
        kT > 0 [J].
    rate : float or list of float
        gamma > 0 [1/s], for all coordinates or for each. Where masses are coupled, the rates
        belong to the reduced momenta C^T P, with H_pp = C C^T and a lower triangular C.
    mass : float or list of float, optional
        M of each coordinate [kg] or [kg m^2], only for a check: it must be the mass of H.
    seed : int
        Seed of the noise, at least 0; the same seed gives the same noise.

    Raises
    ------
    ValueError
        A parameter is out of its range.

    References
    ----------
    B. Leimkuhler, C. Matthews, Appl. Math. Res. Express 2013.

    """

    acts, single, batched, random = Place.MIDDLE, True, False, True
    excludes = {Place.MANIFOLD: 'because its impulses would violate the constraints'}

    def __init__(self, temperature: float, rate: float | list[float],
                 mass: float | list[float] | None = None, seed: int = 0):
        check_positive(temperature=temperature, rate=np.min(rate),
                       mass=1.0 if mass is None else np.min(mass))
        if not 0 <= seed < 2 ** 63:
            raise ValueError(f'seed = {seed} must be from 0 to 2^63 - 1')
        self.temperature, self.rate, self.mass, self.seed = float(temperature), rate, mass, seed

    def resolve(self, coordinates: Sequence[Coordinate], state: EffectState) -> Parameters:
        """Return the bath; a force has at most two channels."""
        return (Bath.of(per_coordinate(coordinates, 'rate', self.rate), self.temperature,
                        self.seed, 2 * state.pending.size),)

    def check_state(self, hamiltonian: Hamiltonian, parameters: Parameters, q: np.ndarray) -> None:
        """Raise ValueError if H has no masses at q, shape (d,), or others than the given ones."""
        check_masses(hamiltonian, q, None if self.mass is None else per_coordinate(
            hamiltonian.coordinates, 'mass', self.mass))

    @staticmethod
    @cache
    def wrap(halves: tuple[Step, Step], keeps_gradient: bool) -> Step:
        """Return the two halves with the bath between them."""
        # Imported lazily: reading a scene needs no compiler.
        from hnn_vi_ros.effects.noise import draw_uniform, fill_normals
        first_half, second_half = halves

        @inlined
        def bathed(kernel: Kernel, h: float, options: Parameters, z: PhasePoint, z1: PhasePoint,
                   memory: tuple[Any, ...]) -> tuple[int, float, int]:
            """Take one step; see Integrator."""
            inner, (bath,), state, effect = options
            middle = memory[-1].point
            outcome, residual, gradients = first_half(
                kernel, 0.5 * h, inner, z, middle, memory[:-1])
            if outcome != OK:
                return outcome, residual, gradients
            fill_normals(bath.seed, state.draws, bath.drawn)
            uniform = draw_uniform(bath.seed, state.draws)
            possible, heat = _exchange(kernel, h, bath, uniform, middle)
            gradients += 1 + bath.rate.size
            if not possible:
                return NO_MASS, residual, gradients
            state.pending[effect] += heat
            outcome, second, more = second_half(kernel, 0.5 * h, inner, middle, z1, memory[:-1])
            return outcome, max(residual, second), gradients + more
        return bathed


@inlined
def _exchange(kernel: Kernel, h: float, bath: Bath, uniform: float, z: PhasePoint
              ) -> tuple[bool, float]:
    """
    Apply friction and noise to the momenta of one state for the time h.

    With H_pp = C C^T at rest and the kinetic momentum P = p + H_pp^-1 H_p(q, 0), the reduced
    momenta x = C^T P have the kinetic energy x . x / 2. Each follows its own Ornstein-Uhlenbeck
    process. If H is not quadratic in p, as a learned H, that process would not preserve
    exp(-H / kT); the result is therefore accepted with the Metropolis-Hastings probability, and p
    is unchanged otherwise.

    Parameters
    ----------
    kernel, h
        H, and the time [s].
    bath : Bath
        The bath; ``drawn`` holds normal random numbers.
    uniform : float
        A random number in (0, 1] that decides on acceptance.
    z : Point
        The state, which is changed.

    Returns
    -------
    tuple of (bool, float)
        True if H_pp is positive definite, and the absorbed heat [J].

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
    if not _accept(kernel, bath, uniform, energy, heat):
        heat = 0.0
        for i in range(d):
            z.p[i], z.p_carry[i] = bath.zero[i], bath.unit[i]
    return True, heat


@inlined
def _factorise_inverse_mass(kernel: Kernel, bath: Bath, q: np.ndarray) -> bool:
    """Fill H_p(q, 0) and the factor C of H_pp(q, 0) = C C^T; return False if there is none."""
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
def _accept(kernel: Kernel, bath: Bath, uniform: float, energy: float, heat: float) -> bool:
    """Decide by Metropolis-Hastings; a difference within rounding is always accepted."""
    excess = heat
    for i in range(bath.rate.size):
        excess += 0.5 * (bath.before[i] * bath.before[i] - bath.after[i] * bath.after[i])
    # Without the margin, a quadratic H would sometimes be rejected because of rounding.
    rounding = _ROUNDING_ERRORS * _EPS * (abs(energy) + abs(energy + heat) + kernel.energy_scale)
    return excess <= rounding or math.log(uniform) * bath.temperature < -excess
