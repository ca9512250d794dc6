# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The simplified Newton method for the stages of Gauss methods."""

from helpers import EPS, Uncompiled
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.hamiltonians.formula import Formula
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.integrators.gauss import gauss_tableau, modes_of, simplified_newton
from hnn_vi_ros.integrators.solvers import anderson, fixed_point
from hnn_vi_ros.kernels.linear_algebra import invert
from hnn_vi_ros.simulation import Simulation
import numpy as np
import pytest


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


@pytest.mark.parametrize('h', [0.1, 1.2])
def test_constant_masses_need_no_matrix_but_in_long_steps(h: float):
    """Coupled masses; the longer step does not contract, and falls back to the matrix."""
    text, ends = '(p_x^2 + p_x*p_y + 2*p_y^2)/2 + x^2 + x^4/4 + 3*y^2 - x*y', []
    for integrator in (INTEGRATORS['gauss8'](), with_solver('gauss8', simplified_newton)):
        simulation = Simulation(Uncompiled(Formula(['x', 'y'], text)), integrator, h,
                                np.array([1.0, -0.4]), np.array([0.2, 0.1]))
        simulation.advance(10)
        ends.append(np.concatenate([simulation.q, simulation.p]))
    # Residuals of a few eps in a step, and neighbours part by no more than 1e3 in so short a time.
    assert ends[0] == pytest.approx(ends[1], abs=1e3 * 16 * EPS * 10)


@pytest.mark.parametrize(('name', 'h', 'q', 'p'), [
    ('pendulum', 0.4, [2.5], [0.0]), ('kepler', 0.1, [0.4, 0.0], [0.0, 2.0]),
    ('henon_heiles', 0.5, [0.1, 0.3], [0.2, 0.0])])
@pytest.mark.parametrize('method', ['gauss8', 'gauss16'])
def test_it_takes_the_steps_of_anderson_s_method_by_fewer_gradients(method: str, name: str,
                                                                    h: float, q, p):
    steps, ends, gradients = 20, [], []
    for integrator in (INTEGRATORS[method](), with_solver(method, anderson)):
        simulation = Simulation(
            Uncompiled(HAMILTONIANS[name]()), integrator, h, np.array(q), np.array(p))
        simulation.advance(steps)
        ends.append(np.concatenate([simulation.q, simulation.p]))
        gradients.append(simulation.gradients)
    # Residuals of a few eps in a step, and neighbours part by no more than 1e3 in so short a time.
    assert ends[0] == pytest.approx(ends[1], abs=1e3 * 16 * EPS * steps)
    # Without the matrix, of constant masses, rounds are cheaper and a few more.
    assert gradients[0] < 0.9 * gradients[1]


def test_forces_join_the_matrix_and_channels_follow():
    """A driven pendulum with a drag, whose work and time are channels."""
    ends, gradients = [], []
    for integrator in (INTEGRATORS['gauss12'](), with_solver('gauss12', anderson)):
        forces = [EFFECTS['quadratic_drag'](['angle'], 0.3),
                  EFFECTS['periodic_drive']('angle', amplitude=0.5, frequency=0.3)]
        simulation = Simulation(Uncompiled(HAMILTONIANS['pendulum']()), integrator, 0.2,
                                np.array([2.5]), np.array([0.0]), forces)
        simulation.advance(50)
        ends.append(np.concatenate([simulation.q, simulation.p]))
        gradients.append(simulation.gradients)
    assert ends[0] == pytest.approx(ends[1], abs=1e3 * 16 * EPS * 50)
    assert gradients[0] < gradients[1]
