# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A learned Hamiltonian of a mass matrix and a potential that both are networks of q."""

from hnn_vi_ros.kernels.compilation import kept
from hnn_vi_ros.kernels.kernel import Kernel, Parameters
from hnn_vi_ros.kernels.linking import part
from hnn_vi_ros.models.learned import LearnedHamiltonian
from hnn_vi_ros.models.outputs import (
    evaluate_outputs, output_tangents, pack_outputs, part_gradient, weigh)
from hnn_vi_ros.networks import perceptron
import numpy as np


class ControlAffineHamiltonian(LearnedHamiltonian):
    """
    H(q, p) = |A(q)^T p|^2 / 2 + V(q), with M^-1 = A A^T, of a control-affine network.

    The network ``mass_inverse`` gives the entries of the lower triangular A, row by row. With
    u = A^T p,

        H_p = A u,    H_q = V' + sum_ij p_i u_j A_ij'.

    Its input map drives the effect external_force.

    Parameters
    ----------
    checkpoint : Checkpoint
        Of the family control_affine.

    References
    ----------
    Y. D. Zhong, B. Dey, A. Chakraborty, Symplectic ODE-Net: Learning Hamiltonian Dynamics with
    Control, ICLR 2020.

    """

    def _kernel(self) -> Kernel:
        d = self.dimension
        parameters = (pack_outputs(self.checkpoint, 'mass_inverse'),
                      self._packed('potential', 'q'),
                      np.zeros((4, d * (d + 1) // 2)), np.zeros((4, d)))
        return Kernel(_energy, _gradient, _hessian_vector, parameters, d, (0.0, 0.0),
                      compiled=True)

    def _extended_gradient(self, z: np.ndarray) -> np.ndarray:
        q, p = np.split(z.astype(np.longdouble), 2, axis=1)
        d = self.dimension
        at = (slice(None), *np.tril_indices(d))
        entries, slopes = self._evaluated('mass_inverse', q)
        A, A_q = np.zeros((len(z), d, d), q.dtype), np.zeros((len(z), d, d, d), q.dtype)
        A[at], A_q[at] = entries, slopes
        u = (A * p[:, :, None]).sum(axis=1)
        H_q = (A_q * p[:, :, None, None] * u[:, None, :, None]).sum(axis=(1, 2))
        V_q = self._evaluated('potential', q)[1][:, 0]
        return np.hstack([H_q + V_q, (A * u[:, None, :]).sum(axis=2)])


@kept(error_model='numpy')
def _energy(parameters: Parameters, q: np.ndarray, p: np.ndarray) -> float:
    root, potential, entries, space = parameters
    evaluate_outputs(root, q, p, entries[0])
    u = space[0]
    _times_transposed(entries[0], p, u)
    energy = perceptron.energy(potential, q, p)
    for j in range(p.size):
        energy += 0.5 * u[j] * u[j]
    return energy


@kept(error_model='numpy')
def _gradient(parameters: Parameters, q: np.ndarray, p: np.ndarray,
              dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    root, potential, entries, space = parameters
    d = space.shape[1]
    part_gradient(potential, q, p, dH_dq, dH_dp)
    for a in range(0, q.size, d):
        b = a + d
        _first_order(root, entries, space, q[a:b], p[a:b])
        _times(entries[0], space[0], dH_dp[a:b])
        weigh(root, entries[1])
        part_gradient(root[0], q[a:b], p[a:b], space[2], space[3])
        for i in range(d):
            dH_dq[a + i] += space[2, i]


@kept(error_model='numpy')
def _hessian_vector(parameters: Parameters, q: np.ndarray, p: np.ndarray, v_q: np.ndarray,
                    v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
    """Differentiate the lines of _gradient along (v_q, v_p)."""
    root, potential, entries, space = parameters
    d = space.shape[1]
    perceptron.hessian_vector(potential, q, p, v_q, v_p, product_q, product_p)
    A, c, A_v, c_v = entries
    u, u_v = space[0], space[1]
    for a in range(0, q.size, d):
        b = a + d
        _first_order(root, entries, space, q[a:b], p[a:b])
        weigh(root, c)
        perceptron.hessian_vector(root[0], q[a:b], p[a:b], v_q[a:b], v_p[a:b], space[2], space[3])
        for i in range(d):
            product_q[a + i] += space[2, i]
        output_tangents(root, A_v)
        _times_transposed(A_v, p[a:b], u_v)
        _times_transposed(A, v_p[a:b], space[3])
        for j in range(d):
            u_v[j] += space[3, j]
        _times(A_v, u, product_p[a:b])
        _times(A, u_v, space[3])
        k = 0
        for i in range(d):
            product_p[a + i] += space[3, i]
            for j in range(i + 1):
                c_v[k] = v_p[a + i] * u[j] + p[a + i] * u_v[j]
                k += 1
        weigh(root, c_v)
        part_gradient(root[0], q[a:b], p[a:b], space[2], space[3])
        for i in range(d):
            product_q[a + i] += space[2, i]


@part(error_model='numpy', forceinline=True)
def _first_order(root: Parameters, entries: np.ndarray, space: np.ndarray, q: np.ndarray,
                 p: np.ndarray) -> None:
    """Fill A in the first row of entries, p_i u_j in the second, u in the first of space."""
    evaluate_outputs(root, q, p, entries[0])
    _times_transposed(entries[0], p, space[0])
    k = 0
    for i in range(p.size):
        for j in range(i + 1):
            entries[1, k] = p[i] * space[0, j]
            k += 1


@part(error_model='numpy', forceinline=True)
def _times(A: np.ndarray, u: np.ndarray, product: np.ndarray) -> None:
    k = 0
    for i in range(u.size):
        product[i] = 0.0
        for j in range(i + 1):
            product[i] += A[k] * u[j]
            k += 1


@part(error_model='numpy', forceinline=True)
def _times_transposed(A: np.ndarray, p: np.ndarray, product: np.ndarray) -> None:
    product[:] = 0.0
    k = 0
    for i in range(p.size):
        for j in range(i + 1):
            product[j] += A[k] * p[i]
            k += 1
