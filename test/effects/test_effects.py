# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Each effect by itself: its parameters, its derivatives, what it takes from outside."""

from pathlib import Path

from effect_table import (
    assert_derivatives, BESIDE, create_effect, EFFECT_ROWS, EffectRow, TOO_LONG, UNKNOWN)
from helpers import (
    effect, EPS, exact, free, jacobian, plain_run, python_step, random_checkpoint,
    symplectic_defect, Uncompiled)
from hnn_vi_ros.effects import EffectError, EFFECTS, EffectState, Force, NUMBERS, Potential
from hnn_vi_ros.effects.noise import fill_normals
from hnn_vi_ros.hamiltonians import Hamiltonian, HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.models import NeuralHamiltonian, save_checkpoint
from hnn_vi_ros.simulation import Simulation, System
from messages import refused
from mpmath import mpf
import numpy as np
import pytest
from scipy.integrate import solve_ivp

NAN, INF = float('nan'), float('inf')
NAMES = ('x', 'y', 'z', 'x2', 'y2', 'z2')


def system_of(hamiltonian: Hamiltonian, *effects: tuple[str, dict], folder: Path = Path(),
              integrator: str = 'generalized_leapfrog') -> System:
    """Build a system of effects, given by kind and arguments."""
    return System(hamiltonian, [create_effect(*one, folder) for one in effects],
                  INTEGRATORS[integrator]())


@pytest.mark.parametrize('kind, arguments', [
    ('gravity', {'coordinate': 'x', 'mass': 0.0}),
    ('gravity', {'coordinate': 'x', 'acceleration': INF}),
    ('spring', {'point': ['x'], 'anchor': [0.0], 'stiffness': -1.0}),
    ('spring', {'point': ['x'], 'anchor': [0.0], 'rest_length': -1.0}),
    ('magnetic_field', {'plane': ['x']}), ('magnetic_field', {'plane': ['x', 'x']}),
    ('magnetic_field', {'plane': ['x', 'y'], 'field': NAN}),
    ('soft_wall', {'coordinate': 'x', 'width': 0.0}),
    ('soft_wall', {'coordinate': 'x', 'position': NAN}), ('damping', {'rate': -0.1}),
    ('damping', {'rate': [0.1, NAN]}), ('dry_friction', {'coordinate': 'x', 'force': 0.0}),
    ('dry_friction', {'coordinate': 'x', 'force': 1.0, 'speed': INF}),
    ('quadratic_drag', {'coordinates': [], 'coefficient': 1.0}),
    ('quadratic_drag', {'coordinates': ['x', 'x'], 'coefficient': 1.0}),
    ('quadratic_drag', {'coordinates': ['x'], 'coefficient': 0.0}),
    ('periodic_drive', {'coordinate': 'x', 'amplitude': 1.0, 'frequency': 0.0}),
    ('periodic_drive', {'coordinate': 'x', 'amplitude': NAN, 'frequency': 1.0}),
    ('external_force', {'coordinates': ['x'], 'timeout': 0.0}),
    ('external_force', {'coordinates': ['x', 'x']}),
    ('servo', {'coordinates': ['x'], 'stiffness': -1.0}),
    ('servo', {'coordinates': ['x'], 'stiffness': 1.0, 'damping': [NAN]}),
    ('servo', {'coordinates': ['x'], 'stiffness': 1.0, 'effort_limit': 0.0}),
    ('servo', {'coordinates': ['x'], 'stiffness': 1.0, 'position': [INF]}),
    ('servo', {'coordinates': ['x', 'x'], 'stiffness': 1.0}),
    ('thermostat', {'temperature': 0.0, 'rate': 1.0}),
    ('thermostat', {'temperature': 1.0, 'rate': [1.0, 0.0]}),
    ('thermostat', {'temperature': 1.0, 'rate': 1.0, 'mass': -1.0}),
    ('thermostat', {'temperature': 1.0, 'rate': 1.0, 'seed': -1}),
    ('holonomic_constraint', {'point': ['x'], 'anchor': [0.0], 'length': 0.0}),
    ('impact', {'coordinate': 'x', 'restitution': 1.1}),
    ('impact', {'coordinate': 'x', 'restitution': NAN}),
    ('impact', {'coordinate': 'x', 'position': INF}), ('joint_limits', {}),
    ('joint_limits', {'lower': {'x': INF}}),
    ('joint_limits', {'lower': {'x': 0.0}, 'restitution': -0.1}), ('joint_friction', {}),
    ('joint_friction', {'damping': {'x': -1.0}}), ('joint_friction', {'load': {'x': -1.0}}),
    ('joint_friction', {'friction': {'x': 1.0}, 'speed': 0.0}),
    *(('observer', {'coordinates': ['x']} | arguments) for arguments in (
        {'gain': -1.0}, {'damping': INF}, {'timeout': 0.0}, {'deviations': [1.0, 2.0]},
        {'deviations': [0.0]}, {'coordinates': ['x', 'x']})),
    ('external_force', {'coordinates': ['x'], 'gain': NAN}),
    ('external_force', {'model': 'any', 'gain': 2.0}),
    *(('lugre_friction', {'coordinate': 'x', 'stiffness': 9.0, 'friction': 1.0} | arguments)
      for arguments in (
          {'stiffness': 0.0}, {'stiffness': INF}, {'friction': -1.0}, {'friction': None},
          {'stribeck': -0.1}, {'stribeck': NAN}, {'speed': 0.0}, {'exponent': 0.5},
          {'damping': -1.0}, {'bristle_damping': INF}, {'bristle_damping_speed': 0.0},
          {'stribeck': 0.5, 'bristle_damping': 30.0, 'damping': 0.1}, {'drive': 'mx65'})),
    *(('motor', {'coordinate': 'x'} | arguments) for arguments in (
        {}, {'time_constant': -1.0}, {'torque_limit': 0.0}, {'torque_limit': NAN},
        {'no_load_speed': 3.0}, {'torque_limit': 1.0, 'no_load_speed': -3.0},
        {'drive': 'erob80_50'}))])
def test_effect_parameter_out_of_its_range_is_refused(kind, arguments):
    with refused(ValueError):
        EFFECTS[kind](**arguments)


def test_effects_of_the_tables_are_all():
    assert set(UNKNOWN) | set(TOO_LONG) | BESIDE == set(EFFECTS)


@pytest.mark.parametrize('kind', UNKNOWN)
def test_effect_on_an_unknown_coordinate_names_its_place_and_the_valid_ones(kind):
    with refused(EffectError) as raised:
        system_of(free('x', 'z'), ('damping', {'rate': 0.1}), (kind, UNKNOWN[kind]))
    assert raised.value.index == 1


@pytest.mark.parametrize('kind', TOO_LONG)
def test_effect_of_another_dimension_names_its_place_and_the_number(kind, tmp_path):
    with refused(EffectError):
        system_of(free('x', 'z'), (kind, TOO_LONG[kind]), folder=tmp_path)


@pytest.mark.parametrize('arguments', [
    {'point': ['x']}, {'point': ['x'], 'anchor': [0.0], 'other': ['z']},
    {'point': ['x', 'z'], 'anchor': [0.0]}, {'point': ['x'], 'other': ['x']},
    {'point': ['x', 'x'], 'anchor': [0.0, 0.0]}, {'point': [], 'anchor': []}], ids=str)
@pytest.mark.parametrize('kind', ['spring', 'holonomic_constraint'])
def test_pair_of_points_that_does_not_fit_is_refused(kind, arguments):
    with refused(EffectError):
        system_of(free('x', 'z'), (kind, arguments))


POTENTIALS = {
    'gravity': {'coordinate': 'y', 'mass': 2.0},
    'spring from a place, 1 coordinate': {'point': ['y'], 'anchor': [0.3], 'rest_length': 0.7},
    'spring from a place, 2 coordinates': {
        'point': ['z', 'x'], 'anchor': [0.3, -0.2], 'rest_length': 0.7, 'stiffness': 3.0},
    'spring from a place, 3 coordinates': {
        'point': ['x', 'y', 'z'], 'anchor': [0.3, -0.2, 0.1], 'rest_length': 0.7},
    'spring between, 1 coordinate': {'point': ['x'], 'other': ['x2'], 'rest_length': 0.7},
    'spring between, 2 coordinates': {'point': ['x', 'y'], 'other': ['x2', 'z2']},
    'spring between, 3 coordinates': {
        'point': ['x', 'y', 'z'], 'other': ['x2', 'y2', 'z2'], 'rest_length': 2.0},
    'soft_wall above': {'coordinate': 'z', 'position': 0.2, 'width': 0.5, 'stiffness': 3.0},
    'soft_wall below': {'coordinate': 'z', 'position': 0.2, 'side': 'below', 'width': 0.5},
}


@pytest.mark.parametrize('name', POTENTIALS)
@pytest.mark.parametrize('seed', range(3))
def test_potential_derivatives_are_those_of_its_energy(name: str, seed: int):
    potential = EFFECTS[name.split()[0]](**POTENTIALS[name])
    assert isinstance(potential, Potential)
    own = potential.resolve(free(*NAMES).coordinates, EffectState.empty(1, 6))
    q, v = np.random.default_rng(seed).normal(size=(2, 6))
    assert_derivatives(potential, own, q, v, 1e-8)


@pytest.mark.parametrize('side, sign', [('above', -1.0), ('below', 1.0)])
def test_soft_wall_is_a_spring_behind_and_nothing_far_in_front_without_overflow(side, sign):
    wall = EFFECTS['soft_wall']('x', 0.5, side, 20.0, 0.01)
    own = wall.resolve(free('x').coordinates, EffectState.empty(1, 1))
    for depth in (10.0, 1e6, -10.0, -1e6):
        q, gradient, product = np.array([0.5 + sign * depth]), np.zeros(1), np.zeros(1)
        with np.errstate(all='raise', under='ignore'):
            energy = wall.energy(own, q)
            wall.add_gradient(own, q, gradient)
            wall.add_hessian_vector(own, q, np.ones(1), product)
        behind = max(depth, 0.0)
        assert energy == pytest.approx(10.0 * behind ** 2, rel=1e-12, abs=1e-300)
        assert gradient[0] == pytest.approx(sign * 20.0 * behind, rel=1e-12, abs=1e-300)
        assert product[0] == pytest.approx(20.0 * (depth > 0.0), rel=1e-12, abs=1e-300)
    # As exp(2 x / w) in front of it.
    energies = [wall.energy(own, np.array([0.5 + sign * x])) for x in (-0.10, -0.11)]
    assert energies[0] / energies[1] == pytest.approx(np.exp(2.0), rel=1e-3)


def test_spring_of_no_length_has_no_force_in_its_middle():
    """Where the direction of a spring with a length at rest is undefined."""
    spring = EFFECTS['spring'](['x', 'y'], anchor=[0.0, 0.0], rest_length=1.0)
    own = spring.resolve(free('x', 'y').coordinates, EffectState.empty(1, 2))
    gradient = np.zeros(2)
    spring.add_gradient(own, np.zeros(2), gradient)
    assert (gradient == 0.0).all()


KERNEL_ROWS = [row for row in EFFECT_ROWS
               if len(row.effects) == 1 and not EFFECTS[row.effects[0][0]].internal
               and (issubclass(EFFECTS[row.effects[0][0]], Force) or row.name == 'magnetic_field')]


@pytest.mark.parametrize('row', KERNEL_ROWS, ids=lambda row: row.name)
def test_hessian_vector_with_an_effect_is_the_derivative_of_its_gradient(
        row: EffectRow, tmp_path: Path):
    effects = row.create(tmp_path)
    system = System(row.uncompiled, effects, INTEGRATORS['gauss4']())
    kernel, (D, d) = system.kernel, (system.kernel.dimension, len(row.q))
    if NUMBERS in system.motors.takes:
        system.motors.command([2.0], np.array(row.q))
    rng = np.random.default_rng(1)
    q, p, v_q, v_p = rng.normal(size=(4, D))
    # Of a channel nothing acts back; time is not differentiated.
    v_q[d:], v_p[d:] = 0.0, 0.0
    sides, spacing = [], 1e-5
    for sign in (1.0, -1.0):
        dH_dq, dH_dp = np.empty((2, D))
        kernel.gradient(kernel.parameters, q + sign * spacing * v_q, p + sign * spacing * v_p,
                        dH_dq, dH_dp)
        sides.append(np.concatenate([dH_dq[:d], dH_dp[:d]]))
    product_q, product_p = np.full((2, D), NAN)
    kernel.hessian_vector(kernel.parameters, q, p, v_q, v_p, product_q, product_p)
    expected = (sides[0] - sides[1]) / (2.0 * spacing)
    # Both are differences of spacing 1e-5, with third derivatives of some 10.
    assert np.concatenate([product_q[:d], product_p[:d]]) == pytest.approx(expected, abs=1e-7)
    assert (product_q[d:] == 0.0).all()
    assert (product_p[d:] == 0.0).all()


@pytest.mark.parametrize('row', [row for row in KERNEL_ROWS if row.name != 'external_force'],
                         ids=lambda row: row.name)
def test_newton_solves_steps_with_an_effect(row: EffectRow, tmp_path: Path):
    """One iteration is never enough for the first attempt of the chain."""
    runs = [plain_run(row.uncompiled, INTEGRATORS['gauss4'](max_iterations=iterations), 0.05,
                      row.q, row.p, *row.create(tmp_path)) for iterations in (1, 100)]
    for simulation in runs:
        simulation.advance(10)
        assert simulation.rescued == 0
    newton, anderson = runs
    # Both are solved to 32 eps in each of 10 steps, the flow stretches that less than tenfold.
    assert newton.q == pytest.approx(anderson.q, abs=10 * 32 * 10 * EPS)
    assert newton.p == pytest.approx(anderson.p, abs=10 * 32 * 10 * EPS)
    assert newton.energy_balance == pytest.approx(anderson.energy_balance, abs=1e-12)
    assert newton.gradients > anderson.gradients


@pytest.mark.parametrize('integrator', ['generalized_leapfrog', 'implicit_midpoint', 'gauss4',
                                        'suzuki4'])
@pytest.mark.parametrize('kind, arguments', [
    ('gravity', {'coordinate': 'x'}),
    ('spring', {'point': ['x', 'y'], 'anchor': [0.2, 0.1], 'rest_length': 0.5})])
def test_method_stays_symplectic_in_60_digits_with_a_potential(integrator, kind, arguments):
    system = system_of(Uncompiled(HAMILTONIANS['henon_heiles']()), (kind, arguments),
                       integrator=integrator)
    method, z = INTEGRATORS[integrator](), exact(['0.3', '-0.2', '0.2', '0.3'])
    derivative = jacobian(
        lambda z: python_step(method, system.hamiltonian, mpf('0.1'), z), z)
    # Solved to 55 digits and differentiated with 40: anything but zero would show.
    assert symplectic_defect(derivative) <= 1e-25


def test_learned_dissipation_is_the_gradient_of_its_network(tmp_path):
    """Take q' = H_p + D_q and p' = -H_q + D_p with H = |p|^2 / 2."""
    network = random_checkpoint([4, 8, 1], seed=5)
    save_checkpoint(tmp_path / 'D.safetensors', network)
    q, p = [0.3, -0.2], [0.7, 0.1]
    simulation = plain_run(free('x', 'y'), 'gauss4', 0.01, q, p,
                           effect('learned_dissipation', str(tmp_path / 'D.safetensors')))
    dD_dq, dD_dp = NeuralHamiltonian(network).gradient(np.array(q), np.array(p))
    assert simulation.dH_dq == pytest.approx(-dD_dp, rel=1e-14)
    assert simulation.dH_dp == pytest.approx(p + dD_dq, rel=1e-14)


def test_learned_dissipation_in_a_magnetic_field_is_that_of_the_kinetic_momentum(tmp_path):
    """Take x = v + D_q and P' = -V' + D_p + c B x-turned, D of (q, P), by DOP853."""
    network, field = random_checkpoint([4, 8, 1], seed=3), 2.0
    save_checkpoint(tmp_path / 'D.safetensors', network)
    D, base = NeuralHamiltonian(network), Uncompiled(HAMILTONIANS['henon_heiles']())

    def slope(t: float, z: np.ndarray) -> np.ndarray:
        (H_q, H_p), (D_q, D_p) = (part.gradient(z[:2], z[2:]) for part in (base, D))
        rate = H_p + D_q
        return np.concatenate([rate, -H_q + D_p + field * np.array([rate[1], -rate[0]])])

    q, P = np.array([0.5, -0.3]), np.array([0.4, 0.6])
    exact = solve_ivp(slope, (0.0, 1.0), [*q, *P], 'DOP853', rtol=1e-11, atol=1e-11).y[:, -1]
    half = 0.5 * field * np.array([[0.0, -1.0], [1.0, 0.0]])
    simulation = plain_run(base, 'gauss6', 0.05, q, P + half @ q,
                           effect('learned_dissipation', str(tmp_path / 'D.safetensors')),
                           effect('magnetic_field', ['x', 'y'], field=field))
    simulation.advance(20)
    # Order 6 at h = 0.05: some 1e-8. With D of p it was 0.18.
    assert simulation.q == pytest.approx(exact[:2], abs=1e-7)
    assert simulation.p - half @ simulation.q == pytest.approx(exact[2:], abs=1e-7)


def pushed(integrator: str, timeout: float, h: float = 0.1) -> Simulation:
    """Return a free particle of 1 kg that takes commands for x."""
    return plain_run(free('y', 'x'), integrator, h, [0.0, 0.0], [0.0, 0.0],
                     effect('external_force', ['x'], timeout))


@pytest.mark.parametrize('integrator', [
    'stormer_verlet', 'generalized_leapfrog', 'variational_euler', 'symplectic_euler', 'gauss4',
    'yoshida4', 'explicit_euler', 'rk4', 'dop853'])
def test_external_force_holds_over_steps_and_ends_in_simulated_time(integrator):
    simulation = pushed(integrator, 0.35)
    simulation.advance(3)
    assert (simulation.p == 0.0).all()
    simulation.set_command([2.0])
    # From now on, over the four steps that begin within 0.35 s.
    impulses = []
    for _ in range(8):
        before = simulation.p[1]
        simulation.advance(1)
        impulses.append(simulation.p[1] - before)
    assert impulses == pytest.approx([0.2] * 4 + [0.0] * 4, abs=1e-12)
    assert simulation.p[0] == 0.0
    # A command that is renewed in time does not end; a new one takes its place at once.
    for force in (1.0, -3.0):
        simulation.set_command([force])
        before = simulation.p[1]
        simulation.advance(2)
        assert simulation.p[1] - before == pytest.approx(0.2 * force, abs=1e-12)


def test_external_force_begins_with_its_initial_command_until_another_comes():
    simulation = plain_run(free('y', 'x'), 'rk4', 0.1, [0.0, 0.0], [0.0, 0.0],
                           effect('external_force', ['x'], timeout=0.2, initial=[2.0]))
    for _ in range(2):
        assert simulation.dH_dq.tolist() == [0.0, -2.0]
        impulses = []
        for step in range(14):
            if step == 8:
                simulation.set_command([-1.0])
            before = simulation.p[1]
            simulation.advance(1)
            impulses.append(simulation.p[1] - before)
        # Far beyond the time-out, which ends commands only; after one no force acts.
        assert impulses == pytest.approx([0.2] * 8 + [-0.1] * 2 + [0.0] * 4, abs=1e-12)
        simulation.restart([0.0, 0.0], [0.0, 0.0])


def test_external_force_refuses_gains_of_other_numbers_than_its_own():
    with refused(EffectError):
        plain_run(free('x', 'y'), 'rk4', 0.1, [0.0] * 2, [0.0] * 2,
                  effect('external_force', ['x', 'y'], gain=[1.0, 2.0, 3.0]))


@pytest.mark.parametrize('initial', [[], [1.0, 2.0], [NAN], [1e13]])
def test_external_force_refuses_a_bad_initial_command(initial):
    with refused(ValueError):
        plain_run(free('x'), 'rk4', 0.1, [0.0], [0.0],
                  effect('external_force', ['x'], initial=initial))


@pytest.mark.parametrize('values', [[], [1.0, 2.0], [NAN], [INF], [1e13], [[1.0]],
                                    [0.0] * 1000])
def test_external_force_refuses_a_bad_command_whole_and_keeps_the_last(values):
    simulation, other = pushed('stormer_verlet', 0.35), pushed('stormer_verlet', 0.35)
    for each in (simulation, other):
        each.set_command([2.0])
        each.advance(2)
    with refused(ValueError):
        simulation.set_command(values)
    # Nor is its time-out renewed.
    for each in (simulation, other):
        each.advance(5)
    assert simulation.p[1] == pytest.approx(0.8, abs=1e-12)
    assert np.array_equal(simulation.p, other.p)


def test_external_force_command_is_in_the_order_of_its_own_coordinates_and_shows_at_once():
    simulation = plain_run(free('x', 'y', 'z'), 'stormer_verlet', 0.1, [0.0] * 3, [0.0] * 3,
                           effect('external_force', ['z', 'x']))
    simulation.set_command([1.0, 2.0])
    assert simulation.dH_dq.tolist() == [-2.0, 0.0, -1.0]
    simulation.advance(1)
    assert simulation.p == pytest.approx([0.2, 0.0, 0.1])


def test_external_force_multiplies_its_command_by_a_gain_and_adds_an_offset():
    simulation = plain_run(
        free('x', 'y', 'z'), 'stormer_verlet', 0.1, [0.0] * 3, [0.0] * 3,
        effect('external_force', ['z', 'x'], 0.2, gain=[2.0, -3.0], offset=[0.5, 0.0]))
    assert simulation.dH_dq.tolist() == [0.0] * 3
    simulation.set_command([1.0, 2.0])
    assert simulation.dH_dq.tolist() == [6.0, 0.0, -2.5]
    simulation.advance(5)
    # The offset ends with the command, after two steps.
    assert simulation.p == pytest.approx([-1.2, 0.0, 0.5])


def test_noise_is_normal_and_depends_on_seed_stream_and_count_only():
    def numbers(seed: int, stream: int, first: int, count: int) -> np.ndarray:
        draws, normals = np.array([first, 0, stream]), np.empty(count)
        fill_normals(seed, draws, normals)
        assert draws.tolist() == [first, 2 * count, stream]
        return normals

    whole = numbers(7, 3, 0, 100_000)
    assert np.array_equal(numbers(7, 3, 2_000, 10), whole[1_000:1_010])
    for other in (numbers(8, 3, 0, 10), numbers(7, 4, 0, 10)):
        assert not np.isclose(other, whole[:10]).any()
    # Moments of 1e5 numbers, within four standard errors: 1, sqrt 2, sqrt 15, sqrt 96 of 1/316.
    for power, moment, error in ((1, 0.0, 1.0), (2, 1.0, 1.41), (3, 0.0, 3.9), (4, 3.0, 9.8)):
        assert abs((whole ** power).mean() - moment) < 4.0 * error / np.sqrt(1e5)
    # Nor do neighbours, or streams, depend on each other.
    for other in (np.roll(whole, 1), numbers(7, 2, 0, 100_000), numbers(6, 3, 0, 100_000)):
        assert abs((whole * other).mean()) < 4.0 / np.sqrt(1e5)
