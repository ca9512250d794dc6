# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Störmer-Verlet on a group, and its composition of order 8."""

from helpers import mostly_long, Uncompiled
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.hamiltonians.free_rigid_body import FreeRigidBody
from hnn_vi_ros.hamiltonians.quadrotor import Quadrotor
from hnn_vi_ros.integrators import check_method, INTEGRATORS
from hnn_vi_ros.integrators.composition import KahanLi8
from hnn_vi_ros.integrators.lie.lie_stormer_verlet import LieStormerVerlet
from hnn_vi_ros.models.lie_group import LieGroupHamiltonian
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.simulation.system import System
from lie_group_models import random_lie_group
from messages import refused
import mpmath
from mpmath import mpf
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from test_lie_methods import (
    check_order, defect, P, product, Q, simulation, start, step, trivialised_jacobian)


@pytest.fixture
def exact_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give numpy the sine and cosine of numbers of many digits."""
    for name in ('sin', 'cos'):
        monkeypatch.setattr(mpf, name, getattr(mpmath, name), raising=False)


def test_lie_stormer_verlet_converges_with_order_2(measured):
    check_order('lie_stormer_verlet', LieStormerVerlet(), [40, 80, 160], measured)


def test_kahan_li8_over_lie_stormer_verlet_converges_with_order_8(measured):
    check_order('kahan_li8', KahanLi8('lie_stormer_verlet'), [6, 9, 12], measured)


EXPLICIT = {method.kernel_name: method
            for method in (LieStormerVerlet(), KahanLi8('lie_stormer_verlet'))}


@pytest.mark.parametrize('name', mostly_long(EXPLICIT, 'LieStormerVerlet'))
def test_explicit_method_on_a_group_is_symplectic_and_symmetric(
        name: str, exact_turns: None, measured):
    method, h, z = EXPLICIT[name], mpf('0.1'), start()
    derivative = trivialised_jacobian(lambda z: step(method, h, z), z)
    found = defect(derivative, z, step(method, h, z))
    measured('symplectic defect on SO(3), 60 digits', method.kernel_name, found, '<= 1e-25')
    assert found <= 1e-25
    back = float(abs(step(method, -h, step(method, h, z)) - z).max())
    measured('back by -h, 60 digits', method.kernel_name, back, '<= 1e-45')
    assert back <= 1e-45


@pytest.mark.parametrize('inertia', [[1.0, 1.0, 0.5], [1.0, 0.5, 1.0], [0.5, 1.0, 1.0],
                                     [0.7, 0.7, 0.7]])
def test_free_body_of_two_equal_moments_moves_exactly(inertia: list[float]):
    body, t = FreeRigidBody(inertia), 0.8
    run = simulation(LieStormerVerlet(), t, body, (Q, P))
    run.advance(1)

    def rates(t: float, z: np.ndarray) -> np.ndarray:
        omega = z[4:] / np.array(inertia)
        return np.array([*(0.5 * product(z[:4], np.array([*omega, 0.0]))),
                         *np.cross(z[4:], omega)])
    true = solve_ivp(rates, (0.0, t), [*Q, *P], 'DOP853', rtol=1e-13, atol=1e-14).y[:, -1]
    # What the tolerances leave of it.
    assert np.allclose([*run.q, *run.p], true, rtol=0.0, atol=1e-11)


def test_pose_on_a_spring_moves_as_by_the_gauss_method():
    spring = EFFECTS['spring'](['body'], point_in_body=[0.03, -0.04, 0.02], stiffness=4.0,
                               anchor=[0.1, 0.0, 9.5], rest_length=0.5)
    state = (np.array([0.0, 0.1, 10.0, *Q]), np.array([0.1, 0.2, -0.3, 0.01, -0.02, 0.03]))
    ends = []
    for method in (KahanLi8('lie_stormer_verlet'), INTEGRATORS['lie_gauss12']()):
        run = Simulation(Uncompiled(Quadrotor()), method, 0.025, *state, effects=[spring])
        run.advance(16)
        ends.append(np.array([*run.q, *run.p]))
    # Half the step changes either by 1.5e-9 at most.
    assert np.allclose(*ends, rtol=0.0, atol=1e-8)


def test_lie_stormer_verlet_refuses_what_it_cannot_take():
    with pytest.raises(UnsupportedSystem, match='rotations and poses.* none'):
        check_method(LieStormerVerlet(), HAMILTONIANS['pendulum']())
    learned = LieGroupHamiltonian(random_lie_group('rotation'))
    for method in (LieStormerVerlet(), KahanLi8('lie_stormer_verlet')):
        with refused(UnsupportedSystem):
            check_method(method, learned)
    learned.separable = True
    for method in (LieStormerVerlet(), KahanLi8('lie_stormer_verlet')):
        with refused(UnsupportedSystem):
            check_method(method, learned)
    joined = System(FreeRigidBody([1.0, 2.0, 2.5]), [], LieStormerVerlet()).hamiltonian
    check_method(LieStormerVerlet(), joined)
