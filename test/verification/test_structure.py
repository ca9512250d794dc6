# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Reversibility, identities between methods, and what theory says is conserved exactly."""

from helpers import (
    EPS, exact, GENERIC, KINDS, long, Method, METHODS, mostly_long, python_step, Uncompiled)
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import Gauss, INTEGRATORS
from hnn_vi_ros.simulation import Simulation
from mpmath import mpf
import numpy as np
import pytest

H = mpf('0.1')
STATE = ['0.7', '-1.2']


class Gauss2(Gauss):
    """Gauss collocation of one stage, which no scene needs."""

    order, stages, equations = 2, 1, (2,)


def run(name: str, system: str, h: float, steps: int, q: list[float], p: list[float],
        arguments: tuple = (), **constants: float) -> Simulation:
    """Return a simulation after some steps; a few of them are not worth a compilation."""
    hamiltonian = HAMILTONIANS[system](**constants)
    simulation = Simulation(hamiltonian if steps > 1000 else Uncompiled(hamiltonian),
                            INTEGRATORS[name](*arguments), h, q, p)
    simulation.advance(steps)
    return simulation


@pytest.mark.parametrize('method', mostly_long(GENERIC, *KINDS))
def test_method_is_symmetric_if_and_only_if_it_says_so(method: Method, measured):
    """A step of h and one of -h return to the start; in 60 digits, so nothing is hidden."""
    z = exact(STATE)
    # numpy's sine is one of doubles only.
    hamiltonian = HAMILTONIANS[
        'harmonic_oscillator' if method.system == 'pendulum' else method.system]()
    there = python_step(method.integrator, hamiltonian, H, z)
    defect = float(max(abs(python_step(method.integrator, hamiltonian, -H, there) - z)))
    bound = '< 1e-45' if method.integrator.requirements.symmetric else '> 1e-9'
    measured('defect of symmetry, 60 digits', method.name, defect, bound)
    if method.integrator.requirements.symmetric:
        assert defect < 1e-45
    else:
        assert defect > 1e-9


@pytest.mark.parametrize('method', mostly_long(
    (m for m in METHODS if m.integrator.requirements.symmetric), *KINDS))
def test_symmetric_method_returns_with_reversed_momentum(method: Method):
    """The flow reversed by p -> -p runs back; 2 n steps of rounding, stretched by the flow."""
    steps, h = 500, 0.02
    hamiltonian = Uncompiled(method.hamiltonian)
    simulation = Simulation(hamiltonian, method.integrator, h, [1.0], [-1.0])
    simulation.advance(steps)
    back = Simulation(hamiltonian, method.integrator, h, simulation.q, -simulation.p)
    back.advance(steps)
    assert abs(back.q[0] - 1.0) < 2e-8
    assert abs(back.p[0] - 1.0) < 2e-8


def test_variational_euler_is_symplectic_euler_shifted():
    """Started from matching states, the two give one trajectory, to the rounding of n steps."""
    h, steps = 0.01, 300
    tao = Uncompiled(HAMILTONIANS['tao']())
    q0, p0 = np.array([0.7]), np.array([-1.2])
    # P_0 = p_0 + h H_q(q_0, p_0): the staggered momentum of the same state.
    staggered = p0 + h * tao.gradient(q0, p0)[0]
    paper = Simulation(tao, INTEGRATORS['variational_euler'](), h, q0, p0)
    euler = Simulation(tao, INTEGRATORS['symplectic_euler'](), h, q0, staggered)
    q_paper, p_paper = paper.record(steps, 1)
    q_euler, p_euler = euler.record(steps + 1, 1)
    tolerance = 8 * EPS * steps
    assert np.abs(q_paper - q_euler[:-1]).max() <= tolerance
    assert np.abs(p_paper - p_euler[1:]).max() <= tolerance


def test_gauss_with_one_stage_is_implicit_midpoint_to_8_eps():
    z, hamiltonian = exact(STATE), HAMILTONIANS['tao']()
    midpoint = python_step(INTEGRATORS['implicit_midpoint'](), hamiltonian, H, z)
    assert max(abs(python_step(Gauss2(), hamiltonian, H, z) - midpoint)) < 1e-45
    first, second = (Simulation(Uncompiled(hamiltonian), method, 0.1, [0.7], [-1.2])
                     for method in (Gauss2(), INTEGRATORS['implicit_midpoint']()))
    first.advance(1)
    second.advance(1)
    assert abs(first.q[0] - second.q[0]) <= 8 * EPS * 0.7
    assert abs(first.p[0] - second.p[0]) <= 8 * EPS * 1.2


@pytest.mark.parametrize('system', ['harmonic_oscillator', 'pendulum'])
def test_generalized_leapfrog_is_stormer_verlet_where_h_separates(system: str):
    # With a mass of 1, q' = p, and a method that takes that for granted would not be found.
    ours, verlet = (run(name, system, 0.01, 200, [0.7], [-1.2], mass=2.5)
                    for name in ('generalized_leapfrog', 'stormer_verlet'))
    assert abs(ours.q[0] - verlet.q[0]) <= 200 * 8 * EPS
    assert abs(ours.p[0] - verlet.p[0]) <= 200 * 8 * EPS


@pytest.mark.parametrize('lagrangian, name', [
    ('rectangle_lagrangian', 'symplectic_euler'), ('midpoint_lagrangian', 'implicit_midpoint')])
def test_discrete_euler_lagrange_is_the_hamiltonian_method_of_the_same_rule(lagrangian, name):
    ours = run('discrete_euler_lagrange', 'pendulum', 0.01, 100, [0.7], [-1.2],
               (f'helpers:{lagrangian}',))
    theirs = run(name, 'pendulum', 0.01, 100, [0.7], [-1.2])
    # D_1 L_d rounds q / h: 1 / h times eps a step, over 100 steps.
    assert abs(ours.q[0] - theirs.q[0]) <= 100 * 100 * 8 * EPS
    assert abs(ours.p[0] - theirs.p[0]) <= 100 * 100 * 8 * EPS


def test_discrete_euler_lagrange_starts_from_two_configurations():
    method = INTEGRATORS['discrete_euler_lagrange']('helpers:rectangle_lagrangian')
    pendulum, h = HAMILTONIANS['pendulum'](), 0.01
    whole = Simulation(pendulum, method, h, [0.7], [-1.2])
    q, p = whole.record(2, 1)
    q1, p1 = method.start(q[0], q[1], h)
    assert q1[0] == q[1, 0]
    # p = D_2 L_d = (q1 - q0) / h: the rounding of q over h.
    assert p1[0] == pytest.approx(p[1, 0], abs=8 * EPS / h)


@pytest.mark.parametrize('name, steps', [
    ('implicit_midpoint', 1000), ('gauss4', 1000),
    *(long(m.name, 10_000) for m in METHODS if m.name.startswith(('gauss', 'implicit')))])
def test_gauss_conserves_quadratic_invariants(name: str, steps: int, measured):
    """The energy of the harmonic oscillator is one; what is left is the rounding of its terms."""
    simulation = run(name, 'harmonic_oscillator', 0.1, steps, [1.0], [0.5])
    # Compensated summation leaves the rounding of the increments: h eps sqrt(steps) a component.
    error = abs(simulation.energy / 0.625 - 1.0)
    if steps == 10_000:
        measured('quadratic invariant after 10,000 steps', name, error, '<= 64 eps')
    assert error <= 64 * EPS


@pytest.mark.parametrize('steps', [1000, long(10_000)])
def test_discrete_gradient_conserves_energy(steps: int, measured):
    simulation = Simulation(Uncompiled(HAMILTONIANS['tao']()), INTEGRATORS['discrete_gradient'](),
                            0.05, [1.0], [-1.0])
    q, p = simulation.record(steps, 1)
    energy = simulation.hamiltonian.energy(q, p)
    # Each step conserves to the solver's 8 eps; at worst they add up.
    assert np.abs(energy / 2.0 - 1.0).max() <= 8 * EPS * steps
    if steps == 10_000:
        measured('energy error over 10,000 steps', 'discrete_gradient, tao',
                 np.abs(energy / 2.0 - 1.0).max(), '<= 1e-12')
    # On average they cancel, and the energy does not drift.
    assert np.abs(energy / 2.0 - 1.0).max() <= 1e-12


@pytest.mark.parametrize('name, limit', [('stormer_verlet', 2.0), ('yoshida4', 1.573)])
def test_explicit_method_is_stable_up_to_its_limit_of_h_omega(name: str, limit: float):
    arguments = ('stormer_verlet',) if name == 'yoshida4' else ()
    below = run(name, 'harmonic_oscillator', 0.99 * limit, 1000, [1.0], [0.0], arguments)
    assert abs(below.q[0]) < 100.0
    above = run(name, 'harmonic_oscillator', 1.02 * limit, 200, [1.0], [0.0], arguments)
    assert abs(above.q[0]) > 1e6
