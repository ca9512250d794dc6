# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The chain of solvers: what each attempt does, and that the chain ends in a typed failure."""

from helpers import EPS, long, plain_steps, python_kernel, Uncompiled
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.hamiltonians import Formula, Hamiltonian, HAMILTONIANS
from hnn_vi_ros.integrators import (
    anderson, fixed_point, gauss_tableau, INTEGRATORS, newton, OK, PhasePoint, solvers, SolverWork)
from hnn_vi_ros.integrators.gauss import modes_of, simplified_newton
from hnn_vi_ros.integrators.implicit_midpoint import MidpointWork
from hnn_vi_ros.integrators.newton_solver import krylov
from hnn_vi_ros.integrators.solvers import secant
from hnn_vi_ros.integrators.workspaces import History
from hnn_vi_ros.kernels import invert
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.assembly import advance, Loop
from messages import refused
import numba
import numpy as np
import pytest


def affine(problem, x, value):
    """Evaluate G(x) = M x + b."""
    value[:] = problem[0] @ x + problem[1]


def affine_tangent(problem, x, v, product):
    """Evaluate M v."""
    product[:] = problem[0] @ v


def work_for(solve, n: int) -> SolverWork:
    """Return what a solver works on; without a Jacobian where it is to do without."""
    return SolverWork.empty(n, largest_matrix=0 if solve is krylov else 10_000)


def set_scales(work: SolverWork, size: float) -> None:
    """Let residuals be relative to a size."""
    work.iterates.scale[:] = work.iterates.own_scale[:] = size


def solve_affine(solve, norm: float, n: int):
    """Solve x = M x + b for a random M of this norm."""
    rng = np.random.default_rng(n)
    matrix = rng.normal(size=(n, n))
    matrix *= norm / np.linalg.norm(matrix, 2)
    right = rng.normal(size=n)
    work, x = work_for(solve, n), right.copy()
    set_scales(work, np.abs(np.linalg.solve(np.eye(n) - matrix, right)).max())
    result = solve(affine, affine_tangent, (matrix, right), x, work, 100)
    return result, np.abs(matrix @ x + right - x).max() / work.iterates.scale[0]


def test_systems_that_are_solved_together_take_no_more_rounds_than_the_slowest_alone():
    systems = 8
    rng = np.random.default_rng(5)
    # Different eigenvalues: one combination cannot suit all. q of all systems, then p of all.
    blocks = rng.normal(size=(systems, 2, 2))
    blocks *= (0.4 / np.linalg.norm(blocks, 2, axis=(1, 2)))[:, None, None]
    right = rng.normal(size=(systems, 2))

    def solved(chosen: list[int], layout: tuple[int, int, int]):
        m = len(chosen)
        matrix = np.einsum('kij,kl->ikjl', blocks[chosen], np.eye(m)).reshape(2 * m, 2 * m)
        b = right[chosen].T.ravel()
        work, x = work_for(anderson, b.size), b.copy()
        set_scales(work, 1.0)
        work.iterates.layout[:] = layout
        outcome, _, rounds = anderson(affine, affine_tangent, (matrix, b), x, work, 100)
        assert outcome == OK
        assert x == pytest.approx(np.linalg.solve(np.eye(b.size) - matrix, b), abs=100 * EPS)
        return rounds

    alone = max(solved([k], (2, 2, 2)) for k in range(systems))
    # One more: residuals may still shrink in one system while they have settled in another.
    assert solved(list(range(systems)), (systems, 1, systems)) <= alone + 1


@pytest.mark.parametrize('norm', [0.0, 1e-3, 0.1])
@pytest.mark.parametrize('solve', [fixed_point, anderson, newton, krylov])
@pytest.mark.parametrize('n', [1, 2, 5])
def test_solver_converges_to_round_off_where_the_map_contracts(solve, norm: float, n: int):
    (outcome, residual, _), defect = solve_affine(solve, norm, n)
    assert outcome == OK
    assert residual <= 8 * EPS
    # Evaluated anew, M x rounds with n terms.
    assert defect <= 16 * EPS * n


@pytest.mark.parametrize('solve', [newton, krylov])
@pytest.mark.parametrize('n', [1, 2, 5])
def test_newton_converges_without_contraction(solve, n: int):
    (outcome, residual, _), _ = solve_affine(solve, 3.0, n)
    assert outcome == OK
    assert residual <= 8 * EPS


def test_newton_keeps_its_jacobian_while_it_converges_fast():
    """G = b + 3 R x + sin(x) / 100, R a rotation: full Newton takes a Jacobian an iteration."""
    n = 40
    rotation, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(n, n)))
    right = np.ones(n)

    def equation(problem, x, value):
        value[:] = right + 3.0 * rotation @ x + 0.01 * np.sin(x)

    def tangent(problem, x, v, product):
        product[:] = 3.0 * rotation @ v + 0.01 * np.cos(x) * v

    work, x = SolverWork.empty(n), right.copy()
    set_scales(work, 1.0)
    outcome, _, evaluations = newton(equation, tangent, None, x, work, 20)
    assert outcome == OK
    # It contracts by 0.02 / 2 at least: eight iterations, and rounding to be seen.
    assert n < evaluations <= n + 12


def test_krylov_leaves_what_does_not_act_back_out_of_the_system():
    """An integral over the step counts for no residual, which its scale says."""
    n, rng = 6, np.random.default_rng(2)
    matrix, right = rng.normal(size=(n, n)), rng.normal(size=n)
    matrix[:, n - 1] = 0.0
    work, x = work_for(krylov, n), right.copy()
    set_scales(work, 1.0)
    work.iterates.scale[n - 1] = work.iterates.own_scale[n - 1] = np.inf
    outcome, _, _ = krylov(affine, affine_tangent, (matrix, right), x, work, 20)
    assert outcome == OK
    exact = np.linalg.solve(np.eye(n) - matrix, right)
    # A residual of 8 eps, by the inverse.
    bound = 8 * EPS * np.linalg.norm(np.linalg.inv(np.eye(n) - matrix), np.inf)
    assert x[:-1] == pytest.approx(exact[:-1], abs=bound * np.abs(exact).max())


def test_memory_grows_as_the_number_of_unknowns_where_no_jacobian_fits():
    for n in (513, 1024, 4096):
        sizes = [array.size for group in SolverWork.empty(n) for array in group]
        assert max(sizes) == 31 * n
        assert sum(sizes) <= (31 + 4 + 3 + 2 * 4 + 5) * n + 2000


class Chain:
    """
    A long chain with stiff springs, and steps of the midpoint rule by one solver.

    Parameters
    ----------
    attempt : int
        Of the chain of solvers: 1 for Newton's method with a Jacobian, 2 for that without.

    """

    method, pairs = INTEGRATORS['implicit_midpoint'](), 300

    def __init__(self, attempt: int):
        hamiltonian = HAMILTONIANS['fput_chain'](self.pairs, 50.0)
        self.kernel, self.n = hamiltonian.kernel, hamiltonian.dimension
        self._loop = Loop(advance, self.kernel, self.method, attempt)

    def end(self, h: float, steps: int) -> np.ndarray:
        """Return q and p after some steps of h from a state that excites all modes."""
        rng, m, z, z1 = np.random.default_rng(0), self.pairs, *map(PhasePoint.empty, [self.n] * 2)
        z.q[:m], z.q[m:], z.p[:] = (size * rng.normal(size=k) for size, k in (
            (0.5, m), (0.02, m), (1.0, 2 * m)))
        self.kernel.gradient(self.kernel.parameters, z.q, z.p, z.dH_dq, z.dH_dp)
        q, p = np.empty((2, 1, self.n))
        size = 2 * self.n
        memory = (MidpointWork(History.empty(size), SolverWork.empty(size, largest_matrix=size),
                               *np.zeros((2, size))),)
        outcome, done, *_ = self._loop(h, 0, steps, z, z1, memory, q, p, steps)
        assert (outcome, done) == (OK, steps)
        return np.concatenate([q[0], p[0]])


@pytest.mark.long
def test_krylov_has_the_solution_of_a_jacobian_to_round_off_at_1200_unknowns():
    ends = [Chain(attempt).end(0.1, 1) for attempt in (1, 2)]
    # Residuals of N eps of the largest unknown, at most 4; h omega^2 / 2 over 1 + (h omega / 2)^2
    # is 17, by which a stretch enters its momentum.
    assert ends[1] == pytest.approx(ends[0], abs=(1 + 17) * 1200 * EPS * 4.0)


@pytest.mark.long
def test_implicit_midpoint_converges_with_order_2_by_krylov():
    chain = Chain(2)
    ends = [chain.end(0.02 / k, 10 * k) for k in (1, 2, 4, 16)]
    errors = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    # The reference is off by 1 / 16 of the last error.
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert orders == pytest.approx(2.0, abs=0.35)


@pytest.mark.long
def test_stiff_chain_beyond_a_jacobian_is_stepped_by_its_own_method_and_resumes_to_the_bit():
    """600 unknowns at h omega = 5, where no fixed-point iteration contracts."""
    def start() -> Simulation:
        rng, m = np.random.default_rng(0), 150
        q = np.concatenate([0.5 * rng.normal(size=m), 0.02 * rng.normal(size=m)])
        return Simulation(HAMILTONIANS['fput_chain'](m, 50.0), INTEGRATORS['implicit_midpoint'](),
                          0.1, q, rng.normal(size=2 * m))

    simulation, other = start(), start()
    simulation.advance(2)
    kept = simulation.snapshot()
    simulation.advance(3)
    assert (simulation.steps, simulation.rescued) == (5, 0)
    assert simulation.residual <= 600 * EPS
    other.restore(kept)
    other.advance(3)
    assert np.array_equal(simulation.q, other.q) and np.array_equal(simulation.p, other.p)


@pytest.mark.parametrize('solve', [fixed_point, secant, anderson])
def test_fixed_point_does_not_pass_on_an_iterate_that_has_not_converged(solve):
    def rotation(problem, x, value):
        value[0], value[1] = 1.0 - 3.0 * x[1] ** 3, 1.0 + 3.0 * x[0] ** 3

    work, x = SolverWork.empty(2), np.array([0.4, -0.3])
    set_scales(work, 1.0)
    outcome, residual, _ = solve(rotation, None, None, x, work, 100)
    assert outcome != OK
    assert not residual <= 8 * EPS


def test_secant_needs_fewer_evaluations_than_the_fixed_point():
    (_, _, plain), _ = solve_affine(fixed_point, 0.5, 1)
    (_, _, accelerated), _ = solve_affine(secant, 0.5, 1)
    # Half a bit an iteration against the secant, exact for an affine map after two.
    assert plain >= 50
    assert accelerated <= 4


def test_chain_solves_a_step_where_the_fixed_point_diverges():
    """Case 7 of the hard ones at a large step: h abs(H_qp) = 2 at the start."""
    arguments = (Uncompiled(HAMILTONIANS['tao']()),)
    with pytest.raises(StepFailure):
        Simulation(*arguments, INTEGRATORS['variational_euler']('fixed_point'), 1.0,
                   [1.0], [-1.0]).advance(1)
    simulation = Simulation(*arguments, INTEGRATORS['implicit_midpoint'](), 1.0, [1.0], [-1.0])
    simulation.advance(3)
    assert simulation.residual <= 16 * EPS


def test_solver_options_are_validated():
    for name, options in (('gauss4', {'solver': 'newton'}), ('gauss4', {'max_iterations': 0}),
                          ('yoshida4', {'base': 'rk4'}),
                          ('discrete_euler_lagrange', {'discrete_lagrangian': 'nothing:here'})):
        with refused(ValueError):
            INTEGRATORS[name](**options)


@pytest.mark.parametrize('steps', [2000, long(200_000)])
def test_under_solved_steps_drift_and_steps_to_round_off_do_not(steps: int):
    """The symplectic defect of M iterations is O(h^(M + 1)); the drift shows in the energy."""
    tao = HAMILTONIANS['tao']()
    simulation = Simulation(Uncompiled(tao) if steps == 2000 else tao,
                            INTEGRATORS['variational_euler'](), 0.01, [0.0], [-3.0])
    start = simulation.modified_energy
    simulation.advance(steps)
    assert abs(simulation.modified_energy / start - 1.0) < 0.02
    assert simulation.gradients / simulation.steps <= 6.0


@pytest.mark.parametrize('name, steps', [
    ('implicit_midpoint', 500), ('gauss4', 500), long('implicit_midpoint', 5000),
    long('gauss4', 5000)])
def test_angle_of_many_turns_neither_fails_nor_changes_the_energy_band(name, steps):
    """An angle of 6e5 rad is rounded to 1e-10: the momenta beside it are not known better."""
    bands = []
    for turns in (0, 100_000):
        simulation = Simulation(Uncompiled(HAMILTONIANS['double_pendulum'](1.0, 1.0, 1.0, 1.0)),
                                INTEGRATORS[name](), 0.01, [1.0, 2.0 * np.pi * turns], [0.5, 0.5])
        bands.append(np.ptp(simulation.hamiltonian.energy(*simulation.record(steps, 1))))
        assert simulation.rescued == 0
    # Rounding moves the energy by about 50 N m times 1e-10 a step, at random: sqrt(5000) of that.
    assert bands[1] == pytest.approx(bands[0], abs=1e-6)


@pytest.mark.parametrize('name', ['variational_euler', 'generalized_leapfrog',
                                  'implicit_midpoint', 'gauss4'])
def test_round_off_of_a_small_momentum_is_relative_to_itself(name):
    """R is a power of two: alone, the small system takes the same steps at any R."""
    # Two of Tao's Hamiltonians that do not act on each other, p scaled by R and 1 / R.
    tao = 'R*(x^2 + 1)*((p_x/R)^2 + 1)/2 + (y^2 + 1)*((p_y*R)^2 + 1)/(2*R)'

    def small(ratio: float) -> np.ndarray:
        end = plain_steps(INTEGRATORS[name](), python_kernel(Formula(['x', 'y'], tao, {
            'R': ratio})), 0.05, [0.7, 1.0], [0.2 * ratio, -0.5 / ratio], 100)
        return np.array([end.q[1], end.p[1] * ratio])

    # Residuals of at most 8 eps a step; relative to the large momentum 2^40 times that.
    assert small(2.0 ** 20) == pytest.approx(small(1.0), abs=100 * 8 * EPS)


@pytest.mark.parametrize('value, x, scale', [(np.nan, 0.0, np.nan), (0.0, np.nan, 0.0),
                                             (np.nan, 0.0, 0.0)])
def test_residual_of_a_lost_iterate_is_no_division_by_zero(value: float, x: float, scale: float):
    """Compiled code raises where a zero divides, plain Python on numpy's numbers does not."""
    defect = np.zeros(1)
    residual = numba.njit(solvers._residual)(
        np.array([value]), np.array([x]), np.array([scale]), defect)
    assert np.isnan(residual) and np.isnan(defect[0])


# The simplified Newton method for the stages of Gauss methods.

def with_solver(method: str, solve):
    """Return a Gauss method whose first attempt is by another solver."""
    class Other(INTEGRATORS[method]):

        def options(self, attempt: int = 0, dimension: int = 1):
            options = super().options(attempt, dimension)
            if attempt > 0:
                return options
            return options._replace(solver=options.solver._replace(solve=solve), direct=False)
    return Other()


@pytest.mark.parametrize('stages', range(2, 9))
def test_the_modes_make_up_the_matrix(stages: int):
    matrix = gauss_tableau(stages)[0]
    values, left, right = modes_of(tuple(map(tuple, matrix.tolist())))
    assert values.size == (stages + 1) // 2
    # A V = V diag(values) + E, where E is some s^2 eps of both; their condition is up to 8144.
    error = np.abs((right * values @ left).real - matrix).max()
    assert error <= stages**2 * EPS * np.linalg.cond(np.linalg.eig(matrix)[1])


@pytest.mark.parametrize('n', range(2, 9))
def test_inverse_of_a_complex_matrix(n: int):
    rng = np.random.default_rng(n)
    # Near the identity, where no row has to be exchanged.
    matrix = np.eye(n) + (rng.normal(size=(n, n)) + 1j * rng.normal(size=(n, n))) / (4.0 * n)
    flat = np.concatenate([[7.0], matrix.ravel(), [7.0]])
    assert invert(flat, 1, n)
    assert flat[0] == flat[-1] == 7.0
    residual = np.abs(flat[1:-1].reshape(n, n) @ matrix - np.eye(n)).max()
    assert residual <= 8 * n * EPS * np.linalg.cond(matrix)


@pytest.mark.parametrize('n', [2, 3])
def test_a_singular_matrix_has_no_inverse(n: int):
    assert not invert(np.zeros(n * n, dtype=complex), 0, n)


@pytest.mark.parametrize(('method', 'd', 'solver'), [
    ('gauss4', 1, simplified_newton), ('gauss4', 2, anderson), ('gauss6', 1, simplified_newton),
    ('gauss8', 2, simplified_newton), ('gauss16', 4, simplified_newton), ('gauss16', 5, anderson)])
def test_few_coordinates_have_it(method: str, d: int, solver):
    assert INTEGRATORS[method]().options(0, d).solver.solve is solver


def test_the_paper_s_iteration_is_left_as_it_is():
    assert INTEGRATORS['gauss8'](solver='fixed_point').options(0, 1).solver.solve is fixed_point


@pytest.mark.parametrize('method', ['gauss4', 'gauss10', 'gauss16'])
def test_linear_equations_take_one_correction(method: str):
    integrator = INTEGRATORS[method]()
    simulation = Simulation(Uncompiled(Formula(['x'], 'p_x^2/2 + x*p_x/8 + x^2/2')), integrator,
                            0.9, np.array([1.0]), np.array([0.3]))
    simulation.advance(1)
    # The start, what the correction gives, J, and one more where its rounding is still to be seen.
    assert simulation.gradients <= 4 * integrator.stages + 1


@pytest.mark.parametrize(('text', 'quadratic'), [
    ('(p_x^2 + p_x*p_y + 2*p_y^2)/2 + cos(x*y)', True), ('p_x^2/2 + p_y^4 + x*y', False),
    ('p_x^2/(2 + y^2) + p_y^2', False), ('p_x^2 + p_y^2 + x*p_y', False)])
def test_constant_masses_are_seen(text: str, quadratic: bool):
    assert Formula(['x', 'y'], text).kernel.quadratic == quadratic


def ends_and_gradients(integrators: tuple, hamiltonian: Hamiltonian, h: float, q: list[float],
                       p: list[float], steps: int, effects: tuple = ()
                       ) -> tuple[list[np.ndarray], list[int]]:
    """Return (q, p) after some steps, and how many gradients they took, by each method."""
    runs = [Simulation(Uncompiled(hamiltonian), integrator, h, q, p, effects)
            for integrator in integrators]
    for run in runs:
        run.advance(steps)
    return [np.concatenate([run.q, run.p]) for run in runs], [run.gradients for run in runs]


# Residuals of a few eps in a step, and neighbours part by no more than 1e3 in so short a time.
APART = 1e3 * 16 * EPS


@pytest.mark.parametrize('h', [0.1, 1.2])
def test_constant_masses_need_no_matrix_but_in_long_steps(h: float):
    """Coupled masses; the longer step does not contract, and falls back to the matrix."""
    H = Formula(['x', 'y'], '(p_x^2 + p_x*p_y + 2*p_y^2)/2 + x^2 + x^4/4 + 3*y^2 - x*y')
    (one, other), _ = ends_and_gradients(
        (INTEGRATORS['gauss8'](), with_solver('gauss8', simplified_newton)), H, h, [1.0, -0.4],
        [0.2, 0.1], 10)
    assert one == pytest.approx(other, abs=10 * APART)


@pytest.mark.parametrize(('name', 'h', 'q', 'p'), [
    ('pendulum', 0.4, [2.5], [0.0]), ('kepler', 0.1, [0.4, 0.0], [0.0, 2.0]),
    ('henon_heiles', 0.5, [0.1, 0.3], [0.2, 0.0])])
@pytest.mark.parametrize('method', ['gauss8', 'gauss16'])
def test_it_takes_the_steps_of_anderson_s_method_by_fewer_gradients(method: str, name: str,
                                                                    h: float, q, p):
    (one, other), gradients = ends_and_gradients(
        (INTEGRATORS[method](), with_solver(method, anderson)), HAMILTONIANS[name](), h, q, p, 20)
    assert one == pytest.approx(other, abs=20 * APART)
    # Without the matrix, of constant masses, rounds are cheaper and a few more.
    assert gradients[0] < 0.9 * gradients[1]


def test_forces_join_the_matrix_and_channels_follow():
    """A driven pendulum with a drag, whose work and time are channels."""
    forces = (EFFECTS['quadratic_drag'](['angle'], 0.3),
              EFFECTS['periodic_drive']('angle', amplitude=0.5, frequency=0.3))
    (one, other), gradients = ends_and_gradients(
        (INTEGRATORS['gauss12'](), with_solver('gauss12', anderson)), HAMILTONIANS['pendulum'](),
        0.2, [2.5], [0.0], 50, forces)
    assert one == pytest.approx(other, abs=50 * APART)
    assert gradients[0] < gradients[1]
