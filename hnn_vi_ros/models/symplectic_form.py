# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A learned one-form and energy, which define motions in non-canonical coordinates."""

from typing import NamedTuple

from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.kernels import called, kept, Kernel, part, solve_linear
from hnn_vi_ros.models.checkpoint import Checkpoint
from hnn_vi_ros.models.graphs.derivatives import gradient as add_gradient
from hnn_vi_ros.models.graphs.family_graphs import network
from hnn_vi_ros.models.graphs.graph import Builder
from hnn_vi_ros.models.graphs.machine import assembled, energy, fill, gradient, GraphParameters
from hnn_vi_ros.models.graphs.tape import program
from hnn_vi_ros.models.learned import LearnedHamiltonian, rounding
import numpy as np

# Number of states of the box at which W is tested.
_TESTED_STATES = 1024
# Maximum condition number of W in units in which the box is a cube; beyond, u' is inaccurate.
_MAX_CONDITION = 1e6
# Motions determine W only along their paths; these remedies keep it regular elsewhere.
REMEDY = ('set linearity (0.01, then more), a weight that keeps the field simple where the data '
          'do not determine it; or use data from more motions, or from a smaller box')
_EPS = float(np.finfo(np.float64).eps)
_SPACING = _EPS ** (1.0 / 3.0)


class SymplecticFormHamiltonian(LearnedHamiltonian):
    """
    The one-form theta(u) and the energy H(u) of a neural symplectic form, u = (q, p) in R^2d.

    The p of u may be any quantity measured with q, often velocities: u need not be canonical.
    Motions make the integral of theta(u) . u' - H(u) over time stationary. Its variation is zero
    if

        d/dt theta_i(u) = sum_j d_i theta_j(u) u'_j - d_i H(u),  that is,
        W(u) u' = H'(u),  W_ij = d_i theta_j - d_j theta_i,

    so H is conserved, because W is skew. With theta = (p, 0) these are Hamilton's equations. Here
    theta = (M p, 0) + N(u): M is the mass matrix of the model card, N the network ``one_form``,
    and H the network ``energy``.

    Instead of (H_q, H_p) it returns (-p', q'), with u' = W^-1 H'.

    Parameters
    ----------
    checkpoint : Checkpoint
        A model of the family symplectic_form.

    Raises
    ------
    ModelError
        W is singular somewhere in the box, where u' is undefined.

    References
    ----------
    Y. Chen, T. Matsubara, T. Yaguchi, Neural Symplectic Form: Learning Hamiltonian Equations on
    General Coordinate Systems, NeurIPS 2021.

    """

    canonical = False

    def __init__(self, checkpoint: Checkpoint):
        super().__init__(checkpoint)
        half = 0.5 * np.ptp(np.concatenate(self.box), axis=1)
        problem = irregularity(self.two_forms(self._samples(_TESTED_STATES)), half)
        if problem:
            raise ModelError(f'{problem}, so its motions are not defined there; train it again: '
                             f'{REMEDY}')

    def two_forms(self, z: np.ndarray) -> np.ndarray:
        """Return W, shape (m, 2 d, 2 d), at states of shape (m, 2 d)."""
        found = np.empty((len(z), 2 * self.dimension, 2 * self.dimension))
        _fill_forms(self._parameters(), z, found)
        return found

    def _kernel(self) -> Kernel:
        parameters, z, d = self._parameters(), self._samples(_TESTED_STATES), self.dimension

        def energies(z: np.ndarray) -> np.ndarray:
            return np.array([[_energy(parameters, x[:d], x[d:])] for x in z])
        error = max(4.0 * np.abs(energies(z)).max(), rounding(energies, z)[0])
        norm = np.abs(np.linalg.inv(self.two_forms(z))).sum(axis=2).max()
        return self._kernel_of(_energy, _gradient, _hessian_vector, parameters._replace(
            energy_rounding=float(error), inverse_norm=float(norm)))

    def _parameters(self) -> 'FormParameters':
        """Return the networks, with their own workspace."""
        b, d, n = Builder(), self.dimension, 2 * self.dimension
        z, mass = b.input(n), np.zeros((n, n))
        mass[:d, d:] = self.checkpoint.card.mass
        output, theta = (network(b, self.checkpoint, name, z) for name in ('energy', 'one_form'))
        rows = b.add(b.constant(mass), b.reshape(b.concatenate(
            [add_gradient(b, theta, z, b.constant(unit)) for unit in np.eye(n)]), (n, n)))
        form = b.sub(b.take(rows, np.arange(n * n).reshape(n, n).T), rows)
        graph = assembled(*program(b, [z], [output], [add_gradient(b, output, z)], [form]), d)
        return FormParameters(graph, np.zeros((n, n)), 0.0, 0.0)


def irregularity(two_forms: np.ndarray, half: np.ndarray) -> str:
    """
    Describe why W is not invertible all over a box, '' if it is.

    If W is singular on a surface, it is regular at almost every sample, but its Pfaffian, whose
    square is its determinant, has both signs.

    Parameters
    ----------
    two_forms : np.ndarray, shape (m, 2 d, 2 d)
        W at samples of the box.
    half : np.ndarray, shape (2 d,)
        Half the side lengths of the box, the units in which W is tested.

    """
    scaled = two_forms * np.outer(half, half)
    signs = np.array([np.sign(_pfaffian(matrix)) for matrix in scaled])
    condition = np.linalg.cond(scaled).max() if (signs != 0.0).all() else np.inf
    if np.ptp(signs) > 0.0 or not condition <= _MAX_CONDITION:
        return ('the learned 2-form is singular in its training domain (Pfaffian of either '
                f'sign at {min((signs > 0).sum(), (signs < 0).sum())} of {len(signs)} states, '
                f'condition number {condition:.1e})')
    return ''


def _pfaffian(matrix: np.ndarray) -> float:
    """Return the Pfaffian of a skew matrix, by elimination with pivoting."""
    a, value = matrix.copy(), 1.0
    for k in range(0, len(a), 2):
        pivot = k + 1 + int(np.abs(a[k, k + 1:]).argmax())
        if a[k, pivot] == 0.0:
            return 0.0
        if pivot != k + 1:
            a[[k + 1, pivot]] = a[[pivot, k + 1]]
            a[:, [k + 1, pivot]] = a[:, [pivot, k + 1]]
            value = -value
        value *= a[k, k + 1]
        ratio, column = a[k, k + 2:] / a[k, k + 1], a[k + 2:, k + 1].copy()
        a[k + 2:, k + 2:] += np.outer(ratio, column) - np.outer(column, ratio)
    return value


class FormParameters(NamedTuple):
    """
    Parameters of the functions of a symplectic form, their first argument.

    Parameters
    ----------
    graph : GraphParameters
        Tapes of H, H' and W.
    two_form : np.ndarray, shape (2 d, 2 d)
        Workspace for W.
    energy_rounding, inverse_norm : float
        Rounding error of H in units of the unit round-off [J], and the largest norm of W^-1.

    """

    graph: GraphParameters
    two_form: np.ndarray
    energy_rounding: float
    inverse_norm: float


def _energy(parameters: FormParameters, q: np.ndarray, p: np.ndarray) -> float:
    return energy(parameters.graph, q, p)


@part(error_model='numpy')
def slope(parameters: FormParameters, q: np.ndarray, p: np.ndarray, covector: np.ndarray) -> None:
    """Fill H'(u), shape (2 d,), at one state."""
    gradient(parameters.graph, q, p, covector[:q.size], covector[q.size:])


@part(error_model='numpy')
def _fill_form(parameters: FormParameters, q: np.ndarray, p: np.ndarray) -> None:
    """Fill W at one state."""
    memory, d = parameters.graph.memory, q.size
    for i in range(d):
        memory[i], memory[d + i] = q[i], p[i]
    fill(parameters.graph, 2, parameters.two_form)


@kept(error_model='numpy')
def _fill_forms(parameters: FormParameters, z: np.ndarray, two_forms: np.ndarray) -> None:
    d = z.shape[1] // 2
    for k in range(z.shape[0]):
        _fill_form(parameters, z[k, :d], z[k, d:])
        two_forms[k] = parameters.two_form


@part(error_model='numpy')
def raise_index(parameters: FormParameters, q: np.ndarray, p: np.ndarray, covector: np.ndarray
                ) -> None:
    """Replace a covector c, shape (2 d,), by W(u)^-1 c at one state; NaN if W is singular."""
    _fill_form(parameters, q, p)
    if not solve_linear(parameters.two_form, covector):
        covector[:] = np.nan


@called
def _gradient(parameters: FormParameters, q: np.ndarray, p: np.ndarray,
              dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    d = parameters.two_form.shape[0] // 2
    rates = np.empty(2 * d)
    for a in range(0, q.size, d):
        slope(parameters, q[a:a + d], p[a:a + d], rates)
        raise_index(parameters, q[a:a + d], p[a:a + d], rates)
        for i in range(d):
            dH_dp[a + i], dH_dq[a + i] = rates[i], -rates[d + i]


def _hessian_vector(parameters: FormParameters, q: np.ndarray, p: np.ndarray, v_q: np.ndarray,
                    v_p: np.ndarray, product_q: np.ndarray, product_p: np.ndarray) -> None:
    """Fill the derivative of (-p', q'), by a central difference."""
    size = max(np.abs(v_q).max(), np.abs(v_p).max())
    if size == 0.0:
        product_q[:], product_p[:] = 0.0, 0.0
        return
    spacing = _SPACING / size * max(np.abs(q).max(), np.abs(p).max(), 1.0)
    behind_q, behind_p = np.empty_like(q), np.empty_like(p)
    _gradient(parameters, q + spacing * v_q, p + spacing * v_p, product_q, product_p)
    _gradient(parameters, q - spacing * v_q, p - spacing * v_p, behind_q, behind_p)
    for i in range(q.size):
        product_q[i] = (product_q[i] - behind_q[i]) / (2.0 * spacing)
        product_p[i] = (product_p[i] - behind_p[i]) / (2.0 * spacing)
