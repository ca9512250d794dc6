# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Gauss collocation: Galerkin variational integrators of any even order."""

from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, ClassVar, NamedTuple, TypeVar

from hnn_vi_ros.integrators.arithmetic import copy_array, plus
from hnn_vi_ros.integrators.base import (
    NO_CONVERGENCE, OK, PartitionedTableau, PhasePoint, Requirements)
from hnn_vi_ros.integrators.equations import set_scale
from hnn_vi_ros.integrators.implicit import ImplicitIntegrator
from hnn_vi_ros.integrators.solvers import (
    anderson, GO_ON, Round, solver, SolverOptions)
from hnn_vi_ros.integrators.workspaces import NewtonWork, SolverWork
from hnn_vi_ros.kernels import inlined, invert, Kernel
import numpy as np

_EPS = float(np.finfo(np.float64).eps)
# If an iteration leaves more of the residual than this, the full matrix saves iterations.
_SLOW_RATIO = 0.1


class Modes(NamedTuple):
    """
    Eigenvalues and eigenvectors of a Runge-Kutta matrix, A = right diag(values) left.

    Parameters
    ----------
    values : np.ndarray of complex, shape (r,)
        One of each conjugate pair, and the real one if the number s of stages is odd.
    left : np.ndarray of complex, shape (r, s)
        Rows of the inverse of the eigenvector matrix.
    right : np.ndarray of complex, shape (s, r)
        Eigenvectors, doubled for a pair, so that the real part of the sum is the full sum.

    """

    values: np.ndarray
    left: np.ndarray
    right: np.ndarray

    def in_fours(self) -> 'Modes':
        """Return left and right as real matrices in groups of four, with alternating parts."""
        left = np.stack([self.left.real, self.left.imag], axis=1)
        right = np.stack([self.right.real, -self.right.imag], axis=2)
        return Modes(self.values, in_fours(left.reshape(-1, left.shape[2])),
                     in_fours(right.reshape(len(right), -1)))


@cache
def modes_of(matrix: tuple[tuple[float, ...], ...]) -> Modes:
    """Return the modes of a matrix with complex pairs and at most one real eigenvalue."""
    values, right = np.linalg.eig(np.array(matrix, dtype=complex))
    left = np.linalg.inv(right)
    noise = _EPS * float(np.linalg.cond(right))
    kept = [k for k, value in enumerate(values) if value.imag > -noise]
    share = [1.0 if abs(values[k].imag) <= noise else 2.0 for k in kept]
    return Modes(values[kept], np.ascontiguousarray(left[kept]),
                 np.ascontiguousarray(right[:, kept] * share))


def in_fours(matrix: np.ndarray) -> np.ndarray:
    """Return a matrix of shape (r, s) as ``add_up`` reads it: (ceil(r / 4), s, 4), zero-padded."""
    rows, several = matrix.shape
    padded = np.zeros((rows + -rows % 4, several), matrix.dtype)
    padded[:rows] = matrix
    return np.ascontiguousarray(padded.reshape(-1, 4, several).transpose(0, 2, 1))


@inlined
def add_up(matrix: np.ndarray, numbers: np.ndarray, first: int, n: int, sums: np.ndarray) -> None:
    """Fill ``sums`` with a matrix in groups of four times numbers[first + k n], in registers."""
    for block in range(matrix.shape[0]):
        a, b, c, d = 0.0, 0.0, 0.0, 0.0
        for k in range(matrix.shape[1]):
            number = numbers[first + k * n]
            a += matrix[block, k, 0] * number
            b += matrix[block, k, 1] * number
            c += matrix[block, k, 2] * number
            d += matrix[block, k, 3] * number
        sums[4 * block], sums[4 * block + 1] = a, b
        sums[4 * block + 2], sums[4 * block + 3] = c, d


class ModesWork(NamedTuple):
    """
    Matrices of the simplified Newton method in the eigenvectors of A.

    Parameters
    ----------
    inverses : np.ndarray of complex, shape (r, N)
        Inverse of I - mu J for each eigenvalue, for all systems in sequence.
    factors, products : np.ndarray, shape (s, 4 ceil(r / 2))
        Their right-hand sides for each component, and the products: real and imaginary parts.
    direct : np.ndarray of int, shape (1,)
        1 if coordinates follow directly from the new momenta, without that matrix, else 0.
    masses : np.ndarray, shape (d, d)
        Inverse masses H_pp, used in that case.
    sums : np.ndarray, shape (4 ceil(s / 4),)
        One number for each stage.

    """

    inverses: np.ndarray
    factors: np.ndarray
    products: np.ndarray
    direct: np.ndarray
    masses: np.ndarray
    sums: np.ndarray

    @classmethod
    def empty(cls, stages: int, n: int, dtype: type = np.float64) -> 'ModesWork':
        """Return the workspace for systems of up to s / 2 coordinates, n in total."""
        d, fours = min(n, stages), -(-stages // 4) * 4
        return cls(np.zeros(((stages + 1) // 2, 2 * stages * n), dtype=complex),
                   np.zeros((stages, fours)), np.zeros((stages, fours)),
                   np.zeros(1, dtype=np.int64),
                   np.zeros((d, d), dtype), np.zeros(fours, dtype))


# J counts as one evaluation.
@solver(foresees=True, cost=1)
def simplified_newton(tangent: Callable, problem: Any, x: np.ndarray, work: SolverWork,
                      value: np.ndarray, defect: np.ndarray, at: Round) -> tuple[int, int, int]:
    """
    Solve for s stages with one matrix I - h A x J in each step.

    J = (H_pq, H_pp; -H_qq, -H_qp) is evaluated at the middle stage of the initial guess, with the
    forces. In the eigenvectors of A the matrix splits into I - mu J, one for each eigenvalue
    mu / h. With d <= s / 2 coordinates, J needs at most s products with H''.

    With constant masses, G computes coordinates from the new momenta (Gauss-Seidel). That takes a
    fifth more iterations but no matrix, which is used only if convergence is slow.

    Channels follow from G. If the last convergence rate predicts a residual below eps, the
    remaining residual is rounding.

    References
    ----------
    E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 1996, section IV.8.

    """
    direct = problem.work.direct
    if direct[0] > 0 and at.number > 1 and at.residual > _SLOW_RATIO * at.before:
        direct[0] = 0
    elif direct[0] > 0:
        copy_array(value, x)
        return GO_ON, 0, 0
    if at.state == 0 and not _invert(problem, x, work.newton):
        return NO_CONVERGENCE, 0, 0
    _correct(problem, value, x)
    return GO_ON, 0, 1


@inlined
def _invert(problem: Any, x: np.ndarray, work: NewtonWork) -> bool:
    """Fill the inverses of I - mu J, and return False if one is singular."""
    kernel, s, n = problem.kernel, problem.matrix.shape[1], problem.z.q.size
    inverses, width = problem.work.inverses, kernel.dimension
    d = width - kernel.channels
    m, middle = 2 * d, s // 2 * n
    at_q, at_p = x[middle:middle + n], x[s * n + middle:s * n + middle + n]
    v_q, v_p = work.direction[:n], work.direction[n:2 * n]
    product_q, product_p = work.product[:n], work.product[n:2 * n]
    for i in range(n):
        v_q[i], v_p[i] = 0.0, 0.0
    for column in range(m):
        for i in range(column % d, n, width):
            if column < d:
                v_q[i] = 1.0
            else:
                v_p[i] = 1.0
        kernel.hessian_vector(kernel.parameters, at_q, at_p, v_q, v_p, product_q, product_p)
        for i in range(column % d, n, width):
            v_q[i], v_p[i] = 0.0, 0.0
        for k in range(inverses.shape[0]):
            mu, to = problem.h * problem.modes.values[k], column
            for i in range(0, n, width):
                for row in range(d):
                    inverses[k, to + row * m] = -mu * product_p[i + row]
                    inverses[k, to + (d + row) * m] = mu * product_q[i + row]
                inverses[k, to + column * m] += 1.0
                to += m * m
    for k in range(inverses.shape[0]):
        for i in range(n // width):
            if not invert(inverses[k], i * m * m, m):
                return False
    return True


@inlined
def _correct(problem: Any, value: np.ndarray, x: np.ndarray) -> None:
    """Take a Newton step; ``value`` is overwritten."""
    s, n, modes = problem.matrix.shape[1], problem.z.q.size, problem.modes
    width = problem.kernel.dimension
    d = width - problem.kernel.channels
    m, at, sums = 2 * d, 0, problem.work.sums
    factors, products = problem.work.factors, problem.work.products
    inverses = problem.work.inverses
    for i in range(0, n, width):
        for j in range(2 * s):
            for a in range(j * n + i, j * n + i + d):
                value[a] -= x[a]
            for a in range(j * n + i + d, j * n + i + width):
                x[a] = value[a]
        for a in range(m):
            add_up(modes.left, value, i + a if a < d else s * n + i + a - d, n, factors[a])
        for a in range(m):
            for k in range(modes.values.size):
                re, im = 0.0, 0.0
                for b in range(m):
                    entry = inverses[k, at + a * m + b]
                    re += entry.real * factors[b, 2 * k] - entry.imag * factors[b, 2 * k + 1]
                    im += entry.real * factors[b, 2 * k + 1] + entry.imag * factors[b, 2 * k]
                products[a, 2 * k], products[a, 2 * k + 1] = re, im
            add_up(modes.right, products[a], 0, 1, sums)
            first = i + a if a < d else s * n + i + a - d
            for j in range(s):
                x[first + j * n] += sums[j]
        at += m * m


class Tableau(NamedTuple):
    """
    Coefficients of a collocation method of s stages, and its solver.

    Parameters
    ----------
    matrix : np.ndarray, shape (s, s)
        a_ij, the integral of the j-th Lagrange polynomial from 0 to c_i.
    weights : np.ndarray, shape (s,)
        b_j, the same integral from 0 to 1.
    start : np.ndarray, shape (s, s)
        Integral from 1 to 1 + c_i, which extrapolates the collocation polynomial by a step.
    solver : SolverOptions
        Options of the solver of the stages.
    modes : Modes
        Eigenvectors of the matrix.
    direct : bool
        True if coordinates may follow from the new momenta directly; see Kernel.quadratic.

    """

    matrix: np.ndarray
    weights: np.ndarray
    start: np.ndarray
    solver: SolverOptions
    modes: Modes
    direct: bool = False


class StageSlopes(NamedTuple):
    """
    Slopes used for the initial guess of the next step.

    Parameters
    ----------
    count : np.ndarray, shape (1,)
        1 if slopes of the previous step are stored, else 0.
    slopes : np.ndarray, shape (2 s n,)
        H_q at all stages, then H_p.

    """

    count: np.ndarray  # type: ignore[assignment]  # not tuple.count
    slopes: np.ndarray


class GaussWork(NamedTuple):
    """
    Workspace of the equation for the stages.

    Parameters
    ----------
    kept : StageSlopes
        Slopes for the next initial guess.
    solver : SolverWork
        Arrays of the solvers.
    modes : ModesWork
        Further arrays of the simplified Newton method.
    stages : np.ndarray, shape (2 s n,)
        q of all stages, then p.

    """

    kept: StageSlopes
    solver: SolverWork
    modes: ModesWork
    stages: np.ndarray


class _StageEquation(NamedTuple):
    """The equation for the stages; arrays of shape (s n,) hold all stages in sequence."""

    kernel: Kernel
    h: float
    matrix: np.ndarray
    modes: Modes
    work: ModesWork
    z: PhasePoint
    q: np.ndarray
    p: np.ndarray
    dH_dq: np.ndarray
    dH_dp: np.ndarray


@cache
def gauss_tableau(stages: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return matrix, weights and start of the Gauss method; see Tableau.

    Each integral of a polynomial of degree s - 1 is computed by Gauss quadrature, which is exact
    for it.
    """
    nodes, weights = np.polynomial.legendre.leggauss(stages)
    nodes, weights = 0.5 * (nodes + 1.0), 0.5 * weights

    def lagrange(j: int, t: np.ndarray) -> np.ndarray:
        others = np.delete(nodes, j)
        return np.prod((t[..., None] - others) / (nodes[j] - others), axis=-1)

    def integrals(low: np.ndarray, high: np.ndarray) -> np.ndarray:
        t = low[:, None] + (high - low)[:, None] * nodes
        return np.array([(high - low) * (lagrange(j, t) @ weights) for j in range(stages)]).T

    zero, one = np.zeros(stages), np.ones(stages)
    return integrals(zero, nodes), weights, integrals(one, 1.0 + nodes)


class Collocation(ImplicitIntegrator):
    """Methods with one equation for s stages at the Gauss nodes; the options contain s."""

    stages: ClassVar[int]  # s; the one equation solves for position and momentum of each stage

    @property
    def usual_gradients(self) -> int:
        """Return the usual number of gradients, one for each stage and evaluation."""
        return self.stages * super().usual_gradients

    def options(self, attempt: int = 0, dimension: int = 1) -> Tableau:  # type: ignore[override]
        """Return the coefficients and the options of the solver."""
        matrix, weights, start = gauss_tableau(self.stages)
        return Tableau(matrix, weights, start, super().options(attempt, dimension),
                       modes_of(tuple(map(tuple, matrix.tolist()))))


_Kind = TypeVar('_Kind', bound=Collocation)


class Gauss(Collocation):
    """
    The Gauss collocation method of s stages, order 2 s.

        Z_i = z_n + h sum_j a_ij J H'(Z_j),  z_(n+1) = z_n + h sum_j b_j J H'(Z_j)

    Variational integrator whose discrete action uses polynomials of degree s for the path and
    Gauss quadrature for the integral. Symplectic, symmetric; conserves every quadratic invariant.
    One stage would be ImplicitMidpoint. All stages are evaluated as one batch. Use `gauss8` if
    accuracy matters, and `generalized_leapfrog` for a fast bounded energy.

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, sections II.1, VI.6
    and VIII.6. J. Marsden, M. West, Discrete mechanics and variational integrators, Acta
    Numerica 2001, section 2.2.

    """

    requirements = Requirements(symmetric=True, symplectic=True)
    kernel_name = 'Gauss'

    def options(self, attempt: int = 0, dimension: int = 1) -> Tableau:  # type: ignore[override]
        """Return coefficients and options; systems of few coordinates have a special solver."""
        options = super().options(attempt, dimension)
        options = options._replace(matrix=in_fours(options.matrix), start=in_fours(options.start),
                                   modes=options.modes.in_fours())
        if options.solver.solve is not anderson or 2 * dimension > self.stages:
            return options
        return options._replace(solver=options.solver._replace(solve=simplified_newton),
                                direct=True)

    def own_times(self, kernel: Kernel) -> tuple[float, float]:
        """Return the times of a step, and of a gradient with its share of the solver."""
        return 1.5e-7, 2e-8 if 2 * kernel.dimension <= self.stages else 8e-8

    def memory(self, n: int, dtype: type = np.float64) -> tuple[GaussWork]:
        """Return the workspace of the equation."""
        (size,) = self.unknowns(n)
        kept = StageSlopes(np.zeros(1, dtype=np.int64), np.zeros(size, dtype))
        return (GaussWork(kept, SolverWork.empty(size, dtype),
                          ModesWork.empty(self.stages, n, dtype), np.zeros(size, dtype)),)

    @property
    def partitioned(self) -> PartitionedTableau:
        """Return the stages, with equal coefficients for q and p."""
        matrix, weights, _ = gauss_tableau(self.stages)
        return PartitionedTableau(matrix, matrix, weights, weights)

    @staticmethod
    @inlined
    def step(kernel: Kernel, h: float, options: Tableau, z: PhasePoint, z1: PhasePoint,
             memory: tuple[GaussWork, ...]) -> tuple[int, float, int]:
        """Take one step; see Integrator."""
        work, n, s = memory[0], z.q.size, options.weights.size
        x, kept, slopes = work.stages, work.kept, work.kept.slopes
        scale, own = work.solver.iterates.scale, work.solver.iterates.own_scale
        set_scale(scale[:n], own[:n], z.q, z.dH_dp, h, kernel, 1)
        set_scale(scale[s * n:(s + 1) * n], own[s * n:(s + 1) * n], z.p, z.dH_dq, h, kernel, 0)
        for i in range(n, s * n):
            scale[i], own[i] = scale[i - n], own[i - n]
            scale[s * n + i], own[s * n + i] = scale[s * n + i - n], own[s * n + i - n]
        # The slopes H_q and H_p at the stages stay in the workspace for the next initial guess.
        problem = _StageEquation(kernel, h, options.matrix, options.modes, work.modes, z,
                                 x[:s * n], x[s * n:], slopes[:s * n], slopes[s * n:])
        work.modes.direct[0] = 1 if options.direct and kernel.quadratic else 0
        if work.modes.direct[0] > 0:
            _find_masses(problem, work.solver.newton)
        _start(options, kept, problem, x)
        outcome, residual, rounds = options.solver.solve(
            _equation, _tangent, problem, x, work.solver, options.solver.max_iterations)
        if outcome != OK:
            kept.count[0] = 0
            return outcome, residual, rounds * s
        kept.count[0] = 1
        for i in range(n):
            dq, dp = 0.0, 0.0
            for j in range(s):
                dq += options.weights[j] * problem.dH_dp[j * n + i]
                dp -= options.weights[j] * problem.dH_dq[j * n + i]
            z1.q[i], z1.q_carry[i] = plus(z.q[i], z.q_carry[i], h * dq)
            z1.p[i], z1.p_carry[i] = plus(z.p[i], z.p_carry[i], h * dp)
            # Replaces the gradient, which scales the next solve.
            z1.dH_dq[i], z1.dH_dp[i] = -dp, dq
        return OK, residual, rounds * s


def orders_of(kind: type[_Kind], where: str = '') -> Iterator[type[_Kind]]:
    """Yield the methods of a kind with 2 to 8 stages, of order 4 to 16."""
    for stages in range(2, 9):
        order = 2 * stages
        yield type(f'{kind.__name__}{order}', (kind,), {
            'stages': stages, 'equations': (order,), 'order': order,
            '__module__': kind.__module__, '__doc__':
            f'Gauss collocation of {stages} stages{where}, order {order}; see {kind.__name__}.'})


GAUSS_METHODS = {f'gauss{method.order}': method for method in orders_of(Gauss)}


@inlined
def _find_masses(problem: _StageEquation, work: NewtonWork) -> None:
    """Fill the inverse masses from products with H''."""
    kernel, z, masses = problem.kernel, problem.z, problem.work.masses
    d, n = kernel.dimension, z.q.size
    v_q, v_p = work.direction[:n], work.direction[n:2 * n]
    product_q, product_p = work.product[:n], work.product[n:2 * n]
    for i in range(n):
        v_q[i], v_p[i] = 0.0, 0.0
    for column in range(d):
        v_p[column] = 1.0
        kernel.hessian_vector(kernel.parameters, z.q[:d], z.p[:d], v_q[:d], v_p[:d],
                              product_q[:d], product_p[:d])
        v_p[column] = 0.0
        for row in range(d):
            masses[row, column] = product_p[row]


@inlined
def _start(options: Tableau, kept: StageSlopes, problem: _StageEquation, x: np.ndarray) -> None:
    """Set the initial guess from the last collocation polynomial, or from the state."""
    z, h, sums, masses = problem.z, problem.h, problem.work.sums, problem.work.masses
    n, s, d, slopes = z.q.size, options.weights.size, problem.kernel.dimension, kept.slopes
    go_on, direct = kept.count[0] > 0 and options.solver.extrapolate, problem.work.direct[0] > 0
    for i in range(n):
        for j in range(s):
            x[j * n + i], x[(s + j) * n + i] = z.q[i], z.p[i]
        if go_on:
            add_up(options.start, slopes, i, n, sums)
            for j in range(s):
                x[(s + j) * n + i] -= h * sums[j]
    if direct:
        for first in range(s * n, 2 * s * n, d):
            for row in range(d):
                slopes[first + row] = 0.0
                for column in range(d):
                    slopes[first + row] += masses[row, column] * x[first + column]
    if go_on or direct:
        for i in range(n):
            add_up(problem.matrix if direct else options.start, slopes, s * n + i, n, sums)
            for j in range(s):
                x[j * n + i] += h * sums[j]


@inlined
def _equation(problem: _StageEquation, x: np.ndarray, value: np.ndarray) -> None:
    z, s, sums, h = problem.z, problem.matrix.shape[1], problem.work.sums, problem.h
    n = z.q.size
    problem.kernel.gradient(problem.kernel.parameters, x[:s * n], x[s * n:],
                            problem.dH_dq, problem.dH_dp)
    for i in range(n):
        add_up(problem.matrix, problem.dH_dq, i, n, sums)
        for j in range(s):
            value[(s + j) * n + i] = z.p[i] + (z.p_carry[i] - h * sums[j])
    if problem.work.direct[0] > 0:
        _renew_velocities(problem, x, value)
    for i in range(n):
        add_up(problem.matrix, problem.dH_dp, i, n, sums)
        for j in range(s):
            value[j * n + i] = z.q[i] + (z.q_carry[i] + h * sums[j])


@inlined
def _renew_velocities(problem: _StageEquation, x: np.ndarray, value: np.ndarray) -> None:
    """Update H_p to the new momenta, using the inverse masses."""
    d, masses, half = problem.kernel.dimension, problem.work.masses, problem.dH_dp.size
    for first in range(0, half, d):
        for row in range(d):
            for column in range(d):
                at = half + first + column
                problem.dH_dp[first + row] += masses[row, column] * (value[at] - x[at])


@inlined
def _tangent(problem: _StageEquation, x: np.ndarray, v: np.ndarray, product: np.ndarray) -> None:
    n, s, sums = problem.z.q.size, problem.matrix.shape[1], problem.work.sums
    # Free until the next evaluation of the equation fills these arrays.
    at_q, at_p = problem.dH_dq, problem.dH_dp
    problem.kernel.hessian_vector(problem.kernel.parameters, x[:s * n], x[s * n:],
                                  v[:s * n], v[s * n:], at_q, at_p)
    for i in range(n):
        add_up(problem.matrix, at_p, i, n, sums)
        for j in range(s):
            product[j * n + i] = problem.h * sums[j]
        add_up(problem.matrix, at_q, i, n, sums)
        for j in range(s):
            product[(s + j) * n + i] = -problem.h * sums[j]
