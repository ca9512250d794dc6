# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Steps whose equation has several solutions, or none."""

from functools import cached_property
import math
from types import SimpleNamespace

from helpers import Uncompiled
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.guards import make_guards
from hnn_vi_ros.guards.solutions import SolutionGuard
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.hamiltonians.base import Hamiltonian, Kernel
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.phase_space import Coordinate
from hnn_vi_ros.simulation import Simulation
import numpy as np
import pytest

pytestmark = pytest.mark.filterwarnings('ignore:.*is not a tanh network of ours')


class Wavy(Hamiltonian):
    """H = (p^2 + q^2) / 2 + q sin(5 p): eq. (6) has several solutions where 5 h > 1."""

    coordinates, separable = (Coordinate('x'),), False

    @cached_property
    def kernel(self) -> Kernel:
        def energy(_, q, p):
            return 0.5 * (p[0] ** 2 + q[0] ** 2) + q[0] * math.sin(5.0 * p[0])

        def gradient(_, q, p, dH_dq, dH_dp):
            for i in range(q.size):
                dH_dq[i] = q[i] + math.sin(5.0 * p[i])
                dH_dp[i] = p[i] + 5.0 * q[i] * math.cos(5.0 * p[i])

        def hessian_vector(_, q, p, v_q, v_p, product_q, product_p):
            for i in range(q.size):
                mixed = 5.0 * math.cos(5.0 * p[i])
                product_q[i] = v_q[i] + mixed * v_p[i]
                product_p[i] = mixed * v_q[i] + (1.0 - 25.0 * q[i] * math.sin(5.0 * p[i])) * v_p[i]

        return Kernel(energy, gradient, hessian_vector, (), 1, (0.0, 0.0), False)


def connected(q: float, p: float, h: float) -> float | None:
    """Return the solution of eq. (6) for Wavy that is connected to h = 0, by a fine path."""
    q1 = q + h * (p + 5.0 * q * math.cos(5.0 * p))
    x, n = p, 4000
    for k in range(1, n + 1):
        s = h * k / n
        for _ in range(4):
            slope = 1.0 + 5.0 * s * math.cos(5.0 * x)
            if slope < 1e-3:
                return None
            x -= (x - p + s * (q1 + math.sin(5.0 * x))) / slope
    return x


def test_step_is_the_solution_connected_to_h_0_whatever_came_before():
    mid = Simulation(Wavy(), INTEGRATORS['variational_euler'](), 0.25, [0.5], [0.3])
    afresh = Simulation(Wavy(), INTEGRATORS['variational_euler'](), 0.25, [0.5], [0.3])
    compared, unsolvable = 0, 0
    for start in np.random.default_rng(1).uniform(-1.5, 1.5, (12, 2)):
        mid.restart(start[:1], start[1:])
        # Until energy is lost: rescued steps go far.
        while mid.rescued == 0 and mid.steps < 8:
            (q,), (p,) = mid.q.copy(), mid.p.copy()
            mid.advance(1)
            expected = connected(q, p, 0.25)
            assert mid.unsolvable == (expected is None)
            if expected is not None:
                afresh.restart([q], [p])
                afresh.advance(1)
                # The same equation, whose derivative is at least 1e-3: some eps over that.
                assert [mid.p[0], afresh.p[0]] == pytest.approx([expected] * 2, abs=1e-11)
            compared, unsolvable = compared + 1, unsolvable + mid.unsolvable
    assert compared > 30
    assert unsolvable > 3


def test_step_without_a_solution_is_told_in_the_words_of_eq_6():
    """Tao's eq. (6) is quadratic in the new p: its discriminant says whether there is a root."""
    arguments = (Uncompiled(HAMILTONIANS['tao']()), INTEGRATORS['variational_euler'](), 0.4,
                 [0.0], [-1.5])
    simulation = Simulation(*arguments, on_failure='stop')
    with pytest.raises(StepFailure, match=r'eq. \(6\) has no solution here'):
        simulation.advance(100)
    (q,), (p,), h = simulation.q, simulation.p, 0.4
    q1 = q + h * (q * q + 1.0) * p
    assert 1.0 - 4.0 * h * q1 * (h * q1 - p) < 0.0
    going_on = Simulation(*arguments)
    going_on.advance(simulation.steps)
    assert going_on.unsolvable == 0
    going_on.advance(1)
    assert going_on.unsolvable == going_on.rescued == 1


def tao(name: str, h: float, q: float, p: float) -> Simulation:
    """Return a simulation of Tao's Hamiltonian, uncompiled."""
    return Simulation(Uncompiled(HAMILTONIANS['tao']()), INTEGRATORS[name](), h, [q], [p])


def test_rescued_steps_of_symplectic_euler_keep_its_modified_energy():
    simulation = tao('symplectic_euler', 0.4, 0.0, -2.0)
    for _ in range(40):
        before, rescued = simulation.modified_energy, simulation.rescued
        simulation.advance(1)
        if simulation.rescued > rescued:
            # The midpoint rule in 16 parts, of order 2.
            assert simulation.modified_energy == pytest.approx(before, rel=1e-2)
    assert simulation.rescued > 0


def test_rescue_in_the_staggered_pair_brings_the_energy_back_and_can_be_resumed():
    """Sub-steps of the pair (q, p) itself lost 0.4 of the modified energy here, for good."""
    simulation, resumed = tao('variational_euler', 0.3, 0.0, -2.0), tao(
        'variational_euler', 0.3, 0.0, -2.0)
    start = simulation.modified_energy
    while simulation.rescued == 0:
        simulation.advance(1)
    # Amid steps that have no solution.
    resumed.restore(simulation.snapshot())
    energies = []
    for _ in range(200):
        simulation.advance(1)
        energies.append(simulation.modified_energy)
    # Close to the fold H~ is kept to its next term in h abs(H_qp), about 1: on average, measured
    # 2 %.
    assert np.mean(energies) == pytest.approx(start, rel=0.1)
    resumed.advance(200)
    assert (resumed.q[0], resumed.p[0]) == (simulation.q[0], simulation.p[0])


@pytest.mark.parametrize('kind', SolutionGuard.KINDS)
def test_solution_guard_raises_its_alarm_once(kind):
    simulation = Simulation(Wavy(), INTEGRATORS['variational_euler'](), 0.05, [0.5], [0.3])
    guard, = (guard for guard in make_guards(
        simulation, lambda sample: 1.0, 0.05, 0.02, None) if guard.kind == kind)
    sample = SimpleNamespace(step=1)
    assert guard.update(sample) is None
    simulation.several_solutions, simulation.unsolvable = 3, 3
    assert 'in 3 steps so far; use a smaller step_size' in guard.update(sample).message
    assert guard.update(sample) is None
    assert guard.renew(sample).value == 3
