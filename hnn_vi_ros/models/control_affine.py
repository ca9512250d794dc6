# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A learned Hamiltonian of a mass matrix and a potential that both are networks of q."""

from typing import NamedTuple

from hnn_vi_ros.kernels.compilation import kept
from hnn_vi_ros.kernels.kernel import Kernel
from hnn_vi_ros.kernels.linking import part
from hnn_vi_ros.models.learned import LearnedHamiltonian
from hnn_vi_ros.models.outputs import (
    evaluate_outputs, output_tangents, pack_outputs, PackedOutputs, part_gradient, root_of, weigh)
from hnn_vi_ros.networks import perceptron
from hnn_vi_ros.networks.perceptron_memory import PackedPerceptron
import numpy as np


class ControlAffineParameters(NamedTuple):
    """
    Parameters of the functions of a control-affine network; ``_v`` marks changes.

    Parameters
    ----------
    root : PackedOutputs
        The network of the entries of A.
    potential : PackedPerceptron
        That of V.
    A, A_v, c, c_v : np.ndarray, shape (d (d + 1) / 2,)
        Space for the entries of A, and for p_i u_j, by which their derivatives are weighed.
    u, u_v : np.ndarray, shape (d,)
        Space for A^T p.
    more_q, more_p : np.ndarray, shape (d,)
        Space for a term of a sum.

    """

    root: PackedOutputs
    potential: PackedPerceptron
    A: np.ndarray
    A_v: np.ndarray
    c: np.ndarray
    c_v: np.ndarray
    u: np.ndarray
    u_v: np.ndarray
    more_q: np.ndarray
    more_p: np.ndarray


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
        parameters = ControlAffineParameters(
            pack_outputs(self.checkpoint, 'mass_inverse'), self._packed('potential', 'q'),
            *np.zeros((4, d * (d + 1) // 2)), *np.zeros((4, d)))
        return self._kernel_of(_energy, _gradient, _hessian_vector, parameters)

    def _extended_gradient(self, z: np.ndarray) -> np.ndarray:
        q, p = np.split(z.astype(np.longdouble), 2, axis=1)
        A, A_q = root_of(*self._evaluated('mass_inverse', q),
                         np.argwhere(np.tri(self.dimension)).tolist(), False)
        u = (A * p[:, :, None]).sum(axis=1)
        H_q = (A_q * p[:, :, None, None] * u[:, None, :, None]).sum(axis=(1, 2))
        V_q = self._evaluated('potential', q)[1][:, 0]
        return np.hstack([H_q + V_q, (A * u[:, None, :]).sum(axis=2)])


@kept(error_model='numpy')
def _energy(parameters: ControlAffineParameters, q: np.ndarray, p: np.ndarray) -> float:
    A, u = parameters.A, parameters.u
    evaluate_outputs(parameters.root, q, p, A)
    _times_transposed(A, p, u)
    energy = perceptron.energy(parameters.potential, q, p)
    for j in range(p.size):
        energy += 0.5 * u[j] * u[j]
    return energy


@kept(error_model='numpy')
def _gradient(parameters: ControlAffineParameters, q: np.ndarray, p: np.ndarray,
              dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    root, more_q, more_p = parameters.root, parameters.more_q, parameters.more_p
    d = more_q.size
    part_gradient(parameters.potential, q, p, dH_dq, dH_dp)
    for a in range(0, q.size, d):
        b = a + d
        _first_order(parameters, q[a:b], p[a:b])
        _times(parameters.A, parameters.u, dH_dp[a:b])
        weigh(root, parameters.c)
        part_gradient(root.network, q[a:b], p[a:b], more_q, more_p)
        for i in range(d):
            dH_dq[a + i] += more_q[i]


@kept(error_model='numpy')
def _hessian_vector(parameters: ControlAffineParameters, q: np.ndarray, p: np.ndarray,
                    v_q: np.ndarray, v_p: np.ndarray, product_q: np.ndarray,
                    product_p: np.ndarray) -> None:
    """Differentiate the lines of _gradient along (v_q, v_p)."""
    root, A, A_v = parameters.root, parameters.A, parameters.A_v
    c, c_v, u, u_v = parameters.c, parameters.c_v, parameters.u, parameters.u_v
    more_q, more_p, d = parameters.more_q, parameters.more_p, parameters.u.size
    perceptron.hessian_vector(parameters.potential, q, p, v_q, v_p, product_q, product_p)
    for a in range(0, q.size, d):
        b = a + d
        _first_order(parameters, q[a:b], p[a:b])
        weigh(root, c)
        perceptron.hessian_vector(root.network, q[a:b], p[a:b], v_q[a:b], v_p[a:b],
                                  more_q, more_p)
        for i in range(d):
            product_q[a + i] += more_q[i]
        output_tangents(root, A_v)
        _times_transposed(A_v, p[a:b], u_v)
        _times_transposed(A, v_p[a:b], more_p)
        for j in range(d):
            u_v[j] += more_p[j]
        _times(A_v, u, product_p[a:b])
        _times(A, u_v, more_p)
        k = 0
        for i in range(d):
            product_p[a + i] += more_p[i]
            for j in range(i + 1):
                c_v[k] = v_p[a + i] * u[j] + p[a + i] * u_v[j]
                k += 1
        weigh(root, c_v)
        part_gradient(root.network, q[a:b], p[a:b], more_q, more_p)
        for i in range(d):
            product_q[a + i] += more_q[i]


@part(error_model='numpy', forceinline=True)
def _first_order(parameters: ControlAffineParameters, q: np.ndarray, p: np.ndarray) -> None:
    """Fill A, u and c."""
    u, c = parameters.u, parameters.c
    evaluate_outputs(parameters.root, q, p, parameters.A)
    _times_transposed(parameters.A, p, u)
    k = 0
    for i in range(p.size):
        for j in range(i + 1):
            c[k] = p[i] * u[j]
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
