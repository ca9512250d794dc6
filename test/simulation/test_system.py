# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Effects together: what is not listed does not exist, what is refused, repeatability."""

from pathlib import Path

from effect_table import create_effect, EFFECT_ROWS
from helpers import effect, EPS, free, long, plain_run
from hnn_vi_ros.effects import EffectError, JointPath
from hnn_vi_ros.errors import StepFailure, UnsupportedSystem
from hnn_vi_ros.hamiltonians import HAMILTONIANS
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.kernels import original
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import BLOCK, simulate, simulate_many, Simulation, System
from messages import refused
import numpy as np
import pytest


@pytest.mark.parametrize('integrator', ['variational_euler', 'stormer_verlet', 'gauss4'])
def test_system_without_effects_is_the_hamiltonian_and_the_method_themselves(integrator):
    hamiltonian, method = HAMILTONIANS['pendulum'](), INTEGRATORS[integrator]()
    system = System(hamiltonian, [], method)
    assert system.hamiltonian is hamiltonian
    assert original(system.kernel) is hamiltonian.kernel
    assert system.integrator is method
    assert system.integrator.step is INTEGRATORS[integrator].step
    assert system.conservative
    assert not system.motors.takes
    assert system.labels == []


def test_system_of_potentials_leaves_the_method_alone():
    method = INTEGRATORS['stormer_verlet']()
    system = System(free('x'), [effect('gravity', 'x')], method)
    assert system.integrator is method
    assert original(system.kernel) is system.hamiltonian.kernel
    assert system.kernel.channels == 0


def test_scene_with_its_effects_removed_is_bit_identical_to_one_that_never_had_any():
    results = [simulate(Scene.build(
        hamiltonian='harmonic_oscillator', integrator='variational_euler', step_size=0.05,
        initial_state=([0.7], [0.7]), **effects), 50.0) for effects in ({}, {'effects': []})]
    for part in ('t', 'q', 'p', 'energy'):
        assert np.array_equal(*(getattr(result, part) for result in results))
    bare = Simulation(HAMILTONIANS['harmonic_oscillator'](), INTEGRATORS['variational_euler'](),
                      0.05, [0.7], [0.7])
    assert np.array_equal(bare.record(1000, 1)[0], results[0].q[1:])


def test_system_labels_tell_effects_of_one_kind_apart():
    system = System(free('x'), [effect('damping', 0.1), effect('gravity', 'x'),
                                effect('damping', 0.2)], INTEGRATORS['stormer_verlet']())
    assert system.labels == ['damping_0', 'gravity', 'damping_2']


# What is refused.

@pytest.mark.parametrize('integrator, kind, arguments, able', [
    (INTEGRATORS['stormer_verlet'](), 'dry_friction', ('x', 1.0), 'generalized_leapfrog'),
    (INTEGRATORS['stormer_verlet'](), 'magnetic_field', (['x', 'z'],), 'implicit_midpoint'),
    (INTEGRATORS['yoshida4']('stormer_verlet'), 'magnetic_field', (['x', 'z'],), 'gauss4'),
    (INTEGRATORS['yoshida4']('stormer_verlet'), 'damping', (0.1,), 'gauss4'),
    (INTEGRATORS['variational_euler'](), 'impact', ('x',), 'stormer_verlet'),
    (INTEGRATORS['variational_euler'](), 'joint_limits', (None, {'x': -1.0}), 'gauss4'),
    (INTEGRATORS['stormer_verlet'](), 'joint_friction', (None, {'x': 1.0}), 'gauss4'),
    (INTEGRATORS['variational_euler'](), 'thermostat', (1.0, 1.0), 'stormer_verlet'),
    (INTEGRATORS['gauss4'](), 'thermostat', (1.0, 1.0), 'stormer_verlet, generalized_leapfrog'),
    (INTEGRATORS['variational_euler'](), 'holonomic_constraint', (['x', 'z'], None, [0.0, 0.0]),
     'stormer_verlet'),
    (INTEGRATORS['discrete_gradient'](), 'holonomic_constraint', (['x', 'z'], None, [0.0, 0.0]),
     'implicit_midpoint'),
    (INTEGRATORS['discrete_gradient'](), 'periodic_drive', ('x', 1.0, 1.0), 'gauss4'),
])
def test_method_that_cannot_take_an_effect_is_refused_with_those_that_can(
        integrator, kind, arguments, able):
    with pytest.raises(UnsupportedSystem) as raised:
        System(free('x', 'z'), [effect(kind, *arguments)], integrator)
    message = str(raised.value)
    assert f'does not support the effect {kind}; valid methods: ' in message
    named = message.partition('valid methods: ')[2].split(', ')
    assert set(able.split(', ')) <= set(named)
    for name in named:
        System(free('x', 'z'), [effect(kind, *arguments)], INTEGRATORS[name]())


def test_discrete_euler_lagrange_takes_no_effect_at_all(tmp_path: Path):
    integrator = INTEGRATORS['discrete_euler_lagrange']('helpers:midpoint_lagrangian', 2)
    for row in EFFECT_ROWS:
        with pytest.raises(UnsupportedSystem, match='discrete_euler_lagrange does not support'):
            System(row.uncompiled, row.create(tmp_path), integrator)


BATH = 'thermostat', {'temperature': 1.0, 'rate': 1.0}
ROD = 'holonomic_constraint', {'point': ['x', 'z'], 'anchor': [0.0, 0.0]}
STOPS = 'joint_limits', {'lower': {'x': 0.0, 'z': 0.0}}


@pytest.mark.parametrize('effects, index', [
    ([BATH, BATH], 1), ([('external_force', {'coordinates': [name]}) for name in 'xz'], 1),
    ([ROD, ('impact', {'coordinate': 'x'})], 1), ([STOPS, ROD], 0), ([STOPS, BATH, BATH], 2),
    ([BATH, ROD], 0), ([ROD, ('learned_dissipation', {'model': 2})], 1)])
def test_effects_that_do_not_combine_are_refused(effects, index, tmp_path):
    with refused(EffectError) as raised:
        System(free('x', 'z'), [create_effect(*one, tmp_path) for one in effects],
               INTEGRATORS['generalized_leapfrog']())
    assert raised.value.index == index


POINT = ['x', 'z']


@pytest.mark.parametrize('names, q, p, effects', [
    (['x'], [-0.5], [0.0], [('impact', {'coordinate': 'x'})]),
    (POINT, [1.0, 0.0], [0.5, 0.2], [ROD]),
    (['x'], [1.0], [0.0], 2 * [('holonomic_constraint', {'point': ['x'], 'anchor': [0.0]})]),
    *((POINT, [[1.0, 0.0]] * 2, [[0.0, 0.0]] * 2, [one])
      for one in (('impact', {'coordinate': 'x'}), BATH, ROD))],
    ids=['behind a wall', 'momentum along a rod', 'more rods than coordinates',
         *(f'several states, {kind}' for kind in ('impact', 'thermostat', 'rod'))])
def test_initial_state_that_an_effect_cannot_take_is_refused(names, q, p, effects):
    with refused(ValueError, EffectError):
        plain_run(free(*names), 'stormer_verlet', 0.1, q, p,
                  *(effect(kind, **arguments) for kind, arguments in effects))


# Repeatability.

def plain() -> Simulation:
    """Return a simulation without effects."""
    return plain_run('tao', 'variational_euler', 0.05, [1.0], [-1.0])


def brownian(seed: int = 1) -> Simulation:
    """Return a pendulum in a heat bath."""
    return plain_run('pendulum', 'stormer_verlet', 0.05, [0.7], [0.0],
                     effect('thermostat', 0.5, 1.0, seed=seed))


def rods() -> Simulation:
    """Return a mass on a rod from a pivot."""
    row = next(row for row in EFFECT_ROWS if row.name == 'rod with forces')
    return plain_run(row.uncompiled, 'generalized_leapfrog', 0.05, row.q, row.p,
                     *row.create(Path()))


def resting() -> Simulation:
    """Return a mass that lies on the floor, and is pushed into it and lifted off it."""
    return plain_run(free('z'), 'implicit_midpoint', 0.02, [0.02], [0.0],
                     effect('gravity', 'z'), effect('impact', 'z', restitution=0.3),
                     effect('periodic_drive', 'z', 20.0, 0.5, 0.5 * np.pi))


def commanded() -> Simulation:
    """Return a pendulum that is driven, and pushed until a time-out."""
    simulation = plain_run('pendulum', 'gauss4', 0.05, [0.7], [0.0], effect(
        'periodic_drive', 'angle', 1.0, 0.3), effect('external_force', ['angle'], 3.02))
    simulation.set_command([2.0])
    return simulation


def following() -> Simulation:
    """Return a pendulum whose servo follows a path, from one rest to another."""
    simulation = plain_run('pendulum', 'gauss4', 0.05, [0.7], [0.0],
                           effect('servo', ['angle'], 20.0, 2.0, 15.0))
    simulation.set_command(JointPath(
        ['angle'], 0.0, np.array([1.03, 4.0]), np.array([[-0.5], [0.9]])))
    return simulation


SIMULATIONS = [plain, brownian, rods, resting, commanded, following]


def assert_same(one: Simulation, other: Simulation) -> None:
    """Compare everything that a simulation shows, bit by bit."""
    for part in ('q', 'p', 'dH_dq', 'dH_dp'):
        assert np.array_equal(getattr(one, part), getattr(other, part))
    assert (one.works, one.energy_balance, one.time) == (
        other.works, other.energy_balance, other.time)


@pytest.mark.parametrize('make', SIMULATIONS, ids=lambda make: make.__name__)
def test_simulation_is_bit_identical_when_repeated_and_when_cut_in_pieces(make):
    whole, pieces = make(), make()
    whole.advance(120)
    for n in (1, 0, 58, 1, 60):
        pieces.advance(n)
    assert_same(whole, pieces)
    q, p = whole.q.copy(), whole.p.copy()
    again = make()
    samples = again.record(4, 30)
    assert np.array_equal(samples[0][-1], q)
    assert np.array_equal(samples[1][-1], p)


@pytest.mark.parametrize('make', SIMULATIONS, ids=lambda make: make.__name__)
def test_simulation_with_effects_restored_from_a_snapshot_is_bit_identical(make):
    whole, resumed = make(), make()
    # After 50 steps the mass lies on the floor, and the external force has ended before 70.
    whole.advance(50)
    snapshot = whole.snapshot()
    whole.advance(70)
    resumed.restore(snapshot)
    resumed.advance(70)
    assert_same(whole, resumed)
    # Going back in the same simulation is no different.
    whole.restore(snapshot)
    whole.advance(70)
    assert_same(whole, resumed)


def test_mass_of_these_tests_is_at_rest_where_it_is_cut_and_is_lifted_off_after_that():
    simulation = resting()
    simulation.advance(50)
    assert (simulation.q[0], simulation.p[0]) == (0.0, 0.0)
    lifted, _ = simulation.record(70, 1)
    assert (lifted[:5] == 0.0).all()
    assert lifted.max() > 0.1


def test_thermostat_noise_is_that_of_its_seed_and_stream():
    first, same, other = brownian(1), brownian(1), brownian(2)
    for simulation in (first, same, other):
        simulation.advance(20)
    assert np.array_equal(first.q, same.q)
    assert not np.isclose(first.q, other.q)
    # Two uniform numbers for the normal one of a step, and one to accept it by.
    assert first.snapshot()['live.draws'][0] == 3 * 20
    first.restart([0.7], [0.0], stream=0)
    other.restart([0.7], [0.0])
    same.restart([0.7], [0.0], stream=1)
    for simulation in (first, same):
        simulation.advance(20)
    assert not np.isclose(first.q, same.q)
    same.restart([0.7], [0.0])
    same.advance(20)
    assert np.array_equal(first.q, same.q)
    assert same.works == first.works


def test_thermostat_noise_is_drawn_once_for_each_part_of_a_step_that_a_wall_cuts():
    """Trials of the time of impact meet the same noise: they are parts of one path."""
    simulation = plain_run(
        'pendulum', 'stormer_verlet', 0.05, [0.7], [0.0], effect('thermostat', 0.5, 1.0),
        effect('impact', 'angle', restitution=1.0))
    q, _ = simulation.record(200, 1)
    assert q.min() >= 0.0
    parts = simulation.snapshot()['live.draws'][0] // 3 - 200
    # One or two impacts a second.
    assert 5 <= parts <= 40


@pytest.mark.parametrize('integrator', ['variational_euler', 'implicit_midpoint'])
def test_step_that_is_taken_in_parts_counts_its_time_and_work_once(integrator):
    """No solver converges in the whole step, nor in all of its halves."""
    name = HAMILTONIANS['tao']().coordinates[0].name
    simulation, fine = (plain_run('tao', method, h, [1.5], [-2.0],
                                  effect('periodic_drive', name, 0.1, 0.1))
                        for method, h in ((integrator, 3.0), ('gauss8', 3.0 / 200)))
    simulation.advance(1)
    assert simulation.rescued == 1
    fine.advance(200)
    # Of the clock of the drive, and roughly of the work: the first attempts are not counted.
    assert simulation.snapshot()['live.clock'].sum() == 3.0
    assert simulation.work == pytest.approx(fine.work, abs=0.1)


@pytest.mark.filterwarnings('ignore::RuntimeWarning')
def test_step_that_fails_leaves_time_work_and_noise_as_they_were():
    simulation = plain_run(free('x'), 'stormer_verlet', 0.1, [1.0], [0.0],
                           effect('spring', ['x'], anchor=[0.0], stiffness=1e300),
                           effect('thermostat', 1.0, 1.0))
    with pytest.raises(StepFailure, match='not finite'):
        simulation.advance(100)
    before = simulation.snapshot()
    assert simulation.steps < 100
    with pytest.raises(StepFailure):
        simulation.advance(1)
    for name in ('live.clock', 'live.work', 'point.q', 'point.p'):
        assert np.array_equal(simulation.snapshot()[name], before[name])
    assert simulation.snapshot()['live.draws'][0] == before['live.draws'][0]
    assert simulation.snapshot()['live.clock'][0] == pytest.approx(simulation.time)


# Many at once.

@pytest.mark.parametrize('kind, d, integrator, effects', [
    ('pendulum', 1, 'generalized_leapfrog', [
        {'kind': 'damping', 'rate': 0.3},
        {'kind': 'periodic_drive', 'coordinate': 'angle', 'amplitude': 1.0, 'frequency': 0.5}]),
    long('henon_heiles', 2, 'implicit_midpoint', [
        {'kind': 'magnetic_field', 'plane': ['x', 'y']}]),
    long('pendulum', 1, 'stormer_verlet', [
        {'kind': 'thermostat', 'temperature': 0.5, 'rate': 2.0, 'seed': 1},
        {'kind': 'impact', 'coordinate': 'angle', 'position': -1.0, 'restitution': 0.7}])],
    ids=['forces', 'magnetic field', 'bath and wall'])
def test_many_trajectories_with_effects_are_those_of_each_alone(kind, d, integrator, effects):
    scene = Scene.build(hamiltonian=kind, integrator=integrator, step_size=0.05, effects=effects,
                        initial_state=([0.0] * d, [0.0] * d))
    m, samples, every = BLOCK + 3, 4, 10
    q, p = np.random.default_rng(0).uniform(-0.4, 0.4, (2, m, d))
    many = simulate_many(scene, q, p, samples * every * 0.05, samples=samples, threads=2)
    alone = Simulation(scene.create_hamiltonian(), scene.create_integrator(), 0.05, q[0], p[0],
                       scene.create_effects())
    for i in (0, 1, BLOCK - 1, BLOCK, m - 1):
        alone.restart(q[i], p[i], stream=i)
        q_alone, p_alone = alone.record(samples, every)
        # Both are solved to 8 eps a step, and the flow stretches that less than 100 times.
        tolerance = 100 * 8 * EPS * samples * every
        assert np.abs(many.q[1:, i] - q_alone).max() <= tolerance
        assert np.abs(many.p[1:, i] - p_alone).max() <= tolerance
        assert many.energy[-1, i] == pytest.approx(alone.energy, abs=100 * tolerance)


def test_energy_balance_of_trajectories_that_step_together_is_the_sum_of_theirs():
    def make(q, p) -> Simulation:
        return plain_run('henon_heiles', 'gauss6', 0.1, q, p, effect('magnetic_field', ['x', 'y']),
                         effect('damping', [0.1, 0.3]), effect('periodic_drive', 'x', 0.3, 0.2))

    q, p = np.random.default_rng(1).uniform(-0.3, 0.3, (2, 3, 2))
    together, alone = make(q, p), [make(*state) for state in zip(q, p, strict=True)]
    for simulation in (together, *alone):
        simulation.advance(20)
    assert together.energy == pytest.approx(sum(one.energy for one in alone), abs=1e-12)
    assert together.work == pytest.approx(sum(one.work for one in alone), abs=1e-12)
    assert abs(together.work) > 1e-3
    assert abs(together.energy_balance) < 1e-8


def test_snapshot_carries_the_energy_that_the_balance_starts_from():
    first, other = (plain_run('pendulum', 'gauss8', 0.1, [q], [0.0]) for q in (1.0, 0.5))
    first.advance(5)
    other.restore(first.snapshot())
    assert other.energy_balance == first.energy_balance


def test_body_that_friction_brought_to_rest_needs_no_rescue():
    simulation = plain_run('pendulum', 'variational_euler', 0.01, [1e-320], [0.0],
                           effect('dry_friction', 'angle', force=0.1))
    simulation.advance(50)
    assert simulation.rescued == 0 and simulation.gradients <= 50 * 5
