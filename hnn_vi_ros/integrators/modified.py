# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The energies that the methods of order 2 nearly conserve, by products with the Hessian of H."""

from hnn_vi_ros.hamiltonians.base import Hamiltonian
import numpy as np


def leapfrog_energy(hamiltonian: Hamiltonian, h: float, q: np.ndarray, p: np.ndarray,
                    energy: np.ndarray | float, dH_dq: np.ndarray, dH_dp: np.ndarray
                    ) -> np.ndarray:
    """
    Return the modified energy of the generalised leapfrog up to O(h^4) [J]; see Integrator.

        H~ = H + (h^2 / 24) (2 H_p . H_qq H_p - H_q . H_pp H_q + 2 H_q . H_pq H_p)

    It follows from that of symplectic Euler, H -+ (h / 2) H_q . H_p
    + (h^2 / 12) (H_p . H_qq H_p + H_q . H_pp H_q + 4 H_q . H_pq H_p), by the formula of Baker,
    Campbell and Hausdorff for half a step of it and half a step of its adjoint. Where H separates
    the last term is zero, and it is that of Störmer-Verlet.

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, sections III.4, IX.3.

    """
    zero = np.zeros_like(dH_dq)
    along_q, mixed = hamiltonian.hessian_vector(q, p, dH_dp, zero)
    _, along_p = hamiltonian.hessian_vector(q, p, zero, dH_dq)
    terms = dH_dp * along_q - 0.5 * dH_dq * along_p + dH_dq * mixed
    return energy + h * h / 12.0 * np.sum(terms, axis=-1)


def midpoint_energy(hamiltonian: Hamiltonian, h: float, q: np.ndarray, p: np.ndarray,
                    energy: np.ndarray | float, dH_dq: np.ndarray, dH_dp: np.ndarray
                    ) -> np.ndarray:
    """
    Return the modified energy of the implicit midpoint rule up to O(h^4) [J]; see Integrator.

        H~ = H - (h^2 / 24) f . H'' f,    f = (H_p, -H_q)

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, section IX.3.

    """
    along_q, along_p = hamiltonian.hessian_vector(q, p, dH_dp, -dH_dq)
    return energy - h * h / 24.0 * np.sum(dH_dp * along_q - dH_dq * along_p, axis=-1)
