# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Structure conserved by single steps, and measures of energy errors over long runs."""

from collections.abc import Callable, Sequence

from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators import (
    Integrator, is_finite, NO_SOLUTION, NOT_FINITE, OK, PhasePoint, step_failure)
from hnn_vi_ros.integrators.variational_euler import VariationalEuler
from hnn_vi_ros.kernels import Kernel
from hnn_vi_ros.simulation.accuracy.diagnostics import state_scales
import numpy as np

BLOCKS = 100
# A spacing of 1e-3 of the state leaves, extrapolated once, 1e-12 of truncation and of rounding.
_SPACING = 1e-3
_NEWTON_ITERATIONS = 50


def block_maxima(error: np.ndarray, blocks: int = BLOCKS) -> np.ndarray:
    """Return the largest absolute values in equally long blocks, shape (blocks,) at most."""
    blocks = min(blocks, error.size)
    if blocks == 0:
        return np.empty(0)
    usable = error[:error.size // blocks * blocks]
    return np.abs(usable).reshape(blocks, -1).max(axis=1)


def rounding_scale(energy: float, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
                   dH_dp: np.ndarray) -> float:
    """
    Return the size of the numbers that H is made of at a state, by which it is rounded [J].

    It is the larger of abs(H) and sum_i (abs(q_i H_qi) + abs(p_i H_pi)) / 2: the change of H
    when each entry of the state changes by half of itself. A constant in H counts here, as it
    does in rounding; what does not is an EnergyScale.
    """
    return max(abs(energy), 0.5 * float(np.abs(q * dH_dq).sum() + np.abs(p * dH_dp).sum()))


def take_step(kernel: Kernel, integrator: Integrator, h: float, q: np.ndarray, p: np.ndarray
              ) -> tuple[np.ndarray, np.ndarray]:
    """
    Take one step of a method from a state, uncompiled; h may be negative.

    Parameters
    ----------
    kernel : Kernel
        Kernel of H.
    integrator : Integrator
        The method, as a scene names it.
    h : float
        Step size [s].
    q, p : np.ndarray, shape (d,)
        The state.

    Raises
    ------
    StepFailure
        The step does not converge, or is not finite.

    """
    z, z1 = PhasePoint.empty(q.size), PhasePoint.empty(q.size)
    z.q[:], z.p[:] = q, p
    kernel.gradient(kernel.parameters, z.q, z.p, z.dH_dq, z.dH_dp)
    for attempt in integrator.attempts(q.size):
        outcome, residual, spent = integrator.step(
            kernel, h, integrator.options(attempt, q.size), z, z1, integrator.memory(q.size))
        if outcome in (OK, NO_SOLUTION):
            break
    if outcome == OK and not is_finite(z1):
        outcome = NOT_FINITE
    if outcome != OK:
        raise step_failure(outcome, 0.0, h, residual, spent)
    return z1.q, z1.p


def reversal_defect(hamiltonian: Hamiltonian, integrator: Integrator, h: float, q: np.ndarray,
                    p: np.ndarray) -> float:
    """
    Return the relative distance from the start after a step forward and a step back.

    For a symmetric method it is round-off. Raises StepFailure where a step fails.
    """
    there = take_step(hamiltonian.kernel, integrator, h, q, p)
    back = take_step(hamiltonian.kernel, integrator, -h, *there)
    return max(float(np.abs(end - start).max() / max(np.abs(start).max(), np.abs(middle).max()))
               for start, middle, end in zip((q, p), there, back, strict=True))


def symplectic_defect(hamiltonian: Hamiltonian, integrator: Integrator, h: float, q: np.ndarray,
                      p: np.ndarray) -> float:
    """
    Return the largest entry of M^T W(z') M - W(z), M the derivative of the step z -> z'.

    W is the matrix of the 2-form that the method keeps: dq ^ dp, but for VariationalEuler
    dq ^ d(p + h H_q). Derivatives are central differences, extrapolated once; entries are in
    units over which H changes, so that 1 is the size of W itself.

    Raises
    ------
    StepFailure
        A step fails.

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section VI.2.

    """
    d, z = q.size, np.concatenate([q, p])
    scales = state_scales(hamiltonian, q, p)

    def step(z: np.ndarray) -> np.ndarray:
        return np.concatenate(take_step(hamiltonian.kernel, integrator, h, z[:d], z[d:]))

    columns = []
    for i in range(2 * d):
        coarse, fine = (_difference(step, z, i, part * _SPACING * scales[i])
                        for part in (1.0, 0.5))
        columns.append((4.0 * fine - coarse) / 3.0)
    M = np.array(columns).T
    before, after = (two_form(hamiltonian, integrator, h, x) for x in (z, step(z)))
    defect = (M.T @ after @ M - before) * np.outer(scales, scales)
    return float(np.abs(defect).max() / (scales[:d] * scales[d:]).max())


def two_form(hamiltonian: Hamiltonian, integrator: Integrator, h: float, z: np.ndarray
             ) -> np.ndarray:
    """Return the matrix, shape (2 d, 2 d), of the 2-form that a method keeps at z = (q, p)."""
    d = z.size // 2
    unit, zero = np.eye(d), np.zeros((d, d))
    J = np.block([[zero, unit], [-unit, zero]])
    if not isinstance(integrator, VariationalEuler):
        return J
    # The derivative of (q, p) -> (q, p + h H_q(q, p)).
    D = np.eye(2 * d)
    for i, v in enumerate(np.eye(2 * d)):
        D[d:, i] += h * hamiltonian.hessian_vector(z[:d], z[d:], v[:d], v[d:])[0]
    return D.T @ J @ D


def stationary_energy(hamiltonian: Hamiltonian, q: Sequence[float], p: Sequence[float]) -> float:
    """
    Return the energy of the stationary state of H next to (q, p), by Newton's method [J].

    Saddles are what separates motions: the top of a pendulum, the corners of the Hénon-Heiles
    triangle.

    Raises
    ------
    ValueError
        None is found.

    """
    d, z = hamiltonian.dimension, np.array([*q, *p], dtype=np.float64)
    for _ in range(_NEWTON_ITERATIONS):
        gradient = np.concatenate(hamiltonian.gradient(z[:d], z[d:]))
        hessian = np.array([np.concatenate(hamiltonian.hessian_vector(z[:d], z[d:], v[:d], v[d:]))
                            for v in np.eye(2 * d)])
        step = np.linalg.lstsq(hessian, -gradient)[0]
        z = z + step
        if np.abs(step).max() <= 1e-12 * max(1.0, np.abs(z).max()):
            # A constant slope also gives a step of zero.
            if np.abs(gradient).max() <= 1e-9 * max(1.0, np.abs(hessian).max()):
                return float(hamiltonian.energy(z[:d], z[d:]))
            break
    raise ValueError(f'no stationary state of H next to q = {list(q)}, p = {list(p)}')


def _difference(step: Callable[[np.ndarray], np.ndarray], z: np.ndarray, i: int, spacing: float
                ) -> np.ndarray:
    ahead, behind = z.copy(), z.copy()
    ahead[i] += spacing
    behind[i] -= spacing
    return (step(ahead) - step(behind)) / (ahead[i] - behind[i])
