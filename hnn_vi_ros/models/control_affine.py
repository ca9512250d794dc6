# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A learned Hamiltonian with networks for the mass matrix and the potential."""

from hnn_vi_ros.kernels import Kernel
from hnn_vi_ros.models.learned import LearnedHamiltonian
from hnn_vi_ros.models.outputs import pack_outputs
from hnn_vi_ros.models.roots import energy, first_order, RootParameters, RootWork, second_order
import numpy as np


class ControlAffineHamiltonian(LearnedHamiltonian):
    """
    H(q, p) = |A(q)^T p|^2 / 2 + V(q), with M^-1 = A A^T, of a control-affine network.

    The network ``mass_inverse`` gives the entries of the lower triangular A, row by row. With
    u = A^T p,

        H_p = A u,    H_q = V' + sum_ij p_i u_j A_ij'.

    Its input map is used by the effect external_force.

    Parameters
    ----------
    checkpoint : Checkpoint
        A model of the family control_affine.

    References
    ----------
    Y. D. Zhong, B. Dey, A. Chakraborty, Symplectic ODE-Net: Learning Hamiltonian Dynamics with
    Control, ICLR 2020.

    """

    def _kernel(self) -> Kernel:
        d = self.dimension
        places = np.argwhere(np.tri(d))
        parameters = RootParameters(
            pack_outputs(self.checkpoint, 'mass_inverse'), self._packed('potential', 'q'),
            places, np.ones(d), 0.0, False, RootWork.empty(2 * d, len(places), d))
        return self._kernel_of(_energy, _gradient, _hessian_vector, parameters)


def _energy(parameters: RootParameters, q: np.ndarray, p: np.ndarray) -> float:
    z, d = parameters.work.z, q.size
    z[:d], z[d:] = q, p
    return energy(parameters)


def _gradient(parameters: RootParameters, q: np.ndarray, p: np.ndarray,
              dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    z, c, v = parameters.work.z, parameters.work.c, parameters.work.v
    d = v.size
    for a in range(0, q.size, d):
        for i in range(d):
            z[i], z[d + i] = q[a + i], p[a + i]
        first_order(parameters)
        for i in range(d):
            dH_dq[a + i], dH_dp[a + i] = c[i], v[i]


def _hessian_vector(parameters: RootParameters, q: np.ndarray, p: np.ndarray,
                    v_q: np.ndarray, v_p: np.ndarray, product_q: np.ndarray,
                    product_p: np.ndarray) -> None:
    z, z_v, c_v, v_v = (parameters.work.z, parameters.work.z_v, parameters.work.c_v,
                        parameters.work.v_v)
    d = v_v.size
    for a in range(0, q.size, d):
        for i in range(d):
            z[i], z[d + i] = q[a + i], p[a + i]
            z_v[i], z_v[d + i] = v_q[a + i], v_p[a + i]
        first_order(parameters)
        second_order(parameters)
        for i in range(d):
            product_q[a + i], product_p[a + i] = c_v[i], v_v[i]
