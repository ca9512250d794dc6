# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Which 2-form each method conserves, and which it does not."""

from helpers import (
    exact, GENERIC, jacobian, long, Method, METHODS, python_gradient, python_step,
    staggered, symplectic_defect)
from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import check_method, INTEGRATORS
from mpmath import mpf
import numpy as np
import pytest

H = mpf('0.1')
STATE = ['0.7', '-1.2']
SYMPLECTIC = [method for method in GENERIC if method.chart is not None]


def derivative(name: str, hamiltonian_name: str) -> np.ndarray:
    """Return the derivative of one step at STATE."""
    hamiltonian, integrator = HAMILTONIANS[hamiltonian_name](), INTEGRATORS[name]()
    return jacobian(lambda z: python_step(integrator, hamiltonian, H, z), exact(STATE))


def test_methods_table_covers_every_integrator_and_its_claim():
    # Those that take other coordinates have tests of their own: test_symplectic_form.py, and
    # test_lie_methods.py.
    assert {method.name for method in METHODS} == {
        name for name, method in INTEGRATORS.items()
        if method.requirements.coordinates in ('canonical', 'any')}
    for method in METHODS:
        assert method.integrator.requirements.symplectic == (method.chart is not None)


@pytest.mark.parametrize('method', SYMPLECTIC, ids=str)
@pytest.mark.parametrize('name', [long('harmonic_oscillator'), 'tao'])
def test_method_is_symplectic_in_its_own_two_form(method: Method, name: str, measured):
    hamiltonian, z = HAMILTONIANS[name](), exact(STATE)
    try:
        check_method(method.integrator, hamiltonian)
    except UnsupportedSystem:
        assert not hamiltonian.separable
        return

    def chart(z: np.ndarray) -> np.ndarray:
        return method.chart(hamiltonian, H, z)

    def step(z: np.ndarray) -> np.ndarray:
        return python_step(method.integrator, hamiltonian, H, z)

    before, after = jacobian(chart, z), jacobian(chart, step(z))
    inverse = np.array([[before[1, 1], -before[0, 1]], [-before[1, 0], before[0, 0]]])
    inverse = inverse / (before[0, 0] * before[1, 1] - before[0, 1] * before[1, 0])
    # Solved to 55 digits and differentiated with 40: anything but zero would show.
    defect = symplectic_defect(after.dot(jacobian(step, z)).dot(inverse))
    measured('symplectic defect in its own 2-form, 60 digits', f'{method.name}, {name}', defect,
             '<= 1e-25')
    assert defect <= 1e-25


@pytest.mark.parametrize('name, power', [('discrete_gradient', 2), ('rk4', 4),
                                         ('explicit_euler', 1)])
def test_method_that_claims_none_has_a_symplectic_defect(name: str, power: int):
    assert symplectic_defect(derivative(name, 'tao')) > float(H) ** (power + 2)


def test_variational_euler_naive_symplecticity_fails_by_the_predicted_amount():
    hamiltonian, z = HAMILTONIANS['tao'](), exact(STATE)
    M = derivative('variational_euler', 'tao')
    z1 = python_step(INTEGRATORS['variational_euler'](), hamiltonian, H, z)
    determinant = M[0, 0] * M[1, 1] - M[0, 1] * M[1, 0]
    # H_qp = 2 q p, and det = (1 + h H_qp(z)) / (1 + h H_qp(z1)); see the class.
    predicted = (1 + H * 2 * z[0] * z[1]) / (1 + H * 2 * z1[0] * z1[1])
    assert abs(determinant - predicted) < 1e-12
    assert abs(float(determinant) - 1.0) > 1e-3
    assert symplectic_defect(M) == pytest.approx(abs(float(predicted) - 1.0), abs=1e-12)


def test_variational_euler_is_symplectic_in_q_and_p_where_h_separates():
    assert symplectic_defect(derivative('variational_euler', 'harmonic_oscillator')) <= 1e-12


def test_explicit_euler_is_not_symplectic():
    # For the harmonic oscillator det = 1 + h^2 exactly.
    defect = symplectic_defect(derivative('explicit_euler', 'harmonic_oscillator'))
    assert defect == pytest.approx(float(H) ** 2, rel=1e-12)


def test_variational_euler_is_symplectic_euler_of_the_staggered_pair():
    """Take P = p_(n-1): q' = q + h H_p(q, p), P' = p with p = P - h H_q(q, p)."""
    hamiltonian, integrator, z = HAMILTONIANS['tao'](), INTEGRATORS['variational_euler'](), \
        exact(STATE)
    for _ in range(20):
        q, p_before = staggered(hamiltonian, H, z)
        z1 = python_step(integrator, hamiltonian, H, z)
        q1, p_staggered = staggered(hamiltonian, H, z1)
        dH_dq, dH_dp = python_gradient(hamiltonian, z)
        assert abs(q1 - (q + H * dH_dp[0])) < 1e-15
        # The staggered momentum after the step is p_n, which solves p_n = P - h H_q(q_n, p_n).
        assert abs(p_staggered - z[1]) < 1e-15
        assert abs(z[1] - (p_before - H * dH_dq[0])) < 1e-15
        z = z1
