# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Variational integrators for bodies that turn: order, structure, invariants, and failures."""

from collections.abc import Callable
from functools import cache, cached_property
from typing import Any
import warnings

from helpers import (
    exact, long, mostly_long, plain_steps, python_kernel, python_step, Uncompiled)
from hnn_vi_ros import simulate
from hnn_vi_ros.effects import EFFECTS
from hnn_vi_ros.errors import HnnViRosError, StepFailure, UnsupportedSystem
from hnn_vi_ros.hamiltonians import Hamiltonian, HAMILTONIANS
from hnn_vi_ros.hamiltonians.free_rigid_body import FreeRigidBody
from hnn_vi_ros.hamiltonians.heavy_top import HeavyTop
from hnn_vi_ros.hamiltonians.quadrotor import Quadrotor
from hnn_vi_ros.hamiltonians.turning_body import spatial_momentum
from hnn_vi_ros.integrators import check_method, Integrator, INTEGRATORS
from hnn_vi_ros.integrators.composition import KahanLi8, Suzuki4, Yoshida4
from hnn_vi_ros.integrators.lie.lie_leapfrog import (
    LieLeapfrog, LieSymplecticEuler, LieSymplecticEulerAdjoint, LieVariationalEuler)
from hnn_vi_ros.integrators.lie.lie_stormer_verlet import LieStormerVerlet
from hnn_vi_ros.integrators.lie.rotations import RETRACTIONS
from hnn_vi_ros.kernels import Kernel
from hnn_vi_ros.models.lie_group import LieGroupHamiltonian
from hnn_vi_ros.phase_space import check_state, Coordinate
from hnn_vi_ros.simulation import Simulation, System
from lie_group_models import random_lie_group, random_states
from messages import refused
import mpmath
from mpmath import mpf
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipj

Q = np.array([0.3, 0.1, -0.2, 0.9]) / np.linalg.norm([0.3, 0.1, -0.2, 0.9])
P = np.array([0.4, -0.7, 3.0])
# A top without symmetry, which is not integrable.
TOP = HeavyTop([1.0, 1.4, 0.8], 1.0, 0.5, 9.81)
CANONICAL = {'lie_symplectic_euler': LieSymplecticEuler,
             'lie_symplectic_euler_adjoint': LieSymplecticEulerAdjoint,
             'lie_leapfrog': LieLeapfrog}
METHODS = {**CANONICAL, 'lie_variational_euler': LieVariationalEuler}
# Of central differences in 60 digits.
SPACING = mpf(10) ** -20


def simulation(method: Integrator, h: float, hamiltonian: Hamiltonian = TOP,
               state: tuple = (Q, P), **options: str) -> Simulation:
    return Simulation(Uncompiled(hamiltonian), method, h, *state, **options)


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the product of two quaternions (x, y, z, w)."""
    vector = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    return np.array([*vector, a[3] * b[3] - a[:3].dot(b[:3])])


def euler_poisson(t: float, z: np.ndarray) -> np.ndarray:
    """Return q' and p' of the top, from Euler's equations with the torque of its weight."""
    q, p = z[:4] / np.linalg.norm(z[:4]), z[4:]
    omega = p / np.array(TOP.inertia)
    vertical = spatial_momentum(np.array([*-q[:3], q[3]]), np.array([0.0, 0.0, 1.0]))
    torque = TOP.moment * np.cross(vertical, [0.0, 0.0, 1.0])
    return np.array([*(0.5 * product(q, np.array([*omega, 0.0]))),
                     *(np.cross(p, omega) + torque)])


@cache
def reference() -> np.ndarray:
    """Return the state of the top at t = 1, of another method of another form."""
    return solve_ivp(euler_poisson, (0.0, 1.0), [*Q, *P], 'DOP853', rtol=1e-13, atol=1e-13
                     ).y[:, -1]


# Methods, and their numbers of steps in 1 s.
ORDERS = {
    **{f'{name}, {retraction}': (kind(retraction), (40, 80, 160))
       for name, kind in METHODS.items() for retraction in RETRACTIONS},
    'yoshida4': (Yoshida4('lie_leapfrog'), (20, 40, 80)),
    'suzuki4': (Suzuki4('lie_leapfrog'), (20, 40, 80)),
    'lie_stormer_verlet': (LieStormerVerlet(), (40, 80, 160)),
    'kahan_li8': (KahanLi8('lie_stormer_verlet'), (6, 9, 12)),
    'lie_gauss4': (INTEGRATORS['lie_gauss4'](), (20, 40, 80)),
    'lie_gauss8': (INTEGRATORS['lie_gauss8'](), (8, 16))}


@pytest.mark.parametrize('name', mostly_long(
    ORDERS, *(f'{name}, cayley' for name in METHODS), 'yoshida4', 'lie_stormer_verlet',
    'kahan_li8', 'lie_gauss4', 'lie_gauss8'))
def test_method_on_a_group_converges_with_its_order(name: str, measured):
    method, steps = ORDERS[name]
    errors = []
    for n in steps:
        run = simulation(method, 1.0 / n)
        run.advance(n)
        errors.append(np.linalg.norm([*run.q, *run.p] - reference()))
    slope = np.log(errors[0] / errors[-1]) / np.log(steps[-1] / steps[0])
    # The next term of the error is h times the first one. Steps of lie_gauss8 that are short
    # enough for that meet round-off: 8.9 from those of 1/5 to 1/10, 8.2 from 1/10 to 1/20.
    bound = 1.2 if name == 'lie_gauss8' else 0.25
    measured('order on the heavy top', name.partition(',')[0], slope,
             f'{method.order} +- {bound:g}')
    assert abs(slope - method.order) < bound


def step(method: Integrator, h: mpf, z: np.ndarray, hamiltonian: Hamiltonian = TOP) -> np.ndarray:
    """Take one step in 60 digits, of (q, p) in 7 numbers."""
    end = python_step(method, hamiltonian, h, np.append(z, mpf(0)))
    assert end[7] == 0
    return end[:7]


def start() -> np.ndarray:
    q, p = exact(['0.3', '0.1', '-0.2', '0.9']), exact(['0.4', '-0.7', '3'])
    return np.append(q / np.sqrt(q.dot(q)), p)


def moved(z: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Return the state turned by a small vector in the body's frame, with its momentum changed."""
    small = np.array([*(change[:3] / 2), 1 + 0 * change[0]])
    return np.append(product(z[:4], small / np.sqrt(small.dot(small))), z[4:] + change[3:])


def trivialised_jacobian(function: Callable, z: np.ndarray, spacing: Any = SPACING) -> np.ndarray:
    """Return the derivative of a map in left-trivialised variables, shape (6, 6); see jacobian."""
    there, result = function(z), []
    inverse = np.array([*-there[:3], there[3]])
    for i in range(6):
        ends = []
        for sign in (1, -1):
            change = np.array([0 * spacing] * 6)
            change[i] = sign * spacing
            end = function(moved(z, change))
            turned = product(inverse, end[:4])
            ends.append(np.append(2 * turned[:3] / turned[3], end[4:] - there[4:]))
        result.append((ends[0] - ends[1]) / (2 * spacing))
    return np.array(result).T


def two_form(p: np.ndarray) -> np.ndarray:
    """Return the canonical 2-form of T*SO(3) in left-trivialised variables."""
    hat = np.array([[0 * p[0], -p[2], p[1]], [p[2], 0 * p[0], -p[0]], [-p[1], p[0], 0 * p[0]]])
    unit, zero = np.eye(3, dtype=int), np.zeros((3, 3), dtype=int)
    return np.block([[-hat, unit], [-unit, zero]])


def defect(derivative: np.ndarray, z: np.ndarray, end: np.ndarray) -> float:
    return float(abs(derivative.T.dot(two_form(end[4:])).dot(derivative) - two_form(z[4:])).max())


EXPLICIT = {method.kernel_name: method
            for method in (LieStormerVerlet(), KahanLi8('lie_stormer_verlet'))}
SYMMETRIC = {**{f'lie_leapfrog, {retraction}': LieLeapfrog(retraction)
                for retraction in RETRACTIONS}, **EXPLICIT}
SYMPLECTIC = {
    **{f'{name}, {retraction}': kind(retraction) for name, kind in CANONICAL.items()
       for retraction in RETRACTIONS},
    'lie_gauss4': INTEGRATORS['lie_gauss4'](), 'yoshida4': Yoshida4('lie_leapfrog'), **EXPLICIT}


@pytest.fixture
def exact_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give numpy the sine and cosine of numbers of many digits."""
    for name in ('sin', 'cos'):
        monkeypatch.setattr(mpf, name, getattr(mpmath, name), raising=False)


@pytest.mark.parametrize('name', mostly_long(
    SYMPLECTIC, 'lie_leapfrog, cayley', 'lie_symplectic_euler, exponential', 'LieStormerVerlet'))
def test_method_on_a_group_is_symplectic_in_left_trivialised_form(
        name: str, exact_turns: None, measured):
    method, h, z = SYMPLECTIC[name], mpf('0.1'), start()
    derivative = trivialised_jacobian(lambda z: step(method, h, z), z)
    found = defect(derivative, z, step(method, h, z))
    measured('symplectic defect on SO(3), 60 digits', name, found, '<= 1e-25')
    assert found <= 1e-25


@pytest.mark.parametrize('name', mostly_long(
    SYMMETRIC, 'lie_leapfrog, exponential', 'LieStormerVerlet'))
def test_method_on_a_group_is_symmetric(name: str, exact_turns: None, measured):
    method, h, z = SYMMETRIC[name], mpf('0.1'), start()
    found = float(abs(step(method, -h, step(method, h, z)) - z).max())
    measured('back by -h, 60 digits', name, found, '<= 1e-45')
    assert found <= 1e-45


@pytest.mark.long
def test_spring_on_a_body_leaves_the_leapfrog_symplectic():
    spring = EFFECTS['spring'](['attitude'], point_in_body=[0.3, -0.4, 0.2], stiffness=4.0,
                               anchor=[0.1, 0.0, 1.5], rest_length=0.5)
    method, h, z = LieLeapfrog(), mpf('0.1'), start()
    joined = System(Uncompiled(TOP), [spring], method).hamiltonian
    derivative = trivialised_jacobian(lambda z: step(method, h, z, joined), z)
    assert abs(step(method, h, z, joined) - step(method, h, z)).max() > 1e-3
    assert defect(derivative, z, step(method, h, z, joined)) <= 1e-25


@pytest.mark.parametrize('retraction', mostly_long(RETRACTIONS, 'cayley'))
def test_lie_variational_euler_is_symplectic_in_the_staggered_momentum(retraction: str):
    method, h, z = LieVariationalEuler(retraction), mpf('0.1'), start()
    staggered = LieSymplecticEuler(retraction)

    def carried(z: np.ndarray) -> np.ndarray:
        """Map (g_k, mu_k) to (g_(k+1), pi_(k+1)), which no equation is solved for."""
        x = h * z[4:] / np.array([mpf(value) for value in TOP.inertia])
        tau, along = RETRACTIONS[retraction](x.dot(x) / 4), x.dot(z[4:])
        p = (z[4:] - np.cross(x, z[4:]) / 2 + tau.along * along * x
             - tau.squared * x.dot(x) * z[4:])
        turned = product(z[:4], np.array([*(tau.vector * x), 1 + tau.less_one]))
        return np.append(turned, p)
    # Eq. (6), then to the staggered pair; or to it at once, and a step of symplectic Euler.
    there, other = carried(step(method, h, z)), step(staggered, h, carried(z))
    assert abs(there - other).max() < mpf(10) ** -50
    derivative = trivialised_jacobian(lambda z: step(method, h, z), z)
    assert defect(derivative, z, step(method, h, z)) > 1e-4


@pytest.mark.parametrize('retraction', mostly_long(RETRACTIONS, 'exponential'))
def test_lie_symplectic_euler_adjoint_is_the_adjoint(retraction: str):
    h, z = mpf('0.1'), start()
    there = step(LieSymplecticEuler(retraction), h, z)
    back = step(LieSymplecticEulerAdjoint(retraction), -h, there)
    assert abs(back - z).max() < mpf(10) ** -45
    assert abs(step(LieSymplecticEuler(retraction), -h, there) - z).max() > 1e-4


@pytest.mark.parametrize('name, n', [
    ('lie_leapfrog', 20_000), long('lie_leapfrog', 1_000_000),
    long('lie_stormer_verlet', 1_000_000)])
def test_explicit_method_keeps_energy_momentum_and_norm_over_long_times(
        name: str, n: int, measured):
    top = HeavyTop()
    run = Simulation(top, INTEGRATORS[name](), 0.01, Q, P)
    q, p = run.record(n // 10, 10)
    energies, vertical = top.energy(q, p) - top.energy(Q, P), spatial_momentum(q, p)[:, 2]
    norms = abs(np.sum(q * q, axis=-1) - 1.0).max()
    drift = abs(vertical - spatial_momentum(Q, P)[2]).max()
    spin = abs(p[:, 2] - P[2]).max()
    for what, value in (('norm of R^T R - I', norms), ('vertical momentum', drift),
                        ('spin of a symmetric top', spin)):
        if n == 1_000_000:
            measured(f'{what}, 1e6 steps', f'{name}, heavy_top', value, '<= 1e-12')
        assert value <= 1e-12
    first, last = energies[:n // 100], energies[-n // 100:]
    # A band, that of the first tenth; 1e-2 of it is what the phase of samples makes of it.
    band = first.max() - first.min()
    if n == 1_000_000:
        measured('energy band [J], 1e6 steps', f'{name}, heavy_top', band, 'that of the start')
    assert abs(last.max() - first.max()) < 1e-2 * band
    assert abs(last.min() - first.min()) < 1e-2 * band


def test_free_rigid_body_follows_jacobi_elliptic_functions(measured):
    body = FreeRigidBody([1.0, 2.0, 2.5])
    I1, I2, I3 = body.inertia
    # omega_2 = 0 at the start and |p|^2 > 2 E I2: Landau and Lifshitz, eq. (37.10).
    omega1, omega3 = 0.5, 1.0
    p = np.array([omega1 * I1, 0.0, omega3 * I3])
    energy, squared = 0.5 * np.sum(p * p / body.inertia), np.sum(p * p)
    assert squared > 2.0 * energy * I2
    rate = np.sqrt((I3 - I2) * (squared - 2.0 * energy * I1) / (I1 * I2 * I3))
    modulus = ((I2 - I1) * (2.0 * energy * I3 - squared)
               / ((I3 - I2) * (squared - 2.0 * energy * I1)))
    swing = np.sqrt((2.0 * energy * I3 - squared) / (I2 * (I3 - I2)))

    def error(n: int) -> float:
        run = simulation(Suzuki4('lie_leapfrog'), 4.0 / n, body, (Q, p))
        _, found = run.record(n, 1)
        sn, cn, dn, _ = ellipj(rate * 4.0 / n * np.arange(1, n + 1), modulus)
        true = np.stack([omega1 * cn, swing * sn, omega3 * dn], axis=-1)
        return float(abs(found / body.inertia - true).max())
    coarse, fine = error(40), error(80)
    measured('order against Jacobi elliptic functions', 'suzuki4 over lie_leapfrog',
             np.log2(coarse / fine), '4 +- 0.3')
    assert abs(np.log2(coarse / fine) - 4.0) < 0.3
    assert fine < 1e-5


TURNING = {**{f'{name}, {retraction}': kind(retraction) for name, kind in METHODS.items()
              for retraction in RETRACTIONS},
           **{name: INTEGRATORS[name]() for name in ('lie_gauss8', 'lie_stormer_verlet')}}


@pytest.mark.parametrize('name', mostly_long(
    TURNING, *(f'{name}, cayley' for name in METHODS), 'lie_gauss8', 'lie_stormer_verlet'))
def test_turn_of_nearly_pi_in_one_step_fails(name: str):
    body, fast = FreeRigidBody([1.0, 1.0, 1.0]), (Q, [0.0, 0.0, 3.1])
    half = 2.0 if 'lie_leapfrog' in name else 1.0
    run = simulation(TURNING[name], half, body, fast, on_failure='stop')
    with pytest.raises(StepFailure, match='rotate by almost pi'):
        run.advance(1)
    assert run.steps == 0 and (run.q == Q).all()
    rescued = simulation(TURNING[name], half, body, fast)
    rescued.advance(1)
    assert rescued.rescued == 1
    # Sub-steps about a fixed axis: the norm of the momentum is kept.
    assert np.allclose(rescued.p, [0.0, 0.0, 3.1], rtol=0.0, atol=1e-13)


def test_newton_solves_what_the_first_solver_does_not():
    exactly, poorly = (simulation(LieLeapfrog(max_iterations=n), 0.1) for n in (100, 2))
    for run in (exactly, poorly):
        run.advance(5)
    assert poorly.rescued == 0 and poorly.gradients > exactly.gradients
    assert np.allclose(poorly.q, exactly.q, rtol=0.0, atol=1e-13)
    assert np.allclose(poorly.p, exactly.p, rtol=0.0, atol=1e-13)


def test_several_bodies_step_together_as_each_alone():
    states = [(Q, P), (product(Q, Q), 0.5 * P)]
    together = simulation(LieLeapfrog(), 0.05, state=tuple(np.array(part) for part in
                                                           zip(*states, strict=True)))
    assert together.q.shape == (2, 4) and together.p.shape == (2, 3)
    together.advance(10)
    for i, state in enumerate(states):
        alone = simulation(LieLeapfrog(), 0.05, state=state)
        alone.advance(10)
        # Solved together to round-off of the larger of them.
        assert np.allclose(together.q[i], alone.q, rtol=0.0, atol=1e-13)
        assert np.allclose(together.p[i], alone.p, rtol=0.0, atol=1e-13)


def test_methods_refuse_the_coordinates_that_they_are_not_made_for():
    for method in INTEGRATORS.values():
        needs = method.requirements
        if needs.coordinates != 'group' and needs.hamiltonian:
            with pytest.raises(UnsupportedSystem, match=r'adds to .* \(attitude\)'):
                check_method(method(), TOP)
    for kind in METHODS.values():
        with pytest.raises(UnsupportedSystem, match='rotations or poses.* none'):
            check_method(kind(), HAMILTONIANS['pendulum']())


def test_state_of_a_rotation_is_checked():
    with refused(ValueError):
        simulation(LieLeapfrog(), 0.1, state=(Q, [*P, 0.0]))
    with refused(ValueError):
        simulation(LieLeapfrog(), 0.1, state=(1.1 * Q, P))
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        with refused(ValueError):
            check_state(1e300 * Q, P, 4, (0,))
    run = simulation(LieLeapfrog(), 0.1, state=(np.round(Q, 7), P))
    assert abs(run.q @ run.q - 1.0) < 1e-15


class Beside(Hamiltonian):
    """The top between two systems of one scalar coordinate, none of which acts on another."""

    coordinates = (Coordinate('x'), Coordinate('attitude', kind='rotation'), Coordinate('y'))

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions, uncompiled."""
        flat, top = python_kernel(HAMILTONIANS['tao']()), python_kernel(TOP)

        def gradient(parameters: tuple, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
                     dH_dp: np.ndarray) -> None:
            for i, j in ((0, 0), (5, 4)):
                flat.gradient(flat.parameters, q[i:i + 1], p[j:j + 1], dH_dq[i:i + 1],
                              dH_dp[j:j + 1])
            velocity = np.zeros(4)
            top.gradient(top.parameters, q[1:5], np.append(p[1:4], 0.0), dH_dq[1:5], velocity)
            dH_dp[1:4], dH_dp[5] = velocity[:3], 0.0
        unused: Any = gradient
        return Kernel(unused, gradient, unused, (), 6, (0.0, 0.0), compiled=False, rotations=(1,))


@pytest.mark.parametrize('name, flat', [
    ('lie_variational_euler', 'variational_euler'), ('lie_symplectic_euler', 'symplectic_euler'),
    ('lie_symplectic_euler_adjoint', 'symplectic_euler_adjoint'),
    ('lie_leapfrog', 'generalized_leapfrog')])
def test_scalar_coordinates_beside_a_rotation_step_as_by_the_flat_method(name: str, flat: str):
    h, (x, p_x), (y, p_y) = 0.05, (0.7, -1.2), (-0.3, 0.4)
    method = METHODS[name]()

    mixed = plain_steps(method, Beside().kernel, h, [x, *Q, y], [p_x, *P, p_y], 20)
    alone = plain_steps(method, python_kernel(TOP), h, Q, P, 20)
    tao = python_kernel(HAMILTONIANS['tao']())
    first, last = (plain_steps(INTEGRATORS[flat](), tao, h, [q], [p], 20)
                   for q, p in ((x, p_x), (y, p_y)))
    # Each is solved to round-off, by solvers that end at different iterates.
    for found, expected in ((mixed.q, [*first.q, *alone.q, *last.q]),
                            (mixed.p, [*first.p, *alone.p[:3], *last.p, 0.0])):
        assert np.allclose(found, expected, rtol=0.0, atol=1e-13)


def test_unknown_retraction_is_refused():
    with refused(ValueError):
        LieLeapfrog('exp')


def test_scene_of_a_body_that_turns_is_simulated_and_refuses_what_it_cannot_take():
    path = simulate('free_rigid_body', 10.0, every=100)
    assert path.q.shape == (6, 4) and path.p.shape == (6, 3) and not path.alarms
    momenta = spatial_momentum(path.q, path.p)
    assert abs(momenta - momenta[0]).max() < 1e-13
    for changes in (
            {'integrator': 'rk4'},
            {'effects': [{'kind': 'thermostat', 'temperature': 1.0, 'rate': 0.1}]},
            {'initial_state': ([0.0, 0.0, 0.0, 1.0], [0.0] * 4)},
            {'initial_state': ([0.0, 0.0, 0.0, 2.0], [0.0] * 3)}):
        with refused(HnnViRosError):
            simulate('free_rigid_body', **{'duration': 0.2, **changes})


@pytest.mark.long
def test_events_of_a_body_that_turns_are_found_and_end_its_run(tmp_path):
    """Of equal moments of inertia: qz = sin(t / 2) and qw = cos(t / 2), at 1 rad/s."""
    file = tmp_path / 'ball.yaml'
    file.write_text("""\
hamiltonian: {kind: free_rigid_body, inertia: [1.0, 1.0, 1.0]}
integrator: {kind: lie_leapfrog, retraction: exponential}
step_size: 0.3
initial_state: {q: [0.0, 0.0, 0.0, 1.0], p: [0.0, 0.0, 1.0]}
events:
  - {when: attitude_qz = 0.5, direction: both, then: log}
  - {when: attitude_qw * attitude_qz = 0.499, direction: both, then: log}
  - {when: attitude_qz = -0.5, direction: down, then: stop}
""")
    run = simulate(file, 20.0)
    # sin t = 0.998, at the top of which a step of 0.3 s is over it for 0.13 s.
    top = np.arcsin(0.998)
    assert [event.t for event in run.events] == pytest.approx(
        [np.pi / 3.0, top, np.pi - top, 5.0 * np.pi / 3.0, 7.0 * np.pi / 3.0], abs=1e-12)
    assert (run.t[-1], run.q[-1, 2]) == pytest.approx((7.0 * np.pi / 3.0, -0.5), abs=1e-12)
    assert run.q.shape == (len(run.t), 4) and run.p.shape == (len(run.t), 3)


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
    with pytest.raises(UnsupportedSystem, match='rotations or poses.* none'):
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


# Gauss collocation, and all methods on a learned H.

# Central differences of a step over 1e-5: 1e-10 times third derivatives, and round-off 1e-11.
DIFFERENCES = 1e-8


def test_lie_gauss_keeps_spatial_momentum_and_norm():
    run = simulation(INTEGRATORS['lie_gauss8'](), 0.1, FreeRigidBody([1.0, 2.0, 2.5]), (Q, P))
    q, p = run.record(100, 1)
    # Round-off of a hundred steps.
    assert abs(spatial_momentum(q, p) - spatial_momentum(Q, P)).max() < 1e-13
    assert abs(np.sum(q * q, axis=-1) - 1.0).max() < 1e-15


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
        d = hamiltonian.dimension
        back = plain_steps(
            METHODS['lie_leapfrog'](), python_kernel(hamiltonian), -0.1, there[:d], there[d:])
        found = abs(np.concatenate([back.q - q[0], back.p[:d - 1] - p[0]])).max()
        measured('back by -h on a learned H', f'lie_leapfrog, {kind}', found, '<= 1e-14')
        # Two steps, solved to round-off.
        assert found <= 1e-14


@pytest.mark.parametrize('name', mostly_long([*CANONICAL, 'lie_gauss4'], 'lie_leapfrog'))
def test_method_on_a_group_is_symplectic_on_a_learned_h(name: str, measured):
    def step(z: np.ndarray) -> np.ndarray:
        return learned_end(LEARNED[name](), 0.2, 1, 'rotation', (z[:4], z[4:]))

    z = np.concatenate([part[0] for part in random_states(3, 1)])
    found = defect(trivialised_jacobian(step, z, 1e-5), z, step(z))
    measured('symplectic defect on a learned H', name, found, f'<= {DIFFERENCES}')
    assert found <= DIFFERENCES
