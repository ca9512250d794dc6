# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Effects on bodies that turn: derivatives, orders, work, momenta, and what is refused."""

from functools import cached_property
from typing import Any

from effect_table import assert_derivatives
from helpers import plain_run, Uncompiled
from hnn_vi_ros.effects import Effect, EffectError, EFFECTS, EffectState
from hnn_vi_ros.effects.spring import BodySpring, Elastic
from hnn_vi_ros.hamiltonians import Hamiltonian, HAMILTONIANS
from hnn_vi_ros.hamiltonians.turning_body import spatial_momentum
from hnn_vi_ros.integrators import Integrator, INTEGRATORS
from hnn_vi_ros.integrators.composition import Suzuki4, Yoshida4
from hnn_vi_ros.kernels import Kernel
from hnn_vi_ros.phase_space import Coordinate, momentum_rates
from hnn_vi_ros.simulation import Simulation, System
from messages import refused
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

MASS, INERTIA, GRAVITY = 0.8, [0.3, 0.4, 0.5], 2.0
FLYING = HAMILTONIANS['quadrotor'](MASS, INERTIA, GRAVITY)
FREE = HAMILTONIANS['quadrotor'](MASS, INERTIA, 0.0)
Q = np.array([0.3, -0.2, 0.5, *np.array([0.3, 0.1, -0.2, 0.9]) / np.sqrt(0.95)])
P = np.array([0.4, -0.3, 0.2, 0.2, -0.4, 0.5])
# A body between scalar coordinates, and one without a place behind them.
MIXED = [Coordinate('x', 'm'), Coordinate('body', 'm', kind='pose'), Coordinate('y', 'm'),
         Coordinate('z', 'm'), Coordinate('top', kind='rotation')]
ARM, OTHER_ARM = [0.3, -0.4, 0.2], [-0.1, 0.5, 0.3]

COMMAND = np.array([3.0, 0.2, -0.3, 0.1])
THRUST = ('external_force', {'coordinates': ['body_fz', 'body_rx', 'body_ry', 'body_rz'],
                             'timeout': 100.0})
DAMPING = ('damping', {'rate': [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]})
DRAG = ('quadratic_drag', {'coordinates': ['body_x', 'body_y', 'body_z'], 'coefficient': 0.3})
WEIGHT = ('gravity', {'coordinate': 'body_z', 'mass': 0.5, 'acceleration': 3.0})
SPRING = ('spring', {'point': ['body'], 'point_in_body': ARM, 'anchor': [0.1, 0.0, 1.5],
                     'stiffness': 4.0, 'rest_length': 0.5})
ALL = [WEIGHT, SPRING, DAMPING, DRAG, THRUST]


def made(*effects: tuple[str, dict[str, Any]]) -> list[Effect]:
    return [EFFECTS[kind](**arguments) for kind, arguments in effects]


def simulation(method: Integrator, h: float, *effects: tuple[str, dict[str, Any]],
               hamiltonian: Hamiltonian = FLYING, state: tuple = (Q, P), **options: str
               ) -> Simulation:
    run = plain_run(Uncompiled(hamiltonian), method, h, *state, *made(*effects), **options)
    if run.takes_commands:
        run.set_command(COMMAND)
    return run


def forces(q: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the force in space and the torque in the body of ALL and the weight of FLYING."""
    R = Rotation.from_quat(q[3:])
    along = q[:3] + R.apply(ARM) - [0.1, 0.0, 1.5]
    pull = -4.0 * (1.0 - 0.5 / np.linalg.norm(along)) * along
    velocity, rates = p[:3] / MASS, np.array(DAMPING[1]['rate'])
    force = (pull + np.array([0.0, 0.0, -MASS * GRAVITY - 1.5])
             + R.apply([0.0, 0.0, COMMAND[0]]) - 0.3 * np.linalg.norm(velocity) * velocity
             - rates[:3] * p[:3])
    return force, np.cross(ARM, R.inv().apply(pull)) + COMMAND[1:] - rates[3:] * p[3:]


def newton_euler(t: float, z: np.ndarray) -> np.ndarray:
    """Return q', p' of a rigid body under ``forces``."""
    q, p = np.array([*z[:3], *(z[3:7] / np.linalg.norm(z[3:7]))]), z[7:]
    omega, u, w = p[3:] / INERTIA, q[3:6], q[6]
    force, torque = forces(q, p)
    return np.concatenate([p[:3] / MASS, 0.5 * (w * omega + np.cross(u, omega)),
                           [-0.5 * u @ omega], force, np.cross(p[3:], omega) + torque])


@pytest.fixture(scope='module')
def reference() -> np.ndarray:
    """Return the state at t = 1 under all effects, by another method from another formula."""
    return solve_ivp(newton_euler, (0.0, 1.0), [*Q, *P], 'DOP853', rtol=1e-12, atol=1e-12
                     ).y[:, -1]


def test_rates_under_all_effects_are_those_of_newton_and_euler():
    # The damping acts around the steps of a method of order 2, and in the gradient of others.
    run = simulation(Suzuki4('lie_leapfrog'), 0.1, *ALL)
    rates = momentum_rates((3,), run.q, run.p, run.dH_dq, run.dH_dp)
    np.testing.assert_allclose(rates, newton_euler(0.0, np.append(Q, P))[7:], rtol=0.0,
                               atol=1e-14)


@pytest.mark.parametrize('name, steps', [
    ('lie_variational_euler', 80), ('lie_symplectic_euler', 80),
    ('lie_symplectic_euler_adjoint', 80), ('lie_leapfrog', 20), ('yoshida4', 10), ('suzuki4', 8)])
def test_motion_and_balance_under_all_effects_have_the_order_of_the_method(
        name: str, steps: int, reference: np.ndarray, measured):
    kind, errors, balances = INTEGRATORS[name], [], []
    method = kind('lie_leapfrog') if kind in (Yoshida4, Suzuki4) else kind()
    for n in (steps, 2 * steps):
        run = simulation(method, 1.0 / n, *ALL)
        run.advance(n)
        assert run.rescued == 0
        errors.append(np.linalg.norm([*run.q, *run.p] - reference))
        balances.append(abs(run.energy_balance))
        # Each effect that is no potential does work, and all of it counts.
        assert [name for name, work in run.works.items() if abs(work) > 1e-3] == [
            'damping', 'quadratic_drag', 'external_force']
    for what, values in (('motion', errors), ('energy balance', balances)):
        slope = np.log2(values[0] / values[1])
        measured(f'order of the {what} of a body under all effects', name, slope,
                 f'>= {method.order} - 0.35')
        assert slope > method.order - 0.35, what


@pytest.mark.parametrize('name', ['lie_symplectic_euler', 'lie_symplectic_euler_adjoint',
                                  'lie_leapfrog'])
def test_spatial_momentum_changes_by_the_discrete_impulse(name: str, measured):
    h, n = 0.05, 40
    run = simulation(INTEGRATORS[name](), h, THRUST, WEIGHT, hamiltonian=FREE)
    states = [(run.q.copy(), run.p.copy())]
    for _ in range(n):
        run.advance(1)
        states.append((run.q.copy(), run.p.copy()))
    q, p = (np.array(part) for part in zip(*states, strict=True))
    turns = Rotation.from_quat(q[:, 3:])
    thrust = turns.apply([0.0, 0.0, COMMAND[0]]) - [0.0, 0.0, 1.5]
    torque = turns.apply(COMMAND[1:])
    # A step takes them where it begins, where it ends, or half of them at each.
    first = {'lie_symplectic_euler': 1.0, 'lie_symplectic_euler_adjoint': 0.0}.get(name, 0.5)
    for what, found, force in (('linear', p[:, :3], thrust),
                               ('angular', spatial_momentum(q[:, 3:], p[:, 3:]), torque)):
        impulse = h * np.cumsum(first * force[:-1] + (1.0 - first) * force[1:], axis=0)
        error = abs(found[1:] - found[0] - impulse).max()
        measured(f'{what} momentum less the discrete impulse', name, error, '<= 1e-13')
        # Some 10 roundings of numbers of order 1 in each of 40 steps.
        assert error <= 1e-13
        assert abs(impulse[-1]).max() > 0.1


def test_spring_about_a_point_keeps_the_angular_momentum_about_it():
    spring = 'spring', SPRING[1] | {'anchor': [0.0, 0.0, 0.0]}
    run = simulation(INTEGRATORS['lie_leapfrog'](), 0.05, spring, hamiltonian=FREE)

    def momentum() -> np.ndarray:
        return np.cross(run.q[:3], run.p[:3]) + spatial_momentum(run.q[3:], run.p[3:])
    before, p = momentum(), run.p.copy()
    run.advance(100)
    assert abs(run.p - p).max() > 0.1
    # It is invariant under turns of all, and so is the method: to some 10 roundings a step.
    assert abs(momentum() - before).max() < 1e-13


def test_damping_of_free_turning_is_exact():
    ball = HAMILTONIANS['free_rigid_body']([0.4, 0.4, 0.4])
    run = simulation(INTEGRATORS['lie_leapfrog'](), 0.1, ('damping', {'rate': 0.7}),
                     hamiltonian=ball, state=(Q[3:], P[3:]))
    energy = run.energy
    run.advance(20)
    np.testing.assert_allclose(spatial_momentum(run.q, run.p),
                               np.exp(-1.4) * spatial_momentum(Q[3:], P[3:]), rtol=1e-13)
    assert run.energy == pytest.approx(np.exp(-2.8) * energy, rel=1e-13)
    assert run.work == pytest.approx(run.energy - energy, rel=1e-13)


def test_drag_of_turning_is_that_of_the_angular_velocity():
    drag = 'quadratic_drag', {'coordinates': ['attitude_rx', 'attitude_ry', 'attitude_rz'],
                              'coefficient': 0.3}
    body = HAMILTONIANS['free_rigid_body'](INERTIA)
    run = simulation(INTEGRATORS['lie_leapfrog'](), 0.1, drag, hamiltonian=body,
                     state=(Q[3:], P[3:]))
    omega = P[3:] / INERTIA
    rates = momentum_rates((0,), run.q, run.p, run.dH_dq, run.dH_dp)
    np.testing.assert_allclose(
        rates, np.cross(P[3:], omega) - 0.3 * np.linalg.norm(omega) * omega, atol=1e-14)


@pytest.mark.parametrize('names, command, force, torque', [
    (['body_x', 'body_z'], [2.0, -1.0], [2.0, 0.0, -1.0], [0.0, 0.0, 0.0]),
    (['body_rz', 'body_fx', 'body_fy'], [0.5, 2.0, -1.0], 'body', [0.0, 0.0, 0.5])])
def test_commands_act_along_axes_of_space_or_of_the_body(names, command, force, torque):
    run = plain_run(Uncompiled(FREE), 'lie_leapfrog', 0.1, Q, P,
                    *made(('external_force', {'coordinates': names, 'gain': 2.0})))
    assert tuple(run.command_names) == tuple(names)
    run.set_command([0.5 * number for number in command])
    rates = momentum_rates((3,), run.q, run.p, run.dH_dq, run.dH_dp)
    if force == 'body':
        force = Rotation.from_quat(Q[3:]).apply([2.0, -1.0, 0.0])
    np.testing.assert_allclose(rates[:3], force, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(rates[3:], np.cross(P[3:], P[3:] / INERTIA) + torque, atol=1e-15)
    # It ends in simulated time: after 0.5 s nothing acts.
    run.advance(5)
    before = run.p[:3].copy()
    run.advance(5)
    assert (run.p[:3] == before).all()


POTENTIALS = {
    'gravity': {'coordinate': 'body_z', 'mass': 2.0},
    'spring from a place': {'point': ['body'], 'point_in_body': ARM, 'anchor': [0.3, -0.2, 0.1],
                            'rest_length': 0.7, 'stiffness': 3.0},
    'spring to the origin of a body': {'point': ['body'], 'anchor': [0.3, -0.2, 0.1]},
    'spring between bodies': {'point': ['top'], 'point_in_body': ARM, 'other': ['body'],
                              'other_in_body': OTHER_ARM, 'rest_length': 0.7},
    'spring to a point': {'point': ['x', 'y', 'z'], 'other': ['top'], 'other_in_body': ARM},
    'spring of places alone': {'point': ['body_x', 'body_y', 'body_z'], 'other': ['x', 'y', 'z'],
                               'rest_length': 0.7},
}


def place(q: np.ndarray, names: list[str], arm: list[float] | None) -> np.ndarray:
    """Return where an end is in space, by scipy."""
    starts = {'body': (1, 4), 'top': (None, 10)}
    if len(names) == 3:
        return q[{'x': [0, 8, 9], 'body_x': [1, 2, 3]}[names[0]]]
    start, turning = starts[names[0]]
    turned = Rotation.from_quat(q[turning:turning + 4]).apply(arm or [0.0, 0.0, 0.0])
    return turned if start is None else q[start:start + 3] + turned


@pytest.mark.parametrize('name', POTENTIALS)
def test_potential_on_bodies_has_the_energy_and_the_derivatives_of_its_formula(name: str):
    arguments, rng = POTENTIALS[name], np.random.default_rng(2)
    effect = EFFECTS[name.split()[0]](**arguments)
    own = effect.resolve(MIXED, EffectState.empty(1, 14))
    potential = effect
    if name.startswith('spring') and not isinstance(own, Elastic):
        potential = BodySpring
    q, v = rng.normal(size=(2, 14))
    for start in (4, 10):
        q[start:start + 4] /= np.linalg.norm(q[start:start + 4])
    if name == 'gravity':
        expected = 2.0 * 9.81 * q[3]
    else:
        first = place(q, arguments['point'], arguments.get('point_in_body'))
        second = (np.array(arguments['anchor']) if 'anchor' in arguments else
                  place(q, arguments['other'], arguments.get('other_in_body')))
        stretch = np.linalg.norm(first - second) - arguments.get('rest_length', 0.0)
        expected = 0.5 * arguments.get('stiffness', 1.0) * stretch ** 2
    assert potential.energy(own, q) == pytest.approx(expected, rel=1e-13)
    assert_derivatives(potential, own, q, v, 1e-7)


class Two(Hamiltonian):
    """Two free bodies with a scalar coordinate before each."""

    coordinates = (Coordinate('x'), Coordinate('first', kind='pose'), Coordinate('y'),
                   Coordinate('second', kind='pose'))

    @cached_property
    def kernel(self) -> Kernel:
        """Return the functions, uncompiled."""
        weights = np.array([2.0, *[MASS] * 3, *INERTIA, 3.0, *[MASS] * 3, *INERTIA])

        def energy(parameters: tuple, q: np.ndarray, p: np.ndarray) -> float:
            return 0.5 * float(np.sum(p[:14] ** 2 / weights))

        def gradient(parameters: tuple, q: np.ndarray, p: np.ndarray, dH_dq: np.ndarray,
                     dH_dp: np.ndarray) -> None:
            dH_dq[:], dH_dp[:] = 0.0, 0.0
            dH_dp[:14] = p[:14] / weights
        unused: Any = gradient
        return Kernel(energy, gradient, unused, (), 16, (0.0, 0.0), compiled=False,
                      rotations=(4, 12))


def test_spring_between_two_bodies_keeps_their_momenta_and_damping_finds_its_columns():
    q = np.array([0.0, *Q, 0.0, -0.5, 0.4, 0.1, *Q[[4, 3, 6, 5]]])
    p = np.array([1.0, *P, -1.0, *-0.5 * P])
    spring = {'point': ['first'], 'point_in_body': ARM, 'other': ['second'],
              'other_in_body': OTHER_ARM, 'stiffness': 5.0, 'rest_length': 0.3}
    run = Simulation(Two(), INTEGRATORS['lie_leapfrog'](), 0.05, q, p, made(('spring', spring)))

    def momenta() -> np.ndarray:
        total = np.zeros(6)
        for i, j in ((1, 1), (9, 8)):
            place, linear = run.q[i:i + 3], run.p[j:j + 3]
            total[:3] += linear
            total[3:] += np.cross(place, linear) + spatial_momentum(
                run.q[i + 3:i + 7], run.p[j + 3:j + 6])
        return total
    before = momenta()
    run.advance(40)
    assert abs(run.p[1:4] - p[1:4]).max() > 0.1 and abs(run.p[11:14] - p[11:14]).max() > 0.05
    assert abs(momenta() - before).max() < 1e-13
    # Forces on what stands behind a rotation.
    names = ['second_fz', 'second_rx', 'y', 'first_rz']
    run = Simulation(Two(), INTEGRATORS['lie_leapfrog'](), 0.05, q, p, made(
        ('external_force', {'coordinates': names}),
        ('quadratic_drag', {'coordinates': ['second_x'], 'coefficient': 0.5})))
    run.set_command([2.0, 0.3, 0.7, 0.4])
    rates = momentum_rates((4, 12), run.q, run.p, run.dH_dq, run.dH_dp)
    expected = np.zeros(14)
    expected[4:7] = np.cross(p[4:7], p[4:7] / INERTIA)
    expected[6] += 0.4
    expected[7] = 0.7
    expected[8:11] = Rotation.from_quat(q[12:]).apply([0.0, 0.0, 2.0])
    expected[8] -= 0.5 * abs(p[8] / MASS) * p[8] / MASS
    expected[11:14] = np.cross(p[11:14], p[11:14] / INERTIA)
    expected[11] += 0.3
    np.testing.assert_allclose(rates, expected, rtol=0.0, atol=1e-14)
    run.advance(4)
    assert abs(run.energy_balance) < 1e-3 < abs(run.work)


def test_newton_solves_steps_with_effects():
    exactly, poorly = (simulation(INTEGRATORS['lie_leapfrog'](max_iterations=n), 0.1, *ALL)
                       for n in (100, 2))
    for run in (exactly, poorly):
        run.advance(5)
    assert poorly.rescued == 0 and poorly.gradients > exactly.gradients
    # Both are solved to some 32 eps in each of 10 equations.
    for one, other in ((exactly.q, poorly.q), (exactly.p, poorly.p)):
        assert np.allclose(one, other, rtol=0.0, atol=1e-13)
    assert exactly.work == pytest.approx(poorly.work, abs=1e-12)


def test_several_bodies_under_effects_step_together_as_each_alone():
    states = [(Q, P), (np.array([*Q[:3], *Q[[4, 3, 6, 5]]]), 0.5 * P)]
    method = INTEGRATORS['lie_leapfrog']
    together = simulation(method(), 0.05, *ALL, state=tuple(
        np.array(part) for part in zip(*states, strict=True)))
    together.advance(5)
    work = 0.0
    for i, state in enumerate(states):
        alone = simulation(method(), 0.05, *ALL, state=state)
        alone.advance(5)
        assert np.allclose(together.q[i], alone.q, rtol=0.0, atol=1e-13)
        assert np.allclose(together.p[i], alone.p, rtol=0.0, atol=1e-13)
        work += alone.work
    assert together.work == pytest.approx(work, abs=1e-12)


@pytest.mark.long
def test_effects_compiled_and_uncompiled_agree():
    # What the scene quadrotor is compiled of, and potentials.
    effects, method = [THRUST, DRAG, WEIGHT, SPRING], INTEGRATORS['lie_leapfrog']
    plain, compiled = simulation(method(), 0.05, *effects), Simulation(
        FLYING, method(), 0.05, Q, P, made(*effects))
    compiled.set_command(COMMAND)
    for run in (plain, compiled):
        run.advance(10)
    # Some 100 roundings of numbers of order 1.
    for one, other in ((plain.q, compiled.q), (plain.p, compiled.p)):
        assert np.allclose(one, other, rtol=0.0, atol=1e-13)
    assert compiled.works == pytest.approx(plain.works, abs=1e-13)
    # A snapshot holds the command and the work.
    kept = compiled.snapshot()
    compiled.advance(10)
    end = compiled.q.copy(), compiled.p.copy(), compiled.work
    compiled.restore(kept)
    compiled.advance(10)
    assert (compiled.q == end[0]).all() and (compiled.p == end[1]).all()
    assert compiled.work == end[2]


@pytest.mark.parametrize('kind, arguments', [
    ('soft_wall', {'coordinate': 'body_z'}),
    ('dry_friction', {'coordinate': 'body_z', 'force': 1.0}),
    ('magnetic_field', {'plane': ['body_x', 'body_y']}),
    ('periodic_drive', {'coordinate': 'body_z', 'amplitude': 1.0, 'frequency': 1.0}),
    ('servo', {'coordinates': ['body_z'], 'stiffness': 1.0}),
    ('thermostat', {'temperature': 1.0, 'rate': 1.0}),
    ('holonomic_constraint', {'point': ['body_x', 'body_z'], 'anchor': [0.0, 0.0]}),
    ('impact', {'coordinate': 'body_z'}),
    # Those that bodies take, on what is no part of a body, or not as it is one.
    ('gravity', {'coordinate': 'body_qx'}), ('damping', {'rate': [1.0] * 7}),
    ('quadratic_drag', {'coordinates': ['body_qx'], 'coefficient': 1.0}),
    ('external_force', {'coordinates': ['body']}),
    ('external_force', {'coordinates': [
        f'body_{kind}{axis}' for kind in ('', 'f', 'r') for axis in 'xyz']}),
    ('spring', {'point': ['body_x'], 'anchor': [0.0], 'point_in_body': ARM}),
    ('spring', {'point': ['body'], 'anchor': [0.0]}), ('spring', {'point': ['body']}),
    ('spring', {'point': ['body'], 'other': ['body']}),
    ('spring', {'point': ['body'], 'other': ['body_x']}),
    ('spring', {'point': ['body'], 'anchor': ARM, 'other_in_body': ARM}),
    ('spring', {'point': ['body'], 'anchor': ARM, 'point_in_body': [1.0]})])
def test_effect_that_does_not_fit_a_body_is_refused_by_name(kind: str, arguments: dict):
    with refused(EffectError) as raised:
        System(Uncompiled(FLYING), made(DRAG, (kind, arguments)), INTEGRATORS['lie_leapfrog']())
    assert raised.value.index == 1


def test_effects_that_bodies_take_are_these():
    assert {kind for kind, effect in EFFECTS.items() if effect.turns} == {
        # A model's friction has tests of its own: test_lie_group.py.
        *(kind for kind, _ in ALL), 'learned_friction'}
