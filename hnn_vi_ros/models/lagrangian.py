# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The Hamiltonian of a learned Lagrangian: its Legendre transform, compiled."""

from collections.abc import Callable
from typing import Any, NamedTuple

from hnn_vi_ros.errors import ModelError
from hnn_vi_ros.kernels import Kernel, part
from hnn_vi_ros.models.checkpoint import Checkpoint
from hnn_vi_ros.models.learned import LearnedHamiltonian
from hnn_vi_ros.models.networks import perceptron
from hnn_vi_ros.models.networks.perceptron_memory import PackedPerceptron
import numpy as np

# Number of states of the box at which L must be regular, and the allowed variation of L_vv.
_SAMPLES = 1000
_MAX_VARIATION = 1e8
_MAX_ITERATIONS = 50
# Relative changes below which Newton's method reuses the last inverse, and stops.
_REUSE_CHANGE, _STOP_CHANGE = 1e-4, 1e-15


class LagrangianParameters(NamedTuple):
    """
    Parameters of the functions of a Legendre transform, their first argument.

    Parameters
    ----------
    network : PackedPerceptron
        N(q, v).
    mass : np.ndarray, shape (d, d)
        M.
    start : np.ndarray, shape (d,)
        Newton's method starts from v = start + start_slope p.
    start_slope : np.ndarray, shape (d, d)
        See ``start``.
    v, L_q, L_v : np.ndarray, shape (d,)
        The velocity, and the derivatives of L there.
    zero, unit, along_q, along_v, change : np.ndarray, shape (d,)
        Zeros, and workspace for directions, products of N'' with them, and Newton steps.
    L_vv, inverse : np.ndarray, shape (d, d)
        Workspace of the elimination, and L_vv^-1.

    """

    network: PackedPerceptron
    mass: np.ndarray
    start: np.ndarray
    start_slope: np.ndarray
    v: np.ndarray
    L_q: np.ndarray
    L_v: np.ndarray
    zero: np.ndarray
    unit: np.ndarray
    along_q: np.ndarray
    along_v: np.ndarray
    change: np.ndarray
    L_vv: np.ndarray
    inverse: np.ndarray


class LagrangianHamiltonian(LearnedHamiltonian):
    """
    H(q, p) = p . v - L(q, v), where L_v(q, v) = p, for L = v . M v / 2 + N(q, v).

    M is the mass matrix of the model card, N the network ``lagrangian``. Each evaluation computes
    v by Newton's method, from an initial guess that does not depend on earlier evaluations, and

        (H_q, H_p) = (-L_q, v),    L_vv v' = p' - L_vq q',

    where the last equation gives the Hessian. If Newton's method fails, all values are NaN, which
    makes a step fail.

    Parameters
    ----------
    checkpoint : Checkpoint
        A model of the family lagrangian.

    Raises
    ------
    ModelError
        L_vv is not positive definite throughout the box of the data.

    References
    ----------
    M. Cranmer, S. Greydanus, S. Hoyer, P. Battaglia, D. Spergel, S. Ho, Lagrangian Neural
    Networks, 2020, arXiv:2003.04630.

    """

    def __init__(self, checkpoint: Checkpoint):
        super().__init__(checkpoint)
        card = checkpoint.card
        self._mass = np.array(card.mass)
        assert card.velocities is not None, 'checked with the card'
        low, high = np.array([*card.box.q, *card.velocities]).T
        x = np.random.default_rng(0).uniform(low, high, (_SAMPLES, low.size))
        x[0] = 0.5 * (low + high)
        self._check(x, np.linalg.eigvalsh(self._masses(x)))
        self._centre = x[:1]

    def _check(self, x: np.ndarray, masses: np.ndarray) -> None:
        worst = masses[:, 0].argmin()
        if not 0.0 < masses.max() < _MAX_VARIATION * masses.min():
            q, v = np.split(x[worst], 2)
            raise ModelError(
                'the learned Lagrangian is singular in its training domain: at q = '
                f'{q.round(3).tolist()}, v = {v.round(3).tolist()} the smallest eigenvalue of '
                f'L_vv is {masses[worst, 0]:.3g}, expected > 0; train it longer or on more data')

    def _masses(self, x: np.ndarray) -> np.ndarray:
        """Return L_vv, shape (m, d, d), at points (q, v) of shape (m, 2 d)."""
        q, v = (np.ascontiguousarray(part).ravel() for part in np.split(x, 2, axis=1))
        network, columns = self._packed('lagrangian'), []
        for unit in np.eye(self.dimension):
            product_q, product_v = np.empty_like(q), np.empty_like(q)
            perceptron.hessian_vector(network, q, v, np.zeros_like(q), np.tile(unit, len(x)),
                                      product_q, product_v)
            columns.append(product_v.reshape(len(x), -1))
        masses = np.stack(columns, axis=2) + self._mass
        return 0.5 * (masses + masses.transpose(0, 2, 1))

    def _kernel(self) -> Kernel:
        d = self.dimension
        inverse = np.linalg.inv(self._masses(self._centre)[0])
        network, (q, v), slope = self._packed('lagrangian'), np.split(self._centre[0], 2), \
            np.empty((2, d))
        perceptron.gradient(network, q, v, *slope)
        parameters = LagrangianParameters(
            network, self._mass, v - inverse @ (slope[1] + self._mass @ v),
            inverse, *np.zeros((8, d)), *np.zeros((2, d, d)))
        return self._kernel_of(_energy, _gradient, _hessian_vector, parameters)


def midpoint_action(checkpoint: Checkpoint) -> Callable[..., Any]:
    """
    Return the midpoint rule for the action of a learned Lagrangian, in torch.

    Parameters
    ----------
    checkpoint : Checkpoint
        A model of the family lagrangian.

    Returns
    -------
    callable
        Discrete Lagrangian; see DiscreteEulerLagrange.

    Raises
    ------
    ModelError
        The model belongs to another family.

    """
    family = checkpoint.card.family
    if family != 'lagrangian':
        raise ModelError(f'{checkpoint.card.name}: a model of the family {family} has no '
                         'Lagrangian; use one of the family lagrangian, or another integrator')
    # Imported lazily: shipped scenes run without torch.
    from hnn_vi_ros.models.torch_network import Network
    import torch
    mass = torch.tensor(checkpoint.card.mass, dtype=torch.float64)
    network = Network(checkpoint.networks['lagrangian'], checkpoint.card.activation)

    def action(q0: torch.Tensor, q1: torch.Tensor, h: float) -> torch.Tensor:
        velocity = (q1 - q0) / h
        rest: torch.Tensor = network(torch.cat([0.5 * (q0 + q1), velocity]))[0]
        return h * (0.5 * velocity @ mass @ velocity + rest)
    return action


def _energy(parameters: LagrangianParameters, q: np.ndarray, p: np.ndarray) -> float:
    mass, v = parameters.mass, parameters.v
    _solve(parameters, q, p)
    energy = -perceptron.energy(parameters.network, q, v)
    for i in range(v.size):
        energy += p[i] * v[i]
        for j in range(v.size):
            energy -= 0.5 * v[i] * mass[i, j] * v[j]
    return energy


def _gradient(parameters: LagrangianParameters, q: np.ndarray, p: np.ndarray,
              dH_dq: np.ndarray, dH_dp: np.ndarray) -> None:
    v, L_q = parameters.v, parameters.L_q
    d = v.size
    for a in range(0, q.size, d):
        _solve(parameters, q[a:a + d], p[a:a + d])
        for i in range(d):
            dH_dq[a + i], dH_dp[a + i] = -L_q[i], v[i]


def _hessian_vector(parameters: LagrangianParameters, q: np.ndarray, p: np.ndarray,
                    v_q: np.ndarray, v_p: np.ndarray, product_q: np.ndarray,
                    product_p: np.ndarray) -> None:
    network, v, inverse = parameters.network, parameters.v, parameters.inverse
    zero, along_q, along_v = parameters.zero, parameters.along_q, parameters.along_v
    d = v.size
    for a in range(0, q.size, d):
        b = a + d
        _solve(parameters, q[a:b], p[a:b])
        _invert_mass(parameters, q[a:b], v)
        perceptron.hessian_vector(network, q[a:b], v, v_q[a:b], zero, along_q, along_v)
        for i in range(d):
            product_p[a + i] = 0.0
            for j in range(d):
                product_p[a + i] += inverse[i, j] * (v_p[a + j] - along_v[j])
        perceptron.hessian_vector(network, q[a:b], v, v_q[a:b], product_p[a:b], along_q, along_v)
        for i in range(d):
            product_q[a + i] = -along_q[i]


@part(error_model='numpy')
def _solve(parameters: LagrangianParameters, q: np.ndarray, p: np.ndarray) -> None:
    """Fill v, L_q and L_v by Newton's method for L_v(q, v) = p."""
    network, mass, inverse = parameters.network, parameters.mass, parameters.inverse
    v, L_q, L_v, change = parameters.v, parameters.L_q, parameters.L_v, parameters.change
    start, start_slope = parameters.start, parameters.start_slope
    d = v.size
    for i in range(d):
        v[i] = start[i]
        for j in range(d):
            v[i] += start_slope[i, j] * p[j]
    before, held = np.inf, False
    for _ in range(_MAX_ITERATIONS):
        perceptron.part_gradient(network, q, v, L_q, L_v)
        if not held:
            _invert_mass(parameters, q, v)
        for i in range(d):
            for j in range(d):
                L_v[i] += mass[i, j] * v[j]
        size, length = 0.0, 0.0
        for i in range(d):
            change[i] = 0.0
            for j in range(d):
                change[i] += inverse[i, j] * (p[j] - L_v[j])
            size, length = max(size, abs(change[i])), max(length, abs(v[i]))
        if size <= _STOP_CHANGE * length or (size >= before and size <= 1e-10 * length):
            return
        # A step that increases the residual is halved; NaN also ends the loop here.
        scale = 1.0 if size < before else 0.5
        held, before = size <= _REUSE_CHANGE * length, size
        for i in range(d):
            v[i] += scale * change[i]
    v[:] = np.nan
    L_q[:] = np.nan


@part(error_model='numpy')
def _invert_mass(parameters: LagrangianParameters, q: np.ndarray, v: np.ndarray) -> None:
    """Fill L_vv^-1 at (q, v)."""
    network, mass = parameters.network, parameters.mass
    A, inverse = parameters.L_vv, parameters.inverse
    zero, unit = parameters.zero, parameters.unit
    along_q, along_v = parameters.along_q, parameters.along_v
    d = v.size
    for j in range(d):
        for i in range(d):
            unit[i] = 1.0 if i == j else 0.0
        perceptron.hessian_vector(network, q, v, zero, unit, along_q, along_v)
        for i in range(d):
            A[i, j], inverse[i, j] = along_v[i] + mass[i, j], unit[i]
    # Gauss-Jordan without pivoting: the matrix is positive definite in the box.
    for k in range(d):
        pivot = 1.0 / A[k, k]
        for j in range(d):
            A[k, j] *= pivot
            inverse[k, j] *= pivot
        for i in range(d):
            factor = A[i, k]
            if i != k:
                for j in range(d):
                    A[i, j] -= factor * A[k, j]
                    inverse[i, j] -= factor * inverse[k, j]
