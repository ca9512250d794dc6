# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Products with the derivatives of runs, against 60 digits and against each other."""

from helpers import (
    EPS, exact, jacobian, Method, METHODS, python_step, symplectic_defect, Uncompiled)
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.simulation import Change, DifferentiableRun
from messages import refused
from mpmath import mpf
import numpy as np
import pytest

H = 0.1
STATE, COUPLED = np.array([0.7, -1.2]), np.array([0.1, -0.4, 0.3, 0.2])
DIFFERENTIABLE = [method for method in METHODS if method.integrator.partitioned is not None]


def run_of(name: str, system: str) -> DifferentiableRun:
    """Return a run that waits for no compiler."""
    return DifferentiableRun(Uncompiled(HAMILTONIANS[system]()), INTEGRATORS[name](), H)


def derivatives(run: DifferentiableRun, z: np.ndarray, steps: int
                ) -> tuple[np.ndarray, np.ndarray]:
    """Return dz_N/dz_0, shape (2 d, 2 d), by tangents and by cotangents, of a state z."""
    unit = np.eye(z.size)
    # A trajectory for each direction: all in one run.
    run.record(np.tile(z, (z.size, 1)), 1, steps)
    forward = run.push_forward([Change(unit)])[0, 1].T
    backward, _ = run.pull_back(np.stack([np.zeros_like(unit), unit]))
    return forward, backward


# The pendulum has no sine of so many digits.
@pytest.mark.parametrize('method, coupled', [
    *((method, method.system != 'tao') for method in DIFFERENTIABLE),
    *((method, True) for method in DIFFERENTIABLE if method.name == 'gauss4')], ids=str)
def test_derivatives_of_every_method_are_those_of_60_digits(
        method: Method, coupled: bool, measured):
    system, z = ('henon_heiles', COUPLED) if coupled else (method.system, STATE)
    hamiltonian = HAMILTONIANS[system]()
    expected = jacobian(lambda z: python_step(method.integrator, hamiltonian, mpf(H), z),
                        exact(z.tolist())).astype(np.float64)
    error = max(abs(found - expected).max()
                for found in derivatives(run_of(method.name, system), z, 1))
    measured('error of the derivative of a step', f'{method.name}, {system}', error, '<= 1e-14')
    # Of entries of order one: the rounding of the solves of up to 32 equations.
    assert error <= 1e-14


@pytest.mark.parametrize('name', ['variational_euler', 'generalized_leapfrog', 'gauss4'])
def test_product_of_tangent_and_adjoint_is_constant_along_the_run(name: str, measured):
    """Hold tangent . adjoint, the pairing whose conservation makes the adjoint symplectic."""
    steps, run, rng = 40, run_of(name, 'tao'), np.random.default_rng(0)
    states = run.record(STATE[None], steps)
    tangents = run.push_forward([Change(rng.normal(size=(1, 2)))])[0]
    last = rng.normal(size=(1, 2))
    products = []
    for n in range(0, steps + 1, 5):
        run.record(states[n], 1, max(steps - n, 1))
        cotangents = np.stack([np.zeros((1, 2)), last])
        adjoint = last if n == steps else run.pull_back(cotangents)[0]
        products.append(float((tangents[n] * adjoint).sum()))
    size = abs(tangents).max() * abs(last).max()
    spread = max(products) - min(products)
    measured('spread of tangent . adjoint in 40 steps, relative', name, spread / size,
             '<= 40 * 64 eps')
    assert spread <= steps * 64 * EPS * size


@pytest.mark.parametrize('name', ['generalized_leapfrog', 'implicit_midpoint', 'gauss8'])
def test_adjoint_of_a_symplectic_method_is_symplectic(name: str):
    forward, backward = derivatives(run_of(name, 'tao'), STATE, 40)
    assert symplectic_defect(backward) <= 40 * 64 * EPS * abs(backward).max() ** 2
    assert abs(forward - backward).max() <= 40 * 64 * EPS * abs(backward).max()


@pytest.mark.parametrize('name', ['dop853', 'discrete_gradient', 'time_transformed'])
def test_method_without_derivatives_is_refused_by_name(name: str):
    with refused(UnsupportedSystem):
        DifferentiableRun(HAMILTONIANS['pendulum'](), INTEGRATORS[name](), H)


@pytest.mark.parametrize('kind, arguments, method', [
    ('impact', {'coordinate': 'angle', 'position': -1.0}, 'variational_euler'),
    ('thermostat', {'temperature': 1.0, 'rate': 1.0}, 'variational_euler'),
    ('servo', {'coordinates': ['angle'], 'stiffness': 1.0, 'delay': 0.01}, 'gauss4')])
def test_effect_without_derivatives_is_refused_by_name(kind: str, arguments: dict, method: str):
    effect = EFFECTS[kind](**arguments)
    with refused(UnsupportedSystem):
        DifferentiableRun(HAMILTONIANS['pendulum'](), INTEGRATORS[method](), H, [effect])


def test_too_many_unknowns_are_refused():
    chain = HAMILTONIANS['fput_chain'](32)
    with refused(UnsupportedSystem):
        DifferentiableRun(chain, INTEGRATORS['gauss16'](), H)


def test_run_of_another_instance_is_gone_back_through_bit_by_bit():
    """Of instances in a pool the first free one goes back, which may have taken no step yet."""
    one, other = (DifferentiableRun(HAMILTONIANS['pendulum'](), INTEGRATORS['gauss4'](), H)
                  for _ in range(2))
    z = np.array([[1.0, 0.5]])
    cotangents = np.ones_like(one.record(z, 300))
    assert len(one.recorded.segments) > 2
    other.recorded = one.recorded
    assert np.array_equal(other.pull_back(cotangents)[0], one.pull_back(cotangents)[0])
