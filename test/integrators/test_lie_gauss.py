# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Gauss collocation on a group, and all methods on a group on a learned H."""

from helpers import mostly_long, python_kernel
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.hamiltonians.free_rigid_body import FreeRigidBody
from hnn_vi_ros.hamiltonians.turning_body import spatial_momentum
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.integrators.base import Integrator, OK, Point
from hnn_vi_ros.integrators.composition import Suzuki4, Yoshida4
from hnn_vi_ros.models.lie_group import LieGroupHamiltonian
from lie_group_models import random_lie_group, random_states
import numpy as np
import pytest
from test_lie_methods import (
    CANONICAL, check_order, METHODS, P, product, Q, reference, simulation, two_form)

# Central differences of a step over 1e-5: 1e-10 times third derivatives, and round-off 1e-11.
DIFFERENCES = 1e-8


@pytest.mark.parametrize('order, steps', [(4, [20, 40, 80]), (8, [8, 16])])
def test_lie_gauss_converges_with_its_order(order: int, steps: list[int], measured):
    method = INTEGRATORS[f'lie_gauss{order}']()
    assert method.order == order
    if order == 4:
        check_order('lie_gauss4', method, steps, measured)
        return
    errors = []
    for n in steps:
        run = simulation(method, 1.0 / n)
        run.advance(n)
        errors.append(np.linalg.norm([*run.q, *run.p] - reference()))
    # Short of its range: 8.2 from steps of 1/10 to 1/20, 8.9 from those of 1/5.
    slope = np.log2(errors[0] / errors[1])
    measured('order on the heavy top', 'lie_gauss8', slope, '8 + 1')
    assert 7.7 < slope < 9.2


def test_lie_gauss_keeps_spatial_momentum_and_norm():
    run = simulation(INTEGRATORS['lie_gauss8'](), 0.1, FreeRigidBody([1.0, 2.0, 2.5]), (Q, P))
    q, p = run.record(100, 1)
    # Round-off of a hundred steps.
    assert abs(spatial_momentum(q, p) - spatial_momentum(Q, P)).max() < 1e-13
    assert abs(np.sum(q * q, axis=-1) - 1.0).max() < 1e-15


@pytest.mark.parametrize('name', ['lie_gauss8', 'lie_stormer_verlet'])
def test_method_fails_where_a_step_would_turn_the_body_by_nearly_pi(name: str):
    run = simulation(INTEGRATORS[name](), 1.0, FreeRigidBody([1.0, 1.0, 1.0]),
                     (Q, [0.0, 0.0, 3.1]), on_failure='stop')
    with pytest.raises(StepFailure, match='turn by nearly pi'):
        run.advance(1)
    assert run.steps == 0 and (run.q == Q).all()


LEARNED = {**METHODS, 'lie_gauss4': INTEGRATORS['lie_gauss4']}
COMPOSED = {'yoshida4': lambda: Yoshida4('lie_leapfrog'),
            'suzuki4': lambda: Suzuki4('lie_leapfrog')}


def learned_end(method: Integrator, h: float, steps: int, kind: str = 'rotation',
                state: tuple | None = None) -> np.ndarray:
    """Return (q, p) of a random network after some steps."""
    hamiltonian = LieGroupHamiltonian(random_lie_group(kind))
    q, p = random_states(hamiltonian.dimension - 1, 1)
    run = simulation(method, h, hamiltonian, state or (q[0], p[0]))
    run.advance(steps)
    return np.concatenate([run.q, run.p])


def one_step(method: Integrator, hamiltonian: LieGroupHamiltonian, h: float, state: np.ndarray
             ) -> np.ndarray:
    """Take one step of any sign from (q, p)."""
    kernel, d = python_kernel(hamiltonian), hamiltonian.dimension
    z, z1 = Point.empty(d), Point.empty(d)
    z.q[:], z.p[:d - 1] = state[:d], state[d:]
    kernel.gradient(kernel.parameters, z.q, z.p, z.dH_dq, z.dH_dp)
    assert method.step(kernel, h, method.options(), z, z1, method.memory(d))[0] == OK
    return np.concatenate([z1.q, z1.p[:d - 1]])


@pytest.fixture(scope='module')
def learned_reference() -> np.ndarray:
    """Return the state of the learned body at t = 1, to about 1e-12."""
    return learned_end(INTEGRATORS['lie_gauss12'](), 0.125, 8)


@pytest.mark.long
@pytest.mark.parametrize('name', [*LEARNED, *COMPOSED])
def test_method_on_a_group_converges_with_its_order_on_a_learned_h(
        name: str, learned_reference: np.ndarray, measured):
    method = (LEARNED | COMPOSED)[name]()
    steps = {1: (32, 64), 2: (8, 16)}.get(method.order, (4, 8))
    errors = [np.linalg.norm(learned_end(method, 1.0 / n, n) - learned_reference) for n in steps]
    slope = np.log2(errors[0] / errors[1])
    measured('order on a learned H', name, slope, f'{method.order} +- 0.4')
    # The next term of the error is h times the first one.
    assert abs(slope - method.order) < 0.4


def test_lie_leapfrog_is_symmetric_on_a_learned_h(measured):
    for kind in ('rotation', 'pose'):
        hamiltonian = LieGroupHamiltonian(random_lie_group(kind))
        q, p = random_states(hamiltonian.dimension - 1, 1)
        there = learned_end(METHODS['lie_leapfrog'](), 0.1, 1, kind)
        found = abs(one_step(METHODS['lie_leapfrog'](), hamiltonian, -0.1, there)
                    - np.concatenate([q[0], p[0]])).max()
        measured('back by -h on a learned H', f'lie_leapfrog, {kind}', found, '<= 1e-14')
        # Two steps, solved to round-off.
        assert found <= 1e-14


@pytest.mark.parametrize('name', mostly_long([*CANONICAL, 'lie_gauss4'], 'lie_leapfrog'))
def test_method_on_a_group_is_symplectic_on_a_learned_h(name: str, measured):
    method, spacing = LEARNED[name](), 1e-5
    q, p = (part[0] for part in random_states(3, 1))
    there, columns = learned_end(method, 0.2, 1, 'rotation', (q, p)), []
    inverse = np.array([*-there[:3], there[3]])
    for i in range(6):
        ends = []
        for sign in (1.0, -1.0):
            change = np.zeros(6)
            change[i] = sign * spacing
            small = np.array([*(0.5 * change[:3]), 1.0])
            end = learned_end(method, 0.2, 1, 'rotation', (
                product(q, small / np.linalg.norm(small)), p + change[3:]))
            turned = product(inverse, end[:4])
            ends.append([*(2.0 * turned[:3] / turned[3]), *(end[4:] - there[4:])])
        columns.append(np.subtract(*ends) / (2.0 * spacing))
    D = np.array(columns).T
    found = abs(D.T @ two_form(there[4:]) @ D - two_form(p)).max()
    measured('symplectic defect on a learned H', name, found, f'<= {DIFFERENCES}')
    assert found <= DIFFERENCES
