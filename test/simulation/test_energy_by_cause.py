# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The energy by cause: each part against an integral by DOP853, and what no cause explains."""

from collections.abc import Sequence
from typing import NamedTuple

from effect_table import EFFECT_ROWS, EffectRow
from helpers import effect, plain_run
from hnn_vi_ros.effects import (
    Command, Force, Joined, LinkWrench, OBSERVATION, Observation, Potential)
from hnn_vi_ros.effects.observer import Observer
from hnn_vi_ros.errors import SceneError
from hnn_vi_ros.hamiltonians import payload_of
from hnn_vi_ros.integrators import INTEGRATORS
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import (
    build, EnergyByCause, simulate, simulate_many, Simulation, Trajectory)
from messages import refused
import numpy as np
from numpy.typing import ArrayLike
import pytest
from scipy.integrate import solve_ivp

Q, P, COMMAND, DURATION = (0.3, -0.2), (1.3, 0.7), 0.3, 0.8
# Smooth along the motion, so that a method keeps its order.
PARTS = {
    'gravity': {'coordinate': 'y', 'acceleration': 0.3},
    'spring': {'point': ['x', 'y'], 'anchor': [1.1, 1.1], 'rest_length': 0.3},
    'soft_wall': {'coordinate': 'x', 'position': -0.1, 'stiffness': 2.0, 'width': 0.4},
    'potential': {'formula': '0.1*x*y^3 - cos(x)/5'},
    'magnetic_field': {'plane': ['x', 'y']},
    'damping': {'rate': [0.3, 0.1]},
    'dry_friction': {'coordinate': 'x', 'force': 0.2, 'speed': 0.5},
    'quadratic_drag': {'coordinates': ['x', 'y'], 'coefficient': 0.4},
    'joint_friction': {'damping': {'x': 0.2}, 'friction': {'y': 0.1}, 'speed': 0.5},
    'periodic_drive': {'coordinate': 'y', 'amplitude': 0.5, 'frequency': 0.7},
    'external_force': {'coordinates': ['y', 'x'], 'timeout': 100.0},
    'servo': {'coordinates': ['y', 'x'], 'stiffness': 2.0, 'damping': [0.5, 0.1],
              'position': [0.4, -0.2]},
    'lugre_friction': {'coordinate': 'x', 'stiffness': 3.0, 'friction': 0.3, 'speed': 1.0,
                       'damping': 0.3},
    'motor': {'coordinate': 'y', 'time_constant': 0.3},
    'observer': {'coordinates': ['y'], 'gain': 2.0, 'damping': 0.5, 'timeout': 100.0},
}
# The observed y, and its velocity.
SEEN = Observation(['y'], 0.0, np.array([0.4]), np.array([-0.2]))
INTERNAL = {'lugre_friction', 'motor'}
# Too short for an instant in which the internal variable would change, long above rounding.
INSTANT = 1e-6


def listed(kinds: Sequence[str]) -> list[str]:
    """Return kinds of effects, with the command that a motor needs."""
    return [*kinds, *['external_force'] * ('motor' in kinds and 'external_force' not in kinds)]


def combinations(count: int, seed: int, pool: Sequence[str]) -> list[tuple[str, ...]]:
    rng = np.random.default_rng(seed)
    return [tuple(rng.choice(pool, size=rng.integers(2, 5), replace=False))
            for _ in range(count)]


SMOOTH = [kind for kind in PARTS if kind not in {*INTERNAL, 'observer'}]
CASES = [
    *(('implicit_midpoint', (kind,)) for kind in PARTS),
    *(('implicit_midpoint', kinds) for kinds in combinations(10, 1, [*PARTS])),
    *(('rk4', kinds) for kinds in combinations(10, 2, SMOOTH))]


def run_of(kinds: Sequence[str], method: str, steps: int) -> Simulation:
    """Return a run with its energy by cause, in plain Python; motors have a constant command."""
    simulation = plain_run('henon_heiles', method, DURATION / steps, Q, P, *(
        effect(kind, **PARTS[kind]) for kind in listed(kinds)), energy_by_cause=True)
    for command in commands_of(simulation):
        simulation.set_command(command)
    simulation.advance(steps)
    return simulation


def commands_of(simulation: Simulation) -> list[Command]:
    """Return the constant commands that the effects of a simulation take."""
    return [*[[COMMAND] * simulation.command_size] * simulation.takes_commands,
            *[SEEN] * (OBSERVATION in simulation.motors.takes)]


class Ends(NamedTuple):
    """State and parts at the end of a reference."""

    q: np.ndarray
    p: np.ndarray
    parts: dict[str, float]


def reference(simulation: Simulation, commands: Sequence[Command], q: ArrayLike = Q,
              p: ArrayLike = P, duration: float = DURATION) -> Ends:
    """Return the end of a run by DOP853, with one more state for each integral."""
    system = simulation.system
    causes = system.causes()
    system.effect_state.reset(0)
    simulation.motors.begin()
    for command in commands:
        simulation.motors.command(command, np.array(q))
    works = [(i, joint, column) for i, cause in enumerate(causes)
             for joint, column in zip(cause.rows, system.joints.get(i, [None]), strict=True)
             if not isinstance(cause.effect, Joined)]

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        q, p, x = y[:2], y[2:4], y[4:4 + len(causes)]
        H_q, H_p = system.hamiltonian.gradient(q, p)
        forces, rates = np.zeros((2, len(causes), 2)), np.zeros(len(causes))
        for i, cause in enumerate(causes):
            if cause.effect.internal:
                column = cause.parameters.column
                forces[1, i, column], rates[i] = cause.effect.respond(
                    cause.parameters, x[i], H_p[column], 0.0, INSTANT)
            elif isinstance(cause.effect, Observer):
                own = cause.parameters
                away = q[own.columns] - SEEN.position - t * SEEN.velocity
                forces[:, i, own.columns] = -own.damping * away, -own.gain * away
            elif isinstance(cause.effect, Force):
                cause.effect.add_force(cause.parameters, t, q, p, H_p, *forces[:, i])
        powers = H_q * forces[0] + H_p * forces[1]
        return np.concatenate([
            H_p + forces[0].sum(axis=0), forces[1].sum(axis=0) - H_q, rates,
            [powers[i].sum() if column is None else powers[i, column]
             for i, _, column in works]])

    start = np.array([*q, *p, *np.zeros(len(causes) + len(works))])
    end = solve_ivp(slope, (0.0, duration), start, 'DOP853', rtol=1e-11, atol=1e-12).y[:, -1]
    q, p, x = end[:2], end[2:4], end[4:4 + len(causes)]
    sums = dict(zip([(causes[i].label, joint) for i, joint, _ in works],
                    end[4 + len(causes):].tolist(), strict=True))
    found, inside = {}, 0.0
    for i, cause in enumerate(causes):
        stored = cause.effect.stored_energy(cause.parameters, q, x[i])
        found |= {f'stored/{cause.label}': own for own in stored.values()}
        inside += sum(stored.values()) * isinstance(cause.effect, Potential)
        if cause.effect.passive:
            found |= {f'heat/{label}{joint}': -own - sum(stored.values())
                      for (label, joint), own in sums.items() if label == cause.label}
    found['stored/hamiltonian'] = float(system.hamiltonian.energy(q, p)) - inside
    if ('motor', '') in sums:
        motor = sums.pop(('motor', ''))
        key = next(key for key in sums if key[0] == 'external_force' and key[1] in ('', '/y'))
        sums['external_force+motor', key[1]] = motor + sums.pop(key)
    found |= {f'work/{label}{joint}': own for (label, joint), own in sums.items()}
    found |= {f'work/{cause.label}': 0.0 for cause in causes
              if isinstance(cause.effect, Joined) and not isinstance(cause.effect, Potential)}
    return Ends(q, p, found | {'error': 0.0})


@pytest.mark.parametrize('method, kinds', CASES, ids=lambda value: (
    value if isinstance(value, str) else '+'.join(value)))
def test_each_part_converges_to_its_integral_and_the_error_to_zero_with_the_order(method, kinds):
    """The Lorentz force and potentials are included; each joint of motors has its integral."""
    order, errors = INTEGRATORS[method].order, []
    simulation = run_of(kinds, method, 1)
    exact = reference(simulation, commands_of(simulation)).parts
    for steps in (20, 40):
        simulation = run_of(kinds, method, steps)
        names, found = simulation.ledger.names, simulation.causes
        assert sorted(names) == sorted(exact)
        # The sums close in every run, which says nothing about the parts.
        assert sum(found[k] for k, name in enumerate(names) if name.startswith('work/')) \
            + found[-1] == pytest.approx(simulation.energy - simulation._energy0, abs=1e-14)
        errors.append(np.abs([found[k] - exact[name] for k, name in enumerate(names)]))
    # The finite instant of internal variables is 1e-6 of a force.
    assert_order(order, *errors, 2e-6 if INTERNAL & set(kinds) else 1e-9)
    # Of parts of up to 1 J.
    assert (errors[0] < (0.05 if order == 2 else 1e-4)).all()


def assert_order(order: int, coarse: np.ndarray, fine: np.ndarray, floor: float = 1e-9) -> None:
    """Compare errors of parts at two step sizes; the tolerance of DOP853 is below the floor."""
    # Halved steps divide errors by 2^order up to the next term, of the size h. An error may be
    # small by chance, where it changes its sign.
    leading = np.maximum(coarse, 0.1 * coarse.max())
    assert (fine <= leading / (0.6 * 2**order) + floor).all(), (coarse, fine)


@pytest.mark.parametrize('motors', [
    {'kind': 'external_force', 'timeout': 100.0},
    {'kind': 'servo', 'stiffness': 20.0, 'damping': 0.5, 'position': [0.6, -0.4]}],
    ids=['external_force', 'servo'])
def test_wrenches_compensation_and_a_change_of_payload_have_their_integrals(motors):
    """The payload changes in the middle of the run; its part is the jump of H."""
    arm, (q, p), half = load_scene('two_joint_arm'), ([0.3, 0.5], [0.2, -0.1]), 0.2
    own = arm.model_dump()['hamiltonian'] | {'payload': {'link': 'forearm'}}
    motors = motors | {'coordinates': ['shoulder', 'elbow'], 'gravity_compensation': 'unloaded'}
    scene = arm.changed({
        'hamiltonian': own, 'integrator': {'kind': 'implicit_midpoint'}, 'step_size': 0.01,
        'initial_state': {'q': q, 'p': p}, 'energy_by_cause': True,
        'effects': [motors, {'kind': 'link_wrench', 'timeout': 100.0}]})
    push = LinkWrench('forearm', [1.0, -0.5, 2.0], [0.1, 0.2, -0.3])
    load = payload_of({'link': 'forearm', 'mass': 0.8, 'centre': [0.1, 0.02, 0.05]})
    simulation = build(scene)
    commands = [*commands_of(simulation), push]
    first = reference(simulation, commands, q, p, half)
    H = simulation.system.hamiltonian
    velocity, before = H.gradient(first.q, first.p)[1], H.energy(first.q, first.p)
    simulation.motors.command(load, first.q)
    moved = np.linalg.solve(H.inverse_mass(first.q, first.p), velocity)
    jump = float(H.energy(first.q, moved) - before)
    last = reference(simulation, [*commands, load], first.q, moved, half)
    exact = {name: part + first.parts[name] * name.startswith(('work/', 'heat/'))
             for name, part in last.parts.items()} | {'work/payload': jump}
    assert abs(jump) > 1e-3
    errors = []
    for steps in (20, 40):
        simulation = build(scene.changed({'step_size': half / steps}))
        for command in commands:
            simulation.set_command(command)
        simulation.advance(steps)
        simulation.set_command(load)
        simulation.advance(steps)
        names, found = simulation.ledger.names, simulation.causes
        assert sorted(names) == sorted(exact)
        errors.append(np.abs([found[k] - exact[name] for k, name in enumerate(names)]))
    assert_order(2, *errors)
    assert (errors[0] < 0.05).all()


@pytest.mark.parametrize('row', [
    row for row in EFFECT_ROWS if row.name not in ('thermostat', 'potential')],
    ids=lambda row: row.name)
def test_error_of_every_effect_falls_with_the_step_and_passive_ones_never_give(
        row: EffectRow, tmp_path):
    unexplained = []
    for steps in (50, 100):
        simulation = plain_run(
            row.uncompiled, 'generalized_leapfrog', row.duration / steps, row.q, row.p,
            *row.create(tmp_path), energy_by_cause=True)
        if simulation.takes_commands:
            simulation.set_command([2.0])
        worst, parts = 0.0, [simulation.causes]
        for _ in range(steps):
            simulation.advance(1)
            parts.append(simulation.causes)
            worst = max(worst, abs(parts[-1][-1]))
        unexplained.append(worst)
        names = simulation.ledger.names
        assert {name.split('/')[1].partition('+')[0] for name in names[:-1]} >= {
            label for label in simulation.system.labels if label != 'motor'}
        heats = [k for k, name in enumerate(names) if name.startswith('heat/')]
        # Heat is an integral of order 2 of a power that is at least 0.
        assert (np.array(parts)[:, heats] >= -(row.duration / steps)**2).all()
        # What moved is not lost from the books.
        assert sum(parts[-1][k] for k, name in enumerate(names) if name.startswith('work/')) \
            == pytest.approx(simulation.work, abs=1e-13)
    # Order 2 divides by 4; an impact at another place in its step by a little less.
    assert unexplained[1] < 0.4 * unexplained[0] + 1e-12


def test_impact_turns_its_share_of_the_kinetic_energy_into_heat():
    """T falls by 1 - e^2 of its value, which in free flight is its first one."""
    wall = effect('impact', 'x', 0.0, 'above', restitution=0.7)
    run = plain_run(EFFECT_ROWS[2].uncompiled, 'generalized_leapfrog', 0.01, (0.5, 0.0),
                    (-1.3, 0.4), wall, energy_by_cause=True)
    run.advance(100)
    heat = run.causes[run.ledger.names.index('heat/impact')]
    # Rounding of 1 J.
    assert heat == pytest.approx(0.5 * 1.3**2 * (1.0 - 0.7**2), abs=1e-13)


ARM = {
    'hamiltonian': 'double_pendulum', 'integrator': 'implicit_midpoint', 'step_size': 0.01,
    'initial_state': ([0.5, 0.2], [0.0, 0.0]), 'energy_by_cause': True, 'effects': [
        {'kind': 'joint_friction', 'damping': {'angle1': 0.3, 'angle2': 0.1}},
        {'kind': 'spring', 'point': ['angle1'], 'anchor': [0.3], 'stiffness': 3.0},
        {'kind': 'external_force', 'coordinates': ['angle1', 'angle2'], 'timeout': 100.0,
         'initial': [1.0, -0.5]},
        {'kind': 'motor', 'coordinate': 'angle2', 'time_constant': 0.1}]}
NAMES = (
    'work/joint_friction/angle1', 'work/joint_friction/angle2', 'work/external_force/angle1',
    'work/external_force+motor/angle2', 'stored/spring', 'stored/hamiltonian',
    'heat/joint_friction/angle1', 'heat/joint_friction/angle2', 'error')


@pytest.fixture(scope='module')
def arm() -> Trajectory:
    """Return a run of 0.5 s of an arm with motors, friction and a spring."""
    return simulate(Scene.build(**ARM), 0.5)


def test_batch_and_simulate_agree_bit_by_bit(arm):
    moved = arm.q[0] + 0.1
    many = simulate_many(arm.scene, [arm.q[0], moved], [arm.p[0]] * 2, 0.5, samples=50)
    commanded = simulate_many(arm.scene, [moved, arm.q[0]], [arm.p[0]] * 2, 0.5, samples=50,
                              commands=lambda t: [1.0, -0.5])
    assert many.energy_by_cause.values.shape == (51, 2, 9)
    assert many.energy_by_cause.names == NAMES
    for found in (many.select(0), commanded.select(1)):
        assert np.array_equal(found.q, arm.q)
        assert np.array_equal(found.energy_by_cause.values, arm.energy_by_cause.values)
        # Some roundings of H.
        assert np.abs(found.work - arm.work).max() <= 1e-15 * np.abs(arm.energy).max()
    assert not np.array_equal(many.select(1).energy_by_cause.values, arm.energy_by_cause.values)
    with refused(ValueError):
        simulate_many(Scene.build(**ARM | {'effects': []}), [[0.5, 0.2]], [[0.0, 0.0]], 0.5,
                      device='cpu')


def test_run_without_it_has_the_same_code_and_its_bits_and_none_to_show(arm):
    """Only effects with several joints have more channels, which may change last digits."""
    scene = Scene.build(**ARM | {'energy_by_cause': False})
    plain = simulate(scene, 0.5)
    assert plain.energy_by_cause is None
    # Rounding of 50 steps: the solver stops at other digits.
    assert plain.q == pytest.approx(arm.q, abs=1e-12)
    single = scene.changed({'effects': [*ARM['effects'][1:2], {'kind': 'damping', 'rate': 0.1}]})
    with_it, without = (simulate(single, 0.5, energy_by_cause=asked) for asked in (True, False))
    assert np.array_equal(with_it.q, without.q) and np.array_equal(with_it.work, without.work)
    with refused(ValueError):
        plain.plot_energy()


def test_energy_by_cause_is_true_or_false():
    with refused(SceneError):
        simulate('exact_pendulum', 0.1, energy_by_cause='yes')


def test_energy_by_cause_has_names_units_and_columns_and_is_kept(arm, tmp_path):
    causes = arm.energy_by_cause
    assert isinstance(causes, EnergyByCause) and causes.names == NAMES
    assert causes.units == {'t': 's', **dict.fromkeys(NAMES, 'J')}
    frame = causes.to_dataframe()
    assert [*frame.columns] == [*NAMES] and frame.attrs['units'] == causes.units
    assert np.array_equal(frame['error'], causes.of('error')[''])
    assert [*causes.of('stored/')] == ['spring', 'hamiltonian']
    assert sum(causes.of('stored/').values()) == pytest.approx(arm.energy, abs=1e-13)
    assert np.array_equal(arm[10:20].energy_by_cause.values, causes.values[10:20])
    arm.save(tmp_path / 'run.safetensors')
    kept = Trajectory.load(tmp_path / 'run.safetensors').energy_by_cause
    assert kept.names == NAMES and np.array_equal(kept.values, causes.values)


def test_samples_between_steps_are_nan_and_those_beyond_ten_thousand_are_not():
    causes = simulate(Scene.build(**ARM), 0.1, times=[0.02, 0.025, 0.1]).energy_by_cause
    assert np.isnan(causes.values).all(axis=1).tolist() == [False, True, False]
    long = simulate(Scene.build(**ARM | {'step_size': 1e-4, 'integrator': 'rk4', 'effects': [
        {'kind': 'damping', 'rate': 0.1}]}), 3.0)
    assert len(long) == 30_001
    assert np.isfinite(long.energy_by_cause.values).all() and np.isfinite(long.work).all()


def test_figure_shows_what_is_stored_lost_and_given_and_the_rest(arm):
    figure = arm.plot_energy()
    upper, lower = figure.axes
    labels = upper.get_legend_handles_labels()[1]
    # The lowest energy, which is not drawn, is named.
    least = {name: f'stored: {own} - ({arm.energy_by_cause.of("stored/")[name].min():.4g} J)'
             for name, own in (('spring', 'spring'), ('hamiltonian', 'double_pendulum'))}
    assert {*least.values(), 'lost: joint_friction/angle1',
            'work: external_force+motor/angle2'} <= set(labels)
    areas = {area.get_label(): area for area in upper.collections}
    below = areas['lost: joint_friction/angle1'].get_paths()[0].vertices[:, 1]
    above = areas[least['hamiltonian']].get_paths()[0].vertices[:, 1]
    assert below.min() == -arm.energy_by_cause.of('heat/')['joint_friction/angle1'][-1]
    assert above.min() >= 0.0 >= below.max()
    assert np.array_equal(lower.lines[0].get_ydata(), arm.energy_by_cause.of('error')[''])


def test_gears_of_drives_have_their_energies_and_loops_do_no_work():
    arm = load_scene('two_joint_arm')
    geared = arm.changed({
        'hamiltonian': arm.hamiltonian.model_dump() | {'drives': {'elbow': {
            'stiffness': 50.0, 'damping': 0.2, 'rotor_inertia': 2e-5, 'gear': 50.0}}},
        'initial_state': {'q': [0.3, 0.2, 0.1], 'p': [0.0, 0.0, 0.0]}, 'effects': []})
    found = simulate(geared, 0.05, integrator='gauss4', step_size=1e-3,
                     energy_by_cause=True).energy_by_cause
    assert {'stored/elastic gears/elbow', 'heat/gear damping'} <= set(found.names)
    assert found.of('stored/')['elastic gears/elbow'][0] == pytest.approx(0.5 * 50.0 * 0.1**2)
    assert (np.diff(found.of('heat/')['gear damping']) >= -1e-12).all()
    closed = simulate('four_bar', 0.05, energy_by_cause=True).energy_by_cause
    assert (closed.of('work/')['loops'] == 0.0).all()


def geared_arm(step_size: float) -> Simulation:
    """Return an arm with LuGre friction, backlash, stops, a servo and a motor."""
    arm = load_scene('two_joint_arm')
    return build(arm.changed({
        'hamiltonian': arm.hamiltonian.model_dump() | {'drives': {'elbow': {
            'stiffness': 300.0, 'damping': 0.5, 'rotor_inertia': 2e-5, 'gear': 50.0,
            'backlash': 0.02, 'smoothing': 0.002}}},
        'initial_state': {'q': [0.3, 0.2, 0.2], 'p': [0.0, 0.0, 0.0]},
        'step_size': step_size, 'energy_by_cause': True, 'effects': [
            {'kind': 'lugre_friction', 'coordinate': 'shoulder', 'stiffness': 200.0,
             'friction': 0.5, 'stribeck': 0.2, 'speed': 0.05, 'damping': 0.2},
            {'kind': 'servo', 'coordinates': ['shoulder'], 'stiffness': 40.0, 'damping': 1.0,
             'position': [0.5]},
            {'kind': 'external_force', 'coordinates': ['elbow'], 'timeout': 100.0},
            {'kind': 'motor', 'coordinate': 'elbow', 'time_constant': 0.02,
             'torque_limit': 12.0, 'no_load_speed': 20.0},
            {'kind': 'joint_limits', 'lower': {'elbow': -1.0}, 'upper': {'elbow': 1.0},
             'restitution': 0.3}]}))


def books_of(step_size: float, seconds: int) -> tuple[float, float, np.ndarray]:
    """Return the largest error, the largest fall of a heat, and all parts at the end [J]."""
    simulation, every = geared_arm(step_size), round(1.0 / step_size)
    heats = [k for k, name in enumerate(simulation.ledger.names) if name.startswith('heat/')]
    worst, fall, before = 0.0, 0.0, simulation.causes
    for k in range(seconds):
        simulation.set_command([(8.0, -8.0, 0.0, 4.0, -4.0)[k % 5]])
        simulation.advance(every)
        found = simulation.causes
        worst, fall = max(worst, abs(found[-1])), max(fall, (before - found)[heats].max())
        before = found
    return worst, fall, before


def test_books_of_a_geared_arm_close_with_the_order_of_its_method():
    (coarse, fell, parts), (fine, falls, _) = books_of(1e-3, 10), books_of(5e-4, 10)
    # Order 2 divides both by 4, up to the next order; every kind of part moved.
    assert 3.0 < coarse / fine < 5.0 and falls <= 0.3 * fell < 1e-3
    assert coarse < 1e-3 * np.abs(parts).max() and (np.abs(parts) > 1e-5).all()
