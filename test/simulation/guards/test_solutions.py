# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Steps whose equation has several solutions, or none."""

import math

from helpers import Uncompiled
from hnn_vi_ros.errors import StepFailure
from hnn_vi_ros.hamiltonians import Formula, HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.simulation import look, make_guards, RunFacts, Simulation
from hnn_vi_ros.simulation.guards.steps import SolutionGuard
import numpy as np
import pytest
from scipy.optimize import brentq

H = 0.25


# Eq. (6) has several solutions where 5 h > 1.
WAVY = Uncompiled(Formula(['x'], '(p_x^2 + x^2)/2 + x*sin(5*p_x)'))


def wavy(name: str = 'variational_euler') -> Simulation:
    """Return a simulation of WAVY at a step size for which it has several solutions."""
    return Simulation(WAVY, INTEGRATORS[name](), H, [0.5], [0.3])


def connected(name: str, q: float, p: float) -> float:
    """
    Return the solution x of a method's equation that is connected to h = 0.

    With x = b + s h f(x), s is known for each x; along that connection it grows, until it is 1.
    NaN where that is close: where the determinant 1 - s h f' comes below 0.05, or x is far away.
    """
    if name == 'symplectic_euler_adjoint':
        base, slope = q, lambda x: p + 5.0 * x * np.cos(5.0 * p)
    else:
        q1 = q + H * (p + 5.0 * q * math.cos(5.0 * p)) if name == 'variational_euler' else q
        base, slope = p, lambda x: -(q1 + np.sin(5.0 * x))
    x = base + math.copysign(1.0, slope(base)) * np.linspace(0.0, 20.0, 20_001)
    share = (x - base) / (H * slope(x))
    end = int(np.argmax(share >= 1.0))
    if end == 0 or (H * slope(x) * np.gradient(share, x))[:end + 1].min() < 0.05:
        return math.nan
    return brentq(lambda x: x - base - H * slope(x), x[end - 1], x[end], xtol=1e-14)


@pytest.mark.parametrize('name', [
    'variational_euler', 'symplectic_euler', 'symplectic_euler_adjoint'])
def test_step_is_the_solution_connected_to_h_0_whatever_came_before(name):
    mid, afresh = wavy(name), wavy(name)
    compared, several = 0, 0
    for start in np.random.default_rng(1).uniform(-1.5, 1.5, (30, 2)):
        mid.restart(start[:1], start[1:])
        # Until energy is lost: rescued steps go far.
        while mid.rescued == 0 and mid.steps < 10:
            (q,), (p,) = mid.q.copy(), mid.p.copy()
            mid.advance(1)
            afresh.restart([q], [p])
            afresh.advance(1)
            # The same equation, whose derivative is not far below 0.05: some eps over that.
            assert [mid.q[0], mid.p[0]] == pytest.approx([afresh.q[0], afresh.p[0]], abs=1e-11)
            assert mid.rescued == afresh.rescued
            expected = connected(name, q, p)
            if not math.isnan(expected):
                found = mid.q if name == 'symplectic_euler_adjoint' else mid.p
                assert (mid.rescued, found[0]) == (0, pytest.approx(expected, abs=1e-11))
                compared += 1
        several += mid.several_solutions
    assert compared > 50
    # The adjoint's equation is linear here, and has one solution.
    assert (several > 0) == (name != 'symplectic_euler_adjoint')


def test_step_without_a_solution_is_told_in_the_words_of_eq_6():
    """Tao's eq. (6) is quadratic in the new p: its discriminant says whether there is a root."""
    arguments = (Uncompiled(HAMILTONIANS['tao']()), INTEGRATORS['variational_euler'](), 0.4,
                 [0.0], [-1.5])
    simulation = Simulation(*arguments, on_failure='stop')
    with pytest.raises(StepFailure, match=r'eq. \(6\) has no solution .*det\(I \+ h H_qp\)'):
        simulation.advance(100)
    (q,), (p,), h = simulation.q, simulation.p, 0.4
    q1 = q + h * (q * q + 1.0) * p
    assert 1.0 - 4.0 * h * q1 * (h * q1 - p) < 0.0
    going_on = Simulation(*arguments)
    going_on.advance(simulation.steps)
    assert going_on.rescued == 0
    going_on.advance(1)
    assert going_on.rescued == 1


def test_solution_guard_raises_its_alarm_once():
    simulation = wavy()
    guard, = make_guards(RunFacts(simulation), (SolutionGuard,))
    assert guard.update(look(simulation)) is None
    simulation.several_solutions = 3
    alarm = guard.update(look(simulation))
    assert 'in 3 steps so far; the solution connected to h = 0' in alarm.message
    assert guard.update(look(simulation)) is None
    assert np.isfinite(guard.renew(look(simulation)).value)


def test_run_that_is_resumed_takes_the_same_solutions_bit_by_bit():
    run, resumed = wavy(), wavy()
    run.advance(3)
    snapshot, several = run.snapshot(), run.several_solutions
    expected = run.record(40, 1)
    assert run.several_solutions > several
    resumed.restore(snapshot)
    assert np.array_equal(resumed.record(40, 1), expected)


def test_trajectories_together_take_the_solutions_that_each_takes_alone():
    starts = np.random.default_rng(2).uniform(-1.0, 1.0, (4, 2))
    alone, compared = wavy(), 0
    together = Simulation(WAVY, INTEGRATORS['variational_euler'](), H, starts[:, :1],
                          starts[:, 1:])
    for _ in range(8):
        before = together.q.ravel().copy(), together.p.ravel().copy()
        together.advance(1)
        if together.rescued:
            break
        for q, p, end in zip(*before, together.p.ravel(), strict=True):
            alone.restart([q], [p])
            alone.advance(1)
            # As above; all of them are iterated until the last one has converged.
            assert end == pytest.approx(alone.p[0], abs=1e-11)
            compared += 1
    assert compared >= 8
